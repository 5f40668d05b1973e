//! Robust brightness levels of a frame (Cramer 2014, section 4.2.5, steps 2 to 4).
//!
//! The Sun covers 2 % of a whole frame and up to half of a small one, so background and noise come from the middle of the histogram, taken
//! over every eighth row and some twenty thousand pixels; where noise is cut off at zero the median and what lies above it do not
//! mind. The disc comes from those pixels that outshine the noise. A cap of it at the sensor's edge has only some
//! hundred pixels: they are looked for by pairs in every fourth row, stretches without any being passed over; hot pixels
//! stand alone and do not count.

use super::Settings;
use super::bright::{Stretches, Whole};
use crate::frame::{Frame, Levels, ROUNDING_NOISE_DN, View};
use crate::units::Rejected;
use crate::with_view;

/// Least distance of the pixels that tell the background, in both axes.
const STRIDE_PX: usize = 8;
/// So many tell background and noise to a hundredth of the noise; larger frames have columns to spare.
const ENOUGH_PIXELS: usize = 20_000;
/// Distance of the rows that are looked through for bright pixels.
const BRIGHT_ROWS_PX: usize = 4;
/// Pixels this many sigma above the background are bright: of a dark frame's fewer than one in 30 000.
const BRIGHT_SIGMAS: f64 = 4.0;
/// Which part of the bright pixels is darker than the disc's level.
const DISC_QUANTILE: f64 = 0.9;
/// Fewest bright pairs in those rows that can be a disc: 32 stand for 256 pixels, 1 % of the Sun.
const MIN_BRIGHT_PAIRS: u32 = 32;
/// A dark ground and a bright disc leave less than this part of the values in the middle third between them; noise alone
/// has half of its own there.
const MOST_BETWEEN: f64 = 0.1;
/// The upper quartile of a normal distribution, sigma.
const QUARTILE_SIGMAS: f64 = 0.6745;

/// The levels of a frame; rejected when nothing outshines the background.
pub fn levels(frame: &Frame, settings: &Settings) -> Result<Levels, Rejected> {
    let values = usize::from(frame.saturation_dn()) + 1;
    with_view!(frame, view => {
        let (background_dn, noise_dn) = Histogram::of_sample(&view, values).ground();
        let bright_dn = background_dn + BRIGHT_SIGMAS * noise_dn;
        let bright = Histogram::of_brighter(&view, values, bright_dn);
        let disc_dn = bright.disc_dn()?;
        let contrast_sigmas = (disc_dn - background_dn) / noise_dn;
        if contrast_sigmas < settings.min_contrast_sigma {
            return Err(Rejected {
                reason: "nothing outshines the background by enough",
                measured: contrast_sigmas,
                limit: settings.min_contrast_sigma,
            });
        }
        Ok(Levels { background_dn, noise_dn, disc_dn })
    })
}

/// Distance of the columns in a frame of so many pixels.
fn column_stride(pixels: usize) -> usize {
    (pixels / STRIDE_PX / ENOUGH_PIXELS).max(STRIDE_PX)
}

/// Counts of values; all that saturate count as saturation.
struct Histogram {
    counts: Vec<u32>,
}

impl Histogram {
    fn new(values: usize) -> Self {
        let counts = vec![0; values];
        Self { counts }
    }

    fn add<T: Whole>(&mut self, pixel: T) {
        let last = self.counts.len() - 1;
        self.counts[pixel.index().min(last)] += 1;
    }

    /// A regular sample of the frame. Its columns shift from row to row, lest it meet a column of the sensor's pattern
    /// always or never.
    fn of_sample<T: Whole>(view: &View<'_, T>, values: usize) -> Self {
        let mut histogram = Self::new(values);
        let stride = column_stride(view.width * view.height);
        for (n, rows) in view.pixels.chunks_exact(STRIDE_PX * view.width).enumerate() {
            let row = &rows[STRIDE_PX / 2 * view.width..][..view.width];
            for pixels in row.chunks_exact(stride) {
                histogram.add(pixels[3 * n % stride]);
            }
        }
        histogram
    }

    /// The pixels above a value, in some of the rows, one of each pair of them. One without a bright neighbour is hot: of a cap's hundred
    /// pixels in these rows, hot ones from all over the sensor would be the brightest tenth.
    fn of_brighter<T: Whole>(view: &View<'_, T>, values: usize, dn: f64) -> Self {
        let floor = T::floor(dn);
        let mut histogram = Self::new(values);
        let mut stretches = Stretches::default();
        let rows = view.pixels.chunks_exact(view.width);
        for row in rows.skip(BRIGHT_ROWS_PX / 2).step_by(BRIGHT_ROWS_PX) {
            for (_, stretch) in stretches.bright(row, floor) {
                for pair in stretch.chunks_exact(2) {
                    if pair[0] > floor && pair[1] > floor {
                        histogram.add(pair[1]);
                    }
                }
            }
        }
        histogram
    }

    fn total(&self) -> u32 {
        self.counts.iter().sum()
    }

    /// The value below which `wanted` counts lie, interpolated within a value.
    fn value_above(&self, wanted: f64) -> f64 {
        let mut below = 0.0;
        for (dn, &count) in self.counts.iter().enumerate().filter(|(_, n)| **n > 0) {
            let count = f64::from(count);
            if below + count >= wanted {
                return dn as f64 - 0.5 + (wanted - below) / count;
            }
            below += count;
        }
        self.counts.len() as f64
    }

    /// How many values are no disc's, where a disc may cover half of a small picture: those below the middle of the range,
    /// if hardly any lie about it.
    fn dark_total(&self) -> f64 {
        let total = f64::from(self.total());
        let (low, high) = (
            self.value_above(0.01 * total),
            self.value_above(0.99 * total),
        );
        let third = (high - low) / 3.0;
        let upto = |dn: f64| {
            let below = self.counts.iter().take(dn.max(0.0) as usize + 1);
            f64::from(below.sum::<u32>())
        };
        let between = upto(high - third) - upto(low + third);
        if between < MOST_BETWEEN * total {
            upto((low + high) / 2.0)
        } else {
            total
        }
    }

    /// Background and its noise, 1 sigma, DN; the second time without what outshines it, which would shift both.
    fn ground(&self) -> (f64, f64) {
        let total = self.dark_total();
        let estimate = |total: f64| {
            let background_dn = self.value_above(0.5 * total);
            let upper_quartile = self.value_above(0.75 * total);
            let noise_dn = (upper_quartile - background_dn) / QUARTILE_SIGMAS;
            (background_dn, noise_dn.max(ROUNDING_NOISE_DN))
        };
        let (background_dn, noise_dn) = estimate(total);
        let bright_dn = background_dn + BRIGHT_SIGMAS * noise_dn;
        let bright: u32 = self.counts.iter().skip(bright_dn.ceil() as usize).sum();
        estimate(total - f64::from(bright))
    }

    fn disc_dn(&self) -> Result<f64, Rejected> {
        let bright = self.total();
        if bright < MIN_BRIGHT_PAIRS {
            return Err(Rejected {
                reason: "too few pixels are brighter than the background",
                measured: f64::from(bright),
                limit: f64::from(MIN_BRIGHT_PAIRS),
            });
        }
        Ok(self.value_above(DISC_QUANTILE * f64::from(bright)))
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
