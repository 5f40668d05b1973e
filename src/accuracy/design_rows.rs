//! The rows about designed plates, and about the predictions of the plate check.

use super::conditions::displaced;
use super::demand::CALIBRATED;
use super::demand::Demand::{FineShare, RivalsLikeliest, SigmaRatioUpTo};
use super::plate_rows::{dots, of_crosses, random};
use super::recipe::{Generator, Recipe, View};
use super::rows::{AccuracyRow, InstrumentOf, Size, row};
use crate::instrument::Instrument;
use crate::plate::{MarkShape, Pattern, Plate};
use crate::plate_check::PlaceVerdict;
use crate::plate_design::{DesignSettings, design, usual_cross, usual_dot};
use crate::units::PlateMil;
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;

/// Number of frames of a row of designed plates.
const DESIGN_FRAMES: [u64; 2] = [40, 10_000];
/// Number of frames of a row about the check's verdicts.
const CHECK_FRAMES: [u64; 2] = [60, 10_000];

/// Every row, in the order of the table.
pub(super) fn design_rows() -> Vec<AccuracyRow> {
    designed_rows().chain(verdict_rows()).collect()
}

/// Rows of plates designed by `solaspect plate design`: the Sun anywhere in the field, five seeds.
fn designed_rows() -> impl Iterator<Item = AccuracyRow> {
    let rows: [(&str, &str, InstrumentOf); 8] = [
        (
            "design-2000-4",
            "designed: field 2000 mil, 4 crosses",
            |i, n, size| designed(i, (n, size), 2000.0, 4, usual_cross),
        ),
        (
            "design-2000-6",
            "designed: field 2000 mil, 6 crosses",
            |i, n, size| designed(i, (n, size), 2000.0, 6, usual_cross),
        ),
        (
            "design-3000-4",
            "designed: field 3000 mil, 4 crosses",
            |i, n, size| designed(i, (n, size), 3000.0, 4, usual_cross),
        ),
        (
            "design-3000-6",
            "designed: field 3000 mil, 6 crosses",
            |i, n, size| designed(i, (n, size), 3000.0, 6, usual_cross),
        ),
        (
            "design-dots-2000-4",
            "designed: field 2000 mil, 4 dots",
            |i, n, size| designed(i, (n, size), 2000.0, 4, usual_dot),
        ),
        (
            "design-dots-2000-6",
            "designed: field 2000 mil, 6 dots",
            |i, n, size| designed(i, (n, size), 2000.0, 6, usual_dot),
        ),
        (
            "design-dots-3000-4",
            "designed: field 3000 mil, 4 dots",
            |i, n, size| designed(i, (n, size), 3000.0, 4, usual_dot),
        ),
        (
            "design-dots-3000-6",
            "designed: field 3000 mil, 6 dots",
            |i, n, size| designed(i, (n, size), 3000.0, 6, usual_dot),
        ),
    ];
    rows.into_iter().map(|(name, title, instrument)| {
        let row = row(name, title, over_the_field);
        AccuracyRow {
            frames: DESIGN_FRAMES,
            instrument: Some(instrument),
            instruments: [1, 5],
            ..row.demanding(&[FineShare(1.0), SigmaRatioUpTo(CALIBRATED.end)])
        }
    })
}

/// The Sun anywhere in the field, the camera rotated by up to 1 deg.
fn over_the_field(recipe: &mut Recipe, _: &Instrument, rng: &mut Generator) {
    recipe.view = View::Field;
    recipe.conditions.similarity.rotation_deg += rng.random_range(-1.0..1.0);
}

/// The instrument with a plate designed for it with the n-th seed, its camera far enough away to see the whole field.
fn designed(
    instrument: Instrument,
    (n, size): (u64, Size),
    field_mil: f64,
    marks_in_view: usize,
    shape: fn(&Instrument) -> MarkShape,
) -> Instrument {
    let start = instrument.seeing(field_mil);
    let usual = DesignSettings::new(field_mil, marks_in_view);
    let settings = DesignSettings {
        shape: shape(&start),
        trials: 1,
        exchanges: size.of([4, usual.exchanges]),
        seed: n + 1,
        ..usual
    };
    // If no plate can be designed, a plate without marks makes the row fail.
    let unmarked = Plate::new(Pattern::Listed, settings.shape, 1.0, []);
    design(&start, &settings, &|| ()).unwrap_or(Instrument {
        plate: unmarked,
        ..start
    })
}

/// Rows that compare the check's verdicts on places with frames with the Sun there and a mounting drawn from its sigmas.
fn verdict_rows() -> [AccuracyRow; 2] {
    let safe = row(
        "check-safe",
        "places that the check calls safe",
        |r, i, rng| {
            displaced(r, i, rng);
            r.view = View::Checked(PlaceVerdict::Safe);
        },
    );
    let ambiguous = row(
        "check-ambiguous",
        "places that the check calls ambiguous",
        |r, i, rng| {
            displaced(r, i, rng);
            r.view = View::Checked(PlaceVerdict::Ambiguous);
        },
    );
    [
        AccuracyRow {
            frames: CHECK_FRAMES,
            instrument: Some(|i, n, _| match n {
                // On an almost regular grid some places are safe, and for others the marks fit several.
                0 => nearly_a_grid(i, 2.0),
                1 => random(i, 225),
                2 => dots(random(i, 225)),
                _ => i,
            }),
            instruments: [2, 4],
            ..safe.demanding(&[])
        },
        AccuracyRow {
            frames: CHECK_FRAMES,
            instrument: Some(|i, n, _| {
                let mut instrument = nearly_a_grid(i, n as f64);
                instrument.mounting.plate_centre_sigma_px = 30.0;
                instrument
            }),
            instruments: [2, 2],
            demands: vec![RivalsLikeliest(1e-3)],
            ..ambiguous
        },
    ]
}

/// The instrument with crosses on a grid, each displaced randomly, 1 sigma per axis.
fn nearly_a_grid(instrument: Instrument, off_mil: f64) -> Instrument {
    const STEP_MIL: f64 = 300.0;
    const HALF: i32 = 8;
    let mut rng = Generator::seed_from_u64(1);
    let along = || -HALF..=HALF;
    let places = along().flat_map(|y| along().map(move |x| [x, y].map(f64::from)));
    let places = places.map(|place| {
        let [x, y] = place.map(|n| n * STEP_MIL + off_mil * rng.sample::<f64, _>(StandardNormal));
        PlateMil::new(x, y)
    });
    let mut plate = of_crosses(places);
    plate.field_radius_mil = 1500.0;
    Instrument {
        plate,
        ..instrument
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::instrument::builtin;

    #[test]
    fn where_no_plate_can_be_designed_there_is_none() {
        let demo = builtin("demo").unwrap();
        let designed = designed(demo, (0, Size::Small), 1000.0, 60, usual_cross);
        assert_eq!(designed.plate.count(), 0);
    }
}
