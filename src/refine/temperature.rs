//! The camera's temperature from the headers, where it is quantised and has outliers.

use crate::estimation::median;

/// Fraction of the frames that must state a temperature.
const LEAST_KNOWN: f64 = 0.9;
/// Readings to each side over which a running median removes outliers.
const SLIP: usize = 3;
/// Half of the averaging time, s: cameras do not warm faster.
const EVEN_S: f64 = 10.0;
/// A smaller change of temperature does not determine a dependence, degC.
const LEAST_CHANGE_C: f64 = 0.1;

/// Temperature at each of the times, which are in order, relative to the flight's median, degC. `None` where too few frames state one,
/// or it does not change.
///
/// A quantised thermometer is most accurate at the moment it changes: the temperature is then half-way between both readings. It is
/// interpolated linearly between two such moments.
pub(super) fn from_the_middle(time_s: &[f64], readings: &[Option<f64>]) -> Option<Vec<f64>> {
    let known: Vec<(f64, f64)> = time_s
        .iter()
        .zip(readings)
        .filter_map(|(time_s, reading)| Some((*time_s, reading.filter(|c| c.is_finite())?)))
        .collect();
    if known.is_empty() || (known.len() as f64) < LEAST_KNOWN * time_s.len() as f64 {
        return None;
    }
    let knots = knots(&without_slips(&known));
    let readings: Vec<f64> = interpolated(&knots, time_s);
    let means = running_mean(&readings, time_s);
    let middle = median(&means)?;
    let most = means.iter().map(|c| (c - middle).abs()).fold(0.0, f64::max);
    (most > LEAST_CHANGE_C).then(|| means.iter().map(|c| c - middle).collect())
}

fn without_slips(known: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let near = |n: usize| &known[n.saturating_sub(SLIP)..known.len().min(n + SLIP + 1)];
    let local = |n: usize| median(near(n).iter().map(|(_, c)| c));
    let points = known.iter().enumerate();
    points
        .map(|(n, (time_s, c))| (*time_s, local(n).unwrap_or(*c)))
        .collect()
}

/// The first and the last reading, and the midpoints of all changes.
fn knots(known: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let changes = known.windows(2).filter(|pair| pair[0].1 != pair[1].1);
    let half = |pair: &[(f64, f64)]| {
        let middle = |a: f64, b: f64| (a + b) / 2.0;
        (middle(pair[0].0, pair[1].0), middle(pair[0].1, pair[1].1))
    };
    let ends = [known.first().copied(), known.last().copied()];
    let [first, last] = ends.map(|end| end.into_iter());
    first.chain(changes.map(half)).chain(last).collect()
}

/// Linear interpolation between knots; constant before the first and after the last.
fn interpolated(knots: &[(f64, f64)], time_s: &[f64]) -> Vec<f64> {
    let at = |time_s: &f64| {
        let next = knots.partition_point(|(t, _)| t <= time_s);
        match (next.checked_sub(1).map(|n| knots[n]), knots.get(next)) {
            (Some((t0, c0)), Some((t1, c1))) => c0 + (c1 - c0) * (time_s - t0) / (t1 - t0),
            (Some((_, c)), None) => c,
            (None, Some((_, c))) => *c,
            (None, None) => 0.0,
        }
    };
    time_s.iter().map(at).collect()
}

/// Running mean over as many values before as after, up to the very ends, so that it leaves a straight line unchanged.
fn running_mean(values: &[f64], time_s: &[f64]) -> Vec<f64> {
    let count = values.len();
    let steps = time_s.windows(2).map(|pair| pair[1] - pair[0]);
    let step_s = median(steps).filter(|step_s| *step_s > 0.0);
    let reach = step_s.map_or(0, |step_s| (EVEN_S / step_s) as usize);
    let mut sums = vec![0.0];
    for value in values {
        sums.push(sums[sums.len() - 1] + value);
    }
    let mean = |n: usize| {
        let side = reach.min(n).min(count - 1 - n);
        (sums[n + side + 1] - sums[n - side]) / (2 * side + 1) as f64
    };
    (0..count).map(mean).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn times(count: usize) -> Vec<f64> {
        (0..count).map(|n| n as f64 / 4.0).collect()
    }

    #[test]
    fn what_goes_straight_stays_straight_though_it_is_stated_in_steps_and_with_slips() {
        let times = times(4000);
        let truth: Vec<f64> = times.iter().map(|t| 20.0 - t / 100.0).collect();
        let mut readings: Vec<Option<f64>> = truth.iter().map(|c| Some(c.round())).collect();
        readings[777] = Some(-999.0);
        readings[1234] = None;
        let found = from_the_middle(&times, &readings).unwrap();
        let middle = median(&truth).unwrap();
        // Half a step is allowed at the ends, where the time of the change is not known.
        for n in 200..3800 {
            assert!((found[n] - (truth[n] - middle)).abs() < 0.15, "{n}");
        }
    }

    #[test]
    fn no_temperature_is_given_by_few_frames_or_by_one_that_stays() {
        let times = times(100);
        assert_eq!(from_the_middle(&times, &[None; 100]), None);
        assert_eq!(from_the_middle(&times, &[Some(21.0); 100]), None);
        let few: Vec<Option<f64>> = (0..100).map(|n| (n < 50).then_some(n as f64)).collect();
        assert_eq!(from_the_middle(&times, &few), None);
        assert_eq!(from_the_middle(&[], &[]), None);
    }
}
