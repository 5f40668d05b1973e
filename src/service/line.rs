//! The link's thread: only this thread reads and writes the port.
//!
//! # Rules
//!
//! 1. Only exposures of the sending camera are announced ([`config::Link::sending_camera`]), and only announced ones are reported.
//! 2. If the peer does not read, the thread waits briefly once; then the queue is dropped, and the newest packet goes first when the
//!    peer reads again. While bytes pile up in the system, exposures are not announced: late announcements are useless.
//! 3. Ages and waits are monotonic: a step of the clock does not stop the line.
//! 4. A port that is lost is opened again; nothing else waits for it.
//! 5. Packets that come by wire are accepted. Datagrams pass the [guard](crate::link::guard) first.

mod moon;
mod outcome;
mod picture;
mod receive;

use super::messages::{
    LinkEvent, MoonState, Outcome, PropagatedEvent, ReceivesSamples, ReceivesTelemetry,
};
use super::shared::Shared;
use super::tally::{LineTally, note_latency};
use super::worker::Heartbeat;
use crate::commands::controls::{Controls, Topic};
use crate::config;
use crate::link::Counters;
use crate::link::{
    Computer, Connection, Direction, Exposure, FrameMarks, LinkState, MessageError, Packet, Parser,
    PortError, Responder, TelemetryPacket,
};
use crate::log::worth_a_line;
use crossbeam_channel::{Receiver, RecvTimeoutError};
use jiff::Timestamp;
use moon::MoonRequests;
use picture::PictureUnderWay;
use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

/// How long the thread waits for something to send before it checks for received bytes.
const TIMEOUT: Duration = Duration::from_millis(5);
/// The same if a filter takes the IMU's samples, each with its time of arrival.
const SAMPLE_TIMEOUT: Duration = Duration::from_millis(1);
/// How long a packet waits for space in the system's buffer. At 115200 baud the system's buffer drains 230 bytes in it.
const WRITE_TIMEOUT: Duration = Duration::from_millis(20);
/// Bytes in the system's buffer beyond which the line is too slow: 45 ms at 115200 baud.
const BACKLOG: usize = 512;
/// Age beyond which an offset by the gyros is not sent: the next one is better.
const OLDEST_OFFSET: Duration = Duration::from_millis(100);

/// Shared state of the link's thread.
#[derive(Clone)]
pub(super) struct LineContext {
    pub controls: Controls,
    pub tally: Shared<LineTally>,
    pub counters: Arc<Counters>,
    pub moon_state: Shared<MoonState>,
    /// Receiver of the IMU's samples; `None` without a filter.
    pub navigation: Option<Arc<dyn ReceivesSamples>>,
    /// Receivers of the telemetry besides the port.
    pub outputs: Arc<dyn ReceivesTelemetry>,
}

pub(super) struct Line<'a> {
    connection: &'a mut Connection,
    responder: Responder,
    parser: Parser,
    controls: Controls,
    settings: config::Link,
    version: u64,
    start: Instant,
    outcomes: u64,
    unsent: u64,
    /// Number of packets that came again.
    repeated: u64,
    stalled: bool,
    stopping_since: Option<Instant>,
    picture: Option<PictureUnderWay>,
    /// Packets of the second's marks, kept until the line is free.
    marks: VecDeque<Vec<u8>>,
    tally: Shared<LineTally>,
    counters: Arc<Counters>,
    /// Arrival of the horizon frame whose roll was sent last.
    last_roll: Option<Instant>,
    moon_state: Shared<MoonState>,
    moon_requests: MoonRequests,
    /// Receiver of the IMU's samples; `None` without a filter.
    navigation: Option<Arc<dyn ReceivesSamples>>,
    outputs: Arc<dyn ReceivesTelemetry>,
}

