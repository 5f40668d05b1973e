//! Robust adjustment, which tolerates a third of bad frames.
//!
//! # Algorithm
//! 1. Each view starts from the mapping that most frames of its pose agree with ([`Pose`](super::observation::Pose)).
//! 2. Views and lens with every mark at its drawn position and robust weights. A mark's own
//!    displacement is the median of its residuals, so that outliers are found even before marks are adjusted.
//! 3. All unknowns, with weights from normalised residuals, until the weights converge. A frame that loses half of its
//!    observations is rejected as a whole.
//!
//! The scale of the residuals is from their own median, not from the sigmas that the frames state.

use super::adjust::{Adjusted, Cell, DRIFT, Freedoms, MarkPrior, Problem, State, drift_terms};
use crate::calibrate::numbers::median;
use crate::estimation::{MEDIAN_LENGTH_2D, QUARTILE_SIGMAS};
use nalgebra::{Matrix2, Vector2};

/// An observation of a mark in the adjustment.
#[derive(Debug, Clone, Copy)]
pub(super) struct Observation {
    pub frame: usize,
    pub pose: usize,
    /// Index into the marks.
    pub mark: usize,
    pub at_px: Vector2<f64>,
    /// Time within its pose, from -1 to 1; 0 if frames do not state their times.
    pub time: f64,
    pub covariance_px2: Matrix2<f64>,
    /// Robust weight, 0 (rejected) to 1.
    pub weight: f64,
}

impl Observation {
    /// Observed position with the drift of its pose removed.
    pub(super) fn at_rest(&self, state: &State) -> Vector2<f64> {
        self.at_px - state.drifted(self.pose, self.time)
    }
}

/// Observations and marks that are adjusted together.
#[derive(Debug, Clone)]
pub(super) struct Bundle {
    pub observations: Vec<Observation>,
    pub poses: usize,
    pub frames: usize,
    pub marks: Vec<MarkPrior>,
    pub lens_sigma_px: f64,
    /// Inflation of the stated variances of the observations.
    pub variance_factor: f64,
}

/// Residuals up to this many sigma have full weight, from the second value on none.
const FULL: f64 = 3.5;
const NONE: f64 = 6.0;
const ROUNDS: usize = 12;
/// The weights have converged if none changes by more than this.
const CONVERGED: f64 = 1e-3;
/// An observation is used for the scale if its residual keeps this part of its variance: the only observation of a mark has no residual.
const CHECKED: f64 = 0.2;
/// Fewest residuals that determine the scale.
const LEAST_CHECKED: usize = 20;
/// Weight of the stated sigmas against the residuals, in degrees of freedom.
const STATED_FREEDOM: f64 = 6.0;
/// Fewest observations for the median of a mark's residuals.
const ENOUGH: usize = 5;

/// Normalised residual of an observation.
#[derive(Debug, Clone, Copy)]
struct NormalisedResidual {
    size: f64,
    /// Whether other observations check it.
    checked: bool,
}

/// Weighted sums over the observations of a [`Cell`].
#[derive(Debug, Clone, Copy, Default)]
struct CellSums {
    weight: Matrix2<f64>,
    at_px: Vector2<f64>,
    terms: [Matrix2<f64>; DRIFT],
    squares: [[Matrix2<f64>; DRIFT]; DRIFT],
    products: [Vector2<f64>; DRIFT],
}

impl CellSums {
    fn add(&mut self, weight: Matrix2<f64>, o: &Observation) {
        self.weight += weight;
        self.at_px += weight * o.at_px;
        let terms = drift_terms(o.time);
        for (n, a) in terms.into_iter().enumerate() {
            self.terms[n] += weight * a;
            self.products[n] += weight * o.at_px * a;
            for (m, b) in terms.into_iter().enumerate() {
                self.squares[n][m] += weight * (a * b);
            }
        }
    }

    fn cell(&self, mark: usize) -> Option<Cell> {
        let inverse = self.weight.try_inverse()?;
        let at_px = inverse * self.at_px;
        let terms = self.terms.map(|term| inverse * term);
        let spread = |n: usize, m: usize| self.squares[n][m] - self.terms[n] * terms[m];
        Some(Cell {
            mark,
            at_px,
            terms,
            weight: self.weight,
            spread: std::array::from_fn(|n| std::array::from_fn(|m| spread(n, m))),
            trend: std::array::from_fn(|n| self.products[n] - self.terms[n] * at_px),
        })
    }
}

