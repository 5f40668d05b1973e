//! A sector of the limb: its pixels, and the brightness of a sphere there.

use super::known::Known;
use super::profile::{Blur, Depths, PIXEL_VARIANCE, Profile};
use super::shading::{Shading, Sphere};
use crate::estimation::Linearised;
use crate::geometry::Circle;
use crate::units::Measured;
use nalgebra::{SMatrix, SVector, Vector1, Vector2};
use std::f64::consts::{PI, TAU};

/// Length of the limb, px, that shares a brightness, and minimum number of such sectors of a limb.
const SECTOR_PX: f64 = 3.0;
const LEAST_SECTORS: f64 = 24.0;
/// Minimum number of pixels of a sector.
pub(super) const LEAST_PIXELS: usize = 6;
/// Range of the pixels in front of and behind the limb, px: farther behind it, variations of the ground would bias the
/// limb.
pub(super) const PIXELS: Depths = -4.0..3.0;
/// Limits of one fit: shift of the limb, px, and change of the light's phase and side, in which the model is linear; beyond
/// them the limb is read again.
pub(super) const SLACK_PX: f64 = 2.0;
pub(super) const SLACK_RAD: f64 = 0.3;
/// Step of the numerical derivative by the phase, rad.
const PHASE_STEP_RAD: f64 = 0.02;
/// A phase with a smaller prior sigma is not fitted, rad.
const KNOWN_PHASE_RAD: f64 = 0.01;

/// Centre x and y (round px), radius (px), blur (px), phase angle, and angle of the bright limb's middle (rad).
pub(super) const PARAMETERS: usize = 6;
pub(super) type Parameters = SVector<f64, PARAMETERS>;
pub(super) type SectorRow = Linearised<1, PARAMETERS>;
pub(super) type RowVector = SMatrix<f64, 1, PARAMETERS>;

pub(super) fn circle_of(at: &Parameters) -> Circle {
    Circle {
        centre: at.fixed_rows::<2>(0).into_owned(),
        radius: at[2],
    }
}

/// The sectors of a whole circle.
#[derive(Debug, Clone, Copy)]
pub(super) struct Sectors {
    pub count: usize,
    pub width_rad: f64,
}

impl Sectors {
    pub fn of_radius(radius: f64) -> Self {
        let count = (radius * TAU / SECTOR_PX).max(LEAST_SECTORS);
        Self {
            count: count as usize,
            width_rad: TAU / count.floor(),
        }
    }

    /// Angle of the middle of a sector.
    pub fn angle_rad(&self, n: usize) -> f64 {
        (n as f64 + 0.5) * self.width_rad
    }

    /// The sector of a direction from the centre, and the angle of that direction, 0 to 2 pi.
    pub fn at(&self, away: &Vector2<f64>) -> (usize, f64) {
        let angle_rad = away.y.atan2(away.x);
        let around_rad = if angle_rad < 0.0 {
            angle_rad + TAU
        } else {
            angle_rad
        };
        let n = (around_rad / self.width_rad) as usize;
        (n.min(self.count - 1), around_rad)
    }
}

/// A pixel near the limb.
pub(super) struct Pixel {
    /// Position in round px.
    pub at: Vector2<f64>,
    /// Difference of its brightness from that of its sector, and derivatives by blur, phase and side of the light, for the
    /// circle at which it was read.
    pub beside: f64,
    pub by_others: [f64; 3],
    pub light_dn: f64,
}

/// The pixels of a few px of the limb's length.
pub(super) struct Sector {
    /// Angle from +x towards +y.
    pub angle_rad: f64,
    pub light: SectorLight,
    pub pixels: Vec<Pixel>,
}

/// An angle from the middle of the bright limb, -pi to pi.
pub(super) fn from_middle(angle_rad: f64, bright_limb_rad: f64) -> f64 {
    (angle_rad - bright_limb_rad + PI).rem_euclid(TAU) - PI
}

/// The brightness along a limb near some parameters: linear in blur, phase and the side of the light.
pub(super) struct Lights {
    pub here: Sphere,
    /// At a phase larger by a step; none if the phase is known.
    pub stepped: Option<Sphere>,
    pub blur: Blur,
    pub radius: f64,
    pub blur_px: f64,
    pub phase_rad: f64,
    pub bright_limb_rad: f64,
}

impl Lights {
    pub fn new(shading: Shading, at: &Parameters, known: &Known) -> Self {
        let is_fitted = known.phase_rad.sigma > KNOWN_PHASE_RAD;
        Self {
            here: Sphere::new(shading, at[4]),
            stepped: is_fitted.then(|| Sphere::new(shading, at[4] + PHASE_STEP_RAD)),
            blur: Blur::new(at[3]),
            radius: at[2],
            blur_px: at[3],
            phase_rad: at[4],
            bright_limb_rad: at[5],
        }
    }

    /// Decrease of the apparent radius of a blurred circle compared with a blurred straight edge, px, at a distance from
    /// its centre.
    pub fn shrinks(&self, distance: f64) -> f64 {
        (self.blur_px.powi(2) + PIXEL_VARIANCE) / (2.0 * distance.max(1.0))
    }

