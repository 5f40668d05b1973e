//! The disc's light by rows of pixels, as marks' fits ask for it.

use super::Profile;
use super::band::outwards;
use crate::geometry::Ellipse;
use multiversion::multiversion;

/// Deeper inside than so many blurs the blur adds little to the limb darkening.
const DEEP_BLURS: f64 = 6.0;

/// The disc's blurred light without marks.
#[derive(Debug, Clone, PartialEq)]
pub struct DiscLight {
    centre: [f64; 2],
    /// The outline's inverse root, 1/px: m11, m12, m22.
    inverse: [f32; 3],
    profile: Profile,
    /// Deeper inside than this the disc is deep, radii squared.
    deep: f32,
}

impl DiscLight {
    pub(super) fn new(outline: &Ellipse, profile: &Profile) -> Self {
        let inverse = outline.inverse().cast::<f32>();
        let deep = 1.0 - DEEP_BLURS * profile.blur_px / profile.radius_px;
        Self {
            centre: outline.centre.into(),
            inverse: [inverse.m11, inverse.m12, inverse.m22],
            profile: *profile,
            deep: deep.max(0.0).powi(2) as f32,
        }
    }

    /// The light on a row's pixels from column `x` on, DN above the background.
    pub fn fill(&self, x: f64, y: f64, light: &mut [f32]) {
        let from = [x - self.centre[0], y - self.centre[1]].map(|v| v as f32);
        let ends = [from[0], from[0] + light.len() as f32];
        // What lies between two places deep inside is deep inside.
        if ends.iter().all(|x| self.radius2(*x, from[1]) < self.deep) {
            fill_deep(self, from, light);
        } else {
            fill_near_limb(self, from, light);
        }
    }

    /// Distance of a place from the centre, radii squared.
    #[inline(always)]
    fn radius2(&self, x: f32, y: f32) -> f32 {
        let [a, b, c] = self.inverse;
        let (wx, wy) = (a * x + b * y, b * x + c * y);
        wx * wx + wy * wy
    }
}

/// Deep inside, the blur adds to the limb darkening half its variance times how much that bends.
#[multiversion(targets("x86_64+avx2"))]
fn fill_deep(disc: &DiscLight, [x, y]: [f32; 2], light: &mut [f32]) {
    let profile = &disc.profile;
    let (even_dn, darkened_dn) = (profile.even_dn as f32, profile.darkened_dn as f32);
    let half_variance = (0.5 * (profile.blur_px / profile.radius_px).powi(2)) as f32;
    for (n, light) in light.iter_mut().enumerate() {
        let root = (1.0 - disc.radius2(x + n as i32 as f32, y)).sqrt();
        let per_root = 1.0 / root;
        let bend = per_root + per_root * per_root * per_root;
        *light = even_dn + darkened_dn * (root - half_variance * bend);
    }
}

/// Near the limb, the light is the [`Profile`]'s.
#[multiversion(targets("x86_64+avx2"))]
fn fill_near_limb(disc: &DiscLight, [x, y]: [f32; 2], light: &mut [f32]) {
    for (n, light) in light.iter_mut().enumerate() {
        let (_, out) = outwards(disc.inverse, x + n as i32 as f32, y);
        (*light, _) = disc.profile.light(out);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix2, Vector2};

    #[test]
    fn rows_hold_the_profile_s_light() {
        let root = Matrix2::new(95.3, 0.2, 0.2, 94.8);
        let outline = Ellipse::new(Vector2::new(300.2, 250.7), root).unwrap();
        let profile = Profile {
            background_dn: 4.0,
            even_dn: 90.0,
            darkened_dn: 115.0,
            blur_px: 0.945,
            radius_px: 95.05,
        };
        let light = DiscLight::new(&outline, &profile);
        for y in [160.0, 200.0, 250.0, 251.0, 330.0] {
            let mut row = [0.0; 220];
            light.fill(190.0, y, &mut row);
            for (n, found) in row.iter().enumerate() {
                let at = Vector2::new(190.0 + n as f64, y);
                let expected = profile.at(outline.excess(at)) - 4.0;
                assert!(
                    (f64::from(*found) - expected).abs() < 0.2,
                    "{at} {found} {expected}"
                );
            }
        }
    }
}
