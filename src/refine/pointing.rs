//! The pointing of a flight as a function of time. Its states are the attitude by gyros where available, else the smoothed path of the
//! Sun with the roll.

use super::history::History;
use super::path::is_known;
use super::roll::{RollHistory, SmoothedRoll};
use super::sky::roll_by;
use crate::geometry::earth::{ecef_m, geodetic, north_east_up};
use crate::instrument::Instrument;
use crate::observe::JournalError;
use crate::pointing::{
    Roll, TelescopeAttitude, body_nadir, solar_north, sun_direction, telescope_attitude,
};
use crate::pointing_history::{Basis, PointingHistory, Second, State};
use crate::sky::{Ephemeris, SunPosition};
use crate::smoothing::PathPoint;
use crate::units::{Estimate, Measured, Place};
use jiff::Timestamp;
use nalgebra::{Matrix2, Matrix3, Rotation3, UnitQuaternion, UnitVector3, Vector2, Vector3};
use rayon::prelude::*;

/// Longest step between states between frames, s: a cubic reproduces a swing of 1 s period to a thousandth of its amplitude.
const STEP_S: f64 = 0.1;
/// No states are made in longer gaps between frames, s.
const LONGEST_STEP_S: f64 = 10.0;
/// The path is used where no gyro state is this near, s.
const NEAR_S: f64 = 1.0;
/// States that share an ephemeris, whose costly part is done once a second.
const TOGETHER: usize = 1024;
/// Half of the interval over which a rate is computed from the rotation, s.
const INSTANT_S: f64 = 1e-3;

/// Slowly changing quantities: stored once in each second that has a state.
#[derive(Debug, Clone, Copy)]
pub(super) struct Slow {
    pub unix_s: f64,
    /// Position in ECEF, m.
    pub position_m: Vector3<f64>,
    /// Covariance of the calibration, as in [`Second`].
    pub systematic_rad2: Matrix3<f64>,
}

/// States in the order of time, with the slowly changing quantities.
#[derive(Debug, Clone, Default)]
pub(super) struct States {
    pub states: Vec<State>,
    slow: Vec<Slow>,
}

impl States {
    /// Appends a state; `slow` is called once a second.
    pub fn push(&mut self, state: State, slow: impl FnOnce() -> Slow) {
        let second = state.unix_s.floor();
        if self
            .slow
            .last()
            .is_none_or(|last| last.unix_s.floor() < second)
        {
            self.slow.push(slow());
        }
        self.states.push(state);
    }

    /// Merges these states with others at other times.
    fn and(mut self, others: &Self) -> Self {
        self.states.extend_from_slice(&others.states);
        self.states.sort_by(|a, b| a.unix_s.total_cmp(&b.unix_s));
        self.states.dedup_by_key(|state| state.unix_s);
        self.slow.extend_from_slice(&others.slow);
        self.slow.sort_by(|a, b| a.unix_s.total_cmp(&b.unix_s));
        self
    }
}

impl History {
    /// Telescope pointing as a function of time: the smoothed path of the Sun, with the roll camera's roll where it is given and near;
    /// otherwise with the mean roll by gyros from the rest of the flight, or the roll stated by the instrument.
    ///
    /// # Errors
    /// If a journal cannot be read.
    pub fn pointing(&self, roll: Option<&RollHistory>) -> Result<PointingHistory, JournalError> {
        self.pointing_with(roll, &States::default())
    }

    /// The same, with gyro states where these exist.
    pub(super) fn pointing_with(
        &self,
        roll: Option<&RollHistory>,
        by_gyros: &States,
    ) -> Result<PointingHistory, JournalError> {
        let mut times_s = times_s(self);
        times_s.retain(|time_s| nearest(&by_gyros.states, |s| s.unix_s, *time_s).is_none());
        let ephemeris = &self.sky().ephemeris;
        let mean_roll_deg = mean_roll_deg(by_gyros);
        let all = by_path(self, roll, mean_roll_deg, &times_s)?.and(by_gyros);
        let seconds = seconds(&all, ephemeris);
        Ok(PointingHistory::new(all.states, seconds))
    }
}

