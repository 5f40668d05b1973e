//! The report as text: one table for the terminal, one in Markdown.

use super::chance::relative_sigma_of_rms;
use super::demand::CALIBRATED;
use super::horizon::HorizonReport;
use super::moon::{Knowledge, MoonReport};
use super::outcome::Summary;
use super::program::Case;
use super::report::{MarksReport, Report, RowReport, RunReport};
use super::rows::{HORIZON, MOON, Size};
use std::collections::BTreeMap;
use std::fmt::Write;

const COLUMNS: usize = 13;
const HEAD: [&str; COLUMNS] = [
    "row",
    "condition",
    "frames",
    "fine",
    "counted",
    "median",
    "99.7 %",
    "largest",
    "error/sigma",
    "ideal",
    "x ideal",
    "bound",
    "error/bound (frames)",
];

/// The cells of a row; `*` marks a ratio of error to sigma outside the accepted range.
fn cells(report: &RowReport) -> [String; COLUMNS] {
    let found = &report.summary;
    let bound = found.bound.as_ref();
    [
        report.row.name.into(),
        report.row.title.into(),
        found.frames.to_string(),
        percent(found.fine_share()),
        found.counted.to_string(),
        number(found.median_arcsec),
        number(found.most_arcsec),
        number(found.largest_arcsec),
        over_sigma(found),
        number(found.ideal.map(|i| i.median_arcsec)),
        times_ideal(found),
        number(bound.map(|b| b.median_arcsec)),
        error_over_bound(found),
    ]
}

fn percent(share: Option<f64>) -> String {
    share.map_or("-".into(), |s| format!("{:.1} %", 100.0 * s))
}

/// Three decimals, or four for values below 0.1.
fn number(value: Option<f64>) -> String {
    value.map_or("-".into(), |v| {
        let digits = if v < 0.1 { 4 } else { 3 };
        format!("{v:.digits$}")
    })
}

/// Ratio of error to sigma by axis, with the 1 sigma of either from the number of frames.
fn over_sigma(found: &Summary) -> String {
    let sigma = relative_sigma_of_rms(found.counted);
    let (Some(axes), Some(sigma)) = (found.over_sigma, sigma) else {
        return "-".into();
    };
    let calibrated = axes.iter().all(|v| CALIBRATED.contains(v));
    let star = if calibrated { "" } else { " *" };
    let sigma = sigma * axes[0].max(axes[1]);
    format!("{:.2}, {:.2} +- {sigma:.2}{star}", axes[0], axes[1])
}

/// With its 1 sigma and the number of frames.
fn error_over_bound(found: &Summary) -> String {
    let Some(bound) = &found.bound else {
        return "-".into();
    };
    // Two axes of a frame.
    let sigma = relative_sigma_of_rms(2 * bound.frames).map(|s| s * bound.error_over_bound);
    format!(
        "{:.2} +- {:.2} ({})",
        bound.error_over_bound,
        sigma.unwrap_or(f64::INFINITY),
        bound.frames
    )
}

fn times_ideal(found: &Summary) -> String {
    found.ideal.map_or("-".into(), |ideal| {
        format!("{:.2} +- {:.2}", ideal.ratio, ideal.ratio_sigma)
    })
}

const MOON_COLUMNS: usize = 10;
const MOON_HEAD: [&str; MOON_COLUMNS] = [
    "pictures",
    "known",
    "frames",
    "fine",
    "coarse",
    "across, px",
    "error/sigma",
    "lit off by",
    "lit error/sigma",
    "demanded",
];

/// The cells of a row about the Moon.
fn moon_cells(report: &MoonReport) -> [String; MOON_COLUMNS] {
    let (row, found) = (&report.row, &report.found);
    let demands = row.demands.iter().map(ToString::to_string);
    let is_known = row.known != Knowledge::RadiusAndPhase;
    [
        row.title.clone(),
        row.known.name().into(),
        found.frames.to_string(),
        percent(found.fine_share()),
        found.coarse.to_string(),
        number(found.across_px),
        number(found.over_sigma),
        number(found.lit.filter(|_| is_known)),
        number(found.lit_over_sigma.filter(|_| is_known)),
        demands.collect::<Vec<_>>().join(", "),
    ]
}

const HORIZON_COLUMNS: usize = 10;
const HORIZON_HEAD: [&str; HORIZON_COLUMNS] = [
    "pictures",
    "edge known to, m",
    "frames",
    "fine of those lit",
    "coarse",
    "roll, deg",
    "pitch, deg",
    "mean of pitch",
    "error/sigma",
    "demanded",
];

