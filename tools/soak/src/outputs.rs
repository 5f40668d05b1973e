//! Effect of outputs on the controller's line: short flights with and without them in turns, so that both have the same
//! load on the machine.

use crate::camera::Ring;
use crate::report::say;
use crate::rig::{Parts, Rig};
use solaspect::config::{Output, Outputs};
use solaspect::instrument::Instrument;
use solaspect::link::{BytePort, SerialPort};
use solaspect::output::Format;
use solaspect::service::{FlightTally, quantile};
use std::collections::BTreeMap;
use std::fs;
use std::io::{ErrorKind, Read};
use std::net::{Ipv4Addr, SocketAddr, TcpListener, TcpStream, UdpSocket};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::{self, JoinHandle};
use std::time::Duration;

/// Length of a flight.
pub const LEG: Duration = Duration::from_secs(20);
/// Number of solutions at the beginning of a flight that do not count, because the Sun is acquired.
const BEGIN: usize = 52;
/// Maximum ratio of the latencies (99 %) with outputs to those without, in the median of the flights: other load on the
/// machine disturbs some of them.
const MOST_RATIO: f64 = 1.1;
/// Interval at which readers poll.
const POLL_INTERVAL: Duration = Duration::from_millis(100);

/// Parts of the flights.
pub struct Flights {
    pub instrument: Instrument,
    pub ring: Ring,
    pub rate_hz: f64,
    pub realtime: Option<u8>,
}

/// Results of the flights with or without outputs.
#[derive(Default)]
struct Sum {
    latencies: Vec<Duration>,
    /// The 99 % quantile of each flight's latencies.
    of_flights: Vec<Duration>,
    /// Numbers of sent and dropped items, by output.
    counts: BTreeMap<String, [u64; 2]>,
    lost: u64,
}

impl Flights {
    /// Flies for about this time, prints the results, and returns whether the line was unaffected.
    pub fn compare(&self, time: Duration) -> anyhow::Result<bool> {
        let [mut without, mut with] = [Sum::default(), Sum::default()];
        // Neither kind comes first more often.
        let rounds = (time.as_secs() / (4 * LEG.as_secs())).max(1);
        for has_outputs in [false, true, true, false].repeat(rounds as usize) {
            match has_outputs {
                false => without.add(&self.fly(Outputs::default())?, &[]),
                true => {
                    let readers = Readers::start()?;
                    with.add(&self.fly(readers.outputs.clone())?, &readers.kinds);
                    readers.end();
                }
            }
        }
        let [before, after] = [("without", &mut without), ("with", &mut with)].map(|(name, sum)| {
            let count = sum.latencies.len();
            let ms = |fraction| {
                let found = quantile(&mut sum.latencies, fraction).unwrap_or_default();
                1e3 * found.as_secs_f64()
            };
            let [median, most, nearly_all] = [0.5, 0.99, 0.999].map(ms);
            let of_flight = quantile(&mut sum.of_flights, 0.5).unwrap_or_default();
            let of_flight_ms = 1e3 * of_flight.as_secs_f64();
            say(format_args!(
                "{name:8} outputs: {count} solutions, frame to packet: median {median:.2}, 99 % {most:.2}, 99.9 % {nearly_all:.2} ms; 99 % of a flight: {of_flight_ms:.2} ms in the median; {} lost",
                sum.lost
            ));
            of_flight_ms
        });
        for (kind, [sent, dropped]) in &with.counts {
            say(format_args!(
                "output   {kind}: {sent} sent, {dropped} dropped"
            ));
        }
        let ratio = after / before;
        say(format_args!(
            "ratio of the medians of the flights' 99 %: {ratio:.3}"
        ));
        Ok(ratio <= MOST_RATIO && with.lost == 0)
    }

    fn fly(&self, outputs: Outputs) -> anyhow::Result<FlightTally> {
        let folder = tempfile::tempdir()?;
        let [root, values] = ["archive", "values"].map(|name| folder.path().join(name));
        fs::create_dir(&values)?;
        let rig = Rig::start(Parts {
            ring: self.ring.again(),
            instrument: self.instrument.clone(),
            roll: None,
            navigation: None,
            realtime: self.realtime,
            outputs,
            roots: vec![root],
            values,
            keep: false,
            rate_hz: self.rate_hz,
            stderr: None,
        })?;
        while !rig.service.is_finished() {
            rig.check(false)?;
        }
        let (_, _far) = rig.gondola.end();
        Ok(rig.service.join()?)
    }
}

