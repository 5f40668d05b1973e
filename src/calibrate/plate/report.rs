//! The report of a calibration: one HTML page with its figures inside, a certificate of the plate.

use super::calibration::Calibration;
use super::certificate;
use super::fit::{MeasuredMark, Residual};
use super::summary::used;
use crate::estimation::{MEDIAN_LENGTH_2D, median};
use crate::instrument::Instrument;
use crate::observe::RejectedFrame;
use crate::plate::drawn_position;
use crate::report::html::Page;
use crate::report::plot::{self, Arrow, Cell, Density, Labels, PlotError, Series};
use nalgebra::Vector2;
use std::collections::BTreeMap;

/// The report as one HTML page that needs nothing beside it. `start` is the instrument that the calibration began with,
/// `file_sha256` that of the file it made.
///
/// # Errors
/// A figure that cannot be drawn.
pub fn html(
    calibration: &Calibration,
    start: &Instrument,
    file_sha256: &str,
) -> Result<String, PlotError> {
    let mut page = Page::default();
    certificate::identity(&mut page, calibration, start, file_sha256);
    page.heading("Result");
    page.preformatted(&used(calibration).join("\n"));
    certificate::suspects(&mut page, calibration);
    certificate::poses(&mut page, calibration);
    certificate::correlations(&mut page, &calibration.fit.correlations);
    page.heading("Marks");
    let source = certificate::folders(calibration).join(", ");
    for (figure, caption) in marks(calibration) {
        page.figure(&figure?, &format!("{caption} Frames of {source}."));
    }
    page.heading("Residuals");
    for (figure, caption) in residuals(calibration) {
        page.figure(&figure?, &format!("{caption} Frames of {source}."));
    }
    RejectedFrame::section(&mut page, &calibration.rejected);
    Ok(page.finish(&format!("Plate calibration of {}", start.name)))
}

/// A figure and what it shows.
type Captioned = (Result<String, PlotError>, &'static str);

fn marks(calibration: &Calibration) -> [Captioned; 3] {
    [
        (
            displacements(calibration),
            "Each mark's displacement from the drawing. Shift, rotation and scale common to the measured marks are removed.",
        ),
        (
            coverage(calibration),
            "How many observations of each mark count. Marks without a square were never read.",
        ),
        (
            sigmas(calibration),
            "How well each mark's place is known, the mean of both axes.",
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
            "The same in units of the sigma that each frame states, beside what honest sigmas have.",
        ),
        (
            over_time(calibration),
            "Mean residual of each frame: how far its marks are from where the mapping of its pose puts them. Camera and plate hold still where this is level.",
        ),
    ]
}

/// Half the width of a map, mil.
const PLATE_MIL: f64 = 3700.0;
/// Width of a mark's square.
const CELL_MIL: f64 = 240.0;

fn plate_labels(title: &str) -> Labels {
    Labels::new(title, "plate X, mil", "plate Y, mil")
}

fn plate_map(
    title: &str,
    arrows: impl Iterator<Item = ((f64, f64), Vector2<f64>)>,
) -> Result<String, PlotError> {
    let arrows: Vec<Arrow> = arrows
        .map(|(at, vector)| Arrow {
            at,
            vector: (vector.x, vector.y),
        })
        .collect();
    plot::vector_map(&plate_labels(title), -PLATE_MIL..PLATE_MIL, &arrows, "mil")
}

fn displacements(calibration: &Calibration) -> Result<String, PlotError> {
    let arrows = calibration.fit.marks.iter().map(|mark| {
        let drawn = drawn_position(mark.id);
        ((drawn.x, drawn.y), mark.position.vector() - drawn.vector())
    });
    plate_map("Marks, measured less drawn", arrows)
}

/// A number of each mark.
fn mark_map(
    calibration: &Calibration,
    title: &str,
    unit: &str,
    value: impl Fn(&MeasuredMark) -> f64,
) -> Result<String, PlotError> {
    let cell = |mark: &MeasuredMark| {
        let at = drawn_position(mark.id);
        Cell {
            at: (at.x, at.y),
            value: value(mark),
        }
    };
    let cells: Vec<Cell> = calibration.fit.marks.iter().map(cell).collect();
    let range = -PLATE_MIL..PLATE_MIL;
    plot::scalar_map(&plate_labels(title), range, &cells, CELL_MIL, unit)
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
    let lengths: Vec<f64> = calibration
        .fit
        .kept()
        .map(|r| r.residual_px.norm())
        .collect();
    let labels = Labels::new("Length of the residuals", "px", "observations");
    // By the median: the scatter of most, whatever a few do.
    let sigma = median(&lengths).unwrap_or(0.0) / MEDIAN_LENGTH_2D;
    let rayleigh = Density::Rayleigh { sigma };
    let expected = (sigma > 0.0).then_some(("Rayleigh, of the same median", rayleigh));
    let rms = calibration.fit.residual_px;
    plot::histogram(&labels, &lengths, 40, &[("rms per axis", rms)], expected)
}

fn normalised_lengths(calibration: &Calibration) -> Result<String, PlotError> {
    let normalised = |r: &Residual| r.residual_px.norm() / r.stated_px;
    let lengths: Vec<f64> = calibration.fit.kept().map(normalised).collect();
    let labels = Labels::new("Residuals over their stated sigma", "sigma", "observations");
    let expected = ("Rayleigh, sigma 1", Density::Rayleigh { sigma: 1.0 });
    plot::histogram(&labels, &lengths, 40, &[], Some(expected))
}

fn over_time(calibration: &Calibration) -> Result<String, PlotError> {
    let means = means(calibration.fit.kept().map(|r| (r.frame, r.residual_px)));
    let unix_s = |frame: usize| Some(calibration.frames[frame].utc?.as_nanosecond() as f64 / 1e9);
    let times: Option<Vec<f64>> = means.keys().map(|frame| unix_s(*frame)).collect();
    let title = "Each frame against the mapping of its pose";
    let (labels, x) = match times {
        Some(times) => (Labels::over_utc(title, "mean residual, px"), times),
        // Frames without time count one after the other.
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
