//! Processing of a flight by the filter: IMU samples in order, with each measurement at its own time in between.

use super::begin::{Waiting, correlated_error, white_rad};
use super::comparison::Comparison;
use super::doubts::{Doubts, ONE_SIDED_CHI2, Remedy};
use super::filter::{Filter, MOST_CHI2, Trust};
use super::measurement::{
    DirectionObservation, ImuSample, Innovation, Measurement, Source, Verdict,
};
use super::model::Model;
use super::motion::{Interval, Lost};
use super::settings::{NavigationSettings, Target};
use super::soundness::{Soundness, Unsound};
use super::states::{Choice, Layout, Opened, Sensors};
use nalgebra::Vector3;
use std::sync::Arc;

/// Number of rejected measurements of one kind in a row, and the time that they must span, after which the filter counts as
/// diverged.
const REFUSED_IN_A_ROW: u32 = 15;
const REFUSED_S: f64 = 3.0;
/// Minimum time between two such restarts: a faulty receiver would cause them repeatedly.
const RESTART_PAUSE_S: f64 = 60.0;
/// After this time without a direction the attitude is from the gyros alone.
pub(super) const COASTING_S: f64 = 10.0;
/// Duration for which rows report a restart.
pub(super) const RESTARTED_S: f64 = 10.0;
/// The filter restarts if the attitude's sigma exceeds this, rad, and is larger than the initial one by this factor.
const UNKNOWN_RAD: f64 = 0.2;
const WORSE: f64 = 2.0;
/// Maximum spacing of neighbours, in intervals, from which the change of force and rate is computed.
const NEIGHBOUR: f64 = 1.5;

/// All input of a flight's solution, in the order of time.
#[derive(Debug, Clone, PartialEq)]
pub struct Flight {
    pub settings: NavigationSettings,
    pub imu: Vec<ImuSample>,
    pub measurements: Vec<Measurement>,
}

impl Flight {
    /// Each run of the IMU with the measurements up to its end; both in the order of time.
    pub fn of_runs(
        settings: &NavigationSettings,
        runs: Vec<Vec<ImuSample>>,
        mut measurements: Vec<Measurement>,
    ) -> Vec<Self> {
        let own = |imu: Vec<ImuSample>| {
            let end_s = imu.last().map_or(f64::NEG_INFINITY, |last| last.t_s);
            let own = measurements.partition_point(|one| one.t_s() <= end_s);
            let later = measurements.split_off(own);
            Self {
                settings: settings.clone(),
                imu,
                measurements: std::mem::replace(&mut measurements, later),
            }
        };
        runs.into_iter().map(own).collect()
    }

    pub(super) fn model(&self, choice: Choice) -> Arc<Model> {
        Arc::new(Model {
            settings: self.settings.clone(),
            layout: self.layout(choice),
        })
    }

    fn layout(&self, choice: Choice) -> Layout {
        let mut used = vec![Vec::<Target>::new(); self.settings.cameras.len()];
        for measurement in &self.measurements {
            if let Measurement::Direction(observation) = measurement {
                let targets = &mut used[observation.camera];
                if !targets.contains(&observation.target) {
                    targets.push(observation.target);
                }
            }
        }
        Layout::new(&self.settings, &used, choice)
    }

    /// The interval of a sample. The change of force and rate is computed from its neighbours.
    fn interval(&self, n: usize) -> Option<Interval> {
        let sample = self.imu.get(n)?;
        let length = |n: usize| Some(self.imu.get(n)?.t_s - self.imu.get(n.checked_sub(1)?)?.t_s);
        let own = length(n).or_else(|| length(1))?;
        let middle = |n: usize| Some(self.imu.get(n)?.t_s - length(n).unwrap_or(own) / 2.0);
        let is_near = |other: Option<f64>| other.is_some_and(|other| other < NEIGHBOUR * own);
        let before = n.checked_sub(1).filter(|_| is_near(Some(own)));
        let after = Some(n + 1).filter(|n| is_near(length(*n)));
        let (from, to) = (before.unwrap_or(n), after.unwrap_or(n));
        let apart = middle(to)? - middle(from)?;
        let per_s = if apart > 0.0 { apart.recip() } else { 0.0 };
        let (from, to) = (&self.imu[from], &self.imu[to]);
        let interval = Interval {
            from_s: sample.t_s - own,
            to_s: sample.t_s,
            force_m_s2: sample.force_m_s2,
            force_change_m_s3: (to.force_m_s2 - from.force_m_s2) * per_s,
            rate_rad_s: sample.rate_rad_s,
            rate_change_rad_s2: (to.rate_rad_s - from.rate_rad_s) * per_s,
            lost: Lost::default(),
        };
        // Samples may have been lost just before as well.
        let usual_s = (n.saturating_sub(3)..n)
            .filter_map(length)
            .fold(own, f64::min);
        Some(match n.checked_sub(1) {
            Some(before) if own > NEIGHBOUR * usual_s => {
                self.bridged(interval, &self.imu[before], usual_s)
            }
            _ => interval,
        })
    }

