//! `solaspect link` from a shell: it sends, reads and records.

use solaspect::commands::controls::Controls;
use solaspect::config::Config;
use solaspect::link::byte_log;
use solaspect::link::{
    BytePort, Computer, Direction, LinkState, Packet, Parser, Responder, SerialPort,
};
use solaspect::pointing::Target;
use std::process::{Command, Output};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

const PACKETS: &str = include_str!("data/packets.txt");

fn link(arguments: &[&str]) -> Output {
    let program = env!("CARGO_BIN_EXE_solaspect");
    Command::new(program)
        .arg("link")
        .args(arguments)
        .output()
        .unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

/// Runs a responder of the aspect system on a pty while `act` uses the other end.
fn with_responder(computer: Computer, act: impl FnOnce(&str)) {
    let (mut near, far) = SerialPort::pair().unwrap();
    let over = AtomicBool::new(false);
    let mounting = solaspect::instrument::builtin("demo").unwrap().mounting;
    let mut controls = Controls::new(Config::default(), Target::default(), mounting);
    std::thread::scope(|scope| {
        scope.spawn(|| {
            let mut responder = Responder::new(computer, LinkState::default());
            let mut parser = Parser::new(Direction::ToAspect);
            let start = Instant::now();
            let mut buffer = [0; 512];
            while !over.load(Ordering::Relaxed) {
                let wait = Duration::from_millis(5);
                let count = near.read(&mut buffer, wait).unwrap();
                for packet in parser.feed(&buffer[..count], start.elapsed()) {
                    let Packet::Command(packet) = packet else {
                        continue;
                    };
                    let now = jiff::Timestamp::now();
                    let reply = responder.handle(&packet, now, &mut controls).unwrap();
                    for packet in reply.packets {
                        near.write(&packet, Duration::from_secs(5)).unwrap();
                    }
                }
            }
        });
        // A failed assertion must end the other thread, too.
        let result = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| act(far.name())));
        over.store(true, Ordering::Relaxed);
        if let Err(failure) = result {
            std::panic::resume_unwind(failure);
        }
    });
}

#[test]
fn a_command_is_sent_in_natural_units_and_its_result_is_shown() {
    with_responder(Computer::One, |port| {
        for (arguments, code, said) in [
            (&["set_target", "-300", "450"][..], 0, "done\n"),
            (&["get_target_x"], 0, "x -300 arcsec\n"),
            (&["set_clocking", "-32.375"], 0, "done\n"),
            (&["0x0C20"], 0, "angle -32.375 deg\n"),
            (&["set_clocking", "1000"], 1, "refused: out of range\n"),
            (&["get_disk_use", "1"], 1, "not known\n"),
            (&["start_tracking"], 0, "done\n"),
            (&["gps", "34.49", "-104.25"], 0, "done\n"),
        ] {
            let arguments = [&["send", "--port", port], arguments].concat();
            let output = link(&arguments);
            assert_eq!(
                text(&output.stdout),
                said,
                "{arguments:?} {}",
                text(&output.stderr)
            );
            assert_eq!(output.status.code(), Some(code), "{arguments:?}");
        }
    });
}

#[test]
fn an_order_that_is_wrong_or_not_answered_fails_and_says_why() {
    with_responder(Computer::Two, |port| {
        let send = |arguments: &[&str]| {
            link(&[&["send", "--port", port, "--timeout", "300ms"], arguments].concat())
        };
        let silent = send(&["no_op"]);
        assert_eq!(silent.status.code(), Some(1));
        assert!(text(&silent.stderr).contains("no receipt within 300ms"));
        let addressed = send(&["--computer", "2", "no_op"]);
        assert_eq!(
            addressed.status.code(),
            Some(0),
            "{}",
            text(&addressed.stderr)
        );
        let unknown = send(&["set_targt", "1", "2"]);
        assert_eq!(unknown.status.code(), Some(1));
        assert!(text(&unknown.stderr).contains("set_target"));
    });
}

#[test]
fn real_packets_are_decoded_from_the_command_line_and_from_files() {
    let solution = PACKETS
        .lines()
        .find(|line| line.starts_with("solution"))
        .unwrap();
    let hex = solution.rsplit_once(' ').unwrap().1;
    let output = link(&["decode", hex]);
    assert!(output.status.success());
    let said = text(&output.stdout);
    assert!(
        said.contains("solution azimuth 0.0125 elevation -0.0034"),
        "{said}"
    );
    assert!(
        said.ends_with("1 packet; rejected: 0 packets, 0 bytes\n"),
        "{said}"
    );

    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("line.log");
    std::fs::write(
        &log,
        format!("# a record\n1379786400.5 {hex}\n1379786401.0 00{hex}\n"),
    )
    .unwrap();
    // `decode` judges every byte; `log` reads as much of a record as it can.
    for (command, code) in [("decode", 1), ("log", 0)] {
        let output = link(&[command, log.to_str().unwrap()]);
        let said = text(&output.stdout);
        assert_eq!(
            output.status.code(),
            Some(code),
            "a byte belongs to no packet"
        );
        assert!(
            said.starts_with("2013-09-21T18:00:00.500000Z to 01 seq 4"),
            "{said}"
        );
        assert!(
            said.ends_with("2 packets; rejected: 0 packets, 1 byte\n"),
            "{said}"
        );
    }
    let raw = folder.path().join("line.bin");
    std::fs::write(&raw, [0x9A, 0xC3, 0xFF]).unwrap();
    let output = link(&["decode", raw.to_str().unwrap()]);
    assert!(text(&output.stdout).contains("rejected: 1 packet, 3 bytes"));
    let wrong = link(&["decode", "9ac3300208006f340110"]);
    assert_eq!(
        text(&wrong.stdout),
        "rejected: packet: expected checksum 6f33, found 6f34\n0 packets; rejected: 1 packet, 10 bytes\n"
    );
    let several = link(&["decode", "9ac3300e7100d498ff1012140b001600ff1081140500"]);
    let said = text(&several.stdout);
    assert!(
        said.contains("set_target") && said.contains("gain 5"),
        "{said}"
    );
    let missing = link(&["decode", "no such file"]);
    assert_eq!(missing.status.code(), Some(1));
    assert!(text(&missing.stderr).contains("expected hexadecimal bytes or a file"));
}

