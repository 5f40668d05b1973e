//! The rows about the Moon: the content of their pictures, and their requirements.

use super::demand::CALIBRATED;
use super::moon::{Draw, Knowledge, MoonDemand, MoonRow};
use super::recipe::Generator;
use crate::simulate::Noise;
use crate::simulate::moon::{MoonConditions, Shown};
use rand::RngExt;
use std::ops::Range;

/// Every row about the Moon, in the order of the table.
pub(super) fn moon_rows() -> Vec<MoonRow> {
    [by_lit_share(), as_photographed(), no_moons()].concat()
}

/// Accepted ratio of error to stated sigma: the same as for frames of the Sun, and for Moons as on photographs.
const SIGMA_RATIO_WITHIN: MoonDemand = MoonDemand::SigmaRatio(CALIBRATED);
const SIGMA_RATIO_NEARLY: MoonDemand = MoonDemand::SigmaRatio(0.8..1.3);
/// Lit fractions, with the largest error across the bright limb, px, of smooth discs of 15 px: with the radius known, and
/// free.
const LIT: [(Range<f64>, f64, f64); 3] = [
    (0.10..0.25, 0.06, 0.20),
    (0.25..0.60, 0.03, 0.10),
    (0.60..1.00, 0.03, 0.05),
];

/// Smooth and cratered discs, of 15 and 227 px, at any phase.
fn by_lit_share() -> Vec<MoonRow> {
    let mut rows = Vec::new();
    for (craters, radius_px) in [(false, 15.0), (false, 227.0), (true, 15.0), (true, 227.0)] {
        let (ground, is_large) = (if craters { "craters" } else { "smooth" }, radius_px > 15.0);
        for (lit, most_known, most_free) in LIT {
            for known in [
                Knowledge::Radius,
                Knowledge::RadiusAndPhase,
                Knowledge::Nothing,
            ] {
                let is_free = known == Knowledge::Nothing;
                let most = match (craters, is_large, is_free) {
                    (false, false, false) => most_known,
                    (false, false, true) => most_free,
                    (false, true, _) => 0.02,
                    (true, false, false) => 0.25,
                    (true, false, true) => 0.45,
                    (true, true, _) => 0.10,
                };
                let conditions = MoonConditions {
                    craters,
                    lit: lit.clone(),
                    ..MoonConditions::clear(radius_px)
                };
                let row = MoonRow::new(
                    format!(
                        "{radius_px} px, {ground}, lit {:.2} to {:.2}",
                        lit.start, lit.end
                    ),
                    known,
                    if is_large { [10, 40] } else { [16, 400] },
                    Draw::Same(Box::new(conditions)),
                );
                rows.push(row.demanding(&[MoonDemand::AcrossPx(most), SIGMA_RATIO_WITHIN]));
            }
        }
    }
    rows
}

/// Conditions of photographs: full Moons, maria, skies at 0 DN, crescents with earthshine.
fn as_photographed() -> Vec<MoonRow> {
    let both = [Knowledge::Radius, Knowledge::Nothing];
    let row = |title: &str, known, draw, demands: &[MoonDemand]| {
        MoonRow::new(title, known, [8, 400], Draw::Any(draw)).demanding(demands)
    };
    let mut rows = Vec::new();
    for known in both {
        rows.push(row(
            "0 to 20 deg from full, 15 to 250 px, craters",
            known,
            |rng| near_full(rng, 15.0..250.0),
            &[MoonDemand::FineShare(0.9), SIGMA_RATIO_NEARLY],
        ));
        rows.push(row(
            "the same with seas",
            known,
            |rng| with_seas(near_full(rng, 15.0..250.0)),
            &[MoonDemand::FineShare(0.9), SIGMA_RATIO_NEARLY],
        ));
        rows.push(row(
            "any phase, 60 px, craters, seas",
            known,
            |_| with_seas(cratered(60.0, 0.1..1.0)),
            &[MoonDemand::FineShare(0.9), SIGMA_RATIO_NEARLY],
        ));
        rows.push(row(
            "sky at 0 DN, noise 1 to 5 DN, 1368 x 912 px, 20 to 150 px",
            known,
            clipped,
            &[MoonDemand::FineShare(0.95), SIGMA_RATIO_NEARLY],
        ));
        rows.push(row(
            "lit 0.01 to 0.10, earthshine, 60 px",
            known,
            crescent,
            &[MoonDemand::FineShare(0.9), SIGMA_RATIO_NEARLY],
        ));
    }
    rows
}

/// Scenes without a Moon: 2,000 frames of each, none of which may be fine.
fn no_moons() -> Vec<MoonRow> {
    let row = |title, known, frames, draw| {
        MoonRow::new(title, known, frames, Draw::Any(draw)).demanding(&[MoonDemand::NoneFine])
    };
    vec![
        row(
            "clouds, a Moon's glow and corona",
            Knowledge::Nothing,
            [20, 2000],
            |_| MoonConditions {
                shown: Shown::Clouds,
                stars: 20,
                ..MoonConditions::clear(60.0)
            },
        ),
        row(
            "stars and planets, street lamps, the unfiltered Sun",
            Knowledge::RadiusAndPhase,
            [100, 2000],
            |rng| MoonConditions {
                shown: [Shown::Nothing, Shown::Lamp, Shown::Sun][rng.random_range(0..3)],
                stars: 60,
                planets: 3,
                ..MoonConditions::clear(15.0)
            },
        ),
    ]
}

fn cratered(radius_px: f64, lit: Range<f64>) -> MoonConditions {
    let clear = MoonConditions::clear(radius_px);
    // Large enough for the largest disc.
    let least_px = (2.5 * radius_px) as usize;
    MoonConditions {
        craters: true,
        lit,
        width_px: clear.width_px.max(least_px),
        height_px: clear.height_px.max(least_px),
        ..clear
    }
}

fn with_seas(conditions: MoonConditions) -> MoonConditions {
    MoonConditions {
        seas: true,
        ..conditions
    }
}

fn even_in_log(rng: &mut Generator, range: Range<f64>) -> f64 {
    rng.random_range(range.start.ln()..range.end.ln()).exp()
}

fn near_full(rng: &mut Generator, radii_px: Range<f64>) -> MoonConditions {
    let phase_deg: f64 = rng.random_range(0.0..20.0);
    let lit = (1.0 + phase_deg.to_radians().cos()) / 2.0;
    cratered(even_in_log(rng, radii_px), lit..lit)
}

fn clipped(rng: &mut Generator) -> MoonConditions {
    MoonConditions {
        width_px: 1368,
        height_px: 912,
        background_dn: 0.0,
        noise: Noise::read(rng.random_range(1.0..5.0)),
        earthshine: rng.random_range(0.0..0.01),
        ..cratered(even_in_log(rng, 20.0..150.0), 0.1..1.0)
    }
}

fn crescent(rng: &mut Generator) -> MoonConditions {
    MoonConditions {
        earthshine: even_in_log(rng, 0.005..0.05),
        noise: Noise::read(2.0),
        ..cratered(60.0, 0.01..0.10)
    }
}
