//! What is not known of the attitude where directions contradict the filter.
//!
//! 1. A direction is refused: it may be wrong, or the filter. What is told of the attitude holds the difference at once.
//! 2. The next one of its kind is taken, as well: the first was wrong, and the doubt is gone.
//! 3. It is refused, too: the gyros were wrong. The attitude begins anew from it, and the gyros are believed as far only as directions show
//!    from then on; that fades while they agree.
//!
//! Where a finer direction agreed with the filter meanwhile, the coarser one is in doubt, and what it might tell is the angle about the finer.
//!
//! Directions that are taken and lie on one side of the filter for long contradict the gyros, too: it follows them too slowly.
//!
//! Velocities that contradict the filter twice, or lie on one side of it for long, do the same for the accelerometers: the attitude does not
//! follow what they feel.

use super::measurement::{Innovation, Sighting, Source, Verdict};
use super::states::Sensors;
use nalgebra::{Matrix3, UnitVector3, Vector3};

/// Gyros and accelerometers are believed again over so long, s.
const GYROS_FADE_S: f64 = 1.0;
const ACCELEROMETERS_FADE_S: f64 = 10.0;
/// Measurements further apart tell no more of them, s.
const LONGEST_S: f64 = 1.0;
/// The mean of so many innovations, in their sigmas, is on one side where its chi^2 is larger than this: of the three axes of velocities once
/// in 15 h at 1 Hz where all is well, of the two of directions once in a thousand hours at 26 Hz.
const MEAN_OF: f64 = 30.0;
pub(super) const ONE_SIDED_CHI2: f64 = 16.0;
const ONE_SIDED_DIRECTIONS_CHI2: f64 = 30.0;
/// A difference with a larger chi^2 of its two axes is the gyros'.
const MOST_CHI2: f64 = 9.0;
/// Less doubt than this share of the directions' own error is none.
const NO_DOUBT: f64 = 0.1;
/// An error that began just before a direction grows by as much in this share of the time to the next.
const JUST_BEFORE: f64 = 0.2;
/// A larger difference is beyond what the filter can correct, rad.
pub(super) const LOST_RAD: f64 = 0.1;

/// A direction as the filter finds it.
#[derive(Debug, Clone, Copy)]
struct Found {
    t_s: f64,
    /// In ECEF.
    towards: UnitVector3<f64>,
    sigma_rad: f64,
    difference_rad: f64,
    /// How fast the body turns, as the gyros say.
    rate_rad_s: f64,
    /// Since the last one of its kind that was taken.
    after_s: f64,
}

/// A kind of direction that contradicts the filter.
#[derive(Debug, Clone)]
struct Refused {
    source: Source,
    found: Found,
    /// A finer direction that agreed with the filter since.
    finer: Option<UnitVector3<f64>>,
}

/// What is to be done about a refused direction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Remedy {
    Wait,
    /// The attitude is unknown by this, about each axis.
    Open {
        rad: f64,
    },
    /// The filter begins anew.
    BeginAnew,
}

/// The doubts at a time.
#[derive(Debug, Clone, Default)]
pub(super) struct Doubts {
    refused: Vec<Refused>,
    taken: Vec<Taken>,
    /// How far the sensors are doubted, as the square of a random walk beside their own, rad^2/s and m^2/s^3.
    gyros: f64,
    accelerometers: f64,
    velocity: Velocity,
}

/// What velocities have told.
#[derive(Debug, Clone, Default)]
struct Velocity {
    mean: Mean,
    last_s: Option<f64>,
    refused: u32,
}

/// A kind of direction that was taken.
#[derive(Debug, Clone)]
struct Taken {
    source: Source,
    /// Of the last one.
    t_s: f64,
    mean: Mean,
}

/// The mean of the last innovations of a kind, whitened.
#[derive(Debug, Clone, Default)]
struct Mean(Vector3<f64>);

impl Mean {
    /// Notes another one; chi^2 of the mean.
    fn note(&mut self, innovation: &Innovation) -> f64 {
        let axis = |n: usize, _| innovation.whitened.get(n).copied().unwrap_or_default();
        let shown = Vector3::from_fn(axis).cap_magnitude(ONE_SIDED_CHI2.sqrt());
        self.0 += (shown - self.0) / MEAN_OF;
        self.0.norm_squared() * (2.0 * MEAN_OF - 1.0)
    }
}

