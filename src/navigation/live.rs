//! The filter in flight, fed with samples and measurements as they arrive. A late measurement - delayed by its exposure,
//! its processing, or another camera - is processed at its own time: the filter resumes from an earlier stored state.

use super::comparison::Comparison;
use super::measurement::{ImuSample, Innovation, Measurement, Verdict};
use super::model::Model;
use super::run::{Flight, Run, Stop};
use super::settings::{NavigationSettings, Target};
use super::solve::{NavigationRow, row};
use super::soundness::Unsound;
use super::states::{Choice, Layout};
use std::collections::VecDeque;
use std::sync::Arc;

/// Maximum delay of a measurement.
const HISTORY_S: f64 = 3.0;
/// Interval at which states are stored.
const KEPT_EVERY_S: f64 = 0.05;
/// Number of samples before a stored state that its next interval depends on.
const NEIGHBOURS: usize = 5;
/// After a gap in the samples of more than this, or a step back by it, the filter restarts: the body's rotation in between
/// is unknown.
const MOST_GAP_S: f64 = 1.0;

/// The filter in flight.
#[derive(Debug)]
pub struct Live {
    /// The samples and measurements of the last seconds.
    recent: Flight,
    run: Run,
    /// Stored states, in the order of time.
    kept: VecDeque<Run>,
    /// Innovations of the last seconds: a late measurement may change them.
    innovations: VecDeque<Innovation>,
    row: Option<NavigationRow>,
    counts: Counts,
    /// The last sample, if its time does not fit the clock so far: a single one is an error, two are a gap or a clock that
    /// was set.
    stray: Option<ImuSample>,
}

/// Counts of measurements by result.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Counts {
    pub taken: u64,
    /// Number of rejected measurements, whose innovations were too large.
    pub refused: u64,
    /// Number of measurements older than the filter's history, or with a time in the future.
    pub out_of_time: u64,
}

impl Live {
    /// Waits for samples, fixes and directions; `sees` lists the targets of each camera of the settings.
    pub fn new(settings: NavigationSettings, sees: &[Vec<Target>]) -> Self {
        let layout = Layout::new(&settings, sees, Choice::AsStated);
        let run = Run::new(Arc::new(Model {
            settings: settings.clone(),
            layout,
        }));
        Self {
            recent: Flight {
                settings,
                imu: Vec::new(),
                measurements: Vec::new(),
            },
            kept: VecDeque::from([run.clone()]),
            run,
            innovations: VecDeque::new(),
            row: None,
            counts: Counts::default(),
            stray: None,
        }
    }

    /// Processes a sample of the IMU; one that is not later than all previous ones is ignored. Returns the attitude at the
    /// latest sample.
    pub fn sample(&mut self, sample: ImuSample) -> Option<NavigationRow> {
        if let Some(last) = self.recent.imu.last() {
            let is_near = |other: &ImuSample| (sample.t_s - other.t_s).abs() <= MOST_GAP_S;
            let stray = self.stray.take();
            if is_near(last) {
                if sample.t_s <= last.t_s {
                    return self.row;
                }
            } else if stray.as_ref().is_some_and(is_near) {
                self.break_off();
            } else {
                self.stray = Some(sample);
                return self.row;
            }
        }
        self.recent.imu.push(sample);
        self.go_on();
        self.drop_before();
        self.row
    }

    /// Restarts with the next sample.
    fn break_off(&mut self) {
        let restarts = self.run.restarts + 1;
        self.run = Run::new(Arc::clone(&self.run.model));
        self.run.restarts = restarts;
        self.innovations.clear();
        self.recent.imu.clear();
        self.recent.measurements.clear();
        self.kept = VecDeque::from([self.run.clone()]);
        self.row = None;
    }

    /// Processes a measurement. One slightly ahead of the samples waits for them.
    pub fn measure(&mut self, measurement: Measurement) {
        let t_s = measurement.t_s();
        let newest_s = self.newest_s();
        if newest_s.is_some_and(|newest_s| t_s > newest_s + HISTORY_S) {
            self.counts.out_of_time += 1;
            return;
        }
        let is_late = t_s <= self.run.at_s;
        if is_late {
            let Some(last) = self.kept.iter().rposition(|run| run.at_s < t_s) else {
                self.counts.out_of_time += 1;
                return;
            };
            self.kept.truncate(last + 1);
            self.run = self.kept[last].clone();
            let from_s = self.run.at_s;
            self.innovations
                .retain(|innovation| innovation.t_s <= from_s);
        }
        let measurements = &mut self.recent.measurements;
        let at = measurements.partition_point(|other| other.t_s() <= t_s);
        measurements.insert(at, measurement);
        if is_late {
            self.go_on();
        }
    }

    /// The attitude at the last sample; `None` before the first two.
    pub fn now(&self) -> Option<NavigationRow> {
        self.row
    }

    /// The time of the last sample that was taken.
    pub fn newest_s(&self) -> Option<f64> {
        self.recent.imu.last().map(|last| last.t_s)
    }

    /// Time of the last accepted direction; minus infinity before the first.
    pub fn seen_s(&self) -> f64 {
        self.run.seen_s
    }

    /// Why the IMU's last values do not determine the motion.
    pub fn unsound(&self) -> Option<Unsound> {
        self.run.unsound()
    }

    /// Differences between cameras and gyros.
    pub fn comparison(&self) -> &Comparison {
        &self.run.comparison
    }

    /// Counts of the measurements that no late one can change any more, and of those that were too late.
    pub fn counts(&self) -> Counts {
        self.counts
    }

    /// Number of restarts, after a divergence of the filter or missing samples.
    pub fn restarts(&self) -> u32 {
        self.run.restarts
    }

    fn go_on(&mut self) {
        let innovations = &mut self.innovations;
        while let Some(stop) = self
            .run
            .step(&self.recent, &mut |one| innovations.push_back(one))
        {
            if let Stop::Sample(n) = stop {
                self.row = Some(row(&self.run, self.recent.imu[n].t_s));
                let last_s = self.kept.back().map(|run| run.at_s);
                if last_s.is_none_or(|last_s| self.run.at_s - last_s >= KEPT_EVERY_S) {
                    self.kept.push_back(self.run.clone());
                }
            }
        }
    }

    /// Drops data older than the filter's history.
    fn drop_before(&mut self) {
        let oldest_s = self.run.at_s - HISTORY_S;
        while self.kept.get(1).is_some_and(|run| run.at_s <= oldest_s) {
            self.kept.pop_front();
        }
        let Some(first) = self.kept.front() else {
            return;
        };
        let first_s = first.at_s;
        let settled = self
            .innovations
            .partition_point(|innovation| innovation.t_s <= first_s);
        for innovation in self.innovations.drain(..settled) {
            match innovation.verdict {
                Verdict::Taken => self.counts.taken += 1,
                Verdict::Refused => self.counts.refused += 1,
            }
        }
        let (samples, measurements) = first.passed();
        let samples = samples.saturating_sub(NEIGHBOURS);
        // In whole blocks: each time the remainder is copied.
        const BLOCK: usize = 256;
        if samples >= BLOCK {
            self.recent.imu.drain(..samples);
            self.recent.measurements.drain(..measurements);
            let runs = self.kept.iter_mut().chain([&mut self.run]);
            runs.for_each(|run| run.drop_before(samples, measurements));
        }
    }
}
