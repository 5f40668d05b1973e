//! Three-axis aspect of a balloon gondola from its cameras, above all from the Sun on a fiducial plate.
//!
//! A lens projects the Sun onto a plate printed with cross-shaped fiducial marks, and a camera images the plate. From one frame
//! [`aspect::solve`] finds the Sun's centre in the coordinates of the plate; [`pointing::offset_of`] turns it into the offset of the
//! telescope from its target. The same library flies ([`service`]), calibrates ([`calibrate`]) and refines a recorded flight
//! ([`refine`]); the program `solaspect` is a thin layer over it.
//!
//! # A first frame
//!
//! ```
//! use solaspect::aspect::{self, Expected, Quality};
//! use solaspect::instrument;
//! use solaspect::simulate::{Conditions, RandomScenes};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! // Camera, plate, optics and mounting: a built-in instrument, or `Instrument::read` of a TOML file.
//! let instrument = instrument::builtin("demo")?;
//!
//! // A frame with known truth; `fits::read_frame` reads one from a file.
//! let scenes = RandomScenes::new(&instrument, &Conditions::of(&instrument), 1)?;
//! let picture = scenes.scene(0)?.picture()?;
//!
//! // What the ephemeris says of the Sun's size at that time, and no tracking prior from an earlier frame.
//! let expected = Expected::at("2013-09-21T18:00:00Z".parse()?);
//! let solution = aspect::solve(&picture.frame, &instrument, expected, None);
//!
//! assert_eq!(solution.quality, Quality::Fine);
//! let sun = solution.aspect.ok_or("no Sun")?.sun_plate; // mil, with covariance
//! let truth = picture.truth.sun.ok_or("no Sun")?.plate;
//! let error_arcsec = sun.position.distance(truth) * instrument.optics.arcsec_per_mil();
//! assert!(error_arcsec < 0.5); // a twentieth of a pixel
//! # Ok(())
//! # }
//! ```
//!
//! A frame that cannot be solved is not an error: its [`Solution`](aspect::Solution) holds what the earlier stages found, and
//! [`stopped`](aspect::Solution::stopped) has the stage, the reason, the measured value and the limit.
//!
//! The folder `examples/` has more: `solve_frame`, `own_gondola` (the traits [`camera::FrameSource`] and [`link::Controller`]) and `own_pipeline` (the stages of
//! [`aspect::Pipeline`], one by one).
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
//! | modules | content |
//! |---|---|
//! | [`units`] | positions on sensor and plate, measured values, the observer's place |
//! | `backoff`, `bounded` | waits between attempts; work with a time limit |
//! | `files` | files that are read whole: regular ones, of a bounded size, in a bounded time |
//! | [`provenance`] | which program made a file: version, commit, hashes |
//! | [`log`] | the log on standard error, which blocks no thread |
//! | `kernels` | vectorised loops over pixels |
//! | [`memory`] | memory that the program keeps |
//! | [`tables`] | rows of CSV tables and logs; bad ones are rejected |
//! | [`clock`] | times as other programs write them, to UTC; state of the computer's clock |
//! | [`geometry`], [`estimation`], [`frame`] | mappings between sensor and plate, direction cameras, attitudes; robust scale and least squares; a picture and the data on how it was taken |
//! | [`smoothing`] | Kalman filter and smoother; a path between frames |
//! | [`link`], [`report`], [`plate`], [`sky`], [`fits`] | packets and ports; drawing; the printed pattern; Sun and Moon; files |
//! | [`instrument`] | camera, plate, optics and mounting, read from TOML and checked |
//! | [`registration`] | fits a mapping to pairs of sensor and plate positions |
//! | [`limb`], [`fiducial`] | the disc's edge; the marks and their ids |
//! | [`aspect`], [`horizon`], [`moon`] | the pipeline on one page; the nadir from the Earth's limb; the Moon's centre at any phase |
//! | [`pointing`] | from the Sun on the plate to an offset on the sky |
//! | [`record`] | the numbers of a solved frame: each once, with its names in every form |
//! | [`navigation`] | inertial navigation: the attitude between and beyond the frames |
//! | [`simulate`] | scenes and trajectories with truth, controller emulator |
//! | [`columns`] | tables by the declaration of their columns: FITS, CSV, the manual |
//! | [`pointing_history`] | where the telescope pointed, as a function of time |
//! | [`archive`], [`camera`] | files on disks; sources of frames |
//! | [`observe`] | one pass over frames: journals, shards, copies, files that cannot be read |
//! | [`events`] | positions of photons on the Sun, by a refined flight's pointing |
//! | [`film`] | a film of where the telescope pointed on the Sun |
//! | [`output`] | outputs of a flight for other programs: JSON lines, NMEA sentences, CCSDS space packets |
//! | [`config`] | the parameter table |
//! | [`commands`] | the ground's commands in flight, their settings, and words for all of it |
//! | [`plan`] | the flight to be flown: the configuration with the files that it names, checked |
//! | [`calibrate`], [`accuracy`] | measuring the instrument; errors on simulated frames |
//! | [`service`], `console`, [`refine`] | threads, channels, bounds and overflow rules on one page; a flight in a browser (feature `console`); the best aspect history of a flight |
//! | [`preflight`], [`demo`] | checks before a flight; the whole system with nothing attached |
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
mod bounded;
pub mod calibrate;
pub mod camera;
#[warn(clippy::too_many_lines)]
pub mod cli;
pub mod clock;
pub mod columns;
pub mod commands;
#[warn(clippy::too_many_lines)]
pub mod config;
#[cfg(feature = "console")]
pub mod console;
pub mod demo;
pub mod estimation;
pub mod events;
pub mod fiducial;
mod files;
#[warn(clippy::too_many_lines)]
pub mod film;
pub mod fits;
pub mod frame;
pub mod geometry;
pub mod horizon;
pub mod instrument;
mod kernels;
pub mod limb;
pub mod link;
pub mod log;
pub mod memory;
pub mod moon;
pub mod navigation;
pub mod observe;
pub mod output;
#[warn(clippy::too_many_lines)]
pub mod plan;
pub mod plate;
pub mod plate_check;
pub mod plate_design;
pub mod pointing;
pub mod pointing_history;
#[warn(clippy::too_many_lines)]
pub mod preflight;
pub mod provenance;
pub mod reasons;
pub mod record;
pub mod refine;
pub mod registration;
pub mod report;
#[warn(clippy::too_many_lines)]
pub mod service;
pub mod simulate;
pub mod sky;
pub mod smoothing;
pub mod tables;
pub mod units;
