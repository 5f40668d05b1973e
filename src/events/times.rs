//! Time systems of event lists: times since MJDREF, in the scale of TIMESYS (OGIP/93-003; FITS 4.0, section 9).

use crate::clock::Scale;
use crate::fits::{Header, Problem};

/// Keywords of a table's time system.
pub const KEYWORDS: &[&str] = &[
    "TIMESYS", "MJDREF", "MJDREFI", "MJDREFF", "TIMEZERO", "TIMEZERI", "TIMEZERF", "TIMEOFFS",
    "TIMEUNIT",
];

/// Modified Julian date of 1970-01-01.
const MJD_OF_UNIX_EPOCH: f64 = 40_587.0;
const DAY_S: f64 = 86_400.0;

const SECOND: Unit = Unit { name: "s", s: 1.0 };

#[rustfmt::skip]
const UNITS: [Unit; 7] = [
    SECOND,
    Unit { name: "d", s: DAY_S },
    Unit { name: "h", s: 3600.0 },
    Unit { name: "min", s: 60.0 },
    Unit { name: "ms", s: 1e-3 },
    Unit { name: "us", s: 1e-6 },
    Unit { name: "ns", s: 1e-9 },
];

/// Time system of a table.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TimeSystem {
    pub scale: Scale,
    /// Time of zero, s since 1970 by a clock of the scale.
    zero_s: f64,
    unit: Unit,
}

/// A unit of time: its name and length.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Unit {
    name: &'static str,
    s: f64,
}

/// The keywords of a table, and those of the primary header, which are used if the table has none.
#[derive(Debug, Clone, Copy)]
pub struct Keywords<'a> {
    pub own: &'a Header,
    pub primary: &'a Header,
}

impl Keywords<'_> {
    /// The time system of the keywords, in this scale if TIMESYS names none; `None` without a MJDREF.
    ///
    /// # Errors
    /// If a value is not a number, a unit or a scale.
    pub fn time_system(self, unstated: Scale) -> Result<Option<TimeSystem>, Problem> {
        let Some(days) = self.sum(["MJDREF", "MJDREFI", "MJDREFF"])? else {
            return Ok(None);
        };
        let unit = self.text("TIMEUNIT")?;
        let unit = unit.map_or(Ok(SECOND), |name| Unit::named("TIMEUNIT", &name))?;
        // FITS 4.0 calls it TIMEOFFS.
        let zero = match self.sum(["TIMEZERO", "TIMEZERI", "TIMEZERF"])? {
            Some([whole, part]) => whole + part,
            None => self.number("TIMEOFFS")?.unwrap_or_default(),
        };
        let [whole, part] = days;
        Ok(Some(TimeSystem {
            scale: self.scale()?.unwrap_or(unstated),
            zero_s: (whole - MJD_OF_UNIX_EPOCH) * DAY_S + part * DAY_S + zero * unit.s,
            unit,
        }))
    }

    fn scale(self) -> Result<Option<Scale>, Problem> {
        let Some(name) = self.text("TIMESYS")? else {
            return Ok(None);
        };
        let scale = Scale::named(&name).ok_or_else(|| {
            let expected = "UTC, TT, TAI, TDB or GPS";
            Problem::field("TIMESYS", expected, format!("'{name}'"))
        })?;
        Ok(Some(scale))
    }

    /// A keyword's number, or the two keywords that share it: whole part and fraction.
    fn sum(self, [one, whole, part]: [&str; 3]) -> Result<Option<[f64; 2]>, Problem> {
        for header in [self.own, self.primary] {
            if let Some(number) = header.number(one)? {
                return Ok(Some([number, 0.0]));
            }
            let parts = [header.number(whole)?, header.number(part)?];
            if parts.iter().any(Option::is_some) {
                return Ok(Some(parts.map(Option::unwrap_or_default)));
            }
        }
        Ok(None)
    }

    pub fn number(self, keyword: &str) -> Result<Option<f64>, Problem> {
        let own = self.own.number(keyword)?;
        own.map_or_else(|| self.primary.number(keyword), |number| Ok(Some(number)))
    }

    fn text(self, keyword: &str) -> Result<Option<String>, Problem> {
        let stated = |header: &Header| {
            let text = header.text(keyword)?;
            Ok(text.filter(|text| !text.trim().is_empty()))
        };
        let own = stated(self.own)?;
        own.map_or_else(|| stated(self.primary), |text| Ok(Some(text)))
    }
}

impl Unit {
    fn named(field: &str, name: &str) -> Result<Self, Problem> {
        let known = UNITS.into_iter().find(|unit| unit.name == name.trim());
        known.ok_or_else(|| {
            let names = UNITS.map(|unit| unit.name).join(", ");
            Problem::field(
                field,
                format!("a unit of time ({names})"),
                format!("'{name}'"),
            )
        })
    }
}

impl TimeSystem {
    /// The same for a column that states its own unit.
    pub fn in_unit(self, field: &str, unit: Option<&str>) -> Result<Self, Problem> {
        let unit = unit.map_or(Ok(self.unit), |name| Unit::named(field, name))?;
        Ok(Self { unit, ..self })
    }

    /// The name of the unit.
    pub fn unit(&self) -> &'static str {
        self.unit.name
    }

    /// UTC, s since 1970.
    pub fn unix_s(&self, time: f64) -> Option<f64> {
        self.scale.unix_s(self.zero_s + time * self.unit.s)
    }

    /// The inverse of [`unix_s`](Self::unix_s).
    pub fn time(&self, unix_s: f64) -> Option<f64> {
        Some((self.scale.seconds(unix_s)? - self.zero_s) / self.unit.s)
    }
}
