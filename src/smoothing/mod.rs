//! The Kalman filter and its smoother ([`Process`], [`smooth`]), and the path between frames based on them ([`path`], [`Path`]): fitted
//! once, evaluated often. The mapping's drift is such a process; the Sun's path over the plate, and the body's in roll and pitch, are
//! such paths.
//!
//! A path has position, speed and acceleration; its axes are independent.
//!
//! Its unit is about the size of the frames' errors: a mil on the plate, a hundredth of a degree in roll and pitch.
//!
//! The acceleration is a random walk. Its process noise changes with the state of the gondola: it rests, swings, begins
//! and ends a slew, steps. So each axis has its own process noise at every frame:
//!
//! 1. The path is smoothed with each of a geometric series of constant process noises.
//! 2. Each of them is scored at each frame: the logarithm of the frame's likelihood given all other frames.
//! 3. The sequence of noises with the greatest likelihood over the flight, where every change has a cost (Viterbi 1967), is multiplied
//!    by nine as a safety factor.
//!
//! 4. Swings of the gondola are added to the random walk, each with its own frequency, damping time and drive, by maximum likelihood. If they
//!    improve the likelihood by more than their cost and explain most of the flight, they become part of the axis's motion, and the noise is
//!    chosen again from the least that suffices with them.
//!
//! Too much process noise costs little at a frame, because the position then follows the frame's own; too little gives wrong positions with
//! small sigmas.

mod kalman;
mod levels;
mod process;
mod swings;

pub use kalman::{Disturbance, Gaussian, Process, Step, log_likelihood, smooth};

use crate::estimation::median;
use levels::Levels;
use process::{Axis, LONGEST_GAP_S, Moments, Smoothed, Swing};
use serde::Serialize;
use swings::{Fit, Found, Segment};

/// A measured position along an axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Measurement {
    pub place: f64,
    /// Variance of the moment's own error.
    pub variance: f64,
    /// Variance of the error shared with its neighbours.
    pub shared_variance: f64,
}

/// A moment of the path, with the measurements of both axes, if any.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Moment {
    pub time_s: f64,
    /// 1 sigma of the measurement's time: with the path's speed it becomes a position error.
    pub time_sigma_s: f64,
    pub measured: Option<[Measurement; 2]>,
}

/// Correlation of the errors shared by neighbours: a Gauss-Markov process.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct SharedErrors {
    /// Time in which their correlation falls to 1/e.
    pub correlation_s: f64,
    /// Times at which they become independent, in order.
    pub jumps_s: Vec<f64>,
}

impl SharedErrors {
    /// The correlation of the errors at two times, the earlier one first.
    fn correlation(&self, before_s: f64, now_s: f64) -> f64 {
        let jumps = |until_s: f64| self.jumps_s.partition_point(|jump_s| *jump_s <= until_s);
        if self.correlation_s <= 0.0 || jumps(before_s) != jumps(now_s) {
            return 0.0;
        }
        ((before_s - now_s) / self.correlation_s).exp()
    }
}

/// The path at a moment, per axis: place, its variance, and speed a second.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PathPoint {
    pub place: [f64; 2],
    pub variance: [f64; 2],
    pub speed: [f64; 2],
}

/// The path of a flight.
#[derive(Debug, Clone, PartialEq)]
pub struct Path {
    /// The median over moments and axes of the most likely process noise: square root of its density, unit/s^2.5. The acceleration
    /// changes by this many unit/s^2 in a second, 1 sigma.
    pub process_noise: f64,
    /// The swings of each axis.
    pub swings: [Vec<FoundSwing>; 2],
    axes: [Motion; 2],
    shared: SharedErrors,
    measured: Vec<Moment>,
}

/// A swing of the gondola along an axis.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct FoundSwing {
    pub period_s: f64,
    /// Time in which its amplitude falls to 1/e without a drive; none if that is not determined: an undamped swing then explains the
    /// stretch of the flight from which it was determined within 2 sigma.
    pub damping_s: Option<f64>,
    /// Lower limit of the damping time, 2 sigma.
    pub damping_least_s: f64,
    /// Rms of its displacement over the flight.
    pub rms: f64,
}

