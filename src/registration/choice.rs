//! Chooses the kind of mapping, the accepted pairs, and their sigmas.

use super::RegistrationSettings;
use super::adjust::{Adjusted, Covariance, Model, Problem, Terms};
use crate::geometry::MappingKind;

/// Fewest redundant coordinates of the pairs that determine their sigmas; with fewer, pairs that agree by chance would dominate the fit.
const MIN_REDUNDANCY: f64 = 4.0;
/// A pair is an outlier if it is this many sigma off the mapping of the others.
const MAX_NORMALISED_RESIDUAL: f64 = 6.0;
/// With fewer pairs the outlier cannot be identified.
const LEAST_TO_REJECT: usize = 5;
/// Fraction of the marks displaced by an object on them, mostly a sunspot: one in forty if there are many spots.
const DISPLACED_SHARE: f64 = 0.025;
/// Residuals whose chi^2 exceeds its expectation by more than this many sigma are not explained by the stated noise.
const EXPLAINED_SIGMAS: f64 = 6.0;
/// An inflation of less than this is not significant.
const EXPLAINED_INFLATION: f64 = 1.3;
/// A richer kind is not fitted if its first step gains less than this part of the least gain.
const FIRST_STEP_SHARE: f64 = 0.5;
/// If pairs with the outline need a larger inflation than this, the outline contradicts them ...
const CONTRADICTED_INFLATION: f64 = 3.0;
/// ... provided that they need less than this without it.
const AGREED_INFLATION: f64 = 1.5;
/// Greatest number of inflations of an outline's sigmas.
const OUTLINE_INFLATIONS: usize = 6;
/// Number of iterations of inflating the pairs' sigmas to agree with the residuals.
const PAIR_INFLATIONS: usize = 4;
/// Prior odds of a camera with a significant tilt against one perpendicular to the plate.
const TILTED_ODDS: f64 = 0.3;

/// The simplest mapping that the data support, without outliers among the pairs. The covariance includes the uncertainty that pairs and
/// outline leave: a tilt, and which of a few marks is displaced.
pub(super) fn choose(problem: &mut Problem, settings: &RegistrationSettings) -> Option<Adjusted> {
    if problem.pairs() < LEAST_TO_REJECT {
        let displaced = DISPLACED_SHARE * MAX_NORMALISED_RESIDUAL.powi(2);
        problem.inflate_pairs((1.0 + displaced).sqrt());
    }
    let mut best = agreeing(problem, settings)?;
    while let Some(outlier) = outlier(problem, &best) {
        problem.reject(outlier);
        best = agreeing(problem, settings)?;
    }
    Some(Adjusted {
        covariance: averaged_covariance(problem, &best),
        ..best
    })
}

/// The simplest mapping that the data support. An outline that contradicts consistent pairs is not the image of a circle, because the Sun
/// moved; its sigmas are inflated until both agree.
fn agreeing(problem: &mut Problem, settings: &RegistrationSettings) -> Option<Adjusted> {
    let mut best = simplest(problem, settings)?;
    if best.terms.inflation < CONTRADICTED_INFLATION || !pairs_agree(problem, settings) {
        return Some(best);
    }
    for _ in 0..OUTLINE_INFLATIONS {
        problem.inflate_outline(best.terms.inflation);
        let Some(again) = simplest(problem, settings) else {
            break;
        };
        best = again;
        if best.terms.inflation < CONTRADICTED_INFLATION {
            break;
        }
    }
    Some(best)
}

/// Whether a similarity explains the pairs without the outline.
fn pairs_agree(problem: &Problem, settings: &RegistrationSettings) -> bool {
    let alone = || {
        let start = problem.similarity_of_pairs()?;
        fit_kind(problem, &start, MappingKind::Similarity, settings)
    };
    alone().is_some_and(|fit| {
        fit.redundancy >= MIN_REDUNDANCY && fit.terms.inflation < AGREED_INFLATION
    })
}

fn simplest(problem: &Problem, settings: &RegistrationSettings) -> Option<Adjusted> {
    let start = problem.similarity()?;
    let similarity = fit_kind(problem, &start, MappingKind::Similarity, settings)?;
    let mut best = similarity;
    let kinds = [
        MappingKind::Keystone,
        MappingKind::Affine,
        MappingKind::Homography,
    ];
    let gains = problem.first_step_gains(&similarity.model, kinds)?;
    for (kind, first_gain) in kinds.into_iter().zip(gains) {
        // A kind that hardly gains with the stated sigmas is not fitted.
        let added = (kind.parameters() - best.terms.kind.parameters()).max(1);
        let least_gain = FIRST_STEP_SHARE * settings.min_gain * added as f64;
        if first_gain.is_none_or(|gain| gain < least_gain) {
            continue;
        }
        let Some(richer) = fit_kind(problem, &similarity.model, kind, settings) else {
            continue;
        };
        let gain = gain(problem, &best, &richer, settings);
        if gain.is_some_and(|gain| gain > settings.min_gain) {
            best = richer;
        }
    }
    Some(best)
}

