//! The sub-pixel position of the lit limb: the circle whose shaded, blurred brightness fits the pixels along the limb best.
//!
//! The brightness of the ground at a place is unknown, and so is that of the sky in front of it: each sector of a few
//! pixels of the limb has a brightness and a sky level of its own. The fit uses only the shape of the brightness profile
//! across the limb.

use super::candidate::View;
use super::known::{Contradiction, Known};
use super::profile::Profile;
use super::sector::{
    Gradient, Lights, PARAMETERS, PIXELS, Parameters, Pixel, SLACK_PX, SLACK_RAD, Sector,
    SectorLight, Sectors, circle_of, from_middle,
};
use super::shading::{Shading, Sphere};
use crate::estimation::{
    FitError, Fitted, LeastSquares, Loss, Prior, SIGMA_PER_MEDIAN, Scale, median,
};
use crate::geometry::Circle;
use crate::units::Measured;
use nalgebra::{SMatrix, Vector2};
use std::f64::consts::{PI, TAU};

/// Minimum brightness of a sector's brightest pixel above the sky, in sigmas of a pixel's noise.
const SEEN_SIGMAS: f64 = 4.0;
/// The limb is lit where the sphere has this share of the brightness in the middle of the bright limb, at this depth behind
/// the limb. Beyond that, the terminator is visible, whose position depends on mountains.
const LIT_SHARE: f64 = 0.2;
const LIT_DEPTH_PX: f64 = 1.5;
const LIT_DEPTH: f64 = 0.1;
/// A sector is an outlier if it is off the circle by so many sigmas, or by so many times the typical scatter.
const OFF_SIGMAS: f64 = 5.0;
/// Correlation length of the ground's residual along the limb, px.
const ALIKE_PX: f64 = 12.0;
/// Typical distance of an outline's circle from the disc's, towards the light, px: it runs outside the bright limb, and
/// inside the dim horns.
const OUTLINE_PX: f64 = 0.5;
/// Prior of the blur by the optics, without that by the pixels, px.
pub(super) const BLUR_PX: Measured = Measured::new(0.8, 0.4);
const POSSIBLE_BLUR_PX: std::ops::Range<f64> = 0.05..3.0;

/// The pixels along a lit limb.
pub(super) struct Limb {
    known: Known,
    start: Parameters,
    lights: Lights,
    sectors: Vec<Sector>,
    noise_dn: f64,
    /// Share of its pixels on the disc that are saturated or masked.
    pub saturated: f64,
}

/// A fitted circle with its limb points.
pub(super) struct LimbFit {
    pub fitted: Fitted<PARAMETERS>,
    pub points: Vec<LimbPoint>,
    pub radius_contradiction: Option<Contradiction>,
}

impl LimbFit {
    pub fn centre(&self) -> Vector2<f64> {
        self.fitted.parameters.fixed_rows::<2>(0).into_owned()
    }
}

/// The limb measured on one sector.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct LimbPoint {
    /// Angle from +x towards +y, in round px.
    pub angle_rad: f64,
    /// Distance of the limb outwards from the circle.
    pub excess_px: Measured,
}

impl Limb {
    /// Reads the pixels along the lit limb of a disc.
    pub fn read(view: &View, start: Parameters, known: Known) -> Self {
        let (circle, levels) = (circle_of(&start), view.levels);
        let lit_rad = lit_rad(view.shading, &start);
        let lights = Lights::new(view.shading, &start, &known);
        let sectors = Sectors::of_radius(circle.radius);
        let (count, width_rad) = (sectors.count, sectors.width_rad);
        let from_middle = |n: usize| from_middle(sectors.angle_rad(n), start[5]);
        // Only the lit sectors and one more on each side are needed.
        let profile = |n: usize| {
            let is_needed = from_middle(n).abs() <= lit_rad + 1.01 * width_rad;
            is_needed.then(|| lights.profile(&lights.here, from_middle(n)))
        };
        let profiles: Vec<Option<Profile>> = (0..count).map(profile).collect();
        let sector = |n: usize| {
            let here = profiles[n].as_ref()?;
            let next = profiles[(n + 1) % count].as_ref()?;
            (from_middle(n).abs() <= lit_rad).then(|| Sector {
                angle_rad: sectors.angle_rad(n),
                light: SectorLight {
                    here: here.clone(),
                    by_angle: next.change_from(here, width_rad),
                    by_phase: lights.by_phase(here, from_middle(n)),
                },
                pixels: Vec::new(),
            })
        };
        let mut lit: Vec<Option<Sector>> = (0..count).map(sector).collect();
        let (mut on_disc, mut saturated) = (0_u32, 0_u32);
        (view.plane).each_near(view.frame, &circle, &PIXELS, 1, |at, dn| {
            let away = at - circle.centre;
            let (n, around_rad) = sectors.at(&away);
            let Some(sector) = &mut lit[n] else {
                return;
            };
            let distance = away.norm();
            on_disc += u32::from(distance < circle.radius);
            if f64::from(dn) >= levels.saturated_dn {
                saturated += 1;
                return;
            }
            let depth = circle.radius - distance - lights.shrinks(distance);
            let beside_rad = around_rad - sector.angle_rad;
            let (beside, by_others) = (sector.light).others(beside_rad, depth, start[3], distance);
            sector.pixels.push(Pixel {
                at,
                beside,
                by_others,
                light_dn: f64::from(dn) - levels.dark_dn,
            });
        });
        let mut sectors: Vec<Sector> = lit.into_iter().flatten().collect();
        sectors.retain(|sector| sector.is_seen(SEEN_SIGMAS * levels.noise_dn));
        Self {
            known,
            start,
            lights,
            sectors,
            noise_dn: levels.noise_dn,
            saturated: f64::from(saturated) / f64::from(on_disc.max(1_u32)),
        }
    }

