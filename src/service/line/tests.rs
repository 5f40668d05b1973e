//! The line's thread over pseudo-terminals; the test makes exposures and their outcomes.

use super::*;
use crate::aspect::{Stage, Stopped};
use crate::commands::order;
use crate::config::Config;
use crate::frame::{Frame, FrameInfo, Pixels};
use crate::instrument::{Role, builtin};
use crate::link::message::NO_OFFSET;
use crate::link::picture::Section;
use crate::link::{
    BytePort, CommandOutcome, Counts, Guard, Housekeeping, Key, Message, NoSolution, Packet,
    Picture, Seal, SerialPort, Telemetry, id,
};
use crate::pointing::{Offset, Roll, Target};
use crate::service::messages::BodyRoll;
use crate::service::outputs::Outputs;
use crate::units::{Measured, Rejected};
use crossbeam_channel::{Sender, unbounded};
use nalgebra::Matrix2;
use std::collections::VecDeque;
use std::net::SocketAddr;
use std::sync::atomic::{AtomicU64, AtomicUsize};
use std::sync::{Arc, Mutex};
use std::thread::JoinHandle;

const LONG: Duration = Duration::from_secs(30);

/// A line's thread, and the far end of its port.
struct Bench {
    events: Sender<LinkEvent>,
    closing: Arc<AtomicBool>,
    thread: JoinHandle<(LineTally, Counts)>,
    far: Far,
}

/// The controller's and the ground's end.
struct Far {
    port: SerialPort,
    parser: Parser,
    start: Instant,
    sequence: u16,
    read: Vec<Packet>,
    computer: Computer,
}

fn bench(change: impl FnOnce(&mut config::Link)) -> Bench {
    let (near, far) = SerialPort::pair().unwrap();
    bench_over(Connection::over(near), far, change)
}

fn bench_over(
    connection: Connection,
    far: SerialPort,
    change: impl FnOnce(&mut config::Link),
) -> Bench {
    let mut config = Config::default();
    // No test depends on how fast the machine is.
    config.link.max_solution_age_ms = 60_000;
    change(&mut config.link);
    let mounting = builtin("demo").unwrap().mounting;
    let controls = Controls::new(config, Target::default(), mounting);
    controls.note_cameras(&[Role::PitchYaw; 2]);
    bench_of(connection, far, controls)
}

fn bench_of(mut connection: Connection, far: SerialPort, controls: Controls) -> Bench {
    let computer = Computer::numbered(controls.config().link.computer).unwrap();
    let (events, receiver) = unbounded();
    let closing = Arc::new(AtomicBool::new(false));
    let also_closing = Arc::clone(&closing);
    let thread = std::thread::spawn(move || {
        let (tally, counters) = (Shared::default(), Arc::<Counters>::default());
        let mut line = Line::new(&mut connection, shared(controls, &tally, &counters));
        line.run(&receiver, &also_closing, &Heartbeat::new());
        (tally.copy(), counters.now())
    });
    let far = Far::new(far, computer);
    Bench {
        events,
        closing,
        thread,
        far,
    }
}

fn shared(controls: Controls, tally: &Shared<LineTally>, counters: &Arc<Counters>) -> LineContext {
    LineContext {
        controls,
        tally: tally.clone(),
        counters: Arc::clone(counters),
        moon_state: Shared::default(),
        navigation: None,
        outputs: Arc::new(Outputs::default()),
    }
}

fn exposure(number: i64) -> Exposure {
    Exposure {
        camera: 1,
        start: Timestamp::from_second(1_379_786_400 + number).unwrap(),
    }
}

fn offset(sigma_deg: f64) -> Offset {
    Offset {
        azimuth_deg: 0.25,
        elevation_deg: -0.125,
        cross_elevation_deg: 0.2,
        sigma_deg,
        covariance_deg2: Matrix2::identity(),
        calibration_deg2: Matrix2::identity(),
        roll: Roll::Stated,
    }
}

fn solved(exposure: Exposure) -> Outcome {
    Outcome {
        exposure,
        arrived: Instant::now(),
        exposure_time: None,
        offset: Some(offset(1.5e-5)),
        roll: None,
        stopped: None,
    }
}

fn stopped(stage: Stage) -> Stopped {
    let rejected = Rejected {
        reason: crate::units::Reason {
            code: "a_test",
            sentence: "a test",
        },
        measured: 1.0,
        limit: 2.0,
    };
    Stopped { stage, rejected }
}

