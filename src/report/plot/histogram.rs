//! Histograms, with the expected distribution.

use super::axis::{Axis, decimals, extent, fixed};
use super::labels::{Labels, PlotError};
use super::sheet::{Entry, Sheet, Stroke, Swatch, hue};
use std::f64::consts::PI;

/// A distribution to compare with.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Density {
    /// Normal about zero.
    Normal { sigma: f64 },
    /// Lengths of vectors with two normally distributed components about zero (Rayleigh 1880).
    Rayleigh { sigma: f64 },
}

impl Density {
    /// Probability per unit of the value.
    fn at(self, value: f64) -> f64 {
        match self {
            Self::Normal { sigma } => {
                (-(value / sigma).powi(2) / 2.0).exp() / (sigma * (2.0 * PI).sqrt())
            }
            Self::Rayleigh { sigma } if value >= 0.0 => {
                value / sigma.powi(2) * (-(value / sigma).powi(2) / 2.0).exp()
            }
            Self::Rayleigh { .. } => 0.0,
        }
    }
}

const SIZE: (f64, f64) = (760.0, 420.0);
/// The axis ends at this multiple of the 99.9 % quantile; the title states the number of values beyond.
const REACH: f64 = 1.5;
/// Lines up to this multiple of that quantile are within the axis.
const NEAR: f64 = 4.0;

/// A histogram with named vertical lines and, by name, a distribution of the same area. Each value counts as `each`: 1 for a frame, or
/// the seconds that it represents. The legend states which lines are beyond the axis.
///
/// # Errors
/// If there is nothing to draw.
pub fn histogram(
    labels: &Labels,
    values: &[f64],
    each: f64,
    bins: usize,
    lines: &[(&str, f64)],
    expected: Option<(&str, Density)>,
) -> Result<String, PlotError> {
    let (low, high) = span(values, lines).ok_or_else(|| labels.empty())?;
    let bins = bins.max(1);
    let width = (high - low) / bins as f64;
    let mut counts = vec![0_u32; bins];
    for value in values.iter().filter(|value| (low..=high).contains(value)) {
        let bin = ((value - low) / width) as usize;
        counts[bin.min(bins - 1)] += 1;
    }
    let inside: u32 = counts.iter().sum();
    let counts: Vec<f64> = counts.into_iter().map(|n| f64::from(n) * each).collect();
    let curve: Vec<(f64, f64)> = expected.map_or(Vec::new(), |(_, density)| {
        let area = values.len() as f64 * each * width;
        let at = |n: u32| low + (high - low) * f64::from(n) / 300.0;
        (0..=300)
            .map(|n| (at(n), area * density.at(at(n))))
            .collect()
    });
    let most = counts.iter().copied().chain(curve.iter().map(|p| p.1));
    let most = most.fold(each, f64::max);
    let beyond = values.len() - inside as usize;
    let mut labels = labels.clone();
    if beyond > 0 {
        let counted = fixed(beyond as f64 * each, decimals(each));
        let unit = labels.y.split_once(',').map_or("", |(_, unit)| unit);
        labels.title += &format!(" ({counted}{unit} beyond the axis)");
    }
    let is_shown = |at: f64| (low..=high).contains(&at);
    let legend = legend(&labels.y, lines, is_shown, expected.map(|(name, _)| name));
    let axes = (Axis::exact(low, high), Axis::exact(0.0, 1.06 * most));
    let mut sheet = Sheet::new(SIZE, 0.0, &labels, axes, &legend);
    for (bin, count) in counts.iter().enumerate().filter(|(_, count)| **count > 0.0) {
        let left = low + bin as f64 * width;
        let corners = [(left, 0.0), (left + width, *count)].map(|p| sheet.place(p));
        sheet.rectangle(corners[0], corners[1], "#9ec5de");
    }
    let curve: Vec<(f64, f64)> = curve.into_iter().map(|p| sheet.place(p)).collect();
    sheet.line(&curve, Stroke::solid(hue(1), 1.8));
    let shown = lines
        .iter()
        .enumerate()
        .filter(|(_, line)| is_shown(line.1));
    for (n, (_, at)) in shown {
        let upright = [(*at, 0.0), (*at, 1.06 * most)].map(|p| sheet.place(p));
        sheet.line(&upright, Stroke::solid(hue(n + 2), 1.4).dashed());
    }
    Ok(sheet.finish())
}

/// Range of the axis: from 0 if no value is negative. It includes lines near the values.
fn span(values: &[f64], lines: &[(&str, f64)]) -> Option<(f64, f64)> {
    let (low, high) = extent(values.iter().copied())?;
    let mut sizes: Vec<f64> = values
        .iter()
        .map(|v| v.abs())
        .filter(|v| v.is_finite())
        .collect();
    sizes.sort_by(f64::total_cmp);
    let usual = sizes[(sizes.len() * 999).div_ceil(1000) - 1];
    let lines = lines.iter().map(|(_, at)| *at);
    let near = lines.filter(|at| at.abs() <= NEAR * usual);
    let (first, last) = near.fold((0.0, 0.0), |(first, last): (f64, f64), at| {
        (first.min(at), last.max(at))
    });
    let reach = REACH * usual;
    let low = 1.04 * low.clamp(-reach, 0.0).min(first);
    let high = 1.04 * high.clamp(0.0, reach).max(last);
    Some(if low < high { (low, high) } else { (0.0, 1.0) })
}

fn legend(
    counted: &str,
    lines: &[(&str, f64)],
    is_shown: impl Fn(f64) -> bool,
    expected: Option<&str>,
) -> Vec<Entry> {
    let entry = |name: &str, swatch, colour| Entry {
        name: name.into(),
        swatch,
        colour,
    };
    let bars = entry(counted, Swatch::Bars, "");
    let expected = expected.map(|name| entry(name, Swatch::Line, hue(1)));
    let lines = lines.iter().enumerate();
    let lines = lines.map(|(n, (name, at))| match is_shown(*at) {
        true => entry(name, Swatch::Dashes, hue(n + 2)),
        false => entry(
            &format!("{name}, beyond the axis"),
            Swatch::Dashes,
            hue(n + 2),
        ),
    });
    [bars].into_iter().chain(expected).chain(lines).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels() -> Labels {
        Labels::new("Errors", "px", "frames")
    }

    #[test]
    fn every_value_is_in_a_bar_or_counted() {
        let svg = histogram(
            &labels(),
            &[0.1, 0.2, 0.25, 0.9],
            1.0,
            4,
            &[("limit", 0.5), ("far", 5.0)],
            None,
        )
        .unwrap();
        assert!(svg.contains(">limit<") && svg.contains(">far, beyond the axis<"));
        assert!(histogram(&labels(), &[], 1.0, 4, &[], None).is_err());
        let mut values = vec![1.0; 5000];
        values.push(100.0);
        let svg = histogram(&labels(), &values, 1.0, 10, &[], None).unwrap();
        assert!(svg.contains("Errors (1 beyond the axis)"));
        let timed = Labels::new("Errors", "px", "time, s");
        let svg = histogram(&timed, &values, 0.1, 10, &[], None).unwrap();
        assert!(svg.contains("Errors (0.1 s beyond the axis)"));
    }

    #[test]
    fn densities_have_unit_area() {
        for density in [
            Density::Normal { sigma: 0.7 },
            Density::Rayleigh { sigma: 0.7 },
        ] {
            let area: f64 = (-1000..1000)
                .map(|n| density.at(f64::from(n) * 0.01) * 0.01)
                .sum();
            assert!((area - 1.0).abs() < 1e-3, "{density:?} {area}");
        }
    }
}