impl Doubts {
    /// The random walk of sensors by the doubts, rad/sqrt(s) or m/s/sqrt(s).
    pub fn random_walk(&self, sensors: Sensors) -> f64 {
        match sensors {
            Sensors::Accelerometers => self.accelerometers.sqrt(),
            Sensors::Gyros => self.gyros.sqrt(),
        }
    }

    /// Until directions agree with them the gyros may be off by as much as the body turns, rad/s: about a direction nothing else shows it.
    pub fn unproven(&mut self, rate_rad_s: f64) {
        self.gyros = self.gyros.max(rate_rad_s.powi(2) * LONGEST_S);
    }

    /// Whether directions contradict the gyros.
    pub fn any(&self) -> bool {
        self.gyros > 0.0 || self.refused.iter().any(|one| one.finer.is_none())
    }

    /// What they add to the covariance of the attitude about the axes of ECEF, rad^2.
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

    /// Notes a direction that was taken.
    pub fn take(
        &mut self,
        sighting: &Sighting,
        (towards, rate_rad_s): (UnitVector3<f64>, f64),
        innovation: &Innovation,
    ) -> Remedy {
        let found = self.found(sighting, (towards, rate_rad_s), innovation);
        self.refused.retain(|one| one.source != innovation.source);
        for other in &mut self.refused {
            if found.sigma_rad <= other.found.sigma_rad {
                other.finer = Some(towards);
            }
        }
        self.judge_gyros(&found, innovation);
        if self.note_taken(innovation) <= ONE_SIDED_DIRECTIONS_CHI2 {
            return Remedy::Wait;
        }
        let was_doubted = self.gyros > 0.0;
        self.doubt_gyros(&found);
        if was_doubted {
            return Remedy::Wait;
        }
        self.unproven(found.rate_rad_s);
        let rad = found.difference_rad;
        Remedy::Open { rad }
    }

    /// Chi^2 of the mean of the last ones of its kind.
    fn note_taken(&mut self, innovation: &Innovation) -> f64 {
        let (source, t_s) = (innovation.source, innovation.t_s);
        let known = self.taken.iter().position(|taken| taken.source == source);
        let n = known.unwrap_or_else(|| {
            let mean = Mean::default();
            self.taken.push(Taken { source, t_s, mean });
            self.taken.len() - 1
        });
        self.taken[n].t_s = t_s;
        self.taken[n].mean.note(innovation)
    }

    /// Notes one that was refused.
    pub fn refuse(
        &mut self,
        sighting: &Sighting,
        (towards, rate_rad_s): (UnitVector3<f64>, f64),
        innovation: &Innovation,
    ) -> Remedy {
        let found = self.found(sighting, (towards, rate_rad_s), innovation);
        let source = innovation.source;
        let known = self.refused.iter().position(|one| one.source == source);
        let finer = known.and_then(|n| self.refused[n].finer);
        let is_doubted = self.gyros > 0.0 || known.is_some();
        if finer.is_none() && is_doubted {
            self.refused.retain(|one| one.source != source);
            if found.difference_rad > LOST_RAD {
                return Remedy::BeginAnew;
            }
            self.doubt_gyros(&found);
            self.unproven(found.rate_rad_s);
            let rad = found.difference_rad;
            return Remedy::Open { rad };
        }
        match known {
            Some(n) => self.refused[n].found = found,
            None => self.refused.push(Refused {
                source,
                found,
                finer,
            }),
        }
        Remedy::Wait
    }

    /// Notes what a velocity has told; the variance of velocity that is unknown by it, m^2/s^2.
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
        let is_one_sided = self.velocity.mean.note(innovation) > ONE_SIDED_CHI2;
        let was_doubted = self.accelerometers > 0.0;
        self.accelerometers *= (-since_s / ACCELEROMETERS_FADE_S).exp();
        let off2: f64 = axes.iter().map(|(r, _)| r * r).sum();
        let own2: f64 = axes.iter().map(|(_, sigma)| sigma * sigma).sum();
        if self.velocity.refused < 2 && !is_one_sided {
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
        sighting: &Sighting,
        (towards, rate_rad_s): (UnitVector3<f64>, f64),
        innovation: &Innovation,
    ) -> Found {
        let own = |taken: &&Taken| taken.source == innovation.source;
        let last_s = self.taken.iter().find(own).map(|taken| taken.t_s);
        let squares = innovation.axes.iter().map(|(residual, _)| residual.powi(2));
        Found {
            t_s: sighting.t_s,
            towards,
            sigma_rad: sighting.sigma_rad,
            difference_rad: squares.sum::<f64>().sqrt(),
            rate_rad_s,
            after_s: last_s.map_or(LONGEST_S, |last_s| (sighting.t_s - last_s).min(LONGEST_S)),
        }
    }

