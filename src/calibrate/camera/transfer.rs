//! Photon transfer: increase of the noise with the light.

use super::dark::{Dark, clipped_variance, dn};
use super::shots::{Shot, Shots, inside, tiles};
use crate::calibrate::numbers::median;
use crate::calibrate::quantity::CalibratedQuantity;
use crate::estimation::{FitError, Fitted, Loss, Scale, regression, regression_by};
use crate::instrument::Instrument;
use crate::report::plot::{Figure, Labels, Series};
use crate::units::{Measured, SensorPx};
use nalgebra::Vector2;

/// Least span of light, in units of the read noise, that determines a slope.
const LEAST_SPAN: f64 = 3.0;
/// Relative noise between neighbours that the plate's grain and the wings of the marks' images may add.
const GRAIN_NOISE: f64 = 0.03;

/// Light above the dark level (DN) and variance (DN^2), with the number of pixels.
struct Point {
    light: f64,
    variance: f64,
    pixels: f64,
}

/// Gain from pairs of evenly illuminated frames.
pub(super) fn by_pairs(flats: &Shots, dark: &Dark) -> (CalibratedQuantity, Option<Figure>) {
    let pairs = flats.pairs();
    let mut points: Vec<Point> = pairs
        .iter()
        .flat_map(|(a, b)| of_pair(a, b, dark))
        .collect();
    if let Ok(noise) = &dark.noise {
        // Has the weight of ten squares of a pair.
        points.push(Point {
            light: 0.0,
            variance: noise.value.powi(2),
            pixels: 1e4,
        });
    }
    let none = "not determined: no pairs of evenly lit frames at equal exposure; take two at each of several exposures (--flat)";
    conclude(points, dark, none, "from pairs of evenly lit frames", 0.0)
}

/// The squares of a pair: the light of the two frames may differ by a common factor only.
fn of_pair(a: &Shot, b: &Shot, dark: &Dark) -> Vec<Point> {
    let level = dark.level_dn();
    let saturation = f64::from(a.frame.saturation_dn());
    let point = |corner: (usize, usize)| {
        let values: Vec<(f64, f64)> = inside(corner, 1)
            .map(|(x, y)| (dn(a, x, y) - level, dn(b, x, y) - level))
            .collect();
        let count = values.len() as f64;
        let mean = |of: fn(&(f64, f64)) -> f64| values.iter().map(of).sum::<f64>() / count;
        let (mean_a, mean_b) = (mean(|v| v.0), mean(|v| v.1));
        let light = (mean_a + mean_b) / 2.0;
        let differences: Vec<f64> = values
            .iter()
            .map(|(a, b)| (a - mean_a) - (b - mean_b))
            .collect();
        let variance = clipped_variance(&differences) / 2.0;
        let reach = 5.0 * variance.max(1.0).sqrt();
        let cut = light + level - reach < 0.0 || light + level + reach > saturation;
        (!cut).then_some(Point {
            light,
            variance,
            pixels: count,
        })
    };
    tiles(&a.frame).filter_map(point).collect()
}

/// Gain from the grain of the Sun's disc between the marks.
pub(super) fn by_suns(
    suns: &Shots,
    stated: &Instrument,
    dark: &Dark,
) -> (CalibratedQuantity, Option<Figure>) {
    let none = "not determined: no frames of the Sun; take pairs of evenly lit frames (--flat)";
    let reach = stated.plate.shape.size_mil() / 2.0 / stated.mounting.scale_mil_per_px.value + 4.0;
    let mut points: Vec<Point> = suns
        .frames
        .iter()
        .flat_map(|shot| noise_in_rings(shot, reach, dark))
        .collect();
    if let Ok(noise) = &dark.noise {
        let pixels = points.iter().map(|p| p.pixels).sum();
        points.push(Point {
            light: 0.0,
            variance: noise.value.powi(2),
            pixels,
        });
    }
    let how = "from neighbouring pixels of the Sun's disc between the marks; the plate's grain counts as noise, so at most this";
    conclude(points, dark, none, how, GRAIN_NOISE)
}

