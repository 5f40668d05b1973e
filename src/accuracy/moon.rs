//! Pictures of the Moon, and of other objects: a row of them, its requirements and its result.

use super::chance::{range_of_rms, rms};
use super::demand::Precision;
use super::recipe::Generator;
use super::rows::Size;
use crate::frame::FrameError;
use crate::geometry::unit;
use crate::moon::{Disc, Expected, MoonSettings, Optics, Quality, Radius, solve};
use crate::simulate::moon::{MoonConditions, MoonScene};
use crate::units::Measured;
use nalgebra::Vector2;
use rand::SeedableRng;
use rayon::prelude::*;
use std::fmt;
use std::ops::Range;

/// Prior knowledge of the Moon before its picture is solved.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Knowledge {
    Nothing,
    Radius,
    RadiusAndPhase,
}

impl Knowledge {
    pub fn name(self) -> &'static str {
        match self {
            Self::Nothing => "nothing",
            Self::Radius => "radius",
            Self::RadiusAndPhase => "radius, phase",
        }
    }

    /// The prior for a scene: the radius to 0.02 %, the phase to 0.1 deg.
    pub fn expected(self, scene: &MoonScene) -> Expected {
        let radius_px = scene.conditions.radius_px;
        let radius = Radius::Pixels(Measured::new(radius_px, 2e-4 * radius_px));
        let phase = Measured::new(scene.phase_angle_deg, 0.1);
        Expected {
            radius: (self != Self::Nothing).then_some(radius),
            phase_angle_deg: (self == Self::RadiusAndPhase).then_some(phase),
            bright_limb_deg: None,
        }
    }
}

/// A requirement of a row about the Moon.
#[derive(Debug, Clone, PartialEq)]
pub enum MoonDemand {
    /// Largest rms of the centre's error across the bright limb, px.
    AcrossPx(f64),
    /// Minimum share of frames that are fine.
    FineShare(f64),
    /// Ratio of error to stated sigma of the centre, rms per axis; see [`Precision`].
    SigmaRatio(Range<f64>),
    /// No fine frame is off by 5 sigma per axis and 0.3 px.
    NoWrongFine,
    /// No frame is reported as fine.
    NoneFine,
}

/// A row of pictures.
#[derive(Debug, Clone)]
pub struct MoonRow {
    pub title: String,
    pub known: Knowledge,
    /// Number of frames: in the small size, and in the full size.
    pub frames: [u64; 2],
    /// Draws the content of a picture.
    conditions: Draw,
    pub demands: Vec<MoonDemand>,
}

#[derive(Debug, Clone)]
pub(super) enum Draw {
    Same(Box<MoonConditions>),
    Any(fn(&mut Generator) -> MoonConditions),
}

/// Result of a row.
#[derive(Debug, Clone)]
pub struct MoonReport {
    pub row: MoonRow,
    pub found: MoonSummary,
    /// Why the row's requirements are not met.
    pub unmet: Vec<String>,
}

/// The statistics of a row's fine frames, except for the counts.
#[derive(Debug, Clone, PartialEq)]
pub struct MoonSummary {
    pub frames: usize,
    pub fine: usize,
    pub coarse: usize,
    /// Rms of the centre's error across the bright limb, px.
    pub across_px: Option<f64>,
    /// Rms of the ratio of its error to sigma, per axis.
    pub over_sigma: Option<f64>,
    /// Rms of the error of the lit fraction, and of its ratio to sigma; if the picture determines it.
    pub lit: Option<f64>,
    pub lit_over_sigma: Option<f64>,
    /// Seeds of fine frames with an error above 5 sigma per axis and 0.3 px.
    pub wrong_fine: Vec<u64>,
}

/// A frame in which a disc was found.
struct Found {
    seed: u64,
    quality: Quality,
    off_px: Vector2<f64>,
    across_px: f64,
    /// Ratio of the error to its sigma, rms of both axes of its covariance.
    over_sigma: f64,
    lit_off: f64,
    lit_sigma: f64,
}

impl MoonRow {
    pub(super) fn new(
        title: impl Into<String>,
        known: Knowledge,
        frames: [u64; 2],
        conditions: Draw,
    ) -> Self {
        Self {
            title: title.into(),
            known,
            frames,
            conditions,
            demands: vec![MoonDemand::NoWrongFine],
        }
    }

    pub(super) fn demanding(mut self, demands: &[MoonDemand]) -> Self {
        self.demands.extend_from_slice(demands);
        self
    }

    fn scene(&self, seed: u64) -> MoonScene {
        let conditions = match &self.conditions {
            Draw::Same(conditions) => (**conditions).clone(),
            Draw::Any(draw) => draw(&mut Generator::seed_from_u64(seed)),
        };
        conditions.scene(1, seed)
    }

    fn found(&self, seed: u64) -> Result<Option<Found>, FrameError> {
        let scene = self.scene(seed);
        let settings = MoonSettings {
            shading: scene.conditions.shading,
            optics: Optics::Aspect(scene.conditions.pixel_aspect),
        };
        let solved = solve(&settings, &scene.frame()?, &self.known.expected(&scene));
        Ok(solved.ok().map(|disc| Found::of(seed, &scene, &disc)))
    }

