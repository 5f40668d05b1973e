//! Uncertainty of the attitude while directions contradict the filter.
//!
//! 1. A direction is rejected: either it or the filter may be wrong. The stated attitude's covariance includes the
//!    difference at once.
//! 2. If the next one of its kind is accepted, the first was wrong, and the doubt ends.
//! 3. If the next one is rejected as well, and no single error of the sensor explains both, the gyros were wrong. The
//!    attitude restarts from this direction, and the gyros get an additional noise according to the directions from then
//!    on, which decays while they agree.
//!
//! If a more precise direction agreed with the filter in between, the less precise one is in doubt, and only the angle
//! about the more precise one may be wrong.
//!
//! The doubt ends within seconds after the filter follows the directions, whether they or the gyros are wrong. `comparison`
//! continues to compare them with the previous gyro attitude.
//!
//! Two successive velocities that contradict the filter, or velocities that deviate to one side for a long time, have the
//! same effect for the accelerometers: the attitude no longer follows their measurements.

use super::filter::MOST_CHI2 as REFUSED_CHI2;
use super::measurement::{DirectionObservation, Innovation, Source, Verdict};
use super::states::Sensors;
use nalgebra::{Matrix3, UnitVector3, Vector2, Vector3};

/// Decay time of the doubt about gyros and accelerometers, s.
const GYROS_FADE_S: f64 = 1.0;
const ACCELEROMETERS_FADE_S: f64 = 10.0;
/// Measurements farther apart are independent of the sensors, s.
const LONGEST_S: f64 = 1.0;
/// Number of velocities in the mean, and limit of its chi^2 (three axes, in sigmas) above which the velocities deviate to
/// one side.
const VELOCITIES: f64 = 30.0;
pub(super) const ONE_SIDED_CHI2: f64 = 16.0;
/// A difference with a larger chi^2 (two axes) is attributed to the gyros.
const MOST_CHI2: f64 = 9.0;
/// A doubt below this share of the directions' own variance is ignored.
const NO_DOUBT: f64 = 0.1;
/// An error that began just before a direction was observed grows by its own amount in this share of the time since the
/// previous direction.
const JUST_BEFORE: f64 = 0.2;
/// A larger difference is beyond the filter's linear range, rad.
pub(super) const LOST_RAD: f64 = 0.1;

/// Two rejected directions contradict the gyros above this chi^2 of both together: that of two independent ones.
const BOTH_CHI2: f64 = 2.0 * REFUSED_CHI2[0];
/// Maximum correlation of two directions.
const MOST_CORRELATION: f64 = 0.99;

/// The part of a direction's error that is correlated in time (a Gauss-Markov process).
#[derive(Debug, Clone, Copy)]
pub(super) struct CorrelatedError {
    pub variance_rad2: f64,
    pub time_s: f64,
}

/// A direction relative to the filter's prediction.
#[derive(Debug, Clone, Copy)]
struct Found {
    t_s: f64,
    /// Predicted direction in ECEF.
    towards: UnitVector3<f64>,
    sigma_rad: f64,
    difference_rad: f64,
    /// Time since the last accepted direction of its kind.
    after_s: f64,
}

/// A kind of direction that contradicts the filter.
#[derive(Debug, Clone)]
struct Refused {
    source: Source,
    found: Found,
    /// The whitened innovation of the first rejected direction, and its time.
    first: (Vector2<f64>, f64),
    /// A more precise direction that has agreed with the filter since.
    finer: Option<UnitVector3<f64>>,
}

impl Refused {
    /// Whether this direction and the first one cannot have one error of the sensor in common.
    fn is_confirmed(&self, innovation: &Innovation, error: Option<CorrelatedError>) -> bool {
        let (first, first_s) = self.first;
        let correlation = error.map_or(0.0, |error| {
            let predicted2: f64 = innovation.axes.iter().map(|(_, sigma)| sigma * sigma).sum();
            let share = 2.0 * error.variance_rad2 / predicted2;
            share * (-(innovation.t_s - first_s).abs() / error.time_s).exp()
        });
        both_chi2(
            first,
            whitened(innovation),
            correlation.min(MOST_CORRELATION),
        ) > BOTH_CHI2
    }
}

fn whitened(innovation: &Innovation) -> Vector2<f64> {
    Vector2::from_iterator(innovation.whitened.iter().copied())
}

/// chi^2 (four axes) of two vectors in sigmas whose errors have this correlation in each axis.
fn both_chi2(first: Vector2<f64>, second: Vector2<f64>, correlation: f64) -> f64 {
    let own = first.norm_squared() + second.norm_squared();
    (own - 2.0 * correlation * first.dot(&second)) / (1.0 - correlation * correlation)
}

