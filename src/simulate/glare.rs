//! The unfiltered Sun in a picture, or beside it: its disc, glow and rays, and the lens flares on the line through the picture's middle.

use super::Generator;
use crate::units::SensorPx;
use nalgebra::Vector2;
use rand::RngExt;

/// Angular radius of the Sun, rad.
pub(super) const SUN_RAD: f64 = 0.00465;
/// Brightness of the disc: any sensor saturates.
const SUN_DN: f64 = 5000.0;
/// Light of the glow, one radius from the disc.
const GLOW_DN: f64 = 120.0;
/// Width and reach of a ray, px.
const RAY_PX: f64 = 4.0;
const RAY_REACH_PX: f64 = 200.0;
const RAYS: u32 = 6;

/// A reflection within the lens.
struct Flare {
    at: SensorPx,
    radius_px: f64,
    light_dn: f64,
    /// Only its rim is bright.
    is_ring: bool,
}

pub(super) struct Glare {
    sun: SensorPx,
    radius_px: f64,
    turn_rad: f64,
    flares: Vec<Flare>,
}

impl Glare {
    /// The glare of a Sun in the picture or beside it, with `flares` flares on the line through the picture's middle.
    pub fn new(
        sun: SensorPx,
        radius_px: f64,
        middle: Vector2<f64>,
        flares: usize,
        random: &mut Generator,
    ) -> Self {
        let flare = |_| Flare {
            at: (middle + (sun.vector() - middle) * random.random_range(-1.2..0.8)).into(),
            radius_px: random.random_range(20.0..120.0),
            light_dn: random.random_range(15.0..90.0),
            is_ring: random.random_bool(0.5),
        };
        Self {
            sun,
            radius_px,
            flares: (0..flares).map(flare).collect(),
            turn_rad: random.random_range(0.0..1.0),
        }
    }

    /// Adds its light to a picture's, row by row.
    pub fn add(&self, width_px: usize, light: &mut [f32]) {
        for (n, dn) in light.iter_mut().enumerate() {
            let at = SensorPx::new((n % width_px) as f64, (n / width_px) as f64);
            let flares: f64 = self.flares.iter().map(|flare| flare.at(at)).sum();
            *dn += (self.of_sun(at) + flares) as f32;
        }
    }

    fn of_sun(&self, at: SensorPx) -> f64 {
        let away = at.vector() - self.sun.vector();
        let radii = away.norm() / self.radius_px;
        if radii < 1.0 {
            return SUN_DN;
        }
        let around = away.y.atan2(away.x) + self.turn_rad;
        let step = std::f64::consts::TAU / f64::from(RAYS);
        let off = (around / step - (around / step).round()) * step;
        let across = off.sin() * away.norm() / RAY_PX;
        let ray = (-across * across - away.norm() / RAY_REACH_PX).exp();
        GLOW_DN * (ray + 3.0 / radii.powf(1.3)) / 2.0
    }
}

impl Flare {
    fn at(&self, at: SensorPx) -> f64 {
        const SOFT_PX: f64 = 4.0;
        let depth = (self.radius_px - at.distance(self.at)) / SOFT_PX;
        match self.is_ring {
            // Here a ring's Gaussian is negligible.
            true if depth.abs() > 5.0 => 0.0,
            true => self.light_dn * (-0.5 * depth * depth).exp(),
            false => self.light_dn * (0.5 + depth / 2.0).clamp(0.0, 1.0),
        }
    }
}
