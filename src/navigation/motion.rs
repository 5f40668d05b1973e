//! Motion of a body between two instants: the inertial mechanisation in ECEF.

use crate::geometry::earth;
use nalgebra::{UnitQuaternion, Vector3};

/// Position, velocity and attitude of a body.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Motion {
    /// Position in ECEF.
    pub position_m: Vector3<f64>,
    /// Velocity relative to the rotating Earth, in ECEF.
    pub velocity_m_s: Vector3<f64>,
    /// Transforms vectors of the body to ECEF.
    pub attitude: UnitQuaternion<f64>,
}

/// Specific force and angular rate relative to inertial space over a time, in the body's axes: their means and their rates
/// of change.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Interval {
    pub from_s: f64,
    pub to_s: f64,
    pub force_m_s2: Vector3<f64>,
    pub force_change_m_s3: Vector3<f64>,
    pub rate_rad_s: Vector3<f64>,
    pub rate_change_rad_s2: Vector3<f64>,
    /// Additional noise from lost samples.
    pub lost: Lost,
}

/// Uncertainty of an interval with lost samples, as random walks in addition to those of the IMU.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Lost {
    /// m/s/sqrt(s)
    pub velocity_random_walk: f64,
    /// rad/sqrt(s)
    pub angular_random_walk: f64,
}

impl Lost {
    pub fn and(&self, other: &Self) -> Self {
        let both = |a: f64, b: f64| a.hypot(b);
        Self {
            velocity_random_walk: both(self.velocity_random_walk, other.velocity_random_walk),
            angular_random_walk: both(self.angular_random_walk, other.angular_random_walk),
        }
    }
}

impl Interval {
    pub fn length_s(&self) -> f64 {
        self.to_s - self.from_s
    }

    /// The part between two instants, with force and rate changing linearly.
    pub fn part(&self, from_s: f64, to_s: f64) -> Self {
        let shift_s = (from_s + to_s - self.from_s - self.to_s) / 2.0;
        Self {
            from_s,
            to_s,
            force_m_s2: self.force_m_s2 + self.force_change_m_s3 * shift_s,
            rate_rad_s: self.rate_rad_s + self.rate_change_rad_s2 * shift_s,
            ..*self
        }
    }

    /// Rotation of the body, as a rotation vector in its axes: the mean rate, and the effect of rotating axes (Magnus's
    /// second term).
    fn turn_rad(&self) -> Vector3<f64> {
        let h = self.length_s();
        self.rate_rad_s * h + self.rate_rad_s.cross(&self.rate_change_rad_s2) * (h.powi(3) / 12.0)
    }

    /// Specific force at a fraction of the interval.
    fn force_at(&self, share: f64) -> Vector3<f64> {
        self.force_m_s2 + self.force_change_m_s3 * (self.length_s() * (share - 0.5))
    }
}

impl Motion {
    /// The attitude's quaternion, scalar first and not negative.
    pub fn quaternion(&self) -> [f64; 4] {
        let q = self.attitude.quaternion();
        let q = if q.w < 0.0 { -q } else { *q };
        [q.w, q.i, q.j, q.k]
    }

    /// The motion at an interval's end from that at its beginning: position and velocity by the fourth-order Runge-Kutta
    /// method, the attitude by the rotations of body and Earth.
    pub fn advanced(&self, interval: &Interval) -> Self {
        let h = interval.length_s();
        let half = interval.part(interval.from_s, interval.from_s + h / 2.0);
        let middle = self.attitude_after(&half);
        let end = self.attitude_after(interval);
        let forces = [
            self.attitude * interval.force_at(0.0),
            middle * interval.force_at(0.5),
            end * interval.force_at(1.0),
        ];
        let (x, v) = (self.position_m, self.velocity_m_s);
        let slope = |x: Vector3<f64>, v: Vector3<f64>, force: Vector3<f64>| {
            (v, force + earth::acceleration(&x, &v))
        };
        let (x1, v1) = slope(x, v, forces[0]);
        let (x2, v2) = slope(x + x1 * (h / 2.0), v + v1 * (h / 2.0), forces[1]);
        let (x3, v3) = slope(x + x2 * (h / 2.0), v + v2 * (h / 2.0), forces[1]);
        let (x4, v4) = slope(x + x3 * h, v + v3 * h, forces[2]);
        let mean = |a: Vector3<f64>, b, c, d| (a + 2.0 * (b + c) + d) * (h / 6.0);
        Self {
            position_m: x + mean(x1, x2, x3, x4),
            velocity_m_s: v + mean(v1, v2, v3, v4),
            attitude: end,
        }
    }

