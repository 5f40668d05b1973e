//! The simulator as a camera: an exposure takes as long as with a real camera.

use super::pace::Pace;
use super::{CameraError, CameraSettings, Exposure, FrameSource, PixelFormat, Take};
use crate::frame::{Frame, Region};
use crate::simulate::earth::SwingingGondola;
use crate::simulate::moon::FollowedMoon;
use crate::simulate::{Depth, FlightScenes, Picture, SceneError, TruthOfSun};
use jiff::{SignedDuration, Timestamp};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

/// The exposure at which limb and Moon have the simulator's standard brightness.
const DEFAULT_EXPOSURE: Duration = Duration::from_millis(15);

/// The truth of all frames so far, by their numbers. It stays with the simulator; the solver never reads it.
#[derive(Debug, Clone, Default)]
pub struct TruthLog(Arc<Mutex<BTreeMap<u64, Option<TruthOfSun>>>>);

impl TruthLog {
    fn note(&self, number: u64, truth: Option<TruthOfSun>) {
        let mut log = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        log.insert(number, truth);
    }

    /// Position of the Sun in a frame: outer `None` for a frame that was never taken, inner for one without Sun.
    pub fn of(&self, number: u64) -> Option<Option<TruthOfSun>> {
        let log = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        log.get(&number).copied()
    }
}

/// Scene in front of a simulated camera.
pub enum View {
    /// The Sun on the plate.
    Plate(Box<FlightScenes>),
    /// The Earth's limb from a swinging gondola.
    Horizon(Box<SwingingGondola>),
    Moon(Box<FollowedMoon>),
}

impl View {
    /// The frame with a number, with its mid-exposure at a time of the flight.
    fn draw(
        &mut self,
        number: u64,
        at: &Moment,
        settings: &CameraSettings,
    ) -> Result<Drawn, CameraError> {
        let brightness = settings.exposure().as_secs_f64() / DEFAULT_EXPOSURE.as_secs_f64();
        let sky = |frame: Result<Frame, _>| -> Result<Drawn, CameraError> {
            let frame = frame.map_err(SceneError::from)?;
            Ok(Drawn { frame, truth: None })
        };
        let mut drawn = match self {
            Self::Plate(scenes) => {
                scenes.exposure = settings.exposure();
                scenes.template.depth = match settings.pixel_format {
                    PixelFormat::Mono8 => Depth::Eight,
                    PixelFormat::Mono10 => Depth::Ten,
                    PixelFormat::Mono12 => Depth::Twelve,
                    PixelFormat::Mono16 => Depth::Sixteen,
                };
                let Picture { frame, truth } = scenes.scene(number, at.since_start)?.picture()?;
                let frame = match settings.region {
                    Some(region) => read_out(frame, region)?,
                    None => frame,
                };
                let truth = truth.sun;
                Drawn { frame, truth }
            }
            Self::Horizon(gondola) => {
                sky(gondola.scene(number, at.since_start, brightness).frame())?
            }
            Self::Moon(moon) => sky(moon.scene(number, at.utc, brightness)?.frame())?,
        };
        let info = &mut drawn.frame.info;
        info.mid_exposure = Some(at.utc);
        info.monotonic = Some(at.since_start);
        info.exposure = Some(settings.exposure());
        Ok(drawn)
    }
}

/// The middle of an exposure.
struct Moment {
    since_start: Duration,
    utc: Timestamp,
}

/// A frame, and the truth about it.
struct Drawn {
    frame: Frame,
    truth: Option<TruthOfSun>,
}

/// A camera in a simulated flight, with its own rate and a clock with a given start.
pub struct SimulatedCamera {
    view: View,
    settings: CameraSettings,
    pace: Pace,
    start: Timestamp,
    /// Time of the flight at the first frame.
    ahead: Duration,
    /// Length of the whole run; `None` without end.
    duration: Option<Duration>,
    number: u64,
    truth: TruthLog,
    /// The next exposure and its announced time, rendered in advance: a camera's frame is available when its exposure ends, however long the
    /// rendering takes.
    drawn: Option<Result<(Drawn, Timestamp), CameraError>>,
}

impl SimulatedCamera {
    /// A flight from `start` on, for `duration` or without end.
    pub fn new(
        view: View,
        settings: &CameraSettings,
        start: Timestamp,
        duration: Option<Duration>,
    ) -> Self {
        Self {
            view,
            settings: settings.clone(),
            pace: Pace::default(),
            start,
            ahead: Duration::ZERO,
            duration,
            number: 0,
            truth: TruthLog::default(),
            drawn: None,
        }
    }

    /// The same, beginning at this time of the flight.
    pub fn ahead_by(self, ahead: Duration) -> Self {
        Self { ahead, ..self }
    }

    /// The truth of the frames of a plate that this camera takes.
    pub fn truth(&self) -> TruthLog {
        self.truth.clone()
    }

    /// Whether the run is complete; its number of frames is rounded to the nearest.
    fn is_over(&self) -> bool {
        let middle = self.pace.due() + self.settings.period() / 2;
        self.duration.is_some_and(|duration| middle > duration)
    }

    /// The frame that is due, and the start of its exposure.
    fn draw(&mut self) -> Result<(Drawn, Timestamp), CameraError> {
        let begin = self.ahead + self.pace.due();
        let since_start = begin + self.settings.exposure() / 2;
        let at = |since: Duration| -> Result<Timestamp, jiff::Error> {
            self.start.checked_add(SignedDuration::try_from(since)?)
        };
        let (announced, utc) = (at(begin)?, at(since_start)?);
        let middle = Moment { since_start, utc };
        let drawn = self.view.draw(self.number, &middle, &self.settings)?;
        Ok((drawn, announced))
    }
}

impl FrameSource for SimulatedCamera {
    fn next(&mut self, starts: &mut dyn FnMut(Timestamp)) -> Result<Take, CameraError> {
        if self.is_over() {
            return Ok(Take::End);
        }
        self.pace.start();
        let drawn = self.drawn.take().unwrap_or_else(|| self.draw());
        if !self.pace.is_due() {
            self.drawn = Some(drawn);
            return Ok(Take::NotYet);
        }
        let number = self.number;
        self.number += 1;
        self.pace.advance(self.settings.period());
        let (Drawn { frame, truth }, announced) = drawn?;
        starts(announced);
        std::thread::sleep(self.settings.exposure());
        if let View::Plate(_) = self.view {
            self.truth.note(number, truth);
        }
        Ok(Take::Exposure(Box::new(Exposure { frame, announced })))
    }

    fn apply(&mut self, settings: &CameraSettings) -> Result<(), CameraError> {
        self.settings = settings.clone();
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
