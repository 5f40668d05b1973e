//! The tables of a flight: IMU, GPS, directions and Sun.

mod imu;
mod parts;

pub use imu::read_imu;

use super::measurement::{Climb, Fix, Implausible, ImuSample};
use super::settings::{NavigationSettings, Target};
use crate::tables::{BadRow, Kind, LeftOut, TableError, TableRow, quoted, read_rows};
use nalgebra::{UnitVector3, Vector3};
use parts::{Late, Part, Read, Timed, parts, without_overlaps};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

/// The columns of an IMU's table, and of a GPS table.
pub const IMU: [&str; 7] = [
    "t_s", "fx_m_s2", "fy_m_s2", "fz_m_s2", "wx_rad_s", "wy_rad_s", "wz_rad_s",
];
pub const GPS: [&str; 7] = ["t_s", "x_m", "y_m", "z_m", "vx_m_s", "vy_m_s", "vz_m_s"];
/// An optional column of GPS.
pub const CLIMB: &str = "climb";
const VECTORS: [&str; 7] = ["t_s", "camera", "target", "x", "y", "z", "sigma_rad"];
const SUN: [&str; 4] = ["t_s", "x", "y", "z"];

/// Tolerance of a unit vector's length.
const UNIT: f64 = 1e-3;
/// Maximum delay of measurements, s.
const LATE_S: f64 = 2.0;
/// Maximum time from the epoch, s: 3,000 years.
const MOST_TIME_S: f64 = 1e11;

/// The rows of a file, and its rejected rows.
type FileRows<T> = (Vec<Read<T>>, LeftOut);

/// Reads the rows of a table with the given columns in this order. Rows that `read` refuses are rejected.
///
/// # Errors
/// If the file cannot be read, if it has other columns, or if none of its rows can be read.
fn read_table<T, const N: usize>(
    path: &Path,
    columns: [&'static str; N],
    mut read: impl FnMut(&Cells<N>) -> Result<T, BadRow>,
) -> Result<FileRows<T>, TableError> {
    let (mut rows, mut left_out) = (Vec::new(), LeftOut::of(path));
    let mut width = None;
    read_rows(path, |row| {
        let Some(width) = width else {
            width = Some(width_of(path, row, &columns)?);
            return Ok(());
        };
        let value = row.check(width, width);
        match value.and_then(|()| read(&Cells { row, columns })) {
            Ok(value) => rows.push(Read {
                line: row.line,
                value,
            }),
            Err(bad) => left_out.note(row.line, bad),
        }
        Ok(())
    })?;
    match left_out.first().filter(|_| rows.is_empty()) {
        Some(first) => Err(first.clone()),
        None if width.is_none() => {
            let expected = format!("rows of {}", columns.join(","));
            Err(BadRow::new(Kind::Cut, "table", expected, "none").at(path, 1))
        }
        None => Ok((rows, left_out)),
    }
}

/// Number of columns in a heading.
fn width_of(path: &Path, heading: &TableRow, columns: &[&str]) -> Result<usize, TableError> {
    let count = columns.len();
    let whole = heading.check(1, usize::MAX);
    whole.map_err(|bad| bad.at(path, heading.line))?;
    let named = (0..count).all(|n| heading.text(n) == columns[n]);
    let further = (count..heading.width()).all(|n| heading.text(n) == CLIMB);
    match named && further {
        true => Ok(heading.width()),
        false => {
            let (expected, found) = (columns.join(","), quoted(&heading.to_string()));
            Err(BadRow::new(Kind::Unreadable, "columns", expected, found).at(path, heading.line))
        }
    }
}

/// A row of a table with the names of its columns.
struct Cells<'a, const N: usize> {
    row: &'a TableRow<'a>,
    columns: [&'static str; N],
}

impl<const N: usize> Cells<'_, N> {
    fn text(&self, n: usize) -> &str {
        self.row.text(n)
    }

    fn number(&self, n: usize) -> Result<f64, BadRow> {
        self.row.number(n, self.columns[n])
    }

    fn time_s(&self) -> Result<f64, BadRow> {
        let t_s = self.number(0)?;
        match t_s.abs() <= MOST_TIME_S {
            true => Ok(t_s),
            false => Err(BadRow::new(
                Kind::OutOfRange,
                self.columns[0],
                format!("a time from -{MOST_TIME_S:e} to {MOST_TIME_S:e} s"),
                t_s,
            )),
        }
    }

    fn vector(&self, first: usize) -> Result<Vector3<f64>, BadRow> {
        Ok(Vector3::new(
            self.number(first)?,
            self.number(first + 1)?,
            self.number(first + 2)?,
        ))
    }

    /// `None` if all three are empty.
    fn known_vector(&self, first: usize) -> Result<Option<Vector3<f64>>, BadRow> {
        match (first..first + 3).all(|n| self.text(n).is_empty()) {
            true => Ok(None),
            false => self.vector(first).map(Some),
        }
    }

    fn unit(&self, first: usize) -> Result<UnitVector3<f64>, BadRow> {
        let vector = self.vector(first)?;
        match (vector.norm() - 1.0).abs() < UNIT {
            true => Ok(UnitVector3::new_normalize(vector)),
            false => Err(BadRow::new(
                Kind::OutOfRange,
                "x, y, z",
                "a vector of length 1",
                format!("one of length {}", vector.norm()),
            )),
        }
    }
}

