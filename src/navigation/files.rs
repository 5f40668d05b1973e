//! The tables of a flight: IMU, GPS, directions and Sun.

use super::measurement::{Climb, Fix, Implausible, ImuSample};
use super::settings::{Settings, Target};
use csv::ByteRecord;
use nalgebra::{UnitVector3, Vector3};
use std::path::{Path, PathBuf};

/// The columns of an IMU's table, and of that of GPS.
pub const IMU: [&str; 7] = [
    "t_s", "fx_m_s2", "fy_m_s2", "fz_m_s2", "wx_rad_s", "wy_rad_s", "wz_rad_s",
];
pub const GPS: [&str; 7] = ["t_s", "x_m", "y_m", "z_m", "vx_m_s", "vy_m_s", "vz_m_s"];
/// A further column of GPS, which may be missing.
pub const CLIMB: &str = "climb";
const VECTORS: [&str; 7] = ["t_s", "camera", "target", "x", "y", "z", "sigma_rad"];
const SUN: [&str; 4] = ["t_s", "x", "y", "z"];

/// From the Earth's centre, m; and the fastest, m/s.
const DISTANCES_M: std::ops::Range<f64> = 6.3e6..1e8;
const MOST_SPEED_M_S: f64 = 12_000.0;
/// A unit vector is off by no more.
const UNIT: f64 = 1e-3;
/// The IMU misses no more samples than that.
const MOST_MISSING: f64 = 10.0;
/// Measurements come no later than that, s.
const LATE_S: f64 = 2.0;

/// Why a table was refused: file and line, the column, what was expected there and what was found.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("{}, line {line}: {column}: expected {expected}, found {found}", .path.display())]
pub struct TableError {
    path: PathBuf,
    line: u64,
    column: String,
    expected: String,
    found: String,
}

impl TableError {
    /// A wrong time.
    fn of_time(path: &Path, line: u64, expected: String, found_s: f64) -> Self {
        Self {
            path: path.into(),
            line,
            column: "t_s".into(),
            expected,
            found: found_s.to_string(),
        }
    }
}

/// A table that is being read.
struct Table<'a, const N: usize> {
    path: &'a Path,
    columns: [&'static str; N],
    line: u64,
}

impl<'a, const N: usize> Table<'a, N> {
    /// Reads a table whose columns are these, in this order; `each` gets a row.
    fn read(
        path: &'a Path,
        columns: [&'static str; N],
        mut each: impl FnMut(&Self, &ByteRecord) -> Result<(), TableError>,
    ) -> Result<(), TableError> {
        let mut table = Self {
            path,
            columns,
            line: 1,
        };
        let unreadable = |table: &Self, error: csv::Error| {
            let readable = format!("a readable table of {N} columns");
            table.error("table", readable, error.to_string())
        };
        let reader = csv::ReaderBuilder::new()
            .trim(csv::Trim::All)
            .from_path(path);
        let mut reader = reader.map_err(|error| unreadable(&table, error))?;
        let heads = reader.byte_headers();
        let heads = heads.map_err(|error| unreadable(&table, error))?;
        let further = heads.iter().skip(N).all(|name| name == CLIMB.as_bytes());
        let named = columns.iter().map(|name| name.as_bytes());
        if !heads.iter().take(N).eq(named) || !further {
            let found = heads.iter().map(String::from_utf8_lossy);
            let found: Vec<_> = found.collect();
            return Err(table.error("columns", columns.join(","), found.join(",")));
        }
        let mut row = ByteRecord::new();
        loop {
            match reader.read_byte_record(&mut row) {
                Ok(true) => {}
                Ok(false) => return Ok(()),
                Err(error) => {
                    table.line = error.position().map_or(table.line + 1, |at| at.line());
                    return Err(unreadable(&table, error));
                }
            }
            table.line = row.position().map_or(table.line + 1, csv::Position::line);
            each(&table, &row)?;
        }
    }

    fn error(&self, column: &str, expected: impl Into<String>, found: impl ToString) -> TableError {
        TableError {
            path: self.path.into(),
            line: self.line,
            column: column.into(),
            expected: expected.into(),
            found: found.to_string(),
        }
    }

    fn text<'r>(&self, row: &'r ByteRecord, column: usize) -> &'r str {
        let bytes = row.get(column).unwrap_or_default();
        str::from_utf8(bytes).unwrap_or_default()
    }

    fn number(&self, row: &ByteRecord, column: usize) -> Result<f64, TableError> {
        let text = self.text(row, column);
        let number: Option<f64> = text.parse().ok();
        number.filter(|number| number.is_finite()).ok_or_else(|| {
            let expected = "a finite number";
            self.error(self.columns[column], expected, format!("\"{text}\""))
        })
    }

    fn vector(&self, row: &ByteRecord, first: usize) -> Result<Vector3<f64>, TableError> {
        Ok(Vector3::new(
            self.number(row, first)?,
            self.number(row, first + 1)?,
            self.number(row, first + 2)?,
        ))
    }

    fn unit(&self, row: &ByteRecord, first: usize) -> Result<UnitVector3<f64>, TableError> {
        let vector = self.vector(row, first)?;
        match (vector.norm() - 1.0).abs() < UNIT {
            true => Ok(UnitVector3::new_normalize(vector)),
            false => Err(self.error(
                "x, y, z",
                "a vector of length 1",
                format!("one of length {}", vector.norm()),
            )),
        }
    }
}

