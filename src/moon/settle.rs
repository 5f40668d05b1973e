//! Reads the limb repeatedly until it converges. If nothing determines the side of the light, several sides are tried and
//! the best fit is kept.

use super::candidate::{Candidate, View};
use super::face::Face;
use super::known::Known;
use super::limb::{self, Limb, LimbFit};
use super::misfit::misfit;
use super::sector::Parameters;
use super::{Stage, Stopped};
use crate::geometry::Circle;
use crate::reasons::{at, moon as reasons};
use crate::units::{Measured, Rejected};
use nalgebra::Matrix2;
use std::f64::consts::{PI, TAU};

/// Minimum number of sectors of a limb.
const LEAST_SECTORS: usize = 6;
/// The limb is read again while the circle or the blur changes by more than this, or the light's direction by more, at most
/// `MOST_ROUNDS` times.
const SETTLED_PX: f64 = 0.1;
const SETTLED_RAD: f64 = 0.08;
const MOST_ROUNDS: usize = 8;
/// At a smaller phase angle, bright and dark ground may displace the light's centroid to any side.
const NEAR_FULL_RAD: f64 = 0.9;
/// Number of sides that are then tried, the sigma of each, rad, and the prior of the phase.
const SIDES: u32 = 8;
const SIDE_RAD: f64 = 0.5;
const PHASE_RAD: Measured = Measured::new(0.35, 0.25);
/// Near full Moon the outline is limb all round: a circle whose centre or radius differs by more, in radii, has diverged.
const STRAYED: f64 = 0.25;
/// The ground is uniform if the shading leaves less than this share of the variance unexplained.
const EVEN: f64 = 0.01;
/// A light is rejected if more of the variance on and around its circle is not explained by a sphere.
const ROUGHLY_UNLIKE: f64 = 0.5;
/// An increase of the misfit by this reduces the likelihood by a factor of e.
const MISFIT_SCALE: f64 = 0.03;

/// A converged limb.
pub(super) struct Settled {
    pub found: LimbFit,
    pub limb: Limb,
    /// Variance of the centre from the ambiguity of the light's side, px^2.
    other_side: Matrix2<f64>,
}

impl Settled {
    pub fn at(&self) -> &Parameters {
        &self.found.fitted.parameters
    }

    /// Covariance of the centre, px^2: from the fit, and from other sides of the light.
    pub fn covariance(&self) -> Matrix2<f64> {
        self.found.fitted.covariance.fixed_view::<2, 2>(0, 0) + self.other_side
    }
}

/// The converged limb of a light, starting at a circle.
pub(super) fn settle(candidate: &Candidate, circle: &Circle) -> Result<Settled, Stopped> {
    let (view, known) = (&candidate.view, candidate.known(circle));
    let by_middle = settle_at(view, circle, known);
    let is_side_known = candidate.bright_limb_rad().is_some();
    if is_side_known || known.phase_rad.value >= NEAR_FULL_RAD || is_even(view, &by_middle) {
        return by_middle;
    }
    check_light(view, circle, &known)?;
    let mut first = None;
    let mut settled = Vec::new();
    for n in 0..SIDES {
        let side_rad = f64::from(n) / f64::from(SIDES) * TAU;
        let known = Known {
            phase_rad: candidate.phase_rad().unwrap_or(PHASE_RAD),
            bright_limb_rad: Measured::new(side_rad, SIDE_RAD),
            ..known
        };
        match settle_at(view, circle, known).and_then(|one| near(circle, &known, one)) {
            Ok(one) => settled.push((misfit(view, one.at()), one)),
            Err(stopped) => first = first.or(Some(stopped)),
        }
    }
    settled.sort_by(|(one, _), (other, _)| one.total_cmp(other));
    let mut settled = settled.into_iter();
    let Some((least, mut best)) = settled.next() else {
        return Err(first.unwrap_or_else(no_fit));
    };
    let spreads = settled.map(|(misfit, other)| {
        let off = other.found.centre() - best.found.centre();
        off * off.transpose() / (1.0 + ((misfit - least) / MISFIT_SCALE).exp())
    });
    let largest = spreads.max_by(|one, other| one.trace().total_cmp(&other.trace()));
    best.other_side = largest.unwrap_or_default();
    Ok(best)
}

/// Whether the ground is so uniform that its brightness follows the shading: then the centroid of the light is valid as
/// well.
fn is_even(view: &View, by_middle: &Result<Settled, Stopped>) -> bool {
    by_middle.as_ref().is_ok_and(|settled| {
        let at = settled.at();
        Face::seen(view, at).unlike(at[4]) < EVEN
    })
}

/// Rejects most lights that are not the Moon before every side is tried.
fn check_light(view: &View, circle: &Circle, known: &Known) -> Result<(), Stopped> {
    let face = Face::seen(view, &limb::begin(circle, known));
    let unlike = face.unlike(face.phase_rad(known.phase_rad.value).value);
    Rejected::at_most(ROUGHLY_UNLIKE, unlike, reasons::UNLIKE).map_err(at(Stage::Detection))
}

/// Checks that a circle has not diverged from its start; a prior radius constrains it.
fn near(circle: &Circle, known: &Known, settled: Settled) -> Result<Settled, Stopped> {
    let grown = match known.radius {
        Some(_) => 0.0,
        None => (settled.at()[2] - circle.radius).abs(),
    };
    let off = (settled.found.centre() - circle.centre).norm().max(grown) / circle.radius;
    match off < STRAYED {
        true => Ok(settled),
        false => Err(Stopped::new(Stage::Limb, reasons::NO_FIT, off, STRAYED)),
    }
}

/// The converged limb, starting from the priors.
fn settle_at(view: &View, circle: &Circle, mut known: Known) -> Result<Settled, Stopped> {
    let mut at = limb::begin(circle, &known);
    for round in 1.. {
        let limb = Limb::read(view, at, known);
        let loose = known.loosened(limb.saturated);
        if loose != known {
            known = loose;
            continue;
        }
        let mut found = fit(&limb)?;
        let step = found.fitted.parameters - at;
        let is_settled = step.fixed_rows::<4>(0).amax() < SETTLED_PX
            && step.fixed_rows::<2>(4).amax() < SETTLED_RAD;
        at = found.fitted.parameters;
        let loose = known.contradicted(found.radius_contradiction);
        if is_settled && loose != known {
            known = loose;
            continue;
        }
        if is_settled || round == MOST_ROUNDS {
            found.fitted.parameters = with_positive_phase(at);
            return Ok(Settled {
                found,
                limb,
                other_side: Matrix2::zeros(),
            });
        }
    }
    Err(no_fit())
}

/// The same light with a positive phase: at a negative phase it comes from the opposite side.
fn with_positive_phase(mut at: Parameters) -> Parameters {
    if at[4] < 0.0 {
        at[4] = -at[4];
        at[5] += PI;
    }
    at
}

fn no_fit() -> Stopped {
    Stopped::new(Stage::Limb, reasons::NO_FIT, 0.0, 0.0)
}

fn fit(limb: &Limb) -> Result<LimbFit, Stopped> {
    let seen = limb.seen();
    if seen < LEAST_SECTORS {
        let limit = LEAST_SECTORS as f64;
        return Err(Stopped::new(
            Stage::Limb,
            reasons::LITTLE_LIMB,
            seen as f64,
            limit,
        ));
    }
    limb.fit()
        .map_err(|_| Stopped::new(Stage::Limb, reasons::NO_FIT, seen as f64, 0.0))
}
