//! Pictures of the Earth's limb from a balloon or a rocket, with the truth about them.
//!
//! The ray of a pixel passes the air, a deck of clouds and the ground. Air scatters sunlight: its brightness saturates with the air's
//! optical depth along the ray, which decreases exponentially with the ray's lowest height (Chapman's grazing incidence, for a layer that is
//! thin compared with the Earth). Rays are straight.

mod front;
mod sky;
mod sunlight;
mod swing;

pub use sky::{Air, Clouds, Glow, Haze, Shape};
pub use swing::SwingingGondola;

use super::blur::Kernel;
use super::glare::{Glare, SUN_RAD};
use super::noise::{Readings, read_out};
use super::{Depth, Generator, Noise, Purpose, frame_info, generator};
use crate::frame::{Frame, FrameError};
use crate::geometry::camera::CameraModel;
use crate::units::SensorPx;
use front::Front;
use nalgebra::{Matrix3, Rotation3, UnitVector3, Vector2, Vector3};
use rand::RngExt;
use sky::Sky;

/// Margin of the rendered picture beyond its edges, for the blur.
const MARGIN_PX: usize = 8;

/// Conditions of the pictures: drawn at random for each, or fixed.
#[derive(Debug, Clone, PartialEq)]
pub struct EarthConditions {
    pub camera: CameraModel,
    pub width_px: usize,
    pub height_px: usize,
    /// The ground's shape; the camera is this high above it.
    pub shape: Shape,
    pub height_m: f64,
    pub aim: Aim,
    pub air: Air,
    /// `None` for clear ground.
    pub clouds: Option<Clouds>,
    /// Night on a part of the Earth: the Sun low, in any direction, or at its place in the picture.
    pub terminator: bool,
    /// The Sun in view, with its flares.
    pub sun: bool,
    /// Light above the limb that decreases over degrees.
    pub glow: Option<Glow>,
    /// Struts and banners of the vehicle in view.
    pub structure: bool,
    /// A full Moon in the picture, added to the other light.
    pub moon: bool,
    /// Stray light that increases across the picture.
    pub gradient: bool,
    /// Rotation about the camera's vertical during the exposure, deg.
    pub spin_deg: f64,
    pub blur_px: f64,
    pub background_dn: f64,
    pub noise: Noise,
    pub depth: Depth,
}

/// Pointing of the camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Aim {
    /// The horizon somewhere in the picture, with a roll up to this in either direction, deg.
    Horizon { most_roll_deg: f64 },
    /// Angle from the nadir, deg: the whole Earth is in view from high enough.
    Down { most_tilt_deg: f64 },
    /// Away from the Earth.
    Space,
}

impl EarthConditions {
    /// A camera of 1920 x 1080 px and 94.4 deg across that sees a clear limb.
    pub fn clear(height_m: f64) -> Self {
        const SIZE_PX: [usize; 2] = [1920, 1080];
        let middle = SIZE_PX.map(|size| (size as f64 - 1.0) / 2.0);
        let focal_px = SIZE_PX[0] as f64 / 2.0 / 47.2_f64.to_radians().tan();
        let camera = CameraModel::rectilinear(focal_px, SensorPx::new(middle[0], middle[1]));
        Self {
            camera,
            width_px: SIZE_PX[0],
            height_px: SIZE_PX[1],
            shape: Shape::SPHERE,
            height_m,
            aim: Aim::Horizon {
                most_roll_deg: 30.0,
            },
            air: Air::CLEAR,
            clouds: None,
            terminator: false,
            sun: false,
            glow: None,
            structure: false,
            moon: false,
            gradient: false,
            spin_deg: 0.0,
            blur_px: 0.8,
            background_dn: 6.0,
            noise: Noise {
                read_dn: 3.0,
                electrons_per_dn: None,
            },
            depth: Depth::Eight,
        }
    }

    /// The same with a limb whose brightness (relative) and height (m) vary along it, 1 sigma.
    pub fn varying(mut self, varies_by: f64, varies_by_m: f64) -> Self {
        (self.air.varies_by, self.air.varies_by_m) = (varies_by, varies_by_m);
        self
    }

    /// The scene for a seed and a number.
    pub fn scene(&self, seed: u64, number: u64) -> EarthScene {
        let mut random = generator(seed, Purpose::Earth, number);
        let latitude_deg = random.random_range(-80.0..80.0);
        let heading_deg = random.random_range(0.0..360.0);
        let (roll_deg, pitch_deg) = self.attitude(&mut random);
        EarthScene {
            conditions: self.clone(),
            latitude_deg,
            heading_deg,
            roll_deg,
            pitch_deg,
            seed,
            number,
            weather: number,
            camera: 0,
        }
    }

