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
use crate::frame::{self, Frame};
use crate::geometry::attitude::Direction;
use crate::horizon::{self, Levels, Settings, Solution, Stage};
use crate::instrument::MountedCamera;
use crate::pointing::body_roll_deg;
use crate::units::Rejected;
use crossbeam_channel::Receiver;
use nalgebra::UnitVector3;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

/// A gondola turns by so much where no frames have told, 1 sigma: half a degree a second.
const USUAL_RAD_PER_S: f64 = 0.009;
/// Frames this near to each other or further apart than that tell no rate; from frame to frame so much of it is kept.
const LEAST_S: f64 = 0.03;
const RATE_VALID_S: f64 = 1.5;
const RATE_KEPT: f64 = 0.95;

/// What the horizon said last; the solvers of the other cameras look.
pub(super) type LatestNadir = Shared<Option<SeenNadir>>;

/// Straight down in the axes of the body that carries the cameras: forward, right, down.
#[derive(Debug, Clone, Copy)]
pub(super) struct SeenNadir {
    pub direction: Direction,
    /// Middle of the exposure.
    at: Instant,
    /// How fast the body turns, by the latest frames.
    rad_per_s: f64,
}

impl SeenNadir {
    /// What comes next. A swing is slow where it turns back, so that its rate is kept for a while.
    fn next(last: Option<Self>, direction: Direction, at: Instant) -> Self {
        let rate = |last: Self| {
            let seconds = apart(last.at, at).as_secs_f64();
            let turned_rad = last.direction.unit.angle(&direction.unit);
            let rad_per_s = turned_rad / seconds.max(LEAST_S);
            (seconds < RATE_VALID_S).then(|| rad_per_s.max(RATE_KEPT * last.rad_per_s))
        };
        Self {
            direction,
            at,
            rad_per_s: last.and_then(rate).unwrap_or(USUAL_RAD_PER_S),
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
            let mut exposure = frame.exposure;
            let snapshot = self.outlet.controls.snapshot();
            // The file tells the place that its nadir rests on.
            let info = &mut exposure.frame.info;
            info.place = info.place.or(snapshot.place);
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

    /// The horizon of a frame. One of another size than the camera's is stored, and not solved.
    fn solve(
        &self,
        exposure: &Exposure,
        commanded: &Snapshot,
        last: Option<&UnitVector3<f64>>,
    ) -> Solution {
        let (frame, camera) = (&exposure.frame, &self.camera.optics);
        if camera.check(frame).is_err() {
            return unsolved(
                frame,
                "wrong_size",
                frame.width() as f64,
                camera.width_px as f64,
            );
        }
        let height_m = exposure.frame.info.place.map(|place| place.height_m);
        match commanded.roll.sphere(height_m) {
            Some(sphere) => horizon::solve(&Settings::default(), frame, camera, &sphere, last),
            None => {
                let limit_m = commanded.roll.atmosphere_m;
                let height_m = commanded.roll.height_m.or(height_m).unwrap_or_default();
                unsolved(frame, "not_above_the_limb", height_m, limit_m)
            }
        }
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

/// A frame that is not searched, with its light: the exposure follows that all the same.
fn unsolved(frame: &Frame, reason: &'static str, measured: f64, limit: f64) -> Solution {
    let whole_px = frame.width().max(frame.height()) as f64;
    let rejected = Rejected {
        reason,
        measured,
        limit,
    };
    match Levels::of(frame, whole_px) {
        Ok(levels) => Solution {
            levels: Some(levels),
            ..Solution::none((Stage::Light, rejected))
        },
        Err(light) => Solution::none((Stage::Light, light)),
    }
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

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    fn down(roll_rad: f64) -> Direction {
        let unit = Vector3::new(0.0, roll_rad.sin(), roll_rad.cos());
        Direction::new(UnitVector3::new_normalize(unit), 1e-4)
    }

    #[test]
    fn a_nadir_is_less_certain_the_more_the_body_turns_until_a_frame_and_serves_for_a_while() {
        let start = Instant::now();
        let after = |ms| start + Duration::from_millis(ms);
        let sigma_at = |seen: SeenNadir, ms| {
            let direction = seen.at(after(ms), Duration::from_secs(1))?;
            Some((direction.sigma_rad().powi(2) - 1e-8).max(0.0).sqrt())
        };
        let is = |sigma: Option<f64>, expected: f64| (sigma.unwrap() - expected).abs() < 1e-9;
        // Nothing tells a rate yet.
        let first = SeenNadir::next(None, down(0.0), after(1000));
        assert!(is(sigma_at(first, 1000), 0.0));
        assert!(is(sigma_at(first, 1500), 0.5 * USUAL_RAD_PER_S));
        // An exposure before it is as far away as one after it.
        assert!(is(sigma_at(first, 500), 0.5 * USUAL_RAD_PER_S));
        assert_eq!(sigma_at(first, 2001), None);
        // Faster than usual.
        let second = SeenNadir::next(Some(first), down(0.01), after(1500));
        assert!(is(sigma_at(second, 2000), 0.5 * 0.02));
        // Where the swing turns back, its rate is kept.
        let third = SeenNadir::next(Some(second), down(0.01), after(2000));
        assert!(is(sigma_at(third, 2500), 0.5 * RATE_KEPT * 0.02));
        // After a gap nothing is known of it.
        let fourth = SeenNadir::next(Some(third), down(0.01), after(9000));
        assert!(is(sigma_at(fourth, 9500), 0.5 * USUAL_RAD_PER_S));
    }
}
