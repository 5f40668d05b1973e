//! Where the Sun and the Moon stand, how large they are and how they are turned, for an observer on or above
//! the Earth.
//!
//! Positions are topocentric and without refraction: at 4 hPa, a balloon's height, it is about 1 arcsec at 15 deg
//! of elevation. They come from the IAU's SOFA routines (crate `sofars`): the Earth's place by `epv00`, within
//! 0.02 arcsec as seen from the Sun, the Moon's by `moon98`, good to about 10 arcsec. Against astropy the Sun
//! agrees to 0.4 arcsec when UT1 - UTC is given (the rest is polar motion); without it azimuth errs by up to
//! 14 arcsec.
//!
//! The Sun's radius and rotation axis are the IAU's (radius 695 700 km, resolution B3 of 2015; pole at right
//! ascension 286.13 deg and declination 63.87 deg, prime meridian 84.176 deg + 14.1844 deg/day, Archinal et
//! al. 2018).

mod observer;
pub mod sphere;

pub use observer::EarthOrientation;

use crate::units::{ARCSEC_PER_RAD, Place, PlaceError};
use jiff::Timestamp;
use nalgebra::Vector3;
use observer::{Earth, JulianDate, LIGHT_DAYS_PER_AU, Observer};
use sofars::eph::moon98;
use sphere::{angles_deg, bearing_rad, direction, separation_rad};

const AU_KM: f64 = 149_597_870.7;
const SUN_RADIUS_KM: f64 = 695_700.0;
const MOON_RADIUS_KM: f64 = 1_737.4;
const SUN_POLE_DEG: [f64; 2] = [286.13, 63.87];
const SUN_PRIME_MERIDIAN_DEG: f64 = 84.176;
const SUN_ROTATION_DEG_PER_DAY: f64 = 14.1844;

/// Why a position cannot be given.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SkyError {
    #[error("expected a date from 1972 to 2099, found {0}")]
    Date(Timestamp),
    #[error(transparent)]
    Place(#[from] PlaceError),
    #[error("no terrestrial time for {utc} (SOFA status {status})")]
    TimeScale { utc: Timestamp, status: i32 },
}

/// The Sun as an observer sees it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SunPosition {
    /// From north through east.
    pub azimuth_deg: f64,
    /// Without refraction.
    pub elevation_deg: f64,
    /// Angular radius as seen from the Earth's centre.
    pub radius_arcsec: f64,
    /// From the observer.
    pub distance_au: f64,
    /// Direction of solar north from the zenith, clockwise (towards larger azimuth) as seen looking out.
    pub zenith_to_north_deg: f64,
    /// Direction of solar north from celestial north, towards east.
    pub p_deg: f64,
    /// Heliographic latitude of the disc's centre as seen from the Earth's centre.
    pub b0_deg: f64,
    /// Carrington longitude of the disc's centre as seen from the Earth's centre, 0 to 360.
    pub l0_deg: f64,
}

/// The Moon as an observer sees it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MoonPosition {
    /// From north through east.
    pub azimuth_deg: f64,
    /// Without refraction.
    pub elevation_deg: f64,
    /// Angular radius as seen by the observer.
    pub radius_arcsec: f64,
    /// From the observer.
    pub distance_km: f64,
    /// The angle between the Sun and the observer as seen from the Moon: 0 full, 180 new.
    pub phase_angle_deg: f64,
    /// Direction of the middle of the bright limb from celestial north, towards east, 0 to 360.
    pub bright_limb_deg: f64,
    /// The same from the zenith, clockwise (towards larger azimuth) as seen looking out, -180 to 180.
    pub zenith_to_bright_limb_deg: f64,
}

/// The Sun from a place at an instant, with the Earth's orientation known to the program.
///
/// # Errors
/// A date outside 1972 to 2099, or a place outside its ranges.
pub fn sun(utc: Timestamp, place: Place) -> Result<SunPosition, SkyError> {
    sun_with(utc, place, EarthOrientation::at(utc))
}

/// As [`sun`], with the Earth's orientation given.
pub fn sun_with(
    utc: Timestamp,
    place: Place,
    orientation: EarthOrientation,
) -> Result<SunPosition, SkyError> {
    let observer = Observer::new(utc, place, orientation)?;
    let from_observer = sun_from(&observer);
    // Solar north: a step along the axis through the same chain. Any length serves, for the step stays in
    // the plane of the Sun's centre and its axis; a long one keeps its digits.
    let north_of_it = from_observer + sun_pole() * 1e-3;
    let [centre, north] = [from_observer, north_of_it].map(|v| observer.equatorial(&v));
    let [centre_up, north_up] = [centre, north].map(|v| observer.horizontal(&v));
    let (azimuth_deg, elevation_deg) = angles_deg(&centre_up);
    let (b0_deg, l0_deg) = disc_centre(observer.tt, &observer.earth.heliocentric[0]);
    Ok(SunPosition {
        azimuth_deg,
        elevation_deg,
        radius_arcsec: sun_radius_arcsec(&observer.earth),
        distance_au: from_observer.norm(),
        zenith_to_north_deg: bearing_rad(&centre_up, &north_up).to_degrees(),
        p_deg: bearing_rad(&centre, &north).to_degrees(),
        b0_deg,
        l0_deg,
    })
}

