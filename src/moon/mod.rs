//! The Moon in a picture: the centre of its whole disc, whatever its phase and however it is turned.
//!
//! # The way of a frame
//! 1. [`Levels`]: sky and noise by a raster of pixels. A frame that is bright all over is refused.
//! 2. `patch`: bright pixels that touch, and the outline of the largest ones. Where none of them is the
//!    Moon, and its radius is known, those of a higher level.
//! 3. `disc`: of the circles through points of the outline, and the one through its eight extremities ("The Development of a Moon Sensor", 2005,
//!    section 3.3.1), the one on which most of the outline lies with the rest inside.
//! 4. How the Sun lights it: the middle of the light lies off the circle's centre towards the bright limb, the further the less is lit.
//! 5. `limb`: the lit limb to a part of a pixel. The circle is fitted with the blur, the phase and the side of the light; what is known of
//!    radius, phase and side takes part with its sigma. Then the limb is read anew along that circle, until it stays.
//! 6. `checks`: what is no Moon, or not the one that is expected, is refused.
//!
//! Inside, columns are drawn together so that the disc is round (`plane`).

mod checks;
mod disc;
mod expected;
mod extremities;
mod light;
mod limb;
mod overlay;
mod patch;
mod plane;
mod profile;
mod shading;

pub use expected::{Expected, Radius, below_horizon, is_night, local_from_camera, near_sun};
pub use light::{Levels, bright_dn};
pub use overlay::overlay;
pub use shading::{Shading, Sphere, towards_sun};

use crate::frame::Frame;
use crate::geometry::Circle;
use crate::geometry::camera::Camera;
use crate::reasons::{at, moon as reasons};
use crate::units::{Estimate, Measured, SensorPx};
use limb::{Contradiction, Known, Limb, LimbFit};
use patch::{Outline, Patch, patches};
use plane::Plane;
use std::f64::consts::PI;
use std::ops::Range;

/// A patch of fewer pixels is no Moon, nor is one of a smaller radius, px.
const LEAST_PIXELS: usize = 20;
const LEAST_RADIUS_PX: f64 = 4.0;
/// So many patches are looked at, the largest first, where the radius is known; else the largest alone.
const MOST_PATCHES: usize = 4;
/// Where no light is the Moon, those are looked at that stand so many times higher above the sky.
const NEXT_LEVEL: f64 = 2.0;
/// A radius that differs by more from the expected one is another thing's.
const MOST_RADIUS_DEVIATION: f64 = 0.12;
/// A radius that the picture contradicts by so many sigmas and so much, relative to it, is known only this well, 1 sigma relative to it.
const CONTRADICTION_SIGMAS: f64 = 5.0;
const CONTRADICTION: f64 = 0.015;
const LOOSE_RADIUS: f64 = 0.06;
/// Fewer sectors of the limb make no circle.
const LEAST_SECTORS: usize = 6;
/// The limb is read anew while the circle or the blur moves by more, or the light turns by more, so often at most.
const SETTLED_PX: f64 = 0.1;
const SETTLED_RAD: f64 = 0.08;
const MOST_ROUNDS: usize = 8;
/// Phase and side of the light by its middle, rad: 1 sigma of a whole disc, and of one that the picture cuts.
const BY_MIDDLE_RAD: f64 = 0.2;
const BY_CUT_MIDDLE_RAD: f64 = 0.6;
/// Where more of the lit limb is saturated its radius is not the Moon's: light has spilled by about so much.
const MOST_SATURATED: f64 = 0.2;
const SPILLED_PX: f64 = 1.5;
/// A find is fine where so much of the lit limb is seen.
const FINE_SHARE: f64 = 0.6;
/// A limb point agrees that lies within so many of its sigmas of the circle.
const AGREEING_SIGMAS: f64 = 4.0;

/// How pixels see the sky.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Optics {
    /// Pixels so many times as high as wide: the disc's horizontal half axis over its vertical one.
    Aspect(f64),
    Camera(Camera),
}

