//! The aspect system's side of the conversation: the answers, and the messages around an exposure.
//!
//! A [`Responder`] is a state machine without threads, clocks or ports. The flight service passes it every command
//! packet and every exposure, and writes the packets that it returns. Commands that go beyond the conversation are
//! executed by a [`Control`].
//!
//! # Rules (HEROES flight program, 2013)
//!
//! 1. Packets for other ids, and aspect commands for the other computer or for none, are ignored unanswered.
//! 2. Every other packet is answered: a receipt, then a result for each of its commands, in order; start and stop of tracking by
//!    "tracking is on" or "off", too.
//! 3. While sending is enabled, tracking or not, the time of every exposure is sent before it starts.
//! 4. A solution is sent only while tracking is on and sending is enabled, only if the time of its own exposure was
//!    sent, once, and never after one of a later exposure; if there is no solution, an error is sent instead.
//! 5. Sending changes between exposures: a command that disables it is executed, and its result sent, when the announced
//!    exposure has been concluded, so that a hand-over to the other computer leaves no gap and no duplicate.
//! 6. An offset by the gyros is sent while tracking is on and sending is enabled, whatever was announced.
//! 7. A request for the Moon is answered by its result at once, and by the Moon's place when a picture has been solved, whether or
//!    not tracking or sending is on.

use super::computer::Computer;
use super::control::{Carried, CommandResult, Control};
use super::message::{
    AspectCommand, CAMERA, ExposureStart, Message, MessageError, Messages, MoonRequest, NoSolution,
    Propagated, Solution, key,
};
use super::moon::MoonAnswer;
use super::packet::{CommandPacket, id};
use super::telemetry::{CommandOutcome, Receipt, Telemetry};
use jiff::Timestamp;
use std::collections::VecDeque;

/// Number of announced exposures that may wait for their solutions.
const ANNOUNCEMENTS: usize = 64;

/// State of the conversation, set by the controller and the ground. Initially no solutions are wanted, and nothing is sent.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct LinkState {
    /// The controller wants solutions.
    pub tracking: bool,
    /// This computer sends them.
    pub sending: bool,
}

/// Answers to a packet, in this order, and whether it has changed the conversation.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Reply {
    pub packets: Vec<Vec<u8>>,
    /// The commands to this computer that the packet held.
    pub commands: Vec<ReceivedCommand>,
    /// Requests for the Moon that wait for a picture, each with its packet's sequence number.
    pub moon_requests: Vec<(u16, MoonRequest)>,
    pub changed: bool,
}

/// A command to this computer, and its result.
#[derive(Debug, Clone, PartialEq)]
pub struct ReceivedCommand {
    /// The key, including the computers' bits.
    pub key: u16,
    /// `None` if it could not be read.
    pub message: Option<Message>,
    pub execution: Execution,
}

/// Result of a command.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Execution {
    Result(CommandResult),
    /// With the reason, if known.
    Refused(Option<String>),
    /// It waits for the announced exposure.
    Waits,
}

/// One exposure of one of this computer's cameras, identified by the announced time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Exposure {
    /// The number of the pitch-yaw camera, from 1.
    pub camera: u16,
    pub start: Timestamp,
}

/// A command to stop sending that waits for the announced exposure.
#[derive(Debug, Clone, Copy)]
struct Stop {
    sequence: u16,
    key: u16,
}

/// Generates the answers of one aspect computer.
#[derive(Debug, Clone)]
pub struct Responder {
    computer: Computer,
    state: LinkState,
    sequence: u16,
    announced: VecDeque<Exposure>,
    /// Sending ends when the announced exposures are concluded.
    stopping: bool,
    /// The commands that are answered then.
    stops: Vec<Stop>,
}

/// The kind of answer to a message.
enum Answer {
    Result(CommandResult),
    /// Done, and reported by a message, too.
    Message(Message),
    /// The result comes later.
    Later,
}

impl Answer {
    fn execution(&self, control: &mut dyn Control) -> Execution {
        match self {
            Self::Result(CommandResult::Refused) => Execution::Refused(control.take_reason()),
            Self::Result(result) => Execution::Result(*result),
            Self::Message(_) => Execution::Result(CommandResult::Done),
            Self::Later => Execution::Waits,
        }
    }
}

impl Responder {
    /// A computer in the state left by controller and ground.
    pub fn new(computer: Computer, state: LinkState) -> Self {
        Self {
            computer,
            state,
            sequence: 0,
            announced: VecDeque::new(),
            stopping: false,
            stops: Vec::new(),
        }
    }

    /// Resumes tracking after a restart, without a command.
    pub fn go_on_tracking(&mut self) {
        self.state.tracking = true;
    }

