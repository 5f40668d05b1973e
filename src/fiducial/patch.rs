//! The pixels about a mark, and the light that would fall on them without it.

use crate::frame::{Sample, View};
use crate::lanes::Scratch;
use crate::units::SensorPx;
use multiversion::multiversion;

/// The disc's light behind the lens's blur, as it would be without marks.
pub trait Light {
    /// The light on a row's pixels from column `x` on, DN above the background.
    fn fill(&self, x: f64, y: f64, light: &mut [f32]);
}

impl<F: Fn(f64, f64) -> f64> Light for F {
    fn fill(&self, x: f64, y: f64, light: &mut [f32]) {
        for (n, light) in light.iter_mut().enumerate() {
            *light = self(x + n as f64, y) as f32;
        }
    }
}

/// Where less than this part of the patch's most light falls, a pixel tells nothing of the mark.
const LEAST_LIGHT: f32 = 0.05;
/// Pixels that are taken together.
const LANES: usize = 8;

/// Light without marks on the pixels of a square, with one more pixel around for the slopes.
pub(super) struct LightMap {
    left: isize,
    top: isize,
    side: usize,
    /// Row by row, filled up so that groups of pixels may be taken together.
    light: Scratch<f32>,
    stride: usize,
}

impl LightMap {
    pub(super) fn about(start: SensorPx, reach: f64, light: &impl Light) -> Self {
        let whole = reach.ceil() as isize + 1;
        let (left, top) = (
            start.x.round() as isize - whole,
            start.y.round() as isize - whole,
        );
        let side = 2 * whole as usize + 1;
        let stride = side + LANES;
        let mut map = Scratch::zeros((side + 1) * stride);
        for (row, values) in map.chunks_exact_mut(stride).take(side).enumerate() {
            let y = (top + row as isize) as f64;
            light.fill(left as f64, y, &mut values[..side]);
        }
        Self {
            left,
            top,
            side,
            light: map,
            stride,
        }
    }

    fn most(&self) -> f32 {
        self.light.iter().copied().fold(0.0, f32::max)
    }
}

/// The pixels about a mark, one list for each quantity, as vector instructions like it. Positions count from the start.
pub(super) struct Patch {
    pub x: Scratch<f32>,
    pub y: Scratch<f32>,
    /// Seen above background, DN.
    pub seen: Scratch<f32>,
    /// Light without the mark, DN, and its slopes, DN/px.
    pub light: Scratch<f32>,
    pub slope_x: Scratch<f32>,
    pub slope_y: Scratch<f32>,
    /// Root of what a pixel counts, 1 on the even disc.
    pub root_weight: Scratch<f32>,
}

/// What decides what a pixel of a patch counts.
pub(super) struct Counting {
    pub background_dn: f32,
    pub saturation_dn: f32,
    /// What the model leaves out, in parts of the noise, for each DN/px^2 that the light bends by (div grad).
    pub left_out_per_bend: f32,
}

impl Patch {
    /// The pixels within `reach` of the start.
    pub(super) fn cut<T: Sample>(
        view: &View<'_, T>,
        counting: &Counting,
        map: &LightMap,
        start: SensorPx,
        reach: f64,
    ) -> Self {
        let mut patch = Self::with_room(map.side * map.side);
        let mut bend = Scratch::empty(map.side * map.side);
        for row in 1..map.side - 1 {
            let Ok(y) = usize::try_from(map.top + row as isize) else {
                continue;
            };
            if y >= view.height {
                continue;
            }
            let dy = y as f64 - start.y;
            let half = (reach * reach - dy * dy).max(0.0).sqrt();
            let first = ((start.x - half).ceil().max(0.0) as isize).max(map.left + 1);
            let end = ((start.x + half).ceil() as isize)
                .min(map.left + map.side as isize - 1)
                .min(view.width as isize);
            if first >= end {
                continue;
            }
            let columns = first as usize..end as usize;
            let seen = &view.pixels[y * view.width..][columns.clone()];
            let here = row * map.stride + (first - map.left) as usize;
            let places = (columns.start as f64 - start.x, dy);
            patch.take(seen, counting, map, here, places, &mut bend);
        }
        let least = LEAST_LIGHT * map.most();
        weigh(
            &patch.light,
            &bend,
            [least, counting.left_out_per_bend],
            &mut patch.root_weight,
        );
        patch.leave_out_dull();
        patch
    }