/// A swing's damping time from a stretch of a flight.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Damping {
    /// The most likely value; none if any value above the least is possible.
    found_s: Option<f64>,
    /// The shortest value within 2 sigma.
    least_s: f64,
}

/// The least process noise of gondolas without swings, unit/s^2.5.
const LEAST_NOISE: f64 = 0.1;
/// The noise that predicts best gives a path whose error from its stiffness equals that from the frames' errors: with this multiple of it
/// only the latter remain.
const SAFETY_FACTOR: f64 = 9.0;

/// Swings must explain this part of the flight.
const CALM_PART: f64 = 0.8;

/// Model of an axis's motion.
#[derive(Debug, Clone, PartialEq)]
struct Motion {
    swings: Vec<Swing>,
    /// Damping time of each swing.
    dampings: Vec<Damping>,
    /// Most likely process noise of the step to each measured moment.
    noise: Vec<f64>,
    /// The least process noise considered.
    least: f64,
}

/// The smoothed path through moments in the order of time. `None` if nothing was measured.
pub fn path(moments: impl IntoIterator<Item = Moment>, shared: SharedErrors) -> Option<Path> {
    let moments = moments.into_iter();
    let measured: Vec<Moment> = moments.filter(|m| m.measured.is_some()).collect();
    measured.first()?;
    let (x, y) = rayon::join(
        || motion(&measured, 0, &shared),
        || motion(&measured, 1, &shared),
    );
    let path = Path {
        process_noise: median(x.noise.iter().chain(&y.noise))?,
        swings: [Vec::new(), Vec::new()],
        axes: [x, y],
        shared,
        measured,
    };
    let swings = [path.found(0)?, path.found(1)?];
    Some(Path { swings, ..path })
}

impl Path {
    /// The path at times in order, from its own motion; `None` outside the measurements and in gaps that are too long.
    pub fn at(&self, times_s: &[f64]) -> Vec<Option<PathPoint>> {
        let is_within = |time_s: f64| {
            let after = self.measured.partition_point(|m| m.time_s < time_s);
            let last = self.measured.get(after)?;
            let first = match last.time_s == time_s {
                true => last,
                false => &self.measured[after.checked_sub(1)?],
            };
            (last.time_s - first.time_s <= LONGEST_GAP_S).then_some(())
        };
        let Some(points) = self.anywhere(times_s) else {
            return vec![None; times_s.len()];
        };
        let points = points.into_iter().zip(times_s);
        points
            .map(|(point, time_s)| is_within(*time_s).map(|()| point))
            .collect()
    }

    /// The same before, after and between measurements: the variance increases with the distance in time. `None` if the filter fails.
    pub fn anywhere(&self, times_s: &[f64]) -> Option<Vec<PathPoint>> {
        self.points(times_s, Motion::with_safety_factor)
    }

    /// The same with the most likely process noise: for search areas, not for results.
    pub fn likeliest(&self, times_s: &[f64]) -> Option<Vec<PathPoint>> {
        self.points(times_s, |_, noise| noise)
    }

    /// The path at times in order. Errors of the times of neighbours may be correlated: smoothing does not reduce their contribution.
    fn points(&self, times_s: &[f64], noise: fn(&Motion, f64) -> f64) -> Option<Vec<PathPoint>> {
        let moments = Moments::requested(&self.measured, times_s);
        let along = |axis: usize| {
            let mut found = Vec::with_capacity(times_s.len());
            self.smooth(axis, &moments, noise, |n, state| {
                if moments.is_requested(n) {
                    found.push([state.place, state.variance, state.speed]);
                }
            })?;
            found.reverse();
            Some(found)
        };
        let (x, y) = rayon::join(|| along(0), || along(1));
        let (x, y) = x.zip(y)?;
        let mut next = 0;
        let point = |((time_s, x), y): ((&f64, [f64; 3]), [f64; 3])| {
            let is_before = |m: &&Moment| m.time_s < *time_s;
            next += self.measured[next..].iter().take_while(is_before).count();
            let near = &self.measured[next.saturating_sub(1)..self.measured.len().min(next + 1)];
            let sigma_s = near
                .iter()
                .fold(0.0_f64, |most, m| most.max(m.time_sigma_s));
            let variance = |[_, variance, speed]: [f64; 3]| variance + (speed * sigma_s).powi(2);
            PathPoint {
                place: [x[0], y[0]],
                variance: [variance(x), variance(y)],
                speed: [x[2], y[2]],
            }
        };
        Some(times_s.iter().zip(x).zip(y).map(point).collect())
    }

