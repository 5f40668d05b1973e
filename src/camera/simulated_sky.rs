//! The simulator as a camera that looks at the sky: the Earth's limb from a swinging gondola, or the Moon.

use super::pace::Pace;
use super::{CameraError, Exposure, FrameSource, Settings, Take};
use crate::frame::Frame;
use crate::simulate::SceneError;
use crate::simulate::earth::SwingingGondola;
use crate::simulate::moon::FollowedMoon;
use jiff::{SignedDuration, Timestamp};
use std::time::Duration;

/// The exposure at which limb and Moon are as bright as the simulator's usual ones.
const USUAL_EXPOSURE: Duration = Duration::from_millis(15);

/// What a simulated camera looks at.
pub enum SkyView {
    Horizon(Box<SwingingGondola>),
    Moon(Box<FollowedMoon>),
}

impl SkyView {
    fn frame(
        &mut self,
        number: u64,
        (middle, utc): (Duration, Timestamp),
        brightness: f64,
    ) -> Result<Frame, CameraError> {
        let frame = match self {
            Self::Horizon(gondola) => gondola.scene(number, middle, brightness).frame(),
            Self::Moon(moon) => moon.scene(number, utc, brightness)?.frame(),
        };
        Ok(frame.map_err(SceneError::from)?)
    }
}

/// A camera that looks at the sky, at its own rate and on a clock that starts where it is told. It draws a picture before its time: a million pixels of the limb take
/// 0.1 s.
pub struct SimulatedSky {
    view: SkyView,
    settings: Settings,
    pace: Pace,
    start: Timestamp,
    /// Length of the whole run; `None` without end.
    duration: Option<Duration>,
    number: u64,
    /// The next exposure, drawn before its time.
    drawn: Option<Result<Exposure, CameraError>>,
}

impl SimulatedSky {
    /// From `start` on, for `duration` or without end.
    pub fn new(
        view: SkyView,
        settings: &Settings,
        start: Timestamp,
        duration: Option<Duration>,
    ) -> Self {
        Self {
            view,
            settings: settings.clone(),
            pace: Pace::default(),
            start,
            duration,
            number: 0,
            drawn: None,
        }
    }

    fn draw(&mut self) -> Result<Exposure, CameraError> {
        let (due, exposure) = (self.pace.due(), self.settings.exposure());
        let announced = self.start.checked_add(SignedDuration::try_from(due)?)?;
        let middle = due + exposure / 2;
        let brightness = exposure.as_secs_f64() / USUAL_EXPOSURE.as_secs_f64();
        let utc = self.start.checked_add(SignedDuration::try_from(middle)?)?;
        let mut frame = self.view.frame(self.number, (middle, utc), brightness)?;
        frame.info.mid_exposure = Some(utc);
        frame.info.monotonic = Some(middle);
        frame.info.exposure = Some(exposure);
        Ok(Exposure { frame, announced })
    }

    /// Whether the run holds as many frames as fit, to the nearest.
    fn is_over(&self) -> bool {
        let middle = self.pace.due() + self.settings.period() / 2;
        self.duration.is_some_and(|duration| middle > duration)
    }
}

impl FrameSource for SimulatedSky {
    fn next(&mut self, starts: &mut dyn FnMut(Timestamp)) -> Result<Take, CameraError> {
        if self.is_over() {
            return Ok(Take::End);
        }
        self.pace.begin();
        let drawn = self.drawn.take().unwrap_or_else(|| self.draw());
        if !self.pace.is_due() {
            self.drawn = Some(drawn);
            return Ok(Take::NotYet);
        }
        self.number += 1;
        self.pace.advance(self.settings.period());
        let exposure = drawn?;
        starts(exposure.announced);
        std::thread::sleep(self.settings.exposure());
        Ok(Take::Exposure(Box::new(exposure)))
    }

    fn apply(&mut self, settings: &Settings) -> Result<(), CameraError> {
        self.settings = settings.clone();
        self.drawn = None;
        Ok(())
    }

    fn frames_wait(&self) -> bool {
        true
    }
}
