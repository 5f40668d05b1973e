//! One adjustment of all marks, the lens and every view: Gauss-Newton on normal equations, the views eliminated first.
//!
//! Within a pose camera and plate are one rigid body, so every sighting of a mark in a pose is of the same place: the
//! sightings of a mark in a pose are one [`Cell`], their weighted mean, and the work does not grow with the frames.
//!
//! Views, lens and marks leave a shift, a rotation and a scale open. Those are held by condition: the displacements of the
//! measured marks from the drawing have none in common.

use super::camera::{LENS, Lens, Prediction, predict, prior_sigmas};
use crate::geometry::MappingKind;
use crate::geometry::view::{PARAMETERS, ParameterCovariance, Parameters, View, parameters_of};
use crate::units::PlateMil;
use nalgebra::{DMatrix, DVector, Matrix2, SMatrix, Vector2};

/// The sightings of a mark in a pose.
#[derive(Debug, Clone, Copy)]
pub(super) struct Cell {
    pub mark: usize,
    /// Their weighted mean, px.
    pub seen: Vector2<f64>,
    /// Inverse of the mean's covariance, px^-2.
    pub weight: Matrix2<f64>,
}

/// A mark before it is measured.
#[derive(Debug, Clone, Copy)]
pub(super) struct MarkPrior {
    pub printed: PlateMil,
    pub sigma_mil: f64,
    /// Whether any sighting counts; the others take no part in the gauge.
    pub measured: bool,
}

/// What is adjusted; the rest is held.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Freedoms {
    pub view: MappingKind,
    pub lens: [bool; LENS],
    pub marks: bool,
}

/// The unknowns.
#[derive(Debug, Clone)]
pub(super) struct State {
    pub views: Vec<View>,
    pub lens: Lens,
    pub places: Vec<PlateMil>,
}

impl State {
    pub(super) fn predict(&self, pose: usize, mark: usize) -> Prediction {
        predict(&self.views[pose], &self.lens, self.places[mark])
    }
}

/// What is known.
pub(super) struct Problem<'a> {
    /// By pose.
    pub cells: &'a [Vec<Cell>],
    pub marks: &'a [MarkPrior],
    /// 1 sigma of each lens term, px at its reach.
    pub lens_sigma_px: f64,
    pub freedoms: Freedoms,
}

/// The unknowns' covariance where they settled.
#[derive(Debug, Clone)]
pub(super) struct Settled {
    pub state: State,
    /// Lens terms, then x and y of every mark.
    pub covariance: DMatrix<f64>,
    /// Of each view.
    pub views: Vec<ParameterCovariance>,
    /// Squared deviations from what was known beforehand, over its variance.
    pub chi2_prior: f64,
    /// How many parameters the sightings, not the priors, determine.
    pub determined: f64,
}

impl Settled {
    pub(super) fn place_covariance(&self, mark: usize) -> Matrix2<f64> {
        let n = LENS + 2 * mark;
        self.covariance.fixed_view::<2, 2>(n, n).into_owned()
    }

    pub(super) fn lens_covariance(&self) -> SMatrix<f64, LENS, LENS> {
        self.covariance.fixed_view::<LENS, LENS>(0, 0).into_owned()
    }
}

const STEPS: usize = 15;
/// A shorter step changes nothing: px, mil and parts of a view alike.
const SETTLED_STEP: f64 = 1e-6;
/// Holds what the gauge forbids, against any information from sightings, mil^-2.
const GAUGE_WEIGHT: f64 = 1e10;