    pub fn state(&self) -> &LinkState {
        &self.state
    }

    /// Answers a packet that came from the line; `now` is the time of the answers.
    ///
    /// It fails if no packet can hold `now`; the commands have been executed all the same.
    pub fn handle(
        &mut self,
        packet: &CommandPacket,
        now: Timestamp,
        control: &mut dyn Control,
    ) -> Result<Reply, MessageError> {
        if !matches!(packet.target(), id::ASPECT | id::EVERYONE) {
            return Ok(Reply::default());
        }
        let before = self.state;
        let sequence = packet.sequence();
        let (mut answers, mut commands) = (Vec::new(), Vec::new());
        let mut moon_requests = Vec::new();
        for (bytes, message) in Messages::of(packet.payload()) {
            let Some(key) = self.key_for_us(bytes) else {
                continue;
            };
            let answer = match &message {
                Ok(message) => self.execute(message, Stop { sequence, key }, control),
                Err(error) => Answer::Result(malformed(error, control)),
            };
            let execution = answer.execution(control);
            if let (Ok(Message::MoonRequest(request)), Answer::Result(CommandResult::Done)) =
                (&message, &answer)
            {
                moon_requests.push((sequence, *request));
            }
            commands.push(ReceivedCommand {
                key,
                message: message.ok(),
                execution,
            });
            answers.push((key, answer));
        }
        if answers.is_empty() {
            return Ok(Reply::default());
        }
        Ok(Reply {
            commands,
            moon_requests,
            changed: self.state != before,
            packets: self.answered(sequence, answers, now)?,
        })
    }

    /// The commands to this computer in a packet: their keys, and the messages that could be read.
    pub fn commands_in(&self, packet: &CommandPacket) -> Vec<(u16, Option<Message>)> {
        let messages = Messages::of(packet.payload());
        let commands =
            messages.filter_map(|(bytes, message)| Some((self.key_for_us(bytes)?, message.ok())));
        commands.collect()
    }

    /// The receipt of a packet, and the results of its commands, with their keys.
    fn answered(
        &mut self,
        sequence: u16,
        answers: Vec<(u16, Answer)>,
        now: Timestamp,
    ) -> Result<Vec<Vec<u8>>, MessageError> {
        let receipt = Telemetry::Receipt(Receipt { sequence });
        let mut packets = vec![receipt.packet(now)?.encode()];
        for (key, answer) in answers {
            let result = match &answer {
                Answer::Result(result) => Some(*result),
                Answer::Message(_) => Some(CommandResult::Done),
                Answer::Later => None,
            };
            if let Some(result) = result {
                packets.push(result_packet(sequence, key, result, now)?);
            }
            if let Answer::Message(message) = answer {
                packets.push(self.numbered(&message)?);
            }
        }
        Ok(packets)
    }

    /// The packet that announces the exposure about to start; `None` while sending is disabled.
    pub fn exposure_starts(&mut self, exposure: Exposure) -> Result<Option<Vec<u8>>, MessageError> {
        if !self.state.sending || self.stopping {
            return Ok(None);
        }
        let (camera, time) = (CAMERA, exposure.start);
        let packet = self.numbered(&Message::ExposureStart(ExposureStart { camera, time }))?;
        if self.announced.len() == ANNOUNCEMENTS {
            self.announced.pop_front();
        }
        self.announced.push_back(exposure);
        Ok(Some(packet))
    }

    /// The packet with an exposure's solution, whose `time` is the exposure's start; `None` if it must not be sent.
    pub fn solution(
        &mut self,
        exposure: Exposure,
        solution: &Solution,
    ) -> Result<Option<Vec<u8>>, MessageError> {
        self.conclude(exposure, &Message::Solution(*solution))
    }

    /// The packet with the reason why an exposure has no solution; `None` if it must not be sent.
    pub fn error(
        &mut self,
        exposure: Exposure,
        code: u16,
    ) -> Result<Option<Vec<u8>>, MessageError> {
        self.conclude(exposure, &Message::Error(NoSolution { code }))
    }

    /// The packet with an offset by the gyros; `None` if it must not be sent.
    pub fn propagated(&mut self, propagated: Propagated) -> Result<Option<Vec<u8>>, MessageError> {
        match self.state.tracking && self.state.sending && !self.stopping {
            true => self.numbered(&Message::Propagated(propagated)).map(Some),
            false => Ok(None),
        }
    }

    /// The packet that answers a request for the Moon.
    pub fn moon(&mut self, answer: MoonAnswer) -> Result<Vec<u8>, MessageError> {
        self.numbered(&answer.into())
    }

    /// Withdraws an announcement: its packet could not be written, or no message will follow it.
    pub fn forget(&mut self, exposure: Exposure) {
        self.announced.retain(|&announced| announced != exposure);
    }

