//! A camera's thread: it sets the camera, announces each exposure on the line, and hands the frame to the solver.

use super::flight::CameraFactory;
use super::messages::{LatestBrightness, LinkEvent, Station, UnsolvedFrame};
use super::shared::Shared;
use super::silence::{self, Silence};
use super::tally::CameraTally;
use super::worker::Heartbeat;
use crate::backoff::Backoff;
use crate::camera::{
    AutoExposure, AutoExposureSettings, CameraError, CameraSettings, FrameSource, Take,
};
use crate::commands::controls::{Controls, Topic};
use crate::frame::FrameInfo;
use crate::link::{self, Counters};
use crate::log::worth_a_line;
use crossbeam_channel::{Sender, TrySendError};
use jiff::{SignedDuration, Timestamp};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

/// Pause after a failure before the camera is asked again.
const PAUSE: Duration = Duration::from_millis(10);
/// How long frames that can wait are held for the solver: longer than the replacement of a solver that hangs takes.
const HOLD: Duration = Duration::from_secs(10);
/// Largest change of UTC against the monotonic clock from one frame to the next; a larger one is a step. A clock that is
/// being slewed gains 0.5 ms/s.
const STEP: SignedDuration = SignedDuration::from_millis(20);

#[derive(Clone)]
pub(super) struct CameraThread {
    pub station: Arc<Station>,
    pub controls: Controls,
    pub to_solver: Sender<UnsolvedFrame>,
    pub to_line: Sender<LinkEvent>,
    pub brightness: LatestBrightness,
    pub tally: Shared<CameraTally>,
    pub counters: Arc<Counters>,
    pub silence: Shared<Silence>,
    pub stop: Arc<AtomicBool>,
}

impl CameraThread {
    /// Takes frames until the source ends or the flight does. Without a source it opens one.
    pub fn run(
        self,
        source: Option<Box<dyn FrameSource>>,
        open: Option<CameraFactory>,
        heartbeat: &Heartbeat,
    ) {
        self.take_frames(source, open, heartbeat);
        // A thread that was replaced leaves the silence to its successor.
        if !heartbeat.is_replaced() {
            self.silence.lock().end(Instant::now());
        }
    }

    fn take_frames(
        &self,
        source: Option<Box<dyn FrameSource>>,
        open: Option<CameraFactory>,
        heartbeat: &Heartbeat,
    ) {
        let settings = self.controls.camera(&self.station.camera).settings();
        self.silence.lock().begin(Instant::now(), &settings);
        let Some(mut source) = source.or_else(|| self.open(open.as_ref()?, heartbeat)) else {
            return;
        };
        let mut commanded = CommandedSettings::new(&self.controls, &self.station);
        let mut clock = ClockWatch::default();
        if !source.falls_silent() {
            self.silence.lock().end(Instant::now());
        }
        while self.is_running(heartbeat) {
            commanded.apply(
                &self.controls,
                &self.station,
                &self.brightness,
                &self.silence,
                source.as_mut(),
            );
            let mut announce = |start| self.announce(start);
            let taken = source.next(&mut announce);
            if heartbeat.is_replaced() {
                return;
            }
            self.tally.lock().health = source.health();
            match taken {
                Ok(Take::Exposure(mut exposure)) => {
                    clock.check(&mut exposure.frame.info, &self.tally);
                    if source.falls_silent() {
                        let change = self.silence.lock().frame(Instant::now());
                        silence::log(self.station.index + 1, change);
                    }
                    if source.frames_wait() {
                        self.wait_for_solver(source.falls_silent(), heartbeat);
                    }
                    self.pass_on(UnsolvedFrame::arrived(*exposure));
                }
                Ok(Take::NotYet) => {}
                Ok(Take::End) => return,
                Err(error) => {
                    self.note_failure(&error);
                    thread::sleep(PAUSE);
                }
            }
        }
    }

    fn is_running(&self, heartbeat: &Heartbeat) -> bool {
        heartbeat.beat();
        !(self.stop.load(Ordering::Relaxed) || heartbeat.is_replaced())
    }

    fn open(&self, open: &CameraFactory, heartbeat: &Heartbeat) -> Option<Box<dyn FrameSource>> {
        let mut waits = Backoff::DEVICE;
        while self.is_running(heartbeat) {
            match open() {
                Ok(source) => return Some(source),
                Err(error) => self.note_failure(&error),
            }
            let next = Instant::now() + waits.wait();
            while Instant::now() < next && self.is_running(heartbeat) {
                thread::sleep(PAUSE);
            }
        }
        None
    }

    fn announce(&self, start: Timestamp) {
        if self.station.camera.sees.plate().is_none() {
            return;
        }
        let camera = self.station.number.into();
        let event = LinkEvent::ExposureStarts(link::Exposure { camera, start });
        if self.to_line.try_send(event).is_err() {
            let mut tally = self.tally.lock();
            tally.unannounced += 1;
            if worth_a_line(tally.unannounced) {
                tracing::warn!("the line is stuck: an exposure was not announced");
            }
        }
    }

