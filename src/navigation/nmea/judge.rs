//! Selection of a receiver's fixes: one rule for the flight's position, its filter and `preflight`.

use super::TimedFix;
use super::sentence::{Gga, Rmc, Zda};
use crate::units::{Place, is_nowhere};
use jiff::civil::Date;
use jiff::{SignedDuration, Timestamp, Unit};
use std::fmt;

const KNOT_M_S: f64 = 1852.0 / 3600.0;
/// A receiver slower than this is at rest.
const STANDS_M_S: f64 = 0.2;
/// Maximum difference between the dates of fix and clock: a larger one means that either has the wrong day.
const ANOTHER_DAY: SignedDuration = SignedDuration::from_hours(12);
/// A receiver's week counter wraps at 1024.
const ROLLOVER_DAYS: f64 = 1024.0 * 7.0;

/// Reasons for rejecting a fix.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Refusal {
    /// The receiver reports that it has no fix.
    NoFix,
    /// Dead reckoning.
    Estimated,
    /// A position that was entered by hand.
    Manual,
    /// From a simulator.
    Simulated,
    /// A field or a sentence is missing.
    Incomplete,
    /// The date is off by 1024 weeks, or twice that.
    WeekRollover,
    /// The date differs from that of the clock.
    AnotherDay,
    /// Latitude and longitude are both about 0: sent by a receiver that has no position.
    Nowhere,
    /// Position, height or speed are out of range.
    Impossible,
    /// Far from the last fixes, and not confirmed by others.
    Jump,
    /// It has the time of the previous fix.
    Repeated,
    /// It has a time outside the IMU's.
    OutOfTime,
}

impl Refusal {
    pub const ALL: [Self; 12] = [
        Self::NoFix,
        Self::Estimated,
        Self::Manual,
        Self::Simulated,
        Self::Incomplete,
        Self::WeekRollover,
        Self::AnotherDay,
        Self::Nowhere,
        Self::Impossible,
        Self::Jump,
        Self::Repeated,
        Self::OutOfTime,
    ];

    pub fn name(self) -> &'static str {
        match self {
            Self::NoFix => "no fix",
            Self::Estimated => "estimated",
            Self::Manual => "manual input",
            Self::Simulated => "simulator",
            Self::Incomplete => "incomplete",
            Self::WeekRollover => "week rollover",
            Self::AnotherDay => "another day",
            Self::Nowhere => "no place",
            Self::Impossible => "out of range",
            Self::Jump => "jump",
            Self::Repeated => "repeated",
            Self::OutOfTime => "out of time",
        }
    }
}

/// A rejected fix, and the reason.
#[derive(Debug, Clone, PartialEq)]
pub struct Refused {
    pub refusal: Refusal,
    why: String,
}

impl Refused {
    pub fn new(refusal: Refusal, why: impl Into<String>) -> Self {
        let why = why.into();
        Self { refusal, why }
    }
}

impl fmt::Display for Refused {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "{}: {}", self.refusal.name(), self.why)
    }
}

/// A receiver's data for one time.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Said {
    pub gga: Option<Gga>,
    pub rmc: Option<Rmc>,
    pub zda: Option<Zda>,
}

impl Said {
    /// The fix, if it is usable; `now` is the flight's time.
    ///
    /// # Errors
    /// Why it is not usable.
    pub fn judge(&self, now: Timestamp) -> Result<TimedFix, Refused> {
        self.is_fix()?;
        let missing = |what: &str| Refused::new(Refusal::Incomplete, format!("{what} is missing"));
        let gga = self
            .gga
            .ok_or_else(|| missing("GGA, which has the height,"))?;
        let [latitude_deg, longitude_deg] = gga.at_deg.ok_or_else(|| missing("the place"))?;
        let altitude_m = gga.altitude_m.ok_or_else(|| missing("the height"))?;
        let micros = gga.time.ok_or_else(|| missing("the time"))?.micros;
        let utc = self.utc(micros, now)?;
        if is_nowhere(latitude_deg, longitude_deg) {
            let why = "latitude and longitude are both about 0";
            return Err(Refused::new(Refusal::Nowhere, why));
        }
        // GGA states the height above the geoid.
        let height_m = altitude_m + gga.geoid_m.unwrap_or(0.0);
        let impossible = |why: String| Refused::new(Refusal::Impossible, why);
        if longitude_deg.abs() > 180.0 {
            let why = format!("expected a longitude from -180 to 180 deg, found {longitude_deg}");
            return Err(impossible(why));
        }
        let place = Place::new(latitude_deg, longitude_deg, height_m);
        let place = place.map_err(|why| impossible(why.to_string()))?;
        let fix = TimedFix {
            utc,
            place,
            level_m_s: self.rmc.and_then(level_m_s),
        };
        let check = fix.fix(0.0).check();
        check
            .map(|()| fix)
            .map_err(|why| impossible(why.to_string()))
    }

