//! The conditions that the pipeline is judged under: how their frames depart from the standard one.

use super::recipe::{ANY_MARKS, Generator, Recipe, View};
use crate::instrument::Instrument;
use crate::simulate::{Depth, Noise};
use rand::RngExt;
use rand_distr::StandardNormal;
use std::ops::{Range, RangeInclusive};

/// Noise of so many DN.
pub fn noise(recipe: &mut Recipe, read_dn: f64) {
    recipe.conditions.noise = Noise::read(read_dn);
}

/// A camera turned anyhow, of which the instrument states no rotation.
pub fn turned(recipe: &mut Recipe, rng: &mut Generator) {
    recipe.conditions.similarity.rotation_deg = rng.random_range(0.0..360.0);
    recipe.stated.rotation_deg.sigma = 360.0;
}

/// A camera turned and tilted anyhow.
pub fn tilted(recipe: &mut Recipe, rng: &mut Generator) {
    turned(recipe, rng);
    recipe.conditions.keystone_deg = rng.random_range(-3.0..3.0);
}

/// Hot pixels, scratches and leaks.
pub fn blemished(recipe: &mut Recipe) {
    /// Makes 12 scratches on the plate that the demo's camera sees.
    const SCRATCHES_PER_DISC: f64 = 0.59;
    let counts = &mut recipe.conditions.blemishes;
    counts.hot_pixels = 60;
    counts.scratches_per_disc = SCRATCHES_PER_DISC;
    counts.leaks = 4;
}

/// A mapping that is off the stated one as far as the instrument's own sigmas say.
pub fn displaced(recipe: &mut Recipe, instrument: &Instrument, rng: &mut Generator) {
    let stated = &instrument.mounting;
    let mut off = |sigma: f64| sigma * rng.sample::<f64, _>(StandardNormal);
    let mapping = &mut recipe.conditions.similarity;
    mapping.plate_centre.x += off(stated.plate_centre_sigma_px);
    mapping.plate_centre.y += off(stated.plate_centre_sigma_px);
    mapping.rotation_deg += off(stated.rotation_deg.sigma);
    mapping.scale_mil_per_px += off(stated.scale_mil_per_px.sigma);
}

/// The disc cut by the sensor's edge, in a picture whose mapping is off as far as its sigmas say.
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

/// Everything at once, each more or less; every fourth frame without a usable Sun. The scale is anywhere within five of its
/// sigmas, the rotation contradicts the stated one. The plate is as the instrument states
/// it: three misprinted marks that happen to agree leave no trace of their error, which is a property of the plate and not
/// of the frame. The row about misprinted marks shows how often.
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
}

/// None in half of the frames, else up to so many.
fn some(rng: &mut Generator, most: usize) -> usize {
    if rng.random_bool(0.5) {
        rng.random_range(1..=most)
    } else {
        0
    }
}

/// Below this part of the limb a Sun is not usable.
pub const LEAST_USABLE_LIMB: f64 = 0.15;

/// Three quarters with a usable Sun, most of them whole; an eighth without Sun, an eighth with a mere edge of it.
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
