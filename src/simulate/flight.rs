//! The scenes of a flight: one instrument whose mapping drifts, and the Sun on its path.

use super::blemish::Counts;
use super::pieces::Pieces;
use super::scene::{Blemishes, Noise, Scene, SceneError, Sun};
use super::trajectory::{Swing, Trajectory};
use super::{EXPOSURE, Purpose, derived_seed, frame_info, generator};
use crate::frame::FrameInfo;
use crate::geometry::{Distortion, Mapping, SimilarityParameters};
use crate::instrument::Instrument;
use crate::units::{PlateMil, SensorPx};
use nalgebra::Vector2;
use rand::RngExt;
use std::f64::consts::TAU;
use std::time::Duration;

/// Path of the Sun, and clouds in front of it.
#[derive(Debug, Clone)]
pub enum Course {
    /// Rests, slews and sway.
    Trajectory(Box<Trajectory>),
    /// A path from a file.
    Pieces(Pieces),
}

impl From<Trajectory> for Course {
    fn from(trajectory: Trajectory) -> Self {
        Self::Trajectory(Box::new(trajectory))
    }
}

impl From<Pieces> for Course {
    fn from(pieces: Pieces) -> Self {
        Self::Pieces(pieces)
    }
}

impl Course {
    /// Position of the Sun on the plate, possibly outside the camera's view.
    pub fn position(&self, since_start: Duration) -> PlateMil {
        match self {
            Self::Trajectory(trajectory) => trajectory.position(since_start),
            Self::Pieces(pieces) => pieces.position(since_start.as_secs_f64()),
        }
    }

    fn velocity_mil_per_s(&self, since_start: Duration) -> Vector2<f64> {
        match self {
            Self::Trajectory(trajectory) => trajectory.velocity_mil_per_s(since_start),
            Self::Pieces(pieces) => pieces.velocity_mil_per_s(since_start.as_secs_f64()),
        }
    }

    fn roll_deg(&self, since_start: Duration) -> f64 {
        match self {
            Self::Trajectory(_) => 0.0,
            Self::Pieces(pieces) => pieces.roll_deg(since_start.as_secs_f64()),
        }
    }

    /// Fraction of the light that passes the clouds, 0 to 1.
    fn light(&self, since_start: Duration) -> f64 {
        match self {
            Self::Trajectory(_) => 1.0,
            Self::Pieces(pieces) => pieces.light(since_start.as_secs_f64()),
        }
    }
}

/// The scenes of a flight.
#[derive(Debug, Clone)]
pub struct FlightScenes {
    /// Shared conditions of the scenes; change them to fly under other conditions.
    pub template: Scene,
    /// The Sun of every scene, except for its place and smear.
    pub sun: Sun,
    /// Exposure time. The Sun has the brightness of `sun` at [`EXPOSURE`], and is proportional otherwise.
    pub exposure: Duration,
    course: Course,
    drift: MappingDrift,
    seed: u64,
}

impl FlightScenes {
    /// A flight with 5 DN of noise, a few hot pixels, scratches and leaks, and a mapping that drifts slowly within the
    /// sigmas that the instrument states.
    pub fn new(
        instrument: &Instrument,
        course: impl Into<Course>,
        radius_mil: f64,
        seed: u64,
    ) -> Result<Self, SceneError> {
        let mapping = instrument.nominal_mapping().ok_or(SceneError::Mapping)?;
        let counts = Counts {
            hot_pixels: 20,
            scratches_per_disc: 0.5,
            leaks: 3,
            ..Counts::default()
        };
        let mut template = Scene {
            noise: Noise::read(5.0),
            ..Scene::new(instrument, mapping)
        };
        template.blemishes = Blemishes::random(&counts, &template, radius_mil, seed);
        Ok(Self {
            template,
            sun: Sun::new(PlateMil::new(0.0, 0.0), radius_mil),
            exposure: EXPOSURE,
            course: course.into(),
            drift: MappingDrift::new(instrument, seed),
            seed,
        })
    }

    /// The scene with mid-exposure `since_start` of the run.
    pub fn scene(&self, number: u64, since_start: Duration) -> Result<Scene, SceneError> {
        let velocity = self.course.velocity_mil_per_s(since_start);
        let exposure_s = self.exposure.as_secs_f64();
        let light = self.course.light(since_start) * exposure_s / EXPOSURE.as_secs_f64();
        let roll_deg = self.course.roll_deg(since_start);
        let mapping = self.drift.mapping(since_start, roll_deg);
        Ok(Scene {
            mapping: mapping.ok_or(SceneError::Mapping)?,
            sun: Some(Sun {
                centre: self.course.position(since_start),
                smear_mil: velocity * exposure_s,
                peak_dn: self.sun.peak_dn * light,
                ..self.sun.clone()
            }),
            seed: derived_seed(self.seed, Purpose::Noise, number),
            info: FrameInfo {
                exposure: Some(self.exposure),
                ..frame_info(number)
            },
            ..self.template.clone()
        })
    }
}

/// A mapping that differs from the stated one by up to its sigmas: half of each is constant, half varies periodically.
#[derive(Debug, Clone)]
struct MappingDrift {
    stated: SimilarityParameters,
    distortion: Distortion,
    /// 1 sigma of the plate's centre in x and y (px), of rotation (deg) and of scale (mil/px).
    sigmas: [f64; 4],
    constant: [f64; 4],
    swings: [Swing; 4],
}

impl MappingDrift {
    fn new(instrument: &Instrument, seed: u64) -> Self {
        let m = &instrument.mounting;
        let mut rng = generator(seed, Purpose::Drift, 0);
        Self {
            stated: m.similarity(),
            distortion: instrument.camera.distortion,
            sigmas: [
                m.plate_centre_sigma_px / 2.0_f64.sqrt(),
                m.plate_centre_sigma_px / 2.0_f64.sqrt(),
                m.rotation_deg.sigma,
                m.scale_mil_per_px.sigma,
            ],
            constant: std::array::from_fn(|_| rng.random_range(-0.5..0.5)),
            swings: std::array::from_fn(|_| Swing {
                amplitude: 0.5,
                period_s: rng.random_range(600.0..1200.0),
                phase: rng.random_range(0.0..TAU),
            }),
        }
    }

    fn mapping(&self, since_start: Duration, roll_deg: f64) -> Option<Mapping> {
        let time_s = since_start.as_secs_f64();
        let [x, y, turn, stretch]: [f64; 4] = std::array::from_fn(|n| {
            self.sigmas[n] * (self.constant[n] + self.swings[n].offset(time_s))
        });
        let centre = self.stated.plate_centre;
        let now = SimilarityParameters {
            plate_centre: SensorPx::new(centre.x + x, centre.y + y),
            scale_mil_per_px: self.stated.scale_mil_per_px + stretch,
            rotation_deg: self.stated.rotation_deg + turn + roll_deg,
            handedness: self.stated.handedness,
        };
        Mapping::similarity(now, self.distortion)
    }
}
