//! The errors that the filter estimates, in order.
//!
//! | states | unit | axes |
//! |---|---|---|
//! | position, velocity | m, m/s | ECEF |
//! | attitude | rad | ECEF: the true attitude is the estimated one, rotated further by it |
//! | accelerometer bias, gyro bias | m/s^2, rad/s | body |
//! | accelerometer scale, gyro scale | 1 | body |
//! | accelerometer axes, gyro axes | rad | body: a small rotation of the triad |
//! | misalignment of each camera | rad | body: v_body = (1 + mu x) R_body_from_camera v_camera (Braun and Barf 2022, eq. 50) |
//! | correlated error of each camera and target | rad | body, perpendicular to the direction |
//!
//! States that are known exactly (sigma 0) are omitted.

use super::settings::{Group, NavigationSettings, Target};
use crate::estimation::Role;
use nalgebra::SVector;
use std::ops::Range;

/// Position, velocity, attitude.
pub(super) const MOTION: usize = 9;
/// The same plus six triads of IMU errors, whether known exactly or not.
pub(super) const DRIVING: usize = 27;
pub(super) const POSITION: usize = 0;
pub(super) const VELOCITY: usize = 3;
pub(super) const ATTITUDE: usize = 6;

/// The sensors of the IMU; each drives some states of the motion.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Sensors {
    Accelerometers,
    Gyros,
}

impl Sensors {
    /// Index of the first state of velocity or attitude.
    pub fn driven(self) -> usize {
        match self {
            Self::Accelerometers => VELOCITY,
            Self::Gyros => ATTITUDE,
        }
    }

    /// Index of their bias in [`Layout::imu`].
    pub fn bias(self) -> usize {
        self as usize
    }
}

/// Variances added to motion and biases at once, in the order of the states.
pub(super) type Opened = SVector<f64, OPENED>;
const OPENED: usize = MOTION + 6;

/// Three successive states.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Triad {
    pub first: usize,
    pub sigma: f64,
    pub role: Role,
}

impl Triad {
    pub fn range(&self) -> Range<usize> {
        self.first..self.first + 3
    }
}

/// An error that is correlated in time (Gauss-Markov process of first order).
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Correlated {
    pub triad: Triad,
    pub time_s: f64,
}

/// The list of states.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Layout {
    /// States of the IMU: accelerometer bias, gyro bias, accelerometer scale, gyro scale, accelerometer axes, gyro axes.
    pub imu: [Option<Triad>; 6],
    pub cameras: Vec<Option<Triad>>,
    /// By camera and [`Target`].
    pub correlated: Vec<[Option<Correlated>; 3]>,
    pub roles: Vec<Role>,
}

impl Layout {
    /// `used` lists the targets of each camera; `choice` tells whether states may be only considered.
    pub fn new(settings: &NavigationSettings, used: &[Vec<Target>], choice: Choice) -> Self {
        let mut layout = Self {
            imu: [None; 6],
            cameras: Vec::new(),
            correlated: Vec::new(),
            roles: vec![Role::Estimated; MOTION],
        };
        let role = |group| match settings.considered.contains(&group) && choice == Choice::AsStated
        {
            true => Role::Considered,
            false => Role::Estimated,
        };
        let imu = &settings.imu;
        for (n, (sigma, group)) in [
            (imu.accelerometer_bias_sigma_m_s2, Group::AccelerometerBias),
            (imu.gyro_bias_sigma_rad_s, Group::GyroBias),
            (imu.accelerometer_scale, Group::AccelerometerScale),
            (imu.gyro_scale, Group::GyroScale),
            (imu.misalignment_rad, Group::Misalignment),
            (imu.misalignment_rad, Group::Misalignment),
        ]
        .into_iter()
        .enumerate()
        {
            layout.imu[n] = layout.add(sigma, role(group));
        }
        for camera in &settings.cameras {
            let triad = layout.add(camera.misalignment_rad, role(Group::CameraMisalignment));
            layout.cameras.push(triad);
        }
        for (camera, targets) in settings.cameras.iter().zip(used) {
            let mut of_camera = [None; 3];
            for target in targets {
                let sigma = match camera.correlation_time_s > 0.0 {
                    true => settings.correlated_rad[*target as usize],
                    // Errors with a correlation time of 0 are white.
                    false => 0.0,
                };
                let triad = layout.add(sigma, role(Group::CorrelatedErrors));
                of_camera[*target as usize] = triad.map(|triad| Correlated {
                    triad,
                    time_s: camera.correlation_time_s,
                });
            }
            layout.correlated.push(of_camera);
        }
        layout
    }

    fn add(&mut self, sigma: f64, role: Role) -> Option<Triad> {
        if sigma <= 0.0 {
            return None;
        }
        let first = self.roles.len();
        self.roles.extend([role; 3]);
        Some(Triad { first, sigma, role })
    }

    pub fn len(&self) -> usize {
        self.roles.len()
    }

    /// Added variances, by state.
    pub fn opened<'a>(&self, opened: &'a Opened) -> impl Iterator<Item = (usize, f64)> + use<'a> {
        let biases = [self.imu[0], self.imu[1]];
        opened.iter().enumerate().filter_map(move |(n, added)| {
            let state = match n.checked_sub(MOTION) {
                None => n,
                Some(n) => biases[n / 3]?.first + n % 3,
            };
            (*added > 0.0).then_some((state, *added))
        })
    }

    /// Every triad except the motion.
    pub fn triads(&self) -> impl Iterator<Item = Triad> {
        let imu = self.imu.iter().flatten().copied();
        let cameras = self.cameras.iter().flatten().copied();
        let correlated = self.all_correlated().map(|correlated| correlated.triad);
        imu.chain(cameras).chain(correlated)
    }

    pub fn all_correlated(&self) -> impl Iterator<Item = Correlated> {
        self.correlated.iter().flatten().flatten().copied()
    }
}

/// States that measurements change.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Choice {
    AsStated,
    /// All of them: required for smoothing.
    AllEstimated,
}
