//! The Moon in a picture: the centre of its whole disc, at any phase and orientation.
//!
//! # Processing of a frame
//! 1. [`Levels`]: sky level and noise from a raster of pixels. A frame that is bright all over is rejected.
//! 2. `patch`: connected bright pixels, and the outline of the largest patches. If none of them is the Moon, a higher level
//!    is tried.
//! 3. `disc`: of the circles through points of the outline, and the one through its eight extremities ("The Development of
//!    a Moon Sensor", 2005, section 3.3.1), the one on which most of the outline lies with the rest inside.
//! 4. `candidate`: its illumination by the Sun. The centroid of the light is displaced from the circle's centre towards the
//!    bright limb, more for a smaller lit fraction.
//! 5. `settle`: the sub-pixel lit limb (`limb`, `sector`). The circle is fitted with the blur, the phase and the side of
//!    the light; prior values (`known`) of radius, phase and side enter with their sigma. The limb is then read again along
//!    the fitted circle until it converges. Near full Moon, where the centroid of the light shows no side, all sides are
//!    tried: the whole edge (`misfit`) decides which is the best.
//! 6. `face`: the phase from the whole disc, if it is not known.
//! 7. `checks`: an object that is not the Moon, or not the expected one, is rejected.
//!
//! Internally, columns are rescaled so that the disc is round (`plane`).

mod candidate;
mod checks;
mod disc;
mod expected;
mod extremities;
mod face;
mod known;
mod light;
mod limb;
mod misfit;
mod overlay;
mod patch;
mod plane;
mod profile;
mod sector;
mod settle;
mod shading;

pub use expected::{Expected, Radius, below_horizon, is_night, local_from_camera, near_sun};
pub use light::{Levels, bright_dn};
pub use overlay::overlay;
pub use shading::{Shading, Sphere, towards_sun};

use crate::frame::Frame;
use crate::geometry::camera::CameraModel;
use crate::geometry::unit;
use crate::reasons::{at, moon as reasons};
use crate::units::{Estimate, Measured, SensorPx};
use candidate::Candidate;
use face::Face;
use known::{CONTRADICTION_SIGMAS, MOST_SATURATED};
use patch::{Patch, patches};
use plane::Plane;
use sector::Sectors;
use settle::{Settled, settle};

/// Minimum number of pixels of a patch.
const LEAST_PIXELS: usize = 20;
/// Number of patches that are tried, the largest first, if the radius is known; otherwise only the largest.
const MOST_PATCHES: usize = 4;
/// If no patch is the Moon, the next level above the sky is higher by this factor.
const NEXT_LEVEL: f64 = 2.0;
/// Maximum relative difference of the radius from the expected one.
const MOST_RADIUS_DEVIATION: f64 = 0.12;
/// Minimum visible share of the lit limb for a fine result.
const FINE_SHARE: f64 = 0.6;
/// A limb point agrees if it lies within so many of its sigmas of the circle.
const AGREEING_SIGMAS: f64 = 4.0;

/// Mapping of the sky to the pixels.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Optics {
    /// Ratio of the pixels' height to their width: the disc's horizontal half axis over its vertical one.
    Aspect(f64),
    Camera(CameraModel),
}

/// Settings for the solution of a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MoonSettings {
    pub shading: Shading,
    pub optics: Optics,
}

impl Default for MoonSettings {
    fn default() -> Self {
        Self {
            shading: Shading::LommelSeeliger,
            optics: Optics::Aspect(1.0),
        }
    }
}

impl MoonSettings {
    /// The plane of a disc near a position. A radius in px refers to an ellipse along the camera's axes; an angle is
    /// projected by its lens.
    fn plane(&self, expected: &Expected, at: SensorPx) -> Option<Plane> {
        match (&self.optics, expected.radius) {
            (Optics::Aspect(aspect), _) => Some(Plane::of_aspect(*aspect)),
            (Optics::Camera(camera), Some(Radius::Angle(_))) => Plane::of_camera(camera, at),
            (Optics::Camera(camera), _) => Some(Plane::of_aspect(camera.aspect())),
        }
    }
}

/// Stage at which the solution of a frame may end.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Stage {
    /// The ephemeris has no Moon above the horizon.
    Sky,
    Light,
    Detection,
    Limb,
    Checks,
}

