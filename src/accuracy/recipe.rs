//! From a recipe and a seed to a scene.

use crate::aspect::SolverSettings;
use crate::geometry::unit;
use crate::instrument::{Instrument, Mounting};
use crate::plate::{MOST_MARKS, MarkId};
use crate::plate_check::{CheckSettings, PlaceVerdict, check_places};
use crate::simulate::{
    Conditions, LitMark, RandomScenes, Scene, SceneError, Sun, SunInView, Sunspot,
};
use crate::units::{PlateMil, SensorPx};
use nalgebra::Vector2;
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use std::f64::consts::TAU;
use std::ops::{Range, RangeInclusive};

/// The generator of a frame's random parameters, in addition to the simulator's own.
pub type Generator = Xoshiro256PlusPlus;

/// A change from the standard frame: modifies a recipe by randomly drawn numbers.
pub type Vary = fn(&mut Recipe, &Instrument, &mut Generator);

/// Position of the Sun in the frames of a row.
#[derive(Debug, Clone, PartialEq)]
pub enum View {
    /// Anywhere with the whole disc on the sensor and the given number of marks fully lit.
    Whole { lit_marks: RangeInclusive<usize> },
    /// Cut by the sensor's edge, with the given fraction of the limb on the sensor, and number of marks fully lit.
    Partial {
        limb_share: Range<f64>,
        lit_marks: RangeInclusive<usize>,
    },
    /// Anywhere with this mark and at least two others fully lit.
    Around(MarkId),
    /// Anywhere in the plate's field.
    Field,
    /// Anywhere in the field where the check of the plate has this verdict.
    Checked(PlaceVerdict),
    /// The whole disc, across the boundary between the sensor's halves: within 0.8 radii of the centre.
    AcrossMiddle,
    /// No Sun.
    Absent,
}

/// Any number of marks.
pub const ANY_MARKS: RangeInclusive<usize> = 0..=MOST_MARKS;
/// Enough marks for a mapping.
pub const ENOUGH_MARKS: RangeInclusive<usize> = 3..=MOST_MARKS;
/// Too few marks for a mapping.
pub const FEW_MARKS: RangeInclusive<usize> = 0..=2;

/// Recipe of a frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Recipe {
    pub conditions: Conditions,
    /// The camera as the instrument states it, which may differ from the true one.
    pub stated: Mounting,
    pub view: View,
    /// Number of sunspots, each up to 1 % of the disc's area.
    pub sunspots: usize,
}

impl Recipe {
    /// The standard frame: the instrument as stated, the whole Sun, 5 DN of noise, no blemishes.
    pub fn standard(instrument: &Instrument) -> Self {
        Self {
            conditions: Conditions::of(instrument),
            stated: instrument.mounting,
            view: View::Whole {
                lit_marks: ANY_MARKS,
            },
            sunspots: 0,
        }
    }

    /// The recipe of a frame of a row. The same seed always gives the same recipe.
    pub fn drawn(vary: Vary, instrument: &Instrument, seed: u64) -> Self {
        let mut recipe = Self::standard(instrument);
        vary(
            &mut recipe,
            instrument,
            &mut Generator::seed_from_u64(seed ^ 0x5eed),
        );
        recipe
    }

    /// The scene of a seed.
    pub fn scene(&self, instrument: &Instrument, seed: u64) -> Result<Scene, SceneError> {
        let conditions = Conditions {
            sun: match self.view {
                View::Absent => SunInView::Absent,
                _ => SunInView::Whole,
            },
            ..self.conditions.clone()
        };
        let scenes = RandomScenes::new(instrument, &conditions, seed)?;
        let mut scene = scenes.scene(seed)?;
        let Some(mut sun) = scene.sun.take() else {
            return Ok(scene);
        };
        let mut rng = Generator::seed_from_u64(seed);
        let spots = (0..self.sunspots).map(|_| sunspot(sun.radius_mil, &mut rng));
        sun.spots.extend(spots);
        // Sufficient for a view that one position in a thousand satisfies.
        for _ in 0..20_000 {
            scene.sun = Some(sun.clone());
            if self.suits(instrument, &scene) {
                return Ok(scene);
            }
            sun.centre = self.place(&scene, sun.radius_mil, &mut rng);
        }
        Err(SceneError::TooSmall {
            width_px: scene.width_px,
            height_px: scene.height_px,
            radius_px: sun.radius_mil / conditions.similarity.scale_mil_per_px,
        })
    }

