//! One adjustment of everything that the mapping decides: the pairs, and the points that lie on one circle of the plate.

use super::model::{MOST, Model, parameters_of};
use super::normal_points::{ARCS, normal_points};
use super::sums::{MISS, Row, Solved, Sums, UNKNOWNS};
use super::{Outline, Pair};
use crate::geometry::{Circle, Distortion, Handedness, MappingKind};
use crate::units::PlateMil;
use nalgebra::{Matrix2, Vector2};

/// The place of the circle's centre x, y and radius among the unknowns, after the mapping's parameters.
pub(super) const CIRCLE: usize = MOST;

/// What is to be fitted, on the ideal sensor.
pub(super) struct Problem<'a> {
    pairs: Vec<IdealPair>,
    outline: Option<(&'a Outline<'a>, Vec<IdealPoint>)>,
    handedness: Handedness,
}

#[derive(Clone)]
struct IdealPair {
    seen: Vector2<f64>,
    printed: PlateMil,
    /// Takes a miss, px, to two numbers of sigma 1 that know nothing of each other.
    in_sigmas: Matrix2<f64>,
}

struct IdealPoint {
    seen: Vector2<f64>,
    sigma_px: f64,
}

/// A fit with all that is needed to judge it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Adjusted {
    pub kind: MappingKind,
    pub model: Model,
    pub circle: Option<Circle>,
    pub solved: Solved,
    /// By the pairs' stated sigmas.
    pub chi2_pairs: f64,
    pub chi2_outline: f64,
    /// How many of the pairs' coordinates are left over, once the parameters have had their share.
    pub redundancy: f64,
    /// By how much the pairs' stated sigmas were raised.
    pub raised: f64,
}

/// The problem near a model, where its misses are linear in all parameters of the richest kind: good for every kind and for
/// any sigmas that lead not far away.
#[derive(Clone)]
pub(super) struct Vicinity {
    model: Model,
    circle: Option<Circle>,
    pairs: Sums,
    outline: Sums,
    coordinates: usize,
}

const STEPS: usize = 12;
/// A step as short as this leaves misses linear to a hundred-thousandth of a pixel.
const SHORT_STEP_PX: f64 = 0.03;