/// The samples of an IMU.
///
/// # Errors
/// File, line and column; times that do not rise, gaps, numbers in other units.
pub fn read_imu(path: &Path, settings: &Settings) -> Result<Vec<ImuSample>, TableError> {
    let samples = read_samples(path, settings)?;
    let most_s = longest_step_s(path, &samples)?;
    let gap = gaps(&samples, most_s).next();
    match gap {
        None => Ok(samples),
        Some(at) => {
            // Behind the head, and counted from 1.
            let line = at as u64 + 2;
            let expected = format!("a time within {most_s:.4} s of that of the line before");
            Err(TableError::of_time(path, line, expected, samples[at].t_s))
        }
    }
}

/// The samples of a flight's files, in the order of time, in runs: one ends where the IMU was silent for longer than ten samples.
///
/// # Errors
/// As [`read_imu`], but for gaps; files that overlap.
pub fn read_imu_runs(
    paths: &[PathBuf],
    settings: &Settings,
) -> Result<Vec<Vec<ImuSample>>, TableError> {
    let read = |path: &Path| read_samples(path, settings);
    let mut samples = joined(paths, read, |sample| sample.t_s)?;
    let first = paths.first().map_or(Path::new(""), PathBuf::as_path);
    let most_s = longest_step_s(first, &samples)?;
    let cuts: Vec<usize> = gaps(&samples, most_s).collect();
    let later = cuts.into_iter().rev().map(|at| samples.split_off(at));
    let mut runs: Vec<Vec<ImuSample>> = later.collect();
    runs.push(samples);
    runs.reverse();
    // One sample alone has no length.
    runs.retain(|run| run.len() > 1);
    Ok(runs)
}

/// The fixes of a flight's files, in the order of time.
///
/// # Errors
/// As [`read_gps`]; files that overlap.
pub fn read_gps_files(paths: &[PathBuf], settings: &Settings) -> Result<Vec<Fix>, TableError> {
    joined(paths, |path| read_gps(path, settings), |fix| fix.t_s)
}

/// What files hold, one after the other in the order of time.
fn joined<T>(
    paths: &[PathBuf],
    read: impl Fn(&Path) -> Result<Vec<T>, TableError>,
    t_s: impl Fn(&T) -> f64,
) -> Result<Vec<T>, TableError> {
    let mut parts: Vec<(&Path, Vec<T>)> = Vec::new();
    for path in paths {
        parts.push((path, read(path)?));
    }
    parts.retain(|(_, part)| !part.is_empty());
    parts.sort_by(|(_, a), (_, b)| t_s(&a[0]).total_cmp(&t_s(&b[0])));
    let mut all: Vec<T> = Vec::new();
    let mut before = Path::new("");
    for (path, part) in parts {
        let first_s = t_s(&part[0]);
        if let Some(last_s) = all.last().map(&t_s).filter(|last_s| first_s <= *last_s) {
            let expected = format!("a time after {last_s} s, the last of {}", before.display());
            return Err(TableError::of_time(path, 2, expected, first_s));
        }
        match all.is_empty() {
            // A flight of one file is not copied.
            true => all = part,
            false => all.extend(part),
        }
        before = path;
    }
    Ok(all)
}

