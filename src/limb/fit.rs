//! The outline of the disc: first a rough fit from every fourth row, then a fit of the whole limb that alternates between
//! points and ellipse until neither moves.

use super::band::{Band, Reach, SectorPixels, Wanted};
use super::edge::{EdgeFit, LimbPoint, fit_edge};
use super::light::DiscLight;
use super::outline::{OutlineFit, OutlinePrior, fit_outline};
use super::profile::{Brightness, MODEL_SIGMA_PX, Profile};
use super::shape::{EdgeModel, Shape, noise};
use super::{LIMB_DARKENING, LimbSettings};
use crate::estimation::{MEDIAN_SIGMA, median_of_orders, order};
use crate::frame::{Cutout, Mask};
use crate::geometry::Ellipse;
use crate::kernels::{smaller, zeros};
use crate::reasons::sun;
use crate::units::{Rejected, SensorPx};
use nalgebra::{Matrix2, Vector2};

/// The limb measured on one frame.
#[derive(Debug, Clone, PartialEq)]
pub struct Limb {
    /// The points that lie on the outline, their sigmas inflated by their scatter.
    pub points: Vec<LimbPoint>,
    pub outline: OutlineFit,
    pub light: DiscLight,
}

impl Limb {
    fn new(fit: EdgeFit, outline: OutlineFit) -> Self {
        let mut points = fit.points;
        let mut accepted = outline.accepted.iter();
        points.retain(|_| accepted.next() == Some(&true));
        for point in &mut points {
            point.sigma_px *= outline.scatter;
        }
        let light = DiscLight {
            outline: outline.ellipse,
            edge: fit.model,
        };
        Self {
            points,
            outline,
            light,
        }
    }

    /// Means of a few neighbouring points each, and 1 sigma across the limb. The outline is so smooth that they determine
    /// it equally well (astrometry's normal points).
    pub fn normal_points(&self) -> Vec<(SensorPx, f64)> {
        let ellipse = &self.outline.ellipse;
        let mean = |points: &[LimbPoint]| {
            let (mut w, mut away_px, mut information) = (Vector2::zeros(), 0.0, 0.0);
            for point in points {
                let (on_disc, own) = (ellipse.to_disc(point.at.vector()), point.sigma_px.powi(-2));
                w += own * on_disc;
                away_px += own * ellipse.excess_at(on_disc);
                information += own;
            }
            let w = w.normalize();
            let at = ellipse.from_disc(w) + ellipse.normal(w) * (away_px / information);
            (SensorPx::from(at), information.powf(-0.5))
        };
        self.points.chunks(NEIGHBOURS).map(mean).collect()
    }
}

/// Number of points of the limb in an average.
const NEIGHBOURS: usize = 4;

/// Priors of the outline before the limb is measured, in two grades.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct KnownOutline {
    /// Possible for any camera.
    pub possible: OutlinePrior,
    /// Expected if the camera is as its calibration states.
    pub stated: OutlinePrior,
}

impl KnownOutline {
    /// The stated prior constrains the outline of a disc of which little is visible. If the limb contradicts it, the fit
    /// without it is used.
    fn fit(&self, points: &[LimbPoint], start: &Ellipse) -> Option<OutlineFit> {
        let free = fit_outline(points, start, &self.possible).ok()?;
        if free.contradicts(&self.stated) {
            return Some(free);
        }
        free.with(&self.stated)
    }
}

const PASSES: usize = 6;
const ROUGH_PASSES: usize = 3;
/// An outline that moved by less than this in a pass has converged, in blurs: the next pass would move it by 3 % of that.
const SETTLED_BLURS: f64 = 0.08;
/// A profile measured around an outline that was farther off is smeared, in blurs.
const STEADY_BLURS: f64 = 0.3;
/// Largest distance of the final outline from the first one, in blurs.
const MOST_BLURS_AWAY: f64 = 8.5;
/// Width of the band on either side of the outline, in blurs and at least in px: at its inner edge the brightness hardly
/// curves any more, at its outer edge pixels show the background.
const INSIDE: (f64, f64) = (5.0, 7.0);
const OUTSIDE: (f64, f64) = (6.0, 6.0);
/// Uncertainty of the limb's distance from the outline in the first pass and in later ones, 1 sigma, in blurs.
const FIRST_SHIFT_BLURS: f64 = 0.7;
const LATER_SHIFT_BLURS: f64 = 0.05;
/// A limb softer than expected by this factor is measured again in a wider band.
const WIDER_BLURS: f64 = 1.5;
/// Bins of the radial medians per blur; fewest pixels of a bin; and the spacing of the rows that are read.
const MEDIANS_PER_BLUR: f64 = 3.0;
const MIN_MEDIAN_PIXELS: usize = 10;
const MOST_BINS: usize = 256;
const ROUGH_ROWS_PX: usize = 4;
/// Fewest sectors: in wider ones the limb curves too much.
const LEAST_SECTORS: usize = 16;

