//! Robust brightness levels of a frame (Cramer 2014, section 4.2.5, steps 2 to 4).
//!
//! The Sun covers 2 % of a whole frame and up to half of a small one, so background and noise come from the middle of the distribution,
//! taken over every eighth row and some twenty thousand pixels; where noise is cut off at zero the median and what lies above it do not
//! mind. The disc comes from those pixels that outshine the noise. A cap of it at the sensor's edge has only some
//! hundred pixels: they are looked for by pairs in every fourth row, stretches without any being passed over; hot pixels
//! stand alone and do not count.

use super::Settings;
use super::bright::{Whole, first_bright};
use crate::estimation::QUARTILE_SIGMAS;
use crate::frame::{Frame, Levels, ROUNDING_NOISE_DN, View};
use crate::lanes::Scratch;
use crate::units::Rejected;
use crate::with_view;
use multiversion::multiversion;

/// Distance of the rows that tell the background.
const SAMPLED_ROWS_PX: usize = 8;
/// Neighbours that are sampled together.
const GROUP_PX: usize = 16;
/// Least distance of such groups in a row: one pixel of 64 is sampled.
const STRIDE_PX: usize = 8 * GROUP_PX;
/// So many tell background and noise to a hundredth of the noise; larger frames have groups to spare.
const ENOUGH_PIXELS: usize = 20_000;
/// Distance of the rows that are looked through for bright pixels, ...
const BRIGHT_ROWS_PX: usize = 4;
/// ... in rounds, every fourth of them in each, ...
const ROUNDS: usize = 4;
/// ... until so many bright pairs are found: a cap's are all wanted, the whole disc's are not.
const ENOUGH_PAIRS: f64 = 500.0;
/// Pixels from a bright one on that are looked at pair by pair.
const STRETCH_PX: usize = 64;
/// Pixels this many sigma above the background are bright: of a dark frame's fewer than one in 30 000.
const BRIGHT_SIGMAS: f64 = 4.0;
/// Which part of the bright pixels is darker than the disc's level.
const DISC_QUANTILE: f64 = 0.9;
/// Fewest bright pairs in those rows that can be a disc: 32 stand for 256 pixels, 1 % of the Sun.
const MIN_BRIGHT_PAIRS: u32 = 32;
/// A dark ground and a bright disc leave less than this part of the values in the middle third between them; noise alone
/// has half of its own there.
const MOST_BETWEEN: f64 = 0.1;

