//! The running filter: an estimate with the covariance of its errors, propagated with the IMU and corrected by
//! measurements.

use super::estimate::Estimate;
use super::measurement::{Climb, DirectionObservation, Fix, Innovation, Source, Towards, Verdict};
use super::model::Model;
use super::motion::Interval;
use super::settings::Vertical;
use super::states::{ATTITUDE, MOTION, Opened, POSITION, Sensors, VELOCITY};
use super::transition::Transition;
use crate::estimation::{Proposal, Role};
use crate::geometry::earth;
use nalgebra::{DMatrix, Matrix2, Matrix3, Matrix3x2, SMatrix, UnitVector3, Vector2, Vector3};
use std::sync::Arc;

/// An innovation with a larger chi^2 is rejected: for two axes 1 in 8,000 valid ones, for three 1 in 9,000.
pub(super) const MOST_CHI2: [f64; 2] = [18.0, 21.0];
/// Uncertainty of the attitude before the first directions are processed, rad: none is known, apart from their use in the
/// alignment.
const FIRST_ATTITUDE_RAD: f64 = 0.5;

/// Climb rate of a balloon, 1 sigma.
const MOST_CLIMB_M_S: f64 = 20.0;
/// Horizontal speed in the wind if a fix has no velocity, 1 sigma.
pub(super) const MOST_DRIFT_M_S: f64 = 100.0;

/// Cosine of the angle to the telescope's right beyond which a direction counts as sideways: 26 deg.
const TO_THE_SIDE: f64 = 0.9;

/// Which measurements are accepted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Trust {
    /// Measurements whose innovations pass the chi^2 test.
    Tested,
    /// All, including those of the alignment.
    Blind,
}

#[derive(Debug, Clone)]
pub(super) struct Filter {
    pub model: Arc<Model>,
    pub estimate: Estimate,
    /// Covariance of all errors at the last measurement.
    pub covariance: DMatrix<f64>,
    /// Transition since then.
    pub since: Transition,
    /// The body's last angular rate, rad/s.
    pub rate_rad_s: Vector3<f64>,
}

impl Filter {
    /// Starts with an estimate; position and velocity are those of the fix.
    pub fn new(model: Arc<Model>, estimate: Estimate, fix: &Fix) -> Self {
        let Model { settings, layout } = &*model;
        let mut covariance = DMatrix::zeros(layout.len(), layout.len());
        let gps = &settings.gps;
        for (first, sigma) in [
            (POSITION, gps.position_sigma_m),
            (VELOCITY, gps.velocity_sigma_m_s),
            (ATTITUDE, FIRST_ATTITUDE_RAD),
        ] {
            (first..first + 3).for_each(|n| covariance[(n, n)] = sigma * sigma);
        }
        let mut velocity = covariance.fixed_view_mut::<3, 3>(VELOCITY, VELOCITY);
        velocity += unknown_velocity(fix);
        for triad in layout.triads() {
            triad
                .range()
                .for_each(|n| covariance[(n, n)] = triad.sigma * triad.sigma);
        }
        Self {
            estimate,
            covariance,
            since: Transition::none(),
            rate_rad_s: Vector3::zeros(),
            model,
        }
    }

    /// Propagates over an interval of IMU data.
    pub fn advance(&mut self, said: &Interval) {
        let felt = self.estimate.felt(said);
        self.since
            .advance(&self.estimate.motion, &felt, &self.model.settings.imu);
        self.estimate.advance(&felt, &self.model.layout);
        self.rate_rad_s = felt.rate_rad_s;
    }

    /// The covariance of the attitude's errors about the axes of ECEF, rad^2.
    pub fn attitude_covariance(&self) -> Matrix3<f64> {
        self.since.attitude(&self.model.layout, &self.covariance)
    }

    /// Propagates the covariance of all errors to the current time.
    pub fn settle(&mut self) {
        if self.since.time_s > 0.0 {
            self.covariance = self.since.predicted(&self.model.layout, &self.covariance);
        }
        self.since = Transition::none();
    }

    /// Adds `times` the attitude's variances to them. Returns the added variances.
    pub fn open_attitude(&mut self, times: f64) -> Opened {
        self.settle();
        let mut opened = Opened::zeros();
        for n in ATTITUDE..ATTITUDE + 3 {
            opened[n] = times * self.covariance[(n, n)];
            self.covariance[(n, n)] += opened[n];
        }
        opened
    }

