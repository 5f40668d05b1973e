//! Our side of the conversation: what to answer, and what to send around an exposure.
//!
//! A [`Responder`] is a state machine without threads, clocks or ports. The flight service hands it every command
//! packet and every exposure, and writes what it gives back.
//!
//! # Rules (HEROES flight program, 2013)
//!
//! 1. Packets for other ids, and aspect commands for the other computer or for none, are ignored unanswered.
//! 2. Every other command is answered: a receipt, then a result; start and stop of tracking by "tracking is on" or "off", too.
//! 3. While sending is enabled, tracking or not, the time of every exposure goes out before it starts.
//! 4. A solution goes out only while tracking is on and sending is enabled, only if its own exposure's time went
//!    out, and once; an error takes its place where there is none.

use super::command::{Command, Computer};
use super::message::{
    AspectCommand, CAMERA, ExposureStart, GpsFix, Message, MessageError, Solution, Telemetry, key,
};
use super::packet::{CommandPacket, id};
use jiff::Timestamp;
use std::collections::VecDeque;

/// Results of commands; a read answers with its value instead.
pub mod result {
    pub const DONE: u16 = 0;
    /// Known, but not carried out: not implemented, or its variables were refused.
    pub const NOT_IMPLEMENTED: u16 = 1;
    pub const UNKNOWN: u16 = 0xFFFF;
}

/// How many announced exposures may wait for their solutions.
const ANNOUNCEMENTS: usize = 64;
/// A GPS fix this far from the last one is taken for an error, deg.
const LATITUDE_JUMP_DEG: f32 = 5.0;
const LONGITUDE_JUMP_DEG: f32 = 15.0;

/// What the controller and the ground have set.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LinkState {
    /// The controller wants solutions.
    pub tracking: bool,
    /// This computer is the one that sends them.
    pub sending: bool,
    /// Helioprojective x (to solar west) and y (to solar north), where the ground has set it.
    pub target_arcsec: Option<(i16, i16)>,
    /// The last place that was believed.
    pub fix: Option<GpsFix>,
}

/// What a packet has changed.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Change {
    Tracking { on: bool },
    Sending { on: bool },
    Target { x_arcsec: i16, y_arcsec: i16 },
    Place(GpsFix),
}

/// What to send in answer to a packet, in this order, and what it has changed.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Reply {
    pub packets: Vec<Vec<u8>>,
    /// `None` also where a command set what was set already.
    pub change: Option<Change>,
}

/// Decides the answers of one aspect computer.
#[derive(Debug, Clone)]
pub struct Responder {
    computer: Computer,
    state: LinkState,
    sequence: u16,
    announced: VecDeque<Timestamp>,
}

impl Responder {
    /// A computer that is not tracking yet. Computer 1 sends from the start, computer 2 when told to. `fix` is the
    /// place the flight starts from, where it is known: GPS messages are judged by it.
    pub fn new(computer: Computer, fix: Option<GpsFix>) -> Self {
        Self {
            computer,
            state: LinkState {
                tracking: false,
                sending: computer == Computer::One,
                target_arcsec: None,
                fix,
            },
            sequence: 0,
            announced: VecDeque::new(),
        }
    }

    pub fn state(&self) -> &LinkState {
        &self.state
    }

