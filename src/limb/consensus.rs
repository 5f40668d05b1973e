//! The circle that most crossings agree on.

use super::{Crossing, LimbPoint, OutlineFit, OutlinePrior, Settings, arc_fraction, fit_outline};
use crate::geometry::Circle;
use crate::units::{Measured, Rejected, SensorPx};
use nalgebra::Vector2;

/// Distance from the circle within which a crossing agrees with it, px.
const AGREEMENT_PX: f64 = 2.0;
/// Most circles that are tried. Nineteen of twenty crossings of a clean disc agree: there a dozen are enough.
const MOST_TRIALS: usize = 400;
/// Probability of never having picked three agreeing crossings at which the trials end.
const LEAST_DOUBT: f64 = 1e-4;
/// Crossings within this part of the radius from the circle belong to the same bright patch ...
const NEAR: f64 = 0.25;
/// ... and this part of them must agree.
const LEAST_AGREEING: f64 = 0.6;
/// Less of the limb does not tell a disc from a speck at the sensor's edge.
const LEAST_ARC: f64 = 0.1;
/// The expected radius is this good, relative to it.
const RADIUS_SIGMA: f64 = 0.003;
/// A limb that tells the radius as well as this, relative to it, is asked for it.
const WELL_TOLD: f64 = 0.001;
/// A disc known less well than this is not known, px.
const MAX_CENTRE_SIGMA_PX: f64 = 1.0;
/// Crossings are never better than this, px: marks, haze and the sensor's tilt see to it.
const CROSSING_SIGMA_PX: f64 = 0.1;
/// The disc is looked for as a circle.
const ROUND: f64 = 1e-4;

/// The circle of nearly the expected radius that most crossings lie on.
pub(super) fn agreed_circle(
    crossings: &[Crossing],
    radius_px: f64,
    settings: &Settings,
) -> Result<Circle, Rejected> {
    let enough = settings.min_crossings;
    if crossings.len() < enough {
        return Err(Rejected {
            reason: "too few chords cross a limb",
            measured: crossings.len() as f64,
            limit: enough as f64,
        });
    }
    let circle = best_circle(crossings, radius_px, settings).unwrap_or(Circle {
        centre: Vector2::zeros(),
        radius: radius_px,
    });
    let points = agreeing(crossings, &circle);
    if points.len() < enough {
        return Err(Rejected {
            reason: "too few crossings lie on a circle of the Sun's size",
            measured: points.len() as f64,
            limit: enough as f64,
        });
    }
    let fit = refined(&points, circle, radius_px, settings).ok_or(Rejected {
        reason: "the crossings determine no circle",
        measured: points.len() as f64,
        limit: enough as f64,
    })?;
    check(crossings, &fit)?;
    Ok(circle_of(&fit))
}

/// The best of many circles. Circles through three crossings serve when much of the limb is seen, circles of the
/// expected radius through two when little is. The choice of crossings is a fixed sequence: the same frame always
/// gives the same disc.
fn best_circle(crossings: &[Crossing], radius_px: f64, settings: &Settings) -> Option<Circle> {
    let mut pick = Sequence::new(crossings.len());
    let (mut best, mut least_cost) = (None, f64::INFINITY);
    let mut trials = MOST_TRIALS;
    let mut trial = 0;
    while trial < trials {
        trial += 1;
        let points: [Crossing; 3] = std::array::from_fn(|_| crossings[pick.next_index()]);
        let candidate = if trial % 2 == 0 {
            let [a, b, c] = points.map(|crossing| crossing.at.vector());
            Circle::through(a, b, c)
        } else {
            of_radius_through(&points[0], &points[1], radius_px)
        };
        let Some(circle) = candidate.filter(|c| of_size(c, radius_px, settings)) else {
            continue;
        };
        let cost = cost(crossings, &circle);
        if cost < least_cost {
            (best, least_cost) = (Some(circle), cost);
            let share = agreeing(crossings, &circle).len() as f64 / crossings.len() as f64;
            trials = trials_for(share);
        }
    }
    best
}

fn of_size(circle: &Circle, radius_px: f64, settings: &Settings) -> bool {
    (circle.radius / radius_px - 1.0).abs() <= settings.max_radius_deviation
}

/// Trials, half of them of three crossings, after which three agreeing ones have been picked.
fn trials_for(agreeing_share: f64) -> usize {
    let miss = (1.0 - agreeing_share.powi(3)).clamp(1e-9, 1.0 - 1e-9);
    let trials = 2.0 * LEAST_DOUBT.ln() / miss.ln();
    (trials.ceil() as usize).clamp(12, MOST_TRIALS)
}

