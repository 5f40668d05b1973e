//! Points of the limb: the profile is fitted to the edge pixels of every sector of azimuth.
//!
//! # Method
//! The brightness in a sector is modelled to first order about the profile P of the whole limb as
//!
//! > (1 + l) P(d - s) + b + q/2 P'' - c W'
//!
//! with d the distance from the ellipse: s is the limb's shift, l an excess of the illumination, b a background that the
//! frame's own model did not remove, and q an excess of the blur's variance. Coma displaces a fraction of the light and
//! blurs it more; c is that fraction times its displacement, and W the profile behind [`COMA_BLURS`] times the blur. The
//! shift is free in every sector. The other quantities vary smoothly round the disc ([`Shape`]): they come from vignetting,
//! stray light and ghosts, the Sun's motion during the exposure, and coma. All sectors together determine them. An effect
//! that is not significant is held at zero, because each free effect increases the uncertainty of the limb. Illumination
//! and background of a single sector may then depart from the smooth course by as much as the scatter of all sectors
//! indicates (DerSimonian and Laird 1986).
//!
//! Residuals are weighted by Tukey's biweight, against hot pixels and scratches.

use super::band::{Band, SectorPixels, middle_of_sector};
use super::shape::{
    BACKGROUND, COMA, COMA_BLURS, COMA_SHIFT, EdgeModel, ILLUMINATION, MOTION, QUANTITY, SHIFT,
    SMOOTH, Shape, UNEVEN_BACKGROUND, course, smooth_terms,
};
use crate::estimation::{Normal, Prior, TUKEY_SIGMAS, median_among};
use crate::geometry::Ellipse;
use crate::kernels::sums::{COLUMNS, SECTOR, Sums, Weighing, sector_sums};
use crate::units::SensorPx;
use nalgebra::{RowSVector, SMatrix, SVector, Vector2};
use serde::{Deserialize, Serialize};

/// A point of the limb.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct LimbPoint {
    pub at: SensorPx,
    /// 1 sigma across the limb.
    pub sigma_px: f64,
}

/// Number of a sector's own quantities, beside the smooth course: shift, illumination, background.
const OWN: usize = 3;

/// 1 sigma of each coefficient of the smooth courses before the fit: illumination, background as fractions of the plateau,
/// px^2, px. They constrain coefficients that a short arc does not determine.
const PRIOR: [f64; SMOOTH] = [
    0.1, 0.1, 0.1, 0.05, 0.05, 0.05, 0.03, 0.03, 1.0, 1.0, 1.0, 0.3, 0.3,
];
/// Effects are fitted if their chi^2 per degree of freedom exceeds this.
const SIGNIFICANT_CHI2: f64 = 6.0;
/// Smallest departure of a sector's illumination from the smooth course, 1 sigma: ink and texture.
const UNEVEN_ILLUMINATION: f64 = 0.02;
/// A blemish in one sector says nothing about the others: its departure is limited to this many sigma.
const MOST_DEPARTURE_SIGMAS: f64 = 4.0;

/// Variance of a position fitted with Tukey's weights w of normal residuals r, relative to the inverse of their weighted
/// information: E[(r w)^2] E[w] / E[d(r w)/dr]^2.
const TUKEY_VARIANCE: f64 = 0.963;
/// Upper limit of the factor by which a step is lengthened.
const LONGEST_STEP: f64 = 1.5;
/// Accepted brightness of a sector relative to the median: vignetting and a first outline that is off by 2 px stay within
/// it.
const USUAL_LIGHT: std::ops::Range<f64> = 0.75..1.33;
/// A sector whose misfit exceeds that of the others by so many sigma is rejected: it shows not only the limb.
const MOST_MISFIT_SIGMAS: f64 = 4.0;
/// Beyond this shift of a sector, in blurs, its model is not linear.
const MOST_LINEAR_BLURS: f64 = 0.3;
/// The shift is not determined if less than this fraction of its information is independent of the illumination.
const LEAST_OWN_PART: f64 = 1e-3;
/// A point with a larger sigma, or farther from the ellipse, is rejected; in blurs.
const MOST_SIGMA_BLURS: f64 = 0.75;
const MOST_SHIFT_BLURS: f64 = 3.2;

/// Points of the limb near an ellipse, and the model with which they were measured.
pub(super) struct EdgeFit {
    pub points: Vec<LimbPoint>,
    pub model: EdgeModel,
}

