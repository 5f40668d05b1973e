//! `solaspect calibrate camera`: noise, gain, hot pixels, vignetting, blur.

use super::edition::{Edition, write_page};
use crate::calibrate::camera::{self, CameraCalibration, Inputs};
use crate::calibrate::frames::{self, LeftOut};
use crate::calibrate::numbers::{sigma_text, value_text};
use crate::calibrate::revision::Provenance;
use crate::cli::output::say;
use anyhow::Context;
use clap::Args;
use jiff::Timestamp;
use jiff::tz::TimeZone;
use std::path::PathBuf;
use std::process::ExitCode;

/// Measure dark level, noise, gain, hot pixels, vignetting and blur, and how blur and scale go with temperature
///
/// Best from dark frames, evenly lit frames (two at each of several exposures) and frames with the Sun all over the plate; each may be
/// missing. What the frames do not determine keeps the instrument's value, and the program says so.
#[derive(Debug, Args)]
pub struct CameraArgs {
    /// Frames of the Sun on the plate, or folders of them
    #[arg(required_unless_present_any = ["dark", "flat"], value_name = "FRAME|DIR")]
    frames: Vec<PathBuf>,
    #[command(flatten)]
    edition: Edition,
    /// Write a page with figures to this folder, camera.html
    #[arg(long, value_name = "DIR")]
    report: Option<PathBuf>,
    /// Frames without light, at equal exposure
    #[arg(long, value_name = "DIR")]
    dark: Option<PathBuf>,
    /// Evenly lit frames, two at each of several exposures
    #[arg(long, value_name = "DIR")]
    flat: Option<PathBuf>,
}

pub fn run(args: CameraArgs) -> anyhow::Result<ExitCode> {
    let (mut revision, stated) = args.edition.open()?;
    let listed = |folder: &Option<PathBuf>| frames::list(folder.as_slice());
    let (dark, flat, sun) = (
        listed(&args.dark)?,
        listed(&args.flat)?,
        frames::list(&args.frames)?,
    );
    let mut inputs = Inputs::default();
    let (mut left_out, mut more);
    (inputs.dark, left_out) = camera::load(&dark, &stated)?;
    (inputs.flat, more) = camera::load(&flat, &stated)?;
    left_out.append(&mut more);
    (inputs.sun, inputs.suns, more) = camera::look(&sun, &stated)?;
    left_out.append(&mut more);
    let calibration =
        camera::calibrate(&inputs, &stated).with_context(|| frames::first_of(&left_out))?;
    let files: Vec<PathBuf> = [dark, flat, sun].concat();
    let provenance = provenance(&inputs, &files);
    calibration.revise(&mut revision, &provenance);
    args.edition.write(&revision)?;
    print(&calibration, &left_out)?;
    if let Some(folder) = &args.report {
        write_page(
            folder,
            "camera.html",
            &camera::page(&calibration, &stated.name, &provenance.source, &left_out)?,
        )?;
    }
    Ok(ExitCode::SUCCESS)
}

fn provenance(inputs: &Inputs, files: &[PathBuf]) -> Provenance {
    let shots = [&inputs.dark, &inputs.flat, &inputs.sun]
        .into_iter()
        .flat_map(|s| &s.frames);
    let last = shots.filter_map(|s| s.frame.info.mid_exposure).max();
    let last = last.unwrap_or_else(Timestamp::now);
    Provenance {
        name: "camera",
        source: format!(
            "camera calibration, {} dark, {} evenly lit and {} frames of the Sun",
            inputs.dark.frames.len(),
            inputs.flat.frames.len(),
            inputs.suns.len()
        ),
        date: TimeZone::UTC.to_datetime(last).date(),
        frames: files.len(),
        frames_sha256: frames::sha256(files),
    }
}

fn print(calibration: &CameraCalibration, left_out: &[LeftOut]) -> anyhow::Result<()> {
    for finding in &calibration.findings {
        match &finding.found {
            Ok(found) => say(format_args!(
                "{}: {} +- {} {}; {}",
                finding.name,
                value_text(*found),
                sigma_text(found.sigma),
                finding.unit,
                finding.remark
            ))?,
            Err(why) => say(format_args!(
                "{}: {why}; keeps the instrument's value",
                finding.name
            ))?,
        }
    }
    match &calibration.hot_pixels {
        Some(hot) => say(format_args!("hot pixels: {}", hot.len()))?,
        None => say(
            "hot pixels: not determined: at least 3 frames are needed; keeps the instrument's list",
        )?,
    }
    for LeftOut { name, reason } in left_out {
        say(format_args!("left out: {name}: {reason}"))?;
    }
    Ok(())
}
