//! Settings of the filter, from NAV.toml.

use crate::geometry::attitude::Direction;
use crate::instrument::toml_file::{TomlError, Utc, parse_strict, read_text};
use crate::instrument::{Role, rotation_of_rows};
use jiff::Timestamp;
use nalgebra::{Rotation3, Vector3};
use serde::Deserialize;
use std::path::Path;

/// Target of a vector measurement.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Target {
    Sun,
    Nadir,
    Moon,
}

impl Target {
    /// Target of the cameras of a role.
    pub fn of(role: Role) -> Self {
        match role {
            Role::PitchYaw => Self::Sun,
            Role::Roll => Self::Nadir,
            Role::Moon => Self::Moon,
        }
    }

    pub const ALL: [Self; 3] = [Self::Sun, Self::Nadir, Self::Moon];

    pub fn name(self) -> &'static str {
        match self {
            Self::Sun => "sun",
            Self::Nadir => "nadir",
            Self::Moon => "moon",
        }
    }

    pub fn named(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|target| target.name() == name)
    }
}

/// Definition of the downward direction.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Vertical {
    /// Towards the Earth's centre.
    #[default]
    Geocentric,
    /// Normal to the ellipsoid.
    Geodetic,
}

/// Groups of states that are estimated, or only considered: their errors enter every covariance, but no measurement changes
/// them (Schmidt).
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Group {
    AccelerometerBias,
    GyroBias,
    AccelerometerScale,
    GyroScale,
    /// Misalignment of both triads of axes.
    Misalignment,
    CameraMisalignment,
    CorrelatedErrors,
}

/// Errors that the paper considers (table 3), except for the gyro's bias, which a long flight determines.
const CONSIDERED: [Group; 4] = [
    Group::AccelerometerScale,
    Group::GyroScale,
    Group::Misalignment,
    Group::CorrelatedErrors,
];

/// The camera of the telescope, by the name of its table in the configuration.
const TELESCOPE: &str = "camera";

/// Minimum sigma of a fix, m and m/s: with smaller ones, two fixes at one time would contradict each other.
const LEAST_FIX: f64 = 1e-4;

/// Maximum biases, m/s^2 and rad/s, and maximum distance of the antenna.
const MOST_ACCELEROMETER_BIAS: f64 = 10.0;
const MOST_GYRO_BIAS: f64 = 1.0;
const MOST_ANTENNA_M: f64 = 1000.0;

/// Maximum rate of a vehicle, rad/s: a larger one is in other units.
const MOST_RATE_RAD_S: f64 = 60.0;
/// Maximum of an IMU's range or limit, in the units of its key.
const MOST_OF_RANGE: f64 = 1e5;

/// Maximum delay of a sensor's times.
const MOST_DELAY_S: f64 = 1.0;

/// Errors of the inertial measurement unit, 1 sigma unless stated otherwise.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Imu {
    pub velocity_random_walk: f64,
    pub angular_random_walk: f64,
    pub accelerometer_bias_sigma_m_s2: f64,
    pub gyro_bias_sigma_rad_s: f64,
    pub accelerometer_scale: f64,
    pub gyro_scale: f64,
    /// Misalignment of each triad of axes.
    pub misalignment_rad: f64,
    /// Initial uncertainty, about each axis.
    pub accelerometer_bias_m_s2: Vector3<f64>,
    pub gyro_bias_rad_s: Vector3<f64>,
    /// Delay of its times.
    pub delay_s: f64,
    /// Measuring range of its axes.
    pub accelerometer_range_m_s2: Option<f64>,
    pub gyro_range_rad_s: Option<f64>,
    /// Maximum rate of the vehicle, and of its change.
    pub most_rate_rad_s: f64,
    pub most_turn_rad_s2: Option<f64>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gps {
    pub position_sigma_m: f64,
    pub velocity_sigma_m_s: f64,
    /// Position of the antenna relative to the IMU, in the body's axes.
    pub antenna_m: Vector3<f64>,
    /// Delay of its times.
    pub delay_s: f64,
}

