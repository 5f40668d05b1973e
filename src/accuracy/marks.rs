//! Accuracy of a single mark's position: its error over many frames, and its bias over the sub-pixel phases.

use super::chance::{quantile, rms};
use super::conditions::noise;
use super::outcome::MOST;
use super::recipe::{Recipe, View};
use super::trial::{Bounded, MarkError, Outcome, Trial};
use crate::aspect::Quality;
use crate::instrument::Instrument;
use crate::plate::MarkId;
use crate::simulate::SceneError;
use crate::units::{PlateMil, SensorPx};
use nalgebra::Vector2;
use rayon::prelude::*;

/// Number of phases per axis of the bias map.
pub const PHASES: usize = 8;
/// Noise of the bias map's frames, DN: low, so that few frames suffice.
const MAP_NOISE_DN: f64 = 1.0;

/// Largest radial error of 99.7 % of the marks.
pub const MOST_ARCSEC: f64 = 0.55;
/// Largest mean error at any phase.
pub const BIAS_PX: f64 = 0.01;

/// Errors of single marks: fully lit ones with an id, in fine frames.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MarkSummary {
    pub marks: usize,
    pub median_px: f64,
    pub most_px: f64,
    pub median_arcsec: f64,
    pub most_arcsec: f64,
    /// Root mean square of the ratio of error to stated sigma, both axes combined.
    pub over_sigma: f64,
}

impl MarkSummary {
    /// `None` if no mark was found.
    pub fn of(outcomes: &[Outcome], arcsec_per_px: f64) -> Option<Self> {
        let errors: Vec<MarkError> = errors(outcomes).collect();
        let radial = || errors.iter().map(|e| e.px.norm()).collect();
        let (median_px, most_px) = (quantile(radial(), 0.5)?, quantile(radial(), MOST)?);
        let normalised = errors
            .iter()
            .flat_map(|e| [e.px.x / e.sigma_px, e.px.y / e.sigma_px]);
        Some(Self {
            marks: errors.len(),
            median_px,
            most_px,
            median_arcsec: median_px * arcsec_per_px,
            most_arcsec: most_px * arcsec_per_px,
            over_sigma: rms(normalised)?,
        })
    }
}

fn errors(outcomes: &[Outcome]) -> impl Iterator<Item = MarkError> + '_ {
    let fine = outcomes.iter().filter(|o| o.quality == Quality::Fine);
    fine.flat_map(|o| o.marks.iter().copied())
}

/// The mean error of a mark at each sub-pixel phase.
#[derive(Debug, Clone, PartialEq)]
pub struct BiasMap {
    /// Row by row, the phase along x fastest.
    pub cells: Vec<Bias>,
    pub frames: usize,
}

/// The mean error at one phase.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bias {
    /// Position of the true mark relative to a pixel's centre, -0.5 to 0.5 px.
    pub phase_px: Vector2<f64>,
    /// `None` if the mark was never found.
    pub mean_px: Option<Vector2<f64>>,
    /// 1 sigma of the mean, per axis.
    pub sigma_px: f64,
}

impl BiasMap {
    /// The largest mean error over all phases, px; `None` if a phase has none.
    pub fn largest_px(&self) -> Option<f64> {
        let lengths: Option<Vec<f64>> = self
            .cells
            .iter()
            .map(|cell| cell.mean_px.map(|mean| mean.norm()))
            .collect();
        quantile(lengths?, 1.0)
    }
}

/// The centre of a phase's cell, px from a pixel's centre.
fn phase_px(cell: usize) -> Vector2<f64> {
    let along = |n: usize| (n as f64 + 0.5) / PHASES as f64 - 0.5;
    Vector2::new(along(cell % PHASES), along(cell / PHASES))
}

