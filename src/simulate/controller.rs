//! Emulator of the gondola's controller at the other end of the line: it starts tracking and checks all received packets.
//!
//! A solution must belong to an announced exposure, packets must be numbered consecutively, and every command of
//! the controller must be answered. Faults are counted by kind in the [`Report`] and are never fatal: only the
//! port can fail.

use super::sensors::{SensorError, Sensors};
use crate::link::message::CAMERA;
use crate::link::{
    BytePort, CommandPacket, Direction, ExposureStart, Message, Messages, MoonAnswer, Packet,
    Parser, PortError, Propagated, Solution, Telemetry, TelemetryPacket, id,
};
use jiff::{SignedDuration, Timestamp};
use std::collections::VecDeque;
use std::fmt;
use std::time::{Duration, Instant};

/// How long one [`Controller::poll`] waits for bytes.
pub const POLL: Duration = Duration::from_millis(20);
/// Time after which a start or stop without an answer is sent again.
const TIMEOUT: Duration = Duration::from_secs(1);
const WRITE_TIMEOUT: Duration = Duration::from_millis(500);
/// Number of announced exposures, and of own commands, that are remembered.
const MEMORY: usize = 256;
/// A solution's time is rounded to 1 ms, an announcement's to 0.24 us (an f64 of seconds).
const SAME_TIME: SignedDuration = SignedDuration::from_micros(501);

/// Faults of the received packets.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Faults {
    /// Sync words from which no packet came: wrong checksums, false headers, packets cut off.
    pub broken: u64,
    /// Breaks in the numbering: packets were lost, or the sender restarted.
    pub out_of_sequence: u64,
    /// Packets with unknown keys, payloads too short, numbers that are not finite.
    pub unreadable: u64,
    /// Messages that are not for a controller, and answers to commands that it never sent.
    pub unexpected: u64,
    /// Solutions of exposures that were not announced, or repeated for the same exposure.
    pub unannounced: u64,
    /// Solutions and errors after "tracking is off".
    pub unasked: u64,
    /// Commands answered by anything but "done".
    pub refused: u64,
}

impl Faults {
    pub fn total(&self) -> u64 {
        let packets = self.broken + self.unreadable + self.unexpected;
        packets + self.out_of_sequence + self.unannounced + self.unasked + self.refused
    }
}

/// Counts so far.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Report {
    pub tracking_on: u64,
    pub tracking_off: u64,
    pub announcements: u64,
    /// Every solution in the order of arrival, also the faulty ones.
    pub solutions: Vec<Solution>,
    pub errors: u64,
    /// Offsets by the gyros, in the order of arrival.
    pub propagated: Vec<Propagated>,
    /// Answers to requests for the Moon.
    pub moon: Vec<MoonAnswer>,
    pub receipts: u64,
    pub results: u64,
    /// Telemetry other than receipts and results.
    pub other_telemetry: u64,
    /// Bytes that belong to no packet. They are no fault in themselves: the controller may start to listen in the middle of a packet.
    pub stray_bytes: u64,
    pub faults: Faults,
}

impl fmt::Display for Report {
    fn fmt(&self, out: &mut fmt::Formatter) -> fmt::Result {
        let Self {
            faults, solutions, ..
        } = self;
        writeln!(
            out,
            "received: {} solutions, {} by gyros, {} errors, {} announcements, {} tracking on, {} tracking off, \
             {} receipts, {} results, {} other telemetry",
            solutions.len(),
            self.propagated.len(),
            self.errors,
            self.announcements,
            self.tracking_on,
            self.tracking_off,
            self.receipts,
            self.results,
            self.other_telemetry,
        )?;
        write!(
            out,
            "bad: {} broken, {} out of sequence, {} unreadable, {} unexpected, {} unannounced, {} unasked, \
             {} refused; {} stray bytes",
            faults.broken,
            faults.out_of_sequence,
            faults.unreadable,
            faults.unexpected,
            faults.unannounced,
            faults.unasked,
            faults.refused,
            self.stray_bytes,
        )
    }
}

/// The tracking state that the controller wants.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Wish {
    Track,
    Rest,
}

/// Emulator of the controller. It wants tracking from the start.
pub struct Controller {
    parser: Parser,
    wish: Wish,
    /// The tracking state last reported by the aspect system.
    answer: Option<Wish>,
    asked_at: Option<Duration>,
    sequence: u16,
    sent: VecDeque<u16>,
    last_heard: Option<u16>,
    announced: VecDeque<Timestamp>,
    report: Report,
    sensors: Option<Sensors>,
}

