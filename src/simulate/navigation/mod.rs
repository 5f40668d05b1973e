//! Flights of an inertial navigation system with their truth: an inertial measurement unit (IMU), GPS, and cameras that observe the Sun and the
//! nadir.
//!
//! A [`FlightPlan`] defines the vehicle and the sizes of the errors; [`FlightPlan::fly`] draws a [`Flight`], the same for the same seed.
//! Positions and attitudes are formulas of time, and the IMU's measurements follow from their derivatives: nothing is integrated here, so that
//! no filter shares an error with its truth.
//!
//! - Earth-fixed axes (ECEF) and the ellipsoid of WGS 84; gravitation with J2 of the Earth's flattening.
//! - An attitude rotates vectors from the body's axes to Earth-fixed ones: Hamilton's quaternion, q0 >= 0.
//! - A row of the IMU holds the means over the interval that ends at its time, in the body's axes; the first interval begins with the flight.
//! - Every camera gives every direction that its [`TargetCamera::targets`] name, regardless of its field of view.

mod balloon;
mod cameras;
mod config;
mod earth;
mod faults;
mod files;
mod fly;
mod imu;
mod motion;
mod plan;
mod rocket;
mod span;
mod telescope;
#[cfg(test)]
mod tests;

pub use cameras::{DirectionErrors, Target, TargetCamera, Visibility};
pub use faults::{FaultyImu, IMU_FAULTS, ImuFault, Shows};
pub use files::WriteError;
pub use imu::ImuErrors;
pub use plan::{FlightPlan, GpsErrors, Vehicle};
pub use telescope::{NoFlight, TelescopeFlight, TelescopeTruth};

use super::{Generator, Purpose, generator};
use nalgebra::{UnitQuaternion, Vector3};
use rand::RngExt;
use rand_distr::StandardNormal;

/// The measurements of a flight, and its truth.
#[derive(Debug, Clone, PartialEq)]
pub struct Flight {
    pub imu: Vec<ImuRow>,
    pub gps: Vec<GpsRow>,
    /// Sorted by time; those of the same time in the order of the plan's cameras.
    pub vectors: Vec<VectorRow>,
    /// At the times of the IMU's rows.
    pub truth: Vec<TruthRow>,
    /// Biases of accelerometers (m/s^2) and gyroscopes (rad/s).
    pub biases: [Vector3<f64>; 2],
    /// Misalignment of each camera of the plan, about the body's axes.
    pub misalignments_rad: Vec<Vector3<f64>>,
    /// One per second, from 2 s before the flight to 2 s after it.
    pub sun: Vec<SunRow>,
    /// The description of the instruments for the navigation: the text of `NAV.toml`.
    pub config_toml: String,
}

/// Means over the interval that ends at `t_s`, in the body's axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImuRow {
    pub t_s: f64,
    /// Acceleration less gravitation.
    pub specific_force_m_s2: Vector3<f64>,
    /// Rate relative to inertial space.
    pub rate_rad_s: Vector3<f64>,
}

/// Earth-fixed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GpsRow {
    pub t_s: f64,
    pub position_m: Vector3<f64>,
    pub velocity_m_s: Vector3<f64>,
}

/// A direction that a camera measured.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VectorRow {
    pub t_s: f64,
    /// Name of the camera.
    pub camera: &'static str,
    pub target: Target,
    /// Unit vector in the true axes of the camera.
    pub direction: Vector3<f64>,
    /// 1 sigma of each of the two angles across the direction.
    pub sigma_rad: f64,
}

/// True position and attitude of the vehicle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TruthRow {
    pub t_s: f64,
    pub ecef_from_body: UnitQuaternion<f64>,
    pub position_m: Vector3<f64>,
    pub velocity_m_s: Vector3<f64>,
}

/// Direction of the Sun: an Earth-fixed unit vector.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SunRow {
    pub t_s: f64,
    pub direction: Vector3<f64>,
}

/// Users of random numbers, each with its own, so that a change to one changes no other.
#[derive(Debug, Clone, Copy)]
enum Drawn {
    Motion,
    Imu,
    Gps,
    /// Index in the plan.
    Camera(usize),
}

fn random(seed: u64, drawn: Drawn) -> Generator {
    let number = match drawn {
        Drawn::Motion => 0,
        Drawn::Imu => 1,
        Drawn::Gps => 2,
        Drawn::Camera(place) => 3 + place as u64,
    };
    generator(seed, Purpose::Navigation, number)
}

/// Three independent normal numbers.
fn normal(random: &mut Generator, sigma: f64) -> Vector3<f64> {
    Vector3::from_fn(|_, _| sigma * random.sample::<f64, _>(StandardNormal))
}