impl Bench {
    fn starts(&mut self, exposure: Exposure) {
        self.events
            .send(LinkEvent::ExposureStarts(exposure))
            .unwrap();
    }

    fn ends(&mut self, outcome: Outcome) {
        self.events
            .send(LinkEvent::Outcome(Box::new(outcome)))
            .unwrap();
    }

    fn expose(&mut self, exposure: Exposure) {
        self.starts(exposure);
        self.ends(solved(exposure));
    }

    /// Waits until all events have been taken.
    fn drain(&self) {
        let end = Instant::now() + LONG;
        while !self.events.is_empty() {
            assert!(Instant::now() < end, "the line waits");
            std::thread::sleep(TIMEOUT);
        }
    }

    /// Waits until all events have been handled. The first answer may overtake the last event, the second cannot.
    fn settle(&mut self) {
        self.drain();
        for _ in 0..2 {
            assert_eq!(self.far.ask("no_op", &[]), 0);
        }
    }

    fn finish(self) -> (LineTally, Counts) {
        drop(self.events);
        self.closing.store(true, Ordering::Relaxed);
        self.thread.join().unwrap()
    }
}

impl Far {
    fn new(port: SerialPort, computer: Computer) -> Self {
        Self {
            port,
            parser: Parser::new(Direction::ToController),
            start: Instant::now(),
            sequence: 0,
            read: Vec::new(),
            computer,
        }
    }

    fn listen(&mut self) {
        let mut buffer = [0; 4096];
        let count = self.port.read(&mut buffer, TIMEOUT).unwrap();
        let now = self.start.elapsed();
        self.read.extend(self.parser.feed(&buffer[..count], now));
    }

    fn send(&mut self, name: &str, values: &[&str]) -> u16 {
        let values: Vec<String> = values.iter().map(|v| (*v).into()).collect();
        let message = order(name, &values, self.computer).unwrap();
        self.sequence += 1;
        let packet = message.packet(id::ASPECT, self.sequence).unwrap();
        self.port.write(&packet.encode(), LONG).unwrap();
        self.sequence
    }

    fn answers(&self) -> impl Iterator<Item = Telemetry> {
        self.read.iter().filter_map(|packet| match packet {
            Packet::Telemetry(packet) => Telemetry::decode(packet).ok(),
            Packet::Command(_) => None,
        })
    }

    /// The result of a command.
    fn ask(&mut self, name: &str, values: &[&str]) -> u16 {
        let of = self.send(name, values);
        self.result(of)
    }

    fn result(&mut self, of: u16) -> u16 {
        let end = Instant::now() + LONG;
        loop {
            assert!(Instant::now() < end, "no result of {of}");
            let result = self.answers().find_map(|answer| match answer {
                Telemetry::Result(CommandOutcome {
                    sequence, value, ..
                }) if sequence == of => Some(value),
                _ => None,
            });
            match result {
                Some(value) => return value,
                None => self.listen(),
            }
        }
    }

    fn messages(&self) -> Vec<Message> {
        let commands = self.read.iter().filter_map(|packet| match packet {
            Packet::Command(packet) => Some(Message::decode(packet.payload()).unwrap()),
            Packet::Telemetry(_) => None,
        });
        commands.collect()
    }

    /// The times of the solutions, in the order of arrival.
    fn solutions(&self) -> Vec<Timestamp> {
        let messages = self.messages().into_iter();
        let time = |message| match message {
            Message::Solution(solution) => Some(solution.time),
            _ => None,
        };
        messages.filter_map(time).collect()
    }

    fn errors(&self) -> Vec<u16> {
        let messages = self.messages().into_iter();
        let code = |message| match message {
            Message::Error(NoSolution { code }) => Some(code),
            _ => None,
        };
        messages.filter_map(code).collect()
    }
}

fn times(numbers: impl IntoIterator<Item = i64>) -> Vec<Timestamp> {
    numbers.into_iter().map(|n| exposure(n).start).collect()
}

