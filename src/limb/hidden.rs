//! What of the limb marks hide.

use crate::frame::Region;
use crate::units::SensorPx;
use nalgebra::{Matrix2, Vector2};
use std::ops::Range;

/// Pixels that show no bare limb: marks lie on them.
#[derive(Debug, Clone, PartialEq)]
pub struct Hidden {
    region: Region,
    /// A bit for every pixel, each row of the region from a word of its own on.
    covered: Vec<u64>,
}

impl Hidden {
    /// Nothing hidden, in a region.
    pub fn nothing(region: Region) -> Self {
        let covered = vec![0; region.width().div_ceil(64) * region.height()];
        Self { region, covered }
    }

    fn words(&self) -> usize {
        self.region.width().div_ceil(64)
    }

    /// Hides those of the pixels within `reach` px of a position that `covers` holds for.
    pub fn hide(&mut self, at: SensorPx, reach: f64, covers: impl Fn(SensorPx) -> bool) {
        let Some(near) = self.near(at, reach) else {
            return;
        };
        for y in near.y0..near.y1 {
            for x in near.x0..near.x1 {
                if covers(SensorPx::new(x as f64, y as f64)) {
                    self.cover(x, y);
                }
            }
        }
    }

    /// Hides two bars that cross at a position: `to_arms` leads from an offset there, px, to one along them, in the units of
    /// their half lengths and half widths. None reaches farther than `reach` px.
    pub fn hide_cross(&mut self, at: SensorPx, reach: f64, to_arms: &Matrix2<f64>, bars: Bars) {
        let Some(near) = self.near(at, reach) else {
            return;
        };
        let (long, wide) = (bars.half_length, bars.half_width);
        let step = to_arms.column(0).into_owned();
        for y in near.y0..near.y1 {
            let first = to_arms * Vector2::new(near.x0 as f64 - at.x, y as f64 - at.y);
            for [u, v] in [[long, wide], [wide, long]] {
                let (in_u, in_v) = (within(first.x, step.x, u), within(first.y, step.y, v));
                let (start, end) = (in_u.start.max(in_v.start), in_u.end.min(in_v.end));
                if start >= end {
                    continue;
                }
                let columns = pixels_within(start..end, near.width());
                self.cover_row(near.x0 + columns.start..near.x0 + columns.end, y);
            }
        }
    }

    fn near(&self, at: SensorPx, reach: f64) -> Option<Region> {
        let r = self.region;
        let near = Region::around(at, reach, r.x1, r.y1)?;
        let [x0, y0] = [near.x0.max(r.x0), near.y0.max(r.y0)];
        (x0 < near.x1 && y0 < near.y1).then_some(Region { x0, y0, ..near })
    }

    fn cover(&mut self, x: usize, y: usize) {
        let (column, row) = (x - self.region.x0, y - self.region.y0);
        let word = row * self.words() + column / 64;
        self.covered[word] |= 1 << (column % 64);
    }

    fn cover_row(&mut self, columns: Range<usize>, y: usize) {
        let words = self.words();
        let row = &mut self.covered[(y - self.region.y0) * words..][..words];
        let columns = columns.start - self.region.x0..columns.end - self.region.x0;
        for (n, word) in row
            .iter_mut()
            .enumerate()
            .take(columns.end.div_ceil(64))
            .skip(columns.start / 64)
        {
            *word |= bits_of(&columns, n);
        }
    }

    /// Whether nothing is hidden in some columns of some rows.
    pub(super) fn is_bare(&self, columns: &Range<usize>, rows: &Range<usize>) -> bool {
        let r = self.region;
        let words = self.words();
        let columns = columns.start.saturating_sub(r.x0)..columns.end.saturating_sub(r.x0);
        let rows = rows.start.max(r.y0) - r.y0..rows.end.clamp(r.y0, r.y1) - r.y0;
        (columns.start / 64..columns.end.div_ceil(64).min(words)).all(|n| {
            let bits = bits_of(&columns, n);
            let mut words = rows.clone().map(|row| self.covered[row * words + n]);
            words.all(|word| word & bits == 0)
        })
    }

