//! The outline of the disc from the whole limb: points and ellipse in turn, until neither moves.

use super::appearance::Appearance;
use super::edge::{EdgeFit, EdgeSearch, LimbPoint};
use super::hidden::Hidden;
use super::light::DiscLight;
use super::outline::{OutlineFit, OutlinePrior, fit_outline};
use super::{Profile, Settings};
use crate::frame::{Frame, Levels, PIXEL_VARIANCE_PX2};
use crate::geometry::Ellipse;
use crate::units::Rejected;
use nalgebra::Matrix2;

/// The limb as one frame shows it.
#[derive(Debug, Clone, PartialEq)]
pub struct Limb {
    /// The points that lie on the outline, their sigmas raised by what scatter they show.
    pub points: Vec<LimbPoint>,
    pub outline: OutlineFit,
    pub profile: Profile,
    appearance: Appearance,
    /// How far the outline lies from the one that its points were measured about.
    moved_px: f64,
}

impl Limb {
    fn new(look: EdgeFit, fit: OutlineFit, moved_px: f64) -> Self {
        let on_it = look.points.iter().zip(&fit.accepted).filter(|(_, a)| **a);
        let raised = on_it.map(|(point, _)| LimbPoint {
            sigma_px: point.sigma_px * fit.scatter,
            ..*point
        });
        Self {
            points: raised.collect(),
            outline: fit,
            profile: look.appearance.profile,
            appearance: look.appearance,
            moved_px,
        }
    }

    /// The blur of the limb, 1 sigma, the pixel's own size taken off.
    pub fn lens_blur_px(&self) -> f64 {
        (self.profile.blur_px.powi(2) - PIXEL_VARIANCE_PX2)
            .max(0.0)
            .sqrt()
    }

    /// Noise of the disc's pixels near the limb, 1 sigma, DN.
    pub fn disc_noise_dn(&self) -> f64 {
        self.appearance.noise.inside_dn
    }

    /// The blurred light of the disc without marks.
    pub fn light(&self) -> DiscLight {
        DiscLight::new(&self.outline.ellipse, &self.profile)
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
/// An outline that was this near serves to tell what lies on the disc, px.
const ROUGHLY_SETTLED_PX: f64 = 0.5;
/// A profile taken about an outline that was farther off is smeared, px.
const STEADY_PX: f64 = 0.3;
/// How far the passes may lead away from the first outline, px.
const MAX_MOVE_PX: f64 = 8.0;

/// Fits the disc's outline to the whole limb of a frame.
#[derive(Debug, Clone, Copy)]
pub struct LimbFit<'a> {
    pub frame: &'a Frame,
    pub levels: &'a Levels,
    /// The expected blur, 1 sigma, the pixel's own size included.
    pub blur_px: f64,
    pub known: KnownOutline,
    pub settings: &'a Settings,
}

impl LimbFit<'_> {
    /// The limb near a first outline, which is within 2 px or so.
    pub fn near(&self, start: &Ellipse, hidden: &Hidden) -> Result<Limb, Rejected> {
        self.settle(start, None, hidden, SETTLED_PX)
    }

    /// The same, roughly: enough to tell what lies on the disc.
    pub fn roughly_near(&self, start: &Ellipse, hidden: &Hidden) -> Result<Limb, Rejected> {
        self.settle(start, None, hidden, ROUGHLY_SETTLED_PX)
    }

    /// The limb where it was seen before, with other pixels hidden.
    pub fn again(&self, before: &Limb, hidden: &Hidden) -> Result<Limb, Rejected> {
        let steady = before.moved_px < STEADY_PX;
        let appearance = steady.then_some(before.appearance);
        self.settle(&before.outline.ellipse, appearance, hidden, SETTLED_PX)
    }

    fn settle(
        &self,
        start: &Ellipse,
        mut appearance: Option<Appearance>,
        hidden: &Hidden,
        settled_px: f64,
    ) -> Result<Limb, Rejected> {
        let mut outline = *start;
        let mut pass = 0;
        loop {
            pass += 1;
            let look = self.look(&outline, appearance.as_ref(), hidden)?;
            let fit = self
                .known
                .fit(&look.points, &outline)
                .ok_or_else(|| self.too_few(look.points.len()))?;
            self.check(&fit, start)?;
            let moved_px = moved_px(&outline, &fit.ellipse);
            if moved_px < settled_px || pass == PASSES {
                return Ok(Limb::new(look, fit, moved_px));
            }
            outline = fit.ellipse;
            appearance = (moved_px < STEADY_PX).then_some(look.appearance);
        }
    }

    fn look(
        &self,
        outline: &Ellipse,
        appearance: Option<&Appearance>,
        hidden: &Hidden,
    ) -> Result<EdgeFit, Rejected> {
        let sight = EdgeSearch {
            frame: self.frame,
            outline,
            hidden,
            sectors: self.settings.limb_points,
        };
        match appearance {
            Some(before) => Ok(sight.look_again(before)),
            None => sight
                .first_look(&self.typical_profile(outline), self.levels)
                .ok_or_else(|| self.too_few(0)),
        }
    }

    fn typical_profile(&self, outline: &Ellipse) -> Profile {
        let light = self.levels.disc_dn - self.levels.background_dn;
        Profile {
            background_dn: self.levels.background_dn,
            even_dn: light * (1.0 - TYPICAL_DARKENING),
            darkened_dn: light * TYPICAL_DARKENING,
            blur_px: self.blur_px,
            radius_px: outline.mean_radius(),
        }
    }

    fn check(&self, fit: &OutlineFit, start: &Ellipse) -> Result<(), Rejected> {
        let accepted = fit.accepted.iter().filter(|a| **a).count();
        if accepted < self.settings.min_limb_points {
            return Err(self.too_few(accepted));
        }
        let away = (fit.ellipse.centre - start.centre).norm();
        if away > MAX_MOVE_PX {
            return Err(Rejected {
                reason: "the limb leads away from the disc that was found",
                measured: away,
                limit: MAX_MOVE_PX,
            });
        }
        Ok(())
    }

    fn too_few(&self, points: usize) -> Rejected {
        Rejected {
            reason: "too few points lie on the limb",
            measured: points as f64,
            limit: self.settings.min_limb_points as f64,
        }
    }
}

/// How far one outline lies from another, but for its size, which a look takes in by itself.
fn moved_px(from: &Ellipse, to: &Ellipse) -> f64 {
    let grown = to.root() - from.root();
    let even = Matrix2::identity() * (grown.trace() / 2.0);
    (to.centre - from.centre).norm() + (grown - even).norm()
}
