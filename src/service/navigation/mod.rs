//! The navigation filter's thread: it takes samples, fixes and directions, and computes offsets between frames.
//!
//! Its clock is the samples' own time. The time of a measurement is its stamp, less its sensor's delay; it may come up to 3 s late.

mod contradiction;
mod gps;
mod inputs;
mod rows;
mod sensor;
mod sent;
mod steps;

pub(super) use inputs::Inputs;

use super::messages::{
    Input, LinkEvent, NavigationLog, NavigationRows, ObservedDirection, PropagatedEvent,
};
use super::priority::Rank;
use super::shared::Shared;
use super::tally::NavigationTally;
use super::worker::{Heartbeat, Worker};
use crate::clock::FlightClock;
use crate::commands::controls::{Controls, Topic};
use crate::config::{self, Host};
use crate::instrument::Role;
use crate::link::{Connection, Counters, ImuPacket};
use crate::log::worth_a_line;
use crate::navigation::{
    DirectionObservation, Due, ImuSample, Live, Measurement, NavigationRow, NavigationSettings,
    NoDirection, PropagatedOffset, Sky, Status, Target, Targets, offset,
};
use crate::sky::Ephemeris;
use contradiction::LastingContradiction;
use crossbeam_channel::{Receiver, RecvTimeoutError, Sender};
use jiff::{SignedDuration, Timestamp};
use nalgebra::{Rotation3, Vector3};
use rows::{imu_row, propagated_row};
use sensor::{Sensor, SensorKind};
use sent::propagated;
use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use steps::Steps;

/// How long the filter waits for an input before it shows that it is at work.
const TIMEOUT: Duration = Duration::from_millis(100);
/// Silence after which the filter counts as hung.
const HANG_TIMEOUT: Duration = Duration::from_secs(5);
/// Silence of the IMU after which no earlier state is valid.
const SILENCE: Duration = Duration::from_secs(1);
/// Offsets are not sent if this many events wait for the line: frames come first.
const MOST_EVENTS: usize = 32;
/// Span of time for which the archive gets rows at once.
const ROWS_S: f64 = 1.0;

/// Shared state of the filter's thread. It outlives a thread that fails; the filter does not.
#[derive(Clone)]
pub(super) struct Navigator {
    pub settings: NavigationSettings,
    /// The flight's cameras, by name and role.
    pub cameras: Vec<(String, Role)>,
    pub ephemeris: Ephemeris,
    pub controls: Controls,
    pub to_line: Sender<LinkEvent>,
    pub rows: Sender<NavigationRows>,
    pub tally: Shared<NavigationTally>,
    pub counters: Arc<Counters>,
    pub ended: Arc<AtomicBool>,
    pub clock: FlightClock,
}

impl Navigator {
    /// Starts the filter's thread, and one for each sensor that has a line of its own.
    ///
    /// # Errors
    /// If the operating system gives no thread.
    pub fn start(
        self,
        imu: Option<Connection>,
        gps: Option<Connection>,
        inputs: &Inputs,
        queue: &Receiver<Input>,
        host: Host,
    ) -> std::io::Result<Vec<Worker>> {
        let mut workers = Vec::new();
        for (kind, connection) in [(SensorKind::Imu, imu), (SensorKind::Gps, gps)] {
            if let Some(connection) = connection {
                let sensor = Sensor {
                    connection: Arc::new(Mutex::new(connection)),
                    kind,
                    inputs: inputs.clone(),
                    tally: self.tally.clone(),
                    ended: Arc::clone(&self.ended),
                    clock: self.clock,
                };
                let listen = move |heartbeat: &Heartbeat| sensor.run(heartbeat);
                // Another thread would wait for the same port.
                workers.push(real_time(kind.name(), None, listen, host)?);
            }
        }
        let queue = queue.clone();
        let filter = move |heartbeat: &Heartbeat| self.run(&queue, heartbeat);
        workers.push(real_time("navigation", Some(HANG_TIMEOUT), filter, host)?);
        Ok(workers)
    }

    /// Filters until the flight ends, or another thread has taken over.
    fn run(&self, inputs: &Receiver<Input>, heartbeat: &Heartbeat) {
        let mut filter = None;
        let mut ending = None;
        let mut last_sample = Instant::now();
        while !heartbeat.is_replaced() {
            heartbeat.beat();
            if self.ended.load(Ordering::Relaxed) {
                // An IMU on the controller's line continues until that is closed.
                let since = *ending.get_or_insert_with(Instant::now);
                if since.elapsed() > TIMEOUT {
                    break;
                }
            }
            if last_sample.elapsed() > SILENCE {
                clear(&mut self.tally.lock());
            }
            match inputs.recv_timeout(TIMEOUT) {
                Ok(Input::Imu(sample, read)) => {
                    last_sample = Instant::now();
                    let filter = filter.get_or_insert_with(|| Filter::new(self, sample.time));
                    filter.sample(&sample, read);
                }
                Ok(Input::Fix(fix)) => {
                    if self.follow(&fix) {
                        let filter = filter.iter_mut();
                        filter.for_each(|filter: &mut Filter| filter.fix(&fix));
                    }
                }
                Ok(Input::Direction(one)) => filter.iter_mut().for_each(|f| f.direction(&one)),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => break,
            }
        }
        filter.iter_mut().for_each(Filter::send_rows);
    }
}

