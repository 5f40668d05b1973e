//! Position, size and orientation of the Sun and the Moon for an observer on or above the Earth.
//!
//! Positions are topocentric and without refraction (at 38 km it is 0.9 arcsec at 15 deg of elevation;
//! [`Air`] computes it). They use the IAU's SOFA routines (crate `sofars`): the Earth's position by `epv00`, the Moon's by
//! `moon98`, accurate to about 10 arcsec; leap seconds, UT1 and polar motion by the IERS's table ([`OrientationTable`]).
//!
//! The Sun's radius and rotation axis are the IAU's (radius 695 700 km, resolution B3 of 2015; pole at right
//! ascension 286.13 deg and declination 63.87 deg, prime meridian 84.176 deg + 14.1844 deg/day, Archinal et
//! al. 2018).

mod events;
mod observer;
mod orientation;
mod refraction;
pub mod sphere;
pub mod visibility;

pub use events::{Crossing, Rising, crossings, horizon_deg, horizon_dip_deg, spells};
pub use orientation::{EarthOrientation, Extrapolated, OrientationTable, TableError};
pub use refraction::Air;

use crate::reasons::pointing as reasons;
use crate::units::{ARCSEC_PER_RAD, Place, PlaceError, Rejected};
use jiff::Timestamp;
use jiff::civil::Date;
use nalgebra::Vector3;
use observer::{Earth, JulianDate, LIGHT_DAYS_PER_AU, Observer, Second};
use orientation::ARCSEC_PER_S;
use sofars::eph::moon98;
use sphere::{angles_deg, bearing_rad, direction, separation_rad, tangents};
use std::sync::Arc;

/// The astronomical unit (IAU 2012, resolution B2).
pub const AU_KM: f64 = 149_597_870.7;
/// Nominal solar radius (IAU 2015, resolution B3).
pub const SUN_RADIUS_KM: f64 = 695_700.0;
const MOON_RADIUS_KM: f64 = 1_737.4;
const SUN_POLE_DEG: [f64; 2] = [286.13, 63.87];
const SUN_PRIME_MERIDIAN_DEG: f64 = 84.176;
/// Sidereal rotation rate of the Carrington longitudes.
pub const SUN_ROTATION_DEG_PER_DAY: f64 = 14.1844;

/// Reasons for which a position cannot be computed.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SkyError {
    #[error("expected a date from 1900 to 2100, as the Earth's ephemeris goes, found {0}")]
    Date(Timestamp),
    #[error(
        "expected a date from {first} on, where the table of Earth orientation begins, found {utc}"
    )]
    Orientation { utc: Timestamp, first: Date },
    #[error(transparent)]
    Place(#[from] PlaceError),
}

impl SkyError {
    /// The error as a frame's reason. Dates are decimal years.
    pub fn rejected(&self) -> Rejected {
        let year = |utc: &Timestamp| 1970.0 + utc.as_second() as f64 / (365.2425 * 86_400.0);
        let (reason, measured, limit) = match self {
            Self::Date(utc) => (reasons::DATE, year(utc), 2100.0),
            Self::Orientation { utc, first } => {
                let limit = f64::from(first.year()) + f64::from(first.day_of_year() - 1) / 365.25;
                (reasons::ORIENTATION, year(utc), limit)
            }
            Self::Place(PlaceError::Latitude(found)) => (reasons::LATITUDE, *found, 90.0),
            Self::Place(PlaceError::Longitude(found)) => (reasons::LONGITUDE, *found, 360.0),
            Self::Place(PlaceError::Height(found)) => (reasons::HEIGHT, *found, 1e5),
            Self::Place(PlaceError::Format(_)) => (reasons::PLACE, 0.0, 0.0),
        };
        Rejected {
            reason,
            measured,
            limit,
        }
    }
}

/// The Sun as seen by an observer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SunPosition {
    /// Azimuth from north through east.
    pub azimuth_deg: f64,
    /// Elevation without refraction.
    pub elevation_deg: f64,
    /// Angular radius as seen from the Earth's centre.
    pub radius_arcsec: f64,
    /// Distance from the observer.
    pub distance_au: f64,
    /// Direction of solar north from the zenith, clockwise (towards larger azimuth) as seen looking out.
    pub zenith_to_north_deg: f64,
    /// Direction of solar north from celestial north, towards east.
    pub p_deg: f64,
    /// Heliographic latitude of the disc's centre as seen from the Earth's centre.
    pub b0_deg: f64,
    /// Carrington longitude of the disc's centre as seen from the Earth's centre, 0 to 360.
    pub l0_deg: f64,
    /// Shift of the Sun for 1 sigma of UT1: towards larger azimuth (true angle) and up. Zero within the table of Earth orientation.
    pub ut1_shift_arcsec: [f64; 2],
}

