//! Check of a camera: whether it answers, its settings, and the results of the flight's solver for its frames.

use super::Finding;
use super::bounded::{findings_within, within};
use crate::aspect::Quality;
use crate::calibrate::check;
use crate::camera::{
    Brightness, Camera, CameraError, CameraHealth, Exposure, FrameSource, PixelFormat, Source,
    Take, TakenFiles,
};
use crate::commands::controls::Snapshot;
use crate::frame::Frame;
use crate::instrument::{Role, WrongSize};
use crate::moon;
use crate::plan::{Plan, PlannedCamera, Replay};
use crate::reasons::horizon::NOT_ABOVE_LIMB;
use crate::service::messages::UnsolvedFrame;
use crate::service::solvers::{Solver, solver};
use crate::service::{BodyRoll, Found, Solved};
use std::time::{Duration, Instant};

/// Time for a camera to be found and to give its first frame.
const TIMEOUT: Duration = Duration::from_secs(15);
/// Longest time of taking frames.
const LONGEST: Duration = Duration::from_secs(30);
/// Usual time of taking frames, s.
const WATCH_S: f64 = 1.0;
/// Fraction of full scale from which the image is saturated.
const SATURATED: f64 = 0.985;
/// Fraction of full scale below which results are noisy.
const DIM: f64 = 0.1;
/// Roll beyond which a result is implausible for a gondola.
const MOST_ROLL_DEG: f64 = 15.0;
const PLUG: &str = "is it powered and plugged in, on this network or free to open by USB, and nobody else's? see docs/camera.md";
const WRITE: &str = "does a program write whole frames into this folder? see docs/camera.md";

/// A camera under test, with the flight's solver.
pub(super) struct Trial {
    pub source: Box<dyn FrameSource>,
    solver: Box<dyn Solver>,
    commanded: Snapshot,
}

impl Trial {
    /// Opens a planned camera, as the flight does; files that it takes from a followed folder are not lost to the flight.
    pub fn open(plan: &Plan, planned: &PlannedCamera) -> Result<Self, CameraError> {
        Ok(Self {
            source: plan.camera_factory(planned, Replay::default(), TakenFiles::default())()?,
            solver: solver(&planned.camera, plan.ephemeris()),
            commanded: plan.controls().snapshot(),
        })
    }

    pub fn solve(&mut self, exposure: Exposure) -> Result<Solved, WrongSize> {
        let mut frame = UnsolvedFrame::arrived(exposure);
        self.solver.solve(&mut frame, &self.commanded)
    }
}

/// Result of taking frames.
struct TrialFrames {
    last: Option<Exposure>,
    taken: u32,
    failed: Option<String>,
    /// Time from the first frame to the last.
    lasted: Duration,
    health: CameraHealth,
}

pub(super) fn check(plan: &Plan, planned: &PlannedCamera) -> Vec<Finding> {
    let check = &planned.camera.name;
    let remedy = match planned.source {
        Source::Followed(..) => WRITE,
        _ => PLUG,
    };
    let (of_plan, of_camera) = (plan.clone(), planned.clone());
    let take = move || {
        let mut trial = Trial::open(&of_plan, &of_camera)?;
        let frames = take_frames(trial.source.as_mut(), of_camera.configured.rate_hz);
        Ok::<_, CameraError>((trial, frames))
    };
    let (trial, frames) = match within(TIMEOUT + LONGEST, take) {
        Ok(Ok(taken)) => taken,
        Ok(Err(error)) => return vec![Finding::fail(check, error.to_string(), remedy)],
        Err(no_answer) => return vec![Finding::fail(check, no_answer.to_string(), remedy)],
    };
    let Some(exposure) = frames.last.clone() else {
        let reason = frames.failed.unwrap_or("no frame came".into());
        let found = format!("{}: {reason}", planned.source);
        return vec![Finding::fail(check, found, remedy)];
    };
    let mut findings = vec![
        rate(planned, &frames),
        settings(planned, &exposure.frame, &frames.health),
    ];
    findings.extend(health(check, &frames));
    match planned.camera.sees.check(&exposure.frame) {
        Ok(()) => findings.extend(solves(trial, planned.camera.clone(), exposure)),
        Err(wrong) => {
            let remedy = "give the camera its own instrument file";
            findings.push(Finding::fail(check, wrong, remedy));
        }
    }
    findings
}