impl Default for Controller {
    fn default() -> Self {
        Self::new()
    }
}

impl Controller {
    pub fn new() -> Self {
        Self {
            parser: Parser::new(Direction::ToController),
            wish: Wish::Track,
            answer: None,
            asked_at: None,
            sequence: 0,
            sent: VecDeque::new(),
            last_heard: None,
            announced: VecDeque::new(),
            report: Report::default(),
            sensors: None,
        }
    }

    /// The same with the gondola's IMU and GPS receiver; they join the flight when its first exposure is announced.
    pub fn with_sensors(self, sensors: Sensors) -> Self {
        Self {
            sensors: Some(sensors),
            ..self
        }
    }

    /// Counts so far.
    pub fn report(&self) -> &Report {
        &self.report
    }

    /// Whether the aspect system has reported the tracking state that this controller wants.
    pub fn is_obeyed(&self) -> bool {
        self.answer == Some(self.wish)
    }

    /// Wants tracking to stop from now on.
    pub fn stop_tracking(&mut self) {
        self.wish = Wish::Rest;
        self.asked_at = None;
    }

    /// Wants tracking again from now on.
    pub fn start_tracking(&mut self) {
        self.wish = Wish::Track;
        self.asked_at = None;
    }

    /// The solutions received since the last call; they are removed from the report.
    pub fn take_solutions(&mut self) -> Vec<Solution> {
        std::mem::take(&mut self.report.solutions)
    }

    /// The offsets by the gyros received since the last call; they are removed from the report.
    pub fn take_propagated(&mut self) -> Vec<Propagated> {
        std::mem::take(&mut self.report.propagated)
    }

    /// Sends a message under the controller's next number, and expects its answers.
    pub fn send(&mut self, port: &mut dyn BytePort, message: &Message) -> Result<(), PortError> {
        self.sequence = self.sequence.wrapping_add(1);
        // A message with a field that no packet can hold is not sent.
        if let Ok(packet) = message.packet(id::ASPECT, self.sequence) {
            port.write(&packet.encode(), WRITE_TIMEOUT)?;
        }
        remember(&mut self.sent, self.sequence);
        Ok(())
    }

    /// One step: sends requests that are due, waits at most [`POLL`] for bytes, checks the received packets and
    /// returns their messages. `now` is a monotonic time from any origin.
    pub fn poll(
        &mut self,
        port: &mut dyn BytePort,
        now: Duration,
    ) -> Result<Vec<Message>, PortError> {
        self.ask(port, now)?;
        let mut wait = POLL;
        if let Some(sensors) = &mut self.sensors {
            if let Err(error) = sensors.speak(port, now) {
                self.silence(error)?;
            } else {
                wait = POLL.min(sensors.wait(now));
            }
        }
        let mut buffer = [0; 1024];
        let asked = Instant::now();
        let count = port.read(&mut buffer, wait)?;
        let read_at = now + asked.elapsed();
        let packets = self.parser.feed(&buffer[..count], now);
        let rejected = self.parser.rejected();
        self.report.faults.broken = rejected.packets;
        self.report.stray_bytes = rejected.bytes;
        let messages: Vec<Message> = packets.iter().flat_map(|p| self.receive(p)).collect();
        for message in &messages {
            if let (Message::ExposureStart(exposure), Some(sensors)) = (message, &mut self.sensors)
            {
                sensors.join(exposure.time, read_at);
            }
        }
        Ok(messages)
    }

    /// Polls until `stopped` returns true, then stops the tracking and waits at most 1 s for the answer.
    /// `heard` is called with every received message.
    pub fn run(
        &mut self,
        port: &mut dyn BytePort,
        mut stopped: impl FnMut() -> bool,
        mut heard: impl FnMut(&Message),
    ) -> Result<&Report, PortError> {
        let start = Instant::now();
        while !stopped() {
            self.poll(port, start.elapsed())?
                .iter()
                .for_each(&mut heard);
        }
        self.stop_tracking();
        let end = start.elapsed() + TIMEOUT;
        while !self.is_obeyed() && start.elapsed() < end {
            self.poll(port, start.elapsed())?
                .iter()
                .for_each(&mut heard);
        }
        Ok(&self.report)
    }

    /// Handles an error of the sensors: they fall silent if the flight cannot be simulated any more; a lost port is returned to the caller.
    fn silence(&mut self, error: SensorError) -> Result<(), PortError> {
        match error {
            SensorError::Port(error) => Err(error),
            SensorError::Flight(error) => {
                tracing::error!(%error, "the simulated IMU is silent from now on");
                self.sensors = None;
                Ok(())
            }
        }
    }

