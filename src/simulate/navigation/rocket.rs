//! The coast of a VSB-30 from Esrange: Braun and Barf 2022, section 7 (flight ATEK, 2019-06-13).
//!
//! The path is Kepler's ellipse about the Earth's centre, converted to Earth-fixed axes; the effect of the Earth's flattening at the highest point
//! is added as a constant acceleration. So the payload is in free fall, except for at most 0.004 m/s^2: too little to determine its attitude.

use super::earth::{
    EARTH_RATE_RAD_S, FixedSun, GM_M3_S2, earth_rate_rad_s, ecef_from_north_east_down,
    gravitation_m_s2, position_m,
};
use super::motion::{Angle, Attitude, Motion, Path, State, Wave, phases, swing};
use crate::units::Place;
use nalgebra::{Matrix3, Rotation3, UnitQuaternion, Vector3};

/// Time since lift-off at the highest point.
const APOGEE_S: f64 = 250.0;
/// A little north of Esrange (67.9 N, 21.1 E): the payload landed 67 km from it.
const APOGEE: Place = Place {
    latitude_deg: 68.2,
    longitude_deg: 21.1,
    height_m: 238_000.0,
};
/// Velocity over ground at the highest point.
const NORTHWARD_M_S: f64 = 140.0;

/// Direction on 2019-06-13 02:21 UTC.
pub(super) const SUN: FixedSun = FixedSun {
    declination_deg: 23.2,
    longitude_deg: 144.7,
};

/// A slow roll, coning of the long axis about the vertical, and a small nod: never above 0.9 deg/s about any axis.
const ROLL_DEG_S: f64 = 0.25;
const ROLL_DEG_PERIOD_S: (f64, f64) = (8.0, 130.0);
const CONE_DEG_PERIOD_S: (f64, f64) = (14.0, 120.0);
const NOD_DEG_PERIOD_S: (f64, f64) = (1.0, 45.0);
/// Number of Newton steps: the first guess has an error of at most 0.003 rad, and each step squares it; three reach the last digit.
const KEPLER_STEPS: usize = 4;

#[derive(Debug, Clone)]
pub(super) struct Rocket {
    arc: Arc,
    /// Rotation from the body's axes before it rolls and cones (x up, y east, z north) to the ellipse's.
    upright: UnitQuaternion<f64>,
    roll: [Wave; 1],
    pitch: [Wave; 2],
    yaw: [Wave; 1],
}

impl Rocket {
    pub fn drawn(seed: u64) -> Self {
        let mut random = phases(seed);
        let mut wave = |(deg, period_s)| Wave::drawn(deg, period_s, &mut random);
        let cone = wave(CONE_DEG_PERIOD_S);
        // Columns: up, east and north in the axes north, east and down.
        let up_east_north = Matrix3::new(0., 0., 1., 0., 1., 0., -1., 0., 0.);
        let upright =
            ecef_from_north_east_down(&APOGEE) * Rotation3::from_matrix_unchecked(up_east_north);
        Self {
            arc: Arc::from_apogee(),
            upright: UnitQuaternion::from_rotation_matrix(&upright),
            roll: [wave(ROLL_DEG_PERIOD_S)],
            pitch: [cone, wave(NOD_DEG_PERIOD_S)],
            yaw: [cone.quarter_ahead()],
        }
    }
}

impl Motion for Rocket {
    fn at(&self, t_s: f64) -> State {
        let since_apogee_s = t_s - APOGEE_S;
        let path = self.arc.at(since_apogee_s);
        let steady_roll = Angle::steady(ROLL_DEG_S.to_radians(), t_s);
        let attitude = Attitude::level()
            .turned(
                Vector3::z_axis(),
                Angle::steady(-EARTH_RATE_RAD_S, since_apogee_s),
            )
            .mounted(&self.upright)
            .turned(Vector3::y_axis(), swing(&self.pitch, t_s))
            .turned(Vector3::z_axis(), swing(&self.yaw, t_s))
            .turned(Vector3::x_axis(), steady_roll + swing(&self.roll, t_s));
        State {
            path: path.carried_round(-EARTH_RATE_RAD_S, since_apogee_s),
            attitude,
        }
    }
}

