//! Priors of a limb before it is measured.

use crate::units::Measured;

/// A radius that the picture contradicts by so many sigmas and so much, relative to it, is known only this well, 1 sigma relative to it.
pub(super) const CONTRADICTION_SIGMAS: f64 = 5.0;
const CONTRADICTION: f64 = 0.015;
const LOOSE_RADIUS: f64 = 0.06;
/// Where more of the lit limb is saturated its radius is not the Moon's: light has spilled by about so much.
pub(super) const MOST_SATURATED: f64 = 0.2;
const SPILLED_PX: f64 = 1.5;

/// Priors of a limb before it is measured.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Known {
    /// Round px.
    pub radius: Option<Measured>,
    pub phase_rad: Measured,
    pub bright_limb_rad: Measured,
}

/// How far the radius that the picture shows lies from the one that was known: px, and sigmas of both.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Contradiction {
    pub off_px: f64,
    pub sigmas: f64,
}

impl Known {
    /// The same where the picture shows another radius: then the picture determines it, within what is allowed.
    pub fn contradicted(self, by: Option<Contradiction>) -> Self {
        let loose = |radius: Measured| {
            let sigma = LOOSE_RADIUS * radius.value;
            Measured::new(radius.value, radius.sigma.max(sigma))
        };
        let is_other = |radius: Measured| {
            by.is_some_and(|by| {
                by.sigmas > CONTRADICTION_SIGMAS && by.off_px > CONTRADICTION * radius.value
            })
        };
        Self {
            radius: self.radius.map(|radius| match is_other(radius) {
                true => loose(radius),
                false => radius,
            }),
            ..self
        }
    }

    /// The same where so much of the limb is saturated.
    pub fn loosened(self, saturated: f64) -> Self {
        let loose = |radius: Measured| Measured::new(radius.value, radius.sigma.max(SPILLED_PX));
        match saturated > MOST_SATURATED {
            true => Self {
                radius: self.radius.map(loose),
                ..self
            },
            false => self,
        }
    }
}
