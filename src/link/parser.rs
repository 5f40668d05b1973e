//! Finds packets in a stream of bytes, with any bytes in between.
//!
//! # Method
//!
//! Every sync word in the stream is a *candidate*, whether or not it stands inside another one. When all bytes of a candidate
//! have come, its checksum is checked; the first one that passes, in the order of the stream, is a packet, and
//! all bytes before its end are done. So a false header never holds back a good packet that has come, whatever length it
//! claims, and the buffer never holds more than one packet of the greatest length.
//!
//! # When it fails
//!
//! A false header passes the checksum once in 65536 times. If a packet's payload holds a whole packet, the inner one is
//! found if it is complete first.

use super::packet::{COMMAND_HEADER, Direction, Packet, PacketError, SYNC};
use std::time::Duration;

/// Longest pause between two bytes of one packet. At 115200 baud a byte takes 0.09 ms.
pub const SILENCE: Duration = Duration::from_millis(100);

/// Number of rejected packets for which the reasons are kept.
const REASONS: usize = 16;

/// Counts of bytes that belong to no packet.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Rejected {
    /// Bytes that belong to no packet.
    pub bytes: u64,
    /// Sync words outside good packets from which no packet came: wrong checksums, false headers, packets cut off.
    pub packets: u64,
}

/// Finds the packets in a stream of bytes.
#[derive(Debug, Clone)]
pub struct Parser {
    direction: Direction,
    bytes: Vec<u8>,
    /// The sync words in `bytes`, in order. The first one is always open.
    candidates: Vec<Candidate>,
    /// Position from which to search for the next sync word.
    searched: usize,
    last_byte: Duration,
    rejected: Rejected,
    reasons: Vec<PacketError>,
}

#[derive(Debug, Clone)]
struct Candidate {
    start: usize,
    state: State,
}

#[derive(Debug, Clone, PartialEq)]
enum State {
    /// Not all of its bytes have come.
    Open,
    /// All of its bytes have come, and they are no packet.
    Refuted(PacketError),
}

impl Parser {
    /// A parser of the bytes that run in one direction of a line.
    pub fn new(direction: Direction) -> Self {
        Self {
            direction,
            bytes: Vec::new(),
            candidates: Vec::new(),
            searched: 0,
            last_byte: Duration::ZERO,
            rejected: Rejected::default(),
            reasons: Vec::new(),
        }
    }

    /// Rejected bytes so far. Bytes of a packet that is not complete are not counted yet.
    pub fn rejected(&self) -> Rejected {
        self.rejected
    }

    /// Reasons why packets were rejected, for the first 16.
    pub fn reasons(&self) -> &[PacketError] {
        &self.reasons
    }

    /// Takes the bytes that came at `now` (a monotonic time since any start) and gives the packets complete by them.
    ///
    /// An unfinished packet whose last byte is older than [`SILENCE`] is abandoned first, also when `bytes` is empty.
    pub fn feed(&mut self, bytes: &[u8], now: Duration) -> Vec<Packet> {
        if now.saturating_sub(self.last_byte) > SILENCE {
            self.abandon();
        }
        if bytes.is_empty() {
            return Vec::new();
        }
        self.last_byte = now;
        self.bytes.extend_from_slice(bytes);
        self.find_candidates();
        let mut packets = Vec::new();
        while let Some((start, length, packet)) = self.judge_candidates() {
            self.reject_to(start);
            self.remove(length);
            packets.push(packet);
        }
        self.reject_to(self.first_open());
        packets
    }

    /// Abandons an incomplete packet, as on a line that was lost.
    pub fn abandon(&mut self) {
        self.reject_to(self.bytes.len());
    }

    fn find_candidates(&mut self) {
        while let Some(pair) = self.bytes.get(self.searched..self.searched + SYNC.len()) {
            if pair == SYNC {
                self.candidates.push(Candidate {
                    start: self.searched,
                    state: State::Open,
                });
            }
            self.searched += 1;
        }
    }

