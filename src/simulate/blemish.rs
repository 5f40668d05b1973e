//! Blemishes of a picture: scratches on the plate, light that passes the baffles, dust and hot pixels of the camera.

use super::scene::{Blemishes, Depth, Dust, HotPixel, Leak, Scene, Scratch};
use super::{Purpose, generator};
use crate::frame::Pixels;
use crate::geometry::unit;
use crate::units::{PlateMil, SensorPx};
use rand::RngExt;
use std::f64::consts::{PI, TAU};

/// Numbers of blemishes to draw at random.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Counts {
    /// Number on the whole sensor.
    pub hot_pixels: usize,
    /// Number that cross the Sun's disc, on average over its places.
    pub scratches_per_disc: f64,
    pub leaks: usize,
    /// Number in front of the Sun's disc, on average over its places.
    pub dust_per_disc: f64,
    /// See [`Blemishes::vignetting`].
    pub vignetting: f64,
}

impl Blemishes {
    /// Blemishes drawn at random for the sensor and mapping of a scene and a Sun of `radius_mil`.
    pub fn random(counts: &Counts, scene: &Scene, radius_mil: f64, seed: u64) -> Self {
        let drawn = Draw { scene, seed };
        Self {
            hot_pixels: drawn.hot_pixels(counts.hot_pixels),
            scratches: drawn.scratches(counts.scratches_per_disc, radius_mil),
            leaks: drawn.leaks(counts.leaks),
            dust: drawn.dust(counts.dust_per_disc, radius_mil),
            vignetting: counts.vignetting,
        }
    }

    /// Applies the blemishes to the light on the sensor: leaks add light, vignetting and dust remove it.
    pub(super) fn shade(&self, scene: &Scene, light: &mut [f32]) {
        for leak in &self.leaks {
            let at = scene.mapping.to_sensor(leak.centre);
            let peak = leak.peak_dn as f32;
            spot(scene, at, leak.sigma_px, light, |l, shape| {
                *l += peak * shape
            });
        }
        if self.vignetting > 0.0 {
            self.vignette(scene, light);
        }
        for dust in &self.dust {
            let depth = dust.depth as f32;
            spot(scene, dust.centre, dust.sigma_px, light, |l, shape| {
                *l *= 1.0 - depth * shape
            });
        }
    }

    fn vignette(&self, scene: &Scene, light: &mut [f32]) {
        let middle_x = (scene.width_px as f32 - 1.0) / 2.0;
        let middle_y = (scene.height_px as f32 - 1.0) / 2.0;
        let loss = self.vignetting as f32 / (middle_x * middle_x + middle_y * middle_y);
        for (y, row) in light.chunks_exact_mut(scene.width_px).enumerate() {
            let dy2 = (y as f32 - middle_y).powi(2);
            for (x, l) in row.iter_mut().enumerate() {
                let dx = x as f32 - middle_x;
                *l *= 1.0 - loss * (dx * dx + dy2);
            }
        }
    }

    /// Saturates the hot pixels of a digitised picture.
    pub(super) fn saturate(&self, width: usize, pixels: &mut Pixels, depth: Depth) {
        for hot in self.hot_pixels.iter().filter(|hot| hot.x < width) {
            let index = hot.y * width + hot.x;
            match pixels {
                Pixels::U8(values) => values.get_mut(index).map(|v| *v = u8::MAX),
                Pixels::U16(values) => values.get_mut(index).map(|v| *v = depth.saturation_dn()),
            };
        }
    }
}

/// Applies a round Gaussian, 1 at its middle, to the pixels within 5 sigma of a place.
fn spot(
    scene: &Scene,
    at: SensorPx,
    sigma_px: f64,
    light: &mut [f32],
    apply: impl Fn(&mut f32, f32),
) {
    const REACH_SIGMA: f64 = 5.0;
    let reach = REACH_SIGMA * sigma_px;
    let span = |middle: f64, pixels: usize| {
        let first = (middle - reach).ceil().clamp(0.0, pixels as f64) as usize;
        let end = ((middle + reach).floor() + 1.0).clamp(0.0, pixels as f64) as usize;
        first..end.max(first)
    };
    for y in span(at.y, scene.height_px) {
        for x in span(at.x, scene.width_px) {
            let r2 = (x as f64 - at.x).powi(2) + (y as f64 - at.y).powi(2);
            let shape = (-0.5 * r2 / sigma_px.powi(2)).exp() as f32;
            apply(&mut light[y * scene.width_px + x], shape);
        }
    }
}