/// Roll measured by gyros in the flight, deg: its mean, and its scatter as 1 sigma. `None` without gyros.
fn mean_roll_deg(by_gyros: &States) -> Option<Measured> {
    let roll_deg = |slow: &Slow| {
        let state = nearest(&by_gyros.states, |state| state.unix_s, slow.unix_s)?;
        let up = north_east_up(&slow.position_m).column(2).into_owned();
        let up = state.attitude.inverse_transform_vector(&up);
        Some((-up.y).atan2(-up.z).to_degrees())
    };
    let rolls_deg: Vec<f64> = by_gyros.slow.iter().filter_map(roll_deg).collect();
    let count = rolls_deg.len() as f64;
    let mean = rolls_deg.iter().sum::<f64>() / count;
    let square = rolls_deg
        .iter()
        .map(|roll| (roll - mean).powi(2))
        .sum::<f64>()
        / count;
    (count > 0.0).then(|| Measured::new(mean, square.sqrt()))
}

/// The item nearest in time, of items in the order of time, if it is near.
pub(super) fn nearest<T>(things: &[T], time: impl Fn(&T) -> f64, time_s: f64) -> Option<&T> {
    let next = things.partition_point(|thing| time(thing) < time_s);
    let both = things[next.saturating_sub(1)..].iter().take(2);
    let away = |thing: &&T| (time(thing) - time_s).abs();
    let nearest = both.min_by(|a, b| away(a).total_cmp(&away(b)));
    nearest.filter(|thing| away(thing) <= NEAR_S)
}

/// Times of the path's states: those of the frames, and equal steps between.
fn times_s(history: &History) -> Vec<f64> {
    let frames: Vec<f64> = history.frame_times_s().collect();
    let mut times_s = Vec::new();
    for pair in frames.windows(2) {
        let length_s = pair[1] - pair[0];
        let steps = match length_s > LONGEST_STEP_S {
            true => 1.0,
            false => (length_s / STEP_S).ceil(),
        };
        times_s.extend((0..steps as u32).map(|n| pair[0] + length_s * f64::from(n) / steps));
    }
    times_s.extend(frames.last());
    times_s
}

/// The states along the path.
fn by_path(
    history: &History,
    roll: Option<&RollHistory>,
    mean_roll_deg: Option<Measured>,
    times_s: &[f64],
) -> Result<States, JournalError> {
    let Some((path, (first_s, _))) = history.path().zip(history.path_times_s()) else {
        return Ok(States::default());
    };
    let since_first: Vec<f64> = times_s.iter().map(|time_s| time_s - first_s).collect();
    let points = path.at(&since_first);
    let rolls = roll.map(|roll| roll.at(times_s));
    let places = history.places()?;
    let sky = history.sky();
    let moment = |n: usize| {
        Some(Moment {
            unix_s: times_s[n],
            point: points[n].filter(is_known)?,
            roll: rolls.as_ref().and_then(|rolls| rolls[n]),
            mean_roll_deg,
            place: place_before(&places, times_s[n]).or(sky.place)?,
            instrument: history.instrument(),
        })
    };
    let chunks = (0..times_s.len()).into_par_iter().chunks(TOGETHER);
    let stated = chunks.flat_map_iter(|chunk| {
        let mut ephemeris = sky.ephemeris.clone();
        let stated = chunk
            .into_iter()
            .filter_map(|n| moment(n)?.state(&mut ephemeris));
        let mut states = States::default();
        stated.for_each(|(state, slow)| states.push(state, || slow));
        [states]
    });
    let mut all = States::default();
    for mut part in stated.collect::<Vec<States>>() {
        all.states.append(&mut part.states);
        all.slow.append(&mut part.slow);
    }
    Ok(all)
}

/// Position of the last frame before a time.
fn place_before(places: &[(f64, Place)], time_s: f64) -> Option<Place> {
    let later = places.partition_point(|(taken_s, _)| *taken_s <= time_s);
    Some(places.get(later.checked_sub(1)?)?.1)
}

/// Measurements that determine the attitude at a moment of the path.
struct Moment<'a> {
    unix_s: f64,
    point: PathPoint,
    roll: Option<SmoothedRoll>,
    /// Used where the roll is not measured.
    mean_roll_deg: Option<Measured>,
    place: Place,
    instrument: &'a Instrument,
}

