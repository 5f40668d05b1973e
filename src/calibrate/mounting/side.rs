//! The side from which the plate is seen.

use crate::instrument::Instrument;
use crate::pointing::{self, Horizontal, Roll};
use crate::sky::SunPosition;
use nalgebra::Vector2;

/// The side from which the plate is seen.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Side {
    /// The convention of [`pointing`].
    Front,
    /// Mirrored.
    Back,
}

impl Side {
    /// A shift on the plate as seen from this side.
    pub fn view(self, shift: Vector2<f64>) -> Vector2<f64> {
        match self {
            Self::Front => shift,
            Self::Back => Vector2::new(-shift.x, shift.y),
        }
    }

    /// The Sun's shift from the boresight on the plate, mil; `None` if the Sun is behind the lens.
    pub fn shift(
        self,
        telescope: Horizontal,
        instrument: &Instrument,
        sun: &SunPosition,
    ) -> Option<Vector2<f64>> {
        let at = pointing::sun_on_plate(telescope, Roll::Stated, instrument, sun).ok()?;
        Some(self.view(at.vector() - instrument.mounting.boresight_mil.vector()))
    }
}
