//! Growth of the errors of the motion from one instant to another.

use super::motion::{Interval, Motion};
use super::settings::Imu;
use super::states::Layout;
use super::states::{ATTITUDE, DRIVING, MOTION, Opened, POSITION, VELOCITY};
use crate::estimation::symmetrise;
use crate::geometry::earth;
use nalgebra::{DMatrix, Matrix3, SMatrix, Vector3};

type MotionMatrix = SMatrix<f64, MOTION, MOTION>;
type Driven = SMatrix<f64, MOTION, DRIVING>;

/// Transition of the errors of the motion and of the IMU over some time, and their process noise.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Transition {
    /// Errors of the motion at the end as a function of those of motion and IMU at the beginning.
    pub matrix: Driven,
    pub noise: MotionMatrix,
    pub time_s: f64,
    /// Variances added at the end.
    pub opened: Opened,
}

impl Transition {
    /// The transition over no time.
    pub fn none() -> Self {
        Self {
            matrix: Driven::identity(),
            noise: MotionMatrix::zeros(),
            time_s: 0.0,
            opened: Opened::zeros(),
        }
    }

    /// Extends the transition over an interval of the body's motion.
    pub fn advance(&mut self, motion: &Motion, interval: &Interval, imu: &Imu) {
        let h = interval.length_s();
        let middle = interval.part(interval.from_s, interval.from_s + h / 2.0);
        let body = motion.advanced(&middle).attitude.to_rotation_matrix();
        let body = body.matrix();
        let force = body * interval.force_m_s2;
        let turn = earth::turn().cross_matrix();
        let cross = force.cross_matrix();
        let mut step = MotionMatrix::identity();
        let mut set = |row, column, block: Matrix3<f64>| {
            step.fixed_view_mut::<3, 3>(row, column).copy_from(&block);
        };
        let one = Matrix3::identity();
        set(POSITION, VELOCITY, one * h);
        set(POSITION, ATTITUDE, cross * (-h * h / 2.0));
        set(VELOCITY, POSITION, gradient(&motion.position_m) * h);
        set(VELOCITY, VELOCITY, one - turn * (2.0 * h));
        set(VELOCITY, ATTITUDE, cross * -h);
        set(ATTITUDE, ATTITUDE, one - turn * h);
        self.matrix = step * self.matrix;
        let (f, w) = (interval.force_m_s2, interval.rate_rad_s);
        let force_errors = [(9, one), (15, diagonal(&f)), (21, -f.cross_matrix())];
        let rate_errors = [(12, one), (18, diagonal(&w)), (24, -w.cross_matrix())];
        let mut add = |row, column, block: Matrix3<f64>| {
            let mut view = self.matrix.fixed_view_mut::<3, 3>(row, column);
            view += block;
        };
        for (column, by) in force_errors {
            let accelerated = -(body * by);
            add(VELOCITY, column, accelerated * h);
            add(POSITION, column, accelerated * (h * h / 2.0));
        }
        for (column, by) in rate_errors {
            let turned = -(body * by);
            add(ATTITUDE, column, turned * h);
            add(VELOCITY, column, -cross * turned * (h * h / 2.0));
        }
        self.noise = step * self.noise * step.transpose();
        let lost = &interval.lost;
        let velocity_walk = imu.velocity_random_walk.hypot(lost.velocity_random_walk);
        let angular_walk = imu.angular_random_walk.hypot(lost.angular_random_walk);
        let (v, a) = (velocity_walk.powi(2) * h, angular_walk.powi(2) * h);
        for n in 0..3 {
            self.noise[(VELOCITY + n, VELOCITY + n)] += v;
            self.noise[(ATTITUDE + n, ATTITUDE + n)] += a;
        }
        self.time_s += h;
    }

    /// The transition from an intermediate instant to its end; `before` is the one up to that instant.
    pub fn since(&self, before: &Self) -> Option<Self> {
        let early = before.matrix.fixed_columns::<MOTION>(0).into_owned();
        let late = self.matrix.fixed_columns::<MOTION>(0) * early.try_inverse()?;
        let mut matrix = Driven::zeros();
        matrix.fixed_columns_mut::<MOTION>(0).copy_from(&late);
        let driven = self.matrix - late * before.matrix;
        const IMU: usize = DRIVING - MOTION;
        matrix
            .fixed_columns_mut::<IMU>(MOTION)
            .copy_from(&driven.fixed_columns::<IMU>(MOTION));
        Some(Self {
            matrix,
            noise: self.noise - late * before.noise * late.transpose(),
            time_s: self.time_s - before.time_s,
            opened: self.opened,
        })
    }

