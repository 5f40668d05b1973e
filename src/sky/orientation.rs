//! Orientation of the Earth relative to its mean rotation, and differences of its time scales, from the IERS's table.
//!
//! The built-in table is made by `tools/iers` from the IERS's finals2000A and list of leap seconds: measured from 1973 on, predicted for
//! about a year after it was made. UT1 - TAI, which has no leap seconds, and the pole are interpolated linearly between its rows, within
//! 0.4 ms (0.006 arcsec of azimuth) of the daily values. The IERS states 1 sigma of the predictions: 25 ms
//! (0.4 arcsec) after a year. Before 1990 its own series differ by up to 6 ms.
//!
//! After its last row the pole is constant, and UT1 - TAI is extrapolated with the trend of the table's last year and a 1 sigma that grows:
//! 21 ms (Bulletin A's 0.00025 s d^0.75 for d = 365 days of prediction) and 0.35 ms for each day. That covers the rms error of this rule
//! on the table's own years 1973 to 2025: 34 ms after 100 days, 87 ms after one year, 0.40 s after three; and the pole's 0.2 arcsec per
//! axis. Future leap seconds are unknown, but keep UT1 - UTC within 0.9 s: it is clamped to this range, and its sigma stays below 0.5 s,
//! that of any value in this range.

use super::SkyError;
use crate::files::{self, Unread};
use jiff::{Timestamp, civil::Date, tz::Offset};
use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

const BUILT_IN: &str = include_str!("earth_orientation.csv");
const COLUMNS: &str = "mjd_utc,tai_utc_s,x_arcsec,y_arcsec,ut1_utc_s";

/// The modified Julian date of 1970-01-01.
const UNIX_EPOCH_MJD: f64 = 40_587.0;
const DAY_S: f64 = 86_400.0;
/// The Earth's rotation with respect to the mean Sun.
pub(super) const ARCSEC_PER_S: f64 = 15.0;
/// Length of the trend of UT1 - TAI: a year, because a shorter time includes seasonal variations.
const TREND_DAYS: f64 = 365.25;
/// 1 sigma of UT1 at the table's end, its growth, and its limit.
const END_SIGMA_S: f64 = 0.021;
const SIGMA_S_PER_DAY: f64 = 0.35e-3;
const MAX_SIGMA_S: f64 = 0.5;
/// Leap seconds keep UT1 - UTC within this (ITU-R TF.460).
const MAX_UT1_UTC_S: f64 = 0.9;

/// Orientation of the Earth and differences of time scales at one instant (IERS).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EarthOrientation {
    /// TAI - UTC: leap seconds, and the ten seconds before them.
    pub tai_utc_s: f64,
    /// UT1 - UTC; a difference of one second changes every azimuth by up to 15 arcsec.
    pub ut1_utc_s: f64,
    /// Position of the pole.
    pub x_arcsec: f64,
    pub y_arcsec: f64,
    /// 1 sigma of `ut1_utc_s` after the table's end; 0 within the table.
    pub ut1_sigma_s: f64,
}

/// An instant after the end of a table of Earth orientation.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Extrapolated {
    pub utc: Timestamp,
    /// Day of the table's last row.
    pub last: Date,
    /// 1 sigma of UT1 at this instant.
    pub ut1_sigma_s: f64,
}

impl fmt::Display for Extrapolated {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            out,
            "the table of Earth orientation ends on {}: at {} UT1 is extrapolated, 1 sigma {:.3} s, {:.1} arcsec of the Sun's hour angle",
            self.last,
            self.utc,
            self.ut1_sigma_s,
            ARCSEC_PER_S * self.ut1_sigma_s,
        )
    }
}