    /// GGA's quality and RMC's status and mode indicator. RMC's navigational status is not used: receivers that do not provide it
    /// send V.
    fn is_fix(&self) -> Result<(), Refused> {
        let refused = |refusal, field: &str, found: char| {
            Err(Refused::new(refusal, format!("{field} is {found}")))
        };
        if let Some(gga) = &self.gga {
            match gga.quality {
                // Some receivers report a fix with satellite corrections as 9.
                Some('1'..='5' | '9') => {}
                Some(found @ '6') => return refused(Refusal::Estimated, "GGA's quality", found),
                Some(found @ '7') => return refused(Refusal::Manual, "GGA's quality", found),
                Some(found @ '8') => return refused(Refusal::Simulated, "GGA's quality", found),
                Some(found) => return refused(Refusal::NoFix, "GGA's quality", found),
                None => return Err(Refused::new(Refusal::NoFix, "GGA's quality is empty")),
            }
        }
        let Some(rmc) = &self.rmc else {
            return Ok(());
        };
        match rmc.mode {
            // Before NMEA 2.3 there was no mode indicator.
            None | Some('A' | 'D' | 'F' | 'P' | 'R') => {}
            Some(found @ 'E') => return refused(Refusal::Estimated, "RMC's mode", found),
            Some(found @ 'M') => return refused(Refusal::Manual, "RMC's mode", found),
            Some(found @ 'S') => return refused(Refusal::Simulated, "RMC's mode", found),
            Some(found) => return refused(Refusal::NoFix, "RMC's mode", found),
        }
        match rmc.status {
            Some('A' | 'D') => Ok(()),
            Some(found) => refused(Refusal::NoFix, "RMC's status", found),
            None => Err(Refused::new(Refusal::NoFix, "RMC's status is empty")),
        }
    }

    /// The instant, if it is on the clock's day. If the receiver gives no date, the clock's day is used.
    fn utc(&self, micros: i64, now: Timestamp) -> Result<Timestamp, Refused> {
        let since = SignedDuration::from_micros(micros);
        let stated = self.rmc.and_then(|rmc| rmc.date);
        let stated = stated.or(self.zda.and_then(|zda| zda.date));
        let Some(date) = stated else {
            return nearest(since, now)
                .ok_or_else(|| Refused::new(Refusal::AnotherDay, format!("the clock says {now}")));
        };
        let utc = at(date, since)
            .ok_or_else(|| Refused::new(Refusal::AnotherDay, format!("it is of {date}")))?;
        let off = utc.duration_since(now);
        if off.abs() <= ANOTHER_DAY {
            return Ok(utc);
        }
        let days = off.as_secs_f64() / 86_400.0;
        let counts = (days / ROLLOVER_DAYS).round();
        let is_rollover = counts != 0.0
            && (days - counts * ROLLOVER_DAYS).abs() * 24.0 <= ANOTHER_DAY.as_hours() as f64;
        let second = utc.round(Unit::Second).unwrap_or(utc);
        let found = format!(
            "it says {second}, {:.1} days off this computer's clock",
            days
        );
        Err(match is_rollover {
            true => Refused::new(
                Refusal::WeekRollover,
                format!(
                    "{found}, which is {:+.0} weeks: the receiver's count of weeks has rolled over",
                    1024.0 * counts
                ),
            ),
            false => Refused::new(Refusal::AnotherDay, found),
        })
    }
}

fn at(date: Date, since: SignedDuration) -> Option<Timestamp> {
    let midnight = date.at(0, 0, 0, 0).to_zoned(jiff::tz::TimeZone::UTC).ok()?;
    midnight.timestamp().checked_add(since).ok()
}

/// The time of day on the day for which it is nearest to an instant.
fn nearest(since: SignedDuration, now: Timestamp) -> Option<Timestamp> {
    let today = jiff::tz::TimeZone::UTC.to_datetime(now).date();
    let days = [today.yesterday().ok(), Some(today), today.tomorrow().ok()];
    let candidates = days
        .into_iter()
        .flatten()
        .filter_map(|date| at(date, since));
    candidates.min_by_key(|utc| utc.duration_since(now).abs())
}

/// The velocity towards north and east, m/s. A speed without a course is not used, except for a receiver at rest.
fn level_m_s(rmc: Rmc) -> Option<[f64; 2]> {
    let speed_m_s = rmc.speed_knots? * KNOT_M_S;
    let Some(course_deg) = rmc.course_deg else {
        return (speed_m_s.abs() < STANDS_M_S).then_some([0.0; 2]);
    };
    let (sin, cos) = course_deg.to_radians().sin_cos();
    Some([speed_m_s * cos, speed_m_s * sin])
}