    /// Answers a packet that came from the line; `now` goes into the answers.
    ///
    /// The error is a `now` that no packet can hold; the command has been carried out all the same.
    pub fn handle(
        &mut self,
        packet: &CommandPacket,
        now: Timestamp,
    ) -> Result<Reply, MessageError> {
        let Some(key) = self.key_for_us(packet) else {
            return Ok(Reply::default());
        };
        let before = self.state;
        let (value, answer) = match Message::decode(packet.payload()) {
            Ok(message) => self.execute(&message),
            Err(MessageError::UnknownKey { .. }) => (result::UNKNOWN, None),
            // An aspect command outside the table is unknown, whatever its variables.
            Err(MessageError::Variables { key, .. }) if super::command::row_of(key).is_none() => {
                (result::UNKNOWN, None)
            }
            Err(_) => (result::NOT_IMPLEMENTED, None),
        };
        let sequence = packet.sequence();
        let receipt = Telemetry::Receipt { sequence };
        let outcome = Telemetry::Result {
            sequence,
            key,
            value,
        };
        let mut packets = vec![receipt.packet(now)?.encode(), outcome.packet(now)?.encode()];
        if let Some(answer) = answer {
            packets.push(self.numbered(&answer)?);
        }
        let change = self.change_since(&before);
        Ok(Reply { packets, change })
    }

    /// The packet that announces the exposure about to start at `time`; `None` while sending is disabled.
    pub fn exposure_starts(&mut self, time: Timestamp) -> Result<Option<Vec<u8>>, MessageError> {
        if !self.state.sending {
            return Ok(None);
        }
        let camera = CAMERA;
        let packet = self.numbered(&Message::ExposureStart(ExposureStart { camera, time }))?;
        if self.announced.len() == ANNOUNCEMENTS {
            self.announced.pop_front();
        }
        self.announced.push_back(time);
        Ok(Some(packet))
    }

    /// The packet with a solution whose `time` was given to [`exposure_starts`](Self::exposure_starts); `None`
    /// where it must not go.
    pub fn solution(&mut self, solution: &Solution) -> Result<Option<Vec<u8>>, MessageError> {
        self.conclude_exposure(solution.time, &Message::Solution(*solution))
    }

    /// The packet that says why the exposure announced for `time` has no solution; `None` where it must not go.
    pub fn error(&mut self, code: u16, time: Timestamp) -> Result<Option<Vec<u8>>, MessageError> {
        self.conclude_exposure(time, &Message::Error { code })
    }

    /// Takes an announcement back whose packet could not be written: its solution will not go out.
    pub fn forget_exposure(&mut self, time: Timestamp) {
        self.announced.retain(|&announced| announced != time);
    }