/// Removes the current state from the tally.
fn clear(tally: &mut NavigationTally) {
    (tally.status, tally.latest) = (None, None);
    (tally.differences, tally.agreement) = Default::default();
}

fn real_time(
    name: &str,
    timeout: Option<Duration>,
    work: impl Fn(&Heartbeat) + Clone + Send + 'static,
    host: Host,
) -> std::io::Result<Worker> {
    Worker::start(name, timeout, move || {
        host.realtime(Rank::Higher, work.clone())
    })
}

/// The filter with what it needs to compute offsets.
struct Filter<'a> {
    nav: &'a Navigator,
    live: Live,
    targets: Targets,
    epoch: Timestamp,
    body_from_telescope: Rotation3<f64>,
    /// The last sample.
    last_sample: Option<ImuPacket>,
    steps: Steps,
    last_fix: Option<Timestamp>,
    /// Settings of the ground, and their version.
    settings: config::Navigation,
    version: u64,
    due: Due,
    contradiction: LastingContradiction,
    rows: [VecDeque<Vec<String>>; NavigationLog::ALL.len()],
    rows_sent_s: f64,
    /// Number of directions that could not be used because the target's direction is not known.
    unknown: u64,
}

impl<'a> Filter<'a> {
    /// A filter that waits for its first input; `epoch` is about the first sample's time.
    fn new(nav: &'a Navigator, epoch: Timestamp) -> Self {
        let settings = &nav.settings;
        // A camera that does not fly gives no directions, whatever its role.
        let targets = settings.cameras.iter().map(|stated| {
            let flown = nav.cameras.iter().find(|(name, _)| *name == stated.name);
            flown.map_or(Target::Sun, |(_, role)| Target::of(*role))
        });
        let sees: Vec<_> = targets.map(|target| vec![target]).collect();
        let sky = Sky::Ephemeris {
            ephemeris: Box::new(nav.ephemeris.clone()),
            epoch,
        };
        Self {
            nav,
            live: Live::new(settings.clone(), &sees),
            targets: Targets::new(sky, Vec::new()),
            epoch,
            body_from_telescope: settings.body_from_telescope(),
            last_sample: None,
            steps: Steps::default(),
            last_fix: None,
            version: nav.controls.version(Topic::Other),
            settings: nav.controls.config().navigation,
            due: Due::default(),
            contradiction: LastingContradiction::default(),
            rows: Default::default(),
            rows_sent_s: 0.0,
            unknown: 0,
        }
    }

    fn since_epoch_s(&self, utc: Timestamp) -> f64 {
        utc.duration_since(self.epoch).as_secs_f64()
    }

    fn sample(&mut self, sample: &ImuPacket, read: Instant) {
        let vector = |v: [f32; 3]| Vector3::from(v).cast::<f64>();
        let t_s = self.since_epoch_s(sample.time) - self.nav.settings.imu.delay_s;
        let imu = ImuSample {
            t_s,
            force_m_s2: vector(sample.force_m_s2),
            rate_rad_s: vector(sample.rate_rad_s),
            time_step_s: self.steps.step_s(sample),
        };
        self.count(sample);
        if let Err(error) = imu.check(&self.nav.settings.imu) {
            let mut tally = self.nav.tally.lock();
            tally.unreadable += 1;
            if worth_a_line(tally.unreadable) {
                tracing::warn!(%error, "a sample of the IMU is not used");
            }
            return;
        }
        let before_s = self.live.newest_s();
        let row = self.live.sample(imu);
        self.note(row.map(|row| row.status));
        // The filter has ignored the sample, or the packet came twice.
        if self.live.newest_s() != Some(t_s) || before_s == Some(t_s) {
            return;
        }
        self.follow_settings();
        if let Some(row) = row.filter(|row| self.due.takes(row.t_s, self.settings.rate_hz)) {
            self.send(&row, read);
        }
        self.queue_row(NavigationLog::Imu, imu_row(sample));
        if !(0.0..ROWS_S).contains(&(t_s - self.rows_sent_s)) {
            self.rows_sent_s = t_s;
            self.send_rows();
        }
    }

