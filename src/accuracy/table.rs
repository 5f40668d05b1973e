//! The report as text: one table for the terminal, one in Markdown.

use super::demand::HONEST;
use super::outcome::Summary;
use super::program::Case;
use super::report::{MarksReport, Report, RowReport, RunReport};
use super::rows::Size;
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
    "error/bound",
];

/// The cells of a row; `*` marks an error over sigma that is not honest.
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
        bound.map_or("-".into(), |b| format!("{:.2}", b.error_over_bound)),
    ]
}

fn percent(share: Option<f64>) -> String {
    share.map_or("-".into(), |s| format!("{:.1} %", 100.0 * s))
}

/// Three digits after the point where they say something.
fn number(value: Option<f64>) -> String {
    value.map_or("-".into(), |v| {
        let digits = if v < 0.1 { 4 } else { 3 };
        format!("{v:.digits$}")
    })
}

fn over_sigma(found: &Summary) -> String {
    found.over_sigma.map_or("-".into(), |axes| {
        let honest = axes.iter().all(|v| HONEST.contains(v));
        let star = if honest { "" } else { " *" };
        format!("{:.2}, {:.2}{star}", axes[0], axes[1])
    })
}

fn times_ideal(found: &Summary) -> String {
    found.ideal.map_or("-".into(), |ideal| {
        format!("{:.2} +- {:.2}", ideal.ratio, ideal.ratio_sigma)
    })
}

/// The report for a terminal.
pub fn text(report: &Report) -> String {
    let rows: Vec<[String; COLUMNS]> = report.rows.iter().map(cells).collect();
    let mut out = String::new();
    if !rows.is_empty() {
        let width = |c: usize| {
            let cells = rows.iter().map(|row| row[c].chars().count());
            cells.chain([HEAD[c].len()]).max().unwrap_or_default()
        };
        let mut line = |cells: [&str; COLUMNS]| {
            let padded = (0..COLUMNS).map(|c| match c {
                0 | 1 => format!("{:<1$}", cells[c], width(c)),
                _ => format!("{:>1$}", cells[c], width(c)),
            });
            let line = padded.collect::<Vec<_>>().join("  ");
            out.push_str(line.trim_end());
            out.push('\n');
        };
        line(HEAD);
        rows.iter()
            .for_each(|row| line(row.each_ref().map(String::as_str)));
    }
    out.push_str(&beside(report));
    out
}

/// The report as a page of Markdown; `commit` is that of the program.
pub fn markdown(report: &Report, commit: Option<&str>) -> String {
    let size = match report.size {
        Size::Small => "small",
        Size::Full => "full",
    };
    let commit = commit.unwrap_or("unknown");
    let mut out = format!(
        "# Accuracy\n\nCommit {commit}, {size} size. Errors in arcsec: radial, of the Sun's centre on the plate, over the \
         counted frames; the bound per axis.\nSeeds of a row: 0 to one less than its frames.\n\n"
    );
    if !report.rows.is_empty() {
        let line = |cells: [&str; COLUMNS]| format!("| {} |\n", cells.join(" | "));
        out += &line(HEAD);
        out += &line(["---"; COLUMNS]);
        for row in &report.rows {
            out += &line(cells(row).each_ref().map(String::as_str));
        }
    }
    out + &beside(report)
}

/// What stands beside the table in both forms.
fn beside(report: &Report) -> String {
    let mut out = String::new();
    if let Some(marks) = &report.marks {
        out += &marks_text(marks);
    }
    for run in &report.runs {
        out += &run_text(run);
    }
    out += &missed_text(report);
    out += &demands_text(report);
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
    format!(
        "\n{}: {} frames, {} with a usable Sun, of these {} fine and {} coarse; {} of the others solved. Fine: median \
         {} arcsec, error/sigma {x}, {y}.\nWrong ids in {} frames, wrong fine frames {}.\n",
        report.run.title,
        found.frames,
        found.usable,
        found.fine,
        found.coarse,
        found.solved_unusable,
        number(found.median_arcsec),
        found.wrong_ids.len(),
        found.wrong_fine.len(),
    )
}

/// Frames that are named for one reason.
const NAMED: usize = 12;

/// The frames of each row that ought to be fine and are not, by reason.
fn missed_text(report: &Report) -> String {
    let mut out = String::new();
    for row in &report.rows {
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
    }
    if out.is_empty() {
        return out;
    }
    format!("\nThree marks fully lit, and not fine:\n{out}")
}

fn demands_text(report: &Report) -> String {
    let unmet = report.unmet();
    if unmet.is_empty() {
        return "\nEvery demand is met.\n".into();
    }
    let lines = unmet.iter().map(|(name, why)| format!("- {name}: {why}\n"));
    format!("\nNot met:\n{}", lines.collect::<String>())
}

/// One frame: how it was made, what is true, what was found.
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
