//! The report of a calibration: one HTML page with embedded figures, a certificate of the plate.

use super::calibration::Calibration;
use super::correlations::{Correlation, Parameter};
use super::fit::{MeasuredMark, Residual};
use super::observation::FrameObservation;
use super::summary::used;
use super::suspects::SuspectMark;
use crate::calibrate::numbers::{sigma_text, value_text};
use crate::estimation::{MEDIAN_LENGTH_2D, median};
use crate::observe::RejectedFrame;
use crate::plate::Plate;
use crate::provenance::{COMMIT, PROGRAM};
use crate::report::html::Page;
use crate::report::plot::{self, Arrow, Cell, Density, Labels, MapField, PlotError, Series};
use crate::units::SensorPx;
use nalgebra::Vector2;
use std::collections::{BTreeMap, BTreeSet};

/// The report as one self-contained HTML page. `file_sha256` is that of the instrument's new file.
///
/// # Errors
/// If a figure cannot be drawn.
pub fn html(calibration: &Calibration, file_sha256: &str) -> Result<String, PlotError> {
    let mut page = Page::default();
    identity(&mut page, calibration, file_sha256);
    page.heading("Result");
    page.preformatted(&used(calibration).join("\n"));
    suspects(&mut page, calibration);
    poses(&mut page, calibration);
    correlations(&mut page, &calibration.fit.correlations);
    page.heading("Marks");
    let source = folders(calibration).join(", ");
    for (figure, caption) in marks(calibration) {
        page.figure(&figure?, &format!("{caption} Frames of {source}."));
    }
    page.heading("Residuals");
    for (figure, caption) in residuals(calibration) {
        page.figure(&figure?, &format!("{caption} Frames of {source}."));
    }
    RejectedFrame::section(&mut page, &calibration.rejected);
    Ok(page.finish(&format!("Plate calibration of {}", calibration.start.name)))
}

const UNKNOWN: &str = "not stated";

/// Identity of the calibration: its instrument, files and frames. `file_sha256` is that of the instrument's new file.
fn identity(page: &mut Page, calibration: &Calibration, file_sha256: &str) {
    let start = &calibration.start;
    let time = |utc: Option<jiff::Timestamp>| utc.map_or(UNKNOWN.into(), |utc| utc.to_string());
    let span = calibration.span();
    let frames: usize = calibration.fit.poses.iter().map(|pose| pose.frames).sum();
    let sensor = format!(
        "{} x {} px, {} bits",
        start.camera.width_px, start.camera.height_px, start.camera.bits
    );
    let camera = calibration.camera.clone();
    let rows = [
        ("instrument", start.name.clone()),
        (
            "camera, name and serial number as the frames state them",
            camera.unwrap_or_else(|| UNKNOWN.into()),
        ),
        ("sensor", sensor),
        ("first frame, UTC", time(span.map(|[first, _]| first))),
        ("last frame, UTC", time(span.map(|[_, last]| last))),
        (
            "frames",
            format!("{frames} used, {} rejected", calibration.rejected.len()),
        ),
        ("folders", folders(calibration).join(", ")),
        ("SHA-256 of the drawing", start.plate.drawing_sha256()),
        ("SHA-256 of the frames", calibration.frames_sha256.clone()),
        ("SHA-256 of the new instrument file", file_sha256.into()),
        ("program", PROGRAM.into()),
        ("commit", COMMIT.unwrap_or("not known").into()),
    ];
    page.table(&[], &rows.map(|(name, value)| vec![name.to_owned(), value]));
}

/// The folders of the frames, without repetition.
fn folders(calibration: &Calibration) -> Vec<String> {
    let folders: BTreeSet<_> = calibration.poses.iter().map(|pose| &pose.folder).collect();
    folders
        .iter()
        .map(|folder| folder.display().to_string())
        .collect()
}

fn poses(page: &mut Page, calibration: &Calibration) {
    let heads = [
        "pose",
        "frames",
        "plate's centre, px",
        "1 sigma per axis, px",
        "scale, mil/px",
        "1 sigma",
        "rotation, deg",
        "1 sigma, deg",
    ];
    let poses = calibration.poses.iter().zip(&calibration.fit.poses);
    let rows = poses.enumerate().map(|(n, (pose, fit))| {
        let SensorPx { x, y } = fit.plate_centre_px;
        let (scale, rotation) = (fit.scale_mil_per_px, fit.rotation_deg);
        vec![
            format!("{}: {pose}", n + 1),
            fit.frames.to_string(),
            format!("{x:.3}, {y:.3}"),
            sigma_text(fit.plate_centre_sigma_px),
            value_text(scale),
            sigma_text(scale.sigma),
            value_text(rotation),
            sigma_text(rotation.sigma),
        ]
    });
    page.heading("Poses");
    page.table(&heads, &rows.collect::<Vec<_>>());
}

