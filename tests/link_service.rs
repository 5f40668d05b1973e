//! The flight service at the end of a serial line: commands, a restart, a lost line. All frames are dark, so that every
//! frame has an error and costs little time.

use jiff::Timestamp;
use solaspect::archive::Store;
use solaspect::camera::{CameraError, Exposure, FrameSource, Take};
use solaspect::commands::{Action, COMMANDS, order};
use solaspect::config::Config;
use solaspect::fits::Compression;
use solaspect::frame::{Frame, FrameInfo, Pixels};
use solaspect::instrument::Role;
use solaspect::instrument::{self, Instrument};
use solaspect::link::ground::{Answered, ask};
use solaspect::link::{
    AspectCommand, BytePort, Computer, Connection, Direction, Guard, Key, LocalEnd, Message,
    NoSolution, Packet, Parser, Peer, PortAddress, SerialPort, UdpPort, id,
};
use solaspect::service::{Flight, FlightCamera, FlightTally, Service};
use std::net::{Ipv4Addr, SocketAddr};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

const LONG: Duration = Duration::from_secs(30);

/// A camera that takes dark frames at 20 frames/s.
struct Dark {
    instrument: Instrument,
    number: u64,
}

impl FrameSource for Dark {
    fn next(&mut self, starts: &mut dyn FnMut(Timestamp)) -> Result<Take, CameraError> {
        let announced = Timestamp::now();
        starts(announced);
        std::thread::sleep(Duration::from_millis(50));
        let info = FrameInfo {
            number: Some(self.number),
            mid_exposure: Some(announced),
            ..FrameInfo::default()
        };
        self.number += 1;
        let (width, height) = (
            self.instrument.camera.width_px,
            self.instrument.camera.height_px,
        );
        let pixels = Pixels::U8(vec![4; width * height]);
        let frame = Frame::new(width, height, pixels, 255, info).expect("a frame");
        Ok(Take::Exposure(Box::new(Exposure { frame, announced })))
    }
}

fn fly(line: Connection, config: Config) -> Service {
    fly_with(line, config, Vec::new())
}

fn fly_with(line: Connection, config: Config, stores: Vec<Store>) -> Service {
    let instrument = instrument::builtin("demo").unwrap();
    let camera = Dark {
        instrument: instrument.clone(),
        number: 0,
    };
    let flight = Flight {
        config,
        line,
        stores,
        ..Flight::of(vec![FlightCamera::of_plate(instrument, camera)])
    };
    Service::start(flight).unwrap()
}

fn end(service: Service) -> FlightTally {
    service.stop();
    service.join().unwrap()
}

/// Sends a command and returns its answer. Each command needs its own sequence number, else it would be taken for a repetition.
fn send(far: &mut dyn BytePort, sequence: u16, name: &str, values: &[&str]) -> Answered {
    let values: Vec<String> = values.iter().map(|v| (*v).into()).collect();
    let message = order(name, &values, Computer::One).unwrap();
    ask(far, &message, sequence, LONG).unwrap()
}

#[test]
fn every_command_of_the_table_is_answered_and_none_ends_the_flight_but_quit() {
    let (near, mut far) = SerialPort::pair().unwrap();
    let service = fly(Connection::over(near), Config::default());
    for (sequence, row) in (1..).zip(COMMANDS) {
        // Zero is valid for most variables and out of range for some.
        let command = row
            .command(Computer::One, &vec![0; row.variables.len()])
            .unwrap();
        if row.action == Action::Quit {
            continue;
        }
        let answer = ask(&mut far, &Message::Aspect(command), sequence, LONG).unwrap();
        assert_eq!(answer.key, 0x1000 | row.key);
        if row.reads.is_none() {
            let refused = [
                "exposure",
                "set_integer",
                "set_float",
                "clocking",
                "twist",
                "place",
            ];
            let expected = match row.name {
                name if refused.iter().any(|part| name.contains(part)) => 2,
                "send_roll_picture" | "send_moon_picture" => 1,
                _ => 0,
            };
            assert_eq!(answer.value, expected, "{}", row.name);
        }
        assert!(!service.controls().quit_requested());
    }
    assert!(send(&mut far, 1000, "quit", &[]).is_done());
    assert!(service.controls().quit_requested());
    let tally = end(service);
    assert_eq!(tally.line.commands, COMMANDS.len() as u64);
}

