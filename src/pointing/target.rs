//! The target: a position relative to the Sun's centre, or a feature of its surface that moves with its rotation.
//!
//! Rates of rotation are those of magnetic features by Howard, Harvey and Forgach (1990, Solar Physics 130, 295), sunpy's default:
//! 2.894 - 0.428 sin^2 B - 0.370 sin^4 B microradian/s, sidereal. The feature keeps its latitude and drifts in Carrington longitude by
//! the difference from the rate that defines it. The error for a feature with proper motion is much larger than that of the rate.

use super::{HelioprojectiveArcsec, PointingError};
use crate::sky::{AU_KM, Disc, SUN_RADIUS_KM, SUN_ROTATION_DEG_PER_DAY, SunPosition};
use crate::units::ARCSEC_PER_RAD;
use jiff::Timestamp;
use nalgebra::Vector3;

const DAY_S: f64 = 86_400.0;
const RADIUS_AU: f64 = SUN_RADIUS_KM / AU_KM;

/// The direction to which the telescope should point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Target {
    /// A position relative to the Sun's centre, on the disc or off it.
    Fixed(HelioprojectiveArcsec),
    /// A position on the Sun's surface that moves with its rotation.
    Feature(Feature),
}

impl Default for Target {
    /// The disc's centre.
    fn default() -> Self {
        Self::Fixed(HelioprojectiveArcsec::default())
    }
}

impl Target {
    /// Position of the target at an instant.
    ///
    /// # Errors
    /// [`PointingError::BehindTheLimb`] if rotation has moved it there.
    pub fn at(
        &self,
        utc: Timestamp,
        sun: &SunPosition,
    ) -> Result<HelioprojectiveArcsec, PointingError> {
        self.on_disc(utc, &Disc::from(sun))
    }

    /// Position of the target on the disc of an instant.
    ///
    /// # Errors
    /// Those of [`at`](Self::at).
    pub fn on_disc(
        &self,
        utc: Timestamp,
        disc: &Disc,
    ) -> Result<HelioprojectiveArcsec, PointingError> {
        match self {
            Self::Fixed(place) => Ok(*place),
            Self::Feature(feature) => feature.at(utc, disc),
        }
    }
}

/// A position on the Sun's surface that moves with its rotation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Feature {
    /// Heliographic latitude.
    pub latitude_deg: f64,
    /// Carrington longitude at the epoch, 0 to 360.
    pub longitude_deg: f64,
    pub epoch: Timestamp,
}

impl Feature {
    /// The feature observed at a position on the disc.
    ///
    /// # Errors
    /// [`PointingError::OffTheDisc`].
    pub fn seen(
        at: HelioprojectiveArcsec,
        epoch: Timestamp,
        disc: &Disc,
    ) -> Result<Self, PointingError> {
        let distance = disc.distance_au;
        let (sin_x, cos_x) = (at.x / ARCSEC_PER_RAD).sin_cos();
        let (sin_y, cos_y) = (at.y / ARCSEC_PER_RAD).sin_cos();
        // The line of sight: to the west, to the north, to the Sun's centre; its near intersection with the sphere.
        let ray = Vector3::new(cos_y * sin_x, sin_y, cos_y * cos_x);
        let nearest = distance * ray.z;
        let depth_squared = nearest.powi(2) - distance.powi(2) + RADIUS_AU.powi(2);
        if depth_squared < 0.0 {
            let from_centre_arcsec = ray.x.hypot(ray.y).asin() * ARCSEC_PER_RAD;
            let limb_arcsec = (RADIUS_AU / distance).asin() * ARCSEC_PER_RAD;
            return Err(PointingError::OffTheDisc {
                from_centre_arcsec,
                limb_arcsec,
            });
        }
        let seen = ray * (nearest - depth_squared.sqrt());
        let (west, north, towards) = (seen.x, seen.y, distance - seen.z);
        let (sin_b0, cos_b0) = disc.b0_deg.to_radians().sin_cos();
        let axial = north * cos_b0 + towards * sin_b0;
        let from_meridian = west.atan2(towards * cos_b0 - north * sin_b0);
        Ok(Self {
            latitude_deg: (axial / RADIUS_AU).clamp(-1.0, 1.0).asin().to_degrees(),
            longitude_deg: (disc.l0_deg + from_meridian.to_degrees()).rem_euclid(360.0),
            epoch,
        })
    }

    /// Observed position of the feature.
    ///
    /// # Errors
    /// [`PointingError::BehindTheLimb`].
    pub fn at(&self, utc: Timestamp, disc: &Disc) -> Result<HelioprojectiveArcsec, PointingError> {
        let days = utc.duration_since(self.epoch).as_secs_f64() / DAY_S;
        let longitude_deg = self.longitude_deg + self.drift_deg_per_day() * days;
        let (sin_b, cos_b) = self.latitude_deg.to_radians().sin_cos();
        let (sin_l, cos_l) = (longitude_deg - disc.l0_deg).to_radians().sin_cos();
        let (sin_b0, cos_b0) = disc.b0_deg.to_radians().sin_cos();
        let west = cos_b * sin_l;
        let north = sin_b * cos_b0 - cos_b * cos_l * sin_b0;
        let towards = sin_b * sin_b0 + cos_b * cos_l * cos_b0;
        let limb = RADIUS_AU / disc.distance_au;
        if towards < limb {
            return Err(PointingError::BehindTheLimb {
                from_centre_deg: towards.clamp(-1.0, 1.0).acos().to_degrees(),
                limb_deg: limb.acos().to_degrees(),
            });
        }
        let depth = disc.distance_au / RADIUS_AU - towards;
        Ok(HelioprojectiveArcsec {
            x: west.atan2(depth) * ARCSEC_PER_RAD,
            y: north.atan2(depth.hypot(west)) * ARCSEC_PER_RAD,
        })
    }

    /// Drift in Carrington longitude.
    fn drift_deg_per_day(&self) -> f64 {
        let sin2 = self.latitude_deg.to_radians().sin().powi(2);
        let microradian_per_s = 2.894 - 0.428 * sin2 - 0.370 * sin2.powi(2);
        (microradian_per_s * 1e-6 * DAY_S).to_degrees() - SUN_ROTATION_DEG_PER_DAY
    }
}
