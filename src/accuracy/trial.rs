//! One frame: its scene, the solution, and the difference between the two.

use super::bound;
use super::recipe::{Recipe, Vary, fully_lit, limb_share};
use crate::aspect::{Expected, Pipeline, Quality, Solution, SolverSettings, Stage, solve_with};
use crate::frame::Frame;
use crate::instrument::Instrument;
use crate::plate::MarkId;
use crate::simulate::{SUN_RADIUS_ARCSEC, Scene, SceneError};
use crate::units::SensorPx;
use nalgebra::{Matrix2, Vector2};
use rayon::prelude::*;

/// A mark farther than this from the true position of its id has a wrong id, px.
const WRONG_ID_PX: f64 = 3.0;
/// Expectation for every frame.
const EXPECTED: Option<Expected> = Some(Expected {
    radius_arcsec: SUN_RADIUS_ARCSEC,
});

/// A frame's solution compared with the truth.
#[derive(Debug, Clone, PartialEq)]
pub struct Outcome {
    pub seed: u64,
    pub quality: Quality,
    /// The reason if the frame is not fine.
    pub reason: Option<String>,
    /// True fraction of the limb on the sensor.
    pub limb_share: f64,
    /// True number of fully lit marks.
    pub lit_marks: usize,
    /// `None` without a true Sun or without a solution.
    pub aspect: Option<AspectError>,
    /// Fully lit marks with the right id.
    pub marks: Vec<MarkError>,
    pub wrong_ids: Vec<MarkId>,
    /// Whether the marks were not identified, and their most likely labelling is a false one.
    pub likeliest_is_false: bool,
    /// The Cramer-Rao bound of the covariance of the Sun's position on the plate, mil^2; if requested.
    pub bound_mil2: Option<Matrix2<f64>>,
}

/// Difference of the aspect from the truth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AspectError {
    /// Solution minus truth, on the plate.
    pub plate_mil: Vector2<f64>,
    /// Covariance stated by the solution.
    pub covariance_mil2: Matrix2<f64>,
    /// Distance on the plate, as an angle.
    pub radial_arcsec: f64,
    /// Distance of the Sun's centre from its true place on the sensor.
    pub sensor_px: f64,
}

impl AspectError {
    /// Ratio of error to stated sigma, by axis.
    pub fn over_sigma(&self) -> [f64; 2] {
        [0, 1].map(|axis| self.plate_mil[axis] / self.covariance_mil2[(axis, axis)].sqrt())
    }

    /// The error in sigma, along its own direction.
    pub fn sigmas(&self) -> f64 {
        let weight = self.covariance_mil2.try_inverse();
        weight.map_or(f64::INFINITY, |weight| {
            self.plate_mil.dot(&(weight * self.plate_mil)).sqrt()
        })
    }
}

/// Difference of a mark's position from the truth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MarkError {
    pub id: MarkId,
    pub true_px: SensorPx,
    /// Solution minus truth.
    pub px: Vector2<f64>,
    pub sigma_px: f64,
}

/// Solves frames and compares them with the truth.
#[derive(Debug, Clone)]
pub struct Trial {
    pub instrument: Instrument,
    pub settings: SolverSettings,
}

/// Whether to compute the Cramer-Rao bound of a frame: it costs several times as much as the frame.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Bounded {
    Yes,
    No,
}

impl Bounded {
    /// For the first `count` seeds.
    pub(super) fn up_to(count: u64, seed: u64) -> Self {
        match seed < count {
            true => Self::Yes,
            false => Self::No,
        }
    }
}

impl Trial {
    /// Makes the frame of a recipe and a seed, solves it on its own and compares it with the truth. The same seed always
    /// gives the same outcome.
    pub fn outcome(
        &self,
        recipe: &Recipe,
        seed: u64,
        bounded: Bounded,
    ) -> Result<Outcome, SceneError> {
        let scene = recipe.scene(&self.instrument, seed)?;
        let frame = scene.frame()?;
        let stated = Instrument {
            mounting: recipe.stated,
            ..self.instrument.clone()
        };
        let solution = solve_with(&self.settings, &frame, &stated, EXPECTED, None);
        let bound_mil2 = match bounded {
            Bounded::Yes => bound::covariance_mil2(&scene),
            Bounded::No => None,
        };
        let misread = solution.stopped.map(|stopped| stopped.stage) == Some(Stage::Identification)
            && self.is_likeliest_false(&scene, &frame, &stated) == Some(true);
        Ok(Outcome {
            bound_mil2,
            likeliest_is_false: misread,
            ..self.compare(&scene, &solution, seed)
        })
    }

