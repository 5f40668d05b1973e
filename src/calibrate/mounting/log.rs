//! Logs of angles in CSV files: the telescope's pointing, or the body's attitude.

use crate::calibrate::numbers::median;
use crate::clock::parse_utc;
use crate::pointing::Horizontal;
use crate::sky::sphere::{angles_deg, direction};
use crate::tables::{self, BadRow, Kind, LeftOut, TableError, quoted, read_rows};
use jiff::Timestamp;
use std::collections::BTreeSet;
use std::path::Path;

/// If the rows before and after a frame are too far apart to interpolate, a row this near is used as it is, s.
const SAME_TIME_S: f64 = 0.02;
/// Rows farther apart than this multiple of the median spacing leave a gap.
const GAP_SPACINGS: f64 = 5.0;

/// Columns of a log besides UTC: the beginnings of their headings, their names and ranges.
struct Columns {
    headings: [&'static [&'static str]; 2],
    names: [&'static str; 2],
    expected: [&'static str; 2],
    limits_deg: [f64; 2],
}

const POINTING: Columns = Columns {
    headings: [&["az"], &["el", "alt"]],
    names: ["azimuth", "elevation"],
    expected: [
        "a number from -360 to 360 deg",
        "a number from -90 to 90 deg",
    ],
    limits_deg: [360.0, 90.0],
};
const ATTITUDE: Columns = Columns {
    headings: [&["roll"], &["pitch"]],
    names: ["roll", "pitch"],
    expected: ["a number from -80 to 80 deg", "a number from -80 to 80 deg"],
    limits_deg: [80.0, 80.0],
};

/// An instant and two angles, deg.
type AngleRow = (Timestamp, [f64; 2]);

/// Pairs of angles, deg, in the order of time.
#[derive(Debug, Clone, PartialEq)]
struct AngleLog {
    rows: Vec<AngleRow>,
    gap_s: f64,
}

impl AngleLog {
    /// Reads a CSV file of UTC (ISO 8601, with or without Z) and two angles: its first three columns, or those named in a heading; lines
    /// that begin with # are comments. Rows that cannot be read are skipped.
    fn read(path: &Path, columns: &Columns) -> Result<Self, TableError> {
        let (mut rows, mut places) = (Vec::new(), [0, 1, 2]);
        let (mut left_out, mut is_first) = (LeftOut::of(path), true);
        let mut times = BTreeSet::new();
        read_rows(path, |record| {
            if std::mem::take(&mut is_first) && record.text(0).starts_with(char::is_alphabetic) {
                places = named(record, columns).unwrap_or(places);
                return Ok(());
            }
            match row(record, places, columns) {
                Ok(row) if times.insert(row.0) => rows.push(row),
                Ok((utc, _)) => {
                    let expected = "a time that no row before has";
                    let again = BadRow::new(Kind::Repeated, "UTC", expected, utc);
                    left_out.note(record.line, again);
                }
                Err(bad) => left_out.note(record.line, bad),
            }
            Ok(())
        })?;
        let Some(log) = Self::new(rows) else {
            return Err(left_out.first().cloned().unwrap_or_else(|| {
                let expected = format!("rows of UTC, {}", columns.names.join(" and "));
                BadRow::new(Kind::Cut, "table", expected, "none").at(path, 1)
            }));
        };
        left_out.warn();
        Ok(log)
    }

    fn new(mut rows: Vec<AngleRow>) -> Option<Self> {
        rows.sort_by_key(|row| row.0);
        rows.dedup_by_key(|row| row.0);
        let spacing_s = median(rows.windows(2).map(|w| seconds(w[0].0, w[1].0)));
        (!rows.is_empty()).then_some(Self {
            rows,
            gap_s: GAP_SPACINGS * spacing_s,
        })
    }

    /// The rows before and after an instant, and its position between them, 0 to 1; else the reason why the angles are not known.
    fn about(&self, utc: Timestamp) -> Result<([f64; 2], [f64; 2], f64), String> {
        let after = self.rows.partition_point(|row| row.0 < utc);
        let before = after.checked_sub(1).and_then(|n| self.rows.get(n));
        let after = self.rows.get(after);
        if let Some((before, after)) = before.zip(after) {
            let apart_s = seconds(before.0, after.0);
            if apart_s <= self.gap_s {
                return Ok((before.1, after.1, seconds(before.0, utc) / apart_s));
            }
        }
        // Beside a gap, or at the log's ends.
        let away_s = |row: &&AngleRow| seconds(row.0, utc).abs();
        let nearest = before.into_iter().chain(after);
        let nearest = nearest.min_by(|a, b| away_s(a).total_cmp(&away_s(b)));
        match nearest.filter(|row| away_s(row) <= SAME_TIME_S) {
            Some(row) => Ok((row.1, row.1, 0.0)),
            None => Err(Self::gap_reason(before, after)),
        }
    }

    /// The reason why the angles are not known between two neighbouring rows, or beyond one.
    fn gap_reason(before: Option<&AngleRow>, after: Option<&AngleRow>) -> String {
        match (before, after) {
            (Some(before), Some(after)) => {
                let apart_s = seconds(before.0, after.0);
                format!("in a gap of {apart_s:.1} s of the log, from {}", before.0)
            }
            (None, Some(first)) => format!("before the log begins, {}", first.0),
            (Some(last), None) => format!("after the log ends, {}", last.0),
            (None, None) => "the log is empty".into(),
        }
    }
}

/// Pointings of the telescope.
#[derive(Debug, Clone, PartialEq)]
pub struct PointingLog(AngleLog);

impl PointingLog {
    /// Reads a CSV file of UTC (ISO 8601, with or without Z), azimuth and elevation in deg: its first three columns, or those whose
    /// headings are utc or time, az... and el...; lines that begin with # are comments.
    ///
    /// # Errors
    /// The error names the file, the line and the field, and what was expected there.
    pub fn read(path: &Path) -> Result<Self, TableError> {
        AngleLog::read(path, &POINTING).map(Self)
    }

    /// A log of pointings; `None` without any.
    pub fn new(rows: Vec<(Timestamp, Horizontal)>) -> Option<Self> {
        let rows = rows.into_iter();
        let rows = rows.map(|(utc, h)| (utc, [h.azimuth_deg, h.elevation_deg]));
        AngleLog::new(rows.collect()).map(Self)
    }

    /// The pointing at an instant, interpolated along the great circle between two rows; else the reason why it is not known.
    pub fn at(&self, utc: Timestamp) -> Result<Horizontal, String> {
        let (before, after, part) = self.0.about(utc)?;
        Ok(between(before, after, part))
    }
}

/// Attitudes of the body.
#[derive(Debug, Clone, PartialEq)]
pub struct AttitudeLog(AngleLog);

impl AttitudeLog {
    /// Reads a CSV file of UTC, roll (right side low positive) and pitch (forward end high positive) in deg, as
    /// [`PointingLog::read`] does.
    ///
    /// # Errors
    /// Those of [`PointingLog::read`].
    pub fn read(path: &Path) -> Result<Self, TableError> {
        AngleLog::read(path, &ATTITUDE).map(Self)
    }

    /// Roll and pitch at an instant, deg, interpolated between two rows; else the reason why they are not known.
    pub fn at(&self, utc: Timestamp) -> Result<[f64; 2], String> {
        let (before, after, part) = self.0.about(utc)?;
        Ok([0, 1].map(|n| before[n] + (after[n] - before[n]) * part))
    }
}

fn seconds(from: Timestamp, to: Timestamp) -> f64 {
    to.duration_since(from).as_secs_f64()
}

/// Interpolates on the great circle between two near directions.
fn between(a: [f64; 2], b: [f64; 2], part: f64) -> Horizontal {
    let [a, b] = [a, b].map(|[azimuth_deg, elevation_deg]| direction(azimuth_deg, elevation_deg));
    let (azimuth_deg, elevation_deg) = angles_deg(&(a * (1.0 - part) + b * part));
    Horizontal {
        azimuth_deg,
        elevation_deg,
    }
}

/// The columns of UTC and both angles, by their headings; `None` if one is missing.
fn named(heading: &tables::TableRow, columns: &Columns) -> Option<[usize; 3]> {
    let column = |names: &[&str]| {
        (0..heading.width()).find(|n| {
            let text = heading.text(*n).to_lowercase();
            names.iter().any(|name| text.starts_with(name))
        })
    };
    let [first, second] = columns.headings;
    Some([
        column(&["utc", "time", "date"])?,
        column(first)?,
        column(second)?,
    ])
}

fn row(
    record: &tables::TableRow,
    places: [usize; 3],
    columns: &Columns,
) -> Result<AngleRow, BadRow> {
    record.check(3, usize::MAX)?;
    let texts = places.map(|n| record.text(n));
    let wrong = |column: &str, expected, found: &str| {
        BadRow::new(Kind::Unreadable, column, expected, quoted(found))
    };
    let an_instant = "a time such as 2013-09-21T18:00:00.250Z";
    let utc = parse_utc(texts[0]).map_err(|_| wrong("UTC", an_instant, texts[0]))?;
    let angle = |n: usize| {
        let found = texts[n + 1];
        angle(found, columns.limits_deg[n])
            .ok_or_else(|| wrong(columns.names[n], columns.expected[n], found))
    };
    Ok((utc, [angle(0)?, angle(1)?]))
}

fn angle(text: &str, limit_deg: f64) -> Option<f64> {
    let angle: f64 = text.parse().ok()?;
    (-limit_deg..=limit_deg).contains(&angle).then_some(angle)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn log(rows: &[(&str, f64, f64)]) -> PointingLog {
        let rows = rows.iter().map(|(utc, azimuth_deg, elevation_deg)| {
            let pointing = Horizontal {
                azimuth_deg: *azimuth_deg,
                elevation_deg: *elevation_deg,
            };
            (parse_utc(utc).unwrap(), pointing)
        });
        PointingLog::new(rows.collect()).unwrap()
    }

    #[test]
    fn a_pointing_lies_between_its_neighbours_also_across_north() {
        let log = log(&[
            ("2013-09-21T18:00:00", 359.0, 40.0),
            ("2013-09-21T18:00:01Z", 1.0, 40.0),
        ]);
        let middle = log.at("2013-09-21T18:00:00.5Z".parse().unwrap()).unwrap();
        let from_north = (middle.azimuth_deg + 180.0).rem_euclid(360.0) - 180.0;
        assert!(from_north.abs() < 1e-9 && (middle.elevation_deg - 40.0).abs() < 0.01);
    }

    #[test]
    fn a_dense_log_does_not_lag() {
        let start: Timestamp = "2013-09-21T18:00:00Z".parse().unwrap();
        let after = |time_s: f64| start + jiff::SignedDuration::from_secs_f64(time_s);
        // At 100 Hz, an angle that changes by 1 deg/s.
        let row = |n: u32| {
            let time_s = f64::from(n) * 0.01;
            (after(time_s), [180.0 + time_s, 40.0])
        };
        let log = AttitudeLog(AngleLog::new((0..100).map(row).collect()).unwrap());
        for time_s in [0.0, 0.5, 0.5025, 0.509, 0.99] {
            let [angle_deg, _] = log.at(after(time_s)).unwrap();
            assert!((angle_deg - 180.0 - time_s).abs() < 1e-6, "{time_s}");
        }
    }

    #[test]
    fn columns_are_found_by_their_headings_and_a_bad_field_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log.csv");
        let write = |text: &str| std::fs::write(&path, text).unwrap();
        write("# night 3\nEl_deg, Azimuth, UTC\n40,180,2013-09-21T18:00:00.5\n");
        let log = PointingLog::read(&path).unwrap();
        let at = log.at("2013-09-21T18:00:00.5Z".parse().unwrap()).unwrap();
        assert_eq!((at.azimuth_deg, at.elevation_deg), (180.0, 40.0));
        write("2013-09-21T18:00:00,180,140\n");
        let error = PointingLog::read(&path).unwrap_err().to_string();
        assert!(error.contains("line 1: elevation: expected"), "{error}");
    }

    #[test]
    fn gaps_and_ends_are_reported() {
        let log = log(&[
            ("2013-09-21T18:00:00Z", 180.0, 40.0),
            ("2013-09-21T18:00:01Z", 180.0, 40.0),
            ("2013-09-21T18:00:02Z", 180.0, 40.0),
            ("2013-09-21T18:01:00Z", 180.0, 40.0),
        ]);
        for (utc, wanted) in [
            ("2013-09-21T17:59:59Z", "before the log begins"),
            ("2013-09-21T18:00:30Z", "in a gap of 58.0 s"),
            ("2013-09-21T18:02:00Z", "after the log ends"),
        ] {
            let reason = log.at(utc.parse().unwrap()).unwrap_err();
            assert!(reason.contains(wanted), "{reason}");
        }
        for beside in ["18:00:02.010", "18:00:59.990", "18:01:00", "18:01:00.010"] {
            let utc = format!("2013-09-21T{beside}Z").parse().unwrap();
            assert!(log.at(utc).is_ok(), "{beside}");
        }
    }
}
