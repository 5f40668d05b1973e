//! Cameras that measure directions to the Sun and the Earth's centre.

use super::earth::FixedSun;
use super::motion::{Motion, State};
use super::span::Span;
use super::{Drawn, VectorRow, normal, random};
use crate::simulate::Generator;
use nalgebra::{Matrix3, Vector3};
use std::fmt;

/// Target of a direction.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Target {
    Sun,
    /// The Earth's centre.
    Nadir,
}

impl fmt::Display for Target {
    fn fmt(&self, f: &mut fmt::Formatter) -> fmt::Result {
        f.write_str(match self {
            Self::Sun => "sun",
            Self::Nadir => "nadir",
        })
    }
}

/// Errors of measured directions, for each of the two angles across them.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct DirectionErrors {
    /// 1 sigma, independent from one measurement to the next.
    pub white_sigma_deg: f64,
    /// 1 sigma of a first-order Gauss-Markov process, separate for each camera and target.
    pub correlated_sigma_deg: f64,
}

impl DirectionErrors {
    pub fn sigma_rad(&self) -> f64 {
        let sigma_deg = self.white_sigma_deg.hypot(self.correlated_sigma_deg);
        sigma_deg.to_radians()
    }
}

/// Times at which a camera observes its targets.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Visibility {
    Always,
    /// From one time to another, both included.
    Between {
        from_s: f64,
        to_s: f64,
    },
    /// Except for the last part of every period from time 0 on.
    WithGaps {
        period_s: f64,
        gap_s: f64,
    },
}

impl Visibility {
    fn at(&self, t_s: f64) -> bool {
        match *self {
            Self::Always => true,
            Self::Between { from_s, to_s } => (from_s..=to_s).contains(&t_s),
            Self::WithGaps { period_s, gap_s } => t_s.rem_euclid(period_s) < period_s - gap_s,
        }
    }
}

/// A camera of the vehicle.
#[derive(Debug, Clone, PartialEq)]
pub struct TargetCamera {
    pub name: &'static str,
    /// Rotation known to the navigation: from the camera's axes (x right, y down, z forward) to the body's.
    pub body_from_camera: Matrix3<f64>,
    /// Misalignment of the camera relative to that, about each of the body's axes.
    pub misalignment_sigma_deg: f64,
    /// Time over which the correlation of its errors falls to 1/e.
    pub correlation_time_s: f64,
    pub rate_hz: u64,
    pub targets: Vec<Target>,
    pub visibility: Visibility,
}

/// The cameras' targets and errors.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sky {
    pub sun: FixedSun,
    pub sun_errors: DirectionErrors,
    pub nadir_errors: DirectionErrors,
}

impl Sky {
    fn errors(&self, target: Target) -> DirectionErrors {
        match target {
            Target::Sun => self.sun_errors,
            Target::Nadir => self.nadir_errors,
        }
    }

    /// Direction in the body's axes.
    fn true_direction(&self, target: Target, state: &State, t_s: f64) -> Vector3<f64> {
        let direction = match target {
            Target::Sun => self.sun.direction(t_s),
            Target::Nadir => -state.path.position_m.normalize(),
        };
        state.attitude.rotation.inverse_transform_vector(&direction)
    }
}

/// Measurements of all cameras, sorted by time.
pub(super) fn measured(
    cameras: &[TargetCamera],
    span: &Span,
    sky: &Sky,
    motion: &dyn Motion,
    seed: u64,
) -> Vec<VectorRow> {
    let mut rows = Vec::new();
    for (place, camera) in cameras.iter().enumerate() {
        let mut mounted = Mounted::drawn(camera, sky, random(seed, Drawn::Camera(place)));
        // None at the start itself: every measurement is at the time of a row of the IMU.
        let times_s = span.ticks_s(camera.rate_hz).skip(1);
        for t_s in times_s.filter(|t_s| camera.visibility.at(*t_s)) {
            rows.extend(mounted.measured(&motion.at(t_s), t_s));
        }
    }
    rows.sort_by(|a, b| a.t_s.total_cmp(&b.t_s));
    rows
}

/// Misalignment of each camera for a seed, about the body's axes.
pub(super) fn misalignments_rad(cameras: &[TargetCamera], seed: u64) -> Vec<Vector3<f64>> {
    let cameras = cameras.iter().enumerate();
    let drawn = |(place, camera)| misalignment_rad(camera, &mut random(seed, Drawn::Camera(place)));
    cameras.map(drawn).collect()
}

fn misalignment_rad(camera: &TargetCamera, random: &mut Generator) -> Vector3<f64> {
    normal(random, camera.misalignment_sigma_deg.to_radians())
}

/// A camera with the misalignment of a seed.
struct Mounted<'a> {
    camera: &'a TargetCamera,
    sky: &'a Sky,
    /// Misalignment about the body's axes.
    misalignment_rad: Vector3<f64>,
    /// Correlated error of each target.
    correlated: Vec<Correlated>,
    random: Generator,
}

impl<'a> Mounted<'a> {
    fn drawn(camera: &'a TargetCamera, sky: &'a Sky, mut random: Generator) -> Self {
        let correlated = |target: &Target| Correlated {
            sigma_rad: sky.errors(*target).correlated_sigma_deg.to_radians(),
            time_s: camera.correlation_time_s,
            last_s: None,
            error_rad: Vector3::zeros(),
        };
        Self {
            camera,
            sky,
            misalignment_rad: misalignment_rad(camera, &mut random),
            correlated: camera.targets.iter().map(correlated).collect(),
            random,
        }
    }

    /// One row for each target.
    fn measured(&mut self, state: &State, t_s: f64) -> Vec<VectorRow> {
        let Self { camera, sky, .. } = *self;
        let mut rows = Vec::with_capacity(camera.targets.len());
        for (&target, correlated) in camera.targets.iter().zip(&mut self.correlated) {
            let errors = sky.errors(target);
            let body = sky.true_direction(target, state, t_s);
            let aligned = unturned(&body, &self.misalignment_rad);
            let seen = camera.body_from_camera.tr_mul(&aligned).normalize();
            let white_rad = normal(&mut self.random, errors.white_sigma_deg.to_radians());
            let error_rad = correlated.at(t_s, &mut self.random) + white_rad;
            let across_rad = error_rad - seen * seen.dot(&error_rad);
            rows.push(VectorRow {
                t_s,
                camera: camera.name,
                target,
                direction: (seen + across_rad).normalize(),
                sigma_rad: errors.sigma_rad(),
            });
        }
        rows
    }
}

/// Solves turned = (I + [turn x]) vector for the vector.
pub(super) fn unturned(turned: &Vector3<f64>, turn: &Vector3<f64>) -> Vector3<f64> {
    (turned - turn.cross(turned) + turn * turn.dot(turned)) / (1.0 + turn.norm_squared())
}

/// A first-order Gauss-Markov process, exact between any two times.
struct Correlated {
    sigma_rad: f64,
    time_s: f64,
    last_s: Option<f64>,
    /// Error at the last time.
    error_rad: Vector3<f64>,
}

impl Correlated {
    /// The error at a later time; the first one is drawn as if the process had always run.
    fn at(&mut self, t_s: f64, random: &mut Generator) -> Vector3<f64> {
        let kept = self
            .last_s
            .map_or(0.0, |last_s| ((last_s - t_s) / self.time_s).exp());
        let fresh_sigma_rad = self.sigma_rad * (1.0 - kept * kept).sqrt();
        self.error_rad = self.error_rad * kept + normal(random, fresh_sigma_rad);
        self.last_s = Some(t_s);
        self.error_rad
    }
}