    /// Waits until the solver's queue can take a frame: the frames behind it wait, too, and none is lost.
    fn wait_for_solver(&self, falls_silent: bool, heartbeat: &Heartbeat) {
        let until = Instant::now() + HOLD;
        while self.to_solver.is_full() && Instant::now() < until && !heartbeat.is_replaced() {
            heartbeat.beat();
            if falls_silent {
                // The camera does not cause this gap.
                self.silence.lock().frame(Instant::now());
            }
            thread::sleep(PAUSE);
        }
    }

    fn pass_on(&self, frame: UnsolvedFrame) {
        let full = matches!(self.to_solver.try_send(frame), Err(TrySendError::Full(_)));
        self.counters.taken.count();
        if full {
            let mut tally = self.tally.lock();
            tally.lost += 1;
            if worth_a_line(tally.lost) {
                let lost = tally.lost;
                tracing::warn!(lost, "the solver is too slow: a frame was lost");
            }
        }
    }

    fn note_failure(&self, error: &CameraError) {
        let mut tally = self.tally.lock();
        tally.failed += 1;
        if worth_a_line(tally.failed) {
            tracing::error!(%error, failed = tally.failed, "no frame from the camera");
        }
    }
}

/// The camera's settings: the commanded ones, and the automatic exposure if it is on.
struct CommandedSettings {
    version: u64,
    settings: CameraSettings,
    auto: Option<(AutoExposureSettings, AutoExposure)>,
    /// Whether the source has the settings.
    set: bool,
}

impl CommandedSettings {
    fn new(controls: &Controls, station: &Station) -> Self {
        let version = controls.version(Topic::Cameras);
        let camera = controls.camera(&station.camera);
        Self {
            version,
            settings: camera.settings(),
            auto: camera.auto_exposure().map(|s| (s, AutoExposure::new(s))),
            // The source was opened with these.
            set: true,
        }
    }

    fn apply(
        &mut self,
        controls: &Controls,
        station: &Station,
        brightness: &LatestBrightness,
        silence: &Shared<Silence>,
        source: &mut dyn FrameSource,
    ) {
        let version = controls.version(Topic::Cameras);
        if version != self.version {
            self.version = version;
            let camera = controls.camera(&station.camera);
            self.set &= self.settings == camera.settings();
            self.settings = camera.settings();
            if !self.set {
                silence.lock().expect_pause(Instant::now());
            }
            let wanted = camera.auto_exposure();
            if wanted != self.auto.as_ref().map(|auto| auto.0) {
                self.auto = wanted.map(|s| (s, AutoExposure::new(s)));
            }
        }
        if let Some((_, auto)) = &mut self.auto
            && let Some((measured, exposure_us)) = brightness.lock().take()
        {
            let exposure_us = auto.next(measured, exposure_us);
            self.set &= exposure_us == self.settings.exposure_us;
            self.settings.exposure_us = exposure_us;
        }
        if !self.set {
            self.set = true;
            silence.lock().expect(&self.settings);
            if let Err(error) = source.apply(&self.settings) {
                tracing::error!(%error, "the camera did not accept a setting");
            }
        }
    }
}

/// Notices when UTC makes a step against the monotonic clock.
#[derive(Default)]
struct ClockWatch {
    /// UTC at the start of the monotonic clock, by the last frame.
    zero: Option<Timestamp>,
}

impl ClockWatch {
    fn check(&mut self, info: &mut FrameInfo, tally: &Shared<CameraTally>) {
        let zero = info.mid_exposure.zip(info.monotonic);
        let zero = zero
            .and_then(|(utc, since)| utc.checked_sub(SignedDuration::try_from(since).ok()?).ok());
        let (Some(now), Some(then)) = (zero, self.zero) else {
            self.zero = zero.or(self.zero);
            return;
        };
        self.zero = Some(now);
        let step = now.duration_since(then);
        if step.abs() > STEP {
            info.utc_step = Some(step);
            tally.lock().utc_steps += 1;
            let step_s = step.as_secs_f64();
            tracing::warn!(step_s, frame = info.number, "UTC has made a step");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_of_utc_is_noticed_and_reported_with_its_frame() {
        let tally = Shared::default();
        let mut clock = ClockWatch::default();
        let start: Timestamp = "2013-09-21T18:00:00Z".parse().unwrap();
        let mut step = |utc_ms, monotonic_ms| {
            let mut info = FrameInfo {
                mid_exposure: Some(start + SignedDuration::from_millis(utc_ms)),
                monotonic: Some(Duration::from_millis(monotonic_ms)),
                ..FrameInfo::default()
            };
            clock.check(&mut info, &tally);
            info.utc_step.map(|step| step.as_millis())
        };
        assert_eq!([step(0, 5000), step(250, 5250), step(500, 5501)], [None; 3]);
        assert_eq!(step(1750, 5750), Some(1001));
        assert_eq!([step(2000, 6000), step(2250, 6250)], [None; 2]);
        assert_eq!(step(1000, 6500), Some(-1500));
        assert_eq!(tally.lock().utc_steps, 2);
    }
}
