//! Test of the solver's settings: whether the solver finds the Sun with them in a frame simulated from the instrument's file.

use crate::aspect::{self, Expected, Quality};
use crate::config::{Config, Refused};
use crate::frame::Frame;
use crate::instrument::{Instrument, MEAN_SUN_ARCSEC};
use crate::simulate::{Scene, Sun};
use std::sync::OnceLock;

/// A frame with the Sun at the boresight, rendered when it is first needed.
#[derive(Debug)]
pub struct Proof {
    instrument: Instrument,
    frame: OnceLock<Option<Frame>>,
}

impl Proof {
    pub fn of(instrument: &Instrument) -> Self {
        Self {
            instrument: instrument.clone(),
            frame: OnceLock::new(),
        }
    }

    /// # Errors
    /// If, after `key` has been set, the solver finds no Sun, although it did with its defaults.
    pub fn check(&self, key: &str, config: &Config) -> Result<(), Refused> {
        let Some(frame) = self.frame.get_or_init(|| self.draw()) else {
            return Ok(());
        };
        let found = self.solve(&config.solver(), frame);
        if found == Quality::Fine {
            return Ok(());
        }
        Err(Refused {
            key: key.to_owned().into(),
            expected: "settings of the solver with which a frame of this instrument is fine".into(),
            found: format!(
                "with those of [limb], [fiducial] and [registration]: {}",
                found.name()
            ),
        })
    }

    /// `None` if the solver finds no Sun with the defaults, either: such an instrument cannot be used for the test.
    fn draw(&self) -> Option<Frame> {
        let instrument = &self.instrument;
        let mut scene = Scene::new(instrument, instrument.nominal_mapping()?);
        let radius_mil = instrument.optics.radius_mil(MEAN_SUN_ARCSEC);
        scene.sun = Some(Sun::new(instrument.mounting.boresight_mil, radius_mil));
        let frame = scene.frame().ok()?;
        let proves = self.solve(&aspect::SolverSettings::default(), &frame) == Quality::Fine;
        proves.then_some(frame)
    }

    fn solve(&self, settings: &aspect::SolverSettings, frame: &Frame) -> Quality {
        let expected = Some(Expected {
            radius_arcsec: MEAN_SUN_ARCSEC,
        });
        aspect::solve_with(settings, frame, &self.instrument, expected, None).quality
    }
}