/// The cells of a row about the horizon.
fn horizon_cells(report: &HorizonReport) -> [String; HORIZON_COLUMNS] {
    let (row, found) = (&report.row, &report.found);
    let demands = row.demands.iter().map(ToString::to_string);
    let degrees = |value: Option<f64>| value.map_or("-".into(), |deg| format!("{deg:.4}"));
    [
        row.title.clone(),
        row.edge_sigma_m.to_string(),
        found.frames.to_string(),
        percent(found.fine_share()),
        found.coarse.to_string(),
        degrees(found.roll_deg),
        degrees(found.pitch_deg),
        degrees(found.pitch_mean_deg),
        number(found.over_sigma),
        demands.collect::<Vec<_>>().join(", "),
    ]
}

/// A table for a terminal; empty if it has no rows.
fn text_table<const N: usize>(head: [&str; N], rows: &[[String; N]]) -> String {
    let mut out = String::new();
    if rows.is_empty() {
        return out;
    }
    let width = |c: usize| {
        let cells = rows.iter().map(|row| row[c].chars().count());
        cells.chain([head[c].len()]).max().unwrap_or_default()
    };
    let mut line = |cells: [&str; N]| {
        let padded = (0..N).map(|c| match c {
            0 | 1 => format!("{:<1$}", cells[c], width(c)),
            _ => format!("{:>1$}", cells[c], width(c)),
        });
        let line = padded.collect::<Vec<_>>().join("  ");
        out.push_str(line.trim_end());
        out.push('\n');
    };
    line(head);
    rows.iter()
        .for_each(|row| line(row.each_ref().map(String::as_str)));
    out
}

/// A table in Markdown; empty if it has no rows.
fn markdown_table<const N: usize>(head: [&str; N], rows: &[[String; N]]) -> String {
    if rows.is_empty() {
        return String::new();
    }
    let line = |cells: &[&str]| format!("| {} |\n", cells.join(" | "));
    let rows = rows
        .iter()
        .map(|cells| line(&cells.each_ref().map(String::as_str)));
    line(&head) + &line(&["---"; N]) + &rows.collect::<String>()
}

/// The report for a terminal.
pub fn text(report: &Report) -> String {
    let rows: Vec<_> = report.rows.iter().map(cells).collect();
    let moons: Vec<_> = report.moons.iter().map(moon_cells).collect();
    let mut out = text_table(HEAD, &rows) + &beside(report) + &missed_text(&report.rows);
    for rows in [&report.plates, &report.designs] {
        let all: Vec<_> = rows.iter().map(cells).collect();
        if !all.is_empty() {
            let gap = if out.is_empty() { "" } else { "\n" };
            out = out + gap + &text_table(HEAD, &all) + &missed_text(rows);
        }
    }
    if !moons.is_empty() {
        out = format!("{out}\n{}", text_table(MOON_HEAD, &moons));
    }
    let horizons: Vec<_> = report.horizons.iter().map(horizon_cells).collect();
    if !horizons.is_empty() {
        out = format!("{out}\n{}", text_table(HORIZON_HEAD, &horizons));
    }
    out + &demands_text(&report.unmet())
}

/// The line before the part of the page that is written by the program.
const BEGIN: &str = "<!-- Written by `solaspect accuracy --out`: from here -->\n";
/// The line after it.
const END: &str = "<!-- to here -->\n";

/// A page of the documentation with a part of the report.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Page {
    Accuracy,
    Plate,
    Design,
    Moon,
    Horizon,
}

impl Page {
    /// The pages with a part of a report.
    pub fn of(report: &Report) -> impl Iterator<Item = Self> {
        let is_of_sun =
            !report.rows.is_empty() || report.marks.is_some() || !report.runs.is_empty();
        let is_of_moon = !report.moons.is_empty();
        let pages = [
            (Self::Accuracy, is_of_sun),
            (Self::Plate, !report.plates.is_empty()),
            (Self::Design, !report.designs.is_empty()),
            (Self::Moon, is_of_moon),
            (Self::Horizon, !report.horizons.is_empty()),
        ];
        (pages.into_iter()).filter_map(|(page, is_known)| is_known.then_some(page))
    }

