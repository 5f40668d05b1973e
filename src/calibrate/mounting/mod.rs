//! Plate-to-telescope alignment: the boresight on the plate (its calibrated centre), the clocking and the plate's distance
//! from the lens, from the Sun's places on the plate and the ephemeris.
//!
//! # Method
//! A [`SunObservation`] is one frame's Sun on the plate beside the Sun in the sky. Given where the telescope pointed,
//! [`pointing::sun_on_plate`](crate::pointing::sun_on_plate) says where the Sun should be; the unknowns are fitted to
//! the observed places. In a drift scan the telescope's one direction is unknown too.
//!
//! 1. `start`: to a part in fifty the chain is a similarity in the plane; the one of least median distance, over many
//!    pairs of observations, is right while more than half of the observations are.
//! 2. `fit`: least squares on the whole chain, first with Tukey's loss, then on the observations
//!    that agree. What they scatter beyond their own sigmas is added to the noise of every observation; where successive
//!    residuals are correlated the covariance is inflated.
//!    All this twice: directions on the plate count from the zenith at the Sun, as the pointing has it, or at the telescope, as on a
//!    plate rigid in the gondola; the observations decide, see [`Chain`].
//! 3. The same with the plate in a mirror, to find whether the data determine the side.
//! 4. `verdict`: each quantity is determined, with a sigma, or keeps the instrument's value.
//!
//! ```text
//! observation <- collect; observation, chain, scatter <- start <- fit <- verdict <- calibration <- report
//! ```

mod calibration;
mod chain;
mod collect;
mod fit;
mod log;
mod observation;
mod report;
mod scatter;
mod start;
mod verdict;

pub use calibration::{Mounting, calibrate};
pub use chain::Chain;
pub use collect::{Frames, collect};
pub use fit::{MountingFit, Pointings, Unknown};
pub use log::{LogError, PointingLog};
pub use observation::{MountingError, SunObservation};
pub use report::page;
