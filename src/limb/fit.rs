//! The outline of the disc from the whole limb: points and ellipse in turn, until neither moves.

use super::band::{Band, Reach};
use super::edge::{EdgeFit, EdgeModel, LimbPoint, Shape, fit_edge, noise};
use super::light::DiscLight;
use super::outline::{OutlineFit, OutlinePrior, fit_outline};
use super::profile::{Brightness, MODEL_SIGMA_PX, Profile};
use super::{LIMB_DARKENING, Settings};
use crate::estimation::{MEDIAN_SIGMA, median};
use crate::frame::{Cutout, Mask, PIXEL_VARIANCE_PX2, PixelNoise};
use crate::geometry::Ellipse;
use crate::units::Rejected;
use nalgebra::{Matrix2, Vector2};

/// The limb as one frame shows it.
#[derive(Debug, Clone, PartialEq)]
pub struct Limb {
    /// The points that lie on the outline, their sigmas inflated by the scatter that they show.
    pub points: Vec<LimbPoint>,
    pub outline: OutlineFit,
    model: EdgeModel,
    /// How far the outline lies from the one that its points were measured about.
    moved_px: f64,
}

impl Limb {
    fn new(fit: EdgeFit, outline: OutlineFit, moved_px: f64) -> Self {
        let accepted = fit
            .points
            .iter()
            .zip(&outline.accepted)
            .filter(|(_, a)| **a);
        let inflated = accepted.map(|(point, _)| LimbPoint {
            sigma_px: point.sigma_px * outline.scatter,
            ..*point
        });
        Self {
            points: inflated.collect(),
            outline,
            model: fit.model,
            moved_px,
        }
    }

    /// Variance of the blur along the limb's normal, all round, and the largest and smallest about it, px^2; the pixel's own
    /// size taken off.
    fn blur_px2(&self) -> (f64, f64) {
        let mean = self.model.profile.blur_px.powi(2) + self.model.shape.blur_px2();
        (
            mean - PIXEL_VARIANCE_PX2,
            self.model.shape.motion_px2().norm(),
        )
    }

    /// The blur of the limb, 1 sigma, all round.
    pub fn blur_px(&self) -> f64 {
        self.blur_px2().0.max(0.0).sqrt()
    }

    /// The blur of the lens, 1 sigma: that of the limb where the Sun's motion does not soften it.
    pub fn lens_blur_px(&self) -> f64 {
        let (mean, motion) = self.blur_px2();
        (mean - motion).max(0.0).sqrt()
    }

    /// How far the Sun's image may have moved during the exposure, px, where the lens itself blurs by so much: on part of a limb
    /// motion and haze cannot be distinguished, and all that it is softer counts as motion.
    pub fn most_motion_px(&self, lens_blur_px: f64, limb_fraction: f64) -> f64 {
        if limb_fraction > MOTION_TOLD {
            return self.motion_px();
        }
        let softer_px2 = self.blur_px2().0 - (HARDLY_SOFTER * lens_blur_px).powi(2);
        self.motion_px().max((12.0 * softer_px2).max(0.0).sqrt())
    }

    /// How far the Sun's image moved during the exposure, px. A uniform motion by l spreads the limb by l^2/12 along it and not
    /// at all across it, l^2/24 all round and as much at twice the azimuth.
    pub fn motion_px(&self) -> f64 {
        (24.0 * self.blur_px2().1).sqrt()
    }

    /// Coma: the part of the light that it displaces times the displacement, px, and the covariance of that; 0 where it is not
    /// significant. The displaced light is blurred by [`COMA_BLURS`](super::COMA_BLURS) times the blur.
    pub fn coma(&self) -> (Vector2<f64>, Matrix2<f64>) {
        self.model.coma()
    }

    /// How far outwards or inwards the limb may lie all round, since its profile is uncertain, 1 sigma, px.
    pub fn place_sigma_px(&self) -> f64 {
        self.model.place_sigma_px
    }

    /// Noise of the pixels near the limb.
    pub fn noise(&self) -> PixelNoise {
        self.model.noise
    }

    /// The blurred light of the disc without marks.
    pub fn light(&self) -> DiscLight {
        DiscLight::new(&self.outline.ellipse, &self.model.profile)
    }
}

/// What is known of the outline before the limb is measured, in two grades.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KnownOutline {
    /// What any camera may show.
    pub possible: OutlinePrior,
    /// What this one shows if it is as its calibration states.
    pub stated: OutlinePrior,
}