/// The Moon as seen by an observer.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MoonPosition {
    /// Azimuth from north through east.
    pub azimuth_deg: f64,
    /// Elevation without refraction.
    pub elevation_deg: f64,
    /// Angular radius as seen by the observer.
    pub radius_arcsec: f64,
    /// Distance from the observer.
    pub distance_km: f64,
    /// The angle between the Sun and the observer as seen from the Moon: 0 full, 180 new.
    pub phase_angle_deg: f64,
    /// Direction of the middle of the bright limb from celestial north, towards east, 0 to 360.
    pub bright_limb_deg: f64,
    /// The same from the zenith, clockwise (towards larger azimuth) as seen looking out, -180 to 180.
    pub zenith_to_bright_limb_deg: f64,
}

/// Orientation of the Sun as seen from the Earth's centre, and its distance.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Disc {
    pub b0_deg: f64,
    /// Carrington longitude of the disc's centre, 0 to 360.
    pub l0_deg: f64,
    pub distance_au: f64,
}

impl Disc {
    /// The Sun's angular radius at this distance.
    pub fn radius_arcsec(&self) -> f64 {
        solar_radius_arcsec(self.distance_au * AU_KM)
    }
}

impl From<&SunPosition> for Disc {
    fn from(sun: &SunPosition) -> Self {
        Self {
            b0_deg: sun.b0_deg,
            l0_deg: sun.l0_deg,
            distance_au: sun.distance_au,
        }
    }
}

/// Sun and Moon for any place and instant. Expensive quantities are computed once for a second and reused for further instants in it;
/// results do not depend on earlier calls.
#[derive(Debug, Clone)]
pub struct Ephemeris {
    table: Arc<OrientationTable>,
    second: Option<Second>,
}

impl Default for Ephemeris {
    /// Uses the built-in table of Earth orientation.
    fn default() -> Self {
        Self::new(OrientationTable::built_in())
    }
}

impl Ephemeris {
    pub fn new(table: Arc<OrientationTable>) -> Self {
        Self {
            table,
            second: None,
        }
    }

    /// The Sun from a place at an instant.
    ///
    /// # Errors
    /// If the date is before the table of Earth orientation, or the place is outside its ranges.
    pub fn sun(&mut self, utc: Timestamp, place: Place) -> Result<SunPosition, SkyError> {
        let orientation = self.table.at(utc)?;
        let observer = self.observer(utc, place, &orientation)?;
        let from_observer = sun_from(&observer);
        // Solar north: transform a step along the axis in the same way. Its length is arbitrary, because the step stays in the plane of
        // the Sun's centre and its axis; a long one avoids rounding errors.
        let north_of_it = from_observer + sun_pole() * 1e-3;
        let [centre, north] = [from_observer, north_of_it].map(|v| observer.equatorial(&v));
        let [centre_up, north_up] = [centre, north].map(|v| observer.horizontal(&v));
        let (azimuth_deg, elevation_deg) = angles_deg(&centre_up);
        let disc = disc(&observer.earth);
        Ok(SunPosition {
            azimuth_deg,
            elevation_deg,
            radius_arcsec: sun_radius_arcsec(&observer.earth),
            distance_au: from_observer.norm(),
            zenith_to_north_deg: bearing_rad(&centre_up, &north_up).to_degrees(),
            p_deg: bearing_rad(&centre, &north).to_degrees(),
            b0_deg: disc.b0_deg,
            l0_deg: disc.l0_deg,
            ut1_shift_arcsec: match orientation.ut1_sigma_s {
                0.0 => [0.0; 2],
                sigma_s => diurnal_arcsec(&observer, &centre_up, sigma_s),
            },
        })
    }

    /// Whether the orientation of the Earth at an instant is extrapolated beyond the end of its table.
    pub fn extrapolates(&self, utc: Timestamp) -> Option<Extrapolated> {
        self.table.extrapolates(utc)
    }

    /// The Moon from a place at an instant.
    ///
    /// # Errors
    /// Those of [`sun`](Self::sun).
    pub fn moon(&mut self, utc: Timestamp, place: Place) -> Result<MoonPosition, SkyError> {
        let orientation = self.table.at(utc)?;
        let observer = self.observer(utc, place, &orientation)?;
        let moon = moon_from(&observer);
        let sun = sun_from(&observer);
        let [moon_apparent, sun_apparent] = [moon, sun].map(|v| observer.equatorial(&v));
        let [moon_up, sun_up] = [moon_apparent, sun_apparent].map(|v| observer.horizontal(&v));
        let (azimuth_deg, elevation_deg) = angles_deg(&moon_up);
        let distance_km = moon.norm() * AU_KM;
        let bright_limb_deg = bearing_rad(&moon_apparent, &sun_apparent).to_degrees();
        Ok(MoonPosition {
            azimuth_deg,
            elevation_deg,
            radius_arcsec: (MOON_RADIUS_KM / distance_km).asin() * ARCSEC_PER_RAD,
            distance_km,
            phase_angle_deg: separation_rad(&(sun - moon), &-moon).to_degrees(),
            bright_limb_deg: bright_limb_deg.rem_euclid(360.0),
            zenith_to_bright_limb_deg: bearing_rad(&moon_up, &sun_up).to_degrees(),
        })
    }