/// What the best circle minimises.
fn cost(crossings: &[Crossing], circle: &Circle) -> f64 {
    let most = AGREEMENT_PX.powi(2);
    crossings
        .iter()
        .map(|crossing| match excess(crossing, circle) {
            Some(excess) => (excess * excess).min(most),
            None => most,
        })
        .sum()
}

/// Distance outwards from a circle of a crossing whose bright side is the circle's inside.
fn excess(crossing: &Crossing, circle: &Circle) -> Option<f64> {
    let to_centre = circle.centre - crossing.at.vector();
    (to_centre.dot(&crossing.inward()) > 0.0).then(|| to_centre.norm() - circle.radius)
}

fn agreeing(crossings: &[Crossing], circle: &Circle) -> Vec<Vector2<f64>> {
    let agrees = |crossing: &&Crossing| {
        excess(crossing, circle).is_some_and(|excess| excess.abs() < AGREEMENT_PX)
    };
    let agreeing = crossings.iter().filter(agrees);
    agreeing.map(|crossing| crossing.at.vector()).collect()
}

/// The circle through all that agree: of the radius that they tell where they tell it well, of the expected one
/// where the arc is too short for that.
fn refined(
    points: &[Vector2<f64>],
    start: Circle,
    radius_px: f64,
    settings: &Settings,
) -> Option<OutlineFit> {
    let point = |at: &Vector2<f64>| LimbPoint {
        at: SensorPx::from(*at),
        sigma_px: CROSSING_SIGMA_PX,
    };
    let points: Vec<LimbPoint> = points.iter().map(point).collect();
    let fit = |sigma: f64| {
        let prior = OutlinePrior {
            radius_px: Measured::new(radius_px, sigma * radius_px),
            flatness: ROUND,
        };
        fit_outline(&points, &start.into(), &prior)
    };
    let told = fit(settings.max_radius_deviation)
        .filter(|fit| fit.radius_sigma_px() < WELL_TOLD * radius_px)
        .filter(|fit| of_size(&circle_of(fit), radius_px, settings));
    told.or_else(|| fit(RADIUS_SIGMA))
}

fn circle_of(fit: &OutlineFit) -> Circle {
    Circle {
        centre: fit.ellipse.centre,
        radius: fit.ellipse.mean_radius(),
    }
}

/// A limb is long, sharply known, and what lies about it is its own.
fn check(crossings: &[Crossing], fit: &OutlineFit) -> Result<(), Rejected> {
    let circle = &circle_of(fit);
    let points = agreeing(crossings, circle);
    let near = crossings
        .iter()
        .filter(|c| circle.excess(c.at.vector()).abs() < NEAR * circle.radius)
        .count();
    let share = points.len() as f64 / near.max(1) as f64;
    if share < LEAST_AGREEING {
        return Err(Rejected {
            reason: "what crosses the threshold near the circle is no limb",
            measured: share,
            limit: LEAST_AGREEING,
        });
    }
    let arc = arc_fraction(points.into_iter(), circle.centre);
    if arc < LEAST_ARC {
        return Err(Rejected {
            reason: "too little of the limb is seen",
            measured: arc,
            limit: LEAST_ARC,
        });
    }
    let sigma_px = fit.centre_covariance().symmetric_eigenvalues().max().sqrt();
    if sigma_px < MAX_CENTRE_SIGMA_PX {
        Ok(())
    } else {
        Err(Rejected {
            reason: "the limb does not tell where the disc is",
            measured: sigma_px,
            limit: MAX_CENTRE_SIGMA_PX,
        })
    }
}

/// The circle of a given radius through two crossings whose centre lies on their bright side.
fn of_radius_through(a: &Crossing, b: &Crossing, radius: f64) -> Option<Circle> {
    let (pa, pb) = (a.at.vector(), b.at.vector());
    let half = (pb - pa) / 2.0;
    let height = (radius.powi(2) - half.norm_squared()).max(0.0).sqrt();
    let across = Vector2::new(-half.y, half.x).try_normalize(1e-9)?;
    let inward = a.inward() + b.inward();
    let side = if across.dot(&inward) >= 0.0 {
        1.0
    } else {
        -1.0
    };
    (half.norm() <= radius).then(|| Circle {
        centre: pa + half + across * (side * height),
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