/// Fits every sector of a band around an ellipse.
pub(super) fn fit_edge(band: &Band, ellipse: &Ellipse, model: &EdgeModel) -> EdgeFit {
    let mut sectors = lit_sectors(band, model);
    retain_limb(&mut sectors, model);
    lengthen_steps(&mut sectors);
    let mut departure = Departure {
        illumination: UNEVEN_ILLUMINATION,
        background_dn: 0.0,
    };
    let mut courses = Courses::fitted(&sectors, &departure, model);
    let shown = departure.shown_by(&sectors, &courses.step);
    if shown != departure {
        departure = shown;
        courses = Courses::fitted(&sectors, &departure, model);
    }
    let point = |sector: &Sector| {
        let (shift_px, sigma_px) = sector.shift(&courses, &departure, model)?;
        let at = ellipse.from_disc(sector.w) + ellipse.normal(sector.w) * shift_px;
        Some(LimbPoint {
            at: at.into(),
            sigma_px,
        })
    };
    let mut points = Vec::with_capacity(sectors.len());
    points.extend(sectors.iter().filter_map(point));
    let shape = Shape {
        coefficients: model.shape.coefficients + courses.step,
    };
    let model = EdgeModel {
        shape,
        covariance: courses.covariance,
        ..*model
    };
    EdgeFit { points, model }
}

/// The sectors that have pixels.
fn lit_sectors(band: &Band, model: &EdgeModel) -> Vec<Sector> {
    let count = band.sectors().count();
    let lit = band.sectors().enumerate();
    let lit = lit.filter(|(_, pixels)| !pixels.light_dn.is_empty());
    let mut sectors = Vec::with_capacity(count);
    sectors.extend(lit.map(|(n, pixels)| {
        let w = middle_of_sector(n, count);
        Sector::new(w, &sums_of(w, pixels, model), pixels.light_dn.len())
    }));
    sectors
}

/// Lengthens the steps to those of Newton's method (see [`sums`](crate::kernels::sums)).
fn lengthen_steps(sectors: &mut [Sector]) {
    let information: f64 = sectors.iter().map(|s| s.information.m11).sum();
    let newton: f64 = sectors.iter().map(|s| s.newton).sum();
    // If many pixels are outliers, the weights are a poor guide to the step length.
    let longer = match newton > 0.0 {
        true => (information / newton).min(LONGEST_STEP),
        false => 1.0,
    };
    for sector in sectors {
        sector.gradient *= longer;
    }
}

/// Rejects the sectors that show no limb, or not only the limb. Something that covers the limb, wholly or in part, leaves
/// less light than most of the limb has; the edge of a shadow across it leaves light that no smooth illumination explains.
fn retain_limb(sectors: &mut Vec<Sector>, model: &EdgeModel) {
    let lights = &mut sectors.iter().map(|s| s.light).collect::<Vec<_>>();
    let most = median_among(lights).unwrap_or_default();
    sectors.retain(|s| USUAL_LIGHT.contains(&(s.light / most)));
    let misfits: Vec<Option<f64>> = sectors.iter().map(|s| s.misfit(model)).collect();
    let mut all: Vec<f64> = misfits.iter().flatten().copied().collect();
    let Some(usual) = median_among(&mut all) else {
        return;
    };
    let mut misfits = misfits.into_iter();
    sectors.retain(|s| {
        let chance = (2.0 / s.pixels).sqrt();
        let most = usual * (1.0 + MOST_MISFIT_SIGMAS * chance);
        misfits.next().flatten().is_none_or(|misfit| misfit < most)
    });
}

/// The sums over the pixels of a sector in a direction.
fn sums_of(w: Vector2<f64>, pixels: SectorPixels<'_>, model: &EdgeModel) -> Sums {
    let course = model.shape.at(w);
    let profile = model.profile_at(&course);
    let weighing = Weighing {
        light: profile.light(),
        wide: profile.with_blur(COMA_BLURS * profile.blur_px).light(),
        background_dn: (profile.background_dn + course[BACKGROUND]) as f32,
        illumination: course[ILLUMINATION] as f32,
        coma_px: course[COMA_SHIFT] as f32,
        dark_dn2: model.noise.dark_dn2 as f32,
        per_light_dn: model.noise.per_light_dn as f32,
        illumination_sigma: UNEVEN_ILLUMINATION as f32,
        shift_sigma_px: model.shift_sigma_px as f32,
        saturated_dn: model.saturated_dn as f32,
        tukey2: (TUKEY_SIGMAS * TUKEY_SIGMAS) as f32,
    };
    sector_sums(&weighing, pixels.distance_px, pixels.light_dn)
}

