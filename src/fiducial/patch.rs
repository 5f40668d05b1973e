//! The pixels about a mark, and the light that would fall on them without it.

use crate::frame::{Cutout, Region};
use crate::units::SensorPx;

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

/// The pixels about a mark, one list for each quantity.
#[derive(Debug, Default)]
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
}

impl Patch {
    /// The lit pixels within `reach` of a place, without the masked ones.
    pub(super) fn about(
        place: SensorPx,
        reach: f64,
        cutout: &Cutout,
        illumination: &impl Illumination,
    ) -> Self {
        let mut patch = Self::default();
        let region = cutout.region();
        let Some(about) = Region::around(place, reach, region.x1, region.y1) else {
            return patch;
        };
        let Some(about) = about.intersection(&region) else {
            return patch;
        };
        let map = LightMap::over(about, illumination);
        let least = LEAST_LIGHT * map.brightest();
        for y in about.y0..about.y1 {
            let dy = y as f64 - place.y;
            let half = (reach * reach - dy * dy).max(0.0).sqrt();
            let first = ((place.x - half).ceil().max(0.0) as usize).max(about.x0);
            let end = ((place.x + half).ceil().max(0.0) as usize).min(about.x1);
            let (seen, masked) = (cutout.row(y), cutout.mask.row(y));
            for x in first..end {
                let (light, column) = (map.at(x, y), x - region.x0);
                if light[LightMap::HERE] > least && !masked[column] {
                    patch.push(
                        [(x as f64 - place.x) as f32, dy as f32],
                        seen[column],
                        light,
                    );
                }
            }
        }
        patch
    }

    fn push(&mut self, [x, y]: [f32; 2], seen: f32, [here, left, right, above, below]: [f32; 5]) {
        self.x.push(x);
        self.y.push(y);
        self.seen.push(seen);
        self.light.push(here);
        self.slope_x.push((right - left) / 2.0);
        self.slope_y.push((below - above) / 2.0);
        self.bend.push(left + right + above + below - 4.0 * here);
    }

    pub(super) fn pixels(&self) -> usize {
        self.x.len()
    }
}

/// Light without marks on the pixels of a region and of one more pixel around.
struct LightMap {
    region: Region,
    stride: usize,
    light: Vec<f32>,
}

impl LightMap {
    const HERE: usize = 0;

    fn over(region: Region, illumination: &impl Illumination) -> Self {
        let stride = region.width() + 2;
        let mut light = vec![0.0; stride * (region.height() + 2)];
        for (row, light) in light.chunks_exact_mut(stride).enumerate() {
            let (x, y) = (region.x0 as f64 - 1.0, (region.y0 + row) as f64 - 1.0);
            illumination.fill(x, y, light);
        }
        Self {
            region,
            stride,
            light,
        }
    }

    fn brightest(&self) -> f32 {
        self.light.iter().copied().fold(0.0, f32::max)
    }

    /// The light on a pixel of the region, and to the left, to the right, above and below.
    fn at(&self, x: usize, y: usize) -> [f32; 5] {
        let here = (y - self.region.y0 + 1) * self.stride + (x - self.region.x0 + 1);
        [
            here,
            here - 1,
            here + 1,
            here - self.stride,
            here + self.stride,
        ]
        .map(|n| self.light[n])
    }
}
