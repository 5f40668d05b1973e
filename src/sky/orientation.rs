//! How the Earth stands within its mean rotation and how far its clocks are apart, by the IERS's table.
//!
//! The table that the program carries is made by `tools/iers` from the IERS's finals2000A and list of leap seconds:
//! measured from 1973 on, predicted for about a year after it was made. Between its rows UT1 - TAI, which knows no
//! leap seconds, and the pole run straight, within 0.4 ms (0.006 arcsec of azimuth) of the daily values. Of the
//! predictions the IERS states 1 sigma: 25 ms (0.4 arcsec) after a year. Before 1990 its own series differ by up to 6 ms.

use super::SkyError;
use jiff::{Timestamp, civil::Date, tz::Offset};
use std::path::{Path, PathBuf};
use std::sync::{Arc, OnceLock};

const BUILT_IN: &str = include_str!("earth_orientation.csv");
const COLUMNS: &str = "mjd_utc,tai_utc_s,x_arcsec,y_arcsec,ut1_utc_s";

/// The modified Julian date of 1970-01-01.
const UNIX_EPOCH_MJD: f64 = 40_587.0;
const DAY_S: f64 = 86_400.0;

/// How the Earth stands, and what its clocks show, at one instant (IERS).
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EarthOrientation {
    /// Leap seconds, and the ten before them.
    pub tai_utc_s: f64,
    /// One second of it moves every azimuth by up to 15 arcsec.
    pub ut1_utc_s: f64,
    /// The pole's place.
    pub x_arcsec: f64,
    pub y_arcsec: f64,
}

/// The Earth's orientation over the years.
#[derive(Debug, Clone, PartialEq)]
pub struct OrientationTable {
    /// By growing date, two at least.
    rows: Vec<Row>,
}

#[derive(Debug, Clone, Copy, PartialEq)]
struct Row {
    mjd: f64,
    orientation: EarthOrientation,
}

/// Why a table of Earth orientation was refused.
#[derive(Debug, thiserror::Error)]
pub enum TableError {
    #[error("{}: {source}", path.display())]
    Unreadable {
        path: PathBuf,
        source: std::io::Error,
    },
    #[error("{}: line {line}: expected {expected}, found \"{found}\"", path.display())]
    Malformed {
        path: PathBuf,
        line: usize,
        expected: &'static str,
        found: String,
    },
}

impl OrientationTable {
    /// The table that the program carries.
    pub fn built_in() -> Arc<Self> {
        static TABLE: OnceLock<Arc<OrientationTable>> = OnceLock::new();
        let read = || {
            let table = Self::parse(Path::new("built-in table of Earth orientation"), BUILT_IN);
            Arc::new(table.expect("the program's own table is well formed: a test reads it"))
        };
        Arc::clone(TABLE.get_or_init(read))
    }

    /// Reads a table as `tools/iers` makes it.
    ///
    /// # Errors
    /// A file that cannot be read, other columns, a value that is no number, dates that do not grow, fewer than two.
    pub fn read(path: &Path) -> Result<Self, TableError> {
        let text = std::fs::read_to_string(path).map_err(|source| TableError::Unreadable {
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
        let mut rows: Vec<Row> = Vec::new();
        let mut lines = (1..)
            .zip(text.lines())
            .filter(|(_, line)| !line.starts_with('#'));
        match lines.next() {
            Some((_, COLUMNS)) => {}
            Some((number, line)) => return Err(malformed(number, COLUMNS, line)),
            None => return Err(malformed(1, COLUMNS, "")),
        }
        for (number, line) in lines {
            let row = Row::parse(line).ok_or_else(|| malformed(number, "five numbers", line))?;
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

    /// The orientation at an instant.
    ///
    /// # Errors
    /// [`SkyError::Orientation`] outside the table.
    pub fn at(&self, utc: Timestamp) -> Result<EarthOrientation, SkyError> {
        let mjd = modified_julian_date(utc);
        let after = self.rows.partition_point(|row| row.mjd <= mjd);
        // The last instant of the table stands behind its last row.
        let is_end = after == self.rows.len() && self.rows[after - 1].mjd == mjd;
        let after = if is_end { after - 1 } else { after };
        if after == 0 || after == self.rows.len() {
            let [first, last] = self.dates();
            return Err(SkyError::Orientation { utc, first, last });
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
        })
    }

    /// The days of the first and the last row; the table ends as its last day begins.
    pub fn dates(&self) -> [Date; 2] {
        let date = |row: &Row| {
            let second = ((row.mjd - UNIX_EPOCH_MJD) * DAY_S) as i64;
            let day = Timestamp::from_second(second).unwrap_or(Timestamp::MAX);
            Offset::UTC.to_datetime(day).date()
        };
        [&self.rows[0], &self.rows[self.rows.len() - 1]].map(date)
    }
}

impl Row {
    fn parse(line: &str) -> Option<Self> {
        let numbers: Option<Vec<f64>> = line.split(',').map(|n| n.trim().parse().ok()).collect();
        match numbers?[..] {
            [mjd, tai_utc_s, x_arcsec, y_arcsec, ut1_utc_s] => Some(Self {
                mjd,
                orientation: EarthOrientation {
                    tai_utc_s,
                    ut1_utc_s,
                    x_arcsec,
                    y_arcsec,
                },
            }),
            _ => None,
        }
        .filter(|row| row.mjd.is_finite() && row.orientation.ut1_utc_s.is_finite())
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
    fn a_table_is_read_up_to_its_last_instant_and_no_further() {
        let table = parse("41317,10,0,0,0.5\n41319,11,0.2,0,1.3\n").unwrap();
        let at = |utc: &str| table.at(utc.parse().unwrap());
        let middle = at("1972-01-02T00:00:00Z").unwrap();
        assert!((middle.ut1_utc_s - 0.4).abs() < 1e-9 && (middle.x_arcsec - 0.1).abs() < 1e-9);
        let end = at("1972-01-03T00:00:00Z").unwrap();
        assert_eq!((end.tai_utc_s, end.x_arcsec), (11.0, 0.2));
        for outside in ["1971-12-31T23:59:59.999Z", "1972-01-03T00:00:00.001Z"] {
            let error = at(outside).unwrap_err().to_string();
            assert!(error.contains("1972-01-01 to 1972-01-03"), "{error}");
        }
    }

    #[test]
    fn a_bad_table_is_refused_with_its_line() {
        for (rows, wanted) in [
            (
                "41317,10,0,0,0.5\n41318,10,0,0\n",
                "line 4: expected five numbers",
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
