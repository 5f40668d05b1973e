//! Time series: the values of packets or of rows of a log, in columns.

use jiff::Timestamp;
use std::ops::Range;

/// Nanoseconds since 1970, UTC.
pub type Nanoseconds = i64;

pub fn nanoseconds(time: Timestamp) -> Nanoseconds {
    // Valid until the year 2262.
    time.as_nanosecond() as i64
}

pub fn timestamp(time: Nanoseconds) -> Timestamp {
    Timestamp::from_nanosecond(time.into()).unwrap_or_default()
}

/// Checks that the flight's time advances with the ground's clock. A time that differs by an hour or more is accepted only
/// after others have agreed with it for a while: a corrupt packet with a valid checksum, or a forged one, must not set the
/// clock.
#[derive(Debug, Clone, Copy, Default)]
pub struct Steady {
    last: Option<Moment>,
    /// The first and the last of the times not accepted yet.
    doubted: Option<(Moment, Moment)>,
}

/// A time of the flight's clock, and the ground's time when it arrived.
#[derive(Debug, Clone, Copy)]
struct Moment {
    time: Nanoseconds,
    arrived: Nanoseconds,
}

impl Moment {
    /// Whether the flight's clock has advanced like the ground's between two moments.
    fn agrees(&self, other: &Self) -> bool {
        const HOUR_NS: u64 = 3_600_000_000_000;
        let moved = self.time.saturating_sub(other.time);
        let ours = self.arrived.saturating_sub(other.arrived);
        moved.abs_diff(ours) < HOUR_NS
    }
}

impl Steady {
    /// Time of the ground's clock after which a new setting of the flight's clock is accepted.
    pub const PERSISTS_NS: i64 = 5_000_000_000;

    /// Whether a time that arrived at a ground time is accepted.
    pub fn take(&mut self, time: Nanoseconds, arrived: Nanoseconds) -> bool {
        let now = Moment { time, arrived };
        let first = match self.doubted.filter(|(_, last)| last.agrees(&now)) {
            Some((first, _)) => first,
            None => now,
        };
        let persists = arrived.saturating_sub(first.arrived) >= Self::PERSISTS_NS;
        let is_steady = self.last.is_none_or(|last| last.agrees(&now)) || persists;
        match is_steady {
            true => (self.last, self.doubted) = (Some(now), None),
            false => self.doubted = Some((first, now)),
        }
        is_steady
    }
}

/// Description of a column.
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

/// Rows in the order of their times (UTC, ns since 1970). Values are stored in single precision, NaN if unknown: 24 hours
/// at 4 Hz with five columns take 10 MB.
#[derive(Debug, Clone)]
pub struct Table {
    pub name: String,
    pub columns: Vec<Column>,
    times: Vec<i64>,
    /// Time of arrival of each row by the ground's clock, s since 1970.
    arrived_s: Vec<u32>,
    values: Vec<Vec<f32>>,
}

impl Table {
    pub fn new(name: &str, columns: Vec<Column>) -> Self {
        Self {
            name: name.into(),
            values: vec![Vec::new(); columns.len()],
            columns,
            times: Vec::new(),
            arrived_s: Vec::new(),
        }
    }

    /// Inserts a row by its own time, with its time of arrival; `row` has one value per column.
    pub fn push(&mut self, time: i64, arrived: Nanoseconds, row: &[Option<f64>]) {
        let at = place(&self.times, time);
        self.times.insert(at, time);
        self.arrived_s.insert(at, seconds(arrived));
        for (column, value) in self.values.iter_mut().zip(row) {
            column.insert(at, value.map_or(f32::NAN, |value| value as f32));
        }
    }

    pub fn times(&self) -> &[i64] {
        &self.times
    }

    /// The values of a column, NaN if unknown.
    pub fn column(&self, name: &str) -> Option<&[f32]> {
        let at = self.columns.iter().position(|column| column.name == name)?;
        self.values.get(at).map(Vec::as_slice)
    }

