//! The circle that most crossings agree on: random sample consensus (Fischler and Bolles 1981), then least squares.

use super::chords::Crossing;
use super::{LimbSettings, arc_fraction};
use crate::estimation::{
    CONTRADICTION_SIGMAS, Fitted, LeastSquares, Linearised, Loss, Prior, Scale, TUKEY_SIGMAS,
};
use crate::geometry::Circle;
use crate::reasons::sun;
use crate::units::{Measured, Rejected};
use nalgebra::{Matrix2, RowVector3, SVector, Vector1, Vector2, Vector3};

/// Distance from the circle within which a crossing agrees with it, px.
const AGREEMENT_PX: f64 = 2.0;
/// Crossings within this fraction of the radius from the circle belong to the same bright patch.
const NEAR: f64 = 0.25;
/// Lower bound of a crossing's sigma, px: marks, haze and the sensor's tilt cause at least this error.
const CROSSING_SIGMA_PX: f64 = 0.1;
/// Maximum number of trial circles. On a clean disc nineteen of twenty crossings agree, and a dozen trials suffice.
const MOST_TRIALS: usize = 400;
const LEAST_TRIALS: usize = 12;
/// Trials end when the probability of never having picked three agreeing crossings falls below this.
const LEAST_DOUBT: f64 = 1e-4;
/// Minimum fraction of the crossings near the circle that must agree with it.
const LEAST_AGREEING: f64 = 0.6;
/// A shorter arc does not distinguish a disc from a speck at the sensor's edge.
const LEAST_ARC: f64 = 0.1;
/// Relative uncertainty of the expected radius, 1 sigma.
const RADIUS_SIGMA: f64 = 0.003;
/// The limb's own radius is used if its relative sigma is below this.
const WELL_DETERMINED: f64 = 0.001;
/// Largest acceptable sigma of the centre, px.
const MAX_CENTRE_SIGMA_PX: f64 = 1.0;

/// The circle of nearly the expected radius that most crossings lie on.
pub(super) fn agreed_circle(
    crossings: &[Crossing],
    radius_px: f64,
    settings: &LimbSettings,
) -> Result<Circle, Rejected> {
    let enough = settings.min_crossings as f64;
    let count = crossings.len() as f64;
    Rejected::at_least(enough, count, sun::FEW_CHORDS)?;
    let consensus = Consensus {
        crossings,
        radius_px,
        settings,
    };
    let best = consensus.best_circle();
    let agreeing = best.map_or(0, |circle| consensus.on(&circle).count()) as f64;
    let reason = sun::NO_CIRCLE;
    Rejected::at_least(enough, agreeing, reason)?;
    let fit = best
        .and_then(|circle| consensus.refined(&circle))
        .ok_or(Rejected {
            reason: sun::CIRCLE_UNDETERMINED,
            measured: agreeing,
            limit: enough,
        })?;
    consensus.check(&fit)?;
    Ok(circle_of(&fit.parameters))
}

/// Crossings, and the prior knowledge of their circle.
struct Consensus<'a> {
    crossings: &'a [Crossing],
    radius_px: f64,
    settings: &'a LimbSettings,
}

