//! Whether a plate will work, before it is made.
//!
//! # Method
//! The Sun is put all over the plate's field, and at each place the camera is mounted as far off its stated mounting as its sigmas say.
//! No frame is drawn: the marks that would be detected follow from the drawing, each displaced by its detection's sigma, and the
//! flight's own identification judges them. It says by how much the odds of its labelling against every rival exceed what the
//! flight asks: a place whose least margin of all draws is below 0 is ambiguous.
//!
//! A draw of each place is judged once more with marks missed and detections false as often as the flight's evidence expects (module
//! `clutter`): how many are read then is told beside the verdicts, and changes one only where marks are read as others.
//!
//! How well the Sun's place would be known follows from the marks' and the limb's own sigmas (module `sigma`).
//!
//! ```text
//! scene <- sigma, clutter <- mod <- page
//! ```

mod clutter;
mod page;
mod scene;
mod sigma;

pub use page::html;

use crate::aspect::SolverSettings;
use crate::geometry::unit;
use crate::instrument::{Instrument, LensMisfit};
use crate::reasons::sun;
use crate::units::PlateMil;
use clutter::among_clutter;
use rand::SeedableRng;
use rand_xoshiro::Xoshiro256PlusPlus;
use rayon::prelude::*;
use scene::{CheckScene, PlateView, Seen};
use serde::{Serialize, Serializer};

/// What is checked, and how closely.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CheckSettings {
    /// Places of the Sun, evenly over the field.
    pub places: usize,
    /// Mountings that are drawn at each place.
    pub draws: u64,
    /// Of these, so many are judged among clutter, too.
    pub cluttered_draws: u64,
    pub rotations: Rotations,
    /// Noise of a frame over the light of the disc's middle.
    pub noise_share: f64,
    pub seed: u64,
}

/// How the camera may be turned.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Rotations {
    /// Within the stated sigma.
    Stated,
    /// Anyhow.
    Any,
}

impl CheckSettings {
    /// Enough to warn of a plate, in a part of a second.
    pub fn quick() -> Self {
        Self {
            places: 300,
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

/// What a place of the Sun is like.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct CheckedPlace {
    pub x_mil: f64,
    pub y_mil: f64,
    /// Marks that are fully lit.
    pub lit: usize,
    pub verdict: PlaceVerdict,
    /// By how much the logarithm of the odds of the true labelling exceeds what is asked, the least of the draws.
    pub margin: Option<f64>,
    /// The worst that becomes of draws that are read when marks are missed and detections false as often as the flight expects.
    pub among_clutter: Option<PlaceVerdict>,
    /// How well the Sun's place would be known, 1 sigma per axis.
    pub sigma_mil: Option<f64>,
    /// By how much marks that are misprinted within the drawing's sigma move it, 1 sigma per axis.
    pub misprint_mil: Option<f64>,
}

impl CheckedPlace {
    /// A place where no mark is lit.
    fn unlit(at: PlateMil) -> Self {
        Self {
            x_mil: at.x,
            y_mil: at.y,
            lit: 0,
            verdict: PlaceVerdict::FewMarks,
            margin: None,
            among_clutter: None,
            sigma_mil: None,
            misprint_mil: None,
        }
    }

    /// The least of the draws so far, and another one.
    fn worsen(&mut self, verdict: PlaceVerdict, margin: f64) {
        let (worst, least) = match self.margin {
            Some(least) => (self.verdict, least),
            None => (verdict, margin),
        };
        (self.verdict, self.margin) = (worst.max(verdict), Some(least.min(margin)));
    }

    pub fn at(&self) -> PlateMil {
        PlateMil::new(self.x_mil, self.y_mil)
    }
}

/// What becomes of frames with the Sun at a place.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum PlaceVerdict {
    /// Its marks are read, and as no others.
    Safe,
    /// Fewer marks are lit on the sensor than make a mapping.
    FewMarks,
    /// Another labelling is nearly as likely.
    Ambiguous,
    /// The marks fit several places of the plate.
    SeveralPlaces,
    /// Its marks are read as others.
    Wrong,
}

impl PlaceVerdict {
    /// All of them with what they mean, the best first.
    pub const ALL: [(Self, &'static str); 5] = [
        (Self::Safe, "marks are read, and as no others"),
        (Self::FewMarks, "too few marks are fully lit"),
        (Self::Ambiguous, "another labelling is nearly as likely"),
        (
            Self::SeveralPlaces,
            "the marks fit several places of the plate",
        ),
        (Self::Wrong, "marks are read as others"),
    ];
}

/// What the check of a plate says.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PlateCheck {
    pub instrument: String,
    pub marks: usize,
    pub shape: &'static str,
    pub field_radius_mil: f64,
    pub rotations: Rotations,
    /// Why no frame can be read at all.
    #[serde(serialize_with = "as_text")]
    pub misfit: Option<LensMisfit>,
    pub places: Vec<CheckedPlace>,
}

impl PlateCheck {
    /// How many places have a verdict.
    pub fn count(&self, verdict: PlaceVerdict) -> usize {
        let places = self.places.iter();
        places.filter(|place| place.verdict == verdict).count()
    }