#[test]
fn solutions_go_at_the_divisor_with_their_own_sigma_after_their_announcements() {
    let mut bench = bench(|link| link.solution_divisor = 4);
    assert_eq!(bench.far.ask("start_tracking", &[]), 0);
    for number in 0..8 {
        bench.expose(exposure(number));
    }
    bench.settle();
    assert_eq!(bench.far.solutions(), times([0, 4]));
    let messages = bench.far.messages();
    let announced = messages
        .iter()
        .filter(|m| matches!(m, Message::ExposureStart(_)));
    assert_eq!(announced.count(), 8);
    let sigma = messages.iter().find_map(|message| match message {
        Message::Solution(solution) => Some(solution.error_deg),
        _ => None,
    });
    assert_eq!(sigma, Some(1.5e-5));
    let (_, counts) = bench.finish();
    assert_eq!(
        (counts.announced, counts.solutions, counts.errors),
        (8, 2, 0)
    );
}

#[test]
fn a_frame_without_a_solution_has_an_error_instead() {
    let mut bench = bench(|_| {});
    bench.far.ask("start_tracking", &[]);
    let none = |number| Outcome {
        offset: None,
        ..solved(exposure(number))
    };
    for (number, outcome) in [
        Outcome {
            stopped: Some(stopped(Stage::Limb)),
            ..none(0)
        },
        none(1),
        Outcome {
            offset: Some(offset(f64::NAN)),
            ..none(2)
        },
    ]
    .into_iter()
    .enumerate()
    {
        bench.starts(exposure(number as i64));
        bench.ends(outcome);
    }
    bench.settle();
    assert_eq!(bench.far.errors(), [2, NO_OFFSET, NO_OFFSET]);
    assert!(bench.far.solutions().is_empty());
    assert_eq!(bench.finish().1.errors, 3);
}

#[test]
fn a_solution_is_too_old_by_its_age_since_mid_exposure() {
    let mut bench = bench(|_| {});
    bench.far.ask("start_tracking", &[]);
    let ago = |seconds| {
        Instant::now()
            .checked_sub(Duration::from_secs(seconds))
            .unwrap()
    };
    let shutter = |seconds| Some(Duration::from_secs(seconds));
    for (number, arrived, shutter) in [
        (0, ago(20), None),
        (1, ago(20), shutter(20)),
        (2, ago(20), shutter(90)),
        (3, ago(61), None),
        (4, ago(0), None),
    ] {
        bench.starts(exposure(number));
        bench.ends(Outcome {
            arrived,
            exposure_time: shutter,
            ..solved(exposure(number))
        });
    }
    bench.settle();
    assert_eq!(bench.far.solutions(), times([0, 1, 4]));
    assert_eq!(bench.finish().1.outdated, 2);
}

#[test]
fn a_clock_that_steps_stops_nothing() {
    let mut bench = bench(|_| {});
    bench.far.ask("start_tracking", &[]);
    let hours = [0, 3600, -3600, 7200, -86_400];
    for hour in hours {
        bench.expose(exposure(hour));
    }
    bench.settle();
    assert_eq!(bench.far.solutions(), times(hours));
}

#[test]
fn the_controller_hears_of_one_camera_which_a_command_chooses() {
    let mut bench = bench(|_| {});
    bench.far.ask("start_tracking", &[]);
    // Both cameras take every exposure at one time; one sends.
    let expose_both = |bench: &mut Bench, number| {
        let both = [1, 2].map(|camera| Exposure {
            camera,
            ..exposure(number)
        });
        both.iter().for_each(|exposure| bench.starts(*exposure));
        both.iter()
            .for_each(|exposure| bench.ends(solved(*exposure)));
    };
    (0..5).for_each(|number| expose_both(&mut bench, number));
    bench.settle();
    assert_eq!(bench.far.ask("set_integer", &["4", "2"]), 0);
    (5..10).for_each(|number| expose_both(&mut bench, number));
    bench.settle();
    assert_eq!(bench.far.solutions(), times(0..10), "each once");
    assert_eq!(bench.far.ask("set_integer", &["4", "3"]), 2);
}

/// Hands the sending over from one computer to the other; returns the stop, which may be answered later.
fn hand_over(from: &mut Bench, to: &mut Bench) -> u16 {
    let stop = from.far.send("stop_sending", &[]);
    assert_eq!(to.far.ask("start_sending", &[]), 0);
    stop
}

