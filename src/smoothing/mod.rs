//! The Kalman filter and its smoother ([`Process`], [`smooth`]), and the path between frames that rests on them ([`path`], [`Path`]): fitted once,
//! asked often. The mapping's drift is such a process; the Sun's way over the plate, and the body's in roll and pitch, are such paths.
//!
//! A path is place, speed and acceleration, each axis on its own.
//!
//! Its unit is about the size of the frames' errors: a mil on the plate, a hundredth of a degree in roll and pitch.
//!
//! The acceleration is a random walk. How far it walks, the process noise, changes with what the gondola does: it rests, swings, begins
//! and ends a slew, steps. So each axis has a process noise of its own at every frame:
//!
//! 1. The path is smoothed with each of a scale of constant process noises.
//! 2. Each frame says how well each of them predicts it from all other frames: the logarithm of its likelihood.
//! 3. The noise of greatest likelihood over the flight, where every change has a price (Viterbi 1967), times nine
//!    for caution.
//!
//! 4. Swings of the gondola are sought beside it, each with a frequency, a damping time and a drive of its own, by maximum likelihood. Where
//!    they pay for themselves and explain most of the flight, they are part of the axis's motion, and the noise is chosen again from the least
//!    that suffices beside them.
//!
//! Too much process noise costs little at a frame, for the place then follows the frame's own; too little is wrong with
//! confidence.

mod kalman;
mod levels;
mod process;
mod swings;

pub use kalman::{Disturbance, Gaussian, Process, Step, log_likelihood, smooth};

use crate::estimation::median;
use levels::Levels;
use process::{Axis, LONGEST_GAP_S, Moments, Smoothed, Swing};
use serde::Serialize;
use swings::{Fit, Found, Stretch};

/// A place along an axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Measurement {
    pub place: f64,
    /// Of the moment's own error.
    pub variance: f64,
    /// Of the error that it shares with its neighbours.
    pub shared_variance: f64,
}

/// A moment of the path, with what was measured then, if anything was, in each axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Moment {
    pub time_s: f64,
    /// 1 sigma of the time of what was measured: along the path it is a place.
    pub time_sigma_s: f64,
    pub measured: Option<[Measurement; 2]>,
}

/// How long errors that neighbours share last: a Gauss-Markov process.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct SharedErrors {
    /// In which their correlation falls to 1/e.
    pub correlation_s: f64,
    /// When they are drawn again, in order.
    pub jumps_s: Vec<f64>,
}

impl SharedErrors {
    /// The correlation of the errors at two times, the earlier one first.
    fn kept(&self, before_s: f64, now_s: f64) -> f64 {
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
    /// The likeliest process noise, the median over moments and axes: square root of its density, unit/s^2.5. The acceleration walks
    /// by so many unit/s^2 in a second.
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
    /// In which its amplitude falls to 1/e where nothing drives it; none where that is not determined: a swing without damping explains the
    /// stretch of the flight by which it was found within 2 sigma.
    pub damping_s: Option<f64>,
    /// It is no shorter than that, by 2 sigma.
    pub damping_least_s: f64,
    /// Of its place over the flight.
    pub rms: f64,
}

/// Result for a swing's damping time from a stretch of a flight.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Damping {
    /// The likeliest; none where it may be any above the least.
    found_s: Option<f64>,
    /// The shortest within 2 sigma.
    least_s: f64,
}

/// The least process noise that gondolas without swings may have, unit/s^2.5.
const LEAST_NOISE: f64 = 0.1;
/// The noise that predicts best leaves a path that is off by as much by its stiffness as by the frames' errors: so many times
/// it, and only the errors are left.
const CAUTION: f64 = 9.0;

/// Swings must explain so much of the flight.
const CALM_PART: f64 = 0.8;

/// How an axis moves.
#[derive(Debug, Clone, PartialEq)]
struct Motion {
    swings: Vec<Swing>,
    /// Of each swing.
    dampings: Vec<Damping>,
    /// Of the step to each measured moment, the likeliest.
    noise: Vec<f64>,
    /// The least of these that is thought of.
    least: f64,
}

/// The smoothed path through moments in the order of time. `None` where nothing was measured.
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
    /// The path at any times in order, by its own motion; `None` outside what was measured and in gaps that are too long.
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

    /// The same, before, after and between what was measured: its variance grows with the distance in time. `None` where the filter fails.
    pub fn anywhere(&self, times_s: &[f64]) -> Option<Vec<PathPoint>> {
        self.points(times_s, Motion::cautious)
    }

    /// The same with the likeliest process noise: where to search, not what to state.
    pub fn likeliest(&self, times_s: &[f64]) -> Option<Vec<PathPoint>> {
        self.points(times_s, |_, noise| noise)
    }

    /// The path at times in order. The errors of the times of neighbours may be correlated: smoothing does not reduce what that adds.
    fn points(&self, times_s: &[f64], noise: fn(&Motion, f64) -> f64) -> Option<Vec<PathPoint>> {
        let moments = Moments::asked(&self.measured, times_s);
        let along = |axis: usize| {
            let mut found = Vec::with_capacity(times_s.len());
            self.smooth(axis, &moments, noise, |n, state| {
                if moments.is_asked(n) {
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

    /// An axis at moments in order, from the last to the first.
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

    /// The swings of an axis, as they are along the path.
    fn found(&self, axis: usize) -> Option<Vec<FoundSwing>> {
        let Motion {
            swings, dampings, ..
        } = &self.axes[axis];
        let mut squares = vec![0.0; swings.len()];
        if !swings.is_empty() {
            let moments = Moments::Measured(&self.measured);
            self.smooth(axis, &moments, Motion::cautious, |_, state| {
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
    /// Where swings suffice, the walk's noise beside them is not doubted.
    fn cautious(&self, noise: f64) -> f64 {
        match !self.swings.is_empty() && self.suffices(noise) {
            true => noise,
            false => CAUTION * noise,
        }
    }

    fn suffices(&self, noise: f64) -> bool {
        noise < 1.01 * self.least
    }
}

/// How the measured moments say that an axis moves.
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
    let fit = Stretch::of(measured, &without.noise, axis, shared).and_then(|stretch| stretch.fit());
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
    // Swings of a part of the flight would loosen the path in the rest of it.
    let calm = swinging
        .noise
        .iter()
        .filter(|noise| swinging.suffices(**noise));
    match calm.count() as f64 > CALM_PART * measured.len() as f64
        && likelihood(&swinging) > likelihood(&without)
    {
        true => swinging,
        false => without,
    }
}
