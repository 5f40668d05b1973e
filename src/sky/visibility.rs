//! Visibility of the Moon from an orbit or a balloon: above the Earth's limb, and clear of the Sun.
//!
//! The Moon and the Sun are represented by their centres, the Earth is a sphere of mean radius; refraction and absorption by air are neglected.

use super::sphere::{angles_deg, direction, separation_rad};
use super::{AU_KM, Ephemeris, SkyError, horizon_dip_deg};
use crate::units::{EARTH_RADIUS_M, Place};
use jiff::{SignedDuration, Timestamp};
use nalgebra::Vector3;
use std::f64::consts::{PI, TAU};
use std::ops::Range;

/// Gravitational parameter of the Earth, km^3/s^2, its oblateness and its equatorial radius, km (WGS 84).
const GRAVITY_KM3_PER_S2: f64 = 398_600.441_8;
const OBLATENESS: f64 = 1.082_63e-3;
const EQUATOR_KM: f64 = 6_378.137;
/// Period of the Sun's apparent revolution around the Earth, s.
const TROPICAL_YEAR_S: f64 = 365.242_19 * 86_400.0;

/// The observer's vantage point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Vantage {
    /// A stationary balloon.
    Place(Place),
    Orbit(SunSynchronous),
}

/// A circular orbit whose plane rotates with the Sun.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SunSynchronous {
    /// Height above the equator.
    pub height_km: f64,
    /// Local true solar time of the ascending node, h.
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

    /// The inclination at which the Earth's oblateness rotates the plane once a year.
    fn inclination_rad(&self) -> f64 {
        let turn = TAU / TROPICAL_YEAR_S;
        let flattening = 1.5 * OBLATENESS * (EQUATOR_KM / self.radius_km()).powi(2);
        (-turn / (flattening * self.motion_rad_per_s())).acos()
    }

    /// Position of the satellite, km, in equatorial axes, a time after it crossed the equator, for the Sun's right ascension.
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

/// The Moon and the Sun at an instant.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Observation {
    pub moon_above_limb_deg: f64,
    pub sun_above_limb_deg: f64,
    pub moon_from_sun_deg: f64,
    /// The illuminated fraction of the Moon's disc.
    pub lit: f64,
}

/// The Moon and the Sun from a vantage point over a time span. A satellite crosses the equator at its beginning.
///
/// # Errors
/// If the ephemeris does not cover the dates, or the place is impossible.
pub fn observations(
    ephemeris: &mut Ephemeris,
    vantage: &Vantage,
    (from, to): (Timestamp, Timestamp),
    step: SignedDuration,
) -> Result<Vec<Observation>, SkyError> {
    let mut observations = Vec::new();
    let mut utc = from;
    while utc < to {
        observations.push(match vantage {
            Vantage::Place(place) => from_place(ephemeris, utc, *place)?,
            Vantage::Orbit(orbit) => {
                let since_s = utc.duration_since(from).as_secs_f64();
                from_orbit(ephemeris, utc, orbit, since_s)?
            }
        });
        utc = utc.checked_add(step).unwrap_or(to);
    }
    Ok(observations)
}

fn lit(phase_angle_rad: f64) -> f64 {
    (1.0 + phase_angle_rad.cos()) / 2.0
}

fn from_place(
    ephemeris: &mut Ephemeris,
    utc: Timestamp,
    place: Place,
) -> Result<Observation, SkyError> {
    let moon = ephemeris.moon(utc, place)?;
    let sun = ephemeris.sun(utc, place)?;
    let towards = [
        direction(moon.azimuth_deg, moon.elevation_deg),
        direction(sun.azimuth_deg, sun.elevation_deg),
    ];
    let dip_deg = horizon_dip_deg(place.height_m);
    Ok(Observation {
        moon_above_limb_deg: moon.elevation_deg + dip_deg,
        sun_above_limb_deg: sun.elevation_deg + dip_deg,
        moon_from_sun_deg: separation_rad(&towards[0], &towards[1]).to_degrees(),
        lit: lit(moon.phase_angle_deg.to_radians()),
    })
}

fn from_orbit(
    ephemeris: &mut Ephemeris,
    utc: Timestamp,
    orbit: &SunSynchronous,
    since_s: f64,
) -> Result<Observation, SkyError> {
    let [moon, sun] = ephemeris.geocentric(utc)?.map(|v| v * AU_KM);
    let sun_ascension = angles_deg(&sun).0.to_radians();
    let satellite = orbit.position_km(sun_ascension, since_s);
    let (to_moon, to_sun) = (moon - satellite, sun - satellite);
    let limb = (EARTH_RADIUS_M / 1e3 / satellite.norm()).asin();
    let above_limb_deg =
        |towards: &Vector3<f64>| (separation_rad(towards, &-satellite) - limb).to_degrees();
    Ok(Observation {
        moon_above_limb_deg: above_limb_deg(&to_moon),
        sun_above_limb_deg: above_limb_deg(&to_sun),
        moon_from_sun_deg: separation_rad(&to_moon, &to_sun).to_degrees(),
        lit: lit(separation_rad(&(sun - moon), &-moon)),
    })
}