    /// Outcomes of a number of frames, without their bounds.
    pub(super) fn outcomes(
        &self,
        vary: Vary,
        frames: u64,
        done: &(dyn Fn() + Sync),
    ) -> Result<Vec<Outcome>, SceneError> {
        outcomes(frames, done, |seed| {
            let recipe = Recipe::drawn(vary, &self.instrument, seed);
            self.outcome(&recipe, seed, Bounded::No)
        })
    }

    /// Whether the most likely labelling of a frame's marks gives one of them the id of another.
    fn is_likeliest_false(
        &self,
        scene: &Scene,
        frame: &Frame,
        stated: &Instrument,
    ) -> Option<bool> {
        let pipeline = Pipeline::new(&self.settings, stated, EXPECTED);
        let levels = pipeline.levels(frame).ok()?;
        let disc = pipeline.find_disc(frame, &levels, None).ok()?;
        let image = pipeline.image(frame, &levels, &disc).ok()?;
        let detections = pipeline.detect(&image);
        let sensor_px = [frame.width() as f64, frame.height() as f64];
        let ids = pipeline.likeliest_ids(sensor_px, image.light.outline, &detections)?;
        let is_false = |(n, id): &(usize, MarkId)| {
            let seen = scene
                .plate
                .position(*id)
                .map(|at| scene.mapping.to_sensor(at));
            seen.is_none_or(|seen| seen.distance(detections.marks[*n].at) > WRONG_ID_PX)
        };
        Some(ids.iter().any(is_false))
    }

    fn compare(&self, scene: &Scene, solution: &Solution, seed: u64) -> Outcome {
        let lit: Vec<_> = fully_lit(scene).collect();
        let (mut marks, mut wrong_ids) = (Vec::new(), Vec::new());
        for mark in &solution.marks {
            let Some(printed) = scene.plate.position(mark.id) else {
                wrong_ids.push(mark.id);
                continue;
            };
            let true_px = scene.mapping.to_sensor(printed);
            let px = mark.at.vector() - true_px.vector();
            if px.norm() > WRONG_ID_PX {
                wrong_ids.push(mark.id);
            } else if lit.iter().any(|l| l.id == mark.id) {
                marks.push(MarkError {
                    id: mark.id,
                    true_px,
                    px,
                    sigma_px: mark.sigma_px(),
                });
            }
        }
        Outcome {
            seed,
            quality: solution.quality,
            reason: solution.stopped.map(|stopped| stopped.to_string()),
            limb_share: limb_share(scene),
            lit_marks: lit.len(),
            aspect: self.aspect_error(scene, solution),
            marks,
            wrong_ids,
            likeliest_is_false: false,
            bound_mil2: None,
        }
    }

    fn aspect_error(&self, scene: &Scene, solution: &Solution) -> Option<AspectError> {
        let (truth, found) = (scene.truth().sun?, solution.aspect?);
        let plate_mil = found.sun_plate.position.vector() - truth.plate.vector();
        Some(AspectError {
            plate_mil,
            covariance_mil2: found.sun_plate.covariance,
            radial_arcsec: plate_mil.norm() * self.instrument.optics.arcsec_per_mil(),
            sensor_px: found.sun_px.position.distance(truth.px),
        })
    }
}

/// Outcomes by seed, from 0, on all cores.
pub(super) fn outcomes(
    frames: u64,
    done: &(dyn Fn() + Sync),
    outcome: impl Fn(u64) -> Result<Outcome, SceneError> + Sync,
) -> Result<Vec<Outcome>, SceneError> {
    let counted = |seed| outcome(seed).inspect(|_| done());
    (0..frames).into_par_iter().map(counted).collect()
}
