//! Three-axis aspect of a balloon gondola from its cameras, above all from the Sun on a fiducial plate.
//!
//! # The modules
//!
//! A frame goes through the modules in one direction:
//!
//! ```text
//! camera -> Frame -> aspect::solve -> Solution -> pointing::offset -> Offset -> link (bytes to the controller)
//!                 \________________________\_________________\____-> archive (a FITS file)
//! ```
//!
//! Dependencies are acyclic: a module imports from those above it in this list only, and never from one in its own line:
//!
//! | modules | what they hold |
//! |---|---|
//! | [`units`] | positions on sensor and plate, measured values, the observer's place |
//! | `backoff` | waits between attempts |
//! | [`provenance`] | which program made a file: version, commit, hashes |
//! | [`log`] | the log on standard error, for which nothing waits |
//! | `kernels` | loops over pixels that are worked on side by side |
//! | [`geometry`], [`estimation`], [`frame`], [`clock`] | mappings between sensor and plate, cameras that see directions, attitudes; robust scale, least squares and Kalman filter; a picture and what is known of it; how well the clock is held |
//! | [`link`], [`report`], [`plate`], [`sky`], [`fits`] | packets and ports; drawing; the printed pattern; Sun and Moon; files |
//! | [`instrument`] | camera, plate, optics and mounting, read from TOML and checked |
//! | [`registration`] | fits a mapping to pairs of sensor and plate positions |
//! | [`limb`], [`fiducial`] | the disc's edge; the marks and their ids |
//! | [`aspect`], [`horizon`], [`moon`] | the pipeline on one page; the nadir by the edge of the Earth; the Moon's centre at any phase |
//! | [`pointing`] | from the Sun on the plate to an offset on the sky |
//! | [`navigation`] | the attitude by gyros between and beyond what cameras see |
//! | [`simulate`] | scenes, trajectories and the controller's side of the link, with truth |
//! | [`archive`], [`camera`] | how a frame survives; where frames come from |
//! | [`config`] | the parameter table |
//! | [`service`], [`calibrate`], [`refine`], [`accuracy`], [`preflight`] | threads, channels, bounds and overflow rules on one page; the instrument as it is; a flight's best aspect history; how near the truth the pipeline comes; whether all is ready to fly |
//! | [`cli`] | one small file per command; no logic |
//!
//! # Conventions
//!
//! Pixel (0, 0) is the **centre** of the first pixel; x grows along a row, y down the rows. Plate positions
//! are in mil (25.4 um) from the plate's centre. Rotation on the sensor is positive from +x towards +y.

pub mod accuracy;
pub mod archive;
pub mod aspect;
mod backoff;
pub mod calibrate;
pub mod camera;
pub mod cli;
pub mod clock;
pub mod config;
pub mod estimation;
pub mod fiducial;
pub mod fits;
pub mod frame;
pub mod geometry;
pub mod horizon;
pub mod instrument;
mod kernels;
pub mod limb;
pub mod link;
pub mod log;
pub mod moon;
pub mod navigation;
pub mod plate;
pub mod pointing;
pub mod preflight;
pub mod provenance;
pub mod refine;
pub mod registration;
pub mod report;
pub mod service;
pub mod simulate;
pub mod sky;
pub mod units;
