//! A camera that measures directions.
//!
//! Camera frame: x to the right along the rows, y down, z forward along the optical axis. A ray is the unit vector from the camera to an
//! object. At the angle theta from z, the ideal image is at the radius r(theta), in focal lengths, from the principal point; one focal
//! length is fx and fy pixels in x and y.
//!
//! r is either tan theta (rectilinear) or k1 theta + k2 theta^3 + k3 theta^5 + k4 theta^7 + k5 theta^9 (Kannala and Brandt
//! 2006, "A Generic Camera Model and Calibration Method"; Braun and Barf 2022, eq. 13), which covers lenses of 180 deg and
//! more.

use super::attitude::Direction;
use crate::units::{Estimate, SensorPx};
use nalgebra::{
    Matrix2, Matrix2x3, Matrix3x2, RowVector2, RowVector3, UnitVector3, Vector2, Vector3,
};
use std::f64::consts::{FRAC_PI_2, PI};

/// Radius in the image, in focal lengths, as a function of the angle from the optical axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Lens {
    /// tan theta.
    Rectilinear,
    /// Coefficients k1 to k5 of the odd powers of theta (rad), from theta to theta^9.
    KannalaBrandt([f64; 5]),
}

impl Lens {
    /// r and dr/dtheta.
    fn radius(&self, theta: f64) -> (f64, f64) {
        match self {
            Self::Rectilinear => (theta.tan(), 1.0 + theta.tan().powi(2)),
            Self::KannalaBrandt(k) => {
                let square = theta * theta;
                let (mut r, mut slope) = (0.0, 0.0);
                for (n, k) in k.iter().enumerate().rev() {
                    r = r * square + k;
                    slope = slope * square + k * (2 * n + 1) as f64;
                }
                (r * theta, slope)
            }
        }
    }

    /// The angle up to which r increases with theta, at most pi.
    fn limit_rad(&self) -> f64 {
        const STEPS: u32 = 4096;
        if *self == Self::Rectilinear {
            return FRAC_PI_2;
        }
        let grows = |theta: f64| self.radius(theta).1 > 0.0;
        let at = |n: u32| PI * f64::from(n) / f64::from(STEPS);
        let Some(first) = (0..=STEPS).find(|n| !grows(at(*n))) else {
            return PI;
        };
        let (mut inside, mut outside) = (at(first.saturating_sub(1)), at(first));
        for _ in 0..60 {
            let middle = (inside + outside) / 2.0;
            if grows(middle) {
                inside = middle;
            } else {
                outside = middle;
            }
        }
        inside
    }
}

/// A camera: lens and pixels. Its rays are limited to angles up to which the [`Lens`]'s radius increases.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CameraModel {
    lens: Lens,
    /// Focal lengths fx and fy, px.
    focal_px: Vector2<f64>,
    principal_point: SensorPx,
    limit_rad: f64,
}

impl CameraModel {
    /// `None` if a number is not finite, a focal length is not positive or the radius does not increase from the axis.
    pub fn new(lens: Lens, focal_px: [f64; 2], principal_point: SensorPx) -> Option<Self> {
        let limit_rad = lens.limit_rad();
        let (at_limit, at_axis) = (lens.radius(limit_rad).0, lens.radius(0.0).1);
        let finite = at_limit.is_finite() && principal_point.vector().iter().all(|v| v.is_finite());
        let positive = focal_px.iter().all(|f| f.is_finite() && *f > 0.0);
        (finite && positive && at_axis > 0.0).then_some(Self {
            lens,
            focal_px: focal_px.into(),
            principal_point,
            limit_rad,
        })
    }

    /// A camera without distortion, with square pixels. The focal length must be positive.
    pub fn rectilinear(focal_px: f64, principal_point: SensorPx) -> Self {
        Self {
            lens: Lens::Rectilinear,
            focal_px: Vector2::repeat(focal_px),
            principal_point,
            limit_rad: Lens::Rectilinear.limit_rad(),
        }
    }

    pub fn lens(&self) -> Lens {
        self.lens
    }

    /// Focal lengths fx and fy, px.
    pub fn focal_px(&self) -> [f64; 2] {
        self.focal_px.into()
    }

    pub fn principal_point(&self) -> SensorPx {
        self.principal_point
    }

