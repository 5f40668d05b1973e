//! The page's first part: what was measured, by which program, from which frames, and what is not to be relied on.

use super::calibration::Calibration;
use super::correlations::Correlation;
use crate::calibrate::numbers::{sigma_text, value_text};
use crate::instrument::Instrument;
use crate::provenance::{COMMIT, PROGRAM};
use crate::report::html::Page;
use crate::units::SensorPx;
use std::collections::BTreeSet;

const UNKNOWN: &str = "not stated";

/// What the calibration is of and rests on. `file_sha256` is that of the instrument's new file.
pub(super) fn identity(
    page: &mut Page,
    calibration: &Calibration,
    start: &Instrument,
    file_sha256: &str,
) {
    let time = |utc: Option<jiff::Timestamp>| utc.map_or(UNKNOWN.into(), |utc| utc.to_string());
    let times = || calibration.frames.iter().filter_map(|frame| frame.utc);
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
        ("first frame, UTC", time(times().min())),
        ("last frame, UTC", time(calibration.last)),
        (
            "frames",
            format!("{frames} used, {} rejected", calibration.rejected.len()),
        ),
        ("folders", folders(calibration).join(", ")),
        ("SHA-256 of the frames", calibration.frames_sha256.clone()),
        ("SHA-256 of the new instrument file", file_sha256.into()),
        ("program", PROGRAM.into()),
        ("commit", COMMIT.unwrap_or("not known").into()),
    ];
    page.table(&[], &rows.map(|(name, value)| vec![name.to_owned(), value]));
}

/// The folders of the frames, each once.
pub(super) fn folders(calibration: &Calibration) -> Vec<String> {
    let folders: BTreeSet<_> = calibration.poses.iter().map(|pose| &pose.folder).collect();
    folders
        .iter()
        .map(|folder| folder.display().to_string())
        .collect()
}

pub(super) fn poses(page: &mut Page, calibration: &Calibration) {
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

pub(super) fn suspects(page: &mut Page, calibration: &Calibration) {
    let suspects = &calibration.suspects;
    page.heading(&format!("Suspect marks: {}", suspects.len()));
    if suspects.is_empty() {
        return page.note("Every mark that was lit often enough was read where the fit has it.");
    }
    let row = |mark: &super::SuspectMark| {
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
    page.note("Printed elsewhere, or covered: their places are not to be relied on.");
}

pub(super) fn correlations(page: &mut Page, correlations: &[Correlation]) {
    page.heading("Correlations");
    let row = |one: &Correlation| {
        let [a, b] = one.between.map(super::Parameter::name);
        vec![a, b, format!("{:+.3}", one.value)]
    };
    let rows: Vec<_> = correlations.iter().map(row).collect();
    page.table(&["between", "and", "correlation"], &rows);
    page.note(
        "The largest of the fit's covariance with the lens or the poses, then between different marks. Two parameters close to +1 or -1 are \
         told apart by their priors more than by the frames.",
    );
}
