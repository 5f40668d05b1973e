//! Weighted least squares of a view of the plate and a circle on it: Gauss-Newton steps on the pairs and the points of the outline.

use super::{Outline, Pair};
use crate::estimation::{Normal, Prior};
use crate::geometry::view::{PARAMETERS, Parameters, UNIT_MIL, View, parameters_of};
use crate::geometry::{Circle, Distortion, Handedness, MappingKind, TILT_PER_PX};
use crate::units::{Measured, PlateMil, SensorPx};
use nalgebra::{Matrix2, SMatrix, SVector, Vector2};

/// The parameters of the view, then centre x, y and radius of the circle (mil).
pub(super) const UNKNOWNS: usize = PARAMETERS + 3;
/// Index of the circle's centre x among the unknowns.
pub(super) const CIRCLE: usize = PARAMETERS;
/// Indices of the tilt among the unknowns.
const TILT: [usize; 2] = [6, 7];
pub(super) type Unknowns = SVector<f64, UNKNOWNS>;
pub(super) type Covariance = SMatrix<f64, UNKNOWNS, UNKNOWNS>;

const MOST_STEPS: usize = 12;
/// After a step as short as this, the residuals are linear to a hundred-thousandth of a pixel.
const SHORT_STEP_PX: f64 = 0.03;
/// The problem: pairs and outline on the ideal sensor, free of lens distortion.
#[derive(Clone)]
pub(super) struct Problem {
    pairs: Vec<IdealPair>,
    outline: Option<IdealOutline>,
    handedness: Handedness,
}

#[derive(Clone)]
struct IdealPair {
    observed: Vector2<f64>,
    printed: PlateMil,
    /// Inverse Cholesky factor of the covariance: transforms a residual (px) to two uncorrelated numbers of sigma 1.
    whitening: Matrix2<f64>,
}

#[derive(Clone)]
struct IdealOutline {
    /// Centre of the ellipse, px: near the image of the circle's centre.
    centre: Vector2<f64>,
    /// Points, and 1 sigma across the outline, px.
    points: Vec<(Vector2<f64>, f64)>,
    /// Prior of the circle's radius.
    radius_mil: Measured,
}

/// The unknowns: the camera's view of the plate, and the circle whose image is the outline.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Model {
    pub view: View,
    pub circle: Option<Circle>,
}

/// The free unknowns, and the inflation of the sigmas.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Terms {
    pub kind: MappingKind,
    /// Factor of the pairs' stated sigmas.
    pub inflation: f64,
}

/// A fit with its statistics.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Adjusted {
    pub terms: Terms,
    pub model: Model,
    /// Zero for fixed unknowns.
    pub covariance: Covariance,
    /// Chi^2 of the pairs with their stated sigmas.
    pub chi2_pairs: f64,
    /// Chi^2 of the outline's points and the priors.
    pub chi2_others: f64,
    /// Degrees of freedom of the pairs' residuals: Förstner's redundancy numbers, summed.
    pub redundancy: f64,
}

impl Adjusted {
    /// Total chi^2 with the inflated sigmas.
    pub(super) fn chi2(&self) -> f64 {
        self.chi2_pairs / self.terms.inflation.powi(2) + self.chi2_others
    }

    /// Square root of the determinant of the tilt's covariance over that of its prior: the fraction of the a priori possible tilts that
    /// the data leave open.
    pub(super) fn open_tilts(&self) -> f64 {
        let [x, y] = TILT;
        let c = &self.covariance;
        let determinant = c[(x, x)] * c[(y, y)] - c[(x, y)].powi(2);
        determinant.max(0.0).sqrt() / self.model.tilt_sigma().powi(2)
    }
}

impl Model {
    /// All parameters zero: one step from here gives the similarity of the pairs alone.
    fn zero(handedness: Handedness) -> Self {
        Self {
            view: View::zero(handedness),
            circle: None,
        }
    }

    pub(super) fn unknowns(&self) -> Unknowns {
        let mut unknowns = Unknowns::zeros();
        unknowns
            .fixed_rows_mut::<PARAMETERS>(0)
            .copy_from(&self.view.parameters);
        if let Some(Circle { centre, radius }) = self.circle {
            let circle = [centre.x, centre.y, radius];
            unknowns.as_mut_slice()[CIRCLE..].copy_from_slice(&circle);
        }
        unknowns
    }

