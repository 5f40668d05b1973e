//! The simplest lens, views and drifts that the observations support.

use super::adjust::{Adjusted, DRIFT, Freedoms, State};
use super::camera::LENS;
use super::robust::Bundle;
use crate::geometry::MappingKind;
use nalgebra::Vector2;

/// All parameters free.
pub(super) const ALL_FREE: Freedoms = Freedoms {
    view: MappingKind::Homography,
    lens: [true; LENS],
    marks: true,
    drift: DRIFT,
};
/// The lens's radial term r^2 alone: tried first.
const RADIAL: [bool; LENS] = [true, false, false, false];
/// Groups of lens terms that are tried after it, in this order: decentring, radial r^4.
const LENS_STEPS: [&[usize]; 2] = [&[2, 3], &[1]];
/// Least decrease of chi^2 for each added parameter, whatever the number of observations.
const LEAST_GAIN: f64 = 9.0;

/// The chosen views, lens terms and drifts.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Choice {
    pub kind: MappingKind,
    /// Radial r^2, radial r^4, decentring.
    pub lens: [bool; LENS],
    /// The degree in time of the drift within a pose; 0 if the camera is at rest.
    pub drift: usize,
}

impl Choice {
    pub(super) fn freedoms(self) -> Freedoms {
        Freedoms {
            view: self.kind,
            lens: self.lens,
            marks: true,
            drift: self.drift,
        }
    }
}

/// How well the frames separate the plate's errors from the lens's distortion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Separation {
    /// 1 sigma of the lens's displacement at the sensor's corner, px.
    pub lens_sigma_px: f64,
    /// The same with priors ten times as wide.
    pub without_priors_px: f64,
}

impl Separation {
    /// Compares the lens's sigma with its value for marks that might be far from their drawn position. Even a lens that needs no terms
    /// might have them: the first is always free here.
    pub(super) fn of(bundle: &Bundle, solved: &Adjusted, choice: Choice) -> Self {
        const LOOSER: f64 = 10.0;
        let mut freedoms = choice.freedoms();
        freedoms.lens[0] = true;
        let sigma_px = |bundle: &Bundle| {
            let solved = bundle.adjust(&solved.state, freedoms);
            solved.map_or(f64::INFINITY, |s| corner_sigma_px(&s))
        };
        let mut loose = bundle.clone();
        loose.widen_priors(LOOSER);
        loose.lens_sigma_px *= LOOSER;
        Self {
            lens_sigma_px: sigma_px(bundle),
            without_priors_px: sigma_px(&loose),
        }
    }

    /// Whether the frames themselves, not the priors, separate the plate's errors from the lens's distortion.
    pub fn by_data(&self) -> bool {
        self.without_priors_px < 2.0 * self.lens_sigma_px
    }
}

/// 1 sigma of the lens's displacement at a corner of the sensor, px, the mean of its axes.
fn corner_sigma_px(solved: &Adjusted) -> f64 {
    let slopes = solved.state.lens.slopes(Vector2::zeros());
    let spread = slopes * solved.lens_covariance() * slopes.transpose();
    (spread.trace() / 2.0).max(0.0).sqrt()
}

/// Chooses kind and lens terms with the bundle's weights; returns the fit with that choice.
///
/// A step is taken if chi^2, with the variances from the richest fit, decreases by more than ln n for each added parameter,
/// where n is the number of coordinates (Schwarz's criterion, which is the F test at that level). The radial term r^2 is omitted
/// only if the frames distinguish it from errors of the plate: otherwise the marks would absorb it, with sigmas that do not include it.
pub(super) fn choose(bundle: &Bundle, start: &State) -> Option<(Choice, Adjusted)> {
    let least_gain = bundle.coordinates().max(1.0).ln().max(LEAST_GAIN);
    let fit = |choice: Choice| {
        let solved = bundle.adjust(start, choice.freedoms())?;
        let chi2 = bundle.chi2(&solved.state) + solved.chi2_prior;
        Some((choice, solved, chi2))
    };
    let parameters = |choice: Choice| {
        let terms = choice.lens.iter().filter(|free| **free).count();
        (choice.kind.parameters() + 2 * choice.drift) * bundle.poses + terms
    };
    let mut best = fit(Choice {
        kind: MappingKind::Similarity,
        lens: ALL_FREE.lens,
        drift: ALL_FREE.drift,
    })?;
    for kind in [MappingKind::Keystone, MappingKind::Homography] {
        let larger = fit(Choice { kind, ..best.0 });
        best = better(best, larger, least_gain, parameters);
    }
    best = fit(Choice {
        lens: [false; LENS],
        ..best.0
    })?;
    let radial = fit(Choice {
        lens: RADIAL,
        ..best.0
    })?;
    best = match Separation::of(bundle, &radial.1, radial.0).by_data() {
        true => better(best, Some(radial), least_gain, parameters),
        false => radial,
    };
    for terms in LENS_STEPS {
        let mut choice = best.0;
        terms.iter().for_each(|n| choice.lens[*n] = true);
        best = better(best, fit(choice), least_gain, parameters);
    }
    let rigid = best.0;
    best = fit(Choice { drift: 0, ..rigid })?;
    for drift in 1..=DRIFT {
        let drifting = fit(Choice { drift, ..rigid });
        best = better(best, drifting, least_gain, parameters);
    }
    Some((best.0, best.1))
}

type Fitted = (Choice, Adjusted, f64);

/// The richer fit, if the decrease of its chi^2 justifies the parameters that it adds.
fn better(
    simple: Fitted,
    larger: Option<Fitted>,
    least_gain: f64,
    parameters: impl Fn(Choice) -> usize,
) -> Fitted {
    let gains = |larger: &Fitted| {
        let added = parameters(larger.0) - parameters(simple.0);
        (simple.2 - larger.2) / added as f64 > least_gain
    };
    match larger.filter(gains) {
        Some(larger) => larger,
        None => simple,
    }
}