    /// An interval with lost samples: the values of the last sample are used for its usual length, and for the rest its
    /// mean with the previous sample, with half their difference as 1 sigma. Their noise then counts more than once.
    fn bridged(&self, interval: Interval, before: &ImuSample, usual_s: f64) -> Interval {
        let own_s = interval.length_s();
        let lost_s = own_s - usual_s;
        let half_share = lost_s / own_s / 2.0;
        let force = (before.force_m_s2 - interval.force_m_s2) * half_share;
        let rate = (before.rate_rad_s - interval.rate_rad_s) * half_share;
        let samples = lost_s / usual_s;
        let noise = ((samples * samples / 2.0 + samples) * usual_s / own_s).sqrt();
        let walk = |half: Vector3<f64>, own_walk: f64| {
            (half.norm() * own_s.sqrt()).hypot(own_walk * noise)
        };
        let imu = &self.settings.imu;
        Interval {
            force_m_s2: interval.force_m_s2 + force,
            rate_rad_s: interval.rate_rad_s + rate,
            lost: Lost {
                velocity_random_walk: walk(force, imu.velocity_random_walk),
                angular_random_walk: walk(rate, imu.angular_random_walk),
            },
            ..interval
        }
    }
}

/// Reason for the end of a step.
pub(super) enum Stop {
    /// The IMU's sample with this index; all measurements up to its time are processed.
    Sample(usize),
    /// Measurements were processed; the filter has either restarted with the first of them, or continued.
    Node(Begun),
}

#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Begun {
    Restarted,
    Before,
}

#[derive(Debug, Clone)]
pub(super) enum Phase {
    Waiting(Waiting),
    Running(Box<Filter>),
}

/// State of the processing of a flight.
#[derive(Debug, Clone)]
pub(super) struct Run {
    pub model: Arc<Model>,
    pub phase: Phase,
    /// Indices of the next sample and of the next measurement.
    sample: usize,
    measurement: usize,
    /// Time up to which the filter has been propagated.
    pub at_s: f64,
    /// Time of the last accepted direction, and of the filter's last restart.
    pub seen_s: f64,
    pub restarted_s: Option<f64>,
    pub restarts: u32,
    refused: Vec<(Source, u32, f64)>,
    pub doubts: Doubts,
    pub comparison: Comparison,
    /// Variances added at the last measurements.
    pub opened: Opened,
    soundness: Soundness,
    /// Index of a sample, and the uncertainty of its interval.
    unknown: Option<(usize, Lost)>,
    /// 1 sigma of the attitude about its worst axis when the filter started.
    begun_rad: f64,
}

impl Run {
    pub fn new(model: Arc<Model>) -> Self {
        Self {
            model,
            phase: Phase::Waiting(Waiting::default()),
            sample: 0,
            measurement: 0,
            at_s: f64::NEG_INFINITY,
            seen_s: f64::NEG_INFINITY,
            restarted_s: None,
            restarts: 0,
            refused: Vec::new(),
            doubts: Doubts::default(),
            comparison: Comparison::default(),
            opened: Opened::zeros(),
            soundness: Soundness::default(),
            unknown: None,
            begun_rad: 0.0,
        }
    }

    /// Fault of the IMU in the last sample.
    pub fn unsound(&self) -> Option<Unsound> {
        self.soundness.found()
    }

    /// The interval of the current sample, with its uncertainty.
    fn interval(&mut self, flight: &Flight) -> Option<Interval> {
        let interval = flight.interval(self.sample)?;
        let unknown = match self.unknown {
            Some((sample, unknown)) if sample == self.sample => unknown,
            _ => {
                let (sample, imu) = (&flight.imu[self.sample], &self.model.settings.imu);
                let unknown = self.soundness.judge(sample, interval.length_s(), imu);
                self.unknown = Some((self.sample, unknown));
                unknown
            }
        };
        Some(Interval {
            lost: interval.lost.and(&unknown),
            ..interval
        })
    }

