//! Pictures of the Earth's limb, and of skies without one: a row of them, its requirements and its result.

use super::chance::{range_of_rms, rms};
use super::demand::Precision;
use super::recipe::Generator;
use super::rows::Size;
use crate::frame::FrameError;
use crate::horizon::{HorizonSettings, Quality, Refraction, Sphere, solve};
use crate::instrument::DirectionCamera;
use crate::simulate::earth::{EarthConditions, EarthScene};
use crate::units::Measured;
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rayon::prelude::*;
use std::fmt;
use std::ops::Range;

/// Minimum sunlit share of the visible edge of a frame that counts.
const LEAST_LIT: f64 = 0.25;
/// A fine frame with a larger error is wrong.
const FAR_DEG: f64 = 2.0;

/// A requirement of a row about the horizon.
#[derive(Debug, Clone, PartialEq)]
pub enum HorizonDemand {
    /// Minimum share of fine frames among those with at least a quarter of the visible edge lit.
    FineShare(f64),
    /// Ratio of error to stated sigma of the nadir, rms per axis; see [`Precision`].
    SigmaRatio(Range<f64>),
    /// No fine frame is off by more than 2 deg.
    NoneFarOff,
    /// No frame is reported as fine.
    NoneFine,
}

/// A row of pictures.
#[derive(Debug, Clone)]
pub struct HorizonRow {
    pub title: String,
    /// Number of frames: in the small size, and in the full size.
    pub frames: [u64; 2],
    /// 1 sigma of the height of the edge given to the solver, and of its error, m.
    pub edge_sigma_m: f64,
    /// Draws the content of a picture.
    draw: fn(&mut Generator, f64) -> EarthConditions,
    /// Height of the camera.
    height_m: f64,
    pub demands: Vec<HorizonDemand>,
}

/// Result of a row.
#[derive(Debug, Clone)]
pub struct HorizonReport {
    pub row: HorizonRow,
    pub found: HorizonSummary,
    /// Why the row's requirements are not met.
    pub unmet: Vec<String>,
}

/// The statistics of a row: errors are those of its fine frames, rms in deg.
#[derive(Debug, Clone, PartialEq)]
pub struct HorizonSummary {
    pub frames: usize,
    /// Number of frames with at least a quarter of the edge lit, and of the fine ones among them.
    pub lit: usize,
    pub lit_fine: usize,
    pub fine: usize,
    pub coarse: usize,
    pub roll_deg: Option<f64>,
    pub pitch_deg: Option<f64>,
    /// Mean error of the pitch.
    pub pitch_mean_deg: Option<f64>,
    /// Rms of the ratio of error to sigma, per axis.
    pub over_sigma: Option<f64>,
    /// Seeds of fine frames with an error above 2 deg.
    pub far_off: Vec<u64>,
}

/// A solved frame.
struct Outcome {
    seed: u64,
    quality: Quality,
    is_lit: bool,
    off: Option<Off>,
}

/// Difference of a nadir from the truth.
struct Off {
    nadir_deg: f64,
    roll_deg: f64,
    pitch_deg: f64,
    over_sigma: f64,
}

impl HorizonRow {
    pub(super) fn new(
        title: impl Into<String>,
        frames: [u64; 2],
        height_m: f64,
        edge_sigma_m: f64,
        draw: fn(&mut Generator, f64) -> EarthConditions,
    ) -> Self {
        Self {
            title: title.into(),
            frames,
            edge_sigma_m,
            draw,
            height_m,
            demands: vec![HorizonDemand::NoneFarOff],
        }
    }

    pub(super) fn demanding(mut self, demands: &[HorizonDemand]) -> Self {
        self.demands.extend_from_slice(demands);
        self
    }

    fn outcome(&self, seed: u64) -> Result<Outcome, FrameError> {
        let mut random = Generator::seed_from_u64(seed);
        let scene = (self.draw)(&mut random, self.height_m).scene(1, seed);
        let off: f64 = random.sample(StandardNormal);
        let truth = scene.truth();
        let edge_m = Measured::new(truth.edge_m + off * self.edge_sigma_m, self.edge_sigma_m);
        let height_m = Measured::new(scene.conditions.height_m, 0.0);
        let sphere = Sphere::earth(height_m, edge_m, Refraction::None);
        let camera = camera(&scene.conditions);
        let settings = HorizonSettings::default();
        let frame = scene.frame()?;
        let solved = sphere.map(|sphere| solve(&settings, &frame, &camera, &sphere, None));
        let nadir = solved
            .as_ref()
            .and_then(|solved| solved.nadir.as_ref().ok());
        Ok(Outcome {
            seed,
            quality: solved
                .as_ref()
                .map_or(Quality::None, |solved| solved.quality()),
            is_lit: truth.arc_px > 0.0 && truth.lit >= LEAST_LIT,
            off: nadir.map(|nadir| Off::of(nadir, &scene)),
        })
    }

