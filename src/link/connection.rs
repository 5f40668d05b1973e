//! A port that may be lost and come back: unplugged, not there yet, or the network is down.

use super::guard::{Guard, Peer};
use super::port::{BytePort, PortError, SerialPort};
use super::udp::{LocalEnd, UdpPort};
use crate::backoff::Backoff;
use std::fmt;
use std::net::SocketAddr;
use std::str::FromStr;
use std::time::Duration;

/// Time after which an open port counts as good: its next loss is a new fault.
const GOOD: Duration = Duration::from_secs(2);

/// A port that carries bytes, of any kind.
pub type AnyPort = Box<dyn BytePort + Send>;
type Open = Box<dyn FnMut() -> Result<AnyPort, PortError> + Send>;

/// Forms of an address, for error messages.
pub const EXPECTED: &str = "a serial device by its path (/dev/...), udp:HOST:PORT or udp:HOST:PORT@LOCALPORT, where HOST is an \
                            IP address (names are not resolved: that may take seconds)";

/// Address of the other end: a serial device by its path, or `udp:HOST:PORT[@LOCALPORT]` with an IP address as HOST.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum PortAddress {
    Serial {
        name: String,
    },
    Udp {
        peer: SocketAddr,
        local_port: Option<u16>,
    },
}

impl FromStr for PortAddress {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let refused = || format!("port: expected {EXPECTED}; found \"{text}\"");
        let Some(udp) = text.strip_prefix("udp:") else {
            // A path: a name with a colon before its first slash is another scheme, such as tcp:, and any other name is no address.
            let is_path = text
                .split_once('/')
                .is_some_and(|(begin, _)| !begin.contains(':'));
            let name = text.to_owned();
            return is_path.then_some(Self::Serial { name }).ok_or_else(refused);
        };
        let (peer, local_port) = match udp.rsplit_once('@') {
            Some((peer, port)) => (peer, Some(port.parse().map_err(|_| refused())?)),
            None => (udp, None),
        };
        match peer.parse::<SocketAddr>() {
            Ok(peer) if peer.port() > 0 => Ok(Self::Udp { peer, local_port }),
            _ => Err(refused()),
        }
    }
}

impl fmt::Display for PortAddress {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Serial { name } => out.write_str(name),
            Self::Udp {
                peer,
                local_port: None,
            } => write!(out, "udp:{peer}"),
            Self::Udp {
                peer,
                local_port: Some(port),
            } => write!(out, "udp:{peer}@{port}"),
        }
    }
}

impl PortAddress {
    /// Opens the port: `baud` applies to a serial one, `local` to UDP; a local port in the address has priority over that.
    pub fn open(&self, baud: u32, local: LocalEnd) -> Result<AnyPort, PortError> {
        Ok(match self {
            Self::Serial { name } => Box::new(SerialPort::open(name, baud)?),
            Self::Udp {
                peer,
                local_port: own,
            } => {
                let port = own.unwrap_or(local.port);
                Box::new(UdpPort::open(*peer, LocalEnd { port, ..local })?)
            }
        })
    }

    /// The resource of this computer that it occupies, in words: a device, its links resolved, or a UDP port. `None` for any free port.
    pub fn takes(&self, udp_local_port: Option<u16>) -> Option<String> {
        match self {
            Self::Serial { name } => {
                let device = std::fs::canonicalize(name);
                Some(device.map_or(name.clone(), |device| device.display().to_string()))
            }
            Self::Udp { local_port, .. } => {
                let port = local_port.or(udp_local_port).filter(|port| *port > 0)?;
                Some(format!("UDP port {port}"))
            }
        }
    }

    /// A guard that accepts commands from this address alone, from any of its ports; over a wire, it accepts all.
    fn guard(&self) -> Guard {
        let peers = match self {
            Self::Udp { peer, .. } => vec![Peer::any_port_of(peer.ip())],
            Self::Serial { .. } => Vec::new(),
        };
        Guard::new(peers, None)
    }
}

