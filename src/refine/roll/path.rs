//! The path of the body's roll and pitch: fitted once, evaluated often.

use super::super::record::Grade;
use super::super::timeline::Timeline;
use super::HorizonRecord;
use super::row::SmoothedRoll;
use crate::estimation::{SIGMA_PER_MEDIAN, median};
use crate::pointing::{body_pitch_deg, body_roll_deg};
use crate::smoothing::{self, Measurement, Moment, Path, PathPoint, SharedErrors};
use crate::units::Measured;

/// Unit of the path: about the error of a frame.
const UNIT_DEG: f64 = 0.01;
/// A roll with a larger 1 sigma is not stated.
const MOST_SIGMA_DEG: f64 = 0.5;
/// Fewest differences of neighbours; in each, the ratio of the steps between frames must be below the second value.
const LEAST_DIFFERENCES: usize = 20;
const EVEN_STEPS: f64 = 1.5;
/// Least part of the stated sigmas that changes between frames: a camera that repeats a picture has differences of 0, and a path through
/// frames without an error cannot be found.
const LEAST_CHANGING: f64 = 0.05;

/// The body's path through frames.
#[derive(Debug, Clone)]
pub(super) struct RollPath {
    used: Vec<RollSample>,
    changing: [f64; 2],
    max_age_s: f64,
    path: Path,
}

impl RollPath {
    /// Fits frames in the order of time; `changing` is the part of their sigmas that changes between frames. `None` without any.
    pub fn through(used: Vec<RollSample>, changing: [f64; 2], max_age_s: f64) -> Option<Self> {
        let first_s = used.first()?.time_s;
        let moments = used.iter().map(|one| one.moment(first_s, changing));
        Some(Self {
            path: smoothing::path(moments, SharedErrors::default())?,
            used,
            changing,
            max_age_s,
        })
    }

    /// Roll and pitch of the body at times, s since 1970 and in order; `None` where no frame is near.
    pub fn at(&self, times_s: &[f64]) -> Vec<Option<SmoothedRoll>> {
        let first_s = self.used[0].time_s;
        let since: Vec<f64> = times_s.iter().map(|time_s| time_s - first_s).collect();
        let Some(points) = self.path.anywhere(&since) else {
            return vec![None; times_s.len()];
        };
        let smoothed = |(time_s, point): (&f64, PathPoint)| {
            let nearest = self.nearest(*time_s)?;
            let near = (nearest.time_s - time_s).abs() <= self.max_age_s;
            let smoothed = self.smoothed(&point, nearest);
            let known = smoothed.roll_deg.sigma < MOST_SIGMA_DEG;
            (near && known).then_some(smoothed)
        };
        times_s.iter().zip(points).map(smoothed).collect()
    }

    /// A point of the path, with the errors common to neighbours added.
    fn smoothed(&self, point: &PathPoint, nearest: &RollSample) -> SmoothedRoll {
        let angle = |axis: usize| {
            let changing = point.variance[axis].max(0.0).sqrt() * UNIT_DEG;
            let alike = (1.0 - self.changing[axis].powi(2)).max(0.0).sqrt();
            let sigma = changing.hypot(nearest.angles_deg[axis].sigma * alike);
            Measured::new(point.place[axis] * UNIT_DEG, sigma)
        };
        SmoothedRoll {
            roll_deg: angle(0),
            pitch_deg: angle(1),
            rates_deg_per_s: point.speed.map(|speed| speed * UNIT_DEG),
        }
    }

    fn nearest(&self, time_s: f64) -> Option<&RollSample> {
        let next = self.used.partition_point(|one| one.time_s < time_s);
        let both = [next.checked_sub(1), Some(next)];
        let both = both.into_iter().flatten().filter_map(|n| self.used.get(n));
        let away = |one: &&RollSample| (one.time_s - time_s).abs();
        both.min_by(|a, b| away(a).total_cmp(&away(b)))
    }
}

/// A frame with roll and pitch, at a time of the path.
#[derive(Debug, Clone, Copy)]
pub(super) struct RollSample {
    /// Its index among the dated frames.
    pub frame: usize,
    pub quality: Grade,
    pub time_s: f64,
    pub time_sigma_s: f64,
    pub angles_deg: [Measured; 2],
}

