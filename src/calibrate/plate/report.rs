//! The report of a calibration: one HTML page with its figures inside.

use super::calibration::Calibration;
use super::fit::Residual;
use super::summary::used;
use crate::calibrate::frames::RejectedFrame;
use crate::plate::drawn_position;
use crate::report::html::Page;
use crate::report::plot::{self, Arrow, Labels, PlotError, Series};
use crate::units::SensorPx;
use nalgebra::Vector2;
use std::collections::BTreeMap;

/// The report as one HTML page that needs nothing beside it.
///
/// # Errors
/// A figure that cannot be drawn.
pub fn html(calibration: &Calibration) -> Result<String, PlotError> {
    let mut page = Page::default();
    page.preformatted(&used(calibration).join("\n"));
    poses(&mut page, calibration);
    let figures = [
        (
            displacements(calibration),
            "Each mark's displacement from the drawing. Shift, rotation and scale common to the measured marks are removed.",
        ),
        (
            residual_map(calibration),
            "The mean residual of each mark over all its observations, drawn to the same scale.",
        ),
        (
            by_radius(calibration, "", &[BEFORE, AFTER]),
            "Outward part of every residual against the distance from the sensor's middle: distortion shows as a curve.",
        ),
        (
            by_radius(calibration, ", calibrated", &[AFTER]),
            "The same after the calibration, enlarged: no curve should be left.",
        ),
        (
            lengths(calibration),
            "Length of the residuals of all observations that count, with their root mean square per axis.",
        ),
        (
            normalised_lengths(calibration),
            "The same in units of the sigma that each frame states: the median of two normal axes is 1.18.",
        ),
        (
            over_time(calibration),
            "Mean residual of each frame: how far its marks are from where the mapping of its pose puts them. Camera and plate hold still where this is level.",
        ),
    ];
    page.heading("Marks, residuals, mapping over time");
    for (figure, caption) in figures {
        page.figure(&figure?);
        page.note(caption);
    }
    RejectedFrame::section(&mut page, &calibration.rejected);
    Ok(page.finish("Plate calibration"))
}

fn poses(page: &mut Page, calibration: &Calibration) {
    let heads = [
        "pose",
        "frames",
        "plate's centre, px",
        "sigma, px",
        "scale, mil/px",
        "sigma",
        "rotation, deg",
        "sigma, deg",
    ];
    let poses = calibration.poses.iter().zip(&calibration.fit.poses);
    let rows = poses.map(|(pose, fit)| {
        let SensorPx { x, y } = fit.plate_centre_px;
        let (scale, rotation) = (fit.scale_mil_per_px, fit.rotation_deg);
        vec![
            pose.to_string(),
            fit.frames.to_string(),
            format!("{x:.3}, {y:.3}"),
            format!("{:.4}", fit.plate_centre_sigma_px),
            format!("{:.6}", scale.value),
            format!("{:.6}", scale.sigma),
            format!("{:.5}", rotation.value),
            format!("{:.5}", rotation.sigma),
        ]
    });
    page.heading("Poses");
    page.table(&heads, &rows.collect::<Vec<_>>());
}

fn plate_map(
    title: &str,
    arrows: impl Iterator<Item = ((f64, f64), Vector2<f64>)>,
) -> Result<String, PlotError> {
    /// Half the width of the map, mil.
    const PLATE_MIL: f64 = 3700.0;
    /// Width of a mark's cell.
    const CELL_MIL: f64 = 260.0;
    /// This many mil on the plate show 1 mil.
    const MAGNIFIED: f64 = 130.0;
    let arrows: Vec<Arrow> = arrows
        .map(|(at, vector)| Arrow {
            at,
            vector: (vector.x, vector.y),
        })
        .collect();
    let title = format!("{title} (x {MAGNIFIED:.0}; full shade 3 mil)");
    let labels = Labels::new(title, "plate X, mil", "plate Y, mil");
    let range = -PLATE_MIL..PLATE_MIL;
    plot::vector_map(&labels, range, CELL_MIL, &arrows, MAGNIFIED, 3.0)
}

