//! Good time intervals: times at which the telescope observed with a valid pointing.

use super::times::{Keywords, TimeSystem};
use crate::fits::{AmendedTable, DiskHdu, FileError, Header, Inward, NumberColumn, Problem};

/// The columns of good time intervals.
pub struct GoodTimes {
    start: End,
    stop: End,
}

/// A column with one end of the intervals.
struct End {
    column: NumberColumn,
    times: TimeSystem,
}

/// Remaining intervals of a table, and their total length before the cut.
#[derive(Debug, Clone, PartialEq)]
pub struct Cut {
    pub before_s: f64,
    /// Remaining intervals, UTC, s since 1970.
    pub left_s: Vec<[f64; 2]>,
}

/// Times at which a detector counted with a valid pointing.
#[derive(Debug, Clone, PartialEq)]
pub struct Good {
    /// Name of the extension.
    pub name: String,
    /// UTC, s since 1970, in the order of time, without overlaps.
    pub intervals_s: Vec<[f64; 2]>,
    /// The fraction of the time in which the detector was live.
    pub live_fraction: f64,
}

impl Good {
    /// Takes intervals in any order.
    pub fn new(name: String, mut intervals_s: Vec<[f64; 2]>, live_fraction: f64) -> Self {
        intervals_s.sort_by(|a, b| a[0].total_cmp(&b[0]));
        let mut merged: Vec<[f64; 2]> = Vec::new();
        for [start, stop] in intervals_s {
            match merged.last_mut() {
                Some(last) if start <= last[1] => last[1] = last[1].max(stop),
                _ => merged.push([start, stop]),
            }
        }
        Self {
            name,
            intervals_s: merged,
            live_fraction,
        }
    }

    /// Whether a time, s since 1970, is in one of the intervals.
    pub fn holds(&self, unix_s: f64) -> bool {
        let next = self
            .intervals_s
            .partition_point(|[start, _]| *start <= unix_s);
        let last = next.checked_sub(1).and_then(|n| self.intervals_s.get(n));
        last.is_some_and(|[_, stop]| unix_s <= *stop)
    }

    pub fn live_s(&self) -> f64 {
        length_s(&self.intervals_s) * self.live_fraction
    }
}

/// The live fraction of a detector, from the first of some headers that states it: DEADC, or LIVETIME over ONTIME
/// (OGIP/93-003); 1 if none does.
///
/// # Errors
/// If the fraction is not above 0 and at most 1.
pub fn live_fraction(headers: &[&Header]) -> Result<f64, Problem> {
    for header in headers {
        let times = header.number("LIVETIME")?.zip(header.number("ONTIME")?);
        let (field, found) = match (header.number("DEADC")?, times) {
            (Some(part), _) => ("DEADC", part),
            (None, Some((live, on))) => ("LIVETIME over ONTIME", live / on),
            (None, None) => continue,
        };
        // A quotient of rounded times may slightly exceed 1.
        if !(found > 0.0 && found <= 1.0 + 1e-6) {
            let expected = "live time over good time, above 0 and at most 1";
            return Err(Problem::field(field, expected, found));
        }
        return Ok(found.min(1.0));
    }
    Ok(1.0)
}

pub fn length_s(intervals: &[[f64; 2]]) -> f64 {
    intervals.iter().map(|[start, stop]| stop - start).sum()
}

/// Whether an extension contains good time intervals.
pub fn are_in(hdu: &DiskHdu) -> bool {
    let name = hdu.name().to_ascii_uppercase();
    hdu.is_table && (name == "GTI" || name.starts_with("STDGTI") || hdu.says("HDUCLAS1", "GTI"))
}