/// Solves a frame of the right size, and checks its brightness.
fn solves(mut trial: Trial, camera: Camera, exposure: Exposure) -> Vec<Finding> {
    let check = format!("{} solves", camera.name);
    let makers = "report this to the program's authors";
    findings_within(TIMEOUT, &check, makers, move || {
        let Ok(solved) = trial.solve(exposure) else {
            return Vec::new();
        };
        let light = light(&camera.name, &solved, camera.role);
        let contradicted = contradicted(&camera.name, &solved);
        let shown = shows(&camera, &solved);
        light.into_iter().chain(contradicted).chain(shown).collect()
    })
}

fn take_frames(camera: &mut dyn FrameSource, rate_hz: f64) -> TrialFrames {
    let wanted = (WATCH_S * rate_hz).clamp(5.0, 60.0) as u32;
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
        let limit = if trial.taken == 0 { TIMEOUT } else { LONGEST };
        if start.elapsed() > limit {
            break;
        }
        match camera.next(&mut |_| {}) {
            Ok(Take::Exposure(exposure)) => {
                trial.taken += 1;
                trial.lasted = first.get_or_insert_with(Instant::now).elapsed();
                trial.last = Some(*exposure);
            }
            Ok(Take::NotYet) => {}
            Ok(Take::End) => break,
            Err(error) => {
                trial.failed = Some(error.to_string());
                // A camera that refuses at once must not be called without a pause.
                std::thread::sleep(Duration::from_millis(20));
            }
        }
    }
    trial.health = camera.health();
    trial
}

fn rate(planned: &PlannedCamera, trial: &TrialFrames) -> Finding {
    let (source, taken) = (&planned.source, trial.taken);
    let wanted_hz = planned.configured.rate_hz;
    let lasted_s = trial.lasted.as_secs_f64();
    let is_own_pace = matches!(source, Source::Folder(_));
    if taken < 3 || is_own_pace || lasted_s <= 0.0 {
        return Finding::pass(
            &planned.camera.name,
            format!("{source} answers; frames taken: {taken}"),
        );
    }
    let rate_hz = f64::from(taken - 1) / lasted_s;
    let found = format!("{source} answers; {taken} frames at {rate_hz:.1} Hz of {wanted_hz} Hz");
    match rate_hz >= 0.9 * wanted_hz {
        true => Finding::pass(&planned.camera.name, found),
        false => Finding::warn(
            &planned.camera.name,
            format!("{found}: too slow"),
            "shorten exposure_us, lower rate_hz, or check the network",
        ),
    }
}