    /// The one message that follows an announced exposure.
    fn conclude_exposure(
        &mut self,
        time: Timestamp,
        message: &Message,
    ) -> Result<Option<Vec<u8>>, MessageError> {
        let Some(at) = self
            .announced
            .iter()
            .position(|&announced| announced == time)
        else {
            return Ok(None);
        };
        self.announced.remove(at);
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

    /// The key that names the command in our answer, or `None` where the packet is not ours to answer.
    fn key_for_us(&self, packet: &CommandPacket) -> Option<u16> {
        if !matches!(packet.target(), id::ASPECT | id::EVERYONE) {
            return None;
        }
        let (first, rest) = packet.payload().split_first_chunk()?;
        match u16::from_le_bytes(*first) {
            key::ASPECT_COMMAND => {
                let key = u16::from_le_bytes(*rest.first_chunk()?);
                self.computer.is_addressed_by(key).then_some(key)
            }
            key => Some(key),
        }
    }

    /// Carries a message out: its result, and the message that answers it.
    fn execute(&mut self, message: &Message) -> (u16, Option<Message>) {
        match message {
            Message::StartTracking => {
                self.state.tracking = true;
                (result::DONE, Some(Message::TrackingOn))
            }
            Message::StopTracking => {
                self.state.tracking = false;
                (result::DONE, Some(Message::TrackingOff))
            }
            Message::Gps(fix) => (self.take_fix(*fix), None),
            Message::Aspect(command) => (self.command(command), None),
            // Messages of our own side are no commands to us.
            _ => (result::UNKNOWN, None),
        }
    }

    fn command(&mut self, command: &AspectCommand) -> u16 {
        match Command::try_from(command) {
            Ok(Command::NoOp) => {}
            Ok(Command::StartSending) => self.state.sending = true,
            Ok(Command::StopSending) => self.state.sending = false,
            Ok(Command::SetTarget { x_arcsec, y_arcsec }) => {
                self.state.target_arcsec = Some((x_arcsec, y_arcsec));
            }
            Ok(Command::NotImplemented(_)) => return result::NOT_IMPLEMENTED,
            Err(_) => return result::UNKNOWN,
        }
        result::DONE
    }

    /// (0, 0) is what a receiver without a fix sends; a jump is a mistake of the receiver or of the line.
    fn take_fix(&mut self, fix: GpsFix) -> u16 {
        let on_earth = fix.latitude_deg.abs() <= 90.0 && fix.longitude_deg.abs() <= 360.0;
        let nowhere = fix.latitude_deg == 0.0 && fix.longitude_deg == 0.0;
        let jumps = self.state.fix.is_some_and(|last| {
            let longitude = (fix.longitude_deg - last.longitude_deg).rem_euclid(360.0);
            (fix.latitude_deg - last.latitude_deg).abs() > LATITUDE_JUMP_DEG
                || longitude.min(360.0 - longitude) > LONGITUDE_JUMP_DEG
        });
        if nowhere || jumps || !on_earth {
            return result::NOT_IMPLEMENTED;
        }
        self.state.fix = Some(fix);
        result::DONE
    }

    fn change_since(&self, before: &LinkState) -> Option<Change> {
        let state = &self.state;
        if state.tracking != before.tracking {
            return Some(Change::Tracking { on: state.tracking });
        }
        if state.sending != before.sending {
            return Some(Change::Sending { on: state.sending });
        }
        if state.target_arcsec != before.target_arcsec {
            let target = |(x_arcsec, y_arcsec)| Change::Target { x_arcsec, y_arcsec };
            return state.target_arcsec.map(target);
        }
        if state.fix != before.fix {
            return state.fix.map(Change::Place);
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::link::packet::{Direction, Packet};

    fn time(second: i64) -> Timestamp {
        Timestamp::from_second(1_379_786_400 + second).unwrap()
    }

    fn solution(second: i64) -> Solution {
        Solution {
            azimuth_deg: 0.01,
            elevation_deg: -0.02,
            roll_deg: 0.0,
            error_deg: 1e-5,
            time: time(second),
        }
    }

    /// What a packet to the controller says, without its sequence number and time.
    #[derive(Debug, PartialEq)]
    enum Said {
        Message(Message),
        Answer(Telemetry),
    }

    fn said(bytes: &[u8]) -> Said {
        match Packet::decode(Direction::ToController, bytes).unwrap() {
            Packet::Command(packet) => Said::Message(Message::decode(packet.payload()).unwrap()),
            Packet::Telemetry(packet) => Said::Answer(Telemetry::decode(&packet).unwrap()),
        }
    }

    fn answers(sequence: u16, key: u16, value: u16) -> Vec<Said> {
        let receipt = Telemetry::Receipt { sequence };
        let outcome = Telemetry::Result {
            sequence,
            key,
            value,
        };
        vec![Said::Answer(receipt), Said::Answer(outcome)]
    }

    fn tell(responder: &mut Responder, message: &Message) -> (Vec<Said>, Option<Change>) {
        tell_payload(responder, message.packet(id::ASPECT, 5).unwrap().payload())
    }

    fn tell_payload(responder: &mut Responder, payload: &[u8]) -> (Vec<Said>, Option<Change>) {
        let packet = CommandPacket::new(id::ASPECT, 5, payload.to_vec()).unwrap();
        let reply = responder.handle(&packet, time(0)).unwrap();
        (
            reply.packets.iter().map(|p| said(p)).collect(),
            reply.change,
        )
    }

    fn aspect(key: u16, variables: &[u16]) -> Message {
        Message::Aspect(AspectCommand::new(key, variables.to_vec()).unwrap())
    }

    fn computer_one() -> Responder {
        Responder::new(Computer::One, None)
    }

    #[test]
    fn start_and_stop_of_tracking_get_a_receipt_a_result_and_their_answer() {
        let mut responder = computer_one();
        assert!(!responder.state().tracking);
        let (packets, change) = tell(&mut responder, &Message::StartTracking);
        let mut expected = answers(5, 0x1000, 0);
        expected.push(Said::Message(Message::TrackingOn));
        assert_eq!(
            (packets, change),
            (expected, Some(Change::Tracking { on: true }))
        );
        let (packets, change) = tell(&mut responder, &Message::StopTracking);
        let mut expected = answers(5, 0x1001, 0);
        expected.push(Said::Message(Message::TrackingOff));
        assert_eq!(
            (packets, change),
            (expected, Some(Change::Tracking { on: false }))
        );
    }

    #[test]
    fn the_carried_out_commands_are_done_the_other_known_ones_not_and_the_rest_unknown() {
        let mut responder = computer_one();
        let mut result = |key, variables: &[u16]| tell(&mut responder, &aspect(key, variables)).0;
        assert_eq!(result(0x1000, &[]), answers(5, 0x1000, 0));
        assert_eq!(result(0x1040, &[]), answers(5, 0x1040, 0));
        assert_eq!(result(0x1030, &[]), answers(5, 0x1030, 0));
        assert_eq!(result(0x1412, &[1, 2]), answers(5, 0x1412, 0));
        assert_eq!(result(0x1451, &[15000]), answers(5, 0x1451, 1));
        assert_eq!(result(0x1A10, &[]), answers(5, 0x1A10, 1));
        assert_eq!(result(0x1FF0, &[]), answers(5, 0x1FF0, 0xFFFF));
    }

    #[test]
    fn a_command_without_its_variables_is_refused_and_an_unknown_message_is_unknown() {
        let mut responder = computer_one();
        let mut told = |payload: &[u8]| tell_payload(&mut responder, payload);
        assert_eq!(
            told(&[0xFF, 0x10, 0x12, 0x14, 1, 0]),
            (answers(5, 0x1412, 1), None)
        );
        assert_eq!(
            told(&[0xFF, 0x10, 0xF2, 0x1F, 1, 0]),
            (answers(5, 0x1FF2, 0xFFFF), None)
        );
        assert_eq!(told(&[0x0A, 0, 0, 0]), (answers(5, 0x000A, 1), None));
        assert_eq!(told(&[0x34, 0x12]), (answers(5, 0x1234, 0xFFFF), None));
        assert_eq!(told(&[0x00, 0x11]), (answers(5, 0x1100, 0xFFFF), None));
    }

    #[test]
    fn what_is_not_for_this_computer_is_ignored_unanswered() {
        let mut responder = computer_one();
        for key in [0x2040, 0x0040, 0x4040] {
            assert_eq!(tell(&mut responder, &aspect(key, &[])), (vec![], None));
        }
        for payload in [&[][..], &[0xFF], &[0xFF, 0x10], &[0xFF, 0x10, 0x40]] {
            assert_eq!(tell_payload(&mut responder, payload), (vec![], None));
        }
        let elsewhere = Message::StartTracking.packet(id::CONTROLLER, 1).unwrap();
        assert_eq!(responder.handle(&elsewhere, time(0)), Ok(Reply::default()));
        assert_eq!(responder.state(), computer_one().state());

        let to_everyone = Message::StartTracking.packet(id::EVERYONE, 1).unwrap();
        assert_eq!(
            responder
                .handle(&to_everyone, time(0))
                .unwrap()
                .packets
                .len(),
            3
        );
        assert_eq!(
            tell(&mut responder, &aspect(0x3040, &[])).0,
            answers(5, 0x3040, 0)
        );
    }

    #[test]
    fn a_target_is_signed_and_reported_once() {
        let mut responder = computer_one();
        let target = aspect(0x1412, &[(-300_i16).cast_unsigned(), 450]);
        let (x_arcsec, y_arcsec) = (-300, 450);
        assert_eq!(
            tell(&mut responder, &target).1,
            Some(Change::Target { x_arcsec, y_arcsec })
        );
        assert_eq!(tell(&mut responder, &target), (answers(5, 0x1412, 0), None));
        assert_eq!(responder.state().target_arcsec, Some((-300, 450)));
    }

    #[test]
    fn a_place_is_believed_unless_it_is_nowhere_or_a_jump() {
        let mut responder = computer_one();
        let mut fix = |latitude_deg, longitude_deg| {
            let fix = GpsFix {
                latitude_deg,
                longitude_deg,
            };
            tell(&mut responder, &Message::Gps(fix)).1.is_some()
        };
        assert!(!fix(0.0, 0.0));
        assert!(!fix(91.0, 10.0));
        assert!(fix(34.49, -104.25), "the first place, where none is known");
        assert!(!fix(0.0, 0.0));
        assert!(!fix(39.6, -104.25), "5.1 deg north");
        assert!(!fix(34.49, -89.0), "15.25 deg east");
        assert!(fix(39.4, -90.0));
        assert!(
            fix(39.0, -76.0),
            "judged by the last place that was believed"
        );
        assert!(fix(39.0, 284.5), "the same meridian counted the other way");
    }

    #[test]
    fn an_exposure_is_announced_while_sending_is_enabled_tracking_or_not() {
        let mut responder = computer_one();
        let packet = responder.exposure_starts(time(1)).unwrap().unwrap();
        let announced = ExposureStart {
            camera: 1,
            time: time(1),
        };
        assert_eq!(
            said(&packet),
            Said::Message(Message::ExposureStart(announced))
        );
        tell(&mut responder, &aspect(0x1040, &[]));
        assert_eq!(responder.exposure_starts(time(2)), Ok(None));
        let mut second = Responder::new(Computer::Two, None);
        assert_eq!(second.exposure_starts(time(1)), Ok(None));
    }

    #[test]
    fn a_solution_goes_only_while_tracking_and_sending_and_after_its_own_announcement_and_once() {
        let mut responder = computer_one();
        responder.exposure_starts(time(1)).unwrap();
        assert_eq!(responder.solution(&solution(1)), Ok(None), "not tracking");
        tell(&mut responder, &Message::StartTracking);
        assert_eq!(responder.solution(&solution(2)), Ok(None), "not announced");
        responder.exposure_starts(time(3)).unwrap();
        responder.exposure_starts(time(4)).unwrap();
        let packet = responder.solution(&solution(3)).unwrap().unwrap();
        assert_eq!(said(&packet), Said::Message(Message::Solution(solution(3))));
        assert_eq!(responder.solution(&solution(3)), Ok(None), "sent already");
        let packet = responder.error(8, time(4)).unwrap().unwrap();
        assert_eq!(said(&packet), Said::Message(Message::Error { code: 8 }));
        assert_eq!(
            responder.solution(&solution(4)),
            Ok(None),
            "an error went instead"
        );
        responder.exposure_starts(time(5)).unwrap();
        responder.forget_exposure(time(5));
        assert_eq!(
            responder.solution(&solution(5)),
            Ok(None),
            "its announcement did not go"
        );
        responder.exposure_starts(time(6)).unwrap();
        tell(&mut responder, &aspect(0x1040, &[]));
        assert_eq!(
            responder.solution(&solution(6)),
            Ok(None),
            "sending disabled"
        );
    }

    #[test]
    fn packets_to_the_controller_are_numbered_one_by_one() {
        let mut responder = computer_one();
        responder.sequence = u16::MAX - 1;
        let mut sequence = |second| {
            let packet = responder.exposure_starts(time(second)).unwrap().unwrap();
            u16::from_le_bytes([packet[4], packet[5]])
        };
        assert_eq!([sequence(1), sequence(2), sequence(3)], [u16::MAX, 0, 1]);
    }
}
