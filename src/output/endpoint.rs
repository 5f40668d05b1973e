//! The end of an output: a port, or the programs that have connected. A reader takes a message completely or not at all, and no reader is waited for
//! longer than [`WRITE_TIMEOUT`].

use super::Destination;
use crate::backoff::Backoff;
use crate::link::{AnyPort, Connection, LocalEnd, PortAddress, PortError};
use std::io::{self, ErrorKind, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::time::Duration;

/// Time limit for a port to take a message.
const WRITE_TIMEOUT: Duration = Duration::from_millis(50);
/// Programs that may be connected at the same time.
const MOST_CLIENTS: usize = 8;
/// Time after which a client that has taken no byte, though messages were offered, is disconnected.
const CLIENT_TIMEOUT: Duration = Duration::from_secs(30);
/// The longest payload of a datagram over IPv4.
const LONGEST_DATAGRAM: usize = 65_507;

/// Number of copies of a message that were sent, and that were dropped.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Went {
    pub sent: u64,
    pub dropped: u64,
}

impl Went {
    const DROPPED: Self = Self {
        sent: 0,
        dropped: 1,
    };

    fn new(is_sent: bool) -> Self {
        Self {
            sent: u64::from(is_sent),
            dropped: u64::from(!is_sent),
        }
    }
}

/// The end of an output. Times are monotonic, from any origin.
pub struct Endpoint(End);

enum End {
    Port(Box<Port>),
    Clients(Clients),
}

impl Endpoint {
    /// An endpoint for a destination; `baud` applies to a serial one. It is opened by the first [`poll`](Self::poll), and again whenever it is lost.
    pub fn new(to: &Destination, baud: u32) -> Self {
        Self(match to {
            Destination::Port(address) => End::Port(Box::new(Port {
                most_bytes: match address {
                    PortAddress::Udp { .. } => LONGEST_DATAGRAM,
                    PortAddress::Serial { .. } => usize::MAX,
                },
                connection: Connection::to(address.clone(), baud, LocalEnd::default()),
                rest: Rest::default(),
            })),
            Destination::Clients(address) => End::Clients(Clients::new(*address)),
        })
    }

    /// Opens what is closed, and accepts programs that connect.
    pub fn poll(&mut self, now: Duration) {
        match &mut self.0 {
            End::Port(port) => port.poll(now),
            End::Clients(clients) => clients.poll(now),
        }
    }

    /// Writes a message to all readers. Without a reader it is dropped.
    pub fn send(&mut self, message: &[u8], now: Duration) -> Went {
        match &mut self.0 {
            End::Port(port) => port.send(message, now),
            End::Clients(clients) => clients.send(message, now),
        }
    }
}

/// Rest of a message of which a reader has taken a part.
#[derive(Default)]
struct Rest(Vec<u8>);

impl Rest {
    /// Offers the rest again; returns whether the reader has all of it. `write` returns the number of bytes taken.
    fn finish<E>(&mut self, write: &mut impl FnMut(&[u8]) -> Result<usize, E>) -> Result<bool, E> {
        if !self.0.is_empty() {
            let taken = write(&self.0)?;
            self.0.drain(..taken);
        }
        Ok(self.0.is_empty())
    }

    /// Offers a message after the rest of the previous one; returns whether the reader has taken any of it.
    fn offer<E>(
        &mut self,
        message: &[u8],
        mut write: impl FnMut(&[u8]) -> Result<usize, E>,
    ) -> Result<bool, E> {
        if !self.finish(&mut write)? {
            return Ok(false);
        }
        let taken = write(message)?;
        if taken > 0 {
            self.0.extend_from_slice(&message[taken..]);
        }
        Ok(taken > 0)
    }
}

/// A serial line, or datagrams.
struct Port {
    connection: Connection,
    most_bytes: usize,
    rest: Rest,
}

impl Port {
    fn poll(&mut self, now: Duration) {
        if self.connection.revive(now) {
            self.rest = Rest::default();
        }
    }

    fn send(&mut self, message: &[u8], now: Duration) -> Went {
        let Some(port) = self.connection.port() else {
            return Went::DROPPED;
        };
        if message.len() > self.most_bytes {
            return Went::DROPPED;
        }
        let write = |bytes: &[u8]| taken(port, bytes);
        match self.rest.offer(message, write) {
            Ok(is_sent) => Went::new(is_sent),
            Err(error) => {
                tracing::warn!(%error, "an output is lost");
                self.connection.lose(now);
                Went::DROPPED
            }
        }
    }
}