#[test]
fn a_line_is_recorded_and_the_record_is_read() {
    let (mut near, far) = SerialPort::pair().unwrap();
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("line.log");
    let packet = PACKETS
        .lines()
        .find(|line| line.starts_with("error"))
        .unwrap();
    let bytes = solaspect::link::hex::from_hex(packet.rsplit_once(' ').unwrap().1).unwrap();
    let port = far.name().to_owned();
    std::thread::scope(|scope| {
        let recording = scope.spawn(|| {
            let out = log.to_str().unwrap();
            link(&["log", "--port", &port, "--out", out, "--duration", "2s"])
        });
        while !recording.is_finished() {
            near.write(&bytes, Duration::from_secs(5)).unwrap();
            std::thread::sleep(Duration::from_millis(50));
        }
        let output = recording.join().unwrap();
        assert!(output.status.success(), "{}", text(&output.stderr));
    });
    let output = link(&["log", log.to_str().unwrap(), "--from", "aspect"]);
    let said = text(&output.stdout);
    assert!(said.contains("no solution, error 8"), "{said}");
}

/// A recording of 20 packets, one per line, whose lines are damaged.
fn damaged(damage: impl Fn(&mut Vec<Vec<u8>>)) -> Vec<u8> {
    let bytes = PACKETS
        .lines()
        .find(|line| line.starts_with("solution"))
        .and_then(|line| line.rsplit_once(' '))
        .unwrap();
    let line = |n: usize| format!("{}.{:09} {}", 1_379_786_400 + n, n + 1, bytes.1).into_bytes();
    let mut lines: Vec<Vec<u8>> = (0..20).map(line).collect();
    damage(&mut lines);
    [byte_log::HEADER.as_bytes(), b"\n", &lines.join(&b'\n')].concat()
}

/// How to damage the lines of a recording, the number of packets left, and the text of the warning.
type Damage = (fn(&mut Vec<Vec<u8>>), usize, &'static str);

#[test]
fn a_damaged_record_is_read_but_for_its_bad_lines() {
    let damages: [Damage; 6] = [
        (
            |lines| lines.push(vec![0; 4096]),
            20,
            "1 with zero bytes; the first is line 22: expected UTC seconds",
        ),
        (
            |lines| lines[7] = vec![0; 200],
            19,
            "1 with zero bytes; the first is line 9",
        ),
        (
            |lines| lines[7].truncate(40),
            19,
            "1 cut or malformed; the first is line 9",
        ),
        (
            |lines| lines[7] = b"\xff\xfe\xfd".to_vec(),
            19,
            "1 not UTF-8; the first is line 9",
        ),
        (
            |lines| lines.insert(7, lines[6].clone()),
            20,
            "1 repeated; the first is line 9",
        ),
        (
            |lines| lines.extend(lines.clone()),
            20,
            "20 repeated; the first is line 22",
        ),
    ];
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("line.log");
    for (damage, packets, warning) in damages {
        std::fs::write(&log, damaged(damage)).unwrap();
        for command in ["log", "decode"] {
            let output = link(&[command, log.to_str().unwrap()]);
            let (said, warned) = (text(&output.stdout), text(&output.stderr));
            assert_eq!(said.matches("solution azimuth").count(), packets, "{said}");
            assert_eq!(warned.lines().count(), 1, "{warned}");
            assert!(
                warned.contains("line.log") && warned.contains(warning),
                "{warned}"
            );
            assert!(command == "decode" || output.status.success());
        }
    }
}

#[test]
fn a_file_of_which_nothing_can_be_read_is_no_record() {
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("line.log");
    for (bytes, found) in [
        (&b""[..], "found an empty file"),
        (&[0; 4096], "found 4096 zero bytes"),
        (b"frame,utc\n1,2013\n", "found \"frame,utc\""),
    ] {
        std::fs::write(&log, bytes).unwrap();
        let output = link(&["log", log.to_str().unwrap()]);
        let said = text(&output.stderr);
        assert_eq!(output.status.code(), Some(1));
        assert!(said.contains("line.log") && said.contains(found), "{said}");
    }
}
