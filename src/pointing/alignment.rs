//! How the plate lies against the sky: the two rules by which the Sun's place on the plate gives where the telescope points.
//!
//! A shift s of the Sun from the boresight on the plate is an angle theta with tan(theta) = |s| / plate distance. The
//! lens's focal length does not enter: the ray through its middle goes straight. The great circle from the Sun to where the
//! telescope points leaves in the direction -(atan2(s.x, s.y) + clocking), clockwise from "up" as seen looking out, where up is
//!
//! - [`Directions::Telescope`]: the telescope's own, in the vertical plane of the boresight turned by the roll. From the
//!   telescope the Sun lies the opposite way. The plate is the plane that touches the sky where the telescope points
//!   (gnomonic projection).
//! - [`Directions::Sun2013`]: the zenith's direction at the Sun (HEROES flight program, 2013). The plate is the plane that
//!   touches the sky at the Sun; roll does not enter.

use super::refusal::PointingError;
use crate::geometry::attitude::Direction;
use crate::instrument::{Directions, Instrument, Mounting};
use crate::sky::sphere::{direction, tangents};
use crate::units::{MIL_MM, Measured, PlateMil};
use nalgebra::{Matrix2, Matrix3, Matrix3x2, Rotation3, UnitVector3, Vector2, Vector3};
use serde::{Deserialize, Serialize};
use std::f64::consts::FRAC_PI_2;

/// The telescope's roll: its turn about the boresight, positive with the right side low.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub enum Roll {
    /// The instrument's `mounting.roll_deg`. Its error is the same in every frame and belongs to the calibration.
    Stated,
    /// Measured for this frame, deg. Its error belongs to the frame.
    Measured(Measured),
}

/// The roll of a body whose axes are forward, right and down, by straight down in them, deg: positive with the right side low.
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

/// Straight down in the axes of a body of some roll and pitch, deg.
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
    /// The roll of a telescope at an elevation that turns in elevation about the second axis of such a body, or is the body itself: that axis
    /// dips as much in both, and a roll about the boresight tilts it by sin(roll) cos(elevation). `None` where no roll dips so much.
    pub fn by_nadir(nadir: &Direction, elevation_deg: f64) -> Option<Self> {
        let level = elevation_deg.to_radians().cos();
        let sine = nadir.unit.y / level;
        let cosine = (1.0 - sine * sine).sqrt();
        let sigma_deg = (nadir.covariance_rad2.m22.max(0.0).sqrt() / (level * cosine)).to_degrees();
        let roll = Measured::new(sine.asin().to_degrees(), sigma_deg);
        (cosine > 0.0).then_some(Self::Measured(roll))
    }

    /// The roll in numbers, deg.
    pub fn about_boresight_deg(self, instrument: &Instrument) -> Measured {
        match self {
            Self::Stated => instrument.mounting.roll_deg,
            Self::Measured(roll) => roll,
        }
    }

    /// The roll that turns directions on the plate, deg.
    fn turning(self, mounting: &Mounting) -> Measured {
        match (mounting.directions, self) {
            (Directions::Sun2013, _) => Measured::new(0.0, 0.0),
            (Directions::Telescope, Self::Stated) => mounting.roll_deg,
            (Directions::Telescope, Self::Measured(roll)) => roll,
        }
    }
}

/// Plate and telescope as the calibration and the roll have them. Between plate and sky lies a plane: the tangent of the angle
/// from the Sun to the boresight in the direction of the great circle, towards the zenith and clockwise from it.
pub(super) struct Alignment {
    directions: Directions,
    boresight_mil: Vector2<f64>,
    distance_mil: f64,
    /// Clocking less roll, deg. A roll to the right turns the plate's +Y clockwise; the clocking counts the other way.
    turn_deg: f64,
    /// That turns directions on the plate.
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

    /// From a shift on the plate, mil, to the plane.
    pub fn to_plane(&self) -> Matrix2<f64> {
        let (sin, cos) = self.turn_deg.to_radians().sin_cos();
        Matrix2::new(-sin, cos, -cos, -sin) / self.distance_mil
    }

    /// The plane's point for a place of the Sun on the plate.
    pub fn on_plane(&self, sun_on_plate: PlateMil) -> Vector2<f64> {
        self.to_plane() * (sun_on_plate.vector() - self.boresight_mil)
    }

    /// The Sun's place on the plate for a point of the plane.
    pub fn on_plate(&self, on_plane: &Vector2<f64>) -> PlateMil {
        (self.boresight_mil + self.to_shift(on_plane)).into()
    }

