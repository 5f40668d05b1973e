//! The blur of the limb, and how blur and scale depend on the camera's temperature.

use super::shots::SunShot;
use crate::calibrate::numbers::median;
use crate::calibrate::quantity::CalibratedQuantity;
use crate::estimation::{MEDIAN_SIGMA, SIGMA_PER_MEDIAN, regression};
use crate::report::plot::{Figure, Labels, Series};
use crate::units::Measured;
use nalgebra::Vector2;

/// Fewest frames, and the least range of temperature, that determine a dependence.
const LEAST_FRAMES: usize = 8;
const LEAST_RANGE_C: f64 = 3.0;
/// Systematic error of the limb fit, whatever the number of frames.
const BLUR_SYSTEMATIC_PX: f64 = 0.02;

pub(super) struct Focus {
    pub quantities: Vec<CalibratedQuantity>,
    pub reference_c: Option<f64>,
    pub figures: Vec<Figure>,
}

/// Blur and its dependence on temperature from frames of the Sun.
pub(super) fn measure(suns: &[SunShot]) -> Focus {
    let temperatures: Vec<f64> = suns.iter().filter_map(|s| s.temperature_c).collect();
    let reference_c = temperatures.iter().sum::<f64>() / temperatures.len().max(1) as f64;
    let refused = refusal(&temperatures);
    let by_temperature = |value: fn(&SunShot) -> Option<f64>| -> Vec<(f64, f64)> {
        let point = |s: &SunShot| Some((s.temperature_c? - reference_c, value(s)?));
        suns.iter().filter_map(point).collect()
    };
    let blurs = by_temperature(|s| s.blur_px);
    let scales = by_temperature(|s| s.scale_mil_per_px);
    let slope = |points: &[(f64, f64)]| match &refused {
        Some(why) => Err(why.clone()),
        None => line(points).ok_or_else(|| "not determined: too few frames".to_owned()),
    };
    let blur_slope = slope(&blurs).map(|l| l.1);
    let scale_slope =
        slope(&scales).map(|(mean, slope)| Measured::new(slope.value / mean, slope.sigma / mean));
    let determined = blur_slope.is_ok() || scale_slope.is_ok();
    let mut quantities = vec![blur(suns, refused.is_none().then_some(&blurs))];
    quantities.push(quantity(
        "blur with temperature",
        "optics.temperature.blur_px_per_c",
        "px/deg C",
        blur_slope,
    ));
    quantities.push(quantity(
        "scale with temperature",
        "optics.temperature.scale_per_c",
        "1/deg C",
        scale_slope,
    ));
    let figure = |title, y, points: &[(f64, f64)]| Figure {
        labels: Labels::new(title, "deg C from the mean temperature", y),
        series: vec![Series::dots("frames", points.iter().copied())],
    };
    let figures = determined.then(|| {
        vec![
            figure("Blur of the limb with temperature", "px, 1 sigma", &blurs),
            figure("Scale with temperature", "mil/px", &scales),
        ]
    });
    Focus {
        quantities,
        reference_c: determined.then_some(reference_c),
        figures: figures.unwrap_or_default(),
    }
}

/// The reason why such temperatures do not determine a dependence.
fn refusal(temperatures: &[f64]) -> Option<String> {
    let most = temperatures
        .iter()
        .copied()
        .fold(f64::NEG_INFINITY, f64::max);
    let least = temperatures.iter().copied().fold(f64::INFINITY, f64::min);
    let range = most - least;
    match temperatures.len() {
        0 => Some("not determined: no temperature (CAMTEMP) in the frames of the Sun".to_owned()),
        _ if range < LEAST_RANGE_C => Some(format!(
            "not determined: temperatures span {range:.1} deg C, at least {LEAST_RANGE_C} are needed"
        )),
        n if n < LEAST_FRAMES => Some(format!(
            "not determined: expected at least {LEAST_FRAMES} frames of the Sun, found {n}"
        )),
        _ => None,
    }
}

fn quantity(
    name: &'static str,
    key: &'static str,
    unit: &'static str,
    found: Result<Measured, String>,
) -> CalibratedQuantity {
    let remark = "from frames of the Sun; a slope within its sigma is none";
    CalibratedQuantity::measured((name, key, unit), found, remark)
}

/// The blur; if it depends on temperature, at the mean temperature.
fn blur(suns: &[SunShot], with_temperature: Option<&Vec<(f64, f64)>>) -> CalibratedQuantity {
    let values: Vec<f64> = suns.iter().filter_map(|s| s.blur_px).collect();
    let at_reference = with_temperature
        .and_then(|points| line(points))
        .map(|l| l.0);
    let found = match values.len() {
        0..3 => Err(format!(
            "not determined: expected at least 3 frames of the whole Sun, found {}",
            values.len()
        )),
        count => {
            let middle = at_reference.unwrap_or_else(|| median(&values));
            let off: Vec<f64> = values.iter().map(|v| (v - median(&values)).abs()).collect();
            let scatter = SIGMA_PER_MEDIAN * median(&off) * MEDIAN_SIGMA / (count as f64).sqrt();
            Ok(Measured::new(middle, scatter.hypot(BLUR_SYSTEMATIC_PX)))
        }
    };
    let remark = "of the Sun's limb, the pixel response removed in quadrature";
    CalibratedQuantity::measured(("blur", "optics.blur_px", "px"), found, remark)
}

/// Value at 0 and slope of a straight line through points.
fn line(points: &[(f64, f64)]) -> Option<(f64, Measured)> {
    let terms: Vec<_> = points.iter().map(|p| Vector2::new(1.0, p.0)).collect();
    let values: Vec<f64> = points.iter().map(|p| p.1).collect();
    let fitted = regression(&terms, &values, &vec![1.0; points.len()]).ok()?;
    Some((fitted.parameters[0], fitted.measured(1)))
}
