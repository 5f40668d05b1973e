//! The report of a calibration: one HTML page with its figures inside.

use super::{Calibration, Residual, summary};
use crate::plate::drawn_position;
use crate::report::html::escaped;
use crate::report::plot::{self, Arrow, Dots, Labels, PlotError};
use crate::units::SensorPx;
use nalgebra::Vector2;
use std::collections::BTreeMap;
use std::fmt::Write;

/// Half the width of the plate's maps, mil.
const PLATE_MIL: f64 = 3700.0;
/// Width of a mark's cell in the plate's maps.
const CELL_MIL: f64 = 260.0;
/// Arrows are magnified so much that this many mil on the plate show 1 mil of displacement.
const MAGNIFIED: f64 = 130.0;

const STYLE: &str = "body{font:15px/1.5 sans-serif;max-width:1240px;margin:2em auto;padding:0 1em;color:#222}\
    h1{font-size:1.5em}h2{font-size:1.15em;margin-top:2em}pre{background:#f5f5f5;padding:1em;overflow-x:auto;white-space:pre-wrap}\
    figure{display:inline-block;width:590px;margin:.5em 0;vertical-align:top}figcaption{padding:0 2em;color:#555;font-size:.9em}\
    svg{width:100%;height:auto}table{border-collapse:collapse}td,th{padding:.2em .8em;text-align:right;border-bottom:1px solid #ddd}";

/// The report as one HTML page that needs nothing beside it.
pub fn html(calibration: &Calibration) -> Result<String, PlotError> {
    let mut page = String::new();
    // Writing to a string cannot fail.
    let _ = write!(
        page,
        "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>Plate calibration</title>\
         <style>{STYLE}</style></head><body>\n<h1>Plate calibration</h1>\n<pre>{}</pre>\n",
        escaped(&used_only(&summary(calibration)))
    );
    page.push_str(&poses(calibration));
    page.push_str("<h2>Before and after</h2>\n");
    figure(
        &mut page,
        displacements(calibration)?,
        "What the drawing does not know: where each mark was found, less where it was drawn. Shift, rotation and scale common to the measured marks are removed.",
    );
    figure(
        &mut page,
        residual_map(calibration)?,
        "What is left: the mean residual of each mark over all its sightings, drawn to the same scale.",
    );
    figure(
        &mut page,
        by_radius(calibration)?,
        "Outward part of every residual against the distance from the sensor's middle: distortion shows as a curve.",
    );
    figure(
        &mut page,
        after_by_radius(calibration)?,
        "The same after the calibration, enlarged: no curve should be left.",
    );
    page.push_str("<h2>Residuals</h2>\n");
    figure(
        &mut page,
        histogram(calibration)?,
        "Length of the residuals of all sightings that count, with their root mean square per axis.",
    );
    figure(
        &mut page,
        pulls(calibration)?,
        "The same in units of the sigma that each frame states: the median of two normal axes is 1.18.",
    );
    page.push_str("<h2>Mapping over time</h2>\n");
    figure(
        &mut page,
        over_time(calibration)?,
        "Mean residual of each frame: how far its marks stand from where the mapping of its pose puts them. Camera and plate hold still where this is level.",
    );
    page.push_str(&not_used(calibration));
    page.push_str("</body></html>\n");
    Ok(page)
}

fn figure(page: &mut String, svg: String, caption: &str) {
    let _ = writeln!(
        page,
        "<figure>{svg}<figcaption>{caption}</figcaption></figure>"
    );
}

/// Without the list of what was not used: the page has its own.
fn used_only(summary: &str) -> String {
    let lines = summary.lines().filter(|line| !line.starts_with("not used"));
    lines.fold(String::new(), |text, line| text + line + "\n")
}

fn labels(title: &str, x: &str, y: &str) -> Labels {
    Labels {
        title: title.into(),
        x: x.into(),
        y: y.into(),
    }
}

fn kept(calibration: &Calibration) -> impl Iterator<Item = &Residual> {
    calibration.fit.residuals.iter().filter(|r| r.kept)
}

fn plate_map(title: &str, arrows: &[Arrow]) -> Result<String, PlotError> {
    let title = format!("{title} (x {MAGNIFIED:.0}; full shade 3 mil)");
    let labels = labels(&title, "plate X, mil", "plate Y, mil");
    plot::vector_map(
        &labels,
        -PLATE_MIL..PLATE_MIL,
        CELL_MIL,
        arrows,
        MAGNIFIED,
        3.0,
    )
}

fn displacements(calibration: &Calibration) -> Result<String, PlotError> {
    let arrow = |mark: &super::MeasuredMark| {
        let drawn = drawn_position(mark.id);
        Arrow {
            at: (drawn.x, drawn.y),
            vector: (mark.position.x - drawn.x, mark.position.y - drawn.y),
        }
    };
    let arrows: Vec<Arrow> = calibration.fit.marks.iter().map(arrow).collect();
    plate_map("Marks, measured less drawn", &arrows)
}