fn suspects(page: &mut Page, calibration: &Calibration) {
    let suspects = &calibration.suspects;
    page.heading(&format!("Suspect marks: {}", suspects.len()));
    if suspects.is_empty() {
        return page
            .note("Every mark that was lit often enough was identified at its fitted position.");
    }
    let row = |mark: &SuspectMark| {
        let measured = calibration.fit.marks.iter().any(|m| m.id == mark.id);
        let place = if measured {
            "measured"
        } else {
            "kept from the file"
        };
        vec![
            mark.id.to_string(),
            mark.lit.to_string(),
            mark.read.to_string(),
            place.into(),
        ]
    };
    let heads = [
        "mark",
        "frames that lit it",
        "frames that read it",
        "its place",
    ];
    page.table(&heads, &suspects.iter().map(row).collect::<Vec<_>>());
    page.note("Printed elsewhere, or covered: their places are unreliable.");
}

fn correlations(page: &mut Page, correlations: &[Correlation]) {
    page.heading("Correlations");
    let row = |one: &Correlation| {
        let [a, b] = one.between.map(Parameter::name);
        vec![a, b, format!("{:+.3}", one.value)]
    };
    let rows: Vec<_> = correlations.iter().map(row).collect();
    page.table(&["between", "and", "correlation"], &rows);
    page.note(
        "The largest of the fit's covariance with the lens or the poses, then between different marks. Two parameters close to +1 or -1 are \
         separated by their priors more than by the frames.",
    );
}

