//! The conditions under which the pipeline is tested: how their frames differ from the standard one.

use super::recipe::{ANY_MARKS, ENOUGH_MARKS, Generator, Recipe, View};
use crate::instrument::Instrument;
use crate::simulate::{Depth, Noise, Readout, Strengths};
use rand::RngExt;
use rand_distr::StandardNormal;
use std::ops::{Range, RangeInclusive};

/// Noise in DN.
pub fn noise(recipe: &mut Recipe, read_dn: f64) {
    recipe.conditions.noise = Noise::read(read_dn);
}

/// A camera rotated by any angle, for which the instrument states no rotation.
pub fn turned(recipe: &mut Recipe, rng: &mut Generator) {
    recipe.conditions.similarity.rotation_deg = rng.random_range(0.0..360.0);
    recipe.stated.rotation_deg.sigma = 360.0;
}

/// A camera rotated by any angle and tilted.
pub fn tilted(recipe: &mut Recipe, rng: &mut Generator) {
    turned(recipe, rng);
    recipe.conditions.keystone_deg = rng.random_range(-3.0..3.0);
}

/// Hot pixels, scratches and light leaks.
pub fn blemished(recipe: &mut Recipe) {
    /// Gives 12 scratches on the part of the plate in the demo camera's view.
    const SCRATCHES_PER_DISC: f64 = 0.59;
    let counts = &mut recipe.conditions.blemishes;
    counts.hot_pixels = 60;
    counts.scratches_per_disc = SCRATCHES_PER_DISC;
    counts.leaks = 4;
}

/// A mapping drawn from the stated one and the instrument's sigmas.
pub fn displaced(recipe: &mut Recipe, instrument: &Instrument, rng: &mut Generator) {
    recipe.conditions.similarity = instrument.mounting.drawn(|| rng.sample(StandardNormal));
}

/// The disc cut by the sensor's edge, with a mapping drawn from the stated one and its sigmas.
pub fn cut(
    recipe: &mut Recipe,
    limb_share: Range<f64>,
    lit_marks: RangeInclusive<usize>,
    instrument: &Instrument,
    rng: &mut Generator,
) {
    recipe.view = View::Partial {
        limb_share,
        lit_marks,
    };
    displaced(recipe, instrument, rng);
}

/// Fraction of a column's light that smear adds to each of its pixels in the rows about smear: 6 DN above and below the
/// Sun.
pub const COLUMN_SMEAR: f64 = 2e-4;
/// Step between the halves of the sensor in the rows about such a step, DN.
pub const TAP_STEP_DN: f64 = 2.0;

/// Photon noise in addition to a read noise of 1 DN.
pub fn photons(recipe: &mut Recipe, electrons_per_dn: f64) {
    recipe.conditions.noise = Noise {
        read_dn: 1.0,
        electrons_per_dn: Some(electrons_per_dn),
    };
}

/// Constant noise everywhere, equal to that at the centre of the disc from photons and a read noise of 1 DN.
pub fn as_noisy_everywhere(recipe: &mut Recipe, electrons_per_dn: f64) {
    let light_dn = recipe.conditions.peak_dn + recipe.conditions.background_dn;
    noise(recipe, (1.0 + light_dn / electrons_per_dn).sqrt());
}

/// Stray light, readout, vignetting and the surface of the Sun, all combined.
pub fn all_effects(recipe: &mut Recipe) {
    let conditions = &mut recipe.conditions;
    conditions.stray = Strengths {
        gradient_dn: 13.0,
        disc_gradient_dn: 0.0,
        ghost: 0.02,
        coma: 0.1,
    };
    conditions.readout = Readout {
        column_smear: COLUMN_SMEAR,
        tap_step_dn: TAP_STEP_DN,
    };
    conditions.blemishes.vignetting = 0.1;
    conditions.hmi = true;
}

/// Each effect of optics, readout and light in a third of the frames, with random strength.
fn some_effects(recipe: &mut Recipe, rng: &mut Generator) {
    // Everything is drawn whether it is used or not, so that one effect does not change another.
    let mut up_to = |most: f64| {
        let (strength, wanted) = (rng.random_range(0.0..most), rng.random_bool(1.0 / 3.0));
        if wanted { strength } else { 0.0 }
    };
    let stray = Strengths {
        gradient_dn: up_to(15.0),
        disc_gradient_dn: up_to(5.0),
        ghost: up_to(0.03),
        coma: up_to(0.1),
    };
    let readout = Readout {
        column_smear: up_to(2.0 * COLUMN_SMEAR),
        tap_step_dn: up_to(2.0 * TAP_STEP_DN),
    };
    let photons = up_to(1.0);
    let hmi = up_to(1.0) > 0.0;
    let softer_px = up_to(2.6);
    let conditions = &mut recipe.conditions;
    (conditions.stray, conditions.readout, conditions.hmi) = (stray, readout, hmi);
    conditions.blur_px = conditions.blur_px.max(0.9 + softer_px);
    if photons > 0.0 {
        conditions.noise.electrons_per_dn = Some(5.0 / photons);
    }
}

