//! Rows of an attitude on disk: a flight of twelve hours has millions, which the smoother returns from the last to the
//! first.

use super::motion::Motion;
use super::solve::{NavigationRow, Status};
use nalgebra::{Matrix3, Quaternion, UnitQuaternion, Vector3};
use std::fs::File;
use std::io::{self, BufReader, Read, Seek, SeekFrom};
use std::os::unix::fs::FileExt;
use std::path::Path;

/// Number of values of a row: time, position, velocity, quaternion, covariance.
const NUMBERS: usize = 1 + 3 + 3 + 4 + 9;
/// Followed by the flag for an attitude, and the status.
const ROW_BYTES: usize = 8 * NUMBERS + 2;
/// Number of rows per write.
const BLOCK: usize = 4096;

/// Rows of an attitude in an unnamed file that is removed when the program ends.
pub struct Spool {
    file: File,
    /// The index of the first row that is not yet written.
    first: u64,
    waiting: Vec<u8>,
    rows: u64,
}

impl Spool {
    /// An empty spool on the disk of a folder.
    ///
    /// # Errors
    /// If no file can be created in the folder.
    pub fn in_folder(folder: &Path) -> io::Result<Self> {
        Ok(Self {
            file: tempfile::tempfile_in(folder)?,
            first: 0,
            waiting: Vec::with_capacity(BLOCK * ROW_BYTES),
            rows: 0,
        })
    }

    pub fn len(&self) -> u64 {
        self.rows
    }

    pub fn is_empty(&self) -> bool {
        self.rows == 0
    }

    /// Appends a row.
    ///
    /// # Errors
    /// If the disk refuses the write.
    pub fn push(&mut self, row: &NavigationRow) -> io::Result<()> {
        self.waiting.extend(encoded(row));
        self.rows += 1;
        match self.waiting.len() < BLOCK * ROW_BYTES {
            true => Ok(()),
            false => self.flush(),
        }
    }

    /// Replaces a row by another.
    ///
    /// # Errors
    /// If the disk refuses the write.
    pub fn replace(&mut self, n: u64, row: &NavigationRow) -> io::Result<()> {
        self.flush()?;
        self.file.write_all_at(&encoded(row), n * ROW_BYTES as u64)
    }

    /// All rows, from the first to the last.
    ///
    /// # Errors
    /// If the disk refuses a write or a read.
    pub fn rows(
        &mut self,
    ) -> io::Result<impl Iterator<Item = io::Result<NavigationRow>> + use<'_>> {
        self.flush()?;
        self.file.seek(SeekFrom::Start(0))?;
        let mut file = BufReader::with_capacity(BLOCK * ROW_BYTES, &self.file);
        Ok((0..self.rows).map(move |_| {
            let mut bytes = [0; ROW_BYTES];
            file.read_exact(&mut bytes)?;
            Ok(decoded(&bytes))
        }))
    }

    fn flush(&mut self) -> io::Result<()> {
        let place = self.first * ROW_BYTES as u64;
        self.file.write_all_at(&self.waiting, place)?;
        self.waiting.clear();
        self.first = self.rows;
        Ok(())
    }
}

fn encoded(row: &NavigationRow) -> [u8; ROW_BYTES] {
    let mut numbers = [0.0; NUMBERS];
    numbers[0] = row.t_s;
    if let Some((motion, covariance)) = &row.attitude {
        numbers[1..4].copy_from_slice(motion.position_m.as_slice());
        numbers[4..7].copy_from_slice(motion.velocity_m_s.as_slice());
        numbers[7..11].copy_from_slice(motion.attitude.as_vector().as_slice());
        numbers[11..20].copy_from_slice(covariance.as_slice());
    }
    let mut bytes = [0; ROW_BYTES];
    let cells = bytes.chunks_exact_mut(8).zip(numbers);
    cells.for_each(|(cell, number)| cell.copy_from_slice(&number.to_le_bytes()));
    bytes[ROW_BYTES - 2] = u8::from(row.attitude.is_some());
    bytes[ROW_BYTES - 1] = row.status as u8;
    bytes
}

fn decoded(bytes: &[u8; ROW_BYTES]) -> NavigationRow {
    let (cells, _) = bytes.as_chunks::<8>();
    let numbers: Vec<f64> = cells.iter().map(|cell| f64::from_le_bytes(*cell)).collect();
    let vector = |first: usize| Vector3::from_column_slice(&numbers[first..first + 3]);
    let turn = Quaternion::from_vector(nalgebra::Vector4::from_column_slice(&numbers[7..11]));
    let has_attitude = bytes[ROW_BYTES - 2] != 0;
    let motion = Motion {
        position_m: vector(1),
        velocity_m_s: vector(4),
        attitude: UnitQuaternion::new_unchecked(turn),
    };
    let covariance = Matrix3::from_column_slice(&numbers[11..20]);
    let status = Status::ALL.get(usize::from(bytes[ROW_BYTES - 1]));
    NavigationRow {
        t_s: numbers[0],
        attitude: has_attitude.then_some((motion, covariance)),
        status: status.copied().unwrap_or(Status::Waiting),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(n: u64, status: Status) -> NavigationRow {
        let x = n as f64;
        let motion = Motion {
            position_m: Vector3::new(x, 2.0 * x, -3.0),
            velocity_m_s: Vector3::new(0.1, x, 7.0),
            attitude: UnitQuaternion::from_euler_angles(0.1 * x, 0.2, -0.3),
        };
        let covariance = Matrix3::from_fn(|a, b| x + (a * 3 + b) as f64);
        NavigationRow {
            t_s: 0.01 * x,
            attitude: (status != Status::Waiting).then_some((motion, covariance)),
            status,
        }
    }

    #[test]
    fn rows_come_back_as_they_were_in_order_and_with_those_that_were_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let mut spool = Spool::in_folder(folder.path()).unwrap();
        assert!(spool.is_empty());
        let all = Status::ALL;
        let count = 2 * BLOCK as u64 + 10;
        let mut rows: Vec<NavigationRow> = (0..count)
            .map(|n| row(n, all[n as usize % all.len()]))
            .collect();
        for row in &rows {
            spool.push(row).unwrap();
        }
        for n in (0..count).rev().step_by(7) {
            rows[n as usize] = row(n + 1, Status::Aligned);
            spool.replace(n, &rows[n as usize]).unwrap();
        }
        assert_eq!(spool.len(), count);
        for _ in 0..2 {
            let back: io::Result<Vec<NavigationRow>> = spool.rows().unwrap().collect();
            assert!(back.unwrap() == rows);
        }
    }
}