    /// Solves the row's frames on all cores.
    pub(super) fn run(
        &self,
        size: Size,
        precision: Precision,
        done: &(dyn Fn() + Sync),
    ) -> Result<MoonReport, FrameError> {
        let frames = size.of(self.frames);
        let found: Vec<Option<Found>> = (0..frames)
            .into_par_iter()
            .map(|seed| self.found(seed).inspect(|_| done()))
            .collect::<Result<_, _>>()?;
        let summary = MoonSummary::of(&found);
        let demands = self.demands.iter();
        let unmet = demands.filter_map(|demand| demand.unmet(&summary, precision));
        let unmet = unmet.map(|why| format!("{}, {} known: {why}", self.title, self.known.name()));
        Ok(MoonReport {
            unmet: unmet.collect(),
            row: self.clone(),
            found: summary,
        })
    }
}

impl Found {
    fn of(seed: u64, scene: &MoonScene, disc: &Disc) -> Self {
        let off_px = disc.centre.position.vector() - scene.centre.vector();
        let bright_limb_rad = scene.bright_limb_in_picture_deg().to_radians();
        let weight = disc.centre.covariance.try_inverse();
        Self {
            seed,
            quality: disc.quality,
            off_px,
            across_px: off_px.dot(&unit(bright_limb_rad)),
            over_sigma: weight.map_or(f64::INFINITY, |weight| {
                (off_px.dot(&(weight * off_px)) / 2.0).sqrt()
            }),
            lit_off: disc.lit().value - scene.lit(),
            lit_sigma: disc.lit().sigma,
        }
    }

    fn is_wrong(&self) -> bool {
        const SIGMAS: f64 = 5.0;
        const PX: f64 = 0.3;
        self.over_sigma > SIGMAS && self.off_px.norm() > PX
    }
}

impl MoonSummary {
    fn of(found: &[Option<Found>]) -> Self {
        let of_quality = |quality| (found.iter().flatten()).filter(move |f| f.quality == quality);
        let fine: Vec<&Found> = of_quality(Quality::Fine).collect();
        let wrong = fine.iter().filter(|found| found.is_wrong());
        Self {
            frames: found.len(),
            fine: fine.len(),
            coarse: of_quality(Quality::Coarse).count(),
            across_px: rms(fine.iter().map(|found| found.across_px)),
            over_sigma: rms(fine.iter().map(|found| found.over_sigma)),
            lit: rms(fine.iter().map(|found| found.lit_off)),
            lit_over_sigma: rms(fine.iter().map(|found| found.lit_off / found.lit_sigma)),
            wrong_fine: wrong.map(|found| found.seed).collect(),
        }
    }

    pub fn fine_share(&self) -> Option<f64> {
        (self.frames > 0).then(|| self.fine as f64 / self.frames as f64)
    }
}

impl MoonDemand {
    /// Why the requirement is not met; `None` if it is. A requirement without measurements is not met.
    fn unmet(&self, found: &MoonSummary, precision: Precision) -> Option<String> {
        let sigmas = precision.allowed_sigmas();
        let unknown = || Some("no fine frame".into());
        match self {
            Self::AcrossPx(most) => {
                let Some(across) = found.across_px else {
                    return unknown();
                };
                let least = *range_of_rms(across, found.fine, sigmas).start();
                (least > *most).then(|| format!("{across:.3} px across over {most}"))
            }
            Self::SigmaRatio(calibrated) => {
                let Some(over) = found.over_sigma else {
                    return unknown();
                };
                let range = range_of_rms(over, 2 * found.fine, sigmas);
                let met = *range.start() <= calibrated.end && *range.end() >= calibrated.start;
                (!met).then(|| format!("error/sigma {over:.2} of {} frames", found.fine))
            }
            Self::FineShare(least) => {
                let share = found.fine_share().unwrap_or(0.0);
                let scatter = (least * (1.0 - least) / found.frames.max(1) as f64).sqrt();
                let met = share + sigmas * scatter >= *least;
                (!met).then(|| format!("fine share {share:.3} under {least}"))
            }
            Self::NoWrongFine => (!found.wrong_fine.is_empty())
                .then(|| format!("wrong fine frames in seeds {:?}", found.wrong_fine)),
            Self::NoneFine => (found.fine > 0).then(|| format!("{} frames are fine", found.fine)),
        }
    }
}

impl fmt::Display for MoonDemand {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::AcrossPx(most) => write!(out, "{most} px"),
            Self::FineShare(least) => write!(out, "{:.0} % fine", 100.0 * least),
            Self::SigmaRatio(range) => write!(out, "error/sigma {} to {}", range.start, range.end),
            Self::NoWrongFine => write!(out, "none wrong"),
            Self::NoneFine => write!(out, "none fine"),
        }
    }
}