    fn doubt_gyros(&mut self, found: &Found) {
        if found.after_s > 0.0 {
            let shown = found.difference_rad.powi(2) / found.after_s;
            self.gyros = self.gyros.max(shown);
        }
    }

    /// Gyros in doubt are believed again while directions agree with them.
    fn judge_gyros(&mut self, found: &Found, innovation: &Innovation) {
        if self.gyros == 0.0 || found.after_s <= 0.0 {
            return;
        }
        let doubted = self.gyros * found.after_s;
        let own = found.sigma_rad.powi(2);
        // What the difference would be expected to be without the doubt.
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

    fn sighting(t_s: f64, target: Target, sigma_rad: f64) -> Sighting {
        Sighting {
            t_s,
            camera: 0,
            target,
            unit: SUN,
            sigma_rad,
            towards: Towards::Down,
        }
    }

    fn innovation(sighting: &Sighting, off_rad: f64, verdict: Verdict) -> Innovation {
        let sigma = sighting.sigma_rad;
        Innovation {
            t_s: sighting.t_s,
            source: Source::Sighting {
                camera: sighting.camera,
                target: sighting.target,
            },
            axes: vec![(off_rad, sigma), (0.0, sigma)],
            whitened: vec![off_rad / sigma, 0.0],
            chi2: (off_rad / sigma).powi(2),
            verdict,
        }
    }

    fn sun(doubts: &mut Doubts, t_s: f64, off_rad: f64) -> Remedy {
        let sighting = sighting(t_s, Target::Sun, 1e-6);
        if off_rad < 5e-6 {
            let innovation = innovation(&sighting, off_rad, Verdict::Taken);
            doubts.take(&sighting, (SUN, 0.0), &innovation);
            return Remedy::Wait;
        }
        doubts.refuse(
            &sighting,
            (SUN, 0.0),
            &innovation(&sighting, off_rad, Verdict::Refused),
        )
    }

    #[test]
    fn a_direction_that_is_wrong_alone_is_held_at_once_and_forgotten_with_the_next() {
        let mut doubts = Doubts::default();
        sun(&mut doubts, 0.0, 0.0);
        assert_eq!(sun(&mut doubts, 0.25, 1e-3), Remedy::Wait);
        let held = doubts.covariance(0.25);
        assert!((held[(1, 1)].sqrt() - 1e-3).abs() < 1e-9 && held[(0, 0)] == 0.0);
        // It may have begun just before the frame.
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
        // In doubt one is enough, and what is too far off is beyond a correction.
        sun(&mut doubts, 20.0, 1e-3);
        sun(&mut doubts, 20.25, 1e-3);
        assert_eq!(sun(&mut doubts, 20.5, 0.2), Remedy::BeginAnew);
    }

    #[test]
    fn directions_on_one_side_contradict_the_gyros_though_each_is_taken() {
        let mut doubts = Doubts::default();
        let taken = |doubts: &mut Doubts, n: i32, off_rad: f64| {
            let sighting = sighting(0.04 * f64::from(n), Target::Sun, 1e-6);
            let innovation = innovation(&sighting, off_rad, Verdict::Taken);
            doubts.take(&sighting, (SUN, 1e-3), &innovation)
        };
        for n in 0..500 {
            let off_rad = if n % 2 == 0 { 2e-6 } else { -2e-6 };
            assert_eq!(taken(&mut doubts, n, off_rad), Remedy::Wait);
        }
        let opens = |n: i32| matches!(taken(&mut doubts, n, 2e-6), Remedy::Open { .. });
        assert!((500..530).any(opens));
        // About the direction nothing else shows how far the gyros are off.
        assert!(doubts.random_walk(Sensors::Gyros) > 0.9e-3);
    }

    #[test]
    fn a_coarser_direction_that_a_finer_one_contradicts_tells_of_the_angle_about_it_alone() {
        let mut doubts = Doubts::default();
        let nadir = |doubts: &mut Doubts, t_s| {
            let sighting = sighting(t_s, Target::Nadir, 1e-3);
            doubts.refuse(
                &sighting,
                (DOWN, 0.0),
                &innovation(&sighting, 0.01, Verdict::Refused),
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
