//! The attitude at each sample of the IMU from all measurements up to then.

use super::comparison::{Axis, Difference};
use super::constants::ConstantErrors;
use super::filter::Filter;
use super::measurement::Innovation;
use super::motion::Motion;
use super::run::{COASTING_S, Flight, Phase, RESTARTED_S, Run, Stop};
use super::states::Choice;
use nalgebra::{Matrix3, Vector3};

/// Status of the attitude.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Status {
    /// No attitude yet, or no longer one.
    Waiting,
    Aligned,
    /// No direction was accepted for 10 s.
    Coasting,
    /// The filter diverged, and restarted in the last 10 s.
    Restarted,
    /// Directions contradict the gyros: the attitude's covariance includes their difference.
    Contradicted,
    /// The IMU's last values do not determine the motion.
    Unsound,
}

impl Status {
    /// All statuses, in the order of their numbers.
    pub const ALL: [Self; 6] = [
        Self::Waiting,
        Self::Aligned,
        Self::Coasting,
        Self::Restarted,
        Self::Contradicted,
        Self::Unsound,
    ];

    /// Whether the IMU is suspect, by itself or because of the directions.
    pub fn is_doubted(self) -> bool {
        matches!(self, Self::Contradicted | Self::Unsound)
    }

    pub fn name(self) -> &'static str {
        match self {
            Self::Waiting => "waiting",
            Self::Aligned => "aligned",
            Self::Coasting => "coasting",
            Self::Restarted => "restarted",
            Self::Contradicted => "contradicted",
            Self::Unsound => "unsound",
        }
    }
}

/// The attitude at a sample of the IMU, with the motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct NavigationRow {
    pub t_s: f64,
    /// `None` before the start.
    pub attitude: Option<(Motion, Matrix3<f64>)>,
    pub status: Status,
}

/// The estimated errors of the sensors at a time, each with 1 sigma.
#[derive(Debug, Clone, PartialEq)]
pub struct SensorErrors {
    pub t_s: f64,
    /// Biases of accelerometer and gyro, m/s^2 and rad/s.
    pub biases: [Option<(Vector3<f64>, Vector3<f64>)>; 2],
    /// Misalignments, rad.
    pub cameras: Vec<Option<(Vector3<f64>, Vector3<f64>)>>,
}

/// Results of a flight apart from its rows.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Summary {
    pub innovations: Vec<Innovation>,
    /// Differences between cameras and gyros, in the order of time.
    pub differences: Vec<(Axis, Difference)>,
    pub errors: Vec<SensorErrors>,
    /// 1 sigma of the attitude about the axes of ECEF, rad, with its time.
    pub attitude_sigmas: Vec<(f64, Vector3<f64>)>,
    /// Start and end of the periods longer than 10 s without an accepted direction.
    pub gaps: Vec<(f64, f64)>,
    /// Number of restarts of the filter.
    pub restarts: u32,
    /// Final state of the filter; `None` if it was waiting at the end.
    pub constants: Option<ConstantErrors>,
}

/// Interval at which sensor errors and sigmas are stored.
const KEPT_EVERY_S: f64 = 1.0;

/// Solves a flight; `each` gets the rows in the order of time.
pub fn solve(flight: &Flight, mut each: impl FnMut(NavigationRow)) -> Summary {
    let mut run = Run::new(flight.model(Choice::AsStated));
    let mut summary = Summary::default();
    let mut kept_s = [f64::NEG_INFINITY; 2];
    let mut seen_s = run.seen_s;
    while let Some(stop) = run.step(flight, &mut |innovation| {
        summary.innovations.push(innovation)
    }) {
        match (stop, &run.phase) {
            (Stop::Sample(n), _) => {
                let row = row(&run, flight.imu[n].t_s);
                summary.note_sigma(&row, &mut kept_s[0]);
                each(row);
            }
            (Stop::Node(_), Phase::Running(filter)) if run.at_s - kept_s[1] >= KEPT_EVERY_S => {
                kept_s[1] = run.at_s;
                summary.errors.push(errors(filter, run.at_s));
            }
            (Stop::Node(_), _) => {}
        }
        summary.note_differences(&run);
        summary.note_gap(seen_s, run.seen_s);
        seen_s = run.seen_s;
    }
    summary.note_gap(seen_s, run.at_s);
    summary.restarts = run.restarts;
    summary.constants = match &run.phase {
        Phase::Waiting(_) => None,
        Phase::Running(filter) => Some(ConstantErrors::of(filter)),
    };
    summary
}

