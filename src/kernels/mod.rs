//! Kernels: the loops over pixels that the processor works on side by side, each held to a plain twin by a test.

pub mod limb;
pub mod ring;
pub mod sums;

use multiversion::multiversion;

/// Numbers that the processor works on side by side.
pub const LANES: usize = 8;

/// A list's whole groups of numbers that are worked on side by side.
#[inline(always)]
pub fn groups(list: &[f32]) -> &[[f32; LANES]] {
    list.as_chunks().0
}

/// So many numbers that are 0. Long fills in one go are slow to begin.
pub fn zeros<T: Copy + Default>(count: usize) -> Vec<T> {
    let mut list = Vec::with_capacity(count);
    while list.len() < count {
        list.resize((list.len() + FILL).min(count), T::default());
    }
    list
}

/// A copy of a list, likewise.
pub fn copied<T: Copy>(list: &[T]) -> Vec<T> {
    let mut copy = Vec::with_capacity(list.len());
    for part in list.chunks(FILL) {
        copy.extend_from_slice(part);
    }
    copy
}

/// Numbers that are filled in at a time.
const FILL: usize = 256;

/// The larger of two numbers, neither of them NaN: the processor's own comparison, where [`f32::max`] takes three.
#[inline(always)]
pub fn larger(a: f32, b: f32) -> f32 {
    if a > b { a } else { b }
}

/// The smaller of two, likewise.
#[inline(always)]
pub fn smaller(a: f32, b: f32) -> f32 {
    if a < b { a } else { b }
}

/// Above it the last bit of a number stands for 1.
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

/// The normal distribution's density at z, to 1e-5 of it; what is below 2^-120 is taken for about that.
///
/// It is 2^x / sqrt(2 pi) of an x below 0: a series in x less the nearest whole number (interpolated at Chebyshev's nodes), the
/// whole number added to its exponent.
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

/// Sums over rows that are as long as the sums, column by column.
#[multiversion(targets("x86_64+avx2"))]
pub fn column_sums(rows: &[f32], sums: &mut [f32]) {
    sums.fill(0.0);
    for row in rows.chunks_exact(sums.len()) {
        for (sum, value) in sums.iter_mut().zip(row) {
            *sum += value;
        }
    }
}

/// The sum of those pixels of a row that are from a least to a most value, DN, and how many these are.
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

/// Weighted sums of the products of a pixel's numbers with each other and themselves: a symmetric matrix, of which the lower triangle is
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
            // A plain condition is decided when the loop is unrolled; the end of a range is not.
            for l in 0..N {
                if l <= m {
                    for k in 0..LANES {
                        sums[m][l][k] += weighted[k] * values[l][k];
                    }
                }
            }
        }
    }
    sums.map(|row| row.map(|lanes| lanes.iter().sum()))
}

/// Sum of the products of weights, in rows of `width` (whole lanes), with values, of which a row begins `stride` after the
/// one before.
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
    /// The light of the disc over the expected one: a polynomial in the pixel's number, the constant first.
    pub factor: [f32; 3],
}

/// The darkness of a row's pixels, 1 less what is seen over the light there. What is brighter than the light counts as brighter by the
/// most allowed. The expected light becomes that of the disc itself; where less than the least is expected, darkness and light are 0, and of
/// masked pixels the darkness.
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

/// Two bars that cross at right angles, behind a Gaussian blur.
#[derive(Debug, Clone, Copy)]
pub struct Bars {
    pub half_length: f32,
    pub half_width: f32,
    /// 1 / sigma of the blur.
    pub per_blur: f32,
}

impl Bars {
    /// Whether each end of an arm may be taken on its own: they are so many sigma of the blur from its middle.
    #[inline(always)]
    pub fn has_ends_apart(&self) -> bool {
        const ENDS_APART_SIGMAS: f32 = 5.0;
        self.half_length * self.per_blur > ENDS_APART_SIGMAS
    }
}

/// Shares of the light that a cross takes at some places, and their slopes along x and y.
#[derive(Debug, Clone, PartialEq)]
pub struct Coverage {
    pub share: Vec<f32>,
    pub slope_x: Vec<f32>,
    pub slope_y: Vec<f32>,
}

impl Coverage {
    /// Sum of the squared slopes along one axis, the mean of both.
    pub fn slope_energy(&self) -> f64 {
        let squares = |slopes: &[f32]| slopes.iter().map(|s| f64::from(s * s)).sum::<f64>();
        (squares(&self.slope_x) + squares(&self.slope_y)) / 2.0
    }

    pub fn of_length(count: usize) -> Self {
        let [share, slope_x, slope_y] = std::array::from_fn(|_| vec![0.0; count]);
        Self {
            share,
            slope_x,
            slope_y,
        }
    }
}

/// What a cross takes of the light at offsets from its centre; `to_arms` leads, by rows, from an offset to one along the
/// arms.
///
/// A blurred bar is its profile along times its profile across, each a difference of two tails of the normal distribution;
/// the cross is two bars less their common middle.
#[multiversion(targets("x86_64+avx2"))]
pub fn cover(bars: &Bars, to_arms: [f32; 4], x: &[f32], y: &[f32], coverage: &mut Coverage) {
    if bars.has_ends_apart() {
        cover_by(long_blurred_bar, bars, to_arms, x, y, coverage);
    } else {
        cover_by(blurred_bar, bars, to_arms, x, y, coverage);
    }
}