/// A figure and its caption.
type Captioned = (Result<String, PlotError>, &'static str);

fn marks(calibration: &Calibration) -> [Captioned; 3] {
    [
        (
            displacements(calibration),
            "Each mark's displacement from the drawing. Shift, rotation and scale common to the measured marks are removed.",
        ),
        (
            coverage(calibration),
            "Number of accepted observations of each mark. Marks without a square were never identified.",
        ),
        (
            sigmas(calibration),
            "1 sigma of each mark's position, mean of both axes.",
        ),
    ]
}

fn residuals(calibration: &Calibration) -> [Captioned; 6] {
    [
        (
            residual_map(calibration),
            "The mean residual of each mark over all its observations.",
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
            "Length of the residuals of all observations that count, beside what normal errors of the same scatter have (Rayleigh).",
        ),
        (
            normalised_lengths(calibration),
            "The same in units of the sigma that each frame states, beside the distribution for correct sigmas.",
        ),
        (
            over_time(calibration),
            "Mean residual of each frame: the distance of its marks from the mapping of its pose. A level curve means that camera and plate did not move.",
        ),
    ]
}

/// Half the width of a map of the plate, mil: its marks and a margin about them.
fn map_reach_mil(plate: &Plate) -> f64 {
    /// Factor on the marks' reach.
    const MARGIN: f64 = 1.0876;
    MARGIN * plate.reach_mil()
}

/// Width of a mark's square on a map: close to the spacing of neighbours.
fn cell_mil(plate: &Plate) -> f64 {
    0.55 / plate.density_per_mil2().sqrt()
}

fn plate_labels(title: &str) -> Labels {
    Labels::new(title, "plate X, mil", "plate Y, mil")
}

fn plate_map(
    plate: &Plate,
    title: &str,
    arrows: impl Iterator<Item = ((f64, f64), Vector2<f64>)>,
) -> Result<String, PlotError> {
    let arrows: Vec<Arrow> = arrows
        .map(|(at, vector)| Arrow {
            at,
            vector: (vector.x, vector.y),
        })
        .collect();
    let reach = map_reach_mil(plate);
    plot::vector_map(&plate_labels(title), -reach..reach, &arrows, "mil")
}

fn displacements(calibration: &Calibration) -> Result<String, PlotError> {
    let plate = &calibration.start.plate;
    let arrows = calibration.fit.marks.iter().filter_map(|mark| {
        let drawn = plate.drawn_position(mark.id)?;
        Some(((drawn.x, drawn.y), mark.position.vector() - drawn.vector()))
    });
    plate_map(plate, "Marks, measured less drawn", arrows)
}

/// Map of a value for each mark.
fn mark_map(
    calibration: &Calibration,
    title: &str,
    unit: &str,
    value: impl Fn(&MeasuredMark) -> f64,
) -> Result<String, PlotError> {
    let plate = &calibration.start.plate;
    let cell = |mark: &MeasuredMark| {
        let at = plate.drawn_position(mark.id)?;
        Some(Cell {
            at: (at.x, at.y),
            value: value(mark),
        })
    };
    let cells: Vec<Cell> = calibration.fit.marks.iter().filter_map(cell).collect();
    plot::scalar_map(
        &plate_labels(title),
        &MapField::about_zero(map_reach_mil(plate)),
        &cells,
        cell_mil(plate),
        unit,
    )
}

fn coverage(calibration: &Calibration) -> Result<String, PlotError> {
    let count = |mark: &MeasuredMark| mark.observations as f64;
    mark_map(
        calibration,
        "Observations of each mark",
        "observations",
        count,
    )
}

fn sigmas(calibration: &Calibration) -> Result<String, PlotError> {
    let sigma = |mark: &MeasuredMark| mark.sigma_mil[0].hypot(mark.sigma_mil[1]) / 2_f64.sqrt();
    mark_map(calibration, "1 sigma of each mark per axis", "mil", sigma)
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
    let plate = &calibration.start.plate;
    let arrows = means.into_iter().filter_map(|(id, mean)| {
        let at = plate.drawn_position(id)?;
        Some(((at.x, at.y), mean))
    });
    plate_map(plate, "Mean residual of each mark", arrows)
}

/// Residuals to draw: name and values.
type Kind = (&'static str, fn(&Residual) -> Vector2<f64>);
const BEFORE: Kind = ("drawing, no lens", |r| r.before_px);
const AFTER: Kind = ("calibrated", |r| r.residual_px);

/// The radial residuals against the distance from the sensor's middle.
fn by_radius(calibration: &Calibration, which: &str, kinds: &[Kind]) -> Result<String, PlotError> {
    let series = kinds.iter().map(|(name, residual_px)| {
        let point = |r: &Residual| {
            let from_middle = r.at.vector() - calibration.start.camera.middle_px().vector();
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
    let lengths: Vec<f64> = calibration
        .fit
        .kept()
        .map(|r| r.residual_px.norm())
        .collect();
    let labels = Labels::new("Length of the residuals", "px", "observations");
    // From the median, which a few outliers do not affect.
    let sigma = median(&lengths).unwrap_or(0.0) / MEDIAN_LENGTH_2D;
    let rayleigh = Density::Rayleigh { sigma };
    let expected = (sigma > 0.0).then_some(("Rayleigh, of the same median", rayleigh));
    let rms = calibration.fit.residual_px;
    let lines = [("rms per axis", rms)];
    plot::histogram(&labels, &lengths, 1.0, 40, &lines, expected)
}

fn normalised_lengths(calibration: &Calibration) -> Result<String, PlotError> {
    let normalised = |r: &Residual| r.residual_px.norm() / r.stated_px;
    let lengths: Vec<f64> = calibration.fit.kept().map(normalised).collect();
    let labels = Labels::new("Residuals over their stated sigma", "sigma", "observations");
    let expected = ("Rayleigh, sigma 1", Density::Rayleigh { sigma: 1.0 });
    plot::histogram(&labels, &lengths, 1.0, 40, &[], Some(expected))
}

fn over_time(calibration: &Calibration) -> Result<String, PlotError> {
    let means = means(calibration.fit.kept().map(|r| (r.frame, r.residual_px)));
    let frames: Vec<&FrameObservation> = calibration.frames().collect();
    let unix_s = |frame: usize| Some(frames[frame].utc?.as_nanosecond() as f64 / 1e9);
    let times: Option<Vec<f64>> = means.keys().map(|frame| unix_s(*frame)).collect();
    let title = "Each frame against the mapping of its pose";
    let (labels, x) = match times {
        Some(times) => (Labels::over_utc(title, "mean residual, px"), times),
        // Frames without a time are numbered.
        None => (
            Labels::new(title, "frame", "mean residual, px"),
            means.keys().map(|frame| *frame as f64).collect(),
        ),
    };
    let axis = |name, n: usize| {
        let points = x.iter().zip(means.values()).map(|(x, mean)| (*x, mean[n]));
        Series::dots(name, points)
    };
    plot::series(&labels, &[axis("x", 0), axis("y", 1)])
}
