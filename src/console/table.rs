//! Numbers over time: what a packet or a row of a log brings, in columns.

use jiff::Timestamp;
use std::ops::Range;

/// Nanoseconds since 1970, UTC.
pub type Nanoseconds = i64;

pub fn nanoseconds(time: Timestamp) -> Nanoseconds {
    // Until the year 2262.
    time.as_nanosecond() as i64
}

pub fn timestamp(time: Nanoseconds) -> Timestamp {
    Timestamp::from_nanosecond(time.into()).unwrap_or_default()
}

/// Times that follow each other. One of another hour than those before it is not believed before another one agrees: a broken packet
/// that passes its checksum must not set the clock.
#[derive(Debug, Clone, Copy, Default)]
pub struct Steady {
    last: Option<Nanoseconds>,
    doubted: Option<Nanoseconds>,
}

impl Steady {
    /// Whether a time is believed.
    pub fn take(&mut self, time: Nanoseconds) -> bool {
        const HOUR_NS: u64 = 3_600_000_000_000;
        let agrees = |other: Nanoseconds| other.abs_diff(time) < HOUR_NS;
        let is_steady = self.last.is_none_or(agrees) || self.doubted.is_some_and(agrees);
        match is_steady {
            true => (self.last, self.doubted) = (Some(time), None),
            false => self.doubted = Some(time),
        }
        is_steady
    }
}

/// What a column holds.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Column {
    pub name: String,
    /// Empty for counts.
    pub unit: String,
    pub documentation: String,
}

impl Column {
    pub fn new(name: &str, unit: &str, documentation: &str) -> Self {
        Self {
            name: name.into(),
            unit: unit.into(),
            documentation: documentation.into(),
        }
    }
}

/// Rows in the order of their times (UTC, ns since 1970). Numbers are kept in single precision, NaN where not known: 24 hours at
/// 4 Hz with five columns take 10 MB.
#[derive(Debug, Clone)]
pub struct Table {
    pub name: String,
    pub columns: Vec<Column>,
    times: Vec<i64>,
    values: Vec<Vec<f32>>,
}

impl Table {
    pub fn new(name: &str, columns: Vec<Column>) -> Self {
        Self {
            name: name.into(),
            values: vec![Vec::new(); columns.len()],
            columns,
            times: Vec::new(),
        }
    }

    /// Adds a row, in its place by time; as many numbers as the table has columns.
    pub fn push(&mut self, time: i64, row: &[Option<f64>]) {
        let at = place(&self.times, time);
        self.times.insert(at, time);
        for (column, value) in self.values.iter_mut().zip(row) {
            column.insert(at, value.map_or(f32::NAN, |value| value as f32));
        }
    }

    pub fn times(&self) -> &[i64] {
        &self.times
    }

    /// The numbers of a column, NaN where not known.
    pub fn column(&self, name: &str) -> Option<&[f32]> {
        let at = self.columns.iter().position(|column| column.name == name)?;
        self.values.get(at).map(Vec::as_slice)
    }

    /// A number of a row.
    pub fn value(&self, row: usize, column: &str) -> Option<f64> {
        let value = *self.column(column)?.get(row)?;
        value.is_finite().then(|| value.into())
    }

    /// Forgets what is older than a time.
    pub fn forget_before(&mut self, time: i64) {
        let count = self.times.partition_point(|at| *at < time);
        self.times.drain(..count);
        for column in &mut self.values {
            column.drain(..count);
        }
    }
}

/// Where a time belongs among ordered ones: behind those equal to it.
pub fn place(times: &[i64], time: i64) -> usize {
    match times.last() {
        Some(last) if *last > time => times.partition_point(|at| *at <= time),
        _ => times.len(),
    }
}

/// The last row that is not later than a time.
pub fn row_at(times: &[i64], time: i64) -> Option<usize> {
    times.partition_point(|at| *at <= time).checked_sub(1)
}

/// The rows within a range of times.
pub fn rows_within(times: &[i64], range: &Range<i64>) -> Range<usize> {
    let first = times.partition_point(|at| *at < range.start);
    let end = times.partition_point(|at| *at < range.end);
    first..end.max(first)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_time_that_stands_alone_is_not_believed_and_two_that_agree_are() {
        const HOUR: i64 = 3_600_000_000_000;
        let mut steady = Steady::default();
        let taken = [
            10,
            11,
            9 * HOUR,
            12,
            8 * HOUR,
            -5 * HOUR,
            13,
            9 * HOUR,
            9 * HOUR + 1,
            14,
        ];
        let taken = taken.map(|time| steady.take(time));
        assert_eq!(
            taken,
            [
                true, true, false, true, false, false, true, false, true, false
            ]
        );
    }

    #[test]
    fn a_late_row_stands_in_its_place_and_old_ones_are_forgotten() {
        let mut table = Table::new("t", vec![Column::new("x", "mil", "a place")]);
        for (time, x) in [
            (10, Some(1.0)),
            (30, None),
            (20, Some(2.0)),
            (40, Some(4.0)),
        ] {
            table.push(time, &[x]);
        }
        assert_eq!(table.times(), [10, 20, 30, 40]);
        let x: Vec<_> = (0..4).map(|row| table.value(row, "x")).collect();
        assert_eq!(x, [Some(1.0), Some(2.0), None, Some(4.0)]);
        assert_eq!(row_at(table.times(), 25), Some(1));
        assert_eq!(row_at(table.times(), 9), None);
        assert_eq!(rows_within(table.times(), &(20..40)), 1..3);
        table.forget_before(25);
        assert_eq!(table.times(), [30, 40]);
        assert_eq!(table.value(1, "x"), Some(4.0));
    }
}
