//! The Kalman filter for a Gaussian state of any fixed size, and Rauch, Tung and Striebel's smoother (1965).

use nalgebra::{Cholesky, Const, SMatrix, SVector};

/// Estimate of a state.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gaussian<const N: usize> {
    pub mean: SVector<f64, N>,
    pub covariance: SMatrix<f64, N, N>,
}

/// A linear step of the state in time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Step<const N: usize> {
    pub transition: SMatrix<f64, N, N>,
    /// Covariance of the process noise.
    pub noise: SMatrix<f64, N, N>,
}

/// Observed minus predicted, with its covariance: that of prediction plus observation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Innovation<const M: usize> {
    pub residual: SVector<f64, M>,
    pub covariance: SMatrix<f64, M, M>,
    pub likelihood: Likelihood,
}

/// Agreement of an observation with its prediction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Likelihood {
    /// The normalised innovation squared.
    pub chi2: f64,
    /// Natural logarithm of the determinant of that covariance up to a constant of the observation.
    pub log_determinant: f64,
}

impl Likelihood {
    /// Natural logarithm of the likelihood up to a constant, with chi^2 limited to `most_chi2`.
    pub fn log(&self, most_chi2: f64) -> f64 {
        -(self.chi2.min(most_chi2) + self.log_determinant) / 2.0
    }
}

/// The disturbance of a step estimated from all observations, times the inverse of the prediction's covariance: the auxiliary residual
/// of Harvey and Koopman (1992).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Disturbance<const N: usize> {
    pub residual: SVector<f64, N>,
    pub covariance: SMatrix<f64, N, N>,
}

impl<const N: usize> Gaussian<N> {
    pub fn new(mean: SVector<f64, N>, variances: &SVector<f64, N>) -> Self {
        let covariance = SMatrix::from_diagonal(variances);
        Self { mean, covariance }
    }

    /// The state after a step.
    pub fn predicted(&self, step: &Step<N>) -> Self {
        let Step { transition, noise } = step;
        Self {
            mean: transition * self.mean,
            covariance: transition * self.covariance * transition.transpose() + noise,
        }
    }

    /// Updates with an observation: observed minus predicted values, the derivatives of the prediction by the state, and the covariance
    /// of the observation's errors. Uses Joseph's form, which keeps the covariance positive. `None`, without a change, if the
    /// innovation's covariance is not positive.
    pub fn update<const M: usize>(
        &mut self,
        residual: &SVector<f64, M>,
        jacobian: &SMatrix<f64, M, N>,
        noise: &SMatrix<f64, M, M>,
    ) -> Option<Innovation<M>> {
        let across = self.covariance * jacobian.transpose();
        let covariance = jacobian * across + noise;
        let root = covariance.cholesky()?;
        let gain = root.solve(&across.transpose()).transpose();
        let kept = SMatrix::<f64, N, N>::identity() - gain * jacobian;
        let chi2 = residual.dot(&root.solve(residual));
        self.mean += gain * residual;
        self.covariance =
            symmetric(kept * self.covariance * kept.transpose() + gain * noise * gain.transpose());
        Some(Innovation {
            residual: *residual,
            covariance,
            likelihood: Likelihood {
                chi2,
                log_determinant: log_determinant(&root),
            },
        })
    }

    /// Updates with many observations at once by their normal equations at the mean: information (derivatives squared over variance),
    /// gradient (derivatives times residual over variance) and the residuals' chi^2. `None`, without a change, if a covariance is not
    /// positive.
    pub fn update_by_information(
        &mut self,
        information: &SMatrix<f64, N, N>,
        gradient: &SVector<f64, N>,
        chi2: f64,
    ) -> Option<Likelihood> {
        let before = self.covariance.cholesky()?;
        let root = (before.inverse() + information).cholesky()?;
        let moved = root.solve(gradient);
        self.mean += moved;
        self.covariance = root.inverse();
        Some(Likelihood {
            chi2: chi2 - gradient.dot(&moved),
            log_determinant: log_determinant(&before) + log_determinant(&root),
        })
    }

