//! The figures: the error against the noise and against the number of limb points, its histogram, and a mark's bias over
//! the sub-pixel phases.

use super::conditions::noise;
use super::marks::{BIAS_PX, BiasMap};
use super::outcome::{About, MOST, Summary};
use super::recipe::{ENOUGH_MARKS, Recipe, View};
use super::rows::Size;
use super::trial::{Bounded, Outcome, Trial, outcomes};
use crate::aspect::{Quality, SolverSettings};
use crate::estimation::MEDIAN_LENGTH_2D;
use crate::report::plot::{self, Arrow, Curve, Labels, PlotError, Stroke};
use crate::simulate::SceneError;

/// Noise of the sweep, DN.
const NOISE_DN: [f64; 8] = [1.0, 1.5, 2.5, 4.0, 6.0, 8.0, 11.0, 15.0];
/// Numbers of limb points of the sweep.
const LIMB_POINTS: [usize; 7] = [8, 16, 24, 32, 48, 64, 96];
/// Number of frames at each value of a sweep.
const FRAMES: [u64; 2] = [40, 600];
/// Number of these for which the bound is computed.
const BOUNDED_FRAMES: [u64; 2] = [6, 60];

/// Dependence of the errors on one quantity: its value and the statistics.
pub type Sweep = Vec<(f64, Summary)>;

/// The measurements for figures in addition to those of the table.
#[derive(Debug, Clone)]
pub struct Sweeps {
    pub noise: Sweep,
    pub limb_points: Sweep,
}

/// Number of frames of the sweeps.
pub fn frames(size: Size) -> u64 {
    size.of(FRAMES) * (NOISE_DN.len() + LIMB_POINTS.len()) as u64
}

/// The settings with a given number of limb points.
fn with_limb_points(settings: SolverSettings, points: usize) -> SolverSettings {
    let mut changed = settings;
    changed.limb.limb_points = points;
    changed
}

impl Sweeps {
    /// Runs the sweeps on all cores; `done` is called after every frame.
    pub fn run(trial: &Trial, size: Size, done: &(dyn Fn() + Sync)) -> Result<Self, SceneError> {
        let noise = NOISE_DN
            .iter()
            .map(|dn| Ok((*dn, at(trial, *dn, size, done)?)));
        let limb_points = LIMB_POINTS.iter().map(|points| {
            let changed = Trial {
                settings: with_limb_points(trial.settings, *points),
                ..trial.clone()
            };
            Ok((*points as f64, at(&changed, STANDARD_DN, size, done)?))
        });
        Ok(Self {
            noise: noise.collect::<Result<_, SceneError>>()?,
            limb_points: limb_points.collect::<Result<_, SceneError>>()?,
        })
    }
}

/// Noise of a standard frame.
const STANDARD_DN: f64 = 5.0;

/// The statistics of frames with enough marks, at a given noise.
fn at(
    trial: &Trial,
    noise_dn: f64,
    size: Size,
    done: &(dyn Fn() + Sync),
) -> Result<Summary, SceneError> {
    let mut recipe = Recipe::standard(&trial.instrument);
    recipe.view = View::Whole {
        lit_marks: ENOUGH_MARKS,
    };
    noise(&mut recipe, noise_dn);
    let outcomes = outcomes(size.of(FRAMES), done, |seed| {
        trial.outcome(&recipe, seed, Bounded::up_to(size.of(BOUNDED_FRAMES), seed))
    })?;
    let arcsec_per_mil = trial.instrument.optics.arcsec_per_mil();
    Ok(Summary::of(&outcomes, About::Fine, arcsec_per_mil))
}

fn curve(name: &str, sweep: &Sweep, stroke: Stroke, of: fn(&Summary) -> Option<f64>) -> Curve {
    let points = sweep.iter().filter_map(|(x, found)| Some((*x, of(found)?)));
    Curve::new(name, stroke, points)
}

fn curves_of(sweep: &Sweep) -> [Curve; 3] {
    [
        curve("99.7 %", sweep, Stroke::Measured, |s| s.most_arcsec),
        curve("median", sweep, Stroke::Measured, |s| s.median_arcsec),
        curve("median at the bound", sweep, Stroke::Known, |s| {
            s.bound.map(|b| b.median_arcsec * MEDIAN_LENGTH_2D)
        }),
    ]
}

const ERROR: &str = "radial error of the aspect, arcsec";

/// The error against the noise.
pub fn noise_figure(sweeps: &Sweeps) -> Result<String, PlotError> {
    let title = "Error of the aspect against noise, and the Cramer-Rao bound";
    let labels = Labels::new(title, "noise of a pixel, DN", ERROR);
    plot::curves(&labels, &curves_of(&sweeps.noise))
}

/// The error against the number of limb points.
pub fn limb_figure(sweeps: &Sweeps) -> Result<String, PlotError> {
    let title = format!("Error of the aspect against points of the limb, noise {STANDARD_DN} DN");
    let labels = Labels::new(title, "points of the limb", ERROR);
    plot::curves(&labels, &curves_of(&sweeps.limb_points))
}

/// The histogram of the fine frames' errors.
pub fn histogram(outcomes: &[Outcome], title: &str) -> Result<String, PlotError> {
    let fine = outcomes.iter().filter(|o| o.quality == Quality::Fine);
    let errors: Vec<f64> = fine
        .filter_map(|o| o.aspect.map(|e| e.radial_arcsec))
        .collect();
    let title = format!("Errors of {} fine frames, {title}", errors.len());
    let labels = Labels::new(title, ERROR, "frames");
    let lines = [("median", 0.5), ("99.7 %", MOST)]
        .map(|(name, part)| Some((name, super::chance::quantile(errors.clone(), part)?)));
    let lines: Vec<_> = lines.into_iter().flatten().collect();
    plot::histogram(&labels, &errors, 1.0, 40, &lines, None)
}

/// The bias of a mark over the sub-pixel phases.
pub fn bias_figure(map: &BiasMap) -> Result<String, PlotError> {
    let arrows: Vec<Arrow> = map
        .cells
        .iter()
        .filter_map(|cell| {
            let mean = cell.mean_px?;
            Some(Arrow {
                at: (cell.phase_px.x, cell.phase_px.y),
                vector: (mean.x, mean.y),
            })
        })
        .collect();
    let title = format!("Bias of a mark, allowed to {BIAS_PX} px");
    let x = "place of the mark from the middle of a pixel, x, px";
    let labels = Labels::new(title, x, "y, px");
    plot::vector_map(&labels, -0.5..0.5, &arrows, "px")
}