    /// Leaves out the pixels that tell nothing.
    fn leave_out_dull(&mut self) {
        let counts: Vec<bool> = self.root_weight.iter().map(|root| *root > 0.0).collect();
        if counts.iter().all(|counts| *counts) {
            return;
        }
        for list in self.lists() {
            let mut counts = counts.iter();
            list.retain(|_| counts.next().is_some_and(|counts| *counts));
        }
    }

    fn with_room(room: usize) -> Self {
        let [x, y, seen, light, slope_x, slope_y, root_weight] =
            [(); 7].map(|()| Scratch::empty(room));
        Self {
            x,
            y,
            seen,
            light,
            slope_x,
            slope_y,
            root_weight,
        }
    }

    fn lists(&mut self) -> [&mut Scratch<f32>; 7] {
        [
            &mut self.x,
            &mut self.y,
            &mut self.seen,
            &mut self.light,
            &mut self.slope_x,
            &mut self.slope_y,
            &mut self.root_weight,
        ]
    }

    /// Adds the pixels of a row, of which the first has an index in the map and a place from the start.
    fn take<T: Sample>(
        &mut self,
        seen: &[T],
        counting: &Counting,
        map: &LightMap,
        here: usize,
        (x, y): (f64, f64),
        bend: &mut Scratch<f32>,
    ) {
        let end = self.x.len() + seen.len();
        let dn = || seen.iter().map(|pixel| pixel.dn());
        let counts = |dn| {
            if dn < counting.saturation_dn {
                1.0
            } else {
                0.0
            }
        };
        self.seen.extend(dn().map(|dn| dn - counting.background_dn));
        self.root_weight.extend(dn().map(counts));
        self.x.extend((0..seen.len()).map(|n| x as f32 + n as f32));
        for first in (0..seen.len()).step_by(LANES) {
            let at = |offset: isize| {
                let from = (here + first).wrapping_add_signed(offset);
                let mut lanes = [0.0; LANES];
                lanes.copy_from_slice(&map.light[from..from + LANES]);
                lanes
            };
            let stride = map.stride as isize;
            let [middle, left, right, above, below] = [0, -1, 1, -stride, stride].map(at);
            let half = |a: [f32; LANES], b: [f32; LANES]| -> [f32; LANES] {
                std::array::from_fn(|k| (b[k] - a[k]) / 2.0)
            };
            self.light.extend_from_slice(&middle);
            self.slope_x.extend_from_slice(&half(left, right));
            self.slope_y.extend_from_slice(&half(above, below));
            let bends: [f32; LANES] =
                std::array::from_fn(|k| left[k] + right[k] + above[k] + below[k] - 4.0 * middle[k]);
            bend.extend_from_slice(&bends);
            self.y.extend_from_slice(&[y as f32; LANES]);
        }
        bend.truncate(end);
        for list in self.lists() {
            list.truncate(end);
        }
    }

    pub(super) fn len(&self) -> usize {
        self.x.len()
    }
}

#[multiversion(targets("x86_64+avx2"))]
fn weigh(light: &[f32], bend: &[f32], [least, per_bend]: [f32; 2], root_weight: &mut [f32]) {
    let count = root_weight.len();
    let (light, bend) = (&light[..count], &bend[..count]);
    for n in 0..count {
        let left_out = per_bend * bend[n];
        let root = 1.0 / (1.0 + left_out * left_out).sqrt();
        root_weight[n] *= if light[n] > least { root } else { 0.0 };
    }
}
