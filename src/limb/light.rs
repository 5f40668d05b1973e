//! The light of the disc, as determined from its edge.

use super::shape::EdgeModel;
use crate::frame::{PIXEL_VARIANCE_PX2, PixelNoise};
use crate::geometry::Ellipse;
use crate::kernels::limb::{Disc, Lit};
use nalgebra::{Matrix2, Vector2};

/// With a larger fraction of the limb, the azimuths at which it is softer are determined.
const MOTION_LIMB: f64 = 0.7;
/// A limb softer than the lens's blur by less than this factor counts as equally sharp.
const HARDLY_SOFTER: f64 = 1.3;

/// Variance that a uniform motion during the exposure adds to a position along it, px^2, from its length: that of a uniform
/// distribution.
pub fn motion_variance_px2(motion_px: f64) -> f64 {
    motion_px.powi(2) / 12.0
}

/// The disc's blurred light without marks: its outline, and the model of its edge.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DiscLight {
    pub outline: Ellipse,
    pub(super) edge: EdgeModel,
}

impl DiscLight {
    /// Variance of the blur along the limb's normal, the mean over azimuth and the amplitude at twice the azimuth, px^2;
    /// the pixel response is subtracted in quadrature.
    fn blur_px2(&self) -> (f64, f64) {
        let mean = self.edge.profile.blur_px.powi(2) + self.edge.shape.blur_px2();
        (
            mean - PIXEL_VARIANCE_PX2,
            self.edge.shape.motion_px2().norm(),
        )
    }

    /// Blur of the limb, 1 sigma, mean over azimuth.
    pub fn blur_px(&self) -> f64 {
        self.blur_px2().0.max(0.0).sqrt()
    }

    /// Blur of the lens, 1 sigma: the limb's blur where the Sun's motion does not add to it.
    pub fn lens_blur_px(&self) -> f64 {
        let (mean, motion) = self.blur_px2();
        (mean - motion).max(0.0).sqrt()
    }

    /// Upper limit of the motion of the Sun's image during the exposure, px, for a given blur of the lens. On part of a
    /// limb motion and haze cannot be distinguished, and all excess blur counts as motion.
    pub fn most_motion_px(&self, lens_blur_px: f64, limb_fraction: f64) -> f64 {
        if limb_fraction > MOTION_LIMB {
            return self.motion_px();
        }
        let softer_px2 = self.blur_px2().0 - (HARDLY_SOFTER * lens_blur_px).powi(2);
        self.motion_px().max((12.0 * softer_px2).max(0.0).sqrt())
    }

    /// Motion of the Sun's image during the exposure, px. A uniform motion by l adds the variance l^2/12 along it and none
    /// across it: a mean of l^2/24, and an amplitude of l^2/24 at twice the azimuth.
    pub fn motion_px(&self) -> f64 {
        (24.0 * self.blur_px2().1).sqrt()
    }

    /// Coma: the fraction of the light that it displaces times the displacement, px, and its covariance; 0 if it is not
    /// significant. The displaced light is blurred by [`COMA_BLURS`](super::COMA_BLURS) times the blur.
    pub fn coma(&self) -> (Vector2<f64>, Matrix2<f64>) {
        self.edge.coma()
    }

    /// Uncertainty of the limb's radial position that is common to all azimuths, from that of its profile, 1 sigma, px.
    pub fn place_sigma_px(&self) -> f64 {
        self.edge.place_sigma_px
    }

    /// Noise of the pixels near the limb.
    pub fn noise(&self) -> PixelNoise {
        self.edge.noise
    }

    /// The disc's light on the pixels of a row from column `x` on, DN above the background.
    pub fn fill(&self, x: f64, y: f64, light: &mut [f32]) {
        let from = Vector2::new(x, y) - self.outline.centre;
        self.disc().fill(from.x as f32, from.y as f32, light);
    }

    /// The light at positions relative to `about`, px.
    pub fn about(&self, about: Vector2<f64>, x: &[f32], y: &[f32], lit: &mut Lit) {
        let from = (about - self.outline.centre).cast::<f32>();
        self.disc().at(from.into(), x, y, lit);
    }

    fn disc(&self) -> Disc {
        let inverse = self.outline.inverse();
        Disc {
            edge: self.edge.profile.light(),
            inverse: [inverse.m11, inverse.m12, inverse.m22].map(|v| v as f32),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::profile::Profile;
    use super::super::shape::Shape;
    use super::*;

    #[test]
    fn the_light_of_a_row_is_the_profiles_at_each_pixel() {
        let profile = Profile {
            background_dn: 0.0,
            even_dn: 90.0,
            darkened_dn: 115.0,
            blur_px: 0.95,
            radius_px: 95.0,
        };
        let root = Matrix2::new(95.1, 0.05, 0.05, 94.9);
        let light = DiscLight {
            outline: Ellipse::new(Vector2::new(120.3, 110.8), root).unwrap(),
            edge: EdgeModel {
                profile,
                place_sigma_px: 0.01,
                shape: Shape::NONE,
                covariance: nalgebra::SMatrix::zeros(),
                noise: PixelNoise::even(1.0),
                resolution_px: 0.95,
                shift_sigma_px: 0.1,
                saturated_dn: 250.0,
            },
        };
        for y in [20.0, 60.0, 111.0] {
            let mut row = [0.0; 237];
            light.fill(3.0, y, &mut row);
            for (n, found) in row.iter().enumerate() {
                let at = Vector2::new(3.0 + n as f64, y);
                let expected = profile.at(light.outline.excess(at));
                assert!((f64::from(*found) - expected).abs() < 0.15, "{at}: {found}");
            }
        }
    }
}
