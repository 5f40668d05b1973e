//! A drift scan: the gondola stands still while the Sun crosses the plate.

use super::random::{Conditions, RandomScenes};
use super::scene::{Scene, SceneError};
use crate::instrument::Instrument;
use crate::pointing::{self, Horizontal, Roll};
use crate::sky::{Air, Ephemeris, SkyError, SunPosition};
use crate::units::{Place, PlateMil, SensorPx};
use jiff::Timestamp;

/// Reason why a drift scan has no scene at an instant.
#[derive(Debug, thiserror::Error)]
pub enum DriftError {
    #[error(transparent)]
    Sky(#[from] SkyError),
    #[error(transparent)]
    Pointing(#[from] pointing::PointingError),
    #[error(transparent)]
    Scene(#[from] SceneError),
    #[error("{0}")]
    Time(#[from] jiff::Error),
}

/// The scenes of a drift scan, by instant: conditions and blemishes as in [`RandomScenes`], the Sun at the position given by the ephemeris
/// and the instrument's own mounting, with refraction by the standard atmosphere.
#[derive(Debug, Clone)]
pub struct DriftScenes {
    scenes: RandomScenes,
    instrument: Instrument,
    place: Place,
    /// Apparent direction of the telescope.
    towards: Horizontal,
    /// The same without refraction.
    pub pointing: Horizontal,
    ephemeris: Ephemeris,
}

impl DriftScenes {
    /// A scan with the Sun in the middle of the sensor at an instant.
    pub fn new(
        instrument: &Instrument,
        conditions: &Conditions,
        (middle, place): (Timestamp, Place),
        seed: u64,
    ) -> Result<Self, DriftError> {
        let scenes = RandomScenes::new(instrument, conditions, seed)?;
        let mut ephemeris = Ephemeris::default();
        let sun = ephemeris.sun(middle, place)?;
        let camera = &instrument.camera;
        let middle_px = SensorPx::new(
            (camera.width_px as f64 - 1.0) / 2.0,
            (camera.height_px as f64 - 1.0) / 2.0,
        );
        let at = scenes.mapping().to_plate(middle_px);
        let pointing = pointing::pointing(at, Roll::Stated, instrument, &sun)?;
        let lift_deg = Air::standard(place.height_m).lift_deg(pointing.elevation_deg);
        Ok(Self {
            scenes,
            instrument: instrument.clone(),
            place,
            towards: Horizontal {
                elevation_deg: pointing.elevation_deg + lift_deg,
                ..pointing
            },
            pointing,
            ephemeris,
        })
    }

    /// The scene of the frame with mid-exposure at an instant.
    pub fn scene(&mut self, number: u64, utc: Timestamp) -> Result<Scene, DriftError> {
        let centre = self.sun_on_plate(utc)?;
        let half = jiff::SignedDuration::from_millis(500);
        let [before, after] = [utc.checked_sub(half)?, utc.checked_add(half)?];
        let per_s = self.sun_on_plate(after)?.vector() - self.sun_on_plate(before)?.vector();
        let mut scene = self.scenes.scene_at(number, centre, per_s);
        scene.info.place = Some(self.place);
        scene.info.mid_exposure = Some(utc);
        Ok(scene)
    }

    fn sun_on_plate(&mut self, utc: Timestamp) -> Result<PlateMil, DriftError> {
        let sun = self.ephemeris.sun(utc, self.place)?;
        let lift_deg = Air::standard(self.place.height_m).lift_deg(sun.elevation_deg);
        let seen = SunPosition {
            elevation_deg: sun.elevation_deg + lift_deg,
            ..sun
        };
        Ok(pointing::sun_on_plate(
            self.towards,
            Roll::Stated,
            &self.instrument,
            &seen,
        )?)
    }
}
