//! The path of the Sun's image: the gondola sways and slews, the Sun drifts over the plate, leaves the field and
//! returns.

use super::scene::SceneError;
use super::{Generator, Purpose, generator};
use crate::geometry::Mapping;
use crate::instrument::Instrument;
use crate::units::{PlateMil, SensorPx};
use nalgebra::Vector2;
use rand::RngExt;
use std::f64::consts::TAU;
use std::ops::Range;
use std::time::Duration;

/// The fastest slew of the gondola (Cramer 2014, section 4.2.1).
pub const MAX_SLEW_DEG_PER_S: f64 = 0.25;

/// Largest sway from the path, in each axis.
const SWAY_PX: f64 = 17.5;

/// Largest sway rate, both axes together.
const SWAY_PX_PER_S: f64 = 22.0;

/// The path of the Sun's image over the plate.
///
/// A path of rests and smooth slews (speed 1 - cos, so that acceleration is continuous) plus two swings in each
/// axis, like the pendulum of a gondola under its balloon. It is laid out on the sensor, so that the whole disc
/// stays in view outside the absence.
#[derive(Debug, Clone)]
pub struct Trajectory {
    mapping: Mapping,
    slews: Vec<Slew>,
    start: Vector2<f64>,
    swings: [[Swing; 2]; 2],
    /// Period of the path, s, if it repeats.
    cycle_s: Option<f64>,
}

#[derive(Debug, Clone)]
struct Slew {
    time_s: Range<f64>,
    from: Vector2<f64>,
    to: Vector2<f64>,
}

/// A harmonic motion, in the unit of its amplitude.
#[derive(Debug, Clone, Copy)]
pub(super) struct Swing {
    pub amplitude: f64,
    pub period_s: f64,
    /// Phase at the start, rad.
    pub phase: f64,
}

impl Trajectory {
    /// The demonstration's path: the Sun is absent only between 60 % and 75 % of `duration`.
    ///
    /// While the whole disc is in view its rate is at most [`MAX_SLEW_DEG_PER_S`]. In a run of less than about 2.5 minutes
    /// it crosses the edge of the field faster than that, as otherwise it could not leave and return in time.
    pub fn demo(
        instrument: &Instrument,
        radius_mil: f64,
        duration: Duration,
        seed: u64,
    ) -> Result<Self, SceneError> {
        let duration_s = duration.as_secs_f64().max(1e-3);
        let absence_s = 0.60 * duration_s..0.75 * duration_s;
        let mut plan = Plan::new(instrument, radius_mil, seed)?;
        plan.until_gone(&absence_s);
        plan.after_return(absence_s.end, duration_s);
        Ok(plan.trajectory(None))
    }

    /// A flight without end: it repeats every 15 minutes, and the Sun is absent for 45 s of each, 9 minutes in.
    pub fn flight(instrument: &Instrument, radius_mil: f64, seed: u64) -> Result<Self, SceneError> {
        const CYCLE_S: f64 = 900.0;
        let mut plan = Plan::new(instrument, radius_mil, seed)?;
        plan.until_gone(&(540.0..585.0));
        plan.after_return(585.0, CYCLE_S - 60.0);
        plan.back_to_the_start(CYCLE_S);
        Ok(plan.trajectory(Some(CYCLE_S)))
    }

    /// Position of the Sun on the plate, possibly outside the camera's view, `since_start` of the run.
    pub fn position(&self, since_start: Duration) -> PlateMil {
        self.mapping.to_plate(self.seen(since_start.as_secs_f64()))
    }

    /// Its velocity on the plate, mil/s.
    pub fn velocity_mil_per_s(&self, since_start: Duration) -> Vector2<f64> {
        let time_s = since_start.as_secs_f64();
        let (_, path) = self.path(self.in_cycle(time_s));
        let sway = self
            .swings
            .map(|axis| axis.iter().map(|s| s.speed(time_s)).sum());
        self.mapping.plate_jacobian(self.seen(time_s)) * (path + Vector2::from(sway))
    }