impl Bundle {
    /// The observations of every mark in every pose, combined into cells.
    pub(super) fn cells(&self) -> Vec<Vec<Cell>> {
        let mut sums = self.everywhere(|_, _| CellSums::default());
        for o in self.observations.iter().filter(|o| o.weight > 0.0) {
            let Some(inverse) = o.covariance_px2.try_inverse() else {
                continue;
            };
            let weight = inverse * (o.weight / self.variance_factor);
            sums[self.place(o)].add(weight, o);
        }
        let cell = |(mark, sum): (usize, &CellSums)| sum.cell(mark);
        sums.chunks(self.marks.len().max(1))
            .map(|pose| pose.iter().enumerate().filter_map(cell).collect())
            .collect()
    }

    /// A value for every mark in every pose, at index [`place`](Self::place).
    fn everywhere<T>(&self, value: impl Fn(usize, usize) -> T) -> Vec<T> {
        let marks = self.marks.len();
        let places = (0..self.poses).flat_map(|pose| (0..marks).map(move |mark| (pose, mark)));
        places.map(|(pose, mark)| value(pose, mark)).collect()
    }

    /// Index of the value for an observation's mark and pose.
    fn place(&self, o: &Observation) -> usize {
        o.pose * self.marks.len() + o.mark
    }

    /// Records which marks have an observation with weight.
    fn note_measured(&mut self) {
        self.marks.iter_mut().for_each(|m| m.measured = false);
        for o in self.observations.iter().filter(|o| o.weight > 0.0) {
            self.marks[o.mark].measured = true;
        }
    }

    /// Adjusts with the current weights.
    pub(super) fn adjust(&self, start: &State, freedoms: Freedoms) -> Option<Adjusted> {
        let cells = self.cells();
        let problem = Problem {
            cells: &cells,
            marks: &self.marks,
            lens_sigma_px: self.lens_sigma_px,
            freedoms,
        };
        problem.adjust(start)
    }

    /// Step 2: views and lens with drawn marks, and weights that the marks' own displacements do not affect.
    pub(super) fn by_drawing(&mut self, start: &State, freedoms: Freedoms) -> Option<State> {
        let freedoms = Freedoms {
            marks: false,
            ..freedoms
        };
        let mut state = start.clone();
        for _ in 0..ROUNDS {
            state = self.adjust(&state, freedoms)?.state;
            let off = self.off_mil(&state);
            let own = self.medians(&off);
            let pairs = self.observations.iter().zip(&off);
            let sizes: Vec<f64> = pairs.map(|(o, off)| (off - own[o.mark]).norm()).collect();
            let sigma = (median(sizes.iter().copied()) / MEDIAN_LENGTH_2D).max(1e-6);
            if self.reweigh(|n| sizes[n] / sigma) < CONVERGED {
                break;
            }
        }
        Some(state)
    }

    /// Distance of each observation from its predicted position, on the plate.
    fn off_mil(&self, state: &State) -> Vec<Vector2<f64>> {
        let back = self.everywhere(|pose, mark| {
            let p = state.predict(pose, mark);
            let back = p.place.try_inverse();
            (p.at_px, back.unwrap_or_else(Matrix2::zeros))
        });
        let off = |o: &Observation| {
            let (predicted, back) = back[self.place(o)];
            back * (o.at_rest(state) - predicted)
        };
        self.observations.iter().map(off).collect()
    }

    /// The median displacement of each mark that is observed often enough; zero for the others.
    fn medians(&self, off: &[Vector2<f64>]) -> Vec<Vector2<f64>> {
        let mut by_mark: Vec<Vec<Vector2<f64>>> = vec![Vec::new(); self.marks.len()];
        for (o, v) in self.observations.iter().zip(off) {
            by_mark[o.mark].push(*v);
        }
        let middle = |offs: &Vec<Vector2<f64>>| {
            if offs.len() < ENOUGH {
                return Vector2::zeros();
            }
            let axis = |n: usize| median(offs.iter().map(|v| v[n]));
            Vector2::new(axis(0), axis(1))
        };
        by_mark.iter().map(middle).collect()
    }

