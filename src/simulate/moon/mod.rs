//! Pictures of the Moon at any phase, a shaded sphere with or without craters, and of other objects; with the truth about them.
//!
//! Lengths on the disc are in units of its radius: x to the right, y down, z to the observer.

mod followed;
mod lights;
mod night;
mod surface;

pub use followed::FollowedMoon;

use super::blur::Kernel;
use super::coverage::Footprint;
use super::glare::Glare;
use super::noise::{Readings, read_out};
use super::scene::{Depth, Noise};
use super::{Purpose, derived_seed, frame_info, generator};
use crate::frame::{Frame, FrameError};
use crate::moon::{Shading, Sphere, towards_sun};
use crate::units::SensorPx;
use lights::{Lamp, add_points};
use nalgebra::{Vector2, Vector3};
use night::Clouds;
use rand::RngExt;
use std::ops::Range;
use surface::Surface;

/// The number of sub-samples in each axis is this divided by the disc's radius in px, within the range below.
const SUBSAMPLED_PX: f64 = 120.0;
const SUBSAMPLES: Range<usize> = 2..9;

/// Object in a picture.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Shown {
    Moon,
    /// Only the sky.
    Nothing,
    /// A street lamp, which differs from the Moon in size, in roundness, or by its glow.
    Lamp,
    /// The unfiltered Sun, about as large as the Moon.
    Sun,
    /// Clouds, and the glow or the corona of a Moon that they hide.
    Clouds,
}

/// Shared settings of pictures of the Moon.
#[derive(Debug, Clone, PartialEq)]
pub struct MoonConditions {
    pub width_px: usize,
    pub height_px: usize,
    /// Ratio of the disc's horizontal half axis to its vertical one.
    pub pixel_aspect: f64,
    pub shown: Shown,
    /// Vertical half axis.
    pub radius_px: f64,
    /// Range of the lit fraction of the disc, from which each picture draws its own.
    pub lit: Range<f64>,
    pub shading: Shading,
    pub craters: bool,
    /// Large plains with half the brightness of other ground.
    pub seas: bool,
    /// Light of the brightest place above the background.
    pub peak_dn: f64,
    pub background_dn: f64,
    pub noise: Noise,
    pub blur_px: f64,
    /// Light of the dark side, relative to the brightest place.
    pub earthshine: f64,
    pub stars: usize,
    /// Number of points brighter than any star.
    pub planets: usize,
    /// Light that the lens spreads around the Moon, one radius from its limb, relative to the brightest place.
    pub glow: f64,
    /// Whether the Sun shines into the lens from beside the picture.
    pub sun_glare: bool,
    /// Whether the picture's edge cuts the disc.
    pub cut: bool,
    pub depth: Depth,
}

impl MoonConditions {
    /// A camera of 720 x 578 px; noise of 5 DN, a Moon of 200 DN, no craters, a lit fraction from 0.1 to 1.
    pub fn clear(radius_px: f64) -> Self {
        Self {
            width_px: 720,
            height_px: 578,
            pixel_aspect: 1.0,
            shown: Shown::Moon,
            radius_px,
            lit: 0.1..1.0,
            shading: Shading::LommelSeeliger,
            craters: false,
            seas: false,
            peak_dn: 200.0,
            background_dn: 10.0,
            noise: Noise {
                read_dn: 5.0,
                electrons_per_dn: None,
            },
            blur_px: 0.8,
            earthshine: 0.0,
            stars: 0,
            planets: 0,
            glow: 0.0,
            sun_glare: false,
            cut: false,
            depth: Depth::Eight,
        }
    }