    /// The geometric positions of the Moon and the Sun from the Earth's centre, au, axes of the ICRS, without light time.
    ///
    /// # Errors
    /// If the date is before the table of Earth orientation.
    pub fn geocentric(&mut self, utc: Timestamp) -> Result<[Vector3<f64>; 2], SkyError> {
        let orientation = self.table.at(utc)?;
        let earth = self.second(utc, &orientation)?.earth(utc);
        let moon = Vector3::from(moon98(earth.tt.0, earth.tt.1)[0]);
        Ok([moon, -earth.heliocentric[0]])
    }

    /// Orientation of the Sun as seen from the Earth's centre.
    ///
    /// # Errors
    /// If the date is before the table of Earth orientation.
    pub fn disc(&mut self, utc: Timestamp) -> Result<Disc, SkyError> {
        let orientation = self.table.at(utc)?;
        Ok(disc(&self.second(utc, &orientation)?.earth(utc)))
    }

    fn observer(
        &mut self,
        utc: Timestamp,
        place: Place,
        orientation: &EarthOrientation,
    ) -> Result<Observer, SkyError> {
        let second = self.second(utc, orientation)?;
        Observer::new(utc, place, orientation, second)
    }

    fn second(
        &mut self,
        utc: Timestamp,
        orientation: &EarthOrientation,
    ) -> Result<&Second, SkyError> {
        let second = match self.second.take().filter(|second| second.holds(utc)) {
            Some(second) => second,
            None => Second::of(utc, orientation)?,
        };
        Ok(self.second.insert(second))
    }
}

/// The Sun's angular radius as seen from the Earth's centre, arcsec: far cheaper than [`Ephemeris::sun`], and for any date from 1900 to 2100.
///
/// # Errors
/// If the date is outside these years.
pub fn sun_angular_radius(utc: Timestamp) -> Result<f64, SkyError> {
    /// Difference of terrestrial time and UTC, accurate to a minute and a half; the radius changes by 0.0003 arcsec in that time.
    const AHEAD_S: f64 = 69.2;
    let earth = Earth::at(JulianDate::ahead_of(utc, AHEAD_S), utc)?;
    Ok(sun_radius_arcsec(&earth))
}

/// Position of the Sun relative to the observer, corrected for light time, au.
fn sun_from(observer: &Observer) -> Vector3<f64> {
    let light_days = observer.earth.heliocentric[0].norm() * LIGHT_DAYS_PER_AU;
    observer.earth.sun_before(light_days) - observer.barycentric()
}

/// Position of the Moon relative to the observer, corrected for light time, au.
fn moon_from(observer: &Observer) -> Vector3<f64> {
    let [earth, earth_velocity] = observer.earth.barycentric;
    let mut light_days = 0.0;
    let mut moon = Vector3::zeros();
    for _ in 0..3 {
        let then = observer.earth.tt.plus_days(-light_days);
        let geocentric = Vector3::from(moon98(then.0, then.1)[0]);
        moon = geocentric + earth - earth_velocity * light_days - observer.barycentric();
        light_days = moon.norm() * LIGHT_DAYS_PER_AU;
    }
    moon
}

/// Shift of a direction by the Earth's rotation in a time, arcsec: towards larger azimuth, and up.
fn diurnal_arcsec(observer: &Observer, horizontal: &Vector3<f64>, time_s: f64) -> [f64; 2] {
    let pole = observer.horizontal(&Vector3::z());
    let moved = horizontal.normalize().cross(&pole) * (ARCSEC_PER_S * time_s);
    let (up, across) = tangents(horizontal);
    [moved.dot(&across), moved.dot(&up)]
}

fn sun_radius_arcsec(earth: &Earth) -> f64 {
    solar_radius_arcsec(earth.heliocentric[0].norm() * AU_KM)
}

/// The Sun's angular radius at a distance from its centre.
pub fn solar_radius_arcsec(distance_km: f64) -> f64 {
    (SUN_RADIUS_KM / distance_km).asin() * ARCSEC_PER_RAD
}

fn sun_pole() -> Vector3<f64> {
    direction(SUN_POLE_DEG[0], SUN_POLE_DEG[1])
}

/// Orientation of the Sun as seen from the Earth's centre.
fn disc(earth: &Earth) -> Disc {
    let from_sun = earth.heliocentric[0];
    let pole = sun_pole();
    // The ascending node of the solar equator on that of the ICRS: the origin of the rotation angle.
    let node = direction(SUN_POLE_DEG[0] + 90.0, 0.0);
    let quarter = pole.cross(&node);
    let seen = Vector3::new(
        from_sun.dot(&node),
        from_sun.dot(&quarter),
        from_sun.dot(&pole),
    );
    let (from_node_deg, b0_deg) = angles_deg(&seen);
    let distance_au = from_sun.norm();
    let from_surface_au = distance_au - SUN_RADIUS_KM / AU_KM;
    let left = earth.tt.plus_days(-from_surface_au * LIGHT_DAYS_PER_AU);
    let turned_deg = SUN_ROTATION_DEG_PER_DAY * left.days_since_j2000();
    Disc {
        b0_deg,
        l0_deg: (from_node_deg - SUN_PRIME_MERIDIAN_DEG - turned_deg).rem_euclid(360.0),
        distance_au,
    }
}
