//! The plots of a flight, drawn as SVG and written as CSV.

use super::history::{HOUSEKEEPING, History, RECEIVED};
use super::table::{Nanoseconds, timestamp};
use super::table::{Table, rows_within};
use crate::estimation::{median, spectrum};
use crate::link::housekeeping::{FIELDS, Field};
use crate::report::plot::{Curve, Figure, Labels, PlotError, Series, Stroke, curves, stack};
use std::fmt::Write;
use std::ops::Range;

/// Maximum number of panels of one drawing.
pub const MOST_FIELDS: usize = 12;
/// Offsets more than so many median steps apart belong to different runs of a spectrum.
const GAP_STEPS: f64 = 1.5;
const SHORTEST_RANGE_NS: i64 = 1_000_000_000;

/// A field by table and name, such as `housekeeping.disk_1`.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct FieldName {
    pub table: String,
    pub name: String,
}

impl FieldName {
    /// Parses a name; `None` if it does not name a table.
    pub fn parse(text: &str) -> Option<Self> {
        let (table, name) = text.rsplit_once('.')?;
        let (table, name) = (table.into(), name.into());
        Some(Self { table, name })
    }
}

/// The values of a field over time: a copy, so that the history is not locked while they are drawn.
pub struct Numbers {
    pub label: String,
    pub unit: String,
    pub points: Vec<(Nanoseconds, f32)>,
}

/// The values of a field within a range of times, with the row before and the row after it. `None` if there is no such
/// field.
pub fn numbers(
    history: &History,
    field: &FieldName,
    range: &Range<Nanoseconds>,
) -> Option<Numbers> {
    if field.table == HOUSEKEEPING {
        let is_it = |known: &&Field| known.name == field.name && known.is_number;
        let known = FIELDS.iter().find(is_it)?;
        let times = &history.housekeeping.times;
        let rows = with_neighbours(rows_within(times, range), times.len());
        let values = history.housekeeping.numbers(rows.clone(), &field.name);
        return Some(Numbers {
            label: known.name.into(),
            unit: known.unit.into(),
            points: times[rows].iter().copied().zip(values).collect(),
        });
    }
    let table = history.tables.get(&field.table)?;
    let column = table
        .columns
        .iter()
        .find(|column| column.name == field.name)?;
    let rows = with_neighbours(rows_within(table.times(), range), table.times().len());
    let values = table.column(&field.name)?;
    let times = table.times()[rows.clone()].iter().copied();
    Some(Numbers {
        label: format!("{}, {}", column.name, table.name),
        unit: column.unit.clone(),
        points: times.zip(values[rows].iter().copied()).collect(),
    })
}

fn with_neighbours(rows: Range<usize>, count: usize) -> Range<usize> {
    rows.start.saturating_sub(1)..(rows.end + 1).min(count)
}

fn seconds(time: Nanoseconds) -> f64 {
    time as f64 / 1e9
}

/// Panels of the fields, one below the other, over a range of times of at least one second.
pub fn panels(fields: Vec<Numbers>, range: &Range<Nanoseconds>) -> String {
    let figure = |field: Numbers| {
        let points = field
            .points
            .into_iter()
            .map(|(time, value)| (seconds(time), value.into()));
        let label = match field.unit.as_str() {
            "" => field.label.clone(),
            unit => format!("{}, {unit}", field.label),
        };
        Figure {
            labels: Labels::over_utc(label, field.unit),
            series: vec![Series::line("", points)],
        }
    };
    let figures: Vec<Figure> = fields.into_iter().map(figure).collect();
    let end = range.end.max(range.start + SHORTEST_RANGE_NS);
    stack(&figures, (seconds(range.start), seconds(end)))
}

/// The table of offsets with the most rows, and the prefix of its columns.
fn offsets(history: &History) -> Option<(&Table, &'static str)> {
    let known = [(RECEIVED, ""), ("solutions", "offset_")];
    let known = known
        .into_iter()
        .filter_map(|(name, prefix)| Some((history.tables.get(name)?, prefix)));
    known.max_by_key(|(table, _)| table.times().len())
}

/// Runs of offsets without gaps, arcsec, in azimuth and in elevation, and the step between them, s.
pub struct OffsetRuns {
    runs: [Vec<Vec<f64>>; 2],
    step_s: f64,
}

/// The offsets within a range of times. `None` if there are none.
pub fn offset_runs(history: &History, range: &Range<Nanoseconds>) -> Option<OffsetRuns> {
    let (table, prefix) = offsets(history)?;
    let rows = rows_within(table.times(), range);
    let times = &table.times()[rows.clone()];
    let column = |name: &str| Some(&table.column(&format!("{prefix}{name}"))?[rows.clone()]);
    let axes = [column("azimuth_deg")?, column("elevation_deg")?];
    let known: Vec<usize> = (0..times.len())
        .filter(|row| axes.iter().all(|axis| axis[*row].is_finite()))
        .collect();
    let steps = known
        .windows(2)
        .map(|pair| seconds(times[pair[1]] - times[pair[0]]));
    let step_s = median(steps).filter(|step| *step > 0.0)?;
    let joined = |a: &usize, b: &usize| seconds(times[*b] - times[*a]) < GAP_STEPS * step_s;
    let runs = |axis: &[f32]| {
        let runs = known.chunk_by(joined);
        let arcsec = |row: &usize| f64::from(axis[*row]) * 3600.0;
        runs.map(|run| run.iter().map(arcsec).collect()).collect()
    };
    Some(OffsetRuns {
        runs: axes.map(runs),
        step_s,
    })
}

