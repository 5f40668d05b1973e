//! Order of a file's rows in time. A new part begins where the clock jumps; a single row with a different time is rejected.

use crate::tables::{BadRow, Kind, LeftOut};

/// A time farther than this from that of the previous row belongs to another clock, or comes after a gap, s: as in flight.
const NEAR_S: f64 = 1.0;
/// The same in median steps, if these are long.
const NEAR_STEPS: f64 = 10.0;

/// The time of a row.
pub(super) trait Timed {
    fn t_s(&self) -> f64;
}

/// A row of a table with its line.
#[derive(Debug, Clone)]
pub(super) struct Read<T> {
    pub line: u64,
    pub value: T,
}

impl<T: Timed> Read<T> {
    fn t_s(&self) -> f64 {
        self.value.t_s()
    }
}

/// Handling of rows that are earlier than a previous one.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) enum Late {
    LeftOut,
    /// Measurements may be late, by at most so much, s.
    SortedIn(f64),
}

/// The median step between rows, s; `None` if no time increases.
pub(super) fn usual_step_s<T: Timed>(rows: &[Read<T>]) -> Option<f64> {
    let steps = rows.windows(2).map(|pair| pair[1].t_s() - pair[0].t_s());
    let mut steps: Vec<f64> = steps.filter(|step_s| *step_s > 0.0).collect();
    let half = steps.len().checked_sub(1)? / 2;
    let (_, usual_s, _) = steps.select_nth_unstable_by(half, f64::total_cmp);
    Some(*usual_s)
}

/// The rows of a file in parts, in the file's order. Within each part the times increase, except for late measurements.
pub(super) fn parts<T: Timed>(
    rows: Vec<Read<T>>,
    late: Late,
    left_out: &mut LeftOut,
) -> Vec<Vec<Read<T>>> {
    let usual_s = usual_step_s(&rows).unwrap_or(0.0);
    let near_s = (NEAR_STEPS * usual_s).max(NEAR_S);
    let mut steps = rows.windows(2).map(|pair| pair[1].t_s() - pair[0].t_s());
    if !rows.is_empty() && steps.all(|step_s| 0.0 < step_s && step_s <= near_s) {
        // A valid file is not copied.
        return vec![rows];
    }
    let mut sorter = Sorter {
        near_s,
        late,
        parts: Vec::new(),
        newest_s: f64::NEG_INFINITY,
        stray: None,
        left_out,
    };
    rows.into_iter().for_each(|row| sorter.take(row));
    sorter.finish()
}

struct Sorter<'a, T> {
    near_s: f64,
    late: Late,
    parts: Vec<Vec<Read<T>>>,
    /// The latest time of the current part.
    newest_s: f64,
    /// The last row, if its time is far from that of the part: the next one shows whether the clock has jumped.
    stray: Option<Read<T>>,
    left_out: &'a mut LeftOut,
}

impl<T: Timed> Sorter<'_, T> {
    fn take(&mut self, row: Read<T>) {
        if self.parts.is_empty() {
            return self.begin(row);
        }
        let is_near = |t_s: f64| (row.t_s() - t_s).abs() <= self.near_s;
        if is_near(self.newest_s) {
            self.drop_stray();
            return self.append(row);
        }
        let Some(stray) = self.stray.take() else {
            self.stray = Some(row);
            return;
        };
        let goes_on = self.newest_s < stray.t_s() && stray.t_s() < row.t_s();
        if is_near(stray.t_s()) {
            self.drop_first(&stray);
            self.begin(stray);
            self.append(row);
        } else if goes_on {
            // Rows at long intervals.
            self.begin(stray);
            self.stray = Some(row);
        } else {
            self.leave_out_stray(stray);
            self.stray = Some(row);
        }
    }

    fn begin(&mut self, row: Read<T>) {
        self.newest_s = row.t_s();
        self.parts.push(vec![row]);
    }

    fn append(&mut self, row: Read<T>) {
        let newest_s = self.newest_s;
        let is_good = match self.late {
            Late::LeftOut => row.t_s() > newest_s,
            Late::SortedIn(most_s) => row.t_s() >= newest_s - most_s,
        };
        if let (true, Some(part)) = (is_good, self.parts.last_mut()) {
            self.newest_s = newest_s.max(row.t_s());
            return part.push(row);
        }
        let expected = match self.late {
            Late::LeftOut => format!("a time after that of the row before, {newest_s} s"),
            Late::SortedIn(most_s) => {
                format!("a time no more than {most_s} s before {newest_s} s, the latest")
            }
        };
        let kind = match row.t_s() == newest_s {
            true => Kind::Repeated,
            false => Kind::OutOfOrder,
        };
        let bad = BadRow::new(kind, "t_s", expected, row.t_s());
        self.left_out.note(row.line, bad);
    }

    /// Rejects the file's first row if the second one has an earlier time, like any other single row with a different time.
    fn drop_first(&mut self, next: &Read<T>) {
        if let [part] = self.parts.as_slice()
            && part.len() == 1
            && next.t_s() < self.newest_s
            && let Some(first) = self.parts.pop().and_then(|mut part| part.pop())
        {
            self.newest_s = next.t_s();
            self.leave_out_stray(first);
        }
    }

    fn drop_stray(&mut self) {
        if let Some(stray) = self.stray.take() {
            self.leave_out_stray(stray);
        }
    }

    fn leave_out_stray(&mut self, stray: Read<T>) {
        let (near_s, newest_s) = (self.near_s, self.newest_s);
        let expected = format!("a time within {near_s} s of that of the rows before, {newest_s} s");
        let bad = BadRow::new(Kind::Stray, "t_s", expected, stray.t_s());
        self.left_out.note(stray.line, bad);
    }

    fn finish(mut self) -> Vec<Vec<Read<T>>> {
        match self.stray.take() {
            Some(last) if last.t_s() > self.newest_s => self.begin(last),
            Some(last) => self.leave_out_stray(last),
            None => {}
        }
        self.parts
    }
}