    /// The transition and the noise of all states of a layout.
    pub fn whole(&self, layout: &Layout) -> (DMatrix<f64>, DMatrix<f64>) {
        let n = layout.len();
        let (mut matrix, mut noise) = (DMatrix::identity(n, n), DMatrix::zeros(n, n));
        matrix
            .fixed_view_mut::<MOTION, MOTION>(0, 0)
            .copy_from(&self.matrix.fixed_columns::<MOTION>(0));
        for (column, triad) in (MOTION..).step_by(3).zip(&layout.imu) {
            if let Some(triad) = triad {
                matrix
                    .fixed_view_mut::<MOTION, 3>(0, triad.first)
                    .copy_from(&self.matrix.fixed_columns::<3>(column));
            }
        }
        noise
            .fixed_view_mut::<MOTION, MOTION>(0, 0)
            .copy_from(&self.noise);
        for (state, added) in layout.opened(&self.opened) {
            noise[(state, state)] += added;
        }
        for correlated in layout.all_correlated() {
            let kept = (-self.time_s / correlated.time_s).exp();
            for state in correlated.triad.range() {
                matrix[(state, state)] = kept;
                // Noise that keeps the variance constant (the discrete Lyapunov equation, Braun and Barf 2022, eq. 44).
                noise[(state, state)] = correlated.triad.sigma.powi(2) * (1.0 - kept * kept);
            }
        }
        (matrix, noise)
    }

    /// The covariance of all states after the transition.
    pub fn predicted(&self, layout: &Layout, covariance: &DMatrix<f64>) -> DMatrix<f64> {
        let n = layout.len();
        let top = self.top(layout, covariance);
        let mut predicted = covariance.clone();
        let motion = self.of_motion(layout, &top);
        predicted
            .fixed_view_mut::<MOTION, MOTION>(0, 0)
            .copy_from(&(motion + self.noise));
        let rest = n - MOTION;
        let across = top.columns(MOTION, rest);
        predicted
            .view_mut((0, MOTION), (MOTION, rest))
            .copy_from(&across);
        predicted
            .view_mut((MOTION, 0), (rest, MOTION))
            .copy_from(&across.transpose());
        for correlated in layout.all_correlated() {
            let kept = (-self.time_s / correlated.time_s).exp();
            let added = correlated.triad.sigma.powi(2) * (1.0 - kept * kept);
            for state in correlated.triad.range() {
                predicted.row_mut(state).scale_mut(kept);
                predicted.column_mut(state).scale_mut(kept);
                predicted[(state, state)] += added;
            }
        }
        for (state, added) in layout.opened(&self.opened) {
            predicted[(state, state)] += added;
        }
        symmetrise(&mut predicted);
        predicted
    }

    /// The covariance of the motion after the transition with all states before it.
    pub fn top(&self, layout: &Layout, covariance: &DMatrix<f64>) -> DMatrix<f64> {
        let own = self.matrix.fixed_columns::<MOTION>(0);
        let mut top = own * covariance.rows(0, MOTION);
        for (column, triad) in (MOTION..).step_by(3).zip(&layout.imu) {
            if let Some(triad) = triad {
                let by = self.matrix.fixed_columns::<3>(column);
                top += by * covariance.rows(triad.first, 3);
            }
        }
        DMatrix::from_fn(MOTION, layout.len(), |row, column| top[(row, column)])
    }

    /// The motion's own covariance after the transition from [`top`](Self::top), without noise.
    fn of_motion(&self, layout: &Layout, top: &DMatrix<f64>) -> MotionMatrix {
        let own = self.matrix.fixed_columns::<MOTION>(0);
        let mut motion = top.fixed_columns::<MOTION>(0) * own.transpose();
        for (column, triad) in (MOTION..).step_by(3).zip(&layout.imu) {
            if let Some(triad) = triad {
                let by = self.matrix.fixed_columns::<3>(column);
                motion += top.fixed_columns::<3>(triad.first) * by.transpose();
            }
        }
        motion.fixed_view::<MOTION, MOTION>(0, 0).into_owned()
    }

    /// The covariance of the attitude after the transition.
    pub fn attitude(&self, layout: &Layout, covariance: &DMatrix<f64>) -> Matrix3<f64> {
        let mut parts = vec![(ATTITUDE, ATTITUDE)];
        // Of the IMU's errors, only those of the gyro affect the attitude.
        for (n, triad) in layout.imu.iter().enumerate().skip(1).step_by(2) {
            parts.extend(triad.map(|triad| (MOTION + 3 * n, triad.first)));
        }
        let by = |column| self.matrix.fixed_view::<3, 3>(ATTITUDE, column);
        let mut attitude = self
            .noise
            .fixed_view::<3, 3>(ATTITUDE, ATTITUDE)
            .into_owned();
        for (column, state) in &parts {
            for (other_column, other) in &parts {
                let block = covariance.fixed_view::<3, 3>(*state, *other);
                attitude += by(*column) * block * by(*other_column).transpose();
            }
        }
        attitude
    }
}

fn diagonal(of: &Vector3<f64>) -> Matrix3<f64> {
    Matrix3::from_diagonal(of)
}

/// The gradient of gravitation of a sphere, 1/s^2.
fn gradient(at_m: &Vector3<f64>) -> Matrix3<f64> {
    let r = at_m.norm();
    let up = at_m / r;
    let gravity = earth::gravitation(at_m).norm() / r;
    (up * up.transpose() * 3.0 - Matrix3::identity()) * gravity
}