    /// Its file's name.
    pub fn file(self) -> &'static str {
        match self {
            Self::Accuracy => "accuracy.md",
            Self::Plate => "plate.md",
            Self::Design => "own-plate.md",
            Self::Moon => "moon.md",
            Self::Horizon => "horizon.md",
        }
    }

    fn title(self) -> &'static str {
        match self {
            Self::Accuracy => "Accuracy",
            Self::Plate => "The plate",
            Self::Design => "Your own plate",
            Self::Moon => "The Moon",
            Self::Horizon => "The horizon",
        }
    }

    /// The page with its part of the report inserted: between the two marker lines of the existing page, or on a new page.
    /// `commit` is that of the program. `None` if the page lacks these lines.
    pub fn with(
        self,
        report: &Report,
        commit: Option<&str>,
        before: Option<&str>,
    ) -> Option<String> {
        let empty = || format!("# {}\n\n{BEGIN}{END}", self.title());
        let before = before.map_or_else(empty, str::to_owned);
        let (above, rest) = before.split_once(BEGIN)?;
        let (_, below) = rest.split_once(END)?;
        let size = match report.size {
            Size::Small => "small",
            Size::Full => "full",
        };
        let commit = commit.unwrap_or("unknown");
        let part = self.part(report);
        Some(format!(
            "{above}{BEGIN}\nCommit {commit}, {size} size. Seeds: 0 to one less than the frames.\n\n{part}\n{END}{below}"
        ))
    }

    /// Its part of the report in Markdown.
    fn part(self, report: &Report) -> String {
        let is_of = |rows: &[RowReport], part: &str| rows.iter().any(|r| r.row.name == part);
        let page_of = |part: &str| match part {
            MOON => Self::Moon,
            HORIZON => Self::Horizon,
            part if is_of(&report.plates, part) => Self::Plate,
            part if is_of(&report.designs, part) => Self::Design,
            _ => Self::Accuracy,
        };
        let unmet = report.unmet().into_iter();
        let unmet: Vec<_> = unmet.filter(|(part, _)| page_of(part) == self).collect();
        match self {
            Self::Accuracy => rows_part(&report.rows, &beside(report), &unmet),
            Self::Plate => rows_part(&report.plates, "", &unmet),
            Self::Design => rows_part(&report.designs, "", &unmet),
            Self::Moon => {
                let rows: Vec<_> = report.moons.iter().map(moon_cells).collect();
                markdown_table(MOON_HEAD, &rows) + &demands_text(&unmet)
            }
            Self::Horizon => {
                let rows: Vec<_> = report.horizons.iter().map(horizon_cells).collect();
                markdown_table(HORIZON_HEAD, &rows) + &demands_text(&unmet)
            }
        }
    }
}

/// Rows in Markdown, with the text beside them.
fn rows_part(rows: &[RowReport], beside: &str, unmet: &[(&str, &str)]) -> String {
    let table: Vec<_> = rows.iter().map(cells).collect();
    markdown_table(HEAD, &table)
        + &demanded(rows)
        + beside
        + &missed_text(rows)
        + &demands_text(unmet)
}

/// Requirements of the rows, one a line.
fn demanded(rows: &[RowReport]) -> String {
    let mut out = String::new();
    if rows.is_empty() {
        return out;
    }
    out += "\nDemanded:\n";
    for row in rows.iter().map(|report| &report.row) {
        let demands = row.demands.iter().map(ToString::to_string);
        let demands = demands.collect::<Vec<_>>().join(", ");
        let _ = writeln!(out, "- {}: {demands}", row.name);
    }
    out
}

/// Text beside the table, for both formats.
fn beside(report: &Report) -> String {
    let mut out = String::new();
    if let Some(marks) = &report.marks {
        out += &marks_text(marks);
    }
    for run in &report.runs {
        out += &run_text(run);
    }
    out
}

fn marks_text(report: &MarksReport) -> String {
    let mut out = String::from("\nSingle marks, fully lit, in fine standard frames: ");
    match &report.summary {
        Some(found) => {
            let _ = writeln!(
                out,
                "{} marks, radial error median {:.4} px ({:.3} arcsec), 99.7 % {:.4} px ({:.3} arcsec), error/sigma {:.2}",
                found.marks,
                found.median_px,
                found.median_arcsec,
                found.most_px,
                found.most_arcsec,
                found.over_sigma
            );
        }
        None => out += "none found\n",
    }
    let sigmas = report.bias.cells.iter().map(|cell| cell.sigma_px);
    let _ = writeln!(
        out,
        "Bias over {} sub-pixel phases ({} frames at 1 DN): largest {} px, known to {:.4} px",
        report.bias.cells.len(),
        report.bias.frames,
        number(report.bias.largest_px()),
        sigmas.fold(0.0, f64::max),
    );
    out
}

