//! The response of the camera to light: dark level, read noise, gain, hot pixels, vignetting, blur, and how blur and scale
//! depend on temperature.
//!
//! # Method
//! - `dark`: the median of every pixel over frames without light (dark frames, else the unilluminated parts of the Sun's frames) gives
//!   level and hot pixels; differences of successive frames give the read noise.
//! - `transfer`: photon transfer. The variance of the difference of two evenly illuminated frames increases with their light; the slope is
//!   the gain, DN per photo-electron. Without such frames, the grain of the Sun's disc between the marks is used.
//! - `flat`: decrease of the light from the middle, in evenly illuminated frames or else in the brightness of the Sun's disc.
//! - `focus`: the blur of the Sun's limb, and the dependence of blur and scale on the camera's temperature.
//!
//! `light` refuses illuminated dark frames, and flat frames that are not evenly illuminated, such as frames of the Sun.
//!
//! Undetermined values stay as in the instrument's file, with the reason.
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
pub use from_frames::{FromFrames, InputFiles, from_frames};
pub use light::WrongLight;
pub use report::page;
pub use shots::{Shot, Shots, SunShot, load, solve};
