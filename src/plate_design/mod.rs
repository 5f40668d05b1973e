//! A plate designed: places for marks such that frames can be read all over a field.
//!
//! # Method
//! 1. Marks on a triangular lattice, each displaced at random, so that no two places of the plate look alike. The lattice is as
//!    wide as leaves every place of the Sun in the field the marks that are asked for.
//! 2. Marks without which every place still has as many are taken away: fewer marks leave more of the limb free.
//! 3. The [check](crate::plate_check) judges it. About the places of the least margin marks are displaced anew, and a plate that
//!    the check likes better is kept: so often, or until none is left to improve.
//! 4. The best of several trials.

use crate::aspect::SolverSettings;
use crate::geometry::unit;
use crate::instrument::{Instrument, MEAN_SUN_ARCSEC, SMALLEST_SUN_ARCSEC};
use crate::plate::{Cross, LEAST_APART_SIZES, MarkId, MarkPlace, MarkShape, Pattern, Plate};
use crate::plate_check::{self, CheckSettings, CheckedPlace, Rotations};
use crate::units::PlateMil;
use nalgebra::Vector2;
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use std::f64::consts::TAU;

mod file;

pub use file::file;

type Generator = Xoshiro256PlusPlus;

/// What a plate is designed for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DesignSettings {
    /// The Sun may stand within this of the plate's centre.
    pub field_mil: f64,
    /// Least marks that are fully lit wherever it stands.
    pub marks_in_view: usize,
    /// Marks that are kept even where fewer would do: more of them tell the Sun's place better, and hide more of the limb.
    pub least_marks: usize,
    pub shape: MarkShape,
    pub rotations: Rotations,
    pub trials: u64,
    /// How often marks are displaced anew in a trial.
    pub exchanges: usize,
    pub seed: u64,
}

/// Plates that are tried, unless it is said otherwise.
pub const TRIALS: u64 = 4;

impl DesignSettings {
    /// Crosses as on the plate of 2013, as many trials and exchanges as a quarter of a minute allows.
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

/// A cross that an instrument's camera reads well and that leaves others room on the disc, its arms of whole mil.
pub fn usual_cross(instrument: &Instrument) -> MarkShape {
    cross_of(usual_mil(instrument, 15.6, 1.0 / 6.0))
}

/// A cross as that of the plate of 2013, its arms so long.
pub fn cross_of(arm_length_mil: f64) -> MarkShape {
    MarkShape::Cross(Cross {
        arm_length_mil,
        arm_width_mil: arm_length_mil * Cross::HEROES.arm_width_mil / Cross::HEROES.arm_length_mil,
        arm_angle_deg: 0.0,
    })
}

/// A dot of the same kind, of whole mil.
pub fn usual_dot(instrument: &Instrument) -> MarkShape {
    MarkShape::Dot {
        diameter_mil: usual_mil(instrument, 9.0, 1.0 / 10.0),
    }
}

/// So many pixels, or this part of the Sun's radius if that is less.
fn usual_mil(instrument: &Instrument, px: f64, of_radius: f64) -> f64 {
    let radius_mil = instrument.optics.radius_mil(MEAN_SUN_ARCSEC);
    let mil = (px * instrument.mounting.scale_mil_per_px.value).min(of_radius * radius_mil);
    mil.round().max(1.0)
}

/// Why no plate can be designed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum DesignError {
    #[error(
        "expected room for {marks_in_view} marks of {size_mil:.0} mil on a disc of {radius_mil:.0} mil radius, found too little; take smaller or fewer marks, or a longer lens"
    )]
    NoRoom {
        marks_in_view: usize,
        size_mil: f64,
        radius_mil: f64,
    },
}

/// Marks keep so many times their size apart: more than a plate must.
const APART_SIZES: f64 = 1.1 * LEAST_APART_SIZES;
/// How far a mark is displaced from its place on the lattice at most, in the lattice's spacing.
const JITTER: f64 = 0.28;

