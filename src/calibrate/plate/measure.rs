//! Observations from files: each frame is read and solved; only its marks are kept.

use super::lit::{by_lamp, lit_levels};
use super::observation::{FrameObservation, MarkObservation};
use super::refusal::Refusal;
use crate::aspect::{self, Adopted, Expected};
use crate::calibrate::frames::{Setting, check_settings};
use crate::frame::Frame;
use crate::instrument::{Instrument, WrongSize};
use crate::observe::{InputError, RejectedFrame, Watch, each_frame};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Results of all frames.
#[derive(Debug, Clone, Default)]
pub(super) struct Observations {
    pub frames: Vec<FrameObservation>,
    pub rejected: Vec<RejectedFrame>,
    /// Facts of every file that could be read.
    pub files: Vec<FileFacts>,
}

/// Facts of a file, whatever its frame contains.
#[derive(Debug, Clone)]
pub(super) struct FileFacts {
    pub file: PathBuf,
    setting: Setting,
    wrong_size: Option<WrongSize>,
    has_time: bool,
}

/// Reads and solves all frames, each once; copies of other frames are listed separately.
///
/// # Errors
/// [`InputError::Cancelled`].
pub(super) fn measure(
    files: Vec<PathBuf>,
    instrument: &Instrument,
    watch: &dyn Watch,
) -> Result<(Observations, Vec<RejectedFrame>), InputError> {
    let observed = each_frame(files, instrument.camera.size_px(), watch, |file, frame| {
        read(file, &frame, instrument)
    })?;
    let mut observations = Observations::default();
    for (file, outcome) in observed.frames {
        let frame = outcome.and_then(|(facts, marks)| {
            observations.files.push(facts);
            marks
        });
        match frame {
            Ok(frame) => observations.frames.push(frame),
            Err(reason) => observations.rejected.push(RejectedFrame::new(file, reason)),
        }
    }
    Ok((observations, observed.copies))
}

/// Facts of a file, and its marks or the reason why there are none.
pub(super) fn read(
    file: &Path,
    frame: &Frame,
    instrument: &Instrument,
) -> (FileFacts, Result<FrameObservation, String>) {
    let wrong_size = instrument.check_size(frame).err();
    let marks = match (&wrong_size, lit_levels(frame)) {
        (Some(wrong), _) => Err(wrong.to_string()),
        (None, Some(levels)) => by_lamp(file, frame, &levels, instrument),
        (None, None) => by_sun(file, frame, instrument),
    };
    let facts = FileFacts {
        file: file.into(),
        setting: Setting::of(file, frame).with_size(frame),
        wrong_size,
        has_time: frame.info.mid_exposure.is_some(),
    };
    (facts, marks)
}

/// The marks of a frame of the Sun, including those cut by the limb: their positions were fitted to their own pixels with the limb's
/// illumination.
fn by_sun(file: &Path, frame: &Frame, instrument: &Instrument) -> Result<FrameObservation, String> {
    /// Fewest marks of a usable frame.
    const LEAST_MARKS: usize = 3;
    let Some(utc) = frame.info.mid_exposure else {
        return Err("no time: expected DATE-OBS or DATE-AVG in a frame of the Sun".into());
    };
    let solution = aspect::solve(frame, instrument, Expected::at(utc), None);
    let own = solution.mapping.as_ref().and_then(Adopted::own);
    let (Some(own), Some(aspect)) = (own, &solution.aspect) else {
        let stopped = solution.stopped.as_ref().map(ToString::to_string);
        return Err(stopped.unwrap_or("no mapping of its own".into()));
    };
    let count = solution.marks.len();
    if count < LEAST_MARKS {
        return Err(format!("{count} marks, expected {LEAST_MARKS}"));
    }
    let mark = |mark: &aspect::Mark| MarkObservation {
        id: mark.id,
        at: mark.at,
        covariance_px2: mark.covariance_px2,
    };
    Ok(FrameObservation {
        file: file.into(),
        utc: Some(utc),
        mapping: own.mapping,
        sun: Some(aspect.sun_plate.position),
        marks: solution.marks.iter().map(mark).collect(),
    })
}

impl Observations {
    /// The camera's name stated in the frames.
    pub(super) fn camera(&self) -> Option<String> {
        self.files.iter().find_map(|facts| facts.setting.camera())
    }

    /// Refuses files of several cameras, sizes or depths, of another instrument's size, or without any time.
    pub(super) fn check_files(&self, instrument: &Instrument) -> Result<(), Refusal> {
        check_settings(self.files.iter().map(|facts| &facts.setting), instrument)?;
        for FileFacts {
            file, wrong_size, ..
        } in &self.files
        {
            if let Some(wrong) = wrong_size.clone() {
                let file = file.clone();
                return Err(Refusal::WrongSize { file, wrong });
            }
        }
        let frames = self.files.len();
        let timeless = frames > 0 && self.files.iter().all(|facts| !facts.has_time);
        match self.frames.is_empty() && timeless {
            true => Err(Refusal::NoTime { frames }),
            false => Ok(()),
        }
    }

    /// Refuses frames that show too little of the plate.
    pub(super) fn check_coverage(&self, instrument: &Instrument) -> Result<(), Refusal> {
        /// Fewest marks observed more than once for a calibration.
        const LEAST_MARKS: usize = 12;
        let frames = self.frames.len();
        let Some(first) = self.frames.first() else {
            let first = self.rejected.first().map(ToString::to_string);
            return Err(Refusal::NothingRead {
                frames: self.rejected.len(),
                first: first.unwrap_or_default(),
            });
        };
        let suns: Option<Vec<_>> = self.frames.iter().map(|frame| frame.sun).collect();
        // A frame of the illuminated plate shows all marks at once.
        let (Some(suns), Some(first)) = (suns, first.sun) else {
            return Ok(());
        };
        let from_first = suns.iter().map(|sun| sun.distance(first));
        let reach_mil = from_first.fold(0.0, f64::max);
        if frames > 1 && reach_mil < instrument.optics.radius_mil(960.0) {
            return Err(Refusal::OnePlace { frames, reach_mil });
        }
        let mut times: BTreeMap<_, usize> = BTreeMap::new();
        for mark in self.frames.iter().flat_map(|frame| &frame.marks) {
            *times.entry(mark.id).or_default() += 1;
        }
        let again = times.values().filter(|times| **times > 1).count();
        match again < LEAST_MARKS {
            true => Err(Refusal::TooFewMarks {
                frames,
                marks: times.len(),
                again,
                limit: LEAST_MARKS,
            }),
            false => Ok(()),
        }
    }
}
