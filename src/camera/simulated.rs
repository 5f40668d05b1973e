//! The simulator as a camera: it takes its time over every exposure, as a camera does.

use super::pace::Pace;
use super::{CameraError, Exposure, FrameSource};
use crate::simulate::{EXPOSURE, FlightScenes, Picture, TruthOfSun};
use jiff::{SignedDuration, Timestamp};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

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
    pace: Pace,
    start: Timestamp,
    /// Frames of the whole run; `None` without end.
    frames: Option<u64>,
    number: u64,
    truth: TruthLog,
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
            pace: Pace::new(rate_hz),
            start,
            frames: duration.map(|duration| (duration.as_secs_f64() * rate_hz).round() as u64),
            number: 0,
            truth: TruthLog::default(),
        }
    }

    /// The truth of the frames that this camera takes.
    pub fn truth(&self) -> TruthLog {
        self.truth.clone()
    }
}

impl FrameSource for SimulatedCamera {
    fn next(&mut self, starts: &mut dyn FnMut(Timestamp)) -> Result<Option<Exposure>, CameraError> {
        let number = self.number;
        if self.frames.is_some_and(|frames| number >= frames) {
            return Ok(None);
        }
        self.number += 1;
        let since_start = self.pace.next_due();
        let middle = since_start + EXPOSURE / 2;
        let announced = self
            .start
            .checked_add(SignedDuration::try_from(since_start)?)?;
        let mut scene = self.scenes.scene(number, middle)?;
        scene.info.mid_exposure = Some(self.start.checked_add(SignedDuration::try_from(middle)?)?);
        scene.info.monotonic = Some(middle);
        self.pace.wait();
        starts(announced);
        let shutter = Instant::now();
        let Picture { frame, truth } = scene.picture()?;
        self.truth.note(number, truth.sun);
        std::thread::sleep(EXPOSURE.saturating_sub(shutter.elapsed()));
        Ok(Some(Exposure { frame, announced }))
    }
}
