//! Statistics of small samples, and their random scatter.

use super::recipe::Generator;
use rand::{RngExt, SeedableRng};
use std::ops::RangeInclusive;

/// The smallest value that is not exceeded by at least the fraction `part` of the values.
pub fn quantile(mut values: Vec<f64>, part: f64) -> Option<f64> {
    values.sort_by(f64::total_cmp);
    let rank = (part * values.len() as f64).ceil() as usize;
    values.get(rank.max(1) - 1).copied()
}

/// Root mean square.
pub fn rms(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (count, squares) = values.fold((0, 0.0), |(n, sum), v| (n + 1, sum + v * v));
    (count > 0).then(|| (squares / f64::from(count)).sqrt())
}

/// The rms of `count` values of a Gaussian with rms 1 that is exceeded with the one-sided probability of `sigmas`.
///
/// The cube root of chi^2 over its degrees of freedom is approximated by a Gaussian (Wilson and Hilferty 1931): accurate to
/// 1 % from 5 values on.
fn rms_at(count: usize, sigmas: f64) -> f64 {
    let width = 2.0 / (9.0 * count.max(1) as f64);
    (1.0 - width + sigmas * width.sqrt()).max(0.0).powf(1.5)
}

/// The range of the population's rms for a measured rms of `count` Gaussian values, to `sigmas` on either side.
pub fn range_of_rms(measured: f64, count: usize, sigmas: f64) -> RangeInclusive<f64> {
    if sigmas == 0.0 {
        return measured..=measured;
    }
    measured / rms_at(count, sigmas)..=measured / rms_at(count, -sigmas)
}

/// Relative 1 sigma of the rms of `count` Gaussian values.
pub fn relative_sigma_of_rms(count: usize) -> Option<f64> {
    (count > 0).then(|| (0.5 / count as f64).sqrt())
}

/// The ratio of the medians of the first and of the second of some pairs, and the median of the second.
pub fn ratio_of_medians(pairs: &[(f64, f64)]) -> Option<(f64, f64)> {
    let first = quantile(pairs.iter().map(|p| p.0).collect(), 0.5)?;
    let second = quantile(pairs.iter().map(|p| p.1).collect(), 0.5)?;
    Some((first / second, second))
}

/// 1 sigma of the ratio of medians, from the scatter among samples drawn from the pairs with replacement (Efron 1979).
pub fn sigma_of_ratio(pairs: &[(f64, f64)]) -> Option<f64> {
    const SAMPLES: usize = 400;
    let mut rng = Generator::seed_from_u64(0);
    let mut drawn = || -> Vec<(f64, f64)> {
        let index = (0..pairs.len()).map(|_| rng.random_range(0..pairs.len()));
        index.map(|n| pairs[n]).collect()
    };
    let ratios: Option<Vec<f64>> = (0..SAMPLES)
        .map(|_| ratio_of_medians(&drawn()).map(|(ratio, _)| ratio))
        .collect();
    let ratios = ratios?;
    let mean = ratios.iter().sum::<f64>() / SAMPLES as f64;
    rms(ratios.iter().map(|r| r - mean))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::accuracy::outcome::MOST;
    use rand_distr::StandardNormal;

    #[test]
    fn a_quantile_leaves_its_part_at_or_below_it() {
        let values = || (1..=1000).map(f64::from).collect();
        assert_eq!(quantile(values(), 0.5), Some(500.0));
        assert_eq!(quantile(values(), MOST), Some(997.0));
        assert_eq!(quantile(values(), 1.0), Some(1000.0));
        assert_eq!(quantile(Vec::new(), 0.5), None);
    }

    #[test]
    fn the_range_of_an_rms_holds_the_truth_as_often_as_it_says() {
        let mut rng = Generator::seed_from_u64(3);
        let outside = (0..20_000).filter(|_| {
            let values = (0..24).map(|_| rng.sample::<f64, _>(StandardNormal));
            let measured = rms(values).unwrap();
            !range_of_rms(measured, 24, 2.0).contains(&1.0)
        });
        // 2 sigma on either side leave 4.55 %, with an uncertainty of 0.15 %.
        let share = outside.count() as f64 / 20_000.0;
        assert!((share - 0.0455).abs() < 0.006, "{share}");
    }

    #[test]
    fn the_sigma_of_a_ratio_is_the_scatter_of_ratios() {
        let mut rng = Generator::seed_from_u64(4);
        let mut pairs = || -> Vec<(f64, f64)> {
            let mut radial = || {
                let [x, y]: [f64; 2] = std::array::from_fn(|_| rng.sample(StandardNormal));
                x.hypot(y)
            };
            (0..300).map(|_| (radial(), radial())).collect()
        };
        let ratios: Vec<f64> = (0..300)
            .map(|_| ratio_of_medians(&pairs()).unwrap().0 - 1.0)
            .collect();
        let scatter = rms(ratios.into_iter()).unwrap();
        let stated = sigma_of_ratio(&pairs()).unwrap();
        // The median of n Rayleigh values has a relative sigma of 0.72 / sqrt(n).
        assert!((scatter - 0.059).abs() < 0.006, "{scatter}");
        assert!((stated / scatter - 1.0).abs() < 0.35, "{stated}");
    }
}