/// Number of bytes that a port takes.
fn taken(port: &mut AnyPort, bytes: &[u8]) -> Result<usize, PortError> {
    match port.write(bytes, WRITE_TIMEOUT) {
        Ok(()) => Ok(bytes.len()),
        Err(PortError::Stalled { written, .. }) => Ok(written),
        Err(error) => Err(error),
    }
}

/// Programs that have connected.
struct Clients {
    address: SocketAddr,
    listener: Option<TcpListener>,
    retry_at: Duration,
    backoff: Backoff,
    clients: Vec<Client>,
}

struct Client {
    stream: TcpStream,
    peer: SocketAddr,
    rest: Rest,
    /// Time at which it last took a byte.
    took_at: Duration,
}

impl Clients {
    fn new(address: SocketAddr) -> Self {
        Self {
            address,
            listener: None,
            retry_at: Duration::ZERO,
            backoff: Backoff::DEVICE,
            clients: Vec::new(),
        }
    }

    fn poll(&mut self, now: Duration) {
        self.listen(now);
        // Limited, so that a flood of connections does not delay messages.
        for _ in 0..MOST_CLIENTS {
            let accept = |listener: &TcpListener| listener.accept().ok();
            let Some((stream, peer)) = self.listener.as_ref().and_then(accept) else {
                break;
            };
            self.take_in(stream, peer, now);
        }
        self.serve(now, |client| {
            let Client { rest, stream, .. } = client;
            rest.finish(&mut |bytes: &[u8]| written(stream, bytes))
        });
    }

    fn listen(&mut self, now: Duration) {
        if self.listener.is_some() || now < self.retry_at {
            return;
        }
        let open = || {
            let listener = TcpListener::bind(self.address)?;
            listener.set_nonblocking(true)?;
            Ok(listener)
        };
        match open() {
            Ok(listener) => {
                tracing::info!(address = %self.address, "an output listens");
                self.listener = Some(listener);
            }
            Err(error) => {
                let error: io::Error = error;
                let wait = self.backoff.wait();
                tracing::warn!(address = %self.address, %error, ?wait, "an output cannot listen");
                self.retry_at = now + wait;
            }
        }
    }

    fn take_in(&mut self, stream: TcpStream, peer: SocketAddr, now: Duration) {
        if self.clients.len() >= MOST_CLIENTS {
            tracing::warn!(%peer, most = MOST_CLIENTS, "an output accepts no more clients");
            return;
        }
        let prepared = stream
            .set_nonblocking(true)
            .and_then(|()| stream.set_nodelay(true));
        if let Err(error) = prepared {
            tracing::warn!(%peer, %error, "a client of an output has gone");
            return;
        }
        tracing::info!(%peer, address = %self.address, "an output has a client");
        self.clients.push(Client {
            stream,
            peer,
            rest: Rest::default(),
            took_at: now,
        });
    }

    fn send(&mut self, message: &[u8], now: Duration) -> Went {
        if self.clients.is_empty() {
            return Went::DROPPED;
        }
        self.serve(now, |client| {
            let Client { rest, stream, .. } = client;
            rest.offer(message, |bytes: &[u8]| written(stream, bytes))
        })
    }

    /// Offers messages to every client; a client that has disconnected, or takes nothing any more, is dropped.
    fn serve(
        &mut self,
        now: Duration,
        mut offer: impl FnMut(&mut Client) -> io::Result<bool>,
    ) -> Went {
        let mut went = Went::default();
        self.clients.retain_mut(|client| {
            let taken = offer(client);
            let is_sent = matches!(taken, Ok(true));
            went.sent += u64::from(is_sent);
            went.dropped += u64::from(!is_sent);
            if is_sent {
                client.took_at = now;
            }
            let peer = client.peer;
            match taken {
                Err(error) => {
                    tracing::info!(%peer, %error, "a client of an output has gone");
                    false
                }
                Ok(_) if now.saturating_sub(client.took_at) > CLIENT_TIMEOUT => {
                    tracing::warn!(%peer, "a client of an output does not read: disconnected");
                    false
                }
                Ok(_) => true,
            }
        });
        went
    }
}

