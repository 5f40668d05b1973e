//! The program over a pseudo-terminal, with the flight side of the link at the other end.

use solaspect::link::{
    self, BytePort, CommandResult, Computer, Control, Direction, Exposure, GpsFix, LinkState,
    Packet, Parser, Responder, SerialPort, Solution,
};
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

#[derive(Clone, Copy, PartialEq)]
enum Line {
    Good,
    Noisy,
}

const TIMEOUT: Duration = Duration::from_secs(10);
const SENDING: LinkState = LinkState {
    tracking: false,
    sending: true,
};

/// Runs the program against a flight side that sends one offset per step, on a noisy line with one wrong bit.
fn converse(line: Line) -> Output {
    let (mut port, far) = SerialPort::pair().unwrap();
    let mut program = Command::new(env!("CARGO_BIN_EXE_gondola"));
    program
        .args([far.name(), "--duration", "3s"])
        .stdout(Stdio::piped());
    let mut child = program.spawn().unwrap();
    let mut responder = Responder::new(Computer::One, SENDING);
    let mut parser = Parser::new(Direction::ToAspect);
    let (start, mut millisecond) = (Instant::now(), 1_379_786_400_000);
    while child.try_wait().unwrap().is_none() {
        let mut buffer = [0; 256];
        let count = port.read(&mut buffer, Duration::from_millis(20)).unwrap();
        millisecond += 250;
        let now = jiff::Timestamp::from_millisecond(millisecond).unwrap();
        let mut to_send = Vec::new();
        for packet in parser.feed(&buffer[..count], start.elapsed()) {
            if let Packet::Command(packet) = packet {
                to_send.extend(responder.handle(&packet, now, &mut Desk).unwrap().packets);
            }
        }
        if responder.state().tracking {
            to_send.extend(responder.exposure_starts(exposure(now)).unwrap());
            to_send.extend(responder.solution(exposure(now), &offset(now)).unwrap());
        }
        if let Some(last) = to_send.last_mut().filter(|_| line == Line::Noisy) {
            last.iter_mut()
                .last()
                .into_iter()
                .for_each(|byte| *byte ^= 1);
        }
        for packet in to_send {
            port.write(&packet, TIMEOUT).unwrap();
        }
    }
    child.wait_with_output().unwrap()
}

/// A service that receives no requests.
struct Desk;

impl Control for Desk {
    fn knows(&self, _: u16) -> bool {
        false
    }

    fn carry_out(&mut self, _: &link::AspectCommand) -> link::Carried {
        CommandResult::Unknown.into()
    }

    fn take_fix(&mut self, _: GpsFix) -> CommandResult {
        CommandResult::Refused
    }

    fn request_moon(&mut self, _: &link::MoonRequest) -> CommandResult {
        CommandResult::NotImplemented
    }
}

fn exposure(start: jiff::Timestamp) -> Exposure {
    Exposure { camera: 1, start }
}

fn offset(time: jiff::Timestamp) -> Solution {
    Solution {
        azimuth_deg: 0.0125,
        elevation_deg: -0.0034,
        roll_deg: 0.0,
        error_deg: 2e-5,
        time,
    }
}

fn printed(output: &Output) -> String {
    String::from_utf8_lossy(&output.stdout).into_owned()
}

#[test]
fn offsets_are_printed_and_a_good_line_ends_well() {
    let output = converse(Line::Good);
    let text = printed(&output);
    assert_eq!(output.status.code(), Some(0), "{text}");
    let first = text.lines().nth(1).unwrap();
    let words: Vec<&str> = first.split_whitespace().collect();
    assert_eq!(words[1..], ["0.012500", "-0.003400", "0.000020"]);
    assert!(
        words[0].starts_with("2013-09-21T18:00:0") && words[0].ends_with('Z'),
        "{first}"
    );
    assert!(text.contains("1 tracking on, 1 tracking off"), "{text}");
}

#[test]
fn a_noisy_line_ends_with_exit_code_1_and_says_so() {
    let output = converse(Line::Noisy);
    let text = printed(&output);
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert!(
        text.contains("bad: ") && !text.contains("bad: 0 broken"),
        "{text}"
    );
}

#[test]
fn a_silent_line_and_a_missing_one_end_with_exit_code_1() {
    let (_port, far) = SerialPort::pair().unwrap();
    let run = |port: &str| {
        let mut program = Command::new(env!("CARGO_BIN_EXE_gondola"));
        program
            .args([port, "--duration", "100ms"])
            .output()
            .unwrap()
    };
    let silent = run(far.name());
    assert_eq!(silent.status.code(), Some(1));
    assert!(printed(&silent).contains("no answer"));
    let missing = run("/nowhere/tty");
    assert_eq!(missing.status.code(), Some(1));
    let complaint = String::from_utf8_lossy(&missing.stderr).into_owned();
    assert!(complaint.contains("/nowhere/tty"), "{complaint}");
}

#[test]
fn wrong_usage_has_exit_code_2() {
    let mut program = Command::new(env!("CARGO_BIN_EXE_gondola"));
    let output = program
        .args(["/dev/null", "--duration", "soon"])
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(2));
}
