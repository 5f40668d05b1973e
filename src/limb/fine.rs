//! The outline of the disc from the whole limb: points and ellipse in turn, until neither moves.

use super::edge::{Hidden, LimbPoint, limb_points};
use super::outline::{OutlineFit, OutlinePrior, fit_outline};
use super::{Profile, Settings};
use crate::frame::{Frame, Levels, PIXEL_VARIANCE_PX2};
use crate::geometry::Ellipse;
use crate::units::Rejected;
use nalgebra::Vector2;

/// The limb as one frame shows it.
#[derive(Debug, Clone, PartialEq)]
pub struct Limb {
    /// The points that lie on the outline, their sigmas raised by what scatter they show.
    pub points: Vec<LimbPoint>,
    pub outline: OutlineFit,
    pub profile: Profile,
}

impl Limb {
    /// The blur of the limb, 1 sigma, the pixel's own size taken off.
    pub fn lens_blur_px(&self) -> f64 {
        (self.profile.blur_px.powi(2) - PIXEL_VARIANCE_PX2)
            .max(0.0)
            .sqrt()
    }

    /// Blurred light of the disc without marks at a sensor position, DN above the background.
    pub fn light_dn(&self, x: f64, y: f64) -> f64 {
        let outwards = self.outline.ellipse.excess(Vector2::new(x, y));
        self.profile.at(outwards) - self.profile.background_dn
    }
}

/// What is known of the outline before the limb is looked at, in two grades.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KnownOutline {
    /// What any camera may show.
    pub possible: OutlinePrior,
    /// What this one shows if it is as its calibration states.
    pub stated: OutlinePrior,
}

impl KnownOutline {
    /// What is stated steadies the outline of a disc of which little is seen. A limb that contradicts it is believed
    /// instead.
    fn fit(&self, points: &[LimbPoint], start: &Ellipse) -> Option<OutlineFit> {
        let free = fit_outline(points, start, &self.possible)?;
        if free.contradicts(&self.stated) {
            return Some(free);
        }
        fit_outline(points, &free.ellipse, &self.stated)
    }
}

/// Limb darkening of the Sun at 630 nm: the share of the light that is gone at the edge.
const TYPICAL_DARKENING: f64 = 0.56;
const PASSES: usize = 6;
/// Points measured about an outline that was this near are as good as they get, px.
const SETTLED_PX: f64 = 0.08;
/// How far the passes may lead away from the first outline, px.
const MAX_MOVE_PX: f64 = 8.0;

/// Fits the disc's outline to the whole limb.
///
/// `start` is within 2 px or so, `blur_px` the expected blur, the pixel's own size included.
pub fn fit_limb(
    frame: &Frame,
    start: &Ellipse,
    levels: &Levels,
    blur_px: f64,
    known: &KnownOutline,
    hidden: &Hidden,
    settings: &Settings,
) -> Result<Limb, Rejected> {
    let light = levels.disc_dn - levels.background_dn;
    let mut profile = Profile {
        background_dn: levels.background_dn,
        even_dn: light * (1.0 - TYPICAL_DARKENING),
        darkened_dn: light * TYPICAL_DARKENING,
        blur_px,
        radius_px: start.mean_radius(),
    };
    let mut outline = *start;
    for pass in 0..PASSES {
        let (points, seen) = limb_points(
            frame,
            &outline,
            &profile,
            levels,
            hidden,
            settings.limb_points,
        )
        .ok_or_else(|| too_few(0, settings))?;
        let fit = known
            .fit(&points, &outline)
            .ok_or_else(|| too_few(points.len(), settings))?;
        let accepted = fit.accepted.iter().filter(|a| **a).count();
        if accepted < settings.min_limb_points {
            return Err(too_few(accepted, settings));
        }
        let moved = (fit.ellipse.centre - outline.centre).norm()
            + (fit.ellipse.root() - outline.root()).norm();
        let away = (fit.ellipse.centre - start.centre).norm();
        if away > MAX_MOVE_PX {
            return Err(Rejected {
                reason: "the limb leads away from the disc that was found",
                measured: away,
                limit: MAX_MOVE_PX,
            });
        }
        if moved < SETTLED_PX || pass == PASSES - 1 {
            let on_it = points.iter().zip(&fit.accepted).filter(|(_, a)| **a);
            let raised = on_it.map(|(point, _)| LimbPoint {
                sigma_px: point.sigma_px * fit.scatter,
                ..*point
            });
            return Ok(Limb {
                points: raised.collect(),
                outline: fit,
                profile: seen,
            });
        }
        outline = fit.ellipse;
        profile = Profile {
            radius_px: outline.mean_radius(),
            ..seen
        };
    }
    Err(too_few(0, settings))
}

fn too_few(points: usize, settings: &Settings) -> Rejected {
    Rejected {
        reason: "too few points lie on the limb",
        measured: points as f64,
        limit: settings.min_limb_points as f64,
    }
}
