//! Decides whose commands are accepted over UDP, where anyone on the network may send.
//!
//! # Rules
//!
//! 1. Datagrams from other addresses than the peers' are refused.
//! 2. Without a key, a packet must be newer than the last one of its sender (address and port), by serial arithmetic on
//!    its sequence number (RFC 1982). The record of a sender is dropped [`MEMORY`] after its last accepted packet, so
//!    that a sender that restarts its count is accepted again.
//! 3. With a key, a datagram must be signed for this computer, and its stamp must be new: not accepted before, and not older than
//!    [`MEMORY`] before the newest of any sender. So senders whose clocks differ do not disturb each other, and a
//!    copy from any address is refused. The computer's own clock is not used: if it is wrong, no sender is locked out.
//! 4. A packet that has been executed within [`MEMORY`] and comes again is answered again, and not executed twice.

use super::key::Seal;
use super::packet::CommandPacket;
use std::collections::{BTreeSet, VecDeque};
use std::net::{IpAddr, SocketAddr};
use std::str::FromStr;
use std::time::{Duration, Instant};

/// How long senders and their packets are remembered, and how far stamps may differ.
pub const MEMORY: Duration = Duration::from_secs(30);
const SENDERS: usize = 64;
const PACKETS: usize = 32;
/// Number of stamps that are kept. An IMU of 200 Hz fills them in 40 s.
const STAMPS: usize = 8192;

/// Reason why a datagram, or a packet in it, is refused.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Refusal {
    #[error("sender: expected one of link.udp_peers")]
    Stranger,
    #[error("signature: expected one by link.key_file, for this computer")]
    Unsigned,
    #[error("sequence number: expected one after {last}, found {found}")]
    OldSequence { last: u16, found: u16 },
    #[error("stamp: expected a new one, found an old one")]
    OldStamp,
}

/// An address from which commands are accepted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Peer {
    address: IpAddr,
    /// `None` for any.
    port: Option<u16>,
}

impl Peer {
    /// Any port of an address.
    pub fn any_port_of(address: IpAddr) -> Self {
        let port = None;
        Self { address, port }
    }

    fn is(&self, sender: SocketAddr) -> bool {
        // A socket for both families writes 10.0.0.1 as ::ffff:10.0.0.1.
        let same = self.address.to_canonical() == sender.ip().to_canonical();
        same && self.port.is_none_or(|port| port == sender.port())
    }
}

impl FromStr for Peer {
    type Err = String;

    /// An IP address, or one with a port.
    fn from_str(text: &str) -> Result<Self, String> {
        if let Ok(address) = text.parse::<IpAddr>() {
            return Ok(Self::any_port_of(address));
        }
        let with_port = text.parse::<SocketAddr>();
        let wrong = |_| format!("expected an IP address or ADDRESS:PORT, found \"{text}\"");
        with_port.map_err(wrong).map(|full| Self {
            address: full.ip(),
            port: Some(full.port()),
        })
    }
}

/// Content of a peer's datagram.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Opened<'a> {
    /// The datagram without the signature.
    pub bytes: &'a [u8],
    /// Whether its content may be executed; a repeated one may only be answered again.
    pub is_new: bool,
}

/// Accepts or refuses datagrams.
#[derive(Debug)]
pub struct Guard {
    peers: Vec<Peer>,
    seal: Option<Seal>,
    /// Used without a key.
    senders: VecDeque<Sender>,
    packets: VecDeque<Remembered>,
    /// Used with a key: the accepted stamps.
    stamps: BTreeSet<i64>,
    oldest_stamp: i64,
}

#[derive(Debug)]
struct Sender {
    address: SocketAddr,
    sequence: u16,
    accepted: Instant,
}

/// A packet that was executed, with its answers.
#[derive(Debug)]
struct Remembered {
    packet: CommandPacket,
    sender: SocketAddr,
    answers: Vec<Vec<u8>>,
    accepted: Instant,
}

