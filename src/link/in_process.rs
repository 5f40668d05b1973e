//! A controller in this program, instead of one at the other end of a wire.

use super::message::{Message, Messages};
use super::packet::{Direction, Packet, TelemetryPacket, id};
use super::parser::Parser;
use super::port::{BytePort, PortError};
use std::time::{Duration, Instant};

/// A controller in the same program that uses the offsets. The line's thread calls it, and everything to be sent waits meanwhile: each call
/// must return within 1 ms.
pub trait Controller: Send {
    /// Takes a message: the start of an exposure, an offset, or whether tracking is on.
    fn hear(&mut self, message: &Message);

    /// Its next message: [`Message::StartTracking`], a fix, a sample of its IMU; `None` if there is none. It is called at least a hundred times per
    /// second.
    fn say(&mut self) -> Option<Message>;

    /// Takes a packet for the ground, such as the housekeeping, which a controller may relay.
    fn hear_telemetry(&mut self, _packet: &TelemetryPacket) {}
}

/// The line to a controller in this program. It carries the same packets as a wire.
pub struct InProcess<C> {
    controller: C,
    parser: Parser,
    start: Instant,
    sequence: u16,
    /// Bytes from the controller that have not been read.
    said: Vec<u8>,
}

impl<C: Controller> InProcess<C> {
    pub fn new(controller: C) -> Self {
        Self {
            controller,
            parser: Parser::new(Direction::ToController),
            start: Instant::now(),
            sequence: 0,
            said: Vec::new(),
        }
    }

    /// The controller's next message as a packet. A message with a field that no packet can hold is not sent.
    fn ask(&mut self) {
        let Some(message) = self.controller.say() else {
            return;
        };
        self.sequence = self.sequence.wrapping_add(1);
        match message.packet(id::ASPECT, self.sequence) {
            Ok(packet) => self.said = packet.encode(),
            Err(error) => tracing::error!(%error, "a message of the controller is not sent"),
        }
    }
}

impl<C: Controller> BytePort for InProcess<C> {
    /// Returns at once: the controller's messages are already there.
    fn read(&mut self, buffer: &mut [u8], _: Duration) -> Result<usize, PortError> {
        if self.said.is_empty() {
            self.ask();
        }
        let count = self.said.len().min(buffer.len());
        buffer[..count].copy_from_slice(&self.said[..count]);
        self.said.drain(..count);
        Ok(count)
    }

    fn write(&mut self, bytes: &[u8], _: Duration) -> Result<(), PortError> {
        for packet in self.parser.feed(bytes, self.start.elapsed()) {
            match packet {
                Packet::Command(packet) => Messages::of(packet.payload())
                    .filter_map(|(_, message)| message.ok())
                    .for_each(|message| self.controller.hear(&message)),
                Packet::Telemetry(packet) => self.controller.hear_telemetry(&packet),
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::link::{CommandPacket, Solution};
    use std::collections::VecDeque;

    #[derive(Default)]
    struct Noting {
        to_say: VecDeque<Message>,
        heard: Vec<Message>,
        packets_for_the_ground: usize,
    }

    impl Controller for Noting {
        fn hear(&mut self, message: &Message) {
            self.heard.push(message.clone());
        }

        fn say(&mut self) -> Option<Message> {
            self.to_say.pop_front()
        }

        fn hear_telemetry(&mut self, _: &TelemetryPacket) {
            self.packets_for_the_ground += 1;
        }
    }

    fn offset() -> Message {
        Message::Solution(Solution {
            azimuth_deg: 0.125,
            elevation_deg: -0.25,
            roll_deg: 1.5,
            error_deg: 1e-5,
            time: "2013-09-21T18:00:00.250Z".parse().unwrap(),
        })
    }

    #[test]
    fn a_controller_in_the_program_hears_what_one_at_a_wire_would_be_sent() {
        let mut line = InProcess::new(Noting::default());
        let packet = offset().packet(id::CONTROLLER, 7).unwrap().encode();
        let housekeeping = crate::link::Housekeeping::default();
        let telemetry = housekeeping.packet("2013-09-21T18:00:00Z".parse().unwrap());
        let (first, rest) = packet.split_at(5);
        for bytes in [first, rest, &telemetry.unwrap().encode()] {
            line.write(bytes, Duration::ZERO).unwrap();
        }
        assert_eq!(line.controller.heard, [offset()]);
        assert_eq!(line.controller.packets_for_the_ground, 1);
    }

    #[test]
    fn what_it_says_comes_as_numbered_packets_however_small_the_buffer() {
        let said = [Message::StartTracking, Message::StopTracking];
        let mut line = InProcess::new(Noting {
            to_say: said.clone().into(),
            ..Noting::default()
        });
        let mut parser = Parser::new(Direction::ToAspect);
        let mut heard: Vec<CommandPacket> = Vec::new();
        let mut buffer = [0; 3];
        loop {
            match line.read(&mut buffer, Duration::ZERO).unwrap() {
                0 => break,
                count => heard.extend(
                    parser
                        .feed(&buffer[..count], Duration::ZERO)
                        .into_iter()
                        .filter_map(|packet| match packet {
                            Packet::Command(packet) => Some(packet),
                            Packet::Telemetry(_) => None,
                        }),
                ),
            }
        }
        let sequences: Vec<u16> = heard.iter().map(CommandPacket::sequence).collect();
        assert_eq!(sequences, [1, 2]);
        let messages = heard.iter().map(|one| Message::decode(one.payload()));
        assert_eq!(messages.collect::<Result<Vec<_>, _>>().unwrap(), said);
    }
}
