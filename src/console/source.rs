//! Source of a flight's data.

use crate::link::PortAddress;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::path::PathBuf;
use std::str::FromStr;

/// Forms of a source.
const EXPECTED: &str = "udp:[ADDR]:PORT, serial:DEV, archive:DIR, record:FILE or demo";

/// Source of a flight's data.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum Source {
    /// Datagrams that arrive at an address of this machine.
    Udp(SocketAddr),
    /// A serial device.
    Serial(String),
    /// An archive's folder, which may still grow.
    Archive(PathBuf),
    /// A byte log of received data. It may still grow.
    Record(PathBuf),
    /// A simulated flight.
    Demo,
}

impl FromStr for Source {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let refused = || format!("expected {EXPECTED}; found \"{text}\"");
        let (kind, rest) = text.split_once(':').unwrap_or((text, ""));
        match (kind, rest) {
            ("demo", "") => Ok(Self::Demo),
            ("udp", rest) => udp(rest).map(Self::Udp).ok_or_else(refused),
            (_, "") => Err(refused()),
            ("serial", device) => match device.parse() {
                Ok(PortAddress::Serial { name }) => Ok(Self::Serial(name)),
                _ => Err(refused()),
            },
            ("archive", folder) => Ok(Self::Archive(folder.into())),
            ("record", file) => Ok(Self::Record(file.into())),
            _ => Err(refused()),
        }
    }
}

/// `ADDR:PORT`, or `:PORT` or `PORT` for all addresses of the machine.
fn udp(text: &str) -> Option<SocketAddr> {
    if let Ok(address) = text.parse() {
        return Some(address);
    }
    let port = text.strip_prefix(':').unwrap_or(text).parse().ok()?;
    let everywhere = IpAddr::V4(Ipv4Addr::UNSPECIFIED);
    (port > 0).then(|| SocketAddr::new(everywhere, port))
}

impl std::fmt::Display for Source {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Udp(address) => write!(out, "udp:{address}"),
            Self::Serial(device) => write!(out, "serial:{device}"),
            Self::Archive(folder) => write!(out, "archive:{}", folder.display()),
            Self::Record(file) => write!(out, "record:{}", file.display()),
            Self::Demo => out.write_str("demo"),
        }
    }
}

impl Source {
    /// Whether it is a line, on which packets arrive as they are sent.
    pub fn is_line(&self) -> bool {
        matches!(self, Self::Udp(_) | Self::Serial(_) | Self::Demo)
    }

    /// Whether commands can be sent. Over UDP the gondola must be named: a datagram does not prove its sender.
    pub fn takes_commands(&self, gondola: Option<SocketAddr>) -> bool {
        match self {
            Self::Serial(_) | Self::Demo => true,
            Self::Udp(_) => gondola.is_some(),
            Self::Archive(_) | Self::Record(_) => false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sources_are_read_as_they_are_written() {
        for text in [
            "udp:0.0.0.0:2000",
            "udp:[::1]:2000",
            "serial:/dev/ttyUSB0",
            "archive:flight",
            "record:a.log",
            "demo",
        ] {
            assert_eq!(text.parse::<Source>().unwrap().to_string(), text);
        }
        let everywhere: Source = "udp::2000".parse().unwrap();
        assert_eq!(everywhere, "udp:2000".parse().unwrap());
        for wrong in [
            "",
            "udp:",
            "udp:host:1",
            "udp::0",
            "archive:",
            "demo:x",
            "tcp:1",
            "serial:tcp:10.0.0.1:1",
            "serial:udp:10.0.0.1:1",
        ] {
            let error = wrong.parse::<Source>().unwrap_err();
            assert!(error.contains("expected udp:[ADDR]:PORT"), "{error}");
        }
    }
}