    /// Sets the weights from the size of each normalised residual; returns the largest change.
    fn reweigh(&mut self, size: impl Fn(usize) -> f64) -> f64 {
        let mut changed: f64 = 0.0;
        for (n, o) in self.observations.iter_mut().enumerate() {
            let weight = ((NONE - size(n)) / (NONE - FULL)).clamp(0.0, 1.0);
            changed = changed.max((weight - o.weight).abs());
            o.weight = weight;
        }
        changed
    }

    /// Step 3: all unknowns, until the weights converge.
    pub(super) fn in_full(&mut self, start: &State, freedoms: Freedoms) -> Option<Adjusted> {
        let mut state = start.clone();
        for _ in 0..ROUNDS {
            self.note_measured();
            let solved = self.adjust(&state, freedoms)?;
            state = solved.state.clone();
            let residuals = self.normalised_residuals(&solved);
            let scale = self.scale(&residuals);
            self.variance_factor *= scale.powi(2);
            let changed = self.reweigh(|n| residuals[n].size / scale);
            self.reject_frames(&residuals);
            if changed < CONVERGED && (scale - 1.0).abs() < 0.01 {
                break;
            }
        }
        self.note_measured();
        let solved = self.adjust(&state, freedoms)?;
        self.variance_factor *= self.reduced_chi2(&solved);
        self.adjust(&solved.state, freedoms)
    }

    /// Inflates the marks' prior sigma to match their displacements from the drawing; returns the factor.
    pub(super) fn inflate_priors(&mut self, solved: &Adjusted) -> f64 {
        let off = |(mark, prior): (usize, &MarkPrior)| {
            let covariance = solved.place_covariance(mark);
            let off = solved.state.places[mark].vector() - prior.place.vector();
            [0, 1].map(|n| {
                let variance = prior.sigma_mil[n].powi(2);
                off[n].abs() / (variance - covariance[(n, n)]).max(0.0).sqrt()
            })
        };
        let measured = self.marks.iter().enumerate().filter(|(_, m)| m.measured);
        let factor = (median(measured.flat_map(off)) / QUARTILE_SIGMAS).max(1.0);
        self.widen_priors(factor);
        factor
    }

    /// Multiplies the marks' prior sigmas.
    pub(super) fn widen_priors(&mut self, factor: f64) {
        let sigmas = self.marks.iter_mut().flat_map(|m| &mut m.sigma_mil);
        sigmas.for_each(|sigma| *sigma *= factor);
    }

    /// Ratio of the residuals to their sigmas; 1 if too few are checked.
    fn scale(&self, residuals: &[NormalisedResidual]) -> f64 {
        let pairs = self.observations.iter().zip(residuals);
        let checked = pairs.filter(|(o, residual)| o.weight > 0.0 && residual.checked);
        let sizes: Vec<f64> = checked.map(|(_, residual)| residual.size).collect();
        match sizes.len() < LEAST_CHECKED {
            true => 1.0,
            false => (median(sizes) / MEDIAN_LENGTH_2D).clamp(0.1, 10.0),
        }
    }

    /// Normalised residual of each observation: its variance excludes the part that the observation itself absorbs.
    fn normalised_residuals(&self, solved: &Adjusted) -> Vec<NormalisedResidual> {
        let of_mark = self.everywhere(|pose, mark| {
            let p = solved.state.predict(pose, mark);
            let spread = p.place * solved.place_covariance(mark) * p.place.transpose();
            (p.at_px, spread)
        });
        let normalised = |o: &Observation| {
            let (predicted, spread) = of_mark[self.place(o)];
            let stated = o.covariance_px2 * self.variance_factor;
            // An observation with weight has moved the mark towards itself; one without has not.
            let variance = stated - spread * (2.0 * o.weight - 1.0);
            let least = variance.symmetric_eigenvalues().min() / (stated.trace() / 2.0);
            let variance = match least > 2e-3 {
                true => variance,
                false => stated * 0.05,
            };
            let residual = o.at_rest(&solved.state) - predicted;
            let square = |inverse| residual.dot(&(inverse * residual)).max(0.0);
            NormalisedResidual {
                size: variance
                    .try_inverse()
                    .map_or(f64::INFINITY, |inverse| square(inverse).sqrt()),
                checked: least > CHECKED,
            }
        };
        self.observations.iter().map(normalised).collect()
    }

