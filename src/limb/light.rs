//! The disc's light by rows of pixels, as marks' fits ask for it.

use super::Profile;
use crate::geometry::Ellipse;
use multiversion::multiversion;
use nalgebra::Vector2;

/// The disc's blurred light without marks.
#[derive(Debug, Clone, PartialEq)]
pub struct DiscLight {
    ellipse: Ellipse,
    profile: Profile,
}

impl DiscLight {
    pub(super) fn new(ellipse: &Ellipse, profile: &Profile) -> Self {
        Self {
            ellipse: *ellipse,
            profile: *profile,
        }
    }

    /// The light on a row's pixels from column `x` on, DN above the background.
    pub fn fill(&self, x: f64, y: f64, light: &mut [f32]) {
        fill(self, Vector2::new(x, y) - self.ellipse.centre, light);
    }
}

#[multiversion(targets("x86_64+avx2"))]
fn fill(disc: &DiscLight, from: Vector2<f64>, light: &mut [f32]) {
    let inverse = disc.ellipse.inverse();
    let [a, b, c] = [inverse.m11, inverse.m12, inverse.m22].map(|v| v as f32);
    let (x, y) = (from.x as f32, from.y as f32);
    for (n, light) in light.iter_mut().enumerate() {
        let x = x + n as i32 as f32;
        let (u, v) = (a * x + b * y, b * x + c * y);
        let r2 = u * u + v * v;
        let (nx, ny) = (a * u + b * v, b * u + c * v);
        // The distance outwards to first order, as Ellipse::excess gives it; the very centre has no direction.
        let per_disc = (nx * nx + ny * ny + f32::MIN_POSITIVE).sqrt();
        (*light, _) = disc.profile.light((r2 - r2.sqrt()) / per_disc);
    }
}
