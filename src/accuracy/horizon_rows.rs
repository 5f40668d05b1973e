//! The rows about the horizon: the content of their pictures, and their requirements.

use super::horizon::{HorizonDemand, HorizonRow};
use super::recipe::Generator;
use crate::geometry::camera::CameraModel;
use crate::simulate::Noise;
use crate::simulate::earth::{Aim, Clouds, EarthConditions, Glow, Haze};
use crate::units::SensorPx;
use HorizonDemand::{FineShare, NoneFine, SigmaRatio};
use rand::RngExt;
use std::ops::Range;

/// Sigma of the edge's height, m: for a picture with the edge at the height that the solver expects, and for other
/// pictures.
const EXACT_M: f64 = 0.0;
const USUAL_M: f64 = 1_000.0;
/// Heights of photographs from orbit, m.
const ORBITS_M: Range<f64> = 200e3..450e3;

/// Every row about the horizon, in the order of the table.
pub(super) fn horizon_rows() -> Vec<HorizonRow> {
    let mut rows = with_an_exact_edge();
    rows.extend(cloudy());
    rows.extend(airs());
    rows.extend(as_photographed());
    rows.extend(skies());
    rows
}

fn with_an_exact_edge() -> Vec<HorizonRow> {
    let row = |title: &str, height_m, draw| {
        HorizonRow::new(title, [16, 200], height_m, EXACT_M, draw)
            .demanding(&[FineShare(0.95), SigmaRatio(0.75..1.25)])
    };
    vec![
        row("230 km, clear", 230e3, |_, m| EarthConditions::clear(m)),
        row("230 km, limb 5 % and 200 m", 230e3, |_, m| {
            varying(m, 0.05, 200.0)
        }),
        row("38 km, clear", 38e3, |_, m| EarthConditions::clear(m)),
        row("38 km, limb 2 % and 100 m", 38e3, |_, m| {
            varying(m, 0.02, 100.0)
        }),
        row(
            "230 km, clouds, Sun, flares, 0.3 deg of spin",
            230e3,
            |_, m| EarthConditions {
                clouds: Some(Clouds::BRIGHT),
                sun: true,
                spin_deg: 0.3,
                ..EarthConditions::clear(m)
            },
        ),
    ]
}

/// Clouds of any cover, top and brightness along the limb.
fn cloudy() -> Vec<HorizonRow> {
    let row = |km: f64| {
        let title = format!("{km} km, clouds of any cover, height and brightness");
        HorizonRow::new(title, [8, 200], 1e3 * km, EXACT_M, |rng, m| {
            with_any_clouds(rng, varying_by_height(m))
        })
        .demanding(&[FineShare(0.95), SigmaRatio(0.8..1.4)])
    };
    let of_half = |title: &str, height_m| {
        HorizonRow::new(title, [8, 200], height_m, EXACT_M, |_, m| {
            with_clouds(Clouds::BRIGHT, varying_by_height(m))
        })
        .demanding(&[FineShare(0.95), SigmaRatio(0.8..1.4)])
    };
    let mut rows = vec![
        of_half("38 km, clouds over half of the ground", 38e3),
        of_half("230 km, clouds over half of the ground", 230e3),
    ];
    rows.extend([25.0, 30.0, 34.0, 38.0, 45.0, 200.0, 300.0, 420.0].map(row));
    rows
}

/// Scale heights of 6 to 9 km, haze layers, airglow.
fn airs() -> Vec<HorizonRow> {
    let row = |km: f64| {
        let title = format!("{km} km, any air");
        HorizonRow::new(title, [8, 200], 1e3 * km, USUAL_M, |rng, m| {
            with_any_air(rng, varying_by_height(m))
        })
        .demanding(&[FineShare(0.95), SigmaRatio(0.6..1.3)])
    };
    [38.0, 230.0, 420.0].map(row).into()
}

/// Pictures from 200 to 450 km, fields of 30 to 100 deg, at any roll.
fn as_photographed() -> Vec<HorizonRow> {
    let row = |title: &str, frames, draw| HorizonRow::new(title, frames, 0.0, USUAL_M, draw);
    vec![
        row("orbit, terminator", [16, 1000], |rng, _| EarthConditions {
            terminator: true,
            ..photograph(rng)
        })
        .demanding(&[FineShare(0.8), SigmaRatio(0.8..1.5)]),
        row("orbit, terminator, Sun in view", [16, 1000], |rng, _| {
            EarthConditions {
                terminator: true,
                sun: true,
                ..photograph(rng)
            }
        })
        .demanding(&[FineShare(0.8), SigmaRatio(0.8..1.5)]),
        row("orbit, glow above the limb", [16, 400], |rng, _| {
            with_glow(rng)
        })
        .demanding(&[FineShare(0.95), SigmaRatio(0.75..1.4)]),
        row("orbit, struts and banners", [16, 400], |rng, _| {
            EarthConditions {
                structure: true,
                ..photograph(rng)
            }
        })
        .demanding(&[FineShare(0.8), SigmaRatio(0.75..1.4)]),
        row("orbit, glow, struts and banners", [16, 400], |rng, _| {
            EarthConditions {
                structure: true,
                ..with_glow(rng)
            }
        })
        .demanding(&[FineShare(0.7), SigmaRatio(0.75..1.4)]),
    ]
}

