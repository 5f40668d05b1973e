//! Runs of many kinds of frames in one series: they search for what must never happen, not for small errors.

use super::chance::{quantile, rms};
use super::conditions::LEAST_USABLE_LIMB;
use super::outcome::{has_wrong_id, is_wrong_fine};
use super::trial::Outcome;
use crate::aspect::Quality;

/// Result of a run.
#[derive(Debug, Clone, PartialEq)]
pub struct MixedSummary {
    pub frames: usize,
    /// Frames with [`LEAST_USABLE_LIMB`] of the limb or more on the sensor.
    pub usable: usize,
    /// Of the usable frames.
    pub fine: usize,
    pub coarse: usize,
    /// Frames with less, or without Sun, that were solved: coarsely at best.
    pub solved_unusable: usize,
    /// Fine frames that the errors are of.
    pub counted: usize,
    /// Median error of the fine frames.
    pub median_arcsec: Option<f64>,
    /// Root mean square of the fine frames' error over stated sigma, by axis.
    pub over_sigma: [Option<f64>; 2],
    /// Solved frames in which a mark has a wrong id, by seed.
    pub wrong_ids: Vec<u64>,
    /// Fine frames that are off by more than 5 sigma and more than 2 arcsec, or without Sun, by seed.
    pub wrong_fine: Vec<u64>,
}

impl MixedSummary {
    pub fn of(outcomes: &[Outcome]) -> Self {
        let usable = |o: &&Outcome| o.limb_share >= LEAST_USABLE_LIMB;
        let count = |quality| {
            let usable = outcomes.iter().filter(usable);
            usable.filter(|o| o.quality == quality).count()
        };
        let unusable = outcomes.iter().filter(|o| !usable(o));
        let fine = outcomes.iter().filter(|o| o.quality == Quality::Fine);
        let errors: Vec<_> = fine.filter_map(|o| o.aspect).collect();
        let seeds = |wrong: fn(&Outcome) -> bool| {
            let wrong = outcomes.iter().filter(|o| wrong(o));
            wrong.map(|o| o.seed).collect()
        };
        Self {
            frames: outcomes.len(),
            usable: outcomes.iter().filter(usable).count(),
            fine: count(Quality::Fine),
            coarse: count(Quality::Coarse),
            solved_unusable: unusable.filter(|o| o.quality != Quality::None).count(),
            counted: errors.len(),
            median_arcsec: quantile(errors.iter().map(|e| e.radial_arcsec).collect(), 0.5),
            over_sigma: [0, 1].map(|axis| rms(errors.iter().map(|e| e.over_sigma()[axis]))),
            wrong_ids: seeds(has_wrong_id),
            wrong_fine: seeds(is_wrong_fine),
        }
    }

    /// Why the run fails; `None` where nothing wrong was found.
    pub fn unmet(&self) -> Option<String> {
        let (ids, fine) = (self.wrong_ids.len(), self.wrong_fine.len());
        (ids + fine > 0)
            .then(|| format!("{ids} frames with a wrong id, {fine} wrong fine frames; seeds above"))
    }
}
