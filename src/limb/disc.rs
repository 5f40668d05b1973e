//! The circle through points of the limb, in any unit: on the sensor (px) or on the plate (mil).

use crate::geometry::Circle;
use crate::units::Measured;
use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

/// A fitted disc. Unit: that of the points.
#[derive(Debug, Clone, PartialEq)]
pub struct DiscFit {
    pub circle: Circle,
    /// Covariance of centre x, centre y and radius.
    pub covariance: Matrix3<f64>,
    /// Scatter of the accepted points about the circle, 1 sigma.
    pub scatter: f64,
    /// Which points lie on the circle.
    pub accepted: Vec<bool>,
}

impl DiscFit {
    /// Covariance of the centre.
    pub fn centre_covariance(&self) -> Matrix2<f64> {
        self.covariance.fixed_view::<2, 2>(0, 0).into_owned()
    }

    pub fn accepted_count(&self) -> usize {
        self.accepted.iter().filter(|accepted| **accepted).count()
    }
}

/// Tukey's biweight gives no weight beyond this many sigma; 95 % efficient for normal errors.
const TUKEY_SIGMAS: f64 = 4.685;
const ITERATIONS: usize = 12;

/// Least-squares circle through points, with Tukey's weights against marks and scratches, and a radius known
/// beforehand with its sigma (which hardly matters when the whole limb is seen and decides when little of it is).
///
/// The scatter, and with it the covariance, comes from the points' own residuals, but is never taken smaller than
/// `least_scatter`. `None` when fewer than three points are left or the geometry is degenerate.
pub fn fit_disc(
    points: &[Vector2<f64>],
    start: Circle,
    radius_prior: Measured,
    least_scatter: f64,
) -> Option<DiscFit> {
    let mut circle = start;
    let mut scatter = robust_scatter(points, &circle).max(least_scatter);
    let mut information = Matrix3::zeros();
    for _ in 0..ITERATIONS {
        let prior_weight = 1.0 / radius_prior.sigma.powi(2);
        information = Matrix3::zeros();
        information[(2, 2)] = prior_weight;
        let mut gradient = Vector3::new(
            0.0,
            0.0,
            prior_weight * (radius_prior.value - circle.radius),
        );
        for point in points {
            let from_centre = point - circle.centre;
            let distance = from_centre.norm();
            let excess = distance - circle.radius;
            let weight = tukey_weight(excess / scatter) / scatter.powi(2);
            if weight > 0.0 && distance > 0.0 {
                let slope = Vector3::new(from_centre.x / distance, from_centre.y / distance, 1.0);
                information += slope * slope.transpose() * weight;
                gradient += slope * (excess * weight);
            }
        }
        let step = information.try_inverse()? * gradient;
        circle.centre += step.fixed_rows::<2>(0);
        circle.radius += step.z;
        if !step.iter().all(|v| v.is_finite()) {
            return None;
        }
        scatter = robust_scatter(points, &circle).max(least_scatter);
    }
    let accepted: Vec<bool> = points
        .iter()
        .map(|p| circle.excess(*p).abs() < TUKEY_SIGMAS * scatter)
        .collect();
    let count = accepted.iter().filter(|a| **a).count();
    (count >= 3).then_some(DiscFit {
        circle,
        covariance: information.try_inverse()?,
        scatter,
        accepted,
    })
}

fn tukey_weight(sigmas: f64) -> f64 {
    let u = sigmas / TUKEY_SIGMAS;
    if u.abs() < 1.0 {
        (1.0 - u * u).powi(2)
    } else {
        0.0
    }
}

/// 1 sigma from the median of the absolute residuals.
fn robust_scatter(points: &[Vector2<f64>], circle: &Circle) -> f64 {
    let mut residuals: Vec<f64> = points.iter().map(|p| circle.excess(*p).abs()).collect();
    if residuals.is_empty() {
        return 0.0;
    }
    let middle = residuals.len() / 2;
    let (_, median, _) = residuals.select_nth_unstable_by(middle, f64::total_cmp);
    1.4826 * *median
}

/// Which part of the circle has points on it, 0 to 1, in steps of 10 deg.
pub fn arc_fraction(points: impl Iterator<Item = Vector2<f64>>, centre: Vector2<f64>) -> f64 {
    const BINS: usize = 36;
    let mut seen = [false; BINS];
    for point in points {
        let d = point - centre;
        let turns = d.y.atan2(d.x) / std::f64::consts::TAU;
        seen[(turns.rem_euclid(1.0) * BINS as f64) as usize % BINS] = true;
    }
    seen.iter().filter(|s| **s).count() as f64 / BINS as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ring(centre: Vector2<f64>, radius: f64, degrees: std::ops::Range<i32>) -> Vec<Vector2<f64>> {
        degrees
            .map(|d| {
                let (sin, cos) = f64::from(d).to_radians().sin_cos();
                let ripple = 0.05 * f64::from(d * 7919 % 13 - 6) / 6.0;
                centre + Vector2::new(cos, sin) * (radius + ripple)
            })
            .collect()
    }

    const FREE: Measured = Measured::new(95.0, 5.0);

    #[test]
    fn a_circle_is_found_though_a_fifth_of_its_points_is_pulled_inwards() {
        let truth = Vector2::new(400.0, 300.0);
        let mut points = ring(truth, 95.16, 0..360);
        for point in points.iter_mut().take(72) {
            *point += (truth - *point).normalize() * 6.0;
        }
        let start = Circle {
            centre: truth + Vector2::new(0.3, -0.3),
            radius: 94.8,
        };
        let fit = fit_disc(&points, start, FREE, 0.01).unwrap();
        assert!((fit.circle.centre - truth).norm() < 0.01);
        assert!((fit.circle.radius - 95.16).abs() < 0.01);
        assert_eq!(fit.accepted_count(), 288);
    }

    #[test]
    fn a_short_arc_is_less_certain_across_it_than_along_it_and_the_prior_helps() {
        let truth = Vector2::new(0.0, 0.0);
        let points = ring(truth, 95.0, -20..20);
        let start = Circle {
            centre: truth,
            radius: 95.0,
        };
        let free = fit_disc(&points, start, FREE, 0.01).unwrap();
        let known = fit_disc(&points, start, Measured::new(95.0, 0.05), 0.01).unwrap();
        assert!(free.covariance[(0, 0)] > free.covariance[(1, 1)]);
        assert!(known.covariance[(0, 0)] < free.covariance[(0, 0)] / 4.0);
    }

    #[test]
    fn three_points_on_a_line_make_no_circle() {
        let p = |x: f64| Vector2::new(x, 2.0 * x);
        assert_eq!(Circle::through(p(0.0), p(1.0), p(2.0)), None);
    }
}