/// Fits the disc's outline to the whole limb of a frame.
#[derive(Debug, Clone, Copy)]
pub struct LimbFit<'a> {
    pub cutout: &'a Cutout,
    /// Brightness of the disc's bright part, DN.
    pub disc_dn: f64,
    /// The expected blur, 1 sigma, pixel response included.
    pub blur_px: f64,
    pub known: KnownOutline,
    pub settings: &'a LimbSettings,
}

impl LimbFit<'_> {
    /// The disc's light and outline from every fourth row, around a first outline that is within 2 px or so. If that shows
    /// too little of the limb, the outline is the first one, scaled to the radius that radial medians show.
    pub fn rough(&self, start: &Ellipse) -> Result<DiscLight, Rejected> {
        let mut outline = *start;
        let mut profile = Profile {
            background_dn: 0.0,
            even_dn: self.disc_dn * (1.0 - LIMB_DARKENING),
            darkened_dn: self.disc_dn * LIMB_DARKENING,
            blur_px: self.blur_px,
            radius_px: start.mean_radius(),
        };
        let mut pass = 0;
        loop {
            pass += 1;
            let mask = &self.cutout.mask;
            let mut band = Band::of(&self.wanted(&outline, mask, profile.blur_px, ROUGH_ROWS_PX));
            let mut light = self.by_medians(&band, &outline, &profile)?;
            band.follow(&outline, &light.outline);
            let blur_px = light.edge.profile.blur_px;
            if pass == ROUGH_PASSES {
                return Ok(light);
            }
            if blur_px < WIDER_BLURS * profile.blur_px {
                let Ok((fit, found)) = self.pass(&band, &light) else {
                    return Ok(light);
                };
                let moved_px = moved_px(&light.outline, &found.ellipse);
                light.outline = found.ellipse;
                if moved_px < STEADY_BLURS * blur_px {
                    light.edge = fit.model;
                    light.edge.shift_sigma_px = LATER_SHIFT_BLURS * blur_px;
                    return Ok(light);
                }
            }
            // Again in a band of the width that the blur needs; the other expected values stay.
            (outline, profile.blur_px) = (light.outline, blur_px);
        }
    }

    /// The disc's light by radial medians of a band, and its outline: the band's, scaled to the radius that they show.
    fn by_medians(
        &self,
        band: &Band,
        outline: &Ellipse,
        profile: &Profile,
    ) -> Result<DiscLight, Rejected> {
        let blur_px = profile.blur_px;
        let noise_dn = self.cutout.noise.dark_dn2.sqrt();
        let saturated_dn = self.cutout.unsaturated_dn - 2.0 * noise_dn;
        let medians = radial_medians(band, &reach(blur_px), blur_px, saturated_dn);
        let fitted = profile.fitted(&medians, noise_dn);
        let (profile, limb_px) = fitted.ok_or_else(|| self.too_few(0))?;
        let outline = outline.grown(limb_px.value);
        Ok(DiscLight {
            outline: outline.ok_or_else(|| self.too_few(0))?,
            edge: EdgeModel {
                profile,
                place_sigma_px: limb_px.sigma.hypot(MODEL_SIGMA_PX),
                shape: Shape::NONE,
                covariance: nalgebra::SMatrix::zeros(),
                noise: self.cutout.noise,
                resolution_px: profile.blur_px.max(self.blur_px),
                shift_sigma_px: FIRST_SHIFT_BLURS * profile.blur_px,
                saturated_dn,
            },
        })
    }

    /// The limb of a disc that is roughly known, without masked pixels.
    pub fn near(&self, rough: &DiscLight, mask: &Mask) -> Result<Limb, Rejected> {
        let mut light = *rough;
        let blur_px = light.edge.profile.blur_px;
        let mut band = Band::of(&self.wanted(&light.outline, mask, blur_px, 1));
        light.edge.noise = noise(&band, &light.edge);
        let mut pass = 0;
        loop {
            pass += 1;
            let (fit, outline) = self.pass(&band, &light)?;
            let moved_px = moved_px(&light.outline, &outline.ellipse);
            let settled =
                moved_px < SETTLED_BLURS * blur_px && fit.model.shape.is_near(&light.edge.shape);
            if settled || pass == PASSES {
                self.check(&outline, &rough.outline, fit.model.resolution_px)?;
                return Ok(Limb::new(fit, outline));
            }
            band.follow(&light.outline, &outline.ellipse);
            light = DiscLight {
                outline: outline.ellipse,
                edge: fit.model,
            };
        }
    }

    /// Points of the limb in a band, and the outline through them.
    fn pass(&self, band: &Band, light: &DiscLight) -> Result<(EdgeFit, OutlineFit), Rejected> {
        let fit = fit_edge(band, &light.outline, &light.edge);
        let outline = self.known.fit(&fit.points, &light.outline);
        let outline = outline.ok_or_else(|| self.too_few(fit.points.len()))?;
        Ok((fit, outline))
    }

    fn wanted<'b>(
        &'b self,
        ellipse: &'b Ellipse,
        mask: &'b Mask,
        blur_px: f64,
        every_row: usize,
    ) -> Wanted<'b> {
        Wanted {
            cutout: self.cutout,
            mask,
            ellipse,
            reach: reach(blur_px),
            // The same number of pixels in each sector for any row stride.
            sectors: (self.settings.limb_points / every_row).max(LEAST_SECTORS),
            every_row,
        }
    }

    fn check(&self, fit: &OutlineFit, start: &Ellipse, resolution_px: f64) -> Result<(), Rejected> {
        let accepted = fit.accepted.iter().filter(|a| **a).count();
        if accepted < self.settings.min_limb_points {
            return Err(self.too_few(accepted));
        }
        let away = (fit.ellipse.centre - start.centre).norm();
        let reason = sun::LIMB_DIVERGED;
        Rejected::at_most(MOST_BLURS_AWAY * resolution_px, away, reason)
    }

    fn too_few(&self, points: usize) -> Rejected {
        Rejected {
            reason: sun::FEW_LIMB_POINTS,
            measured: points as f64,
            limit: self.settings.min_limb_points as f64,
        }
    }
}

