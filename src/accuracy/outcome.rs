//! Summary of many outcomes.

use super::chance::{self, quantile, rms};
use super::trial::{AspectError, Outcome};
use crate::aspect::Quality;

/// Quantile for 3 sigma of a Gaussian.
pub const MOST: f64 = 0.997;

/// Selection of the frames for the statistics of a row.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum About {
    /// Frames solved fine.
    Fine,
    /// Frames solved coarsely.
    Coarse,
    /// All solved frames.
    Solved,
}

impl About {
    fn holds(self, quality: Quality) -> bool {
        match self {
            Self::Fine => quality == Quality::Fine,
            Self::Coarse => quality == Quality::Coarse,
            Self::Solved => quality != Quality::None,
        }
    }
}

/// The statistics of a row. Shares and quantiles of empty sets are `None`.
#[derive(Debug, Clone, PartialEq)]
pub struct Summary {
    pub frames: usize,
    /// Number of frames in the error statistics.
    pub counted: usize,
    pub fine: usize,
    pub coarse: usize,
    /// Frames with the whole disc or enough of its limb and three marks fully lit that are not fine.
    pub missed: Vec<Missed>,
    /// Number of frames that should be fine, with exactly three marks.
    pub due_of_three: usize,
    /// Radial errors of the aspect.
    pub median_arcsec: Option<f64>,
    pub most_arcsec: Option<f64>,
    pub largest_arcsec: Option<f64>,
    /// Root mean square of the ratio of error to stated sigma, by axis.
    pub over_sigma: Option<[f64; 2]>,
    /// Share of the solved frames whose Sun on the sensor is within [`NEAR_PX`] of the truth.
    pub near_share: Option<f64>,
    /// Seeds of frames in which a mark has a wrong id.
    pub wrong_ids: Vec<u64>,
    /// Number of frames without identified marks whose most likely labelling is a false one.
    pub likeliest_false: usize,
    /// Seeds of fine frames with an impossibly large error.
    pub wrong_fine: Vec<u64>,
    pub bound: Option<AgainstBound>,
    /// Present if the row has ideal frames for comparison.
    pub ideal: Option<AgainstIdeal>,
}

/// Maximum error of the Sun on the sensor that is sufficient for pointing, px.
pub const NEAR_PX: f64 = 0.5;

/// A frame that should be fine and is not.
#[derive(Debug, Clone, PartialEq)]
pub struct Missed {
    pub seed: u64,
    pub lit_marks: usize,
    pub reason: String,
}

impl Missed {
    /// Whether its marks have more than one possible labelling.
    pub fn is_undecided(&self) -> bool {
        [
            "two labellings of the marks fit equally well",
            "the best labelling may rest on a false detection",
        ]
        .iter()
        .any(|reason| self.reason.contains(reason))
    }
}

/// Errors relative to the Cramer-Rao bound, for the frames with a known bound.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AgainstBound {
    pub frames: usize,
    /// Median over the frames of the bound per axis.
    pub median_arcsec: f64,
    /// Root mean square, over frames and axes, of the ratio of the error to the frame's own bound.
    pub error_over_bound: f64,
}

/// Errors relative to those of ideal frames with the same seeds, for the seeds that count under both conditions.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AgainstIdeal {
    pub frames: usize,
    /// Median of the radial errors of the ideal frames.
    pub median_arcsec: f64,
    /// The median under the row's conditions relative to that of the ideal frames.
    pub ratio: f64,
    /// 1 sigma of the ratio, from the scatter of the frames.
    pub ratio_sigma: f64,
}

