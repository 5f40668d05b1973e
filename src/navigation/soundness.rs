//! Faults that an IMU's values reveal by themselves: values that repeat, that saturate at the end of the range, that jump
//! more than the vehicle can, and times that step against the samples' count.
//!
//! A fault is treated as noise. No sample is rejected: the covariance grows by the uncertainty until directions determine
//! the motion again.

use super::measurement::ImuSample;
use super::motion::Lost;
use super::settings::Imu;
use nalgebra::Vector3;

/// A value that stays constant for this many samples more than usual for its axis counts as repeating.
const FEW: f64 = 3.0;
/// It must also stay constant this many times longer than usual: values of a coarsely quantised axis repeat without a
/// fault.
const LONGER: f64 = 8.0;
/// Averaging times of the usual values, s.
const USUAL_S: f64 = 30.0;
const USUAL_RUN_S: f64 = 60.0;
/// A value above this fraction of the range counts as saturated.
const AT_THE_END: f64 = 0.98;
/// Limit of the difference of two samples that may be noise, in the sigma of one sample; a larger one is motion of the
/// vehicle.
const NOISE: f64 = 8.5;

/// Why an IMU's values do not determine the motion.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Unsound {
    #[error("a value repeats")]
    Repeats,
    #[error("a value is at the end of the range")]
    Saturated,
    #[error("the rate jumps as the vehicle cannot")]
    Jumps,
    #[error("the time steps against the samples' count")]
    TimeSteps,
}

/// Checks the samples in order.
#[derive(Debug, Clone, Default)]
pub(super) struct Soundness {
    force: [Axis; 3],
    rate: [Axis; 3],
    found: Option<Unsound>,
}

/// Limits and noise of an axis.
struct Expected {
    range: Option<f64>,
    /// Possible excess of the true value beyond the range.
    beyond: f64,
    /// Maximum change per second.
    change_s: Option<f64>,
    /// 1 sigma of a sample's own noise.
    noise: f64,
}

impl Soundness {
    /// Uncertainty that a sample adds to the interval of `length_s` that ends with it.
    pub fn judge(&mut self, sample: &ImuSample, length_s: f64, imu: &Imu) -> Lost {
        self.found = None;
        let force = Expected {
            range: imu.accelerometer_range_m_s2,
            beyond: imu.accelerometer_range_m_s2.unwrap_or_default(),
            change_s: None,
            noise: imu.velocity_random_walk / length_s.sqrt(),
        };
        let range_rad_s = imu.gyro_range_rad_s;
        let rate = Expected {
            range: range_rad_s,
            beyond: range_rad_s.map_or(0.0, |range| range.max(imu.most_rate_rad_s - range)),
            change_s: imu.most_turn_rad_s2,
            noise: imu.angular_random_walk / length_s.sqrt(),
        };
        let step_s = sample.time_step_s;
        let mut judged = |axes: &mut [Axis; 3], values: &Vector3<f64>, expected: &Expected| {
            let of_axis = |(axis, value): (&mut Axis, &f64)| {
                let (variance, found) = axis.judge(*value, length_s, expected);
                self.found = self.found.or(found);
                let by_time = step_s * axis.spread().max(value.abs());
                variance + by_time.powi(2)
            };
            let variances = axes.iter_mut().zip(values.iter()).map(of_axis);
            let largest = variances.fold(0.0, f64::max);
            (largest / length_s).sqrt()
        };
        let lost = Lost {
            velocity_random_walk: judged(&mut self.force, &sample.force_m_s2, &force),
            angular_random_walk: judged(&mut self.rate, &sample.rate_rad_s, &rate),
        };
        if step_s != 0.0 {
            self.found = Some(Unsound::TimeSteps);
        }
        lost
    }

    /// Fault of the last sample.
    pub fn found(&self) -> Option<Unsound> {
        self.found
    }
}

/// One axis of accelerometers or gyros.
#[derive(Debug, Clone, Default)]
struct Axis {
    last: Option<f64>,
    /// Number of samples for which the last value has been constant, and the usual number.
    run: f64,
    usual_run: f64,
    /// Number of samples in a row that were saturated, or jumped.
    at_the_end: f64,
    jumped: f64,
    /// The last value that did not jump, and its age.
    sound: Option<(f64, f64)>,
    /// Mean and variance over the last 30 s, and the number of samples.
    mean: f64,
    variance: f64,
    count: f64,
}

impl Axis {
    /// The variance that a value adds to its interval's integral, and the reason.
    fn judge(&mut self, value: f64, length_s: f64, expected: &Expected) -> (f64, Option<Unsound>) {
        let found = [
            (self.repeats(value, length_s), Unsound::Repeats),
            (self.saturates(value, expected), Unsound::Saturated),
            (self.jumps(value, length_s, expected), Unsound::Jumps),
        ];
        // A constant error over n samples grows with n, not with its square root: the n-th sample adds this.
        let added = |(samples, error): (f64, f64)| {
            (2.0 * samples - 1.0).max(0.0) * (error * length_s).powi(2)
        };
        let variance = found.iter().map(|(found, _)| added(*found)).sum();
        let explains = |(samples, error): &(f64, f64)| *samples > 0.0 && *error > 0.0;
        let why = found.iter().find(|(found, _)| explains(found));
        if why.is_none() {
            self.learn(value, length_s);
        }
        (variance, why.map(|(_, why)| *why))
    }

