//! Alignment of the plate with the sky: the two conventions that convert the Sun's position on the plate to the telescope's pointing.
//!
//! A shift s of the Sun from the boresight on the plate is an angle theta with tan(theta) = |s| / plate distance. The
//! lens's focal length does not enter: the ray through its centre is not deflected. The great circle from the Sun to the pointing
//! of the telescope leaves in the direction -(atan2(s.x, s.y) + clocking), clockwise from "up" as seen looking out, where up is
//!
//! - [`Directions::Telescope`]: the telescope's own, in the vertical plane of the boresight rotated by the roll. From the
//!   telescope the Sun is in the opposite direction. The plate is the tangent plane of the sky at the boresight
//!   (gnomonic projection).
//! - [`Directions::Sun2013`]: the zenith's direction at the Sun (HEROES flight program, 2013). The plate is the tangent plane
//!   of the sky at the Sun; roll does not enter.

use super::refusal::PointingError;
use crate::geometry::attitude::Direction;
use crate::instrument::{Directions, Instrument, Mounting};
use crate::sky::sphere::{direction, tangents};
use crate::units::{MIL_MM, Measured, PlateMil};
use nalgebra::{Matrix2, Matrix3, Matrix3x2, Rotation3, UnitVector3, Vector2, Vector3};
use serde::{Deserialize, Serialize};
use std::f64::consts::FRAC_PI_2;

/// The telescope's roll: its rotation about the boresight, positive with the right side low.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum Roll {
    /// The instrument's `mounting.roll_deg`. Its error is the same in every frame and is part of the calibration's.
    Stated,
    /// Measured for this frame, deg. Its error is part of the frame's.
    Measured(Measured),
}

/// The roll of a body with axes forward, right and down, from the nadir in these axes, deg: positive with the right side low.
pub fn body_roll_deg(nadir: &Direction) -> Measured {
    let down = &nadir.unit;
    let by_nadir = Vector3::new(0.0, down.z, -down.y) / (down.y * down.y + down.z * down.z);
    let variance_rad2 = by_nadir.dot(&(nadir.covariance_rad2 * by_nadir));
    let sigma_deg = variance_rad2.max(0.0).sqrt().to_degrees();
    Measured::new(down.y.atan2(down.z).to_degrees(), sigma_deg)
}

/// The pitch of such a body, deg: positive with the forward end high.
pub fn body_pitch_deg(nadir: &Direction) -> Measured {
    let sine = nadir.unit.x;
    let cosine = (1.0 - sine * sine).sqrt();
    let sigma_rad = nadir.covariance_rad2.m11.max(0.0).sqrt() / cosine;
    Measured::new(-sine.asin().to_degrees(), sigma_rad.to_degrees())
}

/// The nadir in the axes of a body with a roll and a pitch, deg.
pub fn body_nadir(roll_deg: Measured, pitch_deg: Measured) -> Direction {
    let (sin_roll, cos_roll) = roll_deg.value.to_radians().sin_cos();
    let (sin_pitch, cos_pitch) = pitch_deg.value.to_radians().sin_cos();
    let by_roll = Vector3::new(0.0, cos_pitch * cos_roll, -cos_pitch * sin_roll);
    let by_pitch = Vector3::new(-cos_pitch, -sin_pitch * sin_roll, -sin_pitch * cos_roll);
    let part =
        |by: Vector3<f64>, sigma_deg: f64| by * by.transpose() * sigma_deg.to_radians().powi(2);
    Direction {
        unit: UnitVector3::new_normalize(Vector3::new(
            -sin_pitch,
            cos_pitch * sin_roll,
            cos_pitch * cos_roll,
        )),
        covariance_rad2: part(by_roll, roll_deg.sigma) + part(by_pitch, pitch_deg.sigma),
    }
}

impl Roll {
    /// The roll of a telescope at an elevation. The telescope either rotates in elevation about the second axis of such a body, or is the
    /// body itself: the dip of that axis is the same in both, and a roll about the boresight tilts it by sin(roll) cos(elevation). `None`
    /// if no roll gives this dip.
    pub fn by_nadir(nadir: &Direction, elevation_deg: f64) -> Option<Self> {
        let level = elevation_deg.to_radians().cos();
        let sine = nadir.unit.y / level;
        let cosine = (1.0 - sine * sine).sqrt();
        let sigma_deg = (nadir.covariance_rad2.m22.max(0.0).sqrt() / (level * cosine)).to_degrees();
        let roll = Measured::new(sine.asin().to_degrees(), sigma_deg);
        (cosine > 0.0).then_some(Self::Measured(roll))
    }

    /// The roll as a number, deg.
    pub fn about_boresight_deg(self, instrument: &Instrument) -> Measured {
        match self {
            Self::Stated => instrument.mounting.roll_deg,
            Self::Measured(roll) => roll,
        }
    }

