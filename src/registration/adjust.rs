//! One adjustment of everything that the mapping decides: the pairs, and the points that lie on one circle of the plate.

use super::model::{MOST, Model, Normalisation, Parameters};
use super::normal_points::normal_points;
use super::{Outline, Pair};
use crate::geometry::{Circle, Distortion, Handedness, MappingKind, project};
use crate::units::PlateMil;
use nalgebra::{Cholesky, Const, Matrix2, SMatrix, SVector, Vector2};

/// The mapping's parameters, then the circle's centre x, y and radius.
pub(super) const ALL: usize = MOST + 3;
pub(super) type Covariance = SMatrix<f64, ALL, ALL>;
type Row = SVector<f64, ALL>;

/// What is to be fitted, on the ideal sensor.
pub(super) struct Problem<'a> {
    pairs: Vec<IdealPair>,
    outline: Option<(&'a Outline<'a>, Vec<IdealPoint>)>,
    handedness: Handedness,
    normalisation: Normalisation,
}

#[derive(Clone)]
struct IdealPair {
    seen: Vector2<f64>,
    printed: PlateMil,
    /// Inverse of the covariance, px^-2.
    weight: Matrix2<f64>,
}

struct IdealPoint {
    seen: Vector2<f64>,
    sigma_px: f64,
}

/// A fit with all that is needed to judge it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Adjusted {
    pub model: Model,
    pub circle: Option<Circle>,
    pub covariance: Covariance,
    /// By the pairs' stated sigmas.
    pub chi2_pairs: f64,
    pub chi2_outline: f64,
    /// How many of the pairs' coordinates are left over, once the parameters have had their share.
    pub redundancy: f64,
    /// By how much the pairs' stated sigmas were raised.
    pub raised: f64,
}

const STEPS: usize = 12;
/// A shorter step changes nothing: px, mil and parts of the picture's size alike.
const SETTLED_STEP: f64 = 1e-5;

impl<'a> Problem<'a> {
    /// `None` when a covariance cannot be inverted or all pairs fall together.
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
                weight: pair.covariance_px2.try_inverse()?,
            })
        };
        let ideal_points = |outline: &'a Outline<'a>| {
            let point = |(at, sigma_px): (_, f64)| IdealPoint {
                seen: distortion.correct(at).vector(),
                sigma_px,
            };
            let points = normal_points(outline.points, &outline.ellipse);
            (outline, points.into_iter().map(point).collect())
        };
        Some(Self {
            pairs: pairs.iter().map(ideal_pair).collect::<Option<_>>()?,
            outline: outline.map(ideal_points),
            handedness,
            normalisation: Normalisation::of(pairs.iter().map(|pair| pair.printed))?,
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
            normalisation: self.normalisation,
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
        self.adjust(adjusted.model, adjusted.circle, raised)
    }

    /// Whether the first step of a richer kind would lower chi^2 by more than so much for every parameter that it adds, the
    /// pairs taken at their stated sigmas.
    pub(super) fn promises(&self, simple: &Adjusted, start: Model, least_gain: f64) -> bool {
        let kind = start.kind();
        let added = kind
            .parameters()
            .saturating_sub(simple.model.kind().parameters());
        let gain = || {
            let sums = self.sums(&start, simple.circle, 1.0, kind)?;
            let step = sums.information.cholesky()?.solve(&sums.gradient);
            // The start may be of another kind than the simple fit.
            let lost = sums.chi2_pairs + sums.chi2_outline;
            let least = simple.chi2_pairs + simple.chi2_outline;
            Some(step.dot(&sums.gradient) - (lost - least))
        };
        gain().is_none_or(|gain| gain > least_gain * added.max(1) as f64)
    }

    /// Fits the kind of mapping that the start is of, the pairs' sigmas raised by a factor. `None` when the data do not
    /// determine it.
    pub(super) fn fit(&self, start: Model, raised: f64) -> Option<Adjusted> {
        if 2 * self.pairs.len() < MappingKind::Similarity.parameters() {
            return None;
        }
        self.adjust(start, self.start_circle(&start)?, raised)
    }

    fn adjust(&self, start: Model, circle: Option<Circle>, raised: f64) -> Option<Adjusted> {
        let (mut model, mut circle) = (start, circle);
        let kind = model.kind();
        let mut sums = Sums::default();
        for _ in 0..STEPS {
            sums = self.sums(&model, circle, raised, kind)?;
            let step = sums.information.cholesky()?.solve(&sums.gradient);
            if !step.iter().all(|v| v.is_finite()) {
                return None;
            }
            model.advance(&step.fixed_rows::<MOST>(0).into_owned());
            if let Some(circle) = &mut circle {
                circle.centre += Vector2::new(step[MOST], step[MOST + 1]);
                circle.radius += step[MOST + 2];
            }
            if step.norm_squared() < SETTLED_STEP.powi(2) {
                break;
            }
        }
        let covariance = well_conditioned(&sums.information)?.inverse();
        let last = self.sums(&model, circle, raised, kind)?;
        Some(Adjusted {
            model,
            circle,
            covariance,
            chi2_pairs: last.chi2_pairs,
            chi2_outline: last.chi2_outline,
            redundancy: self.redundancy(&model, &covariance, raised),
            raised,
        })
    }

    /// The similarity that the pairs alone give.
    pub(super) fn first_similarity(&self) -> Option<Model> {
        let kind = MappingKind::Similarity;
        let mut first = Model::zero(kind, self.handedness, self.normalisation);
        let mut information = SMatrix::<f64, MOST, MOST>::zeros();
        let mut gradient = Parameters::zeros();
        for pair in &self.pairs {
            let slopes = first.parameter_slopes(pair.printed);
            let miss = pair.seen - first.picture(pair.printed);
            information += slopes.transpose() * pair.weight * slopes;
            gradient += slopes.transpose() * (pair.weight * miss);
        }
        for n in kind.parameters()..MOST {
            information[(n, n)] = 1.0;
        }
        first.advance(&information.cholesky()?.solve(&gradient));
        Some(first)
    }

    /// `Some(None)` where no outline is fitted.
    fn start_circle(&self, model: &Model) -> Option<Option<Circle>> {
        let Some((outline, _)) = &self.outline else {
            return Some(None);
        };
        let back = model.homography().try_inverse()?;
        Some(Some(Circle {
            centre: project(&back, outline.ellipse.centre),
            radius: outline.radius_mil.value,
        }))
    }

    fn sums(
        &self,
        model: &Model,
        circle: Option<Circle>,
        raised: f64,
        kind: MappingKind,
    ) -> Option<Sums> {
        let mut sums = Sums::default();
        for pair in &self.pairs {
            let slopes = model.parameter_slopes(pair.printed);
            let miss = pair.seen - model.picture(pair.printed);
            let weighted = slopes.transpose() * (pair.weight / raised.powi(2));
            sums.add_pair(&(weighted * slopes), &(weighted * miss));
            sums.chi2_pairs += miss.dot(&(pair.weight * miss));
        }
        if let (Some(circle), Some((outline, points))) = (circle, &self.outline) {
            sums.add_prior(outline, &circle);
            let back = model.homography().try_inverse()?;
            for point in points {
                let on_plate = project(&back, point.seen);
                let outward = (on_plate - circle.centre).try_normalize(0.0)?;
                let excess = (on_plate - circle.centre).norm() - circle.radius;
                let to_plate = model.jacobian(on_plate.into()).try_inverse()?;
                let across = to_plate.transpose() * outward;
                let slopes = model.parameter_slopes(on_plate.into());
                let mut row = Row::zeros();
                row.fixed_rows_mut::<MOST>(0)
                    .copy_from(&(slopes.transpose() * across));
                row[MOST] = outward.x;
                row[MOST + 1] = outward.y;
                row[MOST + 2] = 1.0;
                let weight = (point.sigma_px * across.norm()).powi(-2);
                sums.add_row(&row, excess, weight);
            }
        }
        sums.hold_unused(kind, circle.is_some());
        Some(sums)
    }

    /// Förstner's redundancy numbers, summed over the pairs.
    fn redundancy(&self, model: &Model, covariance: &Covariance, raised: f64) -> f64 {
        let of_mapping = covariance.fixed_view::<MOST, MOST>(0, 0);
        self.pairs
            .iter()
            .map(|pair| {
                let slopes = model.parameter_slopes(pair.printed);
                let explained = slopes * of_mapping * slopes.transpose() * pair.weight;
                2.0 - explained.trace() / raised.powi(2)
            })
            .sum()
    }

    /// Squared residual over covariance of every pair, and its residual in px.
    pub(super) fn residuals(&self, model: &Model) -> Vec<(f64, Vector2<f64>)> {
        self.pairs
            .iter()
            .map(|pair| {
                let miss = pair.seen - model.picture(pair.printed);
                (miss.dot(&(pair.weight * miss)), miss)
            })
            .collect()
    }
}

