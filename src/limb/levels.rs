//! Robust brightness levels of a frame (Cramer 2014, section 4.2.5, steps 2 to 4).
//!
//! The Sun covers 2 % of a whole frame and up to half of a small one, so background and noise come from the middle of the
//! distribution of some ten thousand pixels sampled over the whole frame. The median and the values above it are not
//! affected if noise is cut off at zero. The disc's level comes from the pixels that outshine the noise. A cap of the disc
//! at the sensor's edge has only some hundred pixels: every fourth row is searched for them. Hot pixels have no bright
//! neighbour and do not count.

use super::LimbSettings;
use crate::estimation::QUARTILE_SIGMAS;
use crate::frame::{Frame, Levels, ROUNDING_NOISE_DN, Sample};
use crate::reasons::sun;
use crate::units::Rejected;
use crate::with_view;

/// Background and noise come from about this many pixels, which determine them to 1 % of the noise, ...
const SAMPLED_PIXELS: usize = 12_000;
/// ... in groups of this many neighbours in every `SAMPLED_ROWS_PX`-th row.
const GROUP_PX: usize = 64;
const SAMPLED_ROWS_PX: usize = 8;
/// Spacing of the rows that are searched for bright pixels, ...
const BRIGHT_ROWS_PX: usize = 4;
/// ... in rounds, every fourth of these rows in each, ...
const ROUNDS: usize = 4;
/// ... until this many bright pairs are found: all pairs of a cap are needed, but not all of a whole disc.
const ENOUGH_PAIRS: f64 = 500.0;
/// Group of neighbours that is skipped if none is bright.
const STRETCH_PX: usize = 128;
/// Pixels this many sigma above the background are bright: fewer than one in 30 000 of a dark frame.
const BRIGHT_SIGMAS: f64 = 4.0;
/// Quantile of the bright pixels that is the disc's level.
const DISC_QUANTILE: f64 = 0.9;
/// Fewest bright pairs in these rows for a disc: 32 represent 256 pixels, 1 % of the Sun.
const MIN_BRIGHT_PAIRS: f64 = 32.0;
/// With a dark background and a bright disc, less than this fraction of the values lies in the middle third between them;
/// with noise alone half of them do.
const MOST_BETWEEN: f64 = 0.1;

/// The levels of a frame; rejected when nothing outshines the background.
pub fn levels(frame: &Frame, settings: &LimbSettings) -> Result<Levels, Rejected> {
    let (background_dn, noise_dn) = sampled(frame).background();
    let disc_dn = brighter(frame, background_dn + BRIGHT_SIGMAS * noise_dn).disc_dn()?;
    let contrast_sigmas = (disc_dn - background_dn) / noise_dn;
    let reason = sun::LOW_CONTRAST;
    Rejected::at_least(settings.min_contrast_sigma, contrast_sigmas, reason)?;
    Ok(Levels {
        background_dn,
        noise_dn,
        disc_dn,
    })
}

/// A regular sample of the frame. Its groups shift from row to row, so that they do not always or never coincide with a
/// column of the sensor's pattern.
fn sampled(frame: &Frame) -> Histogram {
    let width = frame.width();
    let rows = (SAMPLED_ROWS_PX / 2..frame.height()).step_by(SAMPLED_ROWS_PX);
    let pixels_per_row = (SAMPLED_PIXELS / rows.len().max(1)).max(GROUP_PX);
    let stride = (width * GROUP_PX / pixels_per_row).max(GROUP_PX);
    let mut histogram = Histogram::new(frame);
    for (n, y) in rows.enumerate() {
        let shift = 3 * n * GROUP_PX % stride;
        for x in (shift..width).step_by(stride) {
            frame.count(y, x..(x + GROUP_PX).min(width), &mut histogram.counts);
        }
    }
    histogram
}

/// The pixels above a value in some of the rows, one of each bright pair. A pixel without a bright neighbour is hot: a cap
/// has a hundred pixels in these rows, and hot pixels from all over the sensor would be the brightest tenth.
fn brighter(frame: &Frame, dn: f64) -> Histogram {
    let mut histogram = Histogram::new(frame);
    for round in 0..ROUNDS {
        let first = BRIGHT_ROWS_PX / 2 + round * BRIGHT_ROWS_PX;
        for y in (first..frame.height()).step_by(ROUNDS * BRIGHT_ROWS_PX) {
            if !frame.is_brighter(y, 0..frame.width(), dn) {
                continue;
            }
            for x in (0..frame.width()).step_by(STRETCH_PX) {
                let stretch = x..(x + STRETCH_PX).min(frame.width());
                if !frame.is_brighter(y, stretch.clone(), dn) {
                    continue;
                }
                with_view!(frame, view => histogram.add_pairs(&view.row(y)[stretch], dn));
            }
        }
        if histogram.total() >= ENOUGH_PAIRS {
            break;
        }
    }
    histogram
}