    /// A frame that has lost half of its observations or more loses the others too. Only observations checked by other frames count: the
    /// only observation of a mark has no residual.
    fn reject_frames(&mut self, residuals: &[NormalisedResidual]) {
        let mut counts = vec![(0_usize, 0.0_f64); self.frames];
        let pairs = self.observations.iter().zip(residuals);
        for (o, _) in pairs.filter(|(_, residual)| residual.checked) {
            counts[o.frame].0 += 1;
            counts[o.frame].1 += o.weight;
        }
        for o in &mut self.observations {
            let (count, kept) = counts[o.frame];
            if kept < 0.5 * count as f64 {
                o.weight = 0.0;
            }
        }
    }

    /// Weighted sum of squared residuals over their variances.
    pub(super) fn chi2(&self, state: &State) -> f64 {
        let predicted = self.everywhere(|pose, mark| state.predict(pose, mark).at_px);
        let one = |o: &Observation| {
            let residual = o.at_rest(state) - predicted[self.place(o)];
            let inverse = o
                .covariance_px2
                .try_inverse()
                .unwrap_or_else(Matrix2::zeros);
            o.weight * residual.dot(&(inverse * residual)) / self.variance_factor
        };
        self.observations.iter().map(one).sum()
    }

    /// Number of coordinates with weight.
    pub(super) fn coordinates(&self) -> f64 {
        2.0 * self.observations.iter().map(|o| o.weight).sum::<f64>()
    }

    /// Reduced chi-square, pulled towards 1 if there are few degrees of freedom.
    fn reduced_chi2(&self, solved: &Adjusted) -> f64 {
        let freedom = (self.coordinates() - solved.determined).max(0.0);
        (self.chi2(&solved.state) + STATED_FREEDOM) / (freedom + STATED_FREEDOM)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A cell loses only a constant: the chi-square of any position and drift by the cell differs from that by its observations by a constant.
    #[test]
    fn a_cell_stands_for_its_observations_whatever_their_shapes() {
        let seen = [
            (-1.0, 3.0, 0.5, 0.3),
            (0.2, 0.1, 2.0, 0.4),
            (0.9, 1.0, 1.0, -0.8),
        ];
        let observations = seen.map(|(time, xx, yy, xy)| {
            let observation = Observation {
                frame: 0,
                pose: 0,
                mark: 0,
                at_px: Vector2::new(time, 2.0 - time * time),
                time,
                covariance_px2: Matrix2::identity(),
                weight: 1.0,
            };
            (Matrix2::new(xx, xy, xy, yy), observation)
        });
        let mut sums = CellSums::default();
        for (weight, observation) in &observations {
            sums.add(*weight, observation);
        }
        let cell = sums.cell(0).unwrap();
        let one_by_one = |place: Vector2<f64>, drift: &[Vector2<f64>; DRIFT]| {
            let one = |(weight, o): &(Matrix2<f64>, Observation)| {
                let drifted: Vector2<f64> = (drift_terms(o.time).iter().zip(drift))
                    .map(|(term, px)| px * *term)
                    .sum();
                let residual = o.at_px - place - drifted;
                residual.dot(&(weight * residual))
            };
            observations.iter().map(one).sum::<f64>()
        };
        let by_cell = |place: Vector2<f64>, drift: &[Vector2<f64>; DRIFT]| {
            let drifted: Vector2<f64> = cell.terms.iter().zip(drift).map(|(t, px)| t * px).sum();
            let residual = cell.at_px - place - drifted;
            let mut chi2 = residual.dot(&(cell.weight * residual));
            for n in 0..DRIFT {
                chi2 -= 2.0 * cell.trend[n].dot(&drift[n]);
                for m in 0..DRIFT {
                    chi2 += drift[n].dot(&(cell.spread[n][m] * drift[m]));
                }
            }
            chi2
        };
        let lost = |place, drift: [f64; 2 * DRIFT]| {
            let drift = std::array::from_fn(|n| Vector2::new(drift[2 * n], drift[2 * n + 1]));
            one_by_one(place, &drift) - by_cell(place, &drift)
        };
        let constant = lost(Vector2::zeros(), [0.0; 6]);
        let moved = lost(Vector2::new(2.0, -1.0), [0.5, -2.0, 1.5, 0.3, -0.7, 2.5]);
        assert!((moved - constant).abs() < 1e-12, "{moved} {constant}");
        for (n, m) in [(0, 1), (1, 2), (0, 2)] {
            let skew = cell.spread[n][m] - cell.spread[m][n].transpose();
            assert!(skew.norm() < 1e-12, "{skew}");
        }
    }
}