    /// The part of the field where frames cannot be read, and what most of it lacks; `None` where they can be read all over it.
    pub fn unreadable(&self) -> Option<(f64, &'static str)> {
        let bad = PlaceVerdict::ALL.iter().skip(1);
        let counts = bad.map(|(verdict, meaning)| (self.count(*verdict), *meaning));
        let most = counts.max_by_key(|(count, _)| *count)?;
        let safe = self.count(PlaceVerdict::Safe);
        let part = 1.0 - safe as f64 / self.places.len().max(1) as f64;
        (most.0 > 0).then_some((part, most.1))
    }

    /// Whether frames can be read all over the field.
    pub fn passes(&self) -> bool {
        self.misfit.is_none() && self.count(PlaceVerdict::Safe) == self.places.len()
    }

    /// The share of the places read by complete detections that is read among clutter, too.
    pub fn read_among_clutter(&self) -> Option<f64> {
        let verdicts: Vec<_> = (self.places.iter())
            .filter_map(|place| place.among_clutter)
            .collect();
        let read = verdicts
            .iter()
            .filter(|verdict| **verdict == PlaceVerdict::Safe);
        (!verdicts.is_empty()).then(|| read.count() as f64 / verdicts.len() as f64)
    }

    /// The least of a number over the places that have it.
    pub fn least(&self, of: impl Fn(&CheckedPlace) -> Option<f64>) -> Option<f64> {
        self.places.iter().filter_map(of).min_by(f64::total_cmp)
    }
}

/// An error as its text.
fn as_text<S: Serializer>(misfit: &Option<LensMisfit>, out: S) -> Result<S::Ok, S::Error> {
    misfit.as_ref().map(ToString::to_string).serialize(out)
}

/// Checks an instrument's plate.
pub fn check(
    instrument: &Instrument,
    solver: &SolverSettings,
    settings: &CheckSettings,
) -> PlateCheck {
    let field_mil = instrument.plate.field_radius_mil;
    let at = |n| evenly(n, settings.places, field_mil);
    let places: Vec<(usize, PlateMil)> = (0..settings.places).map(|n| (n, at(n))).collect();
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

/// Checks some places only, each with its number in the check.
pub(crate) fn check_places(
    instrument: &Instrument,
    solver: &SolverSettings,
    settings: &CheckSettings,
    places: &[(usize, PlateMil)],
) -> Vec<CheckedPlace> {
    let view = PlateView::new(instrument, solver, settings.noise_share);
    let least_marks = solver.fiducial.min_marks;
    let checked = |(n, at): &(usize, PlateMil)| match &view {
        Some(view) => checked(view, settings, least_marks, *at, *n as u64),
        None => CheckedPlace::unlit(*at),
    };
    places.par_iter().map(checked).collect()
}

/// The n-th of some places that lie evenly in a circle: on a spiral, each turned from the one before by the golden angle (Vogel 1979).
fn evenly(n: usize, count: usize, radius_mil: f64) -> PlateMil {
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
        // A mounting that is off may leave fewer marks on the sensor.
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
            // That a mark was missed is no fault of the plate, but a false reading is.
            if verdict == PlaceVerdict::Wrong {
                place.worsen(verdict, margin);
            }
        }
    }
    place
}

/// What the flight's identification makes of a scene, and by how much its odds exceed what is asked; `None` where it is not the marks
/// that keep it from being read: fewer than a mapping takes were found, or the mounting is off by more than the flight allows.
///
/// Whether the marks would be read of a camera that is mounted otherwise is left out: the flight asks that of a frame to refuse it.
fn judged(scene: &CheckScene, seen: &Seen) -> Option<(PlaceVerdict, f64)> {
    let rejected = match scene.identify(&seen.detections) {
        Ok(found) => {
            // What is false may lie where a mark is that was missed: nothing tells it from that mark.
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