fn run_text(report: &RunReport) -> String {
    let found = &report.summary;
    let [x, y] = found.over_sigma.map(number);
    let sigma = relative_sigma_of_rms(found.counted);
    let sigma = sigma.and_then(|s| Some(s * found.over_sigma[0]?.max(found.over_sigma[1]?)));
    format!(
        "\n{}: {} frames, {} with a usable Sun, of these {} fine and {} coarse; {} of the others solved. Fine: median \
         {} arcsec, error/sigma {x}, {y} +- {}.\nWrong ids in {}, wrong fine frames {}.\n",
        report.run.title,
        found.frames,
        found.usable,
        found.fine,
        found.coarse,
        found.solved_unusable,
        number(found.median_arcsec),
        number(sigma),
        counted(&found.wrong_ids),
        counted(&found.wrong_fine),
    )
}

/// Number of frames, and the seeds of the first of them.
fn counted(seeds: &[u64]) -> String {
    let named: Vec<String> = seeds.iter().take(NAMED).map(u64::to_string).collect();
    let more = if seeds.len() > NAMED { ", ..." } else { "" };
    match named.len() {
        0 => "none".into(),
        _ => format!("{} (seeds {}{more})", seeds.len(), named.join(", ")),
    }
}

/// Maximum number of frames that are named for one reason.
const NAMED: usize = 12;

/// The frames of each row that should be fine and are not, by reason.
fn missed_text(rows: &[RowReport]) -> String {
    let mut out = String::new();
    for row in rows {
        let mut by_reason: BTreeMap<&str, Vec<String>> = BTreeMap::new();
        for frame in &row.summary.missed {
            let seeds = by_reason.entry(&frame.reason).or_default();
            seeds.push(format!("{} ({})", frame.seed, frame.lit_marks));
        }
        for (reason, seeds) in by_reason {
            let (name, count) = (row.row.name, seeds.len());
            let named = seeds[..count.min(NAMED)].join(", ");
            let more = if count > NAMED { ", ..." } else { "" };
            let _ = writeln!(
                out,
                "- {name}: {reason}: {count} frames, seeds (marks lit) {named}{more}"
            );
        }
        let rivals = row.summary.likeliest_false;
        if rivals > 0 {
            let name = row.row.name;
            let _ = writeln!(
                out,
                "- {name}: a false labelling is the likeliest of {rivals} of these"
            );
        }
    }
    if out.is_empty() {
        return out;
    }
    format!("\nThree marks fully lit, and not fine:\n{out}")
}

fn demands_text(unmet: &[(&str, &str)]) -> String {
    if unmet.is_empty() {
        return "\nEvery demand is met.\n".into();
    }
    let lines = unmet.iter().map(|(name, why)| format!("- {name}: {why}\n"));
    format!("\nNot met:\n{}", lines.collect::<String>())
}

