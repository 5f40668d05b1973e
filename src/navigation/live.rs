//! The filter in flight: samples and measurements as they come. A measurement that comes late - its exposure, its solving, another camera took
//! time - is put where it belongs: the filter goes on again from a state that it kept from before.

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

/// A measurement may come so late.
const HISTORY_S: f64 = 3.0;
/// A state to go on from is kept so often.
const KEPT_EVERY_S: f64 = 0.05;
/// Samples before a state that its next interval rests on.
const NEIGHBOURS: usize = 5;
/// Longer than this without samples, or back by it, and the filter restarts: how the body turned is not known.
const MOST_GAP_S: f64 = 1.0;

/// The filter in flight.
#[derive(Debug)]
pub struct Live {
    /// The samples and measurements of the last seconds.
    recent: Flight,
    run: Run,
    /// In the order of time.
    kept: VecDeque<Run>,
    /// Of the last seconds: a late measurement may change them.
    innovations: VecDeque<Innovation>,
    row: Option<NavigationRow>,
    counts: Counts,
    /// The last sample, if its time is another than the clock's so far: one alone is a slip, two are a gap or a clock that was set.
    stray: Option<ImuSample>,
}

/// Fate of measurements.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Counts {
    pub taken: u64,
    /// Their innovations were too large.
    pub refused: u64,
    /// They came later than the filter remembers, or are of a time that is still to come.
    pub out_of_time: u64,
}

impl Live {
    /// Waits for samples, fixes and directions; `sees` are the targets of each camera of the settings.
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

    /// Takes a sample of the IMU, which is later than all before; one that is not is passed over. The attitude at its time.
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

    /// Takes a measurement. One of a time that the samples have not quite reached waits for them.
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

    /// When a direction was last taken; minus infinity before.
    pub fn seen_s(&self) -> f64 {
        self.run.seen_s
    }

    /// Why the IMU's last values determine less than they should.
    pub fn unsound(&self) -> Option<Unsound> {
        self.run.unsound()
    }

    /// How far what cameras show is from where the gyros have it.
    pub fn comparison(&self) -> &Comparison {
        &self.run.comparison
    }

    /// Fate of the measurements that no late one can change any more, and of those that are too late.
    pub fn counts(&self) -> Counts {
        self.counts
    }

    /// Times that the filter had diverged, or samples were missing, and it restarted.
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

    /// Drops what is older than the filter remembers.
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
        // In whole blocks: each time is a copy of what is left.
        const BLOCK: usize = 256;
        if samples >= BLOCK {
            self.recent.imu.drain(..samples);
            self.recent.measurements.drain(..measurements);
            let runs = self.kept.iter_mut().chain([&mut self.run]);
            runs.for_each(|run| run.drop_before(samples, measurements));
        }
    }
}
