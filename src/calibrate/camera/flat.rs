//! How the light falls off from the middle of the picture.

use super::dark::{Dark, dn};
use super::shots::{Shots, SunShot};
use super::{Figure, Finding};
use crate::calibrate::numbers::median;
use crate::estimation::{Fitted, regression};
use crate::instrument::Instrument;
use crate::report::plot::Dots;
use crate::units::Measured;
use nalgebra::{SVector, Vector5};

const TILE_PX: usize = 32;
/// Every so many pixels of a square, in both axes, tell its light.
const STRIDE_PX: usize = 3;
/// A fourth-order term below so many sigmas is left out.
const SIGNIFICANT: f64 = 5.0;
/// Fewest frames of the Sun, and the part of the way to the corner that they must reach.
const LEAST_SUNS: usize = 12;
const LEAST_REACH: f64 = 0.4;

/// What the disc's brightness may be off by at the corner.
const SUNS_SYSTEMATIC: f64 = 0.005;

/// How the light falls off: light in the middle, and the terms of second and, where it is significant, fourth order.
struct Falloff {
    middle: f64,
    square: Measured,
    fourth: Option<Measured>,
}

/// Light at a position from the middle.
struct Light {
    x: f64,
    y: f64,
    dn: f64,
}

/// The vignetting of evenly lit frames.
pub(super) fn by_flats(flats: &Shots, dark: &Dark) -> (Vec<Finding>, Option<Figure>) {
    let lights: Vec<Light> = flats
        .frames
        .iter()
        .flat_map(|shot| {
            let (width, height) = (shot.frame.width(), shot.frame.height());
            let (columns, rows) = (width / TILE_PX, height / TILE_PX);
            let tile = move |n: usize| {
                let (x0, y0) = (n % columns * TILE_PX, n / columns * TILE_PX);
                let ys = (y0..y0 + TILE_PX).step_by(STRIDE_PX);
                let inside =
                    ys.flat_map(|y| (x0..x0 + TILE_PX).step_by(STRIDE_PX).map(move |x| (x, y)));
                let values: Vec<f64> = inside.map(|(x, y)| dn(shot, x, y)).collect();
                let middle = |low: usize, pixels: usize| {
                    low as f64 + (TILE_PX as f64 - 1.0) / 2.0 - (pixels as f64 - 1.0) / 2.0
                };
                let light = mean_near(&values, median(&values)) - dark.level_dn();
                (light + dark.level_dn() < 0.95 * f64::from(shot.frame.saturation_dn())).then_some(
                    Light {
                        x: middle(x0, width),
                        y: middle(y0, height),
                        dn: light,
                    },
                )
            };
            let lights: Vec<Light> = (0..columns * rows).filter_map(tile).collect();
            let typical = median(lights.iter().map(|l| l.dn));
            // Frames of any exposure, each by its own light.
            lights.into_iter().map(move |l| Light {
                dn: l.dn / typical,
                ..l
            })
        })
        .filter(|l| l.dn.is_finite())
        .collect();
    conclude(
        &lights,
        0.0,
        "from evenly lit frames, a tilt of the lamp's light taken out",
    )
}

/// The mean of the values that are not far from their median: hot pixels do not count.
fn mean_near(values: &[f64], middle: f64) -> f64 {
    let off: Vec<f64> = values.iter().map(|v| (v - middle).abs()).collect();
    let far = 8.0 * median(&off) + 1.0;
    let near = || values.iter().filter(|v| (**v - middle).abs() < far);
    near().sum::<f64>() / near().count().max(1) as f64
}

/// The vignetting from the brightness of the Sun's disc, all over the sensor.
pub(super) fn by_suns(suns: &[SunShot], stated: &Instrument) -> (Vec<Finding>, Option<Figure>) {
    let middle = |pixels: usize| (pixels as f64 - 1.0) / 2.0;
    let (x0, y0) = (
        middle(stated.camera.width_px),
        middle(stated.camera.height_px),
    );
    let typical = median(suns.iter().map(|s| s.light_dn));
    let lights: Vec<Light> = suns
        .iter()
        .map(|s| Light {
            x: s.sun_px.x - x0,
            y: s.sun_px.y - y0,
            dn: s.light_dn / typical,
        })
        .collect();
    let reach = lights.iter().map(|l| l.x.hypot(l.y)).fold(0.0, f64::max);
    if suns.len() < LEAST_SUNS || reach < LEAST_REACH * x0.hypot(y0) {
        let why = "not determined: take evenly lit frames (--flat), or frames with the Sun all over the sensor";
        return (vec![square_finding(Err(why.into()), "")], None);
    }
    conclude(
        &lights,
        SUNS_SYSTEMATIC / (x0 * x0 + y0 * y0),
        "from the brightness of the Sun's disc over the sensor, a tilt taken out; clouds or a low Sun would spoil it",
    )
}

/// `systematic` is what the second order may be off by, whatever the scatter.
fn conclude(lights: &[Light], systematic: f64, how: &str) -> (Vec<Finding>, Option<Figure>) {
    let Some(Falloff {
        middle,
        mut square,
        fourth,
    }) = fit(lights)
    else {
        let why = "not determined: no evenly lit frames (--flat) that are not saturated";
        return (vec![square_finding(Err(why.into()), "")], None);
    };
    square.sigma = square.sigma.hypot(systematic);
    let mut findings = vec![square_finding(Ok(square), how)];
    findings.extend(fourth.map(|fourth| Finding {
        name: "vignetting, fourth order",
        key: "camera.vignetting.radial_per_px4",
        unit: "px^-4",
        found: Ok(fourth),
        remark: how.into(),
    }));
    let b = fourth.map_or(0.0, |f| f.value);
    let model = |r2: f64| 1.0 + r2 * (square.value + r2 * b);
    // Radii apart, so that the figure stays small.
    let step = lights.len().div_ceil(1500).max(1);
    let points: Vec<(f64, f64)> = lights
        .iter()
        .step_by(step)
        .map(|l| (l.x.hypot(l.y), l.dn / middle))
        .collect();
    let figure = Figure {
        title: "Light over the distance from the middle",
        x: "px",
        y: "light over that in the middle",
        series: vec![
            Dots {
                name: "fitted share".into(),
                points: points.iter().map(|(r, _)| (*r, model(r * r))).collect(),
            },
            Dots {
                name: "measured".into(),
                points,
            },
        ],
    };
    (findings, Some(figure))
}

fn square_finding(found: Result<Measured, String>, how: &str) -> Finding {
    Finding {
        name: "vignetting",
        key: "camera.vignetting.radial_per_px2",
        unit: "px^-2",
        found,
        remark: how.into(),
    }
}

fn fit(lights: &[Light]) -> Option<Falloff> {
    /// Radii are fitted in this unit.
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

/// A coefficient as a part of the light in the middle.
fn share<const N: usize>(fitted: &Fitted<N>, n: usize, unit: f64) -> Measured {
    let whole = fitted.parameters[0] * unit;
    let Measured { value, sigma } = fitted.measured(n);
    Measured::new(value / whole, sigma / whole.abs())
}