    /// Number of samples for which a value has been constant too long, and the possible error of the value.
    fn repeats(&mut self, value: f64, length_s: f64) -> (f64, f64) {
        let most = FEW + LONGER * (self.usual_run - 1.0).max(0.0);
        if self.last.replace(value) == Some(value) {
            self.run += 1.0;
        } else {
            let share = (self.run * length_s / USUAL_RUN_S).min(1.0);
            self.usual_run += share * (self.run.min(most) - self.usual_run);
            self.run = 1.0;
        }
        let samples = if self.run >= most { self.run } else { 0.0 };
        (samples, self.spread())
    }

    fn saturates(&mut self, value: f64, expected: &Expected) -> (f64, f64) {
        let is_at_the_end = expected
            .range
            .is_some_and(|range| value.abs() >= AT_THE_END * range);
        self.at_the_end = if is_at_the_end {
            self.at_the_end + 1.0
        } else {
            0.0
        };
        (self.at_the_end, expected.beyond)
    }

    fn jumps(&mut self, value: f64, length_s: f64, expected: &Expected) -> (f64, f64) {
        let change = match (self.sound, expected.change_s) {
            (Some((sound, age_s)), Some(change_s)) => {
                let most = change_s * (age_s + length_s) + NOISE * expected.noise;
                Some((value - sound).abs()).filter(|change| *change > most)
            }
            _ => None,
        };
        match (change, &mut self.sound) {
            (Some(_), Some((_, age_s))) => {
                *age_s += length_s;
                self.jumped += 1.0;
            }
            _ => {
                self.sound = Some((value, 0.0));
                self.jumped = 0.0;
            }
        }
        (self.jumped, change.unwrap_or_default())
    }

    fn learn(&mut self, value: f64, length_s: f64) {
        self.count += 1.0;
        let share = self.count.recip().max((length_s / USUAL_S).min(1.0));
        let off = value - self.mean;
        self.mean += share * off;
        self.variance += share * ((1.0 - share) * off * off - self.variance);
    }

    /// Scatter of the values about their mean, 1 sigma.
    fn spread(&self) -> f64 {
        self.variance.max(0.0).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::instrument::DEMO_NAVIGATION;
    use crate::navigation::NavigationSettings;
    use std::path::Path;

    const STEP_S: f64 = 0.01;

    fn walks(rates: impl Iterator<Item = f64>) -> Vec<f64> {
        let imu = NavigationSettings::parse(Path::new("NAV.toml"), DEMO_NAVIGATION)
            .unwrap()
            .imu;
        let mut soundness = Soundness::default();
        let judged = rates.enumerate().map(|(n, rate)| {
            // Neither accelerometers nor the other gyros repeat values.
            let other = 1e-5 * (n as f64 * 1.7).sin();
            let sample = ImuSample {
                t_s: n as f64 * STEP_S,
                force_m_s2: Vector3::new(other, other, 9.8 + other),
                rate_rad_s: Vector3::new(rate, other, other),
                time_step_s: 0.0,
            };
            soundness.judge(&sample, STEP_S, &imu).angular_random_walk
        });
        judged.collect()
    }

    fn swing(n: i32) -> f64 {
        3e-3 * (f64::from(n) * 0.01).sin()
    }

    #[test]
    fn a_value_that_repeats_leaves_the_angle_unknown_and_one_that_swings_does_not() {
        let walks = walks((0..3000).map(swing).chain([swing(2999); 1000]));
        assert!(walks[..3000].iter().all(|walk| *walk == 0.0));
        // 10 s of a swing's rate: 2e-3 rad/s, 1 sigma.
        let angle: f64 = walks.iter().map(|walk| walk * walk * STEP_S).sum();
        assert!((0.018..0.025).contains(&angle.sqrt()), "{}", angle.sqrt());
    }

    #[test]
    fn a_coarse_gyro_is_known_as_such_after_a_minute() {
        // Quantised to 2e-4 rad/s: each value stays constant for a sixth of a second.
        let coarse = |n: i32| (swing(n) / 2e-4).round() * 2e-4;
        let walks = walks((0..60_000).map(coarse));
        let unsound = |range: std::ops::Range<usize>| {
            walks[range.clone()]
                .iter()
                .filter(|walk| **walk > 0.0)
                .count() as f64
                / range.len() as f64
        };
        assert!(unsound(0..1000) > 0.3);
        assert!(
            unsound(50_000..60_000) < 0.02,
            "{}",
            unsound(50_000..60_000)
        );
    }

    #[test]
    fn a_jump_that_no_vehicle_makes_is_unknown_by_its_size() {
        let spike = |n| if n == 500 { 0.1 } else { swing(n) };
        let walks = walks((0..1000).map(spike));
        let unsound: Vec<usize> = (0..1000).filter(|n| walks[*n] > 0.0).collect();
        assert_eq!(unsound, [500]);
        let angle = walks[500] * STEP_S.sqrt();
        assert!((angle - 1e-3).abs() < 5e-5, "{angle}");
    }
}