/// Designs a plate for an instrument, whose lens and camera it is for; `done` is called after every exchange.
///
/// # Errors
/// Marks too large or too many for the Sun's disc.
pub fn design(
    instrument: &Instrument,
    settings: &DesignSettings,
    done: &dyn Fn(),
) -> Result<Instrument, DesignError> {
    let mut best: Option<Judged> = None;
    for trial in 0..settings.trials {
        let mut rng = Generator::seed_from_u64(settings.seed.wrapping_mul(1 << 16) + trial);
        let layout = Layout::widest(instrument, settings, &mut rng)?;
        let judged = improved(instrument, settings, layout, &mut rng, done);
        if best.as_ref().is_none_or(|best| judged.is_better_than(best)) {
            best = Some(judged);
        }
    }
    let best = best.ok_or_else(|| Layout::no_room(instrument, settings))?;
    Ok(best.layout.instrument(instrument, settings))
}

/// A layout with what the check says of it.
#[derive(Debug, Clone)]
struct Judged {
    layout: Layout,
    places: Vec<CheckedPlace>,
}

/// What the check of a layout in the making takes: fewer places than of the finished plate.
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
    fn new(instrument: &Instrument, settings: &DesignSettings, layout: Layout) -> Self {
        let plate = layout.instrument(instrument, settings);
        let check = check_settings(settings);
        Self {
            places: plate_check::check(&plate, &SolverSettings::default(), &check).places,
            layout,
        }
    }

    /// The same with one mark displaced: the places are checked anew that light it, or did. Others keep what was found: that one of
    /// their rivals has another place now changes little, and the whole plate is checked at the end.
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
        let places = self.places.iter().map(CheckedPlace::at).enumerate();
        let near: Vec<(usize, PlateMil)> = places.filter(|(_, at)| is_near(*at)).collect();
        let plate = layout.instrument(instrument, settings);
        let solver = SolverSettings::default();
        let check = check_settings(settings);
        let found = plate_check::check_places(&plate, &solver, &check, &near);
        let mut places = self.places.clone();
        for ((n, _), place) in near.into_iter().zip(found) {
            places[n] = place;
        }
        Some(Self { layout, places })
    }

    /// The place of the Sun of the least margin; one without a margin has none.
    fn worst(&self) -> Option<&CheckedPlace> {
        let places = self.places.iter();
        places.min_by(|a, b| margin(a).total_cmp(&margin(b)))
    }

    fn is_better_than(&self, other: &Self) -> bool {
        let [own, others] = [self, other].map(|judged| judged.worst().map(margin));
        own > others
    }
}

fn margin(place: &CheckedPlace) -> f64 {
    place.margin.unwrap_or(f64::NEG_INFINITY)
}

/// Displaces a mark about the worst place anew, and keeps what the check likes better.
fn improved(
    instrument: &Instrument,
    settings: &DesignSettings,
    layout: Layout,
    rng: &mut Generator,
    done: &dyn Fn(),
) -> Judged {
    let mut best = Judged::new(instrument, settings, layout);
    for _ in 0..settings.exchanges {
        done();
        let worst = best.worst().map(CheckedPlace::at);
        let changed = worst.and_then(|sun| best.displaced(instrument, settings, sun, rng));
        if let Some(changed) = changed.filter(|changed| changed.is_better_than(&best)) {
            best = changed;
        }
    }
    Judged::new(instrument, settings, best.layout)
}

/// Places of marks, and the lattice that they come from.
#[derive(Debug, Clone)]
struct Layout {
    /// Each with its place on the lattice.
    marks: Vec<(Vector2<f64>, Vector2<f64>)>,
    spacing_mil: f64,
    /// Marks within this of the Sun's centre are fully lit.
    lit_mil: f64,
    least_apart_mil: f64,
    field_mil: f64,
    marks_in_view: usize,
}

