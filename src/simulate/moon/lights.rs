//! Lights that are not the Moon: stars, planets, a street lamp.

use super::MoonScene;
use crate::simulate::{Purpose, generator};
use nalgebra::{Rotation2, Vector2};
use rand::RngExt;
use std::f64::consts::PI;

/// Peak light of the brightest star, and of planets.
const STAR_DN: f64 = 150.0;
const PLANET_DN: std::ops::Range<f64> = 200.0..3000.0;

/// Adds a scene's stars and planets to a picture's light, row by row.
pub(super) fn add_points(scene: &MoonScene, light: &mut [f32]) {
    let conditions = &scene.conditions;
    let (width, height) = (conditions.width_px, conditions.height_px);
    let mut random = generator(scene.seed, Purpose::Stars, scene.number);
    for n in 0..conditions.stars + conditions.planets {
        let at = Vector2::new(
            random.random_range(0.0..width as f64),
            random.random_range(0.0..height as f64),
        );
        let peak_dn = match n < conditions.stars {
            true => STAR_DN * random.random::<f64>().powi(3),
            false => random.random_range(PLANET_DN),
        };
        let near = |centre: f64, pixels: usize| {
            let first = (centre - 5.0).max(0.0) as usize;
            first..((centre + 6.0) as usize).min(pixels)
        };
        for y in near(at.y, height) {
            for x in near(at.x, width) {
                let away = Vector2::new(x as f64, y as f64) - at;
                let part = (-0.5 * away.norm_squared() / conditions.blur_px.powi(2)).exp();
                light[y * width + x] += (peak_dn * part) as f32;
            }
        }
    }
}

/// A uniform, approximately round light with a glow, on a pole.
pub(super) struct Lamp {
    at: Vector2<f64>,
    /// Half axes, px.
    half: Vector2<f64>,
    turn: Rotation2<f64>,
    light_dn: f64,
    /// Glow at the rim, relative to the light; it decreases over a fraction of the lamp's size.
    glow: f64,
    pole_dn: f64,
}

impl Lamp {
    /// A lamp at the place of a scene's Moon.
    pub fn of(scene: &MoonScene) -> Self {
        let conditions = &scene.conditions;
        let mut random = generator(scene.seed, Purpose::Lamp, scene.number);
        let ratio = random.random_range(1.0..1.6_f64);
        let size = match random.random() {
            true => random.random_range(0.35..0.8),
            false => random.random_range(1.3..2.7),
        };
        // Saturated with glare, of another size, or oval: a round lamp of the Moon's size with a visible rim would be a full Moon.
        let (ratio, size, light_dn, glow) = match random.random_range(0..3) {
            0 => (ratio, 1.0, random.random_range(500.0..2000.0), 0.4),
            1 => (ratio, size, random.random_range(80.0..400.0), 0.1),
            _ => (
                ratio.max(1.25),
                random.random_range(0.9..1.1),
                random.random_range(80.0..400.0),
                0.1,
            ),
        };
        let radius_px = size * conditions.radius_px;
        Self {
            at: scene.centre.vector(),
            half: Vector2::new(radius_px / ratio.sqrt(), radius_px * ratio.sqrt()),
            turn: Rotation2::new(random.random_range(0.0..PI)),
            light_dn,
            glow,
            pole_dn: random.random_range(0.0..40.0),
        }
    }

    /// Adds its light to a picture's, row by row.
    pub fn add(&self, width_px: usize, light: &mut [f32]) {
        /// Half the pole's width, px; and the distance, in half axes, over which the glow falls to 1/e.
        const POLE_PX: f64 = 3.0;
        const GLOW_REACH: f64 = 0.5;
        let mean_px = self.half.sum() / 2.0;
        for (n, dn) in light.iter_mut().enumerate() {
            let place = Vector2::new((n % width_px) as f64, (n / width_px) as f64);
            let away = place - self.at;
            let radii = (self.turn * away).component_div(&self.half).norm();
            // The edge is one pixel wide.
            let within = (0.5 + (1.0 - radii) * mean_px).clamp(0.0, 1.0);
            let glow = self.glow * ((1.0 - radii) / GLOW_REACH).min(0.0).exp();
            let pole_dn = match away.x.abs() < POLE_PX && away.y > 0.0 {
                true => self.pole_dn,
                false => 0.0,
            };
            let beside = (self.light_dn * glow).max(pole_dn);
            *dn += (within * self.light_dn + (1.0 - within) * beside) as f32;
        }
    }
}
