//! When the Moon can be seen from an orbit or a balloon: above the Earth's limb, and clear of the Sun.
//!
//! The Moon counts by its centre, the Earth as a sphere; air neither bends light nor hides it.

use super::sphere::{angles_deg, direction, separation_rad};
use super::{AU_KM, Ephemeris, SkyError, horizon_dip_deg};
use crate::units::{EARTH_RADIUS_M, Place};
use jiff::{SignedDuration, Timestamp};
use nalgebra::Vector3;
use std::f64::consts::{PI, TAU};

/// Of the Earth, km^3/s^2, and its oblateness with its equator, km (WGS 84).
const GRAVITY_KM3_PER_S2: f64 = 398_600.441_8;
const OBLATENESS: f64 = 1.082_63e-3;
const EQUATOR_KM: f64 = 6_378.137;
/// A turn of the Sun about the Earth, s.
const TROPICAL_YEAR_S: f64 = 365.242_19 * 86_400.0;

/// From where the Moon is looked at.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Vantage {
    /// A balloon that stays where it is.
    Place(Place),
    Orbit(SunSynchronous),
}

/// A circular orbit whose plane turns with the Sun.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SunSynchronous {
    pub height_km: f64,
    /// Local solar time at which it crosses the equator northwards, h.
    pub node_h: f64,
}

impl SunSynchronous {
    fn radius_km(&self) -> f64 {
        EQUATOR_KM + self.height_km
    }

    /// Mean motion, rad/s.
    fn motion_rad_per_s(&self) -> f64 {
        (GRAVITY_KM3_PER_S2 / self.radius_km().powi(3)).sqrt()
    }

    /// The inclination at which the Earth's oblateness turns the plane once a year.
    fn inclination_rad(&self) -> f64 {
        let turn = TAU / TROPICAL_YEAR_S;
        let flattening = 1.5 * OBLATENESS * (EQUATOR_KM / self.radius_km()).powi(2);
        (-turn / (flattening * self.motion_rad_per_s())).acos()
    }

    /// Where the satellite is, km, in the equator's axes, some time after it crossed the equator, for a Sun at a right ascension.
    fn position_km(&self, sun_ascension_rad: f64, since_s: f64) -> Vector3<f64> {
        let node = sun_ascension_rad + (self.node_h - 12.0) / 24.0 * TAU;
        let (sin_node, cos_node) = node.sin_cos();
        let (sin, cos) = (self.motion_rad_per_s() * since_s).sin_cos();
        let (sin_tilt, cos_tilt) = self.inclination_rad().sin_cos();
        let along = Vector3::new(cos_node, sin_node, 0.0);
        let north = Vector3::new(-sin_node * cos_tilt, cos_node * cos_tilt, sin_tilt);
        (along * cos + north * sin) * self.radius_km()
    }
}

/// The Moon at an instant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sight {
    pub above_limb_deg: f64,
    pub from_sun_deg: f64,
    /// The share of its disc that the Sun shines on.
    pub lit: f64,
}

/// The Moon from a vantage, over some time.
///
/// # Errors
/// Dates that the ephemeris does not know, or a place that is none.
pub fn sights(
    ephemeris: &mut Ephemeris,
    vantage: &Vantage,
    (from, to): (Timestamp, Timestamp),
    step: SignedDuration,
) -> Result<Vec<Sight>, SkyError> {
    let mut sights = Vec::new();
    let mut utc = from;
    while utc < to {
        sights.push(match vantage {
            Vantage::Place(place) => from_place(ephemeris, utc, *place)?,
            Vantage::Orbit(orbit) => {
                let since_s = utc.duration_since(from).as_secs_f64();
                from_orbit(ephemeris, utc, orbit, since_s)?
            }
        });
        utc = utc.checked_add(step).unwrap_or(to);
    }
    Ok(sights)
}

fn lit(phase_angle_rad: f64) -> f64 {
    (1.0 + phase_angle_rad.cos()) / 2.0
}