    /// The scene for a seed and a number, with the disc's place, lit fraction and rotation drawn. The whole disc is in view, or its centre is within
    /// half a radius of one of the picture's edges.
    pub fn scene(&self, seed: u64, number: u64) -> MoonScene {
        let mut random = generator(seed, Purpose::Moon, number);
        let half = Vector2::new(self.radius_px * self.pixel_aspect, self.radius_px);
        let mut place = |pixels: usize, half: f64| {
            let margin = half + 4.0 * self.blur_px + 2.0;
            random.random_range(margin..pixels as f64 - margin)
        };
        let whole = SensorPx::new(place(self.width_px, half.x), place(self.height_px, half.y));
        let centre = match self.cut {
            false => whole,
            true => {
                let inside = random.random_range(-0.2..0.5);
                let last = |pixels: usize| pixels as f64 - 1.0;
                match random.random_range(0..4) {
                    0 => SensorPx::new(inside * half.x, whole.y),
                    1 => SensorPx::new(last(self.width_px) - inside * half.x, whole.y),
                    2 => SensorPx::new(whole.x, inside * half.y),
                    _ => SensorPx::new(whole.x, last(self.height_px) - inside * half.y),
                }
            }
        };
        let lit = match self.lit.is_empty() {
            true => self.lit.start,
            false => random.random_range(self.lit.clone()),
        };
        MoonScene {
            conditions: self.clone(),
            centre,
            phase_angle_deg: (2.0 * lit - 1.0).acos().to_degrees(),
            bright_limb_deg: random.random_range(0.0..360.0),
            turn_deg: random.random_range(0.0..360.0),
            seed,
            number,
        }
    }
}

/// Everything that defines a picture of the Moon.
#[derive(Debug, Clone, PartialEq)]
pub struct MoonScene {
    pub conditions: MoonConditions,
    /// Centre of the whole disc.
    pub centre: SensorPx,
    /// 0 full, 180 new.
    pub phase_angle_deg: f64,
    /// Position angle of the middle of the bright limb, from +x towards +y, on the disc as in the sky: for square pixels.
    pub bright_limb_deg: f64,
    /// Rotation of the surface.
    pub turn_deg: f64,
    pub seed: u64,
    pub number: u64,
}

impl MoonScene {
    /// The lit fraction of the disc.
    pub fn lit(&self) -> f64 {
        (1.0 + self.phase_angle_deg.to_radians().cos()) / 2.0
    }

    /// Position angle of the middle of the bright limb in the picture, from +x towards +y.
    pub fn bright_limb_in_picture_deg(&self) -> f64 {
        let (sin, cos) = self.bright_limb_deg.to_radians().sin_cos();
        sin.atan2(cos * self.conditions.pixel_aspect).to_degrees()
    }

    /// The frame: rendered, with noise, digitised.
    ///
    /// # Errors
    /// If the picture has no pixels.
    pub fn frame(&self) -> Result<Frame, FrameError> {
        let conditions = &self.conditions;
        let readings = Readings {
            width_px: conditions.width_px,
            noise: conditions.noise,
            depth: conditions.depth,
            seed: derived_seed(self.seed, Purpose::Noise, self.number),
        };
        let pixels = read_out(&self.light(), &readings);
        Frame::new(
            conditions.width_px,
            conditions.height_px,
            pixels,
            conditions.depth.saturation_dn(),
            frame_info(self.number),
        )
    }

    /// Light on the sensor in 8-bit DN, row by row: before noise and digitising.
    fn light(&self) -> Vec<f32> {
        let conditions = &self.conditions;
        let (width, height) = (conditions.width_px, conditions.height_px);
        let mut light = vec![conditions.background_dn as f32; width * height];
        add_points(self, &mut light);
        match conditions.shown {
            Shown::Moon => self.add_disc(&mut light),
            Shown::Nothing => {}
            Shown::Lamp => Lamp::of(self).add(width, &mut light),
            Shown::Sun => self.glare(self.centre).add(width, &mut light),
            Shown::Clouds => Clouds::of(self).add(width, &mut light),
        }
        if conditions.glow > 0.0 {
            self.add_glow(&mut light);
        }
        if conditions.sun_glare {
            self.glare(self.sun_beside()).add(width, &mut light);
        }
        light
    }

    /// Adds light that decreases with the square of the distance from the centroid of the disc's light.
    fn add_glow(&self, light: &mut [f32]) {
        let conditions = &self.conditions;
        let sphere = Sphere::new(conditions.shading, self.phase_angle_deg.to_radians());
        let (sin, cos) = self.bright_limb_deg.to_radians().sin_cos();
        let middle = Vector2::new(cos, sin) * sphere.offset_of_light();
        let near_dn = conditions.peak_dn * conditions.glow * 5.0;
        for (n, dn) in light.iter_mut().enumerate() {
            let (x, y) = (n % conditions.width_px, n / conditions.width_px);
            let away = Vector2::new(
                (x as f64 - self.centre.x) / conditions.pixel_aspect,
                y as f64 - self.centre.y,
            ) / conditions.radius_px;
            *dn += (near_dn / (1.0 + (away - middle).norm_squared())) as f32;
        }
    }