/// The levels of a frame; rejected when nothing outshines the background.
pub fn levels(frame: &Frame, settings: &Settings) -> Result<Levels, Rejected> {
    let saturation_dn = frame.saturation_dn();
    with_view!(frame, view => {
        let (background_dn, noise_dn) = sampled(&view, saturation_dn).ground();
        let bright_dn = background_dn + BRIGHT_SIGMAS * noise_dn;
        let disc_dn = brighter(&view, saturation_dn, bright_dn).disc_dn()?;
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

/// A regular sample of the frame. Its groups shift from row to row, lest they meet a column of the sensor's pattern
/// always or never.
fn sampled<T: Whole>(view: &View<'_, T>, saturation_dn: u16) -> Distribution {
    let in_rows = view.pixels.len() / SAMPLED_ROWS_PX;
    let stride = (in_rows * GROUP_PX / ENOUGH_PIXELS).max(STRIDE_PX);
    let mut counts = Counts::new::<T>(saturation_dn);
    let rows = view.pixels.chunks_exact(view.width);
    for (n, row) in rows
        .skip(SAMPLED_ROWS_PX / 2)
        .step_by(SAMPLED_ROWS_PX)
        .enumerate()
    {
        let shift = 3 * n * GROUP_PX % stride;
        for stretch in row.get(shift..).unwrap_or_default().chunks(stride) {
            if let Some(group) = stretch.first_chunk::<GROUP_PX>() {
                counts.add(group.iter().copied());
            }
        }
    }
    counts.summed()
}

/// The pixels above a value, in some of the rows, one of each pair of them. One without a bright neighbour is hot: of a cap's hundred
/// pixels in these rows, hot ones from all over the sensor would be the brightest tenth.
fn brighter<T: Whole>(view: &View<'_, T>, saturation_dn: u16, dn: f64) -> Distribution {
    let mut counts = Counts::new::<T>(saturation_dn);
    for round in 0..ROUNDS {
        let first = BRIGHT_ROWS_PX / 2 + round * BRIGHT_ROWS_PX;
        let rows = view.pixels.chunks_exact(view.width).skip(first);
        for row in rows.step_by(ROUNDS * BRIGHT_ROWS_PX) {
            count_bright(row, T::floor(dn), &mut counts);
        }
        if f64::from(counts.total()) >= ENOUGH_PAIRS {
            break;
        }
    }
    counts.summed()
}

#[multiversion(targets("x86_64+avx2"))]
fn count_bright<T: Whole>(row: &[T], floor: T, counts: &mut Counts) {
    let mut left = row;
    while let Some(dark) = first_bright(left, floor) {
        left = &left[dark & !1..];
        let (stretch, rest) = left.split_at(STRETCH_PX.min(left.len()));
        let bright = |pair: &&[T]| pair[0] > floor && pair[1] > floor;
        let pairs = stretch.chunks_exact(2).filter(bright);
        counts.add(pairs.map(|pair| pair[1]));
        left = rest;
    }
}

/// How many pixels have each value; all that saturate count as saturation.
struct Counts {
    counts: Scratch<u32>,
    saturation_dn: u16,
}

impl Counts {
    fn new<T: Whole>(saturation_dn: u16) -> Self {
        Self {
            counts: Scratch::zeros(T::values(saturation_dn)),
            saturation_dn,
        }
    }

    #[inline(always)]
    fn add<T: Whole>(&mut self, pixels: impl Iterator<Item = T>) {
        let values = T::values(self.saturation_dn);
        let counts = &mut self.counts[..values];
        for pixel in pixels {
            counts[pixel.index().min(values - 1)] += 1;
        }
    }

    fn total(&self) -> u32 {
        self.counts.iter().sum()
    }

    fn summed(self) -> Distribution {
        let mut upto = self.counts;
        let mut sum = 0;
        for count in upto.iter_mut() {
            sum += *count;
            *count = sum;
        }
        Distribution { upto }
    }
}

/// How many pixels have at most each value.
struct Distribution {
    upto: Scratch<u32>,
}

impl Distribution {
    fn total(&self) -> f64 {
        self.upto.last().copied().map_or(0.0, f64::from)
    }

    /// How many have at most a value.
    fn upto(&self, dn: f64) -> f64 {
        let last = self.upto.len() - 1;
        f64::from(self.upto[(dn.max(0.0) as usize).min(last)])
    }

    /// The value below which `wanted` pixels lie, interpolated within a value.
    fn value_above(&self, wanted: f64) -> f64 {
        let dn = self.upto.partition_point(|n| f64::from(*n) < wanted);
        let below = dn.checked_sub(1).map_or(0.0, |dn| self.upto(dn as f64));
        let count = self.upto(dn as f64) - below;
        dn as f64 - 0.5 + (wanted - below) / count.max(1.0)
    }

    /// How many values are no disc's, where a disc may cover half of a small picture: those below the middle of the range,
    /// if hardly any lie about it.
    fn dark_total(&self) -> f64 {
        let total = self.total();
        let (low, high) = (
            self.value_above(0.01 * total),
            self.value_above(0.99 * total),
        );
        let third = (high - low) / 3.0;
        let between = self.upto(high - third) - self.upto(low + third);
        if between < MOST_BETWEEN * total {
            self.upto((low + high) / 2.0)
        } else {
            total
        }
    }

    /// Background and its noise, 1 sigma, DN; the second time without what outshines it, which would shift both.
    fn ground(&self) -> (f64, f64) {
        let estimate = |total: f64| {
            let background_dn = self.value_above(0.5 * total);
            let upper_quartile = self.value_above(0.75 * total);
            let noise_dn = (upper_quartile - background_dn) / QUARTILE_SIGMAS;
            (background_dn, noise_dn.max(ROUNDING_NOISE_DN))
        };
        let dark = self.dark_total();
        let (background_dn, noise_dn) = estimate(dark);
        let bright_dn = background_dn + BRIGHT_SIGMAS * noise_dn;
        estimate(dark.min(self.upto(bright_dn)))
    }

    fn disc_dn(&self) -> Result<f64, Rejected> {
        let bright = self.total();
        let limit = f64::from(MIN_BRIGHT_PAIRS);
        if bright < limit {
            return Err(Rejected {
                reason: "too few pixels are brighter than the background",
                measured: bright,
                limit,
            });
        }
        Ok(self.value_above(DISC_QUANTILE * bright))
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
        let levels = levels(&square, &Settings::default()).unwrap();
        assert!((levels.background_dn - 7.0).abs() <= 0.5);
        assert!((levels.disc_dn - 200.0).abs() <= 0.5);
    }

    #[test]
    fn the_ground_beside_a_disc_that_covers_half_of_a_picture_is_all_of_its_dark_half() {
        let even = |x: usize, y: usize| ((x * 7919 + y * 104_729) % 21) as u8;
        let half = frame(|x, y| if x < 100 { 200 } else { even(x, y) });
        let levels = levels(&half, &Settings::default()).unwrap();
        assert!((levels.background_dn - 10.0).abs() <= 1.0, "{levels:?}");
        // A quarter of an even spread lies between its middle and its upper quartile.
        let noise_dn = 21.0 / 4.0 / QUARTILE_SIGMAS;
        assert!(
            (levels.noise_dn / noise_dn - 1.0).abs() < 0.15,
            "{levels:?}"
        );
    }

    #[test]
    fn frames_of_one_value_have_no_disc() {
        for value in [0, 255] {
            assert!(levels(&frame(|_, _| value), &Settings::default()).is_err());
        }
    }
}
