//! Plate-to-telescope alignment: the boresight on the plate (its calibrated centre), the clocking and the plate's distance from the lens,
//! from the Sun's positions on the plate and the ephemeris.
//!
//! # Method
//! A [`SunObservation`] is one frame's Sun on the plate and the Sun in the sky. Given the telescope's pointing,
//! [`pointing::sun_on_plate`](crate::pointing::sun_on_plate) predicts the Sun's position on the plate; the unknowns are fitted to the
//! observed positions. In a drift scan the telescope's constant direction is an unknown, too.
//!
//! 1. `start`: plate and sky are similar plane figures to a part in fifty; the similarity of least median distance, over many
//!    pairs of observations, is right if more than half of the observations are.
//! 2. `fit`: least squares on the sphere, first with Tukey's loss, then on the observations
//!    that agree. Scatter beyond the observations' own sigmas is added to the noise of every observation; where successive
//!    residuals are correlated the covariance is inflated.
//!    This is done twice: directions on the plate are relative to the telescope or to the Sun; the observations decide, see
//!    [`Directions`](crate::instrument::Directions). If they do not distinguish the two, the instrument's convention is kept.
//! 3. The same with the plate mirrored, to find whether the data determine the side.
//! 4. `verdict`: each quantity is determined, with a sigma, or keeps the instrument's value.
//!
//! ```text
//! observation <- collect; observation, side, scatter <- start <- fit <- verdict <- calibration <- report <- from_frames
//! ```

mod calibration;
mod collect;
mod fit;
mod from_frames;
mod log;
mod observation;
mod report;
mod scatter;
mod side;
mod start;
mod verdict;

pub use calibration::{Mounting, calibrate};
pub use collect::{Frames, collect};
pub use fit::{MountingFit, Pointings, Unknown};
pub use from_frames::{FromFrames, from_frames};
pub use log::{AttitudeLog, PointingLog};
pub use observation::{MountingError, SunObservation};
pub use report::page;
pub(in crate::calibrate) use scatter::correlation_of;
