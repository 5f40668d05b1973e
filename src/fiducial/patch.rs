//! The pixels about a mark, and the light that would fall on them without it.

use crate::frame::{Sample, View};
use crate::lanes::{LANES, Scratch, counted_lanes, first_lanes};
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

/// Light without marks on the pixels of a square, with one more pixel around for the slopes.
pub(super) struct LightMap {
    left: isize,
    top: isize,
    side: usize,
    /// Row by row; what follows each row, whatever it is, lets groups of pixels be taken together.
    light: Scratch<f32>,
    stride: usize,
    /// The most light, DN.
    most: f32,
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
        let mut map = Scratch::of_length((side + 1) * stride);
        let mut most = 0.0_f32;
        for (row, values) in map.chunks_exact_mut(stride).take(side).enumerate() {
            let y = (top + row as isize) as f64;
            light.fill(left as f64, y, &mut values[..side]);
            most = values[..side]
                .iter()
                .fold(most, |most, v| if *v > most { *v } else { most });
        }
        Self {
            left,
            top,
            side,
            light: map,
            stride,
            most,
        }
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
        // The squares of the pixels lie within half a diagonal of the circle; the last group may reach beyond the last pixel.
        let most = std::f64::consts::PI * (reach + std::f64::consts::FRAC_1_SQRT_2).powi(2);
        let room = most as usize + LANES;
        let mut patch = Self::of_length(room);
        let mut bend = Scratch::of_length(room);
        let count = write_pixels(view, counting, map, start, reach, &mut patch, &mut bend);
        for list in patch.lists() {
            list.truncate(count);
        }
        let least = LEAST_LIGHT * map.most;
        weigh(
            &patch.light,
            &bend,
            [least, counting.left_out_per_bend],
            &mut patch.root_weight,
        );
        patch.leave_out_dull();
        patch
    }

    /// Writes the first group of a row's rest, from a place in the lists on: what is seen and where.
    #[inline(always)]
    fn write<T: Sample>(&mut self, at: usize, rest: &[T], counting: &Counting, (x, y): (f32, f32)) {
        let mut seen = first_lanes(rest);
        let mut roots = [0.0; LANES];
        for k in 0..LANES {
            let counts = seen[k] < counting.saturation_dn;
            roots[k] = if counts { 1.0 } else { 0.0 };
            seen[k] -= counting.background_dn;
        }
        let lanes = at..at + LANES;
        self.seen[lanes.clone()].copy_from_slice(&seen);
        self.root_weight[lanes.clone()].copy_from_slice(&roots);
        self.x[lanes.clone()].copy_from_slice(&counted_lanes(x));
        self.y[lanes].copy_from_slice(&[y; LANES]);
    }

    /// Writes the light on a group of pixels, and what it does about them, from an index in the map.
    #[inline(always)]
    fn write_light(&mut self, at: usize, map: &LightMap, here: usize, bend: &mut [f32]) {
        let about = |from: usize| {
            let mut lanes = [0.0; LANES];
            lanes.copy_from_slice(&map.light[from..from + LANES]);
            lanes
        };
        let (middle, left, right) = (about(here), about(here - 1), about(here + 1));
        let (above, below) = (about(here - map.stride), about(here + map.stride));
        let [mut slope_x, mut slope_y, mut bends] = [[0.0; LANES]; 3];
        for k in 0..LANES {
            slope_x[k] = (right[k] - left[k]) / 2.0;
            slope_y[k] = (below[k] - above[k]) / 2.0;
            bends[k] = left[k] + right[k] + above[k] + below[k] - 4.0 * middle[k];
        }
        let lanes = at..at + LANES;
        self.light[lanes.clone()].copy_from_slice(&middle);
        self.slope_x[lanes.clone()].copy_from_slice(&slope_x);
        self.slope_y[lanes.clone()].copy_from_slice(&slope_y);
        bend[lanes].copy_from_slice(&bends);
    }

    /// Leaves out the pixels that tell nothing.
    fn leave_out_dull(&mut self) {
        let dull = self.root_weight.iter().filter(|root| **root <= 0.0);
        if dull.count() == 0 {
            return;
        }
        let counts: Vec<bool> = self.root_weight.iter().map(|root| *root > 0.0).collect();
        for list in self.lists() {
            let mut counts = counts.iter();
            list.retain(|_| counts.next().is_some_and(|counts| *counts));
        }
    }

    fn of_length(length: usize) -> Self {
        let [x, y, seen, light, slope_x, slope_y, root_weight] =
            std::array::from_fn(|_| Scratch::of_length(length));
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

    pub(super) fn len(&self) -> usize {
        self.x.len()
    }
}

/// Writes the pixels within `reach` of the start to the lists, and how the light bends there; how many they are.
#[multiversion(targets("x86_64+avx2"))]
fn write_pixels<T: Sample>(
    view: &View<'_, T>,
    counting: &Counting,
    map: &LightMap,
    start: SensorPx,
    reach: f64,
    patch: &mut Patch,
    bend: &mut [f32],
) -> usize {
    let mut count = 0;
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
        let line = &view.pixels[y * view.width..][first as usize..view.width];
        let here = row * map.stride + (first - map.left) as usize;
        let length = (end - first) as usize;
        for group in (0..length).step_by(LANES) {
            let place = ((first as f64 - start.x) as f32 + group as f32, dy as f32);
            patch.write(count + group, &line[group..], counting, place);
            patch.write_light(count + group, map, here + group, bend);
        }
        count += length;
    }
    count
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