impl GoodTimes {
    /// The columns in an extension. Its keywords define how its times are counted, or those of the photons if it has none.
    ///
    /// # Errors
    /// If the table has no START and STOP, or its keywords are invalid.
    pub fn of(hdu: &DiskHdu, primary: &DiskHdu, photons: TimeSystem) -> Result<Self, Problem> {
        let keywords = Keywords {
            own: &hdu.header,
            primary: &primary.header,
        };
        let times = keywords.time_system(photons.scale)?.unwrap_or(photons);
        let end = |name: &str| {
            let column = hdu.column(name)?;
            let times = times.in_unit(&format!("unit of {name}"), column.unit.as_deref())?;
            Ok(End { column, times })
        };
        Ok(Self {
            start: end("START")?,
            stop: end("STOP")?,
        })
    }

    /// Keeps the parts of a table's intervals with a valid pointing. Each part has the row of its interval, whose other columns are unchanged.
    ///
    /// # Errors
    /// If the table cannot be read or written.
    pub fn intersect(
        &self,
        table: &mut AmendedTable,
        valid: &[[f64; 2]],
    ) -> Result<Cut, FileError> {
        let bytes = table.bytes()?;
        let rows = bytes.chunks_exact((table.row_bytes()? as usize).max(1));
        let before = self.intervals(table)?;
        let own = before
            .iter()
            .zip(rows)
            .filter_map(|(interval, row)| Some(((*interval)?, row)));
        let parts: Vec<_> = own
            .flat_map(|(own, row)| common(own, valid).map(move |part| (row, own, part)))
            .collect();
        table.set_rows(parts.len() as u64)?;
        for (n, (row, own, part)) in (1..).zip(&parts) {
            table.put_bytes(n, 0, row)?;
            self.start.put(table, n, part[0], own[0], Inward::Up)?;
            self.stop.put(table, n, part[1], own[1], Inward::Down)?;
        }
        let after = self.intervals(table)?;
        // An interval may be shorter than the resolution of its columns.
        for row in (1..=after.len())
            .rev()
            .filter(|row| after[row - 1].is_none())
        {
            table.delete_row(row as u64)?;
        }
        let before: Vec<[f64; 2]> = before.into_iter().flatten().collect();
        Ok(Cut {
            before_s: length_s(&before),
            left_s: after.into_iter().flatten().collect(),
        })
    }

    /// UTC, s since 1970; `None` for a row without a positive interval.
    fn intervals(&self, table: &mut AmendedTable) -> Result<Vec<Option<[f64; 2]>>, FileError> {
        let [starts, stops] = [self.start.read(table)?, self.stop.read(table)?];
        let interval = |(start, stop): (Option<f64>, Option<f64>)| {
            let [start, stop] = [start?, stop?];
            (stop > start && (stop - start).is_finite()).then_some([start, stop])
        };
        Ok(starts.into_iter().zip(stops).map(interval).collect())
    }
}

impl End {
    /// Times in UTC, s since 1970.
    fn read(&self, table: &mut AmendedTable) -> Result<Vec<Option<f64>>, FileError> {
        let mut times = vec![0.0; table.rows()? as usize];
        table.read(&self.column, 1, &mut times)?;
        let unix_s = |time| self.times.unix_s(time);
        Ok(times.into_iter().map(unix_s).collect())
    }

    /// Writes a time into a row, unless the row has it already.
    fn put(
        &self,
        table: &mut AmendedTable,
        row: u64,
        unix_s: f64,
        own_s: f64,
        inward: Inward,
    ) -> Result<(), FileError> {
        let time = self.times.time(unix_s).filter(|_| unix_s != own_s);
        time.map_or(Ok(()), |time| table.put(&self.column, row, time, inward))
    }
}

/// Intersection of an interval with others, which are in the order of time.
pub fn common(own: [f64; 2], others: &[[f64; 2]]) -> impl Iterator<Item = [f64; 2]> {
    let first = others.partition_point(|[_, end]| *end <= own[0]);
    let within = others[first..]
        .iter()
        .take_while(move |[start, _]| *start < own[1]);
    within.map(move |[start, end]| [start.max(own[0]), end.min(own[1])])
}
