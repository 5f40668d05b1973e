//! Reduction of long series that preserves extreme values.

use crate::estimation::median;
use std::collections::{BTreeMap, BTreeSet, HashSet};

/// Points further apart than this multiple of the median step are not joined: frames are missing between them.
const GAP_STEPS: f64 = 3.0;

/// Splits points into runs without gaps and without values that are not finite.
pub(super) fn runs(points: &[(f64, f64)]) -> Vec<Vec<(f64, f64)>> {
    let longest = longest_step(points.iter().map(|point| point.0));
    let finite = |point: &(f64, f64)| point.0.is_finite() && point.1.is_finite();
    let joined =
        |a: &(f64, f64), b: &(f64, f64)| finite(a) && finite(b) && (b.0 - a.0).abs() <= longest;
    let runs = points.chunk_by(joined).filter(|run| finite(&run[0]));
    runs.map(<[_]>::to_vec).collect()
}

/// Longer steps are gaps.
pub(super) fn longest_step(times: impl Iterator<Item = f64> + Clone) -> f64 {
    let steps = times
        .clone()
        .skip(1)
        .zip(times)
        .map(|(next, one)| next - one);
    median(steps.filter(|s| *s > 0.0)).map_or(f64::INFINITY, |s| GAP_STEPS * s)
}

/// The points of one column of pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Column {
    pub x: f64,
    pub least: f64,
    pub most: f64,
    pub median: f64,
}

/// Reduces points on the sheet, px, to columns of pixels with the least, the greatest and the median value of each.
pub(super) fn columns(points: impl Iterator<Item = (f64, f64)>) -> Vec<Column> {
    let mut columns: BTreeMap<i64, Vec<f64>> = BTreeMap::new();
    for (x, y) in points {
        columns.entry(x.floor() as i64).or_default().push(y);
    }
    let column = |(x, ys): (i64, Vec<f64>)| Column {
        x: x as f64 + 0.5,
        least: ys.iter().copied().fold(f64::INFINITY, f64::min),
        most: ys.iter().copied().fold(f64::NEG_INFINITY, f64::max),
        median: median(ys).unwrap_or_default(),
    };
    columns.into_iter().map(column).collect()
}

/// Points on the sheet, px, rounded to half a pixel, without duplicates.
pub(super) fn distinct(points: impl Iterator<Item = (f64, f64)>) -> Vec<(f64, f64)> {
    let half = |v: f64| (2.0 * v).round() as i64;
    let distinct: BTreeSet<(i64, i64)> = points.map(|(x, y)| (half(x), half(y))).collect();
    let back = |(x, y): (i64, i64)| (x as f64 / 2.0, y as f64 / 2.0);
    distinct.into_iter().map(back).collect()
}

/// A piece of a line on the sheet, px, and its shade.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Piece<S> {
    pub from: (f64, f64),
    pub to: (f64, f64),
    pub shade: S,
}

/// Width of a line of pieces, px.
pub(super) const PIECE_PX: f64 = 2.0;

/// Pieces in drawing order, without those covered by later ones: at most as many remain as the panel has squares of a line's width,
/// however long the path is.
pub(super) fn uncovered<S>(pieces: Vec<Piece<S>>) -> Vec<Piece<S>> {
    let mut covered = HashSet::new();
    let mut is_new = |piece: &Piece<S>| {
        let (from, to) = (piece.from, piece.to);
        let steps = ((to.0 - from.0).hypot(to.1 - from.1) / PIECE_PX)
            .ceil()
            .max(1.0);
        let square = |n: u32| {
            let part = f64::from(n) / steps;
            let at = [
                from.0 + part * (to.0 - from.0),
                from.1 + part * (to.1 - from.1),
            ];
            at.map(|px| (px / PIECE_PX) as i32)
        };
        let new = (0..=steps as u32).filter(|n| covered.insert(square(*n)));
        new.count() > 0
    };
    let mut left: Vec<Piece<S>> = pieces.into_iter().rev().filter(|p| is_new(p)).collect();
    left.reverse();
    left
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_end_at_gaps_and_at_what_is_no_number() {
        let points = [0.0, 1.0, 2.0, 30.0, 31.0, 32.0, 33.0].map(|x| (x, 1.0));
        let lengths =
            |points: &[(f64, f64)]| -> Vec<usize> { runs(points).iter().map(Vec::len).collect() };
        assert_eq!(lengths(&points), [3, 4]);
        let mut broken = points;
        broken[5].1 = f64::NAN;
        assert_eq!(lengths(&broken), [3, 2, 1]);
        assert_eq!(lengths(&[(0.0, 1.0), (100.0, 1.0)]), [2]);
    }

    #[test]
    fn a_column_keeps_its_least_and_most() {
        let points = [(3.2, 1.0), (3.9, 5.0), (3.5, 2.0), (4.0, 7.0)];
        let columns = columns(points.into_iter());
        assert_eq!((columns.len(), columns[0].x), (2, 3.5));
        assert_eq!((columns[0].least, columns[0].most), (1.0, 5.0));
        assert_eq!(columns[0].median, 2.0);
    }

    #[test]
    fn what_later_pieces_cover_is_not_drawn() {
        let piece = |shade: u32, y: f64| Piece {
            from: (10.0, y),
            to: (30.0, y),
            shade,
        };
        let pieces = vec![piece(0, 5.0), piece(1, 15.0), piece(2, 5.2), piece(3, 25.0)];
        let left: Vec<u32> = uncovered(pieces).iter().map(|p| p.shade).collect();
        assert_eq!(left, [1, 2, 3]);
    }
}
