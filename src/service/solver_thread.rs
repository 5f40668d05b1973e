//! A solver's thread: it takes frames, and passes solved frames to the line and to all receivers.

use super::messages::{
    Found, LatestBrightness, LinkEvent, Outcome, ReceivesFrames, Solved, SolvedFrame, Station,
    UnsolvedFrame,
};
use super::shared::Shared;
use super::solvers::Solver;
use super::tally::SolverTally;
use super::worker::Heartbeat;
use crate::commands::controls::Controls;
use crate::instrument::WrongSize;
use crate::link::picture::{Tag, TagValue};
use crate::link::{self, Picture};
use crate::log::worth_a_line;
use crossbeam_channel::{Receiver, RecvTimeoutError, Sender};
use jiff::Timestamp;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use tracing::Level;

/// How long a solver waits for a frame before it shows that it is at work.
const TIMEOUT: Duration = Duration::from_millis(200);

/// Shared state of a solver's thread.
#[derive(Clone)]
pub(super) struct SolverThread {
    pub station: Arc<Station>,
    pub controls: Controls,
    pub frames: Receiver<UnsolvedFrame>,
    pub cameras_ended: Arc<AtomicBool>,
    pub to_line: Sender<LinkEvent>,
    /// Brightness of the frames, for the camera's thread.
    pub brightness: LatestBrightness,
    /// Receivers of the solved frames, in this order.
    pub receivers: Vec<Arc<dyn ReceivesFrames>>,
    pub tally: Shared<SolverTally>,
}

impl SolverThread {
    /// Solves until the camera ends, or another thread has taken over.
    pub fn run(&self, mut solver: Box<dyn Solver>, heartbeat: &Heartbeat) {
        while let Some(mut frame) = self.next(heartbeat) {
            let commanded = self.controls.snapshot();
            let solved = match solver.solve(&mut frame, &commanded) {
                Ok(solved) => solved,
                Err(wrong) => {
                    self.note_misfit(&wrong);
                    continue;
                }
            };
            if heartbeat.is_replaced() {
                return;
            }
            solver.share(&frame, &solved);
            self.note(&frame, &solved, solver.as_ref());
            let arrived = frame.arrived;
            let solved_frame = SolvedFrame {
                station: Arc::clone(&self.station),
                exposure: Arc::new(frame.exposure),
                solved: Arc::new(solved),
                target: commanded.target,
                to_be_stored: self.controls.stores(self.station.camera.role),
            };
            self.pass_on(&solved_frame, arrived);
        }
    }

    /// The next frame to be solved; `None` when the camera has ended, or another thread has taken over.
    fn next(&self, heartbeat: &Heartbeat) -> Option<UnsolvedFrame> {
        while !heartbeat.is_replaced() {
            heartbeat.beat();
            match self.frames.recv_timeout(TIMEOUT) {
                Ok(frame) => return Some(frame),
                Err(_) if self.cameras_ended.load(Ordering::Relaxed) => return None,
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return None,
            }
        }
        None
    }

    fn note_misfit(&self, wrong: &WrongSize) {
        let mut tally = self.tally.lock();
        tally.misfits += 1;
        if worth_a_line(tally.misfits) {
            let (camera, misfits) = (self.station.number, tally.misfits);
            tracing::error!(camera, error = %wrong, misfits, "not this camera's frame");
        }
    }

    fn note(&self, frame: &UnsolvedFrame, solved: &Solved, solver: &dyn Solver) {
        let (camera, number) = (self.station.number, frame.exposure.frame.info.number);
        let (quality, solve_us) = (solved.quality.name(), solved.solve_time.as_micros() as u64);
        tracing::debug!(camera, number, quality, solve_us, "solved");
        let mut tally = self.tally.lock();
        if !matches!(solved.found, Found::Nothing) {
            *tally.solved.entry(solved.quality).or_default() += 1;
        }
        let Some(stopped) = &solved.stopped else {
            return;
        };
        let reason = (stopped.stage, stopped.rejected.reason);
        let frames = tally.reasons.entry(reason).or_default();
        *frames += 1;
        let frames = *frames;
        drop(tally);
        let Some((level, words)) = solver.log_entry(solved).filter(|_| worth_a_line(frames)) else {
            return;
        };
        let (measured, limit) = (stopped.rejected.measured, stopped.rejected.limit);
        match level {
            Level::INFO => {
                tracing::info!(camera, reason = %stopped, measured, limit, frames, "{words}");
            }
            _ => tracing::warn!(camera, reason = %stopped, measured, limit, frames, "{words}"),
        }
    }

    /// The line comes first: a solution does not wait for a disk.
    fn pass_on(&self, frame: &SolvedFrame, arrived: Instant) {
        self.send_to_line(frame, arrived);
        if self.controls.takes_picture(self.station.camera.role) {
            self.send_picture(frame);
        }
        if let Some(exposure) = frame.exposure.frame.info.exposure {
            let exposure_us = exposure.as_micros() as u32;
            *self.brightness.lock() = Some((frame.solved.brightness, exposure_us));
        }
        for receiver in &self.receivers {
            receiver.receive(frame);
        }
    }

    /// Sends the results of frames of the plate to the controller.
    fn send_to_line(&self, frame: &SolvedFrame, arrived: Instant) {
        let Found::Sun(sun) = &frame.solved.found else {
            return;
        };
        let outcome = Outcome {
            exposure: link::Exposure {
                camera: self.station.number.into(),
                start: frame.exposure.announced,
            },
            arrived,
            exposure_time: frame.exposure.frame.info.exposure,
            offset: sun.offset,
            roll: frame.solved.roll,
            stopped: sun.solution.stopped,
        };
        let event = LinkEvent::Outcome(Box::new(outcome));
        if self.to_line.try_send(event).is_err() {
            let mut tally = self.tally.lock();
            tally.unsent += 1;
            if worth_a_line(tally.unsent) {
                let unsent = tally.unsent;
                tracing::warn!(unsent, "the line is stuck: a solution was not sent");
            }
        }
    }

    /// Sends the pictures that the ground has requested.
    fn send_picture(&self, solved: &SolvedFrame) {
        let frame = &solved.exposure.frame;
        let time = frame.info.mid_exposure.unwrap_or_else(Timestamp::now);
        match Picture::new(frame, self.station.number, self.tags(solved), time) {
            Ok(Some(picture)) => {
                // A line that is stuck carries no pictures.
                let _ = self.to_line.try_send(LinkEvent::Picture(Box::new(picture)));
            }
            Ok(None) => tracing::warn!("the frame is too large for a picture"),
            Err(error) => tracing::warn!(%error, "no picture"),
        }
    }

    /// Facts of a picture.
    fn tags(&self, frame: &SolvedFrame) -> Vec<Tag> {
        let tag = |name: &str, value, comment: &str| Tag {
            name: name.into(),
            value,
            comment: comment.into(),
        };
        let info = &frame.exposure.frame.info;
        let instrument = TagValue::Text(self.station.camera.label.clone());
        let mut tags = vec![tag("INSTRUME", instrument, "instrument")];
        if let Some(exposure) = info.exposure {
            let seconds = TagValue::Number(exposure.as_secs_f64());
            tags.push(tag("EXPTIME", seconds, "exposure, s"));
        }
        if let Some(camera) = &info.camera {
            tags.push(tag("CAMERA", TagValue::Text(camera.clone()), "camera"));
        }
        if let Some(number) = info.number {
            let number = TagValue::Whole(number as i32);
            tags.push(tag("FRAMENUM", number, "number of the frame"));
        }
        tags
    }
}
