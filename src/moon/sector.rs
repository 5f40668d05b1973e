//! A few pixels' limb: its pixels, and the light that a sphere shows there.

use super::known::Known;
use super::profile::{Blur, Depths, PIXEL_VARIANCE, Profile};
use super::shading::{Shading, Sphere};
use crate::estimation::Linearised;
use crate::geometry::Circle;
use crate::units::Measured;
use nalgebra::{SMatrix, SVector, Vector1, Vector2};
use std::f64::consts::{PI, TAU};

/// Pixels of the limb that share a brightness, and how many such sectors a limb has at least.
const SECTOR_PX: f64 = 3.0;
const LEAST_SECTORS: f64 = 24.0;
/// Fewer pixels say nothing of a sector.
pub(super) const LEAST_PIXELS: usize = 6;
/// Pixels count so far before and behind the limb, px: further behind it the ground's own light and shade would move it.
pub(super) const PIXELS: Depths = -4.0..3.0;
/// A fit moves the limb by at most so much, px, and turns the light, in whose phase and side it is linear, by so much; then the limb is read again.
pub(super) const SLACK_PX: f64 = 2.0;
pub(super) const SLACK_RAD: f64 = 0.3;
/// The derivative by the phase is taken over so much, rad.
const PHASE_STEP_RAD: f64 = 0.02;
/// A phase that is known as well as this is not fitted, rad.
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

    /// Of the middle of a sector.
    pub fn angle_rad(&self, n: usize) -> f64 {
        (n as f64 + 0.5) * self.width_rad
    }

    /// The sector of a direction from the centre, and that direction, 0 to 2 pi.
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
    /// In round px.
    pub at: Vector2<f64>,
    /// How its light differs from that of its sector, and changes by blur, phase and side of the light, as the circle was when it was read.
    pub beside: f64,
    pub by_others: [f64; 3],
    pub light_dn: f64,
}

/// Pixels of a few px of the limb.
pub(super) struct Sector {
    /// From +x towards +y.
    pub angle_rad: f64,
    pub light: SectorLight,
    pub pixels: Vec<Pixel>,
}

/// An angle from the middle of the bright limb, -pi to pi.
pub(super) fn from_middle(angle_rad: f64, bright_limb_rad: f64) -> f64 {
    (angle_rad - bright_limb_rad + PI).rem_euclid(TAU) - PI
}

/// The light along a limb about some parameters: linear in blur, phase and the side of the light.
pub(super) struct Lights {
    pub here: Sphere,
    /// At a phase that is a step further; none where the phase is known.
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

    /// A blurred circle appears smaller than a blurred straight edge does, by so many px at a distance from its centre.
    pub fn shrinks(&self, distance: f64) -> f64 {
        (self.blur_px.powi(2) + PIXEL_VARIANCE) / (2.0 * distance.max(1.0))
    }

    /// The light across the limb at an angle from the middle of the bright limb.
    pub fn profile(&self, sphere: &Sphere, angle_rad: f64) -> Profile {
        let depths = PIXELS.start - SLACK_PX..PIXELS.end + SLACK_PX;
        Profile::new(sphere, self.radius, &self.blur, &depths, angle_rad)
    }

    /// How it changes with the phase, 1/rad.
    pub fn by_phase(&self, here: &Profile, angle_rad: f64) -> Option<Profile> {
        let stepped = self.profile(self.stepped.as_ref()?, angle_rad);
        Some(stepped.change_from(here, PHASE_STEP_RAD))
    }
}

/// The light across the limb in the middle of a sector, and how it changes.
pub(super) struct SectorLight {
    pub here: Profile,
    pub by_angle: Profile,
    pub by_phase: Option<Profile>,
}

impl SectorLight {
    /// How the light at an angle from the sector's middle differs from that there, and how it changes with blur, phase and side.
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

    /// Adds the pixels without what the sector's own sky and brightness explain.
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
    /// The pixel's light where the ground's brightness is 1, in the residual's place, and its derivatives.
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
    /// At the radius alone.
    pub radial: f64,
    /// By how much that changes with the limb's place, 1/px^2.
    pub information: f64,
    /// How the gradient by all parameters changes with the limb's place, 1/px.
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

    /// How far the limb lies outwards of the circle.
    pub fn excess(&self, scatter: f64) -> Measured {
        Measured::new(
            self.radial / self.information,
            scatter / self.information.sqrt(),
        )
    }
}