/// Draws blemishes for a scene.
struct Draw<'a> {
    scene: &'a Scene,
    seed: u64,
}

impl Draw<'_> {
    fn generator(&self, kind: u64) -> super::Generator {
        generator(self.seed, Purpose::Blemishes, kind)
    }

    fn hot_pixels(&self, count: usize) -> Vec<HotPixel> {
        let mut rng = self.generator(0);
        let pixel = |_| HotPixel {
            x: rng.random_range(0..self.scene.width_px),
            y: rng.random_range(0..self.scene.height_px),
        };
        (0..count).map(pixel).collect()
    }

    /// A random place on the sensor.
    fn place(&self, rng: &mut super::Generator) -> SensorPx {
        SensorPx::new(
            rng.random_range(-0.5..self.scene.width_px as f64 - 0.5),
            rng.random_range(-0.5..self.scene.height_px as f64 - 0.5),
        )
    }

    /// Area of the plate that the camera sees, mil^2.
    fn seen_area_mil2(&self) -> f64 {
        let (width, height) = (self.scene.width_px as f64, self.scene.height_px as f64);
        let scale = self
            .scene
            .mapping
            .scale_mil_per_px(SensorPx::new(width / 2.0, height / 2.0));
        width * height * scale * scale
    }

    /// Scratches one or two pixels wide; their number is such that `per_disc` of them cross the disc on average.
    fn scratches(&self, per_disc: f64, radius_mil: f64) -> Vec<Scratch> {
        const MEAN_LENGTH_MIL: f64 = 1000.0;
        // A scratch of length l crosses the discs whose centres lie within the radius of it.
        let crossed = 2.0 * radius_mil * MEAN_LENGTH_MIL + PI * radius_mil.powi(2);
        let count = (per_disc * self.seen_area_mil2() / crossed).round() as usize;
        let mut rng = self.generator(1);
        let scratch = |_| {
            let middle = self.scene.mapping.to_plate(self.place(&mut rng)).vector();
            let angle = rng.random_range(0.0..TAU);
            let half = MEAN_LENGTH_MIL / 2.0 * rng.random_range(0.3..1.7);
            let run = unit(angle) * half;
            Scratch {
                start: (middle - run).into(),
                end: (middle + run).into(),
                width_mil: rng.random_range(6.0..12.0),
                brightness: rng.random_range(1.1..1.6),
            }
        };
        (0..count).map(scratch).collect()
    }

    /// Leaks on a ring around the plate's centre, at its edge.
    fn leaks(&self, count: usize) -> Vec<Leak> {
        let mut rng = self.generator(2);
        let leak = |_| {
            let angle = rng.random_range(0.0..TAU);
            let radius = rng.random_range(2600.0..2800.0);
            Leak {
                centre: PlateMil::new(radius * angle.cos(), radius * angle.sin()),
                sigma_px: rng.random_range(3.0..7.0),
                peak_dn: rng.random_range(15.0..50.0),
            }
        };
        (0..count).map(leak).collect()
    }

    fn dust(&self, per_disc: f64, radius_mil: f64) -> Vec<Dust> {
        let covered = PI * radius_mil.powi(2);
        let count = (per_disc * self.seen_area_mil2() / covered).round() as usize;
        let mut rng = self.generator(3);
        let speck = |_| Dust {
            centre: self.place(&mut rng),
            sigma_px: rng.random_range(1.5..5.0),
            depth: rng.random_range(0.1..0.4),
        };
        (0..count).map(speck).collect()
    }
}