#[test]
fn a_hand_over_leaves_neither_a_gap_nor_a_double_wherever_it_falls_in_an_exposure() {
    let mut one = bench(|_| {});
    let mut two = bench(|link| link.computer = 2);
    for bench in [&mut one, &mut two] {
        bench.far.ask("start_tracking", &[]);
    }
    for number in 0..12 {
        for bench in [&mut one, &mut two] {
            bench.starts(exposure(number));
            bench.settle();
        }
        // During an exposure.
        let mut stop_one = (number == 2).then(|| hand_over(&mut one, &mut two));
        let stop_two = (number == 8).then(|| hand_over(&mut two, &mut one));
        for bench in [&mut one, &mut two] {
            bench.ends(solved(exposure(number)));
            bench.settle();
        }
        // Between two exposures.
        if number == 5 {
            let stop = hand_over(&mut two, &mut one);
            assert_eq!(two.far.result(stop), 0);
        }
        if number == 6 {
            stop_one = Some(hand_over(&mut one, &mut two));
        }
        if let Some(stop) = stop_one {
            assert_eq!(one.far.result(stop), 0);
        }
        if let Some(stop) = stop_two {
            assert_eq!(two.far.result(stop), 0);
        }
    }
    assert_eq!(one.far.solutions(), times([0, 1, 2, 6, 9, 10, 11]));
    assert_eq!(two.far.solutions(), times([3, 4, 5, 7, 8]));
    one.finish();
    two.finish();
}

#[test]
fn a_stop_is_answered_even_if_the_announced_frame_never_comes() {
    let mut bench = bench(|link| link.max_solution_age_ms = 50);
    bench.far.ask("start_tracking", &[]);
    bench.starts(exposure(0));
    bench.settle();
    assert_eq!(bench.far.ask("stop_sending", &[]), 0);
    bench.expose(exposure(1));
    bench.settle();
    assert!(bench.far.solutions().is_empty());
}

#[test]
fn a_peer_that_takes_nothing_holds_up_nothing_and_hears_the_newest_afterwards() {
    let mut bench = bench(|_| {});
    bench.far.ask("start_tracking", &[]);
    // Twice the capacity of any pseudo-terminal. There is no reader.
    let many = 3000;
    for number in 0..many {
        bench.expose(exposure(number));
    }
    bench.drain();
    // The peer reads again. It first reads the bytes that the system held; then the line is as before.
    let end = Instant::now() + LONG;
    for number in many.. {
        assert!(Instant::now() < end, "nothing new is received");
        bench.expose(exposure(number));
        (0..20).for_each(|_| bench.far.listen());
        if bench.far.solutions().last() > Some(&exposure(many).start) {
            break;
        }
    }
    let solutions = bench.far.solutions();
    assert!(solutions.is_sorted(), "never an older one after a newer");
    assert!(solutions.len() < many as usize, "some were dropped");
    let (tally, counts) = bench.finish();
    assert!(tally.failed > 0);
    assert!(counts.outdated > 0);
}

#[test]
fn a_port_that_was_unplugged_is_found_again_and_the_conversation_goes_on() {
    let slot: Arc<Mutex<Option<SerialPort>>> = Arc::default();
    let socket = Arc::clone(&slot);
    let connection = Connection::new(move || {
        let port = socket.lock().unwrap().take();
        let absent = || PortError::Udp {
            name: "slot".into(),
            cause: std::io::ErrorKind::NotFound.into(),
        };
        port.map(|port| Box::new(port) as _).ok_or_else(absent)
    });
    let (near, far) = SerialPort::pair().unwrap();
    // Absent at the start, too.
    let mut bench = bench_over(connection, far, |_| {});
    bench.expose(exposure(0));
    bench.drain();
    *slot.lock().unwrap() = Some(near);
    assert_eq!(bench.far.ask("start_tracking", &[]), 0);
    bench.expose(exposure(1));
    bench.settle();
    assert_eq!(bench.far.solutions(), times([1]));

    let (near, far) = SerialPort::pair().unwrap();
    bench.far = Far::new(far, Computer::One);
    for number in 2..50 {
        bench.expose(exposure(number));
    }
    bench.drain();
    *slot.lock().unwrap() = Some(near);
    bench.settle();
    bench.expose(exposure(50));
    bench.settle();
    assert_eq!(
        bench.far.solutions(),
        times([50]),
        "tracking still holds; nothing old comes"
    );
    let (tally, _) = bench.finish();
    assert_eq!((tally.lost, tally.reopened), (1, 1));
}

