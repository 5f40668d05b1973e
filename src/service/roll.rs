//! The roll camera's solver: a frame of the horizon in, straight down in the body's axes out.

use super::answer::Answer;
use super::control::Snapshot;
use super::flight::{Station, UnsolvedFrame};
use super::outlet::Outlet;
use super::shared::Shared;
use super::tally::{RollTally, worth_a_line};
use super::worker::Life;
use crate::aspect;
use crate::camera::{Brightness, Exposure};
use crate::frame;
use crate::geometry::attitude::Direction;
use crate::horizon::{self, Levels, Settings, Solution, Stage, Stopped};
use crate::instrument::MountedCamera;
use crate::pointing::body_roll_deg;
use crate::units::Rejected;
use crossbeam_channel::Receiver;
use nalgebra::UnitVector3;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

/// Frames are not nearer to each other than that.
const LEAST_S: f64 = 1e-3;

/// What the horizon said last; the solvers of the other cameras look.
pub(super) type LatestNadir = Shared<Option<SeenNadir>>;

/// Straight down in the axes of the body that carries the cameras: forward, right, down.
#[derive(Debug, Clone, Copy)]
pub(super) struct SeenNadir {
    pub direction: Direction,
    /// Middle of the exposure.
    at: Instant,
    /// How fast it has moved since the frame before, if there was one.
    rad_per_s: f64,
}

impl SeenNadir {
    /// What comes next; the body has gone on turning in between.
    fn next(last: Option<Self>, direction: Direction, at: Instant) -> Self {
        let speed = |last: Self| {
            let angle_rad = last.direction.unit.angle(&direction.unit);
            angle_rad / apart(last.at, at).as_secs_f64().max(LEAST_S)
        };
        Self {
            direction,
            at,
            rad_per_s: last.map_or(0.0, speed),
        }
    }

    /// The direction for an exposure whose middle was at a moment, less certain by what the body turns in between; `None` where the two
    /// are too far apart.
    pub fn at(self, moment: Instant, max_age: Duration) -> Option<Direction> {
        let apart = apart(self.at, moment);
        let turned_rad = self.rad_per_s * apart.as_secs_f64();
        (apart <= max_age).then(|| self.direction.loosened(turned_rad))
    }
}

fn apart(one: Instant, other: Instant) -> Duration {
    let after = other.saturating_duration_since(one);
    after.max(one.saturating_duration_since(other))
}

#[derive(Clone)]
pub(super) struct RollSolver {
    pub station: Arc<Station>,
    pub camera: MountedCamera,
    pub outlet: Outlet,
    pub cameras_ended: Arc<AtomicBool>,
    pub latest: LatestNadir,
    pub tally: Shared<RollTally>,
}

impl RollSolver {
    /// Solves until the camera ends, or another thread has taken over.
    pub fn run(self, frames: &Receiver<UnsolvedFrame>, life: &Life) {
        let mut last = None;
        while let Some(frame) = UnsolvedFrame::next(frames, &self.cameras_ended, life) {
            let middle = frame.middle();
            let exposure = frame.exposure;
            if !self.is_own(&exposure) {
                continue;
            }
            let snapshot = self.outlet.controls.snapshot();
            let start = Instant::now();
            let solution = self.solve(&exposure, &snapshot, last.as_ref());
            let solve_time = start.elapsed();
            if life.is_over() {
                return;
            }
            let nadir = solution.nadir.as_ref().ok();
            last = nadir.map(|nadir| nadir.direction.unit);
            let before = self.latest.copy();
            let seen = nadir.map(|nadir| {
                let in_body = nadir.direction.turned(&self.camera.body_from_camera);
                SeenNadir::next(before, in_body, middle)
            });
            if seen.is_some() {
                *self.latest.lock() = seen;
            }
            self.note(&solution);
            let roll_deg = seen.map(|seen| body_roll_deg(&seen.direction));
            let saturation_dn = exposure.frame.saturation_dn();
            let brightness = brightness(&solution, saturation_dn);
            let answer = Answer {
                station: Arc::clone(&self.station),
                exposure: Arc::new(exposure),
                solution: Arc::new(levels_alone(&solution)),
                offset: None,
                horizon: Some(Arc::new(solution)),
                roll_deg,
                target: snapshot.target,
                solve_time,
                to_be_stored: self.outlet.stores(&self.station),
            };
            self.outlet.hand_on(answer, brightness);
        }
    }

    /// Whether a frame has the camera's size.
    fn is_own(&self, exposure: &Exposure) -> bool {
        let Err(error) = self.camera.optics.check(&exposure.frame) else {
            return true;
        };
        let mut tally = self.tally.lock();
        tally.misfits += 1;
        if worth_a_line(tally.misfits) {
            tracing::error!(%error, misfits = tally.misfits, "not the roll camera's frame");
        }
        false
    }

    fn solve(
        &self,
        exposure: &Exposure,
        commanded: &Snapshot,
        last: Option<&UnitVector3<f64>>,
    ) -> Solution {
        let place = exposure.frame.info.place.or(commanded.place);
        let sphere = place.and_then(|place| commanded.roll.sphere(place.height_m));
        let Some(sphere) = sphere else {
            return Solution::none(no_height(
                place.map_or(0.0, |place| place.height_m),
                commanded,
            ));
        };
        let camera = &self.camera.optics;
        horizon::solve(&Settings::default(), &exposure.frame, camera, &sphere, last)
    }

    fn note(&self, solution: &Solution) {
        let mut tally = self.tally.lock();
        *tally.solved.entry(solution.quality()).or_default() += 1;
        if let Err((stage, rejected)) = &solution.nadir {
            let count = tally.reasons.entry((*stage, rejected.reason)).or_default();
            *count += 1;
            if worth_a_line(*count) {
                let (stage, reason) = (stage.name(), rejected.reason);
                let (measured, limit) = (rejected.measured, rejected.limit);
                tracing::warn!(
                    stage,
                    reason,
                    measured,
                    limit,
                    frames = *count,
                    "no horizon"
                );
            }
        }
    }
}

/// The camera is not known to be above the limb's edge.
fn no_height(height_m: f64, commanded: &Snapshot) -> Stopped {
    let rejected = Rejected {
        reason: "not_above_the_limb",
        measured: height_m,
        limit: commanded.roll.atmosphere_m,
    };
    (Stage::Light, rejected)
}

/// The limb's light for the exposure that follows it: the Sun in the picture is too small to count. A picture that is bright all over has too
/// much, and one that is dark says nothing of the limb.
fn brightness(solution: &Solution, saturation_dn: u16) -> Brightness {
    let full_dn = f64::from(saturation_dn);
    match (&solution.levels, &solution.nadir) {
        (Some(levels), _) => Brightness::Disc {
            level: levels.bright_dn / full_dn,
            background: levels.dark_dn / full_dn,
        },
        (None, Err((_, rejected))) if rejected.reason == Levels::TOO_BRIGHT => Brightness::Disc {
            level: 1.0,
            background: 1.0,
        },
        _ => Brightness::NoDisc,
    }
}

/// What a frame of the horizon says in the words of one of the Sun: its levels.
fn levels_alone(solution: &Solution) -> aspect::Solution {
    let levels = solution.levels.map(|levels| frame::Levels {
        background_dn: levels.dark_dn,
        noise_dn: levels.noise_dn,
        disc_dn: levels.bright_dn,
    });
    aspect::Solution {
        levels,
        ..aspect::Solution::none()
    }
}
