//! A bright patch that may be the Moon, and the prior knowledge of it before its limb is read.

use super::expected::{Expected, Radius};
use super::known::Known;
use super::light::Levels;
use super::patch::{Outline, Patch};
use super::plane::Plane;
use super::shading::{Shading, Sphere, phase_rad_of_lit};
use super::{MOST_RADIUS_DEVIATION, MoonSettings};
use crate::frame::Frame;
use crate::geometry::Circle;
use crate::units::Measured;
use std::f64::consts::PI;
use std::ops::Range;

/// Minimum radius of a disc that may be the Moon, px.
const LEAST_RADIUS_PX: f64 = 4.0;
/// Uncertainty of phase and side of the light from the light's centroid, rad: 1 sigma for a whole disc, and for one that
/// the picture's edge cuts.
const BY_MIDDLE_RAD: f64 = 0.2;
const BY_CUT_MIDDLE_RAD: f64 = 0.6;

/// A frame with the values needed to measure it near a bright patch.
pub(super) struct View<'a> {
    pub frame: &'a Frame,
    pub levels: &'a Levels,
    pub plane: Plane,
    pub shading: Shading,
}

/// A bright patch that may be the Moon.
pub(super) struct Candidate<'a> {
    pub view: View<'a>,
    pub expected: &'a Expected,
    /// Outline in round px.
    pub outline: Outline,
}

impl<'a> Candidate<'a> {
    /// `None` beyond the limit of the lens.
    pub fn new(
        settings: &MoonSettings,
        expected: &'a Expected,
        frame: &'a Frame,
        patch: &Patch,
        levels: &'a Levels,
        level_dn: f64,
    ) -> Option<Self> {
        let outline = Outline::of(frame, patch, levels, level_dn);
        let plane = settings.plane(expected, outline.middle.into())?;
        Some(Self {
            view: View {
                frame,
                levels,
                plane,
                shading: settings.shading,
            },
            expected,
            outline: outline.seen_by(|at| plane.round(at.x, at.y)),
        })
    }

    /// The expected radius, round px.
    pub fn radius(&self) -> Option<Measured> {
        match self.expected.radius? {
            Radius::Pixels(radius) => Some(radius),
            Radius::Angle(angle) => {
                let scale = self.view.plane.px_per_rad?;
                Some(Measured::new(
                    angle.value.tan() * scale,
                    angle.sigma * scale,
                ))
            }
        }
    }

    /// The range of possible radii, round px.
    pub fn radii(&self) -> Range<f64> {
        let frame = self.view.frame;
        match self.radius() {
            Some(radius) => {
                let most = MOST_RADIUS_DEVIATION;
                radius.value * (1.0 - most)..radius.value * (1.0 + most)
            }
            None => LEAST_RADIUS_PX..(frame.width() + frame.height()) as f64,
        }
    }

    /// The expected phase angle, rad.
    pub fn phase_rad(&self) -> Option<Measured> {
        let radians = |deg: Measured| Measured::new(deg.value.to_radians(), deg.sigma.to_radians());
        self.expected.phase_angle_deg.map(radians)
    }

    /// The expected direction of the bright limb's middle, in round px, rad.
    pub fn bright_limb_rad(&self) -> Option<Measured> {
        let plane = &self.view.plane;
        let round = |deg: Measured| {
            let round_rad = plane.round_angle_rad(deg.value.to_radians());
            Measured::new(round_rad, deg.sigma.to_radians())
        };
        self.expected.bright_limb_deg.map(round)
    }

    /// Priors before the limb is read: from the ephemeris, else from the light's centroid.
    pub fn known(&self, circle: &Circle) -> Known {
        let off = self.outline.middle - circle.centre;
        let sigma = match self.outline.is_cut {
            true => BY_CUT_MIDDLE_RAD,
            false => BY_MIDDLE_RAD,
        };
        Known {
            radius: self.radius(),
            phase_rad: (self.phase_rad())
                .unwrap_or_else(|| Measured::new(self.phase_by_middle_rad(circle), sigma)),
            bright_limb_rad: (self.bright_limb_rad())
                .unwrap_or(Measured::new(off.y.atan2(off.x), sigma)),
        }
    }

    /// The centroid of a thin crescent lies outside its light: the lit fraction of the disc determines its phase better.
    fn phase_by_middle_rad(&self, circle: &Circle) -> f64 {
        let of_area = phase_rad_of_lit(self.light_area(circle));
        self.sphere_by_middle(circle).phase_rad().min(of_area)
    }

    /// The sphere whose centroid of light has the same distance from its centre.
    pub fn sphere_by_middle(&self, circle: &Circle) -> Sphere {
        let off = (self.outline.middle - circle.centre).norm() / circle.radius;
        Sphere::of_offset(self.view.shading, off)
    }

    /// Area of the light relative to that of the disc.
    pub fn light_area(&self, circle: &Circle) -> f64 {
        let disc_px = PI * circle.radius.powi(2) * self.view.plane.sensor_area();
        self.outline.light_px as f64 / disc_px
    }
}
