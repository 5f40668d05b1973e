//! Whether a camera answers, with the settings it was given, and what it sees.

use super::bounded::{findings_within, within};
use super::{DIM, Finding, Plan, PlannedCamera, SATURATED};
use crate::aspect::{self, Expected, Quality, Solution};
use crate::calibrate::check;
use crate::camera::{
    self, CameraError, CameraHealth, FrameSource, PixelFormat, Source, Surroundings, Take,
};
use crate::commands::CameraRole;
use crate::config::Config;
use crate::frame::Frame;
use crate::instrument::{Instrument, SkyCamera};
use crate::pointing;
use std::time::{Duration, Instant};

/// For a camera to be found and to give its first frame.
const PATIENCE: Duration = Duration::from_secs(15);
/// The longest that frames are taken for.
const LONGEST: Duration = Duration::from_secs(30);
/// Frames are taken for about so long.
const LOOK_S: f64 = 1.0;
const PLUG: &str =
    "is it powered and plugged in, on this network, and nobody else's? see docs/camera.md";

/// What taking frames gave.
struct TrialFrames {
    last: Option<Frame>,
    taken: u32,
    failed: Option<String>,
    /// From the first frame to the last.
    lasted: Duration,
    health: CameraHealth,
}

/// Opens a planned camera, as the flight does.
pub(super) fn open(
    config: &Config,
    planned: &PlannedCamera,
) -> Result<Box<dyn FrameSource>, CameraError> {
    let around = Surroundings {
        instrument: &planned.instrument,
        sky: planned.sky.as_ref(),
        seed: config.simulation.seed,
        start: config.simulation.start_utc,
        duration: None,
        speed: 1.0,
    };
    camera::open(&planned.source, &planned.config.settings(), &around)
}

pub(super) fn check(plan: &Plan, planned: &PlannedCamera) -> Vec<Finding> {
    let check = planned.table;
    let (config, camera) = (plan.config.clone(), planned.clone());
    let take = move || {
        open(&config, &camera).map(|mut open| take_frames(open.as_mut(), camera.config.rate_hz))
    };
    let trial = match within(PATIENCE + LONGEST, take) {
        Ok(Ok(trial)) => trial,
        Ok(Err(error)) => return vec![Finding::fail(check, error.to_string(), PLUG)],
        Err(no_answer) => return vec![Finding::fail(check, no_answer.to_string(), PLUG)],
    };
    let Some(frame) = &trial.last else {
        let reason = trial.failed.unwrap_or("no frame came".into());
        return vec![Finding::fail(
            check,
            format!("{}: {reason}", planned.source),
            PLUG,
        )];
    };
    let mut findings = vec![
        rate(planned, &trial),
        settings(planned, frame, &trial.health),
    ];
    findings.extend(health(check, &trial));
    match (planned.role, planned.instrument.seen_by(frame)) {
        (CameraRole::Roll | CameraRole::Moon, _) => {
            if let Some(camera) = planned.sky.clone() {
                let (plan, table, frame) = (plan.clone(), planned.table, frame.clone());
                findings.extend(findings_within(
                    PATIENCE,
                    &format!("{table} solves"),
                    "tell the program's makers",
                    move || match camera {
                        SkyCamera::Horizon(camera) => {
                            super::horizon::solves(&plan, table, &camera, &frame)
                        }
                        SkyCamera::Moon(camera) => {
                            super::moon::solves(&plan, table, &camera, &frame)
                        }
                    },
                ));
            }
        }
        (CameraRole::PitchYaw, Ok(instrument)) => {
            let seen = PlannedCamera {
                instrument: instrument.into_owned(),
                ..planned.clone()
            };
            findings.extend(solves(plan, &seen, frame));
        }
        (CameraRole::PitchYaw, Err(wrong)) => findings.push(Finding::fail(
            check,
            wrong.to_string(),
            "give the camera its own instrument file",
        )),
    }
    findings
}

