//! Whether a plate will work, before it is made.
//!
//! # Method
//! The Sun is put all over the plate's field, and at each place the camera is mounted as far off its stated mounting as its sigmas say.
//! No frame is drawn: the marks that would be detected follow from the drawing, each displaced by its detection's sigma, and the
//! flight's own identification judges them. It says by how much the odds of its labelling against every rival exceed what the
//! flight asks: a place whose least margin of all draws is below 0 is ambiguous.
//!
//! How well the Sun's place would be known follows from the marks' and the limb's own sigmas (module `sigma`).
//!
//! ```text
//! sigma, scene <- mod <- page
//! ```

mod page;
mod scene;
mod sigma;

pub use page::html;

use crate::aspect::SolverSettings;
use crate::geometry::unit;
use crate::instrument::Instrument;
use crate::reasons::sun;
use crate::units::PlateMil;
use rand::SeedableRng;
use rand_xoshiro::Xoshiro256PlusPlus;
use rayon::prelude::*;
use scene::CheckScene;
use serde::Serialize;

/// What is checked, and how closely.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CheckSettings {
    /// Places of the Sun, evenly over the field.
    pub places: usize,
    /// Mountings that are drawn at each place.
    pub draws: u64,
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
    /// How well the Sun's place would be known, 1 sigma per axis.
    pub sigma_mil: Option<f64>,
    /// By how much marks that are misprinted within the drawing's sigma move it, 1 sigma per axis.
    pub misprint_mil: Option<f64>,
}

/// What becomes of frames with the Sun at a place.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum PlaceVerdict {
    /// Its marks are read, and as no others.
    Safe,
    /// Fewer marks are lit than make a mapping.
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
    pub misfit: Option<String>,
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

    /// The least of a number over the places that have it.
    pub fn least(&self, of: impl Fn(&CheckedPlace) -> Option<f64>) -> Option<f64> {
        self.places.iter().filter_map(of).min_by(f64::total_cmp)
    }
}

/// Checks an instrument's plate.
pub fn check(
    instrument: &Instrument,
    solver: &SolverSettings,
    settings: &CheckSettings,
) -> PlateCheck {
    let plate = &instrument.plate;
    let misfit = instrument.check_lens(solver.fiducial.min_marks).err();
    let field_mil = plate.field_radius_mil;
    let places: Vec<CheckedPlace> = (0..settings.places)
        .into_par_iter()
        .map(|n| {
            let at = evenly(n, settings.places, field_mil);
            checked(instrument, solver, settings, at, n as u64)
        })
        .collect();
    PlateCheck {
        instrument: instrument.name.clone(),
        marks: plate.count(),
        shape: plate.shape.name(),
        field_radius_mil: field_mil,
        rotations: settings.rotations,
        misfit: misfit.map(|misfit| misfit.to_string()),
        places,
    }
}

/// The n-th of some places that lie evenly in a circle: on a spiral, each turned from the one before by the golden angle (Vogel 1979).
fn evenly(n: usize, count: usize, radius_mil: f64) -> PlateMil {
    const GOLDEN_ANGLE_RAD: f64 = 2.399_963_229_728_653;
    let part = ((n as f64 + 0.5) / count as f64).sqrt();
    PlateMil::from(unit(n as f64 * GOLDEN_ANGLE_RAD) * (radius_mil * part))
}

fn checked(
    instrument: &Instrument,
    solver: &SolverSettings,
    settings: &CheckSettings,
    at: PlateMil,
    n: u64,
) -> CheckedPlace {
    let mut rng = Xoshiro256PlusPlus::seed_from_u64(settings.seed.wrapping_add(n << 8));
    let stated = CheckScene::stated(instrument, solver, settings, at);
    let mut place = CheckedPlace {
        x_mil: at.x,
        y_mil: at.y,
        lit: stated.lit(),
        verdict: PlaceVerdict::Safe,
        margin: None,
        sigma_mil: None,
        misprint_mil: None,
    };
    if place.lit < solver.fiducial.min_marks {
        place.verdict = PlaceVerdict::FewMarks;
        return place;
    }
    if let Some(known) = sigma::of_place(&stated, settings.noise_share) {
        place.sigma_mil = Some(known.sigma_mil);
        place.misprint_mil = Some(known.misprint_mil);
    }
    for _ in 0..settings.draws {
        let scene = stated.drawn(settings.rotations, &mut rng);
        // A mounting that is off may leave fewer marks on the sensor.
        if scene.lit() < solver.fiducial.min_marks {
            continue;
        }
        let (verdict, margin) = judged(&scene);
        place.verdict = place.verdict.max(verdict);
        place.margin = Some(place.margin.map_or(margin, |least| least.min(margin)));
    }
    place
}

/// What the flight's identification makes of a scene, and by how much its odds exceed what is asked.
fn judged(scene: &CheckScene) -> (PlaceVerdict, f64) {
    match scene.identify(&scene.detections()) {
        Ok(found) => {
            let is_true = |(n, id): &(usize, _)| scene.ids[*n] == *id;
            let verdict = match found.ids.iter().all(is_true) {
                true => PlaceVerdict::Safe,
                false => PlaceVerdict::Wrong,
            };
            (verdict, found.margin)
        }
        Err(unread) => {
            let rejected = unread.rejected();
            let verdict = match rejected.reason == sun::CENTRE_ALONE {
                true => PlaceVerdict::SeveralPlaces,
                false => PlaceVerdict::Ambiguous,
            };
            (verdict, (rejected.measured - rejected.limit).min(0.0))
        }
    }
}