    /// Advances to the next sample, or to the next time with measurements; `None` at the end. `each` is called with every
    /// innovation.
    pub fn step(&mut self, flight: &Flight, each: &mut impl FnMut(Innovation)) -> Option<Stop> {
        let interval = self.interval(flight)?;
        self.at_s = self.at_s.max(interval.from_s);
        loop {
            let due = flight.measurements.get(self.measurement);
            let due = due.filter(|measurement| measurement.t_s() <= interval.to_s);
            let Some(due) = due else {
                self.advance(&interval, interval.to_s);
                let stop = Stop::Sample(self.sample);
                self.sample += 1;
                return Some(stop);
            };
            let t_s = due.t_s();
            self.advance(&interval, t_s);
            let begun = self.take_all(flight, t_s, each);
            if let Phase::Running(filter) = &mut self.phase {
                filter.settle();
                return Some(Stop::Node(begun));
            }
        }
    }

    /// Processes the measurements at one time. Measurements from before the first IMU sample are ignored.
    fn take_all(&mut self, flight: &Flight, t_s: f64, each: &mut impl FnMut(Innovation)) -> Begun {
        let mut begun = Begun::Before;
        self.opened = Opened::zeros();
        while let Some(measurement) = flight.measurements.get(self.measurement) {
            if measurement.t_s() > t_s {
                break;
            }
            self.measurement += 1;
            if t_s >= self.at_s && self.take(measurement, each) == Begun::Restarted {
                begun = Begun::Restarted;
            }
            if t_s >= self.at_s {
                self.compare(measurement);
            }
        }
        begun
    }

    /// Shifts the indices as if the flight had begun so many samples and measurements later.
    pub fn drop_before(&mut self, samples: usize, measurements: usize) {
        self.sample -= samples;
        self.unknown = self
            .unknown
            .map(|(sample, lost)| (sample.saturating_sub(samples), lost));
        self.measurement -= measurements;
    }

    /// Number of samples and measurements that have been processed.
    pub fn passed(&self) -> (usize, usize) {
        (self.sample, self.measurement)
    }

    /// Whether both are at the same point of the same flight.
    pub fn is_at(&self, other: &Self) -> bool {
        (self.sample, self.measurement) == (other.sample, other.measurement)
            && self.at_s == other.at_s
    }

    /// The filter propagated to a time within the current interval, before any measurement.
    pub fn carried_to(&self, flight: &Flight, to_s: f64) -> Option<Filter> {
        let mut run = self.clone();
        let interval = run.interval(flight)?;
        run.advance(&interval, to_s);
        match run.phase {
            Phase::Running(filter) => Some(*filter),
            Phase::Waiting(_) => None,
        }
    }

    fn advance(&mut self, interval: &Interval, to_s: f64) {
        if to_s <= self.at_s {
            return;
        }
        let doubt = Lost {
            angular_random_walk: self.doubts.random_walk(Sensors::Gyros),
            velocity_random_walk: self.doubts.random_walk(Sensors::Accelerometers),
        };
        let part = interval.part(self.at_s, to_s);
        self.comparison.advance(&part);
        let lost = part.lost.and(&doubt);
        let part = Interval { lost, ..part };
        match &mut self.phase {
            Phase::Waiting(waiting) => waiting.advance(&part, &self.model.settings.imu),
            Phase::Running(filter) => filter.advance(&part),
        }
        self.at_s = to_s;
    }

    fn take(&mut self, measurement: &Measurement, each: &mut impl FnMut(Innovation)) -> Begun {
        let model = Arc::clone(&self.model);
        let settings = &model.settings;
        match (&mut self.phase, measurement) {
            (Phase::Waiting(waiting), Measurement::Direction(observation)) => {
                waiting.note(settings, observation);
            }
            (Phase::Waiting(waiting), Measurement::Fix(fix)) => {
                if let Some(filter) = waiting.begin(&model, fix) {
                    self.begun_rad = filter.worst_attitude_rad();
                    if self.restarts > 0 {
                        self.doubts.unproven(filter.rate_rad_s.norm());
                    }
                    self.phase = Phase::Running(Box::new(filter));
                    self.seen_s = fix.t_s;
                    return Begun::Restarted;
                }
            }
            (Phase::Running(filter), Measurement::Direction(observation)) => {
                filter.settle();
                let worst_rad = filter.worst_attitude_rad();
                if worst_rad > UNKNOWN_RAD && worst_rad > WORSE * self.begun_rad {
                    self.restart(observation.t_s);
                    return self.take(measurement, each);
                }
                let white_rad = white_rad(settings, &model.layout, observation);
                let innovation = filter.take_direction(observation, white_rad, Trust::Tested);
                if let Some(innovation) = innovation {
                    self.comparison.note(&innovation, filter);
                    self.note_direction(observation, innovation, each);
                }
            }
            (Phase::Running(filter), Measurement::Fix(fix)) => {
                let innovations = filter.take_fix(fix);
                let innovations = innovations.into_iter().flatten();
                innovations.for_each(|one| self.note_fix(one, each));
            }
        }
        Begun::Before
    }