    /// The glare of a Sun at a place, with some flares.
    fn glare(&self, sun: SensorPx) -> Glare {
        let conditions = &self.conditions;
        let mut random = generator(self.seed, Purpose::Glare, self.number);
        let radius_px = conditions.radius_px * random.random_range(0.95..1.1);
        let picture = Vector2::new(conditions.width_px as f64, conditions.height_px as f64);
        let flares = random.random_range(0..4);
        Glare::new(sun, radius_px, picture / 2.0, flares, &mut random)
    }

    /// A place beside the picture, 8 to 20 radii of the disc from it.
    fn sun_beside(&self) -> SensorPx {
        let conditions = &self.conditions;
        let mut random = generator(self.seed, Purpose::Sun, self.number);
        let picture = Vector2::new(conditions.width_px as f64, conditions.height_px as f64);
        let away = random.random_range(8.0..20.0) * conditions.radius_px;
        let along = random.random_range(0.0..1.0) * picture;
        match random.random_range(0..4) {
            0 => SensorPx::new(-away, along.y),
            1 => SensorPx::new(picture.x + away, along.y),
            2 => SensorPx::new(along.x, -away),
            _ => SensorPx::new(along.x, picture.y + away),
        }
    }

    fn add_disc(&self, light: &mut [f32]) {
        let conditions = &self.conditions;
        let samples = (SUBSAMPLED_PX / conditions.radius_px).ceil() as usize;
        let samples = samples.clamp(SUBSAMPLES.start, SUBSAMPLES.end - 1);
        let kernel = Kernel::new(conditions.blur_px, samples);
        let margin = kernel.margin_px();
        let half = Vector2::new(
            conditions.radius_px * conditions.pixel_aspect,
            conditions.radius_px,
        );
        // Relief exceeds the sphere by a few thousandths at most.
        let reach = half * 1.02 + Vector2::repeat(margin as f64 + 1.0);
        let span = |centre: f64, reach: f64, pixels: usize| {
            let first = (centre - reach).floor().clamp(0.0, pixels as f64) as usize;
            first..(centre + reach).ceil().clamp(0.0, pixels as f64) as usize
        };
        let columns = span(self.centre.x, reach.x, conditions.width_px);
        let rows = span(self.centre.y, reach.y, conditions.height_px);
        let sides = [&columns, &rows].map(|span| (span.len() + 2 * margin) * samples);
        let surface = Surface::new(conditions, self);
        let step = half.map(|half| 1.0 / (samples as f64 * half));
        let footprint = Footprint {
            column: Vector2::new(step.x, 0.0),
            row: Vector2::new(0.0, step.y),
        };
        let place = |n: usize, first: usize, centre: f64, half: f64| {
            let px = (n as f64 + 0.5) / samples as f64 - 0.5 - margin as f64 + first as f64;
            (px - centre) / half
        };
        let field: Vec<f32> = (0..sides[0] * sides[1])
            .map(|n| {
                let x = place(n % sides[0], columns.start, self.centre.x, half.x);
                let y = place(n / sides[0], rows.start, self.centre.y, half.y);
                (conditions.peak_dn * surface.light(x, y, &footprint)) as f32
            })
            .collect();
        let blurred = kernel.apply(&field, sides[0], columns.len(), rows.len());
        for (row, y) in blurred.chunks_exact(columns.len().max(1)).zip(rows) {
            let pixels = &mut light[y * conditions.width_px..][columns.clone()];
            pixels
                .iter_mut()
                .zip(row)
                .for_each(|(dn, more)| *dn += more);
        }
    }

    /// Direction to the Sun.
    fn sun(&self) -> Vector3<f64> {
        towards_sun(self.phase_angle_deg, self.bright_limb_deg)
    }
}
