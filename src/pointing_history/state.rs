//! A state of the smoother, and interpolation between two.

use nalgebra::{Matrix3, UnitQuaternion, Vector3};

/// Sensors used for an attitude.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Basis {
    Sun,
    Gyros,
    Both,
}

impl Basis {
    pub fn name(self) -> &'static str {
        match self {
            Self::Sun => "sun",
            Self::Gyros => "gyros",
            Self::Both => "both",
        }
    }

    /// Basis between two states: the sensors common to both.
    fn shared(self, other: Self) -> Self {
        match (self, other) {
            (Self::Both, one) | (one, Self::Both) => one,
            (one, _) => one,
        }
    }
}

/// The telescope's attitude at a moment.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct State {
    pub unix_s: f64,
    /// Rotation from the telescope's axes to Earth-fixed ones (ECEF).
    pub attitude: UnitQuaternion<f64>,
    /// Angular rate relative to the Earth, in the telescope's axes.
    pub rate_rad_s: Vector3<f64>,
    /// Random covariance: right, up and about the boresight.
    pub covariance_rad2: Matrix3<f64>,
    pub basis: Basis,
    /// Whether the Sun or the horizon contradicts the gyros then.
    pub is_contradicted: bool,
}

/// Rotation by small angles.
fn turn(rad: Vector3<f64>) -> UnitQuaternion<f64> {
    UnitQuaternion::from_scaled_axis(rad)
}

/// The state at a time between two others. The attitude is the cubic with their attitudes and rates: the rotation since the first state
/// is a small vector, whose rate differs from the body's by half their vector product (Bortz 1971).
pub fn between(before: &State, after: &State, unix_s: f64) -> State {
    let length_s = after.unix_s - before.unix_s;
    let turned = (before.attitude.inverse() * after.attitude).scaled_axis();
    let rates = [
        before.rate_rad_s,
        after.rate_rad_s + turned.cross(&after.rate_rad_s) / 2.0,
    ];
    let part = (unix_s - before.unix_s) / length_s;
    let rest = 1.0 - part;
    let since = turned * (part * part * (3.0 - 2.0 * part))
        + (rates[0] * rest - rates[1] * part) * (part * rest * length_s);
    State {
        unix_s,
        attitude: before.attitude * turn(since),
        rate_rad_s: before.rate_rad_s.lerp(&after.rate_rad_s, part),
        covariance_rad2: before.covariance_rad2 * rest + after.covariance_rad2 * part,
        basis: before.basis.shared(after.basis),
        is_contradicted: before.is_contradicted || after.is_contradicted,
    }
}