fn take_frames(camera: &mut dyn FrameSource, rate_hz: f64) -> TrialFrames {
    let wanted = (LOOK_S * rate_hz).clamp(5.0, 60.0) as u32;
    let mut trial = TrialFrames {
        last: None,
        taken: 0,
        failed: None,
        lasted: Duration::ZERO,
        health: CameraHealth::default(),
    };
    let start = Instant::now();
    let mut first = None;
    while trial.taken < wanted {
        let limit = if trial.taken == 0 { PATIENCE } else { LONGEST };
        if start.elapsed() > limit {
            break;
        }
        match camera.next(&mut |_| {}) {
            Ok(Take::Exposure(exposure)) => {
                trial.taken += 1;
                trial.lasted = first.get_or_insert_with(Instant::now).elapsed();
                trial.last = Some(exposure.frame);
            }
            Ok(Take::NotYet) => {}
            Ok(Take::End) => break,
            Err(error) => {
                trial.failed = Some(error.to_string());
                // A camera that refuses at once must not be asked without a pause.
                std::thread::sleep(Duration::from_millis(20));
            }
        }
    }
    trial.health = camera.health();
    trial
}

fn rate(planned: &PlannedCamera, trial: &TrialFrames) -> Finding {
    let (source, taken) = (&planned.source, trial.taken);
    let wanted_hz = planned.config.rate_hz;
    let lasted_s = trial.lasted.as_secs_f64();
    let is_own_pace = matches!(source, Source::Folder(_));
    if taken < 3 || is_own_pace || lasted_s <= 0.0 {
        return Finding::pass(
            planned.table,
            format!("{source} answers; frames taken: {taken}"),
        );
    }
    let rate_hz = f64::from(taken - 1) / lasted_s;
    let found = format!("{source} answers; {taken} frames at {rate_hz:.1} Hz of {wanted_hz} Hz");
    match rate_hz >= 0.9 * wanted_hz {
        true => Finding::pass(planned.table, found),
        false => Finding::warn(
            planned.table,
            format!("{found}: too slow"),
            "shorten exposure_us, lower rate_hz, or look at the network",
        ),
    }
}

/// What the frame says of its settings, against what was asked. A folder's frames were taken as they were.
fn settings(planned: &PlannedCamera, frame: &Frame, health: &CameraHealth) -> Finding {
    let check = format!("{} settings", planned.table);
    if matches!(planned.source, Source::Folder(_)) {
        return Finding::pass(check, "those of a folder's frames are their own");
    }
    let mut wrong = Vec::new();
    if health.refused_settings > 0 {
        wrong.push(format!("{} were refused", health.refused_settings));
    }
    let asked = planned.config.settings();
    let mut compare = |name: &str, asked: Option<f64>, found: Option<f64>| {
        if let (Some(asked), Some(found)) = (asked, found)
            && (found - asked).abs() > 0.02 * asked.abs().max(1.0)
        {
            wrong.push(format!("{name}: asked for {asked}, found {found}"));
        }
    };
    let exposure_us = frame.info.exposure.map(|t| t.as_secs_f64() * 1e6);
    compare("exposure_us", Some(asked.exposure_us.into()), exposure_us);
    compare(
        "analogue_gain",
        asked.analogue_gain,
        frame.info.analogue_gain,
    );
    compare("preamp_gain", asked.preamp_gain, frame.info.preamp_gain);
    let bits = match asked.pixel_format {
        PixelFormat::Mono8 => 8,
        PixelFormat::Mono12 => 16,
    };
    if frame.bits() != bits {
        let found = frame.bits();
        wrong.push(format!(
            "pixel_format: asked for {}, found {found} bits",
            asked.pixel_format.name()
        ));
    }
    match wrong.is_empty() {
        true => Finding::pass(
            check,
            format!("{} us, {}", asked.exposure_us, asked.pixel_format.name()),
        ),
        false => Finding::fail(
            check,
            wrong.join("; "),
            "set what this camera can do: see docs/camera.md",
        ),
    }
}

fn health(check: &str, trial: &TrialFrames) -> Option<Finding> {
    let health = &trial.health;
    let counts = [
        ("incomplete frames", health.incomplete),
        ("missing frames", health.missing),
        ("lost packets", health.lost_packets),
        ("frames without a buffer", health.underruns),
        ("reconnections", health.reconnects),
    ];
    let mut faults: Vec<String> = counts
        .into_iter()
        .filter(|(_, count)| *count > 0)
        .map(|(name, count)| format!("{name}: {count}"))
        .collect();
    faults.extend(trial.failed.clone());
    let remedy = "look at cable, network buffers and packet size: see docs/camera.md";
    (!faults.is_empty())
        .then(|| Finding::warn(format!("{check} health"), faults.join("; "), remedy))
}

