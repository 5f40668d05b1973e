//! Objects between the camera and the Earth, or beside it: the vehicle's struts and banners, a Moon, light that the lens scatters.

use super::EarthConditions;
use crate::simulate::Generator;
use nalgebra::{Rotation2, Vector2};
use rand::RngExt;
use std::ops::Range;

/// Extra blur of near edges in addition to the lens's, px.
const SOFT_PX: f64 = 0.5;

/// A part of the vehicle: a uniformly lit rectangle.
#[derive(Debug, Clone, Copy)]
struct Panel {
    middle: Vector2<f64>,
    turn: Rotation2<f64>,
    half_size_px: Vector2<f64>,
    light_dn: f64,
}

impl Panel {
    /// A strut from one end of the picture to the other, or a banner that covers up to a tenth of it.
    fn drawn(picture: &Vector2<f64>, random: &mut Generator) -> Self {
        const LIGHT_DN: Range<f64> = 15.0..230.0;
        const STRUT_PX: Range<f64> = 4.0..60.0;
        const BANNER: Range<f64> = 0.1..0.3;
        let place = |random: &mut Generator, size: f64| size * random.random_range(0.1..0.9);
        let half_size_px = match random.random_bool(0.5) {
            true => Vector2::new(picture.sum(), random.random_range(STRUT_PX) / 2.0),
            false => picture.map(|size| size * random.random_range(BANNER) / 2.0),
        };
        Self {
            middle: Vector2::new(place(random, picture.x), place(random, picture.y)),
            turn: Rotation2::new(random.random_range(0.0..std::f64::consts::PI)),
            half_size_px,
            light_dn: random.random_range(LIGHT_DN),
        }
    }

    /// Fraction of a pixel that it covers.
    fn hides(&self, at: &Vector2<f64>) -> f64 {
        let inside = self.half_size_px - (self.turn.inverse() * (at - self.middle)).abs();
        (0.5 + inside.min() / (2.0 * SOFT_PX)).clamp(0.0, 1.0)
    }
}

/// A full Moon.
#[derive(Debug, Clone, Copy)]
struct Moon {
    middle: Vector2<f64>,
    radius_px: f64,
}

/// Light that increases from one side of the picture to the other, and towards a place beyond it.
#[derive(Debug, Clone, Copy)]
struct Gradient {
    across: Vector2<f64>,
    dn: f64,
    source: Vector2<f64>,
    reach_px: f64,
    source_dn: f64,
}

impl Gradient {
    fn drawn(picture: &Vector2<f64>, random: &mut Generator) -> Self {
        let angle: f64 = random.random_range(0.0..std::f64::consts::TAU);
        let across = Vector2::new(angle.cos(), angle.sin());
        Self {
            across: across / picture.norm(),
            dn: random.random_range(0.0..80.0),
            source: picture / 2.0 + across * picture.norm() * random.random_range(0.45..0.7),
            reach_px: picture.norm() * random.random_range(0.1..0.5),
            source_dn: random.random_range(0.0..250.0),
        }
    }

    fn at(&self, at: &Vector2<f64>, picture: &Vector2<f64>) -> f64 {
        let along = (at - picture / 2.0).dot(&self.across) + 0.5;
        let away = (at - self.source).norm() / self.reach_px;
        self.dn * along.clamp(0.0, 1.0) + self.source_dn * (-away).exp()
    }
}

/// All objects of a scene.
pub(super) struct Front {
    picture: Vector2<f64>,
    moon: Option<Moon>,
    gradient: Option<Gradient>,
    panels: Vec<Panel>,
}

impl Front {
    pub fn drawn(conditions: &EarthConditions, random: &mut Generator) -> Self {
        const MOST_PANELS: usize = 3;
        const MOON_DN_PX: Range<f64> = 8.0..120.0;
        let picture = Vector2::new(conditions.width_px as f64, conditions.height_px as f64);
        let gradient = Gradient::drawn(&picture, random);
        let moon = Moon {
            middle: picture.map(|size| size * random.random_range(0.0..1.0)),
            radius_px: random.random_range(MOON_DN_PX),
        };
        let panels = random.random_range(1..=MOST_PANELS);
        let panels = (0..panels).map(|_| Panel::drawn(&picture, random));
        let panels = panels.collect();
        Self {
            picture,
            moon: conditions.moon.then_some(moon),
            gradient: conditions.gradient.then_some(gradient),
            panels: if conditions.structure {
                panels
            } else {
                Vec::new()
            },
        }
    }

    /// The light of a pixel, DN, given its light without these objects.
    pub fn light_dn(&self, at: &Vector2<f64>, behind_dn: f64) -> f64 {
        const MOON_DN: f64 = 200.0;
        let moon = self.moon.map_or(0.0, |moon| {
            let inside = moon.radius_px - (at - moon.middle).norm();
            MOON_DN * (0.5 + inside).clamp(0.0, 1.0)
        });
        let gradient = |gradient: Gradient| gradient.at(at, &self.picture);
        let lit_dn = behind_dn + moon + self.gradient.map_or(0.0, gradient);
        let hidden = |dn: f64, panel: &Panel| dn + panel.hides(at) * (panel.light_dn - dn);
        self.panels.iter().fold(lit_dn, hidden)
    }
}