    /// A position of the Sun, drawn uniformly where the view may be satisfied.
    fn place(&self, scene: &Scene, radius_mil: f64, rng: &mut Generator) -> PlateMil {
        if let View::Around(id) = self.view
            && let Some(mark) = scene.plate.position(id)
        {
            let distance = radius_mil * rng.random_range(0.0_f64..1.0).sqrt();
            return (mark.vector() + direction(rng) * distance).into();
        }
        if let View::Field | View::Checked(_) = self.view {
            let distance = scene.plate.field_radius_mil * rng.random_range(0.0_f64..1.0).sqrt();
            return (direction(rng) * distance).into();
        }
        let reach = radius_mil / self.conditions.similarity.scale_mil_per_px;
        let seen = SensorPx::new(
            rng.random_range(-reach..scene.width_px as f64 + reach),
            rng.random_range(-reach..scene.height_px as f64 + reach),
        );
        scene.mapping.to_plate(seen)
    }

    fn suits(&self, instrument: &Instrument, scene: &Scene) -> bool {
        let in_field = || {
            let sun = scene.sun.as_ref();
            sun.is_some_and(|sun| sun.centre.vector().norm() < scene.plate.field_radius_mil)
        };
        let lit = || fully_lit(scene).count();
        match &self.view {
            View::Whole { lit_marks } => is_whole(scene) && lit_marks.contains(&lit()),
            View::Partial {
                limb_share: wanted,
                lit_marks,
            } => wanted.contains(&limb_share(scene)) && lit_marks.contains(&lit()),
            View::Around(id) => {
                is_whole(scene)
                    && ENOUGH_MARKS.contains(&lit())
                    && fully_lit(scene).any(|mark| mark.id == *id)
            }
            View::Field => in_field(),
            View::Checked(verdict) => in_field() && verdict_of(instrument, scene) == Some(*verdict),
            View::AcrossMiddle => is_whole(scene) && reaches_middle(scene),
            View::Absent => true,
        }
    }
}

/// Verdict of the plate's check at the Sun's position.
fn verdict_of(instrument: &Instrument, scene: &Scene) -> Option<PlaceVerdict> {
    let at = scene.sun.as_ref()?.centre;
    let (solver, settings) = (SolverSettings::default(), CheckSettings::default());
    let places = check_places(instrument, &solver, &settings, &[(0, at)]);
    places.first().map(|place| place.verdict)
}

/// Whether the boundary between the sensor's left and right half crosses the disc well inside its limb.
fn reaches_middle(scene: &Scene) -> bool {
    let middle = (scene.width_px as f64 - 1.0) / 2.0;
    let sun = scene.truth().sun;
    sun.is_some_and(|sun| (sun.px.x - middle).abs() < 0.8 * sun.radius_px)
}

/// Minimum transmission of covers: below it, limb and marks count as covered.
const LEAST_LEFT: f64 = 0.8;

/// The visible marks whose tips, with the surroundings that blur into them, are all lit by the Sun and on the sensor.
pub fn fully_lit(scene: &Scene) -> impl Iterator<Item = LitMark> + '_ {
    /// Reach of the blur beyond a tip: twice the blur of a sharp picture, 12 mil at 5.75 mil/px.
    const BLUR_PX: f64 = 12.0 / 5.75;
    let half_mil = scene.plate.shape.size_mil() / 2.0;
    let arms = scene.plate.shape.arms();
    let tips =
        [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)].map(|(x, y)| arms * Vector2::new(x, y));
    scene.truth().marks.into_iter().filter(move |mark| {
        let blur_mil = BLUR_PX * scene.mapping.scale_mil_per_px(mark.px);
        let tip = |direction: Vector2<f64>, reach: f64| {
            PlateMil::from(mark.plate.vector() + direction * reach)
        };
        let on_sensor = |direction| {
            on_sensor(
                scene,
                scene.mapping.to_sensor(tip(direction, half_mil + blur_mil)),
            )
        };
        // The fit of a mark uses pixels around it as well, which must not be darkened by covers.
        let is_clear = |direction| {
            let tip = tip(direction, 1.2 * half_mil + blur_mil);
            let sun = scene.sun.as_ref();
            sun.is_some_and(|sun| sun.left_by_covers(tip) > LEAST_LEFT)
        };
        let shows = scene.mark_contrast > 0.0 && tips.into_iter().all(is_clear);
        shows && mark.depth_mil >= half_mil + blur_mil && tips.into_iter().all(on_sensor)
    })
}

