//! Chords: rows and columns of the sensor, and where they cross the limb.
//!
//! A chord is what is left of a bright run when hot pixels and marks are taken out (Cramer 2014, table 8); one that
//! runs into the sensor's edge keeps the crossing that is seen.

use super::Settings;
use super::bright::{Runs, Whole};
use crate::frame::{Region, View};
use crate::units::SensorPx;
use nalgebra::Vector2;

/// The direction of a chord.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Axis {
    Row,
    Column,
}

/// Which end of a chord a crossing is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Edge {
    /// Brightness rises along the chord: it enters the disc.
    Entering,
    /// Brightness falls along the chord: it leaves the disc.
    Leaving,
}

/// A sub-pixel place where a chord crosses the limb.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Crossing {
    pub at: SensorPx,
    pub axis: Axis,
    pub edge: Edge,
}

impl Crossing {
    /// Unit vector along the chord, into the disc.
    pub(super) fn inward(&self) -> Vector2<f64> {
        let sign = match self.edge {
            Edge::Entering => 1.0,
            Edge::Leaving => -1.0,
        };
        match self.axis {
            Axis::Row => Vector2::new(sign, 0.0),
            Axis::Column => Vector2::new(0.0, sign),
        }
    }
}

/// What makes a chord: the threshold, and the lengths of what is no disc.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Scan {
    pub threshold_dn: f64,
    /// Shorter bright runs are hot pixels and noise.
    pub min_run_px: usize,
    /// Shorter dark gaps are marks.
    pub max_gap_px: usize,
    /// Shorter runs that are left are no disc, unless the sensor cuts them.
    pub min_chord_px: usize,
}

impl Scan {
    /// A scan for a threshold and a mark's length from tip to tip, px.
    pub(super) fn new(threshold_dn: f64, mark_length_px: f64, settings: &Settings) -> Self {
        let gap = (1.3 * mark_length_px).ceil() as usize;
        Self {
            threshold_dn,
            min_run_px: settings.min_run_px,
            max_gap_px: gap,
            min_chord_px: gap,
        }
    }

    pub(super) fn runs(&self) -> Runs {
        Runs::new(self.min_run_px, self.max_gap_px)
    }

    /// The crossings of the given rows or columns, within a region.
    pub(super) fn run<T: Whole>(
        &self,
        view: &View<'_, T>,
        region: Region,
        axis: Axis,
        lines: impl Iterator<Item = usize>,
    ) -> Vec<Crossing> {
        let floor = T::floor(self.threshold_dn);
        let mut crossings = Vec::new();
        let mut runs = self.runs();
        let mut column = Vec::new();
        for at in lines {
            let line = Line { view, axis, at };
            match axis {
                Axis::Row => {
                    let row = &view.pixels[at * view.width..][..region.x1];
                    runs.find(&row[region.x0..], region.x0, floor);
                }
                Axis::Column => {
                    let rows = view.pixels.chunks_exact(view.width);
                    let rows = rows.skip(region.y0).take(region.height());
                    column.clear();
                    column.extend(rows.map(|row| row[at]));
                    runs.find(&column, region.y0, floor);
                }
            }
            self.add_crossings(&line, &runs.found, &mut crossings);
        }
        crossings
    }

    /// The crossings of those runs of a line that are chords.
    fn add_crossings<T: Whole>(
        &self,
        line: &Line<'_, T>,
        runs: &[(usize, usize)],
        crossings: &mut Vec<Crossing>,
    ) {
        // A run that the sensor cuts may be short and yet a chord of the disc.
        let chord = |(first, end): &(usize, usize)| {
            *first == 0 || *end == line.end() || end - first >= self.min_chord_px
        };
        for (start, end) in runs.iter().copied().filter(chord) {
            for (edge, first_after) in [(Edge::Entering, start), (Edge::Leaving, end)] {
                if let Some(along) = self.cross(line, edge, first_after) {
                    crossings.push(line.crossing(along, edge));
                }
            }
        }
    }