    /// A value of a row.
    pub fn value(&self, row: usize, column: &str) -> Option<f64> {
        let value = *self.column(column)?.get(row)?;
        value.is_finite().then(|| value.into())
    }

    /// Drops rows that arrived before a time.
    pub fn forget_before(&mut self, arrived: Nanoseconds) {
        let oldest_s = seconds(arrived);
        let kept: Vec<bool> = self.arrived_s.iter().map(|own| *own >= oldest_s).collect();
        keep(&mut self.times, &kept);
        keep(&mut self.arrived_s, &kept);
        for column in &mut self.values {
            keep(column, &kept);
        }
    }
}

fn seconds(time: Nanoseconds) -> u32 {
    u32::try_from(time / 1_000_000_000).unwrap_or(0)
}

/// Keeps the flagged rows.
pub fn keep<T>(rows: &mut Vec<T>, kept: &[bool]) {
    let mut kept = kept.iter();
    rows.retain(|_| kept.next().is_none_or(|kept| *kept));
}

/// Index at which to insert a time into ordered times: after those equal to it.
pub fn place(times: &[i64], time: i64) -> usize {
    match times.last() {
        Some(last) if *last > time => times.partition_point(|at| *at <= time),
        _ => times.len(),
    }
}

/// The last row with a time not later than the given one.
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

    const SECOND: i64 = 1_000_000_000;

    #[test]
    fn a_time_that_does_not_move_as_ours_is_not_believed_before_it_persists() {
        const HOUR: i64 = 3600 * SECOND;
        let mut steady = Steady::default();
        let mut take =
            |time_s: i64, arrived_s: i64| steady.take(time_s * SECOND, arrived_s * SECOND);
        assert!(take(10, 0) && take(11, 1));
        // Two packets are ten years ahead, and the flight continues.
        assert!(!take(315_360_000, 2) && !take(315_360_001, 3));
        assert!(take(14, 4));
        // After a day of silence the flight's clock has advanced like the ground's.
        assert!(take(86_414, 86_404));
        // The clock was set: accepted after it has advanced like the ground's for five seconds.
        let set = (0..8).map(|n| take(n, 86_410 + n));
        let set: Vec<bool> = set.collect();
        assert_eq!(set, [false, false, false, false, false, true, true, true]);
        assert!(!steady.take(9 * HOUR, 86_418 * SECOND));
    }

    #[test]
    fn rows_are_forgotten_by_when_they_arrived_whatever_their_clock_says() {
        let mut table = Table::new("t", vec![Column::new("x", "mil", "a place")]);
        for (time, arrived) in [(10, 10), (11, 11), (315_360_000, 12), (13, 13), (1, 14)] {
            table.push(time * SECOND, arrived * SECOND, &[Some(arrived as f64)]);
        }
        table.forget_before(12 * SECOND);
        let left: Vec<i64> = table.times().iter().map(|time| time / SECOND).collect();
        assert_eq!(left, [1, 13, 315_360_000]);
        assert_eq!(table.column("x"), Some(&[14.0f32, 13.0, 12.0][..]));
    }

    #[test]
    fn a_late_row_stands_in_its_place() {
        let mut table = Table::new("t", vec![Column::new("x", "mil", "a place")]);
        for (time, x) in [
            (10, Some(1.0)),
            (30, None),
            (20, Some(2.0)),
            (40, Some(4.0)),
        ] {
            table.push(time, 0, &[x]);
        }
        assert_eq!(table.times(), [10, 20, 30, 40]);
        let x: Vec<_> = (0..4).map(|row| table.value(row, "x")).collect();
        assert_eq!(x, [Some(1.0), Some(2.0), None, Some(4.0)]);
        assert_eq!(row_at(table.times(), 25), Some(1));
        assert_eq!(row_at(table.times(), 9), None);
        assert_eq!(rows_within(table.times(), &(20..40)), 1..3);
        assert_eq!(table.value(3, "x"), Some(4.0));
    }
}
