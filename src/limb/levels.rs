//! Robust brightness levels of a frame (Cramer 2014, section 4.2.5, steps 2 to 4).
//!
//! The Sun covers about 2 % of the frame, so background and noise come from the middle of the histogram and the
//! disc from those pixels that outshine the noise; hot pixels and scratches are too few to move its quantile.

use super::Settings;
use crate::frame::{Frame, Levels, Sample, View};
use crate::units::Rejected;
use crate::with_view;

/// Distance of the pixels looked at, in both axes.
const STRIDE_PX: usize = 4;
/// Which part of the bright pixels is darker than the disc's level.
const DISC_QUANTILE: f64 = 0.9;
/// Fewest bright pixels of the sample that can be a disc: 16 stand for 256 pixels, 1 % of the Sun.
const MIN_BRIGHT_SAMPLES: u64 = 16;
/// A histogram over whole numbers cannot show less noise than rounding makes, DN.
const ROUNDING_NOISE_DN: f64 = 0.2887;

/// The levels of a frame; rejected when nothing outshines the background.
pub fn levels(frame: &Frame, settings: &Settings) -> Result<Levels, Rejected> {
    let values = 1 << frame.pixels().bits();
    with_view!(frame, view => Histogram::of(&view, values).levels(settings))
}

/// Counts of values, over a regular sample of the frame.
struct Histogram {
    counts: Vec<u64>,
}

impl Histogram {
    fn of<T: Sample>(view: &View<'_, T>, values: usize) -> Self {
        let mut counts = vec![0_u64; values];
        for y in (STRIDE_PX / 2..view.height).step_by(STRIDE_PX) {
            let row = &view.pixels[y * view.width..(y + 1) * view.width];
            for &pixel in row
                .iter()
                .skip(y / STRIDE_PX % STRIDE_PX)
                .step_by(STRIDE_PX)
            {
                counts[pixel.dn() as usize] += 1;
            }
        }
        Self { counts }
    }

    /// The value below which `fraction` of the counts from `first_dn` on lie, interpolated within a value.
    fn quantile(&self, fraction: f64, first_dn: usize) -> f64 {
        let from_first = self.counts.iter().enumerate().skip(first_dn);
        let wanted = fraction * self.total_from(first_dn) as f64;
        let mut below = 0.0;
        for (dn, &count) in from_first {
            let count = count as f64;
            if count > 0.0 && below + count >= wanted {
                return dn as f64 - 0.5 + (wanted - below) / count;
            }
            below += count;
        }
        self.counts.len() as f64
    }

    fn total_from(&self, first_dn: usize) -> u64 {
        self.counts.iter().skip(first_dn).sum()
    }

    fn levels(&self, settings: &Settings) -> Result<Levels, Rejected> {
        let background_dn = self.quantile(0.5, 0);
        let upper_quartile = self.quantile(0.75, 0);
        let noise_dn = ((upper_quartile - background_dn) / 0.6745).max(ROUNDING_NOISE_DN);
        let bright_dn = background_dn + settings.min_contrast_sigma * noise_dn;
        let first_bright = bright_dn.ceil() as usize;
        let bright = self.total_from(first_bright);
        if bright < MIN_BRIGHT_SAMPLES {
            return Err(Rejected {
                reason: "too few pixels are brighter than the background",
                measured: bright as f64,
                limit: MIN_BRIGHT_SAMPLES as f64,
            });
        }
        Ok(Levels {
            background_dn,
            noise_dn,
            disc_dn: self.quantile(DISC_QUANTILE, first_bright),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::{FrameInfo, Pixels};

    fn frame(value: impl Fn(usize, usize) -> u8) -> Frame {
        let pixels = (0..200 * 160).map(|n| value(n % 200, n / 200)).collect();
        Frame::new(200, 160, Pixels::U8(pixels), 255, FrameInfo::default()).unwrap()
    }

    #[test]
    fn levels_of_a_bright_square_on_a_dark_ground_are_its_own() {
        let square = frame(|x, y| if x / 40 == 2 && y / 40 == 2 { 200 } else { 7 });
        let levels = levels(&square, &Settings::default()).unwrap();
        assert!((levels.background_dn - 7.0).abs() <= 0.5);
        assert!((levels.disc_dn - 200.0).abs() <= 0.5);
    }

    #[test]
    fn frames_of_one_value_have_no_disc() {
        for value in [0, 255] {
            assert!(levels(&frame(|_, _| value), &Settings::default()).is_err());
        }
    }
}
