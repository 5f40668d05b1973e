//! Normal equations of up to eleven unknowns, and their solution.

use multiversion::multiversion;

/// Derivatives by the unknowns and, last, the residual of one observation, in units of its sigma.
pub(super) type Row = [f64; COLUMNS];
const COLUMNS: usize = UNKNOWNS + 1;
pub(super) const UNKNOWNS: usize = 11;
/// Column of the residuals.
pub(super) const RESIDUAL: usize = UNKNOWNS;

/// An unknown with less than this part of its information independent of those before it is not determined.
const LEAST_OWN_PART: f64 = 1e-10;

/// Sums over observations of the products of every two columns of their rows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Sums([Row; COLUMNS]);

/// The unknowns' best values, and how well they are known.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Solved(Sums);

impl Solved {
    /// Changes of the unknowns; zero for those that are held.
    pub(super) fn step(&self) -> [f64; UNKNOWNS] {
        std::array::from_fn(|n| self.covariance(n, RESIDUAL))
    }

    /// Of all observations at the solution.
    pub(super) fn chi2(&self) -> f64 {
        self.covariance(RESIDUAL, RESIDUAL)
    }

    /// Zero for unknowns that are held.
    pub(super) fn covariance(&self, n: usize, m: usize) -> f64 {
        self.0.0[n][m]
    }
}

impl Sums {
    pub(super) fn of(rows: &[Row]) -> Self {
        let mut sums = [[0.0; COLUMNS]; COLUMNS];
        add_products(&mut sums, rows);
        Self(sums)
    }

    /// With other sums, their observations multiplied by a weight.
    pub(super) fn with(&self, others: &Self, weight: f64) -> Self {
        let mut sums = *self;
        for (sums, others) in sums.0.iter_mut().zip(&others.0) {
            for (sum, other) in sums.iter_mut().zip(others) {
                *sum += other * weight;
            }
        }
        sums
    }

    /// Chi^2 of these observations after a step.
    pub(super) fn chi2(&self, step: &[f64; UNKNOWNS]) -> f64 {
        let mut left = [-1.0; COLUMNS];
        left[..UNKNOWNS].copy_from_slice(step);
        let dot = |row: &Row| -> f64 { row.iter().zip(&left).map(|(a, b)| a * b).sum() };
        self.0.iter().zip(&left).map(|(row, v)| v * dot(row)).sum()
    }

    /// How many of these observations' degrees of freedom the unknowns take: trace of covariance times sums.
    pub(super) fn absorbed(&self, solved: &Solved) -> f64 {
        let of_row = |n: usize| -> f64 {
            let pairs = self.0[n].iter().zip(&solved.0.0[n]);
            pairs.take(UNKNOWNS).map(|(a, b)| a * b).sum()
        };
        (0..UNKNOWNS).map(of_row).sum()
    }

    /// The unknowns that are free, the others held at zero; `None` where the observations do not determine them.
    pub(super) fn solved(&self, free: &[bool; UNKNOWNS]) -> Option<Solved> {
        let mut swept = self.0;
        sweep_out(&mut swept, free).then_some(Solved(Self(swept)))
    }
}

/// Sweeps the free unknowns out of the sums, one by one (Goodnight 1979), which leaves their covariance and, in the
/// residuals' column, their values. Whether each was determined.
#[multiversion(targets("x86_64+avx2"))]
fn sweep_out(sums: &mut [Row; COLUMNS], free: &[bool; UNKNOWNS]) -> bool {
    let mut all = [0.0; UNKNOWNS];
    for n in 0..UNKNOWNS {
        all[n] = sums[n][n];
        if !free[n] {
            sums[n] = [0.0; COLUMNS];
            sums.iter_mut().for_each(|row| row[n] = 0.0);
        }
    }
    for n in (0..UNKNOWNS).filter(|n| free[*n]) {
        let own = sums[n][n];
        if own.is_nan() || own <= LEAST_OWN_PART * all[n] {
            return false;
        }
        let inverse = 1.0 / own;
        let mut pivot = sums[n];
        pivot.iter_mut().for_each(|v| *v *= inverse);
        pivot[n] = inverse;
        for row in sums.iter_mut() {
            let share = row[n];
            row[n] = 0.0;
            for (sum, pivot) in row.iter_mut().zip(&pivot) {
                *sum -= share * pivot;
            }
        }
        sums[n] = pivot;
    }
    sums.iter().all(|row| row[RESIDUAL].is_finite())
}

#[multiversion(targets("x86_64+avx2"))]
fn add_products(sums: &mut [Row; COLUMNS], rows: &[Row]) {
    for row in rows {
        for (sums, of_row) in sums.iter_mut().zip(row) {
            for (sum, of_column) in sums.iter_mut().zip(row) {
                *sum += of_row * of_column;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// y = 2 + 3 x + noise, sigma 1.
    fn line() -> Sums {
        let row = |n: i32| {
            let (x, noise) = (f64::from(n), f64::from((n * 37).rem_euclid(11) - 5) * 0.1);
            let mut row = [0.0; COLUMNS];
            (row[0], row[4], row[RESIDUAL]) = (1.0, x, 2.0 + 3.0 * x + noise);
            row
        };
        Sums::of(&(-10..=10).map(row).collect::<Vec<_>>())
    }

    fn free(which: &[usize]) -> [bool; UNKNOWNS] {
        std::array::from_fn(|n| which.contains(&n))
    }

    #[test]
    fn a_line_is_found_with_its_covariance_and_chi2() {
        let sums = line();
        let solved = sums.solved(&free(&[0, 4])).unwrap();
        let step = solved.step();
        assert!((step[0] - 2.0).abs() < 0.1 && (step[4] - 3.0).abs() < 0.02);
        assert!((solved.covariance(0, 0) - 1.0 / 21.0).abs() < 1e-12);
        assert!((solved.covariance(4, 4) - 1.0 / 770.0).abs() < 1e-12);
        assert!((solved.chi2() - sums.chi2(&step)).abs() < 1e-9);
        assert!((sums.absorbed(&solved) - 2.0).abs() < 1e-12);
    }

    #[test]
    fn held_unknowns_stay_and_undetermined_ones_are_refused() {
        let sums = line();
        let solved = sums.solved(&free(&[4])).unwrap();
        assert_eq!((solved.step()[0], solved.covariance(0, 4)), (0.0, 0.0));
        assert_eq!(sums.solved(&free(&[0, 4, 5])), None);
    }
}
