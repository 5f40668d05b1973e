//! Candidates: positions where the disc is dark over about the size of a mark, at any rotation of the camera.

use super::{FiducialSettings, FlatDisc, MarkImage};
use crate::kernels::column_sums;
use crate::units::SensorPx;

/// Bins along a mark's length; the disc is first summed over such bins.
const BINS_PER_LENGTH: f64 = 5.0;
/// Bins along the side of a box: the dense centre of the cross fills it.
const BOX: usize = 3;
/// A cross of contrast 1 darkens a box about its centre by 0.4; a cross between bins, or cut by the limb, by less.
const BOX_SHARE: f64 = 0.2;
/// Detection threshold of a box, in sigma of the noise.
const BOX_SIGMA: f64 = 4.0;
/// Number of candidates that are tried per mark that may be found.
const CANDIDATES_PER_DETECTION: usize = 2;

/// Indices of the darkest positions among the flattened disc's values, darkest first, at least half a mark apart.
pub(super) fn candidates(
    flat: &FlatDisc,
    shape: &MarkImage,
    settings: &FiducialSettings,
) -> Vec<usize> {
    let boxes = Boxes::of(flat, shape);
    let pixels = (boxes.side_px * boxes.side_px) as f64;
    let mut dark: Vec<(usize, f32)> = boxes
        .peaks((settings.min_contrast * BOX_SHARE * pixels) as f32)
        .into_iter()
        .filter(|(index, sum)| f64::from(*sum) > BOX_SIGMA * flat.noise(*index) * pixels.sqrt())
        .collect();
    dark.sort_by(|a, b| b.1.total_cmp(&a.1));
    let mut kept: Vec<(usize, SensorPx)> = Vec::new();
    for (index, _) in dark {
        let here = flat.position(index);
        let far = |(_, other): &(usize, SensorPx)| other.distance(here) > shape.half_length_px;
        if kept.len() < CANDIDATES_PER_DETECTION * settings.max_detections && kept.iter().all(far) {
            kept.push((index, here));
        }
    }
    kept.into_iter().map(|(index, _)| index).collect()
}

/// Sums of the darkness over boxes, one bin apart.
struct Boxes {
    bin_px: usize,
    side_px: usize,
    flat_side: usize,
    /// Number of boxes in a row, and number of rows.
    count: usize,
    sums: Vec<f32>,
}

impl Boxes {
    fn of(flat: &FlatDisc, shape: &MarkImage) -> Self {
        let bin_px = (2.0 * shape.half_length_px / BINS_PER_LENGTH)
            .round()
            .max(1.0) as usize;
        let bins = flat.side() / bin_px;
        let mut binned = vec![0.0; bins * bins];
        let mut columns = vec![0.0; flat.side()];
        let rows_of_bins = flat.values().chunks_exact(bin_px * flat.side());
        for (rows, binned) in rows_of_bins.zip(binned.chunks_exact_mut(bins)) {
            column_sums(rows, &mut columns);
            for (bin, columns) in binned.iter_mut().zip(columns.chunks_exact(bin_px)) {
                *bin = columns.iter().sum();
            }
        }
        let count = (bins + 1).saturating_sub(BOX);
        let mut sums = Vec::with_capacity(count * count);
        for rows in binned.windows(BOX * bins).step_by(bins) {
            column_sums(rows, &mut columns[..bins]);
            let boxes = columns[..bins].windows(BOX);
            sums.extend(boxes.map(|columns| columns.iter().sum::<f32>()));
        }
        Self {
            bin_px,
            side_px: BOX * bin_px,
            flat_side: flat.side(),
            count,
            sums,
        }
    }

    /// Boxes that exceed a minimum sum and all their neighbours: the flattened disc's index of the centre, and the sum.
    fn peaks(&self, least: f32) -> Vec<(usize, f32)> {
        let middle = |n: usize| n * self.bin_px + self.side_px / 2;
        let mut peaks = Vec::new();
        for y in 1..self.count.saturating_sub(1) {
            let row = |y: usize| &self.sums[y * self.count..][..self.count];
            for (x, sum) in row(y).iter().enumerate().take(self.count - 1).skip(1) {
                if *sum > least {
                    let mut around = (y - 1..=y + 1).flat_map(|y| &row(y)[x - 1..=x + 1]);
                    if around.all(|neighbour| neighbour <= sum) {
                        peaks.push((middle(y) * self.flat_side + middle(x), *sum));
                    }
                }
            }
        }
        peaks
    }
}