    /// Smooths an axis at moments in order, from the last to the first.
    fn smooth(
        &self,
        axis: usize,
        moments: &Moments<'_>,
        noise: fn(&Motion, f64) -> f64,
        each: impl FnMut(usize, &Smoothed),
    ) -> Option<()> {
        let motion = &self.axes[axis];
        let mut step = 0;
        let noises = (0..moments.len()).map(|n| {
            let time_s = moments.time_s(n);
            let is_before = |m: &&Moment| m.time_s < time_s;
            step += self.measured[step..].iter().take_while(is_before).count();
            noise(motion, motion.noise[step.min(self.measured.len() - 1)])
        });
        let along = Axis {
            moments,
            axis,
            shared: &self.shared,
            swings: &motion.swings,
            process_noise: &noises.collect::<Vec<f64>>(),
        };
        along.smooth(each)
    }

    /// The swings of an axis, evaluated along the path.
    fn found(&self, axis: usize) -> Option<Vec<FoundSwing>> {
        let Motion {
            swings, dampings, ..
        } = &self.axes[axis];
        let mut squares = vec![0.0; swings.len()];
        if !swings.is_empty() {
            let moments = Moments::Measured(&self.measured);
            self.smooth(axis, &moments, Motion::with_safety_factor, |_, state| {
                let places = squares.iter_mut().zip(state.swings);
                places.for_each(|(sum, place)| *sum += place.powi(2));
            })?;
        }
        let found = |((swing, damping), squares): ((&Swing, &Damping), f64)| FoundSwing {
            period_s: swing.period_s(),
            damping_s: damping.found_s,
            damping_least_s: damping.least_s,
            rms: (squares / self.measured.len() as f64).sqrt(),
        };
        let swings = swings.iter().zip(dampings).zip(squares);
        Some(swings.map(found).collect())
    }
}

impl Motion {
    /// If the swings suffice, the safety factor is not applied to the remaining process noise.
    fn with_safety_factor(&self, noise: f64) -> f64 {
        match !self.swings.is_empty() && self.swings_explain(noise) {
            true => noise,
            false => SAFETY_FACTOR * noise,
        }
    }

    fn swings_explain(&self, noise: f64) -> bool {
        noise < 1.01 * self.least
    }
}

/// Determines the motion model of an axis from the measured moments.
fn motion(measured: &[Moment], axis: usize, shared: &SharedErrors) -> Motion {
    let with = |swings: Vec<Swing>, dampings: Vec<Damping>, least: f64| {
        let levels = Levels {
            measured,
            axis,
            shared,
            swings: &swings,
            least,
        };
        let noise = levels.likeliest();
        Motion {
            swings,
            dampings,
            noise,
            least,
        }
    };
    let without = with(Vec::new(), Vec::new(), LEAST_NOISE);
    let fit = Segment::of(measured, &without.noise, axis, shared).and_then(|segment| segment.fit());
    let Some(Found {
        fit: Fit {
            process_noise,
            swings,
        },
        dampings,
    }) = fit.filter(|found| !found.dampings.is_empty())
    else {
        return without;
    };
    let swinging = with(swings, dampings, process_noise);
    let likelihood = |motion: &Motion| {
        let along = Axis {
            moments: &Moments::Measured(measured),
            axis,
            shared,
            swings: &motion.swings,
            process_noise: &motion.noise,
        };
        along.log_likelihood().unwrap_or(f64::NEG_INFINITY)
    };
    // Swings during a part of the flight would increase the path's uncertainty in the rest of it.
    let calm = swinging
        .noise
        .iter()
        .filter(|noise| swinging.swings_explain(**noise));
    match calm.count() as f64 > CALM_PART * measured.len() as f64
        && likelihood(&swinging) > likelihood(&without)
    {
        true => swinging,
        false => without,
    }
}