impl Moment<'_> {
    fn state(&self, ephemeris: &mut Ephemeris) -> Option<(State, Slow)> {
        let position_m = ecef_m(&self.place);
        let to_earth = |of: &TelescopeAttitude| {
            let axes = north_east_up(&position_m);
            let flip = Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, -1.0));
            let turn = Rotation3::from_matrix_unchecked(axes * flip) * of.turn;
            UnitQuaternion::from_rotation_matrix(&turn)
        };
        let now = self.attitude(0.0, ephemeris)?;
        let [before, after] =
            [-INSTANT_S, INSTANT_S].map(|later_s| self.attitude(later_s, ephemeris));
        let turned = to_earth(&before?).inverse() * to_earth(&after?);
        let state = State {
            unix_s: self.unix_s,
            attitude: to_earth(&now),
            rate_rad_s: turned.scaled_axis() / (2.0 * INSTANT_S),
            covariance_rad2: now.random_rad2,
            basis: Basis::Sun,
            is_contradicted: false,
        };
        let slow = Slow {
            unix_s: self.unix_s,
            position_m,
            systematic_rad2: now.systematic_rad2,
        };
        Some((state, slow))
    }

    /// The attitude a little later, extrapolated with the motion of Sun and body.
    fn attitude(&self, later_s: f64, ephemeris: &mut Ephemeris) -> Option<TelescopeAttitude> {
        let sun = sun_at(self.unix_s + later_s, self.place, ephemeris)?;
        let place = Vector2::from(self.point.place) + Vector2::from(self.point.speed) * later_s;
        let sun_on_plate = Estimate {
            position: place.into(),
            covariance: Matrix2::from_diagonal(&self.point.variance.into()),
        };
        let nadir = self.roll.map(|roll| {
            let [roll_rate, pitch_rate] = roll.rates_deg_per_s;
            let moved = |angle: Measured, rate: f64| {
                Measured::new(angle.value + rate * later_s, angle.sigma)
            };
            body_nadir(
                moved(roll.roll_deg, roll_rate),
                moved(roll.pitch_deg, pitch_rate),
            )
        });
        let roll = roll_by(nadir.as_ref(), sun_on_plate.position, self.instrument, &sun);
        let roll = match (roll, self.mean_roll_deg) {
            (Roll::Stated, Some(mean)) => Roll::Measured(mean),
            (known, _) => known,
        };
        telescope_attitude(&sun_on_plate, roll, self.instrument, &sun).ok()
    }
}

fn sun_at(unix_s: f64, place: Place, ephemeris: &mut Ephemeris) -> Option<SunPosition> {
    let utc = Timestamp::from_nanosecond((unix_s * 1e9) as i128).ok()?;
    ephemeris.sun(utc, place).ok()
}

/// The whole seconds that span the states, in the order of time.
fn seconds(of: &States, ephemeris: &Ephemeris) -> Vec<Second> {
    let ends = of.states.first().zip(of.states.last());
    let Some(ends_s) = ends.map(|(first, last)| [first.unix_s.floor(), last.unix_s.ceil()]) else {
        return Vec::new();
    };
    let [first, last] = ends_s.map(|time_s| time_s as i64);
    let second = |unix_s: i64, ephemeris: &mut Ephemeris| {
        let near = nearest(&of.slow, |slow| slow.unix_s, unix_s as f64)?;
        let place = geodetic(&near.position_m)?;
        let sun = sun_at(unix_s as f64, place, ephemeris)?;
        let axes = north_east_up(&near.position_m);
        let towards = |v: Vector3<f64>| UnitVector3::new_normalize(axes * v);
        Some(Second {
            unix_s,
            position_m: near.position_m,
            to_sun: towards(sun_direction(&sun)),
            north: towards(solar_north(&sun)),
            systematic_rad2: near.systematic_rad2,
        })
    };
    let all: Vec<i64> = (first..=last).collect();
    let chunks = all.par_chunks(TOGETHER);
    let seconds = chunks.flat_map_iter(|chunk| {
        let mut ephemeris = ephemeris.clone();
        let seconds = chunk
            .iter()
            .filter_map(|unix_s| second(*unix_s, &mut ephemeris));
        seconds.collect::<Vec<Second>>()
    });
    seconds.collect()
}
