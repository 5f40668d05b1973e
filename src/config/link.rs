//! Interpretation of the texts in `[link]`.

use super::{Link, Refused};
use crate::link::connection::EXPECTED;
use crate::link::{Computer, Guard, Key, LocalEnd, Peer, PortAddress};
use std::net::{IpAddr, SocketAddr};

impl Link {
    /// Address of the controller; `None` if nothing is sent.
    ///
    /// # Errors
    /// Expected and found value of `link.port`.
    pub fn address(&self) -> Result<Option<PortAddress>, Refused> {
        let parsed = self.port.as_deref().map(str::parse).transpose();
        parsed.map_err(|_: String| {
            let found = self.port.clone().unwrap_or_default();
            refused("link.port", EXPECTED, quoted(&found))
        })
    }

    /// The end of a UDP line on this computer.
    ///
    /// # Errors
    /// If `link.udp_bind` is no IP address, or of another family than the peer's.
    pub fn local_end(&self) -> Result<LocalEnd, Refused> {
        // The parameter table limits it to the range of a port.
        let port = self.udp_local_port as u16;
        let Some(text) = &self.udp_bind else {
            let address = None;
            return Ok(LocalEnd { address, port });
        };
        let wrong = |expected| refused("link.udp_bind", expected, quoted(text));
        let address: IpAddr = text.parse().map_err(|_| wrong("an IP address"))?;
        match self.peer()? {
            Some(peer) if peer.is_ipv4() != address.is_ipv4() => {
                Err(wrong("an IP address of the same kind as link.port's"))
            }
            _ => Ok(LocalEnd {
                address: Some(address),
                port,
            }),
        }
    }

    /// The guard of commands over UDP; over a serial line it accepts all.
    ///
    /// # Errors
    /// If a peer is no IP address, or a key cannot be read.
    pub fn guard(&self) -> Result<Guard, Refused> {
        let peers = match &self.udp_peers {
            Some(peers) => peers.split(',').map(|text| peer(text.trim())).collect(),
            None => Ok(self
                .peer()?
                .into_iter()
                .map(|p| Peer::any_port_of(p.ip()))
                .collect()),
        };
        let key = self.key_file.as_deref().map(Key::read).transpose();
        let key = key.map_err(|error| {
            let expected = "a file with a secret of 16 bytes or more";
            refused("link.key_file", expected, error.to_string())
        })?;
        let computer = Computer::numbered(self.computer).unwrap_or(Computer::One);
        let seal = key.map(|key| key.towards(computer));
        Ok(Guard::new(peers?, seal))
    }

    fn peer(&self) -> Result<Option<SocketAddr>, Refused> {
        Ok(match self.address()? {
            Some(PortAddress::Udp { peer, .. }) => Some(peer),
            _ => None,
        })
    }
}

fn peer(text: &str) -> Result<Peer, Refused> {
    let wrong = |_: String| {
        let expected = "IP addresses or ADDRESS:PORT, separated by commas";
        refused("link.udp_peers", expected, quoted(text))
    };
    text.parse().map_err(wrong)
}

fn refused(key: &'static str, expected: &str, found: String) -> Refused {
    Refused {
        key: key.into(),
        expected: expected.into(),
        found,
    }
}

fn quoted(text: &str) -> String {
    format!("\"{text}\"")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn over_udp(change: impl FnOnce(&mut Link)) -> Link {
        let mut link = Link {
            port: Some("udp:10.0.0.1:2000".into()),
            ..Link::default()
        };
        change(&mut link);
        link
    }

    fn accepts(link: &Link, sender: &str) -> bool {
        let mut guard = link.guard().unwrap();
        guard.open(b"bytes", sender.parse().unwrap()).is_ok()
    }

    #[test]
    fn commands_over_udp_are_taken_of_the_configured_peer_unless_others_are_named() {
        let link = over_udp(|_| {});
        assert!(accepts(&link, "10.0.0.1:4711") && !accepts(&link, "10.0.0.2:2000"));
        let link = over_udp(|link| link.udp_peers = Some("10.0.0.2, 10.0.0.3:7".into()));
        assert!(accepts(&link, "10.0.0.2:4711") && accepts(&link, "10.0.0.3:7"));
        assert!(!accepts(&link, "10.0.0.1:2000") && !accepts(&link, "10.0.0.3:8"));
    }

    #[test]
    fn what_is_wrong_with_a_udp_line_is_said_by_its_key() {
        let name = over_udp(|link| link.port = Some("udp:controller:2000".into()));
        assert_eq!(name.address().unwrap_err().key, "link.port");
        for bind in ["eth0", "fd00::1"] {
            let link = over_udp(|link| link.udp_bind = Some(bind.into()));
            assert_eq!(link.local_end().unwrap_err().key, "link.udp_bind");
        }
        let link = over_udp(|link| link.udp_bind = Some("10.0.0.9".into()));
        assert!(link.local_end().unwrap().address.is_some());
        let peers = over_udp(|link| link.udp_peers = Some("10.0.0.1,ground".into()));
        assert_eq!(peers.guard().unwrap_err().key, "link.udp_peers");
        let key = over_udp(|link| link.key_file = Some("/nowhere/key".into()));
        assert_eq!(key.guard().unwrap_err().key, "link.key_file");
    }
}