    /// Smooths this state with the smoothed state one step later. `None` if the predicted covariance is not positive.
    fn smoothed(&self, step: &Step<N>, later: &Self) -> Option<(Self, Disturbance<N>)> {
        let predicted = self.predicted(step);
        let inverse = predicted.covariance.cholesky()?.inverse();
        let gain = self.covariance * step.transition.transpose() * inverse;
        let (moved, learnt) = (
            later.mean - predicted.mean,
            later.covariance - predicted.covariance,
        );
        // As a sum of squares it stays positive even if the step's noise is many orders of magnitude above the state's covariance.
        let kept = SMatrix::<f64, N, N>::identity() - gain * step.transition;
        let noisy = later.covariance + step.noise;
        let smoothed = Self {
            mean: self.mean + gain * moved,
            covariance: symmetric(
                kept * self.covariance * kept.transpose() + gain * noisy * gain.transpose(),
            ),
        };
        let disturbance = Disturbance {
            residual: inverse * moved,
            covariance: -(inverse * learnt * inverse),
        };
        Some((smoothed, disturbance))
    }
}

fn symmetric<const N: usize>(matrix: SMatrix<f64, N, N>) -> SMatrix<f64, N, N> {
    (matrix + matrix.transpose()) / 2.0
}

fn log_determinant<const N: usize>(root: &Cholesky<f64, Const<N>>) -> f64 {
    let l = root.l_dirty();
    2.0 * (0..N).map(|n| l[(n, n)].ln()).sum::<f64>()
}

/// A state that evolves in steps, and may be observed at each moment.
pub trait Process<const N: usize> {
    fn moments(&self) -> usize;

    /// The state before any observation.
    fn initial(&self) -> Gaussian<N>;

    /// The step from the previous moment to this one, which is not the first; `None` if the state restarts.
    fn step(&self, moment: usize) -> Option<Step<N>>;

    /// Updates the predicted state with the observations of a moment, and returns the logarithm of their likelihood; `None` if the
    /// estimate fails.
    fn observe(&self, moment: usize, state: &mut Gaussian<N>) -> Option<f64>;
}

/// The predicted and updated state at a moment, from the state of the previous moment.
fn advanced<const N: usize>(
    process: &impl Process<N>,
    moment: usize,
    before: Option<&Gaussian<N>>,
) -> Option<(Gaussian<N>, f64)> {
    let step = before.and_then(|before| Some((before, process.step(moment)?)));
    let mut state = match step {
        Some((before, step)) => before.predicted(&step),
        None => process.initial(),
    };
    let likelihood = process.observe(moment, &mut state)?;
    Some((state, likelihood))
}

/// Filters all moments; passes on each filtered state, and returns the logarithm of the likelihood of all observations.
fn filter<const N: usize>(
    process: &impl Process<N>,
    mut each: impl FnMut(usize, &Gaussian<N>),
) -> Option<f64> {
    let (mut last, mut total) = (None, 0.0);
    for moment in 0..process.moments() {
        let (state, likelihood) = advanced(process, moment, last.as_ref())?;
        each(moment, &state);
        total += likelihood;
        last = Some(state);
    }
    total.is_finite().then_some(total)
}

/// Logarithm of the likelihood of all observations up to a constant. `None` if the estimate fails.
pub fn log_likelihood<const N: usize>(process: &impl Process<N>) -> Option<f64> {
    filter(process, |_, _| {})
}

/// Distance in moments between stored filtered states; the filter runs again between them, which needs less memory than storing all of them.
const BLOCK: usize = 256;

