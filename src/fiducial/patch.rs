//! The pixels about a mark, and the light that would fall on them without it.

use crate::frame::{Sample, View};
use crate::lanes::{LANES, Scratch, counted_lanes, first_lanes, groups, larger, smaller};
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

/// Light without marks on the pixels of a square, row by row, with one more pixel around for the slopes.
pub(super) struct LightMap {
    left: isize,
    top: isize,
    side: usize,
    stride: usize,
    /// The light, DN; its slopes along x and y, DN/px; the root of what a pixel counts by it.
    planes: [Scratch<f32>; PLANES],
    /// The most light, DN.
    most: f32,
}

const PLANES: usize = 4;

impl LightMap {
    /// `left_out_per_bend` is what the model leaves out, in parts of the noise, for each DN/px^2 that the light bends by
    /// (div grad).
    pub(super) fn about(
        start: SensorPx,
        reach: f64,
        left_out_per_bend: f32,
        light: &impl Light,
    ) -> Self {
        // The start lies within half a pixel of the middle.
        let whole = (reach + 0.5) as isize + 1;
        let (left, top) = (
            start.x.round() as isize - whole,
            start.y.round() as isize - whole,
        );
        let side = 2 * whole as usize + 1;
        let stride = side.next_multiple_of(LANES);
        // The groups of the last row's pixels may reach beyond it.
        let length = side * stride + LANES;
        let mut planes = std::array::from_fn(|_| Scratch::of_length(length));
        let mut most = [0.0_f32; LANES];
        let [middle, across, down, roots] = &mut planes;
        for (row, values) in middle.chunks_exact_mut(stride).take(side).enumerate() {
            light.fill(left as f64, (top + row as isize) as f64, values);
            for group in groups(values) {
                for k in 0..LANES {
                    most[k] = larger(group[k], most[k]);
                }
            }
        }
        slopes(left_out_per_bend, stride, middle, across, down, roots);
        Self {
            left,
            top,
            side,
            stride,
            planes,
            most: most.into_iter().fold(0.0, larger),
        }
    }

    /// The pixels of a row of the sensor within `reach` of the start that are lit, by column: first, and what follows the
    /// last one.
    #[inline(always)]
    fn lit(&self, row: usize, dy: f64, start_x: f64, reach: f64, width: usize) -> (isize, isize) {
        let half = (reach * reach - dy * dy).max(0.0).sqrt();
        let mut first = ((start_x - half).ceil() as isize).max(0);
        let mut end = ((start_x + half).ceil() as isize).min(width as isize);
        let values = &self.planes[0][row * self.stride..][..self.side];
        let least = LEAST_LIGHT * self.most;
        let dull = |column: isize| values[(column - self.left) as usize] <= least;
        while first < end && dull(first) {
            first += 1;
        }
        while first < end && dull(end - 1) {
            end -= 1;
        }
        (first, end)
    }
}

/// The slopes of what lies in rows of a length, and the roots of what pixels count where it bends; those of the first and last
/// rows and columns mean nothing.
#[multiversion(targets("x86_64+avx2"))]
fn slopes(
    left_out_per_bend: f32,
    stride: usize,
    light: &[f32],
    across: &mut [f32],
    down: &mut [f32],
    roots: &mut [f32],
) {
    let count = light.len() - 2 * stride;
    let (above, below) = (&light[..count], &light[2 * stride..][..count]);
    let (left, right) = (&light[stride - 1..][..count], &light[stride + 1..][..count]);
    let middle = &light[stride..][..count];
    let (across, down) = (&mut across[stride..][..count], &mut down[stride..][..count]);
    let roots = &mut roots[stride..][..count];
    for n in 0..count {
        across[n] = (right[n] - left[n]) / 2.0;
        down[n] = (below[n] - above[n]) / 2.0;
        let bend = left[n] + right[n] + above[n] + below[n] - 4.0 * middle[n];
        let left_out = left_out_per_bend * bend;
        roots[n] = 1.0 / (1.0 + left_out * left_out).sqrt();
    }
}

/// The pixels about a mark, one list for each quantity, as vector instructions like it: in groups, of which what fills the
/// last one counts nothing.
pub(super) struct Patch {
    lists: Scratch<f32>,
    /// What each list has room for.
    room: usize,
    pub pixels: usize,
    /// The most light on one, DN.
    pub most_light: f32,
}

/// The lists of a patch: the pixels' places from the start, px; what is seen above background, DN; light without the mark,
/// DN, and its slopes, DN/px; the root of what a pixel counts, 1 on the even disc.
const LISTS: usize = 7;
const ROOT_WEIGHTS: usize = 6;

/// What decides what a pixel of a patch shows.
pub(super) struct Counting {
    pub background_dn: f32,
    pub saturation_dn: f32,
}