impl<'a> Line<'a> {
    pub fn new(connection: &'a mut Connection, context: LineContext) -> Self {
        let LineContext {
            controls,
            tally,
            counters,
            moon_state,
            navigation,
            outputs,
        } = context;
        let version = controls.version(Topic::Link);
        let settings = controls.config().link;
        let computer = Computer::numbered(settings.computer).unwrap_or(Computer::One);
        let state = LinkState {
            tracking: controls.tracking(),
            sending: controls.sending().unwrap_or(computer.sends_by_default()),
        };
        Self {
            connection,
            responder: Responder::new(computer, state),
            parser: Parser::new(Direction::ToAspect),
            controls,
            settings,
            version,
            start: Instant::now(),
            outcomes: 0,
            last_roll: None,
            unsent: 0,
            repeated: 0,
            stalled: false,
            stopping_since: None,
            picture: None,
            marks: VecDeque::new(),
            tally,
            counters,
            moon_state,
            moon_requests: MoonRequests::default(),
            navigation,
            outputs,
        }
    }

    /// Sends and receives until the line is to be closed and nothing is left to send.
    pub fn run(&mut self, events: &Receiver<LinkEvent>, closing: &AtomicBool, beat: &Heartbeat) {
        let timeout = match self.navigation {
            Some(_) => SAMPLE_TIMEOUT,
            None => TIMEOUT,
        };
        loop {
            beat.beat();
            self.reopen();
            match events.recv_timeout(timeout) {
                Ok(event) => self.process(event, events),
                Err(_) if closing.load(Ordering::Relaxed) => return,
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => std::thread::sleep(timeout),
            }
            self.receive();
            self.answer_moon_requests();
            self.finish_stopping();
            if events.is_empty() {
                self.send_marks();
                self.send_picture();
            }
            self.publish();
        }
    }

    fn publish(&mut self) {
        let mut tally = self.tally.lock();
        tally.reopened = self.connection.reopened();
        tally.never_open = self.connection.was_never_open();
        tally.conversation = *self.responder.state();
    }

    /// Sends what an event asks for. If the port does not take it, outcomes that still wait are dropped: they would only be older.
    fn process(&mut self, event: LinkEvent, events: &Receiver<LinkEvent>) {
        self.follow_settings();
        self.dispatch(event);
        if self.stalled {
            let is_outcome = |event: &LinkEvent| matches!(event, LinkEvent::Outcome(_));
            let outdated = events.try_iter().filter(is_outcome).count();
            self.counters.outdated.add(outdated as u64);
            self.responder.forget_all();
            self.marks.clear();
        }
    }

    fn dispatch(&mut self, event: LinkEvent) {
        match event {
            LinkEvent::ExposureStarts(exposure) => self.announce(exposure),
            LinkEvent::Outcome(outcome) => self.conclude(&outcome),
            LinkEvent::Propagated(event) => self.propagate(&event),
            LinkEvent::Housekeeping(time, housekeeping) => {
                let is_sent = self.send_housekeeping(housekeeping.packet(time));
                self.tally.lock().housekeeping += u64::from(is_sent);
            }
            LinkEvent::Cameras(time, counts) => {
                for counts in counts {
                    self.send_housekeeping(counts.packet(time));
                }
            }
            LinkEvent::Marks(time, marks) => self.queue_marks(time, &marks),
            LinkEvent::Picture(picture) => {
                self.picture = Some(PictureUnderWay::new(picture, Instant::now()));
            }
        }
    }

    /// Sends housekeeping to the ground; returns whether the port took it.
    fn send_housekeeping(&mut self, packet: Result<TelemetryPacket, MessageError>) -> bool {
        match packet {
            Ok(packet) => {
                self.outputs.receive_telemetry(&packet);
                self.backlog() <= BACKLOG && self.send(&packet.encode())
            }
            Err(error) => {
                self.note_unsent(&error, "housekeeping was not sent");
                false
            }
        }
    }

    /// Keeps the second's marks until the line is free; those of the second before, if not sent yet, are outdated.
    fn queue_marks(&mut self, time: Timestamp, marks: &[FrameMarks]) {
        self.marks.clear();
        for one in marks {
            match one.packet(time) {
                Ok(packet) => {
                    self.outputs.receive_telemetry(&packet);
                    self.marks.push_back(packet.encode());
                }
                Err(error) => self.note_unsent(&error, "housekeeping was not sent"),
            }
        }
    }

