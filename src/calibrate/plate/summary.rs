//! The result of a calibration as lines of text.

use super::calibration::{Calibration, StartFrom};
use super::fit::{LENS_PRIOR_PX, PlateFit, PoseFit};
use crate::plate::Plate;
use crate::units::{SensorPx, counted};
use std::collections::BTreeMap;
use std::path::Path;

/// Marks, lens, poses and the rejected frames, a line each.
pub fn summary(calibration: &Calibration) -> String {
    let mut lines = used(calibration);
    let rejected = calibration.rejected.iter();
    lines.extend(rejected.map(|frame| format!("rejected   {frame}")));
    lines.join("\n")
}

/// The lines of [`summary`] without the rejected frames.
pub(super) fn used(calibration: &Calibration) -> Vec<String> {
    /// A factor on the marks' stated sigma above this is reported in a line.
    const NOTABLE: f64 = 1.5;
    /// The same for the rejected part of the observations, and for the scatter of the others relative to their stated sigmas.
    const MOST_DROPPED: f64 = 0.1;
    const MOST_SCATTER: f64 = 2.0;
    let fit = &calibration.fit;
    let used: usize = fit.poses.iter().map(|pose| pose.frames).sum();
    let mut lines = vec![format!(
        "frames     {used} used, {} of them in a later pass; {} rejected; {}",
        calibration.read_later,
        calibration.rejected.len(),
        counted(calibration.poses.len() as u64, "pose")
    )];
    if calibration.start_from == StartFrom::Drawing {
        let line =
            "start      the file rests on these very frames: its marks begin with the drawing";
        lines.push(line.into());
    }
    let found = poses_of_folders(calibration).into_iter();
    lines.extend(found.map(|(path, poses)| {
        format!(
            "found      {}: {}",
            path.display(),
            counted(poses as u64, "pose")
        )
    }));
    lines.push(format!(
        "observed   {} positions of {} marks, {} rejected; residual {:.4} px rms, {:.2} of the stated sigma",
        fit.kept().count(),
        fit.marks.len(),
        fit.residuals.len() - fit.kept().count(),
        fit.residual_px,
        fit.sigma_factor
    ));
    if fit.dropped_share() > MOST_DROPPED {
        lines.push(format!(
            "warning    {:.0} % of the observed positions do not agree with the others: was the camera fixed in each pose?",
            100.0 * fit.dropped_share()
        ));
    }
    if fit.sigma_factor > MOST_SCATTER {
        lines.push(format!(
            "warning    the observed positions scatter {:.1} times as much as the frames state: was the camera fixed, and do the frames state their times?",
            fit.sigma_factor
        ));
    }
    let plate = &calibration.start.plate;
    let (moved, sigma) = displacement_mil(fit, plate);
    lines.push(format!(
        "marks      {moved:.3} mil rms off the drawing, known to {sigma:.3} mil rms; {} never seen keep the place that the file has",
        plate.count() - fit.marks.len()
    ));
    let suspects = calibration.suspects.iter();
    lines.extend(suspects.map(|mark| {
        format!("suspect    {mark}: printed elsewhere, or covered; its place is unreliable")
    }));
    if fit.prior_factor > NOTABLE {
        lines.push(format!(
            "prior      the marks lie {:.1} times as far from where the file has them as their sigmas state: the sigmas are inflated by this factor",
            fit.prior_factor
        ));
    }
    lines.push(format!("lens       {}", lens(fit)));
    let poses = fit.poses.iter().zip(&calibration.poses);
    lines.extend(poses.map(|(pose, name)| {
        format!(
            "pose       {name}: {} frames, {}, plate's centre ({:.3}, {:.3}) px, {:.5} mil/px, {:.4} deg",
            pose.frames,
            fit.choice.kind.name(),
            pose.plate_centre_px.x,
            pose.plate_centre_px.y,
            pose.scale_mil_per_px.value,
            pose.rotation_deg.value
        ) + &drift(pose)
    }));
    lines.push(format!("separation {}", separation(fit)));
    lines
}

fn drift(pose: &PoseFit) -> String {
    pose.drift_px_per_h.map_or(String::new(), |[x, y]| {
        format!(", drifting by ({:.3}, {:.3}) px/h", x.value, y.value)
    })
}

/// The folders with several poses, and their numbers.
fn poses_of_folders(calibration: &Calibration) -> BTreeMap<&Path, usize> {
    let numbered = calibration.poses.iter().filter_map(|pose| {
        let folder = pose.folder.as_path();
        pose.number.map(|number| (folder, number))
    });
    // The last pose number of a folder is the count.
    numbered.collect()
}

/// Root mean square per axis of the marks' displacements, and of their sigmas.
fn displacement_mil(fit: &PlateFit, plate: &Plate) -> (f64, f64) {
    let axes = (2 * fit.marks.len()).max(1) as f64;
    let moved = fit.marks.iter().filter_map(|mark| {
        let off = mark.position.vector() - plate.drawn_position(mark.id)?.vector();
        Some(off.norm_squared())
    });
    let sigmas = fit.marks.iter().flat_map(|mark| mark.sigma_mil);
    let variances = sigmas.map(|sigma| sigma * sigma);
    (
        (moved.sum::<f64>() / axes).sqrt(),
        (variances.sum::<f64>() / axes).sqrt(),
    )
}

fn lens(fit: &PlateFit) -> String {
    let names = ["radial r^2", "radial r^4", "decentring"];
    let terms = names.into_iter().zip(fit.choice.lens);
    let terms: Vec<_> = terms.filter(|t| t.1).map(|t| t.0).collect();
    let sigma = fit.separation.lens_sigma_px;
    if terms.is_empty() {
        return format!("no distortion needed; known to {sigma:.3} px at the corner");
    }
    let corner = SensorPx::new(0.0, 0.0);
    let moved = fit.distortion.distort(corner).distance(corner);
    let terms = terms.join(", ");
    format!("{terms}: {moved:.3} px at the corner, known to {sigma:.3} px")
}

/// Whether the frames separate the plate's errors from the lens's distortion, in words.
fn separation(fit: &PlateFit) -> String {
    let with = fit.separation.lens_sigma_px;
    let without = fit.separation.without_priors_px;
    if fit.separation.by_data() {
        return "the frames separate the plate's errors from the lens's distortion".into();
    }
    format!(
        "the frames do not separate the plate's errors from the lens's distortion (the camera was not moved enough between \
         poses): the split rests on the priors, marks within the file's sigmas and each lens term within \
         {LENS_PRIOR_PX} px at the corner; the lens is known to {with:.3} px there, and to {without:.3} px without these. \
         Shift and turn the camera, and take frames in each pose"
    )
}
