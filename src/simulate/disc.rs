//! The Sun's disc, sub-sample by sub-sample: limb darkening, surface, spots, motion.

use super::cover::Cover;
use super::coverage::{Edge, Footprint};
use super::grid::Grid;
use super::scene::{Sun, Sunspot};
use super::surface::Texture;
use nalgebra::Vector2;
use std::ops::Range;

/// The Sun at one moment of the exposure, in the grid's coordinates.
pub(super) struct Disc {
    centre: Vector2<f32>,
    radius: f32,
    peak: f32,
    darkening: f32,
    texture: Option<Texture>,
    spots: Vec<(Vector2<f32>, f32, f32)>,
    covers: Vec<Cover>,
    footprint: Footprint,
}

/// The Sun at as many moments as its smear needs, at most one sub-sample apart; the exposure's light is divided
/// among them.
pub(super) fn exposures(sun: &Sun, grid: &Grid) -> Vec<Disc> {
    let step_mil = grid.footprint.column.norm();
    let moments = (sun.smear_mil.norm() / step_mil).ceil().max(1.0);
    let at = |k: f64| (sun.smear_mil * ((k + 0.5) / moments - 0.5)).cast::<f32>();
    let spot = |centre: Vector2<f32>, s: &Sunspot| {
        let place = centre + s.offset_mil.cast::<f32>();
        (place, s.radius_mil as f32, s.contrast as f32)
    };
    (0..moments as usize)
        .map(|k| {
            let centre = at(k as f64);
            Disc {
                centre,
                radius: sun.radius_mil as f32,
                peak: (sun.peak_dn / moments) as f32,
                darkening: sun.limb_darkening as f32,
                texture: Texture::of(&sun.surface),
                spots: sun.spots.iter().map(|s| spot(centre, s)).collect(),
                covers: sun.covers.clone(),
                footprint: grid.footprint,
            }
        })
        .collect()
}

impl Disc {
    /// The disc's light at each position of a row.
    pub(super) fn shine(&self, xs: &[f32], ys: &[f32], light: &mut [f32]) {
        let (plain, darkened) = (1.0 - self.darkening, self.darkening);
        let inverse = 1.0 / (self.radius * self.radius);
        for ((light, x), y) in light.iter_mut().zip(xs).zip(ys) {
            let (dx, dy) = (x - self.centre.x, y - self.centre.y);
            let cosine2 = 1.0 - (dx * dx + dy * dy) * inverse;
            let shade = self.peak * (plain + darkened * cosine2.max(0.0).sqrt());
            *light = if cosine2 > 0.0 { shade } else { 0.0 };
        }
        self.round_off(xs, ys, light);
        if let Some(texture) = &self.texture {
            for ((light, x), y) in light.iter_mut().zip(xs).zip(ys) {
                if *light > 0.0 {
                    let from_centre = Vector2::new(x - self.centre.x, y - self.centre.y);
                    *light *= texture.at(from_centre / self.radius);
                }
            }
        }
        for &(place, radius, contrast) in &self.spots {
            self.darken(xs, ys, light, place, radius, contrast);
        }
        for cover in &self.covers {
            match cover {
                Cover::Disc {
                    offset_mil,
                    radius_mil,
                } => {
                    let place = self.centre + offset_mil.cast::<f32>();
                    self.darken(xs, ys, light, place, *radius_mil as f32, 1.0);
                }
                Cover::Shadow { .. } => {
                    for ((light, x), y) in light.iter_mut().zip(xs).zip(ys) {
                        if *light > 0.0 {
                            let from_centre = Vector2::new(x - self.centre.x, y - self.centre.y);
                            *light *= cover.left(from_centre.cast()) as f32;
                        }
                    }
                }
            }
        }
    }

    /// Removes a fraction of the light within a circle.
    fn darken(
        &self,
        xs: &[f32],
        ys: &[f32],
        light: &mut [f32],
        place: Vector2<f32>,
        radius: f32,
        contrast: f32,
    ) {
        let reach = radius + self.footprint.reach() as f32;
        near_circle(xs, ys, place, 0.0..reach, |n, from_centre, r| {
            let edge = self.edge(from_centre, r);
            let share = edge.coverage(f64::from(radius) - r);
            light[n] *= 1.0 - contrast * share as f32;
        });
    }

    /// At the limb, where the light varies as the square root of the depth and ends, uses the mean over each sub-sample.
    fn round_off(&self, xs: &[f32], ys: &[f32], light: &mut [f32]) {
        let (plain, darkened) = (1.0 - self.darkening, f64::from(self.darkening));
        let radius = f64::from(self.radius);
        let band = 1.2 * self.footprint.reach() as f32;
        let rim = self.radius - band..self.radius + band;
        near_circle(xs, ys, self.centre, rim, |n, from_centre, r| {
            let (edge, inside) = (self.edge(from_centre, r), radius - r);
            // cos theta = sqrt(2 depth / R) x sqrt(1 - depth / 2 R), the second square root nearly 1 here.
            let slope = (2.0 / radius * (1.0 - inside.max(0.0) / (2.0 * radius))).sqrt();
            let cosine = slope * edge.mean_root(inside);
            let share = f64::from(plain) * edge.coverage(inside) + darkened * cosine;
            light[n] = self.peak * share as f32;
        });
    }

    fn edge(&self, from_centre: Vector2<f32>, r: f64) -> Edge {
        self.footprint.edge(from_centre.cast::<f64>() / r.max(1e-9))
    }
}

/// Calls `visit` with number, offset and distance for those positions of a row whose distance from a centre is within a range.
fn near_circle(
    xs: &[f32],
    ys: &[f32],
    centre: Vector2<f32>,
    distances: Range<f32>,
    mut visit: impl FnMut(usize, Vector2<f32>, f64),
) {
    /// Number of positions that are skipped together if all are too near or too far.
    const STRETCH: usize = 24;
    let offset = |n: usize| Vector2::new(xs[n] - centre.x, ys[n] - centre.y);
    for start in (0..xs.len()).step_by(STRETCH) {
        let end = (start + STRETCH).min(xs.len());
        let r = offset(start).norm();
        let length = (offset(end - 1) - offset(start)).norm();
        if r + length < distances.start || r - length > distances.end {
            continue;
        }
        for n in start..end {
            let r = offset(n).cast::<f64>().norm();
            if distances.contains(&(r as f32)) {
                visit(n, offset(n), r);
            }
        }
    }
}