fn residual_map(calibration: &Calibration) -> Result<String, PlotError> {
    let mut sums: BTreeMap<_, (Vector2<f64>, f64)> = BTreeMap::new();
    for r in kept(calibration) {
        let back = calibration.fit.poses[r.pose].mapping.plate_jacobian(r.at);
        let sum = sums.entry(r.id).or_insert((Vector2::zeros(), 0.0));
        sum.0 += back * r.miss;
        sum.1 += 1.0;
    }
    let arrow = |(id, (sum, count)): (_, (Vector2<f64>, f64))| {
        let at = drawn_position(id);
        Arrow {
            at: (at.x, at.y),
            vector: (sum.x / count, sum.y / count),
        }
    };
    let arrows: Vec<Arrow> = sums.into_iter().map(arrow).collect();
    plate_map("Mean residual of each mark", &arrows)
}

/// Distance from the sensor's middle and outward part of a residual.
fn outward(calibration: &Calibration, residual: &Residual, miss: Vector2<f64>) -> (f64, f64) {
    let from_middle = residual.at.vector() - calibration.middle_px.vector();
    let radius = from_middle.norm();
    (radius, miss.dot(&from_middle) / radius.max(1e-9))
}

fn by_radius(calibration: &Calibration) -> Result<String, PlotError> {
    let dots = |name: &str, miss: fn(&Residual) -> Vector2<f64>| Dots {
        name: name.into(),
        points: kept(calibration)
            .map(|r| outward(calibration, r, miss(r)))
            .collect(),
    };
    let series = [
        dots("drawing, no lens", |r| r.before),
        dots("calibrated", |r| r.miss),
    ];
    let title = "Outward residual against radius";
    plot::scatter(
        &labels(
            title,
            "distance from the sensor's middle, px",
            "outward, px",
        ),
        &series,
    )
}

fn after_by_radius(calibration: &Calibration) -> Result<String, PlotError> {
    let points = kept(calibration)
        .map(|r| outward(calibration, r, r.miss))
        .collect();
    let dots = Dots {
        name: "calibrated".into(),
        points,
    };
    let title = "Outward residual against radius, calibrated";
    plot::scatter(
        &labels(
            title,
            "distance from the sensor's middle, px",
            "outward, px",
        ),
        &[dots],
    )
}

fn histogram(calibration: &Calibration) -> Result<String, PlotError> {
    let lengths: Vec<f64> = kept(calibration).map(|r| r.miss.norm()).collect();
    let lines = [("rms per axis", calibration.fit.residual_px)];
    plot::histogram(
        &labels("Length of the residuals", "px", "sightings"),
        &lengths,
        40,
        &lines,
    )
}

fn pulls(calibration: &Calibration) -> Result<String, PlotError> {
    let lengths: Vec<f64> = kept(calibration)
        .map(|r| r.miss.norm() / r.stated_px)
        .collect();
    let lines = [("median of normal errors", 1.18)];
    plot::histogram(
        &labels("Residuals over their stated sigma", "sigma", "sightings"),
        &lengths,
        40,
        &lines,
    )
}

fn over_time(calibration: &Calibration) -> Result<String, PlotError> {
    let mut sums: BTreeMap<usize, (Vector2<f64>, f64)> = BTreeMap::new();
    for r in kept(calibration) {
        let sum = sums.entry(r.frame).or_insert((Vector2::zeros(), 0.0));
        sum.0 += r.miss;
        sum.1 += 1.0;
    }
    let first = calibration
        .frames
        .iter()
        .filter_map(|frame| frame.utc)
        .min();
    // Frames without time count one after the other.
    let minutes = |frame: usize| match (calibration.frames[frame].utc, first) {
        (Some(utc), Some(first)) => utc.duration_since(first).as_secs_f64() / 60.0,
        _ => frame as f64,
    };
    let dots = |name: &str, axis: usize| Dots {
        name: name.into(),
        points: sums
            .iter()
            .map(|(n, (sum, count))| (minutes(*n), sum[axis] / count))
            .collect(),
    };
    let labels = labels(
        "Each frame against the mapping of its pose",
        "minutes since the first frame",
        "mean residual, px",
    );
    plot::scatter(&labels, &[dots("x", 0), dots("y", 1)])
}

fn poses(calibration: &Calibration) -> String {
    let mut table = String::from(
        "<h2>Poses</h2>\n<table><tr><th>pose</th><th>frames</th><th>plate's centre, px</th><th>sigma, px</th>\
         <th>scale, mil/px</th><th>sigma</th><th>rotation, deg</th><th>sigma, deg</th></tr>\n",
    );
    for (pose, fit) in calibration.poses.iter().zip(&calibration.fit.poses) {
        let SensorPx { x, y } = fit.plate_centre_px;
        let (scale, rotation) = (fit.scale_mil_per_px, fit.rotation_deg);
        let _ = writeln!(
            table,
            "<tr><td>{}</td><td>{}</td><td>{x:.3}, {y:.3}</td><td>{:.4}</td><td>{:.6}</td><td>{:.6}</td><td>{:.5}</td><td>{:.5}</td></tr>",
            escaped(&pose.to_string()),
            fit.frames,
            fit.plate_centre_sigma_px,
            scale.value,
            scale.sigma,
            rotation.value,
            rotation.sigma
        );
    }
    table + "</table>\n"
}

fn not_used(calibration: &Calibration) -> String {
    if calibration.spoiled.is_empty() {
        return String::new();
    }
    let mut list = String::from("<h2>Frames that were not used</h2>\n<ul>\n");
    for spoiled in &calibration.spoiled {
        let text = format!("{}: {}", spoiled.file.display(), spoiled.reason);
        let _ = writeln!(list, "<li>{}</li>", escaped(&text));
    }
    list + "</ul>\n"
}