/// Frames of the sky, none of which may be fine.
fn skies() -> Vec<HorizonRow> {
    let row = |title: &str, height_m, draw| {
        HorizonRow::new(title, [16, 2000], height_m, USUAL_M, draw).demanding(&[NoneFine])
    };
    vec![
        row("sky, half with the Sun and its flares", 230e3, |rng, m| {
            EarthConditions {
                aim: Aim::Space,
                sun: rng.random_bool(0.5),
                ..EarthConditions::clear(m)
            }
        }),
        row(
            "sky with gradients, flares, banners, Moons",
            0.0,
            |rng, _| EarthConditions {
                aim: Aim::Space,
                clouds: None,
                sun: rng.random_bool(0.5),
                gradient: rng.random_bool(0.7),
                structure: rng.random_bool(0.5),
                moon: rng.random_bool(0.4),
                ..photograph(rng)
            },
        ),
    ]
}

fn varying(height_m: f64, varies_by: f64, varies_by_m: f64) -> EarthConditions {
    EarthConditions::clear(height_m).varying(varies_by, varies_by_m)
}

/// A balloon sees a shorter limb than a rocket, which varies less.
fn varying_by_height(height_m: f64) -> EarthConditions {
    const BALLOONS_M: f64 = 100e3;
    match height_m < BALLOONS_M {
        true => varying(height_m, 0.02, 100.0),
        false => varying(height_m, 0.05, 200.0),
    }
}

fn with_any_clouds(rng: &mut Generator, conditions: EarthConditions) -> EarthConditions {
    let clouds = Clouds {
        cover: rng.random_range(0.2..0.9),
        height_m: rng.random_range(6e3..14e3),
        brightness_dn: rng.random_range(180.0..245.0),
    };
    with_clouds(clouds, conditions)
}

fn with_clouds(clouds: Clouds, conditions: EarthConditions) -> EarthConditions {
    EarthConditions {
        clouds: Some(clouds),
        ..conditions
    }
}

fn with_any_air(rng: &mut Generator, mut conditions: EarthConditions) -> EarthConditions {
    let air = &mut conditions.air;
    air.scale_m = rng.random_range(6e3..9e3);
    air.depth = rng.random_range(8.0..16.0);
    let haze = Haze {
        height_m: rng.random_range(12e3..30e3),
        thickness_m: rng.random_range(1e3..3e3),
        depth: rng.random_range(0.05..0.5),
    };
    air.haze = rng.random_bool(0.5).then_some(haze);
    air.airglow_dn = if rng.random_bool(0.5) {
        rng.random_range(1.0..6.0)
    } else {
        0.0
    };
    conditions
}

fn with_glow(rng: &mut Generator) -> EarthConditions {
    let glow = Glow {
        brightness: rng.random_range(0.1..0.9),
        reach_deg: rng.random_range(1.0..6.0),
    };
    EarthConditions {
        glow: Some(glow),
        ..photograph(rng)
    }
}

fn photograph(rng: &mut Generator) -> EarthConditions {
    let width_px = rng.random_range(500..1300);
    let height_px = (width_px as f64 * rng.random_range(0.55..0.8)) as usize;
    let across_deg: f64 = rng.random_range(30.0..100.0);
    let focal_px = width_px as f64 / 2.0 / (across_deg / 2.0).to_radians().tan();
    let [x, y] = [width_px, height_px].map(|size| (size as f64 - 1.0) / 2.0);
    let conditions = EarthConditions {
        camera: CameraModel::rectilinear(focal_px, SensorPx::new(x, y)),
        width_px,
        height_px,
        aim: Aim::Horizon {
            most_roll_deg: 180.0,
        },
        noise: Noise::read(rng.random_range(1.0..4.0)),
        ..varying(rng.random_range(ORBITS_M), 0.05, 200.0)
    };
    match rng.random_bool(0.5) {
        true => with_any_clouds(rng, conditions),
        false => conditions,
    }
}
