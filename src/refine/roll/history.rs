//! The body's roll and pitch over the flight.

use super::super::flags::FrameFlag;
use super::super::path::UNUSUAL_PATH_CHI2;
use super::super::record::Grade;
use super::super::timeline::{Content, Entry, Timeline};
use super::path::{RollPath, RollSample, changing};
use super::row::{RollRow, SmoothedRoll};
use super::{HorizonRecord, RollRecipe};
use crate::geometry::attitude::Direction;
use crate::observe::{CameraFrames, InputSummary, JournalError, Recorded, Span};
use crate::pointing::body_nadir;
use crate::units::Measured;

/// The body's roll and pitch over the flight. Rows are assembled on request: the results of the frames stay in the journal.
#[derive(Debug)]
pub struct RollHistory {
    timeline: Timeline<HorizonRecord>,
    /// Smoothed roll and pitch at each dated frame.
    smoothed: Vec<Option<SmoothedRoll>>,
    /// The coarse frames that lie off the path of the fine ones, in order.
    off: Vec<usize>,
    path: Option<RollPath>,
    /// Part of the stated sigmas that changes between frames, of roll and pitch. The rest comes from the limb's own shape and the camera's
    /// height, and is common to neighbours.
    pub changing: [f64; 2],
}

impl RollHistory {
    /// Makes the history of all frames, after a pass has observed each of them.
    ///
    /// # Errors
    /// If a journal cannot be read.
    pub fn new(
        done: Recorded<HorizonRecord>,
        camera: CameraFrames,
        recipe: &RollRecipe,
        span: &Span,
    ) -> Result<Self, JournalError> {
        let timeline = Timeline::new(done, camera, span)?;
        let mut used = Vec::new();
        let read = |n: usize| Ok(timeline.frame(n)?.map(|record| (n, record)));
        timeline.each(timeline.dated(), read, |frame| {
            used.extend(frame.and_then(|(n, record)| RollSample::of(&timeline, n, &record)));
        })?;
        let changing = changing(&used);
        let max_age_s = recipe.settings.max_age_s;
        let path = |used: Vec<RollSample>| RollPath::through(used, changing, max_age_s);
        let fine: Vec<RollSample> = used
            .iter()
            .filter(|s| s.quality == Grade::Fine)
            .copied()
            .collect();
        let off = match fine.len() == used.len() {
            true => Vec::new(),
            false => off_path(path(fine).as_ref(), &used),
        };
        used.retain(|one| off.binary_search(&one.frame).is_err());
        let path = path(used);
        let times_s = (0..timeline.dated()).filter_map(|n| timeline.unix_s(n));
        Ok(Self {
            smoothed: smoothed(path.as_ref(), &times_s.collect::<Vec<f64>>()),
            timeline,
            off,
            path,
            changing,
        })
    }

    /// Number of files.
    pub fn len(&self) -> usize {
        self.timeline.len()
    }

    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Inputs that were not used as they stand.
    pub fn inputs(&self) -> &InputSummary {
        &self.timeline.inputs
    }

    /// A row for each file, in the order of time; frames without a time and files that could not be read come last, by name.
    pub fn rows(&self) -> impl Iterator<Item = Result<RollRow, JournalError>> {
        (0..self.len()).map(|n| self.row(n))
    }

    fn row(&self, n: usize) -> Result<RollRow, JournalError> {
        let Entry { file, data } = self.timeline.entry(n)?;
        let (own, copy_of, reason) = match data {
            Content::None { error, copy_of } => (None, copy_of, format!("file: {error}")),
            Content::Frame(own) => {
                let reason = own.facts.reason(own.reason.as_deref());
                (Some(*own), None, reason)
            }
        };
        let is_off = self.off.binary_search(&n).is_ok();
        Ok(RollRow {
            file,
            copy_of,
            utc_ns: self.timeline.utc_ns(n),
            timing: self.timeline.timing(n),
            quality: match &own {
                Some(own) if !is_off => own.quality,
                _ => Grade::None,
            },
            reason: match is_off {
                true => format!("refine: {}", FrameFlag::Path),
                false => reason,
            },
            nadir: match &own {
                Some(own) if !is_off => own.nadir.map(|nadir| nadir.direction()),
                _ => None,
            },
            own,
            smoothed: self.smoothed.get(n).copied().flatten(),
        })
    }

    /// Roll and pitch of the body at times, s since 1970 and in order; `None` where no frame is near.
    pub fn at(&self, times_s: &[f64]) -> Vec<Option<SmoothedRoll>> {
        smoothed(self.path.as_ref(), times_s)
    }

    /// The nadir in the body's axes at such times.
    pub fn body_nadirs(&self, times_s: &[f64]) -> Vec<Option<Direction>> {
        let nadir = |s: SmoothedRoll| body_nadir(s.roll_deg, s.pitch_deg);
        let smoothed = self.at(times_s).into_iter();
        smoothed.map(|smoothed| smoothed.map(nadir)).collect()
    }
}

/// Roll and pitch of the body at times, s since 1970 and in order.
fn smoothed(path: Option<&RollPath>, times_s: &[f64]) -> Vec<Option<SmoothedRoll>> {
    path.map_or_else(|| vec![None; times_s.len()], |path| path.at(times_s))
}

/// The coarse frames that lie off the path of the fine ones.
fn off_path(by_fine: Option<&RollPath>, used: &[RollSample]) -> Vec<usize> {
    let coarse: Vec<&RollSample> = used.iter().filter(|s| s.quality == Grade::Coarse).collect();
    let times_s: Vec<f64> = coarse.iter().map(|one| one.time_s).collect();
    let expected = smoothed(by_fine, &times_s).into_iter();
    let is_off = |(one, expected): (&RollSample, Option<SmoothedRoll>)| {
        let chi2 = |found: Measured, expected: Measured| {
            let sigma = found.sigma.hypot(expected.sigma);
            ((found.value - expected.value) / sigma).powi(2)
        };
        let ([roll, pitch], expected) = (one.angles_deg, expected?);
        let off =
            chi2(roll, expected.roll_deg) + chi2(pitch, expected.pitch_deg) > UNUSUAL_PATH_CHI2;
        off.then_some(one.frame)
    };
    coarse
        .into_iter()
        .zip(expected)
        .filter_map(is_off)
        .collect()
}