impl AgainstIdeal {
    /// Compares outcomes with those of ideal frames. `None` if no seed counts under both conditions.
    pub fn of(outcomes: &[Outcome], ideal: &[Outcome], about: About) -> Option<Self> {
        let error = |o: &Outcome| {
            let counted = about.holds(o.quality);
            o.aspect.filter(|_| counted).map(|e| e.radial_arcsec)
        };
        let pairs: Vec<(f64, f64)> = outcomes
            .iter()
            .zip(ideal)
            .filter_map(|(one, ideal)| Some((error(one)?, error(ideal)?)))
            .collect();
        let (ratio, median_arcsec) = chance::ratio_of_medians(&pairs)?;
        Some(Self {
            frames: pairs.len(),
            median_arcsec,
            ratio,
            ratio_sigma: chance::sigma_of_ratio(&pairs)?,
        })
    }
}

impl Summary {
    pub fn of(outcomes: &[Outcome], about: About, arcsec_per_mil: f64) -> Self {
        let of_quality = |quality| outcomes.iter().filter(|o| o.quality == quality).count();
        let counted: Vec<&Outcome> = outcomes
            .iter()
            .filter(|o| about.holds(o.quality) && o.aspect.is_some())
            .collect();
        let errors: Vec<&AspectError> = counted.iter().filter_map(|o| o.aspect.as_ref()).collect();
        let radial = || errors.iter().map(|e| e.radial_arcsec).collect();
        let seeds = |wrong: fn(&Outcome) -> bool| {
            let wrong = outcomes.iter().filter(|o| wrong(o));
            wrong.map(|o| o.seed).collect()
        };
        Self {
            frames: outcomes.len(),
            counted: counted.len(),
            fine: of_quality(Quality::Fine),
            coarse: of_quality(Quality::Coarse),
            missed: outcomes.iter().filter_map(missed).collect(),
            due_of_three: outcomes
                .iter()
                .filter(|o| is_due(o) && o.lit_marks == 3)
                .count(),
            median_arcsec: quantile(radial(), 0.5),
            most_arcsec: quantile(radial(), MOST),
            largest_arcsec: quantile(radial(), 1.0),
            over_sigma: over_sigma(&errors),
            near_share: near_share(outcomes),
            likeliest_false: outcomes.iter().filter(|o| o.likeliest_is_false).count(),
            wrong_ids: seeds(has_wrong_id),
            wrong_fine: seeds(is_wrong_fine),
            bound: against_bound(&counted, arcsec_per_mil),
            ideal: None,
        }
    }

    /// Share of the frames solved fine or coarsely.
    pub fn solved_share(&self) -> Option<f64> {
        share(self.fine + self.coarse, self.frames)
    }

    /// Share of the frames solved fine.
    pub fn fine_share(&self) -> Option<f64> {
        share(self.fine, self.frames)
    }
}

/// Whether a solved frame has a mark with the id of another.
pub fn has_wrong_id(outcome: &Outcome) -> bool {
    outcome.quality != Quality::None && !outcome.wrong_ids.is_empty()
}

/// Whether a frame reported as fine is off by more than 5 of its sigma and by more than 2 arcsec, or has no Sun.
pub fn is_wrong_fine(outcome: &Outcome) -> bool {
    let wrong = |e: &AspectError| e.sigmas() > 5.0 && e.radial_arcsec > 2.0;
    outcome.quality == Quality::Fine && outcome.aspect.as_ref().is_none_or(wrong)
}

/// Minimum fraction of the limb on the sensor for which a fine solution is expected.
pub const ENOUGH_LIMB: f64 = 0.4;

/// Whether a frame should be fine.
fn is_due(outcome: &Outcome) -> bool {
    outcome.lit_marks >= 3 && outcome.limb_share >= ENOUGH_LIMB
}

fn missed(outcome: &Outcome) -> Option<Missed> {
    (is_due(outcome) && outcome.quality != Quality::Fine).then(|| Missed {
        seed: outcome.seed,
        lit_marks: outcome.lit_marks,
        reason: outcome.reason.clone().unwrap_or_default(),
    })
}

fn share(part: usize, whole: usize) -> Option<f64> {
    (whole > 0).then(|| part as f64 / whole as f64)
}

fn over_sigma(errors: &[&AspectError]) -> Option<[f64; 2]> {
    let along = |axis: usize| rms(errors.iter().map(|e| e.over_sigma()[axis]));
    Some([along(0)?, along(1)?])
}