/// Action after a rejected direction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Remedy {
    Wait,
    /// The attitude has this additional uncertainty about each axis.
    Open {
        rad: f64,
    },
    /// The filter restarts.
    BeginAnew,
}

/// The current doubts.
#[derive(Debug, Clone, Default)]
pub(super) struct Doubts {
    refused: Vec<Refused>,
    /// Time of the last accepted direction of each kind.
    taken: Vec<(Source, f64)>,
    /// Additional noise of the sensors as the square of a random walk, rad^2/s and m^2/s^3.
    gyros: f64,
    accelerometers: f64,
    velocity: Velocity,
}

/// State derived from velocities.
#[derive(Debug, Clone, Default)]
struct Velocity {
    /// The mean of the latest whitened innovations.
    mean: Vector3<f64>,
    last_s: Option<f64>,
    refused: u32,
}

impl Velocity {
    /// Whether the velocities deviate to one side: with good accelerometers this occurs once in 15 h at 1 Hz.
    fn is_one_sided(&self) -> bool {
        let share = 1.0 / VELOCITIES;
        self.mean.norm_squared() * (2.0 - share) / share > ONE_SIDED_CHI2
    }
}

impl Doubts {
    /// The additional random walk of sensors, rad/sqrt(s) or m/s/sqrt(s).
    pub fn random_walk(&self, sensors: Sensors) -> f64 {
        match sensors {
            Sensors::Accelerometers => self.accelerometers.sqrt(),
            Sensors::Gyros => self.gyros.sqrt(),
        }
    }

    /// Until directions agree with them, the gyros may be off by the body's rate, rad/s: the rotation about a direction is
    /// not observable otherwise.
    pub fn unproven(&mut self, rate_rad_s: f64) {
        self.gyros = self.gyros.max(rate_rad_s.powi(2) * LONGEST_S);
    }

    /// Whether directions contradict the gyros.
    pub fn any(&self) -> bool {
        self.gyros > 0.0 || self.refused.iter().any(|one| one.finer.is_none())
    }

    /// Whether the filter accepts directions of every kind, and the gyros are not in doubt.
    pub fn is_settled(&self) -> bool {
        self.gyros == 0.0 && self.refused.is_empty()
    }

    /// Variance that the doubts add to the attitude about the axes of ECEF, rad^2.
    pub fn covariance(&self, t_s: f64) -> Matrix3<f64> {
        let of_one = |one: &Refused| {
            let Found { towards, .. } = one.found;
            let grown = (t_s - one.found.t_s).max(0.0) / (JUST_BEFORE * one.found.after_s);
            let known_s = one.found.after_s > 0.0;
            let rad = one.found.difference_rad * (1.0 + if known_s { grown } else { 0.0 });
            let across = |unit: &UnitVector3<f64>| unit.into_inner() * unit.transpose();
            let free = match &one.finer {
                Some(finer) => across(finer),
                None => Matrix3::identity() - across(&towards),
            };
            free * rad.powi(2)
        };
        self.refused.iter().map(of_one).sum()
    }

    /// Takes in an accepted direction.
    pub fn take(
        &mut self,
        observation: &DirectionObservation,
        towards: UnitVector3<f64>,
        innovation: &Innovation,
    ) {
        let found = self.found(observation, towards, innovation);
        self.refused.retain(|one| one.source != innovation.source);
        for other in &mut self.refused {
            if found.sigma_rad <= other.found.sigma_rad {
                other.finer = Some(towards);
            }
        }
        self.judge_gyros(&found, innovation);
        match self
            .taken
            .iter_mut()
            .find(|(source, _)| *source == innovation.source)
        {
            Some((_, t_s)) => *t_s = found.t_s,
            None => self.taken.push((innovation.source, found.t_s)),
        }
    }

    /// Takes in a rejected direction, observed while the body rotated at a rate, with the correlated part of its error.
    pub fn refuse(
        &mut self,
        observation: &DirectionObservation,
        towards: UnitVector3<f64>,
        innovation: &Innovation,
        rate_rad_s: f64,
        error: Option<CorrelatedError>,
    ) -> Remedy {
        let found = self.found(observation, towards, innovation);
        let source = innovation.source;
        let known = self.refused.iter().position(|one| one.source == source);
        let finer = known.and_then(|n| self.refused[n].finer);
        let is_confirmed = known.is_some_and(|n| self.refused[n].is_confirmed(innovation, error));
        let is_doubted = self.gyros > 0.0 || is_confirmed;
        if finer.is_none() && is_doubted {
            self.refused.retain(|one| one.source != source);
            if found.difference_rad > LOST_RAD {
                return Remedy::BeginAnew;
            }
            self.doubt_gyros(&found);
            self.unproven(rate_rad_s);
            let rad = found.difference_rad;
            return Remedy::Open { rad };
        }
        match known {
            Some(n) => self.refused[n].found = found,
            None => self.refused.push(Refused {
                source,
                found,
                first: (whitened(innovation), found.t_s),
                finer,
            }),
        }
        Remedy::Wait
    }