/// The fraction of the limb that lies on the sensor and is not covered, 0 to 1; 0 without a Sun.
pub fn limb_share(scene: &Scene) -> f64 {
    let seen = limb(scene).filter(|(is_clear, on_sensor)| *is_clear && *on_sensor);
    seen.count() as f64 / LIMB_POINTS as f64
}

/// Whether the Sun's whole disc lies on the sensor.
fn is_whole(scene: &Scene) -> bool {
    limb(scene).filter(|(_, on_sensor)| *on_sensor).count() == LIMB_POINTS
}

/// Number of points along the limb at which it is evaluated.
const LIMB_POINTS: usize = 720;

/// For points all round the limb: whether it is not covered, and whether it is on the sensor; empty without a Sun.
fn limb(scene: &Scene) -> impl Iterator<Item = (bool, bool)> + '_ {
    let at = |sun: &Sun| {
        let (centre, radius_mil) = (sun.centre.vector(), sun.radius_mil);
        (0..LIMB_POINTS).map(move |k| {
            let angle = k as f64 / LIMB_POINTS as f64 * TAU;
            PlateMil::from(centre + unit(angle) * radius_mil)
        })
    };
    scene.sun.iter().flat_map(move |sun| {
        at(sun).map(move |edge| {
            let is_clear = sun.left_by_covers(edge) > LEAST_LEFT;
            (is_clear, on_sensor(scene, scene.mapping.to_sensor(edge)))
        })
    })
}

fn on_sensor(scene: &Scene, at: SensorPx) -> bool {
    let within = |v: f64, pixels: usize| (-0.5..pixels as f64 - 0.5).contains(&v);
    within(at.x, scene.width_px) && within(at.y, scene.height_px)
}

fn direction(rng: &mut Generator) -> Vector2<f64> {
    unit(rng.random_range(0.0..TAU))
}

/// A spot of up to 1 % of the disc's area.
fn sunspot(radius_mil: f64, rng: &mut Generator) -> Sunspot {
    let distance = radius_mil * rng.random_range(0.0_f64..0.7).sqrt();
    Sunspot {
        offset_mil: direction(rng) * distance,
        radius_mil: radius_mil * rng.random_range(0.01..0.1),
        contrast: rng.random_range(0.2..0.6),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::instrument::builtin;

    fn demo() -> Instrument {
        builtin("demo").unwrap()
    }

    #[test]
    fn half_of_the_limb_of_a_sun_on_the_edge_is_on_the_sensor() {
        let mut scene = Recipe::standard(&demo()).scene(&demo(), 1).unwrap();
        assert_eq!(limb_share(&scene), 1.0);
        let edge = scene.mapping.to_plate(SensorPx::new(-0.5, 400.0));
        scene.sun.as_mut().unwrap().centre = edge;
        assert!((limb_share(&scene) - 0.5).abs() < 0.003);
    }

    #[test]
    fn a_view_holds_what_it_says() {
        let view = View::Partial {
            limb_share: 0.15..0.4,
            lit_marks: FEW_MARKS,
        };
        let recipe = Recipe {
            view,
            ..Recipe::standard(&demo())
        };
        for seed in 0..20 {
            let scene = recipe.scene(&demo(), seed).unwrap();
            assert!((0.15..0.4).contains(&limb_share(&scene)));
            assert!(fully_lit(&scene).count() < 3);
        }
    }
}
