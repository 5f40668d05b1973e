//! An attitude as an Attitude Ephemeris Message in keyword-value notation (CCSDS 504.0-B-1, section 4), the input format of
//! flight dynamics programs.
//!
//! The quaternion transforms vectors of the Earth-fixed frame to the body's, scalar first. The standard's rotations rotate
//! the frame, so its components are those of the Hamilton quaternion that transforms the body's vectors to the Earth's.

use super::solve::NavigationRow;
use crate::clock::utc_microseconds;
use jiff::{SignedDuration, Timestamp};
use std::io::{self, Write};

/// Head of the message.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Head<'a> {
    /// The instant of t_s = 0.
    pub epoch: Timestamp,
    pub created: Timestamp,
    pub object: &'a str,
}

/// Time spans of successive rows with an attitude: the first row's time and the last one's, s.
#[derive(Debug, Clone, Default)]
pub struct Stretches {
    ended: Vec<(f64, f64)>,
    under_way: Option<(f64, f64)>,
}

impl Stretches {
    /// Takes in the next row.
    pub fn note(&mut self, row: &NavigationRow) {
        match (&mut self.under_way, &row.attitude) {
            (Some((_, last)), Some(_)) => *last = row.t_s,
            (None, Some(_)) => self.under_way = Some((row.t_s, row.t_s)),
            (_, None) => self.ended.extend(self.under_way.take()),
        }
    }

    fn all(self) -> Vec<(f64, f64)> {
        self.ended.into_iter().chain(self.under_way).collect()
    }
}

/// A message being written: each time span is a segment of its own.
pub struct Aem<'a, W> {
    out: W,
    head: Head<'a>,
    segments: Vec<(f64, f64)>,
    /// Number of segments begun so far.
    begun: usize,
    is_open: bool,
}

impl<'a, W: Write> Aem<'a, W> {
    /// Begins a message for the rows that `stretches` has taken in.
    ///
    /// # Errors
    /// If the writer fails.
    pub fn begin(mut out: W, head: Head<'a>, stretches: Stretches) -> io::Result<Self> {
        writeln!(out, "CCSDS_AEM_VERS = 1.0")?;
        writeln!(out, "CREATION_DATE = {}", utc(head.created))?;
        writeln!(out, "ORIGINATOR = SOLASPECT")?;
        Ok(Self {
            out,
            head,
            segments: stretches.all(),
            begun: 0,
            is_open: false,
        })
    }

    /// Adds the next row.
    ///
    /// # Errors
    /// If the writer fails, or if a time is outside the calendar's range.
    pub fn add(&mut self, row: &NavigationRow) -> io::Result<()> {
        let Some((motion, _)) = &row.attitude else {
            return self.close();
        };
        if !self.is_open {
            self.open()?;
        }
        let at = self.at(row.t_s)?;
        let [w, i, j, k] = motion.quaternion();
        writeln!(self.out, "{at} {w:.15} {i:.15} {j:.15} {k:.15}")
    }

    /// Ends the message.
    ///
    /// # Errors
    /// If the writer fails.
    pub fn finish(mut self) -> io::Result<()> {
        self.close()?;
        self.out.flush()
    }

    fn open(&mut self) -> io::Result<()> {
        let segment = self.segments.get(self.begun);
        let (from_s, to_s) =
            *segment.ok_or_else(|| io::Error::other("more rows than were noted"))?;
        let (from, to) = (self.at(from_s)?, self.at(to_s)?);
        let object = self.head.object;
        self.begun += 1;
        self.is_open = true;
        write!(
            self.out,
            "\nMETA_START\nOBJECT_NAME = {object}\nOBJECT_ID = {object}\nCENTER_NAME = EARTH\nREF_FRAME_A = ITRF2000\nREF_FRAME_B = SC_BODY_1\n\
             ATTITUDE_DIR = A2B\nTIME_SYSTEM = UTC\nSTART_TIME = {from}\nSTOP_TIME = {to}\nATTITUDE_TYPE = QUATERNION\nQUATERNION_TYPE = FIRST\n\
             META_STOP\n\nDATA_START\n"
        )
    }

