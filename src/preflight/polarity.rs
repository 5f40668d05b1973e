//! The guided test of the signs: the operator slews the telescope, and the offsets must follow.
//!
//! A wrong twist, clocking or handedness makes the controller steer the wrong way, with fine solutions. Only a motion in a known
//! direction reveals it.

use super::Finding;
use super::bounded::within;
use super::camera::Trial;
use crate::camera::Take;
use crate::plan::{Plan, PlannedCamera};
use crate::pointing::Offset;
use crate::service::Found;
use std::time::{Duration, Instant};

/// Longest wait for a slew.
const WATCH: Duration = Duration::from_secs(30);
/// Time for the camera to be found, and for a call that lasts longer than the watch.
const TIMEOUT: Duration = Duration::from_secs(15);
/// Smallest change that counts as a motion, in degrees and in sigma.
const MOVED_DEG: f64 = 0.05;
const MOVED_SIGMA: f64 = 5.0;
/// Number of successive frames that must agree.
const AGREEING: u32 = 3;

/// The person who slews the telescope.
pub trait Operator {
    /// Asks for a slew, and returns when it is about to begin; `false` if there will be none.
    fn is_ready(&mut self, request: &str) -> bool;
}

/// An axis of the telescope.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Axis {
    Elevation,
    Azimuth,
}

impl Axis {
    fn check(self) -> &'static str {
        match self {
            Self::Elevation => "polarity of elevation",
            Self::Azimuth => "polarity of azimuth",
        }
    }

    fn request(self) -> &'static str {
        match self {
            Self::Elevation => {
                "slew the telescope UP by 0.1 deg or more, the Sun staying on the plate"
            }
            Self::Azimuth => {
                "slew the telescope to the RIGHT (clockwise seen from above, to larger azimuth) by 0.1 deg or more, \
                 the Sun staying on the plate"
            }
        }
    }

    /// True angle along the axis.
    fn of(self, offset: &Offset) -> f64 {
        match self {
            Self::Elevation => offset.elevation_deg,
            Self::Azimuth => offset.cross_elevation_deg,
        }
    }
}

/// Direction in which an offset has changed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Motion {
    Grew,
    Fell,
}

/// Follows an offset from its first value until it has moved significantly.
#[derive(Debug, Clone, Default)]
pub struct Trend {
    first_deg: Option<f64>,
    /// The direction in the last frames, and the number of them that agree.
    run: Option<(Motion, u32)>,
    samples: u32,
    change_deg: f64,
}

impl Trend {
    /// Takes the next offset with its sigma; returns the motion, once several successive frames show it.
    pub fn push(&mut self, offset_deg: f64, sigma_deg: f64) -> Option<Motion> {
        self.samples += 1;
        self.change_deg = offset_deg - *self.first_deg.get_or_insert(offset_deg);
        let limit_deg = MOVED_DEG.max(MOVED_SIGMA * sigma_deg);
        if self.change_deg.abs() < limit_deg {
            self.run = None;
            return None;
        }
        let motion = match self.change_deg > 0.0 {
            true => Motion::Grew,
            false => Motion::Fell,
        };
        let before = self.run.filter(|(last, _)| *last == motion);
        let agreeing = before.map_or(1, |(_, agreeing)| agreeing + 1);
        self.run = Some((motion, agreeing));
        (agreeing >= AGREEING).then_some(motion)
    }

    /// Change from the first offset to the last.
    pub fn change_deg(&self) -> f64 {
        self.change_deg
    }

    /// Number of offsets so far.
    pub fn samples(&self) -> u32 {
        self.samples
    }
}

pub(super) fn check(plan: &Plan, operator: &mut dyn Operator) -> Vec<Finding> {
    let mut findings = Vec::new();
    for planned in plan
        .cameras
        .iter()
        .filter(|one| one.camera.sees.plate().is_some())
    {
        findings.extend(check_camera(plan, planned, operator));
    }
    findings
}

fn check_camera(plan: &Plan, planned: &PlannedCamera, operator: &mut dyn Operator) -> Vec<Finding> {
    let (plan, planned) = (plan.clone(), planned.clone());
    let opened = within(TIMEOUT, move || Trial::open(&plan, &planned));
    let failed = |found: String| vec![Finding::fail("polarity", found, "see the camera")];
    let mut watch = match opened {
        Ok(Ok(watch)) => watch,
        Ok(Err(error)) => return failed(error.to_string()),
        Err(no_answer) => return failed(no_answer.to_string()),
    };
    let mut findings = Vec::new();
    for axis in [Axis::Elevation, Axis::Azimuth] {
        if !operator.is_ready(axis.request()) {
            let remedy = "slew when asked, so that the signs are known before the flight";
            findings.push(Finding::warn(
                axis.check(),
                "not tested: the telescope was not slewed",
                remedy,
            ));
            continue;
        }
        let watched = within(WATCH + TIMEOUT, move || {
            let outcome = follow(&mut watch, axis);
            (watch, outcome)
        });
        match watched {
            Ok((back, (trend, motion))) => {
                watch = back;
                findings.push(judge(axis, &trend, motion));
            }
            Err(no_answer) => {
                findings.push(Finding::fail(
                    axis.check(),
                    no_answer.to_string(),
                    "see the camera",
                ));
                break;
            }
        }
    }
    findings
}

fn judge(axis: Axis, trend: &Trend, motion: Option<Motion>) -> Finding {
    let found = format!(
        "the offset changed by {:+.3} deg over {} frames",
        trend.change_deg(),
        trend.samples()
    );
    match motion {
        Some(Motion::Grew) => Finding::pass(axis.check(), format!("{found}: it grew, as it must")),
        Some(Motion::Fell) => Finding::fail(
            axis.check(),
            format!("{found}: it fell, and must grow"),
            "check twist, handedness and clocking in the instrument's file, and which way was slewed",
        ),
        None if trend.samples() == 0 => Finding::fail(
            axis.check(),
            "no frame gave an offset",
            "the Sun must be on the plate, and the place known: set [site]",
        ),
        None => Finding::fail(
            axis.check(),
            format!("{found}: no motion beyond doubt"),
            "slew further",
        ),
    }
}

/// Takes and solves frames until the offset has moved along the axis, or the time limit.
fn follow(trial: &mut Trial, axis: Axis) -> (Trend, Option<Motion>) {
    let mut trend = Trend::default();
    let start = Instant::now();
    while start.elapsed() < WATCH {
        match trial.source.next(&mut |_| {}) {
            Ok(Take::Exposure(exposure)) => {
                let solved = trial.solve(*exposure);
                let Ok(Found::Sun(sun)) = solved.map(|solved| solved.found) else {
                    continue;
                };
                let offset = sun.offset;
                let moved = |offset: Offset| trend.push(axis.of(&offset), offset.sigma_deg);
                if let Some(motion) = offset.and_then(moved) {
                    return (trend, Some(motion));
                }
            }
            Ok(Take::NotYet) => {}
            Ok(Take::End) => break,
            Err(_) => std::thread::sleep(Duration::from_millis(20)),
        }
    }
    (trend, None)
}
