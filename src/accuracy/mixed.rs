//! Series of many kinds of frames: they search for events that must never happen, not for small errors.

use super::chance::{quantile, rms};
use super::conditions::LEAST_USABLE_LIMB;
use super::outcome::{has_wrong_id, is_wrong_fine};
use super::trial::Outcome;
use crate::aspect::Quality;

/// Result of a run.
#[derive(Debug, Clone, PartialEq)]
pub struct MixedSummary {
    pub frames: usize,
    /// Number of frames with at least [`LEAST_USABLE_LIMB`] of the limb on the sensor.
    pub usable: usize,
    /// Counts among the usable frames.
    pub fine: usize,
    pub coarse: usize,
    /// Number of solved frames with less, or without Sun: coarse at best.
    pub solved_unusable: usize,
    /// Number of fine frames in the error statistics.
    pub counted: usize,
    /// Median error of the fine frames.
    pub median_arcsec: Option<f64>,
    /// Root mean square of the ratio of the fine frames' error to stated sigma, by axis.
    pub over_sigma: [Option<f64>; 2],
    /// Seeds of solved frames in which a mark has a wrong id.
    pub wrong_ids: Vec<u64>,
    /// Seeds of fine frames that are off by more than 5 sigma and more than 2 arcsec, or have no Sun.
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

    /// Why the run fails; `None` if no error was found.
    pub fn unmet(&self) -> Option<String> {
        let (ids, fine) = (self.wrong_ids.len(), self.wrong_fine.len());
        (ids + fine > 0)
            .then(|| format!("{ids} frames with a wrong id, {fine} wrong fine frames; seeds above"))
    }
}
