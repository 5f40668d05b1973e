//! Comparison of the cameras with the gyros: the difference of a direction from the prediction of the attitude, in its
//! sigmas, by axis of the telescope.
//!
//! The filter itself cannot report a lasting contradiction: after two contradicting directions `doubts` makes it follow the
//! directions, whichever side is wrong (status [`Contradicted`](super::Status::Contradicted), for seconds). Both start with
//! the same direction: one that differs by more than 5 sigma on an axis has a chi^2 above 18, and the filter rejects it.
//! From then on the previous attitude is propagated in parallel with the filter, by the gyros, fixes and the directions
//! that agree with it. Directions are compared with that attitude until they agree with both.

use super::filter::{Filter, Trust};
use super::measurement::{Innovation, Measurement, Source};
use super::motion::Interval;
use super::settings::Target;
use serde::Serialize;
use std::collections::BTreeMap;

/// A difference of more sigmas is a contradiction: the probability is 1 in 1.7 million for a valid direction.
pub const MOST_SIGMAS: f64 = 5.0;
/// Duration after which a contradiction is reported, s.
pub const LASTING_S: f64 = 10.0;
/// The previous attitude is propagated for this long at most, s: a transient jump of the gyros must not cause an alarm for
/// the whole flight.
const CARRIED_S: f64 = 600.0;

/// An axis of the telescope along which the Sun's direction, or about which the nadir's, is compared.
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

    /// The axes that a target measures, in the order of the innovation's axes.
    fn measured_by(target: Target) -> &'static [Self] {
        match target {
            Target::Sun => &[Self::Right, Self::Up],
            // The Sun measures the other axis far better.
            Target::Nadir => &[Self::Roll],
            Target::Moon => &[],
        }
    }
}

/// The latest difference between a camera and the gyros along an axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Difference {
    pub t_s: f64,
    /// Measured minus predicted, divided by its 1 sigma.
    pub sigmas: f64,
    /// Start of the period in which all differences exceeded 5 sigma, if the latest does.
    pub beyond_since_s: Option<f64>,
}

impl Difference {
    /// Whether the differences have exceeded 5 sigma for 10 s or more.
    pub fn lasts(&self) -> bool {
        let beyond_s = self.beyond_since_s.map(|since_s| self.t_s - since_s);
        beyond_s.is_some_and(|beyond_s| beyond_s >= LASTING_S)
    }
}

/// Agreement of cameras and gyros.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Agreement {
    /// No direction exceeds 5 sigma.
    Within,
    /// A direction exceeds 5 sigma, for less than 10 s so far.
    Beyond,
    /// A direction has exceeded 5 sigma for 10 s or more.
    LastingContradiction,
}

/// Cameras compared with the gyros.
#[derive(Debug, Clone, Default)]
pub struct Comparison {
    /// Keys: axis, and index of the camera in the settings.
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
    /// The latest differences by axis and index of the camera in the settings; empty before the start.
    pub fn latest(&self) -> impl Iterator<Item = (Axis, usize, &Difference)> {
        let all = self.latest.iter();
        all.map(|((axis, camera), difference)| (*axis, *camera, difference))
    }

    /// The latest difference along an axis, in sigmas: the largest of all cameras.
    pub fn sigmas(&self, axis: Axis) -> Option<f64> {
        let own = self.latest().filter(|(of, ..)| *of == axis);
        own.map(|(.., difference)| difference.sigmas)
            .max_by(|a, b| a.abs().total_cmp(&b.abs()))
    }

    /// The worst of all axes and cameras; `None` if nothing is compared.
    pub fn agreement(&self) -> Option<Agreement> {
        let of_one = |difference: &Difference| match difference.beyond_since_s {
            None => Agreement::Within,
            Some(_) if difference.lasts() => Agreement::LastingContradiction,
            Some(_) => Agreement::Beyond,
        };
        self.latest.values().map(of_one).max()
    }

    /// Propagates the previous attitude over an interval of IMU data.
    pub(super) fn advance(&mut self, said: &Interval) {
        if let Some(carried) = &mut self.carried {
            carried.filter.advance(said);
        }
    }

    /// Compares a direction by the filter's innovation; if it is a contradiction, the present attitude is kept for
    /// propagation.
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

    /// Compares a measurement with the previous attitude, if one is kept; `is_settled` states that the filter accepts all
    /// directions and doubts no sensor. `white_rad` is the white part of a direction's error.
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

    /// After a restart of the filter, directions are compared with the previous attitude if one is kept, otherwise with
    /// nothing.
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