/// The normal equations of a sector in steps from the model.
struct Sector {
    w: Vector2<f64>,
    terms: SVector<f64, SMOOTH>,
    information: SMatrix<f64, SECTOR, SECTOR>,
    gradient: SVector<f64, SECTOR>,
    /// Sum of the squared residuals; outliers have little weight.
    chi2: f64,
    pixels: f64,
    /// Information on the shift for Newton's step.
    newton: f64,
    /// Observed light relative to the profile's.
    light: f64,
}

impl Sector {
    fn new(w: Vector2<f64>, sums: &Sums, pixels: usize) -> Self {
        let Sums { products, .. } = sums;
        Self {
            w,
            terms: smooth_terms(w),
            information: SMatrix::from_fn(|m, n| products[m][n]),
            gradient: SVector::from_fn(|m, _| products[m][COLUMNS - 1]),
            chi2: products[COLUMNS - 1][COLUMNS - 1],
            pixels: pixels as f64,
            newton: sums.newton,
            light: sums.light,
        }
    }

    /// Decrease of a sector's squared residuals by a shift, an illumination, a background and a blur of its own, relative
    /// to the weight of its pixels. `None` if they are not determined, or if the shift is too large for the linear model.
    fn misfit(&self, model: &EdgeModel) -> Option<f64> {
        const FREE: usize = 4;
        let information = self.information.fixed_view::<FREE, FREE>(0, 0);
        let gradient = self.gradient.fixed_rows::<FREE>(0);
        let step = information.clone_owned().cholesky()?.solve(&gradient);
        let near = step[SHIFT].abs() < MOST_LINEAR_BLURS * model.resolution_px;
        near.then(|| (self.chi2 - step.dot(&gradient)) / self.information[(BACKGROUND, BACKGROUND)])
    }

    /// Information and gradient after marginalising over the sector's own departures.
    fn reduced(
        &self,
        departure: &Departure,
    ) -> Option<(SMatrix<f64, SECTOR, SECTOR>, SVector<f64, SECTOR>)> {
        let own = self.own_information(departure).try_inverse()?;
        let coupling = self.information.fixed_columns::<OWN>(0);
        let taken = coupling * own;
        Some((
            self.information - taken * coupling.transpose(),
            self.gradient - taken * self.gradient.fixed_rows::<OWN>(0),
        ))
    }

    fn own_information(&self, departure: &Departure) -> SMatrix<f64, OWN, OWN> {
        let mut own = self.information.fixed_view::<OWN, OWN>(0, 0).into_owned();
        own[(ILLUMINATION, ILLUMINATION)] += departure.illumination.powi(-2);
        own[(BACKGROUND, BACKGROUND)] += departure.background_dn.max(1e-6).powi(-2);
        own
    }

    /// The limb's shift and its sigma, px; `None` if the pixels do not determine it.
    fn shift(
        &self,
        courses: &Courses,
        departure: &Departure,
        model: &EdgeModel,
    ) -> Option<(f64, f64)> {
        let own = self.own_information(departure);
        let pair = own.fixed_view::<2, 2>(0, 0).into_owned();
        if pair.determinant() < LEAST_OWN_PART * pair.m11 * pair.m22 {
            return None;
        }
        let inverse = own.try_inverse()?;
        let gradient = self.left(&courses.step);
        let shift_px = (inverse * gradient.fixed_rows::<OWN>(0))[SHIFT];
        let by_quantity = inverse.row(SHIFT) * self.information.fixed_rows::<OWN>(0);
        let by_courses =
            RowSVector::<f64, SMOOTH>::from_fn(|_, n| by_quantity[QUANTITY[n]] * self.terms[n]);
        // The uncertainty of the courses moves whole arcs of the limb: the average over many points must not reduce it.
        let common = (by_courses * courses.covariance * by_courses.transpose())[0];
        let variance = TUKEY_VARIANCE * inverse.m11 + 0.5 * courses.sectors as f64 * common;
        let sigma_px = variance.max(0.0).sqrt();
        let determined = sigma_px < MOST_SIGMA_BLURS * model.resolution_px
            && shift_px.abs() < MOST_SHIFT_BLURS * model.resolution_px;
        determined.then_some((shift_px, sigma_px))
    }
}

/// Departures of single sectors from the smooth courses, 1 sigma.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Departure {
    illumination: f64,
    background_dn: f64,
}

