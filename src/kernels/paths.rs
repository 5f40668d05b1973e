//! Brightness along paths across a picture, and tables of it by columns.

use super::{LANES, WHOLES, groups, larger, smaller};
use multiversion::multiversion;

/// Number of columns of a table that are processed in parallel (SIMD).
pub const COLUMNS: usize = 2 * LANES;

/// Successive positions along a path in a picture.
#[derive(Debug, Clone, Copy, Default)]
pub struct OnPath {
    /// Index of the pixel before each position, and the fraction of a pixel beyond it.
    pub column: [u32; LANES],
    pub row: [u32; LANES],
    right: [f32; LANES],
    below: [f32; LANES],
    /// The four pixels around each position: the upper ones, left and right, then the lower ones.
    pub pixels: [[u32; LANES]; 4],
}

/// The positions at the steps of a path, from `first` on, in a picture of some width and height. Columns and rows are
/// polynomials of the step, the constant first.
#[multiversion(targets("x86_64+avx2"))]
pub fn follow_path(
    [columns, rows]: [[f32; 3]; 2],
    first: f32,
    size: [usize; 2],
    groups: &mut [OnPath],
) {
    let last = size.map(|size| (size - 2) as f32);
    let mut steps: [f32; LANES] = std::array::from_fn(|k| first + k as f32);
    for group in groups {
        (group.column, group.right) = whole_pixels(&steps, columns, last[0]);
        (group.row, group.below) = whole_pixels(&steps, rows, last[1]);
        for step in &mut steps {
            *step += LANES as f32;
        }
    }
}

/// Positions on one axis as a pixel index, at most `last`, and the fraction of a pixel beyond it.
#[inline(always)]
fn whole_pixels(steps: &[f32; LANES], path: [f32; 3], last: f32) -> ([u32; LANES], [f32; LANES]) {
    const BITS: u32 = (1 << 22) - 1;
    let (mut whole, mut part) = ([0; LANES], [0.0; LANES]);
    for k in 0..LANES {
        let at = path[0] + (path[1] + path[2] * steps[k]) * steps[k];
        let shifted = larger(smaller(at - 0.5, last), 0.0) + WHOLES;
        whole[k] = shifted.to_bits() & BITS;
        part[k] = at - (shifted - WHOLES);
    }
    (whole, part)
}

/// The brightness interpolated between the four pixels around each position.
#[multiversion(targets("x86_64+avx2"))]
pub fn light_on_path(groups: &[OnPath], light: &mut [f32]) {
    for (group, light) in groups.iter().zip(light.as_chunks_mut::<LANES>().0) {
        let mut pixels = [[0.0; LANES]; 4];
        for (dn, whole) in pixels.iter_mut().zip(&group.pixels) {
            for k in 0..LANES {
                dn[k] = whole[k] as i32 as f32;
            }
        }
        let [a, b, c, d] = &pixels;
        for k in 0..LANES {
            let upper = a[k] + (b[k] - a[k]) * group.right[k];
            let lower = c[k] + (d[k] - c[k]) * group.right[k];
            light[k] = upper + (lower - upper) * group.below[k];
        }
    }
}

/// The quantile of each column of a table, with `below` values below it, to 2^-18 of the column's range. `width`, the
/// length of a row and the number of quantiles, is a multiple of [`COLUMNS`].
#[multiversion(targets("x86_64+avx2"))]
pub fn column_quantiles(table: &[f32], width: usize, below: usize, quantiles: &mut [f32]) {
    const HALVINGS: usize = 18;
    let blocks = table.as_chunks::<COLUMNS>().0;
    let (quantiles, _) = quantiles.as_chunks_mut::<COLUMNS>();
    for (n, quantiles) in quantiles.iter_mut().enumerate() {
        let rows = || {
            let rows = blocks.chunks_exact(width / COLUMNS);
            rows.map(|row| &row[n])
        };
        let (mut low, mut high) = ([f32::INFINITY; COLUMNS], [f32::NEG_INFINITY; COLUMNS]);
        for row in rows() {
            for k in 0..COLUMNS {
                low[k] = smaller(low[k], row[k]);
                high[k] = larger(high[k], row[k]);
            }
        }
        for _ in 0..HALVINGS {
            let mut counts = [0; COLUMNS];
            for k in 0..COLUMNS {
                quantiles[k] = (low[k] + high[k]) / 2.0;
            }
            for row in rows() {
                for k in 0..COLUMNS {
                    counts[k] += i32::from(row[k] < quantiles[k]);
                }
            }
            for k in 0..COLUMNS {
                let is_below = counts[k] <= below as i32;
                low[k] = if is_below { quantiles[k] } else { low[k] };
                high[k] = if is_below { high[k] } else { quantiles[k] };
            }
        }
    }
}