    /// Takes in the innovation of a velocity. Returns the variance to add to the velocity, m^2/s^2.
    pub fn note_velocity(&mut self, innovation: &Innovation) -> Option<f64> {
        if innovation.source != Source::Velocity {
            return None;
        }
        let t_s = innovation.t_s;
        let last_s = self.velocity.last_s.replace(t_s);
        let since_s = last_s.map_or(LONGEST_S, |last_s| (t_s - last_s).min(LONGEST_S));
        if since_s <= 0.0 {
            return None;
        }
        self.velocity.refused = match innovation.verdict {
            Verdict::Taken => 0,
            Verdict::Refused => self.velocity.refused + 1,
        };
        let axes = &innovation.axes;
        let known = Vector3::from_iterator(innovation.whitened.iter().copied());
        let clipped = known.cap_magnitude(ONE_SIDED_CHI2.sqrt());
        self.velocity.mean += (clipped - self.velocity.mean) / VELOCITIES;
        let was_doubted = self.accelerometers > 0.0;
        self.accelerometers *= (-since_s / ACCELEROMETERS_FADE_S).exp();
        let off2: f64 = axes.iter().map(|(r, _)| r * r).sum();
        let own2: f64 = axes.iter().map(|(_, sigma)| sigma * sigma).sum();
        if self.velocity.refused < 2 && !self.velocity.is_one_sided() {
            if self.accelerometers * since_s < NO_DOUBT * own2 {
                self.accelerometers = 0.0;
            }
            return None;
        }
        self.accelerometers = self.accelerometers.max(off2.max(own2) / since_s);
        (!was_doubted).then_some(off2)
    }

    fn found(
        &self,
        observation: &DirectionObservation,
        towards: UnitVector3<f64>,
        innovation: &Innovation,
    ) -> Found {
        let own = |(source, _): &&(Source, f64)| *source == innovation.source;
        let last_s = self.taken.iter().find(own).map(|(_, t_s)| *t_s);
        let squares = innovation.axes.iter().map(|(residual, _)| residual.powi(2));
        Found {
            t_s: observation.t_s,
            towards,
            sigma_rad: observation.sigma_rad,
            difference_rad: squares.sum::<f64>().sqrt(),
            after_s: last_s.map_or(LONGEST_S, |last_s| {
                (observation.t_s - last_s).min(LONGEST_S)
            }),
        }
    }

    fn doubt_gyros(&mut self, found: &Found) {
        if found.after_s > 0.0 {
            let shown = found.difference_rad.powi(2) / found.after_s;
            self.gyros = self.gyros.max(shown);
        }
    }

