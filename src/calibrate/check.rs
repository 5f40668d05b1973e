//! Checks whether fine frames contradict the calibration of the camera: a wrong file, or a camera that was moved.
//!
//! A fine frame measures rotation, scale and the position of the plate's centre on its own. Its sigma here includes two terms that the
//! registration's omits: a tilt of the camera, which a similarity does not show near the Sun but which is significant at the calibration's
//! reference far from it; and errors of the marks' printed positions, which are the same in every frame.

use crate::aspect::{Quality, Solution, printed_mil};
use crate::estimation::CONTRADICTION_SIGMAS;
use crate::geometry::{MappingKind, TILT_PER_PX};
use crate::instrument::Instrument;
use crate::units::Measured;
use serde::{Deserialize, Serialize};
use std::fmt;

/// Number of successive fine frames that must agree on a contradiction: a single misidentified frame is not sufficient.
const PROVE: u32 = 3;

/// Quantities of the camera that are stated in an instrument's file and measured in every fine frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
pub enum Quantity {
    Rotation,
    Scale,
    CentreX,
    CentreY,
}

impl Quantity {
    pub const ALL: [Self; 4] = [Self::Rotation, Self::Scale, Self::CentreX, Self::CentreY];

    /// Key in the instrument's file, and unit.
    pub fn key(self) -> &'static str {
        match self {
            Self::Rotation => "mounting.rotation_deg",
            Self::Scale => "mounting.scale_mil_per_px",
            Self::CentreX => "mounting.plate_centre_px, x",
            Self::CentreY => "mounting.plate_centre_px, y",
        }
    }

    fn stated(self, instrument: &Instrument) -> Measured {
        let mounting = &instrument.mounting;
        let centre = |value| Measured::new(value, mounting.plate_centre_sigma_px);
        match self {
            Self::Rotation => mounting.rotation_deg,
            Self::Scale => mounting.scale_mil_per_px,
            Self::CentreX => centre(mounting.plate_centre_px.x),
            Self::CentreY => centre(mounting.plate_centre_px.y),
        }
    }

    /// One value minus another.
    fn difference(self, a: f64, b: f64) -> f64 {
        match self {
            Self::Rotation => (a - b + 180.0).rem_euclid(360.0) - 180.0,
            _ => a - b,
        }
    }

    fn differ(self, a: Measured, b: Measured) -> bool {
        self.difference(a.value, b.value).abs() > CONTRADICTION_SIGMAS * a.sigma.hypot(b.sigma)
    }
}

/// A quantity that a fine frame contradicts by more than five sigmas, the stated one and the frame's in quadrature.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Contradiction {
    pub quantity: Quantity,
    pub stated: Measured,
    pub measured: Measured,
}

impl fmt::Display for Contradiction {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            quantity,
            stated,
            measured,
        } = self;
        write!(
            out,
            "{}: stated {} +- {}, measured {:.3} +- {:.3}",
            quantity.key(),
            stated.value,
            stated.sigma,
            measured.value,
            measured.sigma
        )
    }
}

/// Contradictions between a fine frame and the instrument; empty for any other frame.
pub fn contradictions(solution: &Solution, instrument: &Instrument) -> Vec<Contradiction> {
    let found = Quantity::ALL
        .into_iter()
        .zip(measured(solution, instrument).into_iter().flatten());
    let all = found.map(|(quantity, measured)| Contradiction {
        quantity,
        stated: quantity.stated(instrument),
        measured,
    });
    all.filter(|c| c.quantity.differ(c.stated, c.measured))
        .collect()
}