    /// Calls with every hidden one of some columns of a row, counted from the first of them; outside the region none is hidden.
    #[inline(always)]
    pub(super) fn each(&self, y: usize, columns: &Range<usize>, mut found: impl FnMut(usize)) {
        let region = self.region;
        if !(region.y0..region.y1).contains(&y) {
            return;
        }
        let words = self.words();
        let row = &self.covered[(y - region.y0) * words..][..words];
        for from in columns.clone().step_by(64) {
            let mut left = next_bits(row, region.x0, from);
            if columns.end - from < 64 {
                left &= (1 << (columns.end - from)) - 1;
            }
            while left != 0 {
                found(from - columns.start + left.trailing_zeros() as usize);
                left &= left - 1;
            }
        }
    }
}

/// The bits of some columns in the n-th word of a row.
fn bits_of(columns: &Range<usize>, n: usize) -> u64 {
    let upto = |column: usize| match column.saturating_sub(64 * n) {
        bits @ 0..64 => (1 << bits) - 1,
        _ => u64::MAX,
    };
    upto(columns.end) & !upto(columns.start)
}

/// The 64 bits from column `from` on of a row whose first one is that of column `first`.
#[inline(always)]
fn next_bits(row: &[u64], first: usize, from: usize) -> u64 {
    let word = |n: usize| row.get(n).copied().unwrap_or(0);
    match from.checked_sub(first) {
        Some(bit) => {
            (word(bit / 64) >> (bit % 64)) | ((word(bit / 64 + 1) << 1) << (63 - bit % 64))
        }
        None if first - from < 64 => word(0) << (first - from),
        None => 0,
    }
}

/// Where the size of `first + step n` is less than a limit.
fn within(first: f64, step: f64, limit: f64) -> Range<f64> {
    if step == 0.0 {
        let always = if first.abs() < limit {
            f64::INFINITY
        } else {
            -1.0
        };
        return -always..always;
    }
    let (middle, half) = (-first / step, (limit / step).abs());
    middle - half..middle + half
}

/// Two bars that cross.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Bars {
    pub half_length: f64,
    pub half_width: f64,
}

/// Whole numbers in a half-open range, as far as there are pixels.
pub(super) fn pixels_within(range: Range<f64>, pixels: usize) -> Range<usize> {
    // What `ceil` does, which many processors' programs must call.
    let first = |v: f64| {
        let v = v.clamp(0.0, pixels as f64);
        let whole = v as u32;
        (whole + u32::from(f64::from(whole) < v)) as usize
    };
    let start = first(range.start);
    start..first(range.end).max(start)
}

/// Brightness of a hidden pixel: so far from any limb's that robust weights leave it out by themselves.
pub(super) const HIDDEN_DN: f32 = 1e9;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_cross_hides_what_its_bars_cover() {
        let at = SensorPx::new(71.3, 40.8);
        let bars = Bars {
            half_length: 1.3,
            half_width: 0.4,
        };
        for degrees in [0.0, 20.0, 45.0, 90.0, 133.0_f64] {
            let (sin, cos) = degrees.to_radians().sin_cos();
            let to_arms = Matrix2::new(cos, sin, -sin, cos) / 8.0;
            let region = Region::sized(10, 5, 100, 90);
            let mut hidden = Hidden::nothing(region);
            hidden.hide_cross(at, 13.0, &to_arms, bars);
            let mut expected = Hidden::nothing(region);
            expected.hide(at, 20.0, |place| {
                let [u, v]: [f64; 2] = (to_arms * (place.vector() - at.vector())).abs().into();
                u.min(v) < bars.half_width && u.max(v) < bars.half_length
            });
            assert_eq!(hidden, expected, "turned by {degrees} deg");
        }
    }
}