/// The Sun's angular radius as seen from the Earth's centre, arcsec: far cheaper than [`sun`].
///
/// # Errors
/// A date outside 1972 to 2099.
pub fn sun_angular_radius(utc: Timestamp) -> Result<f64, SkyError> {
    let earth = Earth::at(JulianDate::terrestrial(utc)?, utc)?;
    Ok(sun_radius_arcsec(&earth))
}

/// The Moon from a place at an instant, with the Earth's orientation known to the program.
///
/// # Errors
/// As for [`sun`].
pub fn moon(utc: Timestamp, place: Place) -> Result<MoonPosition, SkyError> {
    moon_with(utc, place, EarthOrientation::at(utc))
}

/// As [`moon`], with the Earth's orientation given.
pub fn moon_with(
    utc: Timestamp,
    place: Place,
    orientation: EarthOrientation,
) -> Result<MoonPosition, SkyError> {
    let observer = Observer::new(utc, place, orientation)?;
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

/// The Sun from the observer when the light that arrives now left it, au.
fn sun_from(observer: &Observer) -> Vector3<f64> {
    let light_days = observer.earth.heliocentric[0].norm() * LIGHT_DAYS_PER_AU;
    observer.earth.sun_before(light_days) - observer.barycentric()
}

/// The Moon from the observer when the light that arrives now left it, au.
fn moon_from(observer: &Observer) -> Vector3<f64> {
    let [earth, earth_velocity] = observer.earth.barycentric;
    let mut light_days = 0.0;
    let mut moon = Vector3::zeros();
    for _ in 0..3 {
        let then = observer.tt.minus_days(light_days);
        let geocentric = Vector3::from(moon98(then.0, then.1)[0]);
        moon = geocentric + earth - earth_velocity * light_days - observer.barycentric();
        light_days = moon.norm() * LIGHT_DAYS_PER_AU;
    }
    moon
}

fn sun_radius_arcsec(earth: &Earth) -> f64 {
    let distance_km = earth.heliocentric[0].norm() * AU_KM;
    (SUN_RADIUS_KM / distance_km).asin() * ARCSEC_PER_RAD
}

fn sun_pole() -> Vector3<f64> {
    direction(SUN_POLE_DEG[0], SUN_POLE_DEG[1])
}

/// Heliographic latitude and Carrington longitude of the disc's centre, deg.
fn disc_centre(tt: JulianDate, earth_from_sun: &Vector3<f64>) -> (f64, f64) {
    let pole = sun_pole();
    // The ascending node of the solar equator on that of the ICRS, from which rotation counts.
    let node = direction(SUN_POLE_DEG[0] + 90.0, 0.0);
    let quarter = pole.cross(&node);
    let earth = Vector3::new(
        earth_from_sun.dot(&node),
        earth_from_sun.dot(&quarter),
        earth_from_sun.dot(&pole),
    );
    let (from_node_deg, b0_deg) = angles_deg(&earth);
    let from_surface_au = earth_from_sun.norm() - SUN_RADIUS_KM / AU_KM;
    let light_days = from_surface_au * LIGHT_DAYS_PER_AU;
    let days = tt.minus_days(light_days).days_since_j2000();
    let meridian_deg = SUN_PRIME_MERIDIAN_DEG + SUN_ROTATION_DEG_PER_DAY * days;
    (b0_deg, (from_node_deg - meridian_deg).rem_euclid(360.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Row {
        utc: Timestamp,
        place: Place,
        orientation: EarthOrientation,
        values: Vec<f64>,
    }

    /// Positions from astropy and sunpy; the columns from the Sun's azimuth on are in `values`.
    fn oracle() -> Vec<Row> {
        include_str!("../../tests/data/sky.csv")
            .lines()
            .filter(|line| !line.starts_with('#'))
            .skip(1)
            .map(|line| {
                let (utc, rest) = line.split_once(',').unwrap();
                let numbers: Vec<f64> = rest.split(',').map(|n| n.parse().unwrap()).collect();
                Row {
                    utc: format!("{utc}Z").parse().unwrap(),
                    place: Place::new(numbers[0], numbers[1], numbers[2]).unwrap(),
                    orientation: EarthOrientation {
                        ut1_utc_s: numbers[14],
                        ..Default::default()
                    },
                    values: numbers[3..].to_vec(),
                }
            })
            .collect()
    }

    fn assert_near(found: f64, expected: f64, tolerance: f64, what: &str) {
        let off = found - expected;
        assert!(off.abs() <= tolerance, "{what}: {found}, off by {off:e}");
    }

    /// Azimuth error times cos(elevation) and elevation error against (azimuth, elevation), deg.
    fn assert_direction(found: (f64, f64), expected: (f64, f64), tolerance_deg: f64, what: &str) {
        let across = (found.0 - expected.0) * expected.1.to_radians().cos();
        assert_near(across, 0.0, tolerance_deg, what);
        assert_near(found.1, expected.1, tolerance_deg, what);
    }

    #[test]
    fn the_sun_stands_where_astropy_puts_it() {
        for row in oracle() {
            let v = &row.values;
            let sun = sun_with(row.utc, row.place, row.orientation).unwrap();
            let found = (sun.azimuth_deg, sun.elevation_deg);
            assert_direction(found, (v[0], v[1]), 1.0 / 3600.0, "direction");
            assert_near(sun.distance_au, v[2], 2e-7, "distance");
            assert_near(sun.radius_arcsec, v[3], 0.002, "radius");
        }
    }

    #[test]
    fn the_sun_is_turned_as_sunpy_says() {
        for row in oracle() {
            let v = &row.values;
            let sun = sun_with(row.utc, row.place, row.orientation).unwrap();
            assert_near(sun.p_deg, v[4], 0.01, "P");
            assert_near(sun.b0_deg, v[5], 0.01, "B0");
            assert_near(sun.l0_deg, v[6], 1e-4, "L0");
            assert_near(sun.zenith_to_north_deg, v[7], 0.01, "zenith to north");
        }
    }

    #[test]
    fn the_moon_stands_where_astropy_puts_it() {
        for row in oracle() {
            let v = &row.values;
            let moon = moon_with(row.utc, row.place, row.orientation).unwrap();
            let found = (moon.azimuth_deg, moon.elevation_deg);
            assert_direction(found, (v[8], v[9]), 1.0 / 3600.0, "direction");
            assert_near(moon.radius_arcsec, v[10], 0.01, "radius");
        }
    }

    #[test]
    fn without_the_earths_orientation_positions_hold_to_a_hundredth_of_a_degree() {
        for row in oracle() {
            let v = &row.values;
            let sun = sun(row.utc, row.place).unwrap();
            let found = (sun.azimuth_deg, sun.elevation_deg);
            assert_direction(found, (v[0], v[1]), 0.01, "direction");
            assert_near(sun.zenith_to_north_deg, v[7], 0.01, "zenith to north");
            let radius = sun_angular_radius(row.utc).unwrap();
            assert_near(radius, v[3], 0.002, "radius");
        }
    }

    #[test]
    fn the_moons_phase_is_that_of_the_almanac() {
        // Full Moon 2013-09-19 11:13 UTC and first quarter 2013-09-12 17:08 UTC (US Naval Observatory).
        let place = Place::new(34.49, -104.2218, 0.0).unwrap();
        let phase = |utc: &str| moon(utc.parse().unwrap(), place).unwrap();
        assert!(phase("2013-09-19T11:13:00Z").phase_angle_deg < 6.0);
        let quarter = phase("2013-09-12T17:08:00Z");
        assert_near(quarter.phase_angle_deg, 90.0, 2.0, "phase angle");
        // Waxing: the bright limb is the western one.
        assert_near(quarter.bright_limb_deg, 280.0, 15.0, "bright limb");
    }

    #[test]
    fn a_date_beyond_the_ephemeris_is_refused() {
        let place = Place::new(0.0, 0.0, 0.0).unwrap();
        for utc in ["1971-12-31T23:59:59Z", "2100-01-01T00:00:00Z"] {
            let utc: Timestamp = utc.parse().unwrap();
            assert_eq!(sun(utc, place), Err(SkyError::Date(utc)));
            assert_eq!(moon(utc, place), Err(SkyError::Date(utc)));
            assert_eq!(sun_angular_radius(utc), Err(SkyError::Date(utc)));
        }
        for utc in ["1972-01-01T00:00:00Z", "2099-12-31T23:59:59Z"] {
            assert!(sun(utc.parse().unwrap(), place).is_ok());
        }
    }

    #[test]
    fn a_place_that_is_none_is_refused() {
        let nowhere = Place {
            latitude_deg: f64::NAN,
            longitude_deg: 0.0,
            height_m: 0.0,
        };
        let utc = "2013-09-21T18:00:00Z".parse().unwrap();
        assert!(matches!(sun(utc, nowhere), Err(SkyError::Place(_))));
    }
}