/// One frame: its recipe, truth and solution.
pub fn case_text(case: &Case) -> String {
    let Case {
        recipe, outcome, ..
    } = case;
    let mut out = format!("{recipe:#?}\n\nseed {}\n", outcome.seed);
    let _ = writeln!(
        out,
        "limb on the sensor {:.2}, marks fully lit {}",
        outcome.limb_share, outcome.lit_marks
    );
    if let Some(sun) = case.scene.truth().sun {
        let _ = writeln!(
            out,
            "Sun in truth at {:.6}, {:.6} px, on the plate at {:.6}, {:.6} mil, radius {:.6} px",
            sun.px.x, sun.px.y, sun.plate.x, sun.plate.y, sun.radius_px
        );
    }
    let reason = outcome.reason.as_deref().unwrap_or("no complaint");
    let _ = writeln!(out, "{}: {reason}", outcome.quality.name());
    if let Some(error) = &outcome.aspect {
        let [x, y] = error.over_sigma();
        let _ = writeln!(
            out,
            "aspect off by {:.3} arcsec (X {:+.3}, Y {:+.3} mil; error/sigma {x:+.2}, {y:+.2}), Sun on the sensor by {:.3} px",
            error.radial_arcsec, error.plate_mil.x, error.plate_mil.y, error.sensor_px
        );
    }
    if let Some(bound) = &outcome.bound_mil2 {
        let [x, y] = [0, 1].map(|axis| bound[(axis, axis)].sqrt());
        let _ = writeln!(out, "bound X {x:.3}, Y {y:.3} mil");
    }
    for mark in &outcome.marks {
        let _ = writeln!(
            out,
            "mark {} at {:.2}, {:.2} px off by {:+.4}, {:+.4} px, sigma {:.4}",
            mark.id, mark.true_px.x, mark.true_px.y, mark.px.x, mark.px.y, mark.sigma_px
        );
    }
    for id in &outcome.wrong_ids {
        let _ = writeln!(out, "wrong id {id}");
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::accuracy::horizon_rows::horizon_rows;
    use crate::accuracy::moon_rows::moon_rows;
    use crate::accuracy::outcome::{About, AgainstBound};
    use crate::accuracy::plate_rows::plate_rows;
    use crate::accuracy::rows::{rows, runs};

    /// A report without any part.
    fn nothing() -> Report {
        let nothing = Report {
            size: Size::Small,
            rows: Vec::new(),
            plates: Vec::new(),
            designs: Vec::new(),
            marks: None,
            runs: Vec::new(),
            moons: Vec::new(),
            horizons: Vec::new(),
            sweeps: None,
        };
        assert!(nothing.unmet().is_empty());
        nothing
    }

    #[test]
    fn a_report_replaces_what_stands_between_the_two_lines_and_nothing_else() {
        let before = format!("# A\n\ntext\n{BEGIN}old\n{END}\nmore\n");
        let after = Page::Accuracy
            .with(&nothing(), Some("abc"), Some(&before))
            .unwrap();
        assert!(after.starts_with(&format!("# A\n\ntext\n{BEGIN}\nCommit abc, small size")));
        assert!(after.ends_with(&format!("{END}\nmore\n")));
        assert!(!after.contains("old"));
        let again = Page::Accuracy
            .with(&nothing(), Some("abc"), Some(&after))
            .unwrap();
        assert_eq!(again, after);
        assert_eq!(Page::Moon.with(&nothing(), None, Some("# A\n")), None);
        assert!(
            Page::Accuracy
                .with(&nothing(), None, None)
                .unwrap()
                .starts_with("# Accuracy\n")
        );
    }

    #[test]
    fn the_page_of_accuracy_is_about_the_programs_rows_and_runs() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/docs/accuracy.md");
        let page = std::fs::read_to_string(path).unwrap();
        let advice = "run `solaspect accuracy --full --out docs`";
        let (_, rest) = page.split_once(BEGIN).unwrap();
        let (written, _) = rest.split_once(END).unwrap();
        let found: Vec<&str> = written
            .lines()
            .filter_map(|line| Some(line.strip_prefix("| ")?.split(" | ").next().unwrap_or("")))
            .skip(2)
            .collect();
        let names: Vec<&str> = rows().iter().map(|row| row.name).collect();
        assert_eq!(found, names, "{advice}");
        assert!(
            written.contains(&format!("| {} |", HEAD.join(" | "))),
            "{advice}"
        );
        for row in rows() {
            assert!(
                written.contains(&format!("| {} | {} |", row.name, row.title)),
                "{advice}"
            );
        }
        for run in runs() {
            assert!(written.contains(run.title), "{advice}");
        }
    }

    #[test]
    fn the_page_of_the_plate_is_about_the_programs_rows() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/docs/plate.md");
        let page = std::fs::read_to_string(path).unwrap();
        let advice = "run `solaspect accuracy --full --only plates --out docs`";
        for row in plate_rows() {
            let begin = format!("| {} | {} |", row.name, row.title);
            assert!(page.contains(&begin), "{begin}: {advice}");
        }
    }

    #[test]
    fn the_page_of_the_moon_is_about_the_programs_rows() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/docs/moon.md");
        let page = std::fs::read_to_string(path).unwrap();
        let advice = "run `solaspect accuracy --full --only moon --out docs`";
        assert!(
            page.contains(&format!("| {} |", MOON_HEAD.join(" | "))),
            "{advice}"
        );
        for row in moon_rows() {
            let begin = format!("| {} | {} |", row.title, row.known.name());
            assert!(page.contains(&begin), "{begin}: {advice}");
        }
    }

    #[test]
    fn the_page_of_the_horizon_is_about_the_programs_rows() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/docs/horizon.md");
        let page = std::fs::read_to_string(path).unwrap();
        let advice = "run `solaspect accuracy --full --only horizon --out docs`";
        assert!(
            page.contains(&format!("| {} |", HORIZON_HEAD.join(" | "))),
            "{advice}"
        );
        for row in horizon_rows() {
            let begin = format!("| {} | {} |", row.title, row.edge_sigma_m);
            assert!(page.contains(&begin), "{begin}: {advice}");
        }
    }

    #[test]
    fn errors_over_sigma_and_bound_come_with_their_uncertainty_and_count() {
        let found = Summary {
            counted: 50,
            over_sigma: Some([1.0, 1.2]),
            bound: Some(AgainstBound {
                frames: 12,
                median_arcsec: 0.08,
                error_over_bound: 0.9,
            }),
            ..Summary::of(&[], About::Fine, 2.0)
        };
        assert_eq!(over_sigma(&found), "1.00, 1.20 +- 0.12");
        assert_eq!(error_over_bound(&found), "0.90 +- 0.13 (12)");
    }
}
