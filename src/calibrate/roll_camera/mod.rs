//! Orientation of a camera that sees the horizon in the body that carries it: `camera.body_from_camera`.
//!
//! A [`HorizonObservation`] is one frame's nadir in the camera's axes and its reference in the body's:
//! - the nadir itself, if roll and pitch of the body are known;
//! - its angle from the Sun, if a telescope on the same body saw the Sun at the time: 90 deg plus the Sun's elevation. The telescope's
//!   boresight is then the body's forward axis. One angle does not determine the rotation about the Sun's direction; this becomes observable
//!   as the Sun moves sideways over the plate and the body rolls.
//!
//! The covariance of the least-squares rotation includes the residuals' own scatter, and the error shared by all frames of a flight: the
//! shape of the limb and the camera's height.
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