#[derive(Debug, Clone, PartialEq)]
pub struct NavigationCamera {
    pub name: String,
    pub body_from_camera: Rotation3<f64>,
    pub misalignment_rad: f64,
    pub correlation_time_s: f64,
    /// Delay of its times.
    pub delay_s: f64,
}

/// All values of NAV.toml.
#[derive(Debug, Clone, PartialEq)]
pub struct NavigationSettings {
    /// The instant of t_s = 0.
    pub epoch_utc: Option<Timestamp>,
    pub imu: Imu,
    pub gps: Gps,
    pub cameras: Vec<NavigationCamera>,
    /// Time-correlated part of the errors of directions to Sun, nadir and Moon, 1 sigma of each angle.
    pub correlated_rad: [f64; 3],
    pub vertical: Vertical,
    pub considered: Vec<Group>,
    /// Deviation of the accelerometers' mean over 2 s from straight down, 1 sigma; 0 if it is not used for the alignment.
    pub plumb_rad: f64,
}

#[derive(Deserialize)]
struct RawFile {
    epoch_utc: Option<Utc>,
    #[serde(default)]
    imu: RawImu,
    #[serde(default)]
    filter: RawFilter,
    #[serde(default)]
    gps: RawGps,
    #[serde(default, rename = "camera")]
    cameras: Vec<RawCamera>,
    #[serde(default)]
    nadir: RawTarget,
    #[serde(default)]
    sun: RawTarget,
    #[serde(default)]
    moon: RawTarget,
    /// Basis of a calibration; informative only.
    #[serde(default, rename = "calibration")]
    _calibration: Option<toml::Table>,
}

#[derive(Deserialize, Default)]
#[serde(default)]
struct RawImu {
    velocity_random_walk: f64,
    angular_random_walk: f64,
    accelerometer_bias: [f64; 3],
    gyro_bias: [f64; 3],
    accelerometer_bias_sigma: f64,
    gyro_bias_sigma: f64,
    misalignment_sigma_deg: f64,
    accelerometer_scale_sigma_ppm: f64,
    gyro_scale_sigma_ppm: f64,
    extra_velocity_random_walk: f64,
    extra_angular_random_walk: f64,
    delay_s: f64,
    accelerometer_range_m_s2: Option<f64>,
    gyro_range_deg_s: Option<f64>,
    most_rate_deg_s: Option<f64>,
    most_turn_deg_s2: Option<f64>,
}

#[derive(Deserialize, Default)]
#[serde(default)]
struct RawFilter {
    considered: Option<Vec<Group>>,
    plumb_sigma_deg: f64,
}

#[derive(Deserialize, Default)]
#[serde(default)]
struct RawGps {
    position_sigma_m: f64,
    velocity_sigma_m_s: f64,
    antenna_m: [f64; 3],
    delay_s: f64,
}

#[derive(Deserialize)]
struct RawCamera {
    name: String,
    body_from_camera: [[f64; 3]; 3],
    #[serde(default)]
    misalignment_sigma_deg: f64,
    #[serde(default)]
    correlation_time_s: f64,
    #[serde(default)]
    delay_s: f64,
}

#[derive(Deserialize, Default)]
#[serde(default)]
struct RawTarget {
    correlated_sigma_deg: f64,
    vertical: Option<Vertical>,
}

