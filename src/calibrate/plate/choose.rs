//! The simplest lens and views that the sightings support.

use super::adjust::{Freedoms, Settled, State};
use super::camera::LENS;
use super::robust::Bundle;
use crate::geometry::MappingKind;

/// Everything free.
pub(super) const RICHEST: Freedoms = Freedoms {
    view: MappingKind::Homography,
    lens: [true; LENS],
    marks: true,
};
/// Groups of lens terms, each with what it adds.
const LENS_STEPS: [[usize; 2]; 3] = [[0, 0], [2, 3], [1, 1]];
/// Least gain in chi^2 for each added parameter, whatever the number of sightings.
const LEAST_GAIN: f64 = 9.0;

/// What was chosen, and what each richer choice would have gained.
#[derive(Debug, Clone, PartialEq)]
pub struct Choice {
    pub kind: MappingKind,
    /// Radial r^2, radial r^4, decentring.
    pub lens: [bool; LENS],
    /// Gain in chi^2 per parameter that a step must have.
    pub asked: f64,
    /// Each step that was tried: its name, its gain in chi^2 per parameter.
    pub tried: Vec<(&'static str, f64)>,
}

/// Chooses kind and lens terms with the bundle's weights; gives the fit that the choice leads to.
///
/// A step is taken when chi^2, with the variances that the richest fit shows, falls by more than ln n for each parameter
/// that it adds, n the number of coordinates (Schwarz's criterion, which is the F test at that level).
pub(super) fn choose(bundle: &Bundle, richest: &State) -> Option<(Choice, Settled)> {
    let asked = bundle.coordinates().max(1.0).ln().max(LEAST_GAIN);
    let mut tried = Vec::new();
    let fit = |freedoms| {
        let settled = bundle.settle(richest, freedoms)?;
        let cost = bundle.chi2(&settled.state) + settled.chi2_prior;
        Some((settled, cost))
    };
    let mut freedoms = Freedoms {
        view: MappingKind::Similarity,
        ..RICHEST
    };
    let mut best = fit(freedoms)?;
    for richer in [MappingKind::Keystone, MappingKind::Homography] {
        let free = Freedoms {
            view: richer,
            ..freedoms
        };
        let Some(candidate) = fit(free) else { continue };
        let added = (richer.parameters() - freedoms.view.parameters()) * bundle.poses;
        let gain = (best.1 - candidate.1) / added as f64;
        tried.push((richer.name(), gain));
        if gain > asked {
            (freedoms, best) = (free, candidate);
        }
    }
    freedoms.lens = [false; LENS];
    best = fit(freedoms)?;
    for (terms, name) in LENS_STEPS
        .into_iter()
        .zip(["radial r^2", "decentring", "radial r^4"])
    {
        let mut free = freedoms;
        terms.iter().for_each(|n| free.lens[*n] = true);
        let added =
            free.lens.iter().filter(|f| **f).count() - freedoms.lens.iter().filter(|f| **f).count();
        let Some(candidate) = fit(free) else { continue };
        let gain = (best.1 - candidate.1) / added.max(1) as f64;
        tried.push((name, gain));
        if gain > asked {
            (freedoms, best) = (free, candidate);
        }
    }
    let choice = Choice {
        kind: freedoms.view,
        lens: freedoms.lens,
        asked,
        tried,
    };
    Some((choice, best.0))
}
