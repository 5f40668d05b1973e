//! A square part of the sky near the Sun, on which positions are drawn: north up, west to the right.

use super::context::Context;
use super::track::Point;
use crate::pointing::HelioprojectiveArcsec;
use crate::report::{Canvas, Colour, graticule, limb};
use crate::simulate::LIMB_DARKENING;
use crate::sky::Disc;
use crate::units::SensorPx;
use image::{Rgb, RgbImage};
use rayon::prelude::*;

/// Spacing of the circles of the graticule, deg.
const SPACING_DEG: u32 = 15;
/// Grey level of the middle of the disc without a context, and of a context's white: the path is visible on it.
const DISC_GREY: f64 = 170.0;
const WHITE_GREY: f64 = 215.0;
/// Greatest number of samples in a pixel along each side, averaged where the context is finer than the picture.
const MOST_SAMPLES: f64 = 4.0;

const LIMB: Colour = Colour(200, 200, 210);
const GRATICULE: Colour = Colour(80, 120, 160);
pub const PATH: Colour = Colour::YELLOW;
pub const OLD_PATH: Colour = Colour(200, 125, 40);
pub const INVALID: Colour = Colour(140, 140, 150);
pub const BORESIGHT: Colour = Colour::RED;
pub const TARGET: Colour = Colour::GREEN;

/// The part of the sky in a picture.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct View {
    pub centre: HelioprojectiveArcsec,
    pub arcsec_per_px: f64,
    pub side_px: u32,
}

impl View {
    /// A square of this side around a position, with the distance from its centre to each edge.
    pub fn about(centre: HelioprojectiveArcsec, reach_arcsec: f64, side_px: u32) -> Self {
        Self {
            centre,
            arcsec_per_px: 2.0 * reach_arcsec / f64::from(side_px),
            side_px,
        }
    }

    fn middle_px(&self) -> f64 {
        f64::from(self.side_px - 1) / 2.0
    }

    /// The pixel of a position.
    pub fn px(&self, place: HelioprojectiveArcsec) -> SensorPx {
        let along = |arcsec: f64| arcsec / self.arcsec_per_px;
        SensorPx::new(
            self.middle_px() + along(place.x - self.centre.x),
            self.middle_px() - along(place.y - self.centre.y),
        )
    }

    /// Whether a position is within the view.
    pub fn holds(&self, place: HelioprojectiveArcsec) -> bool {
        let px = self.px(place);
        let side = 0.0..f64::from(self.side_px);
        side.contains(&px.x) && side.contains(&px.y)
    }

    /// The position of a pixel.
    pub fn place(&self, px: SensorPx) -> HelioprojectiveArcsec {
        HelioprojectiveArcsec {
            x: self.centre.x + (px.x - self.middle_px()) * self.arcsec_per_px,
            y: self.centre.y - (px.y - self.middle_px()) * self.arcsec_per_px,
        }
    }
}

/// A part of the sky and its drawings.
#[derive(Clone)]
pub struct Panel {
    pub view: View,
    pub canvas: Canvas,
}

impl Panel {
    /// The Sun, from the context or limb-darkened, with limb and graticule.
    pub fn new(view: View, disc: &Disc, context: Option<&Context>) -> Self {
        let sun = sun(&view, disc.radius_arcsec(), context);
        let canvas = Canvas::of_image(&sun, 0);
        let mut panel = Self { view, canvas };
        for line in graticule(disc, SPACING_DEG) {
            panel.lines(&line, GRATICULE);
        }
        panel.lines(&limb(disc), LIMB);
        panel
    }

    fn lines(&mut self, places: &[HelioprojectiveArcsec], colour: Colour) {
        for ends in places.windows(2) {
            self.line(ends[0], ends[1], colour);
        }
    }

    /// A straight line between two positions, if it may cross the view.
    fn line(&mut self, from: HelioprojectiveArcsec, to: HelioprojectiveArcsec, colour: Colour) {
        let [from, to] = [from, to].map(|place| self.view.px(place));
        let side = f64::from(self.view.side_px);
        let outside = |a: f64, b: f64| a.max(b) < 0.0 || a.min(b) > side;
        if !outside(from.x, to.x) && !outside(from.y, to.y) {
            self.canvas.line(from, to, colour);
        }
    }

    /// The path through points, valid parts in this colour.
    pub fn path(&mut self, points: &[Point], colour: Colour) {
        for step in points.windows(2) {
            let ([from, to], [Some(a), Some(b)]) =
                ([step[0], step[1]], [step[0].place, step[1].place])
            else {
                continue;
            };
            let is_valid = from.invalid.or(to.invalid).is_none();
            self.line(a, b, if is_valid { colour } else { INVALID });
        }
    }

    /// The target: a circle.
    pub fn target(&mut self, place: HelioprojectiveArcsec) {
        let at = self.view.px(place);
        self.canvas.circle(at, 13.0, TARGET);
        self.canvas.circle(at, 12.0, TARGET);
    }

    /// The boresight: a dot in a cross with an open middle.
    pub fn boresight(&mut self, place: HelioprojectiveArcsec, colour: Colour) {
        let at = self.view.px(place);
        for (x, y) in [(1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)] {
            let end = |px: f64| SensorPx::new(at.x + x * px, at.y + y * px);
            self.canvas.line(end(6.0), end(18.0), colour);
        }
        self.canvas.circle(at, 6.0, colour);
        self.canvas.dot(at, colour);
    }

    /// The edges of another view.
    pub fn outline(&mut self, other: &View, colour: Colour) {
        let half = other.arcsec_per_px * f64::from(other.side_px) / 2.0;
        let corner = |x: f64, y: f64| HelioprojectiveArcsec {
            x: other.centre.x + x * half,
            y: other.centre.y + y * half,
        };
        let around = [
            (1.0, 1.0),
            (1.0, -1.0),
            (-1.0, -1.0),
            (-1.0, 1.0),
            (1.0, 1.0),
        ];
        self.lines(&around.map(|(x, y)| corner(x, y)), colour);
    }
}

/// The Sun without lines.
fn sun(view: &View, radius_arcsec: f64, context: Option<&Context>) -> RgbImage {
    let side = view.side_px as usize;
    let fine = context.map_or(1.0, |context| context.arcsec_per_px(radius_arcsec));
    let samples = (view.arcsec_per_px / fine).round().clamp(1.0, MOST_SAMPLES) as u32;
    let light = |place: HelioprojectiveArcsec| match context {
        Some(context) => {
            let brightness = context.brightness(place, radius_arcsec);
            WHITE_GREY * f64::from(brightness.unwrap_or(0.0))
        }
        None => {
            let cosine2 = 1.0 - (place.x.powi(2) + place.y.powi(2)) / radius_arcsec.powi(2);
            match cosine2 > 0.0 {
                true => DISC_GREY * (1.0 - LIMB_DARKENING * (1.0 - cosine2.sqrt())),
                false => 0.0,
            }
        }
    };
    let within = |n: u32| (f64::from(n) + 0.5) / f64::from(samples) - 0.5;
    let grey = |n: usize| {
        let (x, y) = ((n % side) as f64, (n / side) as f64);
        let parts = (0..samples * samples).map(|part| {
            let px = SensorPx::new(x + within(part % samples), y + within(part / samples));
            light(view.place(px))
        });
        (parts.sum::<f64>() / f64::from(samples * samples)) as u8
    };
    let greys: Vec<u8> = (0..side * side).into_par_iter().map(grey).collect();
    RgbImage::from_fn(view.side_px, view.side_px, |x, y| {
        Rgb([greys[y as usize * side + x as usize]; 3])
    })
}
