//! One adjustment of everything that the mapping decides: the pairs, and the points that lie on one circle of the plate.

use super::input::{Outline, Pair};
use super::normal_points::{ARCS, normal_points};
use super::sums::{RESIDUAL, Row, Solved, Sums, UNKNOWNS};
use crate::geometry::view::{PARAMETERS, ParameterJacobian, Parameters, UNIT_MIL};
use crate::geometry::view::{View, parameters_of};
use crate::geometry::{Circle, Distortion, Handedness, MappingKind};
use crate::units::{PlateMil, SensorPx};
use nalgebra::{Matrix2, RowSVector, Vector2};

/// Index of the circle's centre x, y and radius among the unknowns, after the view's parameters.
pub(super) const CIRCLE: usize = PARAMETERS;

/// Pairs and outline, on the ideal sensor.
pub(super) struct Problem<'a> {
    pairs: Vec<IdealPair>,
    outline: Option<(&'a Outline<'a>, Vec<IdealPoint>)>,
    handedness: Handedness,
}

#[derive(Clone)]
struct IdealPair {
    seen: Vector2<f64>,
    printed: PlateMil,
    /// Inverse Cholesky factor of the covariance: takes a residual (px) to two uncorrelated numbers of sigma 1.
    whitening: Matrix2<f64>,
}

struct IdealPoint {
    seen: Vector2<f64>,
    sigma_px: f64,
}

/// A fit with its statistics.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Adjusted {
    pub kind: MappingKind,
    pub view: View,
    pub circle: Option<Circle>,
    pub solved: Solved,
    /// By the pairs' stated sigmas.
    pub chi2_pairs: f64,
    pub chi2_outline: f64,
    /// Degrees of freedom of the pairs' residuals.
    pub redundancy: f64,
    /// Factor of the pairs' stated sigmas.
    pub inflation: f64,
}

/// The problem linearised about a view in all parameters of the richest kind: good for every kind and inflation whose
/// solution is close.
#[derive(Clone)]
pub(super) struct Linearised {
    view: View,
    circle: Option<Circle>,
    pairs: Sums,
    outline: Sums,
    coordinates: usize,
}

const STEPS: usize = 12;
/// A step as short as this leaves residuals linear to a hundred-thousandth of a pixel.
const SHORT_STEP_PX: f64 = 0.03;

impl<'a> Problem<'a> {
    /// `None` when a covariance is not positive.
    pub(super) fn new(
        pairs: &[Pair],
        outline: Option<&'a Outline<'a>>,
        handedness: Handedness,
        distortion: Distortion,
    ) -> Option<Self> {
        let ideal_points = |outline: &'a Outline<'a>| {
            let point = |(at, sigma_px): (SensorPx, f64)| IdealPoint {
                seen: distortion.correct(at).vector(),
                sigma_px,
            };
            let mut points = Vec::with_capacity(ARCS);
            points.extend(normal_points(outline.points, &outline.ellipse).map(point));
            (outline, points)
        };
        let mut ideal_pairs = Vec::with_capacity(pairs.len());
        for pair in pairs {
            ideal_pairs.push(IdealPair {
                seen: distortion.correct(pair.seen).vector(),
                printed: pair.printed,
                whitening: whitening(&pair.covariance_px2)?,
            });
        }
        Some(Self {
            pairs: ideal_pairs,
            outline: outline.map(ideal_points),
            handedness,
        })
    }

    pub(super) fn pairs(&self) -> usize {
        self.pairs.len()
    }

    /// Multiplies the sigmas of the outline's points by a factor.
    pub(super) fn inflate_outline(&mut self, factor: f64) {
        if let Some((_, points)) = &mut self.outline {
            points.iter_mut().for_each(|point| point.sigma_px *= factor);
        }
    }

    /// The same without the outline; `None` where there is none.
    pub(super) fn pairs_alone(&self) -> Option<Self> {
        self.outline.as_ref()?;
        Some(Self {
            pairs: self.pairs.clone(),
            outline: None,
            handedness: self.handedness,
        })
    }

