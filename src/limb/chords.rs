//! Chords: bright runs of rows and columns of the sensor, and their crossings with the limb.
//!
//! A chord is a bright run after hot pixels and marks are removed (Cramer 2014, table 8). A chord that runs into the
//! sensor's edge keeps its one visible crossing.

use super::LimbSettings;
use crate::frame::{Frame, Region};
use nalgebra::Vector2;
use std::ops::Range;

/// The direction of a chord.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Axis {
    Row,
    Column,
}

/// Position where a chord crosses the limb, with the unit vector along the chord into the disc.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Crossing {
    pub at: Vector2<f64>,
    pub inward: Vector2<f64>,
}

/// The pixels of a row or a column within a region, one line after the other.
pub(super) struct Line<'a> {
    frame: &'a Frame,
    region: Region,
    axis: Axis,
    /// Row or column of the frame.
    at: usize,
    dn: Vec<f32>,
}

impl<'a> Line<'a> {
    pub(super) fn new(frame: &'a Frame, region: Region, axis: Axis) -> Self {
        Self {
            frame,
            region,
            axis,
            at: 0,
            dn: Vec::new(),
        }
    }

    /// Reads a row or column of the frame.
    pub(super) fn read(&mut self, at: usize) {
        let Region { x0, y0, x1, y1 } = self.region;
        self.at = at;
        match self.axis {
            Axis::Row => self.frame.read_row(at, x0..x1, &mut self.dn),
            Axis::Column => self.frame.read_column(at, y0..y1, &mut self.dn),
        }
    }
}

/// Settings of chords: the threshold, and the minimum and maximum lengths.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Scan {
    pub threshold_dn: f64,
    /// Shorter bright runs are hot pixels and noise.
    pub min_run_px: usize,
    /// Shorter dark gaps are marks and are filled.
    pub max_gap_px: usize,
    /// Shorter runs are not part of the disc, unless the line's end cuts them.
    pub min_chord_px: usize,
}

impl Scan {
    /// A scan for a threshold and a mark's length from tip to tip, px.
    pub(super) fn new(threshold_dn: f64, mark_length_px: f64, settings: &LimbSettings) -> Self {
        /// A mark rotated by 45 deg is longer by this factor, and so is its blur.
        const LONGEST: f64 = 1.3;
        let gap = (LONGEST * mark_length_px).ceil() as usize;
        Self {
            threshold_dn,
            min_run_px: settings.min_run_px,
            max_gap_px: gap,
            min_chord_px: gap,
        }
    }

    /// Bright runs of a line, counted from its first pixel. Hot pixels are removed and marks filled in.
    pub(super) fn runs<'l>(&self, line: &'l Line<'_>) -> impl Iterator<Item = Range<usize>> + 'l {
        let Self {
            threshold_dn,
            min_run_px,
            max_gap_px,
            ..
        } = *self;
        let bright = move |dn: &f32| f64::from(*dn) > threshold_dn;
        let mut at = 0;
        let mut plain = std::iter::from_fn(move || {
            let start = first(&line.dn, at, bright)?;
            at = first(&line.dn, start, |dn| !bright(dn)).unwrap_or(line.dn.len());
            Some(start..at)
        });
        let mut plain =
            std::iter::from_fn(move || plain.find(|run| run.len() >= min_run_px)).peekable();
        std::iter::from_fn(move || {
            let mut run = plain.next()?;
            while let Some(next) = plain.next_if(|next| next.start - run.end <= max_gap_px) {
                run.end = next.end;
            }
            Some(run)
        })
    }

    /// The crossings of a line's chords.
    pub(super) fn crossings(&self, line: &Line<'_>) -> impl Iterator<Item = Crossing> {
        let chords = self.runs(line).filter(|run| {
            let cut = run.start == 0 || run.end == line.dn.len();
            cut || run.len() >= self.min_chord_px
        });
        chords.flat_map(|run| {
            let ends = [(run.start, 1.0), (run.end, -1.0)];
            ends.map(|(end, inward)| self.crossing(line, end, inward))
                .into_iter()
                .flatten()
        })
    }

    /// Position where the straight line through four pixels meets the threshold; `first_after` is the first pixel beyond
    /// it. The window is centred again once, since noise may have shifted the first guess. `inward` is 1 if brightness
    /// rises along the line and -1 if it falls. `None` if the line ends.
    fn crossing(&self, line: &Line<'_>, first_after: usize, inward: f64) -> Option<Crossing> {
        let mut first_after = first_after;
        let mut along = None;
        for _ in 0..2 {
            let window = line.dn.get(first_after.checked_sub(2)?..first_after + 2)?;
            let mean = window.iter().sum::<f32>() / 4.0;
            let slope = 0.3 * (window[3] - window[0]) + 0.1 * (window[2] - window[1]);
            let from_middle = (self.threshold_dn - f64::from(mean)) / f64::from(slope);
            let rises_inward = f64::from(slope) * inward > 0.0;
            if !rises_inward || from_middle.abs() > 2.0 {
                return None;
            }
            let place = first_after as f64 - 0.5 + from_middle;
            first_after = (place + 1.0).max(0.0) as usize;
            along = Some(place);
        }
        let (along, across) = (along?, line.at as f64);
        let from = Vector2::new(line.region.x0 as f64, line.region.y0 as f64);
        Some(match line.axis {
            Axis::Row => Crossing {
                at: Vector2::new(from.x + along, across),
                inward: Vector2::new(inward, 0.0),
            },
            Axis::Column => Crossing {
                at: Vector2::new(across, from.y + along),
                inward: Vector2::new(0.0, inward),
            },
        })
    }
}

/// The first pixel at or after `from` that fulfils the condition. Most of a line is dark: groups without such a pixel are
/// skipped.
fn first(dn: &[f32], from: usize, wanted: impl Fn(&f32) -> bool) -> Option<usize> {
    const GROUP: usize = 16;
    let any = |group: &[f32]| group.iter().fold(false, |any, dn| any | wanted(dn));
    let passed = dn[from..].chunks(GROUP).position(any)? * GROUP;
    let within = dn[from + passed..].iter().position(&wanted)?;
    Some(from + passed + within)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::{FrameInfo, Pixels};

    const SCAN: Scan = Scan {
        threshold_dn: 50.0,
        min_run_px: 4,
        max_gap_px: 20,
        min_chord_px: 20,
    };

    fn with_line<T>(row: &[u8], read: impl Fn(&Line<'_>) -> T) -> T {
        let pixels = Pixels::U8(row.to_vec());
        let frame = Frame::new(row.len(), 1, pixels, 255, FrameInfo::default()).unwrap();
        let mut line = Line::new(&frame, frame.region(), Axis::Row);
        line.read(0);
        read(&line)
    }

    fn crossings(row: &[u8]) -> Vec<f64> {
        with_line(row, |line| SCAN.crossings(line).map(|c| c.at.x).collect())
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
        assert!((found[0] - 40.5).abs() < 1e-6 && (found[1] - 102.5).abs() < 1e-6);
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

    #[test]
    fn runs_are_those_that_are_long_enough_with_their_short_gaps_filled() {
        let lit = [3..30, 50..56, 120..123, 125..135, 190..320, 331..333];
        let bright = |n: &usize| lit.iter().any(|run| run.contains(n));
        let row: Vec<u8> = (0..333).map(|n| if bright(&n) { 90 } else { 40 }).collect();
        let scan = Scan {
            max_gap_px: 5,
            ..SCAN
        };
        let runs = with_line(&row, |line| scan.runs(line).collect::<Vec<_>>());
        assert_eq!(runs, [3..30, 50..56, 125..135, 190..320]);
    }
}
