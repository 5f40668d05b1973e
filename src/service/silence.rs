//! Detects a camera that gives no frames: a dead one may hold its thread in a call of the driver, so the watch checks from outside.

use super::shared::Shared;
use crate::camera::CameraSettings;
use std::time::{Duration, Instant};

/// A camera whose last frame is not older than this is not silent.
const LEAST: Duration = Duration::from_millis(500);
/// Time for a camera to be found and opened, from the start of the flight.
const OPENING: Duration = Duration::from_secs(5);
/// Time for a camera to take a command: the longest that `FrameSource::apply` may take.
const SETTING: Duration = Duration::from_secs(2);

/// Time without frames from a camera that should deliver them.
#[derive(Debug, Clone, Default, PartialEq)]
pub(super) struct Silence {
    /// Time from which the next frame is overdue: the last frame, or when the camera should be ready; `None` if no frame is
    /// expected.
    since: Option<Instant>,
    /// Gap between frames beyond which the camera is silent.
    limit: Duration,
    /// Whether the present gap is counted already.
    is_silent: bool,
    count: u64,
    /// Total duration of the silences that have ended.
    ended: Duration,
}

/// Log entries of a silence.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Change {
    /// The n-th silence has begun, and the time without a frame.
    Silent(u64, Duration),
    /// Frames have come again after the n-th silence, and its duration.
    Resumed(u64, Duration),
}

impl Silence {
    /// The camera should give frames with these settings from now on. A silence that another thread left goes on.
    pub fn begin(&mut self, now: Instant, settings: &CameraSettings) {
        self.expect(settings);
        self.since.get_or_insert(now + OPENING);
    }

    /// The settings with which the next frames are taken.
    pub fn expect(&mut self, settings: &CameraSettings) {
        let exposure = settings.exposure();
        self.limit = LEAST.max(3 * settings.period().max(exposure) + exposure);
    }

    /// A command is being carried out: frames may pause for that.
    pub fn expect_pause(&mut self, now: Instant) {
        if !self.is_silent {
            self.since = self.since.map(|since| since.max(now + SETTING));
        }
    }

    /// A frame has come.
    pub fn frame(&mut self, now: Instant) -> Option<Change> {
        self.check(now);
        let back = self.is_silent.then(|| {
            let lasted = self.present(now);
            self.ended += lasted;
            Change::Resumed(self.count, lasted)
        });
        self.is_silent = false;
        self.since = Some(now);
        back
    }

    /// No more frames are expected.
    pub fn end(&mut self, now: Instant) {
        if self.is_silent {
            self.ended += self.present(now);
        }
        self.is_silent = false;
        self.since = None;
    }

    /// Notices a silence.
    pub fn check(&mut self, now: Instant) -> Option<Change> {
        let gap = self.gap(now);
        if self.is_silent || gap <= self.limit {
            return None;
        }
        self.is_silent = true;
        self.count += 1;
        Some(Change::Silent(self.count, gap))
    }

    /// Silences so far, and the time without frames in them, the present one included.
    pub fn total(&self, now: Instant) -> (u64, Duration) {
        (self.count, self.ended + self.present(now))
    }

    fn present(&self, now: Instant) -> Duration {
        if self.is_silent {
            self.gap(now)
        } else {
            Duration::ZERO
        }
    }

    fn gap(&self, now: Instant) -> Duration {
        self.since
            .map_or(Duration::ZERO, |since| now.saturating_duration_since(since))
    }
}

/// Logs a change: the 1st, 2nd, 4th ... silence.
pub(super) fn log(camera: usize, change: Option<Change>) {
    use crate::log::worth_a_line;
    match change {
        Some(Change::Silent(silences, gap)) if worth_a_line(silences) => {
            let for_s = gap.as_secs_f64();
            tracing::error!(camera, silences, for_s, "the camera gives no frames");
        }
        Some(Change::Resumed(silences, lasted)) if worth_a_line(silences) => {
            let after_s = lasted.as_secs_f64();
            tracing::warn!(camera, silences, after_s, "the camera gives frames again");
        }
        _ => {}
    }
}

/// Checks all cameras, and logs the ones that have fallen silent.
pub(super) fn check<'s>(silences: impl Iterator<Item = &'s Shared<Silence>>) {
    for (index, silence) in silences.enumerate() {
        let change = silence.lock().check(Instant::now());
        log(index + 1, change);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at_26_hz() -> CameraSettings {
        CameraSettings {
            rate_hz: 26.0,
            ..CameraSettings::default()
        }
    }

    /// A clock in milliseconds, and a silence that began at 0.
    fn begun(settings: &CameraSettings) -> (impl Fn(u64) -> Instant + use<>, Silence) {
        let start = Instant::now();
        let mut silence = Silence::default();
        silence.begin(start, settings);
        (move |ms| start + Duration::from_millis(ms), silence)
    }

    #[test]
    fn a_camera_that_gives_no_frames_is_silent_within_a_second() {
        let (at, mut silence) = begun(&at_26_hz());
        assert_eq!(silence.frame(at(100)), None);
        assert_eq!(silence.frame(at(138)), None);
        assert_eq!(silence.check(at(638)), None);
        let gap = Duration::from_millis(501);
        assert_eq!(silence.check(at(639)), Some(Change::Silent(1, gap)));
        // It grows while it lasts, and is reported once.
        assert_eq!(silence.check(at(5138)), None);
        assert_eq!(silence.total(at(5138)), (1, Duration::from_secs(5)));
        let lasted = Duration::from_secs(6);
        assert_eq!(silence.frame(at(6138)), Some(Change::Resumed(1, lasted)));
        assert_eq!(silence.frame(at(6176)), None);
        assert_eq!(silence.total(at(6300)), (1, lasted));
        silence.check(at(7176));
        silence.end(at(8176));
        let total = (2, Duration::from_secs(8));
        assert_eq!(silence.check(at(60_000)), None);
        assert_eq!(silence.total(at(60_000)), total);
    }

    #[test]
    fn a_slow_camera_is_given_three_of_its_periods() {
        let slow = CameraSettings {
            rate_hz: 0.05,
            exposure_us: 1_000_000,
            ..CameraSettings::default()
        };
        let (at, mut silence) = begun(&slow);
        silence.frame(at(0));
        assert_eq!(silence.check(at(61_000)), None);
        assert!(silence.check(at(61_001)).is_some());
    }

    #[test]
    fn a_camera_may_take_its_time_to_open_and_to_be_set_but_not_for_ever() {
        let (at, mut silence) = begun(&at_26_hz());
        assert_eq!(silence.check(at(5_500)), None);
        silence.frame(at(5_500));
        silence.expect_pause(at(5_520));
        assert_eq!(silence.check(at(8_020)), None);
        assert!(silence.check(at(8_021)).is_some());
        // A camera that was never there; another thread that tries again does not restart the count.
        let (at, mut silence) = begun(&at_26_hz());
        assert!(silence.check(at(5_501)).is_some());
        silence.begin(at(9_000), &at_26_hz());
        silence.expect_pause(at(9_000));
        assert_eq!(silence.total(at(10_000)), (1, Duration::from_secs(5)));
    }
}
