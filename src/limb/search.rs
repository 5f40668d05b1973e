//! Finding the disc: sparse rows over the whole frame, chords where it is bright, and a circle that most crossings
//! agree on.

use super::bright::Whole;
use super::chords::{Axis, Crossing, Scan};
use super::consensus::agreed_circle;
use super::patches::{Patch, bright_patches};
use super::{LIMB_DARKENING, Settings};
use crate::frame::{Frame, Levels, Region, View};
use crate::geometry::Circle;
use crate::units::{Rejected, SensorPx};
use crate::with_view;
use nalgebra::Vector2;

/// The disc as the sparse chords see it, to a pixel or so.
#[derive(Debug, Clone, PartialEq)]
pub struct CoarseDisc {
    pub centre: SensorPx,
    pub radius_px: f64,
}

impl CoarseDisc {
    pub fn circle(&self) -> Circle {
        Circle {
            centre: self.centre.vector(),
            radius: self.radius_px,
        }
    }
}

impl From<Circle> for CoarseDisc {
    fn from(circle: Circle) -> Self {
        Self {
            centre: circle.centre.into(),
            radius_px: circle.radius,
        }
    }
}

/// Patches that are looked at.
const MOST_PATCHES: usize = 6;
/// Lines across a disc, or across the shorter side of a patch.
const LINES_ACROSS: usize = 24;
/// Lines are no nearer to each other than this: what is between is the same noise twice.
const LEAST_SPACING_PX: usize = 2;
/// A patch this much wider than high is crossed by columns: rows would hardly cross its limb.
const WIDE: usize = 2;

/// A search for the disc, whole or in part.
///
/// # Algorithm
/// 1. Rows far apart tell where the frame is bright.
/// 2. Each bright patch, the largest first, is crossed by rows or columns: the smaller it is, the nearer they lie.
/// 3. The circle that most of their crossings agree on is the disc if it is bright within and dark about.
/// 4. Where the sensor shows only the darker outside of the disc, 2 and 3 again with the threshold that the whole
///    disc would have had.
#[derive(Debug, Clone, Copy)]
pub struct DiscSearch<'a> {
    pub frame: &'a Frame,
    pub levels: &'a Levels,
    /// The expected radius.
    pub radius_px: f64,
    /// A mark from tip to tip.
    pub mark_length_px: f64,
    pub settings: &'a Settings,
}

impl DiscSearch<'_> {
    /// Looks for the disc everywhere in a region of the frame.
    pub fn anywhere(&self, region: Region) -> Result<CoarseDisc, Rejected> {
        Ok(with_view!(self.frame, view => self.in_patches(&view, region))?.into())
    }

    /// Looks for the disc in a region about the place where it was: steps 2 to 4, the region for a patch.
    pub fn near(&self, region: Region) -> Result<CoarseDisc, Rejected> {
        let grid = Grid {
            region,
            spacing_px: (2.0 * self.radius_px) as usize / self.lines_across(),
            axis: Axis::Row,
        };
        Ok(with_view!(self.frame, view => self.disc_on(&view, &grid))?.into())
    }

    fn in_patches<T: Whole>(&self, view: &View<'_, T>, region: Region) -> Result<Circle, Rejected> {
        let scan = self.scan(self.levels);
        let patches = bright_patches(view, region, &scan, self.spacing_px())?; // 1
        let mut reason = Rejected {
            reason: "nothing is as bright and as wide as a disc",
            measured: 0.0,
            limit: 1.0,
        };
        for (n, patch) in patches.iter().take(MOST_PATCHES).enumerate() {
            match self.disc_on(view, &self.grid_over(view, patch)) {
                Ok(circle) => return Ok(circle),
                Err(rejected) if n == 0 => reason = rejected,
                Err(_) => {}
            }
        }
        Err(reason)
    }

    fn scan(&self, levels: &Levels) -> Scan {
        let threshold_dn = levels.threshold_dn(self.settings.level_fraction);
        Scan::new(threshold_dn, self.mark_length_px, self.settings)
    }

    fn spacing_px(&self) -> usize {
        self.settings.search_spacing_px.max(1)
    }

    /// Each line crosses the limb twice at the most: where many crossings are asked for, so are lines.
    fn lines_across(&self) -> usize {
        LINES_ACROSS.max(self.settings.min_crossings)
    }

    /// The rows or columns that cross a patch.
    fn grid_over<T: Whole>(&self, view: &View<'_, T>, patch: &Patch) -> Grid {
        // The patch may end anywhere before the next row, and its chords need dark pixels at their ends.
        let margin_px = self.spacing_px() + self.settings.min_run_px;
        let region = patch.grown(margin_px, view.width, view.height);
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

    fn disc_in<T: Whole>(
        &self,
        view: &View<'_, T>,
        grid: &Grid,
        scan: &Scan,
    ) -> Result<Circle, Rejected> {
        let crossings = grid.crossings(view, scan); // 2
        let circle = agreed_circle(&crossings, self.radius_px, self.settings)?; // 3
        check_filled(view, &circle, scan.threshold_dn)?;
        Ok(circle)
    }

    /// The disc that a grid crosses.
    fn disc_on<T: Whole>(&self, view: &View<'_, T>, grid: &Grid) -> Result<Circle, Rejected> {
        let circle = self.disc_in(view, grid, &self.scan(self.levels))?;
        Ok(self.with_whole_levels(view, grid, circle))
    }

    /// The disc by the threshold of the whole disc, where the levels are those of a darker part; else as it was. 4
    fn with_whole_levels<T: Whole>(
        &self,
        view: &View<'_, T>,
        grid: &Grid,
        circle: Circle,
    ) -> Circle {
        const HARDLY_DARKER: f64 = 0.95;
        let brightest = brightest_seen(&circle, view.width, view.height);
        if brightest > HARDLY_DARKER {
            return circle;
        }
        let background_dn = self.levels.background_dn;
        let levels = Levels {
            disc_dn: background_dn + (self.levels.disc_dn - background_dn) / brightest,
            ..*self.levels
        };
        self.disc_in(view, grid, &self.scan(&levels))
            .unwrap_or(circle)
    }
}