    /// Where a straight line through the four pixels about a threshold crossing meets the threshold; the window is
    /// centred anew once, since noise may have moved the first guess. `None` where the sensor ends.
    fn cross<T: Whole>(&self, line: &Line<'_, T>, edge: Edge, first_after: usize) -> Option<f64> {
        let mut first_after = first_after;
        let mut refined = None;
        for _ in 0..2 {
            if first_after < 2 || first_after + 2 > line.end() {
                return None;
            }
            let window: [f64; 4] = std::array::from_fn(|k| line.dn(first_after - 2 + k));
            let mean = window.iter().sum::<f64>() / 4.0;
            let slope =
                (-1.5 * window[0] - 0.5 * window[1] + 0.5 * window[2] + 1.5 * window[3]) / 5.0;
            let rises = slope > 0.0;
            if rises != (edge == Edge::Entering) {
                return None;
            }
            let from_middle = (self.threshold_dn - mean) / slope;
            if from_middle.abs() > 2.0 {
                return None;
            }
            let along = first_after as f64 - 0.5 + from_middle;
            refined = Some(along);
            first_after = (along + 1.0).max(0.0) as usize;
        }
        refined
    }
}

/// A row or a column of the sensor.
struct Line<'a, T> {
    view: &'a View<'a, T>,
    axis: Axis,
    at: usize,
}

impl<T: Whole> Line<'_, T> {
    /// The pixel after its last.
    fn end(&self) -> usize {
        match self.axis {
            Axis::Row => self.view.width,
            Axis::Column => self.view.height,
        }
    }

    fn dn(&self, along: usize) -> f64 {
        f64::from(match self.axis {
            Axis::Row => self.view.dn(along, self.at),
            Axis::Column => self.view.dn(self.at, along),
        })
    }

    fn crossing(&self, along: f64, edge: Edge) -> Crossing {
        let at = match self.axis {
            Axis::Row => SensorPx::new(along, self.at as f64),
            Axis::Column => SensorPx::new(self.at as f64, along),
        };
        Crossing {
            at,
            axis: self.axis,
            edge,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SCAN: Scan = Scan {
        threshold_dn: 50.0,
        min_run_px: 4,
        max_gap_px: 20,
        min_chord_px: 20,
    };

    fn crossings(row: &[u8]) -> Vec<f64> {
        let view = View {
            width: row.len(),
            height: 1,
            pixels: row,
        };
        let region = Region {
            x0: 0,
            y0: 0,
            x1: row.len(),
            y1: 1,
        };
        let crossings = SCAN.run(&view, region, Axis::Row, 0..1);
        crossings.iter().map(|c| c.at.x).collect()
    }

    fn disc_row() -> Vec<u8> {
        let mut row = vec![0; 40];
        row.extend([25, 75]);
        row.extend([100; 60]);
        row.extend([75, 25]);
        row.extend([0; 40]);
        row
    }

    #[test]
    fn a_chord_crosses_where_the_straight_edge_meets_the_threshold() {
        let found = crossings(&disc_row());
        assert_eq!(found.len(), 2);
        assert!((found[0] - 40.5).abs() < 1e-9 && (found[1] - 102.5).abs() < 1e-9);
    }

    #[test]
    fn marks_and_hot_pixels_do_not_break_a_chord() {
        let clean = crossings(&disc_row());
        let mut row = disc_row();
        row[60..75].fill(10);
        row[10] = 255;
        row[130] = 255;
        assert_eq!(crossings(&row), clean);
    }

    #[test]
    fn a_chord_cut_by_the_sensor_keeps_the_edge_that_is_seen() {
        let row = disc_row();
        assert_eq!(crossings(&row[..80]), crossings(&row)[..1]);
    }

    #[test]
    fn two_discs_have_four_crossings() {
        let mut row = disc_row();
        row.extend(disc_row());
        assert_eq!(crossings(&row).len(), 4);
    }

    #[test]
    fn a_short_chord_counts_where_the_sensor_cuts_it_and_nowhere_else() {
        let mut row = disc_row();
        row.drain(..95);
        assert_eq!(crossings(&row).len(), 1);
        row.insert(0, 0);
        assert!(crossings(&row).is_empty());
    }
}