    /// Largest angle of a ray from the optical axis, rad, without the limit of the sensor's size.
    pub fn limit_rad(&self) -> f64 {
        self.limit_rad
    }

    /// The mean of the two focal lengths: pixels per rad at the axis of a lens without distortion.
    pub fn mean_focal_px(&self) -> f64 {
        self.lens.radius(0.0).1 * (self.focal_px.x + self.focal_px.y) / 2.0
    }

    /// Derivative of the radius by the angle from the axis at a ray, relative to that at the axis.
    pub fn growth(&self, ray: &UnitVector3<f64>) -> f64 {
        match self.lens {
            // The same formula without angles.
            Lens::Rectilinear => ray.z.powi(-2),
            Lens::KannalaBrandt(_) => {
                let (theta, _) = polar(ray);
                self.lens.radius(theta).1 / self.lens.radius(0.0).1
            }
        }
    }

    /// The horizontal focal length over the vertical one: the ratio of the pixels' height to their width.
    pub fn aspect(&self) -> f64 {
        self.focal_px.x / self.focal_px.y
    }

    /// The pixel of a ray. `None` beyond the limit of the lens.
    pub fn pixel(&self, ray: &UnitVector3<f64>) -> Option<SensorPx> {
        let at = match self.lens {
            // The same formula without angles.
            Lens::Rectilinear => (ray.z > 0.0).then(|| ray.xy() / ray.z)?,
            Lens::KannalaBrandt(_) => {
                let (theta, outward) = polar(ray);
                outward * self.seen(theta)?.0
            }
        };
        let from_centre = at.component_mul(&self.focal_px);
        Some((self.principal_point.vector() + from_centre).into())
    }

    /// The ray of a pixel: the inverse of [`pixel`](Self::pixel). `None` beyond the limit of the lens.
    pub fn ray(&self, pixel: SensorPx) -> Option<UnitVector3<f64>> {
        if self.lens == Lens::Rectilinear {
            let at = self.in_plane(pixel);
            let is_finite = at.iter().all(|v| v.is_finite());
            return is_finite.then(|| UnitVector3::new_normalize(at.push(1.0)));
        }
        let (theta, outward) = self.angles(pixel)?;
        let across = outward * theta.sin();
        let ray = Vector3::new(across.x, across.y, theta.cos());
        Some(UnitVector3::new_normalize(ray))
    }

    /// Derivative of [`pixel`](Self::pixel), px per rad across the ray; the component along the ray is zero.
    pub fn pixel_jacobian(&self, ray: &UnitVector3<f64>) -> Option<Matrix2x3<f64>> {
        let (theta, outward) = polar(ray);
        let (r, slope) = self.seen(theta)?;
        let (sin, cos) = theta.sin_cos();
        // Derivatives of theta and of the outward direction by the ray.
        let polar = RowVector3::new(outward.x * cos, outward.y * cos, -sin);
        let around = RowVector3::new(-outward.y, outward.x, 0.0);
        let per_sin = if sin > 0.0 { r / sin } else { slope };
        let plane = outward * slope * polar + turned(outward) * per_sin * around;
        Some(Matrix2::from_diagonal(&self.focal_px) * plane)
    }

    /// Derivative of [`ray`](Self::ray), rad per px.
    pub fn ray_jacobian(&self, pixel: SensorPx) -> Option<Matrix3x2<f64>> {
        let per_px = Matrix2::from_diagonal(&self.focal_px.map(f64::recip));
        if self.lens == Lens::Rectilinear {
            let ray = self.ray(pixel)?.into_inner();
            // The axes of the image plane, without their components along the ray, over its distance.
            let axes = Matrix3x2::identity() - ray * ray.xy().transpose();
            return Some(axes * per_px * ray.z);
        }
        let (theta, outward) = self.angles(pixel)?;
        let (r, slope) = self.lens.radius(theta);
        let (sin, cos) = theta.sin_cos();
        let polar = Vector3::new(outward.x * cos, outward.y * cos, -sin);
        let around = Vector3::new(-outward.y, outward.x, 0.0);
        let per_r = if r > 0.0 { sin / r } else { 1.0 / slope };
        let along: RowVector2<f64> = outward.transpose() / slope;
        let across: RowVector2<f64> = turned(outward).transpose() * per_r;
        let by_plane = polar * along + around * across;
        Some(by_plane * per_px)
    }

