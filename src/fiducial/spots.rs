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

/// The flattened disc's values summed over bins, or bins over boxes; of the bins of a row there are whole lanes.
struct Binned {
    side: usize,
    values: Scratch<f32>,
}

impl Binned {
    fn of(flat: &FlatDisc) -> Self {
        let side = flat.side() / BIN_PX;
        let mut values = Scratch::of_length(side * side);
        let pairs = flat.values().chunks_exact(BIN_PX * flat.side());
        for (pair, bins) in pairs.zip(values.chunks_exact_mut(side)) {
            let (upper, lower) = pair.split_at(flat.side());
            add_pairs(upper, lower, bins);
        }
        Self { side, values }
    }

    /// Sums over boxes, each at its first bin; those that reach over the end of a row sum up nothing but margin.
    fn boxed(&self) -> Self {
        let side = self.side;
        let count = self.values.len().saturating_sub(BOX * side);
        let mut columns = Scratch::of_length(count);
        let rows = std::array::from_fn(|n| &self.values[n * side..][..count]);
        add_five(rows, &mut columns);
        let count = count.saturating_sub(BOX - 1);
        let mut values = Scratch::of_length(count);
        add_five(std::array::from_fn(|n| &columns[n..][..count]), &mut values);
        Self { side, values }
    }

    /// Indices of the values above a least one that no neighbour exceeds.
    fn peaks(&self, least: f32) -> Vec<usize> {
        let mut dark = Vec::new();
        let last = self.values.len().saturating_sub(self.side);
        find_dark(&self.values[..last], least, &mut dark);
        dark.retain(|n| *n > self.side && self.is_peak(*n));
        dark
    }

    fn is_peak(&self, index: usize) -> bool {
        let here = self.values[index];
        neighbours(index, self.side).all(|n| self.values[n] <= here)
    }
}

/// Sums over two columns of two rows.
#[multiversion(targets("x86_64+avx2"))]
fn add_pairs(upper: &[f32], lower: &[f32], bins: &mut [f32]) {
    const WIDTH: usize = BIN_PX * LANES;
    let rows = upper
        .as_chunks::<WIDTH>()
        .0
        .iter()
        .zip(lower.as_chunks::<WIDTH>().0);
    for ((upper, lower), bins) in rows.zip(bins.as_chunks_mut::<LANES>().0) {
        for (k, bin) in bins.iter_mut().enumerate() {
            let pair = BIN_PX * k;
            *bin = (upper[pair] + lower[pair]) + (upper[pair + 1] + lower[pair + 1]);
        }
    }
}

/// Sums of five lists, number by number.
#[multiversion(targets("x86_64+avx2"))]
fn add_five([a, b, c, d, e]: [&[f32]; BOX], sums: &mut [f32]) {
    let lists = a.iter().zip(b).zip(c).zip(d).zip(e);
    for (sum, ((((a, b), c), d), e)) in sums.iter_mut().zip(lists) {
        *sum = a + b + c + d + e;
    }
}

/// Indices of the values above a least one that neither the one before nor the one after exceeds.
#[multiversion(targets("x86_64+avx2"))]
fn find_dark(values: &[f32], least: f32, dark: &mut Vec<usize>) {
    let groups = |from| {
        values
            .get(from..)
            .unwrap_or_default()
            .as_chunks::<LANES>()
            .0
    };
    let rows = groups(0).iter().zip(groups(1)).zip(groups(2));
    for (n, ((before, here), after)) in rows.enumerate() {
        let mut found = [false; LANES];
        for k in 0..LANES {
            found[k] = (here[k] > least) & (here[k] >= before[k]) & (here[k] >= after[k]);
        }
        // Most of the disc is bright.
        if found.iter().fold(false, |any, found| any | found) {
            dark.extend((0..LANES).filter(|k| found[*k]).map(|k| n * LANES + k + 1));
        }
    }
}

/// Indices into the flattened disc's values of its darkest places, darkest first, half a mark apart at least.
pub(super) fn find_spots(flat: &FlatDisc, shape: &CrossShape, settings: &Settings) -> Vec<usize> {
    let boxes = Binned::of(flat).boxed();
    let box_px = (BOX * BIN_PX) as f32;
    let least = settings.min_contrast as f32 * BOX_SHARE * box_px * box_px;
    let unbinned = |index: usize| {
        let (row, column) = (index / boxes.side + BOX / 2, index % boxes.side + BOX / 2);
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