impl Guard {
    /// Accepts datagrams of these peers; with the seal of a computer, only those that are signed for it.
    pub fn new(peers: Vec<Peer>, seal: Option<Seal>) -> Self {
        Self {
            peers,
            seal,
            senders: VecDeque::new(),
            packets: VecDeque::new(),
            stamps: BTreeSet::new(),
            oldest_stamp: 0,
        }
    }

    /// The newest stamp that was accepted; 0 if there is none.
    pub fn newest_stamp(&self) -> i64 {
        self.stamps.last().copied().unwrap_or(self.oldest_stamp)
    }

    /// Refuses stamps that are not newer than one that an earlier run of the program accepted.
    pub fn refuse_to(&mut self, stamp: i64) {
        if stamp > self.newest_stamp() {
            self.stamps.clear();
            self.oldest_stamp = stamp;
        }
    }

    /// Checks sender, signature and stamp of a datagram.
    pub fn open<'a>(
        &mut self,
        datagram: &'a [u8],
        sender: SocketAddr,
    ) -> Result<Opened<'a>, Refusal> {
        if !self.peers.iter().any(|peer| peer.is(sender)) {
            return Err(Refusal::Stranger);
        }
        let Some(seal) = &self.seal else {
            let (bytes, is_new) = (datagram, true);
            return Ok(Opened { bytes, is_new });
        };
        let (bytes, stamp) = seal.verified(datagram).ok_or(Refusal::Unsigned)?;
        let is_new = self.take_stamp(stamp);
        Ok(Opened { bytes, is_new })
    }

    /// Records a stamp; returns whether it is new.
    fn take_stamp(&mut self, stamp: i64) -> bool {
        if stamp <= self.oldest_stamp || !self.stamps.insert(stamp) {
            return false;
        }
        let newest = self.newest_stamp();
        let limit = newest.saturating_sub(MEMORY.as_nanos() as i64);
        self.oldest_stamp = self.oldest_stamp.max(limit);
        self.stamps.retain(|&kept| kept > limit || kept == newest);
        if self.stamps.len() > STAMPS {
            self.oldest_stamp = self.stamps.pop_first().unwrap_or(self.oldest_stamp);
        }
        true
    }

    /// `None` if a packet is to be executed; else the answers given when it was executed.
    pub fn admit(
        &mut self,
        packet: &CommandPacket,
        sender: SocketAddr,
        is_new: bool,
        now: Instant,
    ) -> Result<Option<Vec<Vec<u8>>>, Refusal> {
        let is_fresh = |accepted: Instant| now.saturating_duration_since(accepted) <= MEMORY;
        self.packets.retain(|known| is_fresh(known.accepted));
        self.senders.retain(|known| is_fresh(known.accepted));
        // With a key, the sender of a copy can only repeat that copy.
        let any_sender = self.seal.is_some();
        let known = self
            .packets
            .iter()
            .find(|known| known.packet == *packet && (any_sender || known.sender == sender));
        if let Some(known) = known {
            return Ok(Some(known.answers.clone()));
        }
        if self.seal.is_some() {
            return if is_new {
                Ok(None)
            } else {
                Err(Refusal::OldStamp)
            };
        }
        self.count(packet.sequence(), sender, now).map(|()| None)
    }

    /// Advances a sender's count to this sequence number, if it is a later one.
    fn count(&mut self, found: u16, address: SocketAddr, now: Instant) -> Result<(), Refusal> {
        let at = self.senders.iter().position(|s| s.address == address);
        let last = at.and_then(|at| self.senders.get(at)).map(|s| s.sequence);
        if let Some(last) = last.filter(|&last| !is_later(found, last)) {
            return Err(Refusal::OldSequence { last, found });
        }
        at.and_then(|at| self.senders.remove(at));
        if self.senders.len() == SENDERS {
            self.senders.pop_front();
        }
        self.senders.push_back(Sender {
            address,
            sequence: found,
            accepted: now,
        });
        Ok(())
    }

    /// Keeps the answers of a packet that was executed.
    pub fn remember(
        &mut self,
        packet: CommandPacket,
        sender: SocketAddr,
        answers: Vec<Vec<u8>>,
        now: Instant,
    ) {
        if self.packets.len() == PACKETS {
            self.packets.pop_front();
        }
        self.packets.push_back(Remembered {
            packet,
            sender,
            answers,
            accepted: now,
        });
    }
}