/// The Earth's orientation over the years.
#[derive(Debug, Clone, PartialEq)]
pub struct OrientationTable {
    /// Rows in the order of time, two at least.
    rows: Vec<OrientationRow>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct OrientationRow {
    mjd: f64,
    orientation: EarthOrientation,
}

/// Reasons for which a table of Earth orientation is refused.
#[derive(Debug, thiserror::Error)]
pub enum TableError {
    #[error("{}: {source}", path.display())]
    Unreadable { path: PathBuf, source: Unread },
    #[error("{}: line {line}: expected {expected}, found \"{found}\"", path.display())]
    Malformed {
        path: PathBuf,
        line: usize,
        expected: &'static str,
        found: String,
    },
}

impl OrientationTable {
    /// The built-in table.
    pub fn built_in() -> Arc<Self> {
        static TABLE: OnceLock<Arc<OrientationTable>> = OnceLock::new();
        let read = || {
            let table = Self::parse(Path::new("built-in table of Earth orientation"), BUILT_IN);
            Arc::new(table.expect("the program's own table is well formed: a test reads it"))
        };
        Arc::clone(TABLE.get_or_init(read))
    }

    /// Reads a table made by `tools/iers`.
    ///
    /// # Errors
    /// If the file cannot be read, or has other columns, a value that is not a number, dates that do not increase, or fewer than two rows.
    pub fn read(path: &Path) -> Result<Self, TableError> {
        let text = files::read_text(path).map_err(|source| TableError::Unreadable {
            path: path.into(),
            source,
        })?;
        Self::parse(path, &text)
    }

    fn parse(path: &Path, text: &str) -> Result<Self, TableError> {
        let malformed = |line, expected, found: &str| TableError::Malformed {
            path: path.into(),
            line,
            expected,
            found: found.into(),
        };
        let mut rows: Vec<OrientationRow> = Vec::new();
        let mut lines = (1..)
            .zip(text.lines())
            .filter(|(_, line)| !line.starts_with('#'));
        match lines.next() {
            Some((_, COLUMNS)) => {}
            Some((number, line)) => return Err(malformed(number, COLUMNS, line)),
            None => return Err(malformed(1, COLUMNS, "")),
        }
        for (number, line) in lines {
            let row = OrientationRow::parse(line)
                .ok_or_else(|| malformed(number, "five finite numbers", line))?;
            if rows.last().is_some_and(|last| last.mjd >= row.mjd) {
                return Err(malformed(number, "dates that grow", line));
            }
            rows.push(row);
        }
        if rows.len() < 2 {
            return Err(malformed(text.lines().count(), "two rows at least", ""));
        }
        Ok(Self { rows })
    }

    /// The orientation at an instant; after the table's end it is extrapolated.
    ///
    /// # Errors
    /// [`SkyError::Orientation`] before the table's beginning.
    pub fn at(&self, utc: Timestamp) -> Result<EarthOrientation, SkyError> {
        let mjd = modified_julian_date(utc);
        let after = self.rows.partition_point(|row| row.mjd <= mjd);
        // The last instant of the table coincides with its last row.
        let is_end = after == self.rows.len() && self.rows[after - 1].mjd == mjd;
        let after = if is_end { after - 1 } else { after };
        if after == 0 {
            let [first, _] = self.dates();
            return Err(SkyError::Orientation { utc, first });
        }
        if after == self.rows.len() {
            return Ok(self.extrapolated(mjd));
        }
        let (a, b) = (&self.rows[after - 1], &self.rows[after]);
        let tai_utc_s = if is_end { b } else { a }.orientation.tai_utc_s;
        let part = (mjd - a.mjd) / (b.mjd - a.mjd);
        let (a, b) = (a.orientation, b.orientation);
        let between = |from: f64, to: f64| from + (to - from) * part;
        Ok(EarthOrientation {
            tai_utc_s,
            ut1_utc_s: between(a.ut1_utc_s - a.tai_utc_s, b.ut1_utc_s - b.tai_utc_s) + tai_utc_s,
            x_arcsec: between(a.x_arcsec, b.x_arcsec),
            y_arcsec: between(a.y_arcsec, b.y_arcsec),
            ut1_sigma_s: 0.0,
        })
    }