impl Stage {
    pub fn name(self) -> &'static str {
        match self {
            Self::Sky => "sky",
            Self::Light => "light",
            Self::Detection => "detection",
            Self::Limb => "limb",
            Self::Checks => "checks",
        }
    }
}

/// The stage at which processing stopped, and the reason.
pub type Stopped = crate::reasons::Stopped<Stage>;

impl crate::reasons::Stage for Stage {
    fn name(self) -> &'static str {
        Self::name(self)
    }
}

/// Quality of a result.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Quality {
    /// Most of the lit limb is visible.
    Fine,
    /// The picture cuts the limb, much of it is saturated, or it contradicts the stated radius.
    Coarse,
}

impl Quality {
    pub fn name(self) -> &'static str {
        match self {
            Self::Fine => "fine",
            Self::Coarse => "coarse",
        }
    }
}

/// The Moon's disc.
#[derive(Debug, Clone, PartialEq)]
pub struct Disc {
    /// Centre of the whole disc.
    pub centre: Estimate<SensorPx>,
    /// Vertical half axis.
    pub radius_px: Measured,
    /// Horizontal half axis over the vertical one.
    pub aspect: f64,
    pub phase_angle_deg: Measured,
    /// Direction of the bright limb's middle in the picture, from +x towards +y.
    pub bright_limb_deg: f64,
    pub quality: Quality,
    /// Observed points of the limb, and whether each agrees with the circle.
    pub limb: Vec<(SensorPx, Agreement)>,
}

/// Whether a point of the limb lies on the circle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Agreement {
    Agrees,
    Departs,
}

impl Disc {
    /// The sunlit fraction of the disc. Its sigma is half of the change of the fraction between -1 and +1 sigma of the
    /// phase.
    pub fn lit(&self) -> Measured {
        let phase = self.phase_angle_deg;
        let lit = |off_deg: f64| shading::lit((phase.value + off_deg).clamp(0.0, 180.0));
        Measured::new(lit(0.0), (lit(-phase.sigma) - lit(phase.sigma)) / 2.0)
    }
}

/// The circle through eight extremities alone: centre, and vertical half axis, px.
///
/// # Errors
/// If the frame shows no light of sufficient size.
pub fn by_extremities(settings: &MoonSettings, frame: &Frame) -> Result<(SensorPx, f64), Stopped> {
    let levels = Levels::of(frame).map_err(at(Stage::Light))?;
    let level_dn = levels.least_dn();
    let largest = candidates(frame, levels.dark_dn + level_dn)?[0];
    let nothing = Expected::default();
    let candidate = Candidate::new(settings, &nothing, frame, &largest, &levels, level_dn);
    let candidate = candidate.ok_or_else(beyond_lens)?;
    let circle = extremities::circle(&candidate.outline.points);
    let circle =
        circle.ok_or_else(|| Stopped::new(Stage::Detection, reasons::NO_CIRCLE, 0.0, 0.0))?;
    Ok((candidate.view.plane.sensor(circle.centre), circle.radius))
}

/// Finds the Moon in a frame.
///
/// # Errors
/// If the frame shows no Moon: the stage, and the reason. With several lights, the reason for the largest.
pub fn solve(settings: &MoonSettings, frame: &Frame, expected: &Expected) -> Result<Disc, Stopped> {
    let levels = Levels::of(frame).map_err(at(Stage::Light))?;
    let mut level_dn = levels.least_dn();
    // Without a radius, a bright part of the Moon must not be taken for another light.
    let most = expected.radius.map_or(1, |_| MOST_PATCHES);
    let mut first = None;
    // Lights that the Sun's glare joins at one level are separate at a higher one.
    while levels.dark_dn + level_dn < levels.saturated_dn {
        match solve_at(settings, frame, expected, &levels, level_dn, most) {
            Ok(disc) => return Ok(disc),
            Err(stopped) => first = first.or(Some(stopped)),
        }
        level_dn *= NEXT_LEVEL;
    }
    Err(first.unwrap_or_else(|| no_moon(0)))
}