/// The normal equations' root, unless one parameter is so nearly a combination of others that the data do not tell
/// them apart.
fn well_conditioned(information: &Covariance) -> Option<Cholesky<f64, Const<ALL>>> {
    const LEAST_OWN_PART: f64 = 1e-10;
    let root = information.cholesky()?;
    let own_part = |n: usize| root.l_dirty()[(n, n)].powi(2) / information[(n, n)];
    (0..ALL)
        .all(|n| own_part(n) > LEAST_OWN_PART)
        .then_some(root)
}

/// Normal equations.
struct Sums {
    information: Covariance,
    gradient: Row,
    chi2_pairs: f64,
    chi2_outline: f64,
}

impl Default for Sums {
    fn default() -> Self {
        Self {
            information: Covariance::zeros(),
            gradient: Row::zeros(),
            chi2_pairs: 0.0,
            chi2_outline: 0.0,
        }
    }
}

impl Sums {
    fn add_pair(&mut self, information: &SMatrix<f64, MOST, MOST>, gradient: &Parameters) {
        let mut block = self.information.fixed_view_mut::<MOST, MOST>(0, 0);
        block += information;
        let mut rows = self.gradient.fixed_rows_mut::<MOST>(0);
        rows += gradient;
    }

    fn add_row(&mut self, row: &Row, miss: f64, weight: f64) {
        self.information.ger(weight, row, row, 1.0);
        self.gradient += row * (miss * weight);
        self.chi2_outline += miss * miss * weight;
    }

    fn add_prior(&mut self, outline: &Outline<'_>, circle: &Circle) {
        let mut row = Row::zeros();
        row[MOST + 2] = 1.0;
        let miss = outline.radius_mil.value - circle.radius;
        self.add_row(&row, miss, outline.radius_mil.sigma.powi(-2));
    }

    /// Parameters that the kind does not have stay where they are.
    fn hold_unused(&mut self, kind: MappingKind, with_circle: bool) {
        let circle = if with_circle { MOST..MOST } else { MOST..ALL };
        for n in (kind.parameters()..MOST).chain(circle) {
            self.information[(n, n)] = 1.0;
        }
    }
}
