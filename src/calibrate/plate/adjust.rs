//! One adjustment of all marks, the lens and every view: Gauss-Newton on normal equations.
//!
//! Within a pose camera and plate are one rigid body, which may drift slowly. The observations of a mark in a pose are combined into one
//! [`Cell`], their weighted mean and their trend about it, so that the cost does not grow with the number of frames.
//!
//! Views, lens and marks leave a shift, a rotation and a scale undetermined. These are fixed by constraints: the displacements of the
//! measured marks from the drawing have none of them in common.

use super::camera::{LENS, Lens, Prediction, predict, prior_sigmas};
use crate::estimation::{Large, LargeSolved};
use crate::geometry::MappingKind;
use crate::geometry::view::{PARAMETERS, ParameterCovariance, View, parameters_of};
use crate::units::PlateMil;
use nalgebra::{DMatrix, DVector, Matrix1, Matrix2, SMatrix, Vector1, Vector2};

/// Highest degree of the polynomial in time that describes a drift.
pub(super) const DRIFT: usize = 3;

/// The terms of a drift at a time within a pose, -1 to 1: Legendre polynomials from the first degree on, each 1 at the end.
pub(super) fn drift_terms(time: f64) -> [f64; DRIFT] {
    let t = time;
    [t, (3.0 * t * t - 1.0) / 2.0, (5.0 * t * t - 3.0) * t / 2.0]
}

/// The drift of a pose along both axes: displacement of the plate's picture by each term, px.
pub(super) type Drift = [Vector2<f64>; DRIFT];

/// The observations of a mark in a pose.
#[derive(Debug, Clone, Copy)]
pub(super) struct Cell {
    pub mark: usize,
    /// Weighted mean of the observed positions, px.
    pub at_px: Vector2<f64>,
    /// Weighted means of the drift terms: the change of the mean position with each of them.
    pub terms: [Matrix2<f64>; DRIFT],
    /// Inverse of the mean's covariance, px^-2.
    pub weight: Matrix2<f64>,
    /// Information of the observations on a drift: weighted products of the terms about their means, and of these with the deviation of
    /// each observation from the mean position.
    pub spread: [[Matrix2<f64>; DRIFT]; DRIFT],
    pub trend: [Vector2<f64>; DRIFT],
}

/// A mark's position before it is measured.
#[derive(Debug, Clone, Copy)]
pub(super) struct MarkPrior {
    pub place: PlateMil,
    /// 1 sigma per axis.
    pub sigma_mil: [f64; 2],
    /// Whether any observation has weight; the gauge ignores the others.
    pub measured: bool,
}

/// The free parameters; the others are fixed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Freedoms {
    pub view: MappingKind,
    pub lens: [bool; LENS],
    pub marks: bool,
    /// Number of drift terms.
    pub drift: usize,
}

/// The unknowns. Their order in vectors and matrices: the lens terms, x and y of every mark, the parameters of every view, the drifts.
#[derive(Debug, Clone)]
pub(super) struct State {
    pub views: Vec<View>,
    pub lens: Lens,
    pub places: Vec<PlateMil>,
    /// Drift of each pose, px; time within a pose runs from -1 at its first frame to 1 at its last.
    pub drift_px: Vec<Drift>,
}

/// Index of a mark's x among the unknowns.
fn mark_index(mark: usize) -> usize {
    LENS + 2 * mark
}

impl State {
    pub(super) fn predict(&self, pose: usize, mark: usize) -> Prediction {
        predict(&self.views[pose], &self.lens, self.places[mark])
    }

    /// Index of a view's first parameter among the unknowns.
    fn view_index(&self, pose: usize) -> usize {
        mark_index(self.places.len()) + PARAMETERS * pose
    }

    /// Index of the x of a drift's first term among the unknowns.
    fn drift_index(&self, pose: usize) -> usize {
        self.view_index(self.views.len()) + 2 * DRIFT * pose
    }

    fn unknowns(&self) -> usize {
        self.drift_index(self.views.len())
    }