    /// Compares a measurement that the filter has processed with the previous gyro attitude.
    fn compare(&mut self, measurement: &Measurement) {
        let Model { settings, layout } = &*self.model;
        let white_rad = match measurement {
            Measurement::Direction(observation) => white_rad(settings, layout, observation),
            Measurement::Fix(_) => 0.0,
        };
        let is_running = matches!(self.phase, Phase::Running(_));
        let is_settled = is_running && self.doubts.is_settled();
        self.comparison.take(measurement, white_rad, is_settled);
    }

    /// Updates the doubts by a direction, and the filter by the doubts.
    fn note_direction(
        &mut self,
        observation: &DirectionObservation,
        innovation: Innovation,
        each: &mut impl FnMut(Innovation),
    ) {
        let Phase::Running(filter) = &mut self.phase else {
            return;
        };
        let towards = filter.towards(observation);
        if innovation.verdict == Verdict::Taken {
            self.doubts.take(observation, towards, &innovation);
            return self.note(innovation, each);
        }
        let was_doubted = self.doubts.random_walk(Sensors::Gyros) > 0.0;
        let rate_rad_s = filter.rate_rad_s.norm();
        let Model { settings, layout } = &*self.model;
        let error = correlated_error(settings, layout, observation);
        match self
            .doubts
            .refuse(observation, towards, &innovation, rate_rad_s, error)
        {
            Remedy::Wait => self.note(innovation, each),
            Remedy::BeginAnew => {
                each(innovation);
                self.restart(observation.t_s);
            }
            Remedy::Open { rad } => {
                each(innovation);
                self.opened += filter.open(Sensors::Gyros, rad * rad);
                if !was_doubted {
                    // The filter has followed the gyros as long as no direction contradicted them.
                    self.opened += filter.open_attitude(MOST_CHI2[0]);
                }
                let white_rad = white_rad(&self.model.settings, &self.model.layout, observation);
                let taken = filter.take_direction(observation, white_rad, Trust::Blind);
                if let Some(taken) = taken {
                    self.doubts.take(observation, towards, &taken);
                    self.note(taken, each);
                }
            }
        }
    }

    /// Updates the doubts by a fix, and the filter by the doubts: the next fix then determines the velocity.
    fn note_fix(&mut self, innovation: Innovation, each: &mut impl FnMut(Innovation)) {
        if let Phase::Running(filter) = &mut self.phase
            && let Some(variance) = self.doubts.note_velocity(&innovation)
        {
            self.opened += filter.open(Sensors::Accelerometers, variance);
            // The filter has followed the accelerometers as long as this was undetected.
            self.opened += filter.open_attitude(ONE_SIDED_CHI2);
        }
        self.note(innovation, each);
    }

    fn restart(&mut self, t_s: f64) {
        self.refused.clear();
        self.doubts = Doubts::default();
        self.comparison.restart();
        self.restarts += 1;
        self.restarted_s = Some(t_s);
        self.phase = Phase::Waiting(Waiting::default());
    }

    /// Counts rejected measurements in a row: a diverged filter returns to the alignment.
    fn note(&mut self, innovation: Innovation, each: &mut impl FnMut(Innovation)) {
        let (t_s, source) = (innovation.t_s, innovation.source);
        match (innovation.verdict, source) {
            (Verdict::Taken, Source::Direction { .. }) => self.seen_s = t_s,
            (Verdict::Taken | Verdict::Refused, _) => {}
        }
        match innovation.verdict {
            Verdict::Taken => self.refused.retain(|(other, ..)| *other != source),
            Verdict::Refused => {
                let row = self.refused.iter_mut().find(|(other, ..)| *other == source);
                match row {
                    Some((_, count, _)) => *count += 1,
                    None => self.refused.push((source, 1, t_s)),
                }
            }
        }
        each(innovation);
        let is_wrong = |(_, count, since_s): &(Source, u32, f64)| {
            *count >= REFUSED_IN_A_ROW && t_s - since_s >= REFUSED_S
        };
        let is_soon = self
            .restarted_s
            .is_some_and(|last| t_s - last < RESTART_PAUSE_S);
        if self.refused.iter().any(is_wrong) && !is_soon {
            self.restart(t_s);
        }
    }
}