    /// The first candidate that is a packet: its start, its length and the packet.
    fn judge_candidates(&mut self) -> Option<(usize, usize, Packet)> {
        let open = self
            .candidates
            .iter_mut()
            .filter(|c| c.state == State::Open);
        for candidate in open {
            let bytes = &self.bytes[candidate.start..];
            let Some(length) = Packet::length(self.direction, bytes) else {
                continue;
            };
            let Some(bytes) = bytes.get(..length) else {
                continue;
            };
            match Packet::decode(self.direction, bytes) {
                Ok(packet) => return Some((candidate.start, length, packet)),
                Err(error) => candidate.state = State::Refuted(error),
            }
        }
        None
    }

    /// Start of the bytes that may yet be part of a packet.
    fn first_open(&self) -> usize {
        let open = self.candidates.iter().find(|c| c.state == State::Open);
        open.map_or(self.searched, |candidate| candidate.start)
    }

    /// Drops the first `count` bytes as rejected.
    fn reject_to(&mut self, count: usize) {
        let rejected = self.candidates.iter().take_while(|c| c.start < count);
        self.rejected.packets += rejected.clone().count() as u64;
        self.rejected.bytes += count as u64;
        let left = REASONS.saturating_sub(self.reasons.len());
        let reasons = rejected
            .take(left)
            .map(|c| c.reason(&self.bytes, self.direction));
        self.reasons.extend(reasons);
        self.remove(count);
    }

    /// Drops the first `count` bytes and the candidates that begin in them.
    fn remove(&mut self, count: usize) {
        self.bytes.drain(..count);
        self.candidates.retain(|c| c.start >= count);
        for candidate in &mut self.candidates {
            candidate.start -= count;
        }
        self.searched = self.searched.saturating_sub(count);
    }
}