    fn count(&mut self, sample: &ImuPacket) {
        self.nav.counters.imu_samples.count();
        let mut tally = self.nav.tally.lock();
        if let Some(last) = self.last_sample.replace(*sample) {
            tally.lost_samples += last.missing_before(sample);
        }
    }

    fn note(&mut self, status: Option<Status>) {
        let (comparison, settings) = (self.live.comparison(), &self.nav.settings);
        let mut tally = self.nav.tally.lock();
        self.contradiction.note(comparison, settings, &mut tally);
        let counts = self.live.counts();
        tally.refused = counts.refused;
        tally.out_of_time = counts.out_of_time;
        tally.restarts = self.live.restarts().into();
        if status.is_none_or(|status| status == Status::Waiting) {
            tally.latest = None;
        }
        let Some(status) = status else { return };
        if tally.status.replace(status) == Some(status) {
            return;
        }
        if !status.is_doubted() {
            return tracing::info!(status = status.name(), "navigation");
        }
        tally.doubted += 1;
        if worth_a_line(tally.doubted) {
            let why = self.live.unsound().map(|unsound| unsound.to_string());
            let why = why.unwrap_or_else(|| "directions contradict the gyros".into());
            tracing::warn!(why, times = tally.doubted, "inertial offsets are uncertain");
        }
    }

    fn direction(&mut self, observed: &ObservedDirection) {
        let settings = &self.nav.settings;
        let name = self.nav.cameras.get(observed.camera).map(|(name, _)| name);
        let Some(camera) = name.and_then(|name| settings.camera(name)) else {
            return;
        };
        let t_s = self.since_epoch_s(observed.utc) - settings.cameras[camera].delay_s;
        let towards = match self.targets.towards(observed.target, t_s) {
            Ok(towards) => towards,
            // The filter has not started yet.
            Err(NoDirection::NoFix) => return,
            Err(error) => {
                self.unknown += 1;
                if worth_a_line(self.unknown) {
                    tracing::warn!(%error, "a direction cannot be used");
                }
                return;
            }
        };
        let sigma_rad = settings.sigma_rad(observed.target, &observed.direction);
        self.live
            .measure(Measurement::Direction(DirectionObservation {
                t_s,
                camera,
                target: observed.target,
                unit: observed.direction.unit,
                sigma_rad,
                towards,
            }));
        self.nav.tally.lock().directions += 1;
    }

    /// Sends the offset at a row to line and archive.
    fn send(&mut self, row: &NavigationRow, read: Instant) {
        let Some((utc, offset)) = self.offset(row) else {
            self.nav.tally.lock().latest = None;
            return;
        };
        let age_s = row.t_s - self.live.seen_s();
        self.note_offset(&offset);
        if self.settings.sends(&offset) && self.nav.to_line.len() < MOST_EVENTS {
            let event = PropagatedEvent {
                propagated: propagated(&offset, utc, age_s),
                read,
            };
            // A line that is stuck sends nothing; the next offset is better.
            let _ = self.nav.to_line.try_send(LinkEvent::Propagated(event));
        }
        let row = propagated_row(utc, &offset, age_s, row.status);
        self.queue_row(NavigationLog::Propagated, row);
    }

    /// The offset at a row and its time; `None` before the start, and if the target cannot be pointed at.
    fn offset(&mut self, row: &NavigationRow) -> Option<(Timestamp, PropagatedOffset)> {
        row.attitude?;
        let target = self.nav.controls.snapshot().target;
        let towards = self.targets.aim(&target, row.t_s).ok()?;
        let offset = offset(row, &self.body_from_telescope, &towards).ok()??;
        let since = SignedDuration::try_from_secs_f64(row.t_s).ok()?;
        Some((self.epoch.checked_add(since).ok()?, offset))
    }

    fn follow_settings(&mut self) {
        let version = self.nav.controls.version(Topic::Other);
        if version != self.version {
            self.version = version;
            self.settings = self.nav.controls.config().navigation;
        }
    }

    fn note_offset(&self, offset: &PropagatedOffset) {
        let mut tally = self.nav.tally.lock();
        tally.offsets += 1;
        tally.uncertain += u64::from(offset.sigma_deg > self.settings.max_sigma_deg());
        tally.latest = Some(*offset);
    }

    fn queue_row(&mut self, log: NavigationLog, row: Vec<String>) {
        self.rows[log as usize].push_back(row);
    }

    fn send_rows(&mut self) {
        for (log, rows) in NavigationLog::ALL.into_iter().zip(&mut self.rows) {
            let rows = std::mem::take(rows);
            let count = rows.len() as u64;
            if count > 0
                && self
                    .nav
                    .rows
                    .try_send(NavigationRows { log, rows })
                    .is_err()
            {
                self.nav.tally.lock().rows_lost += count;
            }
        }
    }
}

#[cfg(test)]
mod tests;
