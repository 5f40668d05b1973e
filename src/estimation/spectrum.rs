//! The spectrum of a motion: Welch's mean over overlapping segments with a Hann window.

use rustfft::FftPlanner;
use rustfft::num_complex::Complex;
use std::f64::consts::TAU;

/// Longest segment, samples.
const LONGEST: usize = 1024;
/// A shorter segment is ignored.
const SHORTEST: usize = 16;

/// Power spectral density, one-sided: frequency (Hz) and density (unit^2/Hz), from values `step_s` apart. The runs have no gaps. Empty if
/// no run is long enough.
pub fn density(runs: &[Vec<f64>], step_s: f64) -> Vec<(f64, f64)> {
    let longest = runs.iter().map(Vec::len).max().unwrap_or(0);
    let length = (SHORTEST..=LONGEST.min(longest))
        .rev()
        .find(|n| n.is_power_of_two());
    let Some(length) = length else {
        return Vec::new();
    };
    let window: Vec<f64> = (0..length)
        .map(|n| (1.0 - (TAU * (n as f64 + 0.5) / length as f64).cos()) / 2.0)
        .collect();
    let norm = 2.0 * step_s / window.iter().map(|w| w * w).sum::<f64>();
    let transform = FftPlanner::new().plan_fft_forward(length);
    let mut sums = vec![0.0; length / 2];
    let mut pieces = 0;
    for run in runs {
        for start in (0..(run.len() + 1).saturating_sub(length)).step_by(length / 2) {
            let piece = &run[start..start + length];
            let mean = piece.iter().sum::<f64>() / length as f64;
            let samples = piece.iter().zip(&window);
            let mut samples: Vec<Complex<f64>> = samples
                .map(|(v, w)| Complex::new((v - mean) * w, 0.0))
                .collect();
            transform.process(&mut samples);
            sums.iter_mut()
                .zip(&samples)
                .for_each(|(sum, v)| *sum += v.norm_sqr());
            pieces += 1;
        }
    }
    let frequency = |n: usize| n as f64 / (length as f64 * step_s);
    let density = |sum: &f64| norm * sum / f64::from(pieces.max(1));
    let found = sums.iter().enumerate().skip(1);
    found.map(|(n, sum)| (frequency(n), density(sum))).collect()
}

/// The one-sided density of white noise with 1 sigma per value, values `step_s` apart (unit^2/Hz): its variance spread evenly up to half
/// the sampling rate.
pub fn floor(sigma: f64, step_s: f64) -> f64 {
    2.0 * sigma.powi(2) * step_s
}

/// The rms of all motion at or above a frequency: the square root of the density integrated from the highest frequency down.
/// The frequencies of `density` (Hz, unit^2/Hz) are multiples of the first, which is the step.
pub fn rms_above(density: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let step_hz = density.first().map_or(0.0, |first| first.0);
    let mut variance = 0.0;
    let from_above = density.iter().rev().map(|(hertz, density)| {
        variance += density * step_hz;
        (*hertz, variance.sqrt())
    });
    let mut rms: Vec<(f64, f64)> = from_above.collect();
    rms.reverse();
    rms
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_swing_stands_at_its_frequency_with_its_power() {
        let step_s = 0.25;
        let swing = |n: i32| 3.0 * (TAU * 0.5 * f64::from(n) * step_s).sin();
        let spectrum = density(&[(0..2000).map(swing).collect()], step_s);
        let peak = spectrum.iter().max_by(|a, b| a.1.total_cmp(&b.1)).unwrap();
        assert!((peak.0 - 0.5).abs() < 0.01);
        let width = spectrum[1].0 - spectrum[0].0;
        let power: f64 = spectrum.iter().map(|(_, density)| density * width).sum();
        assert!((power - 4.5).abs() < 0.05, "{power}");
        assert!(density(&[vec![1.0; 5]], step_s).is_empty());
    }
    #[test]
    fn the_cumulative_rms_of_white_noise_and_a_swing_is_theirs() {
        let flat: Vec<(f64, f64)> = (1..=512)
            .map(|n| (f64::from(n) * 2.0 / 512.0, floor(3.0, 0.25)))
            .collect();
        let rms = rms_above(&flat);
        assert!((rms[0].1 - 3.0).abs() < 1e-9 && (rms[256].1 - 4.5_f64.sqrt()).abs() < 0.01);
        let swing = |n: i32| 3.0 * (TAU * 0.5 * f64::from(n) * 0.25).sin();
        let rms = rms_above(&density(&[(0..2000).map(swing).collect()], 0.25));
        assert!((rms[0].1 - 4.5_f64.sqrt()).abs() < 0.02);
        let above = rms.iter().find(|(hertz, _)| *hertz > 0.6).unwrap();
        assert!(above.1 < 0.02, "{above:?}");
    }
}