    /// Sends marks when the system's buffer is empty: right after housekeeping they would fill it so far that an exposure is not announced.
    fn send_marks(&mut self) {
        while !self.stalled
            && self.backlog() == 0
            && let Some(packet) = self.marks.pop_front()
        {
            self.send(&packet);
        }
    }

    /// Sends the parts of a picture that are due, when nothing else waits.
    fn send_picture(&mut self) {
        let baud = self.settings.baud;
        while !self.stalled {
            let backlog = self.backlog();
            let Some(under_way) = self.picture.as_mut() else {
                return;
            };
            let Some(part) = under_way.next_due(baud, backlog, Instant::now()) else {
                if under_way.is_complete() {
                    self.picture = None;
                    self.tally.lock().pictures += 1;
                }
                return;
            };
            self.outputs.receive_telemetry(&part);
            self.send(&part.encode());
        }
    }

    fn follow_settings(&mut self) {
        let version = self.controls.version(Topic::Link);
        if version != self.version {
            self.version = version;
            self.settings = self.controls.config().link;
            if self.controls.tracking() {
                // Saved values that came after the start, because a disk hung.
                self.responder.go_on_tracking();
            }
        }
    }

    fn announce(&mut self, exposure: Exposure) {
        if u32::from(exposure.camera) != self.settings.sending_camera {
            return;
        }
        if self.backlog() > BACKLOG {
            self.tally.lock().unannounced += 1;
            return;
        }
        match self.responder.exposure_starts(exposure) {
            Ok(Some(packet)) => {
                if self.send(&packet) {
                    self.counters.announced.count();
                } else {
                    self.tally.lock().unannounced += u64::from(self.connection.is_wanted());
                    self.responder.forget(exposure);
                }
            }
            Ok(None) => {}
            Err(error) => self.note_unsent(&error, "an exposure was not announced"),
        }
    }

    fn conclude(&mut self, outcome: &Outcome) {
        let exposure = outcome.exposure;
        if u32::from(exposure.camera) == self.settings.sending_camera {
            self.outcomes += 1;
            let divisor = u64::from(self.settings.solution_divisor);
            if !(self.outcomes - 1).is_multiple_of(divisor) {
                return self.responder.forget(exposure);
            }
        }
        let max_age = Duration::from_millis(self.settings.max_solution_age_ms.into());
        if outcome.age() > max_age {
            self.counters.outdated.count();
            return self.responder.forget(exposure);
        }
        match self.conclusion(outcome) {
            Ok(Some(packet)) => {
                if !self.send(&packet) {
                } else if outcome.solution().is_some() {
                    self.note_sent(outcome);
                } else {
                    self.counters.errors.count();
                }
            }
            Ok(None) => {}
            Err(error) => self.note_unsent(&error, "a solution was not sent"),
        }
    }

    fn propagate(&mut self, event: &PropagatedEvent) {
        if self.backlog() > BACKLOG || event.read.elapsed() > OLDEST_OFFSET {
            return;
        }
        match self.responder.propagated(event.propagated) {
            Ok(Some(packet)) => {
                if self.send(&packet) {
                    self.counters.propagated.count();
                    let mut tally = self.tally.lock();
                    note_latency(&mut tally.propagated_latencies, event.read.elapsed());
                }
            }
            Ok(None) => {}
            Err(error) => self.note_unsent(&error, "an offset by the gyros was not sent"),
        }
    }

    fn note_sent(&mut self, outcome: &Outcome) {
        // Under the lock, because the latencies must be those of the solutions counted.
        let mut tally = self.tally.lock();
        self.counters.solutions.count();
        note_latency(&mut tally.latencies, outcome.arrived.elapsed());
        let roll = outcome.roll.map(|roll| roll.arrived);
        if let Some(arrived) = roll.filter(|_| roll != self.last_roll) {
            note_latency(&mut tally.roll_latencies, arrived.elapsed());
        }
        self.last_roll = roll;
    }