impl Departure {
    /// Estimated from the sectors: the variance between them by DerSimonian and Laird's moments, never less than `self`.
    fn shown_by(&self, sectors: &[Sector], step: &SVector<f64, SMOOTH>) -> Self {
        let left: Vec<_> = sectors.iter().map(|s| s.left(step)).collect();
        let between = |index: usize| {
            let each = sectors.iter().zip(&left);
            let departures = each.filter_map(|(s, left)| s.departure(index, left));
            let (mut excess, mut count, mut weights) = (0.0, 0.0, 0.0);
            for (value, variance) in departures {
                let squared = (value * value / variance).min(MOST_DEPARTURE_SIGMAS.powi(2));
                (excess, count, weights) =
                    (excess + squared, count + 1.0, weights + 1.0 / variance);
            }
            let significant = excess > count + 3.0 * f64::sqrt(2.0 * count);
            if significant {
                ((excess - count) / weights).sqrt()
            } else {
                0.0
            }
        };
        Self {
            illumination: between(ILLUMINATION).max(self.illumination),
            background_dn: between(BACKGROUND).max(self.background_dn),
        }
    }
}

impl Sector {
    /// Gradient that remains after a step of the smooth courses.
    fn left(&self, step: &SVector<f64, SMOOTH>) -> SVector<f64, SECTOR> {
        self.gradient - self.information * course(&self.terms, step)
    }

    /// Departure of one quantity from its course by the remaining gradient, and its variance; the shift is free.
    fn departure(&self, index: usize, gradient: &SVector<f64, SECTOR>) -> Option<(f64, f64)> {
        let (ss, si, ii) = (
            self.information.m11,
            self.information[(SHIFT, index)],
            self.information[(index, index)],
        );
        let own = ii - si * si / ss;
        let determined = ss > 0.0 && own > LEAST_OWN_PART * ii;
        determined.then(|| {
            (
                (gradient[index] - gradient[SHIFT] * si / ss) / own,
                1.0 / own,
            )
        })
    }
}

/// The smooth courses: their steps from the model, with the covariance of the steps.
struct Courses {
    step: SVector<f64, SMOOTH>,
    covariance: SMatrix<f64, SMOOTH, SMOOTH>,
    sectors: usize,
}

impl Courses {
    fn fitted(sectors: &[Sector], departure: &Departure, model: &EdgeModel) -> Self {
        let mut normal = Normal::<SMOOTH>::zero();
        for sector in sectors {
            let Some((own, gradient)) = sector.reduced(departure) else {
                continue;
            };
            let terms = &sector.terms;
            // Coupling of each quantity with the coefficients.
            let with: [SVector<f64, SMOOTH>; SECTOR] = std::array::from_fn(|quantity| {
                SVector::from_fn(|m, _| terms[m] * own[(QUANTITY[m], quantity)])
            });
            for n in 0..SMOOTH {
                normal.gradient[n] += terms[n] * gradient[QUANTITY[n]];
                let mut column = normal.information.column_mut(n);
                column.axpy(terms[n], &with[QUANTITY[n]], 1.0);
            }
        }
        let now = &model.shape.coefficients;
        let plateau = model.plateau_dn().max(1.0);
        let mut prior = Prior {
            mean: SVector::zeros(),
            information: SVector::from_fn(|n, _| match n {
                3..8 => (PRIOR[n] * plateau).powi(-2),
                _ => PRIOR[n].powi(-2),
            }),
        };
        let shown = normal.solve(&prior, now).map_or([false; 3], |all| {
            let (values, covariance) = (now + all.step, all.covariance());
            [
                is_significant::<4>(&UNEVEN_BACKGROUND, &values, &covariance),
                is_significant::<2>(&MOTION, &values, &covariance),
                is_significant::<2>(&COMA, &values, &covariance),
            ]
        });
        for (effect, shown) in [UNEVEN_BACKGROUND, MOTION, COMA].into_iter().zip(shown) {
            if !shown {
                effect.for_each(|n| prior.information[n] = f64::INFINITY);
            }
        }
        let solved = normal.solve(&prior, now);
        let (step, covariance) = solved.map_or_else(
            || (SVector::zeros(), SMatrix::zeros()),
            |solved| (solved.step, solved.covariance()),
        );
        Self {
            step,
            covariance,
            sectors: sectors.len(),
        }
    }
}

/// Whether the `N` coefficients of an effect are far from zero by their covariance.
fn is_significant<const N: usize>(
    effect: &std::ops::Range<usize>,
    coefficients: &SVector<f64, SMOOTH>,
    covariance: &SMatrix<f64, SMOOTH, SMOOTH>,
) -> bool {
    let own = covariance.fixed_view::<N, N>(effect.start, effect.start);
    let value = coefficients.fixed_rows::<N>(effect.start);
    let solved = own.clone_owned().cholesky().map(|root| root.solve(&value));
    solved.is_some_and(|solved| value.dot(&solved) > SIGNIFICANT_CHI2 * N as f64)
}