/// Decrease of chi^2 by a richer kind for every added parameter. `None` if one of the two cannot be fitted with the inflation of both.
fn gain(
    problem: &Problem,
    simple: &Adjusted,
    rich: &Adjusted,
    settings: &RegistrationSettings,
) -> Option<f64> {
    // Use the same sigmas for both: those from the richer one's residuals, if they determine them.
    let inflation = match rich.redundancy < MIN_REDUNDANCY {
        true => simple.terms.inflation,
        false => rich.terms.inflation,
    };
    let ratio = f_ratio(rich, settings);
    let added = rich.terms.kind.parameters() - simple.terms.kind.parameters();
    let [simple, rich] = [simple, rich].map(|fit| problem.with_inflation(fit, inflation));
    let (simple, rich) = (simple?, rich?);
    let by_outline = simple.chi2_others - rich.chi2_others;
    let by_pairs = (simple.chi2_pairs - rich.chi2_pairs) / inflation.powi(2);
    Some((by_outline + by_pairs / ratio) / added.max(1) as f64)
}

impl Problem {
    /// Repeats a fit with another inflation of the pairs' sigmas.
    fn with_inflation(&self, fit: &Adjusted, inflation: f64) -> Option<Adjusted> {
        if fit.terms.inflation == inflation {
            return Some(*fit);
        }
        let terms = Terms {
            inflation,
            ..fit.terms
        };
        self.adjust(&fit.model, terms)
    }
}

/// Fits a kind of mapping, and inflates the pairs' sigmas until they agree with the residuals.
pub(super) fn fit_kind(
    problem: &Problem,
    start: &Model,
    kind: MappingKind,
    settings: &RegistrationSettings,
) -> Option<Adjusted> {
    let terms = Terms {
        kind,
        inflation: 1.0,
    };
    let mut adjusted = problem.adjust(start, terms)?;
    for _ in 0..PAIR_INFLATIONS {
        let inflation = inflation(&adjusted, settings);
        if (inflation / adjusted.terms.inflation - 1.0).abs() < 0.01 {
            break;
        }
        adjusted = problem.with_inflation(&adjusted, inflation)?;
    }
    Some(adjusted)
}

/// The factor on the pairs' sigmas that agrees with a fit's residuals.
///
/// Residuals that the stated sigmas can explain are averaged with these. Larger ones are used alone, with a margin that increases for
/// fewer of them: Student's distribution of nu degrees of freedom is wider than its scale by sqrt(nu / (nu - 2)).
fn inflation(adjusted: &Adjusted, settings: &RegistrationSettings) -> f64 {
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

/// Factor on the required gain of pairs whose sigmas come from few residuals: the quantile of F(2, nu) over that of F(2, infinity), which
/// is chi^2 per parameter. Stated sigmas that explain the residuals add their own degrees of freedom.
fn f_ratio(rich: &Adjusted, settings: &RegistrationSettings) -> f64 {
    let stated = match rich.terms.inflation < EXPLAINED_INFLATION {
        true => settings.prior_freedom,
        false => 0.0,
    };
    let half = (rich.redundancy.max(1.0) + stated) / 2.0;
    let gain = settings.min_gain.max(1.0);
    half * ((gain / half).exp() - 1.0) / gain
}

/// The pair with the largest normalised residual, if it is an outlier.
fn outlier(problem: &Problem, adjusted: &Adjusted) -> Option<usize> {
    if problem.pairs() < LEAST_TO_REJECT {
        return None;
    }
    let (worst, squared) = problem
        .residuals(&adjusted.model.view)
        .map(|(chi2, _)| chi2)
        .enumerate()
        .max_by(|a, b| a.1.total_cmp(&b.1))?;
    // The variance factor from the other pairs.
    let others = (adjusted.chi2_pairs - squared) / (adjusted.redundancy - 2.0).max(1.0);
    (squared > MAX_NORMALISED_RESIDUAL.powi(2) * others.max(1.0)).then_some(worst)
}

/// The covariance of a mapping without tilt, averaged with that of the same mapping with a tilt of up to 3 deg, weighted by the
/// probability of the latter (Bayesian model averaging: Hoeting et al. 1999).
///
/// The odds of the tilt are the prior odds, times exp(half the gain in chi^2), times the fraction of the possible tilts that
/// the data leave open (Occam's factor). If a tilt would be observable, it is improbable and adds nothing; if not, as
/// with few marks and half a limb, the covariance includes it.
fn averaged_covariance(problem: &Problem, simple: &Adjusted) -> Covariance {
    if simple.model.circle.is_none() {
        return simple.covariance;
    }
    let kind = match simple.terms.kind {
        MappingKind::Similarity => MappingKind::Keystone,
        MappingKind::Affine => MappingKind::Homography,
        MappingKind::Keystone | MappingKind::Homography => return simple.covariance,
    };
    let terms = Terms {
        kind,
        ..simple.terms
    };
    let Some(tilted) = problem.adjust(&simple.model, terms) else {
        return simple.covariance;
    };
    let gain = (simple.chi2() - tilted.chi2()).max(0.0);
    let odds = TILTED_ODDS * tilted.open_tilts() * (gain / 2.0).exp();
    let probability = odds / (1.0 + odds);
    let shift = tilted.model.unknowns() - simple.model.unknowns();
    simple.covariance * (1.0 - probability)
        + (tilted.covariance + shift * shift.transpose()) * probability
}
