//! Requirements of a row.

use super::chance;
use super::outcome::{NEAR_PX, Summary};
use std::fmt;
use std::ops::Range;

/// A requirement of a row.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Demand {
    /// Largest median of the radial errors.
    MedianArcsec(f64),
    /// Largest error of 99.7 % of the frames.
    MostArcsec(f64),
    /// Every frame that shows enough of the limb and three marks fully lit is fine.
    AllFine,
    /// Every such frame with four marks or more fully lit is fine.
    AllFineOfFour,
    /// Of such frames with three marks fully lit at least this share is fine.
    FineOfThree(f64),
    /// Every such frame is fine, except for at most this share whose marks leave two labellings open: three in a row at the
    /// sensor's edge, which cuts off the neighbours that determine the quarter turn.
    FewUndecided(f64),
    /// Minimum share of frames that are at least coarse.
    SolvedShare(f64),
    /// Minimum share of solved frames whose Sun is within [`NEAR_PX`] of the truth on the sensor.
    NearShare(f64),
    /// Minimum share of frames that are fine.
    FineShare(f64),
    /// No frame is reported as fine.
    NoneFine,
    /// The ratio of error to stated sigma is close to 1.
    SigmaRatio,
    /// As [`SigmaRatio`](Self::SigmaRatio), with this upper limit, for rows with few frames; see [`Precision`].
    SigmaRatioUpTo(f64),
    /// Largest median of the radial errors relative to that of ideal frames with the same seeds; see [`Precision`].
    TimesIdeal(f64),
    /// In at least this share of the frames the marks are not identified, and their most likely labelling is a false one.
    RivalsLikeliest(f64),
    /// No solved frame has a wrong id.
    NoWrongId,
    /// No fine frame is off by 5 sigma and 2 arcsec.
    NoWrongFine,
}

/// Accepted ratio of error to stated sigma, rms per axis.
pub const CALIBRATED: Range<f64> = 0.8..1.25;

/// Comparison of the statistics of few frames with a limit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Precision {
    /// Without allowance.
    Measured,
    /// A limit is exceeded only if the statistics exceed it by 3 sigma of their scatter for that number of frames.
    OfCount,
}

impl Precision {
    /// Allowance beyond a limit, in sigma of the statistic.
    pub(super) fn allowed_sigmas(self) -> f64 {
        match self {
            Self::Measured => 0.0,
            Self::OfCount => 3.0,
        }
    }
}

impl Demand {
    /// Why the requirement is not met; `None` if it is. A requirement without measurements is not met.
    pub fn unmet(self, found: &Summary, precision: Precision) -> Option<String> {
        let at_most = |name: &str, value: Option<f64>, limit: f64| {
            let met = value.is_some_and(|v| v <= limit);
            (!met).then(|| format!("{name} {} over {limit}", text(value)))
        };
        let at_least = |name: &str, value: Option<f64>, limit: f64| {
            let met = value.is_some_and(|v| v >= limit);
            (!met).then(|| format!("{name} {} under {limit}", text(value)))
        };
        let none = |name: &str, seeds: &[u64]| {
            (!seeds.is_empty()).then(|| format!("{name} in seeds {seeds:?}"))
        };
        match self {
            Self::MedianArcsec(limit) => at_most("median", found.median_arcsec, limit),
            Self::MostArcsec(limit) => at_most("99.7 %", found.most_arcsec, limit),
            Self::AllFine => (!found.missed.is_empty())
                .then(|| format!("{} frames should be fine and are not", found.missed.len())),
            Self::AllFineOfFour => {
                let missed = found.missed.iter().filter(|m| m.lit_marks > 3).count();
                (missed > 0)
                    .then(|| format!("{missed} frames of four marks should be fine and are not"))
            }
            Self::FineOfThree(least) => {
                let missed = found.missed.iter().filter(|m| m.lit_marks == 3).count();
                let most = (1.0 - least) * found.due_of_three as f64;
                // With few frames, a single one exceeds any small share.
                let most = match precision {
                    Precision::Measured => most,
                    Precision::OfCount => most + 3.0 * most.max(1.0).sqrt(),
                };
                (missed as f64 > most).then(|| {
                    format!(
                        "{missed} of {} frames of three marks are not fine",
                        found.due_of_three
                    )
                })
            }
            Self::FewUndecided(most) => {
                let undecided = found.missed.iter().filter(|m| m.is_undecided()).count();
                let others = found.missed.len() - undecided;
                let share = undecided as f64 / found.frames.max(1) as f64;
                (others > 0 || share > most).then(|| {
                    format!(
                        "{others} frames should be fine and are not, {:.1} % undecided over {most}",
                        100.0 * share
                    )
                })
            }
            Self::SolvedShare(limit) => at_least("solved share", found.solved_share(), limit),
            Self::NearShare(limit) => at_least("share within 0.5 px", found.near_share, limit),
            Self::FineShare(limit) => at_least("fine share", found.fine_share(), limit),
            Self::NoneFine => (found.fine > 0).then(|| format!("{} frames are fine", found.fine)),
            Self::SigmaRatio => {
                let calibrated = |axes: [f64; 2]| axes.iter().all(|v| CALIBRATED.contains(v));
                let [x, y] = [0, 1].map(|axis| text(found.over_sigma.map(|axes| axes[axis])));
                (!found.over_sigma.is_some_and(calibrated)).then(|| format!("error/sigma {x}, {y}"))
            }
            Self::SigmaRatioUpTo(most) => dishonest(found, most, precision),
            Self::TimesIdeal(most) => {
                let ideal = found.ideal.as_ref();
                let least = ideal.map(|i| i.ratio - precision.allowed_sigmas() * i.ratio_sigma);
                let met = least.is_some_and(|ratio| ratio <= most);
                (!met).then(|| {
                    format!(
                        "{} x the ideal median over {most}",
                        text(ideal.map(|i| i.ratio))
                    )
                })
            }
            Self::RivalsLikeliest(limit) => {
                let share = found.likeliest_false as f64 / found.frames.max(1) as f64;
                at_least("share with a likelier rival", Some(share), limit)
            }
            Self::NoWrongId => none("wrong ids", &found.wrong_ids),
            Self::NoWrongFine => none("wrong fine frames", &found.wrong_fine),
        }
    }
}