#[test]
fn a_line_that_restarts_goes_on_tracking_as_commanded() {
    let mut config = Config::default();
    config.link.max_solution_age_ms = 60_000;
    let mounting = builtin("demo").unwrap().mounting;
    let controls = Controls::new(config, Target::default(), mounting);
    let next_life = || {
        let (near, far) = SerialPort::pair().unwrap();
        bench_of(Connection::over(near), far, controls.clone())
    };
    let mut bench = next_life();
    assert_eq!(bench.far.ask("start_tracking", &[]), 0);
    bench.finish();
    let mut bench = next_life();
    bench.expose(exposure(1));
    bench.settle();
    assert_eq!(bench.far.solutions(), times([1]));
    assert_eq!(bench.far.ask("stop_tracking", &[]), 0);
    bench.finish();
    let mut bench = next_life();
    bench.expose(exposure(2));
    bench.settle();
    assert!(bench.far.solutions().is_empty());
}

#[test]
fn housekeeping_and_a_picture_reach_the_ground_between_solutions() {
    let mut bench = bench(|link| link.baud = 4_000_000);
    bench.far.ask("start_tracking", &[]);
    let pixels: Vec<u8> = (0..50 * 40).map(|n| (n % 251) as u8).collect();
    let info = FrameInfo::default();
    let frame = Frame::new(50, 40, Pixels::U8(pixels.clone()), 255, info).unwrap();
    let picture = Picture::new(&frame, 1, vec![], exposure(0).start)
        .unwrap()
        .unwrap();
    bench
        .events
        .send(LinkEvent::Picture(Box::new(picture)))
        .unwrap();
    let housekeeping = Housekeeping {
        solutions: 7,
        ..Housekeeping::default()
    };
    bench
        .events
        .send(LinkEvent::Housekeeping(
            Timestamp::now(),
            Box::new(housekeeping.clone()),
        ))
        .unwrap();
    let end = Instant::now() + LONG;
    let mut received = vec![0; pixels.len()];
    let mut number = 0;
    let mut complete = false;
    while !complete {
        assert!(Instant::now() < end, "the picture does not come");
        bench.expose(exposure(number));
        number += 1;
        (0..5).for_each(|_| bench.far.listen());
        for packet in &bench.far.read {
            let Packet::Telemetry(packet) = packet else {
                continue;
            };
            if let Some(section) = Section::decode(packet) {
                received[section.first..][..section.pixels.len()].copy_from_slice(section.pixels);
                complete |= section.last;
            }
        }
    }
    bench.settle();
    assert_eq!(received, pixels);
    assert_eq!(
        bench.far.solutions(),
        times(0..number),
        "none was lost or late"
    );
    let received = bench.far.read.iter().find_map(|packet| match packet {
        Packet::Telemetry(packet) => Housekeeping::decode(packet),
        Packet::Command(_) => None,
    });
    assert_eq!(received, Some(housekeeping));
    let (tally, _) = bench.finish();
    assert_eq!((tally.pictures, tally.housekeeping), (1, 1));
}

#[test]
fn marks_wait_until_nothing_else_is_on_the_line_and_the_newest_go() {
    let port = Datagrams::default();
    let (written, backlog) = (Arc::clone(&port.written), Arc::clone(&port.backlog));
    let mut connection = Connection::over(port);
    let (tally, counters) = (Shared::default(), Arc::<Counters>::default());
    let mut line = Line::new(
        &mut connection,
        shared(ground_controls(), &tally, &counters),
    );
    let (_, events) = unbounded();
    let marks = |number| FrameMarks::new(1, number, &[[101, 0], [-9999, 5]]).unwrap();
    backlog.store(1, Ordering::Relaxed);
    for second in [1, 2] {
        let time = exposure(second).start;
        line.process(LinkEvent::Marks(time, vec![marks(second as u32)]), &events);
        line.send_marks();
    }
    line.process(LinkEvent::ExposureStarts(exposure(3)), &events);
    backlog.store(0, Ordering::Relaxed);
    (0..2).for_each(|_| line.send_marks());
    let newest = marks(2).packet(exposure(2).start).unwrap().encode();
    let written = written.lock().unwrap();
    assert_eq!(written.len(), 2, "the exposure, and marks once");
    assert_eq!(written[1], newest);
    assert_eq!(counters.now().announced, 1);
}