impl KnownOutline {
    /// What is stated constrains the outline of a disc of which little is visible. A limb that contradicts it is believed
    /// instead.
    fn fit(&self, points: &[LimbPoint], start: &Ellipse) -> Option<OutlineFit> {
        let free = fit_outline(points, start, &self.possible).ok()?;
        if free.contradicts(&self.stated) {
            return Some(free);
        }
        free.with(&self.stated)
    }
}

/// A larger part of the limb shows at which azimuths it is softer.
const MOTION_TOLD: f64 = 0.7;
/// A limb so many times softer than the lens makes it is as sharp as it is stated.
const HARDLY_SOFTER: f64 = 1.3;
const PASSES: usize = 6;
/// Points measured about an outline that was this near are as good as they get, in blurs.
const SETTLED_BLURS: f64 = 0.08;
/// An outline that was this near is enough to detect what lies on the disc, in blurs.
const ROUGHLY_SETTLED_BLURS: f64 = 0.5;
/// A profile taken about an outline that was farther off is smeared, in blurs.
const STEADY_BLURS: f64 = 0.3;
/// How far the passes may lead away from the first outline, in blurs.
const MOST_BLURS_AWAY: f64 = 8.5;
/// The band about an outline reaches so many blurs, and at least so many px: inside the light hardly bends any more, outside
/// pixels show the background.
const INSIDE: (f64, f64) = (5.0, 7.0);
const OUTSIDE: (f64, f64) = (6.0, 6.0);
/// How far the limb may be from an outline before and after a first pass, 1 sigma, in blurs.
const FIRST_SHIFT_BLURS: f64 = 0.7;
const LATER_SHIFT_BLURS: f64 = 0.05;
/// Distances that share a median, per blur; fewest pixels that make one; and every so many sectors are used.
const MEDIANS_PER_BLUR: f64 = 3.0;
const MIN_MEDIAN_PIXELS: usize = 10;
const MEDIAN_SECTORS: usize = 4;

/// Fits the disc's outline to the whole limb of a frame.
#[derive(Debug, Clone, Copy)]
pub struct LimbFit<'a> {
    pub cutout: &'a Cutout,
    /// Light of the disc's bright part, DN.
    pub disc_dn: f64,
    /// The expected blur, 1 sigma, the pixel's own size included.
    pub blur_px: f64,
    pub known: KnownOutline,
    pub settings: &'a Settings,
}