/// Why the ratio of error to sigma is outside the accepted range up to `most`; `None` if it is inside.
fn dishonest(found: &Summary, most: f64, precision: Precision) -> Option<String> {
    let sigmas = precision.allowed_sigmas();
    let calibrated = |rms: f64| {
        let range = chance::range_of_rms(rms, found.counted, sigmas);
        *range.start() <= most && *range.end() >= CALIBRATED.start
    };
    let met = found
        .over_sigma
        .is_some_and(|axes| axes.into_iter().all(calibrated));
    let [x, y] = [0, 1].map(|axis| text(found.over_sigma.map(|axes| axes[axis])));
    (!met).then(|| format!("error/sigma {x}, {y} of {} frames", found.counted))
}

impl fmt::Display for Demand {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::MedianArcsec(limit) => write!(out, "median {limit}"),
            Self::MostArcsec(limit) => write!(out, "99.7 % {limit}"),
            Self::AllFine => write!(out, "all marked frames fine"),
            Self::AllFineOfFour => write!(out, "all frames of four marks fine"),
            Self::FineOfThree(least) => {
                write!(out, "{:.0} % of those of three marks fine", 100.0 * least)
            }
            Self::FewUndecided(most) => {
                write!(
                    out,
                    "marked frames fine but {:.0} % undecided",
                    100.0 * most
                )
            }
            Self::SolvedShare(limit) => write!(out, "{:.0} % solved", 100.0 * limit),
            Self::FineShare(limit) => write!(out, "{:.0} % fine", 100.0 * limit),
            Self::NearShare(limit) => write!(out, "{:.0} % within {NEAR_PX} px", 100.0 * limit),
            Self::NoneFine => write!(out, "none fine"),
            Self::SigmaRatio => write!(
                out,
                "error/sigma {} to {}",
                CALIBRATED.start, CALIBRATED.end
            ),
            Self::SigmaRatioUpTo(most) => write!(out, "error/sigma {} to {most}", CALIBRATED.start),
            Self::TimesIdeal(most) => write!(out, "median {most} x the ideal"),
            Self::RivalsLikeliest(least) => {
                write!(
                    out,
                    "a rival likeliest in {:.1} % of the frames or more",
                    100.0 * least
                )
            }
            Self::NoWrongId => write!(out, "no wrong id"),
            Self::NoWrongFine => write!(out, "no wrong fine frame"),
        }
    }
}

fn text(value: Option<f64>) -> String {
    value.map_or("unknown".into(), |v| format!("{v:.3}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::accuracy::outcome::{About, AgainstIdeal};

    fn summary(counted: usize, over_sigma: f64, ratio: f64) -> Summary {
        Summary {
            counted,
            median_arcsec: Some(2.85),
            over_sigma: Some([1.0, over_sigma]),
            ideal: Some(AgainstIdeal {
                frames: counted,
                median_arcsec: 1.0,
                ratio,
                ratio_sigma: 0.2,
            }),
            ..Summary::of(&[], About::Fine, 2.0)
        }
    }

    #[test]
    fn a_limit_is_kept_up_to_itself() {
        let found = summary(300, 1.2, 1.3);
        for (demand, met) in [
            (Demand::SigmaRatio, true),
            (Demand::SigmaRatioUpTo(1.25), true),
            (Demand::SigmaRatioUpTo(1.1), false),
            (Demand::MedianArcsec(2.8), false),
            (Demand::MedianArcsec(2.9), true),
            (Demand::TimesIdeal(1.3), true),
            (Demand::TimesIdeal(1.29), false),
        ] {
            let unmet = demand.unmet(&found, Precision::Measured);
            assert_eq!(unmet.is_none(), met, "{demand}");
        }
    }

    #[test]
    fn few_frames_fail_a_demand_only_where_their_scatter_does_not_explain_it() {
        let few = |over_sigma, ratio| summary(24, over_sigma, ratio);
        for (found, sigma_met, ideal_met) in [
            (few(1.5, 1.8), true, true),
            // 24 values of a Gaussian have an rms above 1.44 with a probability of 1 in 1000.
            (few(2.0, 2.0), false, false),
            (few(0.6, 1.0), true, true),
            (few(0.4, 1.0), false, true),
        ] {
            let unmet = |demand: Demand| demand.unmet(&found, Precision::OfCount);
            assert_eq!(unmet(Demand::SigmaRatioUpTo(1.25)).is_none(), sigma_met);
            assert_eq!(unmet(Demand::TimesIdeal(1.3)).is_none(), ideal_met);
        }
    }

    #[test]
    fn a_demand_on_frames_that_were_not_found_is_not_met() {
        let summary = Summary::of(&[], About::Coarse, 2.0);
        for demand in [
            Demand::MedianArcsec(9.0),
            Demand::SigmaRatio,
            Demand::SigmaRatioUpTo(1.3),
            Demand::TimesIdeal(2.0),
            Demand::SolvedShare(0.1),
        ] {
            assert!(
                demand.unmet(&summary, Precision::OfCount).is_some(),
                "{demand}"
            );
        }
    }
}
