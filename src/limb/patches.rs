//! Where a frame is bright: rows far apart, and their bright runs joined to patches, each of which may be the disc.

use super::bright::Whole;
use super::chords::Scan;
use crate::frame::{Region, View};
use crate::units::Rejected;

/// More bright runs than this, on average over the rows, are no Sun on a dark sky: it has one in every fifth row.
const MOST_RUNS_PER_ROW: usize = 4;

/// Bright runs that touch each other.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Patch {
    /// The smallest region that holds them.
    pub region: Region,
    /// Their pixels.
    pub bright_px: usize,
}

/// The bright patches of a region, the largest first.
pub(super) fn bright_patches<T: Whole>(
    view: &View<'_, T>,
    region: Region,
    scan: &Scan,
    spacing_px: usize,
) -> Result<Vec<Patch>, Rejected> {
    let floor = T::floor(scan.threshold_dn);
    let mut patches: Vec<Patch> = Vec::new();
    let mut runs = scan.runs();
    let rows = (region.y0 + spacing_px / 2..region.y1).step_by(spacing_px);
    let most_runs = MOST_RUNS_PER_ROW * rows.len();
    let mut count = 0;
    for y in rows {
        let row = &view.pixels[y * view.width..][region.x0..region.x1];
        runs.find(row, region.x0, floor);
        count += runs.found.len();
        if count > most_runs {
            return Err(Rejected {
                reason: "the frame is bright in too many places",
                measured: count as f64,
                limit: most_runs as f64,
            });
        }
        for &(x0, x1) in &runs.found {
            let run = Patch {
                region: Region {
                    x0,
                    x1,
                    y0: y,
                    y1: y + 1,
                },
                bright_px: x1 - x0,
            };
            join(&mut patches, run, scan.max_gap_px, 2 * spacing_px);
        }
    }
    patches.sort_by_key(|patch| std::cmp::Reverse(patch.bright_px));
    Ok(patches)
}

/// Adds a run to the patches, and makes one of all those that it touches.
fn join(patches: &mut Vec<Patch>, run: Patch, gap_px: usize, rows_px: usize) {
    let mut joined = run;
    patches.retain(|patch| {
        let (a, b) = (&patch.region, &run.region);
        let touches = a.x0 <= b.x1 + gap_px && b.x0 <= a.x1 + gap_px && b.y0 < a.y1 + rows_px;
        if touches {
            joined = joined.with(patch);
        }
        !touches
    });
    patches.push(joined);
}

impl Patch {
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

    /// The patch with a margin about it, as far as a sensor of `width` x `height` goes.
    pub(super) fn grown(&self, margin_px: usize, width: usize, height: usize) -> Region {
        let region = self.region;
        Region {
            x0: region.x0.saturating_sub(margin_px),
            y0: region.y0.saturating_sub(margin_px),
            x1: (region.x1 + margin_px).min(width),
            y1: (region.y1 + margin_px).min(height),
        }
    }
}
