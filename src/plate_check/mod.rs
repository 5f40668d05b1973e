//! Check of a plate before it is made.
//!
//! # Method
//! The Sun is placed all over the plate's field, and at each position the camera's mounting is drawn from the stated one
//! and its sigmas. No frame is rendered: the marks that would be detected follow from the drawing, each displaced by the
//! sigmas of its detection and of the print, and the flight's own identification is applied to them. It returns the
//! difference between the odds of its labelling against every rival and their limit: a position whose smallest margin over
//! all draws is below 0 is ambiguous.
//!
//! Some draws of each position are judged once more with marks missed and detections false as often as the flight's
//! evidence expects (module `clutter`): the share that is identified then is reported beside the verdicts, and changes a
//! verdict only if marks are identified as others.
//!
//! The uncertainty of the Sun's position follows from the marks' and the limb's own sigmas (module `sigma`).
//!
//! ```text
//! scene <- sigma, clutter; these, found <- mod; found <- page
//! ```

mod clutter;
mod found;
mod page;
mod scene;
mod sigma;

pub use found::{CheckSummary, CheckedPlace, PlaceVerdict, PlateCheck};
pub use page::{html, json};

use crate::aspect::SolverSettings;
use crate::geometry::unit;
use crate::instrument::Instrument;
use crate::reasons::sun;
use crate::units::PlateMil;
use clutter::among_clutter;
use rand::SeedableRng;
use rand_xoshiro::Xoshiro256PlusPlus;
use rayon::prelude::*;
use scene::{CheckScene, PlateView, Seen};
use serde::Serialize;

/// Extent of a check.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CheckSettings {
    /// Number of positions of the Sun, evenly distributed over the field.
    pub places: u64,
    /// Number of mountings that are drawn at each position.
    pub draws: u64,
    /// Number of these that are also judged among clutter.
    pub cluttered_draws: u64,
    pub rotations: Rotations,
    /// Noise of a frame relative to the brightness of the disc's centre.
    pub noise_share: f64,
    pub seed: u64,
}

/// Range of the camera's rotation.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Rotations {
    /// Within the stated sigma.
    Stated,
    /// Any rotation.
    Any,
}

impl CheckSettings {
    /// Sufficient to warn of a plate. Takes a fraction of a second, or two seconds for 2,000 marks or for dots at any
    /// rotation.
    pub fn quick() -> Self {
        Self {
            places: 100,
            draws: 1,
            cluttered_draws: 0,
            ..Self::default()
        }
    }
}

impl Default for CheckSettings {
    /// The standard frame has 5 DN of noise on 205.
    fn default() -> Self {
        Self {
            places: 2000,
            draws: 4,
            cluttered_draws: 1,
            rotations: Rotations::Stated,
            noise_share: 5.0 / 205.0,
            seed: 1,
        }
    }
}

/// Checks an instrument's plate.
pub fn check(
    instrument: &Instrument,
    solver: &SolverSettings,
    settings: &CheckSettings,
) -> PlateCheck {
    let field_mil = instrument.plate.field_radius_mil;
    let at = |n| evenly(n, settings.places, field_mil);
    let places: Vec<(u64, PlateMil)> = (0..settings.places).map(|n| (n, at(n))).collect();
    PlateCheck {
        instrument: instrument.name.clone(),
        marks: instrument.plate.count(),
        shape: instrument.plate.shape.name(),
        field_radius_mil: field_mil,
        rotations: settings.rotations,
        misfit: instrument.check_lens(solver.fiducial.min_marks).err(),
        places: check_places(instrument, solver, settings, &places),
    }
}

/// Checks some positions only, each with its index in the check.
pub(crate) fn check_places(
    instrument: &Instrument,
    solver: &SolverSettings,
    settings: &CheckSettings,
    places: &[(u64, PlateMil)],
) -> Vec<CheckedPlace> {
    let view = PlateView::new(instrument, solver, settings.noise_share);
    let least_marks = solver.fiducial.min_marks;
    let checked = |(n, at): &(u64, PlateMil)| match &view {
        Some(view) => checked(view, settings, least_marks, *at, *n),
        None => CheckedPlace::unlit(*at),
    };
    places.par_iter().map(checked).collect()
}