impl Consensus<'_> {
    /// The best of many circles: through three crossings if much of the limb is visible, or of the expected radius through
    /// two crossings if little is. Crossings are chosen by a fixed sequence, so that the same frame always gives the same
    /// disc.
    fn best_circle(&self) -> Option<Circle> {
        let mut pick = Sequence::new(self.crossings.len());
        let (mut best, mut least_cost) = (None, f64::INFINITY);
        let mut trials = MOST_TRIALS;
        let mut trial = 0;
        while trial < trials {
            trial += 1;
            let [a, b, c] = std::array::from_fn(|_| &self.crossings[pick.next_index()]);
            let candidate = match trial % 2 {
                0 => Circle::through(a.at, b.at, c.at),
                _ => of_radius_through(a, b, self.radius_px),
            };
            let Some(circle) = candidate.filter(|circle| self.is_of_size(circle)) else {
                continue;
            };
            let cost = self.cost_px2(&circle);
            if cost < least_cost {
                (best, least_cost) = (Some(circle), cost);
                let share = self.on(&circle).count() as f64 / self.crossings.len() as f64;
                trials = trials_for(share);
            }
        }
        best
    }

    fn is_of_size(&self, circle: &Circle) -> bool {
        (circle.radius / self.radius_px - 1.0).abs() <= self.settings.max_radius_deviation
    }

    /// The crossings that lie on a circle, with their bright side inwards.
    fn on(&self, circle: &Circle) -> impl Iterator<Item = &Crossing> + Clone {
        let circle = *circle;
        let agrees = move |c: &&Crossing| departure_px(c, &circle) < AGREEMENT_PX;
        self.crossings.iter().filter(agrees)
    }

    /// Sum of squared distances from a circle; a crossing that disagrees counts with the agreement limit.
    fn cost_px2(&self, circle: &Circle) -> f64 {
        let departures = self.crossings.iter().map(|c| departure_px(c, circle));
        departures.map(|px| px.min(AGREEMENT_PX).powi(2)).sum()
    }

    /// The circle through all agreeing crossings. Its radius is fitted if they determine it well, or if it clearly differs
    /// from the expected radius; on a shorter arc it is held at the expected radius.
    fn refined(&self, start: &Circle) -> Option<Fitted<3>> {
        let fit = |sigma: f64| {
            let radius_px = Measured::new(self.radius_px, sigma * self.radius_px);
            fitted(self.on(start), start, radius_px)
        };
        let determined = |fit: &Fitted<3>| {
            let radius = fit.measured(2);
            let limit = CONTRADICTION_SIGMAS * radius.sigma.hypot(RADIUS_SIGMA * self.radius_px);
            let plainly = (radius.value - self.radius_px).abs() > limit
                && centre_sigma_px(fit) < MAX_CENTRE_SIGMA_PX;
            let well = radius.sigma < WELL_DETERMINED * self.radius_px;
            (well || plainly) && self.is_of_size(&circle_of(&fit.parameters))
        };
        fit(self.settings.max_radius_deviation)
            .filter(determined)
            .or_else(|| fit(RADIUS_SIGMA))
    }

    /// Checks that the arc is long enough, the centre is well determined, and most crossings near the circle agree with it.
    fn check(&self, fit: &Fitted<3>) -> Result<(), Rejected> {
        let circle = circle_of(&fit.parameters);
        let near = self.crossings.iter();
        let near = near.filter(|c| circle.excess(c.at).abs() < NEAR * circle.radius);
        let agreeing = self.on(&circle).count() as f64 / near.count().max(1) as f64;
        let reason = sun::NO_LIMB;
        Rejected::at_least(LEAST_AGREEING, agreeing, reason)?;
        let arc = arc_fraction(self.on(&circle).map(|c| c.at), circle.centre);
        Rejected::at_least(LEAST_ARC, arc, sun::LITTLE_LIMB)?;
        let sigma_px = centre_sigma_px(fit);
        let reason = sun::DISC_UNDETERMINED;
        Rejected::at_most(MAX_CENTRE_SIGMA_PX, sigma_px, reason)
    }
}

/// Distance of a crossing from a circle; if its bright side faces outwards, a distance above the agreement limit.
fn departure_px(crossing: &Crossing, circle: &Circle) -> f64 {
    match (crossing.at - circle.centre).dot(&crossing.inward) < 0.0 {
        true => circle.excess(crossing.at).abs(),
        false => f64::INFINITY,
    }
}

/// Centre x, y and radius by least squares with Tukey's weights, which reject marks, scratches and leaks.
fn fitted<'c>(
    crossings: impl Iterator<Item = &'c Crossing> + Clone,
    start: &Circle,
    radius_px: Measured,
) -> Option<Fitted<3>> {
    let fit = LeastSquares {
        start: Vector3::new(start.centre.x, start.centre.y, start.radius),
        prior: Prior {
            mean: Vector3::new(0.0, 0.0, radius_px.value),
            information: Vector3::new(0.0, 0.0, radius_px.sigma.powi(-2)),
        },
        loss: Loss::Tukey(TUKEY_SIGMAS),
        scale: Scale::Inflated,
        tolerance_sigmas: 0.05,
    };
    fit.fit_each(|parameters| {
        let circle = circle_of(parameters);
        let row = move |crossing: &Crossing| {
            let out = (crossing.at - circle.centre).normalize();
            Linearised {
                residual: Vector1::new(circle.excess(crossing.at) / CROSSING_SIGMA_PX),
                jacobian: RowVector3::new(out.x, out.y, 1.0) / CROSSING_SIGMA_PX,
            }
        };
        Some(crossings.clone().map(row))
    })
    .ok()
}