    /// The roll that rotates directions on the plate, deg.
    fn turning(self, mounting: &Mounting) -> Measured {
        match (mounting.directions, self) {
            (Directions::Sun2013, _) => Measured::new(0.0, 0.0),
            (Directions::Telescope, Self::Stated) => mounting.roll_deg,
            (Directions::Telescope, Self::Measured(roll)) => roll,
        }
    }
}

/// Plate and telescope with the calibration and the roll. Plate and sky are related through a plane: the tangent of the angle from the
/// Sun to the boresight in the direction of the great circle, towards the zenith and clockwise from it.
pub(super) struct Alignment {
    directions: Directions,
    boresight_mil: Vector2<f64>,
    distance_mil: f64,
    /// Clocking minus roll, deg. A roll to the right rotates the plate's +Y clockwise; the clocking has the opposite sign.
    turn_deg: f64,
    /// Roll that rotates directions on the plate.
    roll_deg: f64,
    pub roll_sigma_deg: f64,
}

impl Alignment {
    pub fn new(instrument: &Instrument, roll: Roll) -> Self {
        let mounting = &instrument.mounting;
        let roll = roll.turning(mounting);
        Self {
            directions: mounting.directions,
            boresight_mil: mounting.boresight_mil.vector(),
            distance_mil: instrument.optics.plate_distance_mm.value / MIL_MM,
            turn_deg: mounting.clocking_deg.value - roll.value,
            roll_deg: roll.value,
            roll_sigma_deg: roll.sigma,
        }
    }

    /// Converts a shift on the plate, mil, to the plane.
    pub fn to_plane(&self) -> Matrix2<f64> {
        let (sin, cos) = self.turn_deg.to_radians().sin_cos();
        Matrix2::new(-sin, cos, -cos, -sin) / self.distance_mil
    }

    /// The plane's point for a position of the Sun on the plate.
    pub fn on_plane(&self, sun_on_plate: PlateMil) -> Vector2<f64> {
        self.to_plane() * (sun_on_plate.vector() - self.boresight_mil)
    }

    /// The Sun's position on the plate for a point of the plane.
    pub fn on_plate(&self, on_plane: &Vector2<f64>) -> PlateMil {
        (self.boresight_mil + self.to_shift(on_plane)).into()
    }

    /// Converts a point of the plane to a shift on the plate, mil.
    pub fn to_shift(&self, on_plane: &Vector2<f64>) -> Vector2<f64> {
        // `to_plane` is a rotation divided by the distance.
        self.to_plane().transpose() * on_plane * self.distance_mil.powi(2)
    }

    /// The telescope's pointing as a unit vector, from that to the Sun.
    ///
    /// # Errors
    /// [`PointingError::NoBoresight`] near the zenith, with [`Directions::Telescope`].
    pub fn boresight(
        &self,
        on_plane: &Vector2<f64>,
        sun: &Vector3<f64>,
    ) -> Result<Vector3<f64>, PointingError> {
        match self.directions {
            Directions::Telescope => from_telescope(-on_plane, sun),
            Directions::Sun2013 => Ok((sun + axes(sun) * on_plane).normalize()),
        }
    }

    /// The plane's point for a pointing of the telescope less than 90 deg from the Sun.
    pub fn towards(&self, boresight: &Vector3<f64>, sun: &Vector3<f64>) -> Vector2<f64> {
        match self.directions {
            Directions::Telescope => -gnomonic(boresight, sun),
            Directions::Sun2013 => gnomonic(sun, boresight),
        }
    }

    /// Rotation from the tangent plane of the sky at the Sun, with the zenith's direction there, to the plane of the plate. The zenith's
    /// direction at the telescope's pointing differs: it rotates along the great circle from the Sun.
    ///
    /// # Errors
    /// Those of [`boresight`](Self::boresight).
    pub fn turn_from_sun(
        &self,
        on_plane: &Vector2<f64>,
        sun: &Vector3<f64>,
    ) -> Result<Matrix2<f64>, PointingError> {
        let boresight = self.boresight(on_plane, sun)?;
        Ok(self.up_and_right(&boresight, sun).transpose() * carried(sun, &boresight))
    }

    /// Up and right, as columns, of a telescope without roll at a pointing: the reference for directions on the plate.
    fn up_and_right(&self, boresight: &Vector3<f64>, sun: &Vector3<f64>) -> Matrix3x2<f64> {
        match self.directions {
            Directions::Telescope => axes(boresight),
            Directions::Sun2013 => carried(sun, boresight),
        }
    }