/// Linear least squares of values by three columns. The first column is 1 where values count; all columns are 0 elsewhere.
/// Given the inverse of the normal matrix, returns the coefficients and the sum of squared residuals. All lists have the
/// same length, in whole lanes.
#[multiversion(targets("x86_64+avx2"))]
pub fn fit_columns(
    columns: [&[f32]; 3],
    inverse: &[[f32; 3]; 3],
    values: &[f32],
) -> ([f32; 3], f32) {
    let columns = columns.map(groups);
    let mut sums = [[0.0_f32; LANES]; 3];
    for (n, values) in groups(values).iter().enumerate() {
        for (sums, column) in sums.iter_mut().zip(columns) {
            for k in 0..LANES {
                sums[k] += column[n][k] * values[k];
            }
        }
    }
    let [a, b, c] = sums.map(|lanes| lanes.iter().sum::<f32>());
    let found = inverse.map(|row| row[0] * a + row[1] * b + row[2] * c);
    let mut squares = [0.0_f32; LANES];
    for (n, values) in groups(values).iter().enumerate() {
        let [ones, second, third] = columns.map(|column| &column[n]);
        for k in 0..LANES {
            let fitted = found[1] * second[k] + found[2] * third[k];
            let left = ones[k] * (values[k] - found[0]) - fitted;
            squares[k] += left * left;
        }
    }
    (found, squares.iter().sum())
}

#[cfg(test)]
mod tests {
    use super::super::tests::wave;
    use super::*;

    #[test]
    fn the_light_on_a_path_is_interpolated_between_pixels_and_none_is_read_outside() {
        const SIZE: [usize; 2] = [9, 7];
        let dn = |x: u32, y: u32| x * x + 10 * y;
        let mut groups = [OnPath::default(); 2];
        // From (0, 6) to (8, 0), and beyond the corner.
        let path = [[4.0, 1.0, 0.0], [3.0, -0.75, 0.0]];
        follow_path(path, -4.0, SIZE, &mut groups);
        for group in &mut groups {
            for k in 0..LANES {
                let (x, y) = (group.column[k], group.row[k]);
                assert!(x < 8 && y < 6, "({x}, {y})");
                let square = [dn(x, y), dn(x + 1, y), dn(x, y + 1), dn(x + 1, y + 1)];
                for (pixels, dn) in group.pixels.iter_mut().zip(square) {
                    pixels[k] = dn;
                }
            }
        }
        let mut light = [0.0; 2 * LANES];
        light_on_path(&groups, &mut light);
        for (n, light) in light.iter().take(9).enumerate() {
            let (x, y) = (n as f32, 6.0 - 0.75 * n as f32);
            assert!((light - x * x - 10.0 * y).abs() < 1e-4, "{n}: {light}");
        }
    }

    #[test]
    fn quantiles_of_columns_are_those_of_the_sorted_columns() {
        let table = wave(21 * 2 * COLUMNS, 0.7);
        let mut quantiles = [0.0; 2 * COLUMNS];
        for below in [0, 2, 10, 20] {
            column_quantiles(&table, 2 * COLUMNS, below, &mut quantiles);
            for (n, quantile) in quantiles.iter().enumerate() {
                let mut column: Vec<f32> =
                    table.iter().skip(n).step_by(2 * COLUMNS).copied().collect();
                column.sort_by(f32::total_cmp);
                assert!((quantile - column[below]).abs() < 1e-5);
            }
        }
    }

    #[test]
    fn values_are_fitted_by_columns_where_they_count() {
        let row = |n: usize| [1.0, (n as f32 * 0.3).sin(), (n as f32 * 0.8).cos()];
        let fitted = |[a, b, c]: [f32; 3], [x, y, z]: [f32; 3]| a * x + b * y + c * z;
        // The first three values do not count.
        let mut columns = [[0.0; 3 * LANES]; 3];
        let mut values = [100.0; 3 * LANES];
        let mut normal = nalgebra::Matrix3::<f32>::zeros();
        for n in 3..values.len() {
            for (m, value) in row(n).into_iter().enumerate() {
                columns[m][n] = value;
            }
            normal += nalgebra::Vector3::from(row(n)) * nalgebra::RowVector3::from(row(n));
            values[n] = fitted([5.0, 2.0, -3.0], row(n)) + if n == 10 { 4.0 } else { 0.0 };
        }
        let inverse = normal.try_inverse().unwrap();
        let (found, squares) =
            fit_columns(columns.each_ref().map(|c| &c[..]), &inverse.data.0, &values);
        let left = |n: usize| values[n] - fitted(found, row(n));
        let plain: f32 = (3..values.len()).map(|n| left(n).powi(2)).sum();
        assert!((squares - plain).abs() < 1e-3 * plain);
        // Least-squares residuals are orthogonal to all columns.
        for m in 0..3 {
            let along: f32 = (3..values.len()).map(|n| left(n) * row(n)[m]).sum();
            assert!(along.abs() < 1e-3);
        }
    }
}
