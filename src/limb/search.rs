//! Finding the disc: sparse rows over the whole frame, chords in bright patches, and a circle that most crossings agree on.

use super::chords::{Axis, Line, Scan};
use super::circle::agreed_circle;
use super::{LIMB_DARKENING, LimbSettings};
use crate::frame::{Frame, Levels, Region};
use crate::geometry::Circle;
use crate::reasons::sun;
use crate::units::Rejected;
use nalgebra::Vector2;

/// Maximum number of patches that are tried.
const MOST_PATCHES: usize = 6;
/// More bright runs than this, on average over the rows, rule out a Sun on a dark sky, which has one in every fifth row.
const MOST_RUNS_PER_ROW: usize = 4;
/// Number of lines across a disc, or across the shorter side of a patch.
const LINES_ACROSS: usize = 24;
/// Minimum spacing of lines: nearer lines would sample the same noise twice.
const LEAST_SPACING_PX: usize = 2;
/// A patch wider than this times its height is crossed by columns: few rows would cross its limb.
const WIDE: usize = 2;
/// The level of a part of the disc this bright, relative to the centre, stands for the whole disc.
const HARDLY_DARKER: f64 = 0.95;

/// A search for the disc, whole or in part.
///
/// # Algorithm
/// 1. Widely spaced rows find where the frame is bright: bright runs that touch each other form patches.
/// 2. Each patch, the largest first, is crossed by rows or columns, more closely spaced the smaller it is.
/// 3. The circle that most of their crossings agree on is the disc if it is bright inside and dark around.
/// 4. If the sensor shows only the darker outer part of the disc, steps 2 and 3 are repeated with the threshold of the
///    whole disc.
#[derive(Debug, Clone, Copy)]
pub struct DiscSearch<'a> {
    pub frame: &'a Frame,
    pub levels: &'a Levels,
    /// The expected radius.
    pub radius_px: f64,
    /// Length of a mark from tip to tip.
    pub mark_length_px: f64,
    pub settings: &'a LimbSettings,
}

impl DiscSearch<'_> {
    /// Searches a region of the frame for the disc, to about a pixel.
    pub fn anywhere(&self, region: Region) -> Result<Circle, Rejected> {
        let mut reason = Rejected {
            reason: sun::NO_BRIGHT_PATCH,
            measured: 0.0,
            limit: 1.0,
        };
        let patches = self.bright_patches(region)?; // 1
        for (n, patch) in patches.iter().take(MOST_PATCHES).enumerate() {
            match self.disc_on(&self.grid_over(patch)) {
                Ok(circle) => return Ok(circle),
                Err(rejected) if n == 0 => reason = rejected,
                Err(_) => {}
            }
        }
        Err(reason)
    }

    /// Searches the disc near its previous position: steps 2 to 4, with the region as the patch.
    pub fn near(&self, region: Region) -> Result<Circle, Rejected> {
        self.disc_on(&Grid {
            region,
            spacing_px: (2.0 * self.radius_px) as usize / self.lines_across(),
            axis: Axis::Row,
        })
    }

    /// The bright patches of a region, the largest first.
    fn bright_patches(&self, region: Region) -> Result<Vec<Patch>, Rejected> {
        let scan = self.scan(self.levels);
        let spacing_px = self.spacing_px();
        let rows = (region.y0 + spacing_px / 2..region.y1).step_by(spacing_px);
        let most_runs = MOST_RUNS_PER_ROW * rows.len();
        let (mut patches, mut count) = (Vec::new(), 0);
        let columns = region.x0..region.x1;
        let mut line = Line::new(self.frame, region, Axis::Row);
        for y in rows {
            if !self
                .frame
                .is_brighter(y, columns.clone(), scan.threshold_dn)
            {
                continue;
            }
            line.read(y);
            for run in scan.runs(&line) {
                count += 1;
                let reason = sun::MANY_BRIGHT_PLACES;
                Rejected::at_most(most_runs as f64, count as f64, reason)?;
                let run = Patch {
                    region: Region::sized(region.x0 + run.start, y, run.len(), 1),
                    bright_px: run.len(),
                };
                run.join(&mut patches, scan.max_gap_px, 2 * spacing_px);
            }
        }
        patches.sort_by_key(|patch| std::cmp::Reverse(patch.bright_px));
        Ok(patches)
    }

    fn scan(&self, levels: &Levels) -> Scan {
        let threshold_dn = levels.threshold_dn(self.settings.level_fraction);
        Scan::new(threshold_dn, self.mark_length_px, self.settings)
    }

    fn spacing_px(&self) -> usize {
        self.settings.search_spacing_px.max(1)
    }

    /// Each line crosses the limb at most twice: more required crossings need more lines.
    fn lines_across(&self) -> usize {
        LINES_ACROSS.max(self.settings.min_crossings)
    }

    /// The rows or columns that cross a patch.
    fn grid_over(&self, patch: &Patch) -> Grid {
        // The patch may end anywhere before the next row, and its chords need dark pixels at both ends.
        let margin_px = self.spacing_px() + self.settings.min_run_px;
        let region = patch.grown(margin_px, self.frame);
        let (width, height) = (region.width(), region.height());
        let diameter_px = (2.0 * self.radius_px) as usize;
        Grid {
            region,
            spacing_px: width.min(height).min(diameter_px) / self.lines_across(),
            axis: match width > WIDE * height {
                true => Axis::Column,
                false => Axis::Row,
            },
        }
    }

    /// The disc that a grid crosses; by the threshold of the whole disc if the levels are those of a darker part.
    fn disc_on(&self, grid: &Grid) -> Result<Circle, Rejected> {
        let circle = self.disc_above(grid, self.levels)?;
        let brightest = brightest_seen(&circle, self.frame);
        if brightest > HARDLY_DARKER {
            return Ok(circle);
        }
        let background_dn = self.levels.background_dn;
        let whole = Levels {
            disc_dn: background_dn + (self.levels.disc_dn - background_dn) / brightest,
            ..*self.levels
        };
        Ok(self.disc_above(grid, &whole).unwrap_or(circle)) // 4
    }

    fn disc_above(&self, grid: &Grid, levels: &Levels) -> Result<Circle, Rejected> {
        let scan = self.scan(levels);
        let mut line = Line::new(self.frame, grid.region, grid.axis);
        let mut crossings = Vec::with_capacity(4 * self.lines_across());
        for at in grid.lines() {
            line.read(at);
            crossings.extend(scan.crossings(&line)); // 2
        }
        let circle = agreed_circle(&crossings, self.radius_px, self.settings)?; // 3
        check_filled(self.frame, &circle, scan.threshold_dn)?;
        Ok(circle)
    }
}

