//! Transforms positions in the solar system to the observer's horizon at one instant: the IAU's chain (SOFA) with aberration, precession
//! and nutation, and Earth rotation; the caller corrects for light time, and there is no refraction.

use super::{EarthOrientation, SkyError};
use crate::units::{ARCSEC_PER_RAD, Place};
use jiff::Timestamp;
use nalgebra::Vector3;
use sofars::astro::{IauAstrom, ab, apco, atioq};
use sofars::eph::epv00;
use sofars::erst::era00;
use sofars::pnp::{bpn2xy, pnm06a, s06, sp00};
use sofars::vm::rxp;

/// Light time for one astronomical unit, days.
pub(super) const LIGHT_DAYS_PER_AU: f64 = 499.004_783_836 / 86_400.0;

/// Terrestrial time - TAI.
const TT_TAI_S: f64 = 32.184;
const DAY_S: i64 = 86_400;

/// An instant in two parts, as used by SOFA: Julian date = first + second.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct JulianDate(pub f64, pub f64);

impl JulianDate {
    /// The date of a clock that is ahead of UTC.
    pub fn ahead_of(utc: Timestamp, ahead_s: f64) -> Self {
        let (days, second) = (
            utc.as_second().div_euclid(DAY_S),
            utc.as_second().rem_euclid(DAY_S),
        );
        let second = second as f64 + f64::from(utc.subsec_nanosecond()) * 1e-9;
        Self(2_440_587.5 + days as f64, (second + ahead_s) / DAY_S as f64)
    }

    pub fn terrestrial(utc: Timestamp, orientation: &EarthOrientation) -> Self {
        Self::ahead_of(utc, orientation.tai_utc_s + TT_TAI_S)
    }

    pub fn plus_days(self, days: f64) -> Self {
        Self(self.0, self.1 + days)
    }

    /// Days since J2000.0.
    pub fn days_since_j2000(self) -> f64 {
        (self.0 - 2_451_545.0) + self.1
    }
}

/// Position and velocity of the Earth, au and au/day, axes of the ICRS.
#[derive(Debug, Clone)]
pub(super) struct Earth {
    pub tt: JulianDate,
    /// Relative to the Sun.
    pub heliocentric: [Vector3<f64>; 2],
    /// Relative to the barycentre of the solar system.
    pub barycentric: [Vector3<f64>; 2],
}

impl Earth {
    /// Computed by SOFA's `epv00`; `utc` is for the error.
    pub fn at(tt: JulianDate, utc: Timestamp) -> Result<Self, SkyError> {
        let (heliocentric, barycentric) = epv00(tt.0, tt.1).ok_or(SkyError::Date(utc))?;
        Ok(Self {
            tt,
            heliocentric: heliocentric.map(Vector3::from),
            barycentric: barycentric.map(Vector3::from),
        })
    }

    /// The Earth a short time later; within a second its path is straight to 3 mm.
    fn after(&self, days: f64) -> Self {
        let moved =
            |[position, velocity]: [Vector3<f64>; 2]| [position + velocity * days, velocity];
        Self {
            tt: self.tt.plus_days(days),
            heliocentric: moved(self.heliocentric),
            barycentric: moved(self.barycentric),
        }
    }

    /// The Sun relative to the barycentre, `days` earlier; within an hour its path is straight to a metre.
    pub fn sun_before(&self, days: f64) -> Vector3<f64> {
        let velocity = self.barycentric[1] - self.heliocentric[1];
        self.barycentric[0] - self.heliocentric[0] - velocity * days
    }
}

/// The expensive part of the chain, computed once for a second: the Earth's position and the orientation of its axis. The axis moves by
/// less than 2e-6 arcsec in that time.
#[derive(Debug, Clone)]
pub(super) struct Second {
    start: Timestamp,
    earth: Earth,
    /// The celestial intermediate pole, and the locator of its origin.
    pole: [f64; 2],
    locator: f64,
}

impl Second {
    /// The second that contains an instant: the same for every instant in it.
    pub fn of(utc: Timestamp, orientation: &EarthOrientation) -> Result<Self, SkyError> {
        let start = whole_second(utc);
        let tt = JulianDate::terrestrial(start, orientation);
        let earth = Earth::at(tt, utc)?;
        let (x, y) = bpn2xy(&pnm06a(tt.0, tt.1));
        Ok(Self {
            start,
            earth,
            pole: [x, y],
            locator: s06(tt.0, tt.1, x, y),
        })
    }

    pub fn holds(&self, utc: Timestamp) -> bool {
        self.start == whole_second(utc)
    }

    /// The Earth at an instant of the second.
    pub fn earth(&self, utc: Timestamp) -> Earth {
        let days = utc.duration_since(self.start).as_secs_f64() / DAY_S as f64;
        self.earth.after(days)
    }
}

fn whole_second(utc: Timestamp) -> Timestamp {
    Timestamp::from_second(utc.as_second()).unwrap_or(utc)
}

/// An observer at one instant.
pub(super) struct Observer {
    pub earth: Earth,
    astrometry: IauAstrom,
}

impl Observer {
    pub fn new(
        utc: Timestamp,
        place: Place,
        orientation: &EarthOrientation,
        second: &Second,
    ) -> Result<Self, SkyError> {
        let place = Place::new(place.latitude_deg, place.longitude_deg, place.height_m)?;
        let earth = second.earth(utc);
        let tt = earth.tt;
        let ut1 = JulianDate::ahead_of(utc, orientation.ut1_utc_s);
        let mut astrometry = IauAstrom::default();
        apco(
            tt.0,
            tt.1,
            &earth.barycentric.map(Into::into),
            &earth.heliocentric[0].into(),
            second.pole[0],
            second.pole[1],
            second.locator,
            era00(ut1.0, ut1.1),
            place.longitude_deg.to_radians(),
            place.latitude_deg.to_radians(),
            place.height_m,
            orientation.x_arcsec / ARCSEC_PER_RAD,
            orientation.y_arcsec / ARCSEC_PER_RAD,
            sp00(tt.0, tt.1),
            0.0, // no air: no refraction
            0.0,
            &mut astrometry,
        );
        Ok(Self { earth, astrometry })
    }

    /// The observer relative to the barycentre, au.
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

    /// Transforms an apparent equatorial direction to the horizon's frame: north, east, up.
    pub fn horizontal(&self, equatorial: &Vector3<f64>) -> Vector3<f64> {
        let ascension = equatorial.y.atan2(equatorial.x);
        let declination = equatorial.z.atan2(equatorial.x.hypot(equatorial.y));
        let (azimuth, zenith_distance, ..) = atioq(ascension, declination, &self.astrometry);
        let (sin, cos) = zenith_distance.sin_cos();
        Vector3::new(sin * azimuth.cos(), sin * azimuth.sin(), cos)
    }
}
