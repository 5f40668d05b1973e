//! Which kind of mapping, which pairs, and with what sigmas.

use super::adjust::{Adjusted, Linearised, Problem};
use super::input::Settings;
use crate::geometry::MappingKind;

/// Fewest redundant coordinates of the pairs that determine their sigmas; with fewer, pairs that lie well by chance bend
/// the mapping to themselves.
const MIN_REDUNDANCY: f64 = 4.0;
/// A pair so many sigma off the mapping of the others is an outlier.
const MAX_NORMALISED_RESIDUAL: f64 = 6.0;
/// With fewer pairs it is undetermined which of them is the outlier.
const LEAST_TO_REJECT: usize = 5;
/// Residuals of which chi^2 exceeds its expectation by more than this many sigma are not those of the stated noise.
const EXPLAINED_SIGMAS: f64 = 6.0;
/// An inflation of less than this is not significant.
const EXPLAINED_INFLATION: f64 = 1.3;
/// A richer kind whose first step does not gain this part of the least gain is not fitted.
const FIRST_STEP_SHARE: f64 = 0.5;
/// Pairs that need a larger inflation than this beside the outline are contradicted by it ...
const CONTRADICTED_INFLATION: f64 = 3.0;
/// ... if they need less than this without it.
const AGREED_INFLATION: f64 = 1.5;
/// How often an outline's sigmas are inflated.
const OUTLINE_INFLATIONS: usize = 6;
/// How often the pairs' sigmas are inflated until they agree with the residuals.
const INFLATIONS: usize = 4;

/// The simplest kind of mapping that the data support, fitted. An outline that contradicts pairs which agree among
/// themselves is not the image of a circle, since the Sun moved; its sigmas are inflated until both agree.
pub(super) fn choose(problem: &mut Problem<'_>, settings: &Settings) -> Option<Adjusted> {
    let mut best = simplest(problem, settings)?;
    if best.inflation < CONTRADICTED_INFLATION || !pairs_agree(problem, settings) {
        return Some(best);
    }
    for _ in 0..OUTLINE_INFLATIONS {
        problem.inflate_outline(best.inflation);
        let Some(again) = simplest(problem, settings) else {
            break;
        };
        best = again;
        if best.inflation < CONTRADICTED_INFLATION {
            break;
        }
    }
    Some(best)
}

/// Whether a similarity explains the pairs by themselves.
fn pairs_agree(problem: &Problem<'_>, settings: &Settings) -> bool {
    let alone = || {
        let pairs = problem.pairs_alone()?;
        let mut near = pairs.near_similarity()?;
        fit_kind(&pairs, &mut near, MappingKind::Similarity, settings)
    };
    alone().is_some_and(|fit| fit.redundancy >= MIN_REDUNDANCY && fit.inflation < AGREED_INFLATION)
}

fn simplest(problem: &Problem<'_>, settings: &Settings) -> Option<Adjusted> {
    let mut near = problem.near_similarity()?;
    let mut best = fit_kind(problem, &mut near, MappingKind::Similarity, settings)?;
    for kind in [
        MappingKind::Keystone,
        MappingKind::Affine,
        MappingKind::Homography,
    ] {
        if !near.may_gain(&best, kind, settings.min_gain * FIRST_STEP_SHARE) {
            continue;
        }
        let Some(richer) = fit_kind(problem, &mut near.clone(), kind, settings) else {
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
/// fitted with the inflation of both.
fn gain(
    problem: &Problem<'_>,
    best: &Adjusted,
    richer: &Adjusted,
    settings: &Settings,
) -> Option<f64> {
    // Both take the same sigmas: those that the richer one's residuals show, if they determine them.
    let inflation = if richer.redundancy < MIN_REDUNDANCY {
        best.inflation
    } else {
        richer.inflation
    };
    let simple = problem.with_inflation(best, inflation)?;
    let rich = problem.with_inflation(richer, inflation)?;
    let by_outline = simple.chi2_outline - rich.chi2_outline;
    let by_pairs = (simple.chi2_pairs - rich.chi2_pairs) / inflation.powi(2);
    let added = richer.kind.parameters() - best.kind.parameters();
    Some((by_outline + by_pairs / f_ratio(richer, settings)) / added.max(1) as f64)
}

/// Fits a kind, the pairs' sigmas inflated until they agree with the residuals, and linearises at the fit.
pub(super) fn fit_kind(
    problem: &Problem<'_>,
    near: &mut Linearised,
    kind: MappingKind,
    settings: &Settings,
) -> Option<Adjusted> {
    let mut adjusted = problem.adjust(near, kind, 1.0)?;
    for _ in 0..INFLATIONS {
        let inflation = inflation(&adjusted, settings);
        if (inflation / adjusted.inflation - 1.0).abs() < 0.01 {
            break;
        }
        adjusted = problem.adjust(near, kind, inflation)?;
    }
    Some(adjusted)
}

/// The factor of the pairs' sigmas that agrees with a fit's residuals.
///
/// Residuals that the stated sigmas can explain are weighed against these. Larger ones count alone, and the fewer they are
/// the wider: Student's distribution of nu degrees of freedom is wider than its scale by sqrt(nu / (nu - 2)).
fn inflation(adjusted: &Adjusted, settings: &Settings) -> f64 {
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
fn f_ratio(richer: &Adjusted, settings: &Settings) -> f64 {
    let stated = if richer.inflation < EXPLAINED_INFLATION {
        settings.prior_freedom
    } else {
        0.0
    };
    let half = (richer.redundancy.max(1.0) + stated) / 2.0;
    let gain = settings.min_gain.max(1.0);
    half * ((gain / half).exp() - 1.0) / gain
}

/// The pair of the largest normalised residual, if it is an outlier.
pub(super) fn outlier(problem: &Problem<'_>, adjusted: &Adjusted) -> Option<usize> {
    if problem.pairs() < LEAST_TO_REJECT {
        return None;
    }
    let (worst, squared) = problem
        .residuals(&adjusted.view)
        .map(|(chi2, _)| chi2)
        .enumerate()
        .max_by(|a, b| a.1.total_cmp(&b.1))?;
    // The variance factor that the other pairs show.
    let others = (adjusted.chi2_pairs - squared) / (adjusted.redundancy - 2.0).max(1.0);
    (squared > MAX_NORMALISED_RESIDUAL.powi(2) * others.max(1.0)).then_some(worst)
}
