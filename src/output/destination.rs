//! Destination of an output.

use crate::link::PortAddress;
use std::fmt;
use std::net::SocketAddr;
use std::str::FromStr;

/// Destination of an output.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Destination {
    /// Datagrams to a peer, or a serial device.
    Port(PortAddress),
    /// Clients that connect to this address of the computer by TCP.
    Clients(SocketAddr),
}

/// A text that names no destination.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("expected {expected}, found {0:?}", expected = Destination::EXPECTED)]
pub struct NoDestination(String);

impl Destination {
    pub const EXPECTED: &'static str = "udp:HOST:PORT, serial:/dev/... or tcp-listen:ADDRESS:PORT, where HOST and ADDRESS are IP addresses";

    /// Whether both are the same destination.
    pub fn is_same_place(&self, other: &Self) -> bool {
        use PortAddress::{Serial, Udp};
        match (self, other) {
            (Self::Port(Udp { peer, .. }), Self::Port(Udp { peer: other, .. })) => peer == other,
            (Self::Port(own @ Serial { .. }), Self::Port(other @ Serial { .. })) => {
                own.takes(None) == other.takes(None)
            }
            (Self::Clients(own), Self::Clients(other)) => {
                let is_any = own.ip().is_unspecified() || other.ip().is_unspecified();
                own.port() == other.port() && (is_any || own.ip() == other.ip())
            }
            _ => false,
        }
    }
}

impl FromStr for Destination {
    type Err = NoDestination;

    fn from_str(text: &str) -> Result<Self, NoDestination> {
        let refused = || NoDestination(text.into());
        let port = |text: &str| text.parse::<PortAddress>().map_err(|_| refused());
        match text.split_once(':') {
            Some(("udp", _)) => port(text).map(Self::Port),
            Some(("serial", name)) => match port(name)? {
                serial @ PortAddress::Serial { .. } => Ok(Self::Port(serial)),
                PortAddress::Udp { .. } => Err(refused()),
            },
            Some(("tcp-listen", address)) => match address.parse::<SocketAddr>() {
                Ok(address) if address.port() > 0 => Ok(Self::Clients(address)),
                _ => Err(refused()),
            },
            _ => Err(refused()),
        }
    }
}

impl fmt::Display for Destination {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Port(port @ PortAddress::Serial { .. }) => write!(out, "serial:{port}"),
            Self::Port(port) => write!(out, "{port}"),
            Self::Clients(address) => write!(out, "tcp-listen:{address}"),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn to(text: &str) -> Destination {
        text.parse().unwrap()
    }

    #[test]
    fn a_destination_is_written_as_it_is_read() {
        for text in [
            "udp:192.168.1.9:5000",
            "udp:[::1]:5000",
            "udp:10.0.0.1:5000@6000",
            "serial:/dev/serial/by-path/pci-0000:00:14.0-usb-0:2:1.0-port0",
            "tcp-listen:0.0.0.0:5001",
            "tcp-listen:[::]:5001",
        ] {
            assert_eq!(to(text).to_string(), text);
        }
    }

    #[test]
    fn another_text_is_refused_with_what_is_expected() {
        for text in [
            "",
            "udp",
            "udp:ground:5000",
            "udp:10.0.0.1",
            "/dev/ttyS1",
            "serial:ttyS1",
            "serial:udp:10.0.0.1:5000",
            "tcp:10.0.0.1:5000",
            "tcp-listen:5000",
            "tcp-listen:0.0.0.0:0",
        ] {
            let error = text.parse::<Destination>().unwrap_err().to_string();
            assert!(error.contains("tcp-listen:ADDRESS:PORT"), "{error}");
            assert!(error.ends_with(&format!("found {text:?}")), "{error}");
        }
    }

    #[test]
    fn places_are_the_same_by_peer_device_or_listening_port() {
        for (one, other, same) in [
            ("udp:10.0.0.1:5000", "udp:10.0.0.1:5000@6000", true),
            ("udp:10.0.0.1:5000", "udp:10.0.0.1:5001", false),
            ("serial:/dev/null", "serial:/dev/../dev/null", true),
            ("serial:/dev/null", "serial:/dev/zero", false),
            ("tcp-listen:0.0.0.0:5000", "tcp-listen:127.0.0.1:5000", true),
            (
                "tcp-listen:10.0.0.1:5000",
                "tcp-listen:10.0.0.2:5000",
                false,
            ),
            ("tcp-listen:10.0.0.1:5000", "udp:10.0.0.1:5000", false),
        ] {
            assert_eq!(to(one).is_same_place(&to(other)), same, "{one} {other}");
        }
    }
}