    fn ask(&mut self, port: &mut dyn BytePort, now: Duration) -> Result<(), PortError> {
        let waiting = self
            .asked_at
            .is_some_and(|at| now.saturating_sub(at) < TIMEOUT);
        if self.is_obeyed() || waiting {
            return Ok(());
        }
        let message = match self.wish {
            Wish::Track => Message::StartTracking,
            Wish::Rest => Message::StopTracking,
        };
        self.send(port, &message)?;
        self.asked_at = Some(now);
        Ok(())
    }

    fn receive(&mut self, packet: &Packet) -> Vec<Message> {
        match packet {
            Packet::Command(packet) => self.receive_command(packet),
            Packet::Telemetry(packet) => {
                self.receive_telemetry(packet);
                Vec::new()
            }
        }
    }

    fn receive_command(&mut self, packet: &CommandPacket) -> Vec<Message> {
        let sequence = packet.sequence();
        if self
            .last_heard
            .is_some_and(|last| sequence != last.wrapping_add(1))
        {
            self.report.faults.out_of_sequence += 1;
        }
        self.last_heard = Some(sequence);
        if !matches!(packet.target(), id::CONTROLLER | id::EVERYONE) {
            self.report.faults.unexpected += 1;
            return Vec::new();
        }
        let (mut read, mut readable) = (Vec::new(), true);
        let mut messages = Messages::of(packet.payload());
        for (_, message) in messages.by_ref() {
            match message {
                Ok(message) => {
                    self.take(&message);
                    read.push(message);
                }
                Err(_) => readable = false,
            }
        }
        if !readable || messages.not_understood() > 0 {
            self.report.faults.unreadable += 1;
        }
        read
    }

    fn take(&mut self, message: &Message) {
        match message {
            Message::TrackingOn => {
                self.report.tracking_on += 1;
                self.answer = Some(Wish::Track);
            }
            Message::TrackingOff => {
                self.report.tracking_off += 1;
                self.answer = Some(Wish::Rest);
            }
            Message::ExposureStart(exposure) => self.take_announcement(exposure),
            Message::Solution(solution) => self.take_solution(solution),
            Message::Error(_) => {
                self.report.errors += 1;
                self.check_asked();
            }
            Message::Propagated(propagated) => {
                self.report.propagated.push(*propagated);
                self.check_asked();
            }
            message => match message.moon_answer() {
                Some(answer) => self.report.moon.push(answer),
                None => self.report.faults.unexpected += 1,
            },
        }
    }

    fn take_announcement(&mut self, exposure: &ExposureStart) {
        self.report.announcements += 1;
        if exposure.camera != CAMERA {
            self.report.faults.unexpected += 1;
        }
        remember(&mut self.announced, exposure.time);
    }

    fn take_solution(&mut self, solution: &Solution) {
        self.report.solutions.push(*solution);
        self.check_asked();
        let same_time =
            |announced: &Timestamp| announced.duration_since(solution.time).abs() <= SAME_TIME;
        match self.announced.iter().position(same_time) {
            Some(at) => drop(self.announced.remove(at)),
            None => self.report.faults.unannounced += 1,
        }
    }

    fn check_asked(&mut self) {
        if self.answer == Some(Wish::Rest) {
            self.report.faults.unasked += 1;
        }
    }

    fn receive_telemetry(&mut self, packet: &TelemetryPacket) {
        use crate::link::packet::telemetry_type::{RECEIPT, RESULT};
        if !matches!(packet.kind(), RECEIPT | RESULT) {
            self.report.other_telemetry += 1;
            return;
        }
        match Telemetry::decode(packet) {
            Ok(Telemetry::Receipt(receipt)) => {
                self.report.receipts += 1;
                self.check_sent(receipt.sequence);
            }
            Ok(Telemetry::Result(result)) => {
                self.report.results += 1;
                self.check_sent(result.sequence);
                if result.value != crate::link::control::result::DONE {
                    self.report.faults.refused += 1;
                }
            }
            Err(_) => self.report.faults.unreadable += 1,
        }
    }

    fn check_sent(&mut self, sequence: u16) {
        if !self.sent.contains(&sequence) {
            self.report.faults.unexpected += 1;
        }
    }
}

fn remember<T>(memory: &mut VecDeque<T>, item: T) {
    if memory.len() == MEMORY {
        memory.pop_front();
    }
    memory.push_back(item);
}

#[cfg(test)]
mod tests;