    /// Removes a pair.
    pub(super) fn reject(&mut self, pair: usize) {
        self.pairs.remove(pair);
    }

    /// A fit repeated with another inflation of the pairs' sigmas.
    pub(super) fn with_inflation(&self, adjusted: &Adjusted, inflation: f64) -> Option<Adjusted> {
        if adjusted.inflation == inflation {
            return Some(*adjusted);
        }
        let mut near = self.near(adjusted.view, adjusted.circle)?;
        self.adjust(&mut near, adjusted.kind, inflation)
    }

    /// Fits a kind of mapping with the pairs' sigmas inflated by a factor, and linearises at the fit. `None` when the data
    /// do not determine it.
    pub(super) fn adjust(
        &self,
        near: &mut Linearised,
        kind: MappingKind,
        inflation: f64,
    ) -> Option<Adjusted> {
        let mut solved = near.solved(kind, inflation)?;
        for _ in 1..STEPS {
            if near.moved_px2(&solved.step()) < SHORT_STEP_PX.powi(2) {
                break;
            }
            let (view, circle) = near.after(&solved.step());
            *near = self.near(view, circle)?;
            solved = near.solved(kind, inflation)?;
        }
        Some(near.adjusted(solved, kind, inflation))
    }

    /// The problem linearised about the similarity of the pairs alone, whose projection is linear in its parameters.
    pub(super) fn near_similarity(&self) -> Option<Linearised> {
        let zero = View::zero(self.handedness);
        let pairs = Sums::of(&self.pair_rows(&zero));
        let solved = pairs.solved(&free(MappingKind::Similarity, false))?;
        let similarity = zero.advanced(&parameters(&solved.step()));
        let circle = match &self.outline {
            Some((outline, _)) => Some(Circle {
                centre: similarity.unproject(outline.ellipse.centre)?.0.vector(),
                radius: outline.radius_mil.value,
            }),
            None => None,
        };
        self.near(similarity, circle)
    }

    fn near(&self, view: View, circle: Option<Circle>) -> Option<Linearised> {
        let outline = match (&self.outline, circle) {
            (Some((outline, points)), Some(circle)) => {
                outline_rows(outline, points, &view, &circle)?
            }
            _ => Vec::new(),
        };
        Some(Linearised {
            view,
            circle,
            pairs: Sums::of(&self.pair_rows(&view)),
            outline: Sums::of(&outline),
            coordinates: 2 * self.pairs.len(),
        })
    }

    fn pair_rows(&self, view: &View) -> Vec<Row> {
        let mut rows = Vec::with_capacity(2 * self.pairs.len());
        for pair in &self.pairs {
            let slopes: ParameterJacobian = pair.whitening * view.parameter_jacobian(pair.printed);
            let residual = pair.whitening * (pair.seen - view.project(pair.printed));
            for n in 0..2 {
                rows.push(row(slopes.row(n).into_owned(), [0.0; 3], residual[n]));
            }
        }
        rows
    }

    /// Squared normalised residual of every pair, and its residual in px.
    pub(super) fn residuals(&self, view: &View) -> impl Iterator<Item = (f64, Vector2<f64>)> {
        self.pairs.iter().map(|pair| {
            let residual = pair.seen - view.project(pair.printed);
            ((pair.whitening * residual).norm_squared(), residual)
        })
    }
}

impl Linearised {
    /// Whether a richer kind would lower chi^2 by more than so much for every parameter that it adds, the pairs taken at
    /// their stated sigmas.
    pub(super) fn may_gain(&self, simple: &Adjusted, kind: MappingKind, least_gain: f64) -> bool {
        let added = kind
            .parameters()
            .saturating_sub(simple.kind.parameters())
            .max(1);
        let chi2 = simple.chi2_pairs + simple.chi2_outline;
        self.solved(kind, 1.0)
            .is_some_and(|richer| chi2 - richer.chi2() > least_gain * added as f64)
    }

    fn solved(&self, kind: MappingKind, inflation: f64) -> Option<Solved> {
        let sums = self
            .outline
            .with(&self.pairs, 1.0 / (inflation * inflation));
        sums.solved(&free(kind, self.circle.is_some()))
    }

