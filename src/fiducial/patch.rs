//! The pixels around a mark, and the illumination that they would have without it.

use crate::frame::{Cutout, Region};
use crate::kernels::limb::Lit;
use crate::kernels::{LANES, larger};
use crate::units::SensorPx;

/// The illumination of the plate's marks, behind the lens's blur, as it would be without marks.
pub trait Illumination {
    /// The light on the pixels of a row from column `x` on, DN above the background.
    fn fill(&self, x: f64, y: f64, light: &mut [f32]);

    /// The light at positions in whole lanes, relative to `position`, px.
    fn about(&self, position: SensorPx, x: &[f32], y: &[f32], lit: &mut Lit);
}

impl<F: Fn(f64, f64) -> f64> Illumination for F {
    fn fill(&self, x: f64, y: f64, light: &mut [f32]) {
        for (n, light) in light.iter_mut().enumerate() {
            *light = self(x + n as f64, y) as f32;
        }
    }

    fn about(&self, position: SensorPx, x: &[f32], y: &[f32], lit: &mut Lit) {
        for list in lit.lists() {
            list.clear();
        }
        for (x, y) in x.iter().zip(y) {
            let (x, y) = (position.x + f64::from(*x), position.y + f64::from(*y));
            let [left, right, above, below] = [
                self(x - 1.0, y),
                self(x + 1.0, y),
                self(x, y - 1.0),
                self(x, y + 1.0),
            ];
            let light = self(x, y);
            let bend = left + right + above + below - 4.0 * light;
            let found = [light, (right - left) / 2.0, (below - above) / 2.0, bend];
            for (list, found) in lit.lists().into_iter().zip(found) {
                list.push(found as f32);
            }
        }
    }
}

/// A pixel with less than this fraction of the patch's brightest light is not used.
const LEAST_LIGHT: f32 = 0.05;

/// The pixels around a mark, one list per quantity, in whole lanes: the last lane may be padded with pixels that do not
/// count.
#[derive(Debug, Clone, Default)]
pub(super) struct Patch {
    /// Offset from the mark's expected position, px.
    pub x: Vec<f32>,
    pub y: Vec<f32>,
    /// Light above the background, DN.
    pub seen: Vec<f32>,
    /// Light expected without the mark.
    pub lit: Lit,
    /// 1 for pixels that count, 0 for masked and unlit ones.
    pub counts: Vec<f32>,
}

impl Patch {
    /// Replaces the pixels by those within `reach` of a position; `None` if the cutout has none of them.
    pub(super) fn take(
        &mut self,
        place: SensorPx,
        reach: f64,
        cutout: &Cutout,
        illumination: &impl Illumination,
    ) -> Option<()> {
        let region = cutout.region();
        let about = Region::around(place, reach, region.x1, region.y1)?.intersection(&region)?;
        for list in self.lists() {
            list.clear();
            list.reserve(about.width() * about.height());
        }
        for y in about.y0..about.y1 {
            let dy = y as f64 - place.y;
            let half = (reach * reach - dy * dy).max(0.0).sqrt();
            let first = ((place.x - half).ceil().max(0.0) as usize).clamp(about.x0, about.x1);
            let end = ((place.x + half).ceil().max(0.0) as usize).clamp(first, about.x1);
            let columns = first - region.x0..end - region.x0;
            let first_x = (first as f64 - place.x) as f32;
            self.x
                .extend((0..columns.len() as i32).map(|n| first_x + n as f32));
            self.y.resize(self.x.len(), dy as f32);
            self.seen.extend_from_slice(&cutout.row(y)[columns.clone()]);
            let counts = cutout.mask.row(y)[columns].iter();
            self.counts
                .extend(counts.map(|masked| f32::from(u8::from(!masked))));
        }
        let whole = self.x.len().next_multiple_of(LANES);
        for list in self.lists() {
            list.resize(whole, 0.0);
        }
        illumination.about(place, &self.x, &self.y, &mut self.lit);
        let brightest = self.lit.light.iter().copied().fold(0.0, larger);
        for (counts, light) in self.counts.iter_mut().zip(&self.lit.light) {
            *counts = if *light > LEAST_LIGHT * brightest {
                *counts
            } else {
                0.0
            };
        }
        Some(())
    }

    fn lists(&mut self) -> [&mut Vec<f32>; 4] {
        [&mut self.x, &mut self.y, &mut self.seen, &mut self.counts]
    }
}