    fn close(&mut self) -> io::Result<()> {
        match std::mem::take(&mut self.is_open) {
            true => writeln!(self.out, "DATA_STOP"),
            false => Ok(()),
        }
    }

    fn at(&self, t_s: f64) -> io::Result<String> {
        let since = SignedDuration::try_from_secs_f64(t_s).map_err(io::Error::other)?;
        let at = self.head.epoch.checked_add(since);
        Ok(utc(at.map_err(io::Error::other)?))
    }
}

/// A time in the standard's format: UTC without a zone, to the microsecond.
fn utc(time: Timestamp) -> String {
    utc_microseconds(time).trim_end_matches('Z').to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::navigation::{Motion, Status};
    use nalgebra::{Matrix3, UnitQuaternion, Vector3};

    fn row(t_s: f64, attitude: Option<UnitQuaternion<f64>>) -> NavigationRow {
        let motion = |attitude| Motion {
            position_m: Vector3::zeros(),
            velocity_m_s: Vector3::zeros(),
            attitude,
        };
        NavigationRow {
            t_s,
            attitude: attitude.map(|attitude| (motion(attitude), Matrix3::identity())),
            status: Status::Aligned,
        }
    }

    #[test]
    fn each_stretch_of_rows_is_a_segment_with_its_times_and_the_quaternion_is_the_standards() {
        let turn = UnitQuaternion::from_euler_angles(0.3, -1.1, 2.0);
        let rows = [
            row(0.0, None),
            row(0.5, Some(turn)),
            row(1.25, Some(turn)),
            row(2.0, None),
            row(3.0, Some(turn)),
        ];
        let mut stretches = Stretches::default();
        rows.iter().for_each(|row| stretches.note(row));
        let head = Head {
            epoch: "2026-11-22T18:00:00Z".parse().unwrap(),
            created: "2026-11-23T00:00:00Z".parse().unwrap(),
            object: "GONDOLA",
        };
        let mut bytes = Vec::new();
        let mut message = Aem::begin(&mut bytes, head, stretches).unwrap();
        rows.iter().for_each(|row| message.add(row).unwrap());
        message.finish().unwrap();
        let text = String::from_utf8(bytes).unwrap();
        let times = |key: &str| -> Vec<String> {
            let lines = text.lines().filter_map(|line| line.strip_prefix(key));
            lines.map(str::to_owned).collect()
        };
        let [start, stop] = ["START_TIME = ", "STOP_TIME = "].map(times);
        assert_eq!(
            start,
            ["2026-11-22T18:00:00.500000", "2026-11-22T18:00:03.000000"]
        );
        assert_eq!(
            stop,
            ["2026-11-22T18:00:01.250000", "2026-11-22T18:00:03.000000"]
        );
        assert_eq!(text.matches("DATA_STOP").count(), 2);
        let data = text.lines().find(|line| line.starts_with("2026-11-22"));
        let q: Vec<f64> = data
            .unwrap()
            .split(' ')
            .skip(1)
            .map(|q| q.parse().unwrap())
            .collect();
        // The standard's matrix from A to B from its quaternion (504.0-B-1, annex): (qc^2 - q.q) 1 + 2 q q^T - 2 qc [q x].
        let (scalar, vector) = (q[0], Vector3::new(q[1], q[2], q[3]));
        let matrix = Matrix3::identity() * (scalar * scalar - vector.norm_squared())
            + vector * vector.transpose() * 2.0
            - vector.cross_matrix() * (2.0 * scalar);
        let body_from_earth = turn.inverse().to_rotation_matrix();
        assert!((matrix - body_from_earth.matrix()).amax() < 1e-12);
    }
}
