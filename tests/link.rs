//! The controller link: real packets byte for byte, and a conversation over a pseudo-terminal.

use jiff::Timestamp;
use solaspect::commands::controls::Controls;
use solaspect::config::Config;
use solaspect::instrument;
use solaspect::link::code::{angle_code, angle_from_code, pair3b, position_from_pair3b};
use solaspect::link::{
    AspectCommand, BytePort, CommandOutcome, Computer, Direction, Exposure, ExposureStart, GpsFix,
    LinkState, Message, NoSolution, Packet, Parser, Receipt, Responder, SerialPort, Solution,
    Telemetry, id,
};
use solaspect::pointing::{HelioprojectiveArcsec, Target};
use solaspect::simulate::controller::{Controller, Faults};
use solaspect::units::SensorPx;
use std::collections::HashMap;
use std::time::{Duration, Instant};

const PACKETS: &str = include_str!("data/packets.txt");

/// A line of the packets: words without `=`, fields, and bytes.
struct Line {
    words: Vec<&'static str>,
    fields: HashMap<&'static str, &'static str>,
    bytes: Vec<u8>,
}

fn lines() -> Vec<Line> {
    let lines = PACKETS.lines().filter(|line| !line.starts_with('#'));
    lines.map(line).collect()
}

fn line(text: &'static str) -> Line {
    let (rest, hex) = text.rsplit_once(' ').unwrap();
    let (fields, words) = rest
        .split(' ')
        .partition::<Vec<_>, _>(|word| word.contains('='));
    let byte = |at| u8::from_str_radix(&hex[at..at + 2], 16).unwrap();
    Line {
        words,
        fields: fields.iter().map(|f| f.split_once('=').unwrap()).collect(),
        bytes: (0..hex.len()).step_by(2).map(byte).collect(),
    }
}

impl Line {
    fn number<T: std::str::FromStr<Err: std::fmt::Debug>>(&self, field: &str) -> T {
        self.fields[field].parse().unwrap()
    }

    /// A time in seconds and decimals, parsed without floating point.
    fn time(&self, field: &str) -> Timestamp {
        let (seconds, decimals) = self.fields[field].split_once('.').unwrap();
        let nanoseconds = format!("{decimals:0<9}").parse().unwrap();
        Timestamp::new(seconds.parse().unwrap(), nanoseconds).unwrap()
    }

    fn message(&self) -> Message {
        match self.words[..] {
            ["tracking_on"] => Message::TrackingOn,
            ["tracking_off"] => Message::TrackingOff,
            ["timestamp"] => Message::ExposureStart(ExposureStart {
                camera: self.number("camera"),
                time: self.time("t"),
            }),
            ["solution"] => Message::Solution(Solution {
                azimuth_deg: self.number("az"),
                elevation_deg: self.number("el"),
                roll_deg: self.number("roll"),
                error_deg: self.number("err"),
                time: Timestamp::new(self.number("s"), self.number::<i32>("ms") * 1_000_000)
                    .unwrap(),
            }),
            ["error"] => Message::Error(NoSolution {
                code: self.number("code"),
            }),
            ["ctl_start_tracking"] => Message::StartTracking,
            ["ctl_stop_tracking"] => Message::StopTracking,
            ["sas_cmd", "set_target"] => self.aspect("set_target", &["x", "y"]),
            ["sas_cmd", "set_pyas_exposure"] => self.aspect("set_pitch_yaw_exposure", &["us"]),
            ["gps_info"] => Message::Gps(GpsFix {
                latitude_deg: self.number("lat"),
                longitude_deg: self.number("lon"),
            }),
            ref words => panic!("no message for {words:?}"),
        }
    }

    fn aspect(&self, name: &str, variables: &[&str]) -> Message {
        assert_eq!(self.fields["sas"], "1");
        let row = solaspect::commands::COMMANDS
            .iter()
            .find(|row| row.name == name)
            .unwrap();
        let variable = |field: &&str| self.number::<i32>(field) as u16;
        let variables: Vec<u16> = variables.iter().map(variable).collect();
        Message::Aspect(row.command(Computer::One, &variables).unwrap())
    }

    fn telemetry(&self) -> Telemetry {
        let sequence = self.number("cmdseq");
        match self.words[1] {
            "ack_receipt" => Telemetry::Receipt(Receipt { sequence }),
            _ => Telemetry::Result(CommandOutcome {
                sequence,
                key: u16::from_str_radix(self.fields["key"].trim_start_matches("0x"), 16).unwrap(),
                value: self.number("err"),
            }),
        }
    }
}

