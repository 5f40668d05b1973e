//! Kernels: the loops over pixels that the processor runs in parallel (SIMD), each compared with a plain version by a test.

pub mod limb;
pub mod marks;
pub mod paths;
pub mod ring;
pub mod sums;

use multiversion::multiversion;

/// Number of values that the processor handles in parallel (SIMD).
pub const LANES: usize = 8;

/// A list's complete groups of values that are processed in parallel (SIMD).
#[inline(always)]
pub fn groups(list: &[f32]) -> &[[f32; LANES]] {
    list.as_chunks().0
}

/// A list of zeros. Filling it in blocks avoids the slow start of long fills.
pub fn zeros<T: Copy + Default>(count: usize) -> Vec<T> {
    let mut list = Vec::with_capacity(count);
    while list.len() < count {
        list.resize((list.len() + FILL).min(count), T::default());
    }
    list
}

/// A copy of a list, made in the same way.
pub fn copied<T: Copy>(list: &[T]) -> Vec<T> {
    let mut copy = Vec::with_capacity(list.len());
    for part in list.chunks(FILL) {
        copy.extend_from_slice(part);
    }
    copy
}

/// Number of values that are filled in at a time.
const FILL: usize = 256;

/// The larger of two numbers, neither of them NaN: one instruction, where [`f32::max`] takes three.
#[inline(always)]
pub fn larger(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// The smaller of two numbers, likewise.
#[inline(always)]
pub fn smaller(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

/// Added to a number, this constant rounds it to an integer: the last bit of the sum has the value 1.
const WHOLES: f32 = 12_582_912.0;

/// The normal distribution's tail beyond z (Abramowitz and Stegun, Handbook of Mathematical Functions, 26.2.16, to 1e-5),
/// and its density there.
#[inline(always)]
pub fn normal_tail(z: f32) -> (f32, f32) {
    let t = 1.0 / (1.0 + 0.332_67 * z.abs());
    let density = normal_density(z);
    let beyond = ((0.937_298 * t - 0.120_167_6) * t + 0.436_183_6) * t * density;
    (if z < 0.0 { 1.0 - beyond } else { beyond }, density)
}

/// The normal distribution's density at z, with a relative error of 1e-5; values below 2^-120 are returned as about that.
///
/// It is 2^x / sqrt(2 pi) with x below 0: a polynomial in x minus its nearest integer (interpolated at Chebyshev's nodes),
/// with the integer added to the exponent.
#[inline(always)]
fn normal_density(z: f32) -> f32 {
    const EXPONENT_BITS: u32 = 23;
    let x = larger(-0.5 * std::f32::consts::LOG2_E * z * z, -120.0);
    let shifted = x + WHOLES;
    let part = x - (shifted - WHOLES);
    let series = (0.003_856_324 * part + 0.022_309_643) * part + 0.095_835_31;
    let series = (series * part + 0.276_515_33) * part + 0.398_942_3;
    f32::from_bits(
        series
            .to_bits()
            .wrapping_add(shifted.to_bits() << EXPONENT_BITS),
    )
}

/// Sums over rows of the same length as `sums`, column by column.
#[multiversion(targets("x86_64+avx2"))]
pub fn column_sums(rows: &[f32], sums: &mut [f32]) {
    sums.fill(0.0);
    for row in rows.chunks_exact(sums.len()) {
        for (sum, value) in sums.iter_mut().zip(row) {
            *sum += value;
        }
    }
}

/// Adds a row's light: its pixels minus the background of each column and of the row.
#[multiversion(targets("x86_64+avx2"))]
pub fn subtract<T: Copy + Into<u32>>(
    row: &[T],
    columns_dn: &[f32],
    row_dn: f32,
    light_dn: &mut Vec<f32>,
) {
    light_dn.extend(row.iter().zip(columns_dn).map(|(pixel, column_dn)| {
        let dn: u32 = (*pixel).into();
        dn as i32 as f32 - column_dn - row_dn
    }));
}

/// Whether at least one pixel of a row is above a value.
#[multiversion(targets("x86_64+avx2"))]
pub fn any_above<T: Copy + Default + Ord>(row: &[T], floor: T) -> bool {
    /// Number of pixels that are compared in parallel.
    const GROUP: usize = 32;
    let (groups, rest) = row.as_chunks::<GROUP>();
    let mut most = [T::default(); GROUP];
    for group in groups {
        for k in 0..GROUP {
            most[k] = if group[k] > most[k] {
                group[k]
            } else {
                most[k]
            };
        }
    }
    let of = |list: &[T]| list.iter().copied().fold(T::default(), T::max);
    of(&most).max(of(rest)) > floor
}

/// Number of values within a limit, and the sum of their squares.
#[multiversion(targets("x86_64+avx2"))]
pub fn squares_within(values: &[f32], limit: f32) -> [f32; 2] {
    let (mut counts, mut squares) = ([0.0_f32; LANES], [0.0_f32; LANES]);
    for values in groups(values) {
        for k in 0..LANES {
            let square = values[k] * values[k];
            let within = square < limit * limit;
            counts[k] += if within { 1.0 } else { 0.0 };
            squares[k] += if within { square } else { 0.0 };
        }
    }
    [counts, squares].map(|lanes| lanes.iter().sum())
}

/// The sum of the pixels of a row that are within a range, DN, and their number.
#[multiversion(targets("x86_64+avx2"))]
pub fn sum_within<T: Copy + Into<u32>>(row: &[T], [least, most]: [i32; 2]) -> [i32; 2] {
    let [mut sum, mut count] = [0; 2];
    for pixel in row {
        let dn: u32 = (*pixel).into();
        let dn = dn as i32;
        let is_within = i32::from((least <= dn) & (dn <= most));
        sum += is_within * dn;
        count += is_within;
    }
    [sum, count]
}

/// Weighted sums of the products of all pairs of a pixel's numbers: a symmetric matrix, of which the lower triangle is
/// filled in.
#[multiversion(targets("x86_64+avx2"))]
pub fn products<const N: usize>(
    pixels: &[[[f32; LANES]; N]],
    weights: &[[f32; LANES]],
) -> [[f32; N]; N] {
    let mut sums = [[[0.0_f32; LANES]; N]; N];
    for (values, weights) in pixels.iter().zip(weights) {
        for m in 0..N {
            let mut weighted = [0.0; LANES];
            for k in 0..LANES {
                weighted[k] = values[m][k] * weights[k];
            }
            // The compiler resolves this condition when it unrolls the loop, but not a range with a variable end.
            for l in 0..N {
                if l <= m {
                    for k in 0..LANES {
                        sums[m][l][k] += weighted[k] * values[l][k];
                    }
                }
            }
        }
    }
    let total = |m: usize, l: usize| match l <= m {
        true => sums[m][l].iter().sum(),
        false => 0.0,
    };
    std::array::from_fn(|m| std::array::from_fn(|l| total(m, l)))
}

/// Sum of the products of weights, in rows of `width` (whole lanes), with values, whose rows begin `stride` apart.
#[multiversion(targets("x86_64+avx2"))]
pub fn correlate(weights: &[f32], width: usize, values: &[f32], stride: usize) -> f32 {
    sum_over(weights, width, values, stride, |weight, value| {
        weight * value
    })
}

/// The same with the values' squares.
#[multiversion(targets("x86_64+avx2"))]
pub fn weighted_squares(weights: &[f32], width: usize, values: &[f32], stride: usize) -> f32 {
    sum_over(weights, width, values, stride, |weight, value| {
        weight * value * value
    })
}

#[inline(always)]
fn sum_over(
    weights: &[f32],
    width: usize,
    values: &[f32],
    stride: usize,
    term: impl Fn(f32, f32) -> f32,
) -> f32 {
    let mut lanes = [0.0_f32; LANES];
    for (weights, values) in weights.chunks_exact(width).zip(values.chunks(stride)) {
        for (weights, values) in groups(weights).iter().zip(groups(&values[..width])) {
            for k in 0..LANES {
                lanes[k] += term(weights[k], values[k]);
            }
        }
    }
    lanes.iter().sum()
}

/// A row of the disc, to be divided by its light.
pub struct SeenRow<'a> {
    pub seen: &'a [f32],
    pub masked: &'a [bool],
    /// The ratio of the disc's light to the expected light: a polynomial in the pixel's index, the constant first.
    pub factor: [f32; 3],
}

/// The darkness of a row's pixels: 1 minus the ratio of observed light to the disc's light. Excess brightness is clipped at
/// the largest allowed. The expected light is replaced by that of the disc itself; where less than the minimum is expected,
/// darkness and light are 0, and for masked pixels the darkness is 0.
#[multiversion(targets("x86_64+avx2"))]
pub fn divide_row(
    row: &SeenRow<'_>,
    least_light: f32,
    most_excess: f32,
    light: &mut [f32],
    darkness: &mut [f32],
) {
    let [first, slope, bend] = row.factor;
    let count = row.seen.len();
    let (seen, masked) = (&row.seen[..count], &row.masked[..count]);
    let (light, darkness) = (&mut light[..count], &mut darkness[..count]);
    for n in 0..count {
        let along = n as i32 as f32;
        let of_disc = light[n] * (first + along * (slope + along * bend));
        let left = smaller(seen[n], of_disc + most_excess) / of_disc;
        let is_judged = light[n] >= least_light;
        darkness[n] = if is_judged & !masked[n] {
            1.0 - left
        } else {
            0.0
        };
        light[n] = if is_judged { of_disc } else { 0.0 };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    pub(super) fn wave(count: usize, step: f32) -> Vec<f32> {
        (0..count).map(|n| (n as f32 * step).sin()).collect()
    }

    #[test]
    fn products_are_the_weighted_sums_of_products() {
        for count in [0, 8, 104] {
            let lists = [0.3, 0.7, 1.1].map(|step| wave(count, step));
            let [a, b, weights] = lists.each_ref().map(|list| groups(list));
            let pixels: Vec<_> = a.iter().zip(b).map(|(a, b)| [*a, *b]).collect();
            let [a, b, w] = &lists;
            let plain: f32 = (0..count).map(|n| a[n] * b[n] * w[n]).sum();
            assert!((products(&pixels, weights)[1][0] - plain).abs() < 1e-4);
        }
    }

    #[test]
    fn a_row_less_its_background_is_each_pixel_less_both_parts() {
        let (row, columns): (Vec<u8>, _) = ((0..77).collect(), wave(77, 0.3));
        let mut light = vec![9.0];
        subtract(&row, &columns, 2.5, &mut light);
        let plain = row
            .iter()
            .zip(&columns)
            .map(|(p, c)| f32::from(*p) - c - 2.5);
        assert_eq!(light[1..], plain.collect::<Vec<f32>>());
    }

    #[test]
    fn any_pixel_above_a_value_is_noticed_wherever_it_stands() {
        for n in 0..77 {
            let mut row = [7_u8; 77];
            assert!(!any_above(&row, 7));
            row[n] = 8;
            assert!(any_above(&row, 7));
        }
    }

    #[test]
    fn squares_within_a_limit_leave_out_what_is_beyond() {
        let values = wave(80, 0.7);
        let within = values.iter().filter(|v| v.abs() < 0.5);
        let (count, sum) = within.fold((0.0, 0.0), |(n, sum), v| (n + 1.0, sum + v * v));
        let found = squares_within(&values, 0.5);
        assert!(found[0] == count && (found[1] - sum).abs() < 1e-4);
    }

    #[test]
    fn a_sum_within_limits_leaves_out_what_is_beyond_them() {
        let row: Vec<u16> = (0..77).map(|n: u32| (n * 7919 % 4096) as u16).collect();
        let same = row.iter().filter(|dn| (100..=3000).contains(*dn));
        let (sum, count) = same.fold((0, 0), |(sum, count), dn| (sum + i32::from(*dn), count + 1));
        assert_eq!(sum_within(&row, [100, 3000]), [sum, count]);
    }

    #[test]
    fn column_sums_are_those_of_the_rows() {
        let rows = wave(3 * 21, 0.3);
        let mut sums = [9.0; 21];
        column_sums(&rows, &mut sums);
        for (n, sum) in sums.iter().enumerate() {
            assert!((sum - rows[n] - rows[n + 21] - rows[n + 42]).abs() < 1e-6);
        }
    }

    #[test]
    fn a_divided_row_is_dark_where_light_is_missing_and_0_where_little_is_expected() {
        let (mut light, mut darkness) = ([100.0, 50.0, 100.0, 50.0, 1.0], [9.0; 5]);
        let row = SeenRow {
            seen: &[50.0, 100.0, 110.0, 300.0, 1.0],
            masked: &[false, false, false, true, false],
            // 1, 2, 1, -2, ...: the polynomial through the first three.
            factor: [1.0, 2.0, -1.0],
        };
        divide_row(&row, 10.0, 20.0, &mut light, &mut darkness);
        assert_eq!(light, [100.0, 100.0, 100.0, -100.0, 0.0]);
        assert_eq!(darkness[..2], [0.5, 0.0]);
        assert!((darkness[2] + 0.1).abs() < 1e-6);
        assert_eq!(darkness[3..], [0.0, 0.0]);
    }

    #[test]
    fn a_correlation_is_the_sum_of_products_of_its_rows() {
        let (weights, values) = (wave(3 * 16, 0.3), wave(3 * 21, 0.7));
        let pairs = (0..3).flat_map(|row| (0..16).map(move |n| (row * 16 + n, row * 21 + n)));
        let pairs = pairs.map(|(w, v)| (weights[w], values[v]));
        let plain: f32 = pairs.clone().map(|(w, v)| w * v).sum();
        assert!((correlate(&weights, 16, &values, 21) - plain).abs() < 1e-4);
        let plain: f32 = pairs.map(|(w, v)| w * v * v).sum();
        assert!((weighted_squares(&weights, 16, &values, 21) - plain).abs() < 1e-4);
    }
}