    /// The parameter with index n among the unknowns.
    pub(super) fn unknown(&self, n: usize) -> Unknown {
        let (views, drifts) = (self.view_index(0), self.drift_index(0));
        match n {
            n if n < LENS => Unknown::Lens(n),
            n if n < views => Unknown::Mark((n - LENS) / 2, (n - LENS) % 2),
            n if n < drifts => Unknown::View((n - views) / PARAMETERS, (n - views) % PARAMETERS),
            n => {
                let n = n - drifts;
                Unknown::Drift(n / (2 * DRIFT), n / 2 % DRIFT, n % 2)
            }
        }
    }

    /// Drift of a pose at a time within it, px.
    pub(super) fn drifted(&self, pose: usize, time: f64) -> Vector2<f64> {
        let terms = self.drift_px[pose].iter().zip(drift_terms(time));
        terms.map(|(px, term)| px * term).sum()
    }

    fn advance(&mut self, step: &DVector<f64>) {
        self.lens.terms += step.fixed_rows::<LENS>(0);
        for (mark, place) in self.places.iter_mut().enumerate() {
            *place = (place.vector() + step.fixed_rows::<2>(mark_index(mark))).into();
        }
        let first = self.view_index(0);
        for (pose, view) in self.views.iter_mut().enumerate() {
            let step = step.fixed_rows::<PARAMETERS>(first + PARAMETERS * pose);
            *view = view.advanced(&step.into_owned());
        }
        let first = self.drift_index(0);
        for (n, term) in self.drift_px.as_flattened_mut().iter_mut().enumerate() {
            *term += step.fixed_rows::<2>(first + 2 * n);
        }
    }
}

/// Inputs of the adjustment: observations and priors.
pub(super) struct Problem<'a> {
    /// Cells of each pose.
    pub cells: &'a [Vec<Cell>],
    pub marks: &'a [MarkPrior],
    /// 1 sigma of each lens term, px at its reach.
    pub lens_sigma_px: f64,
    pub freedoms: Freedoms,
}

/// The converged unknowns.
#[derive(Debug, Clone)]
pub(super) struct Adjusted {
    pub state: State,
    /// Covariance of all unknowns; zero for fixed ones.
    covariance: DMatrix<f64>,
    /// Squared deviations from the priors over their variance.
    pub chi2_prior: f64,
    /// Number of parameters determined by the observations instead of the priors.
    pub determined: f64,
}

/// The meaning of an unknown.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Unknown {
    Lens(usize),
    /// Mark and axis.
    Mark(usize, usize),
    /// Pose and parameter.
    View(usize, usize),
    /// Pose, term and axis.
    Drift(usize, usize, usize),
}

impl Adjusted {
    /// Covariance of all unknowns; zero for fixed ones.
    pub(super) fn covariance(&self) -> &DMatrix<f64> {
        &self.covariance
    }

    fn block<const N: usize>(&self, first: usize) -> SMatrix<f64, N, N> {
        let block = self.covariance.fixed_view::<N, N>(first, first);
        block.into_owned()
    }

    pub(super) fn place_covariance(&self, mark: usize) -> Matrix2<f64> {
        self.block(mark_index(mark))
    }

    pub(super) fn lens_covariance(&self) -> SMatrix<f64, LENS, LENS> {
        self.block(0)
    }

    pub(super) fn view_covariance(&self, pose: usize) -> ParameterCovariance {
        self.block(self.state.view_index(pose))
    }

    /// Covariance of x and y of each drift term.
    pub(super) fn drift_covariance(
        &self,
        pose: usize,
    ) -> SMatrix<f64, { 2 * DRIFT }, { 2 * DRIFT }> {
        self.block(self.state.drift_index(pose))
    }
}

