//! Bright patches of a frame, and their outlines.

use super::light::Levels;
use crate::frame::{Frame, Region};
use crate::reasons::moon as reasons;
use crate::units::Rejected;
use nalgebra::Vector2;

/// A frame with more runs of bright pixels than this, and than one per so many pixels, shows a pattern and not a night sky.
const MANY_RUNS: usize = 20_000;
const PIXELS_PER_RUN: usize = 30;
/// Number of columns that are scanned together: most of the sky is dark.
const BLOCK_PX: usize = 96;
/// Level of a patch's outline above the sky, as a share of the level that this share of its pixels exceeds.
const OUTLINE_SHARE: f64 = 0.4;
const BRIGHT_SHARE: f64 = 0.1;
/// The minimum of that level, with another share of the brightest pixels: a thin crescent is a small part of a disc with
/// earthshine.
const CRESCENT_SHARE: f64 = 0.25;
const BRIGHTEST_SHARE: f64 = 0.01;
/// Margin around the patch in which the outline is searched.
const MARGIN_PX: usize = 2;

/// A set of connected bright pixels.
#[derive(Debug, Clone, Copy)]
pub(super) struct Patch {
    pub pixels: usize,
    region: Region,
}

/// A run of bright pixels in a row, first and last column.
struct Run {
    first: usize,
    last: usize,
    patch: usize,
}

impl Run {
    fn touches(&self, (first, last): (usize, usize)) -> bool {
        self.first <= last + 1 && first <= self.last + 1
    }
}

/// The patches of pixels above a threshold, the largest first.
///
/// If there are runs of bright pixels all over the frame.
/// Runs of bright pixels all over.
pub(super) fn patches(frame: &Frame, threshold_dn: f64) -> Result<Vec<Patch>, Rejected> {
    let most_runs = MANY_RUNS.max(frame.width() * frame.height() / PIXELS_PER_RUN);
    let mut patches: Vec<Option<Patch>> = Vec::new();
    let mut above: Vec<Run> = Vec::new();
    for y in 0..frame.height() {
        let mut here: Vec<Run> = Vec::new();
        for run in runs(frame, y, threshold_dn) {
            let mut patch = Patch {
                pixels: run.1 + 1 - run.0,
                region: Region {
                    x0: run.0,
                    y0: y,
                    x1: run.1 + 1,
                    y1: y + 1,
                },
            };
            let number = patches.len();
            let touched = above.iter().filter(|other| other.touches(run));
            for other in touched.map(|other| other.patch).collect::<Vec<_>>() {
                patch = joined(patch, patches[other].take());
                let same = above.iter_mut().chain(&mut here);
                same.filter(|run| run.patch == other)
                    .for_each(|run| run.patch = number);
            }
            patches.push(Some(patch));
            here.push(Run {
                first: run.0,
                last: run.1,
                patch: number,
            });
        }
        above = here;
        Rejected::at_most(most_runs as f64, patches.len() as f64, reasons::MANY_LIGHTS)?;
    }
    let mut patches: Vec<Patch> = patches.into_iter().flatten().collect();
    patches.sort_by_key(|patch| std::cmp::Reverse(patch.pixels));
    Ok(patches)
}

fn joined(one: Patch, other: Option<Patch>) -> Patch {
    let Some(other) = other else {
        return one;
    };
    let (a, b) = (one.region, other.region);
    Patch {
        pixels: one.pixels + other.pixels,
        region: Region {
            x0: a.x0.min(b.x0),
            y0: a.y0.min(b.y0),
            x1: a.x1.max(b.x1),
            y1: a.y1.max(b.y1),
        },
    }
}

/// First and last columns of a row's runs.
fn runs(frame: &Frame, y: usize, threshold_dn: f64) -> Vec<(usize, usize)> {
    let mut runs: Vec<(usize, usize)> = Vec::new();
    let width = frame.width();
    if !frame.is_brighter(y, 0..width, threshold_dn) {
        return runs;
    }
    for first in (0..width).step_by(BLOCK_PX) {
        let columns = first..(first + BLOCK_PX).min(width);
        if !frame.is_brighter(y, columns.clone(), threshold_dn) {
            continue;
        }
        let row = frame.row_dn(y, columns.clone());
        for (x, _) in columns
            .zip(row)
            .filter(|(_, dn)| f64::from(*dn) > threshold_dn)
        {
            match runs.last_mut().filter(|run| run.1 + 1 == x) {
                Some(run) => run.1 = x,
                None => runs.push((x, x)),
            }
        }
    }
    runs
}

/// The outline of a patch and its light.
#[derive(Debug, Clone)]
pub(super) struct Outline {
    /// First and last crossings of a level in its rows and columns, px.
    pub points: Vec<Vector2<f64>>,
    /// Centroid of its light, px.
    pub middle: Vector2<f64>,
    /// Pixels above the level.
    pub light_px: usize,
    /// Whether the picture's edge cuts it.
    pub is_cut: bool,
}

impl Outline {
    /// For a patch of pixels that are at least `least_dn` above the sky.
    pub fn of(frame: &Frame, patch: &Patch, levels: &Levels, least_dn: f64) -> Self {
        let Region { x0, y0, x1, y1 } = patch.region;
        let region = Region {
            x0: x0.saturating_sub(MARGIN_PX),
            y0: y0.saturating_sub(MARGIN_PX),
            x1: (x1 + MARGIN_PX).min(frame.width()),
            y1: (y1 + MARGIN_PX).min(frame.height()),
        };
        let level = outline_dn(frame, &region, patch.pixels, levels.dark_dn, least_dn);
        let mut points = Vec::new();
        for y in region.y0..region.y1 {
            let ends = ends(&frame.row_dn(y, region.x0..region.x1), level);
            points.extend(ends.map(|x| Vector2::new(region.x0 as f64 + x, y as f64)));
        }
        for x in region.x0..region.x1 {
            let ends = ends(&frame.column_dn(x, region.y0..region.y1), level);
            points.extend(ends.map(|y| Vector2::new(x as f64, region.y0 as f64 + y)));
        }
        let (middle, light_px) = light(frame, &region, level, levels.dark_dn);
        Self {
            points,
            middle,
            light_px,
            is_cut: x0 == 0 || y0 == 0 || x1 == frame.width() || y1 == frame.height(),
        }
    }