    /// The brightness across the limb at an angle from the middle of the bright limb.
    pub fn profile(&self, sphere: &Sphere, angle_rad: f64) -> Profile {
        let depths = PIXELS.start - SLACK_PX..PIXELS.end + SLACK_PX;
        Profile::new(sphere, self.radius, &self.blur, &depths, angle_rad)
    }

    /// Its derivative by the phase, 1/rad.
    pub fn by_phase(&self, here: &Profile, angle_rad: f64) -> Option<Profile> {
        let stepped = self.profile(self.stepped.as_ref()?, angle_rad);
        Some(stepped.change_from(here, PHASE_STEP_RAD))
    }
}

/// The brightness across the limb in the middle of a sector, and its derivatives.
pub(super) struct SectorLight {
    pub here: Profile,
    pub by_angle: Profile,
    pub by_phase: Option<Profile>,
}

impl SectorLight {
    /// Difference of the brightness at an angle from the sector's middle, and its derivatives by blur, phase and side.
    pub fn others(
        &self,
        angle_rad: f64,
        depth: f64,
        blur_px: f64,
        distance: f64,
    ) -> (f64, [f64; 3]) {
        let here = self.here.at(depth);
        let by_angle = self.by_angle.at(depth).light;
        let by_phase = self.by_phase.as_ref();
        let by_others = [
            // Blurred light obeys the heat equation.
            blur_px * (here.curve - here.slope / distance.max(1.0)),
            by_phase.map_or(0.0, |by_phase| by_phase.at(depth).light),
            -by_angle,
        ];
        (by_angle * angle_rad, by_others)
    }
}

impl Sector {
    pub fn is_seen(&self, least_dn: f64) -> bool {
        let brightest = self
            .pixels
            .iter()
            .map(|pixel| pixel.light_dn)
            .fold(0.0, f64::max);
        self.pixels.len() >= LEAST_PIXELS && brightest > least_dn
    }

    /// Adds the pixels after eliminating the sector's own sky level and brightness.
    pub fn add_rows(
        &self,
        at: &Parameters,
        lights: &Lights,
        noise_dn: f64,
        rows: &mut Vec<SectorRow>,
    ) {
        let pixels = self.pixels.iter();
        let first = rows.len();
        rows.extend(pixels.map(|pixel| pixel.modelled(at, lights, &self.light.here)));
        let rows = &mut rows[first..];
        let count = rows.len() as f64;
        let (mut light, mut by, mut dn) = (0.0, RowVector::zeros(), 0.0);
        for (row, pixel) in rows.iter().zip(&self.pixels) {
            light += row.residual[0];
            by += row.jacobian;
            dn += pixel.light_dn;
        }
        let (light, by, dn) = (light / count, by / count, dn / count);
        let (mut norm, mut product, mut along) = (f64::MIN_POSITIVE, 0.0, RowVector::zeros());
        for (row, pixel) in rows.iter_mut().zip(&self.pixels) {
            row.residual[0] -= light;
            row.jacobian -= by;
            let light = row.residual[0];
            norm += light * light;
            product += light * (pixel.light_dn - dn);
            along += row.jacobian * light;
        }
        let brightness_dn = (product / norm).max(0.0);
        along /= norm;
        for (row, pixel) in rows.iter_mut().zip(&self.pixels) {
            let light = row.residual[0];
            row.residual[0] = (pixel.light_dn - dn - brightness_dn * light) / noise_dn;
            row.jacobian = (row.jacobian - along * light) * (brightness_dn / noise_dn);
        }
    }
}

impl Pixel {
    /// The pixel's brightness for a ground of brightness 1, in place of the residual, and its derivatives.
    fn modelled(&self, at: &Parameters, lights: &Lights, profile: &Profile) -> SectorRow {
        let away = self.at - Vector2::new(at[0], at[1]);
        let distance = away.norm().max(1.0);
        let unit = away / distance;
        let depth = at[2] - distance - lights.shrinks(distance);
        let here = profile.at(depth);
        let [by_blur, by_phase, by_side] = self.by_others;
        let light = here.light
            + self.beside
            + by_blur * (at[3] - lights.blur_px)
            + by_phase * (at[4] - lights.phase_rad)
            + by_side * (at[5] - lights.bright_limb_rad);
        let slope = here.slope;
        SectorRow {
            residual: Vector1::new(light),
            jacobian: RowVector::from([
                slope * unit.x,
                slope * unit.y,
                slope,
                by_blur,
                by_phase,
                by_side,
            ]),
        }
    }
}

/// The gradient of a sector's squared residuals.
pub(super) struct Gradient {
    /// By the radius alone.
    pub radial: f64,
    /// Its derivative by the limb's position, 1/px^2.
    pub information: f64,
    /// Derivative of the gradient by all parameters with respect to the limb's position, 1/px.
    pub by_excess: Parameters,
}

impl Gradient {
    pub fn of(rows: &[SectorRow]) -> Self {
        let (mut radial, mut by_excess) = (0.0, Parameters::zeros());
        for row in rows {
            radial += row.jacobian[2] * row.residual[0];
            by_excess += row.jacobian.transpose() * row.jacobian[2];
        }
        Self {
            radial,
            information: by_excess[2].max(1e-9),
            by_excess,
        }
    }

    /// Distance of the limb outwards from the circle.
    pub fn excess(&self, scatter: f64) -> Measured {
        Measured::new(
            self.radial / self.information,
            scatter / self.information.sqrt(),
        )
    }
}