/// Serial arithmetic: later means ahead by less than half of all numbers.
fn is_later(sequence: u16, than: u16) -> bool {
    (1..0x8000).contains(&sequence.wrapping_sub(than))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::link::{Computer, Key, id};

    fn address(text: &str) -> SocketAddr {
        text.parse().unwrap()
    }

    fn packet(sequence: u16, payload: &[u8]) -> CommandPacket {
        CommandPacket::new(id::ASPECT, sequence, payload.to_vec()).unwrap()
    }

    fn guard(peers: &[&str], key: Option<Seal>) -> Guard {
        Guard::new(peers.iter().map(|p| p.parse().unwrap()).collect(), key)
    }

    fn key() -> Seal {
        seal(Computer::One)
    }

    fn seal(computer: Computer) -> Seal {
        let key = Key::new(b"sixteen bytes or more").unwrap();
        key.towards(computer)
    }

    #[test]
    fn only_peers_are_heard_from_any_port_unless_one_is_named() {
        let mut guard = guard(&["10.0.0.1", "10.0.0.2:2000", "fd00::1"], None);
        let mut hears = |sender| guard.open(b"bytes", address(sender)).is_ok();
        assert!(hears("10.0.0.1:4711") && hears("10.0.0.1:2000"));
        assert!(hears("[::ffff:10.0.0.1]:4711"));
        assert!(hears("10.0.0.2:2000") && !hears("10.0.0.2:2001"));
        assert!(hears("[fd00::1]:1") && !hears("[fd00::2]:1"));
        assert!(!hears("10.0.0.3:2000"));
        assert!("ground:2000".parse::<Peer>().is_err());
    }

    #[test]
    fn sequence_numbers_only_rise_by_sender_and_through_the_largest() {
        let mut guard = guard(&["10.0.0.1"], None);
        let (one, other) = (address("10.0.0.1:1"), address("10.0.0.1:2"));
        let now = Instant::now();
        let mut admits = |sequence, sender| {
            let taken = guard.admit(&packet(sequence, &[1]), sender, true, now);
            taken.is_ok()
        };
        assert!(admits(65_534, one) && admits(65_535, one) && admits(0, one));
        assert!(admits(7, one), "packets may be lost");
        assert!(!admits(6, one) && !admits(65_535, one));
        assert!(!admits(7, one), "another packet of the same number");
        assert!(!admits(7 + 0x8000, one), "half of all numbers ahead");
        assert!(admits(3, other), "senders do not disturb each other");
    }

    #[test]
    fn a_sender_is_dropped_after_30_s_of_silence_however_often_it_is_refused() {
        let mut guard = guard(&["10.0.0.1"], None);
        let sender = address("10.0.0.1:1");
        let start = Instant::now();
        let mut admits = |sequence, second| {
            let now = start + Duration::from_secs(second);
            let taken = guard.admit(&packet(sequence, &[1]), sender, true, now);
            taken.is_ok()
        };
        assert!(admits(100, 0) && admits(101, 10));
        // The sender restarts its count.
        assert!((11..=40).all(|second| !admits(second as u16 - 10, second)));
        assert!(admits(31, 41));
    }

    #[test]
    fn a_packet_that_comes_again_is_answered_again_and_not_carried_out() {
        let sender = address("10.0.0.1:1");
        let now = Instant::now();
        for key in [None, Some(key())] {
            let mut guard = guard(&["10.0.0.1"], key);
            let first = packet(1, &[1]);
            assert_eq!(guard.admit(&first, sender, true, now), Ok(None));
            let answers = vec![b"answer".to_vec()];
            guard.remember(first.clone(), sender, answers.clone(), now);
            assert_eq!(guard.admit(&packet(2, &[1]), sender, true, now), Ok(None));
            let again = guard.admit(&first, sender, false, now + MEMORY);
            assert_eq!(again, Ok(Some(answers)));
        }
    }

    #[test]
    fn with_a_key_only_signed_and_new_datagrams_are_taken_whoever_sends_them() {
        let mut guard = guard(&["10.0.0.1", "10.0.0.2"], Some(key()));
        let (ground, attacker) = (address("10.0.0.1:1"), address("10.0.0.2:2"));
        let second = 1_000_000_000;
        let at = |seconds: i64| key().sign(b"packet", 1_379_786_400 * second + seconds * second);
        let mut is_new = |datagram: &[u8], sender| guard.open(datagram, sender).map(|o| o.is_new);
        assert_eq!(is_new(b"packet", ground), Err(Refusal::Unsigned));
        assert_eq!(is_new(&at(0), ground), Ok(true));
        assert_eq!(is_new(&at(0), attacker), Ok(false), "a copy from elsewhere");
        assert_eq!(
            is_new(&at(-29), attacker),
            Ok(true),
            "a clock behind the other"
        );
        assert_eq!(is_new(&at(-29), ground), Ok(false));
        assert_eq!(is_new(&at(100), ground), Ok(true));
        assert_eq!(
            is_new(&at(70), ground),
            Ok(false),
            "as old as may be and older"
        );
        assert_eq!(is_new(&at(0), attacker), Ok(false));
        let old = guard.admit(&packet(9, &[1]), ground, false, Instant::now());
        assert_eq!(old, Err(Refusal::OldStamp));
    }

    #[test]
    fn a_datagram_for_the_other_computer_is_refused_whatever_it_holds() {
        let ground = address("10.0.0.1:1");
        for (own, other) in [
            (Computer::One, Computer::Two),
            (Computer::Two, Computer::One),
        ] {
            let mut guard = guard(&["10.0.0.1"], Some(seal(own)));
            let mut opened = |datagram: &[u8]| guard.open(datagram, ground).map(|o| o.is_new);
            let replayed = seal(other).sign(b"packet", 1000);
            assert_eq!(opened(&replayed), Err(Refusal::Unsigned));
            assert_eq!(opened(&seal(own).sign(b"packet", 1000)), Ok(true));
            assert_eq!(opened(&replayed), Err(Refusal::Unsigned));
        }
    }

    #[test]
    fn stamps_of_an_earlier_run_are_refused() {
        let mut guard = guard(&["10.0.0.1"], Some(key()));
        let ground = address("10.0.0.1:1");
        guard.refuse_to(1000);
        for (stamp, is_new) in [(999, false), (1000, false), (1001, true)] {
            let datagram = key().sign(b"packet", stamp);
            let opened = guard.open(&datagram, ground).unwrap();
            assert_eq!(opened.is_new, is_new, "{stamp}");
        }
        assert_eq!(guard.newest_stamp(), 1001);
        guard.refuse_to(1001);
        assert!(
            guard
                .open(&key().sign(b"packet", 1002), ground)
                .unwrap()
                .is_new
        );
    }

    #[test]
    fn a_flood_of_senders_and_stamps_takes_no_more_memory() {
        let now = Instant::now();
        let mut open = guard(&["10.0.0.1"], None);
        for port in 1..1000 {
            let sender = SocketAddr::from(([10, 0, 0, 1], port));
            assert_eq!(open.admit(&packet(1, &[]), sender, true, now), Ok(None));
            open.remember(packet(1, &[]), sender, vec![], now);
        }
        assert_eq!((open.senders.len(), open.packets.len()), (SENDERS, PACKETS));
        let mut keyed = guard(&["10.0.0.1"], Some(key()));
        for stamp in 1..=2 * STAMPS as i64 {
            assert!(keyed.take_stamp(stamp));
        }
        assert_eq!(keyed.stamps.len(), STAMPS);
        assert!(!keyed.take_stamp(5));
    }
}