#[test]
fn values_set_by_command_outlive_a_restart_where_a_file_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let mut config = Config::default();
    config.link.saved_values = Some(folder.path().join("values.toml"));
    let start = |config: &Config| {
        let (near, far) = SerialPort::pair().unwrap();
        (fly(Connection::over(near), config.clone()), far)
    };
    let (service, mut far) = start(&config);
    assert!(send(&mut far, 1, "set_target", &["-300", "450"]).is_done());
    assert!(send(&mut far, 2, "set_pitch_yaw_exposure", &["12000"]).is_done());
    assert!(send(&mut far, 3, "stop_sending", &[]).is_done());
    assert!(!send(&mut far, 4, "set_twist", &["1000"]).is_done());
    end(service);

    let (service, mut far) = start(&config);
    assert_eq!(
        send(&mut far, 5, "get_target_x", &[]).value,
        (-300_i16).cast_unsigned()
    );
    assert_eq!(send(&mut far, 6, "get_target_y", &[]).value, 450);
    assert_eq!(
        send(&mut far, 7, "get_pitch_yaw_exposure", &[]).value,
        12_000
    );
    assert_eq!(
        end(service).counts.announced,
        0,
        "it does not send, as commanded"
    );

    config.link.saved_values = None;
    let (service, mut far) = start(&config);
    assert_eq!(send(&mut far, 8, "get_target_x", &[]).value, 0);
    end(service);
}

#[test]
fn solving_goes_on_while_the_line_is_away_and_the_line_comes_back() {
    let folder = tempfile::tempdir().unwrap();
    let device = folder.path().join("controller");
    let name = device.to_str().unwrap().to_owned();
    // A symlink to the current device, as by-id names are. It does not exist yet.
    let plug = |device: &Path| {
        let (near, far) = SerialPort::pair().unwrap();
        std::os::unix::fs::symlink(far.name(), device).unwrap();
        // The service opens the far end by its name; the test uses the near one.
        (near, far)
    };
    let line = Connection::to(PortAddress::Serial { name }, 115_200, LocalEnd::default());
    let service = fly(line, Config::default());
    std::thread::sleep(Duration::from_millis(100));
    let (mut ours, theirs) = plug(&device);
    assert!(send_patiently(&mut ours, 1, "no_op"));

    std::fs::remove_file(&device).unwrap();
    drop((ours, theirs));
    std::thread::sleep(Duration::from_millis(300));
    let (mut ours, _theirs) = plug(&device);
    assert!(send_patiently(&mut ours, 2, "no_op"));
    let tally = end(service);
    assert_eq!((tally.line.lost, tally.line.reopened), (1, 1), "{tally}");
    assert_eq!(tally.camera.lost, 0);
    assert_eq!(tally.solved(), tally.counts.taken);
    assert_eq!(tally.solver(Role::PitchYaw).unsent, 0);
}

/// Repeats a command until it is answered.
fn send_patiently(far: &mut dyn BytePort, sequence: u16, name: &str) -> bool {
    let message = order(name, &[], Computer::One).unwrap();
    let end = Instant::now() + LONG;
    while Instant::now() < end {
        if ask(far, &message, sequence, Duration::from_millis(500)).is_ok() {
            return true;
        }
    }
    false
}