impl Patch {
    /// The pixels within `reach` of the start that tell something of the mark.
    pub(super) fn cut<T: Sample>(
        view: &View<'_, T>,
        counting: &Counting,
        map: &LightMap,
        start: SensorPx,
        reach: f64,
    ) -> Self {
        // The squares of the pixels lie within half a diagonal of the circle; the last group may reach beyond the last pixel.
        let most = std::f64::consts::PI * (reach + std::f64::consts::FRAC_1_SQRT_2).powi(2);
        let room = (most as usize + LANES).next_multiple_of(LANES);
        let mut patch = Self {
            lists: Scratch::of_length(LISTS * room),
            room,
            pixels: 0,
            most_light: map.most,
        };
        patch.pixels = write_pixels(view, counting, map, start, reach, patch.lists_mut());
        patch.leave_out_saturated();
        let (pixels, length) = (patch.pixels, patch.length());
        for list in patch.lists_mut() {
            list[pixels..length].fill(0.0);
        }
        patch
    }

    /// The pixels, and what fills the last group.
    pub(super) fn length(&self) -> usize {
        self.pixels.next_multiple_of(LANES)
    }

    pub(super) fn lists(&self) -> [&[f32]; LISTS] {
        std::array::from_fn(|n| &self.lists[n * self.room..][..self.length()])
    }

    pub(super) fn root_weights(&self) -> &[f32] {
        self.lists()[ROOT_WEIGHTS]
    }

    fn lists_mut(&mut self) -> [&mut [f32]; LISTS] {
        let mut lists = self.lists.chunks_exact_mut(self.room);
        std::array::from_fn(|_| lists.next().unwrap_or_default())
    }

    /// Leaves out the pixels that count nothing.
    fn leave_out_saturated(&mut self) {
        let roots = &self.lists()[ROOT_WEIGHTS][..self.pixels];
        if roots.iter().copied().fold(1.0, smaller) > 0.0 {
            return;
        }
        let counting: Vec<usize> = (0..self.pixels).filter(|n| roots[*n] > 0.0).collect();
        for list in self.lists_mut() {
            for (to, from) in counting.iter().enumerate() {
                list[to] = list[*from];
            }
        }
        self.pixels = counting.len();
    }
}

/// Writes the pixels within `reach` of the start to the lists of a patch; how many they are.
#[multiversion(targets("x86_64+avx2"))]
fn write_pixels<T: Sample>(
    view: &View<'_, T>,
    counting: &Counting,
    map: &LightMap,
    start: SensorPx,
    reach: f64,
    lists: [&mut [f32]; LISTS],
) -> usize {
    let room = lists[0].len();
    let [x, y, seen, light, slope_x, slope_y, roots] = lists;
    let (x, y, seen) = (&mut x[..room], &mut y[..room], &mut seen[..room]);
    let (slope_x, slope_y) = (&mut slope_x[..room], &mut slope_y[..room]);
    let (light, roots) = (&mut light[..room], &mut roots[..room]);
    let [map_light, map_slope_x, map_slope_y, map_roots] = &map.planes;
    let length = map_light.len();
    let (map_light, map_roots) = (&map_light[..length], &map_roots[..length]);
    let (map_slope_x, map_slope_y) = (&map_slope_x[..length], &map_slope_y[..length]);
    let mut count = 0;
    for row in 1..map.side - 1 {
        let Ok(sensor_row) = usize::try_from(map.top + row as isize) else {
            continue;
        };
        if sensor_row >= view.height {
            continue;
        }
        let dy = sensor_row as f64 - start.y;
        let (first, end) = map.lit(row, dy, start.x, reach, view.width);
        if first >= end {
            continue;
        }
        let line = &view.pixels[sensor_row * view.width..][first as usize..view.width];
        let length = (end - first) as usize;
        let here = row * map.stride + (first - map.left) as usize;
        let from_start = (first as f64 - start.x) as f32;
        for group in (0..length).step_by(LANES) {
            let dn = first_lanes(&line[group..]);
            let from = here + group..here + group + LANES;
            let to = count + group..count + group + LANES;
            let (mut above_background, mut counts) = ([0.0; LANES], [0.0; LANES]);
            counts.copy_from_slice(&map_roots[from.clone()]);
            for k in 0..LANES {
                above_background[k] = dn[k] - counting.background_dn;
                let unsaturated = dn[k] < counting.saturation_dn;
                counts[k] = if unsaturated { counts[k] } else { 0.0 };
            }
            x[to.clone()].copy_from_slice(&counted_lanes(from_start + group as i32 as f32));
            y[to.clone()].copy_from_slice(&[dy as f32; LANES]);
            seen[to.clone()].copy_from_slice(&above_background);
            light[to.clone()].copy_from_slice(&map_light[from.clone()]);
            slope_x[to.clone()].copy_from_slice(&map_slope_x[from.clone()]);
            slope_y[to.clone()].copy_from_slice(&map_slope_y[from]);
            roots[to].copy_from_slice(&counts);
        }
        count += length;
    }
    count
}