    fn seen(&self, time_s: f64) -> SensorPx {
        let (path, _) = self.path(self.in_cycle(time_s));
        let sway = self
            .swings
            .map(|axis| axis.iter().map(|s| s.offset(time_s)).sum());
        (path + Vector2::from(sway)).into()
    }

    fn in_cycle(&self, time_s: f64) -> f64 {
        self.cycle_s.map_or(time_s, |cycle| time_s % cycle)
    }

    /// Position and velocity on the path without sway, px and px/s.
    fn path(&self, time_s: f64) -> (Vector2<f64>, Vector2<f64>) {
        let begun = self.slews.partition_point(|s| s.time_s.start <= time_s);
        match begun.checked_sub(1).and_then(|last| self.slews.get(last)) {
            Some(slew) => slew.at(time_s),
            None => (self.start, Vector2::zeros()),
        }
    }
}

impl Slew {
    fn at(&self, time_s: f64) -> (Vector2<f64>, Vector2<f64>) {
        let length_s = self.time_s.end - self.time_s.start;
        let way = self.to - self.from;
        if time_s >= self.time_s.end {
            return (self.to, Vector2::zeros());
        }
        let part = (time_s - self.time_s.start) / length_s;
        let done = part - (TAU * part).sin() / TAU;
        let rate = (1.0 - (TAU * part).cos()) / length_s;
        (self.from + way * done, way * rate)
    }
}

impl Swing {
    pub(super) fn offset(&self, time_s: f64) -> f64 {
        self.amplitude * (TAU * time_s / self.period_s + self.phase).sin()
    }

    fn speed(&self, time_s: f64) -> f64 {
        let rate = TAU / self.period_s;
        self.amplitude * rate * (rate * time_s + self.phase).cos()
    }
}

/// A path under construction, px on the sensor.
struct Plan {
    mapping: Mapping,
    rng: Generator,
    /// Region where the path may rest: the middle of the plate, where many marks are lit.
    home: [Range<f64>; 2],
    /// The last place with the whole disc in view, on the way out.
    gate: Vector2<f64>,
    /// A place with no part of the disc in view.
    away: Vector2<f64>,
    slew_px_per_s: f64,
    start: Vector2<f64>,
    slews: Vec<Slew>,
}

impl Plan {
    fn new(instrument: &Instrument, radius_mil: f64, seed: u64) -> Result<Self, SceneError> {
        const HOME_MIL: [f64; 2] = [1400.0, 1100.0];
        let mapping = instrument.nominal_mapping().ok_or(SceneError::Mapping)?;
        let scale = instrument.mounting.scale_mil_per_px.value;
        let (centre, camera) = (instrument.mounting.plate_centre_px, &instrument.camera);
        let radius_px = radius_mil / scale;
        let edge = radius_px + SWAY_PX + uncertainty_px(instrument);
        let too_small = SceneError::TooSmall {
            width_px: camera.width_px,
            height_px: camera.height_px,
            radius_px,
        };
        let last = [camera.width_px as f64 - 1.0, camera.height_px as f64 - 1.0];
        if last.iter().any(|last| edge + 1.0 > last - edge) {
            return Err(too_small);
        }
        let middle = [centre.x, centre.y];
        let home = std::array::from_fn(|axis| {
            let reach = |v: f64| v.clamp(edge, last[axis] - edge);
            let half = HOME_MIL[axis] / scale;
            reach(middle[axis] - half)..reach(middle[axis] + half)
        });
        let mut rng = generator(seed, Purpose::Path, 0);
        let x = within(&mut rng, &home[0]);
        let upwards = middle[1] < last[1] / 2.0;
        let (gate, away) = if upwards {
            (edge, -edge)
        } else {
            (last[1] - edge, last[1] + edge)
        };
        let limit_px_per_s =
            MAX_SLEW_DEG_PER_S * 3600.0 / instrument.optics.arcsec_per_mil() / scale;
        Ok(Self {
            mapping,
            rng,
            home,
            gate: Vector2::new(x, gate),
            away: Vector2::new(x, away),
            slew_px_per_s: (0.97 * limit_px_per_s - SWAY_PX_PER_S).max(0.3 * limit_px_per_s),
            start: Vector2::new(x, gate),
            slews: Vec::new(),
        })
    }