/// A part of a file, or the remainder after removing overlaps.
pub(super) struct Part<T> {
    /// Index of its file.
    pub file: usize,
    pub rows: Vec<Read<T>>,
    /// Whether rows were removed because others cover their time.
    pub is_trimmed: bool,
}

/// Parts in the order of time, without overlaps: of two overlapping parts, the longer one is kept whole. Overlaps result
/// from a clock that was set back, and from overlapping files.
pub(super) fn without_overlaps<T: Timed>(
    mut parts: Vec<Part<T>>,
    left_out: &mut [LeftOut],
) -> Vec<Part<T>> {
    let span_s = |part: &Part<T>| {
        let (first, last) = (part.rows.first(), part.rows.last());
        first
            .zip(last)
            .map_or(0.0, |(first, last)| last.t_s() - first.t_s())
    };
    parts.sort_by(|a, b| span_s(b).total_cmp(&span_s(a)));
    let mut kept: Vec<Part<T>> = Vec::new();
    for part in parts {
        let pieces = trimmed(part, &kept, left_out);
        kept.extend(pieces);
        kept.sort_by(|a, b| first_s(a).total_cmp(&first_s(b)));
    }
    kept
}

fn first_s<T: Timed>(part: &Part<T>) -> f64 {
    part.rows.first().map_or(f64::INFINITY, |row| row.t_s())
}

/// The pieces of a part between the kept ones, which are in the order of time.
fn trimmed<T: Timed>(part: Part<T>, kept: &[Part<T>], left_out: &mut [LeftOut]) -> Vec<Part<T>> {
    let ends = |kept: &Part<T>| kept.rows.last().map_or(f64::NEG_INFINITY, |row| row.t_s());
    let (file, length) = (part.file, part.rows.len());
    let last_s = ends(&part);
    let meets = |other: &Part<T>| first_s(other) <= last_s && first_s(&part) <= ends(other);
    if !kept.iter().any(meets) {
        return vec![part];
    }
    let mut pieces: Vec<(usize, Vec<Read<T>>)> = Vec::new();
    for row in part.rows {
        let next = kept.partition_point(|other| ends(other) < row.t_s());
        let other = kept.get(next).filter(|other| first_s(other) <= row.t_s());
        if let Some(other) = other {
            let expected = format!(
                "a time outside {} to {} s, which a longer part of the log covers",
                first_s(other),
                ends(other)
            );
            left_out[file].note(
                row.line,
                BadRow::new(Kind::CoveredTwice, "t_s", expected, row.t_s()),
            );
            continue;
        }
        match pieces.last_mut() {
            Some((before, rows)) if *before == next => rows.push(row),
            _ => pieces.push((next, vec![row])),
        }
    }
    let whole = |rows: &Vec<Read<T>>| rows.len() == length;
    let piece = |(_, rows): (usize, Vec<Read<T>>)| Part {
        file,
        is_trimmed: !whole(&rows),
        rows,
    };
    pieces.into_iter().map(piece).collect()
}