/// The spectrum of offsets.
///
/// # Errors
/// If no run is long enough.
pub fn offset_spectrum(offsets: &OffsetRuns) -> Result<String, PlotError> {
    let labels = Labels::new(
        "Spectrum of the offsets",
        "frequency, Hz",
        "density, arcsec^2/Hz",
    );
    let curve = |(runs, name): (&Vec<Vec<f64>>, &str)| {
        Curve::new(name, Stroke::Known, spectrum::density(runs, offsets.step_s))
    };
    let names = ["azimuth", "elevation"];
    curves(
        &labels,
        &offsets
            .runs
            .iter()
            .zip(names)
            .map(curve)
            .collect::<Vec<_>>(),
    )
}

/// The values of fields of one table, one row per time.
pub fn csv(fields: &[Numbers], range: &Range<Nanoseconds>) -> String {
    let mut text = String::from("utc");
    for field in fields {
        let name = field.label.split(',').next().unwrap_or_default();
        let unit = if field.unit.is_empty() {
            String::new()
        } else {
            format!(" [{}]", field.unit)
        };
        let _ = write!(text, ",{name}{unit}");
    }
    text.push('\n');
    let rows = fields.first().map_or(0, |field| field.points.len());
    for row in 0..rows {
        let time = fields[0].points[row].0;
        if !range.contains(&time) {
            continue;
        }
        let _ = write!(text, "{:.3}", timestamp(time));
        for field in fields {
            match field.points[row].1 {
                value if value.is_finite() => _ = write!(text, ",{value}"),
                _ => text.push(','),
            }
        }
        text.push('\n');
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::Duration;

    const SECOND: i64 = 1_000_000_000;

    fn swinging(rows: i64) -> History {
        let mut history = History::new(Duration::from_secs(1 << 30));
        let table = history.tables.get_mut(RECEIVED).unwrap();
        for row in 0..rows {
            let time = 1_379_786_400 * SECOND + row * SECOND / 4;
            let swing = (std::f64::consts::TAU * 0.5 * row as f64 / 4.0).sin() / 3600.0;
            table.push(
                time,
                time,
                &[Some(swing), Some(-swing), None, Some(1e-5), None],
            );
        }
        history
    }

    fn all(history: &History) -> Range<Nanoseconds> {
        let (first, last) = history.span().unwrap();
        first..last + 1
    }

    #[test]
    fn fields_are_named_by_table_and_part() {
        let field = FieldName::parse("roll/solutions.roll_deg").unwrap();
        assert_eq!(
            (field.table.as_str(), field.name.as_str()),
            ("roll/solutions", "roll_deg")
        );
        assert_eq!(
            FieldName::parse("housekeeping.disk_1").unwrap().name,
            "disk_1"
        );
        assert_eq!(FieldName::parse("taken"), None);
        let history = swinging(4);
        let range = all(&history);
        let found =
            |text: &str| numbers(&history, &FieldName::parse(text).unwrap(), &range).is_some();
        assert!(found("received.azimuth_deg") && found("housekeeping.disk_2"));
        assert!(!found("housekeeping.ids") && !found("housekeeping.x") && !found("x.y"));
    }

    #[test]
    fn a_drawing_says_where_its_times_stand() {
        let history = swinging(400);
        let range = all(&history);
        let field = FieldName::parse("received.azimuth_deg").unwrap();
        let panels = panels(vec![numbers(&history, &field, &range).unwrap()], &range);
        assert!(panels.contains("data-left=\"78\"") && panels.contains("azimuth_deg"));
    }

    #[test]
    fn a_swing_of_half_a_hertz_stands_in_the_spectrum() {
        let history = swinging(2000);
        let runs = offset_runs(&history, &all(&history)).unwrap();
        let density = spectrum::density(&runs.runs[0], runs.step_s);
        let peak = density.iter().max_by(|a, b| a.1.total_cmp(&b.1)).unwrap();
        assert!((peak.0 - 0.5).abs() < 0.01, "{peak:?}");
        assert!(offset_spectrum(&runs).unwrap().contains("arcsec^2/Hz"));
    }

    #[test]
    fn a_table_is_written_with_its_units_and_without_what_is_not_known() {
        let history = swinging(2);
        let range = all(&history);
        let field =
            |name: &str| numbers(&history, &FieldName::parse(name).unwrap(), &range).unwrap();
        let text = csv(
            &[field("received.azimuth_deg"), field("received.roll_deg")],
            &range,
        );
        let lines: Vec<&str> = text.lines().collect();
        assert_eq!(lines[0], "utc,azimuth_deg [deg],roll_deg [deg]");
        assert_eq!(lines[1], "2013-09-21T18:00:00.000Z,0,");
    }
}