#[test]
fn garbage_on_the_line_loses_no_command() {
    let mut bench = bench(|_| {});
    for number in 0..20 {
        let noise: Vec<u8> = (0..number * 7).map(|n| (n * 37 + number) as u8).collect();
        bench.far.port.write(&noise, LONG).unwrap();
        bench
            .far
            .port
            .write(&[0x9A, 0xC3, 0x30, 0xFF], LONG)
            .unwrap();
        assert_eq!(bench.far.ask("no_op", &[]), 0);
    }
    let (tally, _) = bench.finish();
    assert_eq!(tally.commands, 20);
    assert!(tally.rejected.packets >= 20);
}

/// A port with received datagrams, each with its sender, and the packets that were sent.
#[derive(Default)]
struct Datagrams {
    to_read: VecDeque<(Vec<u8>, SocketAddr)>,
    sender: Option<SocketAddr>,
    written: Arc<Mutex<Vec<Vec<u8>>>>,
    backlog: Arc<AtomicUsize>,
}

impl BytePort for Datagrams {
    fn read(&mut self, buffer: &mut [u8], _: Duration) -> Result<usize, PortError> {
        let next = self.to_read.pop_front();
        self.sender = next.as_ref().map(|(_, sender)| *sender);
        let bytes = next.map_or_else(Vec::new, |(bytes, _)| bytes);
        buffer[..bytes.len()].copy_from_slice(&bytes);
        Ok(bytes.len())
    }

    fn sender(&self) -> Option<SocketAddr> {
        self.sender
    }

    fn write(&mut self, bytes: &[u8], _: Duration) -> Result<(), PortError> {
        self.written.lock().unwrap().push(bytes.to_vec());
        Ok(())
    }

    fn backlog(&mut self) -> usize {
        self.backlog.load(Ordering::Relaxed)
    }
}

const GROUND: &str = "10.0.0.1:4711";
const STRANGER: &str = "10.0.0.2:4711";

fn command(sequence: u16, name: &str, values: &[&str]) -> Vec<u8> {
    let values: Vec<String> = values.iter().map(|v| (*v).into()).collect();
    let message = order(name, &values, Computer::One).unwrap();
    message.packet(id::ASPECT, sequence).unwrap().encode()
}

fn ground_controls() -> Controls {
    let mounting = builtin("demo").unwrap().mounting;
    Controls::new(Config::default(), Target::default(), mounting)
}

