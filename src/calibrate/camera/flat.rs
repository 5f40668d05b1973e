//! Vignetting: decrease of the light from the middle of the picture.

use super::dark::{Dark, dn};
use super::shots::{Shots, SunShot, TILE_PX, inside, tiles};
use crate::calibrate::numbers::median;
use crate::calibrate::quantity::CalibratedQuantity;
use crate::estimation::{Fitted, regression};
use crate::instrument::Instrument;
use crate::report::plot::{Figure, Labels, Series};
use crate::units::Measured;
use nalgebra::{SVector, Vector5};

/// Every n-th pixel of a square, in both axes, is used for its light.
const STRIDE_PX: usize = 3;
/// A fourth-order term below this many sigmas is not fitted.
const SIGNIFICANT: f64 = 5.0;
/// Fewest frames of the Sun, and the part of the distance to the corner that they must reach.
const LEAST_SUNS: usize = 12;
const LEAST_REACH: f64 = 0.4;
/// Systematic relative error of the disc's brightness at the corner.
const SUNS_SYSTEMATIC: f64 = 0.005;

/// Vignetting: light in the middle, and the terms of second and, if significant, fourth order.
struct Falloff {
    middle: f64,
    square: Measured,
    fourth: Option<Measured>,
}

/// Light at a position relative to the middle.
struct Light {
    x: f64,
    y: f64,
    dn: f64,
}

/// The vignetting from evenly illuminated frames.
pub(super) fn by_flats(flats: &Shots, dark: &Dark) -> (Vec<CalibratedQuantity>, Option<Figure>) {
    let lights: Vec<Light> = flats
        .frames
        .iter()
        .flat_map(|shot| {
            let (width, height) = (shot.frame.width(), shot.frame.height());
            let saturation = f64::from(shot.frame.saturation_dn());
            let tile = |(x0, y0): (usize, usize)| {
                let pixels = inside((x0, y0), STRIDE_PX);
                let values: Vec<f64> = pixels.map(|(x, y)| dn(shot, x, y)).collect();
                let from_middle = |low: usize, pixels: usize| {
                    low as f64 + (TILE_PX as f64 - 1.0) / 2.0 - (pixels as f64 - 1.0) / 2.0
                };
                let level = mean_near(&values, median(&values));
                (level < 0.95 * saturation).then_some(Light {
                    x: from_middle(x0, width),
                    y: from_middle(y0, height),
                    dn: level - dark.level_dn(),
                })
            };
            relative(tiles(&shot.frame).filter_map(tile).collect())
        })
        .filter(|l| l.dn.is_finite())
        .collect();
    conclude(
        &lights,
        0.0,
        "from evenly lit frames, a tilt of the lamp's light removed",
    )
}

/// Normalises frames of any exposure to their own median light.
fn relative(mut lights: Vec<Light>) -> Vec<Light> {
    let median = median(lights.iter().map(|l| l.dn));
    lights.iter_mut().for_each(|l| l.dn /= median);
    lights
}

/// The mean of the values near their median, which excludes hot pixels.
fn mean_near(values: &[f64], middle: f64) -> f64 {
    let off: Vec<f64> = values.iter().map(|v| (v - middle).abs()).collect();
    let far = 8.0 * median(&off) + 1.0;
    let near = || values.iter().filter(|v| (**v - middle).abs() < far);
    near().sum::<f64>() / near().count().max(1) as f64
}

/// The vignetting from the brightness of the Sun's disc, all over the sensor.
pub(super) fn by_suns(
    suns: &[SunShot],
    stated: &Instrument,
) -> (Vec<CalibratedQuantity>, Option<Figure>) {
    let middle = stated.camera.middle_px();
    let light = |s: &SunShot| Light {
        x: s.sun_px.x - middle.x,
        y: s.sun_px.y - middle.y,
        dn: s.light_dn,
    };
    let lights = relative(suns.iter().map(light).collect());
    let corner2 = middle.vector().norm_squared();
    let reach = lights.iter().map(|l| l.x.hypot(l.y)).fold(0.0, f64::max);
    if suns.len() < LEAST_SUNS || reach < LEAST_REACH * corner2.sqrt() {
        let why = "not determined: take evenly lit frames (--flat), or frames with the Sun all over the sensor";
        return (vec![square_quantity(Err(why.into()), "")], None);
    }
    conclude(
        &lights,
        SUNS_SYSTEMATIC / corner2,
        "from the brightness of the Sun's disc over the sensor, a tilt removed; clouds or a low Sun would falsify it",
    )
}

