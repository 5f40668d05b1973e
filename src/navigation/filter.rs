//! The filter while it runs: an estimate with the covariance of its errors, carried on by the IMU and corrected by measurements.

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

/// An innovation with a larger chi^2 is of another motion: of two axes 1 in 8,000 good ones, of three 1 in 9,000.
pub(super) const MOST_CHI2: [f64; 2] = [18.0, 21.0];
/// So little is known of the attitude before the first directions are taken, rad: nothing, but that they were used to begin.
const FIRST_ATTITUDE_RAD: f64 = 0.5;

/// A balloon rises or falls no faster, 1 sigma.
const MOST_CLIMB_M_S: f64 = 20.0;
/// Nor does the wind carry it faster, where a fix gives no velocity.
pub(super) const MOST_DRIFT_M_S: f64 = 100.0;

/// Cosine of a direction with the telescope's right beyond which it is to the side: 26 deg from it.
const TO_THE_SIDE: f64 = 0.9;

/// Which measurements are taken.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Trust {
    /// Those whose innovations are of this motion.
    Tested,
    /// All: those that the filter begins with.
    Blind,
}

#[derive(Debug, Clone)]
pub(super) struct Filter {
    pub model: Arc<Model>,
    pub estimate: Estimate,
    /// Of all errors at the last measurement.
    pub covariance: DMatrix<f64>,
    /// Since then.
    pub since: Transition,
    /// The body's last rate, rad/s.
    pub rate_rad_s: Vector3<f64>,
}

impl Filter {
    /// Begins with an estimate; position and velocity are the fix's.
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

    /// Goes on over an interval, as the IMU has said it.
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

    /// Brings the covariance of all errors up to now.
    pub fn settle(&mut self) {
        if self.since.time_s > 0.0 {
            self.covariance = self.since.predicted(&self.model.layout, &self.covariance);
        }
        self.since = Transition::none();
    }

    /// Increases what is unknown of the attitude by so many times. By how much it opened the variances.
    pub fn open_attitude(&mut self, times: f64) -> Opened {
        self.settle();
        let mut opened = Opened::zeros();
        for n in ATTITUDE..ATTITUDE + 3 {
            opened[n] = times * self.covariance[(n, n)];
            self.covariance[(n, n)] += opened[n];
        }
        opened
    }

    /// Discards what sensors have made of the motion, by a variance of each axis, and their bias, which is as unknown as at the start. By how
    /// much it opened the variances.
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

    /// 1 sigma of the attitude about its worst axis; at measurements.
    pub fn worst_attitude_rad(&self) -> f64 {
        let sigmas = (0..3).map(|n| self.sigma(ATTITUDE + n));
        sigmas.fold(0.0, f64::max)
    }

    /// Takes a fix: position and, where there is one, velocity, one after the other.
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

    /// Takes three numbers that are three states, and what the attitude makes of an arm.
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

    /// Takes straight down in the body's axes, as the accelerometers feel it at rest.
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

    /// Takes a direction.
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
        // Where it should be in the body's axes as the camera's file has them.
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
        // A large correction is bent by itself, and by what is not known about the other axes.
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

    /// The direction of a target in ECEF from where the body is.
    pub fn towards(&self, observation: &DirectionObservation) -> UnitVector3<f64> {
        let at_m = &self.estimate.motion.position_m;
        towards(&observation.towards, at_m, self.model.settings.vertical)
    }

    /// The telescope's right and up across a direction in the body's axes: two unit vectors.
    fn across(&self, unit: &UnitVector3<f64>) -> Matrix3x2<f64> {
        let telescope = self.model.settings.body_from_telescope();
        let right = telescope * Vector3::y_axis();
        // A direction to the side has no right across it.
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

    /// How large the motion's errors are, 1 sigma of each state.
    pub fn sigma(&self, state: usize) -> f64 {
        debug_assert!(state < MOTION || self.since.time_s == 0.0);
        self.covariance[(state, state)].sqrt()
    }
}

/// Variance that a fix leaves of the velocity in ECEF, m^2/s^2.
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

/// The direction of a target in ECEF from a place.
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
