//! The roll camera's solver: a frame of the horizon in, straight down in the body's axes out.

use super::answer::Answer;
use super::flight::{Middle, Station, UnsolvedFrame};
use super::outlet::Outlet;
use super::shared::Shared;
use super::tally::RollTally;
use super::worker::Life;
use crate::aspect;
use crate::camera::{Brightness, Exposure};
use crate::commands::controls::Snapshot;
use crate::frame::{self, Frame};
use crate::geometry::attitude::Direction;
use crate::horizon::{self, Levels, Quality, Settings, Solution, Stage};
use crate::instrument::MountedCamera;
use crate::link::Counters;
use crate::log::worth_a_line;
use crate::pointing::body_roll_deg;
use crate::reasons::{Stopped, at, horizon as reasons};
use crate::units::Reason;
use crate::units::Rejected;
use crossbeam_channel::Receiver;
use nalgebra::{Rotation3, UnitVector3, Vector3};
use std::sync::Arc;
use std::sync::atomic::AtomicBool;
use std::time::{Duration, Instant};

/// A gondola turns by so much in a second where no frames have told, 1 sigma: half a degree.
const USUAL_RAD_PER_S: f64 = 0.009;
/// Frames further apart than that tell no rate.
const RATE_VALID_S: f64 = 1.5;
/// The rate follows the frames in this time.
const RATE_FOLLOWS_S: f64 = 0.15;
/// From frame to frame so much is kept of how far the frames before missed.
const MISS_KEPT: f64 = 0.9;

/// What the horizon said last; the solvers of the other cameras look.
pub(super) type LatestNadir = Shared<Option<SeenNadir>>;

/// Straight down in the axes of the body that carries the cameras: forward, right, down.
#[derive(Debug, Clone, Copy)]
pub(super) struct SeenNadir {
    pub direction: Direction,
    at: Middle,
    /// When the frame was there.
    pub arrived: Instant,
    /// How it turns in these axes, by the latest frames.
    turn_rad_per_s: Vector3<f64>,
    /// How far such a turn has missed the frame that came, 1 sigma per axis, and after how long.
    missed_rad: f64,
    after_s: f64,
}

impl SeenNadir {
    /// A direction, where no frames before tell how it turns.
    fn first(direction: Direction, at: Middle) -> Self {
        Self {
            direction,
            at,
            arrived: at.by_arrival,
            turn_rad_per_s: Vector3::zeros(),
            missed_rad: USUAL_RAD_PER_S,
            after_s: 1.0,
        }
    }

    /// What comes after it.
    fn next(last: Option<Self>, direction: Direction, at: Middle) -> Self {
        let Some(last) = last else {
            return Self::first(direction, at);
        };
        let step_s = last.at.until(&at);
        if step_s <= 0.0 || step_s > RATE_VALID_S {
            return Self::first(direction, at);
        }
        let foretold = last.turned(step_s).direction;
        let miss_rad = foretold.unit.angle(&direction.unit);
        let kept = MISS_KEPT * last.miss_rad(step_s).powi(2);
        let rate = last.direction.unit.cross(&direction.unit) / step_s;
        let follows = (step_s / RATE_FOLLOWS_S).min(1.0);
        Self {
            direction,
            at,
            arrived: at.by_arrival,
            turn_rad_per_s: last.turn_rad_per_s.lerp(&rate, follows),
            missed_rad: (kept + (1.0 - MISS_KEPT) * miss_rad.powi(2) / 2.0).sqrt(),
            after_s: step_s,
        }
    }

    /// The direction at the middle of another exposure, by how it turns, and less certain by what such a turn misses; `None` where the two
    /// are too far apart.
    pub fn at(self, moment: &Middle, max_age: Duration) -> Option<Direction> {
        let after_s = self.at.until(moment);
        let near = after_s.abs() <= max_age.as_secs_f64();
        near.then(|| {
            self.turned(after_s)
                .direction
                .loosened(self.miss_rad(after_s))
        })
    }

    fn turned(self, after_s: f64) -> Self {
        let turn = Rotation3::new(self.turn_rad_per_s * after_s);
        Self {
            direction: self.direction.turned(&turn),
            ..self
        }
    }

    /// By how much a turn misses after some time, 1 sigma per axis: in proportion to it, and to its square beyond the time that frames have told
    /// of. It cannot be worse than no turn at all.
    fn miss_rad(self, after_s: f64) -> f64 {
        let part = after_s.abs() / self.after_s;
        let still = (self.turn_rad_per_s.norm() + USUAL_RAD_PER_S) * after_s.abs();
        (self.missed_rad * part.max(part.powi(2))).min(still)
    }
}

#[derive(Clone)]
pub(super) struct RollSolver {
    pub station: Arc<Station>,
    pub camera: MountedCamera,
    pub outlet: Outlet,
    pub cameras_ended: Arc<AtomicBool>,
    pub latest: LatestNadir,
    pub tally: Shared<RollTally>,
    pub counters: Arc<Counters>,
}