/// Finds the Moon among the largest `most` lights above the sky by `level_dn`, the largest first.
fn solve_at(
    settings: &MoonSettings,
    frame: &Frame,
    expected: &Expected,
    levels: &Levels,
    level_dn: f64,
    most: usize,
) -> Result<Disc, Stopped> {
    let mut first = None;
    let candidates = candidates(frame, levels.dark_dn + level_dn)?;
    for patch in candidates.iter().take(most) {
        let candidate = Candidate::new(settings, expected, frame, patch, levels, level_dn);
        match candidate.as_ref().map(solve_in) {
            Some(Ok(disc)) => return Ok(disc),
            Some(Err(stopped)) => first = first.or(Some(stopped)),
            None => {}
        }
    }
    Err(first.unwrap_or_else(beyond_lens))
}

/// The patches that may be the Moon: at least one, the largest first.
fn candidates(frame: &Frame, threshold_dn: f64) -> Result<Vec<Patch>, Stopped> {
    let mut found = patches(frame, threshold_dn).map_err(at(Stage::Detection))?;
    let largest = found.first().map_or(0, |patch| patch.pixels);
    found.retain(|patch| patch.pixels >= LEAST_PIXELS);
    match found.is_empty() {
        true => Err(no_moon(largest)),
        false => Ok(found),
    }
}

fn no_moon(largest: usize) -> Stopped {
    let limit = LEAST_PIXELS as f64;
    Stopped::new(Stage::Detection, reasons::NO_MOON, largest as f64, limit)
}

fn beyond_lens() -> Stopped {
    Stopped::new(Stage::Detection, reasons::BEYOND_LENS, 0.0, 0.0)
}

/// Finds the Moon in one patch.
fn solve_in(candidate: &Candidate) -> Result<Disc, Stopped> {
    let circle = disc::circle(&candidate.outline, &candidate.radii()).ok_or_else(|| {
        let points = candidate.outline.points.len() as f64;
        let expected = candidate.radius().map_or(0.0, |radius| radius.value);
        Stopped::new(Stage::Detection, reasons::NO_DISC, points, expected)
    })?;
    let settled = settle(candidate, &circle)?;
    let face = Face::seen(&candidate.view, settled.at());
    // The limb alone determines the phase poorly, but near the terminator its brightness is nearly the same at any phase.
    let by_face = || face.phase_rad(settled.at()[4]);
    let phase_rad = candidate.phase_rad().unwrap_or_else(by_face);
    checks::check(candidate, &settled, face.unlike(phase_rad.value))?;
    Ok(disc_of(candidate, &settled, &face, phase_rad))
}

fn disc_of(candidate: &Candidate, settled: &Settled, face: &Face, phase_rad: Measured) -> Disc {
    let Settled { found, limb, .. } = settled;
    let (at, plane) = (settled.at(), &candidate.view.plane);
    let centre = found.centre();
    let radius_px = found.fitted.measured(2);
    let is_of_size = candidate.radius().is_none_or(|stated| {
        let sigma = radius_px.sigma.hypot(stated.sigma);
        (radius_px.value - stated.value).abs() < CONTRADICTION_SIGMAS * sigma
    });
    let mut lit_at = *at;
    lit_at[4] = phase_rad.value;
    let lit_rad = 2.0 * limb::lit_rad(candidate.view.shading, &lit_at);
    let seen_rad = limb.seen() as f64 * Sectors::of_radius(at[2]).width_rad;
    let is_whole = seen_rad >= FINE_SHARE * lit_rad;
    // If the radius is not stated, a saturated disc may be any light that has spilled over.
    let saturated = match candidate.expected.radius {
        Some(_) => limb.saturated,
        None => limb.saturated.max(face.saturated),
    };
    let points = found.points.iter().map(|point| {
        let radius = at[2] + point.excess_px.value;
        let round = centre + unit(point.angle_rad) * radius;
        let off = point.excess_px.value.abs() / point.excess_px.sigma;
        let agreement = match off < AGREEING_SIGMAS {
            true => Agreement::Agrees,
            false => Agreement::Departs,
        };
        (plane.sensor(round), agreement)
    });
    Disc {
        centre: plane.estimate(centre, settled.covariance()),
        radius_px,
        aspect: plane.aspect(),
        phase_angle_deg: Measured::new(phase_rad.value.to_degrees(), phase_rad.sigma.to_degrees()),
        bright_limb_deg: plane.sensor_angle_rad(at[5]).to_degrees(),
        quality: match is_whole && is_of_size && saturated < MOST_SATURATED {
            true => Quality::Fine,
            false => Quality::Coarse,
        },
        limb: points.collect(),
    }
}
