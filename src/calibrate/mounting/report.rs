//! The calibration as one page of HTML that needs nothing else.

use super::scatter::Residual;
use super::verdict::{Finding, Verdict};
use super::{Mounting, Pointings};
use crate::calibrate::frames::LeftOut;
use crate::calibrate::html;
use crate::calibrate::numbers::sigma_text;
use crate::instrument::Instrument;
use crate::report::html::escaped;
use crate::report::plot::{self, Arrow, Dots, Labels, PlotError};
use std::fmt::Write;

/// The page: verdicts, residuals over time and on the plate, and what was left out.
///
/// # Errors
/// Where a figure cannot be drawn.
pub fn page(
    mounting: &Mounting,
    stated: &Instrument,
    source: &str,
    left_out: &[LeftOut],
) -> Result<String, PlotError> {
    let fit = &mounting.fit;
    let way = match fit.pointings {
        Pointings::Known => "known pointing",
        Pointings::Fixed => "drift scan: the telescope fixed, the Sun crossing",
    };
    let shared = match fit.correlation {
        c if c < 1.05 => String::new(),
        c => format!("; neighbours scatter alike, so variances are taken {c:.1} times as large"),
    };
    let title = format!("Mounting of {}", stated.name);
    let mut text = html::head(&title, &format!("{way}; {source}"));
    text += &format!(
        "<p>{taken} of {all} sights agree, scattering by {scatter:.3} mil ({arcsec:.2} arcsec) rms per axis{shared}.</p>\n",
        taken = fit.accepted(),
        all = fit.residuals.len(),
        scatter = fit.scatter_mil,
        arcsec = fit.scatter_mil * stated.optics.arcsec_per_mil(),
    );
    text += &table(&mounting.findings);
    text += "<h2>Residuals: where the Sun was seen minus where the mounting puts it</h2>\n";
    text += &over_time(&fit.residuals)?;
    text += &on_plate(&fit.residuals)?;
    text += &html::left_out(left_out);
    text += "</html>\n";
    Ok(text)
}

fn table(findings: &[Finding]) -> String {
    let mut rows = String::from(
        "<table><tr><th>quantity</th><th>stated</th><th>found</th><th>1 sigma</th><th>verdict</th></tr>\n",
    );
    for finding in findings {
        let class = match finding.verdict {
            Verdict::Determined => "determined",
            Verdict::Kept => "kept",
        };
        let _ = writeln!(
            rows,
            "<tr><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td class=\"{class}\">{}</td></tr>",
            finding.name,
            values(&finding.stated, finding.unit),
            values(&finding.found, finding.unit),
            if finding.found.is_empty() {
                String::new()
            } else {
                sigma_text(finding.sigma)
            },
            escaped(&finding.remark),
        );
    }
    rows + "</table>\n"
}

fn values(values: &[f64], unit: &str) -> String {
    let numbers: Vec<String> = values.iter().map(|v| format!("{v:.4}")).collect();
    if numbers.is_empty() {
        return String::new();
    }
    format!("{} {unit}", numbers.join(", "))
}

fn over_time(residuals: &[Residual]) -> Result<String, PlotError> {
    let first = residuals.first().map(|r| r.utc);
    let minutes =
        |r: &Residual| first.map_or(0.0, |f| r.utc.duration_since(f).as_secs_f64() / 60.0);
    let along = |name: &str, axis: usize| Dots {
        name: name.into(),
        points: residuals
            .iter()
            .filter(|r| r.accepted)
            .map(|r| (minutes(r), r.off[axis]))
            .collect(),
    };
    let labels = Labels {
        title: "Residuals over time (sights that agree)".into(),
        x: "minutes since the first".into(),
        y: "mil".into(),
    };
    plot::scatter(&labels, &[along("X", 0), along("Y", 1)])
}

fn on_plate(residuals: &[Residual]) -> Result<String, PlotError> {
    let taken: Vec<&Residual> = residuals.iter().filter(|r| r.accepted).collect();
    let reach = taken
        .iter()
        .map(|r| r.at.x.abs().max(r.at.y.abs()))
        .fold(500.0, f64::max);
    let longest = taken.iter().map(|r| r.off.norm()).fold(1e-6, f64::max);
    let magnified = 0.1 * reach / longest;
    const MOST_ARROWS: usize = 150;
    let arrows: Vec<Arrow> = taken
        .iter()
        .step_by(taken.len().div_ceil(MOST_ARROWS).max(1))
        .map(|r| Arrow {
            at: (r.at.x, r.at.y),
            vector: (r.off.x, r.off.y),
        })
        .collect();
    let labels = Labels {
        title: format!("Residuals on the plate, magnified {magnified:.0} times"),
        x: "X, mil".into(),
        y: "Y, mil".into(),
    };
    let range = -1.1 * reach..1.1 * reach;
    plot::vector_map(&labels, range, 0.0, &arrows, magnified, longest)
}
