//! Storage of the states: `pointing.fits`.

use super::PointingHistory;
use super::seconds::Second;
use super::state::{Basis, State};
use crate::columns::{self, Column, Widths, float, integer};
use crate::fits::{Card, FileError, open_disk_file};
use fitsio::tables::ReadsCol;
use fitsio::{FileOpenMode, FitsFile};
use nalgebra::{Matrix3, Quaternion, UnitQuaternion, UnitVector3, Vector3};
use std::path::{Path, PathBuf};

/// The file of a refined flight with its pointing's states.
pub const POINTING_FILE: &str = "pointing.fits";
/// Its tables.
const STATES: &str = "STATES";
const SECONDS: &str = "SECONDS";
/// Bits of BASIS.
const SUN: i64 = 1;
const GYROS: i64 = 2;
const CONTRADICTED: i64 = 4;

#[rustfmt::skip]
const STATE_COLUMNS: &[Column<State>] = &[
    float("UNIX_S", "s", "time, UTC, since 1970-01-01", |s| Some(s.unix_s)),
    float("Q0", "", "scalar: v_ecef = R(q) v_telescope; forward, right, down", |s| Some(s.attitude.w)),
    float("Q1", "", "x", |s| Some(s.attitude.i)),
    float("Q2", "", "y", |s| Some(s.attitude.j)),
    float("Q3", "", "z", |s| Some(s.attitude.k)),
    float("RATE_FORWARD", "rad/s", "rate about forward, against the Earth", |s| Some(s.rate_rad_s.x)),
    float("RATE_RIGHT", "rad/s", "about right", |s| Some(s.rate_rad_s.y)),
    float("RATE_DOWN", "rad/s", "about down", |s| Some(s.rate_rad_s.z)),
    float("VAR_RIGHT", "rad2", "variance to the right, random", |s| Some(s.covariance_rad2.m11)),
    float("VAR_UP", "rad2", "variance up", |s| Some(s.covariance_rad2.m22)),
    float("VAR_ROLL", "rad2", "variance about the boresight", |s| Some(s.covariance_rad2.m33)),
    float("COV_RIGHT_UP", "rad2", "covariance", |s| Some(s.covariance_rad2.m12)),
    float("COV_RIGHT_ROLL", "rad2", "covariance", |s| Some(s.covariance_rad2.m13)),
    float("COV_UP_ROLL", "rad2", "covariance", |s| Some(s.covariance_rad2.m23)),
    integer("BASIS", "1 Sun, 2 gyros, 3 both; 4 more where they contradict", |s| Some(basis(s))),
];

#[rustfmt::skip]
const SECOND_COLUMNS: &[Column<Second>] = &[
    integer("UNIX_S", "time, UTC, since 1970-01-01, s", |s| Some(s.unix_s)),
    float("X", "m", "place of the telescope, ECEF", |s| Some(s.position_m.x)),
    float("Y", "m", "place of the telescope, ECEF", |s| Some(s.position_m.y)),
    float("Z", "m", "place of the telescope, ECEF", |s| Some(s.position_m.z)),
    float("SUN_X", "", "direction to the Sun, ECEF", |s| Some(s.to_sun.x)),
    float("SUN_Y", "", "direction to the Sun, ECEF", |s| Some(s.to_sun.y)),
    float("SUN_Z", "", "direction to the Sun, ECEF", |s| Some(s.to_sun.z)),
    float("NORTH_X", "", "solar north, ECEF", |s| Some(s.north.x)),
    float("NORTH_Y", "", "solar north, ECEF", |s| Some(s.north.y)),
    float("NORTH_Z", "", "solar north, ECEF", |s| Some(s.north.z)),
    float("VAR_RIGHT", "rad2", "variance to the right, of the calibration", |s| Some(s.systematic_rad2.m11)),
    float("VAR_UP", "rad2", "variance up", |s| Some(s.systematic_rad2.m22)),
    float("VAR_ROLL", "rad2", "variance about the boresight", |s| Some(s.systematic_rad2.m33)),
    float("COV_RIGHT_UP", "rad2", "covariance", |s| Some(s.systematic_rad2.m12)),
    float("COV_RIGHT_ROLL", "rad2", "covariance", |s| Some(s.systematic_rad2.m13)),
    float("COV_UP_ROLL", "rad2", "covariance", |s| Some(s.systematic_rad2.m23)),
];