    /// The telescope's own axes - forward, right, up - as columns, at a pointing.
    pub fn telescope(&self, boresight: &Vector3<f64>, sun: &Vector3<f64>) -> Matrix3<f64> {
        let level = self.up_and_right(boresight, sun);
        let (up, right) = (level.column(0), level.column(1));
        let (sin, cos) = self.roll_deg.to_radians().sin_cos();
        Matrix3::from_columns(&[*boresight, right * cos - up * sin, up * cos + right * sin])
    }

    /// Rotation of a telescope about its boresight during a small motion of the boresight: its reference for up rotates with the azimuth,
    /// or like an axis that is transported along great circles from the Sun (by the area between two of them).
    pub fn turned_about(
        &self,
        boresight: &Vector3<f64>,
        moved: &Vector3<f64>,
        sun: &Vector3<f64>,
    ) -> f64 {
        match self.directions {
            Directions::Telescope => {
                let (_, across) = tangents(boresight);
                -moved.dot(&across) * boresight.z / boresight.xy().norm()
            }
            Directions::Sun2013 => sun.cross(boresight).dot(moved) / (1.0 + sun.dot(boresight)),
        }
    }

    /// Derivatives of the boresight, rad of true angle across (towards larger azimuth) and in elevation: by the point on the plane, and
    /// by the Sun (towards the zenith and clockwise). Central differences, accurate to 1e-6 relative up to 85 deg of elevation.
    ///
    /// # Errors
    /// Those of [`boresight`](Self::boresight).
    pub fn derivatives(
        &self,
        on_plane: &Vector2<f64>,
        sun: &Vector3<f64>,
    ) -> Result<[Matrix2<f64>; 2], PointingError> {
        const STEP_RAD: f64 = 1e-5;
        let (up, across) = tangents(&self.boresight(on_plane, sun)?);
        let by = |plane: Vector2<f64>, sky: Vector2<f64>| {
            let moved = |step: f64| {
                let sun = (sun + axes(sun) * sky * step).normalize();
                self.boresight(&(on_plane + plane * step), &sun)
            };
            let change = (moved(STEP_RAD)? - moved(-STEP_RAD)?) / (2.0 * STEP_RAD);
            Ok(Vector2::new(across.dot(&change), up.dot(&change)))
        };
        let (x, y, still) = (Vector2::x(), Vector2::y(), Vector2::zeros());
        Ok([
            Matrix2::from_columns(&[by(x, still)?, by(y, still)?]),
            Matrix2::from_columns(&[by(still, x)?, by(still, y)?]),
        ])
    }
}

/// Pointing of a telescope without roll that has the Sun above and to the right of its boresight, by the tangents of these angles. Its
/// elevation E follows from the Sun's vertical component, (sin E + above cos E) / secant of the Sun's angle; its azimuth from the
/// horizontal ones. Of two solutions, on both sides of the zenith, it is the one within 90 deg of the Sun's azimuth.
fn from_telescope(
    above_and_right: Vector2<f64>,
    sun: &Vector3<f64>,
) -> Result<Vector3<f64>, PointingError> {
    let (above, right) = (above_and_right.x, above_and_right.y);
    let secant = above_and_right.norm().hypot(1.0);
    let elevation = (sun.z * secant / above.hypot(1.0)).asin() - above.atan();
    // If the sine exceeds 1 the elevation is NaN, which fails the comparison.
    if elevation.abs() <= FRAC_PI_2 {
        let forward = elevation.cos() - above * elevation.sin();
        let azimuth = sun.y.atan2(sun.x) - right.atan2(forward);
        return Ok(direction(azimuth.to_degrees(), elevation.to_degrees()));
    }
    Err(PointingError::NoBoresight {
        sun_from_vertical_deg: sun.x.hypot(sun.y).atan2(sun.z.abs()).to_degrees(),
        sun_from_boresight_deg: above_and_right.norm().atan().to_degrees(),
    })
}

/// Gnomonic projection of a direction onto the tangent plane of the sky at another: towards the zenith, and clockwise.
pub(super) fn gnomonic(at: &Vector3<f64>, of: &Vector3<f64>) -> Vector2<f64> {
    axes(at).transpose() * of / of.dot(at)
}

/// The axes at the Sun, transported along the great circle to another direction.
fn carried(sun: &Vector3<f64>, to: &Vector3<f64>) -> Matrix3x2<f64> {
    let along = Rotation3::rotation_between(sun, to);
    along.map_or(axes(sun), |along| along * axes(sun))
}

/// The axes of the tangent plane of the sky at a direction, as columns: towards the zenith, and clockwise, which is towards larger azimuth.
fn axes(at: &Vector3<f64>) -> Matrix3x2<f64> {
    let (up, clockwise) = tangents(at);
    Matrix3x2::from_columns(&[up, clockwise])
}
