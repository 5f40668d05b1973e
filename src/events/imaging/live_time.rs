//! Exposure map: time for which each pixel was in the field of a live detector with a valid pointing.

use super::grid::Grid;
use crate::events::detectors::FromBoresight;
use crate::pointing_history::PointingHistory;
use nalgebra::Vector3;

/// The field is evaluated at the ends of pieces of at most this length, s: swings take seconds.
const PIECE_S: f64 = 0.1;
/// Greatest motion of the field in each part of a piece, px.
const STEP_PX: f64 = 0.5;
/// Greatest number of parts in a piece: in a slew of a degree per second each is a tenth of a pixel of 5 arcsec long.
const MOST_PARTS: f64 = 1000.0;

/// The corners of a detector's field, in order.
pub type Corners = [FromBoresight; 4];

/// A map under construction.
pub struct LiveTime<'a> {
    grid: &'a Grid,
    /// Differences of the time between neighbouring pixels of each row, s.
    changes_s: Vec<f64>,
}

impl<'a> LiveTime<'a> {
    pub fn new(grid: &'a Grid) -> Self {
        Self {
            grid,
            changes_s: vec![0.0; (grid.width_px + 2) * grid.height_px],
        }
    }

    /// Adds an interval in which a detector was live for a fraction of the time.
    pub fn add(
        &mut self,
        history: &PointingHistory,
        corners: &Corners,
        [start_s, stop_s]: [f64; 2],
        live_fraction: f64,
    ) {
        let pieces = ((stop_s - start_s) / PIECE_S).ceil().max(1.0);
        let piece_s = (stop_s - start_s) / pieces;
        for n in 0..pieces as u64 {
            let from_s = start_s + n as f64 * piece_s;
            let ends = [from_s, from_s + piece_s].map(|at| self.outline_px(history, corners, at));
            let parts = match ends {
                [Some(from), Some(to)] => (moved_px(&from, &to) / STEP_PX).ceil(),
                _ => 1.0,
            };
            let parts = parts.clamp(1.0, MOST_PARTS);
            let part_s = piece_s / parts;
            for m in 0..parts as u64 {
                let middle_s = from_s + (m as f64 + 0.5) * part_s;
                if let Some(outline) = self.outline_px(history, corners, middle_s) {
                    self.fill(&outline, part_s * live_fraction);
                }
            }
        }
    }

    /// The outline of a field on the image; straight lines remain straight in tangent planes of the sky.
    fn outline_px(
        &self,
        history: &PointingHistory,
        corners: &Corners,
        unix_s: f64,
    ) -> Option<[[f64; 2]; 4]> {
        let line_of_sight = history.at(unix_s).line_of_sight?;
        let mut outline = [[0.0; 2]; 4];
        for (corner, place) in corners.iter().zip(&mut outline) {
            let towards = Vector3::new(1.0, corner.right_rad, -corner.up_rad);
            *place = self
                .grid
                .place_px(&(line_of_sight.sun_from_telescope * towards))?;
        }
        Some(outline)
    }

    /// Adds a time to the pixels within a convex outline, in proportion for pixels cut by its left or right edge.
    fn fill(&mut self, outline: &[[f64; 2]; 4], seconds: f64) {
        let rows = outline.iter().map(|[_, y]| *y);
        let (low, high) = rows.fold((f64::MAX, f64::MIN), |(low, high), y| {
            (low.min(y), high.max(y))
        });
        let first = low.ceil().max(0.0) as usize;
        let end = (high.floor() + 1.0).clamp(0.0, self.grid.height_px as f64) as usize;
        for row in first..end {
            let (mut left, mut right) = (f64::MAX, f64::MIN);
            for (n, [x, y]) in outline.iter().enumerate() {
                let [next_x, next_y] = outline[(n + 1) % 4];
                let at = row as f64;
                if (*y <= at) != (next_y <= at) {
                    let crossing = x + (at - y) / (next_y - y) * (next_x - x);
                    (left, right) = (left.min(crossing), right.max(crossing));
                }
            }
            if left < right {
                self.change(row, left, seconds);
                self.change(row, right, -seconds);
            }
        }
    }

    /// Increases the time of a row from a position on.
    fn change(&mut self, row: usize, from_px: f64, seconds: f64) {
        let from = (from_px + 0.5).clamp(0.0, self.grid.width_px as f64);
        let (pixel, part) = (from.floor(), from.fract());
        let at = row * (self.grid.width_px + 2) + pixel as usize;
        self.changes_s[at] += seconds * (1.0 - part);
        self.changes_s[at + 1] += seconds * part;
    }

    /// The time of each pixel, s, row by row.
    pub fn finish(self) -> Vec<f32> {
        let width = self.grid.width_px;
        let rows = self.changes_s.chunks_exact(width + 2);
        let along = |row: &[f64]| {
            let times = row[..width].iter().scan(0.0, |sum, change| {
                *sum += change;
                // Suppress rounding errors of the sums where the time is zero.
                Some(if *sum > 1e-9 { *sum as f32 } else { 0.0 })
            });
            times.collect::<Vec<f32>>()
        };
        rows.flat_map(along).collect()
    }
}

/// Displacement of the corner that moves most.
fn moved_px(from: &[[f64; 2]; 4], to: &[[f64; 2]; 4]) -> f64 {
    let moved = from
        .iter()
        .zip(to)
        .map(|(from, to)| (to[0] - from[0]).hypot(to[1] - from[1]));
    moved.fold(0.0, f64::max)
}
