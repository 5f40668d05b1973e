//! Nadir between frames of the horizon: it is propagated with the body's turn rate; its uncertainty grows with the time from the frame.

use crate::geometry::attitude::Direction;
use crate::service::messages::{BodyNadir, MidExposure};
use nalgebra::{Rotation3, Vector3};
use std::time::Duration;

/// Turn rate of the gondola before any frames have measured it, 1 sigma: 0.5 deg/s.
const DEFAULT_RAD_PER_S: f64 = 0.009;
/// Frames further apart than this do not determine a rate.
const RATE_VALID_S: f64 = 1.5;
/// Time constant of the rate, s.
const RATE_FOLLOWS_S: f64 = 0.15;
/// Fraction of the mean prediction error that is kept from frame to frame.
const ERROR_KEPT: f64 = 0.9;

impl BodyNadir {
    /// A direction, without earlier frames that determine its turn rate.
    fn first(direction: Direction, at: MidExposure) -> Self {
        Self {
            direction,
            at,
            arrived: at.by_arrival,
            turn_rad_per_s: Vector3::zeros(),
            error_rad: DEFAULT_RAD_PER_S,
            after_s: 1.0,
        }
    }

    /// The state after the next direction.
    pub fn next(last: Option<Self>, direction: Direction, at: MidExposure) -> Self {
        let Some(last) = last else {
            return Self::first(direction, at);
        };
        let step_s = last.at.until(&at);
        if step_s <= 0.0 || step_s > RATE_VALID_S {
            return Self::first(direction, at);
        }
        let predicted = last.turned(step_s).direction;
        let error_rad = predicted.unit.angle(&direction.unit);
        let kept = ERROR_KEPT * last.error_rad(step_s).powi(2);
        let rate = last.direction.unit.cross(&direction.unit) / step_s;
        let follows = (step_s / RATE_FOLLOWS_S).min(1.0);
        Self {
            direction,
            at,
            arrived: at.by_arrival,
            turn_rad_per_s: last.turn_rad_per_s.lerp(&rate, follows),
            error_rad: (kept + (1.0 - ERROR_KEPT) * error_rad.powi(2) / 2.0).sqrt(),
            after_s: step_s,
        }
    }

    /// The direction at the middle of another exposure, propagated with the turn rate; its error is increased by that of the prediction.
    /// `None` if the two are too far apart in time.
    pub fn at(self, moment: &MidExposure, max_age: Duration) -> Option<Direction> {
        let after_s = self.at.until(moment);
        let near = after_s.abs() <= max_age.as_secs_f64();
        near.then(|| {
            self.turned(after_s)
                .direction
                .loosened(self.error_rad(after_s))
        })
    }

    fn turned(self, after_s: f64) -> Self {
        let turn = Rotation3::new(self.turn_rad_per_s * after_s);
        Self {
            direction: self.direction.turned(&turn),
            ..self
        }
    }

    /// The error of a predicted turn after some time, 1 sigma per axis: proportional to the time, and to its square beyond the time that the frames
    /// cover. It is at most the error without any turn.
    fn error_rad(self, after_s: f64) -> f64 {
        let part = after_s.abs() / self.after_s;
        let still = (self.turn_rad_per_s.norm() + DEFAULT_RAD_PER_S) * after_s.abs();
        (self.error_rad * part.max(part.powi(2))).min(still)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use jiff::Timestamp;
    use nalgebra::UnitVector3;
    use std::time::Instant;

    fn down(roll_rad: f64) -> Direction {
        let unit = Vector3::new(0.0, roll_rad.sin(), roll_rad.cos());
        Direction::new(UnitVector3::new_normalize(unit), 1e-4)
    }

    fn swing_rad(time_s: f64) -> f64 {
        0.02 * (std::f64::consts::TAU * time_s / 3.7).sin()
    }

    fn after(start: Instant, time_s: f64) -> MidExposure {
        MidExposure {
            utc: None,
            by_arrival: start + Duration::from_secs_f64(time_s),
        }
    }

    /// Error of the direction from some frames on a swing, and the sigma added to the frames' own, at a time.
    fn error_and_sigma(frames_s: &[f64], time_s: f64) -> Option<(f64, f64)> {
        let start = Instant::now();
        let mut seen = None;
        for frame_s in frames_s {
            let direction = down(swing_rad(*frame_s));
            seen = Some(BodyNadir::next(seen, direction, after(start, *frame_s)));
        }
        let found = seen?.at(&after(start, time_s), Duration::from_secs(1))?;
        let error = found.unit.y.asin() - swing_rad(time_s);
        Some((
            error.abs(),
            (found.sigma_rad().powi(2) - 1e-8).max(0.0).sqrt(),
        ))
    }

    #[test]
    fn frames_own_times_count_unless_the_clock_has_made_a_step() {
        let start = Instant::now();
        let middle = |utc_ms: i64, arrived_ms: u64| MidExposure {
            utc: Some(Timestamp::from_millisecond(utc_ms).unwrap()),
            by_arrival: start + Duration::from_millis(arrived_ms),
        };
        let first = middle(1_000_000, 3000);
        assert_eq!(first.until(&middle(1_000_250, 3900)), 0.25);
        assert_eq!(first.until(&middle(999_750, 2700)), -0.25);
        assert_eq!(first.until(&middle(4_600_250, 3300)), 0.3);
    }

    #[test]
    fn a_nadir_turns_on_as_the_body_does_and_is_as_certain_as_it_says() {
        let frames: Vec<f64> = (0..60).map(|n| f64::from(n) * 0.25).collect();
        let mut sum = 0.0;
        for count in 20..60 {
            let last_s = frames[count - 1];
            let (error, sigma) = error_and_sigma(&frames[..count], last_s + 0.25).unwrap();
            // Less than half of the turn where the swing is fastest.
            assert!(error < 0.45 * 0.25 * 0.034, "{error}");
            sum += (error / sigma).powi(2);
        }
        let ratio = (sum / 40.0).sqrt();
        assert!((0.5..1.6).contains(&ratio), "{ratio}");
    }

    #[test]
    fn a_nadir_is_less_certain_the_further_away_it_is_and_serves_for_a_while() {
        let sigma = |frames_s: &[f64], time_s| Some(error_and_sigma(frames_s, time_s)?.1);
        let is = |sigma: Option<f64>, expected: f64| (sigma.unwrap() - expected).abs() < 1e-9;
        assert!(is(sigma(&[1.0], 1.0), 0.0));
        assert!(is(sigma(&[1.0], 1.5), 0.5 * DEFAULT_RAD_PER_S));
        // An exposure before the frame is as far away as one after it.
        assert!(is(sigma(&[1.0], 0.5), 0.5 * DEFAULT_RAD_PER_S));
        assert_eq!(sigma(&[1.0], 2.001), None);
        // After a gap the turn rate is unknown.
        assert!(is(sigma(&[1.0, 1.5, 9.0], 9.5), 0.5 * DEFAULT_RAD_PER_S));
    }
}