/// Estimates the state at each moment from all observations: passes them on from the last moment to the first, with the disturbance of
/// the step to the next one. `None` if the filter fails.
pub fn smooth<const N: usize>(
    process: &impl Process<N>,
    mut each: impl FnMut(usize, &Gaussian<N>, Option<&Disturbance<N>>),
) -> Option<()> {
    let mut starts = Vec::new();
    filter(process, |moment, state| {
        if moment % BLOCK == 0 {
            starts.push(*state);
        }
    })?;
    let mut later: Option<Gaussian<N>> = None;
    for (block, start) in starts.into_iter().enumerate().rev() {
        let first = block * BLOCK;
        let mut filtered = vec![start];
        for moment in first + 1..(first + BLOCK).min(process.moments()) {
            filtered.push(advanced(process, moment, filtered.last())?.0);
        }
        for (n, state) in filtered.iter().enumerate().rev() {
            let moment = first + n;
            // A restart, or a prediction without scatter, gives no information on the previous moment.
            let smoothed = later.and_then(|l| state.smoothed(&process.step(moment + 1)?, &l));
            let (state, disturbance) = smoothed.map_or((*state, None), |(s, d)| (s, Some(d)));
            each(moment, &state, disturbance.as_ref());
            later = Some(state);
        }
    }
    Some(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix1, Matrix2, Matrix2x1, RowVector2, Vector1, Vector2};

    /// Position and speed, the speed a random walk; positions observed with an error of 1.
    struct Walk {
        observed: Vec<Option<f64>>,
        restarted_at: Option<usize>,
    }

    impl Walk {
        fn new(moments: usize) -> Self {
            let place = |n: usize| {
                (n % 7 != 3).then(|| (n as f64 / 9.0).sin() * 20.0 + (n * 7919 % 11) as f64 / 5.0)
            };
            Self {
                observed: (0..moments).map(place).collect(),
                restarted_at: None,
            }
        }
    }

    const PLACE: RowVector2<f64> = RowVector2::new(1.0, 0.0);

    impl Process<2> for Walk {
        fn moments(&self) -> usize {
            self.observed.len()
        }

        fn initial(&self) -> Gaussian<2> {
            Gaussian::new(Vector2::zeros(), &Vector2::new(100.0, 4.0))
        }

        fn step(&self, moment: usize) -> Option<Step<2>> {
            (self.restarted_at != Some(moment)).then_some(Step {
                transition: Matrix2::new(1.0, 1.0, 0.0, 1.0),
                noise: Matrix2::new(0.1, 0.0, 0.0, 0.3),
            })
        }

        fn observe(&self, moment: usize, state: &mut Gaussian<2>) -> Option<f64> {
            let Some(place) = self.observed[moment] else {
                return Some(0.0);
            };
            let residual = Vector1::new(place - state.mean.x);
            let innovation = state.update(&residual, &PLACE, &Matrix1::new(1.0))?;
            Some(innovation.likelihood.log(f64::INFINITY))
        }
    }

    fn smoothed(walk: &Walk) -> Vec<(Gaussian<2>, Option<Disturbance<2>>)> {
        let mut states = Vec::new();
        smooth(walk, |_, state, disturbance| {
            states.push((*state, disturbance.copied()))
        })
        .unwrap();
        states.reverse();
        states
    }

    #[test]
    fn the_smoothed_states_are_those_of_least_squares_over_all_moments() {
        const MOMENTS: usize = 12;
        let walk = Walk::new(MOMENTS);
        let (mut information, mut gradient) =
            (SMatrix::<f64, 24, 24>::zeros(), SVector::<f64, 24>::zeros());
        let initial = walk.initial().covariance.try_inverse().unwrap();
        information.fixed_view_mut::<2, 2>(0, 0).copy_from(&initial);
        for n in 0..MOMENTS {
            if let Some(place) = walk.observed[n] {
                information[(2 * n, 2 * n)] += 1.0;
                gradient[2 * n] += place;
            }
            if n > 0 {
                let step = walk.step(n).unwrap();
                let mut row = SMatrix::<f64, 2, 24>::zeros();
                row.fixed_view_mut::<2, 2>(0, 2 * n)
                    .copy_from(&Matrix2::identity());
                row.fixed_view_mut::<2, 2>(0, 2 * n - 2)
                    .copy_from(&-step.transition);
                information += row.transpose() * step.noise.try_inverse().unwrap() * row;
            }
        }
        let covariance = information.try_inverse().unwrap();
        let means = covariance * gradient;
        for (n, (state, _)) in smoothed(&walk).iter().enumerate() {
            let whole = covariance.fixed_view::<2, 2>(2 * n, 2 * n);
            assert!(
                (state.mean - means.fixed_rows::<2>(2 * n)).norm() < 1e-9,
                "{n}"
            );
            assert!((state.covariance - whole).norm() < 1e-9, "{n}");
        }
    }

    #[test]
    fn one_block_and_several_give_the_same_states() {
        let walk = Walk::new(2 * BLOCK + 5);
        let several = smoothed(&walk);
        assert_eq!(several.len(), 2 * BLOCK + 5);
        let tail = Walk {
            observed: walk.observed[BLOCK - 100..BLOCK + 100].to_vec(),
            restarted_at: None,
        };
        let one = smoothed(&tail);
        let apart = several[BLOCK].0.mean - one[100].0.mean;
        assert!(apart.norm() < 1e-9, "{apart}");
    }

    #[test]
    fn an_update_by_information_is_that_by_innovation() {
        let start = Gaussian {
            mean: Vector2::new(1.0, -2.0),
            covariance: Matrix2::new(4.0, 1.0, 1.0, 2.0),
        };
        let jacobian = Matrix2::new(1.0, 0.5, -0.3, 2.0);
        let (noise, residual) = (Matrix2::new(0.5, 0.1, 0.1, 0.2), Vector2::new(0.7, -0.4));
        let inverse = noise.try_inverse().unwrap();
        let (mut one, mut other) = (start, start);
        let innovation = one.update(&residual, &jacobian, &noise).unwrap();
        let weighted = jacobian.transpose() * inverse;
        let chi2 = residual.dot(&(inverse * residual));
        let likelihood = other
            .update_by_information(&(weighted * jacobian), &(weighted * residual), chi2)
            .unwrap();
        assert!((one.mean - other.mean).norm() < 1e-12);
        assert!((one.covariance - other.covariance).norm() < 1e-12);
        assert!((innovation.likelihood.chi2 - likelihood.chi2).abs() < 1e-12);
        let constant = noise.determinant().ln();
        let apart = innovation.likelihood.log_determinant - constant - likelihood.log_determinant;
        assert!(apart.abs() < 1e-12);
    }

    #[test]
    fn precise_observations_of_a_state_hardly_known_leave_its_covariance_positive() {
        let mut state = Gaussian::new(Vector2::zeros(), &Vector2::new(1e4, 1e4));
        for n in 0..50 {
            let jacobian = Matrix2x1::new(1.0, 1.0 + 1e-3 * f64::from(n)).transpose();
            state
                .update(&Vector1::zeros(), &jacobian, &Matrix1::new(1e-4))
                .unwrap();
            assert!(state.covariance.cholesky().is_some(), "{n}");
        }
    }

    #[test]
    fn a_state_that_begins_anew_knows_nothing_of_before() {
        let mut walk = Walk::new(40);
        walk.restarted_at = Some(20);
        let all = smoothed(&walk);
        walk.observed.truncate(20);
        assert_eq!(all[..20], smoothed(&walk));
        assert!(all[19].1.is_none() && all[20].1.is_some());
    }

    #[test]
    fn the_disturbance_shows_where_the_state_was_pushed() {
        let mut walk = Walk::new(60);
        for n in 30..60 {
            walk.observed[n] = walk.observed[n].map(|place| place + 30.0);
        }
        let chi2 = |(_, d): &(Gaussian<2>, Option<Disturbance<2>>)| {
            let d = d.as_ref()?;
            Some(d.residual.x.powi(2) / d.covariance.m11)
        };
        let chi2: Vec<f64> = smoothed(&walk)
            .iter()
            .map(|s| chi2(s).unwrap_or(0.0))
            .collect();
        let worst = (0..chi2.len()).max_by(|a, b| chi2[*a].total_cmp(&chi2[*b]));
        assert_eq!(worst, Some(29));
    }
}