impl Sum {
    /// Adds a flight with outputs of these kinds.
    fn add(&mut self, tally: &FlightTally, kinds: &[&str]) {
        let latencies = tally.line.latencies.iter().skip(BEGIN);
        let mut latencies: Vec<Duration> = latencies.copied().collect();
        self.of_flights.extend(quantile(&mut latencies, 0.99));
        self.latencies.append(&mut latencies);
        self.lost += tally.lost();
        for (output, kind) in tally.outputs.iter().zip(kinds) {
            let counts = self.counts.entry((*kind).to_owned()).or_default();
            counts[0] += output.sent;
            counts[1] += output.dropped;
        }
    }
}

/// Programs at the receiving ends of outputs of all kinds, some of which read nothing.
struct Readers {
    outputs: Outputs,
    kinds: Vec<&'static str>,
    over: Arc<AtomicBool>,
    threads: Vec<JoinHandle<()>>,
    /// Ends that are kept open.
    _serial: Vec<SerialPort>,
}

impl Readers {
    fn start() -> anyhow::Result<Self> {
        let over = Arc::<AtomicBool>::default();
        let mut threads = Vec::new();
        let mut read = |mut next: Box<dyn FnMut() + Send>| {
            let over = Arc::clone(&over);
            threads.push(thread::spawn(move || {
                while !over.load(Ordering::Relaxed) {
                    next();
                }
            }));
        };
        let udp = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0))?;
        udp.set_read_timeout(Some(POLL_INTERVAL))?;
        let to_udp = format!("udp:{}", udp.local_addr()?);
        let mut buffer = [0; 65_536];
        read(Box::new(move || _ = udp.recv(&mut buffer)));

        let (mut near, far) = SerialPort::pair()?;
        let mut buffer = [0; 4096];
        read(Box::new(move || _ = near.read(&mut buffer, POLL_INTERVAL)));
        let (unread, deaf) = SerialPort::pair()?;

        let [read_by, stuck_by] = [free_address()?, free_address()?];
        let (mut client, mut buffer) = (None, [0; 65_536]);
        read(Box::new(move || match &mut client {
            None => client = connected(read_by),
            Some(stream) => take(stream, &mut buffer),
        }));
        let mut stuck = None;
        read(Box::new(move || match &stuck {
            None => stuck = connected(stuck_by),
            Some(_) => thread::sleep(POLL_INTERVAL),
        }));
        let outputs = [
            ("jsonl by UDP", to_udp, Format::Jsonl),
            (
                "nmea, serial",
                format!("serial:{}", far.name()),
                Format::Nmea,
            ),
            (
                "jsonl, serial, unread",
                format!("serial:{}", deaf.name()),
                Format::Jsonl,
            ),
            (
                "ccsds by TCP",
                format!("tcp-listen:{read_by}"),
                Format::Ccsds,
            ),
            (
                "jsonl by TCP, unread",
                format!("tcp-listen:{stuck_by}"),
                Format::Jsonl,
            ),
        ];
        let output = |(_, to, format): &(_, String, Format)| {
            let to = Some(to.parse()?);
            Ok(Output {
                to,
                format: *format,
                ..Output::default()
            })
        };
        Ok(Self {
            kinds: outputs.iter().map(|(kind, ..)| *kind).collect(),
            outputs: outputs.iter().map(output).collect::<anyhow::Result<_>>()?,
            over,
            threads,
            _serial: vec![far, unread, deaf],
        })
    }

    fn end(self) {
        self.over.store(true, Ordering::Relaxed);
        for thread in self.threads {
            let _ = thread.join();
        }
    }
}

fn free_address() -> anyhow::Result<SocketAddr> {
    Ok(TcpListener::bind((Ipv4Addr::LOCALHOST, 0))?.local_addr()?)
}

fn connected(address: SocketAddr) -> Option<TcpStream> {
    thread::sleep(Duration::from_millis(10));
    let stream = TcpStream::connect(address).ok()?;
    stream.set_read_timeout(Some(POLL_INTERVAL)).ok()?;
    Some(stream)
}

/// Reads available bytes; a stream that has ended is ignored.
fn take(stream: &mut TcpStream, buffer: &mut [u8]) {
    match stream.read(buffer) {
        Ok(0) => thread::sleep(POLL_INTERVAL),
        Err(error) if error.kind() == ErrorKind::ConnectionReset => thread::sleep(POLL_INTERVAL),
        _ => {}
    }
}