/// A port that is opened again, with growing waits, whenever it is lost. Times are monotonic, from any origin.
pub struct Connection {
    port: Option<AnyPort>,
    open: Option<Open>,
    /// Kept when the port is lost, and when a thread panics.
    guard: Guard,
    opened_at: Duration,
    retry_at: Duration,
    backoff: Backoff,
    opened: u64,
    failed: u64,
}

impl Connection {
    /// A connection over ports that `open` makes, now and after every loss.
    pub fn new(open: impl FnMut() -> Result<AnyPort, PortError> + Send + 'static) -> Self {
        Self {
            open: Some(Box::new(open)),
            ..Self::none()
        }
    }

    /// A connection to an address, at a baud rate; `local` as in [`PortAddress::open`]. Over UDP, commands of that address alone are accepted.
    pub fn to(address: PortAddress, baud: u32, local: LocalEnd) -> Self {
        let guard = address.guard();
        Self::new(move || address.open(baud, local)).guarded(guard)
    }

    /// The same connection with another guard for datagrams.
    pub fn guarded(self, guard: Guard) -> Self {
        Self { guard, ..self }
    }

    /// A connection over a port that cannot be opened again. Datagrams are refused, unless a guard accepts them.
    pub fn over(port: impl BytePort + Send + 'static) -> Self {
        Self {
            port: Some(Box::new(port)),
            opened: 1,
            ..Self::none()
        }
    }

    /// A connection without a line.
    pub fn none() -> Self {
        Self {
            port: None,
            open: None,
            guard: Guard::new(Vec::new(), None),
            opened_at: Duration::ZERO,
            retry_at: Duration::ZERO,
            backoff: Backoff::DEVICE,
            opened: 0,
            failed: 0,
        }
    }

    /// The port, if it is open.
    pub fn port(&mut self) -> Option<&mut AnyPort> {
        self.port.as_mut()
    }

    /// The guard that accepts or refuses datagrams.
    pub fn guard(&mut self) -> &mut Guard {
        &mut self.guard
    }

    /// Whether there is a line at all, open or not.
    pub fn is_wanted(&self) -> bool {
        self.open.is_some() || self.opened > 0
    }

    /// Whether there is a line and it has never been open.
    pub fn was_never_open(&self) -> bool {
        self.is_wanted() && self.opened == 0
    }

    /// Number of times that the port was opened, without the first time.
    pub fn reopened(&self) -> u64 {
        self.opened.saturating_sub(1)
    }

    /// Opens the port if it is not open and an attempt is due; returns true when it is new.
    pub fn revive(&mut self, now: Duration) -> bool {
        let Some(open) = self.open.as_mut() else {
            return false;
        };
        if self.port.is_some() || now < self.retry_at {
            return false;
        }
        match open() {
            Ok(port) => {
                tracing::info!(opened = self.opened + 1, "the line is open");
                self.port = Some(port);
                self.opened += 1;
                self.opened_at = now;
                true
            }
            Err(error) => {
                self.failed += 1;
                if self.failed.is_power_of_two() {
                    tracing::error!(%error, failed = self.failed, "the line cannot be opened");
                }
                self.retry_at = now + self.backoff.wait();
                false
            }
        }
    }