impl Summary {
    /// Appends the summary of a later flight with the same sensors.
    pub fn append(&mut self, later: Self) {
        self.innovations.extend(later.innovations);
        self.differences.extend(later.differences);
        self.errors.extend(later.errors);
        self.attitude_sigmas.extend(later.attitude_sigmas);
        self.gaps.extend(later.gaps);
        self.restarts += later.restarts;
        self.constants = later.constants.or(self.constants.take());
    }

    fn note_sigma(&mut self, row: &NavigationRow, kept_s: &mut f64) {
        if let Some((_, covariance)) = row.attitude.filter(|_| row.t_s - *kept_s >= KEPT_EVERY_S) {
            *kept_s = row.t_s;
            let sigma = covariance
                .diagonal()
                .map(|variance| variance.max(0.0).sqrt());
            self.attitude_sigmas.push((row.t_s, sigma));
        }
    }

    /// Stores the differences of the last measurements.
    fn note_differences(&mut self, run: &Run) {
        let noted_s = self.differences.last().map(|(_, last)| last.t_s);
        let latest = run.comparison.latest();
        let fresh = latest.filter(|(.., one)| noted_s.is_none_or(|noted_s| one.t_s > noted_s));
        let mut fresh: Vec<(Axis, Difference)> = fresh.map(|(axis, _, one)| (axis, *one)).collect();
        fresh.sort_by(|(_, a), (_, b)| a.t_s.total_cmp(&b.t_s));
        self.differences.append(&mut fresh);
    }

    fn note_gap(&mut self, from_s: f64, to_s: f64) {
        if from_s.is_finite() && to_s - from_s > COASTING_S {
            self.gaps.push((from_s, to_s));
        }
    }
}

/// The filter's result at a sample.
pub(super) fn row(run: &Run, t_s: f64) -> NavigationRow {
    let attitude = match &run.phase {
        Phase::Waiting(_) => None,
        Phase::Running(filter) => {
            let covariance = filter.attitude_covariance() + run.doubts.covariance(t_s);
            Some((filter.estimate.motion, covariance))
        }
    };
    NavigationRow {
        t_s,
        attitude,
        status: status(run, t_s),
    }
}

fn status(run: &Run, t_s: f64) -> Status {
    let is_new = run.restarted_s.is_some_and(|at_s| t_s - at_s < RESTARTED_S);
    match &run.phase {
        Phase::Waiting(_) => Status::Waiting,
        Phase::Running(_) if run.unsound().is_some() => Status::Unsound,
        Phase::Running(_) if run.doubts.any() => Status::Contradicted,
        Phase::Running(_) if is_new => Status::Restarted,
        Phase::Running(_) if t_s - run.seen_s > COASTING_S => Status::Coasting,
        Phase::Running(_) => Status::Aligned,
    }
}

fn errors(filter: &Filter, t_s: f64) -> SensorErrors {
    let layout = &filter.model.layout;
    let sigma = |first: usize| Vector3::from_fn(|n, _| filter.sigma(first + n));
    let of = |triad: &Option<super::states::Triad>, value: &Vector3<f64>| {
        triad.map(|triad| (*value, sigma(triad.first)))
    };
    let estimate = &filter.estimate;
    let cameras = layout.cameras.iter().zip(&estimate.cameras);
    SensorErrors {
        t_s,
        biases: [0, 1].map(|n| of(&layout.imu[n], &estimate.imu[n])),
        cameras: cameras.map(|(triad, value)| of(triad, value)).collect(),
    }
}
