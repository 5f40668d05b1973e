//! Pixels without a valid value: undefined, not a number, or impossible.

use super::{Frame, Pixels};
use std::sync::Arc;

/// Flags of the unusable pixels of a frame, row by row.
pub(super) type Unusable = Arc<[bool]>;

impl Frame {
    /// The same frame with unusable pixels, one flag per pixel. They are masked in every cutout; for stages that read only
    /// the brightness, they are interpolated linearly between their neighbours in the row.
    pub fn with_unusable(mut self, unusable: Vec<bool>) -> Self {
        if unusable.len() != self.width * self.height || !unusable.contains(&true) {
            return self;
        }
        let pixels = match self.pixels() {
            Pixels::U8(pixels) => Pixels::U8(filled(pixels, self.width, &unusable)),
            Pixels::U16(pixels) => Pixels::U16(filled(pixels, self.width, &unusable)),
        };
        self.pixels = super::PixelStorage::Whole(pixels);
        self.unusable = Some(unusable.into());
        self
    }

    /// Flags of the unusable pixels of columns `x0` to `x1` of a row; `None` if all pixels of the frame are usable.
    pub fn unusable(&self, y: usize, x0: usize, x1: usize) -> Option<&[bool]> {
        let unusable = self.unusable.as_ref()?;
        Some(&unusable[y * self.width..][x0..x1])
    }
}

/// The pixels with each gap of a row interpolated; a row without usable pixels is replaced by the row above it, or below.
fn filled<T: Copy + Into<f64> + FromDn>(pixels: &[T], width: usize, unusable: &[bool]) -> Vec<T> {
    let mut filled = pixels.to_vec();
    let mut rows = unusable.chunks_exact(width);
    let Some(first) = rows.position(|unusable| unusable.contains(&false)) else {
        return filled;
    };
    let start = |y: usize| y * width;
    for (y, unusable) in unusable.chunks_exact(width).enumerate().skip(first) {
        if unusable.contains(&false) {
            bridge(&mut filled[start(y)..][..width], unusable);
        } else {
            filled.copy_within(start(y - 1)..start(y), start(y));
        }
    }
    for y in 0..first {
        filled.copy_within(start(first)..start(first + 1), start(y));
    }
    filled
}

/// Interpolates linearly over each gap of a row that has at least one usable pixel.
fn bridge<T: Copy + Into<f64> + FromDn>(row: &mut [T], unusable: &[bool]) {
    let mut x = 0;
    while x < row.len() {
        if !unusable[x] {
            x += 1;
            continue;
        }
        let gap = unusable[x..]
            .iter()
            .take_while(|unusable| **unusable)
            .count();
        let before = x.checked_sub(1).map(|at| row[at].into());
        let after = row.get(x + gap).map(|dn| (*dn).into());
        let (first, last) = (
            before.or(after).unwrap_or(0.0),
            after.or(before).unwrap_or(0.0),
        );
        for n in 0..gap {
            let share = (n + 1) as f64 / (gap + 1) as f64;
            row[x + n] = T::from_dn(first + share * (last - first));
        }
        x += gap;
    }
}

/// Conversion of a number in range to a pixel's type.
trait FromDn {
    fn from_dn(dn: f64) -> Self;
}

impl FromDn for u8 {
    fn from_dn(dn: f64) -> Self {
        dn.round() as Self
    }
}

impl FromDn for u16 {
    fn from_dn(dn: f64) -> Self {
        dn.round() as Self
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::{Background, Cutout, FrameInfo, PixelNoise, Region};

    #[test]
    fn unusable_pixels_are_bridged_and_masked() {
        let pixels = [[9, 0, 0, 6], [0, 0, 0, 0], [0, 5, 7, 0]].concat();
        let unusable = [
            [false, true, true, false],
            [true; 4],
            [true, false, false, true],
        ];
        let frame = Frame::new(4, 3, Pixels::U16(pixels), 4095, FrameInfo::default()).unwrap();
        let frame = frame.with_unusable(unusable.concat());
        let expected = [[9, 8, 7, 6], [9, 8, 7, 6], [5, 5, 7, 7]].concat();
        assert_eq!(*frame.pixels(), Pixels::U16(expected));
        let region = Region::sized(1, 0, 3, 3);
        let background = Background::even(region, 0.0);
        let cutout = Cutout::new(&frame, region, &background, PixelNoise::even(1.0));
        assert_eq!(cutout.mask.row(0), [true, true, false]);
        assert_eq!(cutout.mask.row(1), [true; 3]);
        assert_eq!(cutout.mask.row(2), [false, false, true]);
        let cropped = frame.cropped(Region::sized(1, 0, 3, 3)).unwrap();
        assert_eq!(cropped.unusable(0, 0, 3), Some(&[true, true, false][..]));
    }
}