    fn advanced(&self, step: &Unknowns) -> Self {
        let view_step = Parameters::from_column_slice(&step.as_slice()[..PARAMETERS]);
        Self {
            view: self.view.advanced(&view_step),
            circle: self.circle.map(|circle| Circle {
                centre: circle.centre + Vector2::new(step[CIRCLE], step[CIRCLE + 1]),
                radius: circle.radius + step[CIRCLE + 2],
            }),
        }
    }

    /// Displacement by a step of the image at [`UNIT_MIL`] from the plate's centre, px.
    fn moved_px(&self, step: &Unknowns) -> f64 {
        let unit_px = self.view.unit_px();
        let linear = step.fixed_rows::<6>(0).norm();
        let by_tilt = unit_px * step.fixed_rows::<2>(TILT[0]).norm();
        let by_circle = unit_px / UNIT_MIL * step.fixed_rows::<3>(CIRCLE).norm();
        linear.hypot(by_tilt).hypot(by_circle)
    }

    /// 1 sigma of the tilt of a camera aligned by hand, in the view's units.
    fn tilt_sigma(&self) -> f64 {
        TILT_PER_PX * self.view.unit_px()
    }
}

impl Problem {
    /// `None` if a covariance is not positive.
    pub(super) fn new(
        pairs: &[Pair],
        outline: Option<&Outline<'_>>,
        handedness: Handedness,
        distortion: Distortion,
    ) -> Option<Self> {
        let ideal = |pair: &Pair| {
            Some(IdealPair {
                observed: distortion.correct(pair.observed).vector(),
                printed: pair.printed,
                whitening: pair.covariance_px2.cholesky()?.l().try_inverse()?,
            })
        };
        let outline = outline.map(|outline| {
            let ideal =
                |(at, sigma_px): &(SensorPx, f64)| (distortion.correct(*at).vector(), *sigma_px);
            IdealOutline {
                centre: outline.ellipse.centre,
                points: outline.points.iter().map(ideal).collect(),
                radius_mil: outline.radius_mil,
            }
        });
        Some(Self {
            pairs: pairs.iter().map(ideal).collect::<Option<_>>()?,
            outline,
            handedness,
        })
    }

    pub(super) fn pairs(&self) -> usize {
        self.pairs.len()
    }

    /// Removes a pair.
    pub(super) fn reject(&mut self, pair: usize) {
        self.pairs.remove(pair);
    }

    /// Multiplies the sigmas of the pairs by a factor.
    pub(super) fn inflate_pairs(&mut self, factor: f64) {
        let pairs = self.pairs.iter_mut();
        pairs.for_each(|pair| pair.whitening /= factor);
    }

    /// Multiplies the sigmas of the outline's points by a factor.
    pub(super) fn inflate_outline(&mut self, factor: f64) {
        let points = self.outline.iter_mut().flat_map(|o| &mut o.points);
        points.for_each(|(_, sigma_px)| *sigma_px *= factor);
    }

    /// The similarity of the pairs alone.
    pub(super) fn similarity_of_pairs(&self) -> Option<Model> {
        let terms = Terms {
            kind: MappingKind::Similarity,
            inflation: 1.0,
        };
        let fitted = self.adjust(&Model::zero(self.handedness), terms)?;
        Some(fitted.model)
    }

    /// The same with the circle whose image is the outline, if there is one.
    pub(super) fn similarity(&self) -> Option<Model> {
        let Model { view, .. } = self.similarity_of_pairs()?;
        let circle = match &self.outline {
            Some(outline) => Some(Circle {
                centre: view.unproject(outline.centre)?.0.vector(),
                radius: outline.radius_mil.value,
            }),
            None => None,
        };
        Some(Model { view, circle })
    }

    /// Fits from a model near the solution; without the outline if the model has no circle. `None` if the data do not determine the fit.
    pub(super) fn adjust(&self, start: &Model, terms: Terms) -> Option<Adjusted> {
        let held = held(terms.kind, start.circle.is_some());
        let mut model = *start;
        for _ in 0..MOST_STEPS {
            let pairs = self.normal_of_pairs(&model);
            let others = self.normal_of_others(&model)?;
            let weight = terms.inflation.powi(-2);
            let both = pairs.weighted(weight).with(&others);
            let solved = both.solve(&held, &Unknowns::zeros())?;
            let step = solved.step;
            let next = model.advanced(&step);
            if next.moved_px(&step) < SHORT_STEP_PX {
                let covariance = solved.covariance();
                return Some(Adjusted {
                    terms,
                    model: next,
                    chi2_pairs: pairs.chi2_after(&step),
                    chi2_others: others.chi2_after(&step),
                    redundancy: (2 * self.pairs.len()) as f64
                        - weight * covariance.component_mul(&pairs.information).sum(),
                    covariance,
                });
            }
            model = next;
        }
        None
    }