const KEYS: &[&str] = &[
    "epoch_utc",
    "imu.velocity_random_walk",
    "imu.angular_random_walk",
    "imu.accelerometer_bias",
    "imu.gyro_bias",
    "imu.accelerometer_bias_sigma",
    "imu.gyro_bias_sigma",
    "imu.misalignment_sigma_deg",
    "imu.accelerometer_scale_sigma_ppm",
    "imu.gyro_scale_sigma_ppm",
    "imu.extra_velocity_random_walk",
    "imu.extra_angular_random_walk",
    "imu.delay_s",
    "imu.accelerometer_range_m_s2",
    "imu.gyro_range_deg_s",
    "imu.most_rate_deg_s",
    "imu.most_turn_deg_s2",
    "filter.considered",
    "filter.plumb_sigma_deg",
    "gps.position_sigma_m",
    "gps.velocity_sigma_m_s",
    "gps.antenna_m",
    "gps.delay_s",
    "camera.name",
    "camera.body_from_camera",
    "camera.misalignment_sigma_deg",
    "camera.correlation_time_s",
    "camera.delay_s",
    "nadir.correlated_sigma_deg",
    "nadir.vertical",
    "sun.correlated_sigma_deg",
    "moon.correlated_sigma_deg",
    "calibration",
];

impl NavigationSettings {
    /// # Errors
    /// The file, the field, and what was expected there.
    pub fn read(path: &Path) -> Result<Self, TomlError> {
        Self::parse(path, &read_text(path)?)
    }

    /// Reads the text of such a file; `path` is used in error messages.
    ///
    /// # Errors
    /// As [`read`](Self::read).
    pub fn parse(path: &Path, text: &str) -> Result<Self, TomlError> {
        let known: Vec<String> = KEYS.iter().map(|key| (*key).into()).collect();
        let raw: RawFile = parse_strict(path, text, &known)?;
        let check = Check(path);
        if raw.sun.vertical.is_some() || raw.moon.vertical.is_some() {
            let field = "sun.vertical or moon.vertical";
            return Err(check.error(field, "it in [nadir] alone", "it here"));
        }
        Ok(Self {
            epoch_utc: raw.epoch_utc.map(|Utc(instant)| instant),
            imu: raw.imu.checked(&check)?,
            gps: raw.gps.checked(&check)?,
            correlated_rad: [
                check.degrees("sun.correlated_sigma_deg", raw.sun.correlated_sigma_deg)?,
                check.degrees("nadir.correlated_sigma_deg", raw.nadir.correlated_sigma_deg)?,
                check.degrees("moon.correlated_sigma_deg", raw.moon.correlated_sigma_deg)?,
            ],
            vertical: raw.nadir.vertical.unwrap_or_default(),
            cameras: cameras(raw.cameras, &check)?,
            plumb_rad: check.degrees("filter.plumb_sigma_deg", raw.filter.plumb_sigma_deg)?,
            considered: raw.filter.considered.unwrap_or(CONSIDERED.into()),
        })
    }

    /// Settings for a flight with cameras of these names, those of their tables in the configuration: no other names are
    /// allowed, and the telescope's own camera must be present, since its axes are the basis of the offsets.
    ///
    /// # Errors
    /// The file, the field, and what was expected there.
    pub fn for_flight(self, path: &Path, names: &[&str]) -> Result<Self, TomlError> {
        let check = Check(path);
        let is_unknown = |camera: &&NavigationCamera| !names.contains(&camera.name.as_str());
        if let Some(camera) = self.cameras.iter().find(is_unknown) {
            let expected = format!("one of {}", names.join(", "));
            return Err(check.error("camera.name", &expected, &camera.name));
        }
        let telescope = self.camera(TELESCOPE).map(|n| &self.cameras[n]);
        for (field, value, least) in [
            (
                "imu.velocity_random_walk",
                self.imu.velocity_random_walk,
                0.0,
            ),
            ("imu.angular_random_walk", self.imu.angular_random_walk, 0.0),
            ("gps.position_sigma_m", self.gps.position_sigma_m, 0.01),
            ("gps.velocity_sigma_m_s", self.gps.velocity_sigma_m_s, 0.001),
        ] {
            if value <= least {
                let expected = format!("more than {least}: offsets that are sent rest on it");
                return Err(check.error(field, &expected, value));
            }
        }
        match telescope.map(|camera| camera.misalignment_rad) {
            None => {
                let expected = "one named \"camera\": the telescope's own";
                Err(check.error("camera", expected, "none"))
            }
            Some(rad) if rad > 0.0 => {
                let expected = "0: offsets are those of this camera's telescope";
                let field = "camera \"camera\": misalignment_sigma_deg";
                Err(check.error(field, expected, rad.to_degrees()))
            }
            Some(_) => Ok(self),
        }
    }

