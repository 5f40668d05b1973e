//! Directions of Sun and Moon from the flight's position.

use super::measurement::{Fix, Towards};
use super::settings::Target;
use crate::geometry::earth::{geodetic_up, north_east_up};
use crate::pointing::{self, PointingError, target_direction};
use crate::sky::sphere::direction;
use crate::sky::{Ephemeris, SkyError};
use crate::units::{EARTH_RADIUS_M, Place};
use jiff::{SignedDuration, Timestamp};
use nalgebra::{Matrix3, UnitVector3, Vector3};
use std::collections::BTreeMap;

/// Interval of the ephemeris computations; linear interpolation between them is accurate to 0.001 arcsec.
const EVERY_S: f64 = 2.0;
/// In flight directions are requested no later than this after their time.
const KEPT_S: f64 = 20.0;

/// The source of the directions of Sun and Moon.
pub enum Sky {
    /// The ephemeris; `epoch` is the instant of t_s = 0.
    Ephemeris {
        ephemeris: Box<Ephemeris>,
        epoch: Timestamp,
    },
    /// Directions to the Sun in ECEF by time.
    Sun(Vec<(f64, UnitVector3<f64>)>),
    /// No source.
    Unknown,
}

/// Directions of Sun, Moon and the telescope's target during the flight.
pub struct Targets {
    sky: Sky,
    /// In the order of time.
    fixes: Vec<Fix>,
    known: BTreeMap<(Target, i64), Vector3<f64>>,
    aimed: Option<Aimed>,
}

/// The direction of the telescope's target at a step and at the next.
struct Aimed {
    target: pointing::Target,
    step: i64,
    towards: [Vector3<f64>; 2],
}

/// Why a direction is unknown.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum NoDirection {
    #[error("neither epoch_utc in the configuration nor, for the Sun, a table (--sun)")]
    NoSky,
    #[error("a table of the Sun that does not reach so far")]
    BeyondTable,
    #[error("no fix of GPS")]
    NoFix,
    #[error("a time that no calendar has")]
    Time,
    #[error(transparent)]
    Sky(#[from] SkyError),
    #[error(transparent)]
    Pointing(#[from] PointingError),
}

impl Targets {
    pub fn new(sky: Sky, fixes: Vec<Fix>) -> Self {
        Self {
            sky,
            fixes,
            known: BTreeMap::new(),
            aimed: None,
        }
    }

    /// Takes in the current position in flight: later requests use it, and old positions are dropped.
    pub fn note(&mut self, fix: Fix) {
        self.fixes = vec![fix];
        let oldest = ((fix.t_s - KEPT_S) / EVERY_S) as i64;
        self.known.retain(|(_, step), _| *step >= oldest);
    }

    /// The direction of a target.
    ///
    /// # Errors
    /// As [`direction`](Self::direction).
    pub fn towards(&mut self, target: Target, t_s: f64) -> Result<Towards, NoDirection> {
        Ok(match target {
            Target::Nadir => Towards::Down,
            target => Towards::Known(self.direction(target, t_s)?),
        })
    }

    /// The direction to Sun or Moon in ECEF.
    ///
    /// # Errors
    /// Why it is unknown.
    pub fn direction(&mut self, target: Target, t_s: f64) -> Result<UnitVector3<f64>, NoDirection> {
        if let (Sky::Sun(table), Target::Sun) = (&self.sky, target) {
            return by_table(table, t_s).ok_or(NoDirection::BeyondTable);
        }
        let before = (t_s / EVERY_S).floor();
        let share = t_s / EVERY_S - before;
        let from = self.at(target, before as i64)?;
        let to = self.at(target, before as i64 + 1)?;
        Ok(UnitVector3::new_normalize(from.lerp(&to, share)))
    }

    /// The direction in ECEF of the telescope's target.
    ///
    /// # Errors
    /// Why it is unknown.
    pub fn aim(
        &mut self,
        target: &pointing::Target,
        t_s: f64,
    ) -> Result<UnitVector3<f64>, NoDirection> {
        let step = (t_s / EVERY_S).floor();
        let share = t_s / EVERY_S - step;
        let step = step as i64;
        let is_of = |aimed: &&Aimed| aimed.step == step && aimed.target == *target;
        let towards = match self.aimed.as_ref().filter(is_of) {
            Some(aimed) => aimed.towards,
            None => [self.aim_at(target, step)?, self.aim_at(target, step + 1)?],
        };
        self.aimed = Some(Aimed {
            target: *target,
            step,
            towards,
        });
        let [from, to] = &towards;
        Ok(UnitVector3::new_normalize(from.lerp(to, share)))
    }

    fn aim_at(
        &mut self,
        target: &pointing::Target,
        step: i64,
    ) -> Result<Vector3<f64>, NoDirection> {
        let (ephemeris, utc, place, axes) = self.sky_at(step)?;
        let sun = ephemeris.sun(utc, place)?;
        let target = target.at(utc, &sun)?;
        Ok(axes * target_direction(target, &sun))
    }

    fn at(&mut self, target: Target, step: i64) -> Result<Vector3<f64>, NoDirection> {
        if let Some(known) = self.known.get(&(target, step)) {
            return Ok(*known);
        }
        let (ephemeris, utc, place, axes) = self.sky_at(step)?;
        let (azimuth_deg, elevation_deg) = match target {
            Target::Moon => {
                let moon = ephemeris.moon(utc, place)?;
                (moon.azimuth_deg, moon.elevation_deg)
            }
            Target::Sun | Target::Nadir => {
                let sun = ephemeris.sun(utc, place)?;
                (sun.azimuth_deg, sun.elevation_deg)
            }
        };
        let towards = axes * direction(azimuth_deg, elevation_deg);
        self.known.insert((target, step), towards);
        Ok(towards)
    }

    /// The ephemeris, with time and place of a step, and the axes north, east and up there.
    fn sky_at(
        &mut self,
        step: i64,
    ) -> Result<(&mut Ephemeris, Timestamp, Place, Matrix3<f64>), NoDirection> {
        let Sky::Ephemeris { ephemeris, epoch } = &mut self.sky else {
            return Err(NoDirection::NoSky);
        };
        let t_s = step as f64 * EVERY_S;
        let next = self.fixes.partition_point(|fix| fix.t_s < t_s);
        let fix = self.fixes.get(next).or(self.fixes.last());
        let at_m = fix.ok_or(NoDirection::NoFix)?.position_m;
        let up = geodetic_up(&at_m);
        let since = SignedDuration::try_from_secs_f64(t_s).map_err(|_| NoDirection::Time)?;
        let utc = epoch.checked_add(since).map_err(|_| NoDirection::Time)?;
        let longitude_deg = up.y.atan2(up.x).to_degrees();
        // The parallax is insensitive to using the height above a sphere.
        let height_m = (at_m.norm() - EARTH_RADIUS_M).clamp(-1000.0, 2e6);
        let place = Place::new(up.z.asin().to_degrees(), longitude_deg, height_m);
        let place = place.map_err(SkyError::from)?;
        Ok((ephemeris, utc, place, north_east_up(&at_m)))
    }
}

fn by_table(table: &[(f64, UnitVector3<f64>)], t_s: f64) -> Option<UnitVector3<f64>> {
    let next = table.partition_point(|(at_s, _)| *at_s < t_s);
    let (to_s, to) = table.get(next)?;
    if *to_s == t_s {
        return Some(*to);
    }
    let (from_s, from) = table.get(next.checked_sub(1)?)?;
    let share = (t_s - from_s) / (to_s - from_s);
    Some(UnitVector3::new_normalize(from.lerp(to, share)))
}