fn basis(state: &State) -> i64 {
    let basis = match state.basis {
        Basis::Sun => SUN,
        Basis::Gyros => GYROS,
        Basis::Both => SUN | GYROS,
    };
    basis
        | if state.is_contradicted {
            CONTRADICTED
        } else {
            0
        }
}

/// Reasons for which stored states cannot be read.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    #[error("{}: expected a refined flight's {POINTING_FILE}, found \"{cause}\"", .path.display())]
    File {
        path: PathBuf,
        cause: fitsio::errors::Error,
    },
    #[error("{}: {table}, {column}: expected {expected}, found none in row {row}", .path.display())]
    Value {
        path: PathBuf,
        table: &'static str,
        column: &'static str,
        expected: &'static str,
        /// Number of the row, from 1.
        row: usize,
    },
}

impl StoreError {
    fn file(path: &Path, cause: fitsio::errors::Error) -> Self {
        let path = path.into();
        Self::File { path, cause }
    }

    fn value(
        path: &Path,
        table: &'static str,
        column: &'static str,
        expected: &'static str,
        row: usize,
    ) -> Self {
        Self::Value {
            path: path.into(),
            table,
            column,
            expected,
            row: row + 1,
        }
    }
}

impl PointingHistory {
    /// Writes the states to a folder; `cards` are added to every header.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn write(&self, folder: &Path, cards: &[Card]) -> Result<(), FileError> {
        columns::write_tables(&folder.join(POINTING_FILE), cards, |file| {
            let states = self.states.iter().map(Ok::<_, FileError>);
            columns::write_fits(
                file,
                STATES,
                STATE_COLUMNS,
                &Widths::new(STATE_COLUMNS),
                states,
            )?;
            let seconds = self.seconds.rows.iter().map(Ok::<_, FileError>);
            let widths = Widths::new(SECOND_COLUMNS);
            columns::write_fits(file, SECONDS, SECOND_COLUMNS, &widths, seconds)
        })
    }

    /// Reads the states of a refined flight.
    ///
    /// # Errors
    /// If the folder has none, or a value is invalid.
    pub fn read(folder: &Path) -> Result<Self, StoreError> {
        let path = folder.join(POINTING_FILE);
        let mut file = Stored::open(&path)?;
        Ok(Self::new(file.states()?, file.seconds()?))
    }
}

/// A file of states.
struct Stored<'a> {
    path: &'a Path,
    file: FitsFile,
}

impl<'a> Stored<'a> {
    fn open(path: &'a Path) -> Result<Self, StoreError> {
        let file = open_disk_file(path, FileOpenMode::READONLY);
        let file = file.map_err(|cause| StoreError::file(path, cause))?;
        Ok(Self { path, file })
    }

    /// Columns of a table.
    fn columns<T: ReadsCol, const N: usize>(
        &mut self,
        table: &str,
        names: [&str; N],
    ) -> Result<Columns<T, N>, StoreError> {
        let file = &mut self.file;
        let hdu = file.hdu(table);
        let hdu = hdu.map_err(|cause| StoreError::file(self.path, cause))?;
        let mut columns = [const { Vec::new() }; N];
        for (column, name) in columns.iter_mut().zip(names) {
            let read = hdu.read_col::<T>(file, name);
            *column = read.map_err(|cause| StoreError::file(self.path, cause))?;
        }
        Ok(Columns(columns))
    }