    /// Roll and pitch, deg.
    fn attitude(&self, random: &mut Generator) -> (f64, f64) {
        match self.aim {
            Aim::Horizon { most_roll_deg } => {
                // Dip of the limb's edge below the horizontal.
                let radius = self.shape.mean_radius_m();
                let dip_deg = (radius / (radius + self.height_m)).acos().to_degrees();
                let half_height =
                    (self.height_px as f64 / 2.0 / self.camera.mean_focal_px()).atan();
                let off_deg = half_height.to_degrees() * random.random_range(-0.6..0.6);
                (
                    random.random_range(-most_roll_deg..=most_roll_deg),
                    off_deg - dip_deg,
                )
            }
            Aim::Down { most_tilt_deg } => {
                let tilt_deg = random.random_range(0.0..=most_tilt_deg);
                (random.random_range(-180.0..180.0), tilt_deg - 90.0)
            }
            Aim::Space => {
                let up_deg = random.random_range(60.0..90.0);
                (random.random_range(-180.0..180.0), up_deg)
            }
        }
    }
}

/// Everything that defines a picture of the Earth.
#[derive(Debug, Clone, PartialEq)]
pub struct EarthScene {
    pub conditions: EarthConditions,
    /// Geodetic latitude.
    pub latitude_deg: f64,
    /// Azimuth of the optical axis, from north over east.
    pub heading_deg: f64,
    /// Positive with the right side low.
    pub roll_deg: f64,
    /// Elevation of the optical axis above the horizontal.
    pub pitch_deg: f64,
    pub seed: u64,
    pub number: u64,
    /// Number of the limb and the clouds: frames of one flight share them.
    pub weather: u64,
    /// Number of the vehicle's camera: each has its own noise.
    pub camera: u64,
}

/// The truth about a picture of the Earth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EarthTruth {
    /// Nadir in the camera frame.
    pub nadir: UnitVector3<f64>,
    /// Height above the ground at which the clear limb has half of its greatest brightness above the dark sky, m.
    pub edge_m: f64,
    /// Length of the edge that the picture shows, px.
    pub arc_px: f64,
    /// Fraction of that edge that has at least half of the full sunlight.
    pub lit: f64,
}

impl EarthScene {
    /// Rotation from the camera frame to north, east, down.
    pub fn local_from_camera(&self) -> Rotation3<f64> {
        let [roll, pitch, heading] =
            [self.roll_deg, self.pitch_deg, self.heading_deg].map(f64::to_radians);
        let level = Rotation3::from_axis_angle(&Vector3::z_axis(), heading)
            * Rotation3::from_axis_angle(&Vector3::y_axis(), pitch)
            * Rotation3::from_axis_angle(&Vector3::x_axis(), roll);
        // Camera x is right, y down, z forward; a level body has x forward, y right, z down.
        let body_from_camera = Matrix3::new(0.0, 0.0, 1.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0);
        level * Rotation3::from_matrix_unchecked(body_from_camera)
    }

    /// The same scene at the same moment in another camera; `turn` rotates its directions to the frame of this one.
    pub fn seen_by(&self, turn: &Rotation3<f64>) -> Self {
        let local = self.local_from_camera() * turn;
        let down = local.inverse() * Vector3::z_axis();
        let ahead = local * Vector3::z();
        Self {
            roll_deg: down.x.atan2(down.y).to_degrees(),
            pitch_deg: -down.z.asin().to_degrees(),
            heading_deg: ahead.y.atan2(ahead.x).to_degrees().rem_euclid(360.0),
            camera: self.camera + 1,
            ..self.clone()
        }
    }

    /// The frame: rendered, with noise, digitised.
    ///
    /// # Errors
    /// If the picture has no pixels.
    pub fn frame(&self) -> Result<Frame, FrameError> {
        let conditions = &self.conditions;
        let readings = Readings {
            width_px: conditions.width_px,
            noise: conditions.noise,
            depth: conditions.depth,
            seed: self.seed ^ self.number << 32 ^ self.camera << 60,
        };
        let pixels = read_out(&self.light(), &readings);
        let info = frame_info(self.number);
        let saturation_dn = conditions.depth.saturation_dn();
        Frame::new(
            conditions.width_px,
            conditions.height_px,
            pixels,
            saturation_dn,
            info,
        )
    }

    /// Light on the sensor in 8-bit DN, row by row: before noise and digitising.
    fn light(&self) -> Vec<f32> {
        let conditions = &self.conditions;
        let turns = self.turns_deg();
        let sky = Sky::of(self);
        let columns = conditions.width_px + 2 * MARGIN_PX;
        let rows = conditions.height_px + 2 * MARGIN_PX;
        let share = 1.0 / turns.len() as f32;
        let mut field = vec![0.0_f32; columns * rows];
        for turn_deg in turns {
            let turn = Rotation3::from_axis_angle(&Vector3::y_axis(), turn_deg.to_radians());
            let local = self.local_from_camera() * turn;
            for (n, light) in field.iter_mut().enumerate() {
                let (x, y) = ((n % columns) as f64, (n / columns) as f64);
                let at = SensorPx::new(x - MARGIN_PX as f64, y - MARGIN_PX as f64);
                if let Some(ray) = conditions.camera.ray(at) {
                    *light += share * sky.light_dn(&(local * ray)) as f32;
                }
            }
        }
        let kernel = Kernel::new(conditions.blur_px, 1);
        let margin = MARGIN_PX - kernel.margin_px().min(MARGIN_PX);
        let trimmed: Vec<f32> = field
            .chunks_exact(columns)
            .skip(margin)
            .take(rows - 2 * margin)
            .flat_map(|row| &row[margin..columns - margin])
            .copied()
            .collect();
        let (width, height) = (conditions.width_px, conditions.height_px);
        let mut light = kernel.apply(&trimmed, columns - 2 * margin, width, height);
        light
            .iter_mut()
            .for_each(|dn| *dn += conditions.background_dn as f32);
        if let Some(glare) = self.glare() {
            glare.add(width, &mut light);
        }
        let mut random = generator(self.seed, Purpose::Front, self.number);
        let front = Front::drawn(conditions, &mut random);
        for (n, dn) in light.iter_mut().enumerate() {
            let at = Vector2::new((n % width) as f64, (n / width) as f64);
            *dn = front.light_dn(&at, f64::from(*dn)) as f32;
        }
        light
    }