impl LimbFit<'_> {
    /// The limb near a first outline, which is within 2 px or so, without the pixels that are masked.
    pub fn near(&self, start: &Ellipse, mask: &Mask) -> Result<Limb, Rejected> {
        self.settle(start, None, mask, SETTLED_BLURS)
    }

    /// The same, roughly: enough to detect what lies on the disc.
    pub fn roughly_near(&self, start: &Ellipse, mask: &Mask) -> Result<Limb, Rejected> {
        self.settle(start, None, mask, ROUGHLY_SETTLED_BLURS)
    }

    /// The limb where it was found before, with other pixels masked.
    pub fn again(&self, before: &Limb, mask: &Mask) -> Result<Limb, Rejected> {
        let model = self.steady(before.moved_px, before.model);
        self.settle(&before.outline.ellipse, model, mask, SETTLED_BLURS)
    }

    /// The model of a pass for the next one, unless the outline has moved since.
    fn steady(&self, moved_px: f64, model: EdgeModel) -> Option<EdgeModel> {
        let blur_px = model.profile.blur_px;
        (moved_px < STEADY_BLURS * blur_px).then_some(EdgeModel {
            shift_sigma_px: LATER_SHIFT_BLURS * blur_px,
            ..model
        })
    }

    fn settle(
        &self,
        start: &Ellipse,
        mut model: Option<EdgeModel>,
        mask: &Mask,
        settled_blurs: f64,
    ) -> Result<Limb, Rejected> {
        let mut ellipse = *start;
        let mut pass = 0;
        loop {
            pass += 1;
            let (band, before) = match model {
                Some(model) => (self.band(&ellipse, mask, model.profile.blur_px), model),
                None => self.first_band(&mut ellipse, mask)?,
            };
            let mut fit = fit_edge(&band, &ellipse, &before, self.settings.limb_points);
            let outline = self
                .known
                .fit(&fit.points, &ellipse)
                .ok_or_else(|| self.too_few(fit.points.len()))?;
            self.check(&outline, start, fit.model.resolution_px)?;
            let blur_px = fit.model.profile.blur_px;
            let moved_px = moved_px(&ellipse, &outline.ellipse);
            let settled = moved_px < settled_blurs * blur_px || pass == PASSES;
            if settled || model.is_none() {
                fit.model.noise = noise(&band, &fit.model);
            }
            if settled {
                return Ok(Limb::new(fit, outline, moved_px));
            }
            ellipse = outline.ellipse;
            model = self.steady(moved_px, fit.model);
        }
    }

    /// The band of a first pass, and the profile from medians all round; the ellipse grows to where the medians put the limb.
    fn first_band(
        &self,
        ellipse: &mut Ellipse,
        mask: &Mask,
    ) -> Result<(Band, EdgeModel), Rejected> {
        let start = Profile {
            background_dn: 0.0,
            even_dn: self.disc_dn * (1.0 - LIMB_DARKENING),
            darkened_dn: self.disc_dn * LIMB_DARKENING,
            blur_px: self.blur_px,
            radius_px: ellipse.mean_radius(),
        };
        let noise = self.cutout.noise;
        let mut band = self.band(ellipse, mask, start.blur_px);
        let saturated_dn = self.cutout.unsaturated_dn - 2.0 * noise.dark_dn2.sqrt();
        let medians = radial_medians(&band, start.blur_px, saturated_dn);
        let fitted = start.fitted(&medians, noise.dark_dn2.sqrt());
        let (profile, limb_px) = fitted.ok_or_else(|| self.too_few(0))?;
        *ellipse = ellipse
            .grown(limb_px.value)
            .ok_or_else(|| self.too_few(0))?;
        band.shift(limb_px.value);
        let model = EdgeModel {
            profile,
            place_sigma_px: limb_px.sigma.hypot(MODEL_SIGMA_PX),
            shape: Shape::NONE,
            covariance: nalgebra::SMatrix::zeros(),
            noise,
            resolution_px: profile.blur_px.max(self.blur_px),
            shift_sigma_px: FIRST_SHIFT_BLURS * profile.blur_px,
            saturated_dn,
        };
        Ok((band, model))
    }

    fn band(&self, ellipse: &Ellipse, mask: &Mask, blur_px: f64) -> Band {
        let reach = |(blurs, least): (f64, f64)| (blurs * blur_px).max(least);
        let reach = Reach {
            inside_px: reach(INSIDE),
            outside_px: reach(OUTSIDE),
        };
        Band::about(self.cutout, mask, ellipse, reach, self.settings.limb_points)
    }

    fn check(&self, fit: &OutlineFit, start: &Ellipse, resolution_px: f64) -> Result<(), Rejected> {
        let accepted = fit.accepted.iter().filter(|a| **a).count();
        if accepted < self.settings.min_limb_points {
            return Err(self.too_few(accepted));
        }
        let away = (fit.ellipse.centre - start.centre).norm();
        let limit = MOST_BLURS_AWAY * resolution_px;
        if away > limit {
            return Err(Rejected {
                reason: "limb fit diverged from the disc that was found",
                measured: away,
                limit,
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

/// Medians of the light by distance from the ellipse, from sectors all round; what saturates says nothing.
fn radial_medians(band: &Band, blur_px: f64, saturated_dn: f64) -> Vec<Brightness> {
    let width_px = blur_px / MEDIANS_PER_BLUR;
    let first_px = -band.reach.inside_px;
    let bins = ((band.reach.outside_px - first_px) / width_px).ceil() as usize;
    let mut values = vec![Vec::new(); bins];
    for pixels in band.sectors().step_by(MEDIAN_SECTORS) {
        for (distance_px, light_dn) in pixels.distance_px.iter().zip(pixels.light_dn) {
            let bin = (f64::from(*distance_px) - first_px) / width_px;
            values[(bin as usize).min(bins - 1)].push(f64::from(*light_dn));
        }
    }
    let enough = values.iter().enumerate();
    let enough = enough.filter(|(_, values)| values.len() >= MIN_MEDIAN_PIXELS);
    let medians = enough.filter_map(|(bin, values)| {
        Some(Brightness {
            distance_px: first_px + (bin as f64 + 0.5) * width_px,
            dn: median(values)?,
            weight: values.len() as f64 / MEDIAN_SIGMA.powi(2),
        })
    });
    medians.filter(|median| median.dn < saturated_dn).collect()
}

/// How far one outline lies from another, but for its size, which a pass takes in by itself.
fn moved_px(from: &Ellipse, to: &Ellipse) -> f64 {
    let grown = to.root() - from.root();
    let even = Matrix2::identity() * (grown.trace() / 2.0);
    (to.centre - from.centre).norm() + (grown - even).norm()
}