/// The coverage, `long_bar` telling the share and slope of the bars along their length.
#[inline(always)]
fn cover_by(
    long_bar: impl Fn(f32, f32, f32) -> (f32, f32),
    bars: &Bars,
    to_arms: [f32; 4],
    x: &[f32],
    y: &[f32],
    coverage: &mut Coverage,
) {
    let count = x.len();
    let y = &y[..count];
    let share = &mut coverage.share[..count];
    let slope_x = &mut coverage.slope_x[..count];
    let slope_y = &mut coverage.slope_y[..count];
    for n in 0..count {
        [share[n], slope_x[n], slope_y[n]] = cover_at(&long_bar, bars, to_arms, x[n], y[n]);
    }
}

/// Share and slopes along x and y at one place.
#[inline(always)]
pub fn cover_at(
    long_bar: impl Fn(f32, f32, f32) -> (f32, f32),
    bars: &Bars,
    [ux, uy, vx, vy]: [f32; 4],
    x: f32,
    y: f32,
) -> [f32; 3] {
    let (u, v) = (ux * x + uy * y, vx * x + vy * y);
    let (long_u, long_slope_u) = long_bar(u, bars.half_length, bars.per_blur);
    let (long_v, long_slope_v) = long_bar(v, bars.half_length, bars.per_blur);
    let (wide_u, wide_slope_u) = blurred_bar(u, bars.half_width, bars.per_blur);
    let (wide_v, wide_slope_v) = blurred_bar(v, bars.half_width, bars.per_blur);
    let slope_u = long_slope_u * wide_v + wide_slope_u * (long_v - wide_v);
    let slope_v = long_slope_v * wide_u + wide_slope_v * (long_u - wide_u);
    [
        long_u * wide_v + wide_u * (long_v - wide_v),
        ux * slope_u + vx * slope_v,
        uy * slope_u + vy * slope_v,
    ]
}

/// The share and slope of a bar so long that its other end is not seen from either.
#[inline(always)]
pub fn long_blurred_bar(at: f32, half: f32, per_blur: f32) -> (f32, f32) {
    let (share, density) = normal_tail((at.abs() - half) * per_blur);
    (share, -(density * per_blur).copysign(at))
}

/// The share that a blurred bar of some half length covers at an offset from its middle, and its slope.
#[inline(always)]
pub fn blurred_bar(at: f32, half: f32, per_blur: f32) -> (f32, f32) {
    let (near, near_density) = normal_tail((at - half) * per_blur);
    let (far, far_density) = normal_tail((at + half) * per_blur);
    (near - far, (far_density - near_density) * per_blur)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn wave(count: usize, step: f32) -> Vec<f32> {
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
    fn a_sum_within_limits_leaves_out_what_is_beyond_them() {
        let row: Vec<u16> = (0..77).map(|n| n * 7919 % 4096).collect();
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
            // 1, 2, 1, -2, ...: a polynomial through the first three.
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

    #[test]
    fn the_coverage_is_that_of_the_blurred_cross_and_its_slopes() {
        const BARS: Bars = Bars {
            half_length: 7.8,
            half_width: 1.05,
            per_blur: 1.0 / 0.95,
        };
        // The blurred cross straight from its definition, turned by 0.3 rad.
        let share = |x: f64, y: f64| {
            let (sin, cos) = 0.3_f64.sin_cos();
            let (u, v) = (cos * x + sin * y, cos * y - sin * x);
            let below = |at: f64| {
                0.5 * libm::erfc(-at * f64::from(BARS.per_blur) / std::f64::consts::SQRT_2)
            };
            let bar =
                |at: f64, half: f32| below(at + f64::from(half)) - below(at - f64::from(half));
            let (long_u, long_v) = (bar(u, BARS.half_length), bar(v, BARS.half_length));
            let (wide_u, wide_v) = (bar(u, BARS.half_width), bar(v, BARS.half_width));
            long_u * wide_v + wide_u * long_v - wide_u * wide_v
        };
        let places = |n: i32| (f64::from(n) * 0.41 - 12.0, f64::from(n) * 0.17 - 5.0);
        let (x, y): (Vec<f32>, Vec<f32>) = (0..60)
            .map(places)
            .map(|(x, y)| (x as f32, y as f32))
            .unzip();
        let (sin, cos) = 0.3_f32.sin_cos();
        let mut found = Coverage::of_length(60);
        cover(&BARS, [cos, sin, -sin, cos], &x, &y, &mut found);
        for (n, (x, y)) in (0..60).map(places).enumerate() {
            assert!((f64::from(found.share[n]) - share(x, y)).abs() < 3e-5);
            const H: f64 = 1e-4;
            let slope_x = (share(x + H, y) - share(x - H, y)) / (2.0 * H);
            let slope_y = (share(x, y + H) - share(x, y - H)) / (2.0 * H);
            assert!((f64::from(found.slope_x[n]) - slope_x).abs() < 3e-5);
            assert!((f64::from(found.slope_y[n]) - slope_y).abs() < 3e-5);
        }
    }
}
