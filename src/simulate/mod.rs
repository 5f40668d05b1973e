//! Pictures of the Sun on the plate with the truth beside them, and whole flights of such pictures.
//!
//! A [`Scene`] is everything a picture consists of; [`Scene::picture`] renders it to a [`Frame`](crate::frame::Frame) and states its
//! [`Truth`]. The same scene gives the same frame, bit for bit. [`RandomScenes`] draws scenes by condition,
//! [`RandomScenes::covered`] and [`RandomScenes::evenly_lit`] show the same camera without Sun,
//! [`FlightScenes`] follows a [`Trajectory`], [`DriftScenes`] the Sun past a gondola that stands still. Beside them the gondola's side of the link: [`controller`];
//! and what another camera sees, the Earth's limb: [`earth`].
//!
//! # How a picture is made
//!
//! 1. The part of the sensor that the Sun reaches is sampled S x S times per pixel (S = 3). Each sub-sample looks up
//!    its place on the plate, takes the disc's light there and what the plate returns of it; edges count by the
//!    share of the sub-sample behind them, so that sampling moves nothing.
//! 2. One separable kernel blurs and integrates over the pixel. Coma and a ghost are further images of the same plate, each with its
//!    shift and blur.
//! 3. On the sensor: leaks, vignetting, dust, gradients of stray light; smear along the columns, background, the step between the
//!    halves; then noise, digitising, hot pixels.
//!
//! Positions are true to 0.001 px: `tests/simulation.rs` holds the proof.

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

/// Where simulated frames are taken: float altitude above Fort Sumner, New Mexico.
pub const FORT_SUMNER: Place = Place {
    latitude_deg: 34.49,
    longitude_deg: -104.2218,
    height_m: 38_405.0,
};

/// Facts of a simulated frame, except for its time.
fn frame_info(number: u64) -> FrameInfo {
    FrameInfo {
        number: Some(number),
        exposure: Some(EXPOSURE),
        place: Some(FORT_SUMNER),
        camera: Some(SIMULATED_CAMERA.into()),
        ..FrameInfo::default()
    }
}

/// The generator behind everything that is drawn at random here: fast, and the same on every machine.
type Generator = Xoshiro256PlusPlus;

/// Purpose of a generator. Each purpose has its own numbers, so that one more hot pixel moves nothing else.
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