    /// 1 sigma of each of the two angles of a direction: its own, and the stated time-correlated part, which a single frame
    /// cannot determine.
    pub fn sigma_rad(&self, target: Target, direction: &Direction) -> f64 {
        let own_rad = (direction.covariance_rad2.trace() / 2.0).max(0.0).sqrt();
        own_rad.hypot(self.correlated_rad[target as usize])
    }

    /// Rotation from the telescope's axes - forward, right, down - to the body's: those of the first camera in flight;
    /// identity if none is named.
    pub fn body_from_telescope(&self) -> Rotation3<f64> {
        let telescope = self.camera(TELESCOPE);
        telescope.map_or_else(Rotation3::identity, |n| self.cameras[n].body_from_camera)
    }

    /// The index of a camera by name.
    pub fn camera(&self, name: &str) -> Option<usize> {
        self.cameras.iter().position(|camera| camera.name == name)
    }
}

/// Checks the values of a file.
struct Check<'a>(&'a Path);

impl Check<'_> {
    fn error(&self, field: &str, expected: &str, found: impl ToString) -> TomlError {
        TomlError::new(self.0, field, expected, found.to_string())
    }

    /// A sigma between 0 and a limit.
    fn sigma(&self, field: &str, value: f64, most: f64) -> Result<f64, TomlError> {
        match (0.0..=most).contains(&value) {
            true => Ok(value),
            false => Err(self.error(field, &format!("a number from 0 to {most}"), value)),
        }
    }

    /// Three numbers with absolute values up to a limit.
    fn within(&self, field: &str, value: [f64; 3], most: f64) -> Result<Vector3<f64>, TomlError> {
        match value.iter().all(|one| one.abs() <= most) {
            true => Ok(value.into()),
            false => {
                let expected = format!("three numbers from -{most} to {most}");
                Err(self.error(field, &expected, format!("{value:?}")))
            }
        }
    }

    fn delay(&self, field: &str, value: f64) -> Result<f64, TomlError> {
        match value.abs() <= MOST_DELAY_S {
            true => Ok(value),
            false => {
                let expected = format!("a number within {MOST_DELAY_S} s");
                Err(self.error(field, &expected, value))
            }
        }
    }

    /// A positive number, if there is one.
    fn limit(&self, field: &str, value: Option<f64>) -> Result<Option<f64>, TomlError> {
        let is_limit = |value: &f64| *value > 0.0 && *value <= MOST_OF_RANGE;
        match value {
            Some(value) if !is_limit(&value) => {
                let expected = format!("a number above 0, to {MOST_OF_RANGE}");
                Err(self.error(field, &expected, value))
            }
            value => Ok(value),
        }
    }

    fn degrees(&self, field: &str, value: f64) -> Result<f64, TomlError> {
        Ok(self.sigma(field, value, 30.0)?.to_radians())
    }
}

