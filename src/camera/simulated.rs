//! The simulator as a camera: it takes its time over every exposure, as a camera does.

use super::pace::Pace;
use super::{CameraError, Exposure, FrameSource, PixelFormat, Settings, Take, settings};
use crate::frame::{Frame, Region};
use crate::simulate::{Depth, FlightScenes, Picture, Scene, TruthOfSun};
use jiff::{SignedDuration, Timestamp};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// The truth of every frame so far by its number. It stays with the simulator's side; the solver never sees it.
#[derive(Debug, Clone, Default)]
pub struct TruthLog(Arc<Mutex<BTreeMap<u64, Option<TruthOfSun>>>>);

impl TruthLog {
    fn note(&self, number: u64, truth: Option<TruthOfSun>) {
        let mut log = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        log.insert(number, truth);
    }

    /// Where the Sun was in a frame: outer `None` for a frame that was never taken, inner for one without Sun.
    pub fn of(&self, number: u64) -> Option<Option<TruthOfSun>> {
        let log = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        log.get(&number).copied()
    }
}

/// A camera that sees a simulated flight, at its own rate and on a clock that starts where it is told.
pub struct SimulatedCamera {
    scenes: FlightScenes,
    period: Duration,
    region: Option<Region>,
    pace: Pace,
    start: Timestamp,
    /// How far the flight was when the first frame was taken.
    ahead: Duration,
    /// Length of the whole run; `None` without end.
    duration: Option<Duration>,
    number: u64,
    truth: TruthLog,
    /// The next exposure, drawn before its time: a camera's frame is there when its exposure ends, however long it takes to draw.
    drawn: Option<Result<Drawn, CameraError>>,
}

/// An exposure, and the truth about it.
struct Drawn {
    exposure: Exposure,
    truth: Option<TruthOfSun>,
}

impl SimulatedCamera {
    /// A flight from `start` on, at `rate_hz`, for `duration` or without end.
    pub fn new(
        scenes: FlightScenes,
        rate_hz: f64,
        start: Timestamp,
        duration: Option<Duration>,
    ) -> Self {
        Self {
            scenes,
            period: settings::period(rate_hz),
            region: None,
            pace: Pace::default(),
            start,
            ahead: Duration::ZERO,
            duration,
            number: 0,
            truth: TruthLog::default(),
            drawn: None,
        }
    }

    /// The same, begun so long after the flight.
    pub fn ahead_by(self, ahead: Duration) -> Self {
        Self { ahead, ..self }
    }

    /// The truth of the frames that this camera takes.
    pub fn truth(&self) -> TruthLog {
        self.truth.clone()
    }

    /// Whether the run holds as many frames as fit, to the nearest.
    fn is_over(&self) -> bool {
        let middle = self.pace.due() + self.period / 2;
        self.duration.is_some_and(|duration| middle > duration)
    }

    fn draw(&self) -> Result<Drawn, CameraError> {
        let (scene, announced) = self.due_scene()?;
        let Picture { frame, truth } = scene.picture()?;
        let frame = match self.region {
            Some(region) => read_out(frame, region)?,
            None => frame,
        };
        Ok(Drawn {
            exposure: Exposure { frame, announced },
            truth: truth.sun,
        })
    }

    /// The scene that is due, and the start of its exposure.
    fn due_scene(&self) -> Result<(Scene, Timestamp), CameraError> {
        let since_start = self.ahead + self.pace.due();
        let middle = since_start + self.scenes.exposure / 2;
        let at = |since: Duration| -> Result<Timestamp, jiff::Error> {
            self.start.checked_add(SignedDuration::try_from(since)?)
        };
        let mut scene = self.scenes.scene(self.number, middle)?;
        scene.info.mid_exposure = Some(at(middle)?);
        scene.info.monotonic = Some(middle);
        Ok((scene, at(since_start)?))
    }
}

impl FrameSource for SimulatedCamera {
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
        let number = self.number;
        self.number += 1;
        self.pace.advance(self.period);
        let Drawn { exposure, truth } = drawn?;
        starts(exposure.announced);
        std::thread::sleep(self.scenes.exposure);
        self.truth.note(number, truth);
        Ok(Take::Exposure(Box::new(exposure)))
    }

    fn apply(&mut self, settings: &Settings) -> Result<(), CameraError> {
        self.period = settings.period();
        self.scenes.exposure = settings.exposure();
        self.scenes.template.depth = match settings.pixel_format {
            PixelFormat::Mono8 => Depth::Eight,
            PixelFormat::Mono12 => Depth::Twelve,
        };
        self.region = settings.region;
        self.drawn = None;
        Ok(())
    }

    fn frames_wait(&self) -> bool {
        true
    }
}

fn read_out(frame: Frame, region: Region) -> Result<Frame, CameraError> {
    let (width, height) = (frame.width(), frame.height());
    frame.cropped(region).ok_or_else(|| CameraError::Setting {
        setting: "region_px",
        expected: format!("a part of the sensor's {width} x {height} px"),
        found: region.to_string(),
    })
}