#[test]
fn every_real_message_is_written_and_read_byte_for_byte() {
    let mut count = 0;
    for line in lines() {
        if matches!(line.words[0], "tm" | "pair3b" | "float2b") {
            continue;
        }
        let to_us = matches!(
            line.words[0],
            "ctl_start_tracking" | "ctl_stop_tracking" | "sas_cmd" | "gps_info"
        );
        let (direction, target) = if to_us {
            (Direction::ToAspect, id::ASPECT)
        } else {
            (Direction::ToController, id::CONTROLLER)
        };
        let written = line.message().packet(target, line.number("seq")).unwrap();
        assert_eq!(written.encode(), line.bytes, "{:?}", line.words);
        let read = Packet::decode(direction, &line.bytes).unwrap();
        assert_eq!(read, Packet::Command(written.clone()));
        assert_eq!(Message::decode(written.payload()), Ok(line.message()));
        count += 1;
    }
    assert_eq!(count, 10);
}

#[test]
fn every_real_answer_is_written_and_read_byte_for_byte() {
    let answers: Vec<Line> = lines()
        .into_iter()
        .filter(|line| line.words[0] == "tm")
        .collect();
    assert_eq!(answers.len(), 2);
    for line in answers {
        // Only the acknowledgement of receipt states its time; both packets were made at that time.
        let time = Timestamp::new(1_379_786_400, 250_000_000).unwrap();
        let written = line.telemetry().packet(time).unwrap();
        assert_eq!(written.encode(), line.bytes, "{:?}", line.words);
        let Packet::Telemetry(read) = Packet::decode(Direction::ToController, &line.bytes).unwrap()
        else {
            panic!("{:?} is no telemetry", line.words);
        };
        assert_eq!(Telemetry::decode(&read), Ok(line.telemetry()));
        assert_eq!(read.time(), (1_379_786_400, 250_000_000));
    }
}

#[test]
fn every_real_code_is_written_and_read_byte_for_byte() {
    for line in lines() {
        match line.words[..] {
            ["pair3b", position] => {
                let (x, y) = position.split_once(',').unwrap();
                let position = SensorPx::new(x.parse().unwrap(), y.parse().unwrap());
                let bytes = line.bytes.clone().try_into().unwrap();
                assert_eq!(pair3b(position), Some(bytes));
                assert!(position_from_pair3b(bytes).distance(position) < 0.25);
            }
            ["float2b", value] => {
                let value = value.parse().unwrap();
                let code = u16::from_le_bytes(line.bytes.clone().try_into().unwrap());
                assert_eq!(angle_code(value), Some(code));
                assert!((angle_from_code(code) - value).abs() <= 1.0 / 16.0);
            }
            _ => {}
        }
    }
}

#[test]
fn real_packets_one_after_another_are_separated_in_both_directions() {
    let to_us = |line: &Line| {
        matches!(
            line.words[0],
            "ctl_start_tracking" | "ctl_stop_tracking" | "sas_cmd" | "gps_info"
        )
    };
    let (down, up): (Vec<Line>, Vec<Line>) = lines()
        .into_iter()
        .filter(|line| !matches!(line.words[0], "pair3b" | "float2b"))
        .partition(to_us);
    for (direction, lines) in [(Direction::ToAspect, down), (Direction::ToController, up)] {
        let stream: Vec<u8> = lines.iter().flat_map(|line| line.bytes.clone()).collect();
        let packets = Parser::new(direction).feed(&stream, Duration::ZERO);
        let bytes: Vec<Vec<u8>> = packets.iter().map(Packet::encode).collect();
        let expected: Vec<Vec<u8>> = lines.into_iter().map(|line| line.bytes).collect();
        assert_eq!(bytes, expected);
    }
}

fn controls() -> Controls {
    let mounting = instrument::builtin("demo").unwrap().mounting;
    Controls::new(Config::default(), Target::default(), mounting)
}

/// The flight side of a line, called step by step, as the service's link thread does.
struct Flight {
    port: SerialPort,
    parser: Parser,
    responder: Responder,
    controls: Controls,
    frame: i64,
}

const NO_WAIT: Duration = Duration::ZERO;
const LONG: Duration = Duration::from_secs(10);
const SENDING: LinkState = LinkState {
    tracking: false,
    sending: true,
};

impl Flight {
    fn new(port: SerialPort) -> Self {
        Self {
            port,
            parser: Parser::new(Direction::ToAspect),
            responder: Responder::new(Computer::One, SENDING),
            controls: controls(),
            frame: 0,
        }
    }

    fn answer(&mut self, now: Duration) {
        let mut buffer = [0; 256];
        let count = self.port.read(&mut buffer, NO_WAIT).unwrap();
        for packet in self.parser.feed(&buffer[..count], now) {
            let Packet::Command(packet) = packet else {
                panic!("telemetry towards us");
            };
            let reply = self
                .responder
                .handle(&packet, exposure_time(self.frame), &mut self.controls)
                .unwrap();
            for packet in reply.packets {
                self.port.write(&packet, LONG).unwrap();
            }
        }
    }