fn from_place(ephemeris: &mut Ephemeris, utc: Timestamp, place: Place) -> Result<Sight, SkyError> {
    let moon = ephemeris.moon(utc, place)?;
    let sun = ephemeris.sun(utc, place)?;
    let towards = [
        direction(moon.azimuth_deg, moon.elevation_deg),
        direction(sun.azimuth_deg, sun.elevation_deg),
    ];
    Ok(Sight {
        above_limb_deg: moon.elevation_deg + horizon_dip_deg(place.height_m),
        from_sun_deg: separation_rad(&towards[0], &towards[1]).to_degrees(),
        lit: lit(moon.phase_angle_deg.to_radians()),
    })
}

fn from_orbit(
    ephemeris: &mut Ephemeris,
    utc: Timestamp,
    orbit: &SunSynchronous,
    since_s: f64,
) -> Result<Sight, SkyError> {
    let [moon, sun] = ephemeris.geocentric(utc)?.map(|v| v * AU_KM);
    let sun_ascension = angles_deg(&sun).0.to_radians();
    let satellite = orbit.position_km(sun_ascension, since_s);
    let (to_moon, to_sun) = (moon - satellite, sun - satellite);
    let limb = (EARTH_RADIUS_M / 1e3 / satellite.norm()).asin();
    Ok(Sight {
        above_limb_deg: (separation_rad(&to_moon, &-satellite) - limb).to_degrees(),
        from_sun_deg: separation_rad(&to_moon, &to_sun).to_degrees(),
        lit: lit(separation_rad(&(sun - moon), &-moon)),
    })
}

/// What the study of a Moon sensor assumed ("The Development of a Moon Sensor", 2005, section 3.2): the Moon and the Sun far away in one plane, which stands
/// at right angles to the plane of the satellite's orbit; the Earth with its air hides a cone; the Moon within some angle of the Sun is not seen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Simplified {
    /// Half the angle that Earth and air hide.
    pub hidden_deg: f64,
    /// Between the Sun and the orbit's plane.
    pub sun_from_plane_deg: f64,
    pub clear_of_sun_deg: f64,
}

impl Simplified {
    /// Its numbers: a satellite 550 km above an Earth of 6,378 km with 40 km of air.
    pub const STUDY_OF_2005: Self = Self {
        hidden_deg: 67.87,
        sun_from_plane_deg: 30.0,
        clear_of_sun_deg: 15.0,
    };

    /// The share of each orbit in which a body is above the limb that stands so far from the Sun along the Moon's path.
    pub fn share(&self, from_sun_deg: f64) -> f64 {
        // How far the body stands from the orbit's plane.
        let normal_deg = 90.0 + self.sun_from_plane_deg;
        let sine = (from_sun_deg - normal_deg).to_radians().cos();
        let cosine = (1.0 - sine * sine).sqrt();
        let edge = self.hidden_deg.to_radians().cos();
        match edge < cosine {
            true => 1.0 - (edge / cosine).acos() / PI,
            false => 1.0,
        }
    }

    /// The share in which the Moon is seen.
    pub fn moon_share(&self, from_new_deg: f64) -> f64 {
        let from_sun = from_new_deg.min(360.0 - from_new_deg);
        match from_sun < self.clear_of_sun_deg {
            true => 0.0,
            false => self.share(from_new_deg),
        }
    }