/// A set of touching bright runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Patch {
    /// Bounding box of the runs.
    region: Region,
    /// Number of their pixels.
    bright_px: usize,
}

impl Patch {
    /// Adds a run to the patches, and merges all patches that it touches.
    fn join(self, patches: &mut Vec<Self>, gap_px: usize, rows_px: usize) {
        let mut joined = self;
        patches.retain(|patch| {
            let (a, b) = (&patch.region, &self.region);
            let touches = a.x0 <= b.x1 + gap_px && b.x0 <= a.x1 + gap_px && b.y0 < a.y1 + rows_px;
            if touches {
                joined = joined.with(patch);
            }
            !touches
        });
        patches.push(joined);
    }

    fn with(self, other: &Self) -> Self {
        let (a, b) = (self.region, other.region);
        Self {
            region: Region {
                x0: a.x0.min(b.x0),
                y0: a.y0.min(b.y0),
                x1: a.x1.max(b.x1),
                y1: a.y1.max(b.y1),
            },
            bright_px: self.bright_px + other.bright_px,
        }
    }

    /// The patch with a margin, clipped to the frame.
    fn grown(&self, margin_px: usize, frame: &Frame) -> Region {
        let region = self.region;
        Region {
            x0: region.x0.saturating_sub(margin_px),
            y0: region.y0.saturating_sub(margin_px),
            x1: (region.x1 + margin_px).min(frame.width()),
            y1: (region.y1 + margin_px).min(frame.height()),
        }
    }
}

/// Brightness of the brightest visible part of a disc relative to that of its centre.
fn brightest_seen(circle: &Circle, frame: &Frame) -> f64 {
    let centre = circle.centre;
    let nearest = Vector2::new(
        centre.x.clamp(0.0, frame.width() as f64 - 1.0),
        centre.y.clamp(0.0, frame.height() as f64 - 1.0),
    );
    let sine = (nearest - centre).norm() / circle.radius;
    let cosine = (1.0 - sine.powi(2)).max(0.0).sqrt();
    1.0 - LIMB_DARKENING * (1.0 - cosine)
}

/// Rows or columns that cross a region.
struct Grid {
    region: Region,
    spacing_px: usize,
    axis: Axis,
}

impl Grid {
    /// Indices of the rows or columns.
    fn lines(&self) -> impl Iterator<Item = usize> {
        let (spacing, region) = (self.spacing_px.max(LEAST_SPACING_PX), self.region);
        let across = match self.axis {
            Axis::Row => region.y0..region.y1,
            Axis::Column => region.x0..region.x1,
        };
        across.skip(spacing / 2).step_by(spacing)
    }
}

/// Checks that a disc is bright inside and dark around; a circle fitted to noise or to something else is not.
fn check_filled(frame: &Frame, circle: &Circle, threshold_dn: f64) -> Result<(), Rejected> {
    /// Number of pixels that are checked.
    const PIXELS: usize = 400;
    /// Minimum bright fraction: the Moon may cover half of the disc.
    const LEAST_BRIGHT: f64 = 0.45;
    const LEAST_DARK: f64 = 0.8;
    const INSIDE: f64 = 0.95;
    const OUTSIDE: std::ops::Range<f64> = 1.05..1.25;
    let (mut within, mut about) = ([0.0; 2], [0.0; 2]);
    let reach = OUTSIDE.end * circle.radius;
    if let Some(region) = frame.around(circle.centre.into(), reach) {
        let step = (region.width() * region.height() / PIXELS).isqrt().max(1);
        for y in (region.y0..region.y1).step_by(step) {
            for x in (region.x0..region.x1).step_by(step) {
                let out = (Vector2::new(x as f64, y as f64) - circle.centre).norm() / circle.radius;
                let bright = usize::from(f64::from(frame.dn(x, y)) > threshold_dn);
                if out < INSIDE {
                    within[bright] += 1.0;
                } else if OUTSIDE.contains(&out) {
                    about[bright] += 1.0;
                }
            }
        }
    }
    let share = |right: f64, [dark, bright]: [f64; 2]| right / (dark + bright).max(1.0);
    let reason = sun::DARK_INSIDE;
    Rejected::at_least(LEAST_BRIGHT, share(within[1], within), reason)?;
    let reason = sun::BRIGHT_OUTSIDE;
    Rejected::at_least(LEAST_DARK, share(about[0], about), reason)
}
