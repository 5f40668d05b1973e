//! A GenICam camera, through Aravis: GigE Vision, USB3 Vision, or Aravis's own fake device.
//!
//! Each frame is triggered by software, so that its time can be announced before the exposure begins. The camera
//! belongs to a thread of its own (`worker`), since calls to a lost camera block for seconds; this side waits
//! 0.25 s at a time. A lost camera is released with its stream and thread and reopened,
//! and every setting is applied again before the first frame: an earlier experiment lost its flight to a camera that came
//! back with its own exposure.

mod configure;
mod frames;
mod numbers;
mod open;
mod opened;
mod worker;

use super::pace::{Pace, TIMEOUT};
use super::{CameraError, CameraHealth, CameraSettings, Device, Exposure, FrameSource, Take};
use crate::backoff::Backoff;
use jiff::Timestamp;
use opened::{Opening, SharedHealth, count};
use std::sync::{Arc, PoisonError};
use std::time::{Duration, Instant};
use worker::{Link, Report};

/// How long a camera may take to open, or to answer an order beyond its exposure, before it is given up.
const HANGS: Duration = Duration::from_secs(15);
/// How long applying settings waits for the camera's answer.
const APPLY: Duration = Duration::from_secs(2);

/// State of the camera, as far as this side knows.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Phase {
    Opening,
    Idle,
    /// Taking the frame that was announced for this time.
    Exposing(Timestamp),
}

/// A camera that is reconnected whenever it is lost.
pub struct GenicamCamera {
    device: Device,
    settings: CameraSettings,
    link: Option<Link>,
    phase: Phase,
    /// Time since which the camera owes an answer.
    waiting: Instant,
    pace: Pace,
    /// Waits between attempts to open it; an attempt takes 2.5 s itself.
    backoff: Backoff,
    due: Instant,
    /// Origin of the monotonic times.
    zero: Instant,
    next_number: u64,
    was_there: bool,
    /// Frames that came while settings were applied.
    early: Option<Report>,
    health: SharedHealth,
}

impl GenicamCamera {
    /// A camera that need not be present yet.
    pub fn new(device: Device, settings: &CameraSettings) -> Self {
        Self {
            device,
            settings: settings.clone(),
            link: None,
            phase: Phase::Opening,
            waiting: Instant::now(),
            pace: Pace::default(),
            backoff: Backoff::DEVICE,
            due: Instant::now(),
            zero: Instant::now(),
            next_number: 0,
            was_there: false,
            early: None,
            health: SharedHealth::default(),
        }
    }

    /// Opens the camera in its thread, if an attempt is due.
    fn open(&mut self) -> Result<Take, CameraError> {
        let wait = self.due.saturating_duration_since(Instant::now());
        if !wait.is_zero() {
            std::thread::sleep(wait.min(TIMEOUT));
            return Ok(Take::NotYet);
        }
        let opening = Opening {
            device: self.device.clone(),
            settings: self.settings.clone(),
            zero: self.zero,
            next_number: self.next_number,
            health: Arc::clone(&self.health),
        };
        let link = Link::open(opening).map_err(|error| self.problem(error))?;
        self.link = Some(link);
        self.await_answer(Phase::Opening);
        Ok(Take::NotYet)
    }

    fn await_answer(&mut self, phase: Phase) {
        self.phase = phase;
        self.waiting = Instant::now();
    }

    fn problem(&self, problem: impl ToString) -> CameraError {
        CameraError::of(&self.device, problem)
    }

    /// Announces and triggers a frame, when one is due.
    fn trigger(&mut self, starts: &mut dyn FnMut(Timestamp)) {
        if !self.pace.is_due() {
            return;
        }
        self.pace.advance_past_now(self.settings.period());
        let announced = Timestamp::now();
        starts(announced);
        if let Some(link) = &self.link {
            link.take_frame();
        }
        self.await_answer(Phase::Exposing(announced));
    }

    fn process(&mut self, report: Report) -> Result<Take, CameraError> {
        match report {
            Report::Ready => {
                if std::mem::replace(&mut self.was_there, true) {
                    count(&self.health, |health| health.reconnects += 1);
                }
                self.backoff.reset();
                self.pace = Pace::default();
                self.phase = Phase::Idle;
                Ok(Take::NotYet)
            }
            Report::Taken(taken) => {
                let Phase::Exposing(announced) = self.phase else {
                    return Ok(Take::NotYet);
                };
                self.phase = Phase::Idle;
                let frame = (*taken)?;
                self.next_number = frame.info.number.map_or(self.next_number, |n| n + 1);
                Ok(Take::Exposure(Box::new(Exposure { frame, announced })))
            }
            // The receiver of the result no longer waits.
            Report::Applied(applied) => applied.map(|()| Take::NotYet),
            Report::Gone(error) => {
                self.give_up();
                Err(error)
            }
        }
    }

    /// Releases the camera with its stream and thread, to be reopened later.
    fn give_up(&mut self) {
        self.link = None;
        self.due = Instant::now() + self.backoff.wait();
    }
}

impl FrameSource for GenicamCamera {
    fn next(&mut self, starts: &mut dyn FnMut(Timestamp)) -> Result<Take, CameraError> {
        if let Some(report) = self.early.take() {
            return self.process(report);
        }
        if self.link.is_none() {
            return self.open();
        }
        if self.phase == Phase::Idle {
            self.trigger(starts);
        }
        let report = self.link.as_ref().and_then(|link| link.report(TIMEOUT));
        match report {
            Some(report) => self.process(report),
            None if self.phase == Phase::Idle => Ok(Take::NotYet),
            None if self.waiting.elapsed() > HANGS + self.settings.exposure() => {
                self.give_up();
                Err(self.problem("it hangs"))
            }
            None => Ok(Take::NotYet),
        }
    }

    /// A camera that is lost, or does not answer in time, gets the settings when it is back.
    fn apply(&mut self, settings: &CameraSettings) -> Result<(), CameraError> {
        self.settings = settings.clone();
        let Some(link) = &self.link else {
            return Ok(());
        };
        if self.phase == Phase::Opening {
            // It is being opened with the previous settings.
            link.apply(settings);
            return Ok(());
        }
        link.apply(settings);
        let begun = Instant::now();
        while let Some(report) = link.report(APPLY.saturating_sub(begun.elapsed())) {
            match report {
                Report::Applied(applied) => return applied,
                other => self.early = Some(other),
            }
        }
        tracing::warn!(camera = %self.device, "the camera has not yet answered");
        Ok(())
    }

    fn health(&self) -> CameraHealth {
        *self.health.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for GenicamCamera {
    /// Releases the camera for the next program, if it answers.
    fn drop(&mut self) {
        if let Some(link) = self.link.take() {
            link.close(Duration::from_millis(500));
        }
    }
}