    /// Where what is seen changes its kind, degrees from new Moon: near the Sun, seen for a part of each orbit, seen always.
    pub fn edges_deg(&self) -> Vec<f64> {
        let normal = 90.0 + self.sun_from_plane_deg;
        let always = 90.0 - self.hidden_deg;
        let (clear, opposite) = (self.clear_of_sun_deg, normal + 180.0);
        vec![
            0.0,
            clear,
            normal - always,
            normal + always,
            180.0,
            opposite - always,
            opposite + always,
            360.0 - clear,
            360.0,
        ]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LEO: SunSynchronous = SunSynchronous {
        height_km: 550.0,
        node_h: 10.0,
    };

    #[test]
    fn the_orbit_at_550_km_takes_95_minutes_and_keeps_to_the_sun_at_97_and_a_half_degrees() {
        // The study has 95.65 min (eq. 3.1); a sun-synchronous orbit at 550 km is inclined by 97.59 deg.
        assert!((TAU / LEO.motion_rad_per_s() / 60.0 - 95.65).abs() < 0.01);
        assert!((LEO.inclination_rad().to_degrees() - 97.59).abs() < 0.03);
    }

    #[test]
    fn the_studys_table_comes_out_under_its_assumptions() {
        let study = Simplified::STUDY_OF_2005;
        // Table 3.1: 0, 15, 98, 142, 180, 278, 322, 345, 360; at least 61.7 % where it is seen at all.
        let printed = [0.0, 15.0, 98.0, 142.0, 180.0, 278.0, 322.0, 345.0, 360.0];
        for (edge, printed) in study.edges_deg().iter().zip(printed) {
            assert!((edge - printed).abs() < 0.2, "{edge}, {printed}");
        }
        let least = (0..=360)
            .map(|n| study.share(f64::from(n)))
            .fold(1.0, f64::min);
        assert!((least - 0.617).abs() < 0.008, "{least}");
        assert_eq!(study.moon_share(14.0), 0.0);
        assert_eq!(study.moon_share(120.0), 1.0);
        assert_eq!(study.moon_share(300.0), 1.0);
    }

    #[test]
    fn a_pole_sees_the_moon_for_half_a_month_and_a_little_more_from_high_above() {
        let month = ("2026-01-01T00:00:00Z", "2026-01-28T08:00:00Z");
        let month = (month.0.parse().unwrap(), month.1.parse().unwrap());
        let mut ephemeris = Ephemeris::default();
        let share = |ephemeris: &mut Ephemeris, height_m: f64| {
            let pole = Vantage::Place(Place::new(90.0, 0.0, height_m).unwrap());
            let seen = sights(ephemeris, &pole, month, SignedDuration::from_hours(2)).unwrap();
            let up = seen.iter().filter(|sight| sight.above_limb_deg > 0.0);
            up.count() as f64 / seen.len() as f64
        };
        let low = share(&mut ephemeris, 0.0);
        let high = share(&mut ephemeris, 38_000.0);
        // Half of a month, less 1.1 % for a parallax of a degree; the orbit's eccentricity of 0.055 moves that by 3.5 % at most.
        assert!((low - 0.489).abs() < 0.036, "{low}");
        // At most 28.5 deg from the equator, it moves by 6.5 deg a day there: 6.3 deg of dip are 2 days of 27.3.
        assert!((high - low - 0.071).abs() < 0.015, "{low}, {high}");
    }

    #[test]
    fn the_true_moon_from_the_orbit_is_seen_less_than_always_and_more_than_half_the_time() {
        let month = ("2026-01-01T00:00:00Z", "2026-01-30T12:00:00Z");
        let month = (month.0.parse().unwrap(), month.1.parse().unwrap());
        let step = SignedDuration::from_mins(7);
        let seen = sights(&mut Ephemeris::default(), &Vantage::Orbit(LEO), month, step).unwrap();
        let share = |keep: &dyn Fn(&&Sight) -> bool| {
            seen.iter().filter(keep).count() as f64 / seen.len() as f64
        };
        // The simplified mean over a month is 0.72.
        let up = share(&|sight| sight.above_limb_deg > 0.0);
        assert!((0.6..0.8).contains(&up), "{up}");
        // Half of a month the disc is lit by more than a half.
        let gibbous = share(&|sight| sight.lit > 0.5);
        assert!((gibbous - 0.5).abs() < 0.05, "{gibbous}");
    }
}
