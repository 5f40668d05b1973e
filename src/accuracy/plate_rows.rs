//! The rows about other plates, lenses and cameras, each of which differs from the demo in one respect.

use super::conditions::turned;
use super::demand::CALIBRATED;
use super::demand::Demand::{AllFineOfFour, FineOfThree, SigmaRatioUpTo};
use super::recipe::{ENOUGH_MARKS, Generator, Recipe, Vary, View};
use super::rows::{AccuracyRow, InstrumentOf, row};
use crate::instrument::Instrument;
use crate::plate::{Cross, MarkId, MarkPlace, MarkShape, Pattern, Plate};
use crate::units::{Measured, PlateMil};
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;

/// Area of the demo's plate per mark, mil^2.
const AREA_PER_MARK_MIL2: f64 = 190_000.0;
/// Number of frames of a row, and of one with twelve megapixels.
const FRAMES: [u64; 2] = [16, 2000];
const LARGE_FRAMES: [u64; 2] = [2, 200];

/// Every row, in the order of the table.
pub(super) fn plate_rows() -> Vec<AccuracyRow> {
    let rows: [(&str, &str, InstrumentOf, Vary); 10] = [
        (
            "plate-100",
            "100 crosses at random",
            |i, _, _| random(i, 100),
            marked,
        ),
        (
            "plate-225",
            "225 crosses at random",
            |i, _, _| random(i, 225),
            marked,
        ),
        (
            "plate-600",
            "600 crosses at random",
            |i, _, _| random(i, 600),
            marked,
        ),
        (
            "plate-turned",
            "225 crosses, any rotation",
            |i, _, _| random(i, 225),
            |r, i, rng| {
                marked(r, i, rng);
                turned(r, rng);
            },
        ),
        (
            "plate-45deg",
            "225 crosses with arms at 45 deg",
            |i, _, _| at_45_deg(random(i, 225)),
            marked,
        ),
        (
            "plate-dots",
            "225 dots, turned within the stated sigma",
            |i, _, _| dots(random(i, 225)),
            misaligned,
        ),
        (
            "lens-1m",
            "225 crosses, f = 1 m",
            |i, _, _| random(i, 225).scaled(1.0 / 3.0),
            marked,
        ),
        (
            "lens-10m",
            "225 crosses, f = 10 m",
            |i, _, _| random(i, 225).scaled(10.0 / 3.0),
            marked,
        ),
        (
            "sensor-640",
            "225 crosses, 640 x 480 px",
            |i, _, _| sampled(random(i, 225), [640, 480]),
            marked,
        ),
        (
            "sensor-4096",
            "225 crosses, 4096 x 3000 px",
            |i, _, _| sampled(random(i, 225), [4096, 3000]),
            marked,
        ),
    ];
    let row = |(name, title, instrument, vary): (&'static str, &'static str, _, _)| {
        let row = row(name, title, vary).demanding(&[
            AllFineOfFour,
            FineOfThree(0.95),
            SigmaRatioUpTo(CALIBRATED.end),
        ]);
        AccuracyRow {
            frames: FRAMES,
            instrument: Some(instrument),
            ..row
        }
    };
    let mut rows: Vec<AccuracyRow> = rows.into_iter().map(row).collect();
    // The last row has the large frames.
    if let Some(last) = rows.last_mut() {
        last.frames = LARGE_FRAMES;
    }
    rows
}

/// Enough marks in view for a mapping.
fn marked(recipe: &mut Recipe, _: &Instrument, _: &mut Generator) {
    recipe.view = View::Whole {
        lit_marks: ENOUGH_MARKS,
    };
}

/// The same, with a camera rotation drawn from its stated sigma.
fn misaligned(recipe: &mut Recipe, instrument: &Instrument, rng: &mut Generator) {
    marked(recipe, instrument, rng);
    let turned = instrument.mounting.rotation_deg.sigma * rng.sample::<f64, _>(StandardNormal);
    recipe.conditions.similarity.rotation_deg += turned;
}

/// The instrument with `count` crosses at random positions in a square, with the density of the demo's, each apart from the
/// others.
pub(super) fn random(instrument: Instrument, count: usize) -> Instrument {
    let half_mil = (count as f64 * AREA_PER_MARK_MIL2).sqrt() / 2.0;
    let mut rng = Generator::seed_from_u64(count as u64);
    let mut places: Vec<PlateMil> = Vec::new();
    while places.len() < count {
        let [x, y] = [(); 2].map(|()| rng.random_range(-half_mil..half_mil));
        let at = PlateMil::new(x, y);
        if places
            .iter()
            .all(|other| other.distance(at) > 2.2 * Cross::HEROES.arm_length_mil)
        {
            places.push(at);
        }
    }
    Instrument {
        plate: of_crosses(places),
        ..instrument
    }
}

/// A plate of the demo's crosses.
pub(super) fn of_crosses(places: impl IntoIterator<Item = PlateMil>) -> Plate {
    let ids = (1..).map(|i| MarkId { i, j: 0 });
    let marks = ids
        .zip(places)
        .map(|(id, at)| (id, MarkPlace::new(at, 1.0)));
    Plate::new(Pattern::Listed, MarkShape::Cross(Cross::HEROES), 1.0, marks)
}

fn with_shape(mut instrument: Instrument, shape: MarkShape) -> Instrument {
    instrument.plate.shape = shape;
    instrument
}

fn at_45_deg(instrument: Instrument) -> Instrument {
    let cross = Cross {
        arm_angle_deg: 45.0,
        ..Cross::HEROES
    };
    with_shape(instrument, MarkShape::Cross(cross))
}

/// Dots that absorb as much light as the crosses.
pub(super) fn dots(instrument: Instrument) -> Instrument {
    with_shape(instrument, MarkShape::Dot { diameter_mil: 50.0 })
}

/// The instrument with another sensor with the same field on the plate.
fn sampled(mut instrument: Instrument, [width_px, height_px]: [usize; 2]) -> Instrument {
    let camera = &mut instrument.camera;
    let coarser = camera.height_px as f64 / height_px as f64;
    (camera.width_px, camera.height_px) = (width_px, height_px);
    let mounting = &mut instrument.mounting;
    mounting.plate_centre_px = camera.middle_px();
    mounting.plate_centre_sigma_px /= coarser;
    let scale = mounting.scale_mil_per_px;
    mounting.scale_mil_per_px = Measured::new(scale.value * coarser, scale.sigma * coarser);
    instrument
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::instrument::builtin;

    #[test]
    fn another_lens_keeps_the_disc_and_the_marks_in_pixels() {
        let demo = builtin("demo").unwrap();
        let usual = random(demo, 225);
        let near = |a: f64, b: f64| assert!((a - b).abs() < 1e-9 * b.abs(), "{a} {b}");
        for by in [1.0 / 3.0, 10.0 / 3.0] {
            let other = usual.clone().scaled(by);
            near(other.radius_px(960.0), usual.radius_px(960.0));
            let size =
                |i: &Instrument| i.plate.shape.size_mil() / i.mounting.scale_mil_per_px.value;
            near(size(&other), size(&usual));
            near(other.plate.reach_mil(), by * usual.plate.reach_mil());
        }
    }
}
