//! A folder of files as a camera: it replays their frames in the order of their names, with the intervals at which they were taken.

use super::pace::Pace;
use super::{CameraError, CameraSettings, Exposure, FrameSource, Take, settings};
use crate::fits;
use crate::frame::{Frame, Warnings};
use jiff::{SignedDuration, Timestamp};
use std::collections::VecDeque;
use std::path::{Path, PathBuf};
use std::time::Duration;

/// The longest pause between two frames, so that a gap of a day is not waited for.
const LONGEST_PAUSE: Duration = Duration::from_secs(10);

/// Replays the frames of a folder and of the folders in it.
///
/// A frame follows the one before it by the difference of their times. Frames without times, or out of their order,
/// follow at a constant rate; no pause is longer than 10 s. The speed divides all pauses.
pub struct FolderCamera {
    files: VecDeque<PathBuf>,
    period: Duration,
    speed: f64,
    pace: Pace,
    /// The next frame, read ahead.
    ahead: Option<Frame>,
    /// Mid-exposure of the previous frame.
    before: Option<Timestamp>,
    warnings: Warnings,
}

impl FolderCamera {
    /// Lists the folder's frames. They are replayed `speed` times as fast as they were taken.
    ///
    /// # Errors
    /// If the folder cannot be listed, or holds no frame.
    pub fn open(folder: &Path, rate_hz: f64, speed: f64) -> Result<Self, CameraError> {
        let files = fits::list_tree(folder).map_err(|unlisted| CameraError::Folder {
            folder: folder.into(),
            found: format!("\"{}\"", unlisted.cause),
        })?;
        if files.is_empty() {
            return Err(CameraError::Folder {
                folder: folder.into(),
                found: "no file that ends like one".into(),
            });
        }
        Ok(Self {
            files: files.into(),
            period: settings::period(rate_hz),
            speed,
            pace: Pace::default(),
            ahead: None,
            before: None,
            warnings: Warnings::default(),
        })
    }
}

impl FolderCamera {
    /// Reads the next frame and sets the time at which it is due; `None` at the end.
    fn read_ahead(&mut self) -> Result<Option<Frame>, CameraError> {
        let Some(path) = self.files.pop_front() else {
            return Ok(None);
        };
        let frame = fits::read_frame(&path)?;
        let warnings = &frame.info.warnings;
        self.warnings.note(&path.display().to_string(), warnings);
        let time = frame.info.mid_exposure;
        if self.pace.has_started() {
            let pause = self.pause(time).min(LONGEST_PAUSE);
            self.pace.advance(pause.div_f64(self.speed));
        }
        self.before = time.or(self.before);
        Ok(Some(frame))
    }

    /// The pause from the previous frame to one of this time, divided by the speed.
    fn pause(&self, time: Option<Timestamp>) -> Duration {
        time.zip(self.before)
            .map(|(time, before)| time.duration_since(before))
            .filter(SignedDuration::is_positive)
            .map_or(self.period, SignedDuration::unsigned_abs)
    }
}

impl FrameSource for FolderCamera {
    fn next(&mut self, starts: &mut dyn FnMut(Timestamp)) -> Result<Take, CameraError> {
        if self.ahead.is_none() {
            self.ahead = self.read_ahead()?;
            if self.ahead.is_none() {
                return Ok(Take::End);
            }
        }
        if !self.pace.is_due() {
            return Ok(Take::NotYet);
        }
        let Some(frame) = self.ahead.take() else {
            return Ok(Take::NotYet);
        };
        let announced = frame.info.exposure_start().unwrap_or_else(Timestamp::now);
        starts(announced);
        Ok(Take::Exposure(Box::new(Exposure { frame, announced })))
    }

    /// Applies the rate; the other settings are those with which the frames were taken.
    fn apply(&mut self, settings: &CameraSettings) -> Result<(), CameraError> {
        self.period = settings.period();
        Ok(())
    }

    fn frames_wait(&self) -> bool {
        true
    }
}
