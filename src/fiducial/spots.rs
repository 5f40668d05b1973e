//! Where the disc is dark: places that may be marks, whatever the camera's rotation.

use super::{CrossShape, FlatDisc, Settings};
use crate::lanes::{LANES, Scratch};
use crate::units::SensorPx;
use multiversion::multiversion;

/// The first look is at sums of so many pixels in each axis: a cross is many times larger.
const BIN_PX: usize = 2;
/// Bins along the side of a box; the cross's middle, where its arms are dense, fills it.
const BOX: usize = 5;
/// A cross of contrast 1 darkens its box by 0.37, one that the limb cuts by less.
const BOX_SHARE: f32 = 0.22;
/// A box must be darker than the noise by so many sigma.
const BOX_SIGMA: f32 = 4.0;
/// So many dark places are looked at for each mark that may be found.
const SPOTS_PER_DETECTION: usize = 2;

/// The flattened disc's values summed over bins, or bins over boxes.
struct Binned {
    side: usize,
    values: Scratch<f32>,
}

impl Binned {
    fn of(flat: &FlatDisc) -> Self {
        let side = flat.side() / BIN_PX;
        let mut values = Scratch::of_length(side * side);
        for (pair, bins) in flat
            .values()
            .chunks_exact(BIN_PX * flat.side())
            .zip(values.chunks_exact_mut(side))
        {
            let (upper, lower) = pair.split_at(flat.side());
            add_pairs(upper, lower, bins);
        }
        Self { side, values }
    }

    /// Sums over the boxes about every bin; 0 where the box does not fit.
    fn boxed(&self) -> Self {
        let side = self.side;
        let mut sums = Scratch::of_length(side * side);
        let mut columns = vec![0.0_f32; side];
        for row in 0..side {
            sums[row * side..][..side].fill(0.0);
            let entering = &self.values[row * side..][..side];
            columns.iter_mut().zip(entering).for_each(|(c, v)| *c += v);
            if row + 1 < BOX {
                continue;
            }
            let first = (row - BOX / 2) * side + BOX / 2;
            add_fives(&columns, &mut sums[first..first + side + 1 - BOX]);
            let leaving = &self.values[(row + 1 - BOX) * side..][..side];
            columns.iter_mut().zip(leaving).for_each(|(c, v)| *c -= v);
        }
        Self { side, values: sums }
    }

    /// Indices of the values above a least one that no neighbour exceeds.
    fn peaks(&self, least: f32) -> Vec<usize> {
        let inner = self.side..self.side * (self.side - 1);
        let mut peaks = Vec::new();
        for (n, group) in self.values[inner].chunks(LANES).enumerate() {
            // Most of the disc is bright.
            if group.iter().filter(|sum| **sum > least).count() == 0 {
                continue;
            }
            let first = self.side + n * LANES;
            let dark = (first..first + group.len()).filter(|n| self.values[*n] > least);
            peaks.extend(dark.filter(|n| self.is_peak(*n)));
        }
        peaks
    }

    fn is_peak(&self, index: usize) -> bool {
        let here = self.values[index];
        neighbours(index, self.side).all(|n| self.values[n] <= here)
    }
}

/// Sums over two columns of two rows.
#[multiversion(targets("x86_64+avx2"))]
fn add_pairs(upper: &[f32], lower: &[f32], bins: &mut [f32]) {
    let pairs = upper.chunks_exact(BIN_PX).zip(lower.chunks_exact(BIN_PX));
    for (bin, (upper, lower)) in bins.iter_mut().zip(pairs) {
        *bin = upper[0] + upper[1] + lower[0] + lower[1];
    }
}

/// Sums over five neighbours.
#[multiversion(targets("x86_64+avx2"))]
fn add_fives(columns: &[f32], sums: &mut [f32]) {
    for (sum, part) in sums.iter_mut().zip(columns.windows(BOX)) {
        *sum = part[0] + part[1] + part[2] + part[3] + part[4];
    }
}

/// Indices into the flattened disc's values of its darkest places, darkest first, half a mark apart at least.
pub(super) fn find_spots(flat: &FlatDisc, shape: &CrossShape, settings: &Settings) -> Vec<usize> {
    let boxes = Binned::of(flat).boxed();
    let box_px = (BOX * BIN_PX) as f32;
    let least = settings.min_contrast as f32 * BOX_SHARE * box_px * box_px;
    let unbinned = |index: usize| {
        let (row, column) = (index / boxes.side, index % boxes.side);
        BIN_PX * (row * flat.side() + column)
    };
    let mut dark: Vec<(usize, f32)> = Vec::new();
    for index in boxes.peaks(least) {
        let spot = unbinned(index);
        let sum = boxes.values[index];
        let noise = flat.noise(flat.position(spot)) as f32 * box_px;
        if sum > BOX_SIGMA * noise {
            dark.push((spot, sum));
        }
    }
    dark.sort_by(|a, b| b.1.total_cmp(&a.1));
    let mut kept: Vec<(usize, SensorPx)> = Vec::new();
    for (spot, _) in dark {
        let here = flat.position(spot);
        let far = |(_, other): &(usize, SensorPx)| other.distance(here) > shape.half_length_px;
        if kept.len() < SPOTS_PER_DETECTION * settings.max_detections && kept.iter().all(far) {
            kept.push((spot, here));
        }
    }
    kept.into_iter().map(|(spot, _)| spot).collect()
}

/// The 3 x 3 neighbourhood of an index, by rows.
pub(super) fn neighbours(index: usize, side: usize) -> impl Iterator<Item = usize> {
    (0..9).map(move |n| index + (n / 3) * side + n % 3 - side - 1)
}