/// The n-th of some positions evenly distributed in a circle: on a spiral with steps of the golden angle (Vogel 1979).
fn evenly(n: u64, count: u64, radius_mil: f64) -> PlateMil {
    const GOLDEN_ANGLE_RAD: f64 = 2.399_963_229_728_653;
    let part = ((n as f64 + 0.5) / count as f64).sqrt();
    PlateMil::from(unit(n as f64 * GOLDEN_ANGLE_RAD) * (radius_mil * part))
}

fn checked(
    view: &PlateView,
    settings: &CheckSettings,
    least_marks: usize,
    at: PlateMil,
    n: u64,
) -> CheckedPlace {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(settings.seed.wrapping_add(n << 8));
    let stated = CheckScene::new(view, at, &view.stated);
    let mut place = CheckedPlace {
        lit: stated.lit(),
        limb_free: stated.limb_free(at),
        ..CheckedPlace::unlit(at)
    };
    if place.lit < least_marks {
        return place;
    }
    if let Some(known) = sigma::of_place(&stated, settings.noise_share) {
        place.sigma_mil = Some(known.sigma_mil);
        place.misprint_mil = Some(known.misprint_mil);
    }
    for draw in 0..settings.draws {
        let scene = CheckScene::new(view, at, &view.drawn(settings.rotations, &mut rng));
        // A displaced mounting may leave fewer marks on the sensor.
        if scene.lit() < least_marks {
            continue;
        }
        let Some((verdict, margin)) = judged(&scene, &scene.all_found(&mut rng)) else {
            continue;
        };
        place.worsen(verdict, margin);
        if draw < settings.cluttered_draws && verdict == PlaceVerdict::Safe {
            let among = judged(&scene, &among_clutter(&scene, &mut rng));
            let unread = (PlaceVerdict::FewMarks, 0.0);
            let (verdict, margin) = among.unwrap_or(unread);
            place.among_clutter = place.among_clutter.max(Some(verdict));
            // A missed mark is no fault of the plate, but a wrong labelling is.
            if verdict == PlaceVerdict::Wrong {
                place.worsen(verdict, margin);
            }
        }
    }
    place
}

/// The flight's identification of a scene, and the difference between its odds and their limit; `None` if the marks'
/// pattern is not the cause of a failure: too few marks for a mapping were found, or the mounting is off by more than the
/// flight allows.
///
/// Whether the marks could be identified for a different mounting is not checked: in flight such a frame is rejected.
fn judged(scene: &CheckScene, seen: &Seen) -> Option<(PlaceVerdict, f64)> {
    let rejected = match scene.identify(&seen.detections) {
        Ok(found) => {
            // A false detection may lie at the position of a missed mark: nothing distinguishes it from that mark.
            let true_ids = found.ids.iter();
            let true_ids = true_ids.filter_map(|(n, id)| Some((seen.ids[*n]?, *id)));
            let right = true_ids.clone().filter(|(truth, id)| truth == id).count();
            let verdict = match right > 0 && right == true_ids.count() {
                true => PlaceVerdict::Safe,
                false => PlaceVerdict::Wrong,
            };
            return Some((verdict, found.margin));
        }
        Err(unread) => unread.rejected(),
    };
    let verdict = match rejected.reason {
        sun::CENTRE_ALONE => PlaceVerdict::SeveralPlaces,
        sun::TWO_LABELLINGS | sun::FALSE_DETECTION | sun::WEAK_LABELLING => PlaceVerdict::Ambiguous,
        _ => return None,
    };
    Some((verdict, (rejected.measured - rejected.limit).min(0.0)))
}
