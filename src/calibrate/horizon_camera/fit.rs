//! Least-squares fit of the camera: every frame has its own nadir, all share one camera and one height of the edge.
//!
//! Each frame's nadir is determined as in flight ([`horizon::nadir`](crate::horizon::nadir())), with its loss. Gauss-Newton steps for the
//! shared parameters use the residuals after each frame's nadir is fitted.
//!
//! A limb's residuals are correlated along the edge, and between frames of one flight, so the covariance is larger than for white noise. It is
//! estimated from blocks of successive frames as independent samples (the sandwich of Huber 1967).

use super::edges::{Limb, uncrossed};
use super::unknowns::{Change, Stated, UNKNOWNS, Unknown};
use crate::calibrate::numbers::sigma_text;
use crate::estimation::{Normal, Solved};
use crate::geometry::camera::CameraModel;
use crate::horizon::{Departure, EdgeHeight, EdgeRay, EdgeRays, Nadir, Sphere, across, nadir};
use crate::instrument::DirectionCamera;
use crate::units::Measured;
use nalgebra::{SMatrix, SVector, UnitVector3};
use rayon::prelude::*;
use std::slice::from_ref;

/// Fewer frames do not determine a scatter.
const LEAST_FRAMES: usize = 30;
/// Number of blocks of frames.
const BLOCKS: usize = 60;
const MOST_STEPS: usize = 30;
/// A shorter step ends the fit, in sigmas: points that enter or leave the edge change the solution by less.
const CONVERGED_SIGMAS: f64 = 0.02;
/// Step of the camera's numerical derivatives, relative to the assumed sigma of its file.
const DIFFERENCE: f64 = 1e-3;
/// Number of parameters of a frame: its nadir and the shared ones.
const OF_FRAME: usize = 2 + UNKNOWNS;

/// A camera's optics determined from frames.
#[derive(Debug, Clone, PartialEq)]
pub struct Optics {
    pub camera: CameraModel,
    /// Difference of each unknown from the file's value; see [`Unknown`].
    pub change: SVector<f64, UNKNOWNS>,
    pub covariance: SMatrix<f64, UNKNOWNS, UNKNOWNS>,
    /// Rms distance of the agreeing points of the edge from the cone, px.
    pub residual_px: f64,
    pub frames: usize,
    /// Points of the edge that agree, and all.
    pub agreeing: usize,
    pub points: usize,
    /// Parts of the picture that hardly any limb crosses; see [`PARTS`](crate::calibrate::parts::PARTS).
    pub uncrossed: Vec<&'static str>,
}

impl Optics {
    /// The change of an unknown.
    pub fn changed(&self, unknown: Unknown) -> Measured {
        let n = unknown as usize;
        Measured::new(self.change[n], self.covariance[(n, n)].max(0.0).sqrt())
    }

    /// Greatest difference of an unknown from another solution, in sigmas.
    pub(super) fn sigmas_from(&self, other: &Self) -> f64 {
        let apart = (self.change - other.change).abs();
        let sigmas = Unknown::ALL.map(|unknown| self.changed(unknown).sigma);
        apart.component_div(&Change::from(sigmas)).max()
    }

    /// Whether the frames determine the optics well enough.
    ///
    /// # Errors
    /// The first unknown that they do not determine.
    pub fn check_determined(&self, file: &DirectionCamera) -> Result<(), OpticsError> {
        for unknown in Unknown::REQUIRED {
            let most = unknown.most_sigma(file);
            let found = self.changed(unknown).sigma;
            if found > most {
                return Err(OpticsError::NotDetermined {
                    unknown,
                    most,
                    found,
                    advice: advice(self),
                });
            }
        }
        Ok(())
    }
}

/// Reasons for which frames give no optics.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum OpticsError {
    #[error("too few frames: expected at least {LEAST_FRAMES} that show the limb, found {0}")]
    TooFew(usize),
    #[error(
        "the {} is not determined: expected a sigma of {} at most, found {}; {advice}",
        .unknown.name(), sigma_text(*.most), sigma_text(*.found)
    )]
    NotDetermined {
        unknown: Unknown,
        most: f64,
        found: f64,
        advice: String,
    },
    #[error(
        "no camera fits the frames: expected an edge that is a cone of rays, found none after {MOST_STEPS} steps; check size, focal length and heights"
    )]
    NoFit,
}