    /// The packet that concludes an exposure: its solution, or the reason why there is none.
    fn conclusion(&mut self, outcome: &Outcome) -> Result<Option<Vec<u8>>, MessageError> {
        match outcome.solution() {
            Some(solution) => self.responder.solution(outcome.exposure, &solution),
            None => self.responder.error(outcome.exposure, outcome.error_code()),
        }
    }

    /// The results of commands to stop sending, when the announced exposure is concluded or too old to be.
    fn finish_stopping(&mut self) {
        let max_age = Duration::from_millis(self.settings.max_solution_age_ms.into());
        if !self.responder.is_stopping() {
            self.stopping_since = None;
        } else if self
            .stopping_since
            .get_or_insert_with(Instant::now)
            .elapsed()
            > max_age
        {
            self.responder.forget_all();
        }
        match self.responder.stopped(Timestamp::now()) {
            Ok(packets) if packets.is_empty() => {}
            Ok(packets) => {
                self.answer(&packets);
                self.note_conversation();
            }
            Err(error) => self.note_unsent(&error, "a command was not answered"),
        }
    }

    /// Sends answers to commands: receipts, results, and requested data.
    fn answer(&mut self, packets: &[Vec<u8>]) {
        for packet in packets {
            if let Ok(Packet::Telemetry(packet)) = Packet::decode(Direction::ToController, packet) {
                self.outputs.receive_telemetry(&packet);
            }
            self.send(packet);
        }
    }

    fn note_conversation(&self) {
        let state = *self.responder.state();
        tracing::info!(?state, "by command");
        let default = self.computer_sends_by_default();
        if self.controls.sending().unwrap_or(default) != state.sending {
            self.controls.note_sending(state.sending);
        }
        if self.controls.tracking() != state.tracking {
            self.controls.note_tracking(state.tracking);
        }
    }

    fn computer_sends_by_default(&self) -> bool {
        let computer = Computer::numbered(self.settings.computer);
        computer.is_none_or(Computer::sends_by_default)
    }

    fn backlog(&mut self) -> usize {
        self.connection.port().map_or(0, |port| port.backlog())
    }

    /// Sends a packet; returns whether the port took it.
    fn send(&mut self, packet: &[u8]) -> bool {
        let Some(port) = self.connection.port() else {
            return false;
        };
        let timeout = match self.stalled {
            true => Duration::ZERO,
            false => WRITE_TIMEOUT,
        };
        let Err(error) = port.write(packet, timeout) else {
            self.stalled = false;
            return true;
        };
        self.tally.lock().failed += 1;
        if matches!(error, PortError::Stalled { .. }) {
            port.discard_backlog();
            self.stalled = true;
            if worth_a_line(self.tally.lock().failed) {
                tracing::warn!(%error, failed = self.tally.lock().failed, "a packet was not sent");
            }
        } else {
            self.lose(&error);
        }
        false
    }

    /// Notes a message that no packet can hold: the clock is out of range, and so is every further message.
    fn note_unsent(&mut self, error: &MessageError, what: &'static str) {
        self.unsent += 1;
        if worth_a_line(self.unsent) {
            tracing::error!(%error, unsaid = self.unsent, what);
        }
    }

    fn lose(&mut self, error: &PortError) {
        self.tally.lock().lost += 1;
        if worth_a_line(self.tally.lock().lost) {
            tracing::error!(%error, lost = self.tally.lock().lost, "the line is lost");
        }
        self.connection.lose(self.start.elapsed());
    }

    /// Opens a lost port again. State of the old connection is dropped; the controller's settings still hold.
    fn reopen(&mut self) {
        if self.connection.revive(self.start.elapsed()) {
            self.parser.abandon();
            self.responder.forget_all();
            self.picture = None;
            self.marks.clear();
            self.stalled = false;
        }
    }
}

#[cfg(test)]
mod tests;