fn circle_of(parameters: &SVector<f64, 3>) -> Circle {
    Circle {
        centre: Vector2::new(parameters.x, parameters.y),
        radius: parameters.z,
    }
}

/// 1 sigma of the centre in its least certain direction.
fn centre_sigma_px(fit: &Fitted<3>) -> f64 {
    let centre: Matrix2<f64> = fit.covariance.fixed_view::<2, 2>(0, 0).into();
    centre.symmetric_eigenvalues().max().max(0.0).sqrt()
}

/// Number of trials, half of them with three crossings, after which three agreeing ones have been picked.
fn trials_for(agreeing_share: f64) -> usize {
    let fails = (1.0 - agreeing_share.powi(3)).clamp(1e-9, 1.0 - 1e-9);
    let trials = 2.0 * LEAST_DOUBT.ln() / fails.ln();
    (trials.ceil() as usize).clamp(LEAST_TRIALS, MOST_TRIALS)
}

/// The circle of a given radius through two crossings whose centre lies on their bright side.
fn of_radius_through(a: &Crossing, b: &Crossing, radius: f64) -> Option<Circle> {
    let half = (b.at - a.at) / 2.0;
    let height2 = radius.powi(2) - half.norm_squared();
    let across = Vector2::new(-half.y, half.x).try_normalize(1e-9)?;
    let side = match across.dot(&(a.inward + b.inward)) >= 0.0 {
        true => 1.0,
        false => -1.0,
    };
    (height2 >= 0.0).then(|| Circle {
        centre: a.at + half + across * (side * height2.sqrt()),
        radius,
    })
}

/// A fixed pseudo-random sequence of indices (Marsaglia's xorshift64).
struct Sequence {
    state: u64,
    len: usize,
}

impl Sequence {
    fn new(len: usize) -> Self {
        Self {
            state: 0x9E37_79B9_7F4A_7C15,
            len,
        }
    }

    fn next_index(&mut self) -> usize {
        self.state ^= self.state << 13;
        self.state ^= self.state >> 7;
        self.state ^= self.state << 17;
        ((self.state >> 16) % self.len as u64) as usize
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const TRUTH: Circle = Circle {
        centre: Vector2::new(400.3, 299.6),
        radius: 95.2,
    };

    /// Crossings of 24 rows with a circle; the first six are off by `off_px` in x.
    fn crossings(off_px: f64) -> Vec<Crossing> {
        let row = |n: usize| {
            let y = TRUTH.centre.y + 7.5 * (n as f64 - 11.5);
            let half = (TRUTH.radius.powi(2) - (y - TRUTH.centre.y).powi(2)).sqrt();
            [(1.0, -half), (-1.0, half)].map(|(inward, x)| Crossing {
                at: Vector2::new(TRUTH.centre.x + x, y),
                inward: Vector2::new(inward, 0.0),
            })
        };
        let mut crossings: Vec<Crossing> = (0..24).flat_map(row).collect();
        for crossing in crossings.iter_mut().take(6) {
            crossing.at.x += off_px;
        }
        crossings
    }

    #[test]
    fn crossings_agree_with_their_circle_and_those_that_face_the_other_way_do_not() {
        let mut some = crossings(0.0);
        for crossing in &mut some[20..22] {
            crossing.inward = -crossing.inward;
        }
        let consensus = Consensus {
            crossings: &some,
            radius_px: 95.0,
            settings: &LimbSettings::default(),
        };
        assert_eq!(consensus.on(&TRUTH).count(), 46);
    }

    #[test]
    fn a_circle_is_found_though_an_eighth_of_the_crossings_is_off() {
        for off_px in [0.0, 1.9, -30.0] {
            let circle = agreed_circle(&crossings(off_px), 95.0, &LimbSettings::default()).unwrap();
            assert!((circle.centre - TRUTH.centre).norm() < 0.05, "{circle:?}");
            assert!((circle.radius - TRUTH.radius).abs() < 0.05, "{circle:?}");
        }
    }

    #[test]
    fn a_radius_that_is_known_before_is_kept() {
        let known = Measured::new(TRUTH.radius - 0.05, 0.001);
        let fit = fitted(crossings(0.0).iter(), &TRUTH, known).unwrap();
        assert!((fit.parameters.z - known.value).abs() < 0.01);
        assert!(fit.measured(2).sigma < 0.0015);
        assert!((0.01..0.1).contains(&centre_sigma_px(&fit)));
    }
}