impl From<Implausible> for BadRow {
    fn from(found: Implausible) -> Self {
        Self::new(Kind::OutOfRange, found.what, found.expected, found.found)
    }
}

impl Timed for ImuSample {
    fn t_s(&self) -> f64 {
        self.t_s
    }
}

impl Timed for Fix {
    fn t_s(&self) -> f64 {
        self.t_s
    }
}

impl Timed for CameraVector {
    fn t_s(&self) -> f64 {
        self.t_s
    }
}

impl Timed for (f64, UnitVector3<f64>) {
    fn t_s(&self) -> f64 {
        self.0
    }
}

/// The tables of several files, each with its rejected rows. If there are several, a file without a valid row is skipped
/// with a warning: a power cut may leave a file that has just been created.
fn read_files<T>(
    paths: &[PathBuf],
    read: impl Fn(&Path) -> Result<FileRows<T>, TableError>,
) -> Result<Vec<FileRows<T>>, TableError> {
    let (mut tables, mut error) = (Vec::new(), None);
    for path in paths {
        match read(path) {
            Ok(table) => tables.push(table),
            Err(refused) if refused.column == "columns" => return Err(refused),
            Err(empty) => {
                if paths.len() > 1 {
                    tracing::warn!("{empty}; the file is not used");
                }
                error.get_or_insert(empty);
            }
        }
    }
    match error.filter(|_| tables.is_empty()) {
        Some(error) => Err(error),
        None => Ok(tables),
    }
}

/// Measurements of a file, in the order of time; of those with the same `key`, the first.
fn in_order<T: Timed, K: Ord>((rows, mut left_out): FileRows<T>, key: impl Fn(&T) -> K) -> Vec<T> {
    let parts = parts(rows, Late::SortedIn(LATE_S), &mut left_out);
    let mut rows: Vec<Read<T>> = parts.into_iter().flatten().collect();
    let mut seen = BTreeSet::new();
    rows.retain(|row| {
        let t_s = row.value.t_s();
        let is_new = seen.insert((t_s.to_bits(), key(&row.value)));
        if !is_new {
            let expected = "a time that no row before has";
            let bad = BadRow::new(Kind::Repeated, "t_s", expected, t_s);
            left_out.note(row.line, bad);
        }
        is_new
    });
    left_out.warn();
    rows.sort_by(|a, b| a.value.t_s().total_cmp(&b.value.t_s()));
    rows.into_iter().map(|row| row.value).collect()
}

/// The GPS fixes of a flight's files, in the order of time.
///
/// # Errors
/// As [`read_imu`].
pub fn read_gps(paths: &[PathBuf], settings: &NavigationSettings) -> Result<Vec<Fix>, TableError> {
    let tables = read_files(paths, |path| read_fixes(path, settings))?;
    let mut fixes: Vec<Fix> = Vec::new();
    for table in tables {
        fixes.extend(in_order(table, |_| ()));
    }
    fixes.sort_by(|a, b| a.t_s.total_cmp(&b.t_s));
    // Files from both disks of a flight.
    fixes.dedup_by_key(|fix| fix.t_s);
    Ok(fixes)
}

