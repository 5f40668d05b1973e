//! What a degree of the camera's temperature does to the view, as the marks of all moments tell it.

use crate::refine::view::STATES;
use nalgebra::{Cholesky, Const, Matrix4, SMatrix, Vector4};

/// The states that a degree changes: the first ones, shift x and y, stretch and turn.
pub const WARMED: usize = 4;
/// What is known beforehand of what a degree does, 1 sigma, px: cameras on balloons shift by a tenth of a pixel, and aluminium
/// stretches by 23e-6, 0.004 px.
const WARMTH_SIGMA_PX: [f64; WARMED] = [0.2, 0.2, 0.02, 0.02];

/// What a degree of the camera's temperature does to shift x and y, stretch and turn, px.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Warmth {
    pub px_per_degc: Vector4<f64>,
    pub covariance: Matrix4<f64>,
}

/// How a view answers to each coefficient of [`Warmth`].
pub type Answer = SMatrix<f64, STATES, WARMED>;

/// What so many degrees do to the view beside the walk.
pub fn warmed(degrees: f64) -> Answer {
    Answer::identity() * degrees
}

/// What the marks have said so far of the model and of the temperature's coefficients.
pub struct Evidence {
    pub likelihood: f64,
    pub information: Matrix4<f64>,
    pub gradient: Vector4<f64>,
}

impl Evidence {
    pub fn none() -> Self {
        Self {
            likelihood: 0.0,
            information: Matrix4::from_diagonal(&prior_information()),
            gradient: Vector4::zeros(),
        }
    }

    pub fn warmth(&self) -> Option<Warmth> {
        let root = self.information.cholesky()?;
        Some(Warmth {
            px_per_degc: root.solve(&self.gradient),
            covariance: root.inverse(),
        })
    }

    /// Logarithm of the likelihood but for a constant, whatever the coefficients are.
    pub fn total(&self) -> Option<f64> {
        let root = self.information.cholesky()?;
        let gained = self.gradient.dot(&root.solve(&self.gradient)) / 2.0;
        let prior: f64 = prior_information().iter().map(|p| p.ln() / 2.0).sum();
        let total = self.likelihood + gained + prior - log_root(&root);
        total.is_finite().then_some(total)
    }
}

fn prior_information() -> Vector4<f64> {
    Vector4::from(WARMTH_SIGMA_PX.map(|sigma| sigma.powi(-2)))
}

/// Logarithm of the square root of a determinant.
pub fn log_root<const N: usize>(root: &Cholesky<f64, Const<N>>) -> f64
where
    Const<N>: nalgebra::DimMin<Const<N>, Output = Const<N>>,
{
    let l = root.l_dirty();
    (0..N).map(|n| l[(n, n)].ln()).sum()
}
