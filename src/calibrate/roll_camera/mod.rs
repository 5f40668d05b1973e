//! How a camera that sees the horizon sits in the body that carries it: `camera.body_from_camera`.
//!
//! A [`HorizonObservation`] is one frame's nadir in the camera's axes beside what is known of it in the body's:
//! - all of it, where roll and pitch of the body are known;
//! - its angle from the Sun, where a telescope on the same body saw the Sun at the time: 90 deg and the Sun's elevation. The telescope's
//!   boresight is then the body's forward axis. One angle says nothing of the turn about the Sun's direction; the turn shows as the Sun moves
//!   sideways over the plate and the body rolls.
//!
//! The turn of least squares has the residuals' own scatter in its covariance, and the error that all frames of a flight share: the shape of
//! its limb and the camera's height.
//!
//! ```text
//! observation <- fit <- report <- from_frames; observation <- collect <- from_frames
//! ```

mod collect;
mod fit;
mod from_frames;
mod observation;
mod report;

pub use collect::{Horizons, collect, with_attitude, with_sun};
pub use fit::{LIMIT_DEG, Turn, TurnError, fit};
pub use from_frames::{FromFrames, Reference, from_frames};
pub use observation::{Horizon, HorizonObservation, Known};
pub use report::NAME;