fn read_fixes(path: &Path, settings: &NavigationSettings) -> Result<FileRows<Fix>, TableError> {
    read_table(path, GPS, |row| {
        let fix = Fix {
            t_s: row.time_s()? - settings.gps.delay_s,
            position_m: row.vector(1)?,
            velocity_m_s: row.known_vector(4)?,
            climb: match row.text(GPS.len()) {
                "" => Climb::Measured,
                name => Climb::named(name).ok_or_else(|| {
                    let expected = "measured or unknown";
                    BadRow::new(Kind::Unreadable, CLIMB, expected, quoted(name))
                })?,
            },
        };
        fix.check()?;
        Ok(fix)
    })
}

/// A direction in its table.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CameraVector {
    pub line: u64,
    pub t_s: f64,
    pub camera: usize,
    pub target: Target,
    /// Unit vector in the camera's axes.
    pub unit: UnitVector3<f64>,
    pub sigma_rad: f64,
}

/// The directions observed by cameras, in the order of time.
///
/// # Errors
/// As [`read_imu`].
pub fn read_vectors(
    path: &Path,
    settings: &NavigationSettings,
) -> Result<Vec<CameraVector>, TableError> {
    let table = read_table(path, VECTORS, |row| {
        let name = row.text(1);
        let camera = settings.camera(name).ok_or_else(|| {
            let names: Vec<_> = settings.cameras.iter().map(|c| c.name.as_str()).collect();
            let expected = format!("a camera of the configuration ({})", names.join(", "));
            BadRow::new(Kind::Unreadable, "camera", expected, quoted(name))
        })?;
        let name = row.text(2);
        let target = Target::named(name).ok_or_else(|| {
            BadRow::new(
                Kind::Unreadable,
                "target",
                "sun, nadir or moon",
                quoted(name),
            )
        })?;
        Ok(CameraVector {
            line: row.row.line,
            t_s: row.time_s()? - settings.cameras[camera].delay_s,
            camera,
            target,
            unit: row.unit(3)?,
            sigma_rad: sigma_rad(row, settings, target)?,
        })
    })?;
    Ok(in_order(table, |seen| (seen.camera, seen.target)))
}

fn sigma_rad(row: &Cells<7>, settings: &NavigationSettings, target: Target) -> Result<f64, BadRow> {
    let sigma_rad = row.number(6)?;
    let correlated_rad = settings.correlated_rad[target as usize];
    let refused = |expected: String| {
        Err(BadRow::new(
            Kind::OutOfRange,
            "sigma_rad",
            expected,
            sigma_rad,
        ))
    };
    if sigma_rad <= 0.0 || sigma_rad > 1.0 {
        return refused("a number above 0, and of 1 rad at most".into());
    }
    // Rounding may cause a small difference.
    if sigma_rad < correlated_rad * (1.0 - 1e-6) {
        return refused(format!(
            "{correlated_rad} rad or more, the part that [{}] correlated_sigma_deg states",
            target.name()
        ));
    }
    Ok(sigma_rad)
}

/// Directions to the Sun in ECEF, with their times.
///
/// # Errors
/// As [`read_imu`].
pub fn read_sun(path: &Path) -> Result<Vec<(f64, UnitVector3<f64>)>, TableError> {
    let (rows, mut left_out) = read_table(path, SUN, |row| Ok((row.time_s()?, row.unit(1)?)))?;
    let parts = parts(rows, Late::LeftOut, &mut left_out).into_iter();
    let parts = parts.map(|rows| Part {
        file: 0,
        rows,
        is_trimmed: false,
    });
    let mut left_out = [left_out];
    let parts = without_overlaps(parts.collect(), &mut left_out);
    left_out.iter().for_each(LeftOut::warn);
    let rows = parts.into_iter().flat_map(|part| part.rows);
    Ok(rows.map(|row| row.value).collect())
}

impl CameraVector {
    /// The error for a target with unknown position.
    pub fn without(&self, why: impl ToString) -> BadRow {
        let expected = "a target whose direction is known";
        BadRow::new(Kind::OutOfRange, self.target.name(), expected, why)
    }
}

#[cfg(test)]
mod tests;