/// Assumptions of the study of a Moon sensor ("The Development of a Moon Sensor", 2005, section 3.2): the Moon and the Sun are infinitely
/// distant in one plane, perpendicular to the plane of the satellite's orbit; the Earth with its atmosphere obstructs a cone; the Moon is
/// not visible within an angle of the Sun.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Simplified {
    /// Radius of the satellite's orbit.
    pub orbit_radius_km: f64,
    /// Radius of the Earth including the atmosphere that obstructs the view.
    pub opaque_radius_km: f64,
    /// Angle between the Sun and the orbit's plane.
    pub sun_from_plane_deg: f64,
    pub clear_of_sun_deg: f64,
}

impl Simplified {
    /// The study's numbers: a satellite 550 km above an Earth of 6,378 km with 40 km of atmosphere.
    pub const STUDY_OF_2005: Self = Self {
        orbit_radius_km: 6_378.0 + 550.0,
        opaque_radius_km: 6_378.0 + 40.0,
        sun_from_plane_deg: 30.0,
        clear_of_sun_deg: 15.0,
    };

    /// Half the angle obstructed by Earth and atmosphere (half of eq. 3.2).
    pub fn hidden_deg(&self) -> f64 {
        (self.opaque_radius_km / self.orbit_radius_km)
            .asin()
            .to_degrees()
    }

    /// Intersection of the Moon's path with the normal of the orbit's plane, degrees from new Moon; the other one is 180 deg further.
    fn normal_deg(&self) -> f64 {
        90.0 + self.sun_from_plane_deg
    }

    /// The fraction of each orbit in which a body at an angle from the Sun along the Moon's path is above the limb.
    pub fn share(&self, from_sun_deg: f64) -> f64 {
        // Angle of the body from the orbit's plane.
        let sine = (from_sun_deg - self.normal_deg()).to_radians().cos();
        let cosine = (1.0 - sine * sine).sqrt();
        let edge = self.hidden_deg().to_radians().cos();
        match edge < cosine {
            true => 1.0 - (edge / cosine).acos() / PI,
            false => 1.0,
        }
    }

    /// The fraction in which the Moon is visible: above the limb, and clear of the Sun.
    pub fn moon_share(&self, from_new_deg: f64) -> f64 {
        let from_sun = from_new_deg.min(360.0 - from_new_deg);
        match from_sun < self.clear_of_sun_deg {
            true => 0.0,
            false => self.share(from_new_deg),
        }
    }

    /// Boundaries between kinds of visibility, degrees from new Moon, in order: too near the Sun, visible for a part of each orbit,
    /// always visible.
    pub fn edges_deg(&self) -> Vec<f64> {
        let always = 90.0 - self.hidden_deg();
        let (clear, normal) = (self.clear_of_sun_deg, self.normal_deg());
        let opposite = normal + 180.0;
        let mut edges = vec![
            0.0,
            clear,
            normal - always,
            normal + always,
            180.0,
            opposite - always,
            opposite + always,
            360.0 - clear,
            360.0,
        ];
        edges.sort_by(f64::total_cmp);
        edges.dedup();
        edges
    }

    /// The least and the greatest fraction in which the Moon is visible, between two boundaries.
    pub fn moon_share_range(&self, between_deg: Range<f64>) -> [f64; 2] {
        let Range { start, end } = between_deg;
        if self.moon_share((start + end) / 2.0) == 0.0 {
            return [0.0; 2];
        }
        // Between two boundaries the fraction has an extremum only where the Moon crosses the orbit's plane.
        let crossings = [self.normal_deg() - 90.0, self.normal_deg() + 90.0];
        let inside = crossings
            .into_iter()
            .filter(|deg| (start..end).contains(deg));
        let shares = inside.chain([start, end]).map(|deg| self.share(deg));
        let least = shares.clone().fold(1.0, f64::min);
        [least, shares.fold(0.0, f64::max)]
    }

