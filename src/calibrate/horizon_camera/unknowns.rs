//! Unknowns of a camera that sees the horizon, and their priors from its file.

use crate::estimation::{Normal, Prior};
use crate::geometry::camera::{CameraModel, Lens};
use crate::instrument::DirectionCamera;
use crate::units::SensorPx;
use nalgebra::SVector;

/// Number of unknowns.
pub const UNKNOWNS: usize = 6;

/// An unknown, in the order of the vectors.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Unknown {
    /// The logarithm of the focal length of both axes, whose ratio is fixed.
    Focal,
    CentreX,
    CentreY,
    /// k2 and k3 of Kannala and Brandt's polynomial: its terms of theta^3 and theta^5.
    Cubic,
    Quintic,
    /// The height of the limb's edge, in sigmas.
    Edge,
}

impl Unknown {
    pub const ALL: [Self; UNKNOWNS] = [
        Self::Focal,
        Self::CentreX,
        Self::CentreY,
        Self::Cubic,
        Self::Quintic,
        Self::Edge,
    ];
    /// Unknowns that the frames must determine. If they do not determine k3, it stays near the file's.
    pub const REQUIRED: [Self; 4] = [Self::Focal, Self::CentreX, Self::CentreY, Self::Cubic];

    pub fn name(self) -> &'static str {
        match self {
            Self::Focal => "focal length",
            Self::CentreX => "centre in x",
            Self::CentreY => "centre in y",
            Self::Cubic => "distortion k2",
            Self::Quintic => "distortion k3",
            Self::Edge => "edge's height",
        }
    }

    /// Parameters with a larger sigma are not determined: such a camera is of little use.
    pub(super) fn most_sigma(self, camera: &DirectionCamera) -> f64 {
        const PART: f64 = 0.2;
        PART * self.stated_sigma(camera)
    }

    /// Assumed 1 sigma of the values in a camera's file.
    pub(super) fn stated_sigma(self, camera: &DirectionCamera) -> f64 {
        const FOCAL: f64 = 0.1;
        const CENTRE: f64 = 0.05;
        const CUBIC: f64 = 0.1;
        const QUINTIC: f64 = 0.05;
        match self {
            Self::Focal => FOCAL,
            Self::CentreX => CENTRE * camera.width_px as f64,
            Self::CentreY => CENTRE * camera.height_px as f64,
            Self::Cubic => CUBIC,
            Self::Quintic => QUINTIC,
            Self::Edge => 1.0,
        }
    }
}

/// Difference of each unknown from the file's value.
pub(super) type Change = SVector<f64, UNKNOWNS>;

/// A camera's file and its lens as a polynomial.
#[derive(Debug, Clone)]
pub(super) struct Stated<'a> {
    pub file: &'a DirectionCamera,
    k: [f64; 5],
}

impl<'a> Stated<'a> {
    /// `None` if no polynomial approximates the rectilinear lens.
    pub fn new(file: &'a DirectionCamera) -> Option<Self> {
        let k = match file.lens.lens() {
            Lens::KannalaBrandt(k) => k,
            Lens::Rectilinear => nearest_to_rectilinear(corner_rad(file)?)?,
        };
        Some(Self { file, k })
    }

    /// `None` if the change gives no valid camera.
    pub fn camera(&self, change: &Change) -> Option<CameraModel> {
        let lens = &self.file.lens;
        let mut k = self.k;
        k[1] += change[Unknown::Cubic as usize];
        k[2] += change[Unknown::Quintic as usize];
        let focal_px = lens
            .focal_px()
            .map(|px| px * change[Unknown::Focal as usize].exp());
        let centre = lens.principal_point();
        let centre = SensorPx::new(
            centre.x + change[Unknown::CentreX as usize],
            centre.y + change[Unknown::CentreY as usize],
        );
        CameraModel::new(Lens::KannalaBrandt(k), focal_px, centre)
    }

    pub fn prior(&self) -> Prior<UNKNOWNS> {
        let sigmas = SVector::from(Unknown::ALL.map(|unknown| unknown.stated_sigma(self.file)));
        Prior {
            mean: Change::zeros(),
            information: sigmas.map(|sigma: f64| sigma.powi(-2)),
        }
    }
}

/// The largest angle from the axis in the picture, at a corner.
fn corner_rad(camera: &DirectionCamera) -> Option<f64> {
    let (right, bottom) = (camera.width_px as f64, camera.height_px as f64);
    let corners = [(0.0, 0.0), (right, 0.0), (0.0, bottom), (right, bottom)];
    let axis = camera.lens.ray(camera.lens.principal_point())?;
    let angle = |(x, y)| Some(camera.lens.ray(SensorPx::new(x, y))?.angle(&axis));
    corners.into_iter().filter_map(angle).reduce(f64::max)
}

/// k1 to k5 that approximate the radius tan theta, up to an angle.
fn nearest_to_rectilinear(up_to_rad: f64) -> Option<[f64; 5]> {
    const SAMPLES: u32 = 200;
    let mut normal = Normal::<5>::zero();
    for n in 1..=SAMPLES {
        let theta = up_to_rad * f64::from(n) / f64::from(SAMPLES);
        let powers = SVector::from_fn(|n, _| theta.powi(2 * n as i32 + 1));
        normal.add(&powers, theta.tan(), 1.0);
    }
    let solved = normal.solve(&Prior::none(), &SVector::zeros())?;
    Some(solved.step.into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wide_rectilinear_lens_is_a_polynomials_to_a_twentieth_of_a_pixel() {
        const FOCAL_PX: f64 = 900.0;
        let up_to_rad = 0.9;
        let k = nearest_to_rectilinear(up_to_rad).unwrap();
        for n in 1..100 {
            let theta = up_to_rad * f64::from(n) / 100.0;
            let r: f64 = (0..5).map(|n| k[n as usize] * theta.powi(2 * n + 1)).sum();
            assert!(FOCAL_PX * (r - theta.tan()).abs() < 0.05, "{theta} rad");
        }
    }
}
