//! The circle that most crossings agree on.

use super::agreement::{CircleFit, Crossings};
use super::chords::Crossing;
use super::{Settings, arc_fraction};
use crate::geometry::Circle;
use crate::units::{Measured, Rejected};
use nalgebra::Vector2;

/// Most circles that are tried. Nineteen of twenty crossings of a clean disc agree: there a dozen are enough.
const MOST_TRIALS: usize = 400;
/// Probability of never having picked three agreeing crossings at which the trials end.
const LEAST_DOUBT: f64 = 1e-4;
/// This part of the crossings near the circle must agree with it.
const LEAST_AGREEING: f64 = 0.6;
/// Less of the limb does not tell a disc from a speck at the sensor's edge.
const LEAST_ARC: f64 = 0.1;
/// The expected radius is this good, relative to it.
const RADIUS_SIGMA: f64 = 0.003;
/// A limb that tells the radius as well as this, relative to it, is asked for it.
const WELL_TOLD: f64 = 0.001;
/// A radius that differs from the expected one by so many sigma is another one.
const PLAIN_SIGMAS: f64 = 5.0;
/// A disc known less well than this is not known, px.
const MAX_CENTRE_SIGMA_PX: f64 = 1.0;

/// The circle of nearly the expected radius that most crossings lie on.
pub(super) fn agreed_circle(
    crossings: &[Crossing],
    radius_px: f64,
    settings: &Settings,
) -> Result<Circle, Rejected> {
    let enough = settings.min_crossings as f64;
    let least = |reason, measured, limit| match measured >= limit {
        true => Ok(()),
        false => Err(Rejected {
            reason,
            measured,
            limit,
        }),
    };
    least(
        "too few chords cross a limb",
        crossings.len() as f64,
        enough,
    )?;
    let vote = Vote {
        crossings,
        groups: Crossings::new(crossings),
        radius_px,
        settings,
    };
    let best = vote.best_circle();
    let on = best.map_or(0.0, |circle| f64::from(vote.groups.agreement(&circle).on));
    let few = "too few crossings lie on a circle of the Sun's size";
    least(few, on, enough)?;
    let fit = best
        .and_then(|circle| vote.refined(circle))
        .ok_or(Rejected {
            reason: "the crossings determine no circle",
            measured: on,
            limit: enough,
        })?;
    vote.check(&fit)?;
    Ok(fit.circle)
}

/// What a circle is chosen by.
struct Vote<'a> {
    crossings: &'a [Crossing],
    groups: Crossings,
    radius_px: f64,
    settings: &'a Settings,
}

impl Vote<'_> {
    /// The best of many circles. Circles through three crossings serve when much of the limb is seen, circles of the
    /// expected radius through two when little is. The choice of crossings is a fixed sequence: the same frame always
    /// gives the same disc.
    fn best_circle(&self) -> Option<Circle> {
        let mut pick = Sequence::new(self.crossings.len());
        let (mut best, mut least_cost) = (None, f32::INFINITY);
        let mut trials = MOST_TRIALS;
        let mut trial = 0;
        while trial < trials {
            trial += 1;
            let [a, b, c] = std::array::from_fn(|_| &self.crossings[pick.next_index()]);
            let candidate = if trial % 2 == 0 {
                Circle::through(a.at.vector(), b.at.vector(), c.at.vector())
            } else {
                of_radius_through(a, b, self.radius_px)
            };
            let Some(circle) = candidate.filter(|circle| self.of_size(circle)) else {
                continue;
            };
            let agreement = self.groups.agreement(&circle);
            if agreement.cost_px2 < least_cost {
                (best, least_cost) = (Some(circle), agreement.cost_px2);
                trials = trials_for(f64::from(agreement.on) / self.crossings.len() as f64);
            }
        }
        best
    }

    fn of_size(&self, circle: &Circle) -> bool {
        (circle.radius / self.radius_px - 1.0).abs() <= self.settings.max_radius_deviation
    }

    /// The circle through all that agree: of the radius that they tell where they tell it well, or plainly another than the expected
    /// one; of the expected one where the arc is too short for that.
    fn refined(&self, start: Circle) -> Option<CircleFit> {
        let fit = |sigma: f64| {
            let radius_px = Measured::new(self.radius_px, sigma * self.radius_px);
            self.groups.fit(start, radius_px)
        };
        let tells = |fit: &CircleFit| {
            let sigma_px = fit.radius_sigma_px();
            let off_px = (fit.circle.radius - self.radius_px).abs();
            let limit_px = PLAIN_SIGMAS * sigma_px.hypot(RADIUS_SIGMA * self.radius_px);
            let well = sigma_px < WELL_TOLD * self.radius_px;
            let plainly = off_px > limit_px && fit.centre_sigma_px() < MAX_CENTRE_SIGMA_PX;
            well || plainly
        };
        let told = fit(self.settings.max_radius_deviation)
            .filter(|fit| tells(fit) && self.of_size(&fit.circle));
        told.or_else(|| fit(RADIUS_SIGMA))
    }

    /// A limb is long, sharply known, and what lies about it is its own.
    fn check(&self, fit: &CircleFit) -> Result<(), Rejected> {
        let agreement = self.groups.agreement(&fit.circle);
        let share = f64::from(agreement.on / agreement.near.max(1.0));
        if share < LEAST_AGREEING {
            return Err(Rejected {
                reason: "what crosses the threshold near the circle is no limb",
                measured: share,
                limit: LEAST_AGREEING,
            });
        }
        let arc = arc_fraction(self.groups.on(&fit.circle), fit.circle.centre);
        if arc < LEAST_ARC {
            return Err(Rejected {
                reason: "too little of the limb is seen",
                measured: arc,
                limit: LEAST_ARC,
            });
        }
        let sigma_px = fit.centre_sigma_px();
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
}

/// Trials, half of them of three crossings, after which three agreeing ones have been picked.
fn trials_for(agreeing_share: f64) -> usize {
    let miss = (1.0 - agreeing_share.powi(3)).clamp(1e-9, 1.0 - 1e-9);
    let trials = 2.0 * LEAST_DOUBT.ln() / miss.ln();
    (trials.ceil() as usize).clamp(12, MOST_TRIALS)
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