/// Fits the optics, starting from the camera's file. [`Optics::check_determined`] checks whether the frames determine them.
///
/// # Errors
/// If there are too few frames, or no camera fits them.
pub fn fit(limbs: &[Limb], file: &DirectionCamera) -> Result<Optics, OpticsError> {
    if limbs.len() < LEAST_FRAMES {
        return Err(OpticsError::TooFew(limbs.len()));
    }
    let stated = Stated::new(file).ok_or(OpticsError::NoFit)?;
    let prior = stated.prior();
    let mut change = Change::zeros();
    for _ in 0..MOST_STEPS {
        let frames = of_frames(limbs, &stated, &change).ok_or(OpticsError::NoFit)?;
        let sum = sum(&frames);
        let solved = sum.solve(&prior, &change).ok_or(OpticsError::NoFit)?;
        let covariance = sandwich(&frames, &solved, &prior.information);
        let sigmas = covariance.diagonal().map(f64::sqrt);
        if solved.step.component_div(&sigmas).amax() < CONVERGED_SIGMAS {
            return optics(limbs, &stated, change, covariance).ok_or(OpticsError::NoFit);
        }
        change += solved.step;
    }
    Err(OpticsError::NoFit)
}

fn sum(frames: &[Normal<UNKNOWNS>]) -> Normal<UNKNOWNS> {
    frames
        .iter()
        .fold(Normal::zero(), |sum, frame| sum.with(frame))
}

/// Information of each frame on the shared parameters, its own nadir eliminated. Zero for a frame whose edge does not determine a nadir;
/// `None` if the change gives no valid camera.
fn of_frames(
    limbs: &[Limb],
    stated: &Stated<'_>,
    change: &Change,
) -> Option<Vec<Normal<UNKNOWNS>>> {
    let cameras = Cameras::new(stated, change)?;
    let frame = |limb: &Limb| {
        let limb = ObservedLimb::by(&cameras.camera, limb, change)?;
        cameras.normal(&limb).of_last::<2, UNKNOWNS>()
    };
    let frames = limbs.par_iter().map(frame);
    Some(
        frames
            .map(|frame| frame.unwrap_or(Normal::zero()))
            .collect(),
    )
}

/// A limb observed with a camera.
struct ObservedLimb {
    /// The Earth's sphere with the common height of the edge.
    sphere: Sphere,
    /// 1 sigma of the half-angle common to all frames: from the edge's height, and from its dependence on the picture's brightness.
    edge_rad: f64,
    rays: Vec<EdgeRay>,
    nadir: Nadir,
}

impl ObservedLimb {
    /// `None` if the edge does not determine a nadir.
    fn by(camera: &CameraModel, limb: &Limb, change: &Change) -> Option<Self> {
        let with_camera = |ray: &EdgeRay| {
            let unit = camera.ray(ray.at)?;
            Some(EdgeRay { unit, ..*ray })
        };
        let edge = EdgeRays {
            rays: limb.edge.rays.iter().filter_map(with_camera).collect(),
            sigma_rad: limb.edge.sigma_rad,
        };
        let mut sphere = limb.sphere;
        let edge_rad = sphere.half_angle_rad.sigma.hypot(edge.sigma_rad);
        sphere.half_angle_rad.value += change[Unknown::Edge as usize] * edge_rad;
        let found = nadir(from_ref(&edge), &sphere, EdgeHeight::Given, Departure::NONE);
        Some(Self {
            nadir: found.ok()?,
            rays: edge.rays,
            sphere,
            edge_rad,
        })
    }

    /// The rays that are part of the edge. They have equal weights: weights that depend on the residuals would add their derivatives to
    /// the normal equations.
    fn agreeing(&self) -> impl Iterator<Item = &EdgeRay> {
        let rays = self.rays.iter().enumerate();
        rays.filter(|(n, _)| self.nadir.agrees(*n))
            .map(|(_, ray)| ray)
    }

    fn down(&self) -> &UnitVector3<f64> {
        &self.nadir.direction.unit
    }

    /// Angle of a ray inside the edge, rad.
    fn residual_rad(&self, ray: &EdgeRay) -> f64 {
        let down = self.down();
        self.sphere.half_angle_towards(&ray.unit, down) - ray.angle_from(down).0
    }

    /// The point of the edge nearest to a ray.
    fn nearest_edge(&self, ray: &EdgeRay) -> UnitVector3<f64> {
        let inward = self.down().into_inner() - ray.unit.into_inner() * ray.unit.dot(self.down());
        let (sine, cosine) = self.residual_rad(ray).sin_cos();
        UnitVector3::new_normalize(ray.unit.into_inner() * cosine - inward.normalize() * sine)
    }
}

/// A camera, and variants with each of its unknowns changed by a small step.
struct Cameras {
    camera: CameraModel,
    varied: [(CameraModel, f64); UNKNOWNS - 1],
}

