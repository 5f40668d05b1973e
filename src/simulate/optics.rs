//! Stray light and readout: coma, a ghost, gradients, smear along the columns, a step between the sensor's halves.
//!
//! Coma and ghost are images of the plate beside the sharp one: the same plate under a mapping that is shifted and with more blur, so that light
//! from beyond the sensor's edge reaches the sensor as in a camera. The other effects are added to the pixels.

use super::scene::{Coma, Extent, Ghost, Gradient, Readout, Scene, StrayLight};
use super::{Purpose, generator};
use crate::geometry::{Distortion, Mapping, unit};
use crate::units::SensorPx;
use nalgebra::{Matrix3, Vector2};
use rand::RngExt;
use std::borrow::Cow;
use std::f64::consts::TAU;

/// Amounts of stray light. Its directions are drawn at random.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Strengths {
    /// Rise of additive light across the sensor; see [`Extent::Sensor`].
    pub gradient_dn: f64,
    /// Rise of additive light across the disc; see [`Extent::Disc`].
    pub disc_gradient_dn: f64,
    /// Light of the ghost relative to that of the Sun.
    pub ghost: f64,
    /// Fraction of the light that coma displaces.
    pub coma: f64,
}

/// Shift of the ghost, in solar radii.
const GHOST_OFFSET_RADII: std::ops::Range<f64> = 0.5..1.4;
/// Blur of the ghost, 1 sigma, px.
const GHOST_BLUR_PX: std::ops::Range<f64> = 3.0..8.0;
/// Displacement by coma, px.
const COMA_OFFSET_PX: f64 = 1.5;
/// Blur of the displaced light, 1 sigma, px.
const COMA_BLUR_PX: f64 = 2.5;

impl StrayLight {
    /// Stray light drawn at random for a Sun of `radius_px`.
    pub(super) fn random(strengths: &Strengths, radius_px: f64, seed: u64) -> Self {
        let mut rng = generator(seed, Purpose::Optics, 0);
        // Everything is drawn whether it is used or not, so that one more effect changes no other.
        let [sensor, disc, ghost, coma]: [f64; 4] =
            std::array::from_fn(|_| rng.random_range(0.0..TAU));
        let ghost_radii = rng.random_range(GHOST_OFFSET_RADII);
        let ghost_blur_px = rng.random_range(GHOST_BLUR_PX);
        let gradients = [
            (strengths.gradient_dn, sensor, Extent::Sensor),
            (strengths.disc_gradient_dn, disc, Extent::Disc),
        ];
        let gradients = gradients.into_iter().filter(|(dn, ..)| *dn > 0.0);
        Self {
            gradients: gradients
                .map(|(rise_dn, direction_rad, across)| Gradient {
                    rise_dn,
                    direction_rad,
                    across,
                })
                .collect(),
            ghost: (strengths.ghost > 0.0).then(|| Ghost {
                share: strengths.ghost,
                offset_px: unit(ghost) * ghost_radii * radius_px,
                blur_px: ghost_blur_px,
            }),
            coma: (strengths.coma > 0.0).then(|| Coma {
                share: strengths.coma,
                offset_px: unit(coma) * COMA_OFFSET_PX,
                blur_px: COMA_BLUR_PX,
            }),
        }
    }

    /// Adds the gradients to the light on the sensor.
    pub(super) fn add_gradients(&self, scene: &Scene, light: &mut [f32]) {
        for gradient in &self.gradients {
            let Some((at, there_dn, slope)) = gradient.plane(scene) else {
                continue;
            };
            for (y, row) in light.chunks_exact_mut(scene.width_px).enumerate() {
                let start_dn = there_dn + slope.y * (y as f64 - at.y) - slope.x * at.x;
                for (x, l) in row.iter_mut().enumerate() {
                    *l += (start_dn + slope.x * x as f64).max(0.0) as f32;
                }
            }
        }
    }
}