    /// How far a step moves the image of what lies [`UNIT_MIL`] from the plate's centre, px, squared.
    fn moved_px2(&self, step: &[f64; UNKNOWNS]) -> f64 {
        let unit_px = self.view.unit_px();
        let [linear @ .., gx, gy, x, y, radius] = *step;
        let by_linear: f64 = linear.iter().map(|v| v * v).sum();
        let by_tilt = unit_px * unit_px * (gx * gx + gy * gy);
        by_linear + by_tilt + (x * x + y * y + radius * radius) * (unit_px / UNIT_MIL).powi(2)
    }

    fn after(&self, step: &[f64; UNKNOWNS]) -> (View, Option<Circle>) {
        let [.., x, y, radius] = *step;
        let circle = self.circle.map(|circle| Circle {
            centre: circle.centre + Vector2::new(x, y),
            radius: circle.radius + radius,
        });
        (self.view.advanced(&parameters(step)), circle)
    }

    fn adjusted(&self, solved: Solved, kind: MappingKind, inflation: f64) -> Adjusted {
        let step = solved.step();
        let (view, circle) = self.after(&step);
        // Förstner's redundancy numbers, summed over the pairs.
        let absorbed = self.pairs.absorbed(&solved) / (inflation * inflation);
        Adjusted {
            kind,
            view,
            circle,
            chi2_pairs: self.pairs.chi2(&step),
            chi2_outline: self.outline.chi2(&step),
            redundancy: self.coordinates as f64 - absorbed,
            solved,
            inflation,
        }
    }
}

/// The view's part of a step.
fn parameters(step: &[f64; UNKNOWNS]) -> Parameters {
    Parameters::from_column_slice(&step[..PARAMETERS])
}

/// The unknowns of a kind of mapping.
fn free(kind: MappingKind, with_circle: bool) -> [bool; UNKNOWNS] {
    let mut free = [with_circle; UNKNOWNS];
    free[..PARAMETERS].copy_from_slice(&parameters_of(kind));
    free
}

/// The prior of the circle's radius, and the points that lie on the circle.
fn outline_rows(
    outline: &Outline<'_>,
    points: &[IdealPoint],
    view: &View,
    circle: &Circle,
) -> Option<Vec<Row>> {
    let mut rows = Vec::with_capacity(points.len() + 1);
    let radius_mil = outline.radius_mil;
    let weight = 1.0 / radius_mil.sigma;
    let residual = (radius_mil.value - circle.radius) * weight;
    rows.push(row(RowSVector::zeros(), [0.0, 0.0, weight], residual));
    for point in points {
        let (on_plate, to_plate) = view.unproject(point.seen)?;
        let from_centre = on_plate.vector() - circle.centre;
        let distance = from_centre.norm();
        let outward = (distance > 0.0).then(|| from_centre / distance)?;
        let across = to_plate.tr_mul(&outward);
        let weight = 1.0 / (point.sigma_px * across.norm());
        let (out, across) = (outward * weight, across * weight);
        let slopes = across.transpose() * view.parameter_jacobian(on_plate);
        let residual = (distance - circle.radius) * weight;
        rows.push(row(slopes, [out.x, out.y, weight], residual));
    }
    Some(rows)
}

fn row(slopes: RowSVector<f64, PARAMETERS>, circle: [f64; 3], residual: f64) -> Row {
    let mut row = [0.0; RESIDUAL + 1];
    row[..PARAMETERS].copy_from_slice(slopes.as_slice());
    row[CIRCLE..RESIDUAL].copy_from_slice(&circle);
    row[RESIDUAL] = residual;
    row
}

/// The inverse of a covariance's Cholesky factor.
fn whitening(covariance: &Matrix2<f64>) -> Option<Matrix2<f64>> {
    let first = covariance.m11.sqrt();
    let common = covariance.m21 / first;
    let rest = (covariance.m22 - common * common).sqrt();
    (first > 0.0 && rest > 0.0).then(|| {
        let own = 1.0 / rest;
        Matrix2::new(1.0 / first, 0.0, -common / first * own, own)
    })
}