    /// Number of sectors in which the limb is visible.
    pub fn seen(&self) -> usize {
        self.sectors.len()
    }

    /// The least-squares circle, with the blur, the phase and the side of the light. Sectors far off the circle are
    /// rejected: they show a star, or a part of the vehicle.
    ///
    /// # Errors
    /// If the limb does not determine it.
    pub fn fit(&self) -> Result<LimbFit, FitError> {
        let all: Vec<&Sector> = self.sectors.iter().collect();
        let first = self.fit_through(&all)?;
        let off = |point: &LimbPoint| point.excess_px.value / point.excess_px.sigma;
        let sizes = first.points.iter().map(|point| off(point).abs());
        let most = OFF_SIGMAS * (SIGMA_PER_MEDIAN * median(sizes).unwrap_or(0.0)).max(1.0);
        let kept = all.iter().zip(&first.points);
        let kept: Vec<&Sector> = kept
            .filter(|(_, point)| off(point).abs() < most)
            .map(|(sector, _)| *sector)
            .collect();
        match kept.len() == all.len() {
            true => Ok(first),
            false => self.fit_through(&kept),
        }
    }

    fn fit_through(&self, sectors: &[&Sector]) -> Result<LimbFit, FitError> {
        let rows_at = |at: &Parameters| {
            let pixels = sectors.iter().map(|sector| sector.pixels.len());
            let mut rows = Vec::with_capacity(pixels.sum());
            for sector in sectors {
                sector.add_rows(at, &self.lights, self.noise_dn, &mut rows);
            }
            rows
        };
        let fit = LeastSquares {
            start: self.start,
            prior: self.prior(),
            loss: Loss::Squares,
            scale: Scale::Inflated,
            tolerance_sigmas: 0.3,
        };
        let mut fitted = fit.fit(|at: &Parameters| {
            let moved = at - self.start;
            let is_possible = moved.fixed_rows::<3>(0).amax() < SLACK_PX
                && moved.fixed_rows::<2>(4).amax() < SLACK_RAD
                && POSSIBLE_BLUR_PX.contains(&at[3]);
            is_possible.then(|| rows_at(at))
        })?;
        let rows = rows_at(&fitted.parameters);
        let mut rest = &rows[..];
        let gradient = |sector: &&Sector| {
            let (of_sector, others) = rest.split_at(sector.pixels.len());
            rest = others;
            Gradient::of(of_sector)
        };
        let gradients: Vec<Gradient> = sectors.iter().map(gradient).collect();
        let points = sectors
            .iter()
            .zip(&gradients)
            .map(|(sector, gradient)| LimbPoint {
                angle_rad: sector.angle_rad,
                excess_px: gradient.excess(fitted.scatter),
            });
        let points: Vec<LimbPoint> = points.collect();
        let radius_contradiction = self.radius_contradiction(&fitted);
        // A sector without light does not determine the ground's brightness.
        let lit = points.iter().copied().zip(gradients);
        let (lit, gradients): (Vec<LimbPoint>, Vec<Gradient>) = lit
            .filter(|(point, _)| point.excess_px.sigma < SLACK_PX)
            .unzip();
        fitted.covariance += of_rough_limb(&lit, &gradients, &fitted);
        Ok(LimbFit {
            fitted,
            points,
            radius_contradiction,
        })
    }