    fn expose(&mut self) {
        self.frame += 1;
        let time = exposure_time(self.frame);
        let exposure = Exposure {
            camera: 1,
            start: time,
        };
        let announcement = self.responder.exposure_starts(exposure).unwrap();
        let conclusion = match self.frame % 5 {
            0 => self.responder.error(exposure, 8).unwrap(),
            _ => self
                .responder
                .solution(exposure, &offset(self.frame))
                .unwrap(),
        };
        for packet in announcement.into_iter().chain(conclusion) {
            self.port.write(&packet, LONG).unwrap();
        }
    }
}

/// Exposures at 4 Hz at times that are no multiples of a microsecond.
fn exposure_time(frame: i64) -> Timestamp {
    Timestamp::from_nanosecond(i128::from(1_379_786_400_000_499_900 + frame * 250_000_001)).unwrap()
}

fn offset(frame: i64) -> Solution {
    Solution {
        azimuth_deg: 0.001 * frame as f64,
        elevation_deg: -0.25,
        roll_deg: 0.0,
        error_deg: 1.5e-5,
        time: exposure_time(frame),
    }
}

#[test]
fn a_conversation_over_a_serial_line_is_flawless() {
    let (near, mut far) = SerialPort::pair().unwrap();
    let mut flight = Flight::new(near);
    let mut controller = Controller::new();
    let start = Instant::now();
    let mut step = |flight: &mut Flight, controller: &mut Controller| {
        flight.expose();
        controller.poll(&mut far, start.elapsed()).unwrap();
        flight.answer(start.elapsed());
    };

    while controller.report().solutions.len() < 40 {
        step(&mut flight, &mut controller);
        assert!(flight.frame < 1000, "{}", controller.report());
    }
    assert!(flight.responder.state().tracking);
    for solution in &controller.report().solutions {
        let since_start = solution.time.duration_since(exposure_time(0));
        let frame = (4.0 * since_start.as_secs_f64()).round() as i64;
        assert_eq!(solution.azimuth_deg, offset(frame).azimuth_deg);
        assert_ne!(
            frame % 5,
            0,
            "the error of frame {frame} came as a solution"
        );
    }

    controller.stop_tracking();
    while !controller.is_obeyed() {
        step(&mut flight, &mut controller);
        assert!(flight.frame < 2000, "{}", controller.report());
    }
    let report = controller.report();
    assert_eq!(report.faults, Faults::default(), "{report}");
    assert_eq!(report.stray_bytes, 0);
    assert_eq!((report.tracking_on, report.tracking_off), (1, 1));
    assert_eq!((report.receipts, report.results), (2, 2));
    assert!(report.errors >= 10);
    assert!(report.announcements >= 50);
    assert!(!flight.responder.state().tracking);
}

#[test]
fn the_ground_sets_the_target_over_a_serial_line_in_spite_of_noise() {
    let (near, mut far) = SerialPort::pair().unwrap();
    let mut flight = Flight::new(near);
    let variables = vec![(-300_i16).cast_unsigned(), 450];
    let command = Message::Aspect(AspectCommand::new(0x1412, variables).unwrap());
    let packet = command.packet(id::ASPECT, 9).unwrap().encode();
    // A header that claims 255 bytes, then the valid packet.
    far.write(&[0x9A, 0xC3, 0x30, 0xFF, 0x9A], LONG).unwrap();
    far.write(&packet, LONG).unwrap();

    let mut parser = Parser::new(Direction::ToController);
    let mut answers = Vec::new();
    let end = Instant::now() + LONG;
    while answers.len() < 2 {
        assert!(Instant::now() < end, "{answers:?}");
        flight.answer(Duration::ZERO);
        let mut buffer = [0; 256];
        let count = far.read(&mut buffer, Duration::from_millis(10)).unwrap();
        answers.extend(parser.feed(&buffer[..count], Duration::ZERO));
    }
    let answers: Vec<Telemetry> = answers
        .iter()
        .map(|packet| match packet {
            Packet::Telemetry(packet) => Telemetry::decode(packet).unwrap(),
            Packet::Command(packet) => panic!("{packet:?}"),
        })
        .collect();
    let (sequence, key, value) = (9, 0x1412, 0);
    assert_eq!(
        answers,
        [
            Telemetry::Receipt(Receipt { sequence }),
            Telemetry::Result(CommandOutcome {
                sequence,
                key,
                value
            })
        ]
    );
    let (x, y) = (-300.0, 450.0);
    let target = Target::Fixed(HelioprojectiveArcsec { x, y });
    assert_eq!(flight.controls.snapshot().target, target);
}