/// Writes the bytes that a stream takes at once; returns their number.
fn written(stream: &mut TcpStream, bytes: &[u8]) -> io::Result<usize> {
    let mut count = 0;
    while count < bytes.len() {
        match stream.write(&bytes[count..]) {
            Ok(0) => return Err(ErrorKind::WriteZero.into()),
            Ok(more) => count += more,
            Err(error) if error.kind() == ErrorKind::Interrupted => {}
            Err(error) if error.kind() == ErrorKind::WouldBlock => break,
            Err(error) => return Err(error),
        }
    }
    Ok(count)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::link::{BytePort, SerialPort};
    use std::io::Read;
    use std::net::Ipv4Addr;
    use std::time::Instant;

    const LONG: Duration = Duration::from_secs(60);
    const NOW: Duration = Duration::ZERO;
    const SENT: Went = Went {
        sent: 1,
        dropped: 0,
    };

    /// A free address of this computer.
    fn free_address() -> SocketAddr {
        let any = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        any.local_addr().unwrap()
    }

    fn endpoint(to: &Destination) -> Endpoint {
        Endpoint::new(to, 115_200)
    }

    /// An endpoint that listens, and clients that it has accepted.
    fn with_clients<const N: usize>() -> (Endpoint, [TcpStream; N]) {
        let address = free_address();
        let mut endpoint = endpoint(&Destination::Clients(address));
        endpoint.poll(NOW);
        let clients = [(); N].map(|()| TcpStream::connect(address).unwrap());
        wait_until(|| {
            endpoint.poll(NOW);
            clients_of(&endpoint) == N
        });
        (endpoint, clients)
    }

    fn clients_of(endpoint: &Endpoint) -> usize {
        match &endpoint.0 {
            End::Clients(clients) => clients.clients.len(),
            End::Port(_) => 0,
        }
    }

    #[track_caller]
    fn wait_until(mut done: impl FnMut() -> bool) {
        let start = Instant::now();
        while !done() {
            assert!(start.elapsed() < LONG, "it never came");
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    /// A long line that begins with its number.
    fn line(number: usize) -> Vec<u8> {
        let mut line = format!("{number} ").into_bytes();
        line.resize(100_000, b'x');
        line.push(b'\n');
        line
    }

    /// The numbers of lines, which must all be complete.
    fn numbers(bytes: &[u8]) -> Vec<usize> {
        let lines = bytes.split_inclusive(|byte| *byte == b'\n');
        let number = |own: &[u8]| {
            let text = std::str::from_utf8(own).unwrap();
            let number: usize = text.split(' ').next().unwrap().parse().unwrap();
            assert_eq!(own, line(number), "a line that is not whole");
            number
        };
        lines.map(number).collect()
    }

    #[test]
    fn a_client_that_takes_nothing_loses_whole_messages_and_the_other_none() {
        let (mut endpoint, [mut stuck, mut good]) = with_clients();
        good.set_nonblocking(true).unwrap();
        let (mut dropped, mut sent) = (0, 0);
        while dropped < 5 {
            let message = line(sent);
            let went = endpoint.send(&message, NOW);
            assert_eq!(went.sent + went.dropped, 2);
            dropped += went.dropped;
            sent += 1;
            let mut read = Vec::new();
            wait_until(|| {
                endpoint.poll(NOW);
                let _ = good.read_to_end(&mut read);
                read.len() >= message.len()
            });
            assert_eq!(read, message);
        }
        // It has lost the last messages. When it reads again, it finds complete lines, and gets the next one.
        stuck.set_nonblocking(true).unwrap();
        let mut read = Vec::new();
        wait_until(|| {
            endpoint.poll(NOW);
            let before = read.len();
            let _ = stuck.read_to_end(&mut read);
            before == read.len() && read.ends_with(b"\n")
        });
        let expected: Vec<usize> = (0..sent - 5).collect();
        assert_eq!(numbers(&read), expected);
        assert_eq!(endpoint.send(b"next\n", NOW).sent, 2);
        wait_until(|| {
            let _ = stuck.read_to_end(&mut read);
            read.ends_with(b"\nnext\n")
        });
    }

    #[test]
    fn a_client_that_takes_nothing_for_half_a_minute_is_disconnected() {
        let (mut endpoint, [_stuck]) = with_clients();
        while endpoint.send(&line(0), NOW).dropped == 0 {}
        endpoint.send(&line(0), CLIENT_TIMEOUT);
        assert_eq!(clients_of(&endpoint), 1);
        endpoint.poll(CLIENT_TIMEOUT + Duration::from_millis(1));
        assert_eq!(clients_of(&endpoint), 0);
    }

    #[test]
    fn a_ninth_client_is_turned_away_until_one_has_left() {
        let (mut endpoint, clients) = with_clients::<MOST_CLIENTS>();
        let address = match &endpoint.0 {
            End::Clients(clients) => clients.address,
            End::Port(_) => panic!("no clients"),
        };
        let mut ninth = TcpStream::connect(address).unwrap();
        ninth
            .set_read_timeout(Some(Duration::from_millis(1)))
            .unwrap();
        wait_until(|| {
            endpoint.poll(NOW);
            matches!(ninth.read(&mut [0]), Ok(0))
        });
        assert_eq!(endpoint.send(b"all\n", NOW).sent, 8);
        drop(clients);
        // The system may still take the first write to a client that has left.
        wait_until(|| endpoint.send(b"anyone?\n", NOW) == Went::DROPPED);
        let mut tenth = TcpStream::connect(address).unwrap();
        wait_until(|| {
            endpoint.poll(NOW);
            endpoint.send(b"you\n", NOW) == SENT
        });
        let mut read = [0; 4];
        tenth.read_exact(&mut read).unwrap();
        assert_eq!(&read, b"you\n");
    }

    #[test]
    fn an_address_in_use_is_tried_again() {
        let taken = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        let address = taken.local_addr().unwrap();
        let mut endpoint = endpoint(&Destination::Clients(address));
        endpoint.poll(NOW);
        assert_eq!(endpoint.send(b"anyone?\n", NOW), Went::DROPPED);
        drop(taken);
        endpoint.poll(Duration::from_millis(249));
        assert!(TcpStream::connect(address).is_err(), "it waits a little");
        endpoint.poll(Duration::from_millis(250));
        TcpStream::connect(address).unwrap();
    }

    #[test]
    fn a_serial_reader_that_was_away_finds_whole_messages() {
        let (mut near, far) = SerialPort::pair().unwrap();
        let name = far.name().to_owned();
        let mut endpoint = endpoint(&Destination::Port(PortAddress::Serial { name }));
        assert_eq!(endpoint.send(b"not open\n", NOW), Went::DROPPED);
        endpoint.poll(NOW);
        let message = |number: usize| format!("${number:0>70}\r\n").into_bytes();
        let (mut sent, mut dropped) = (0, 0);
        for number in 0.. {
            let went = endpoint.send(&message(number), NOW);
            (sent, dropped) = (sent + went.sent, dropped + went.dropped);
            if dropped == 2 {
                break;
            }
        }
        let (mut read, mut buffer) = (Vec::new(), [0; 4096]);
        let mut read_on = |read: &mut Vec<u8>| {
            let count = near.read(&mut buffer, Duration::from_millis(1)).unwrap();
            read.extend_from_slice(&buffer[..count]);
        };
        // The rest of the incomplete message goes first.
        wait_until(|| {
            read_on(&mut read);
            endpoint.send(&message(999_999), NOW) == SENT
        });
        wait_until(|| {
            read_on(&mut read);
            read.ends_with(&message(999_999))
        });
        let expected = (0..sent as usize).chain([999_999]).flat_map(message);
        assert_eq!(read, expected.collect::<Vec<u8>>());
    }

    #[test]
    fn what_no_datagram_can_hold_is_dropped_and_the_next_goes_out() {
        let reader = std::net::UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
        reader.set_read_timeout(Some(LONG)).unwrap();
        let peer = reader.local_addr().unwrap();
        let local_port = None;
        let mut endpoint = endpoint(&Destination::Port(PortAddress::Udp { peer, local_port }));
        endpoint.poll(NOW);
        assert_eq!(endpoint.send(&line(0), NOW), Went::DROPPED);
        assert_eq!(endpoint.send(b"short\n", NOW), SENT);
        let mut buffer = [0; 16];
        let count = reader.recv(&mut buffer).unwrap();
        assert_eq!(&buffer[..count], b"short\n");
    }
}
