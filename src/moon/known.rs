//! Priors of a limb before it is measured.

use crate::units::Measured;

/// If the picture contradicts a prior radius by so many sigmas and by this relative difference, the radius gets this
/// relative uncertainty, 1 sigma.
pub(super) const CONTRADICTION_SIGMAS: f64 = 5.0;
const CONTRADICTION: f64 = 0.015;
const LOOSE_RADIUS: f64 = 0.06;
/// If a larger share of the lit limb is saturated, its radius is not the Moon's: the light has spilled over by about so
/// much.
pub(super) const MOST_SATURATED: f64 = 0.2;
const SPILLED_PX: f64 = 1.5;

/// Priors of a limb before it is measured.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Known {
    /// Radius, round px.
    pub radius: Option<Measured>,
    pub phase_rad: Measured,
    pub bright_limb_rad: Measured,
}

/// Difference between the radius in the picture and the prior one: in px, and in sigmas of the difference.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Contradiction {
    pub off_px: f64,
    pub sigmas: f64,
}

impl Known {
    /// The same with a loose prior of the radius if the picture contradicts it: then the picture determines the radius,
    /// within the allowed range.
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

    /// The same with a loose radius if too much of the limb is saturated.
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