/// How a frame is looked at.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Settings {
    pub shading: Shading,
    pub optics: Optics,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            shading: Shading::LommelSeeliger,
            optics: Optics::Aspect(1.0),
        }
    }
}

impl Settings {
    /// The plane of a disc near a place. A radius in px is that of an ellipse with the camera's axes; an angle is projected by its lens.
    fn plane(&self, expected: &Expected, at: SensorPx) -> Option<Plane> {
        match (&self.optics, expected.radius) {
            (Optics::Aspect(aspect), _) => Some(Plane::of_aspect(*aspect)),
            (Optics::Camera(camera), Some(Radius::Angle(_))) => Plane::of_camera(camera, at),
            (Optics::Camera(camera), _) => Some(Plane::of_aspect(camera.aspect())),
        }
    }
}

/// Where the solution of a frame may end.
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

/// The stage that went no further, and why.
pub type Stopped = crate::reasons::Stopped<Stage>;

impl crate::reasons::Stage for Stage {
    fn name(self) -> &'static str {
        Self::name(self)
    }
}

/// How good a find is.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Quality {
    /// Most of the lit limb is seen.
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
    /// Of the whole disc.
    pub centre: Estimate<SensorPx>,
    /// Vertical half axis.
    pub radius_px: Measured,
    /// Horizontal half axis over the vertical one.
    pub aspect: f64,
    pub phase_angle_deg: f64,
    /// The middle of the bright limb in the picture, from +x towards +y.
    pub bright_limb_deg: f64,
    pub quality: Quality,
    /// Where the limb was seen, and whether it agrees with the circle.
    pub limb: Vec<(SensorPx, Agreement)>,
}

/// Whether a point of the limb lies on the circle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Agreement {
    Agrees,
    Departs,
}

impl Disc {
    /// The share of the disc that the Sun shines on.
    pub fn lit(&self) -> f64 {
        shading::lit(self.phase_angle_deg)
    }
}

/// The circle by eight extremities alone: centre, and vertical half axis, px.
///
/// # Errors
/// A frame that shows no light of some size.
pub fn by_extremities(settings: &Settings, frame: &Frame) -> Result<(SensorPx, f64), Stopped> {
    let levels = Levels::of(frame).map_err(at(Stage::Light))?;
    let level_dn = levels.least_dn();
    let largest = candidates(frame, levels.dark_dn + level_dn)?[0];
    let nothing = Expected::default();
    let candidate = Candidate::new(settings, &nothing, frame, &largest, &levels, level_dn);
    let candidate = candidate.ok_or_else(beyond_lens)?;
    let circle = extremities::circle(&candidate.outline.points);
    let circle =
        circle.ok_or_else(|| Stopped::new(Stage::Detection, reasons::NO_CIRCLE, 0.0, 0.0))?;
    Ok((candidate.plane.sensor(circle.centre), circle.radius))
}

/// Finds the Moon in a frame.
///
/// # Errors
/// Where the frame shows none: the stage, and why. Of several lights, the reason of the largest.
pub fn solve(settings: &Settings, frame: &Frame, expected: &Expected) -> Result<Disc, Stopped> {
    let levels = Levels::of(frame).map_err(at(Stage::Light))?;
    let mut level_dn = levels.least_dn();
    if expected.radius.is_none() {
        // A crater beyond the terminator, or a bright part of the Moon, may pass for all of it.
        return solve_at(settings, frame, expected, &levels, level_dn, 1);
    }
    let mut first = None;
    // What the Sun's glare joins at one level lies apart at a higher one.
    while levels.dark_dn + level_dn < levels.saturated_dn {
        match solve_at(settings, frame, expected, &levels, level_dn, MOST_PATCHES) {
            Ok(disc) => return Ok(disc),
            Err(stopped) => first = first.or(Some(stopped)),
        }
        level_dn *= NEXT_LEVEL;
    }
    Err(first.unwrap_or_else(|| no_moon(0)))
}

