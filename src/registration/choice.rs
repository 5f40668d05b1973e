//! Which kind of mapping, which pairs, and with what sigmas.

use super::Settings;
use super::adjust::{Adjusted, Problem, Vicinity};
use crate::geometry::MappingKind;

/// Fewest redundant coordinates of the pairs that tell their sigmas; with fewer, pairs that lie well by chance bend the
/// mapping to themselves.
const TELLING_REDUNDANCY: f64 = 4.0;
/// A pair so many sigma off the mapping of the others is an error.
const MAX_PULL: f64 = 6.0;
/// Fewer pairs cannot tell which of them is the error.
const LEAST_TO_REJECT: usize = 5;
/// Residuals of which chi^2 exceeds its expectation by more than this many sigma are not those of the stated noise.
const EXPLAINED_SIGMAS: f64 = 6.0;
/// Sigmas raised by less than this are the stated ones, as well as can be told.
const EXPLAINED_RISE: f64 = 1.3;
/// A richer kind whose first step does not promise this part of the least gain is not fitted.
const PROMISED_SHARE: f64 = 0.5;
/// Pairs whose sigmas must rise by more than this beside the outline are contradicted by it ...
const CONTRADICTED_RISE: f64 = 3.0;
/// ... if they agree among themselves with less.
const AGREED_RISE: f64 = 1.5;
/// How often an outline is doubted.
const DOUBTS: usize = 6;
/// How often the sigmas are raised until they agree with the residuals.
const RISES: usize = 4;

/// The simplest kind of mapping that the data support, fitted. An outline that contradicts pairs which agree among
/// themselves is not the picture of a circle, since the Sun moved; it is doubted until it does no more.
pub(super) fn agreed(problem: &mut Problem<'_>, settings: &Settings) -> Option<Adjusted> {
    let mut best = simplest(problem, settings)?;
    if best.raised < CONTRADICTED_RISE || !pairs_agree(problem, settings) {
        return Some(best);
    }
    for _ in 0..DOUBTS {
        problem.doubt_outline(best.raised);
        let Some(fairer) = simplest(problem, settings) else {
            break;
        };
        best = fairer;
        if best.raised < CONTRADICTED_RISE {
            break;
        }
    }
    Some(best)
}

/// Whether a similarity explains the pairs by themselves.
fn pairs_agree(problem: &Problem<'_>, settings: &Settings) -> bool {
    let alone = || {
        let pairs = problem.pairs_alone()?;
        let mut near = pairs.near_first_similarity()?;
        settle(&pairs, &mut near, MappingKind::Similarity, settings)
    };
    alone().is_some_and(|fit| fit.redundancy >= TELLING_REDUNDANCY && fit.raised < AGREED_RISE)
}

fn simplest(problem: &Problem<'_>, settings: &Settings) -> Option<Adjusted> {
    let mut near = problem.near_first_similarity()?;
    let mut best = settle(problem, &mut near, MappingKind::Similarity, settings)?;
    for kind in [
        MappingKind::Keystone,
        MappingKind::Affine,
        MappingKind::Homography,
    ] {
        if !near.promises(&best, kind, settings.min_gain * PROMISED_SHARE) {
            continue;
        }
        let Some(richer) = settle(problem, &mut near.clone(), kind, settings) else {
            continue;
        };
        let gain = gain(problem, &best, &richer, settings);
        if gain.is_some_and(|gain| gain > settings.min_gain) {
            best = richer;
        }
    }
    Some(best)
}

/// By how much a richer kind lowers chi^2, for every parameter that it adds. `None` where one of the two cannot be
/// fitted by the sigmas of both.
fn gain(
    problem: &Problem<'_>,
    best: &Adjusted,
    richer: &Adjusted,
    settings: &Settings,
) -> Option<f64> {
    // Both are held against the same sigmas: those that the richer one's residuals show, if they can.
    let raised = if richer.redundancy < TELLING_REDUNDANCY {
        best.raised
    } else {
        richer.raised
    };
    let (simple, rich) = (problem.again(best, raised)?, problem.again(richer, raised)?);
    let by_outline = simple.chi2_outline - rich.chi2_outline;
    let by_pairs = (simple.chi2_pairs - rich.chi2_pairs) / raised.powi(2);
    let added = richer.kind.parameters() - best.kind.parameters();
    Some((by_outline + by_pairs / distrust(richer, settings)) / added.max(1) as f64)
}

/// Fits a kind, the pairs' sigmas raised until they agree with the residuals, and moves the vicinity to where the fit is.
pub(super) fn settle(
    problem: &Problem<'_>,
    near: &mut Vicinity,
    kind: MappingKind,
    settings: &Settings,
) -> Option<Adjusted> {
    let mut adjusted = problem.adjust(near, kind, 1.0)?;
    for _ in 0..RISES {
        let raised = risen(&adjusted, settings);
        if (raised / adjusted.raised - 1.0).abs() < 0.01 {
            break;
        }
        adjusted = problem.adjust(near, kind, raised)?;
    }
    Some(adjusted)
}

/// By how much the pairs' sigmas must rise to agree with a fit's residuals.
///
/// Residuals that the stated sigmas can explain are weighed against these. Those that they cannot speak alone, and the
/// fewer they are the wider: Student's distribution of nu degrees of freedom is wider than its scale by
/// sqrt(nu / (nu - 2)).
fn risen(adjusted: &Adjusted, settings: &Settings) -> f64 {
    let (chi2, freedom) = (adjusted.chi2_pairs, adjusted.redundancy.max(0.5));
    let explained = freedom + EXPLAINED_SIGMAS * (2.0 * freedom).sqrt();
    let variance = if chi2 < explained {
        let prior = settings.prior_freedom;
        (prior + chi2) / (prior + freedom)
    } else {
        chi2 / (freedom - 2.0).max(0.5 * freedom).max(0.5)
    };
    variance.max(1.0).sqrt()
}

/// How much more pairs must gain whose sigmas come from few residuals: the quantile of F(2, nu) over that of
/// F(2, infinity), which is chi^2 per parameter. Stated sigmas that explain the residuals count for their own freedom.
fn distrust(richer: &Adjusted, settings: &Settings) -> f64 {
    let stated = if richer.raised < EXPLAINED_RISE {
        settings.prior_freedom
    } else {
        0.0
    };
    let half = (richer.redundancy.max(1.0) + stated) / 2.0;
    let gain = settings.min_gain.max(1.0);
    half * ((gain / half).exp() - 1.0) / gain
}

/// The pair farthest from its place, if it is an error.
pub(super) fn outlier(problem: &Problem<'_>, adjusted: &Adjusted) -> Option<usize> {
    if problem.pairs() < LEAST_TO_REJECT {
        return None;
    }
    let (worst, squared) = problem
        .residuals(&adjusted.model)
        .map(|(chi2, _)| chi2)
        .enumerate()
        .max_by(|a, b| a.1.total_cmp(&b.1))?;
    // What the others show of the true sigmas.
    let others = (adjusted.chi2_pairs - squared) / (adjusted.redundancy - 2.0).max(1.0);
    (squared > MAX_PULL.powi(2) * others.max(1.0)).then_some(worst)
}
