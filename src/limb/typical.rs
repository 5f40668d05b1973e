//! The typical brightness at each distance from an outline, taken all round.

use super::band::Band;
use super::hidden::HIDDEN_DN;
use super::profile::Brightness;
use crate::lanes::{Scratch, split};
use multiversion::multiversion;

/// Distances that share a median, per px.
const PER_PX: f32 = 3.0;
/// Values are counted in at most so many steps.
const LEVELS: usize = 256;
/// Levels that are counted together on the way to the median.
const STRIDE: usize = 16;
const LAST_LEVEL: f32 = LEVELS as f32 - 0.51;
/// Fewest pixels that make a median.
const MIN_PIXELS: u32 = 10;
/// A median is worth 64 % of a mean.
const MEDIAN_WORTH: f64 = 0.64;

/// The medians of the band's brightness by distance. Where the disc saturates it says nothing.
pub(super) fn medians(band: &Band, saturation_dn: f64) -> Vec<Brightness> {
    let reach = &band.reach;
    let bins = ((reach.inside_px + reach.outside_px) * f64::from(PER_PX)).ceil() as usize + 1;
    let step_dn = ((saturation_dn + 1.0) / LEVELS as f64).ceil().max(1.0);
    let hidden = (bins * LEVELS) as u32;
    let mut cells = Scratch::<u32>::empty(band.dn.len());
    let mut counts = Scratch::<u16>::zeros((bins + 1) * LEVELS);
    let mut sums = Scratch::<f32>::zeros(if step_dn > 1.0 { counts.len() } else { 0 });
    for strip in band.sample() {
        let dn = &band.dn[strip.entries.clone()];
        let distance_px = &band.distance_px[strip.entries.clone()];
        cells.resize(dn.len(), 0);
        find_cells(
            reach.inside_px as f32,
            step_dn as f32,
            hidden,
            distance_px,
            dn,
            &mut cells,
        );
        // No cell but that of the hidden pixels, which nobody reads, can fill up.
        for cell in cells.iter() {
            counts[*cell as usize] = counts[*cell as usize].wrapping_add(1);
        }
        if !sums.is_empty() {
            for (cell, dn) in cells.iter().zip(dn) {
                sums[*cell as usize] += dn;
            }
        }
    }
    let middle_px = |bin: usize| (bin as f64 + 0.5) / f64::from(PER_PX) - reach.inside_px;
    counts
        .chunks_exact(LEVELS)
        .take(bins)
        .enumerate()
        .filter_map(|(bin, counts)| {
            let sums = sums.get(bin * LEVELS..(bin + 1) * LEVELS);
            let (dn, pixels) = median(counts, step_dn, sums)?;
            (dn < saturation_dn - step_dn).then(|| Brightness {
                distance_px: middle_px(bin),
                dn,
                weight: MEDIAN_WORTH * f64::from(pixels),
            })
        })
        .collect()
}

/// The cell of every pixel, by distance and then by value; hidden pixels fall into the first cell beyond.
#[multiversion(targets("x86_64+avx2"))]
fn find_cells(
    inside_px: f32,
    step_dn: f32,
    hidden: u32,
    distance_px: &[f32],
    dn: &[f32],
    cells: &mut [u32],
) {
    let last_bin = hidden as f32 / LEVELS as f32 - 0.51;
    let per_step = 1.0 / step_dn;
    let count = cells.len();
    let (distance_px, dn) = (&distance_px[..count], &dn[..count]);
    for n in 0..count {
        let bin = split(((distance_px[n] + inside_px) * PER_PX).clamp(0.0, last_bin)).0;
        // A whole number would fall on the step between two levels.
        let level = split(((dn[n] + 0.25) * per_step).min(LAST_LEVEL)).0;
        let cell = bin * LEVELS as u32 + level;
        cells[n] = if dn[n] < HIDDEN_DN { cell } else { hidden };
    }
}

/// The median of counted values, interpolated within its step, and their number. Where the median's step holds most of the
/// values, as that of a quiet ground does, it is the mean of these.
fn median(counts: &[u16], step_dn: f64, sums: Option<&[f32]>) -> Option<(f64, u32)> {
    let (strides, _) = counts.as_chunks::<STRIDE>();
    let add = |stride: &[u16; STRIDE]| stride.iter().fold(0_u16, |sum, n| sum.wrapping_add(*n));
    let strides = strides.iter().map(|stride| u32::from(add(stride)));
    let pixels: u32 = strides.clone().sum();
    if pixels < MIN_PIXELS {
        return None;
    }
    let half = pixels.div_ceil(2);
    let (mut first, mut upto) = (0, 0);
    for within in strides {
        if upto + within >= half {
            break;
        }
        upto += within;
        first += STRIDE;
    }
    let rest = counts.iter().map(|n| u32::from(*n)).enumerate();
    for (level, count) in rest.skip(first) {
        if upto + count >= half {
            if let Some(sum) = sums.map(|sums| f64::from(sums[level]))
                && count > half
            {
                return Some((sum / f64::from(count), pixels));
            }
            let part = (f64::from(pixels) / 2.0 - f64::from(upto)) / f64::from(count);
            // A value stands for all that was rounded to it.
            return Some(((level as f64 + part) * step_dn - 0.5, pixels));
        }
        upto += count;
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_median_is_found_between_whole_values() {
        let mut counts = [0_u16; LEVELS];
        (counts[10], counts[11], counts[200]) = (10, 10, 2);
        let (dn, pixels) = median(&counts, 1.0, None).unwrap();
        assert!((dn - 10.6).abs() < 1e-9, "{dn}");
        assert_eq!(pixels, 22);
    }

    #[test]
    fn a_quiet_ground_is_not_rounded_to_the_steps_of_a_deep_picture() {
        let (mut counts, mut sums) = ([0_u16; LEVELS], [0.0; LEVELS]);
        (counts[3], sums[3]) = (40, 40.0 * 61.5);
        assert_eq!(median(&counts, 16.0, Some(&sums)), Some((61.5, 40)));
    }

    #[test]
    fn a_handful_of_pixels_makes_no_median() {
        let mut counts = [0_u16; LEVELS];
        counts[7] = 9;
        assert_eq!(median(&counts, 1.0, None), None);
    }
}