    fn glare(&self) -> Option<Glare> {
        const FLARES: usize = 7;
        let mut random = generator(self.seed, Purpose::Glare, self.number);
        let sun = self.sun_among(&mut random)?;
        let radius_px = SUN_RAD * self.conditions.camera.mean_focal_px();
        let middle = self.picture_px() / 2.0;
        Some(Glare::new(sun, radius_px, middle, FLARES, &mut random))
    }

    /// Position of the Sun in the picture, on the sky; `None` without a Sun, or if the picture shows no sky.
    fn sun_px(&self) -> Option<SensorPx> {
        self.sun_among(&mut generator(self.seed, Purpose::Glare, self.number))
    }

    fn sun_among(&self, random: &mut Generator) -> Option<SensorPx> {
        const MOST_TRIES: u32 = 50;
        if !self.conditions.sun {
            return None;
        }
        let place = |_| -> SensorPx {
            let within = self
                .picture_px()
                .map(|size| random.random_range(0.1..0.9) * size);
            within.into()
        };
        (0..MOST_TRIES).map(place).find(|at| self.shows_sky(*at))
    }

    fn picture_px(&self) -> Vector2<f64> {
        Vector2::new(
            self.conditions.width_px as f64,
            self.conditions.height_px as f64,
        )
    }

    /// The angle from the nadir to the ground's edge.
    fn edge_angle_rad(&self) -> f64 {
        let radius = self.conditions.shape.mean_radius_m();
        (radius / (radius + self.conditions.height_m)).asin()
    }

    /// Whether a pixel is above the ground.
    fn shows_sky(&self, at: SensorPx) -> bool {
        let ray = self.conditions.camera.ray(at);
        ray.is_some_and(|ray| (self.local_from_camera() * ray).z < self.edge_angle_rad().cos())
    }

    /// The rotations of the camera over which the exposure is averaged, deg.
    fn turns_deg(&self) -> Vec<f64> {
        const STEP_PX: f64 = 1.0;
        let spin_deg = self.conditions.spin_deg;
        let path_px = spin_deg.to_radians().abs() * self.conditions.camera.mean_focal_px();
        let count = 1 + (path_px / STEP_PX) as usize;
        (0..count)
            .map(|n| spin_deg * ((n as f64 + 0.5) / count as f64 - 0.5))
            .collect()
    }

    pub fn truth(&self) -> EarthTruth {
        let nadir = self.local_from_camera().inverse() * Vector3::z_axis();
        let sky = Sky::of(self);
        let edge_m = sky.edge_m();
        let arc = self.arc(edge_m);
        let lengths = || arc.iter().map(|(length_px, _)| length_px);
        let lit = arc
            .iter()
            .filter(|(_, middle)| sky.lit_towards(middle) >= 0.5);
        let arc_px = lengths().sum::<f64>();
        EarthTruth {
            nadir,
            edge_m,
            arc_px,
            lit: lit.map(|(length_px, _)| length_px).sum::<f64>() / arc_px.max(f64::MIN_POSITIVE),
        }
    }

    /// The edge within the picture: lengths of its pieces, px, and the ray to each in north, east, down.
    fn arc(&self, edge_m: f64) -> Vec<(f64, Vector3<f64>)> {
        const STEPS: u32 = 3600;
        let conditions = &self.conditions;
        let picture = self.picture_px();
        let inside =
            |at: &SensorPx| (0.0..picture.x).contains(&at.x) && (0.0..picture.y).contains(&at.y);
        let radius = conditions.shape.mean_radius_m();
        let angle = ((radius + edge_m) / (radius + conditions.height_m))
            .min(1.0)
            .asin();
        let camera_from_local = self.local_from_camera().inverse();
        let ray = |n: u32| {
            let (sine, cosine) =
                (f64::from(n) / f64::from(STEPS) * std::f64::consts::TAU).sin_cos();
            Vector3::new(cosine * angle.sin(), sine * angle.sin(), angle.cos())
        };
        let seen = |n: u32| {
            let ray = camera_from_local * UnitVector3::new_normalize(ray(n));
            conditions.camera.pixel(&ray).filter(inside)
        };
        let steps = (0..STEPS).filter_map(|n| Some((seen(n)?.distance(seen(n + 1)?), ray(n))));
        steps.collect()
    }
}