/// Light and noise in rings of the disc: difference of a pixel from the mean of its left and right neighbours.
fn noise_in_rings(shot: &Shot, mark_reach_px: f64, dark: &Dark) -> Vec<Point> {
    const RINGS: usize = 6;
    const OUTERMOST: f64 = 0.9;
    let Some((centre, radius)) = shot.disc else {
        return Vec::new();
    };
    let saturation = f64::from(shot.frame.saturation_dn());
    let mut rings: Vec<(Vec<f64>, Vec<f64>)> = vec![Default::default(); RINGS];
    let near: Vec<SensorPx> = shot
        .marks
        .iter()
        .copied()
        .filter(|m| m.distance(centre) < radius + mark_reach_px)
        .collect();
    let span = |middle: f64, pixels: usize| {
        let low = (middle - radius).max(1.0) as usize;
        low..((middle + radius).max(0.0) as usize).min(pixels.saturating_sub(2))
    };
    for y in span(centre.y, shot.frame.height()) {
        for x in span(centre.x, shot.frame.width()) {
            let at = SensorPx::new(x as f64, y as f64);
            let part = (at.distance(centre) / radius / OUTERMOST).powi(2);
            if part >= 1.0 || near.iter().any(|m| m.distance(at) < mark_reach_px) {
                continue;
            }
            let [left, here, right] = [x - 1, x, x + 1].map(|x| dn(shot, x, y));
            let ring = &mut rings[(part * RINGS as f64) as usize];
            ring.0.push(here);
            ring.1.push(here - (left + right) / 2.0);
        }
    }
    rings
        .iter()
        .filter(|(values, _)| values.len() > 200)
        .filter_map(|(values, differences)| {
            let seen = median(values);
            // For independent pixels the difference has 1.5 times their variance.
            let variance = clipped_variance(differences) / 1.5;
            let clear = seen + 5.0 * variance.max(1.0).sqrt() < saturation;
            clear.then_some(Point {
                light: seen - dark.level_dn(),
                variance,
                pixels: values.len() as f64 / 2.0,
            })
        })
        .collect()
}

/// The gain: the slope of variance against light.
fn conclude(
    points: Vec<Point>,
    dark: &Dark,
    none: &str,
    how: &str,
    systematic: f64,
) -> (CalibratedQuantity, Option<Figure>) {
    let measured = points.iter().map(|p| (p.light, p.variance));
    let line = determined_line(&points, dark, none);
    let fitted = line.iter().flat_map(|(dark, gain)| {
        let brightest = points.iter().map(|p| p.light).fold(0.0, f64::max);
        [0.0, brightest].map(|light| (light, dark + gain.value * light))
    });
    let figure = Figure {
        labels: Labels::new(
            "Photon transfer",
            "light above the dark level, DN",
            "variance of a pixel, DN^2",
        ),
        series: vec![
            Series::dots("measured", measured),
            Series::curve("fitted", fitted),
        ],
    };
    let found =
        line.map(|(_, gain)| Measured::new(gain.value, gain.sigma.hypot(systematic * gain.value)));
    let key = "camera.noise.gain_dn_per_electron";
    let gain = CalibratedQuantity::measured(("gain", key, "DN/electron"), found, how);
    (gain, (points.len() > 1).then_some(figure))
}

/// The variance without light, and the slope, if the light determines them.
fn determined_line(points: &[Point], dark: &Dark, none: &str) -> Result<(f64, Measured), String> {
    if points.len() < 4 {
        return Err(none.into());
    }
    let (low, high) = points
        .iter()
        .fold((f64::INFINITY, 0.0_f64), |(low, high), p| {
            (low.min(p.light), high.max(p.light))
        });
    let least = LEAST_SPAN * dark.noise_dn();
    if high - low < least {
        return Err(format!(
            "not determined: the light spans {:.1} DN, at least {least:.1} is needed; take pairs at several exposures",
            high - low
        ));
    }
    let fitted = line(points).map_err(|_| none)?;
    let gain = fitted.measured(1);
    if gain.value < 3.0 * gain.sigma {
        return Err(format!(
            "not determined: the noise does not grow with the light ({:.2e} +- {:.1e} DN/electron)",
            gain.value, gain.sigma
        ));
    }
    Ok((fitted.parameters[0], gain))
}

/// Variance against light as a straight line, without outliers.
///
/// A variance of n values has a relative error of the square root of 2 / n. The weights use the variance predicted by the line: with the
/// measured ones, values that are small by chance would have the largest weight, and the slope would be too low. A robust loss would
/// make it too low as well, because the errors of variances are skewed.
fn line(points: &[Point]) -> Result<Fitted<2>, FitError> {
    /// Each pass reduces the error of the weights by the relative error of a variance, a few hundredths.
    const PASSES: usize = 3;
    let at = |p: &Point| Vector2::new(1.0, p.light);
    let sigma = |p: &Point, expected: f64| expected.max(1e-3) * (2.0 / p.pixels).sqrt();
    let (terms, variances): (Vec<_>, Vec<f64>) =
        points.iter().map(|p| (at(p), p.variance)).collect();
    let own: Vec<f64> = points.iter().map(|p| sigma(p, p.variance)).collect();
    let mut fitted = regression(&terms, &variances, &own)?;
    let weighted = points.iter().zip(&fitted.weights);
    let kept: Vec<&Point> = weighted
        .filter(|(_, w)| **w > 0.0)
        .map(|(p, _)| p)
        .collect();
    let (terms, variances): (Vec<_>, Vec<f64>) = kept.iter().map(|p| (at(p), p.variance)).collect();
    for _ in 0..PASSES {
        let by_line = |p: &&Point| sigma(p, at(p).dot(&fitted.parameters));
        let sigmas: Vec<f64> = kept.iter().map(by_line).collect();
        fitted = regression_by(Loss::Squares, Scale::Inflated, &terms, &variances, &sigmas)?;
    }
    Ok(fitted)
}
