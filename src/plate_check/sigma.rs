//! Predicted uncertainty of the Sun's position on the plate from marks and limb.
//!
//! # Method
//! Marks with a common sigma s at positions r from the Sun's centre determine a similarity there: shift, rotation and
//! scale. The Fisher matrix of shift (x, y), rotation and scale has the blocks of least squares; the disc's radius, which
//! is known on the plate, adds to the information on the scale. The limb's centre contributes as well: a limb with a step D
//! behind a blur b and noise n determines a shift along its normal with the information D^2 / (2 sqrt(pi) b n^2) per px of
//! its length, half of it along each axis.
//!
//! This is the Cramer-Rao bound apart from correlations between limb and marks: within a fifth of the bound in `accuracy`,
//! which differentiates the whole picture.

use super::scene::CheckScene;
use nalgebra::{Matrix4, Vector2};
use std::f64::consts::PI;

/// Brightness at the limb: 1 - u of a linear limb darkening of 0.56.
const LIMB_LIGHT: f64 = 0.44;

/// Predicted uncertainty of a position.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct KnownPlace {
    /// Error from noise, 1 sigma per axis.
    pub sigma_mil: f64,
    /// Error from misprinted marks, according to the plate's sigmas, 1 sigma per axis.
    pub misprint_mil: f64,
}

/// `None` if marks and limb do not determine a similarity.
pub(super) fn of_place(scene: &CheckScene, noise_share: f64) -> Option<KnownPlace> {
    let (view, radius_px) = (scene.view, scene.radius_px());
    let per_length = (LIMB_LIGHT / noise_share).powi(2) / (2.0 * PI.sqrt() * view.image.blur_px);
    let limb_variance = 1.0 / (PI * radius_px * per_length);
    let radius_variance = limb_variance / 2.0 / radius_px.powi(2);
    let scale_mil_per_px = view.radius_mil() / radius_px;
    let per_mark = view.sigma_px.powi(-2);
    let marks = || {
        scene
            .full()
            .map(|mark| mark.at.vector() - scene.outline.centre)
    };
    let by_marks = shift_variance(marks().map(|r| (r, per_mark)), 1.0 / radius_variance)?;
    let per_print = scene
        .full()
        .map(|mark| (scale_mil_per_px / mark.print_mil.max(1e-6)).powi(2));
    let by_print = shift_variance(marks().zip(per_print), 0.0)?;
    let mil = |variance: f64| variance.sqrt() * scale_mil_per_px;
    Some(KnownPlace {
        sigma_mil: mil(by_marks + limb_variance),
        misprint_mil: mil(by_print),
    })
}

/// Mean variance per axis, px^2, of the shift at the origin, from positions with their information; `of_scale` is
/// additional information on the scale.
fn shift_variance(places: impl Iterator<Item = (Vector2<f64>, f64)>, of_scale: f64) -> Option<f64> {
    let mut information = Matrix4::zeros();
    for (r, per_place) in places {
        let slopes = nalgebra::Matrix2x4::new(1.0, 0.0, -r.y, r.x, 0.0, 1.0, r.x, r.y);
        information += slopes.transpose() * slopes * per_place;
    }
    information[(3, 3)] += of_scale;
    let covariance = information.cholesky()?.inverse();
    Some((covariance.m11 + covariance.m22) / 2.0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn four_marks_about_the_sun_halve_the_sigma_of_one() {
        let places = [[90.0, 0.0], [-90.0, 0.0], [0.0, 90.0], [0.0, -90.0]].map(Vector2::from);
        let variance = shift_variance(places.map(|p| (p, 25.0)).into_iter(), 0.0).unwrap();
        assert!((variance - 0.01).abs() < 1e-12);
        // Far from the marks, the errors of rotation and scale add: each has a variance of 1 / (25 x 4 x 90^2).
        let far = places.map(|p| (p + Vector2::new(180.0, 0.0), 25.0));
        let variance = shift_variance(far.into_iter(), 0.0).unwrap();
        assert!((variance - 0.01 * (1.0 + 4.0)).abs() < 1e-9, "{variance}");
        assert_eq!(shift_variance(far.into_iter().take(1), 0.0), None);
    }
}