/// Adds the observations of a mark in a pose: their mean, and their information on the drift.
fn add_cell(normal: &mut Large, state: &State, pose: usize, cell: &Cell) {
    let p = state.predict(pose, cell.mark);
    let drift_px = &state.drift_px[pose];
    let terms = cell.terms.iter().zip(drift_px);
    let drifted: Vector2<f64> = terms.map(|(term, px)| term * px).sum();
    let residual = cell.at_px - p.at_px - drifted;
    let of_drift = cell.terms.iter().flat_map(Matrix2::column_iter);
    let lens = p.lens.column_iter().enumerate();
    let place = (mark_index(cell.mark)..).zip(p.place.column_iter());
    let view = (state.view_index(pose)..).zip(p.view.column_iter());
    let drift = (state.drift_index(pose)..).zip(of_drift);
    let slopes = lens.chain(place).chain(view).chain(drift);
    let slopes: Vec<_> = slopes.map(|(n, slope)| (n, slope.into_owned())).collect();
    normal.add(&slopes, &residual, &cell.weight);
    let index = |term: usize| state.drift_index(pose) + 2 * term;
    for (n, spread) in cell.spread.iter().enumerate() {
        let mut gradient = cell.trend[n];
        for (m, spread) in spread.iter().enumerate() {
            normal.add_block([index(n), index(m)], spread);
            gradient -= spread * drift_px[m];
        }
        normal.add_gradient(index(n), &gradient);
    }
}

/// Derivatives of a constraint by the unknowns it depends on.
type Slopes = Vec<(usize, Vector1<f64>)>;

/// A prior of one unknown: its deviation from the expected value, with 1 sigma.
struct Prior {
    unknown: usize,
    off: f64,
    sigma: f64,
}

const STEPS: usize = 15;
/// Two marks determine shift, rotation and scale of a view; its other parameters have priors.
const LEAST_MARKS: usize = 2;
/// A shorter step has converged: for px, mil and view parameters.
const CONVERGED_STEP: f64 = 1e-6;
/// Weight of the gauge constraints, far above the information of any observations, mil^-2.
const GAUGE_WEIGHT: f64 = 1e10;
/// Prior of each term of a camera's drift, 1 sigma per axis.
const DRIFT_PRIOR_PX: f64 = 1.0;