/// Values that a fine frame measures, in the order of [`Quantity::ALL`].
fn measured(solution: &Solution, instrument: &Instrument) -> Option<[Measured; 4]> {
    let adopted = solution.mapping.as_ref()?;
    let registration = adopted
        .own()
        .filter(|_| solution.quality == Quality::Fine)?;
    let aspect = solution.aspect?;
    let [rotation_deg, scale, x_px, y_px] = registration.at_plate_centre();
    let from_sun_px =
        (x_px.value - aspect.sun_px.position.x).hypot(y_px.value - aspect.sun_px.position.y);
    let tilt_per_px = match registration.mapping.kind() {
        MappingKind::Similarity | MappingKind::Affine => TILT_PER_PX,
        MappingKind::Keystone | MappingKind::Homography => 0.0,
    };
    let turned = tilt_per_px * from_sun_px;
    let printed = printed_mil(&solution.marks, &instrument.plate)
        / (aspect.sun_radius_px.value * scale.value);
    let widened = |m: Measured, by: f64| Measured::new(m.value, m.sigma.hypot(by));
    let open_px =
        (turned * from_sun_px).hypot(printed * from_sun_px.hypot(aspect.sun_radius_px.value));
    Some([
        widened(rotation_deg, turned.hypot(printed).to_degrees()),
        // The relative change of scale along the tilt is twice that across it.
        widened(scale, scale.value * (1.5 * turned).hypot(printed)),
        widened(x_px, open_px),
        widened(y_px, open_px),
    ])
}

/// Check of the instrument's calibration against a flight's fine frames.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct CalibrationCheck {
    /// Trials in the order of [`Quantity::ALL`].
    trials: [Trial; 4],
}

/// A stated quantity and its contradictions by fine frames.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct Trial {
    /// The last frame's contradiction, and the number of successive frames that agree on it.
    last: Option<(Contradiction, u32)>,
    /// Number of successive fine frames without a contradiction.
    agreeing: u32,
    proven: Option<Contradiction>,
}

impl CalibrationCheck {
    /// Takes a frame's solution into account; returns the contradictions that it newly proves.
    pub fn note(&mut self, solution: &Solution, instrument: &Instrument) -> Vec<Contradiction> {
        if measured(solution, instrument).is_none() {
            return Vec::new();
        }
        let found = contradictions(solution, instrument);
        let trials = Quantity::ALL.into_iter().zip(&mut self.trials);
        let proven = trials.filter_map(|(quantity, trial)| {
            trial.note(found.iter().find(|c| c.quantity == quantity).copied())
        });
        proven.collect()
    }

    /// Contradictions that fine frames have proved.
    pub fn proven(&self) -> impl Iterator<Item = Contradiction> {
        self.trials.iter().filter_map(|trial| trial.proven)
    }

    /// The instrument with measured values in place of disproved ones; `None` if none was disproved.
    pub fn corrected(&self, instrument: &Instrument) -> Option<Instrument> {
        self.proven().next()?;
        let mut corrected = instrument.clone();
        let mounting = &mut corrected.mounting;
        for Contradiction {
            quantity,
            stated,
            measured,
        } in self.proven()
        {
            // On a sensor readout window pixels count from another corner: apply the difference.
            let shift = measured.value - stated.value;
            match quantity {
                Quantity::Rotation => mounting.rotation_deg = measured,
                Quantity::Scale => mounting.scale_mil_per_px = measured,
                Quantity::CentreX => mounting.plate_centre_px.x += shift,
                Quantity::CentreY => mounting.plate_centre_px.y += shift,
            }
            if matches!(quantity, Quantity::CentreX | Quantity::CentreY) {
                // The axes share a sigma; the axis that was not disproved keeps at least the stated one.
                let stated_px = instrument.mounting.plate_centre_sigma_px;
                mounting.plate_centre_sigma_px = stated_px.max(measured.sigma);
            }
        }
        Some(corrected)
    }
}

impl Trial {
    fn note(&mut self, found: Option<Contradiction>) -> Option<Contradiction> {
        let Some(found) = found else {
            self.last = None;
            self.agreeing += 1;
            if self.agreeing >= PROVE {
                self.proven = None;
            }
            return None;
        };
        self.agreeing = 0;
        let in_a_row = match self.last {
            Some((last, count)) if !found.quantity.differ(last.measured, found.measured) => {
                count.saturating_add(1)
            }
            _ => 1,
        };
        self.last = Some((found, in_a_row));
        if in_a_row < PROVE {
            return None;
        }
        self.proven.replace(found).is_none().then_some(found)
    }
}