    /// Decrease of chi^2 by the first step from a model in the unknowns of each of some kinds, all with stated sigmas.
    /// `None` if the data do not determine a step.
    pub(super) fn first_step_gains<const N: usize>(
        &self,
        model: &Model,
        kinds: [MappingKind; N],
    ) -> Option<[Option<f64>; N]> {
        let pairs = self.normal_of_pairs(model);
        let others = self.normal_of_others(model)?;
        let both = pairs.with(&others);
        Some(kinds.map(|kind| {
            let held = held(kind, model.circle.is_some());
            let solved = both.solve(&held, &Unknowns::zeros())?;
            Some(both.gradient.dot(&solved.step))
        }))
    }

    fn normal_of_pairs(&self, model: &Model) -> Normal<UNKNOWNS> {
        let mut normal = Normal::zero();
        for pair in &self.pairs {
            let residual = pair.whitening * (pair.observed - model.view.project(pair.printed));
            let slopes = pair.whitening * model.view.parameter_jacobian(pair.printed);
            for n in 0..2 {
                let mut row = Unknowns::zeros();
                row.fixed_rows_mut::<PARAMETERS>(0)
                    .copy_from(&slopes.row(n).transpose());
                normal.add(&row, residual[n], 1.0);
            }
        }
        normal
    }

    /// Normal equations of the priors of tilt and radius, and of the outline's points; zero without a circle. `None` if a point has no
    /// position on the plate.
    fn normal_of_others(&self, model: &Model) -> Option<Normal<UNKNOWNS>> {
        let mut normal = Normal::zero();
        let (Some(outline), Some(circle)) = (&self.outline, model.circle) else {
            return Some(normal);
        };
        for n in TILT {
            let weight = 1.0 / model.tilt_sigma();
            normal.add(&along(n, weight), -model.view.parameters[n] * weight, 1.0);
        }
        let Measured { value, sigma, .. } = outline.radius_mil;
        let slopes = along(CIRCLE + 2, 1.0 / sigma);
        normal.add(&slopes, (value - circle.radius) / sigma, 1.0);
        for (observed, sigma_px) in &outline.points {
            let (on_plate, to_plate) = model.view.unproject(*observed)?;
            let from_centre = on_plate.vector() - circle.centre;
            let distance = from_centre.norm();
            let outward = (distance > 0.0).then(|| from_centre / distance)?;
            // Change of the point's distance on the plate with its shift on the sensor.
            let across = to_plate.tr_mul(&outward);
            let weight = (sigma_px * across.norm()).powi(-2);
            let mut slopes = Unknowns::zeros();
            let by_view = model.view.parameter_jacobian(on_plate).tr_mul(&across);
            slopes.fixed_rows_mut::<PARAMETERS>(0).copy_from(&by_view);
            slopes[CIRCLE] = outward.x;
            slopes[CIRCLE + 1] = outward.y;
            slopes[CIRCLE + 2] = 1.0;
            normal.add(&slopes, distance - circle.radius, weight);
        }
        Some(normal)
    }

    /// Squared normalised residual of every pair, and its residual in px.
    pub(super) fn residuals(&self, view: &View) -> impl Iterator<Item = (f64, Vector2<f64>)> {
        self.pairs.iter().map(|pair| {
            let residual = pair.observed - view.project(pair.printed);
            ((pair.whitening * residual).norm_squared(), residual)
        })
    }
}

/// Derivatives of an observation of one unknown.
fn along(unknown: usize, weight: f64) -> Unknowns {
    let mut slopes = Unknowns::zeros();
    slopes[unknown] = weight;
    slopes
}

/// The fixed unknowns for a kind of mapping.
fn held(kind: MappingKind, with_circle: bool) -> Prior<UNKNOWNS> {
    let mut free = [with_circle; UNKNOWNS];
    free[..PARAMETERS].copy_from_slice(&parameters_of(kind));
    let mut held = Prior::none();
    for n in (0..UNKNOWNS).filter(|n| !free[*n]) {
        held.information[n] = f64::INFINITY;
    }
    held
}