    fn extrapolated(&self, mjd: f64) -> EarthOrientation {
        let end = &self.rows[self.rows.len() - 1];
        let year = self
            .rows
            .partition_point(|row| row.mjd < end.mjd - TREND_DAYS);
        let from = &self.rows[year.min(self.rows.len() - 2)];
        let ut1_tai_s =
            |row: &OrientationRow| row.orientation.ut1_utc_s - row.orientation.tai_utc_s;
        let s_per_day = (ut1_tai_s(end) - ut1_tai_s(from)) / (end.mjd - from.mjd);
        let days = mjd - end.mjd;
        let ut1_utc_s = end.orientation.ut1_utc_s + s_per_day * days;
        EarthOrientation {
            ut1_utc_s: ut1_utc_s.clamp(-MAX_UT1_UTC_S, MAX_UT1_UTC_S),
            ut1_sigma_s: (END_SIGMA_S + SIGMA_S_PER_DAY * days).min(MAX_SIGMA_S),
            ..end.orientation
        }
    }

    /// Set if an instant is after the table's end, with the resulting uncertainty.
    pub fn extrapolates(&self, utc: Timestamp) -> Option<Extrapolated> {
        let [_, last] = self.dates();
        let ut1_sigma_s = self.at(utc).ok()?.ut1_sigma_s;
        (ut1_sigma_s > 0.0).then_some(Extrapolated {
            utc,
            last,
            ut1_sigma_s,
        })
    }