    /// Adds a variance to each axis of the motion that the sensors determine, and resets the variance of their bias to its
    /// initial value. Returns the added variances.
    pub fn open(&mut self, sensors: Sensors, variance: f64) -> Opened {
        self.settle();
        let mut opened = Opened::zeros();
        opened.fixed_rows_mut::<3>(sensors.driven()).fill(variance);
        let bias = self.model.layout.imu[sensors.bias()];
        if let Some(triad) = bias.filter(|triad| triad.role == Role::Estimated) {
            for (n, state) in triad.range().enumerate() {
                let known = self.covariance[(state, state)];
                opened[MOTION + 3 * sensors.bias() + n] = (triad.sigma.powi(2) - known).max(0.0);
            }
        }
        for (state, added) in self.model.layout.opened(&opened) {
            self.covariance[(state, state)] += added;
        }
        opened
    }

    /// 1 sigma of the attitude about its worst axis; valid at measurements.
    pub fn worst_attitude_rad(&self) -> f64 {
        let sigmas = (0..3).map(|n| self.sigma(ATTITUDE + n));
        sigmas.fold(0.0, f64::max)
    }

    /// Processes a fix: position and, if present, velocity, one after the other.
    pub fn take_fix(&mut self, fix: &Fix) -> [Option<Innovation>; 2] {
        let gps = self.model.settings.gps;
        let (sigma_m, sigma_m_s) = (gps.position_sigma_m, gps.velocity_sigma_m_s);
        let motion = &self.estimate.motion;
        let arm = motion.attitude * gps.antenna_m;
        let residual = fix.position_m - motion.position_m - arm;
        let position = self.take_triad(
            (fix.t_s, Source::Position),
            residual,
            (POSITION, arm),
            Matrix3::identity() * sigma_m.powi(2),
        );
        let motion = &self.estimate.motion;
        let spin = motion.attitude * self.rate_rad_s - earth::turn();
        let swing = spin.cross(&(motion.attitude * gps.antenna_m));
        let expected = motion.velocity_m_s + swing;
        let velocity = fix.velocity_m_s.and_then(|velocity_m_s| {
            self.take_triad(
                (fix.t_s, Source::Velocity),
                velocity_m_s - expected,
                (VELOCITY, swing),
                Matrix3::identity() * sigma_m_s.powi(2) + unknown_velocity(fix),
            )
        });
        [position, velocity]
    }

    /// Processes a measurement of three states, with the effect of the attitude on a lever arm.
    fn take_triad(
        &mut self,
        (t_s, source): (f64, Source),
        residual: Vector3<f64>,
        (first, arm): (usize, Vector3<f64>),
        noise: Matrix3<f64>,
    ) -> Option<Innovation> {
        let mut jacobian = DMatrix::zeros(3, self.model.layout.len());
        jacobian
            .fixed_view_mut::<3, 3>(0, first)
            .copy_from(&Matrix3::identity());
        jacobian
            .fixed_view_mut::<3, 3>(0, ATTITUDE)
            .copy_from(&-arm.cross_matrix());
        self.take((t_s, source), residual, &jacobian, noise, Trust::Tested)
    }

    /// Processes straight down in the body's axes, as measured by the accelerometers at rest.
    pub fn take_plumb(
        &mut self,
        t_s: f64,
        down: &UnitVector3<f64>,
        sigma_rad: f64,
    ) -> Option<Innovation> {
        let motion = &self.estimate.motion;
        let towards = earth::plumb(&motion.position_m);
        let body = motion.attitude.to_rotation_matrix();
        let predicted = body.inverse() * towards;
        let across = self.across(&predicted);
        let residual: Vector2<f64> = across.transpose() * down.into_inner();
        let by_attitude = across.transpose() * body.inverse().matrix() * towards.cross_matrix();
        let mut jacobian = DMatrix::zeros(2, self.model.layout.len());
        jacobian
            .fixed_view_mut::<2, 3>(0, ATTITUDE)
            .copy_from(&by_attitude);
        let noise = Matrix2::identity() * sigma_rad.powi(2);
        self.take(
            (t_s, Source::Plumb),
            residual,
            &jacobian,
            noise,
            Trust::Blind,
        )
    }

