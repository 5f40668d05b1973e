//! Analytic motion: successive rotations, and axes that rotate at a constant rate.

use super::Drawn;
use super::earth::{earth_rate_rad_s, gravitation_m_s2};
use crate::simulate::Generator;
use nalgebra::{Rotation3, Unit, UnitQuaternion, Vector3};
use rand::RngExt;
use std::f64::consts::TAU;
use std::ops::Add;

/// Motion of a vehicle.
pub(super) trait Motion {
    fn at(&self, t_s: f64) -> State;
}

/// Position, attitude and their derivatives at one time.
#[derive(Debug, Clone, Copy)]
pub(super) struct State {
    pub path: Path,
    pub attitude: Attitude,
}

impl State {
    /// Specific force measured by an accelerometer without errors, in the body's axes.
    pub fn specific_force_m_s2(&self) -> Vector3<f64> {
        let Path {
            position_m,
            velocity_m_s,
            acceleration_m_s2,
        } = self.path;
        let turn = earth_rate_rad_s();
        let coriolis_m_s2 = 2.0 * turn.cross(&velocity_m_s);
        let centripetal_m_s2 = turn.cross(&turn.cross(&position_m));
        let inertial_m_s2 = acceleration_m_s2 + coriolis_m_s2 + centripetal_m_s2;
        let felt_m_s2 = inertial_m_s2 - gravitation_m_s2(&position_m);
        self.attitude.rotation.inverse_transform_vector(&felt_m_s2)
    }

    /// Rate measured by a gyroscope without errors, in the body's axes.
    pub fn inertial_rate_rad_s(&self) -> Vector3<f64> {
        let earth = earth_rate_rad_s();
        self.attitude.rate_rad_s + self.attitude.rotation.inverse_transform_vector(&earth)
    }
}

/// Position and its derivatives in axes of the flight; Earth-fixed in a [`State`].
#[derive(Debug, Clone, Copy)]
pub(super) struct Path {
    pub position_m: Vector3<f64>,
    pub velocity_m_s: Vector3<f64>,
    pub acceleration_m_s2: Vector3<f64>,
}

impl Path {
    /// The path in axes relative to which its own rotate at a constant rate about the common third one. Both agree at time 0.
    pub fn carried_round(&self, turn_rad_s: f64, t_s: f64) -> Self {
        let turn = Vector3::new(0.0, 0.0, turn_rad_s);
        let rotation = Rotation3::from_axis_angle(&Vector3::z_axis(), turn_rad_s * t_s);
        let carried_m_s = turn.cross(&self.position_m);
        let carried_m_s2 = turn.cross(&carried_m_s) + 2.0 * turn.cross(&self.velocity_m_s);
        Self {
            position_m: rotation * self.position_m,
            velocity_m_s: rotation * (self.velocity_m_s + carried_m_s),
            acceleration_m_s2: rotation * (self.acceleration_m_s2 + carried_m_s2),
        }
    }
}

/// An angle and its derivative.
#[derive(Debug, Clone, Copy)]
pub(super) struct Angle {
    pub rad: f64,
    pub rad_s: f64,
}

impl Add for Angle {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self {
            rad: self.rad + other.rad,
            rad_s: self.rad_s + other.rad_s,
        }
    }
}

impl Angle {
    pub fn steady(rad_s: f64, t_s: f64) -> Self {
        Self {
            rad: rad_s * t_s,
            rad_s,
        }
    }
}

/// An attitude built of successive rotations.
#[derive(Debug, Clone, Copy)]
pub(super) struct Attitude {
    /// Rotation from the body's axes to the axes before the first rotation.
    pub rotation: UnitQuaternion<f64>,
    /// Rate of the body relative to the axes before the first rotation, in the body's axes.
    pub rate_rad_s: Vector3<f64>,
}

impl Attitude {
    pub fn level() -> Self {
        Self {
            rotation: UnitQuaternion::identity(),
            rate_rad_s: Vector3::zeros(),
        }
    }

    /// Adds a rotation about an axis of the body, after the previous rotations.
    pub fn turned(&self, axis: Unit<Vector3<f64>>, angle: Angle) -> Self {
        let turn = UnitQuaternion::from_axis_angle(&axis, angle.rad);
        let before_rad_s = turn.inverse_transform_vector(&self.rate_rad_s);
        Self {
            rotation: self.rotation * turn,
            rate_rad_s: before_rad_s + axis.into_inner() * angle.rad_s,
        }
    }

    /// Adds a constant rotation.
    pub fn mounted(&self, turn: &UnitQuaternion<f64>) -> Self {
        Self {
            rotation: self.rotation * turn,
            rate_rad_s: turn.inverse_transform_vector(&self.rate_rad_s),
        }
    }
}

/// amplitude x sin(2 pi t / period + phase).
#[derive(Debug, Clone, Copy)]
pub(super) struct Wave {
    amplitude: f64,
    per_s: f64,
    phase_rad: f64,
}

impl Wave {
    /// A wave with a random phase.
    pub fn drawn(amplitude: f64, period_s: f64, random: &mut Generator) -> Self {
        Self {
            amplitude,
            per_s: TAU / period_s,
            phase_rad: random.random_range(0.0..TAU),
        }
    }

    /// The same wave advanced by a quarter of its period.
    pub fn quarter_ahead(&self) -> Self {
        Self {
            phase_rad: self.phase_rad + TAU / 4.0,
            ..*self
        }
    }

    /// The value with its first and second derivative.
    pub fn at(&self, t_s: f64) -> [f64; 3] {
        let (sin, cos) = (self.per_s * t_s + self.phase_rad).sin_cos();
        [
            self.amplitude * sin,
            self.amplitude * self.per_s * cos,
            -self.amplitude * self.per_s.powi(2) * sin,
        ]
    }
}

/// Sum of waves in degrees.
pub(super) fn swing<const N: usize>(waves_deg: &[Wave; N], t_s: f64) -> Angle {
    let still = Angle::steady(0.0, t_s);
    waves_deg.iter().fold(still, |sum, wave| {
        let [deg, deg_s, _] = wave.at(t_s);
        let (rad, rad_s) = (deg.to_radians(), deg_s.to_radians());
        sum + Angle { rad, rad_s }
    })
}

/// The random generator of a flight's phases.
pub(super) fn phases(seed: u64) -> Generator {
    super::random(seed, Drawn::Motion)
}