#[test]
fn a_controller_that_reads_nothing_does_not_hold_up_the_solver() {
    let (near, mut far) = SerialPort::pair().unwrap();
    let service = fly(Connection::over(near), Config::default());
    assert!(send_patiently(&mut far, 1, "start_tracking"));
    std::thread::sleep(Duration::from_secs(2));
    let tally = end(service);
    assert_eq!(tally.camera.lost, 0);
    assert_eq!(tally.solved(), tally.counts.taken);
    assert_eq!(
        tally.solver(Role::PitchYaw).unsent + tally.camera.unannounced,
        0
    );
}

#[test]
fn over_udp_a_packet_is_a_datagram() {
    let to_port = |port| SocketAddr::from((Ipv4Addr::LOCALHOST, port));
    let open = |port| UdpPort::open(to_port(port), LocalEnd::default()).unwrap();
    let mut ours = open(9);
    let near = open(ours.local_port().unwrap());
    // Commands come from another socket than the one that gets the answers, as commands from the ground may.
    let mut ground = open(near.local_port().unwrap());
    let guard = Guard::new(vec![Peer::any_port_of(Ipv4Addr::LOCALHOST.into())], None);
    let service = fly(Connection::over(near).guarded(guard), Config::default());
    let packet = Message::StartTracking.packet(id::ASPECT, 7).unwrap();
    ground.write(&packet.encode(), LONG).unwrap();
    let (mut heard, mut buffer) = (Vec::new(), [0; 2048]);
    let finish = Instant::now() + LONG;
    while !heard.contains(&Some(Message::Error(NoSolution { code: 1 }))) {
        assert!(Instant::now() < finish, "{heard:?}");
        let count = ours.read(&mut buffer, Duration::from_millis(50)).unwrap();
        if count == 0 {
            continue;
        }
        // Each datagram holds exactly one packet.
        let packets = Parser::new(Direction::ToController).feed(&buffer[..count], Duration::ZERO);
        assert_eq!(packets.len(), 1);
        assert_eq!(packets[0].encode().len(), count);
        heard.push(match &packets[0] {
            Packet::Command(packet) => Message::decode(packet.payload()).ok(),
            Packet::Telemetry(_) => None,
        });
    }
    assert!(heard.contains(&Some(Message::TrackingOn)));
    end(service);
}

/// The rows of all command logs in an archive, without their times; logs sorted by name.
fn command_rows(root: &Path) -> Vec<Vec<String>> {
    let entries = std::fs::read_dir(root).unwrap();
    let mut logs: Vec<PathBuf> = entries
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.to_string_lossy().contains("/commands_"))
        .collect();
    logs.sort();
    let mut rows = Vec::new();
    for log in logs {
        let mut log = csv::Reader::from_path(log).unwrap();
        let columns: Vec<String> = log.headers().unwrap().iter().map(Into::into).collect();
        let stated = ["utc", "sender", "key", "name", "values", "result"];
        assert_eq!(columns, stated);
        for row in log.records() {
            let row = row.unwrap();
            assert!(row[0].parse::<Timestamp>().is_ok(), "{row:?}");
            rows.push(row.iter().skip(1).map(Into::into).collect());
        }
    }
    rows
}