impl Problem<'_> {
    /// Adjusts from a start. `None` where sightings and priors together do not determine the unknowns.
    pub(super) fn settle(&self, start: &State) -> Option<Settled> {
        let mut state = start.clone();
        for view in &mut state.views {
            *view = view.simplified(self.freedoms.view);
        }
        for n in (0..LENS).filter(|n| !self.freedoms.lens[*n]) {
            state.lens.terms[n] = 0.0;
        }
        for _ in 0..STEPS {
            let normal = self.normal(&state)?;
            let common = normal.reduced.clone().cholesky()?.solve(&normal.gradient);
            let mut size = common.norm_squared();
            state.lens.terms += common.fixed_rows::<LENS>(0);
            let adjusted = self.adjusted_marks();
            for (mark, place) in state.places.iter_mut().enumerate().take(adjusted) {
                let step = common.fixed_rows::<2>(LENS + 2 * mark);
                *place = (place.vector() + step).into();
            }
            for (view, part) in state.views.iter_mut().zip(&normal.views) {
                let step = part.own_step(&common);
                size += step.norm_squared();
                *view = view.advanced(&step);
            }
            if !size.is_finite() {
                return None;
            }
            if size < SETTLED_STEP.powi(2) {
                break;
            }
        }
        let normal = self.normal(&state)?;
        let covariance = normal.reduced.cholesky()?.inverse();
        let views = normal.views.iter().map(|v| v.covariance(&covariance));
        Some(Settled {
            views: views.collect(),
            chi2_prior: self.chi2_prior(&state),
            determined: self.determined(&state, &covariance),
            covariance,
            state,
        })
    }

    fn adjusted_marks(&self) -> usize {
        match self.freedoms.marks {
            true => self.marks.len(),
            false => 0,
        }
    }

    fn normal(&self, state: &State) -> Option<Normal> {
        let size = LENS + 2 * self.adjusted_marks();
        let mut reduced = DMatrix::zeros(size, size);
        let mut gradient = DVector::zeros(size);
        self.add_priors(state, &mut reduced, &mut gradient);
        let mut views = Vec::with_capacity(self.cells.len());
        for pose in 0..self.cells.len() {
            let part = self.view_part(pose, state, &mut reduced, &mut gradient)?;
            views.push(part);
        }
        for n in (0..LENS).filter(|n| !self.freedoms.lens[*n]) {
            reduced.row_mut(n).fill(0.0);
            reduced.column_mut(n).fill(0.0);
            reduced[(n, n)] = 1.0;
            gradient[n] = 0.0;
            for part in &mut views {
                part.coupling.column_mut(n).fill(0.0);
            }
        }
        for part in &views {
            // What is left once the view follows the common unknowns.
            let follow = part.inverse * &part.coupling;
            reduced.gemm_tr(-1.0, &part.coupling, &follow, 1.0);
            gradient.gemv_tr(-1.0, &follow, &part.gradient, 1.0);
        }
        Some(Normal {
            reduced,
            gradient,
            views,
        })
    }

    /// Adds a pose's cells to the common part, and gives the view's own.
    fn view_part(
        &self,
        pose: usize,
        state: &State,
        common: &mut DMatrix<f64>,
        gradient: &mut DVector<f64>,
    ) -> Option<ViewPart> {
        let mut own = ParameterCovariance::zeros();
        let mut own_gradient = Parameters::zeros();
        let mut coupling = DMatrix::zeros(PARAMETERS, common.ncols());
        for cell in &self.cells[pose] {
            let p = state.predict(pose, cell.mark);
            let miss = cell.seen - p.seen;
            let n = LENS + 2 * cell.mark;
            let to_view = p.view.transpose() * cell.weight;
            let to_lens = p.lens.transpose() * cell.weight;
            own += to_view * p.view;
            own_gradient += to_view * miss;
            add(common, (0, 0), to_lens * p.lens);
            add(&mut coupling, (0, 0), to_view * p.lens);
            let mut part = gradient.fixed_rows_mut::<LENS>(0);
            part += to_lens * miss;
            if self.freedoms.marks {
                let to_place = p.place.transpose() * cell.weight;
                add(common, (0, n), to_lens * p.place);
                add(common, (n, 0), to_place * p.lens);
                add(common, (n, n), to_place * p.place);
                add(&mut coupling, (0, n), to_view * p.place);
                let mut part = gradient.fixed_rows_mut::<2>(n);
                part += to_place * miss;
            }
        }
        let view = &state.views[pose];
        for (n, sigma) in prior_sigmas(view).into_iter().enumerate() {
            let information = sigma.map_or(0.0, |sigma| sigma.powi(-2));
            own[(n, n)] += information;
            own_gradient[n] -= view.parameters[n] * information;
        }
        // A view that nothing is seen in stays as it is.
        let free = match self.cells[pose].is_empty() {
            true => [false; PARAMETERS],
            false => parameters_of(self.freedoms.view),
        };
        for n in (0..PARAMETERS).filter(|n| !free[*n]) {
            own.row_mut(n).fill(0.0);
            own.column_mut(n).fill(0.0);
            own[(n, n)] = 1.0;
            own_gradient[n] = 0.0;
            coupling.row_mut(n).fill(0.0);
        }
        Some(ViewPart {
            inverse: own.cholesky()?.inverse(),
            gradient: own_gradient,
            coupling,
        })
    }

    fn add_priors(&self, state: &State, common: &mut DMatrix<f64>, gradient: &mut DVector<f64>) {
        let lens = self.lens_sigma_px.powi(-2);
        for n in 0..LENS {
            common[(n, n)] += lens;
            gradient[n] -= lens * state.lens.terms[n];
        }
        if !self.freedoms.marks {
            return;
        }
        for (mark, prior) in self.marks.iter().enumerate() {
            let weight = prior.sigma_mil.powi(-2);
            let off = state.places[mark].vector() - prior.printed.vector();
            for axis in 0..2 {
                let n = LENS + 2 * mark + axis;
                common[(n, n)] += weight;
                gradient[n] -= weight * off[axis];
            }
        }
        for row in self.gauge() {
            let off: f64 = row
                .iter()
                .map(|(n, slope)| slope * self.off(state, *n))
                .sum();
            for (a, slope_a) in &row {
                gradient[*a] -= GAUGE_WEIGHT * slope_a * off;
                for (b, slope_b) in &row {
                    common[(*a, *b)] += GAUGE_WEIGHT * slope_a * slope_b;
                }
            }
        }
    }

    /// Displacement of a mark from the drawing along the axis of a common unknown.
    fn off(&self, state: &State, unknown: usize) -> f64 {
        let (mark, axis) = ((unknown - LENS) / 2, (unknown - LENS) % 2);
        state.places[mark].vector()[axis] - self.marks[mark].printed.vector()[axis]
    }

    /// What the displacements of the measured marks must not have in common: shift in x and y, rotation, scale. Each is a
    /// unit vector over the common unknowns.
    fn gauge(&self) -> Vec<Vec<(usize, f64)>> {
        let measured = || self.marks.iter().enumerate().filter(|(_, m)| m.measured);
        let count = measured().count().max(1) as f64;
        let sum: Vector2<f64> = measured().map(|(_, m)| m.printed.vector()).sum();
        let middle = sum / count;
        let moves: [fn(Vector2<f64>) -> Vector2<f64>; 4] = [
            |_| Vector2::x(),
            |_| Vector2::y(),
            |from_middle| Vector2::new(-from_middle.y, from_middle.x),
            |from_middle| from_middle,
        ];
        let row = |motion: fn(Vector2<f64>) -> Vector2<f64>| {
            let mut row: Vec<(usize, f64)> = measured()
                .flat_map(|(mark, m)| {
                    let along = motion(m.printed.vector() - middle);
                    [(LENS + 2 * mark, along.x), (LENS + 2 * mark + 1, along.y)]
                })
                .collect();
            let norm = row.iter().map(|(_, v)| v * v).sum::<f64>().sqrt();
            row.iter_mut().for_each(|(_, v)| *v /= norm.max(1e-12));
            row
        };
        moves.into_iter().map(row).collect()
    }

    fn chi2_prior(&self, state: &State) -> f64 {
        let marks = self.marks.iter().zip(&state.places).map(|(prior, place)| {
            (place.vector() - prior.printed.vector()).norm_squared() / prior.sigma_mil.powi(2)
        });
        let views = state.views.iter().flat_map(|view| {
            let priors = view.parameters.into_iter().zip(prior_sigmas(view));
            priors.filter_map(|(value, sigma)| Some((value / sigma?).powi(2)))
        });
        let lens = state.lens.terms.norm_squared() / self.lens_sigma_px.powi(2);
        marks.sum::<f64>() + views.sum::<f64>() + lens
    }

    /// Each parameter counts by the part of its prior variance that the sightings took away.
    fn determined(&self, state: &State, covariance: &DMatrix<f64>) -> f64 {
        let left = |n: usize, sigma: f64| 1.0 - (covariance[(n, n)] / sigma.powi(2)).min(1.0);
        let lens = (0..LENS).filter(|n| self.freedoms.lens[*n]);
        let lens: f64 = lens.map(|n| left(n, self.lens_sigma_px)).sum();
        let marks = self.marks.iter().enumerate().flat_map(|(mark, prior)| {
            [0, 1].map(|axis| left(LENS + 2 * mark + axis, prior.sigma_mil))
        });
        // The gauge takes four of the marks' freedoms.
        let marks = match self.freedoms.marks {
            true => marks.sum::<f64>() - 4.0,
            false => 0.0,
        };
        lens + marks + (self.freedoms.view.parameters() * state.views.len()) as f64
    }
}

/// Adds a block to a matrix.
fn add<const R: usize, const C: usize>(
    to: &mut DMatrix<f64>,
    (row, column): (usize, usize),
    block: SMatrix<f64, R, C>,
) {
    let mut part = to.fixed_view_mut::<R, C>(row, column);
    part += block;
}

/// Normal equations: the common unknowns', reduced by the views, and the views' own.
struct Normal {
    reduced: DMatrix<f64>,
    gradient: DVector<f64>,
    views: Vec<ViewPart>,
}

struct ViewPart {
    inverse: ParameterCovariance,
    gradient: Parameters,
    /// With the common unknowns.
    coupling: DMatrix<f64>,
}

impl ViewPart {
    /// The view's step once the common unknowns made theirs.
    fn own_step(&self, common: &DVector<f64>) -> Parameters {
        let mut gradient = self.gradient;
        gradient -= &self.coupling * common;
        self.inverse * gradient
    }

    fn covariance(&self, common: &DMatrix<f64>) -> ParameterCovariance {
        let follow = &self.coupling * common * self.coupling.transpose();
        let mut fixed = ParameterCovariance::zeros();
        fixed.copy_from(&follow);
        self.inverse + self.inverse * fixed * self.inverse
    }
}
