//! Photons are put on the Sun where the telescope's rotation says, as exactly as their sigmas say, and what else an event list holds stays.
//!
//! The pointing is made by hand, so that the truth is a product of rotations. Event lists are written and read by cfitsio.

mod command;
mod copies;
mod flight;
pub mod image;
mod image_options;
mod intervals;
pub mod lists;
mod mistakes;
mod places;