/// A Sun that moves by up to 30 px during the exposure in any direction, a third of the discs cut by the sensor's edge,
/// with a mapping drawn from the stated one and its sigmas.
pub fn moving(recipe: &mut Recipe, instrument: &Instrument, rng: &mut Generator) {
    const MOST_PX: f64 = 30.0;
    displaced(recipe, instrument, rng);
    if rng.random_bool(1.0 / 3.0) {
        recipe.view = View::Partial {
            limb_share: LEAST_USABLE_LIMB..1.0,
            lit_marks: ANY_MARKS,
        };
    }
    recipe.conditions.smear_px = rng.random_range(0.0..MOST_PX);
}

/// A Sun covered by the Moon over some fraction of its diameter; three or more marks remain.
pub fn eclipsed(recipe: &mut Recipe, parts: Range<f64>, rng: &mut Generator) {
    recipe.view = View::Whole {
        lit_marks: ENOUGH_MARKS,
    };
    recipe.conditions.covers.eclipse = rng.random_range(parts);
}

/// A cloud whose edge crosses the disc, and that absorbs a quarter to nine tenths of the light.
pub fn clouded(recipe: &mut Recipe, rng: &mut Generator) {
    recipe.conditions.covers.cloud = rng.random_range(0.25..0.9);
}

/// A strut in front of the disc, up to a quarter of its radius wide.
pub fn strutted(recipe: &mut Recipe, rng: &mut Generator) {
    recipe.conditions.covers.strut = rng.random_range(0.03..0.25);
}

/// All effects combined, with random strength, in half of the frames also effects of optics and readout; every fourth frame
/// has no usable Sun. The scale is within five of its sigmas, the rotation contradicts the stated one. The plate is as the
/// instrument states it: if three misprinted marks happen to agree, their error cannot be detected, which is a property of
/// the plate and not of the frame. The row about misprinted marks shows how often this happens.
pub fn mixed(recipe: &mut Recipe, instrument: &Instrument, rng: &mut Generator) {
    tilted(recipe, rng);
    recipe.stated = instrument.mounting;
    let scale = instrument.mounting.scale_mil_per_px;
    let stretch = 1.0 + 5.0 * scale.sigma / scale.value * rng.random_range(-1.0..1.0);
    recipe.view = mixed_view(rng);
    recipe.sunspots = some(rng, 8);
    let conditions = &mut recipe.conditions;
    conditions.similarity.scale_mil_per_px *= stretch;
    conditions.noise = Noise::read(rng.random_range(1.0..15.0));
    conditions.smear_px = rng.random_range(0.0..1.5);
    if rng.random_bool(0.5) {
        conditions.depth = Depth::Twelve;
    }
    if rng.random_bool(0.3) {
        conditions.blur_px = rng.random_range(0.9..2.5);
    }
    conditions.peak_dn = match rng.random_range(0..10) {
        0 | 1 => rng.random_range(60.0..120.0),
        2 | 3 => rng.random_range(255.0..320.0),
        _ => rng.random_range(150.0..240.0),
    };
    let counts = &mut conditions.blemishes;
    counts.hot_pixels = some(rng, 60);
    counts.scratches_per_disc = rng.random_range(0.0..1.0);
    counts.leaks = some(rng, 4);
    counts.dust_per_disc = rng.random_range(0.0..2.0);
    counts.vignetting = rng.random_range(0.0..0.2);
    // Last, so that the frames without these effects are the same as in earlier versions.
    if rng.random_bool(0.5) {
        some_effects(recipe, rng);
    }
}

/// Zero in half of the frames, otherwise up to `most`.
fn some(rng: &mut Generator, most: usize) -> usize {
    if rng.random_bool(0.5) {
        rng.random_range(1..=most)
    } else {
        0
    }
}

/// Minimum fraction of the limb of a usable Sun.
pub const LEAST_USABLE_LIMB: f64 = 0.15;

/// Three quarters with a usable Sun, most of them whole; an eighth without Sun, an eighth with only its edge.
fn mixed_view(rng: &mut Generator) -> View {
    let cut = |limb_share| View::Partial {
        limb_share,
        lit_marks: ANY_MARKS,
    };
    match rng.random_range(0..16) {
        0 | 1 => View::Absent,
        2 | 3 => cut(0.01..LEAST_USABLE_LIMB),
        4..=6 => cut(LEAST_USABLE_LIMB..1.0),
        _ => View::Whole {
            lit_marks: ANY_MARKS,
        },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::accuracy::recipe::limb_share;
    use crate::instrument::builtin;

    fn demo() -> Instrument {
        builtin("demo").unwrap()
    }

    #[test]
    fn a_blemished_plate_shows_twelve_scratches() {
        let mut recipe = Recipe::standard(&demo());
        blemished(&mut recipe);
        let scene = recipe.scene(&demo(), 1).unwrap();
        assert_eq!(scene.blemishes.scratches.len(), 12);
    }

    #[test]
    fn a_quarter_of_the_mixed_frames_has_no_usable_sun() {
        let demo = demo();
        let usable = |seed: &u64| {
            let scene = Recipe::drawn(mixed, &demo, *seed)
                .scene(&demo, *seed)
                .unwrap();
            limb_share(&scene) >= LEAST_USABLE_LIMB
        };
        let count = (0..400).filter(usable).count();
        assert!((270..330).contains(&count), "{count}");
    }
}