    /// Reduces the doubt about the gyros while directions agree with them.
    fn judge_gyros(&mut self, found: &Found, innovation: &Innovation) {
        if self.gyros == 0.0 || found.after_s <= 0.0 {
            return;
        }
        let doubted = self.gyros * found.after_s;
        let own = found.sigma_rad.powi(2);
        // The expected variance of the difference without the doubt.
        let without = |sigma: f64| (sigma * sigma - doubted).max(own);
        let axes = innovation.axes.iter();
        let chi2: f64 = axes.map(|(r, sigma)| r * r / without(*sigma)).sum();
        self.gyros *= (-found.after_s / GYROS_FADE_S).exp();
        if chi2 > MOST_CHI2 {
            self.doubt_gyros(found);
        } else if self.gyros * found.after_s < NO_DOUBT * own {
            self.gyros = 0.0;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::navigation::measurement::Towards;
    use crate::navigation::settings::Target;

    const SUN: UnitVector3<f64> = UnitVector3::new_unchecked(Vector3::new(1.0, 0.0, 0.0));
    const DOWN: UnitVector3<f64> = UnitVector3::new_unchecked(Vector3::new(0.0, 0.0, 1.0));

    fn observation(t_s: f64, target: Target, sigma_rad: f64) -> DirectionObservation {
        DirectionObservation {
            t_s,
            camera: 0,
            target,
            unit: SUN,
            sigma_rad,
            towards: Towards::Down,
        }
    }

    fn innovation(
        observation: &DirectionObservation,
        off_rad: f64,
        verdict: Verdict,
    ) -> Innovation {
        let sigma = observation.sigma_rad;
        Innovation {
            t_s: observation.t_s,
            source: Source::Direction {
                camera: observation.camera,
                target: observation.target,
            },
            axes: vec![(off_rad, sigma), (0.0, sigma)],
            whitened: vec![off_rad / sigma, 0.0],
            chi2: (off_rad / sigma).powi(2),
            verdict,
        }
    }

    fn sun(doubts: &mut Doubts, t_s: f64, off_rad: f64) -> Remedy {
        let observation = observation(t_s, Target::Sun, 1e-6);
        if off_rad < 5e-6 {
            let innovation = innovation(&observation, off_rad, Verdict::Taken);
            doubts.take(&observation, SUN, &innovation);
            return Remedy::Wait;
        }
        doubts.refuse(
            &observation,
            SUN,
            &innovation(&observation, off_rad, Verdict::Refused),
            1e-9,
            None,
        )
    }

    #[test]
    fn a_direction_that_is_wrong_alone_is_held_at_once_and_dropped_with_the_next() {
        let mut doubts = Doubts::default();
        sun(&mut doubts, 0.0, 0.0);
        assert_eq!(sun(&mut doubts, 0.25, 1e-3), Remedy::Wait);
        let held = doubts.covariance(0.25);
        assert!((held[(1, 1)].sqrt() - 1e-3).abs() < 1e-9 && held[(0, 0)] == 0.0);
        // The error may have begun just before the frame.
        assert!(doubts.covariance(0.5)[(2, 2)].sqrt() > 5e-3);
        sun(&mut doubts, 0.5, 0.0);
        assert!(!doubts.any() && doubts.covariance(0.5).norm() == 0.0);
    }

    #[test]
    fn two_directions_in_a_row_are_right_and_the_gyros_are_doubted_until_others_agree() {
        let mut doubts = Doubts::default();
        sun(&mut doubts, 0.0, 0.0);
        sun(&mut doubts, 0.25, 1e-3);
        assert_eq!(sun(&mut doubts, 0.5, 2e-3), Remedy::Open { rad: 2e-3 });
        let walk = doubts.random_walk(Sensors::Gyros);
        assert!((walk - 2e-3 / 0.5f64.sqrt()).abs() < 1e-9, "{walk}");
        for n in 2..80 {
            sun(&mut doubts, 0.25 * f64::from(n), 1e-7);
        }
        assert!(!doubts.any());
        // The rotation about the direction is not observable: the gyros may be off by the body's rate.
        let (one, two) = [20.0, 20.25]
            .map(|t_s| observation(t_s, Target::Sun, 1e-6))
            .into();
        for refused in [one, two] {
            let innovation = innovation(&refused, 1e-5, Verdict::Refused);
            doubts.refuse(&refused, SUN, &innovation, 1e-3, None);
        }
        assert!(doubts.random_walk(Sensors::Gyros) >= 1e-3);
        // While in doubt, one rejection suffices; a large difference is beyond the linear range.
        assert_eq!(sun(&mut doubts, 20.5, 0.2), Remedy::BeginAnew);
    }

    #[test]
    fn one_error_of_the_sensor_in_two_directions_does_not_accuse_the_gyros() {
        let both = |off_rad: f64, error| {
            let mut doubts = Doubts::default();
            let remedies = [1.0, 1.25].map(|t_s| {
                let observation = observation(t_s, Target::Nadir, 1e-3);
                let innovation = innovation(&observation, off_rad, Verdict::Refused);
                doubts.refuse(&observation, DOWN, &innovation, 1e-9, error)
            });
            (remedies[1], doubts)
        };
        let lasting = Some(CorrelatedError {
            variance_rad2: 0.98e-6,
            time_s: 20.0,
        });
        // 5 sigma: improbable twice, but not once in 200 flights.
        let (remedy, doubts) = both(5e-3, lasting);
        assert_eq!(remedy, Remedy::Wait);
        assert!(doubts.covariance(1.25)[(0, 0)].sqrt() >= 5e-3 * (1.0 - 1e-9));
        assert_eq!(both(5e-3, None).0, Remedy::Open { rad: 5e-3 });
        assert_eq!(both(7e-3, lasting).0, Remedy::Open { rad: 7e-3 });
    }

    #[test]
    fn a_coarser_direction_that_a_finer_one_contradicts_determines_the_angle_about_it_alone() {
        let mut doubts = Doubts::default();
        let nadir = |doubts: &mut Doubts, t_s| {
            let observation = observation(t_s, Target::Nadir, 1e-3);
            doubts.refuse(
                &observation,
                DOWN,
                &innovation(&observation, 0.01, Verdict::Refused),
                1e-9,
                None,
            )
        };
        assert_eq!(nadir(&mut doubts, 1.0), Remedy::Wait);
        sun(&mut doubts, 1.1, 0.0);
        for n in 0..20 {
            assert_eq!(nadir(&mut doubts, 1.2 + 0.1 * f64::from(n)), Remedy::Wait);
        }
        let held = doubts.covariance(3.1);
        assert!(held[(0, 0)].sqrt() >= 0.0099 && held[(1, 1)] == 0.0 && held[(2, 2)] == 0.0);
        assert!(!doubts.any());
    }
}