impl RollSolver {
    /// Solves until the camera ends, or another thread has taken over.
    pub fn run(self, frames: &Receiver<UnsolvedFrame>, life: &Life) {
        let mut last = None;
        while let Some(frame) = UnsolvedFrame::next(frames, &self.cameras_ended, life) {
            let (middle, arrived) = (frame.middle, frame.arrived);
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
                SeenNadir {
                    arrived,
                    ..SeenNadir::next(before, in_body, middle)
                }
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
                moon: None,
                roll_deg,
                roll_arrived: Some(arrived),
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
                reasons::WRONG_SIZE,
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
                unsolved(frame, reasons::NOT_ABOVE_LIMB, height_m, limit_m)
            }
        }
    }

    fn note(&self, solution: &Solution) {
        match solution.quality() {
            Quality::Fine => self.counters.roll_fine.count(),
            Quality::Coarse => self.counters.roll_coarse.count(),
            Quality::None => self.counters.roll_none.count(),
        };
        let mut tally = self.tally.lock();
        if let Err(Stopped { stage, rejected }) = &solution.nadir {
            let count = tally.reasons.entry((*stage, rejected.reason)).or_default();
            *count += 1;
            if worth_a_line(*count) {
                let (stage, reason) = (stage.name(), rejected.reason.sentence);
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
fn unsolved(frame: &Frame, reason: Reason, measured: f64, limit: f64) -> Solution {
    let whole_px = frame.width().max(frame.height()) as f64;
    let rejected = Rejected {
        reason,
        measured,
        limit,
    };
    match Levels::of(frame, whole_px) {
        Ok(levels) => Solution {
            levels: Some(levels),
            ..Solution::none(at(Stage::Light)(rejected))
        },
        Err(light) => Solution::none(at(Stage::Light)(light)),
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
        (None, Err(stopped)) if stopped.rejected.reason == reasons::TOO_BRIGHT => {
            Brightness::Disc {
                level: 1.0,
                background: 1.0,
            }
        }
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
    use jiff::Timestamp;

    fn down(roll_rad: f64) -> Direction {
        let unit = Vector3::new(0.0, roll_rad.sin(), roll_rad.cos());
        Direction::new(UnitVector3::new_normalize(unit), 1e-4)
    }

    fn swing_rad(time_s: f64) -> f64 {
        0.02 * (std::f64::consts::TAU * time_s / 3.7).sin()
    }

    fn after(start: Instant, time_s: f64) -> Middle {
        Middle {
            utc: None,
            by_arrival: start + Duration::from_secs_f64(time_s),
        }
    }

    /// How far the direction of some frames is off a swing, and its sigma beside the frames' own, at a time.
    fn error_and_sigma(frames_s: &[f64], time_s: f64) -> Option<(f64, f64)> {
        let start = Instant::now();
        let mut seen = None;
        for frame_s in frames_s {
            let direction = down(swing_rad(*frame_s));
            seen = Some(SeenNadir::next(seen, direction, after(start, *frame_s)));
        }
        let found = seen?.at(&after(start, time_s), Duration::from_secs(1))?;
        let error = found.unit.y.asin() - swing_rad(time_s);
        Some((
            error.abs(),
            (found.sigma_rad().powi(2) - 1e-8).max(0.0).sqrt(),
        ))
    }

    #[test]
    fn frames_own_times_count_unless_the_clock_has_made_a_step() {
        let start = Instant::now();
        let middle = |utc_ms: i64, arrived_ms: u64| Middle {
            utc: Some(Timestamp::from_millisecond(utc_ms).unwrap()),
            by_arrival: start + Duration::from_millis(arrived_ms),
        };
        let first = middle(1_000_000, 3000);
        assert_eq!(first.until(&middle(1_000_250, 3900)), 0.25);
        assert_eq!(first.until(&middle(999_750, 2700)), -0.25);
        assert_eq!(first.until(&middle(4_600_250, 3300)), 0.3);
    }

    #[test]
    fn a_nadir_turns_on_as_the_body_does_and_is_as_certain_as_it_says() {
        let frames: Vec<f64> = (0..60).map(|n| f64::from(n) * 0.25).collect();
        let mut sum = 0.0;
        for count in 20..60 {
            let last_s = frames[count - 1];
            let (error, sigma) = error_and_sigma(&frames[..count], last_s + 0.25).unwrap();
            // Less than half of what it turns where it is fastest.
            assert!(error < 0.45 * 0.25 * 0.034, "{error}");
            sum += (error / sigma).powi(2);
        }
        let ratio = (sum / 40.0).sqrt();
        assert!((0.5..1.6).contains(&ratio), "{ratio}");
    }

    #[test]
    fn a_nadir_is_less_certain_the_further_away_it_is_and_serves_for_a_while() {
        let sigma = |frames_s: &[f64], time_s| Some(error_and_sigma(frames_s, time_s)?.1);
        let is = |sigma: Option<f64>, expected: f64| (sigma.unwrap() - expected).abs() < 1e-9;
        assert!(is(sigma(&[1.0], 1.0), 0.0));
        assert!(is(sigma(&[1.0], 1.5), 0.5 * USUAL_RAD_PER_S));
        // An exposure before it is as far away as one after it.
        assert!(is(sigma(&[1.0], 0.5), 0.5 * USUAL_RAD_PER_S));
        assert_eq!(sigma(&[1.0], 2.001), None);
        // After a gap nothing is known of how it turns.
        assert!(is(sigma(&[1.0, 1.5, 9.0], 9.5), 0.5 * USUAL_RAD_PER_S));
    }
}
