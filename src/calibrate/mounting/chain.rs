//! From the sky to the plate: at which end directions count, and from which side the plate is seen.

use crate::instrument::Instrument;
use crate::pointing::{self, Horizontal};
use crate::sky::SunPosition;
use nalgebra::Vector2;

/// Where the directions on the plate count from the zenith. At the boresight the two are one; beside it the zenith's direction turns.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Chain {
    /// At the Sun: the chain of [`pointing`], as HEROES's flight program had it.
    AtSun,
    /// At the telescope: a plate that stands rigidly in the gondola.
    AtTelescope,
}

/// From which side the plate is seen.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Side {
    /// As the chain of [`pointing`] has it.
    Front,
    /// In a mirror.
    Back,
}

impl Side {
    /// A shift on the plate as this side sees it.
    pub fn seen(self, shift: Vector2<f64>) -> Vector2<f64> {
        match self {
            Self::Front => shift,
            Self::Back => Vector2::new(-shift.x, shift.y),
        }
    }
}

impl Chain {
    /// The Sun's shift from the boresight on the plate, mil; `None` when the Sun stands behind the lens.
    pub(super) fn shift(
        self,
        telescope: Horizontal,
        instrument: &Instrument,
        sun: &SunPosition,
    ) -> Option<Vector2<f64>> {
        let centre = instrument.mounting.boresight_mil.vector();
        match self {
            Self::AtSun => {
                let at = pointing::sun_on_plate(telescope, instrument, sun).ok()?;
                Some(at.vector() - centre)
            }
            // From the telescope the Sun lies the other way: the same chain with the two exchanged.
            Self::AtTelescope => {
                let towards_sun = Horizontal {
                    azimuth_deg: sun.azimuth_deg,
                    elevation_deg: sun.elevation_deg,
                };
                let from = SunPosition {
                    azimuth_deg: telescope.azimuth_deg,
                    elevation_deg: telescope.elevation_deg,
                    ..*sun
                };
                let at = pointing::sun_on_plate(towards_sun, instrument, &from).ok()?;
                Some(centre - at.vector())
            }
        }
    }
}