/// `systematic` is the systematic error of the second order, added to the scatter.
fn conclude(
    lights: &[Light],
    systematic: f64,
    how: &str,
) -> (Vec<CalibratedQuantity>, Option<Figure>) {
    let Some(Falloff {
        middle,
        mut square,
        fourth,
    }) = fit(lights)
    else {
        let why = "not determined: no evenly lit frames (--flat) that are not saturated";
        return (vec![square_quantity(Err(why.into()), "")], None);
    };
    square.sigma = square.sigma.hypot(systematic);
    let mut quantities = vec![square_quantity(Ok(square), how)];
    quantities.extend(fourth.map(|fourth| {
        let key = "camera.vignetting.radial_per_px4";
        let name = ("vignetting, fourth order", key, "px^-4");
        CalibratedQuantity::measured(name, Ok(fourth), how)
    }));
    let b = fourth.map_or(0.0, |f| f.value);
    let model = |r2: f64| 1.0 + r2 * (square.value + r2 * b);
    let radius = |l: &Light| l.x.hypot(l.y);
    let reach = lights.iter().map(radius).fold(0.0, f64::max);
    let fitted = (0..=100).map(|n| reach * f64::from(n) / 100.0);
    let fitted = fitted.map(|r| (r, model(r * r)));
    let measured = lights.iter().map(|l| (radius(l), l.dn / middle));
    let figure = Figure {
        labels: Labels::new(
            "Light over the distance from the middle",
            "distance from the middle, px",
            "light over that in the middle",
        ),
        series: vec![
            Series::dots("measured", measured),
            Series::curve("fitted", fitted),
        ],
    };
    (quantities, Some(figure))
}

fn square_quantity(found: Result<Measured, String>, how: &str) -> CalibratedQuantity {
    let key = "camera.vignetting.radial_per_px2";
    CalibratedQuantity::measured(("vignetting", key, "px^-2"), found, how)
}

fn fit(lights: &[Light]) -> Option<Falloff> {
    /// Unit of the radii in the fit.
    const UNIT_PX: f64 = 500.0;
    let all = |l: &Light| {
        let r2 = (l.x * l.x + l.y * l.y) / UNIT_PX.powi(2);
        Vector5::new(1.0, l.x / UNIT_PX, l.y / UNIT_PX, r2, r2 * r2)
    };
    let values: Vec<f64> = lights.iter().map(|l| l.dn).collect();
    let even = vec![1.0; lights.len()];
    let terms: Vec<_> = lights.iter().map(all).collect();
    let fitted = regression(&terms, &values, &even).ok()?;
    let fourth = share(&fitted, 4, UNIT_PX.powi(4));
    if fourth.value.abs() > SIGNIFICANT * fourth.sigma {
        return Some(Falloff {
            middle: fitted.parameters[0],
            square: share(&fitted, 3, UNIT_PX.powi(2)),
            fourth: Some(fourth),
        });
    }
    let fewer: Vec<SVector<f64, 4>> = terms
        .iter()
        .map(|t| SVector::from([t[0], t[1], t[2], t[3]]))
        .collect();
    let fitted = regression(&fewer, &values, &even).ok()?;
    Some(Falloff {
        middle: fitted.parameters[0],
        square: share(&fitted, 3, UNIT_PX.powi(2)),
        fourth: None,
    })
}

/// A coefficient relative to the light in the middle.
fn share<const N: usize>(fitted: &Fitted<N>, n: usize, unit: f64) -> Measured {
    let whole = fitted.parameters[0] * unit;
    let Measured { value, sigma } = fitted.measured(n);
    Measured::new(value / whole, sigma / whole.abs())
}