impl Layout {
    fn no_room(instrument: &Instrument, settings: &DesignSettings) -> DesignError {
        DesignError::NoRoom {
            marks_in_view: settings.marks_in_view,
            size_mil: settings.shape.size_mil(),
            radius_mil: instrument.optics.radius_mil(SMALLEST_SUN_ARCSEC),
        }
    }

    /// The layout of the widest lattice that leaves every place of the field its marks, without those that are not needed.
    fn widest(
        instrument: &Instrument,
        settings: &DesignSettings,
        rng: &mut Generator,
    ) -> Result<Self, DesignError> {
        /// Blur that a fully lit mark keeps from the limb, px.
        const BLUR_PX: f64 = 3.0;
        const STEPS: usize = 60;
        /// The next lattice is narrower by this.
        const NARROWER: f64 = 0.97;
        let size_mil = settings.shape.size_mil();
        let blur_mil = BLUR_PX * instrument.mounting.scale_mil_per_px.value;
        let sun_mil = instrument.optics.radius_mil(SMALLEST_SUN_ARCSEC);
        let mut layout = Self {
            marks: Vec::new(),
            spacing_mil: sun_mil,
            lit_mil: sun_mil - size_mil / 2.0 - blur_mil,
            least_apart_mil: APART_SIZES * size_mil,
            field_mil: settings.field_mil,
            marks_in_view: settings.marks_in_view,
        };
        for _ in 0..STEPS {
            layout.fill(rng);
            // With marks so near to each other none could be displaced.
            if layout.spacing_mil * (1.0 - JITTER) < layout.least_apart_mil {
                break;
            }
            if layout.are_apart() && layout.least_in_view() >= settings.marks_in_view {
                layout.prune(settings.least_marks);
                return Ok(layout);
            }
            layout.spacing_mil *= NARROWER;
        }
        Err(Self::no_room(instrument, settings))
    }

    /// Puts marks on the lattice, each displaced.
    fn fill(&mut self, rng: &mut Generator) {
        let reach = self.field_mil + self.lit_mil;
        let rows = (reach / (self.spacing_mil * 0.75_f64.sqrt())).ceil() as i32 + 1;
        let columns = (reach / self.spacing_mil).ceil() as i32 + 1;
        self.marks.clear();
        for row in -rows..=rows {
            for column in -columns..=columns {
                let shift = if row % 2 == 0 { 0.0 } else { 0.5 };
                let (x, y) = (f64::from(column) + shift, f64::from(row) * 0.75_f64.sqrt());
                let node = Vector2::new(x, y) * self.spacing_mil;
                if node.norm() < reach {
                    let at = self.apart_about(node, rng);
                    self.marks.push((node, at));
                }
            }
        }
    }

    /// A place about a node, apart from the marks so far; the node itself where none is found soon.
    fn apart_about(&self, node: Vector2<f64>, rng: &mut Generator) -> Vector2<f64> {
        const TRIES: usize = 20;
        for _ in 0..TRIES {
            let at = self.about(node, rng);
            if self
                .marks
                .iter()
                .all(|(_, other)| (other - at).norm() > self.least_apart_mil)
            {
                return at;
            }
        }
        node
    }

    fn about(&self, node: Vector2<f64>, rng: &mut Generator) -> Vector2<f64> {
        let distance = JITTER * self.spacing_mil * rng.random_range(0.0_f64..1.0).sqrt();
        node + unit(rng.random_range(0.0..TAU)) * distance
    }

    fn are_apart(&self) -> bool {
        let places = || self.marks.iter().map(|(_, at)| at).enumerate();
        places().all(|(n, at)| {
            let mut before = places().take(n);
            before.all(|(_, other)| (other - at).norm() > self.least_apart_mil)
        })
    }

    /// Places of the Sun all over the field, closer than marks are.
    fn suns(&self) -> Vec<Vector2<f64>> {
        let step = self.spacing_mil / 5.0;
        let count = (self.field_mil / step).ceil() as i32;
        let along = move || (-count..=count).map(move |n| f64::from(n) * step);
        let all = along().flat_map(|x| along().map(move |y| Vector2::new(x, y)));
        // The edge itself, too.
        let edge = (0..360).map(|n| unit(f64::from(n).to_radians()) * self.field_mil);
        all.filter(|at| at.norm() < self.field_mil)
            .chain(edge)
            .collect()
    }

