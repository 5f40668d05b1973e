//! The link over UDP, as the HEROES flight program had it: one packet a datagram.

use super::port::{BytePort, PortError, means_later};
use std::io::{self, ErrorKind};
use std::net::{Ipv4Addr, Ipv6Addr, SocketAddr, ToSocketAddrs, UdpSocket};
use std::time::Duration;

/// A UDP socket that sends to one peer and takes what comes from any: controller and ground may be two hosts.
#[derive(Debug)]
pub struct UdpPort {
    name: String,
    socket: UdpSocket,
    peer: SocketAddr,
}

impl UdpPort {
    /// Listens on `local_port` (0: any free one) and sends to `peer`, a host and port.
    pub fn open(peer: &str, local_port: u16) -> Result<Self, PortError> {
        let name = format!("udp:{peer}");
        let open = || -> io::Result<(UdpSocket, SocketAddr)> {
            let found = peer.to_socket_addrs()?.next();
            let peer = found.ok_or_else(|| io::Error::from(ErrorKind::NotFound))?;
            let any = match peer {
                SocketAddr::V4(_) => SocketAddr::from((Ipv4Addr::UNSPECIFIED, local_port)),
                SocketAddr::V6(_) => SocketAddr::from((Ipv6Addr::UNSPECIFIED, local_port)),
            };
            Ok((UdpSocket::bind(any)?, peer))
        };
        match open() {
            Ok((socket, peer)) => Ok(Self { name, socket, peer }),
            Err(cause) => Err(PortError::Udp { name, cause }),
        }
    }

    /// The port that this end listens on.
    pub fn local_port(&self) -> Option<u16> {
        self.socket.local_addr().ok().map(|address| address.port())
    }

    fn lost(&self, cause: io::Error) -> PortError {
        let name = self.name.clone();
        PortError::Lost { name, cause }
    }

    fn receive(&self, buffer: &mut [u8], timeout: Duration) -> io::Result<usize> {
        // A timeout of zero would mean none.
        self.socket.set_nonblocking(timeout.is_zero())?;
        if !timeout.is_zero() {
            self.socket.set_read_timeout(Some(timeout))?;
        }
        self.socket.recv_from(buffer).map(|(count, _)| count)
    }
}

impl BytePort for UdpPort {
    fn read(&mut self, buffer: &mut [u8], timeout: Duration) -> Result<usize, PortError> {
        match self.receive(buffer, timeout) {
            Ok(count) => Ok(count),
            Err(error) if means_later(&error) || is_of_the_peer(&error) => Ok(0),
            Err(error) => Err(self.lost(error)),
        }
    }

    fn write(&mut self, bytes: &[u8], _: Duration) -> Result<(), PortError> {
        let sent = self
            .socket
            .set_nonblocking(true)
            .and_then(|()| self.socket.send_to(bytes, self.peer));
        match sent {
            Ok(_) => Ok(()),
            Err(error) if means_later(&error) => Err(PortError::Stalled {
                name: self.name.clone(),
                written: 0,
                length: bytes.len(),
                timeout: Duration::ZERO,
            }),
            // Nobody listens there yet, or the network is down for now: the datagram is lost, the port is not.
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

    const LONG: Duration = Duration::from_secs(10);

    /// Two ends that know each other.
    fn pair() -> (UdpPort, UdpPort) {
        let near = UdpPort::open("127.0.0.1:9", 0).unwrap();
        let peer = format!("127.0.0.1:{}", near.local_port().unwrap());
        let far = UdpPort::open(&peer, 0).unwrap();
        let back = SocketAddr::from((Ipv4Addr::LOCALHOST, far.local_port().unwrap()));
        (UdpPort { peer: back, ..near }, far)
    }

    #[test]
    fn a_write_is_a_datagram_and_a_read_is_one() {
        let (mut near, mut far) = pair();
        near.write(b"one", LONG).unwrap();
        near.write(b"two!", LONG).unwrap();
        let mut buffer = [0; 64];
        assert_eq!(far.read(&mut buffer, LONG).unwrap(), 3);
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
        drop(far);
        for _ in 0..5 {
            near.write(b"anyone?", LONG).unwrap();
            let short = Duration::from_millis(5);
            assert_eq!(near.read(&mut buffer, short).unwrap(), 0);
        }
    }

    #[test]
    fn a_peer_without_a_port_is_refused() {
        let error = UdpPort::open("127.0.0.1", 0).unwrap_err().to_string();
        assert!(
            error.starts_with("udp:127.0.0.1: cannot be opened"),
            "{error}"
        );
    }
}