    /// The same in another plane.
    pub fn seen_by(self, plane: impl Fn(Vector2<f64>) -> Vector2<f64>) -> Self {
        Self {
            points: self.points.into_iter().map(&plane).collect(),
            middle: plane(self.middle),
            ..self
        }
    }
}

/// The level of a patch's outline.
fn outline_dn(frame: &Frame, region: &Region, pixels: usize, dark_dn: f64, least_dn: f64) -> f64 {
    let rows = (region.y0..region.y1).flat_map(|y| frame.row_dn(y, region.x0..region.x1));
    let mut light: Vec<f32> = rows.collect();
    let mut above_sky = |share: f64| {
        let rank = ((share * pixels as f64) as usize).min(light.len() - 1);
        let (_, dn, _) = light.select_nth_unstable_by(rank, |a, b| b.total_cmp(a));
        f64::from(*dn) - dark_dn
    };
    let level_dn = OUTLINE_SHARE * above_sky(BRIGHT_SHARE);
    let crescent_dn = CRESCENT_SHARE * above_sky(BRIGHTEST_SHARE);
    dark_dn + level_dn.max(crescent_dn).max(least_dn)
}

/// Positions, to a fraction of a pixel, at which a line of pixels first rises above a level and last falls below it; none
/// where the picture's edge cuts it.
fn ends(line: &[f32], level: f64) -> impl Iterator<Item = f64> + use<> {
    let level = level as f32;
    let crossing = |dark: f32, bright: f32| f64::from((level - dark) / (bright - dark));
    let first = line.iter().position(|dn| *dn > level);
    let last = line.iter().rposition(|dn| *dn > level);
    let rise = first
        .filter(|n| *n > 0)
        .map(|n| n as f64 - 1.0 + crossing(line[n - 1], line[n]));
    let fall = last
        .filter(|n| n + 1 < line.len())
        .map(|n| n as f64 + 1.0 - crossing(line[n + 1], line[n]));
    rise.into_iter().chain(fall)
}

/// The centroid of the light above a level, and its number of pixels.
fn light(frame: &Frame, region: &Region, level: f64, dark_dn: f64) -> (Vector2<f64>, usize) {
    let (mut sum, mut moment, mut count) = (0.0, Vector2::zeros(), 0);
    for y in region.y0..region.y1 {
        let row = frame.row_dn(y, region.x0..region.x1);
        for (x, dn) in (region.x0..)
            .zip(row)
            .filter(|(_, dn)| f64::from(*dn) > level)
        {
            let light = f64::from(dn) - dark_dn;
            sum += light;
            moment += Vector2::new(x as f64, y as f64) * light;
            count += 1;
        }
    }
    (moment / f64::max(sum, f64::MIN_POSITIVE), count)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::Pixels;

    /// A frame whose pixels are lit where a picture has a '#'.
    fn frame(rows: &[&str]) -> Frame {
        let dn = |symbol: u8| if symbol == b'#' { 110 } else { 10 };
        let pixels = rows.iter().flat_map(|row| row.bytes().map(dn)).collect();
        let (width, height) = (rows[0].len(), rows.len());
        Frame::new(width, height, Pixels::U8(pixels), 255, Default::default()).unwrap()
    }

    #[test]
    fn pixels_that_touch_are_one_patch_and_the_largest_is_the_first() {
        let frame = frame(&[
            "#.....###.", //
            "......#.#.",
            "..#.....#.",
            ".#........",
            "..#....##.",
        ]);
        let found = patches(&frame, 60.0).unwrap();
        let sizes: Vec<usize> = found.iter().map(|patch| patch.pixels).collect();
        assert_eq!(sizes, [6, 3, 2, 1]);
        let Region { x0, y0, x1, y1 } = found[0].region;
        assert_eq!((x0, y0, x1, y1), (6, 0, 9, 3));
    }

    #[test]
    fn an_outline_lies_where_rows_and_columns_cross_its_level() {
        let frame = frame(&[
            "........", //
            "........", "..####..", "..####..", "..####..", "........", "........",
        ]);
        let levels = Levels {
            dark_dn: 10.0,
            noise_dn: 1.0,
            saturated_dn: 255.0,
        };
        let patch = patches(&frame, 60.0).unwrap()[0];
        let outline = Outline::of(&frame, &patch, &levels, 6.0);
        assert!(!outline.is_cut);
        assert!((outline.middle - Vector2::new(3.5, 3.0)).norm() < 1e-9);
        // 0.4 of the light: 0.4 px beside the first lit pixel.
        let (left, right) = (1.0 + OUTLINE_SHARE, 6.0 - OUTLINE_SHARE);
        assert_eq!(outline.points.len(), 2 * (3 + 4));
        for point in &outline.points {
            let is_side = (point.x - left).abs() < 1e-5 || (point.x - right).abs() < 1e-5;
            let is_end = (point.y - 1.4).abs() < 1e-5 || (point.y - 4.6).abs() < 1e-5;
            assert!(is_side || is_end, "{point}");
        }
    }
}
