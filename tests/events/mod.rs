//! Photons are mapped to the Sun by the telescope's rotation, with calibrated sigmas, and the other contents of an event
//! list are preserved.
//!
//! The pointing is synthetic, so that the truth is a product of rotations. Event lists are written and read by cfitsio.

mod command;
mod copies;
mod flight;
pub mod image;
mod image_options;
mod intervals;
pub mod lists;
mod mistakes;
mod places;