    /// Closes the port and schedules the next attempt.
    pub fn lose(&mut self, now: Duration) {
        self.port = None;
        if now.saturating_sub(self.opened_at) > GOOD {
            self.backoff.reset();
        }
        self.retry_at = now + self.backoff.wait();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Arc;
    use std::sync::atomic::{AtomicU64, Ordering};

    #[test]
    fn addresses_are_serial_names_or_ip_addresses_with_ports() {
        let by_id = "/dev/serial/by-id/usb-FTDI_x-if00-port0";
        let name = by_id.to_owned();
        assert_eq!(by_id.parse(), Ok(PortAddress::Serial { name }));
        let udp = |peer: &str, local_port| {
            let peer = peer.parse().unwrap();
            Ok(PortAddress::Udp { peer, local_port })
        };
        assert_eq!("udp:10.0.0.1:2000".parse(), udp("10.0.0.1:2000", None));
        let with_local = "udp:10.0.0.1:2000@3000".parse();
        assert_eq!(with_local, udp("10.0.0.1:2000", Some(3000)));
        assert_eq!("udp:[::1]:2000".parse(), udp("[::1]:2000", None));
    }

    #[test]
    fn another_scheme_and_a_name_that_is_no_path_are_refused() {
        for path in [
            "/dev/ttyS0",
            "/dev/serial/by-path/pci-0000:00:14.0-usb-0:2:1.0-port0",
            "./tty",
        ] {
            let name = path.to_owned();
            assert_eq!(path.parse(), Ok(PortAddress::Serial { name }));
        }
        for wrong in [
            "tcp:10.0.0.1:2000",
            "tcp://10.0.0.1:2000",
            "mavlink:/dev/ttyUSB0",
            "serial:/dev/ttyUSB0",
            "file:///dev/ttyUSB0",
            "UDP:10.0.0.1:2000",
            " udp:10.0.0.1:2000",
            "10.0.0.1:2000",
            "udp",
            "ttyUSB0",
            "",
        ] {
            let error = wrong.parse::<PortAddress>().unwrap_err();
            assert!(error.contains("(/dev/...), udp:HOST:PORT"), "{error}");
            assert!(error.ends_with(&format!("found \"{wrong}\"")), "{error}");
        }
    }

    #[test]
    fn a_peer_by_name_is_refused_and_never_resolved() {
        for wrong in [
            "udp:",
            "udp:10.0.0.1",
            "udp::2000",
            "udp:10.0.0.1:0",
            "udp:10.0.0.1:port",
            "udp:10.0.0.1:1@x",
            "udp:controller:2000",
            "udp:localhost:2000",
        ] {
            let error = wrong.parse::<PortAddress>().unwrap_err();
            assert!(error.contains("HOST is an IP address"), "{error}");
            assert!(error.ends_with(&format!("found \"{wrong}\"")), "{error}");
        }
    }

    struct Silent;

    impl BytePort for Silent {
        fn read(&mut self, _: &mut [u8], _: Duration) -> Result<usize, PortError> {
            Ok(0)
        }

        fn write(&mut self, _: &[u8], _: Duration) -> Result<(), PortError> {
            Ok(())
        }
    }

    #[test]
    fn a_lost_port_is_opened_again_with_growing_waits_that_end_when_it_stays() {
        let attempts = Arc::new(AtomicU64::new(0));
        let counted = Arc::clone(&attempts);
        // Present at the start, absent for ten attempts, and present again.
        let mut connection =
            Connection::new(move || match counted.fetch_add(1, Ordering::Relaxed) {
                1..=10 => Err(PortError::Udp {
                    name: "gone".into(),
                    cause: std::io::ErrorKind::NotFound.into(),
                }),
                _ => Ok(Box::new(Silent)),
            });
        let at = Duration::from_millis;
        assert!(connection.revive(at(0)));
        assert!(!connection.revive(at(1)), "it is open");
        connection.lose(at(10_000));
        let mut tried = Vec::new();
        for now in 10_000..30_000 {
            let before = attempts.load(Ordering::Relaxed);
            connection.revive(at(now));
            if attempts.load(Ordering::Relaxed) > before {
                tried.push(now - 10_000);
            }
        }
        assert_eq!(tried[..5], [250, 750, 1750, 3750, 5750]);
        assert_eq!(tried.len(), 11);
        assert!(connection.port().is_some());
        assert_eq!(connection.reopened(), 1);
        connection.lose(at(100_000));
        assert!(!connection.revive(at(100_249)));
        assert!(connection.revive(at(100_250)), "a new fault, a short wait");
    }

    #[test]
    fn a_connection_over_a_port_is_not_opened_again() {
        let mut connection = Connection::over(Silent);
        assert!(connection.port().is_some());
        connection.lose(Duration::ZERO);
        assert!(!connection.revive(Duration::from_secs(100)));
        assert!(Connection::none().port().is_none());
    }
}