impl Candidate {
    /// Reason why it is no packet; one that is still open was cut off.
    fn reason(&self, bytes: &[u8], direction: Direction) -> PacketError {
        match &self.state {
            State::Refuted(error) => error.clone(),
            State::Open => {
                let found = &bytes[self.start..];
                PacketError::Length {
                    expected: Packet::length(direction, found).unwrap_or(COMMAND_HEADER),
                    found: found.len(),
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::link::packet::{CommandPacket, TelemetryPacket, id};
    use proptest::prelude::*;
    use proptest::test_runner::RngSeed;

    const START: Duration = Duration::from_secs(7);

    fn stop(sequence: u16) -> Packet {
        Packet::Command(CommandPacket::new(id::ASPECT, sequence, vec![1, 0x10]).unwrap())
    }

    fn to_aspect() -> Parser {
        Parser::new(Direction::ToAspect)
    }

    #[test]
    fn packets_after_garbage_half_packets_and_wrong_checksums_are_found() {
        let mut wrong = stop(3).encode();
        wrong[8] ^= 1;
        let half = &stop(4).encode()[..6];
        let stream = [
            b"noise",
            &stop(1).encode()[..],
            &wrong,
            half,
            &stop(2).encode(),
        ]
        .concat();
        let mut parser = to_aspect();
        assert_eq!(parser.feed(&stream, START), [stop(1), stop(2)]);
        let (bytes, packets) = (5 + 10 + 6, 2);
        assert_eq!(parser.rejected(), Rejected { bytes, packets });
    }

    #[test]
    fn a_false_header_does_not_hold_back_the_good_packet_inside_it() {
        let false_command = [0x9A, 0xC3, 0x30, 0xFF];
        let stream = [&false_command[..], &stop(1).encode()].concat();
        assert_eq!(to_aspect().feed(&stream, START), [stop(1)]);

        let false_telemetry = [0x9A, 0xC3, 0x82, 0x30, 0xFF, 0xFF];
        let answer = Packet::Command(CommandPacket::new(1, 9, vec![0, 0x11]).unwrap());
        let stream = [&false_telemetry[..], &answer.encode()].concat();
        let mut parser = Parser::new(Direction::ToController);
        assert_eq!(parser.feed(&stream, START), [answer]);
        assert_eq!(parser.rejected().packets, 1);
    }

    #[test]
    fn a_packet_that_pauses_too_long_is_abandoned_and_the_next_one_found() {
        let bytes = stop(1).encode();
        let mut parser = to_aspect();
        assert!(parser.feed(&bytes[..5], START).is_empty());
        assert_eq!(parser.feed(&bytes[5..], START + SILENCE), [stop(1)]);

        assert!(parser.feed(&bytes[..5], START).is_empty());
        let late = START + SILENCE + Duration::from_millis(1);
        assert!(parser.feed(&bytes[5..], late).is_empty());
        assert_eq!(parser.feed(&bytes, late), [stop(1)]);
        let (bytes, packets) = (10, 1);
        assert_eq!(parser.rejected(), Rejected { bytes, packets });
    }

    #[test]
    fn silence_alone_is_enough_to_abandon_a_packet() {
        let mut parser = to_aspect();
        parser.feed(&stop(1).encode()[..9], START);
        assert_eq!(parser.rejected().packets, 0);
        parser.feed(&[], START + 2 * SILENCE);
        let (bytes, packets) = (9, 1);
        assert_eq!(parser.rejected(), Rejected { bytes, packets });
    }

    #[test]
    fn a_sync_word_in_a_payload_is_part_of_its_packet() {
        let payload = [&SYNC[..], &[0; 40], &SYNC].concat();
        let packet = Packet::Command(CommandPacket::new(id::ASPECT, 1, payload).unwrap());
        let mut parser = to_aspect();
        let one_by_one = packet.encode();
        let found: Vec<_> = one_by_one
            .iter()
            .flat_map(|b| parser.feed(&[*b], START))
            .collect();
        assert_eq!(found, [packet]);
        assert_eq!(parser.rejected(), Rejected::default());
    }

    #[test]
    fn a_stream_of_nothing_but_headers_does_not_grow_the_buffer_for_ever() {
        let mut parser = Parser::new(Direction::ToController);
        let longest = 16 + 65535;
        for _ in 0..200 {
            parser.feed(&[0x9A, 0xC3, 0x82, 0x30, 0xFF, 0xFF].repeat(100), START);
            assert!(parser.bytes.len() < longest + 600);
        }
    }

    fn packets() -> impl Strategy<Value = Packet> {
        let payload = || prop::collection::vec(any::<u8>(), 0..40);
        let command =
            (any::<bool>(), any::<u16>(), payload()).prop_map(|(all, sequence, payload)| {
                let target = if all { id::EVERYONE } else { id::CONTROLLER };
                Packet::Command(CommandPacket::new(target, sequence, payload).unwrap())
            });
        let kind = prop::sample::select(vec![0x01, 0x03, 0x70, 0x72, 0x73, 0x82, 0x83, 0xE1]);
        let telemetry = (kind, any::<(u32, u32)>(), payload()).prop_map(|(kind, time, payload)| {
            Packet::Telemetry(TelemetryPacket::new(kind, id::ASPECT, time, payload).unwrap())
        });
        prop_oneof![command, telemetry]
    }

    /// Random bytes, a header without a packet, a packet cut off, with a wrong bit or a wrong length.
    fn garbage() -> impl Strategy<Value = Vec<u8>> {
        let header = prop::sample::select(vec![0x01, 0x30, 0x82, 0xE1, 0xFF]);
        let false_header = (header, prop::collection::vec(any::<u8>(), 0..20))
            .prop_map(|(kind, rest)| [&SYNC[..], &[kind], &rest].concat());
        let half = (packets(), any::<prop::sample::Index>()).prop_map(|(packet, at)| {
            let bytes = packet.encode();
            bytes[..at.index(bytes.len())].to_vec()
        });
        let wrong_bit = (packets(), any::<prop::sample::Index>()).prop_map(|(packet, bit)| {
            let mut bytes = packet.encode();
            let bit = bit.index(8 * bytes.len());
            bytes[bit / 8] ^= 1 << (bit % 8);
            bytes
        });
        let wrong_length = (packets(), 1_u8..=255).prop_map(|(packet, more)| {
            let mut bytes = packet.encode();
            let at = match packet {
                Packet::Command(_) => 3,
                Packet::Telemetry(_) => 4,
            };
            bytes[at] = bytes[at].wrapping_add(more);
            bytes
        });
        prop_oneof![
            prop::collection::vec(any::<u8>(), 0..30),
            false_header,
            half,
            wrong_bit,
            wrong_length
        ]
    }

    /// A false header that claims a packet of this many bytes.
    fn claim(direction: Direction, length: usize) -> Vec<u8> {
        match direction {
            Direction::ToAspect => [&SYNC[..], &[id::ASPECT, (length - 8) as u8]].concat(),
            Direction::ToController => {
                let [low, high] = ((length - 16) as u16).to_le_bytes();
                [&SYNC[..], &[0x82, id::ASPECT, low, high]].concat()
            }
        }
    }

    proptest! {
        // A fixed seed: random bytes pass a 16-bit checksum often enough to matter over many runs.
        #![proptest_config(ProptestConfig { rng_seed: RngSeed::Fixed(20130921), ..ProptestConfig::default() })]

        #[test]
        fn every_good_packet_survives_garbage_however_the_bytes_are_cut(
            stream in prop::collection::vec((garbage(), packets()), 1..8),
            cuts in prop::collection::vec(1_usize..60, 1..10),
        ) {
            let bytes: Vec<u8> = stream.iter().flat_map(|(g, p)| [g.clone(), p.encode()].concat()).collect();
            let mut parser = Parser::new(Direction::ToController);
            let (mut rest, mut found, mut cuts) = (&bytes[..], Vec::new(), cuts.iter().cycle());
            while !rest.is_empty() {
                let (chunk, after) = rest.split_at(rest.len().min(*cuts.next().unwrap()));
                found.extend(parser.feed(chunk, START));
                rest = after;
            }
            let good: Vec<Packet> = stream.iter().map(|(_, p)| p.clone()).collect();
            prop_assert_eq!(found, good);
            let noise: usize = stream.iter().map(|(g, _)| g.len()).sum();
            prop_assert_eq!(parser.rejected().bytes, noise as u64);
        }

        #[test]
        fn a_good_packet_is_given_with_its_last_byte_whatever_a_false_header_before_it_claims(
            packet in packets(),
            claimed in 16_usize..70_000,
            to_controller in any::<bool>(),
        ) {
            let (direction, packet) = match to_controller {
                true => (Direction::ToController, packet),
                // Only commands run towards us.
                false => (Direction::ToAspect, stop(claimed as u16)),
            };
            let header = claim(direction, claimed.min(if to_controller { 65_551 } else { 263 }));
            let mut parser = Parser::new(direction);
            prop_assert!(parser.feed(&header, START).is_empty());
            let bytes = packet.encode();
            let (last, others) = bytes.split_last().unwrap();
            prop_assert!(parser.feed(others, START).is_empty());
            prop_assert_eq!(parser.feed(&[*last], START), [packet]);
        }

        #[test]
        fn arbitrary_bytes_never_panic_and_are_all_accounted_for(
            chunks in prop::collection::vec((prop_oneof![garbage(), prop::collection::vec(any::<u8>(), 0..400)], 0_u64..150), 0..20),
            to_controller in any::<bool>(),
        ) {
            let direction = if to_controller { Direction::ToController } else { Direction::ToAspect };
            let mut parser = Parser::new(direction);
            let mut now = START;
            let mut packets = Vec::new();
            for (bytes, pause) in &chunks {
                now += Duration::from_millis(*pause);
                packets.extend(parser.feed(bytes, now));
            }
            packets.extend(parser.feed(&[], now + 2 * SILENCE));
            let accepted: usize = packets.iter().map(|p| p.encode().len()).sum();
            let total: usize = chunks.iter().map(|(bytes, _)| bytes.len()).sum();
            prop_assert_eq!(parser.rejected().bytes + accepted as u64, total as u64);
        }
    }
}
