//! Estimation: robust scale and loss, and least squares for a few parameters.
//!
//! - `robust`: medians, scatter from medians, Tukey's loss, and the related constants of the normal distribution.
//! - `least_squares`: from residuals with their derivatives, a prior and a loss to parameters, covariance and scatter.
//! - `normal`: the normal equations of a few parameters or of many, for fits with their own steps.
//! - `spectrum`: the power spectral density of a motion.
//! - `schmidt`: the update of an error of many states, some of which are only considered.

mod least_squares;
mod normal;
mod robust;
mod schmidt;
pub mod spectrum;

pub use least_squares::{
    FitError, Fitted, LeastSquares, Linearised, Scale, regression, regression_by,
};
pub use normal::{Large, LargeSolved, Normal, Prior, Solved};
pub use robust::{
    CONTRADICTION_SIGMAS, Loss, MEDIAN_CHI2_2D, MEDIAN_LENGTH_2D, MEDIAN_SIGMA, QUARTILE_SIGMAS,
    SIGMA_PER_MEDIAN, TUKEY_SIGMAS, TUKEY_SIGMAS_2D, clipped_sigma, median, median_among,
    median_and_scatter, median_of_orders, order,
};
pub use schmidt::{Proposal, Role, ScaledRoot, symmetrise};
