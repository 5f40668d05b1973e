//! What came of a calibration, in words.

use super::{Calibration, LENS_PRIOR_PX, PlateFit};
use crate::plate::{MarkId, drawn_position};
use crate::units::SensorPx;
use std::collections::BTreeMap;
use std::fmt::Write;
use std::path::Path;

/// A drawing's sigma that is off by so much is worth a line.
const NOTABLE: f64 = 1.5;

/// Marks, lens, poses and the frames that were not used, as lines of text.
pub fn summary(calibration: &Calibration) -> String {
    let mut text = String::new();
    // Writing to a string cannot fail.
    let _ = write(calibration, &mut text);
    text
}

fn write(calibration: &Calibration, out: &mut String) -> std::fmt::Result {
    let fit = &calibration.fit;
    let used: usize = fit.poses.iter().map(|pose| pose.frames).sum();
    let kept = fit.residuals.iter().filter(|r| r.kept).count();
    writeln!(
        out,
        "frames     {used} used, {} of them read at a second look; {} not used; {} poses",
        calibration.read_later,
        calibration.spoiled.len(),
        calibration.poses.len()
    )?;
    for (folder, poses) in found(calibration) {
        writeln!(out, "found      {}: {poses} poses", folder.display())?;
    }
    writeln!(
        out,
        "sightings  {kept} of {} marks, {} left out; residual {:.4} px rms, {:.2} of what the frames state",
        fit.marks.len(),
        fit.residuals.len() - kept,
        fit.residual_px,
        fit.sigma_factor
    )?;
    let (moved, sigma) = displacement_mil(fit);
    writeln!(
        out,
        "marks      {moved:.3} mil rms off the drawing, known to {sigma:.3} mil rms; {} never seen keep the drawing's place",
        MarkId::all().count() - fit.marks.len()
    )?;
    if fit.drawing_factor > NOTABLE {
        writeln!(
            out,
            "drawing    the marks lie {:.1} times as far from it as its sigma states; so much of it is believed",
            fit.drawing_factor
        )?;
    }
    writeln!(out, "lens       {}", lens(fit))?;
    for (pose, name) in fit.poses.iter().zip(&calibration.poses) {
        writeln!(
            out,
            "pose       {name}: {} frames, {}, plate's centre ({:.3}, {:.3}) px, {:.5} mil/px, {:.4} deg",
            pose.frames,
            fit.choice.kind.name(),
            pose.plate_centre_px.x,
            pose.plate_centre_px.y,
            pose.scale_mil_per_px.value,
            pose.rotation_deg.value
        )?;
    }
    writeln!(out, "apart      {}", separation(fit))?;
    for spoiled in &calibration.spoiled {
        writeln!(
            out,
            "not used   {}: {}",
            spoiled.file.display(),
            spoiled.reason
        )?;
    }
    Ok(())
}

/// The folders that hold several poses, and how many.
fn found(calibration: &Calibration) -> BTreeMap<&Path, usize> {
    let numbered = calibration.poses.iter().filter_map(|pose| {
        let folder = pose.folder.as_path();
        pose.number.map(|number| (folder, number))
    });
    // The last number of a folder is the count.
    numbered.collect()
}

/// Root mean square per axis of the marks' displacements, and of their sigmas.
pub(super) fn displacement_mil(fit: &PlateFit) -> (f64, f64) {
    let axes = (2 * fit.marks.len()).max(1) as f64;
    let moved = fit.marks.iter().map(|mark| {
        let off = mark.position.vector() - drawn_position(mark.id).vector();
        off.norm_squared()
    });
    let sigma = fit
        .marks
        .iter()
        .flat_map(|mark| mark.sigma_mil.map(|s| s * s));
    (
        (moved.sum::<f64>() / axes).sqrt(),
        (sigma.sum::<f64>() / axes).sqrt(),
    )
}

fn lens(fit: &PlateFit) -> String {
    let names = ["radial r^2", "radial r^4", "decentring", ""];
    let terms: Vec<_> = (0..3)
        .filter(|n| fit.choice.lens[*n])
        .map(|n| names[n])
        .collect();
    if terms.is_empty() {
        let sigma = fit.separation.lens_sigma_px;
        return format!("no distortion called for; known to {sigma:.3} px at the corner");
    }
    let corner = SensorPx::new(0.0, 0.0);
    let moved = fit.distortion.distort(corner).distance(corner);
    format!(
        "{}: {moved:.3} px at the corner, known to {:.3} px",
        terms.join(", "),
        fit.separation.lens_sigma_px
    )
}

/// Whether the frames tell the plate's errors from the lens's, in words.
pub(super) fn separation(fit: &PlateFit) -> String {
    let with = fit.separation.lens_sigma_px;
    let without = fit.separation.without_priors_px;
    if fit.separation.by_data() {
        return "the frames themselves tell the plate's errors from the lens's distortion".into();
    }
    format!(
        "the frames do not tell the plate's errors from the lens's distortion (the camera was not moved enough between poses): \
         the split rests on what was stated beforehand, marks within the drawing's sigma and each lens term within \
         {LENS_PRIOR_PX} px at the corner; the lens is known to {with:.3} px there, and to {without:.3} px without these. \
         Shift and turn the camera, and take frames in each pose"
    )
}