/// Range of the band around a limb with this blur.
fn reach(blur_px: f64) -> Reach {
    let px = |(blurs, least): (f64, f64)| (blurs * blur_px).max(least);
    Reach {
        inside_px: px(INSIDE),
        outside_px: px(OUTSIDE),
    }
}

/// Medians of the brightness by distance from the ellipse, over all azimuths; saturated medians are dropped.
fn radial_medians(band: &Band, reach: &Reach, blur_px: f64, saturated_dn: f64) -> Vec<Brightness> {
    let width_px = blur_px / MEDIANS_PER_BLUR;
    let first_px = -reach.inside_px;
    let bins = (((reach.outside_px - first_px) / width_px).ceil() as usize).min(MOST_BINS);
    let (per_width, first) = ((1.0 / width_px) as f32, first_px as f32);
    let last = bins as f32 - 1.0;
    let bin = |distance_px: &f32| smaller((distance_px - first) * per_width, last) as u8;
    // Sorts the values by bin.
    let SectorPixels {
        distance_px,
        light_dn,
    } = band.pixels();
    let mut ends = [0; MOST_BINS];
    let bin_of: Vec<u8> = distance_px.iter().map(bin).collect();
    bin_of.iter().for_each(|bin| ends[usize::from(*bin)] += 1);
    let mut begin = 0;
    for end in &mut ends {
        begin += std::mem::replace(end, begin);
    }
    let mut values = zeros(light_dn.len());
    for (bin, light_dn) in bin_of.iter().zip(light_dn) {
        let end = &mut ends[usize::from(*bin)];
        values[*end] = order(*light_dn);
        *end += 1;
    }
    let mut left = values.as_mut_slice();
    let mut begin = 0;
    let medians = ends[..bins].iter().enumerate().filter_map(|(bin, end)| {
        let values = left.split_off_mut(..end - std::mem::replace(&mut begin, *end))?;
        let enough = values.len() >= MIN_MEDIAN_PIXELS;
        Some(Brightness {
            distance_px: first_px + (bin as f64 + 0.5) * width_px,
            weight: values.len() as f64 / MEDIAN_SIGMA.powi(2),
            dn: median_of_orders(values).filter(|_| enough)?.into(),
        })
    });
    medians.filter(|median| median.dn < saturated_dn).collect()
}

/// Distance of one outline from another, apart from its size, which a pass fits by itself.
fn moved_px(from: &Ellipse, to: &Ellipse) -> f64 {
    let grown = to.root() - from.root();
    let even = Matrix2::identity() * (grown.trace() / 2.0);
    (to.centre - from.centre).norm() + (grown - even).norm()
}