/// Finds the Moon among so many of the lights that stand by some DN above the sky, the largest first.
fn solve_at(
    settings: &Settings,
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
        match candidate.map(|candidate| candidate.solve(frame, levels)) {
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

/// A light that may be the Moon.
struct Candidate<'a> {
    settings: &'a Settings,
    expected: &'a Expected,
    plane: Plane,
    /// In round px.
    outline: Outline,
}

impl<'a> Candidate<'a> {
    /// `None` beyond the limit of the lens.
    fn new(
        settings: &'a Settings,
        expected: &'a Expected,
        frame: &Frame,
        patch: &Patch,
        levels: &Levels,
        level_dn: f64,
    ) -> Option<Self> {
        let outline = Outline::of(frame, patch, levels, level_dn);
        let plane = settings.plane(expected, outline.middle.into())?;
        Some(Self {
            settings,
            expected,
            plane,
            outline: outline.seen_by(|at| plane.round(at.x, at.y)),
        })
    }

    fn solve(&self, frame: &Frame, levels: &Levels) -> Result<Disc, Stopped> {
        let circle = disc::circle(&self.outline, &self.radii(frame)).ok_or_else(|| {
            let expected = self.radius().map_or(0.0, |radius| radius.value);
            Stopped::new(
                Stage::Detection,
                reasons::NO_DISC,
                self.outline.points.len() as f64,
                expected,
            )
        })?;
        let mut known = self.known(&circle);
        let mut at = limb::begin(&circle, &known);
        for round in 1.. {
            let limb = Limb::read(frame, &self.plane, at, levels, self.settings.shading, known);
            let loose = known.loosened(limb.saturated);
            if loose != known {
                known = loose;
                continue;
            }
            let found = fit(&limb)?;
            let step = found.fitted.parameters - at;
            let is_settled = step.fixed_rows::<4>(0).amax() < SETTLED_PX
                && step.fixed_rows::<2>(4).amax() < SETTLED_RAD;
            at = found.fitted.parameters;
            let loose = known.contradicted(found.radius_contradiction);
            if is_settled && loose != known {
                known = loose;
                continue;
            }
            if is_settled || round == MOST_ROUNDS {
                checks::check(self, frame, levels, &found, &limb)?;
                return Ok(self.disc(&found, &limb));
            }
        }
        Err(Stopped::new(Stage::Limb, reasons::NO_FIT, 0.0, 0.0))
    }

    /// The radius that is expected, round px.
    fn radius(&self) -> Option<Measured> {
        match self.expected.radius? {
            Radius::Pixels(radius) => Some(radius),
            Radius::Angle(angle) => {
                let scale = self.plane.px_per_rad?;
                Some(Measured::new(
                    angle.value.tan() * scale,
                    angle.sigma * scale,
                ))
            }
        }
    }

    fn radii(&self, frame: &Frame) -> Range<f64> {
        match self.radius() {
            Some(radius) => {
                let most = MOST_RADIUS_DEVIATION;
                radius.value * (1.0 - most)..radius.value * (1.0 + most)
            }
            None => LEAST_RADIUS_PX..(frame.width() + frame.height()) as f64,
        }
    }

    /// What is known before the limb is read: by the ephemeris, else by where the light is.
    fn known(&self, circle: &Circle) -> Known {
        let off = self.outline.middle - circle.centre;
        let sigma = match self.outline.is_cut {
            true => BY_CUT_MIDDLE_RAD,
            false => BY_MIDDLE_RAD,
        };
        let radians = |deg: Measured| Measured::new(deg.value.to_radians(), deg.sigma.to_radians());
        let phase = self.expected.phase_angle_deg.map(radians);
        let side = self
            .expected
            .bright_limb_deg
            .map(radians)
            .map(|known| Measured::new(self.plane.round_angle_rad(known.value), known.sigma));
        Known {
            radius: self.radius(),
            phase_rad: phase
                .unwrap_or_else(|| Measured::new(self.sphere_by_middle(circle).phase_rad(), sigma)),
            bright_limb_rad: side.unwrap_or(Measured::new(off.y.atan2(off.x), sigma)),
        }
    }

    /// The sphere whose light's middle lies as far off.
    fn sphere_by_middle(&self, circle: &Circle) -> Sphere {
        let off = (self.outline.middle - circle.centre).norm() / circle.radius;
        Sphere::of_offset(self.settings.shading, off)
    }

    /// The area of the light, in that of a disc.
    fn light_area(&self, circle: &Circle) -> f64 {
        let disc_px = PI * circle.radius.powi(2) * self.plane.sensor_area();
        self.outline.light_px as f64 / disc_px
    }

    fn disc(&self, found: &LimbFit, limb: &Limb) -> Disc {
        let at = &found.fitted.parameters;
        let centre = at.fixed_rows::<2>(0).into_owned();
        let covariance = found
            .fitted
            .covariance
            .fixed_view::<2, 2>(0, 0)
            .into_owned();
        let is_whole = limb.seen() as f64 >= FINE_SHARE * limb.lit as f64;
        let radius_px = found.fitted.measured(2);
        let is_of_size = self.radius().is_none_or(|stated| {
            let sigma = radius_px.sigma.hypot(stated.sigma);
            (radius_px.value - stated.value).abs() < CONTRADICTION_SIGMAS * sigma
        });
        let points = found.points.iter().map(|point| {
            let (sin, cos) = point.angle_rad.sin_cos();
            let radius = at[2] + point.excess_px.value;
            let round = centre + nalgebra::Vector2::new(cos, sin) * radius;
            let off = point.excess_px.value.abs() / point.excess_px.sigma;
            let agreement = match off < AGREEING_SIGMAS {
                true => Agreement::Agrees,
                false => Agreement::Departs,
            };
            (self.plane.sensor(round), agreement)
        });
        Disc {
            centre: self.plane.estimate(centre, covariance),
            radius_px,
            aspect: self.plane.aspect(),
            phase_angle_deg: at[4].to_degrees().abs(),
            bright_limb_deg: self.plane.sensor_angle_rad(at[5]).to_degrees(),
            quality: match is_whole && is_of_size && limb.saturated < MOST_SATURATED {
                true => Quality::Fine,
                false => Quality::Coarse,
            },
            limb: points.collect(),
        }
    }
}

impl Known {
    /// The same where the picture shows another radius: then that is told by the picture, within what is allowed.
    fn contradicted(self, by: Option<Contradiction>) -> Self {
        let loose = |radius: Measured| {
            let sigma = LOOSE_RADIUS * radius.value;
            Measured::new(radius.value, radius.sigma.max(sigma))
        };
        let is_other = |radius: Measured| {
            by.is_some_and(|by| {
                by.sigmas > CONTRADICTION_SIGMAS && by.off_px > CONTRADICTION * radius.value
            })
        };
        Self {
            radius: self.radius.map(|radius| match is_other(radius) {
                true => loose(radius),
                false => radius,
            }),
            ..self
        }
    }

    /// The same where so much of the limb is saturated.
    fn loosened(self, saturated: f64) -> Self {
        let loose = |radius: Measured| Measured::new(radius.value, radius.sigma.max(SPILLED_PX));
        match saturated > MOST_SATURATED {
            true => Self {
                radius: self.radius.map(loose),
                ..self
            },
            false => self,
        }
    }
}

fn fit(limb: &Limb) -> Result<LimbFit, Stopped> {
    let seen = limb.seen();
    if seen < LEAST_SECTORS {
        let limit = LEAST_SECTORS as f64;
        return Err(Stopped::new(
            Stage::Limb,
            reasons::LITTLE_LIMB,
            seen as f64,
            limit,
        ));
    }
    limb.fit()
        .map_err(|_| Stopped::new(Stage::Limb, reasons::NO_FIT, seen as f64, 0.0))
}
