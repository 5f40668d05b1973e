//! Pictures of the Sun on the plate with their truth, and whole flights of such pictures.
//!
//! A [`Scene`] contains everything that defines a picture; [`Scene::picture`] renders it to a [`Frame`](crate::frame::Frame) and states its
//! [`Truth`]. The same scene gives the same frame, bit for bit. [`RandomScenes`] draws scenes by condition,
//! [`RandomScenes::covered`] and [`RandomScenes::evenly_lit`] show the same camera without Sun,
//! [`FlightScenes`] follows a [`Trajectory`], [`DriftScenes`] the Sun as it drifts past a fixed gondola. Further parts: the gondola's side of the
//! link, [`controller`]; and the Earth's limb in another camera, [`earth`].
//!
//! # Rendering
//!
//! 1. The part of the sensor that the Sun reaches is sampled S x S times per pixel (S = 3). For each sub-sample,
//!    its place on the plate gives the disc's light there and the reflectance of the plate; edges are weighted by the
//!    fraction of the sub-sample behind them, so that sampling causes no displacement.
//! 2. One separable kernel blurs and integrates over the pixel. Coma and a ghost are further images of the same plate, each with its own
//!    shift and blur.
//! 3. On the sensor: leaks, vignetting, dust, gradients of stray light; smear along the columns, background, the step between the
//!    halves; then noise, digitisation, hot pixels.
//!
//! Positions are accurate to 0.001 px: `tests/simulation.rs` proves it.

mod blemish;
mod blur;
pub mod controller;
mod cover;
mod coverage;
mod disc;
mod drift;
pub mod earth;
mod flight;
mod glare;
mod gondola;
mod grid;
mod lamp;
pub mod moon;
pub mod navigation;
mod noise;
mod optics;
mod pieces;
mod prints;
mod random;
mod render;
mod scene;
pub mod sensors;
mod surface;
mod texture;
mod trajectory;

pub use blemish::Counts;
pub use cover::{Cover, Covers};
pub use drift::{DriftError, DriftScenes};
pub use flight::{Course, FlightScenes};
pub use gondola::Gondola;
pub use optics::Strengths;
pub use pieces::{Piece, Pieces};
pub use random::{Conditions, RandomScenes, SunInView};
pub use render::{SAMPLES_PER_PX, render_exact, render_oversampled};
pub use scene::{
    Blemishes, Coma, Depth, Dust, Extent, Ghost, Gradient, HotPixel, LIMB_DARKENING, Leak, LitMark,
    Noise, Picture, Readout, Scene, SceneError, Scratch, StrayLight, Sun, Sunspot, Surface, Truth,
    TruthOfSun, keystoned, scattered,
};
pub use trajectory::{MAX_SLEW_DEG_PER_S, Trajectory};

use crate::frame::{FrameInfo, SIMULATED_CAMERA};
use crate::units::Place;
use rand::SeedableRng;
use rand_xoshiro::Xoshiro256PlusPlus;
use std::time::Duration;

/// Exposure of a simulated frame.
pub const EXPOSURE: Duration = Duration::from_millis(15);

/// Angular radius of the Sun on 2013-09-21, the day of the HEROES flight: asin(695 700 km / distance), arcsec.
pub const SUN_RADIUS_ARCSEC: f64 = 955.59;

/// Place of simulated frames: float altitude above Fort Sumner, New Mexico.
pub const FORT_SUMNER: Place = Place {
    latitude_deg: 34.49,
    longitude_deg: -104.2218,
    height_m: 38_405.0,
};

/// Exposure data of a simulated frame, except for its time.
fn frame_info(number: u64) -> FrameInfo {
    FrameInfo {
        number: Some(number),
        exposure: Some(EXPOSURE),
        place: Some(FORT_SUMNER),
        camera: Some(SIMULATED_CAMERA.into()),
        ..FrameInfo::default()
    }
}

/// The random generator for everything that is drawn here: fast, and the same on every computer.
type Generator = Xoshiro256PlusPlus;

/// Purpose of a generator. Each purpose has its own random numbers, so that one more hot pixel changes nothing else.
#[derive(Debug, Clone, Copy)]
enum Purpose {
    Plate = 1,
    Blemishes,
    Sun,
    Noise,
    Path,
    Drift,
    Optics,
    Earth,
    Clouds,
    LimbBrightness,
    LimbHeight,
    Glare,
    Moon,
    Craters,
    Albedo,
    Stars,
    Lamp,
    Navigation,
    Covered,
    EvenLamp,
    Covers,
    Seas,
    NightSky,
    Sunlight,
    Front,
}

/// A seed for one purpose and one frame of a run.
fn derived_seed(seed: u64, purpose: Purpose, number: u64) -> u64 {
    // The odd constants of SplitMix64 (Steele, Lea and Flood 2014) keep neighbouring seeds apart.
    seed.wrapping_mul(0xbf58_476d_1ce4_e5b9)
        .wrapping_add(number.wrapping_mul(0x9e37_79b9_7f4a_7c15))
        .wrapping_add((purpose as u64).wrapping_mul(0x94d0_49bb_1331_11eb))
}

fn generator(seed: u64, purpose: Purpose, number: u64) -> Generator {
    Generator::seed_from_u64(derived_seed(seed, purpose, number))
}