    fn attitude_after(&self, interval: &Interval) -> UnitQuaternion<f64> {
        let earth = UnitQuaternion::new(-earth::turn() * interval.length_s());
        let mut turned = earth * self.attitude * UnitQuaternion::new(interval.turn_rad());
        turned.renormalize_fast();
        turned
    }

    /// The same motion with its errors corrected: of position (m), velocity (m/s), and a small rotation about the axes of
    /// ECEF (rad).
    pub fn corrected(
        &self,
        position_m: &Vector3<f64>,
        velocity_m_s: &Vector3<f64>,
        turn_rad: &Vector3<f64>,
    ) -> Self {
        Self {
            position_m: self.position_m + position_m,
            velocity_m_s: self.velocity_m_s + velocity_m_s,
            attitude: UnitQuaternion::new(*turn_rad) * self.attitude,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn interval(from_s: f64, to_s: f64, rate: impl Fn(f64) -> Vector3<f64>) -> Interval {
        let (h, middle) = (to_s - from_s, (from_s + to_s) / 2.0);
        // Simpson's rule.
        let mean = (rate(from_s) + 4.0 * rate(middle) + rate(to_s)) / 6.0;
        Interval {
            from_s,
            to_s,
            force_m_s2: Vector3::zeros(),
            force_change_m_s3: Vector3::zeros(),
            rate_rad_s: mean,
            rate_change_rad_s2: (rate(to_s) - rate(from_s)) / h,
            lost: Lost::default(),
        }
    }

    /// A coning body: its axis moves on a circle, so the mean of its rate is not zero although the body does not drift.
    #[test]
    fn a_coning_body_does_not_drift() {
        let (tilt, speed) = (0.02f64, 10.0f64);
        let rate = |t: f64| {
            Vector3::new(
                -tilt.sin() * speed * (speed * t).sin(),
                tilt.sin() * speed * (speed * t).cos(),
                speed * (tilt.cos() - 1.0),
            )
        };
        let axis = |t: f64| Vector3::new((speed * t).cos(), (speed * t).sin(), 0.0) * tilt;
        let far = Vector3::new(7e6, 0.0, 0.0);
        let mut motion = Motion {
            position_m: far,
            velocity_m_s: Vector3::zeros(),
            attitude: UnitQuaternion::new(axis(0.0)),
        };
        let (steps, end_s) = (2000, 20.0);
        for n in 0..steps {
            let at = |n: i32| f64::from(n) * end_s / f64::from(steps);
            motion = motion.advanced(&interval(at(n), at(n + 1), rate));
        }
        let earth = UnitQuaternion::new(-earth::turn() * end_s);
        let off = (earth * UnitQuaternion::new(axis(end_s))).angle_to(&motion.attitude);
        assert!(off < 2e-7, "{off}");
    }

    #[test]
    fn parts_of_an_interval_make_the_whole() {
        let whole = Interval {
            from_s: 0.0,
            to_s: 0.05,
            force_m_s2: Vector3::new(0.1, -9.8, 1.0),
            force_change_m_s3: Vector3::new(3.0, 1.0, -2.0),
            rate_rad_s: Vector3::new(0.2, -0.1, 0.4),
            rate_change_rad_s2: Vector3::new(1.0, 2.0, -3.0),
            lost: Lost::default(),
        };
        let start = Motion {
            position_m: Vector3::new(1e6, -5e6, 4e6),
            velocity_m_s: Vector3::new(100.0, 20.0, -1500.0),
            attitude: UnitQuaternion::new(Vector3::new(0.3, 1.0, -0.4)),
        };
        let end = start.advanced(&whole);
        let cut = start
            .advanced(&whole.part(0.0, 0.02))
            .advanced(&whole.part(0.02, 0.05));
        assert!(cut.attitude.angle_to(&end.attitude) < 1e-7);
        assert!((cut.velocity_m_s - end.velocity_m_s).norm() < 1e-6);
        assert!((cut.position_m - end.position_m).norm() < 1e-6);
    }
}