/// Attraction by a sphere.
fn central_m_s2(position_m: &Vector3<f64>) -> Vector3<f64> {
    position_m * (-GM_M3_S2 / position_m.norm().powi(3))
}

/// The path in inertial axes that agree with the Earth-fixed ones at the highest point.
#[derive(Debug, Clone)]
struct Arc {
    /// From the Earth's centre to the highest point, and along the velocity there: the ellipse's half axes.
    outward_m: Vector3<f64>,
    forward_m: Vector3<f64>,
    eccentricity: f64,
    mean_motion_rad_s: f64,
    /// Acceleration by the Earth's flattening.
    steady_m_s2: Vector3<f64>,
}

impl Arc {
    fn from_apogee() -> Self {
        let place_m = position_m(&APOGEE);
        let (radius_m, up) = (place_m.norm(), place_m.normalize());
        let east = Vector3::z().cross(&up).normalize();
        let north = up.cross(&east);
        // Perpendicular to the radius, as at the end of an ellipse's axis.
        let velocity_m_s = north * NORTHWARD_M_S + earth_rate_rad_s().cross(&place_m);
        let half_axis_m = 1.0 / (2.0 / radius_m - velocity_m_s.norm_squared() / GM_M3_S2);
        let mean_motion_rad_s = (GM_M3_S2 / half_axis_m.powi(3)).sqrt();
        let short_half_axis_m = radius_m * velocity_m_s.norm() / (mean_motion_rad_s * half_axis_m);
        Self {
            outward_m: up * half_axis_m,
            forward_m: velocity_m_s.normalize() * short_half_axis_m,
            eccentricity: radius_m / half_axis_m - 1.0,
            mean_motion_rad_s,
            steady_m_s2: gravitation_m_s2(&place_m) - central_m_s2(&place_m),
        }
    }

    fn at(&self, since_apogee_s: f64) -> Path {
        // The eccentric anomaly measured from the highest point.
        let anomaly_rad = self.anomaly_rad(self.mean_motion_rad_s * since_apogee_s);
        let (sin, cos) = anomaly_rad.sin_cos();
        let ellipse_m = self.outward_m * (cos + self.eccentricity) + self.forward_m * sin;
        let rad_s = self.mean_motion_rad_s / (1.0 + self.eccentricity * cos);
        let ellipse_m_s = (self.forward_m * cos - self.outward_m * sin) * rad_s;
        let steady_m_s = self.steady_m_s2 * since_apogee_s;
        Path {
            position_m: ellipse_m + steady_m_s * since_apogee_s / 2.0,
            velocity_m_s: ellipse_m_s + steady_m_s,
            acceleration_m_s2: central_m_s2(&ellipse_m) + self.steady_m_s2,
        }
    }

    /// Solves mean = anomaly + eccentricity x sin(anomaly) by Newton's method.
    fn anomaly_rad(&self, mean_rad: f64) -> f64 {
        let first = mean_rad / (1.0 + self.eccentricity);
        (0..KEPLER_STEPS).fold(first, |anomaly, _| {
            let (sin, cos) = anomaly.sin_cos();
            let excess = anomaly + self.eccentricity * sin - mean_rad;
            anomaly - excess / (1.0 + self.eccentricity * cos)
        })
    }
}

/// A camera on the side of the body's third axis (1) or on the opposite one (-1) that points 20 deg towards the tail.
pub(super) fn camera_axes(side: f64) -> Matrix3<f64> {
    let (sin, cos) = 20.0_f64.to_radians().sin_cos();
    let forward = Vector3::new(-sin, 0.0, side * cos);
    let down = Vector3::new(-cos, 0.0, -side * sin);
    let right = Vector3::new(0.0, side, 0.0);
    Matrix3::from_columns(&[right, down, forward])
}