/// Number of pixels of each value; all saturated pixels count as saturation.
struct Histogram {
    counts: Vec<u32>,
}

impl Histogram {
    fn new(frame: &Frame) -> Self {
        Self {
            counts: vec![0; usize::from(frame.saturation_dn()) + 1],
        }
    }

    /// Adds one of each pair of neighbours that are both above a value.
    fn add_pairs<T: Sample>(&mut self, row: &[T], dn: f64) {
        let last = self.counts.len() - 1;
        let below = T::floor(dn);
        for pair in row.as_chunks::<2>().0 {
            if pair[0].min(pair[1]) > below {
                let value: u32 = pair[1].into();
                self.counts[(value as usize).min(last)] += 1;
            }
        }
    }

    fn total(&self) -> f64 {
        f64::from(self.counts.iter().sum::<u32>())
    }

    /// Number of pixels with at most a value.
    fn up_to(&self, dn: f64) -> f64 {
        let values = (dn.max(0.0) as usize + 1).min(self.counts.len());
        f64::from(self.counts[..values].iter().sum::<u32>())
    }

    /// The value below which `wanted` pixels lie, interpolated within a value.
    fn quantile(&self, wanted: f64) -> f64 {
        let mut below = 0.0;
        for (dn, count) in self
            .counts
            .iter()
            .map(|count| f64::from(*count))
            .enumerate()
        {
            if below + count >= wanted {
                return dn as f64 - 0.5 + (wanted - below) / count.max(1.0);
            }
            below += count;
        }
        self.counts.len() as f64 - 0.5
    }

    /// Number of values not of the disc, which may cover half of a small picture: those below the middle of the range, if
    /// few lie near the middle.
    fn dark_total(&self) -> f64 {
        let total = self.total();
        let (low, high) = (self.quantile(0.01 * total), self.quantile(0.99 * total));
        let third = (high - low) / 3.0;
        let between = self.up_to(high - third) - self.up_to(low + third);
        match between < MOST_BETWEEN * total {
            true => self.up_to((low + high) / 2.0),
            false => total,
        }
    }

    /// Background and its noise, 1 sigma, DN; the second pass excludes the pixels that outshine it, which would bias both.
    fn background(&self) -> (f64, f64) {
        let estimate = |total: f64| {
            let background_dn = self.quantile(0.5 * total);
            let noise_dn = (self.quantile(0.75 * total) - background_dn) / QUARTILE_SIGMAS;
            (background_dn, noise_dn.max(ROUNDING_NOISE_DN))
        };
        let dark = self.dark_total();
        let (background_dn, noise_dn) = estimate(dark);
        estimate(dark.min(self.up_to(background_dn + BRIGHT_SIGMAS * noise_dn)))
    }

    fn disc_dn(&self) -> Result<f64, Rejected> {
        let bright = self.total();
        let reason = sun::FEW_BRIGHT_PIXELS;
        Rejected::at_least(MIN_BRIGHT_PAIRS, bright, reason)?;
        Ok(self.quantile(DISC_QUANTILE * bright))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::estimation::QUARTILE_SIGMAS;
    use crate::frame::{FrameInfo, Pixels};

    fn frame(value: impl Fn(usize, usize) -> u8) -> Frame {
        let pixels = (0..200 * 160).map(|n| value(n % 200, n / 200)).collect();
        Frame::new(200, 160, Pixels::U8(pixels), 255, FrameInfo::default()).unwrap()
    }

    #[test]
    fn levels_of_a_bright_square_on_a_dark_ground_are_its_own() {
        let square = frame(|x, y| if x / 40 == 2 && y / 40 == 2 { 200 } else { 7 });
        let levels = levels(&square, &LimbSettings::default()).unwrap();
        assert!((levels.background_dn - 7.0).abs() <= 0.5);
        assert!((levels.disc_dn - 200.0).abs() <= 0.5);
    }

    #[test]
    fn the_ground_beside_a_disc_that_covers_half_of_a_picture_is_all_of_its_dark_half() {
        let even = |x: usize, y: usize| ((x * 7919 + y * 104_729) % 21) as u8;
        let half = frame(|x, y| if x < 100 { 200 } else { even(x, y) });
        let levels = levels(&half, &LimbSettings::default()).unwrap();
        assert!((levels.background_dn - 10.0).abs() <= 1.0, "{levels:?}");
        // A quarter of a uniform distribution lies between its median and its upper quartile.
        let noise_dn = 21.0 / 4.0 / QUARTILE_SIGMAS;
        assert!(
            (levels.noise_dn / noise_dn - 1.0).abs() < 0.15,
            "{levels:?}"
        );
    }

    #[test]
    fn frames_of_one_value_have_no_disc() {
        for value in [0, 255] {
            assert!(levels(&frame(|_, _| value), &LimbSettings::default()).is_err());
        }
    }
}