fn read_samples(path: &Path, settings: &Settings) -> Result<Vec<ImuSample>, TableError> {
    let mut samples: Vec<ImuSample> = Vec::new();
    Table::read(path, IMU, |table, row| {
        let sample = ImuSample {
            t_s: table.number(row, 0)? - settings.imu.delay_s,
            force_m_s2: table.vector(row, 1)?,
            rate_rad_s: table.vector(row, 4)?,
        };
        rises(table, samples.last().map(|last| last.t_s), sample.t_s)?;
        if let Err(Implausible { what, found, most }) = sample.check() {
            return Err(table.error(what, format!("less than {most}"), found));
        }
        samples.push(sample);
        Ok(())
    })?;
    Ok(samples)
}

fn rises<const N: usize>(
    table: &Table<N>,
    before: Option<f64>,
    t_s: f64,
) -> Result<(), TableError> {
    match before {
        Some(before) if t_s <= before => {
            let expected = format!("a time after that of the line before, {before} s");
            Err(table.error("t_s", expected, t_s))
        }
        _ => Ok(()),
    }
}

/// The longest step between two samples that is none of an IMU that was silent, s.
fn longest_step_s(path: &Path, samples: &[ImuSample]) -> Result<f64, TableError> {
    let steps = samples.windows(2).map(|pair| pair[1].t_s - pair[0].t_s);
    let mut steps: Vec<f64> = steps.collect();
    let Some(half) = steps.len().checked_sub(1).map(|last| last / 2) else {
        let rows = samples.len();
        let table = Table {
            path,
            columns: IMU,
            line: 1,
        };
        return Err(table.error("table", "two rows or more", format!("{rows}")));
    };
    let (_, usual_s, _) = steps.select_nth_unstable_by(half, f64::total_cmp);
    Ok(MOST_MISSING * *usual_s)
}

/// The samples before which the IMU was silent for longer.
fn gaps(samples: &[ImuSample], most_s: f64) -> impl Iterator<Item = usize> {
    let steps = samples.windows(2).map(|pair| pair[1].t_s - pair[0].t_s);
    let after = steps
        .enumerate()
        .filter(move |(_, step_s)| *step_s > most_s);
    after.map(|(before, _)| before + 1)
}

/// The fixes of GPS, in the order of time.
///
/// # Errors
/// As [`read_imu`].
pub fn read_gps(path: &Path, settings: &Settings) -> Result<Vec<Fix>, TableError> {
    let mut fixes = Vec::new();
    let mut newest = f64::NEG_INFINITY;
    Table::read(path, GPS, |table, row| {
        let fix = Fix {
            t_s: table.number(row, 0)? - settings.gps.delay_s,
            position_m: table.vector(row, 1)?,
            velocity_m_s: table.vector(row, 4)?,
            climb: match table.text(row, GPS.len()) {
                "" => Climb::Measured,
                name => Climb::named(name)
                    .ok_or_else(|| table.error(CLIMB, "measured or unknown", name))?,
            },
        };
        newest = not_late(table, newest, fix.t_s)?;
        let distance_m = fix.position_m.norm();
        if !DISTANCES_M.contains(&distance_m) {
            let expected = format!("ECEF in m, {DISTANCES_M:?} from the Earth's centre");
            return Err(table.error("x_m, y_m, z_m", expected, format!("{distance_m} m")));
        }
        let speed_m_s = fix.velocity_m_s.norm();
        if speed_m_s > MOST_SPEED_M_S {
            let expected = format!("less than {MOST_SPEED_M_S} m/s");
            return Err(table.error("vx_m_s, vy_m_s, vz_m_s", expected, speed_m_s));
        }
        fixes.push(fix);
        Ok(())
    })?;
    fixes.sort_by(|a, b| a.t_s.total_cmp(&b.t_s));
    Ok(fixes)
}

