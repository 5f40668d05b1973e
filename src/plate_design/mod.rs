//! Design of a plate: positions of marks such that frames can be identified all over a field.
//!
//! # Method
//! 1. Marks on a triangular lattice, each displaced at random, so that no two places of the plate show the same pattern.
//!    The lattice is the widest that leaves every position of the Sun in the field the requested number of marks.
//! 2. Marks that no place needs are removed: fewer marks leave more of the limb free.
//! 3. The [check](crate::plate_check) judges it. A mark near the position with the smallest margin is displaced again, and
//!    the new plate is kept if the check rates it higher; this is repeated.
//! 4. The best of several trials, by the whole check.
//!
//! ```text
//! layout <- mod; file
//! ```

use crate::aspect::SolverSettings;
use crate::instrument::{Instrument, MEAN_SUN_ARCSEC, SMALLEST_SUN_ARCSEC};
use crate::plate::{Cross, MOST_MARKS, MarkShape};
use crate::plate_check::{self, CheckSettings, CheckedPlace, Rotations};
use crate::units::PlateMil;
use layout::Layout;
use rand::SeedableRng;
use rand_xoshiro::Xoshiro256PlusPlus;

mod file;
mod layout;

pub use file::file;

type Generator = Xoshiro256PlusPlus;

/// Goals of a design.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DesignSettings {
    /// The Sun's centre may be within this distance of the plate's centre.
    pub field_mil: f64,
    /// Minimum number of fully lit marks for any position of the Sun in the field.
    pub marks_in_view: usize,
    /// Minimum number of marks that are kept even if fewer would do: more marks determine the Sun's position better, and
    /// mask more of the limb.
    pub least_marks: usize,
    pub shape: MarkShape,
    pub rotations: Rotations,
    pub trials: u64,
    /// Number of displacements of marks per trial.
    pub exchanges: usize,
    pub seed: u64,
}

/// Default number of trials.
pub const TRIALS: u64 = 8;

impl DesignSettings {
    /// Crosses as on the plate of 2013, with as many trials and exchanges as take half a minute.
    pub fn new(field_mil: f64, marks_in_view: usize) -> Self {
        Self {
            field_mil,
            marks_in_view,
            least_marks: 0,
            shape: MarkShape::Cross(Cross::HEROES),
            rotations: Rotations::Stated,
            trials: TRIALS,
            exchanges: 60,
            seed: 1,
        }
    }
}

/// A cross that an instrument's camera identifies well and that leaves space for others on the disc; its dimensions are
/// whole mil.
pub fn usual_cross(instrument: &Instrument) -> MarkShape {
    cross_of(usual_mil(instrument, 15.6, 1.0 / 6.0))
}

/// A cross of the proportions of the plate of 2013, with the given arm length.
pub fn cross_of(arm_length_mil: f64) -> MarkShape {
    MarkShape::Cross(Cross {
        arm_length_mil,
        arm_width_mil: arm_length_mil * Cross::HEROES.arm_width_mil / Cross::HEROES.arm_length_mil,
        arm_angle_deg: 0.0,
    })
}

/// A dot chosen in the same way, of whole mil.
pub fn usual_dot(instrument: &Instrument) -> MarkShape {
    MarkShape::Dot {
        diameter_mil: usual_mil(instrument, 9.0, 1.0 / 10.0),
    }
}

/// A length in pixels, or a fraction of the Sun's radius if that is less, as whole mil.
fn usual_mil(instrument: &Instrument, px: f64, of_radius: f64) -> f64 {
    let radius_mil = instrument.optics.radius_mil(MEAN_SUN_ARCSEC);
    let mil = (px * instrument.mounting.scale_mil_per_px.value).min(of_radius * radius_mil);
    mil.round().max(1.0)
}

/// Why no plate can be designed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum DesignError {
    #[error(
        "expected space for {marks_in_view} marks of {size_mil:.0} mil on a disc of {radius_mil:.0} mil radius, found too little; take smaller or fewer marks, or a longer lens"
    )]
    NoSpace {
        marks_in_view: usize,
        size_mil: f64,
        radius_mil: f64,
    },
    #[error(
        "expected a plate of at most {MOST_MARKS} marks, found a field of {field_mil:.0} mil that takes {count:.0}; take a smaller field, fewer marks in view, or a longer lens"
    )]
    TooMany { count: f64, field_mil: f64 },
}

