//! From places in the solar system to the observer's horizon at one instant: the IAU's chain (SOFA) with
//! light time left to the caller, aberration, precession and nutation, Earth rotation, and no refraction.

use super::SkyError;
use crate::units::{ARCSEC_PER_RAD, Place};
use jiff::{Timestamp, tz::Offset};
use nalgebra::Vector3;
use sofars::astro::{IauAstrom, ab, apco13, atioq};
use sofars::eph::epv00;
use sofars::ts::{dtf2d, taitt, utctai};
use sofars::vm::rxp;

/// Light's time for one astronomical unit, days.
pub(super) const LIGHT_DAYS_PER_AU: f64 = 499.004_783_836 / 86_400.0;

/// Years for which positions are given: from the first leap second to the end of the Earth ephemeris.
const YEARS: std::ops::RangeInclusive<i16> = 1972..=2099;

/// How the Earth stands within its mean rotation (IERS).
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct EarthOrientation {
    /// UT1 - UTC, s. One second moves every azimuth by up to 15 arcsec.
    pub ut1_utc_s: f64,
    /// The pole's place, arcsec.
    pub xp_arcsec: f64,
    pub yp_arcsec: f64,
}

impl EarthOrientation {
    /// The orientation used when the caller has none: the mean one, within 0.9 s and 0.6 arcsec of the true.
    pub fn at(_utc: Timestamp) -> Self {
        Self::default()
    }
}

/// An instant in two parts, as SOFA takes it: Julian date = first + second.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct JulianDate(pub f64, pub f64);

impl JulianDate {
    /// An instant in coordinated universal time (SOFA's quasi Julian date).
    fn utc(utc: Timestamp) -> Result<Self, SkyError> {
        let t = Offset::UTC.to_datetime(utc);
        if !YEARS.contains(&t.year()) {
            return Err(SkyError::Date(utc));
        }
        let second = f64::from(t.second()) + f64::from(t.subsec_nanosecond()) * 1e-9;
        let [month, day, hour, minute] = [t.month(), t.day(), t.hour(), t.minute()].map(i32::from);
        let date = dtf2d("UTC", t.year().into(), month, day, hour, minute, second);
        date.map(|(a, b)| Self(a, b))
            .map_err(|status| SkyError::TimeScale { utc, status })
    }

    /// An instant in terrestrial time.
    pub fn terrestrial(utc: Timestamp) -> Result<Self, SkyError> {
        let Self(a, b) = Self::utc(utc)?;
        utctai(a, b)
            .and_then(|(a, b)| taitt(a, b))
            .map(|(a, b)| Self(a, b))
            .map_err(|status| SkyError::TimeScale { utc, status })
    }

    pub fn minus_days(self, days: f64) -> Self {
        Self(self.0, self.1 - days)
    }

    /// Days since J2000.0.
    pub fn days_since_j2000(self) -> f64 {
        (self.0 - 2_451_545.0) + self.1
    }
}

/// Position and velocity of the Earth, au and au/day, axes of the ICRS.
pub(super) struct Earth {
    /// From the Sun.
    pub heliocentric: [Vector3<f64>; 2],
    /// From the barycentre of the solar system.
    pub barycentric: [Vector3<f64>; 2],
}

impl Earth {
    pub fn at(tt: JulianDate, utc: Timestamp) -> Result<Self, SkyError> {
        let (heliocentric, barycentric) = epv00(tt.0, tt.1).ok_or(SkyError::Date(utc))?;
        Ok(Self {
            heliocentric: heliocentric.map(Vector3::from),
            barycentric: barycentric.map(Vector3::from),
        })
    }

    /// The Sun from the barycentre, some days before; its path within an hour is straight to a metre.
    pub fn sun_before(&self, days: f64) -> Vector3<f64> {
        let velocity = self.barycentric[1] - self.heliocentric[1];
        self.barycentric[0] - self.heliocentric[0] - velocity * days
    }
}

/// An observer at one instant.
pub(super) struct Observer {
    pub tt: JulianDate,
    pub earth: Earth,
    astrometry: IauAstrom,
}

impl Observer {
    pub fn new(utc: Timestamp, place: Place, pole: EarthOrientation) -> Result<Self, SkyError> {
        let place = Place::new(place.latitude_deg, place.longitude_deg, place.height_m)?;
        let JulianDate(utc1, utc2) = JulianDate::utc(utc)?;
        let tt = JulianDate::terrestrial(utc)?;
        let mut astrometry = IauAstrom::default();
        let mut equation_of_origins = 0.0;
        apco13(
            utc1,
            utc2,
            pole.ut1_utc_s,
            place.longitude_deg.to_radians(),
            place.latitude_deg.to_radians(),
            place.height_m,
            pole.xp_arcsec / ARCSEC_PER_RAD,
            pole.yp_arcsec / ARCSEC_PER_RAD,
            0.0, // no air: no refraction
            0.0,
            0.0,
            0.63,
            &mut astrometry,
            &mut equation_of_origins,
        )
        .map_err(|status| SkyError::TimeScale { utc, status })?;
        Ok(Self {
            tt,
            earth: Earth::at(tt, utc)?,
            astrometry,
        })
    }

    /// The observer from the barycentre, au.
    pub fn barycentric(&self) -> Vector3<f64> {
        self.astrometry.eb.into()
    }

    /// The apparent direction of a vector from the observer, in the true equator of date: x towards the
    /// celestial intermediate origin, z towards the pole.
    pub fn equatorial(&self, from_observer: &Vector3<f64>) -> Vector3<f64> {
        let a = &self.astrometry;
        let proper = ab(&from_observer.normalize().into(), &a.v, a.em, a.bm1);
        let mut intermediate = [0.0; 3];
        rxp(&a.bpn, &proper, &mut intermediate);
        intermediate.into()
    }

    /// The direction of an apparent equatorial one in the horizon's frame: north, east, up.
    pub fn horizontal(&self, equatorial: &Vector3<f64>) -> Vector3<f64> {
        let ascension = equatorial.y.atan2(equatorial.x);
        let declination = equatorial.z.atan2(equatorial.x.hypot(equatorial.y));
        let (azimuth, zenith_distance, ..) = atioq(ascension, declination, &self.astrometry);
        let (sin, cos) = zenith_distance.sin_cos();
        Vector3::new(sin * azimuth.cos(), sin * azimuth.sin(), cos)
    }
}