/// Steps the plate's central mark through the phases, with a number of frames each; the Sun is placed around it at random.
pub fn bias_map(
    trial: &Trial,
    frames_per_phase: u64,
    done: &(dyn Fn() + Sync),
) -> Result<BiasMap, SceneError> {
    let stepped_mark = middle_mark(&trial.instrument);
    let cells = (0..PHASES * PHASES)
        .into_par_iter()
        .map(|cell| {
            let phase = phase_px(cell);
            let recipe = stepped(trial, phase, stepped_mark);
            let errors: Result<Vec<_>, SceneError> = (0..frames_per_phase)
                .map(|n| {
                    let seed = cell as u64 * frames_per_phase + n;
                    let outcome = trial.outcome(&recipe, seed, Bounded::No)?;
                    done();
                    Ok(errors(&[outcome])
                        .find(|e| e.id == stepped_mark)
                        .map(|e| e.px))
                })
                .collect();
            Ok(bias(
                phase,
                &errors?.into_iter().flatten().collect::<Vec<_>>(),
            ))
        })
        .collect::<Result<_, SceneError>>()?;
    Ok(BiasMap {
        cells,
        frames: frames_per_phase as usize * PHASES * PHASES,
    })
}

/// The mark nearest to the plate's centre.
fn middle_mark(instrument: &Instrument) -> MarkId {
    let marks = instrument.plate.marks();
    let from_centre = |(_, at): &(MarkId, PlateMil)| at.vector().norm();
    let nearest = marks.min_by(|a, b| from_centre(a).total_cmp(&from_centre(b)));
    nearest.map_or(MarkId { i: 0, j: 0 }, |(id, _)| id)
}

/// The frame whose central mark lies at a phase.
fn stepped(trial: &Trial, phase_px: Vector2<f64>, mark: MarkId) -> Recipe {
    let mut recipe = Recipe::standard(&trial.instrument);
    let centre = &mut recipe.conditions.similarity.plate_centre;
    let pixel = centre.vector().map(f64::floor);
    *centre = SensorPx::from(pixel + phase_px);
    recipe.view = View::Around(mark);
    noise(&mut recipe, MAP_NOISE_DN);
    recipe
}

fn bias(phase_px: Vector2<f64>, errors: &[Vector2<f64>]) -> Bias {
    let count = errors.len() as f64;
    let mean = errors.iter().sum::<Vector2<f64>>() / count;
    let squares: f64 = errors.iter().map(|e| (e - mean).norm_squared()).sum();
    Bias {
        phase_px,
        mean_px: (!errors.is_empty()).then_some(mean),
        sigma_px: (squares / 2.0 / (count - 1.0).max(1.0) / count).sqrt(),
    }
}

/// Unmet requirements of the marks.
pub fn unmet(summary: Option<&MarkSummary>, bias: &BiasMap) -> Vec<String> {
    let mut unmet = Vec::new();
    match summary {
        Some(found) if found.most_arcsec <= MOST_ARCSEC => {}
        Some(found) => unmet.push(format!(
            "99.7 % of the marks {:.3} arcsec over {MOST_ARCSEC}",
            found.most_arcsec
        )),
        None => unmet.push("no mark was found".into()),
    }
    match bias.largest_px() {
        Some(largest) if largest <= BIAS_PX => {}
        Some(largest) => unmet.push(format!("bias {largest:.4} px over {BIAS_PX}")),
        None => unmet.push("a phase at which the mark was never found".into()),
    }
    unmet
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_phases_are_spread_evenly_over_a_pixel() {
        let sum: Vector2<f64> = (0..PHASES * PHASES).map(phase_px).sum();
        assert!(sum.norm() < 1e-12);
        assert_eq!(phase_px(0), Vector2::new(-0.4375, -0.4375));
        assert_eq!(phase_px(PHASES), Vector2::new(-0.4375, -0.3125));
    }

    #[test]
    fn a_bias_is_the_mean_error_with_its_own_error() {
        let errors = [0.01, 0.03].map(|x| Vector2::new(x, 0.0));
        let bias = bias(Vector2::zeros(), &errors);
        assert!((bias.mean_px.unwrap() - Vector2::new(0.02, 0.0)).norm() < 1e-12);
        assert!((bias.sigma_px - 0.01 / 2.0_f64.sqrt()).abs() < 1e-9);
    }
}