    /// The ray of a measured pixel with its covariance. `None` beyond the limit of the lens.
    pub fn direction(&self, pixel: &Estimate<SensorPx>) -> Option<Direction> {
        let jacobian = self.ray_jacobian(pixel.position)?;
        Some(Direction {
            unit: self.ray(pixel.position)?,
            covariance_rad2: jacobian * pixel.covariance * jacobian.transpose(),
        })
    }

    /// r and its derivative, within the limit.
    fn seen(&self, theta: f64) -> Option<(f64, f64)> {
        (theta < self.limit_rad).then(|| self.lens.radius(theta))
    }

    /// Angle of a pixel from the axis (rad), and the outward unit vector in the image.
    fn angles(&self, pixel: SensorPx) -> Option<(f64, Vector2<f64>)> {
        let at = self.in_plane(pixel);
        Some((self.angle(at.norm())?, outward(at)))
    }

    /// Position of a pixel relative to the principal point, in focal lengths.
    fn in_plane(&self, pixel: SensorPx) -> Vector2<f64> {
        let from_centre = pixel.vector() - self.principal_point.vector();
        from_centre.component_div(&self.focal_px)
    }

    /// The angle for a radius, by Newton's method within a bracket that every step narrows.
    fn angle(&self, radius: f64) -> Option<f64> {
        if self.lens == Lens::Rectilinear {
            return radius.is_finite().then(|| radius.atan());
        }
        let (mut low, mut high) = (0.0, self.limit_rad);
        let (at_limit, _) = self.lens.radius(high);
        if !(0.0..at_limit).contains(&radius) {
            return None;
        }
        let mut theta = (radius / self.lens.radius(0.0).1).min(high);
        for _ in 0..100 {
            let (r, slope) = self.lens.radius(theta);
            if r < radius {
                low = theta;
            } else {
                high = theta;
            }
            let newton = theta - (r - radius) / slope;
            let next = if newton > low && newton < high {
                newton
            } else {
                (low + high) / 2.0
            };
            let step = (next - theta).abs();
            theta = next;
            if step <= f64::EPSILON * theta {
                break;
            }
        }
        Some(theta)
    }
}

/// Angle of a ray from z (rad), and the outward unit vector in the image.
fn polar(ray: &UnitVector3<f64>) -> (f64, Vector2<f64>) {
    let across = ray.xy();
    (across.norm().atan2(ray.z), outward(across))
}

/// The direction of a vector; +x for zero, where the direction is arbitrary.
fn outward(across: Vector2<f64>) -> Vector2<f64> {
    across.try_normalize(0.0).unwrap_or_else(Vector2::x)
}