    /// From the plane to a shift on the plate, mil.
    pub fn to_shift(&self, on_plane: &Vector2<f64>) -> Vector2<f64> {
        // `to_plane` is a rotation divided by the distance.
        self.to_plane().transpose() * on_plane * self.distance_mil.powi(2)
    }

    /// The direction in which the telescope points, as a unit vector; so is the Sun's.
    ///
    /// # Errors
    /// [`PointingError::NoBoresight`] near the zenith, by [`Directions::Telescope`].
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

    /// The plane's point at which the telescope points in a direction, less than 90 deg from the Sun.
    pub fn towards(&self, boresight: &Vector3<f64>, sun: &Vector3<f64>) -> Vector2<f64> {
        match self.directions {
            Directions::Telescope => -gnomonic(boresight, sun),
            Directions::Sun2013 => gnomonic(sun, boresight),
        }
    }

    /// From the plane that touches the sky at the Sun, with the zenith's direction there, to the plane of the plate. At the telescope
    /// the zenith's direction is another: it turns along the great circle from the Sun.
    ///
    /// # Errors
    /// As [`boresight`](Self::boresight).
    pub fn turn_from_sun(
        &self,
        on_plane: &Vector2<f64>,
        sun: &Vector3<f64>,
    ) -> Result<Matrix2<f64>, PointingError> {
        let boresight = self.boresight(on_plane, sun)?;
        Ok(self.up_and_right(&boresight, sun).transpose() * carried(sun, &boresight))
    }

    /// Up and right, as columns, of a telescope without roll that points in a direction: what directions on the plate are counted from.
    fn up_and_right(&self, boresight: &Vector3<f64>, sun: &Vector3<f64>) -> Matrix3x2<f64> {
        match self.directions {
            Directions::Telescope => axes(boresight),
            Directions::Sun2013 => carried(sun, boresight),
        }
    }

    /// The telescope's own axes - forward, right, up - as columns, where it points in a direction.
    pub fn telescope(&self, boresight: &Vector3<f64>, sun: &Vector3<f64>) -> Matrix3<f64> {
        let level = self.up_and_right(boresight, sun);
        let (up, right) = (level.column(0), level.column(1));
        let (sin, cos) = self.roll_deg.to_radians().sin_cos();
        Matrix3::from_columns(&[*boresight, right * cos - up * sin, up * cos + right * sin])
    }

    /// By how much a telescope turns about its boresight while that moves a little: what its up is counted from turns with the azimuth, or as
    /// an axis does that is carried along great circles from the Sun (by the area between two of them).
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

    /// How the boresight moves, rad of true angle across (towards larger azimuth) and in elevation: with the point on the plane,
    /// and with the Sun (towards the zenith and clockwise). Central differences, exact to 1e-6 of themselves up to 85 deg of elevation.
    ///
    /// # Errors
    /// As [`boresight`](Self::boresight).
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

/// Where a telescope without roll points that has the Sun above and to the right of its boresight, by the tangents of these
/// angles. Its elevation E follows from the Sun's vertical component, (sin E + above cos E) / secant of the Sun's angle; its azimuth
/// from the horizontal ones. Of two boresights, on both sides of the zenith, it is the one within 90 deg of the Sun's azimuth.
fn from_telescope(
    above_and_right: Vector2<f64>,
    sun: &Vector3<f64>,
) -> Result<Vector3<f64>, PointingError> {
    let (above, right) = (above_and_right.x, above_and_right.y);
    let secant = above_and_right.norm().hypot(1.0);
    let elevation = (sun.z * secant / above.hypot(1.0)).asin() - above.atan();
    // Where the sine exceeds 1 the elevation is NaN, which fails the comparison.
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

/// A direction on the plane that touches the sky at another: towards the zenith, and clockwise.
pub(super) fn gnomonic(at: &Vector3<f64>, of: &Vector3<f64>) -> Vector2<f64> {
    axes(at).transpose() * of / of.dot(at)
}

/// The axes at the Sun as they come along the great circle to another direction.
fn carried(sun: &Vector3<f64>, to: &Vector3<f64>) -> Matrix3x2<f64> {
    let along = Rotation3::rotation_between(sun, to);
    along.map_or(axes(sun), |along| along * axes(sun))
}

/// The axes of the plane that touches the sky at a direction, as columns: towards the zenith, and clockwise, which is towards
/// larger azimuth.
fn axes(at: &Vector3<f64>) -> Matrix3x2<f64> {
    let (up, clockwise) = tangents(at);
    Matrix3x2::from_columns(&[up, clockwise])
}