    /// Processes a direction.
    pub fn take_direction(
        &mut self,
        observation: &DirectionObservation,
        white_rad: f64,
        trust: Trust,
    ) -> Option<Innovation> {
        self.settle();
        let towards = self.towards(observation);
        let (camera, target) = (observation.camera, observation.target);
        let body = self.estimate.motion.attitude.to_rotation_matrix();
        let true_body = body.inverse() * towards;
        let correlated = self.estimate.correlated[camera][target as usize];
        // Predicted direction in the body's axes according to the camera's file.
        let seen = true_body.into_inner() - self.estimate.cameras[camera].cross(&true_body);
        let predicted = UnitVector3::new_normalize(seen + correlated);
        let said = self.model.settings.cameras[camera].body_from_camera * observation.unit;
        let across = self.across(&predicted);
        let residual: Vector2<f64> = across.transpose() * said.into_inner();
        let mut jacobian = DMatrix::zeros(2, self.model.layout.len());
        let mut set = |first: usize, by: Matrix3<f64>| {
            jacobian
                .fixed_view_mut::<2, 3>(0, first)
                .copy_from(&(across.transpose() * by));
        };
        set(ATTITUDE, body.inverse().matrix() * towards.cross_matrix());
        if let Some(triad) = self.model.layout.cameras[camera] {
            set(triad.first, predicted.cross_matrix());
        }
        if let Some(correlated) = self.model.layout.correlated[camera][target as usize] {
            set(correlated.triad.first, Matrix3::identity());
        }
        let source = Source::Direction { camera, target };
        // The linearisation error of a large correction, including that from the uncertainty of the other axes.
        let off_rad = residual.norm();
        let bent_rad = off_rad * (off_rad / 2.0 + self.worst_attitude_rad());
        let noise = Matrix2::identity() * (white_rad.powi(2) + bent_rad.powi(2));
        if residual.norm() > 0.5 || said.dot(&predicted) < 0.0 {
            return Some(Innovation {
                t_s: observation.t_s,
                source,
                axes: residual.iter().map(|r| (*r, white_rad)).collect(),
                whitened: residual.iter().map(|r| r / white_rad).collect(),
                chi2: f64::MAX,
                verdict: Verdict::Refused,
            });
        }
        self.take((observation.t_s, source), residual, &jacobian, noise, trust)
    }

    /// The direction of a target in ECEF from the body's position.
    pub fn towards(&self, observation: &DirectionObservation) -> UnitVector3<f64> {
        let at_m = &self.estimate.motion.position_m;
        towards(&observation.towards, at_m, self.model.settings.vertical)
    }

    /// The telescope's right and up projected perpendicular to a direction in the body's axes: two unit vectors.
    fn across(&self, unit: &UnitVector3<f64>) -> Matrix3x2<f64> {
        let telescope = self.model.settings.body_from_telescope();
        let right = telescope * Vector3::y_axis();
        // For a sideways direction the projection of right is undefined.
        let beside = match unit.dot(&right).abs() < TO_THE_SIDE {
            true => right,
            false => -(telescope * Vector3::x_axis()),
        };
        let first = (beside.into_inner() - unit.into_inner() * unit.dot(&beside)).normalize();
        Matrix3x2::from_columns(&[first, first.cross(unit)])
    }

    fn take<const M: usize>(
        &mut self,
        (t_s, source): (f64, Source),
        residual: SMatrix<f64, M, 1>,
        jacobian: &DMatrix<f64>,
        noise: SMatrix<f64, M, M>,
        trust: Trust,
    ) -> Option<Innovation> {
        self.settle();
        let proposal = Proposal::new(&self.covariance, residual, jacobian, noise)?;
        let chi2 = proposal.chi2();
        let verdict = match trust == Trust::Blind || chi2 < MOST_CHI2[M - 2] {
            true => Verdict::Taken,
            false => Verdict::Refused,
        };
        let axes = (0..M).map(|n| (residual[n], proposal.covariance[(n, n)].sqrt()));
        let axes = axes.collect();
        let whitened = proposal.whitened().as_slice().to_vec();
        if verdict == Verdict::Taken {
            let errors = proposal.take(&mut self.covariance, &self.model.layout.roles);
            self.estimate.correct(&errors, &self.model.layout);
        }
        Some(Innovation {
            t_s,
            source,
            axes,
            whitened,
            chi2,
            verdict,
        })
    }

    /// 1 sigma of the error of a state.
    pub fn sigma(&self, state: usize) -> f64 {
        debug_assert!(state < MOTION || self.since.time_s == 0.0);
        self.covariance[(state, state)].sqrt()
    }
}

/// Variance of the velocity in ECEF that a fix leaves undetermined, m^2/s^2.
fn unknown_velocity(fix: &Fix) -> Matrix3<f64> {
    match (fix.velocity_m_s, fix.climb) {
        (None, _) => Matrix3::identity() * MOST_DRIFT_M_S.powi(2),
        (Some(_), Climb::Measured) => Matrix3::zeros(),
        (Some(_), Climb::Unknown) => {
            let up = earth::geodetic_up(&fix.position_m);
            up * up.transpose() * MOST_CLIMB_M_S.powi(2)
        }
    }
}

/// The direction of a target in ECEF from a position.
pub(super) fn towards(
    towards: &Towards,
    at_m: &Vector3<f64>,
    vertical: Vertical,
) -> UnitVector3<f64> {
    match (towards, vertical) {
        (Towards::Known(unit), _) => *unit,
        (Towards::Down, Vertical::Geocentric) => UnitVector3::new_normalize(-at_m),
        (Towards::Down, Vertical::Geodetic) => {
            UnitVector3::new_normalize(-earth::geodetic_up(at_m))
        }
    }
}
