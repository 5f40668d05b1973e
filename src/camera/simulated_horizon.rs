//! The simulator as a roll camera: the Earth's limb from a swinging gondola.

use super::pace::Pace;
use super::{CameraError, Exposure, FrameSource, Settings, Take};
use crate::simulate::SceneError;
use crate::simulate::earth::SwingingGondola;
use jiff::{SignedDuration, Timestamp};
use std::time::Duration;

/// The exposure at which the limb is as bright as the simulator's usual one.
const USUAL_EXPOSURE: Duration = Duration::from_millis(15);

/// A camera that sees the limb, at its own rate and on a clock that starts where it is told. It takes 0.1 s to draw a million pixels.
pub struct SimulatedHorizon {
    gondola: SwingingGondola,
    settings: Settings,
    pace: Pace,
    start: Timestamp,
    /// Length of the whole run; `None` without end.
    duration: Option<Duration>,
    number: u64,
}

impl SimulatedHorizon {
    /// From `start` on, for `duration` or without end.
    pub fn new(
        gondola: SwingingGondola,
        settings: &Settings,
        start: Timestamp,
        duration: Option<Duration>,
    ) -> Self {
        Self {
            gondola,
            settings: settings.clone(),
            pace: Pace::default(),
            start,
            duration,
            number: 0,
        }
    }

    /// Whether the run holds as many frames as fit, to the nearest.
    fn is_over(&self) -> bool {
        let middle = self.pace.due() + self.settings.period() / 2;
        self.duration.is_some_and(|duration| middle > duration)
    }
}

impl FrameSource for SimulatedHorizon {
    fn next(&mut self, starts: &mut dyn FnMut(Timestamp)) -> Result<Take, CameraError> {
        if self.is_over() {
            return Ok(Take::End);
        }
        if !self.pace.is_due() {
            return Ok(Take::NotYet);
        }
        let (due, exposure) = (self.pace.due(), self.settings.exposure());
        let number = self.number;
        self.number += 1;
        self.pace.advance(self.settings.period());
        let announced = self.start.checked_add(SignedDuration::try_from(due)?)?;
        starts(announced);
        let middle = due + exposure / 2;
        let brightness = exposure.as_secs_f64() / USUAL_EXPOSURE.as_secs_f64();
        let scene = self.gondola.scene(number, middle, brightness);
        let mut frame = scene.frame().map_err(SceneError::from)?;
        frame.info.mid_exposure = Some(self.start.checked_add(SignedDuration::try_from(middle)?)?);
        frame.info.monotonic = Some(middle);
        frame.info.exposure = Some(exposure);
        Ok(Take::Exposure(Box::new(Exposure { frame, announced })))
    }

    fn apply(&mut self, settings: &Settings) -> Result<(), CameraError> {
        self.settings = settings.clone();
        Ok(())
    }

    fn frames_wait(&self) -> bool {
        true
    }
}