impl Problem<'_> {
    /// Adjusts the unknowns from a start. `None` if observations and priors together do not determine them.
    pub(super) fn adjust(&self, start: &State) -> Option<Adjusted> {
        let mut state = start.clone();
        for view in &mut state.views {
            *view = view.simplified(self.freedoms.view);
        }
        for n in (0..LENS).filter(|n| !self.freedoms.lens[*n]) {
            state.lens.terms[n] = 0.0;
        }
        for drift in &mut state.drift_px {
            drift[self.freedoms.drift..].fill(Vector2::zeros());
        }
        for _ in 0..STEPS {
            let step = self.solved(&state)?.step;
            state.advance(&step);
            if step.norm_squared() < CONVERGED_STEP.powi(2) {
                break;
            }
        }
        let covariance = self.solved(&state)?.covariance();
        let priors = self.priors(&state);
        Some(Adjusted {
            chi2_prior: priors.iter().map(|p| (p.off / p.sigma).powi(2)).sum(),
            determined: self.determined(&state, &priors, &covariance),
            covariance,
            state,
        })
    }

    /// Whether an unknown is fixed: not free, or part of a view with too few marks to determine it.
    fn is_fixed(&self, unknown: Unknown) -> bool {
        let is_determined = |pose: usize| self.cells[pose].len() >= LEAST_MARKS;
        let is_free = match unknown {
            Unknown::Lens(term) => self.freedoms.lens[term],
            Unknown::Mark(..) => self.freedoms.marks,
            Unknown::View(pose, n) => parameters_of(self.freedoms.view)[n] && is_determined(pose),
            Unknown::Drift(pose, term, _) => term < self.freedoms.drift && is_determined(pose),
        };
        !is_free
    }

    /// The Gauss-Newton step.
    fn solved(&self, state: &State) -> Option<LargeSolved> {
        let mut normal = Large::zero(state.unknowns());
        for (pose, cells) in self.cells.iter().enumerate() {
            for cell in cells {
                add_cell(&mut normal, state, pose, cell);
            }
        }
        for Prior {
            unknown,
            off,
            sigma,
        } in self.priors(state)
        {
            let weight = Matrix1::new(sigma.powi(-2));
            normal.add(
                &[(unknown, Vector1::new(1.0))],
                &Vector1::new(-off),
                &weight,
            );
        }
        for (row, off) in self.gauge(state) {
            let weight = Matrix1::new(GAUGE_WEIGHT);
            normal.add(&row, &Vector1::new(-off), &weight);
        }
        normal.solve(|n| self.is_fixed(state.unknown(n)))
    }

    /// Priors of the lens terms, the marks, the views and the drifts, in this order.
    fn priors(&self, state: &State) -> Vec<Prior> {
        let lens = (0..LENS).map(|n| Prior {
            unknown: n,
            off: state.lens.terms[n],
            sigma: self.lens_sigma_px,
        });
        let marks = self.marks.iter().enumerate().flat_map(|(mark, prior)| {
            let off = state.places[mark].vector() - prior.place.vector();
            [0, 1].map(|axis| Prior {
                unknown: mark_index(mark) + axis,
                off: off[axis],
                sigma: prior.sigma_mil[axis],
            })
        });
        let views = state.views.iter().enumerate().flat_map(|(pose, view)| {
            let sigmas = prior_sigmas(view).into_iter().enumerate();
            sigmas.filter_map(move |(n, sigma)| {
                Some(Prior {
                    unknown: state.view_index(pose) + n,
                    off: view.parameters[n],
                    sigma: sigma?,
                })
            })
        });
        let terms = state
            .drift_px
            .as_flattened()
            .iter()
            .flat_map(|px| [px.x, px.y]);
        let drifts = terms
            .zip(state.drift_index(0)..)
            .map(|(off, unknown)| Prior {
                unknown,
                off,
                sigma: DRIFT_PRIOR_PX,
            });
        lens.chain(marks).chain(views).chain(drifts).collect()
    }

    /// Constraints: the displacements of the measured marks from their priors have no common shift in x and y, rotation or scale. Marks
    /// are weighted by their prior variance, so that previously measured marks keep their position against marks that were only drawn.
    /// Each constraint is a unit vector over the unknowns, with its product with the displacements.
    fn gauge(&self, state: &State) -> Vec<(Slopes, f64)> {
        let measured = || self.marks.iter().enumerate().filter(|(_, m)| m.measured);
        let weight =
            |m: &MarkPrior| 2.0 / m.sigma_mil.map(|sigma| sigma.powi(2)).iter().sum::<f64>();
        let weights: f64 = measured().map(|(_, m)| weight(m)).sum();
        let sum: Vector2<f64> = measured().map(|(_, m)| m.place.vector() * weight(m)).sum();
        let middle = sum / weights.max(f64::MIN_POSITIVE);
        let moves: [fn(Vector2<f64>) -> Vector2<f64>; 4] = [
            |_| Vector2::x(),
            |_| Vector2::y(),
            |from_middle| Vector2::new(-from_middle.y, from_middle.x),
            |from_middle| from_middle,
        ];
        let row = |motion: fn(Vector2<f64>) -> Vector2<f64>| {
            let along =
                measured().map(|(n, m)| (n, m, motion(m.place.vector() - middle) * weight(m)));
            let norm = along.clone().map(|(.., v)| v.norm_squared()).sum::<f64>();
            let unit = along.map(|(n, m, v)| (n, m, v / norm.sqrt().max(1e-12)));
            let off = unit.clone().map(|(n, m, v)| {
                let displacement = state.places[n].vector() - m.place.vector();
                v.dot(&displacement)
            });
            let off: f64 = off.sum();
            let row = unit.flat_map(|(n, _, v)| {
                [0, 1].map(|axis| (mark_index(n) + axis, Vector1::new(v[axis])))
            });
            (row.collect(), off)
        };
        moves.into_iter().map(row).collect()
    }

    /// Number of determined parameters: each counts by the fraction of its prior variance that the observations removed, those of a view
    /// in full.
    fn determined(&self, state: &State, priors: &[Prior], covariance: &DMatrix<f64>) -> f64 {
        let views = (self.freedoms.view.parameters() * state.views.len()) as f64;
        let is_common = |n: usize| match state.unknown(n) {
            Unknown::View(..) => false,
            unknown => !self.is_fixed(unknown),
        };
        let common = priors.iter().filter(|prior| is_common(prior.unknown));
        let part = |prior: &Prior| {
            let share = covariance[(prior.unknown, prior.unknown)] / prior.sigma.powi(2);
            1.0 - share.min(1.0)
        };
        // The gauge removes four degrees of freedom of the marks.
        let gauge = if self.freedoms.marks { 4.0 } else { 0.0 };
        common.map(part).sum::<f64>() - gauge + views
    }
}