/// Compares the frame's settings with the requested ones. Those of a folder's frames are fixed.
fn settings(planned: &PlannedCamera, frame: &Frame, health: &CameraHealth) -> Finding {
    let check = format!("{} settings", planned.camera.name);
    if matches!(planned.source, Source::Folder(_) | Source::Followed(..)) {
        return Finding::pass(check, "those of a folder's frames are their own");
    }
    let mut wrong = Vec::new();
    if health.refused_settings > 0 {
        wrong.push(format!("{} were refused", health.refused_settings));
    }
    let asked = planned.configured.settings();
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
    let format = asked.pixel_format;
    let largest = u16::MAX >> (16 - format.bits());
    let found = frame.saturation_dn();
    // Of 16 bits a camera may use fewer.
    let is_format = found == largest || (format == PixelFormat::Mono16 && frame.bits() == 16);
    if !is_format {
        let name = format.name();
        wrong.push(format!(
            "pixel_format: asked for {name}, found numbers up to {found} DN"
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
    let remedy = "check cable, network buffers and packet size: see docs/camera.md";
    (!faults.is_empty())
        .then(|| Finding::warn(format!("{check} health"), faults.join("; "), remedy))
}

/// A warning if a fine frame contradicts the instrument's file.
fn contradicted(camera: &str, solved: &Solved) -> Option<Finding> {
    let Found::Sun(sun) = &solved.found else {
        return None;
    };
    let found: Vec<String> = check::contradictions(&sun.solution, &sun.instrument)
        .iter()
        .map(ToString::to_string)
        .collect();
    let remedy = "is it this camera's file, and was the camera moved? see docs/calibration.md";
    (!found.is_empty()).then(|| {
        let found = format!("instrument {}: {}", sun.instrument.name, found.join("; "));
        let check = format!("{camera} contradicts its calibration");
        Finding::warn(check, found, remedy)
    })
}

/// Finding on the brightness that the automatic exposure uses.
fn light(camera: &str, solved: &Solved, role: Role) -> Option<Finding> {
    let check = format!("{camera} light");
    let (level, background) = match solved.brightness {
        Brightness::Disc { level, background } => (level, background),
        // Horizon and Moon may be out of view, without any fault of the exposure.
        Brightness::NoDisc if role != Role::PitchYaw => return None,
        Brightness::NoDisc => {
            let remedy =
                "no matter indoors; else open the cap, point at the Sun, lengthen exposure_us";
            return Some(Finding::warn(check, "dark: no disc is seen", remedy));
        }
    };
    let [light, dark] = [level, background].map(|part| 100.0 * part);
    let found = format!("light at {light:.0} % of full scale, background at {dark:.0} %");
    Some(if level >= SATURATED {
        let remedy = "shorten exposure_us, or set auto_exposure";
        Finding::warn(check, format!("{found}: saturated"), remedy)
    } else if level < DIM {
        let remedy = "lengthen exposure_us, or set auto_exposure";
        Finding::warn(check, format!("{found}: dim"), remedy)
    } else {
        Finding::pass(check, found)
    })
}

/// Finding from a frame's solution; `None` for a camera whose frames are not solved.
fn shows(camera: &Camera, solved: &Solved) -> Option<Finding> {
    if let Found::Nothing = solved.found {
        return None;
    }
    let check = format!("{} solves", camera.name);
    let why = solved.stopped.map(|stopped| stopped.in_full());
    let inspect = format!(
        "inspect the frame with `solaspect {} --overlay`",
        camera.role.command()
    );
    let Some(found) = solved.in_words() else {
        let found = format!("no {} ({})", camera.role.target(), why.unwrap_or_default());
        let is_hidden = |stage: &str| stage == moon::Stage::Sky.name();
        return Some(match solved.stopped {
            Some(stopped) if is_hidden(stopped.stage) => Finding::pass(check, found),
            Some(stopped) if stopped.rejected.reason == NOT_ABOVE_LIMB => {
                let remedy = "no matter on the ground; else set roll.height_m";
                Finding::warn(check, found, remedy)
            }
            _ => {
                let remedy = format!("no matter where none is in view; else {inspect}");
                Finding::warn(check, found, &remedy)
            }
        });
    };
    let doubt = why.map_or(String::new(), |why| format!(" ({why})"));
    let found = format!("{}{doubt}: {found}", solved.quality.name());
    let is_too_large = |roll: BodyRoll| roll.deg.value.abs() > MOST_ROLL_DEG;
    Some(match solved.quality {
        _ if camera.role == Role::Roll && solved.roll.is_some_and(is_too_large) => {
            Finding::warn(check, found, "is body_from_camera right?")
        }
        Quality::Fine => Finding::pass(check, found),
        Quality::Coarse | Quality::None => Finding::warn(check, found, &inspect),
    })
}
