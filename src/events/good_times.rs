//! Good time intervals: when the telescope observed, and its pointing is valid.

use super::times::{Counted, Keywords};
use crate::fits::{DiskFile, DiskHdu, DiskTable, FileError, Inward, NumberColumn, Problem};

/// A table of good time intervals.
pub struct GoodTimes<'a> {
    hdu: &'a DiskHdu,
    pub table: DiskTable,
    start: End,
    stop: End,
}

/// A column of the intervals' ends.
struct End {
    column: NumberColumn,
    counted: Counted,
}

/// Intervals of a table, and how long they are together.
#[derive(Debug, Clone, PartialEq)]
pub struct Intersected {
    /// The new rows of the table.
    pub rows: Vec<u8>,
    pub before_s: f64,
    pub after_s: f64,
}

/// Whether an extension holds good time intervals.
pub fn are_in(hdu: &DiskHdu) -> bool {
    let name = hdu.name().to_ascii_uppercase();
    hdu.is_table() && (name == "GTI" || name.starts_with("STDGTI") || hdu.says("HDUCLAS1", "GTI"))
}

impl<'a> GoodTimes<'a> {
    /// The table in an extension. Its times are counted as its keywords say, or as the photons' where it has none.
    ///
    /// # Errors
    /// A table without START and STOP; keywords that are none.
    pub fn of(hdu: &'a DiskHdu, primary: &DiskHdu, photons: Counted) -> Result<Self, Problem> {
        let keywords = Keywords {
            own: &hdu.header,
            primary: &primary.header,
        };
        let counted = keywords.counted(photons.scale)?.unwrap_or(photons);
        let table = hdu.table()?;
        let end = |name: &str| {
            let column = hdu.column(&table, name)?;
            let counted = counted.in_unit(&format!("unit of {name}"), column.unit.as_deref())?;
            Ok(End { column, counted })
        };
        Ok(Self {
            hdu,
            start: end("START")?,
            stop: end("STOP")?,
            table,
        })
    }

    /// The parts of the intervals in which the pointing is valid. Each part has the row of its interval, whose other columns stay as they are.
    ///
    /// # Errors
    /// A file that cannot be read.
    pub fn intersected(
        &self,
        file: &DiskFile,
        valid: &[[f64; 2]],
    ) -> Result<Intersected, FileError> {
        let all = file.rows(self.hdu, &self.table)?;
        let mut found = Intersected {
            rows: Vec::new(),
            before_s: 0.0,
            after_s: 0.0,
        };
        for row in all.chunks_exact(self.table.row_bytes.max(1)) {
            let Some(own) = self.interval(row) else {
                continue;
            };
            found.before_s += own[1] - own[0];
            for part in common(own, valid) {
                let mut row = row.to_vec();
                self.start.put(part[0], own[0], Inward::Up, &mut row);
                self.stop.put(part[1], own[1], Inward::Down, &mut row);
                if let Some([start, stop]) = self.interval(&row) {
                    found.after_s += stop - start;
                    found.rows.extend(row);
                }
            }
        }
        Ok(found)
    }

    /// UTC, s since 1970; `None` of a row without one that lasts.
    fn interval(&self, row: &[u8]) -> Option<[f64; 2]> {
        let [start, stop] = [self.start.get(row)?, self.stop.get(row)?];
        (stop > start && (stop - start).is_finite()).then_some([start, stop])
    }
}

impl End {
    fn get(&self, row: &[u8]) -> Option<f64> {
        self.counted.unix_s(self.column.get(row)?)
    }

    /// Puts a time into a row, unless it is the one that stands there.
    fn put(&self, unix_s: f64, own_s: f64, inward: Inward, row: &mut [u8]) {
        let time = self.counted.time(unix_s).filter(|_| unix_s != own_s);
        if let Some(time) = time {
            self.column.put(time, inward, row);
        }
    }
}

/// What an interval has in common with others, which are in the order of time.
pub fn common(own: [f64; 2], others: &[[f64; 2]]) -> impl Iterator<Item = [f64; 2]> {
    let first = others.partition_point(|[_, end]| *end <= own[0]);
    let within = others[first..]
        .iter()
        .take_while(move |[start, _]| *start < own[1]);
    within.map(move |[start, end]| [start.max(own[0]), end.min(own[1])])
}