impl<'a> Problem<'a> {
    /// `None` when a covariance is not positive.
    pub(super) fn new(
        pairs: &[Pair],
        outline: Option<&'a Outline<'a>>,
        handedness: Handedness,
        distortion: Distortion,
    ) -> Option<Self> {
        let ideal_pair = |pair: &Pair| {
            Some(IdealPair {
                seen: distortion.correct(pair.seen).vector(),
                printed: pair.printed,
                in_sigmas: in_sigmas(&pair.covariance_px2)?,
            })
        };
        let ideal_points = |outline: &'a Outline<'a>| {
            let point = |(at, sigma_px): (_, f64)| IdealPoint {
                seen: distortion.correct(at).vector(),
                sigma_px,
            };
            let mut points = Vec::with_capacity(ARCS);
            points.extend(normal_points(outline.points, &outline.ellipse).map(point));
            (outline, points)
        };
        let mut ideal_pairs = Vec::with_capacity(pairs.len());
        for pair in pairs {
            ideal_pairs.push(ideal_pair(pair)?);
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

    /// Raises the sigmas of the outline's points by a factor.
    pub(super) fn doubt_outline(&mut self, factor: f64) {
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

    /// Leaves out one of the pairs.
    pub(super) fn leave_out(&mut self, pair: usize) {
        self.pairs.remove(pair);
    }

    /// A fit with the pairs' sigmas raised by another factor; itself where it was made by that very one.
    pub(super) fn again(&self, adjusted: &Adjusted, raised: f64) -> Option<Adjusted> {
        if adjusted.raised == raised {
            return Some(*adjusted);
        }
        let mut near = self.near(adjusted.model, adjusted.circle)?;
        self.adjust(&mut near, adjusted.kind, raised)
    }

    /// Fits a kind of mapping, the pairs' sigmas raised by a factor, and moves the vicinity to where the fit is. `None` when
    /// the data do not determine it.
    pub(super) fn adjust(
        &self,
        near: &mut Vicinity,
        kind: MappingKind,
        raised: f64,
    ) -> Option<Adjusted> {
        let mut solved = near.solved(kind, raised)?;
        for _ in 1..STEPS {
            if near.moved_px2(&solved.step()) < SHORT_STEP_PX.powi(2) {
                break;
            }
            let (model, circle) = near.after(&solved.step());
            *near = self.near(model, circle)?;
            solved = near.solved(kind, raised)?;
        }
        Some(near.adjusted(solved, kind, raised))
    }

    /// The vicinity of the similarity that the pairs alone give.
    pub(super) fn near_first_similarity(&self) -> Option<Vicinity> {
        // A similarity's picture is linear in its parameters.
        let zero = Model::zero(self.handedness);
        let pairs = Sums::of(&self.pair_rows(&zero));
        let step = pairs.solved(&free(MappingKind::Similarity, false))?.step();
        let similarity = zero.advanced(&step);
        let circle = match &self.outline {
            Some((outline, _)) => Some(Circle {
                centre: similarity.back(outline.ellipse.centre)?.0,
                radius: outline.radius_mil.value,
            }),
            None => None,
        };
        self.near(similarity, circle)
    }

    fn near(&self, model: Model, circle: Option<Circle>) -> Option<Vicinity> {
        let outline = match (&self.outline, circle) {
            (Some((outline, points)), Some(circle)) => {
                outline_rows(outline, points, &model, &circle)?
            }
            _ => Vec::new(),
        };
        Some(Vicinity {
            model,
            circle,
            pairs: Sums::of(&self.pair_rows(&model)),
            outline: Sums::of(&outline),
            coordinates: 2 * self.pairs.len(),
        })
    }

    fn pair_rows(&self, model: &Model) -> Vec<Row> {
        let mut rows = Vec::with_capacity(2 * self.pairs.len());
        for pair in &self.pairs {
            let [x, y] = model.parameter_slopes(pair.printed);
            let miss = pair.in_sigmas * (pair.seen - model.picture(pair.printed));
            for n in 0..2 {
                let (of_x, of_y) = (pair.in_sigmas[(n, 0)], pair.in_sigmas[(n, 1)]);
                let slopes = std::array::from_fn(|k| of_x * x[k] + of_y * y[k]);
                rows.push(row(slopes, [0.0; 3], miss[n]));
            }
        }
        rows
    }

    /// Squared residual over covariance of every pair, and its residual in px.
    pub(super) fn residuals(&self, model: &Model) -> impl Iterator<Item = (f64, Vector2<f64>)> {
        self.pairs.iter().map(|pair| {
            let miss = pair.seen - model.picture(pair.printed);
            ((pair.in_sigmas * miss).norm_squared(), miss)
        })
    }
}

impl Vicinity {
    /// Whether a richer kind would lower chi^2 by more than so much for every parameter that it adds, the pairs taken at
    /// their stated sigmas.
    pub(super) fn promises(&self, simple: &Adjusted, kind: MappingKind, least_gain: f64) -> bool {
        let added = kind
            .parameters()
            .saturating_sub(simple.kind.parameters())
            .max(1);
        let left = simple.chi2_pairs + simple.chi2_outline;
        self.solved(kind, 1.0)
            .is_some_and(|richer| left - richer.chi2() > least_gain * added as f64)
    }

    fn solved(&self, kind: MappingKind, raised: f64) -> Option<Solved> {
        let sums = self.outline.with(&self.pairs, 1.0 / (raised * raised));
        sums.solved(&free(kind, self.circle.is_some()))
    }

    fn moved_px2(&self, step: &[f64; UNKNOWNS]) -> f64 {
        let [tx, ty, a, b, c, d, gx, gy, circle @ ..] = *step;
        let mapping = self.model.moved_px2(&[tx, ty, a, b, c, d, gx, gy]);
        let circle_mil2: f64 = circle.iter().map(|v| v * v).sum();
        mapping + circle_mil2 * self.model.scale_px_per_mil().powi(2)
    }

    fn after(&self, step: &[f64; UNKNOWNS]) -> (Model, Option<Circle>) {
        let [.., x, y, radius] = *step;
        let circle = self.circle.map(|circle| Circle {
            centre: circle.centre + Vector2::new(x, y),
            radius: circle.radius + radius,
        });
        (self.model.advanced(step), circle)
    }

    fn adjusted(&self, solved: Solved, kind: MappingKind, raised: f64) -> Adjusted {
        let step = solved.step();
        let (model, circle) = self.after(&step);
        // Förstner's redundancy numbers, summed over the pairs.
        let explained = self.pairs.explained(&solved) / (raised * raised);
        Adjusted {
            kind,
            model,
            circle,
            chi2_pairs: self.pairs.chi2(&step),
            chi2_outline: self.outline.chi2(&step),
            redundancy: self.coordinates as f64 - explained,
            solved,
            raised,
        }
    }
}

/// The unknowns of a kind of mapping.
fn free(kind: MappingKind, with_circle: bool) -> [bool; UNKNOWNS] {
    let [tx, ty, a, b, c, d, gx, gy] = parameters_of(kind);
    let circle = with_circle;
    [tx, ty, a, b, c, d, gx, gy, circle, circle, circle]
}

/// What is known of the circle's radius, and the points that lie on the circle.
fn outline_rows(
    outline: &Outline<'_>,
    points: &[IdealPoint],
    model: &Model,
    circle: &Circle,
) -> Option<Vec<Row>> {
    let mut rows = Vec::with_capacity(points.len() + 1);
    let radius_mil = outline.radius_mil;
    let weight = 1.0 / radius_mil.sigma;
    let miss = (radius_mil.value - circle.radius) * weight;
    rows.push(row([0.0; MOST], [0.0, 0.0, weight], miss));
    for point in points {
        let (on_plate, to_plate) = model.back(point.seen)?;
        let from_centre = on_plate - circle.centre;
        let distance = from_centre.norm();
        let outward = (distance > 0.0).then(|| from_centre / distance)?;
        let across = to_plate.tr_mul(&outward);
        let weight = 1.0 / (point.sigma_px * across.norm());
        let (out, across) = (outward * weight, across * weight);
        let [x, y] = model.parameter_slopes(on_plate.into());
        let slopes = std::array::from_fn(|k| across.x * x[k] + across.y * y[k]);
        let miss = (distance - circle.radius) * weight;
        rows.push(row(slopes, [out.x, out.y, weight], miss));
    }
    Some(rows)
}

fn row(slopes: [f64; MOST], circle: [f64; 3], miss: f64) -> Row {
    let mut row = [0.0; MISS + 1];
    row[..MOST].copy_from_slice(&slopes);
    row[CIRCLE..MISS].copy_from_slice(&circle);
    row[MISS] = miss;
    row
}

/// The inverse of a covariance's root.
fn in_sigmas(covariance: &Matrix2<f64>) -> Option<Matrix2<f64>> {
    let first = covariance.m11.sqrt();
    let common = covariance.m21 / first;
    let rest = (covariance.m22 - common * common).sqrt();
    (first > 0.0 && rest > 0.0).then(|| {
        let own = 1.0 / rest;
        Matrix2::new(1.0 / first, 0.0, -common / first * own, own)
    })
}