/// Result of a line that listens to the ground for these datagrams: numbers of commands answered and datagrams refused, and the answers.
fn received(
    controls: &Controls,
    seal: Option<Seal>,
    datagrams: impl IntoIterator<Item = (Vec<u8>, &'static str)>,
) -> ((u64, u64), Vec<Vec<u8>>) {
    let mut port = Datagrams::default();
    let datagrams = datagrams.into_iter();
    port.to_read = datagrams.map(|(b, s)| (b, s.parse().unwrap())).collect();
    let (written, turns) = (Arc::clone(&port.written), port.to_read.len());
    let guard = Guard::new(vec!["10.0.0.1".parse().unwrap()], seal);
    let mut connection = Connection::over(port).guarded(guard);
    let (tally, counters) = (Shared::default(), Arc::<Counters>::default());
    let mut line = Line::new(&mut connection, shared(controls.clone(), &tally, &counters));
    (0..turns).for_each(|_| line.receive());
    let written = written.lock().unwrap().clone();
    let counted = (tally.copy().commands, counters.now().datagrams_refused);
    (counted, written)
}

#[test]
fn a_datagram_is_carried_out_once_and_only_if_a_peer_sent_it() {
    let controls = ground_controls();
    let set = |sequence, x| command(sequence, "set_target", &[x, "0"]);
    let (counted, answers) = received(
        &controls,
        None,
        [
            (set(5, "100"), GROUND),
            (set(6, "200"), GROUND),
            (set(5, "100"), GROUND),
            (set(4, "300"), GROUND),
            (set(7, "400"), STRANGER),
        ],
    );
    assert_eq!(controls.config().target.x_arcsec, 200.0);
    assert_eq!(counted, (2, 2));
    assert_eq!(answers.len(), 6, "receipt and result, the first ones twice");
    assert_eq!(answers[4..], answers[..2]);
}

#[test]
fn with_a_key_a_command_is_signed_and_new_over_a_restart_too() {
    let key = Key::new(b"sixteen bytes or more").unwrap();
    let key = key.towards(Computer::One);
    let set = |x| command(1, "set_target", &[x, "0"]);
    let signed = |x, stamp| (key.sign(&set(x), stamp), GROUND);
    let controls = ground_controls();
    let receive = |datagrams: [_; 2]| received(&controls, Some(key.clone()), datagrams).0;
    let counted = receive([(set("100"), GROUND), signed("200", 1000)]);
    assert_eq!(counted, (1, 1));
    let counted = receive([signed("200", 1000), signed("300", 1001)]);
    assert_eq!(counted, (1, 1));
    assert_eq!(controls.config().target.x_arcsec, 300.0);
    assert_eq!(controls.stamp_ns(), 1001);
}

#[test]
fn nothing_that_was_signed_for_the_other_computer_is_carried_out() {
    let key = Key::new(b"sixteen bytes or more").unwrap();
    let controls = ground_controls();
    for (name, values) in [
        ("set_target", &["100", "0"][..]),
        ("start_tracking", &[]),
        ("stop_tracking", &[]),
        ("gps", &["34.5", "-104.25"]),
        ("moon", &["34.5", "-104.25", "38405"]),
    ] {
        let replayed = key
            .towards(Computer::Two)
            .sign(&command(1, name, values), 1000);
        let seal = Some(key.towards(Computer::One));
        let (counted, answers) = received(&controls, seal, [(replayed, GROUND)]);
        assert_eq!(counted, (0, 1), "{name}");
        assert!(answers.is_empty(), "{name}");
    }
    assert_eq!(controls.config(), Config::default());
    assert!(!controls.tracking());
}

/// Counts lines of the log.
struct Lines(Arc<AtomicU64>);

impl<S: tracing::Subscriber> tracing_subscriber::Layer<S> for Lines {
    fn on_event(&self, _: &tracing::Event<'_>, _: tracing_subscriber::layer::Context<'_, S>) {
        self.0.fetch_add(1, Ordering::Relaxed);
    }
}

/// The command, its values, and its sender.
type Flood = (&'static str, &'static [&'static str], &'static str);

#[test]
fn a_flood_writes_few_lines_into_the_log_and_every_change_one() {
    use tracing_subscriber::layer::SubscriberExt;
    let lines = Arc::new(AtomicU64::new(0));
    let subscriber = tracing_subscriber::registry().with(Lines(Arc::clone(&lines)));
    let _guard = tracing::subscriber::set_default(subscriber);
    let count = |controls: &Controls, packets, (name, values, sender): Flood| {
        lines.store(0, Ordering::Relaxed);
        let flood = (1..packets).map(|n| (command(n, name, values), sender));
        received(controls, None, flood);
        lines.load(Ordering::Relaxed)
    };
    let floods = [
        ("set_target", &["1", "2"][..], STRANGER),
        ("set_target", &["1", "2"], GROUND),
        ("set_twist", &["1000"], GROUND),
        ("start_tracking", &[], GROUND),
    ];
    // Threads of other tests have no log: if one of them wrote a line first, it would disable the log for this place.
    let warm_up = ground_controls();
    for flood in floods {
        count(&warm_up, 2, flood);
    }
    tracing::callsite::rebuild_interest_cache();
    let controls = ground_controls();
    let counts = floods.map(|flood| count(&controls, 5000, flood));
    assert_eq!(
        counts,
        [13, 2, 13, 1],
        "1, 2, 4 ... 4096; x and y; as the first; once"
    );
    let noise = (1..5000).map(|n: u16| (n.to_le_bytes().repeat(20), GROUND));
    lines.store(0, Ordering::Relaxed);
    received(&controls, None, noise);
    assert_eq!(lines.load(Ordering::Relaxed), 0, "counted as rejected");
}

#[test]
fn a_solution_says_the_roll_where_it_is_known_and_zero_where_it_is_not() {
    for (roll_deg, sent) in [(Some(Measured::new(-2.5, 0.01)), -2.5), (None, 0.0)] {
        let offset = Offset {
            roll: roll_deg.map_or(Roll::Stated, Roll::Measured),
            ..offset(1.0)
        };
        let outcome = Outcome {
            roll: roll_deg.map(|deg| BodyRoll {
                deg,
                arrived: Instant::now(),
            }),
            offset: Some(offset),
            ..solved(exposure(0))
        };
        assert_eq!(outcome.solution().unwrap().roll_deg, sent);
    }
}
