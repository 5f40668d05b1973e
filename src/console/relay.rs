//! Relay of received packets to other consoles.
//!
//! Consoles may pass data on in a ring, on two paths, or by mistake to themselves. So each passes a datagram on once: one
//! that is byte for byte the same as one passed on within [`MEMORY`] is dropped. The flight never sends the same datagram
//! twice: its telemetry contains the time to the nanosecond, its other packets a number that repeats after 65,536 packets.

use super::source::Source;
use crate::link::{BytePort, LocalEnd, PortError, UdpPort};
use anyhow::ensure;
use std::collections::{HashSet, VecDeque};
use std::hash::{BuildHasher, RandomState};
use std::net::{IpAddr, SocketAddr, UdpSocket};
use std::time::{Duration, Instant};

/// How long a datagram is remembered: longer than any path takes.
const MEMORY: Duration = Duration::from_secs(30);
/// Maximum number of remembered datagrams: 2,000 per second.
const MOST: usize = 1 << 16;

/// Passes datagrams on, each once.
pub struct Relay {
    ports: Vec<UdpPort>,
    passed: Passed,
}

impl Relay {
    /// A relay to consoles other than the one that receives from `source`.
    ///
    /// # Errors
    /// If a peer is the address on which this console itself listens, or if it cannot be sent to.
    pub fn to(peers: &[SocketAddr], source: &Source) -> anyhow::Result<Self> {
        for peer in peers {
            ensure!(
                !matches!(source, Source::Udp(here) if is_own(*peer, *here)),
                "--relay {peer}: expected another console, found the address at which this one listens ({source})"
            );
        }
        let port = |peer: &SocketAddr| UdpPort::open(*peer, LocalEnd::default());
        Ok(Self {
            ports: peers.iter().map(port).collect::<Result<_, PortError>>()?,
            passed: Passed::default(),
        })
    }

    /// Passes a datagram on, unless it was passed on recently. A console that is not listening does not get it.
    pub fn pass_on(&mut self, datagram: &[u8], now: Instant) {
        if self.ports.is_empty() || !self.passed.is_new(datagram, now) {
            return;
        }
        for port in &mut self.ports {
            let _ = port.write(datagram, Duration::ZERO);
        }
    }
}

/// Whether a datagram sent to `peer` arrives at the socket that listens on `here`.
fn is_own(peer: SocketAddr, here: SocketAddr) -> bool {
    let is_here =
        here.ip().is_unspecified() || here.ip() == peer.ip() || peer.ip().is_unspecified();
    peer.port() == here.port() && is_here && is_of_this_machine(peer.ip())
}

/// Whether an address belongs to this machine: then a socket can be bound to it.
fn is_of_this_machine(address: IpAddr) -> bool {
    // Data sent to the unspecified address go to the machine itself.
    UdpSocket::bind((address, 0)).is_ok()
}

/// Digests of the recent datagrams.
#[derive(Default)]
struct Passed {
    /// Randomised at every start, so that no one can construct two datagrams with equal digests.
    hash: RandomState,
    digests: HashSet<u64>,
    in_order: VecDeque<(Instant, u64)>,
}

impl Passed {
    /// Whether a datagram is new; adds it.
    fn is_new(&mut self, datagram: &[u8], now: Instant) -> bool {
        let is_old = |passed: Instant| now.saturating_duration_since(passed) > MEMORY;
        while let Some((passed, digest)) = self.in_order.front().copied() {
            if !is_old(passed) && self.in_order.len() < MOST {
                break;
            }
            self.in_order.pop_front();
            self.digests.remove(&digest);
        }
        let digest = self.hash.hash_one(datagram);
        let is_new = self.digests.insert(digest);
        if is_new {
            self.in_order.push_back((now, digest));
        }
        is_new
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_datagram_is_passed_on_once_and_again_after_half_a_minute() {
        let mut passed = Passed::default();
        let start = Instant::now();
        let mut is_new =
            |datagram: &[u8], second| passed.is_new(datagram, start + Duration::from_secs(second));
        assert!(is_new(b"one", 0) && is_new(b"two", 0));
        assert!(!is_new(b"one", 1) && !is_new(b"one", 30));
        assert!(is_new(b"one", 31), "a command that is given again");
        assert!(!is_new(b"one", 32) && is_new(b"two", 61));
    }

    #[test]
    fn a_flood_of_datagrams_takes_no_more_memory() {
        let mut passed = Passed::default();
        let now = Instant::now();
        for n in 0..2 * MOST {
            assert!(passed.is_new(&n.to_le_bytes(), now));
        }
        assert_eq!((passed.in_order.len(), passed.digests.len()), (MOST, MOST));
    }

    #[test]
    fn a_console_that_would_relay_to_itself_is_refused() {
        for (source, peer) in [
            ("udp::4711", "127.0.0.1:4711"),
            ("udp:127.0.0.1:4711", "127.0.0.1:4711"),
            ("udp:127.0.0.1:4711", "0.0.0.0:4711"),
        ] {
            let source: Source = source.parse().unwrap();
            let error = Relay::to(&[peer.parse().unwrap()], &source).err().unwrap();
            let error = error.to_string();
            assert!(
                error.starts_with("--relay ") && error.contains("this one listens"),
                "{error}"
            );
        }
        for (source, peer) in [
            ("udp::4711", "127.0.0.1:4712"),
            ("udp::4711", "192.0.2.1:4711"),
            ("serial:/dev/ttyUSB0", "127.0.0.1:4711"),
        ] {
            let source: Source = source.parse().unwrap();
            assert!(
                Relay::to(&[peer.parse().unwrap()], &source).is_ok(),
                "{source} {peer}"
            );
        }
    }
}
