//! The pixels of the disc that tell its light without marks: some rows and columns apart, sorted by rings.

use crate::frame::{Region, Sample, View};
use crate::geometry::Ellipse;
use nalgebra::Vector2;

/// Rings that make the profile, equally wide in mu, the cosine of the angle to the Sun's vertical: limb darkening is nearly
/// straight in mu, and towards the limb, where light falls steeply, such rings become narrow by themselves.
pub(super) const RINGS: usize = 16;
/// Only every so many columns and rows make the profile.
const STRIDE_PX: usize = 4;
/// Fewest pixels that make a ring's median.
const MIN_RING_PIXELS: usize = 12;
/// Brighter or darker than this is a mark or a blemish and tells nothing of the light's tilt.
const MOST_TILT: f32 = 0.2;

/// The pixels that make the profile, one list for each quantity, ring by ring.
pub(super) struct Taken {
    /// Position in disc units.
    pub x: Vec<f32>,
    pub y: Vec<f32>,
    /// Above background, DN.
    pub light: Vec<f32>,
    /// The first pixel of every ring, and the one after the last.
    rings: [usize; RINGS + 1],
}

impl Taken {
    /// Pixels of the disc, some rows and columns apart.
    pub(super) fn of<T: Sample>(
        view: &View<'_, T>,
        region: Region,
        outline: &Ellipse,
        background_dn: f32,
    ) -> Self {
        let mut found: Vec<([f32; 3], usize)> = Vec::with_capacity(4096);
        let mut counts = [0; RINGS];
        let inverse = outline.inverse().cast::<f32>();
        for y in (region.y0..region.y1).step_by(STRIDE_PX) {
            let row = &view.pixels[y * view.width..][..view.width];
            // Neighbouring rows look at other columns.
            let x0 = region.x0 + y / STRIDE_PX % STRIDE_PX;
            let dy = (y as f64 - outline.centre.y) as f32;
            for x in (x0..region.x1).step_by(STRIDE_PX) {
                let dx = (x as f64 - outline.centre.x) as f32;
                let (wx, wy) = (
                    inverse.m11 * dx + inverse.m12 * dy,
                    inverse.m12 * dx + inverse.m22 * dy,
                );
                let mu2 = 1.0 - wx * wx - wy * wy;
                if mu2 > 0.0 {
                    let ring = ring(mu2);
                    counts[ring] += 1;
                    found.push(([wx, wy, row[x].dn() - background_dn], ring));
                }
            }
        }
        let mut rings = [0; RINGS + 1];
        for n in 0..RINGS {
            rings[n + 1] = rings[n] + counts[n];
        }
        let [x, y, light] = std::array::from_fn(|_| vec![0.0; found.len()]);
        let mut taken = Self { x, y, light, rings };
        let mut next = rings;
        for ([x, y, light], ring) in found {
            let n = next[ring];
            next[ring] += 1;
            (taken.x[n], taken.y[n], taken.light[n]) = (x, y, light);
        }
        taken
    }

    pub(super) fn ring(&self, ring: usize) -> std::ops::Range<usize> {
        self.rings[ring]..self.rings[ring + 1]
    }
}

/// `None` when there are too few values.
pub(super) fn median(values: &mut [f32]) -> Option<f32> {
    if values.len() < MIN_RING_PIXELS {
        return None;
    }
    let middle = values.len() / 2;
    Some(*values.select_nth_unstable_by(middle, f32::total_cmp).1)
}

/// The slope of the light across the disc, by least squares on what is neither mark nor blemish.
pub(super) fn measure_tilt(taken: &Taken, darkness: &[f32]) -> Vector2<f32> {
    let (mut moment, mut inertia) = (Vector2::zeros(), 0.0);
    for ((x, y), darkness) in taken.x.iter().zip(&taken.y).zip(darkness) {
        if darkness.abs() < MOST_TILT {
            let w = Vector2::new(*x, *y);
            moment -= w * *darkness;
            inertia += w.norm_squared() / 2.0;
        }
    }
    if inertia > 0.0 {
        moment / inertia
    } else {
        moment
    }
}

/// The ring of a mu^2.
pub(super) fn ring(mu2: f32) -> usize {
    ((mu2.sqrt() * RINGS as f32) as usize).min(RINGS - 1)
}
