//! The link over UDP, as in the HEROES flight program: one packet per datagram.

use super::key::Seal;
use super::port::{BytePort, PortError, means_later};
use std::io::{self, ErrorKind};
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr, SocketAddr, UdpSocket};
use std::time::Duration;

/// The local end of a UDP line.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct LocalEnd {
    /// `None`: all addresses of the computer.
    pub address: Option<IpAddr>,
    /// 0: any free port.
    pub port: u16,
}

/// A UDP socket that sends to one peer and receives from any: a
/// [`Guard`](super::Guard) decides which senders to accept.
#[derive(Debug)]
pub struct UdpPort {
    name: String,
    socket: UdpSocket,
    peer: SocketAddr,
    seal: Option<Seal>,
    sender: Option<SocketAddr>,
}

impl UdpPort {
    /// Listens on the local end and sends to `peer`.
    pub fn open(peer: SocketAddr, local: LocalEnd) -> Result<Self, PortError> {
        let any = match peer {
            SocketAddr::V4(_) => IpAddr::V4(Ipv4Addr::UNSPECIFIED),
            SocketAddr::V6(_) => IpAddr::V6(Ipv6Addr::UNSPECIFIED),
        };
        let name = format!("udp:{peer}");
        let address = SocketAddr::from((local.address.unwrap_or(any), local.port));
        match UdpSocket::bind(address) {
            Ok(socket) => Ok(Self {
                name,
                socket,
                peer,
                seal: None,
                sender: None,
            }),
            Err(cause) => Err(PortError::Udp { name, cause }),
        }
    }

    /// The same port, signing every datagram that it sends.
    pub fn signing(self, seal: Seal) -> Self {
        let seal = Some(seal);
        Self { seal, ..self }
    }

    /// The port that this end listens on.
    pub fn local_port(&self) -> Option<u16> {
        self.socket.local_addr().ok().map(|address| address.port())
    }

    fn lost(&self, cause: io::Error) -> PortError {
        let name = self.name.clone();
        PortError::Lost { name, cause }
    }

    fn receive(&self, buffer: &mut [u8], timeout: Duration) -> io::Result<(usize, SocketAddr)> {
        // A zero timeout would mean no timeout.
        self.socket.set_nonblocking(timeout.is_zero())?;
        if !timeout.is_zero() {
            self.socket.set_read_timeout(Some(timeout))?;
        }
        self.socket.recv_from(buffer)
    }

    fn send(&self, packet: &[u8]) -> io::Result<usize> {
        self.socket.set_nonblocking(true)?;
        match &self.seal {
            Some(seal) => self.socket.send_to(&seal.sign_now(packet), self.peer),
            None => self.socket.send_to(packet, self.peer),
        }
    }
}

impl BytePort for UdpPort {
    fn read(&mut self, buffer: &mut [u8], timeout: Duration) -> Result<usize, PortError> {
        self.sender = None;
        match self.receive(buffer, timeout) {
            Ok((count, sender)) => {
                self.sender = Some(sender);
                Ok(count)
            }
            Err(error) if means_later(&error) || is_of_the_peer(&error) => Ok(0),
            Err(error) => Err(self.lost(error)),
        }
    }

    fn sender(&self) -> Option<SocketAddr> {
        self.sender
    }

    fn write(&mut self, bytes: &[u8], _: Duration) -> Result<(), PortError> {
        match self.send(bytes) {
            Ok(_) => Ok(()),
            Err(error) if means_later(&error) => Err(PortError::Stalled {
                name: self.name.clone(),
                written: 0,
                length: bytes.len(),
                timeout: Duration::ZERO,
            }),
            // No program listens there yet, or the network is down: the datagram is lost, but not the port.
            Err(error) if is_of_the_peer(&error) => Ok(()),
            Err(error) => Err(self.lost(error)),
        }
    }
}

fn is_of_the_peer(error: &io::Error) -> bool {
    matches!(
        error.kind(),
        ErrorKind::ConnectionRefused
            | ErrorKind::ConnectionReset
            | ErrorKind::HostUnreachable
            | ErrorKind::NetworkUnreachable
            | ErrorKind::NetworkDown
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::link::{Computer, Key};

    const LONG: Duration = Duration::from_secs(10);

    fn to_port(port: u16) -> SocketAddr {
        SocketAddr::from((Ipv4Addr::LOCALHOST, port))
    }

    fn open(peer: SocketAddr) -> UdpPort {
        UdpPort::open(peer, LocalEnd::default()).unwrap()
    }

    /// Two ends that are each other's peers.
    fn pair() -> (UdpPort, UdpPort) {
        let near = open(to_port(9));
        let far = open(to_port(near.local_port().unwrap()));
        let peer = to_port(far.local_port().unwrap());
        (UdpPort { peer, ..near }, far)
    }

    #[test]
    fn a_write_is_a_datagram_and_a_read_is_one() {
        let (mut near, mut far) = pair();
        near.write(b"one", LONG).unwrap();
        near.write(b"two!", LONG).unwrap();
        let mut buffer = [0; 64];
        assert_eq!(far.read(&mut buffer, LONG).unwrap(), 3);
        assert_eq!(far.sender(), Some(to_port(near.local_port().unwrap())));
        assert_eq!(far.read(&mut buffer, LONG).unwrap(), 4);
        assert_eq!(&buffer[..4], b"two!");
        far.write(b"back", LONG).unwrap();
        assert_eq!(near.read(&mut buffer, LONG).unwrap(), 4);
    }

    #[test]
    fn silence_and_an_absent_peer_are_no_errors() {
        let (mut near, far) = pair();
        let mut buffer = [0; 64];
        assert_eq!(near.read(&mut buffer, Duration::ZERO).unwrap(), 0);
        assert_eq!(near.sender(), None);
        drop(far);
        for _ in 0..5 {
            near.write(b"anyone?", LONG).unwrap();
            let short = Duration::from_millis(5);
            assert_eq!(near.read(&mut buffer, short).unwrap(), 0);
        }
    }

    #[test]
    fn a_local_address_that_is_not_this_machines_is_an_error() {
        let local = LocalEnd {
            address: Some(IpAddr::V4(Ipv4Addr::new(192, 0, 2, 1))),
            port: 0,
        };
        let error = UdpPort::open(to_port(9), local).unwrap_err().to_string();
        assert!(
            error.starts_with("udp:127.0.0.1:9: cannot be opened"),
            "{error}"
        );
    }

    #[test]
    fn a_signing_port_signs_what_it_sends() {
        let (near, mut far) = pair();
        let key = Key::new(b"sixteen bytes or more").unwrap();
        let key = key.towards(Computer::Two);
        near.signing(key.clone()).write(b"packet", LONG).unwrap();
        let mut buffer = [0; 64];
        let count = far.read(&mut buffer, LONG).unwrap();
        let (packet, _) = key.verified(&buffer[..count]).unwrap();
        assert_eq!(packet, b"packet");
    }
}