/// The newest time so far; measurements may come late, by so much.
fn not_late<const N: usize>(table: &Table<N>, newest: f64, t_s: f64) -> Result<f64, TableError> {
    match t_s < newest - LATE_S {
        true => {
            let expected = format!("a time no more than {LATE_S} s before {newest} s, the latest");
            Err(table.error("t_s", expected, t_s))
        }
        false => Ok(newest.max(t_s)),
    }
}

/// A direction as its table has it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Seen {
    pub line: u64,
    pub t_s: f64,
    pub camera: usize,
    pub target: Target,
    /// In the camera's axes.
    pub unit: UnitVector3<f64>,
    pub sigma_rad: f64,
}

/// The directions that cameras have seen, in the order of time.
///
/// # Errors
/// As [`read_imu`]; cameras and targets that are not known, and sigmas that are less than their correlated part.
pub fn read_vectors(path: &Path, settings: &Settings) -> Result<Vec<Seen>, TableError> {
    let mut vectors = Vec::new();
    let mut newest = f64::NEG_INFINITY;
    Table::read(path, VECTORS, |table, row| {
        let said_s = table.number(row, 0)?;
        newest = not_late(table, newest, said_s)?;
        let name = table.text(row, 1);
        let camera = settings.camera(name).ok_or_else(|| {
            let names: Vec<_> = settings.cameras.iter().map(|c| c.name.as_str()).collect();
            let expected = format!("a camera of the configuration ({})", names.join(", "));
            table.error("camera", expected, format!("\"{name}\""))
        })?;
        let name = table.text(row, 2);
        let target = Target::named(name)
            .ok_or_else(|| table.error("target", "sun, nadir or moon", format!("\"{name}\"")))?;
        let sigma_rad = table.number(row, 6)?;
        let correlated_rad = settings.correlated_rad[target as usize];
        if sigma_rad <= 0.0 || sigma_rad > 1.0 {
            return Err(table.error(
                "sigma_rad",
                "a number above 0, and of 1 rad at most",
                sigma_rad,
            ));
        }
        // Rounding may make them differ.
        if sigma_rad < correlated_rad * (1.0 - 1e-6) {
            let expected = format!(
                "{correlated_rad} rad or more, the part that [{}] correlated_sigma_deg states",
                target.name()
            );
            return Err(table.error("sigma_rad", expected, sigma_rad));
        }
        vectors.push(Seen {
            line: table.line,
            t_s: said_s - settings.cameras[camera].delay_s,
            camera,
            target,
            unit: table.unit(row, 3)?,
            sigma_rad,
        });
        Ok(())
    })?;
    vectors.sort_by(|a, b| a.t_s.total_cmp(&b.t_s));
    Ok(vectors)
}

/// Directions to the Sun in ECEF, with their times.
///
/// # Errors
/// As [`read_imu`].
pub fn read_sun(path: &Path) -> Result<Vec<(f64, UnitVector3<f64>)>, TableError> {
    let mut table_of_sun: Vec<(f64, UnitVector3<f64>)> = Vec::new();
    Table::read(path, SUN, |table, row| {
        let t_s = table.number(row, 0)?;
        rises(table, table_of_sun.last().map(|(t_s, _)| *t_s), t_s)?;
        table_of_sun.push((t_s, table.unit(row, 1)?));
        Ok(())
    })?;
    Ok(table_of_sun)
}

impl Seen {
    /// That nothing tells where its target is.
    pub fn without(&self, path: &Path, expected: &str, found: impl ToString) -> TableError {
        TableError {
            path: path.into(),
            line: self.line,
            column: self.target.name().into(),
            expected: expected.into(),
            found: found.to_string(),
        }
    }
}