/// Light of the brightest part of a disc that a sensor of `width` x `height` shows, relative to that of its middle.
fn brightest_seen(circle: &Circle, width: usize, height: usize) -> f64 {
    let centre = circle.centre;
    let nearest = Vector2::new(
        centre.x.clamp(0.0, width as f64 - 1.0),
        centre.y.clamp(0.0, height as f64 - 1.0),
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
    /// Their crossings with the edge of what is bright.
    fn crossings<T: Whole>(&self, view: &View<'_, T>, scan: &Scan) -> Vec<Crossing> {
        let (spacing, region) = (self.spacing_px.max(LEAST_SPACING_PX), self.region);
        let across = match self.axis {
            Axis::Row => region.y0..region.y1,
            Axis::Column => region.x0..region.x1,
        };
        let lines = across.skip(spacing / 2).step_by(spacing);
        scan.run(view, region, self.axis, lines)
    }
}

/// A disc is bright within and dark about: a circle of noise, or one drawn through anything else, is not.
fn check_filled<T: Whole>(
    view: &View<'_, T>,
    circle: &Circle,
    threshold_dn: f64,
) -> Result<(), Rejected> {
    const PIXELS: usize = 400;
    const LEAST_RIGHT: f64 = 0.8;
    let floor = T::floor(threshold_dn);
    let [inside, rim, outside] = [0.95, 1.05, 1.25].map(|part| (part * circle.radius).powi(2));
    let (mut within, mut about) = (Share::default(), Share::default());
    let reach = 1.25 * circle.radius;
    if let Some(region) = Region::around(circle.centre.into(), reach, view.width, view.height) {
        let step = (region.width() * region.height() / PIXELS).isqrt().max(1);
        for y in (region.y0..region.y1).step_by(step) {
            let row = &view.pixels[y * view.width..][..region.x1];
            let dy2 = (y as f64 - circle.centre.y).powi(2);
            for (n, pixel) in row[region.x0..].iter().step_by(step).enumerate() {
                let x = (region.x0 + n * step) as f64;
                let out2 = (x - circle.centre.x).powi(2) + dy2;
                if out2 < inside {
                    within.count(*pixel > floor);
                } else if (rim..outside).contains(&out2) {
                    about.count(*pixel <= floor);
                }
            }
        }
    }
    for (share, reason) in [
        (within, "the disc is not bright within"),
        (about, "the disc is not dark about"),
    ] {
        if share.right() < LEAST_RIGHT {
            return Err(Rejected {
                reason,
                measured: share.right(),
                limit: LEAST_RIGHT,
            });
        }
    }
    Ok(())
}

/// How many pixels were looked at, and how many are as they should be.
#[derive(Default)]
struct Share {
    seen: usize,
    right: usize,
}

impl Share {
    fn count(&mut self, right: bool) {
        self.seen += 1;
        self.right += usize::from(right);
    }

    /// The part that is right; of nothing, nothing is.
    fn right(&self) -> f64 {
        self.right as f64 / self.seen.max(1) as f64
    }
}