impl RawImu {
    fn checked(&self, check: &Check) -> Result<Imu, TomlError> {
        let walk = |field: &str, value, extra: f64| {
            let value = check.sigma(field, value, 10.0)?;
            let field = field.replace("imu.", "imu.extra_");
            Ok(value.hypot(check.sigma(&field, extra, 10.0)?))
        };
        let ppm = |field, value| Ok(check.sigma(field, value, 1e5)? * 1e-6);
        let degrees = |field, value| Ok(check.limit(field, value)?.map(f64::to_radians));
        Ok(Imu {
            velocity_random_walk: walk(
                "imu.velocity_random_walk",
                self.velocity_random_walk,
                self.extra_velocity_random_walk,
            )?,
            angular_random_walk: walk(
                "imu.angular_random_walk",
                self.angular_random_walk,
                self.extra_angular_random_walk,
            )?,
            accelerometer_bias_sigma_m_s2: check.sigma(
                "imu.accelerometer_bias_sigma",
                self.accelerometer_bias_sigma,
                MOST_ACCELEROMETER_BIAS,
            )?,
            gyro_bias_sigma_rad_s: check.sigma(
                "imu.gyro_bias_sigma",
                self.gyro_bias_sigma,
                MOST_GYRO_BIAS,
            )?,
            accelerometer_bias_m_s2: check.within(
                "imu.accelerometer_bias",
                self.accelerometer_bias,
                MOST_ACCELEROMETER_BIAS,
            )?,
            gyro_bias_rad_s: check.within("imu.gyro_bias", self.gyro_bias, MOST_GYRO_BIAS)?,
            accelerometer_scale: ppm(
                "imu.accelerometer_scale_sigma_ppm",
                self.accelerometer_scale_sigma_ppm,
            )?,
            gyro_scale: ppm("imu.gyro_scale_sigma_ppm", self.gyro_scale_sigma_ppm)?,
            misalignment_rad: check
                .degrees("imu.misalignment_sigma_deg", self.misalignment_sigma_deg)?,
            delay_s: check.delay("imu.delay_s", self.delay_s)?,
            accelerometer_range_m_s2: check.limit(
                "imu.accelerometer_range_m_s2",
                self.accelerometer_range_m_s2,
            )?,
            gyro_range_rad_s: degrees("imu.gyro_range_deg_s", self.gyro_range_deg_s)?,
            most_rate_rad_s: degrees("imu.most_rate_deg_s", self.most_rate_deg_s)?
                .map_or(MOST_RATE_RAD_S, |most| most.min(MOST_RATE_RAD_S)),
            most_turn_rad_s2: degrees("imu.most_turn_deg_s2", self.most_turn_deg_s2)?,
        })
    }
}

impl RawGps {
    fn checked(&self, check: &Check) -> Result<Gps, TomlError> {
        Ok(Gps {
            position_sigma_m: check
                .sigma("gps.position_sigma_m", self.position_sigma_m, 1e6)?
                .max(LEAST_FIX),
            velocity_sigma_m_s: check
                .sigma("gps.velocity_sigma_m_s", self.velocity_sigma_m_s, 1e4)?
                .max(LEAST_FIX),
            antenna_m: check.within("gps.antenna_m", self.antenna_m, MOST_ANTENNA_M)?,
            delay_s: check.delay("gps.delay_s", self.delay_s)?,
        })
    }
}

fn cameras(raw: Vec<RawCamera>, check: &Check) -> Result<Vec<NavigationCamera>, TomlError> {
    let mut cameras: Vec<NavigationCamera> = Vec::new();
    for raw in raw {
        let field = |name: &str| format!("camera \"{}\": {name}", raw.name);
        if cameras.iter().any(|camera| camera.name == raw.name) {
            return Err(check.error("camera.name", "names that differ", raw.name));
        }
        cameras.push(NavigationCamera {
            body_from_camera: rotation_of_rows(&raw.body_from_camera).ok_or_else(|| {
                let expected = "three rows of a rotation (orthonormal to 1e-4, right-handed)";
                let found = format!("{:?}", raw.body_from_camera);
                check.error(&field("body_from_camera"), expected, found)
            })?,
            misalignment_rad: check
                .degrees(&field("misalignment_sigma_deg"), raw.misalignment_sigma_deg)?,
            correlation_time_s: check.sigma(
                &field("correlation_time_s"),
                raw.correlation_time_s,
                1e6,
            )?,
            delay_s: check.delay(&field("delay_s"), raw.delay_s)?,
            name: raw.name,
        });
    }
    Ok(cameras)
}