    /// Solves the row's frames on all cores.
    pub(super) fn run(
        &self,
        size: Size,
        precision: Precision,
        done: &(dyn Fn() + Sync),
    ) -> Result<HorizonReport, FrameError> {
        let seeds = (0..size.of(self.frames)).into_par_iter();
        let outcomes = seeds.map(|seed| self.outcome(seed).inspect(|_| done()));
        let found = HorizonSummary::of(&outcomes.collect::<Result<Vec<_>, _>>()?);
        let demands = self.demands.iter();
        let unmet = demands.filter_map(|demand| demand.unmet(&found, precision));
        Ok(HorizonReport {
            unmet: unmet.map(|why| format!("{}: {why}", self.title)).collect(),
            row: self.clone(),
            found,
        })
    }
}

/// The camera of a scene, with the values of its file.
fn camera(conditions: &EarthConditions) -> DirectionCamera {
    DirectionCamera {
        width_px: conditions.width_px,
        height_px: conditions.height_px,
        lens: conditions.camera,
        body_from_camera: None,
        mask: Vec::new(),
    }
}

impl Off {
    fn of(nadir: &crate::horizon::Nadir, scene: &EarthScene) -> Self {
        let truth = scene.truth().nadir;
        let off = nadir.direction.unit.into_inner() - truth.into_inner();
        let covariance = nadir.direction.covariance_rad2;
        let weight = covariance.pseudo_inverse(1e-6 * covariance.norm());
        let squares = weight.map_or(f64::INFINITY, |weight| off.dot(&(weight * off)));
        let roll_deg = nadir.roll_deg() - scene.roll_deg;
        Self {
            nadir_deg: nadir.direction.unit.angle(&truth).to_degrees(),
            roll_deg: (roll_deg + 180.0).rem_euclid(360.0) - 180.0,
            pitch_deg: nadir.pitch_deg() - scene.pitch_deg,
            over_sigma: (squares / 2.0).sqrt(),
        }
    }
}

impl HorizonSummary {
    fn of(outcomes: &[Outcome]) -> Self {
        let is_fine = |outcome: &&Outcome| outcome.quality == Quality::Fine;
        let fine: Vec<&Outcome> = outcomes.iter().filter(is_fine).collect();
        let off: Vec<&Off> = fine.iter().filter_map(|o| o.off.as_ref()).collect();
        let is_far = |o: &&&Outcome| o.off.as_ref().is_some_and(|off| off.nadir_deg > FAR_DEG);
        let mean = off.iter().map(|off| off.pitch_deg).sum::<f64>() / off.len() as f64;
        Self {
            frames: outcomes.len(),
            lit: outcomes.iter().filter(|o| o.is_lit).count(),
            lit_fine: fine.iter().filter(|o| o.is_lit).count(),
            fine: fine.len(),
            coarse: outcomes
                .iter()
                .filter(|o| o.quality == Quality::Coarse)
                .count(),
            roll_deg: rms(off.iter().map(|off| off.roll_deg)),
            pitch_deg: rms(off.iter().map(|off| off.pitch_deg)),
            pitch_mean_deg: (!off.is_empty()).then_some(mean),
            over_sigma: rms(off.iter().map(|off| off.over_sigma)),
            far_off: fine.iter().filter(is_far).map(|o| o.seed).collect(),
        }
    }

    /// Share of fine frames among those with at least a quarter of the edge lit.
    pub fn fine_share(&self) -> Option<f64> {
        (self.lit > 0).then(|| self.lit_fine as f64 / self.lit as f64)
    }
}

impl HorizonDemand {
    /// Why the requirement is not met; `None` if it is. A requirement without measurements is not met.
    fn unmet(&self, found: &HorizonSummary, precision: Precision) -> Option<String> {
        let sigmas = precision.allowed_sigmas();
        match self {
            Self::FineShare(least) => {
                let share = found.fine_share().unwrap_or(0.0);
                let scatter = (least * (1.0 - least) / found.lit.max(1) as f64).sqrt();
                let met = share + sigmas * scatter >= *least;
                (!met).then(|| format!("fine share {share:.3} under {least}"))
            }
            Self::SigmaRatio(calibrated) => {
                let Some(over) = found.over_sigma else {
                    return Some("no fine frame".into());
                };
                let range = range_of_rms(over, 2 * found.fine, sigmas);
                let met = *range.start() <= calibrated.end && *range.end() >= calibrated.start;
                (!met).then(|| format!("error/sigma {over:.2} of {} frames", found.fine))
            }
            Self::NoneFarOff => (!found.far_off.is_empty())
                .then(|| format!("fine frames far off in seeds {:?}", found.far_off)),
            Self::NoneFine => (found.fine > 0).then(|| format!("{} frames are fine", found.fine)),
        }
    }
}

impl fmt::Display for HorizonDemand {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::FineShare(least) => write!(out, "{:.0} % fine", 100.0 * least),
            Self::SigmaRatio(range) => write!(out, "error/sigma {} to {}", range.start, range.end),
            Self::NoneFarOff => write!(out, "none off by 2 deg"),
            Self::NoneFine => write!(out, "none fine"),
        }
    }
}