    fn lit(&self, sun: &Vector2<f64>) -> usize {
        let near = |(_, at): &&(Vector2<f64>, Vector2<f64>)| (at - sun).norm() < self.lit_mil;
        self.marks.iter().filter(near).count()
    }

    fn least_in_view(&self) -> usize {
        self.suns()
            .iter()
            .map(|sun| self.lit(sun))
            .min()
            .unwrap_or(0)
    }

    /// Takes marks away without which every place has as many as are asked for, those first that are farthest out, while more are left
    /// than `least`.
    fn prune(&mut self, least: usize) {
        let mut left = self.marks.len();
        let suns = self.suns();
        let mut lit: Vec<usize> = suns.iter().map(|sun| self.lit(sun)).collect();
        self.marks.sort_by(|a, b| b.1.norm().total_cmp(&a.1.norm()));
        let mut kept = Vec::new();
        for mark in std::mem::take(&mut self.marks) {
            let near = |n: &usize| (mark.1 - suns[*n]).norm() < self.lit_mil;
            let near: Vec<usize> = (0..suns.len()).filter(near).collect();
            // Of a mark that nothing lights none is left.
            if left > least && near.iter().all(|n| lit[*n] > self.marks_in_view) {
                left -= 1;
                near.iter().for_each(|n| lit[*n] -= 1);
            } else {
                kept.push(mark);
            }
        }
        self.marks = kept;
    }

    /// The layout with a mark in view of a place displaced anew, and from where to where; `None` where the marks would be too near or too
    /// few somewhere.
    fn displaced(&self, sun: PlateMil, rng: &mut Generator) -> Option<(Self, [Vector2<f64>; 2])> {
        let near = |n: &usize| (self.marks[*n].1 - sun.vector()).norm() < self.lit_mil;
        let near: Vec<usize> = (0..self.marks.len()).filter(near).collect();
        if near.is_empty() {
            return None;
        }
        let chosen = near[rng.random_range(0..near.len())];
        let mut changed = self.clone();
        let (node, before) = self.marks[chosen];
        let at = self.about(node, rng);
        changed.marks[chosen].1 = at;
        let apart = |(n, (_, other)): (usize, &(Vector2<f64>, Vector2<f64>))| {
            n == chosen || (other - at).norm() > self.least_apart_mil
        };
        let is_apart = self.marks.iter().enumerate().all(apart);
        let suits = is_apart && changed.least_in_view() >= self.marks_in_view;
        suits.then_some((changed, [before, at]))
    }

    /// The instrument with this plate.
    fn instrument(&self, instrument: &Instrument, settings: &DesignSettings) -> Instrument {
        let sigma_mil = instrument.plate.drawing_sigma_mil();
        let mut places: Vec<Vector2<f64>> = self.marks.iter().map(|(_, at)| *at).collect();
        places.sort_by(|a, b| {
            (a.y, a.x)
                .partial_cmp(&(b.y, b.x))
                .unwrap_or(std::cmp::Ordering::Equal)
        });
        // What is made is what was checked: to a thousandth of a mil.
        let rounded = |v: f64| (v * 1e3).round() / 1e3;
        let mark = |(i, at): (i32, Vector2<f64>)| {
            let at = PlateMil::new(rounded(at.x), rounded(at.y));
            (MarkId { i, j: 0 }, MarkPlace::new(at, sigma_mil))
        };
        let marks = (1..).zip(places).map(mark);
        let mut plate = Plate::new(Pattern::Table, settings.shape, sigma_mil, marks);
        plate.field_radius_mil = settings.field_mil;
        Instrument {
            plate,
            ..instrument.clone()
        }
    }
}
