//! A synthetic pointing: the telescope rotates at a constant rate in front of a fixed Sun.

use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};
use solaspect::pointing_history::{Basis, PointingHistory, Second, State};

/// 2013-09-21T18:00:00Z, and midnight before it.
pub const START_S: f64 = 1_379_786_400.0;
pub const MIDNIGHT_S: f64 = START_S - 64_800.0;
pub const MJD_OF_MIDNIGHT: f64 = 56_556.0;
pub const SECONDS: usize = 60;
pub const STATE_HZ: usize = 4;
pub const ARCSEC: f64 = std::f64::consts::PI / 180.0 / 3600.0;

/// Attitude at the start, with these axes as columns: forward to the Sun (x), right to solar west (-y), down to solar south (-z).
pub fn level() -> UnitQuaternion<f64> {
    let axes = Matrix3::new(1.0, 0.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, -1.0);
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes))
}

/// Angular rate in the telescope's axes.
pub fn rate_rad_s() -> Vector3<f64> {
    Vector3::new(300.0, 20.0, -30.0) * ARCSEC
}

pub fn attitude(unix_s: f64) -> UnitQuaternion<f64> {
    let turned = UnitQuaternion::from_scaled_axis(rate_rad_s() * (unix_s - START_S));
    let begun = UnitQuaternion::from_scaled_axis(Vector3::new(0.4, 200.0 * ARCSEC, -90.0 * ARCSEC));
    level() * begun * turned
}

/// Origin (HPX, HPY), arcsec, of a photon seen at this offset right and up of the boresight, arcsec.
pub fn truth_arcsec(attitude: &UnitQuaternion<f64>, [right, up]: [f64; 2]) -> [f64; 2] {
    let v = attitude * Vector3::new(1.0, right * ARCSEC, -up * ARCSEC).normalize();
    [(-v.y).atan2(v.x), v.z.atan2(v.x.hypot(v.y))].map(|rad| rad / ARCSEC)
}

pub fn random_rad2() -> Matrix3<f64> {
    Matrix3::new(4.0, 1.0, 90.0, 1.0, 2.0, -60.0, 90.0, -60.0, 40_000.0) * (ARCSEC * ARCSEC)
}

pub fn systematic_rad2() -> Matrix3<f64> {
    Matrix3::from_diagonal(&Vector3::new(9.0, 16.0, 2500.0)) * (ARCSEC * ARCSEC)
}

pub fn states() -> Vec<State> {
    let state = |n: usize| {
        let unix_s = START_S + n as f64 / STATE_HZ as f64;
        State {
            unix_s,
            attitude: attitude(unix_s),
            rate_rad_s: rate_rad_s(),
            covariance_rad2: random_rad2(),
            basis: Basis::Both,
            is_contradicted: false,
        }
    };
    (0..=SECONDS * STATE_HZ).map(state).collect()
}

pub fn seconds() -> Vec<Second> {
    let second = |n: i64| Second {
        unix_s: START_S as i64 + n,
        position_m: Vector3::new(6.4e6, 0.0, 0.0),
        to_sun: Vector3::x_axis(),
        north: Vector3::z_axis(),
        systematic_rad2: systematic_rad2(),
    };
    (-1..=SECONDS as i64 + 1).map(second).collect()
}

/// A flight with a gap, a contradiction, a slew and uncertain states.
pub fn troubled() -> PointingHistory {
    let mut states = states();
    for (n, state) in states.iter_mut().enumerate() {
        match n {
            80..=83 => state.is_contradicted = true,
            120..=131 => state.covariance_rad2 *= 40.0 * (n - 119) as f64,
            160..=167 => state.rate_rad_s.y += 900.0 * ARCSEC * (n - 159) as f64,
            _ => {}
        }
    }
    states.drain(30..40);
    let mut seconds = seconds();
    seconds.remove(53);
    PointingHistory::new(states, seconds)
}
