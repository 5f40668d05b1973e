//! The response of the camera to light: dark level, read noise, gain, hot pixels, vignetting, blur, and how blur and scale
//! depend on temperature.
//!
//! # Method
//! - `dark`: the median of every pixel over frames without light (dark frames, else the unlit parts of the Sun's frames) gives
//!   level and hot pixels; differences of frames that follow each other give the read noise.
//! - `transfer`: photon transfer. The variance of the difference of two evenly lit frames grows with their light by the gain, DN per
//!   photo-electron. Without such frames, the grain of the Sun's disc between the marks does instead.
//! - `flat`: how the light of evenly lit frames, else the brightness of the Sun's disc, falls off from the middle.
//! - `focus`: the blur of the Sun's limb, and how blur and scale depend on the camera's temperature.
//!
//! `light` refuses dark frames that something lights, and flat ones that are not evenly lit: frames of the Sun.
//!
//! Undetermined values stay the instrument's, with the reason.
//!
//! ```text
//! shots <- dark <- light, transfer, flat; shots <- focus; all <- calibration <- report <- from_frames
//! ```

mod calibration;
mod dark;
mod flat;
mod focus;
mod from_frames;
mod light;
mod report;
mod shots;
mod transfer;

pub use calibration::{CameraCalibration, CameraError, Inputs, calibrate};
pub use from_frames::{FromFrames, Given, from_frames};
pub use light::WrongLight;
pub use report::page;
pub use shots::{Shot, Shots, SunShot, load, solve};