/// A vector rotated by 90 deg from +x towards +y.
fn turned(v: Vector2<f64>) -> Vector2<f64> {
    Vector2::new(-v.y, v.x)
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Matrix3;

    const CENTRE: SensorPx = SensorPx::new(630.0, 490.0);

    fn cameras() -> [CameraModel; 3] {
        let lens = [
            Lens::Rectilinear,
            Lens::KannalaBrandt([1.0, -0.05, 0.01, -2e-3, 1e-4]),
            // An equidistant fish-eye lens, for all directions.
            Lens::KannalaBrandt([0.9, 0.0, 0.0, 0.0, 0.0]),
        ];
        lens.map(|lens| CameraModel::new(lens, [800.0, 790.0], CENTRE).unwrap())
    }

    fn ray(theta: f64, phi: f64) -> UnitVector3<f64> {
        let (x, y) = (theta.sin() * phi.cos(), theta.sin() * phi.sin());
        UnitVector3::new_normalize(Vector3::new(x, y, theta.cos()))
    }

    fn rays(camera: &CameraModel) -> impl Iterator<Item = UnitVector3<f64>> + use<> {
        let limit = camera.limit_rad();
        (0..50).map(move |n| ray(limit * f64::from(n) / 50.5, f64::from(n)))
    }

    #[test]
    fn known_directions_have_known_pixels() {
        let [rectilinear, _, fish_eye] = cameras();
        let right = ray(0.5, 0.0);
        let seen = rectilinear.pixel(&right).unwrap();
        assert!(seen.distance(SensorPx::new(630.0 + 800.0 * 0.5_f64.tan(), 490.0)) < 1e-9);
        let backward = ray(3.0, FRAC_PI_2);
        let seen = fish_eye.pixel(&backward).unwrap();
        assert!(seen.distance(SensorPx::new(630.0, 490.0 + 790.0 * 2.7)) < 1e-9);
        for camera in cameras() {
            assert_eq!(camera.pixel(&Vector3::z_axis()), Some(CENTRE));
            assert_eq!(camera.ray(CENTRE), Some(Vector3::z_axis()));
        }
    }

    #[test]
    fn a_ray_comes_back_from_its_pixel() {
        for camera in cameras() {
            for ray in rays(&camera) {
                let back = camera.ray(camera.pixel(&ray).unwrap()).unwrap();
                assert!((back.into_inner() - ray.into_inner()).norm() < 2e-15 * 50.0);
            }
        }
    }

    #[test]
    fn jacobians_are_the_derivatives() {
        for camera in cameras() {
            for ray in rays(&camera) {
                let pixel = camera.pixel(&ray).unwrap();
                let to_pixel = camera.pixel_jacobian(&ray).unwrap();
                let to_ray = camera.ray_jacobian(pixel).unwrap();
                for step in [Vector2::x(), Vector2::y()] {
                    let at = |h: f64| camera.ray((pixel.vector() + step * h).into()).unwrap();
                    let slope = (at(1e-3).into_inner() - at(-1e-3).into_inner()) / 2e-3;
                    assert!((slope - to_ray * step).norm() < 1e-5 * slope.norm());
                }
                let tangent = Matrix3::identity() - ray.into_inner() * ray.transpose();
                assert!((to_pixel * to_ray - Matrix2::identity()).norm() < 1e-9);
                assert!((to_ray * to_pixel - tangent).norm() < 1e-9);
            }
        }
    }

    #[test]
    fn nothing_is_seen_beyond_the_limit() {
        let [rectilinear, polynomial, fish_eye] = cameras();
        assert_eq!(rectilinear.pixel(&ray(1.6, 0.3)), None);
        assert_eq!(fish_eye.limit_rad(), PI);
        // r = theta - theta^3 / 3 increases up to 1 rad, where it is 2/3.
        let lens = Lens::KannalaBrandt([1.0, -1.0 / 3.0, 0.0, 0.0, 0.0]);
        let narrow = CameraModel::new(lens, [300.0, 300.0], CENTRE).unwrap();
        assert!((narrow.limit_rad() - 1.0).abs() < 1e-9);
        assert_eq!(narrow.pixel(&ray(1.001, 0.0)), None);
        assert_eq!(narrow.ray(SensorPx::new(630.0 + 200.1, 490.0)), None);
        assert!(narrow.ray(SensorPx::new(630.0 + 199.9, 490.0)).is_some());
        assert_eq!(polynomial.ray(SensorPx::new(f64::NAN, 0.0)), None);
    }

    #[test]
    fn a_lens_that_makes_no_image_is_refused() {
        let falling = Lens::KannalaBrandt([-1.0, 0.0, 0.0, 0.0, 0.0]);
        assert_eq!(CameraModel::new(falling, [800.0; 2], CENTRE), None);
        assert_eq!(
            CameraModel::new(Lens::Rectilinear, [800.0, 0.0], CENTRE),
            None
        );
        let nan = Lens::KannalaBrandt([1.0, f64::NAN, 0.0, 0.0, 0.0]);
        assert_eq!(CameraModel::new(nan, [800.0; 2], CENTRE), None);
    }

    #[test]
    fn a_pixel_error_becomes_an_angle() {
        let [_, _, fish_eye] = cameras();
        let pixel = Estimate {
            position: SensorPx::new(630.0 + 720.0, 490.0),
            covariance: Matrix2::from_diagonal(&Vector2::new(0.04, 0.09)),
        };
        // At 1 rad to the right: across the radius, the image is stretched by theta / sin theta.
        let found = fish_eye.direction(&pixel).unwrap();
        let along = 0.2_f64 / 720.0;
        let around = 0.3 / (790.0 * 0.9) * 1.0_f64.sin();
        let covariance = found.covariance_rad2;
        assert!((covariance[(1, 1)].sqrt() - around).abs() < 1e-12);
        assert!((covariance.trace().sqrt() - along.hypot(around)).abs() < 1e-12);
        assert!((covariance * found.unit.into_inner()).norm() < 1e-18);
    }
}
