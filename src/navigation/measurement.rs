//! Measurements of the sensors, each with its own time.

use super::settings::{Imu, Target};
use nalgebra::{UnitVector3, Vector3};

/// The mean specific force and angular rate relative to inertial space over the interval that ends at a time, in the body's
/// axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImuSample {
    pub t_s: f64,
    pub force_m_s2: Vector3<f64>,
    pub rate_rad_s: Vector3<f64>,
    /// Step of its time relative to the count of samples, s; 0 if the samples are not counted.
    pub time_step_s: f64,
}

/// A larger specific force (50 g) is in other units, or invalid.
const MOST_FORCE_M_S2: f64 = 500.0;

/// Range of the distance from the Earth's centre, m, and maximum speed, m/s.
const DISTANCES_M: std::ops::Range<f64> = 6.3e6..1e8;
const MOST_SPEED_M_S: f64 = 12_000.0;

/// Values that are physically impossible for vehicle or receiver.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{what}: expected {expected}, found {found}")]
pub struct Implausible {
    pub what: &'static str,
    pub expected: String,
    pub found: String,
}

impl ImuSample {
    /// # Errors
    /// If the force is impossible for a vehicle, or the rate exceeds the limit stated for this vehicle.
    pub fn check(&self, imu: &Imu) -> Result<(), Implausible> {
        let (force, rate) = (self.force_m_s2.norm(), self.rate_rad_s.norm());
        for (what, unit, size, most) in [
            ("specific force", "m/s^2", force, MOST_FORCE_M_S2),
            ("rate", "rad/s", rate, imu.most_rate_rad_s),
        ] {
            if size > most {
                return Err(Implausible {
                    what,
                    expected: format!("less than {most} {unit}"),
                    found: format!("{size} {unit}"),
                });
            }
        }
        Ok(())
    }
}

/// A GPS fix, in ECEF.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Fix {
    pub t_s: f64,
    pub position_m: Vector3<f64>,
    /// `None` if the receiver gives none.
    pub velocity_m_s: Option<Vector3<f64>>,
    pub climb: Climb,
}

impl Fix {
    /// # Errors
    /// If the position is not near the Earth, or the speed is impossible for a vehicle.
    pub fn check(&self) -> Result<(), Implausible> {
        let distance_m = self.position_m.norm();
        if !DISTANCES_M.contains(&distance_m) {
            return Err(Implausible {
                what: "position",
                expected: format!("ECEF in m, {DISTANCES_M:?} from the Earth's centre"),
                found: format!("{distance_m} m"),
            });
        }
        match self.velocity_m_s.map(|velocity| velocity.norm()) {
            Some(speed_m_s) if speed_m_s > MOST_SPEED_M_S => Err(Implausible {
                what: "velocity",
                expected: format!("less than {MOST_SPEED_M_S} m/s"),
                found: format!("{speed_m_s} m/s"),
            }),
            _ => Ok(()),
        }
    }
}

/// Whether a fix contains the vertical velocity.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Climb {
    Measured,
    /// As in NMEA 0183: the velocity is horizontal only.
    Unknown,
}

impl Climb {
    pub fn name(self) -> &'static str {
        match self {
            Self::Measured => "measured",
            Self::Unknown => "unknown",
        }
    }

    pub fn named(name: &str) -> Option<Self> {
        let both = [Self::Measured, Self::Unknown];
        both.into_iter().find(|climb| climb.name() == name)
    }
}

/// A direction observed by a camera.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DirectionObservation {
    pub t_s: f64,
    /// Index among the cameras of the settings.
    pub camera: usize,
    pub target: Target,
    /// Unit vector in the camera's axes.
    pub unit: UnitVector3<f64>,
    /// 1 sigma of each of the two angles, including the part that is correlated in time.
    pub sigma_rad: f64,
    pub towards: Towards,
}

/// Direction of a target.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Towards {
    /// Unit vector in ECEF, at the time of the observation.
    Known(UnitVector3<f64>),
    /// Straight down from the body's position.
    Down,
}

#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Measurement {
    Direction(DirectionObservation),
    Fix(Fix),
}

impl Measurement {
    /// All measurements in the order of time; at equal times the directions first.
    pub fn in_order(
        observations: impl IntoIterator<Item = DirectionObservation>,
        fixes: &[Fix],
    ) -> Vec<Self> {
        let mut all: Vec<Self> = observations.into_iter().map(Self::Direction).collect();
        all.extend(fixes.iter().map(|fix| Self::Fix(*fix)));
        all.sort_by(|a, b| a.t_s().total_cmp(&b.t_s()));
        all
    }

    pub fn t_s(&self) -> f64 {
        match self {
            Self::Direction(observation) => observation.t_s,
            Self::Fix(fix) => fix.t_s,
        }
    }
}

/// Source of an innovation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Source {
    Direction {
        camera: usize,
        target: Target,
    },
    /// Straight down as measured by the accelerometers, for the alignment.
    Plumb,
    Position,
    Velocity,
}

/// Whether a measurement was accepted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Verdict {
    Taken,
    /// Its innovation is too large.
    Refused,
}

/// Measured minus predicted.
#[derive(Debug, Clone, PartialEq)]
pub struct Innovation {
    pub t_s: f64,
    pub source: Source,
    /// Along each measured axis, with its 1 sigma; rad, m or m/s. For a direction: the telescope's right and up, projected
    /// perpendicular to it.
    pub axes: Vec<(f64, f64)>,
    /// The same in units of its sigmas and decorrelated.
    pub whitened: Vec<f64>,
    /// Its square normalised by its covariance.
    pub chi2: f64,
    pub verdict: Verdict,
}