    /// Dates of the first and the last row; the table ends at the beginning of its last day.
    pub fn dates(&self) -> [Date; 2] {
        let date = |row: &OrientationRow| {
            let second = ((row.mjd - UNIX_EPOCH_MJD) * DAY_S) as i64;
            let day = Timestamp::from_second(second).unwrap_or(Timestamp::MAX);
            Offset::UTC.to_datetime(day).date()
        };
        [&self.rows[0], &self.rows[self.rows.len() - 1]].map(date)
    }
}

impl OrientationRow {
    fn parse(line: &str) -> Option<Self> {
        let number = |text: &str| text.trim().parse().ok().filter(|n: &f64| n.is_finite());
        let numbers: Option<Vec<f64>> = line.split(',').map(number).collect();
        match numbers?[..] {
            [mjd, tai_utc_s, x_arcsec, y_arcsec, ut1_utc_s] => Some(Self {
                mjd,
                orientation: EarthOrientation {
                    tai_utc_s,
                    ut1_utc_s,
                    x_arcsec,
                    y_arcsec,
                    ut1_sigma_s: 0.0,
                },
            }),
            _ => None,
        }
    }
}

/// Days since 1858-11-17 in UTC.
pub(super) fn modified_julian_date(utc: Timestamp) -> f64 {
    UNIX_EPOCH_MJD
        + utc.as_second() as f64 / DAY_S
        + f64::from(utc.subsec_nanosecond()) / 1e9 / DAY_S
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(rows: &str) -> Result<OrientationTable, TableError> {
        OrientationTable::parse(
            Path::new("t.csv"),
            &format!("# from afar\n{COLUMNS}\n{rows}"),
        )
    }

    #[test]
    fn a_leap_second_moves_utc_and_leaves_the_earth_turning() {
        let table = OrientationTable::built_in();
        let at = |utc: &str| table.at(utc.parse().unwrap()).unwrap();
        let before = at("2016-12-31T23:59:59.999Z");
        let after = at("2017-01-01T00:00:00Z");
        assert_eq!([before.tai_utc_s, after.tai_utc_s], [36.0, 37.0]);
        let ut1_tai = |o: EarthOrientation| o.ut1_utc_s - o.tai_utc_s;
        assert!((ut1_tai(after) - ut1_tai(before)).abs() < 1e-6);
        // The IERS's other series, EOP 20 C04, for 2017-01-01.
        assert!((after.ut1_utc_s - 0.591_287).abs() < 1e-3, "{after:?}");
    }

    #[test]
    fn a_table_begins_at_its_first_instant() {
        let table = parse("41317,10,0,0,0.5\n41319,11,0.2,0,1.3\n").unwrap();
        let at = |utc: &str| table.at(utc.parse().unwrap());
        let middle = at("1972-01-02T00:00:00Z").unwrap();
        assert!((middle.ut1_utc_s - 0.4).abs() < 1e-9 && (middle.x_arcsec - 0.1).abs() < 1e-9);
        let end = at("1972-01-03T00:00:00Z").unwrap();
        assert_eq!((end.tai_utc_s, end.x_arcsec), (11.0, 0.2));
        let error = at("1971-12-31T23:59:59.999Z").unwrap_err().to_string();
        assert!(error.contains("from 1972-01-01 on"), "{error}");
    }

    #[test]
    fn behind_the_tables_end_ut1_goes_on_with_a_sigma_that_grows() {
        let table = OrientationTable::built_in();
        let end = table.rows[table.rows.len() - 1];
        let after = |days: f64| {
            let second = ((end.mjd + days - UNIX_EPOCH_MJD) * DAY_S) as i64;
            let utc = Timestamp::from_second(second).unwrap();
            (table.at(utc).unwrap(), table.extrapolates(utc))
        };
        let at_end = after(0.0);
        assert_eq!((at_end.0.ut1_sigma_s, at_end.1), (0.0, None));
        assert!((at_end.0.ut1_utc_s - end.orientation.ut1_utc_s).abs() < 1e-9);
        let (day, hundred_days, three_years, sixty_years) =
            (after(1.0), after(100.0), after(1096.0), after(22_000.0));
        let sigmas = [&day, &hundred_days, &three_years, &sixty_years].map(|a| a.0.ut1_sigma_s);
        assert!(sigmas[0] > 0.02 && sigmas.is_sorted(), "{sigmas:?}");
        assert_eq!(sigmas[3], 0.5);
        let moved = |a: &(EarthOrientation, _)| (a.0.ut1_utc_s - end.orientation.ut1_utc_s).abs();
        assert!(moved(&day) < 0.002 && moved(&hundred_days) < 0.2);
        assert!(sixty_years.0.ut1_utc_s.abs() <= 0.9);
        assert_eq!(day.0.x_arcsec, end.orientation.x_arcsec);
        let text = hundred_days.1.unwrap().to_string();
        assert!(
            text.contains("2027-10-29") && text.contains("0.056 s"),
            "{text}"
        );
    }

    /// Tests the rule on past data: its errors from any day of the table are within the stated sigma.
    #[test]
    fn the_sigma_behind_the_end_covers_what_the_rule_missed_since_1973() {
        let table = OrientationTable::built_in();
        let measured_until = 61_000.0;
        let instant =
            |mjd: f64| Timestamp::from_second(((mjd - UNIX_EPOCH_MJD) * DAY_S) as i64).unwrap();
        for days in [30.0, 100.0, 365.0, 1096.0] {
            let (mut squares, mut count, mut sigma_s) = (0.0, 0.0, 0.0);
            for kept in (130..table.rows.len()).step_by(10) {
                let mut before = (*table).clone();
                before.rows.truncate(kept);
                let then = before.rows[kept - 1].mjd + days;
                if then > measured_until {
                    break;
                }
                let predicted = before.at(instant(then)).unwrap();
                let truth = table.at(instant(then)).unwrap();
                let ut1_tai = |o: &EarthOrientation| o.ut1_utc_s - o.tai_utc_s;
                // At the clamp leap seconds affect the result.
                if predicted.ut1_utc_s.abs() < MAX_UT1_UTC_S {
                    squares += (ut1_tai(&predicted) - ut1_tai(&truth)).powi(2);
                    count += 1.0;
                }
                sigma_s = predicted.ut1_sigma_s;
            }
            let rms_s = f64::sqrt(squares / count);
            assert!(
                count > 20.0 && rms_s < sigma_s,
                "{days} days: {rms_s} s rms, sigma {sigma_s}"
            );
        }
    }

    #[test]
    fn a_bad_table_is_refused_with_its_line() {
        for (rows, wanted) in [
            (
                "41317,10,0,0,0.5\n41318,10,0,0\n",
                "line 4: expected five finite numbers",
            ),
            (
                "41317,10,0,0,0.5\n41317,10,0,0,0.4\n",
                "line 4: expected dates that grow",
            ),
            ("41317,10,0,0,NaN\n", "line 3"),
            ("41317,10,0,0,0.5\n", "two rows"),
        ] {
            let error = parse(rows).unwrap_err().to_string();
            assert!(
                error.contains(wanted) && error.starts_with("t.csv"),
                "{error}"
            );
        }
        assert!(OrientationTable::parse(Path::new("t.csv"), "a,b\n").is_err());
    }
}
