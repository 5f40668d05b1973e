//! Whether the cameras agree with the gyros: how far a direction is from where the attitude predicts it, in its sigmas, by axis of the telescope.
//!
//! The filter itself cannot report a contradiction that lasts: `doubts` has it follow the directions after two of them, whichever is wrong
//! (status [`Contradicted`](super::Status::Contradicted), for seconds). Both begin with the same direction: one that is beyond 5 sigma on an
//! axis has a chi^2 above 18, and the filter refuses it. From then on the attitude of before is carried on beside the filter, by the
//! gyros, fixes and the directions that agree with it. What is compared is compared with that attitude, until the directions agree with both.

use super::filter::{Filter, Trust};
use super::measurement::{Innovation, Measurement, Source};
use super::motion::Interval;
use super::settings::Target;
use serde::Serialize;
use std::collections::BTreeMap;

/// A difference of more sigmas is a contradiction: of good ones 1 in 1.7 million is.
pub const MOST_SIGMAS: f64 = 5.0;
/// One that lasts so long is a finding, s.
pub const LASTING_S: f64 = 10.0;
/// The attitude of before is carried on for so long at most, s: a jump of the gyros that is over must not be an alarm for the whole flight.
const CARRIED_S: f64 = 600.0;

/// An axis of the telescope along which the Sun, or about which the nadir, is compared.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Axis {
    /// The Sun, along the telescope's right.
    Right,
    /// The Sun, along the telescope's up.
    Up,
    /// The nadir, along the telescope's right: the roll about the boresight, positive with the right side low.
    Roll,
}

impl Axis {
    pub const ALL: [Self; 3] = [Self::Right, Self::Up, Self::Roll];

    pub fn name(self) -> &'static str {
        match self {
            Self::Right => "right",
            Self::Up => "up",
            Self::Roll => "roll",
        }
    }

    /// The axes that a target measures, in the order of an innovation's.
    fn measured_by(target: Target) -> &'static [Self] {
        match target {
            Target::Sun => &[Self::Right, Self::Up],
            // The Sun measures the other one far better.
            Target::Nadir => &[Self::Roll],
            Target::Moon => &[],
        }
    }
}

/// The latest difference of a camera from the gyros along an axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Difference {
    pub t_s: f64,
    /// Measured minus predicted, in the 1 sigma of that.
    pub sigmas: f64,
    /// Since when all of them have been beyond 5 sigma.
    pub beyond_since_s: Option<f64>,
}

impl Difference {
    /// Whether they have been beyond 5 sigma for 10 s or more.
    pub fn lasts(&self) -> bool {
        let beyond_s = self.beyond_since_s.map(|since_s| self.t_s - since_s);
        beyond_s.is_some_and(|beyond_s| beyond_s >= LASTING_S)
    }
}

/// How cameras and gyros agree.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Agreement {
    /// No direction is beyond 5 sigma.
    Within,
    /// One is, for less than 10 s so far.
    Beyond,
    /// For 10 s or more.
    LastingContradiction,
}

/// Cameras compared with the gyros.
#[derive(Debug, Clone, Default)]
pub struct Comparison {
    /// By axis, and by camera of the settings.
    latest: BTreeMap<(Axis, usize), Difference>,
    carried: Option<Carried>,
}

/// The attitude that directions contradict.
#[derive(Debug, Clone)]
struct Carried {
    since_s: f64,
    filter: Box<Filter>,
}

impl Comparison {
    /// The latest differences by axis and camera of the settings; none before the start.
    pub fn latest(&self) -> impl Iterator<Item = (Axis, usize, &Difference)> {
        let all = self.latest.iter();
        all.map(|((axis, camera), difference)| (*axis, *camera, difference))
    }

    /// The latest difference along an axis, in its sigmas: the largest of the cameras'.
    pub fn sigmas(&self, axis: Axis) -> Option<f64> {
        let own = self.latest().filter(|(of, ..)| *of == axis);
        own.map(|(.., difference)| difference.sigmas)
            .max_by(|a, b| a.abs().total_cmp(&b.abs()))
    }

    /// The worst of all axes and cameras; `None` where nothing is compared.
    pub fn agreement(&self) -> Option<Agreement> {
        let of_one = |difference: &Difference| match difference.beyond_since_s {
            None => Agreement::Within,
            Some(_) if difference.lasts() => Agreement::LastingContradiction,
            Some(_) => Agreement::Beyond,
        };
        self.latest.values().map(of_one).max()
    }

    /// Carries the attitude of before on over an interval, as the IMU has said it.
    pub(super) fn advance(&mut self, said: &Interval) {
        if let Some(carried) = &mut self.carried {
            carried.filter.advance(said);
        }
    }

    /// Compares what the filter has made of a direction; the attitude of one that contradicts it is kept as it is now.
    pub(super) fn note(&mut self, innovation: &Innovation, filter: &Filter) {
        if self.carried.is_some() {
            return;
        }
        self.compare(innovation);
        if self.is_beyond() {
            self.carried = Some(Carried {
                since_s: innovation.t_s,
                filter: Box::new(filter.clone()),
            });
        }
    }

    /// Compares a measurement with the attitude of before, where there is one; `is_settled` says that the filter takes all directions
    /// without a doubt. `white_rad` is the part of a direction's error that is white.
    pub(super) fn take(&mut self, measurement: &Measurement, white_rad: f64, is_settled: bool) {
        let Some(carried) = &mut self.carried else {
            return;
        };
        if measurement.t_s() - carried.since_s > CARRIED_S {
            *self = Self::default();
            return;
        }
        let innovation = match measurement {
            Measurement::Fix(fix) => {
                carried.filter.take_fix(fix);
                return;
            }
            Measurement::Direction(observation) => {
                let filter = &mut carried.filter;
                filter.take_direction(observation, white_rad, Trust::Tested)
            }
        };
        innovation.iter().for_each(|one| self.compare(one));
        if is_settled && !self.is_beyond() {
            self.carried = None;
        }
    }

    /// The filter restarts: what cameras show is compared with the attitude of before, if there is one, else with nothing.
    pub(super) fn restart(&mut self) {
        if self.carried.is_none() {
            self.latest.clear();
        }
    }

    fn is_beyond(&self) -> bool {
        self.agreement() > Some(Agreement::Within)
    }

    fn compare(&mut self, innovation: &Innovation) {
        let Source::Direction { camera, target } = innovation.source else {
            return;
        };
        let axes = Axis::measured_by(target).iter().zip(&innovation.axes);
        for (axis, (residual_rad, sigma_rad)) in axes {
            let (t_s, sigmas) = (innovation.t_s, residual_rad / sigma_rad);
            let before = self.latest.get(&(*axis, camera));
            let since_s = before.and_then(|before| before.beyond_since_s);
            let difference = Difference {
                t_s,
                sigmas,
                beyond_since_s: (sigmas.abs() > MOST_SIGMAS).then(|| since_s.unwrap_or(t_s)),
            };
            self.latest.insert((*axis, camera), difference);
        }
    }
}