    /// The fraction of the Moon's path on which it is visible for at least a given fraction of each orbit.
    pub fn path_with(&self, least_share: f64) -> f64 {
        const STEPS: u32 = 36_000;
        let middle_deg = |n: u32| (f64::from(n) + 0.5) * 360.0 / f64::from(STEPS);
        let enough = |n: &u32| self.moon_share(middle_deg(*n)) >= least_share;
        (0..STEPS).filter(enough).count() as f64 / f64::from(STEPS)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LEO: SunSynchronous = SunSynchronous {
        height_km: 550.0,
        node_h: 10.0,
    };

    fn share<T>(all: &[T], keep: impl Fn(&&T) -> bool) -> f64 {
        all.iter().filter(keep).count() as f64 / all.len() as f64
    }

    fn span([from, to]: [&str; 2]) -> (Timestamp, Timestamp) {
        (from.parse().unwrap(), to.parse().unwrap())
    }

    #[test]
    fn the_orbit_at_550_km_takes_95_minutes_and_keeps_to_the_sun_at_97_and_a_half_degrees() {
        // The study states 95.65 min (eq. 3.1); a sun-synchronous orbit at 550 km has an inclination of 97.59 deg.
        assert!((TAU / LEO.motion_rad_per_s() / 60.0 - 95.65).abs() < 0.01);
        assert!((LEO.inclination_rad().to_degrees() - 97.59).abs() < 0.03);
    }

    #[test]
    fn the_studys_table_comes_out_under_its_assumptions() {
        let study = Simplified::STUDY_OF_2005;
        // Eq. 3.2, full angle.
        assert!((2.0 * study.hidden_deg() - 136.0).abs() < 0.5);
        // Table 3.1.
        let printed = [0.0, 15.0, 98.0, 142.0, 180.0, 278.0, 322.0, 345.0, 360.0];
        let edges = study.edges_deg();
        assert_eq!(edges.len(), printed.len());
        for (edge, printed) in edges.iter().zip(printed) {
            assert!((edge - printed).abs() < 0.2, "{edge}, {printed}");
        }
        // Its least fraction of 61.7 % corresponds to an obstructed arc of 138 deg; its own cone of 135.7 deg gives 62.3 %, and rows that
        // do not include the orbit's plane are above that.
        let least = 1.0 - study.hidden_deg() / 180.0;
        assert!((least - 0.617).abs() < 0.007, "{least}");
        let at = |deg: f64| study.share(deg);
        let expected = [
            [0.0; 2],
            [least, 1.0],
            [1.0; 2],
            [at(180.0), 1.0],
            [least, 1.0],
            [1.0; 2],
            [at(345.0), 1.0],
            [0.0; 2],
        ];
        for (ends, expected) in edges.windows(2).zip(expected) {
            let found = study.moon_share_range(ends[0]..ends[1]);
            let off = (found[0] - expected[0]).abs() + (found[1] - expected[1]).abs();
            assert!(off < 1e-6, "{ends:?}: {found:?}, {expected:?}");
        }
        // 91.6 % of the Moon's path.
        assert!((study.path_with(least - 1e-9) - 0.916).abs() < 1e-3);
    }

    #[test]
    fn the_simplified_rows_are_in_order_however_far_the_moon_must_be_from_the_sun() {
        for clear_of_sun_deg in [0.0, 15.0, 97.0, 100.0, 150.0, 180.0] {
            let study = Simplified {
                clear_of_sun_deg,
                ..Simplified::STUDY_OF_2005
            };
            let edges = study.edges_deg();
            assert!(edges.is_sorted_by(|a, b| a < b), "{edges:?}");
            let hidden = (edges.windows(2))
                .filter(|ends| study.moon_share_range(ends[0]..ends[1]) == [0.0; 2])
                .map(|ends| ends[1] - ends[0]);
            assert!((hidden.sum::<f64>() - 2.0 * clear_of_sun_deg).abs() < 1e-9);
        }
    }

    #[test]
    fn a_pole_sees_the_moon_for_half_a_month_and_a_little_more_from_high_above() {
        let month = span(["2026-01-01T00:00:00Z", "2026-01-28T08:00:00Z"]);
        let mut ephemeris = Ephemeris::default();
        let mut up = |height_m: f64| {
            let pole = Vantage::Place(Place::new(90.0, 0.0, height_m).unwrap());
            let step = SignedDuration::from_hours(2);
            let found = observations(&mut ephemeris, &pole, month, step).unwrap();
            share(&found, |seen| seen.moon_above_limb_deg > 0.0)
        };
        let (low, high) = (up(0.0), up(38_000.0));
        // Half of a month, minus 1.1 % for a parallax of one degree; the orbit's eccentricity of 0.055 changes that by 3.5 % at most.
        assert!((low - 0.489).abs() < 0.036, "{low}");
        // The Moon's declination, at most 28.5 deg, changes by 6.5 deg a day near the equator: 6.3 deg of dip are 2 days of 27.3.
        assert!((high - low - 0.071).abs() < 0.015, "{low}, {high}");
    }

    /// The fraction of an orbit in which a body is above the limb. The line from the orbit to the body that grazes the Earth
    /// spans acos(R / orbit) + acos(R / distance) at the Earth's centre.
    fn share_of_an_orbit(body_km: &Vector3<f64>, normal: &Vector3<f64>) -> f64 {
        let earth_km = EARTH_RADIUS_M / 1e3;
        let from_plane = body_km.normalize().dot(normal).asin();
        let spanned = (earth_km / LEO.radius_km()).acos() + (earth_km / body_km.norm()).acos();
        (spanned.cos() / from_plane.cos()).clamp(-1.0, 1.0).acos() / PI
    }

    #[test]
    fn over_a_month_an_orbit_sees_moon_and_sun_as_long_as_the_angles_from_its_plane_allow() {
        let month = span(["2026-01-01T00:00:00Z", "2026-01-30T12:43:00Z"]);
        for node_h in [6.0, 10.0, 12.0] {
            let mut ephemeris = Ephemeris::default();
            let orbit = SunSynchronous { node_h, ..LEO };
            let step = SignedDuration::from_mins(7);
            let vantage = Vantage::Orbit(orbit);
            let found = observations(&mut ephemeris, &vantage, month, step).unwrap();
            let mut expected = [0.0; 2];
            for n in 0..found.len() {
                let utc = month.0 + step * i32::try_from(n).unwrap();
                let bodies = ephemeris.geocentric(utc).unwrap().map(|au| au * AU_KM);
                let node_deg = angles_deg(&bodies[1]).0 + (node_h - 12.0) * 15.0;
                // 97.59 deg from the equator's pole, a quarter turn behind the node.
                let normal = direction(node_deg - 90.0, 90.0 - 97.59);
                for (sum, body) in expected.iter_mut().zip(&bodies) {
                    *sum += share_of_an_orbit(body, &normal) / found.len() as f64;
                }
            }
            let moon = share(&found, |seen| seen.moon_above_limb_deg > 0.0);
            let sun = share(&found, |seen| seen.sun_above_limb_deg > 0.0);
            assert!((moon - expected[0]).abs() < 3e-3, "{moon}, {expected:?}");
            assert!((sun - expected[1]).abs() < 3e-3, "{sun}, {expected:?}");
            // For half of a month more than half of the disc is illuminated.
            let gibbous = share(&found, |seen| seen.lit > 0.5);
            assert!((gibbous - 0.5).abs() < 0.05, "{gibbous}");
        }
    }

    #[test]
    fn a_noon_orbit_loses_the_sun_behind_the_whole_disc_of_the_earth() {
        // 2026-03-20: the Sun is on the equator, hence in the plane. 1 - asin(6371 / 6928) / 180 deg = 62.85 %.
        let noon = Vantage::Orbit(SunSynchronous {
            node_h: 12.0,
            ..LEO
        });
        let day = span(["2026-03-20T00:00:00Z", "2026-03-20T23:54:45Z"]); // 15 orbits
        let step = SignedDuration::from_secs(13);
        let found = observations(&mut Ephemeris::default(), &noon, day, step).unwrap();
        let sun = share(&found, |seen| seen.sun_above_limb_deg > 0.0);
        assert!((sun - 0.6285).abs() < 1e-3, "{sun}");
    }

    #[test]
    fn a_balloon_sees_the_moon_as_long_as_astropy_says() {
        // astropy 6.1 with moon98, a sample every 10 min: Moon above the limb, also clear of the Sun, Sun above the limb.
        let month = span(["2026-01-01T00:00:00Z", "2026-01-30T12:43:00Z"]);
        for (place, expected) in [
            ([34.49, -104.2218, 38_405.0], [0.5500, 0.5029, 0.4540]),
            ([-77.85, 166.67, 36_500.0], [0.5478, 0.4611, 1.0]),
        ] {
            let place = Place::new(place[0], place[1], place[2]).unwrap();
            let (vantage, step) = (Vantage::Place(place), SignedDuration::from_mins(10));
            let found = observations(&mut Ephemeris::default(), &vantage, month, step).unwrap();
            let up = share(&found, |seen| seen.moon_above_limb_deg > 0.0);
            let visible = share(&found, |seen| {
                seen.moon_above_limb_deg > 0.0 && seen.moon_from_sun_deg > 15.0
            });
            let sun = share(&found, |seen| seen.sun_above_limb_deg > 0.0);
            for (found, expected) in [up, visible, sun].into_iter().zip(expected) {
                // Tolerance of two samples of 4,253.
                assert!((found - expected).abs() < 5e-4, "{found}, {expected}");
            }
        }
    }
}
