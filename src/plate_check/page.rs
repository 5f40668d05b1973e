//! The check of a plate as lines of text and as an HTML page.

use super::{CheckSummary, CheckedPlace, PlateCheck, Rotations};
use crate::provenance::{COMMIT, PROGRAM};
use crate::report::html::Page;
use crate::report::plot::{self, Cell, Labels, MapField, PlotError};
use serde::Serialize;
use std::fmt;

/// A quantity of a place.
type NumberOf = fn(&CheckedPlace) -> Option<f64>;

/// Lines of text.
impl fmt::Display for PlateCheck {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (count, field) = (self.places.len(), self.field_radius_mil);
        let summary = self.summary();
        writeln!(
            out,
            "plate      {:?}: {} marks, {}",
            self.instrument, self.marks, self.shape
        )?;
        let turned = match self.rotations {
            Rotations::Stated => "within its stated sigma",
            Rotations::Any => "anyhow",
        };
        writeln!(
            out,
            "field      {count} places within {field:.0} mil, camera turned {turned}"
        )?;
        if let Some(misfit) = &self.misfit {
            writeln!(out, "lens       {misfit}")?;
        }
        for (verdict, found) in &summary.places {
            let share = 100.0 * *found as f64 / count.max(1) as f64;
            writeln!(
                out,
                "{found:>6} places, {share:5.1} %: {}",
                verdict.meaning()
            )?;
        }
        let number = |value: Option<f64>, unit: &str| match value {
            Some(value) => format!("{value:.3}{unit}"),
            None => "none".into(),
        };
        let fewest = summary.fewest_lit.unwrap_or(0);
        let free = 100.0 * summary.least_limb_free.unwrap_or(0.0);
        writeln!(
            out,
            "fewest     {fewest} marks fully lit; at least {free:.0} % of the limb free of marks"
        )?;
        writeln!(
            out,
            "odds       at least {} beyond what the flight asks (logarithm)",
            number(summary.least_margin, "")
        )?;
        if let Some(read) = summary.read_among_clutter {
            let read = 100.0 * read;
            writeln!(
                out,
                "clutter    {read:.2} % still read with marks missed and false ones found as often as the flight expects"
            )?;
        }
        write!(
            out,
            "sigma      {}, median {} and at most {} by noise, at most {} by misprints",
            number(summary.least_sigma_mil, ""),
            number(summary.median_sigma_mil, ""),
            number(summary.most_sigma_mil, " mil"),
            number(summary.most_misprint_mil, " mil")
        )
    }
}

/// The check as JSON: its summary and all places.
///
/// # Errors
/// If a number cannot be represented in JSON.
pub fn json(check: &PlateCheck) -> serde_json::Result<String> {
    #[derive(Serialize)]
    struct Whole<'a> {
        summary: CheckSummary,
        #[serde(flatten)]
        check: &'a PlateCheck,
    }
    let summary = check.summary();
    serde_json::to_string_pretty(&Whole { summary, check })
}

/// The check as a self-contained HTML page.
///
/// # Errors
/// If a figure cannot be drawn.
pub fn html(check: &PlateCheck) -> Result<String, PlotError> {
    let mut page = Page::default();
    let verdict = match check.passes() {
        true => "The plate passes: frames can be read all over its field.",
        false => "The plate fails: in part of its field frames cannot be read.",
    };
    page.note(verdict);
    page.preformatted(&check.to_string());
    let rows = [
        ("program", PROGRAM.to_owned()),
        ("commit", COMMIT.unwrap_or("not known").into()),
    ];
    page.table(&[], &rows.map(|(name, value)| vec![name.to_owned(), value]));
    page.heading("Over the field");
    let maps: [(&str, &str, NumberOf); 4] = [
        ("Marks fully lit", "marks", |p| Some(p.lit as f64)),
        ("Odds beyond what the flight asks, logarithm", "", |p| {
            p.margin
        }),
        ("Sigma by noise", "mil", |p| p.sigma_mil),
        ("Sigma by misprints", "mil", |p| p.misprint_mil),
    ];
    for (title, unit, of) in maps {
        if let Some(figure) = map(check, title, unit, of)? {
            page.figure(
                &figure,
                &format!("{title}, by the place of the Sun's centre on the plate."),
            );
        }
    }
    Ok(page.finish(&format!("Plate of {}", check.instrument)))
}

/// A map of a quantity over the places; `None` if no place has it.
fn map(
    check: &PlateCheck,
    title: &str,
    unit: &str,
    of: NumberOf,
) -> Result<Option<String>, PlotError> {
    let cell = |place: &CheckedPlace| {
        Some(Cell {
            at: (place.x_mil, place.y_mil),
            value: of(place)?,
        })
    };
    let cells: Vec<Cell> = check.places.iter().filter_map(cell).collect();
    if cells.is_empty() {
        return Ok(None);
    }
    let reach = 1.05 * check.field_radius_mil;
    // Cell size equal to the spacing of the places.
    let side = check.field_radius_mil * (std::f64::consts::PI / check.places.len() as f64).sqrt();
    let labels = Labels::new(title, "plate X, mil", "plate Y, mil");
    plot::scalar_map(&labels, &MapField::about_zero(reach), &cells, side, unit).map(Some)
}