impl Cameras {
    fn new(stated: &Stated<'_>, change: &Change) -> Option<Self> {
        let camera = stated.camera(change)?;
        let mut varied = [(camera, 1.0); UNKNOWNS - 1];
        for (n, (camera, by)) in varied.iter_mut().enumerate() {
            *by = DIFFERENCE * Unknown::ALL[n].stated_sigma(stated.file);
            let mut change = *change;
            change[n] += *by;
            *camera = stated.camera(&change)?;
        }
        Some(Self { camera, varied })
    }

    /// The normal equations of a frame, for its nadir and the shared parameters. Rays beyond a lens's limit are ignored.
    fn normal(&self, limb: &ObservedLimb) -> Normal<OF_FRAME> {
        let mut normal = Normal::zero();
        for ray in limb.agreeing() {
            if let Some(slopes) = self.slopes(limb, ray) {
                let own_rad = ray.sigma_rad.hypot(ray.of_brightness_rad);
                let weight = (limb.nadir.scatter * own_rad).powi(-2);
                normal.add(&slopes, limb.residual_rad(ray), weight);
            }
        }
        normal
    }

    /// Derivatives of a ray's angle from the edge, by the nadir and the shared parameters. They are evaluated at the nearest point of the
    /// edge: at the ray its noise would enter its own derivatives, and a longer focal length would seem better because all angles,
    /// including noise, are smaller with it.
    fn slopes(&self, limb: &ObservedLimb, ray: &EdgeRay) -> Option<SVector<f64, OF_FRAME>> {
        let nearest = EdgeRay {
            unit: limb.nearest_edge(ray),
            ..*ray
        };
        let at = self.camera.pixel(&nearest.unit)?;
        let (angle, by_nadir) = nearest.angle_from(limb.down());
        let by_nadir = across(limb.down()).transpose() * by_nadir;
        let mut slopes = SVector::<f64, OF_FRAME>::zeros();
        slopes.fixed_rows_mut::<2>(0).copy_from(&by_nadir);
        for (n, (camera, by)) in self.varied.iter().enumerate() {
            let unit = camera.ray(at)?;
            slopes[2 + n] = (EdgeRay { unit, ..nearest }.angle_from(limb.down()).0 - angle) / by;
        }
        slopes[2 + Unknown::Edge as usize] = -limb.edge_rad;
        Some(slopes)
    }
}

/// The covariance of the solution, from the scatter of the blocks of frames.
fn sandwich(
    frames: &[Normal<UNKNOWNS>],
    solved: &Solved<UNKNOWNS>,
    prior: &SVector<f64, UNKNOWNS>,
) -> SMatrix<f64, UNKNOWNS, UNKNOWNS> {
    let blocks = frames.chunks(frames.len().div_ceil(BLOCKS));
    let count = blocks.len() as f64;
    let scatter = blocks.map(|block| {
        let sum = sum(block);
        // The gradient at the solution; otherwise a wrong start would count as scatter.
        let gradient = sum.gradient - sum.information * solved.step;
        gradient * gradient.transpose()
    });
    let scatter: SMatrix<f64, UNKNOWNS, UNKNOWNS> = scatter.sum();
    // The camera's parameters use five of the blocks' degrees of freedom.
    let freedom = count / (count - (UNKNOWNS - 1) as f64);
    let inverse = solved.covariance();
    inverse * (scatter * freedom + SMatrix::from_diagonal(prior)) * inverse
}

fn optics(
    limbs: &[Limb],
    stated: &Stated<'_>,
    change: Change,
    covariance: SMatrix<f64, UNKNOWNS, UNKNOWNS>,
) -> Option<Optics> {
    let camera = stated.camera(&change)?;
    let (mut squares, mut agreeing, mut points, mut frames) = (0.0, 0, 0, 0);
    for limb in limbs
        .iter()
        .filter_map(|limb| ObservedLimb::by(&camera, limb, &change))
    {
        frames += 1;
        points += limb.rays.len();
        agreeing += limb.nadir.agreeing();
        for ray in limb.agreeing() {
            let px_per_rad = (camera.pixel_jacobian(&ray.unit)? * ray.inward).norm();
            squares += (px_per_rad * limb.residual_rad(ray)).powi(2);
        }
    }
    Some(Optics {
        camera,
        change,
        covariance,
        residual_px: (squares / f64::max(agreeing as f64, 1.0)).sqrt(),
        frames,
        agreeing,
        points,
        uncrossed: uncrossed(limbs, stated.file),
    })
}

/// Advice on optics that the frames do not determine.
fn advice(optics: &Optics) -> String {
    match &optics.uncrossed[..] {
        [] => "state the camera's height and roll.atmosphere_m with smaller sigmas, or take frames from higher up, where the limb curves more".into(),
        parts => format!(
            "tilt and roll the camera until the limb crosses all parts of the picture: hardly a frame has it in {}",
            parts.join(", ")
        ),
    }
}