/// Designs a plate for an instrument with its lens and camera; `done` is called after every exchange.
///
/// # Errors
/// If the marks are too large or too many for the Sun's disc.
pub fn design(
    instrument: &Instrument,
    settings: &DesignSettings,
    done: &dyn Fn(),
) -> Result<Instrument, DesignError> {
    let mut layouts = Vec::new();
    for trial in 0..settings.trials {
        let mut rng = Generator::seed_from_u64(settings.seed.wrapping_mul(1 << 16) + trial);
        let layout = Layout::widest(instrument, settings, &mut rng)?;
        layouts.push(improved(instrument, settings, layout, &mut rng, done));
    }
    // A single layout needs no comparison.
    if layouts.len() > 1 {
        let whole = CheckSettings {
            rotations: settings.rotations,
            ..CheckSettings::default()
        };
        let judged = layouts.into_iter();
        let judged = judged.map(|layout| Judged::new(instrument, settings, layout, &whole));
        let best = judged.max_by(|a, b| a.worst_margin().total_cmp(&b.worst_margin()));
        layouts = best.into_iter().map(|best| best.layout).collect();
    }
    let best = layouts.first();
    let best = best.ok_or_else(|| Layout::no_space(instrument, settings))?;
    Ok(best.instrument(instrument, settings))
}

/// A layout with the result of its check.
#[derive(Debug, Clone)]
struct Judged {
    layout: Layout,
    places: Vec<CheckedPlace>,
}

/// Settings of the check during the design: fewer places than for the finished plate.
fn check_settings(settings: &DesignSettings) -> CheckSettings {
    CheckSettings {
        places: 400,
        draws: 2,
        cluttered_draws: 0,
        rotations: settings.rotations,
        ..CheckSettings::default()
    }
}

impl Judged {
    fn new(
        instrument: &Instrument,
        settings: &DesignSettings,
        layout: Layout,
        check: &CheckSettings,
    ) -> Self {
        let plate = layout.instrument(instrument, settings);
        Self {
            places: plate_check::check(&plate, &SolverSettings::default(), check).places,
            layout,
        }
    }

    /// The same with one mark displaced. The positions that light the mark, before or after, are checked again. Others keep
    /// their result: the changed place of a rival changes little, and the whole plate is checked at the end.
    fn displaced(
        &self,
        instrument: &Instrument,
        settings: &DesignSettings,
        sun: PlateMil,
        rng: &mut Generator,
    ) -> Option<Self> {
        let (layout, ends) = self.layout.displaced(sun, rng)?;
        let reach_mil = instrument.optics.radius_mil(SMALLEST_SUN_ARCSEC);
        let is_near = |at: PlateMil| {
            ends.iter()
                .any(|end| (end - at.vector()).norm() < reach_mil)
        };
        let places = (0..).zip(self.places.iter().map(CheckedPlace::at));
        let near: Vec<(u64, PlateMil)> = places.filter(|(_, at)| is_near(*at)).collect();
        let plate = layout.instrument(instrument, settings);
        let solver = SolverSettings::default();
        let check = check_settings(settings);
        let found = plate_check::check_places(&plate, &solver, &check, &near);
        let mut places = self.places.clone();
        for ((n, _), place) in near.into_iter().zip(found) {
            places[n as usize] = place;
        }
        Some(Self { layout, places })
    }

    /// The position of the Sun with the smallest margin; a position without a margin counts as the smallest.
    fn worst(&self) -> Option<&CheckedPlace> {
        let places = self.places.iter();
        places.min_by(|a, b| margin(a).total_cmp(&margin(b)))
    }

    fn worst_margin(&self) -> f64 {
        self.worst().map_or(f64::NEG_INFINITY, margin)
    }
}

fn margin(place: &CheckedPlace) -> f64 {
    place.margin.unwrap_or(f64::NEG_INFINITY)
}

/// Displaces marks near the worst position, and keeps what the check rates higher.
fn improved(
    instrument: &Instrument,
    settings: &DesignSettings,
    layout: Layout,
    rng: &mut Generator,
    done: &dyn Fn(),
) -> Layout {
    let mut best = Judged::new(instrument, settings, layout, &check_settings(settings));
    for _ in 0..settings.exchanges {
        done();
        let worst = best.worst().map(CheckedPlace::at);
        let changed = worst.and_then(|sun| best.displaced(instrument, settings, sun, rng));
        let better = changed.filter(|changed| changed.worst_margin() > best.worst_margin());
        best = better.unwrap_or(best);
    }
    best.layout
}