    /// Contradiction of the prior radius: if prior and result agree, the variance of their difference is the decrease of
    /// the variance.
    fn radius_contradiction(&self, fitted: &Fitted<PARAMETERS>) -> Option<Contradiction> {
        let known = self.known.radius?;
        let off = (fitted.parameters[2] - known.value).abs();
        let shrinks = known.sigma.powi(2) - fitted.covariance[(2, 2)];
        (shrinks > 0.0).then(|| Contradiction {
            off_px: off * known.sigma.powi(2) / shrinks,
            sigmas: off / shrinks.sqrt(),
        })
    }

    fn prior(&self) -> Prior<PARAMETERS> {
        let Known {
            radius,
            phase_rad,
            bright_limb_rad,
        } = self.known;
        let mut prior = Prior::none();
        let known = [
            radius,
            Some(BLUR_PX),
            Some(phase_rad),
            Some(bright_limb_rad),
        ];
        for (n, known) in (2..).zip(known) {
            if let Some(known) = known {
                prior.mean[n] = known.value;
                prior.information[n] = known.sigma.powi(-2);
            }
        }
        prior
    }
}

/// The contribution of the ground to the covariance. Mountains, and ground with a brightness gradient across the limb,
/// shift the limb of neighbouring sectors together: a first-order process along the limb. Its variance is that of the
/// excess beyond the noise; the circle's fit absorbs a part of such a process.
fn of_rough_limb(
    points: &[LimbPoint],
    gradients: &[Gradient],
    fitted: &Fitted<PARAMETERS>,
) -> SMatrix<f64, PARAMETERS, PARAMETERS> {
    // Derivatives of the parameters by each sector's limb, and of the limb by the parameters.
    let inverse = fitted.covariance / fitted.scatter.powi(2);
    let moves: Vec<Parameters> = gradients
        .iter()
        .map(|gradient| inverse * gradient.by_excess)
        .collect();
    let follows = |n: usize| gradients[n].by_excess / gradients[n].information;
    let radius = fitted.parameters[2];
    let mut covariance = SMatrix::zeros();
    let (mut shown, mut noise, mut expected) = (0.0, 0.0, 0.0);
    for (n, point) in points.iter().enumerate() {
        let together: Parameters = (points.iter().zip(&moves))
            .map(|(other, moves)| moves * alike(point.angle_rad - other.angle_rad, radius))
            .sum();
        covariance += moves[n] * together.transpose();
        let kept = 1.0 - follows(n).dot(&moves[n]);
        shown += point.excess_px.value.powi(2);
        noise += point.excess_px.sigma.powi(2) * kept;
        expected += 1.0 - 2.0 * follows(n).dot(&together);
    }
    for n in 0..points.len() {
        expected += follows(n).dot(&(covariance * follows(n)));
    }
    covariance * ((shown - noise) / expected.max(1.0)).max(0.0)
}

/// Correlation of the ground at two places of the limb.
fn alike(apart_rad: f64, radius: f64) -> f64 {
    let apart = (apart_rad + PI).rem_euclid(TAU) - PI;
    (-apart.abs() * radius / ALIKE_PX).exp()
}

/// Half angle of the lit part of the limb about the middle of the bright limb, rad.
pub(super) fn lit_rad(shading: Shading, at: &Parameters) -> f64 {
    const STEPS: u32 = 180;
    let sphere = Sphere::new(shading, at[4]);
    // At most half the width of a thin crescent.
    let depth = LIT_DEPTH.min(LIT_DEPTH_PX / at[2]).min(sphere.lit());
    let light = |angle: f64| sphere.light(1.0 - depth, angle);
    let least = LIT_SHARE * light(0.0);
    let angles = (0..=STEPS).map(|n| f64::from(n) / f64::from(STEPS) * PI);
    let lit = angles.take_while(|angle| light(*angle) > least);
    lit.last().unwrap_or(0.0)
}

/// Start of a search: a circle with the prior radius and direction of the bright limb, if they are known.
pub(super) fn begin(circle: &Circle, known: &Known) -> Parameters {
    let radius = known.radius.map_or(circle.radius, |radius| radius.value);
    let (sin, cos) = known.bright_limb_rad.value.sin_cos();
    let centre = circle.centre + Vector2::new(cos, sin) * (circle.radius - OUTLINE_PX - radius);
    Parameters::from([
        centre.x,
        centre.y,
        radius,
        BLUR_PX.value,
        known.phase_rad.value,
        known.bright_limb_rad.value,
    ])
}
