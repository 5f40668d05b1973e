//! The outline of a disc seen by a tilted camera.

use super::circle::Circle;
use nalgebra::{Matrix2, Vector2};

/// An ellipse as the image of the unit circle: x = centre + root w, |w| = 1, where `root` is symmetric and positive: the square root of
/// the matrix of its squared half axes.
///
/// A disc that is round on the plate is such an ellipse on the sensor, and `root` is then, up to a rotation, the local mapping from plate
/// to sensor in units of the disc's radius.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ellipse {
    pub centre: Vector2<f64>,
    root: Matrix2<f64>,
    inverse: Matrix2<f64>,
}

impl Ellipse {
    /// `None` if the root is not symmetric and positive.
    pub fn new(centre: Vector2<f64>, root: Matrix2<f64>) -> Option<Self> {
        let positive = root.m11 > 0.0 && root.determinant() > 0.0;
        let symmetric = (root.m12 - root.m21).abs() <= 1e-9 * root.m11.abs();
        Some(Self {
            centre,
            root,
            inverse: root.try_inverse()?,
        })
        .filter(|_| positive && symmetric)
    }

    /// The image of the unit circle under a linear mapping.
    pub fn of_unit_circle(centre: Vector2<f64>, mapping: &Matrix2<f64>) -> Option<Self> {
        // The root is the symmetric part of the mapping's polar decomposition, the square root of M M^T. By Cayley and
        // Hamilton it is (M M^T + d 1) / sqrt(trace + 2 d) with d^2 its determinant.
        let square = mapping * mapping.transpose();
        let d = mapping.determinant().abs();
        let root = (square + Matrix2::identity() * d) / (square.trace() + 2.0 * d).sqrt();
        Self::new(centre, root)
    }

    pub fn root(&self) -> &Matrix2<f64> {
        &self.root
    }

    /// The inverse of the root, 1/px.
    pub fn inverse(&self) -> &Matrix2<f64> {
        &self.inverse
    }

    /// Mean of the half axes.
    pub fn mean_radius(&self) -> f64 {
        self.root.trace() / 2.0
    }

    /// Both half axes longer by `px`; `None` if nothing remains.
    pub fn grown(&self, px: f64) -> Option<Self> {
        Self::new(self.centre, self.root + Matrix2::identity() * px)
    }

    /// A position relative to the centre in units of the disc's radius: 1 on the outline.
    pub fn to_disc(&self, point: Vector2<f64>) -> Vector2<f64> {
        self.inverse * (point - self.centre)
    }

    /// The inverse of [`to_disc`](Self::to_disc).
    pub fn from_disc(&self, w: Vector2<f64>) -> Vector2<f64> {
        self.centre + self.root * w
    }

    /// Outward unit normal of the outline at the image of `w`.
    pub fn normal(&self, w: Vector2<f64>) -> Vector2<f64> {
        (self.inverse * w).normalize()
    }

    /// Distance of a point outside the outline; to first order in that distance and in the ellipse's flattening.
    pub fn excess(&self, point: Vector2<f64>) -> f64 {
        self.excess_at(self.to_disc(point))
    }

    /// The same for a position in units of the disc's radius.
    pub fn excess_at(&self, w: Vector2<f64>) -> f64 {
        let r = w.norm();
        if r == 0.0 {
            return -self.mean_radius();
        }
        // The derivative of |w| along its own gradient, per px.
        (r - 1.0) * r / (self.inverse * w).norm()
    }
}

impl From<Circle> for Ellipse {
    fn from(circle: Circle) -> Self {
        Self {
            centre: circle.centre,
            root: Matrix2::identity() * circle.radius,
            inverse: Matrix2::identity() / circle.radius,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_of_the_outline_lie_on_it_and_steps_off_it_are_measured() {
        let ellipse =
            Ellipse::new(Vector2::new(10.0, -4.0), Matrix2::new(95.5, 0.2, 0.2, 94.8)).unwrap();
        for n in 0..24 {
            let (sin, cos) = (f64::from(n) * 0.26).sin_cos();
            let at = ellipse.from_disc(Vector2::new(cos, sin));
            assert!(ellipse.excess(at).abs() < 1e-9);
            let out = (at - ellipse.centre).normalize() * 3.0;
            assert!((ellipse.excess(at + out) - 3.0).abs() < 0.001);
        }
    }

    #[test]
    fn the_image_of_the_unit_circle_is_where_its_points_are() {
        let mapping = Matrix2::new(-70.0, 55.0, 54.0, 71.0);
        let ellipse = Ellipse::of_unit_circle(Vector2::new(3.0, 9.0), &mapping).unwrap();
        for n in 0..24 {
            let (sin, cos) = (f64::from(n) * 0.26).sin_cos();
            let at = ellipse.centre + mapping * Vector2::new(cos, sin);
            assert!(ellipse.excess(at).abs() < 1e-9);
        }
    }

    #[test]
    fn a_circle_is_an_ellipse() {
        let circle = Circle {
            centre: Vector2::new(3.0, 4.0),
            radius: 7.0,
        };
        let at = Vector2::new(8.0, -2.0);
        assert!((Ellipse::from(circle).excess(at) - circle.excess(at)).abs() < 1e-12);
    }

    #[test]
    fn a_root_that_is_no_ellipse_is_refused() {
        assert_eq!(Ellipse::new(Vector2::zeros(), Matrix2::zeros()), None);
        assert_eq!(
            Ellipse::new(Vector2::zeros(), Matrix2::new(1.0, 0.5, -0.5, 1.0)),
            None
        );
    }
}
