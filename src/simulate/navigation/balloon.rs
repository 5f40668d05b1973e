//! A telescope under a balloon above Fort Sumner that follows the Sun.
//!
//! The balloon drifts along its parallel at a constant speed with slow deviations. Pendulum motion rotates the gondola about the IMU, whose position
//! it does not change.

use super::earth::{EARTH_RATE_RAD_S, FixedSun, ecef_from_north_east_down, position_m};
use super::motion::{Angle, Attitude, Motion, Path, State, Wave, phases, swing};
use crate::units::Place;
use nalgebra::{Matrix3, UnitQuaternion, Vector3};

const START: Place = Place {
    latitude_deg: 34.49,
    longitude_deg: -104.22,
    height_m: 38_000.0,
};
const EASTWARD_M_S: f64 = 10.0;

/// 2013-09-21, the day of the HEROES flight; the elevation is that at the start.
const SUN_DECLINATION_DEG: f64 = 0.6;
const SUN_ELEVATION_DEG: f64 = 54.0;

/// Amplitude in deg and period in s: the flight train's pendulum, the gondola's own, and the azimuth's slow drift.
const PENDULUM: [(f64, f64); 2] = [(0.2, 12.3), (0.05, 3.7)];
const AZIMUTH_DRIFT: [(f64, f64); 2] = [(0.7, 310.0), (0.3, 97.0)];
/// Amplitude in m and period in s, north, east and down: accelerations of 1e-3 to 3e-3 m/s^2.
const SWINGS: [[(f64, f64); 2]; 3] = [
    [(9.0, 600.0), (2.0, 190.0)],
    [(7.0, 520.0), (2.4, 210.0)],
    [(4.0, 330.0), (0.5, 95.0)],
];

/// The Sun of the balloon's flights.
pub(super) fn sun() -> FixedSun {
    FixedSun::rising(SUN_DECLINATION_DEG, &START, SUN_ELEVATION_DEG)
}

#[derive(Debug, Clone)]
pub(super) struct Balloon {
    start_m: Vector3<f64>,
    /// Rate of the longitude.
    turn_rad_s: f64,
    /// Rotation from north, east and down at the start.
    local: UnitQuaternion<f64>,
    /// Swings along Earth-fixed axes at the start.
    swings: [(Vector3<f64>, [Wave; 2]); 3],
    azimuth_drift: [Wave; 2],
    roll: [Wave; 2],
    pitch: [Wave; 2],
}

impl Balloon {
    pub fn drawn(seed: u64) -> Self {
        let mut random = phases(seed);
        let mut waves = |pairs: [(f64, f64); 2]| {
            pairs.map(|(amplitude, period_s)| Wave::drawn(amplitude, period_s, &mut random))
        };
        let start_m = position_m(&START);
        let axes = ecef_from_north_east_down(&START);
        let swing = |axis: usize, waves| (axes.matrix().column(axis).into_owned(), waves);
        let [north, east, down] = SWINGS.map(&mut waves);
        Self {
            start_m,
            turn_rad_s: EASTWARD_M_S / start_m.xy().norm(),
            local: UnitQuaternion::from_rotation_matrix(&axes),
            swings: [swing(0, north), swing(1, east), swing(2, down)],
            azimuth_drift: waves(AZIMUTH_DRIFT),
            roll: waves(PENDULUM),
            pitch: waves(PENDULUM),
        }
    }

    /// Path in axes that drift with the balloon.
    fn path(&self, t_s: f64) -> Path {
        let [position_m, velocity_m_s, acceleration_m_s2] = [0, 1, 2].map(|derivative| {
            let along = |(axis, waves): &(Vector3<f64>, [Wave; 2])| {
                axis * waves.iter().map(|w| w.at(t_s)[derivative]).sum::<f64>()
            };
            self.swings.iter().map(along).sum::<Vector3<f64>>()
        });
        Path {
            position_m: self.start_m + position_m,
            velocity_m_s,
            acceleration_m_s2,
        }
    }

    /// Azimuth, from north over east, and elevation of the Sun above the drifting horizon.
    fn sun_angles(&self, t_s: f64) -> (Angle, Angle) {
        let seen = sun().direction(t_s);
        let drifted = Attitude::level()
            .turned(Vector3::z_axis(), Angle::steady(self.turn_rad_s, t_s))
            .mounted(&self.local);
        let to_local = |vector: &Vector3<f64>| drifted.rotation.inverse_transform_vector(vector);
        let direction = to_local(&seen);
        let turn = Vector3::new(0.0, 0.0, -EARTH_RATE_RAD_S - self.turn_rad_s);
        let change_s = to_local(&turn.cross(&seen));
        let level = direction.xy().norm();
        let azimuth = Angle {
            rad: direction.y.atan2(direction.x),
            rad_s: (direction.x * change_s.y - direction.y * change_s.x) / (level * level),
        };
        let elevation = Angle {
            rad: (-direction.z).atan2(level),
            rad_s: -change_s.z / level,
        };
        (azimuth, elevation)
    }
}

impl Motion for Balloon {
    fn at(&self, t_s: f64) -> State {
        let (azimuth, elevation) = self.sun_angles(t_s);
        let attitude = Attitude::level()
            .turned(Vector3::z_axis(), Angle::steady(self.turn_rad_s, t_s))
            .mounted(&self.local)
            .turned(Vector3::z_axis(), azimuth + swing(&self.azimuth_drift, t_s))
            .turned(Vector3::x_axis(), swing(&self.roll, t_s))
            .turned(Vector3::y_axis(), elevation + swing(&self.pitch, t_s));
        State {
            path: self.path(t_s).carried_round(self.turn_rad_s, t_s),
            attitude,
        }
    }
}

/// A camera that points along the body's first axis, towards the Sun.
pub(super) const ALONG_FIRST: Matrix3<f64> = Matrix3::new(0., 0., 1., 1., 0., 0., 0., 1., 0.);
/// A camera that points along the body's second axis, at the horizon to the right of the Sun.
pub(super) const ALONG_SECOND: Matrix3<f64> = Matrix3::new(-1., 0., 0., 0., 0., 1., 0., 1., 0.);