    fn states(&mut self) -> Result<Vec<State>, StoreError> {
        #[rustfmt::skip]
        let numbers = self.columns::<f64, 14>(STATES, [
            "UNIX_S", "Q0", "Q1", "Q2", "Q3", "RATE_FORWARD", "RATE_RIGHT", "RATE_DOWN",
            "VAR_RIGHT", "VAR_UP", "VAR_ROLL", "COV_RIGHT_UP", "COV_RIGHT_ROLL", "COV_UP_ROLL",
        ])?;
        let Columns([bases]) = self.columns::<i64, 1>(STATES, ["BASIS"])?;
        let mut states = Vec::with_capacity(bases.len());
        for ((n, row), basis) in numbers.rows().enumerate().zip(bases) {
            let wrong =
                |column, expected| StoreError::value(self.path, STATES, column, expected, n);
            let [unix_s, w, i, j, k, x, y, z, ..] = row;
            if !row.iter().all(|value| value.is_finite()) {
                return Err(wrong("UNIX_S ... COV_UP_ROLL", "numbers"));
            }
            if states
                .last()
                .is_some_and(|last: &State| last.unix_s >= unix_s)
            {
                return Err(wrong("UNIX_S", "times in order"));
            }
            let attitude = Quaternion::new(w, i, j, k);
            if (attitude.norm() - 1.0).abs() > 1e-6 {
                return Err(wrong("Q0, Q1, Q2, Q3", "a quaternion of length 1"));
            }
            states.push(State {
                unix_s,
                attitude: UnitQuaternion::new_normalize(attitude),
                rate_rad_s: Vector3::new(x, y, z),
                covariance_rad2: covariance(&row[8..]),
                basis: match basis & (SUN | GYROS) {
                    SUN => Basis::Sun,
                    GYROS => Basis::Gyros,
                    0 => return Err(wrong("BASIS", "1, 2 or 3, and 4 more")),
                    _ => Basis::Both,
                },
                is_contradicted: basis & CONTRADICTED != 0,
            });
        }
        Ok(states)
    }

    fn seconds(&mut self) -> Result<Vec<Second>, StoreError> {
        let Columns([times_s]) = self.columns::<i64, 1>(SECONDS, ["UNIX_S"])?;
        #[rustfmt::skip]
        let numbers = self.columns::<f64, 15>(SECONDS, [
            "X", "Y", "Z", "SUN_X", "SUN_Y", "SUN_Z", "NORTH_X", "NORTH_Y", "NORTH_Z",
            "VAR_RIGHT", "VAR_UP", "VAR_ROLL", "COV_RIGHT_UP", "COV_RIGHT_ROLL", "COV_UP_ROLL",
        ])?;
        let mut seconds = Vec::with_capacity(times_s.len());
        for ((n, row), unix_s) in numbers.rows().enumerate().zip(times_s) {
            let wrong =
                |column, expected| StoreError::value(self.path, SECONDS, column, expected, n);
            if !row.iter().all(|value| value.is_finite()) {
                return Err(wrong("X ... COV_UP_ROLL", "numbers"));
            }
            if seconds
                .last()
                .is_some_and(|last: &Second| last.unix_s >= unix_s)
            {
                return Err(wrong("UNIX_S", "times in order"));
            }
            let vector = |first: usize| Vector3::from_column_slice(&row[first..first + 3]);
            seconds.push(Second {
                unix_s,
                position_m: vector(0),
                to_sun: UnitVector3::new_normalize(vector(3)),
                north: UnitVector3::new_normalize(vector(6)),
                systematic_rad2: covariance(&row[9..]),
            });
        }
        Ok(seconds)
    }
}

/// Columns of equal length.
struct Columns<T, const N: usize>([Vec<T>; N]);

impl<const N: usize> Columns<f64, N> {
    fn rows(&self) -> impl Iterator<Item = [f64; N]> {
        let count = self.0.iter().map(Vec::len).min().unwrap_or_default();
        (0..count).map(|n| self.0.each_ref().map(|column| column[n]))
    }
}

/// Covariance from the six numbers in tables: the variances, and the covariances above the diagonal.
fn covariance(numbers: &[f64]) -> Matrix3<f64> {
    match numbers {
        [xx, yy, zz, xy, xz, yz] => Matrix3::new(*xx, *xy, *xz, *xy, *yy, *yz, *xz, *yz, *zz),
        _ => Matrix3::from_element(f64::NAN),
    }
}
