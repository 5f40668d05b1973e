//! The pixels about a mark, and the light that would fall on them without it.

use crate::frame::{Cutout, Region};
use crate::kernels::LANES;
use crate::units::SensorPx;
use std::ops::Range;

/// The light that falls on the plate's marks, behind the lens's blur, as it would be without marks.
pub trait Illumination {
    /// The light on a row's pixels from column `x` on, DN above the background.
    fn fill(&self, x: f64, y: f64, light: &mut [f32]);
}

impl<F: Fn(f64, f64) -> f64> Illumination for F {
    fn fill(&self, x: f64, y: f64, light: &mut [f32]) {
        for (n, light) in light.iter_mut().enumerate() {
            *light = self(x + n as f64, y) as f32;
        }
    }
}

/// Where less than this part of the patch's brightest light falls, a pixel tells nothing of the mark.
const LEAST_LIGHT: f32 = 0.05;

/// The pixels about a mark, one list for each quantity, in whole lanes: the last ones may be filled up with pixels that do not
/// count.
#[derive(Debug, Clone, Default)]
pub(super) struct Patch {
    /// Offset from where the mark is expected, px.
    pub x: Vec<f32>,
    pub y: Vec<f32>,
    /// Light above the background, DN.
    pub seen: Vec<f32>,
    /// Light without the mark, DN, and its slopes, DN/px.
    pub light: Vec<f32>,
    pub slope_x: Vec<f32>,
    pub slope_y: Vec<f32>,
    /// How much that slope changes (div grad), DN/px^2.
    pub bend: Vec<f32>,
    /// 1 for pixels that count, 0 for masked and unlit ones.
    pub counts: Vec<f32>,
    map: LightMap,
}

impl Patch {
    /// Takes in the pixels within `reach` of a place instead of those that it had; `None` when the cutout has none of them.
    pub(super) fn take(
        &mut self,
        place: SensorPx,
        reach: f64,
        cutout: &Cutout,
        illumination: &impl Illumination,
    ) -> Option<()> {
        let region = cutout.region();
        let about = Region::around(place, reach, region.x1, region.y1)?.intersection(&region)?;
        self.map.take(about, illumination);
        let least = LEAST_LIGHT * self.map.brightest();
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
            self.add_light(first..end, y);
            let masked = &cutout.mask.row(y)[columns];
            let lit = &self.light[self.light.len() - masked.len()..];
            let counts = lit.iter().zip(masked);
            let counts = counts.map(|(light, masked)| *light > least && !masked);
            self.counts
                .extend(counts.map(|counts| f32::from(u8::from(counts))));
        }
        let whole = self.x.len().next_multiple_of(LANES);
        for list in self.lists() {
            list.resize(whole, 0.0);
        }
        Some(())
    }

    fn lists(&mut self) -> [&mut Vec<f32>; 8] {
        let Self {
            x,
            y,
            seen,
            light,
            slope_x,
            slope_y,
            bend,
            counts,
            ..
        } = self;
        [x, y, seen, light, slope_x, slope_y, bend, counts]
    }

    /// Adds the light of some columns of a row.
    fn add_light(&mut self, columns: Range<usize>, y: usize) {
        let [above, here, below] = self.map.rows_about(columns, y);
        let inner = 1..here.len() - 1;
        let (left, right) = (&here[..here.len() - 2], &here[2..]);
        let (above, here, below) = (&above[inner.clone()], &here[inner.clone()], &below[inner]);
        self.light.extend_from_slice(here);
        self.slope_x
            .extend(left.iter().zip(right).map(|(l, r)| (r - l) / 2.0));
        self.slope_y
            .extend(above.iter().zip(below).map(|(a, b)| (b - a) / 2.0));
        let sums = left.iter().zip(right).zip(above).zip(below);
        let bends = sums
            .zip(here)
            .map(|((((l, r), a), b), here)| l + r + a + b - 4.0 * here);
        self.bend.extend(bends);
    }
}

/// Light without marks on the pixels of a region and of one more pixel around.
#[derive(Debug, Clone, Default)]
struct LightMap {
    /// Of the region's first pixel.
    x0: usize,
    y0: usize,
    stride: usize,
    light: Vec<f32>,
}

impl LightMap {
    fn take(&mut self, region: Region, illumination: &impl Illumination) {
        (self.x0, self.y0, self.stride) = (region.x0, region.y0, region.width() + 2);
        self.light.resize(self.stride * (region.height() + 2), 0.0);
        for (row, light) in self.light.chunks_exact_mut(self.stride).enumerate() {
            let (x, y) = (region.x0 as f64 - 1.0, (region.y0 + row) as f64 - 1.0);
            illumination.fill(x, y, light);
        }
    }

    fn brightest(&self) -> f32 {
        self.light.iter().copied().fold(0.0, f32::max)
    }

    /// The light on some columns of a row of the region and one more at either end: in the row above, in this one and below.
    fn rows_about(&self, columns: Range<usize>, y: usize) -> [&[f32]; 3] {
        let above = (y - self.y0) * self.stride + columns.start - self.x0;
        [0, 1, 2].map(|n| &self.light[above + n * self.stride..][..columns.len() + 2])
    }
}