    /// Withdraws all announcements.
    pub fn forget_all(&mut self) {
        self.announced.clear();
    }

    /// Whether a command to stop sending waits for an announced exposure. [`forget_all`](Self::forget_all) ends the
    /// waiting.
    pub fn is_stopping(&self) -> bool {
        self.stopping
    }

    /// The results of commands to stop sending, once the announced exposures are concluded. To be called after every event.
    pub fn stopped(&mut self, now: Timestamp) -> Result<Vec<Vec<u8>>, MessageError> {
        if self.stopping && !self.announced.is_empty() {
            return Ok(Vec::new());
        }
        if std::mem::take(&mut self.stopping) {
            self.state.sending = false;
        }
        let stops = self.stops.drain(..);
        stops
            .map(|stop| result_packet(stop.sequence, stop.key, CommandResult::Done, now))
            .collect()
    }

    /// The one message that follows an announced exposure. Exposures announced before it will have none.
    fn conclude(
        &mut self,
        exposure: Exposure,
        message: &Message,
    ) -> Result<Option<Vec<u8>>, MessageError> {
        let Some(at) = self.announced.iter().position(|&e| e == exposure) else {
            return Ok(None);
        };
        self.announced.drain(..=at);
        if !(self.state.tracking && self.state.sending) {
            return Ok(None);
        }
        self.numbered(message).map(Some)
    }

    /// A message to the controller as a packet with the next sequence number.
    fn numbered(&mut self, message: &Message) -> Result<Vec<u8>, MessageError> {
        let sequence = self.sequence.wrapping_add(1);
        let bytes = message.packet(id::CONTROLLER, sequence)?.encode();
        self.sequence = sequence;
        Ok(bytes)
    }

    /// The key that identifies the command in the answer, or `None` if the message is not for this computer.
    fn key_for_us(&self, message: &[u8]) -> Option<u16> {
        let (first, rest) = message.split_first_chunk()?;
        match u16::from_le_bytes(*first) {
            key::ASPECT_COMMAND => {
                let key = u16::from_le_bytes(*rest.first_chunk()?);
                self.computer.is_addressed_by(key).then_some(key)
            }
            key => Some(key),
        }
    }

    /// Executes a message.
    fn execute(&mut self, message: &Message, stop: Stop, control: &mut dyn Control) -> Answer {
        match message {
            Message::StartTracking => {
                self.state.tracking = true;
                Answer::Message(Message::TrackingOn)
            }
            Message::StopTracking => {
                self.state.tracking = false;
                Answer::Message(Message::TrackingOff)
            }
            Message::Gps(fix) => Answer::Result(control.take_fix(*fix)),
            Message::MoonRequest(request) => Answer::Result(control.request_moon(request)),
            Message::Aspect(command) => self.command(command, stop, control),
            // Messages of the aspect system's own side are no commands to it.
            _ => Answer::Result(CommandResult::Unknown),
        }
    }

    fn command(
        &mut self,
        command: &AspectCommand,
        stop: Stop,
        control: &mut dyn Control,
    ) -> Answer {
        match control.carry_out(command) {
            Carried::Result(result) => Answer::Result(result),
            Carried::StartSending => {
                self.state.sending = true;
                self.stopping = false;
                Answer::Result(CommandResult::Done)
            }
            Carried::StopSending => self.stop_sending(stop),
        }
    }

    /// Stops sending; at once, if no message will follow the announced exposures.
    fn stop_sending(&mut self, stop: Stop) -> Answer {
        if self.state.sending && self.state.tracking && !self.announced.is_empty() {
            self.stopping = true;
            self.stops.push(stop);
            return Answer::Later;
        }
        self.state.sending = false;
        Answer::Result(CommandResult::Done)
    }
}

/// The result for a packet that holds no known message.
fn malformed(error: &MessageError, control: &dyn Control) -> CommandResult {
    match error {
        MessageError::UnknownKey { .. } => CommandResult::Unknown,
        // An aspect command outside the table is unknown, whatever its variables.
        MessageError::Variables { key, .. } if !control.knows(*key) => CommandResult::Unknown,
        MessageError::NotFinite { .. } => CommandResult::Refused,
        _ => CommandResult::NotImplemented,
    }
}

fn result_packet(
    sequence: u16,
    key: u16,
    result: CommandResult,
    now: Timestamp,
) -> Result<Vec<u8>, MessageError> {
    let value = result.code();
    let result = Telemetry::Result(CommandOutcome {
        sequence,
        key,
        value,
    });
    Ok(result.packet(now)?.encode())
}

#[cfg(test)]
mod tests;