    fn anywhere_at_home(&mut self) -> Vector2<f64> {
        let [x, y] = self.home.clone();
        Vector2::new(within(&mut self.rng, &x), within(&mut self.rng, &y))
    }

    fn rest_s(&mut self) -> f64 {
        self.rng.random_range(2.0..6.0)
    }

    /// Duration of a slew whose peak rate, twice its mean, is the largest allowed.
    fn slew_s(&self, from: Vector2<f64>, to: Vector2<f64>) -> f64 {
        2.0 * (to - from).norm() / self.slew_px_per_s
    }

    fn slew(&mut self, time_s: Range<f64>, from: Vector2<f64>, to: Vector2<f64>) {
        if time_s.end > time_s.start {
            self.slews.push(Slew { time_s, from, to });
        }
    }

    /// The path before and through the absence, constructed backwards from the moment the Sun leaves.
    fn until_gone(&mut self, absence_s: &Range<f64>) {
        let (mut time_s, mut to) = (absence_s.start, self.gate);
        while time_s > 0.0 {
            let mut from = self.anywhere_at_home();
            let needed_s = self.slew_s(from, to);
            let begin_s = (time_s - needed_s).max(0.0);
            // If the time does not suffice, start from a nearer place.
            if needed_s > time_s {
                from = to + (from - to) * (time_s / needed_s);
            }
            self.slew(begin_s..time_s, from, to);
            to = from;
            time_s = begin_s - self.rest_s();
        }
        self.start = to;
        self.slews.reverse();
        let longest_s = 0.4 * (absence_s.end - absence_s.start);
        let transit_s = self.slew_s(self.gate, self.away).min(longest_s);
        let (gate, away) = (self.gate, self.away);
        self.slew(absence_s.start..absence_s.start + transit_s, gate, away);
        self.slew(absence_s.end - transit_s..absence_s.end, away, gate);
    }

    fn after_return(&mut self, mut time_s: f64, end_s: f64) {
        let mut from = self.gate;
        while time_s < end_s {
            let to = self.anywhere_at_home();
            let arrival_s = time_s + self.slew_s(from, to);
            self.slew(time_s..arrival_s, from, to);
            from = to;
            time_s = arrival_s + self.rest_s();
        }
    }

    fn back_to_the_start(&mut self, end_s: f64) {
        if let Some(last) = self.slews.last() {
            let (from, to) = (last.to, self.start);
            let needed_s = self.slew_s(from, to);
            self.slew(end_s - needed_s..end_s, from, to);
        }
    }

    fn trajectory(mut self, cycle_s: Option<f64>) -> Trajectory {
        let mut swing = |amplitude: f64, period_s: Range<f64>| Swing {
            amplitude,
            period_s: self.rng.random_range(period_s),
            phase: self.rng.random_range(0.0..TAU),
        };
        let swings = std::array::from_fn(|_| [swing(14.0, 11.0..15.0), swing(3.5, 3.2..4.5)]);
        Trajectory {
            mapping: self.mapping,
            slews: self.slews,
            start: self.start,
            swings,
            cycle_s,
        }
    }
}

fn within(rng: &mut Generator, range: &Range<f64>) -> f64 {
    if range.is_empty() {
        range.start
    } else {
        rng.random_range(range.clone())
    }
}

/// Possible shift of the picture relative to the instrument's stated mapping, and a margin for the blur.
fn uncertainty_px(instrument: &Instrument) -> f64 {
    let (camera, mounting) = (&instrument.camera, &instrument.mounting);
    let half_diagonal = (camera.width_px as f64).hypot(camera.height_px as f64) / 2.0;
    let turn = mounting.rotation_deg.sigma.to_radians();
    let stretch = mounting.scale_mil_per_px.sigma / mounting.scale_mil_per_px.value;
    mounting.plate_centre_sigma_px + half_diagonal * (turn + stretch) + 5.0
}