impl RollSample {
    pub fn of(
        timeline: &Timeline<HorizonRecord>,
        n: usize,
        record: &HorizonRecord,
    ) -> Option<Self> {
        let nadir = record.nadir?.direction();
        Some(Self {
            frame: n,
            quality: record.quality,
            time_s: timeline.unix_s(n).filter(|_| timeline.is_timed(n))?,
            time_sigma_s: timeline.timing(n).sigma_s.unwrap_or(0.0),
            angles_deg: [body_roll_deg(&nadir), body_pitch_deg(&nadir)],
        })
    }

    fn moment(&self, first_s: f64, changing: [f64; 2]) -> Moment {
        let axis = |axis: usize| {
            let sigma = self.angles_deg[axis].sigma * changing[axis];
            Measurement {
                place: self.angles_deg[axis].value / UNIT_DEG,
                variance: (sigma / UNIT_DEG).powi(2),
                shared_variance: 0.0,
            }
        };
        Moment {
            time_s: self.time_s - first_s,
            time_sigma_s: self.time_sigma_s,
            measured: Some([axis(0), axis(1)]),
        }
    }
}

/// Part of the stated sigmas that changes between frames, of roll and pitch, from third differences: these suppress slow motion.
/// All of it if there are too few frames or the motion is too fast.
pub(super) fn changing(used: &[RollSample]) -> [f64; 2] {
    let evenly = |four: &&[RollSample]| {
        let steps = four.windows(2).map(|pair| pair[1].time_s - pair[0].time_s);
        let (least, most) = steps.fold((f64::INFINITY, 0.0_f64), |(least, most), step| {
            (least.min(step), most.max(step))
        });
        least > 0.0 && most < EVEN_STEPS * least
    };
    [0, 1].map(|axis| {
        let difference = |four: &[RollSample]| {
            let weights = [1.0, -3.0, 3.0, -1.0];
            let angles = four.iter().map(|one| one.angles_deg[axis]);
            let (sum, variance) = angles
                .zip(weights)
                .fold((0.0, 0.0), |(sum, variance), (a, w)| {
                    (sum + w * a.value, variance + (w * a.sigma).powi(2))
                });
            (sum * sum / variance).sqrt()
        };
        let differences = used.windows(4).filter(evenly).map(difference);
        let differences: Vec<f64> = differences.collect();
        let enough = differences.len() >= LEAST_DIFFERENCES;
        let scatter = median(&differences).filter(|scatter| enough && scatter.is_finite());
        scatter.map_or(1.0, |scatter| {
            (scatter * SIGMA_PER_MEDIAN).clamp(LEAST_CHANGING, 1.0)
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_camera_that_repeats_a_picture_still_has_a_smoothed_roll() {
        // Frames at 4 Hz.
        let fine = |frame: usize, roll_deg: f64| RollSample {
            frame,
            quality: Grade::Fine,
            time_s: frame as f64 / 4.0,
            time_sigma_s: 0.0,
            angles_deg: [roll_deg, 1.0].map(|deg| Measured::new(deg, 0.01)),
        };
        let stuck = (0..200).map(|n| fine(n, 2.0));
        let swings = (200..300).map(|n| fine(n, 2.0 + ((n - 200) as f64 / 9.0).sin()));
        let used: Vec<RollSample> = stuck.chain(swings).collect();
        let changing = changing(&used);
        assert_eq!(changing, [LEAST_CHANGING; 2]);
        let times_s: Vec<f64> = used.iter().map(|one| one.time_s).collect();
        let path = RollPath::through(used.clone(), changing, 1.0).unwrap();
        for (one, smoothed) in used.iter().zip(path.at(&times_s)) {
            let roll = smoothed.unwrap().roll_deg;
            assert!(
                (roll.value - one.angles_deg[0].value).abs() < 0.01,
                "{one:?}"
            );
            assert!(roll.sigma > 0.0099, "{one:?}");
        }
    }
}