/// Solves a frame of the right size, and judges its light.
fn solves(plan: &Plan, planned: &PlannedCamera, frame: &Frame) -> Vec<Finding> {
    let (plan, planned_too, frame) = (plan.clone(), planned.clone(), frame.clone());
    let table = planned.table;
    let work = move || {
        let expected = frame.info.mid_exposure.and_then(Expected::at);
        let (settings, instrument) = (plan.config.solver(), &planned_too.instrument);
        let solution = aspect::solve_with(&settings, &frame, instrument, expected, None);
        let mut findings = vec![light(table, &solution, frame.saturation_dn())];
        findings.extend(contradicted(table, &solution, instrument));
        findings.push(aspect(&plan, &planned_too, &frame, solution));
        findings
    };
    findings_within(
        PATIENCE,
        &format!("{table} solves"),
        "tell the program's makers",
        work,
    )
}

/// A fine frame that contradicts what the instrument's file states of the camera.
fn contradicted(table: &str, solution: &Solution, instrument: &Instrument) -> Option<Finding> {
    let found: Vec<String> = check::contradictions(solution, instrument)
        .iter()
        .map(ToString::to_string)
        .collect();
    let remedy = "is it this camera's file, and was the camera moved? see docs/calibration.md";
    (!found.is_empty()).then(|| {
        let found = format!("instrument {}: {}", instrument.name, found.join("; "));
        Finding::warn(
            format!("{table} contradicts its calibration"),
            found,
            remedy,
        )
    })
}

fn light(table: &str, solution: &Solution, saturation_dn: u16) -> Finding {
    let check = format!("{table} light");
    let full_dn = f64::from(saturation_dn);
    let Some(levels) = solution.levels else {
        let found = "dark: no disc is seen";
        return Finding::warn(
            check,
            found,
            "no matter indoors; else open the cap, point at the Sun, lengthen exposure_us",
        );
    };
    let (disc, background) = (levels.disc_dn / full_dn, levels.background_dn / full_dn);
    let found = format!(
        "disc at {:.0} % of full scale, background at {:.0} %",
        100.0 * disc,
        100.0 * background
    );
    if disc >= SATURATED {
        return Finding::warn(
            check,
            format!("{found}: saturated"),
            "shorten exposure_us, or set auto_exposure",
        );
    }
    match disc < DIM {
        true => Finding::warn(
            check,
            format!("{found}: dim"),
            "lengthen exposure_us, or set auto_exposure",
        ),
        false => Finding::pass(check, found),
    }
}

fn aspect(plan: &Plan, planned: &PlannedCamera, frame: &Frame, mut solution: Solution) -> Finding {
    let check = format!("{} solves", planned.table);
    let reason = solution.stopped.map_or(String::new(), |stopped| {
        let limit = stopped.rejected;
        format!(
            " ({stopped}: {:.3}, limit {:.3})",
            limit.measured, limit.limit
        )
    });
    let quality = solution.quality;
    let Some(aspect) = solution.aspect else {
        let remedy =
            "no matter without a Sun; else look at the frame with `solaspect solve --overlay`";
        return Finding::warn(check, format!("no Sun{reason}"), remedy);
    };
    let [sx, sy] = aspect.sun_plate.sigma();
    let scale = planned.instrument.optics.arcsec_per_mil();
    let at = aspect.sun_plate.position;
    let mut found = format!(
        "{}{reason}: the Sun at {:.1}, {:.1} mil, 1 sigma {:.2} arcsec, {} marks",
        quality.name(),
        at.x,
        at.y,
        scale * (0.5 * (sx * sx + sy * sy)).sqrt(),
        solution.marks.len()
    );
    let place = frame.info.place.or(plan.config.site.place());
    let utc = frame.info.mid_exposure;
    let mut ephemeris = plan.ephemeris();
    let offset = pointing::offset_of(
        &mut solution,
        utc,
        place,
        &plan.target,
        None,
        &planned.instrument,
        &mut ephemeris,
    );
    match offset {
        Some(offset) => {
            found += &format!(
                "; offset {:.4}, {:.4} deg",
                offset.azimuth_deg, offset.elevation_deg
            );
        }
        None => found += "; no offset, for want of a time, a place or a sky",
    }
    match quality {
        Quality::Fine => Finding::pass(check, found),
        _ => Finding::warn(
            check,
            found,
            "look at the frame with `solaspect solve --overlay`",
        ),
    }
}
