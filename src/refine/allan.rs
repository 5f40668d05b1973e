//! The Allan deviation of a series with gaps.
//!
//! With means over m successive values, the deviation is the square root of half the mean square difference of successive means;
//! all pairs of adjacent means count, including overlapping ones (Riley 2008, NIST Special Publication 1065, section 5.2.4).
//! Of white noise of sigma s it is s / sqrt(m), of a random walk of q per step sqrt(q (2 m^2 + 1) / (6 m)), which is close to
//! sqrt(q m / 3) (IEEE Std 952-1997, annex C).

/// Fewest non-overlapping pairs of means that determine a deviation.
const LEAST_PAIRS: usize = 4;

/// Averaging time (s) and Allan deviation (unit of the values) for averages over 1, 2, 4, ... values that are `step_s` apart. The
/// runs have no gaps; no mean extends over several runs. Empty if no run is long enough.
pub fn deviation(runs: &[Vec<f64>], step_s: f64) -> Vec<(f64, f64)> {
    let longest = runs.iter().map(Vec::len).max().unwrap_or(0);
    let sums: Vec<Vec<f64>> = runs.iter().map(|run| running_sums(run)).collect();
    let lengths = (0..usize::BITS).map(|n| 1_usize << n);
    let lengths = lengths.take_while(|m| 2 * m <= longest);
    let at = |m: usize| Some((m as f64 * step_s, variance(&sums, m)?.sqrt()));
    lengths.filter_map(at).collect()
}

/// Cumulative sums, relative to the run's mean to avoid rounding errors.
fn running_sums(run: &[f64]) -> Vec<f64> {
    let mean = run.iter().sum::<f64>() / run.len().max(1) as f64;
    let mut sum = 0.0;
    let after = run.iter().map(|value| {
        sum += value - mean;
        sum
    });
    [0.0].into_iter().chain(after).collect()
}

/// The Allan variance of means over m values.
fn variance(sums: &[Vec<f64>], m: usize) -> Option<f64> {
    let pairs = |sums: &Vec<f64>| (sums.len().saturating_sub(1) / m).saturating_sub(1);
    let apart: usize = sums.iter().map(pairs).sum();
    let squares = sums.iter().flat_map(|sums| {
        let windows = sums.windows(2 * m + 1);
        windows.map(move |w| ((w[2 * m] - 2.0 * w[m] + w[0]) / m as f64).powi(2))
    });
    let (sum, count) = squares.fold((0.0, 0_u64), |(sum, n), square| (sum + square, n + 1));
    (apart >= LEAST_PAIRS && sum > 0.0).then(|| sum / count as f64 / 2.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};
    use rand_xoshiro::Xoshiro256PlusPlus;

    const STEP_S: f64 = 0.25;

    fn noise(count: usize, seed: u64) -> Vec<f64> {
        let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
        (0..count)
            .map(|_| StandardNormal.sample(&mut random))
            .collect()
    }

    fn walk(steps: &[f64]) -> Vec<f64> {
        let mut place = 1e6;
        steps
            .iter()
            .map(|step| {
                place += step;
                place
            })
            .collect()
    }

    /// Compares deviations with the formula where many means determine them.
    fn check(found: &[(f64, f64)], expected: impl Fn(f64) -> f64) {
        assert!(found.len() > 8, "{found:?}");
        for (time_s, deviation) in &found[..8] {
            let expected = expected((time_s / STEP_S).round());
            assert!(
                (deviation / expected - 1.0).abs() < 0.1,
                "{time_s} {deviation} {expected}"
            );
        }
    }

    #[test]
    fn white_noise_falls_with_the_root_of_the_time() {
        let white: Vec<f64> = noise(100_000, 1).iter().map(|v| 3.0 * v).collect();
        check(&deviation(&[white], STEP_S), |m| 3.0 / m.sqrt());
    }

    #[test]
    fn a_random_walk_grows_with_the_root_of_the_time() {
        let walked = walk(&noise(100_000, 2));
        let found = deviation(&[walked], STEP_S);
        check(&found, |m| ((2.0 * m * m + 1.0) / (6.0 * m)).sqrt());
        let slope = (found[7].1 / found[4].1).ln() / (found[7].0 / found[4].0).ln();
        assert!((slope - 0.5).abs() < 0.05, "{slope}");
    }

    #[test]
    fn no_mean_reaches_over_a_gap() {
        let (first, mut second) = (noise(50_000, 3), noise(50_000, 4));
        second.iter_mut().for_each(|value| *value += 1000.0);
        check(&deviation(&[first, second], STEP_S), |m| 1.0 / m.sqrt());
        assert!(deviation(&[vec![1.0; 100]], STEP_S).is_empty());
        assert!(deviation(&[], STEP_S).is_empty());
    }
}