fn near_share(outcomes: &[Outcome]) -> Option<f64> {
    let solved = outcomes.iter().filter(|o| About::Solved.holds(o.quality));
    let errors: Vec<f64> = solved
        .filter_map(|o| o.aspect.map(|e| e.sensor_px))
        .collect();
    let near = errors.iter().filter(|px| **px <= NEAR_PX).count();
    share(near, errors.len())
}

fn against_bound(counted: &[&Outcome], arcsec_per_mil: f64) -> Option<AgainstBound> {
    let pairs: Vec<_> = counted
        .iter()
        .filter_map(|o| Some((o.aspect?.plate_mil, o.bound_mil2?)))
        .collect();
    let bounds = pairs.iter().map(|(_, b)| (b.trace() / 2.0).sqrt());
    let ratios = pairs
        .iter()
        .flat_map(|(error, bound)| [0, 1].map(|axis| error[axis] / bound[(axis, axis)].sqrt()));
    Some(AgainstBound {
        frames: pairs.len(),
        median_arcsec: quantile(bounds.collect(), 0.5)? * arcsec_per_mil,
        error_over_bound: rms(ratios)?,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix2, Vector2};

    /// A fine frame with the given error along X and a stated sigma of 1 mil.
    fn off_by(mil: f64) -> Outcome {
        Outcome {
            likeliest_is_false: false,
            seed: 0,
            quality: Quality::Fine,
            reason: None,
            limb_share: 1.0,
            lit_marks: 4,
            aspect: Some(AspectError {
                plate_mil: Vector2::new(mil, mil),
                covariance_mil2: Matrix2::identity(),
                radial_arcsec: mil.abs() * 2.0_f64.sqrt() * 2.0,
                sensor_px: 0.1,
            }),
            marks: Vec::new(),
            wrong_ids: Vec::new(),
            bound_mil2: Some(Matrix2::identity() * 0.25),
        }
    }

    #[test]
    fn errors_are_held_against_sigma_and_bound() {
        let outcomes = [off_by(1.0), off_by(-1.0)];
        let summary = Summary::of(&outcomes, About::Fine, 2.0);
        assert_eq!(summary.over_sigma, Some([1.0, 1.0]));
        let bound = summary.bound.unwrap();
        assert_eq!((bound.median_arcsec, bound.error_over_bound), (1.0, 2.0));
        assert_eq!(summary.median_arcsec, Some(2.0 * 2.0_f64.sqrt()));
    }

    #[test]
    fn only_seeds_that_are_counted_under_both_conditions_are_compared() {
        let ideal = [off_by(1.0), off_by(1.0), off_by(3.0)];
        let coarse = Outcome {
            quality: Quality::Coarse,
            ..off_by(9.0)
        };
        let found = [off_by(2.0), off_by(2.0), coarse];
        let beside = AgainstIdeal::of(&found, &ideal, About::Fine).unwrap();
        assert_eq!((beside.frames, beside.ratio), (2, 2.0));
        assert_eq!(AgainstIdeal::of(&[], &ideal, About::Fine), None);
    }

    #[test]
    fn what_is_not_fine_though_it_ought_to_be_is_listed() {
        let coarse = Outcome {
            quality: Quality::Coarse,
            ..off_by(0.0)
        };
        let summary = Summary::of(&[off_by(0.0), coarse], About::Fine, 2.0);
        assert_eq!(summary.missed.len(), 1);
        assert_eq!((summary.fine, summary.counted), (1, 1));
    }

    #[test]
    fn a_fine_frame_that_is_far_off_is_wrong_and_one_that_says_so_is_not() {
        assert!(is_wrong_fine(&off_by(4.0)));
        assert!(!is_wrong_fine(&off_by(3.0)));
        let sunless = Outcome {
            aspect: None,
            ..off_by(0.0)
        };
        assert!(is_wrong_fine(&sunless));
    }
}