impl Gradient {
    /// A place, the light there in DN, and its slope in DN/px; `None` if the place is not determined.
    fn plane(&self, scene: &Scene) -> Option<(SensorPx, f64, Vector2<f64>)> {
        let direction = unit(self.direction_rad);
        match self.across {
            Extent::Sensor => {
                let last = |pixels: usize| pixels as f64 - 1.0;
                let (width, height) = (last(scene.width_px), last(scene.height_px));
                let reach = width * direction.x.abs() + height * direction.y.abs();
                let dark = |along: f64, far: f64| if along < 0.0 { far } else { 0.0 };
                let corner = SensorPx::new(dark(direction.x, width), dark(direction.y, height));
                Some((corner, 0.0, direction * (self.rise_dn / reach.max(1.0))))
            }
            Extent::Disc => {
                let sun = scene.truth_of(scene.sun.as_ref()?);
                let slope = direction * (self.rise_dn / (2.0 * sun.radius_px));
                Some((sun.px, self.rise_dn, slope))
            }
        }
    }
}

impl Readout {
    /// Adds the effects of the readout to the light: smear along the columns, the background, the step between the halves.
    pub(super) fn add(&self, scene: &Scene, light: &mut [f32]) {
        let (background, step) = (scene.background_dn as f32, self.tap_step_dn as f32);
        let mut level = vec![background; scene.width_px];
        level[scene.width_px.div_ceil(2)..]
            .iter_mut()
            .for_each(|dn| *dn += step);
        if self.column_smear > 0.0 {
            let mut totals = vec![0.0_f64; scene.width_px];
            for row in light.chunks_exact(scene.width_px) {
                for (total, l) in totals.iter_mut().zip(row) {
                    *total += f64::from(*l);
                }
            }
            for (dn, total) in level.iter_mut().zip(totals) {
                *dn += (self.column_smear * total) as f32;
            }
        }
        for row in light.chunks_exact_mut(scene.width_px) {
            for (l, dn) in row.iter_mut().zip(&level) {
                *l += dn;
            }
        }
    }
}

/// One of the images of the plate whose light adds up on the sensor.
pub(super) struct Image<'a> {
    /// Its light relative to that of the scene.
    pub share: f32,
    /// The scene under the image's mapping and blur.
    pub scene: Cow<'a, Scene>,
}

/// The images of a scene: the sharp one, coma's and the ghost's.
pub(super) fn images(scene: &Scene) -> Vec<Image<'_>> {
    let stray = &scene.stray;
    let moved = |share: f64, offset_px: Vector2<f64>, blur_px: f64| {
        Some(Image {
            share: share as f32,
            scene: Cow::Owned(Scene {
                mapping: shifted(&scene.mapping, offset_px)?,
                blur_px: scene.blur_px.hypot(blur_px),
                ..scene.clone()
            }),
        })
    };
    let whole = Image {
        share: 1.0,
        scene: Cow::Borrowed(scene),
    };
    let sharp = match &stray.coma {
        None => [Some(whole), None],
        Some(Coma {
            share,
            offset_px,
            blur_px,
        }) => [
            moved(1.0 - share, -offset_px * *share, 0.0),
            moved(*share, offset_px * (1.0 - share), *blur_px),
        ],
    };
    let ghost = stray
        .ghost
        .and_then(|ghost| moved(ghost.share, ghost.offset_px, ghost.blur_px));
    sharp.into_iter().flatten().chain(ghost).collect()
}

/// A mapping whose picture is shifted on the sensor. It is never `None` for an invertible mapping.
fn shifted(mapping: &Mapping, by_px: Vector2<f64>) -> Option<Mapping> {
    let lens = mapping.distortion();
    let lens = Distortion {
        centre: (lens.centre.vector() + by_px).into(),
        ..*lens
    };
    let back = Matrix3::new_translation(&-by_px);
    Mapping::new(mapping.kind(), mapping.matrix() * back, lens)
}