fn displacements(calibration: &Calibration) -> Result<String, PlotError> {
    let arrows = calibration.fit.marks.iter().map(|mark| {
        let drawn = drawn_position(mark.id);
        ((drawn.x, drawn.y), mark.position.vector() - drawn.vector())
    });
    plate_map("Marks, measured less drawn", arrows)
}

/// The mean of vectors by key.
fn means<K: Ord>(vectors: impl Iterator<Item = (K, Vector2<f64>)>) -> BTreeMap<K, Vector2<f64>> {
    let mut sums: BTreeMap<K, (Vector2<f64>, f64)> = BTreeMap::new();
    for (key, vector) in vectors {
        let (sum, count) = sums.entry(key).or_default();
        *sum += vector;
        *count += 1.0;
    }
    let mean = |(key, (sum, count)): (K, (Vector2<f64>, f64))| (key, sum / count);
    sums.into_iter().map(mean).collect()
}

fn residual_map(calibration: &Calibration) -> Result<String, PlotError> {
    let fit = &calibration.fit;
    let on_plate = |r: &Residual| fit.poses[r.pose].mapping.plate_jacobian(r.at) * r.residual_px;
    let means = means(fit.kept().map(|r| (r.id, on_plate(r))));
    let arrows = means.into_iter().map(|(id, mean)| {
        let at = drawn_position(id);
        ((at.x, at.y), mean)
    });
    plate_map("Mean residual of each mark", arrows)
}

/// Residuals to draw: a name, and which they are.
type Kind = (&'static str, fn(&Residual) -> Vector2<f64>);
const BEFORE: Kind = ("drawing, no lens", |r| r.before_px);
const AFTER: Kind = ("calibrated", |r| r.residual_px);

/// The outward part of residuals over the distance from the sensor's middle.
fn by_radius(calibration: &Calibration, which: &str, kinds: &[Kind]) -> Result<String, PlotError> {
    let series = kinds.iter().map(|(name, residual_px)| {
        let point = |r: &Residual| {
            let from_middle = r.at.vector() - calibration.middle_px.vector();
            let radius = from_middle.norm();
            (radius, residual_px(r).dot(&from_middle) / radius.max(1e-9))
        };
        Series::dots(*name, calibration.fit.kept().map(point))
    });
    let labels = Labels::new(
        format!("Outward residual against radius{which}"),
        "distance from the sensor's middle, px",
        "outward, px",
    );
    plot::series(&labels, &series.collect::<Vec<_>>())
}

fn lengths(calibration: &Calibration) -> Result<String, PlotError> {
    let fit = &calibration.fit;
    let lengths: Vec<f64> = fit.kept().map(|r| r.residual_px.norm()).collect();
    let labels = Labels::new("Length of the residuals", "px", "observations");
    plot::histogram(&labels, &lengths, 40, &[("rms per axis", fit.residual_px)])
}

fn normalised_lengths(calibration: &Calibration) -> Result<String, PlotError> {
    let normalised = |r: &Residual| r.residual_px.norm() / r.stated_px;
    let lengths: Vec<f64> = calibration.fit.kept().map(normalised).collect();
    let labels = Labels::new("Residuals over their stated sigma", "sigma", "observations");
    plot::histogram(&labels, &lengths, 40, &[("median of normal errors", 1.18)])
}

fn over_time(calibration: &Calibration) -> Result<String, PlotError> {
    let kept = calibration.fit.kept();
    let means = means(kept.map(|r| (r.frame, r.residual_px)));
    let times = calibration.frames.iter().filter_map(|frame| frame.utc);
    let first = times.min();
    // Frames without time count one after the other.
    let minutes = |frame: usize| match (calibration.frames[frame].utc, first) {
        (Some(utc), Some(first)) => utc.duration_since(first).as_secs_f64() / 60.0,
        _ => frame as f64,
    };
    let axis = |name, n: usize| {
        let points = means.iter().map(|(frame, mean)| (minutes(*frame), mean[n]));
        Series::dots(name, points)
    };
    let labels = Labels::new(
        "Each frame against the mapping of its pose",
        "minutes since the first frame",
        "mean residual, px",
    );
    plot::series(&labels, &[axis("x", 0), axis("y", 1)])
}
