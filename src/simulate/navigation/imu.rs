//! The inertial measurement unit: true means over its intervals, and their errors.

use super::motion::Motion;
use super::{Drawn, ImuRow, normal, random};
use crate::simulate::Generator;
use nalgebra::{Matrix3, Rotation3, Vector3};

pub(super) const RATE_HZ: u64 = 100;
const INTERVAL_S: f64 = 1.0 / RATE_HZ as f64;

/// Standard gravity, m/s^2.
const STANDARD_GRAVITY_M_S2: f64 = 9.80665;

/// Nodes of Gauss-Legendre quadrature on -1 to 1 with their weights, which add up to 1: exact for polynomials of degree 7.
const NODES: [(f64, f64); 4] = [
    (-0.861_136_311_594_052_6, 0.173_927_422_568_726_93),
    (-0.339_981_043_584_856_3, 0.326_072_577_431_273_1),
    (0.339_981_043_584_856_3, 0.326_072_577_431_273_1),
    (0.861_136_311_594_052_6, 0.173_927_422_568_726_93),
];

/// Sizes of the errors; constant ones are drawn once per flight, for each axis.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct ImuErrors {
    /// White noise: the error of a mean over an interval is this divided by the square root of the interval, m/s/sqrt(s).
    pub velocity_random_walk: f64,
    /// The same for rates, rad/sqrt(s).
    pub angular_random_walk: f64,
    pub accelerometer_bias_sigma_m_s2: f64,
    pub gyro_bias_sigma_rad_s: f64,
    /// Misalignment of the three accelerometers, and a separate one of the three gyroscopes, about each axis.
    pub misalignment_sigma_rad: f64,
    pub accelerometer_scale_sigma_ppm: f64,
    pub gyro_scale_sigma_ppm: f64,
}

impl ImuErrors {
    /// Braun and Barf 2022, table 3, without the additions by which they tuned their filter.
    pub fn rocket() -> Self {
        Self {
            velocity_random_walk: 0.05e-3 * STANDARD_GRAVITY_M_S2,
            // The square root of an hour of 3600 s is 60.
            angular_random_walk: 0.05_f64.to_radians() / 60.0,
            accelerometer_bias_sigma_m_s2: 2e-3 * STANDARD_GRAVITY_M_S2,
            gyro_bias_sigma_rad_s: 6.0_f64.to_radians() / 3600.0,
            misalignment_sigma_rad: 2e-3,
            accelerometer_scale_sigma_ppm: 300.0,
            gyro_scale_sigma_ppm: 2000.0,
        }
    }

    /// Fibre-optic gyroscopes, aligned and scaled before the flight.
    pub fn balloon() -> Self {
        Self {
            velocity_random_walk: 1e-4,
            angular_random_walk: 3e-6,
            accelerometer_bias_sigma_m_s2: 1e-3,
            gyro_bias_sigma_rad_s: 1e-6,
            ..Self::default()
        }
    }
}

/// Sample of a unit without errors for the interval that ends at a time.
pub(super) fn true_means(motion: &dyn Motion, t_s: f64) -> ImuRow {
    let mut row = ImuRow {
        t_s,
        specific_force_m_s2: Vector3::zeros(),
        rate_rad_s: Vector3::zeros(),
    };
    for (node, weight) in NODES {
        let state = motion.at(t_s + (node - 1.0) / 2.0 * INTERVAL_S);
        row.specific_force_m_s2 += weight * state.specific_force_m_s2();
        row.rate_rad_s += weight * state.inertial_rate_rad_s();
    }
    row
}

/// A unit with the errors drawn for a seed.
#[derive(Debug, Clone)]
pub(super) struct Imu {
    accelerometers: Triad,
    gyroscopes: Triad,
    random: Generator,
}

impl Imu {
    pub fn drawn(errors: &ImuErrors, seed: u64) -> Self {
        let mut random = random(seed, Drawn::Imu);
        let mut triad = |bias_sigma, scale_sigma_ppm, random_walk: f64| {
            let turn = normal(&mut random, errors.misalignment_sigma_rad);
            let scale = normal(&mut random, scale_sigma_ppm * 1e-6).add_scalar(1.0);
            Triad {
                gain: Rotation3::new(turn) * Matrix3::from_diagonal(&scale),
                bias: normal(&mut random, bias_sigma),
                white_sigma: random_walk / INTERVAL_S.sqrt(),
            }
        };
        let accelerometers = triad(
            errors.accelerometer_bias_sigma_m_s2,
            errors.accelerometer_scale_sigma_ppm,
            errors.velocity_random_walk,
        );
        let gyroscopes = triad(
            errors.gyro_bias_sigma_rad_s,
            errors.gyro_scale_sigma_ppm,
            errors.angular_random_walk,
        );
        Self {
            accelerometers,
            gyroscopes,
            random,
        }
    }

    /// Biases of accelerometers and gyroscopes, m/s^2 and rad/s.
    pub fn biases(&self) -> [Vector3<f64>; 2] {
        [self.accelerometers.bias, self.gyroscopes.bias]
    }

    /// The row with errors added.
    pub fn measured(&mut self, truth: &ImuRow) -> ImuRow {
        let force = &truth.specific_force_m_s2;
        ImuRow {
            t_s: truth.t_s,
            specific_force_m_s2: self.accelerometers.measured(force, &mut self.random),
            rate_rad_s: self
                .gyroscopes
                .measured(&truth.rate_rad_s, &mut self.random),
        }
    }
}

/// Three sensors of one kind, m/s^2 or rad/s.
#[derive(Debug, Clone)]
struct Triad {
    /// Scale factors and misalignment of the axes.
    gain: Matrix3<f64>,
    bias: Vector3<f64>,
    /// 1 sigma of the mean over an interval.
    white_sigma: f64,
}

impl Triad {
    fn measured(&self, truth: &Vector3<f64>, random: &mut Generator) -> Vector3<f64> {
        self.gain * truth + self.bias + normal(random, self.white_sigma)
    }
}