#[test]
fn every_command_and_every_restored_value_is_in_the_archive_with_sender_and_result() {
    let root = tempfile::tempdir().unwrap();
    let values = root.path().join("values.toml");
    let mut config = Config::default();
    config.link.port = Some("/dev/ttyUSB7".into());
    config.link.saved_values = Some(values.clone());
    let start = || {
        let (near, far) = SerialPort::pair().unwrap();
        let store = Store::open(root.path(), "demo", Compression::Rice).unwrap();
        let line = Connection::over(near);
        (fly_with(line, config.clone(), vec![store]), far)
    };
    let (service, mut far) = start();
    assert!(send(&mut far, 1, "set_target", &["-300", "450"]).is_done());
    assert!(!send(&mut far, 2, "set_twist", &["1000"]).is_done());
    send(&mut far, 3, "get_target_x", &[]);
    assert!(send(&mut far, 4, "gps", &["34.5", "-104.25"]).is_done());
    let unknown = AspectCommand::new(0x1FF0, vec![]).unwrap();
    ask(&mut far, &Message::Aspect(unknown), 5, LONG).unwrap();
    end(service);
    let (service, far) = start();
    end(service);
    drop(far);
    let from = |sender: &str, rest: [&str; 4]| -> Vec<String> {
        std::iter::once(sender)
            .chain(rest)
            .map(Into::into)
            .collect()
    };
    let line = |rest| from("/dev/ttyUSB7", rest);
    let rows = command_rows(root.path());
    assert_eq!(rows[0], line(["0x1412", "set_target", "-300 450", "done"]));
    let twist = "refused: mounting.twist_deg: expected an angle from -360 to 360 deg, found 1000";
    assert_eq!(rows[1], line(["0x1731", "set_twist", "1000", twist]));
    let read = line(["0x1a10", "get_target_x", "", "x -300 arcsec"]);
    assert_eq!(rows[2], read);
    assert_eq!(rows[3][1..4], ["0x000a", "gps", "34.5 -104.25"]);
    assert_eq!(rows[3][4], "done");
    assert_eq!(rows[4], line(["0x1ff0", "", "", "unknown"]));
    let saved = values.display().to_string();
    let restored: Vec<_> = rows[5..]
        .iter()
        .map(|row| (&row[2][..], &row[3][..]))
        .collect();
    assert!(
        rows[5..]
            .iter()
            .all(|row| row[0] == saved && row[4] == "restored")
    );
    assert!(
        restored.contains(&("target.x_arcsec", "-300")),
        "{restored:?}"
    );
}

#[test]
fn commands_that_are_refused_or_come_again_over_udp_are_in_the_archive_too() {
    let root = tempfile::tempdir().unwrap();
    let open = |port| {
        let to = SocketAddr::from((Ipv4Addr::LOCALHOST, port));
        UdpPort::open(to, LocalEnd::default()).unwrap()
    };
    let near = open(9);
    let mut ground = open(near.local_port().unwrap());
    let seal = |computer| {
        let key = Key::new(b"sixteen bytes or more").unwrap();
        key.towards(computer)
    };
    let peers = vec![Peer::any_port_of(Ipv4Addr::LOCALHOST.into())];
    let guard = Guard::new(peers, Some(seal(Computer::One)));
    let store = Store::open(root.path(), "demo", Compression::Rice).unwrap();
    let line = Connection::over(near).guarded(guard);
    let service = fly_with(line, Config::default(), vec![store]);
    let packet = order("no_op", &[], Computer::One).unwrap();
    let packet = packet.packet(id::ASPECT, 7).unwrap().encode();
    let stamp = 1_379_786_400_000_000_000;
    let signed = seal(Computer::One).sign(&packet, stamp);
    let replayed = seal(Computer::Two).sign(&packet, stamp + 1);
    for datagram in [&packet, &replayed, &signed, &signed] {
        ground.write(datagram, LONG).unwrap();
    }
    let finish = Instant::now() + LONG;
    while service.tally().line.commands == 0 {
        assert!(Instant::now() < finish, "no command came");
        std::thread::sleep(Duration::from_millis(20));
    }
    std::thread::sleep(Duration::from_millis(200));
    end(service);
    let rows = command_rows(root.path());
    let results: Vec<_> = rows.iter().map(|row| (&row[2][..], &row[4][..])).collect();
    let expected = [
        (
            "",
            "refused (1): signature: expected one by link.key_file, for this computer",
        ),
        (
            "",
            "refused (2): signature: expected one by link.key_file, for this computer",
        ),
        ("no_op", "done"),
        ("no_op", "came again (1): answered again"),
    ];
    assert_eq!(results, expected);
    let sender = format!("127.0.0.1:{}", ground.local_port().unwrap());
    assert!(rows.iter().all(|row| row[0] == sender), "{rows:?}");
}
