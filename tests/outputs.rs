//! Outputs of a flight for other programs: the solutions and the telemetry, for each reader as much as it takes, without
//! any effect on the controller's line.

use crossbeam_channel::{Receiver, RecvTimeoutError, Sender, unbounded};
use jiff::{SignedDuration, Timestamp};
use solaspect::aspect::Quality;
use solaspect::camera::{CameraError, Exposure, FrameSource, Take};
use solaspect::commands::order;
use solaspect::config::{Config, Output, Outputs};
use solaspect::frame::{Frame, FrameInfo, Pixels};
use solaspect::instrument;
use solaspect::link::ground::ask;
use solaspect::link::{
    BytePort, Computer, Connection, Direction, Housekeeping, Packet, Parser, SerialPort,
    TelemetryPacket, id,
};
use solaspect::output::Format;
use solaspect::record::Record;
use solaspect::service::{Flight, FlightCamera, Service, SolvedFrame};
use solaspect::simulate::{Conditions, FORT_SUMNER, RandomScenes};
use spacepackets::CcsdsPacketReader;
use std::io::{BufRead, BufReader};
use std::net::{Ipv4Addr, SocketAddr, TcpListener, TcpStream, UdpSocket};
use std::time::{Duration, Instant};

const LONG: Duration = Duration::from_secs(60);
const FRAMES: u64 = 6;

/// A camera that returns the frames sent to it.
struct Given(Receiver<Frame>);

impl FrameSource for Given {
    fn next(&mut self, starts: &mut dyn FnMut(Timestamp)) -> Result<Take, CameraError> {
        let frame = match self.0.recv_timeout(Duration::from_millis(20)) {
            Ok(frame) => frame,
            Err(RecvTimeoutError::Timeout) => return Ok(Take::NotYet),
            Err(RecvTimeoutError::Disconnected) => return Ok(Take::End),
        };
        let announced = Timestamp::now();
        starts(announced);
        Ok(Take::Exposure(Box::new(Exposure { frame, announced })))
    }

    fn frames_wait(&self) -> bool {
        true
    }
}

/// A flight with outputs and a line: the far end of the line, the input of the camera, and the answers.
struct Rig {
    service: Service,
    frames: Sender<Frame>,
    solved: Receiver<SolvedFrame>,
    far: SerialPort,
}

fn fly(outputs: impl IntoIterator<Item = Output>) -> Rig {
    let (near, far) = SerialPort::pair().unwrap();
    let (frames, given) = unbounded();
    let mut config = Config::default();
    // No test depends on the speed of the machine.
    config.link.max_solution_age_ms = 60_000;
    config.outputs = Outputs::from_iter(outputs);
    config.site = FORT_SUMNER.into();
    let demo = instrument::builtin("demo").unwrap();
    let flight = Flight {
        config,
        line: Connection::over(near),
        ..Flight::of(vec![FlightCamera::of_plate(demo, Given(given))])
    };
    let (service, solved) = Service::start_watched(flight).unwrap();
    Rig {
        service,
        frames,
        solved,
        far,
    }
}

fn output(to: &str, format: Format) -> Output {
    Output {
        to: Some(to.parse().unwrap()),
        format,
        ..Output::default()
    }
}

/// `picture` as a frame at `number` quarters of a second after the start of a flight.
fn timed(picture: Frame, number: u64) -> Frame {
    let start: Timestamp = "2013-09-21T18:00:00Z".parse().unwrap();
    let info = FrameInfo {
        number: Some(number),
        mid_exposure: Some(start + SignedDuration::from_millis(250 * number as i64)),
        ..FrameInfo::default()
    };
    let (width, height, saturation) = (picture.width(), picture.height(), picture.saturation_dn());
    Frame::new(width, height, picture.pixels().clone(), saturation, info).unwrap()
}

fn sunny(number: u64) -> Frame {
    let demo = instrument::builtin("demo").unwrap();
    let scenes = RandomScenes::new(&demo, &Conditions::of(&demo), 1).unwrap();
    timed(scenes.scene(number).unwrap().frame().unwrap(), number)
}

fn dark(number: u64) -> Frame {
    let camera = &instrument::builtin("demo").unwrap().camera;
    let (width, height) = (camera.width_px, camera.height_px);
    let pixels = Pixels::U8(vec![7; width * height]);
    let frame = Frame::new(width, height, pixels, 255, FrameInfo::default()).unwrap();
    timed(frame, number)
}

fn reader() -> (UdpSocket, String) {
    let socket = UdpSocket::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
    socket.set_read_timeout(Some(LONG)).unwrap();
    let to = format!("udp:{}", socket.local_addr().unwrap());
    (socket, to)
}

/// An unused TCP address.
fn free_address() -> SocketAddr {
    let any = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
    any.local_addr().unwrap()
}

fn connect(address: SocketAddr) -> TcpStream {
    let start = Instant::now();
    loop {
        match TcpStream::connect(address) {
            Ok(client) => return client,
            Err(error) => assert!(start.elapsed() < LONG, "{error}"),
        }
        std::thread::sleep(Duration::from_millis(5));
    }
}

fn datagram(socket: &UdpSocket) -> Vec<u8> {
    let mut buffer = vec![0; 65_536];
    let count = socket.recv(&mut buffer).unwrap();
    buffer.truncate(count);
    buffer
}

/// The line that `solaspect solve` writes for the frame, with camera and frame number in front.
fn expected_line(frame: &SolvedFrame) -> String {
    let sun = frame.sun().unwrap();
    let info = &frame.exposure.frame.info;
    let time = Some(frame.solved.solve_time);
    let record = Record::new("", info.mid_exposure, &sun.solution, sun.offset, time);
    let record = serde_json::to_string(&record).unwrap();
    let (camera, number) = (&frame.station.camera.name, info.number.unwrap());
    format!(
        "{{\"camera\":\"{camera}\",\"frame\":{number},{}\n",
        &record[1..]
    )
}

/// The fields of an NMEA sentence; asserts that its checksum is right.
fn fields(sentence: &str) -> Vec<String> {
    assert!(sentence.len() <= 82, "{sentence}");
    let text = sentence.strip_prefix('$').unwrap();
    let text = text.strip_suffix("\r\n").unwrap();
    let (text, sum) = text.split_once('*').unwrap();
    let expected = text.bytes().fold(0, |sum, byte| sum ^ byte);
    assert_eq!(u8::from_str_radix(sum, 16).unwrap(), expected);
    text.split(',').map(str::to_owned).collect()
}

fn telemetry(space_packet: &[u8]) -> TelemetryPacket {
    let packet = CcsdsPacketReader::new(space_packet, None).unwrap();
    assert_eq!(packet.packet_len(), space_packet.len());
    let kind = packet.apid().value() as u8;
    let payload = packet.packet_data()[9..].to_vec();
    TelemetryPacket::new(kind, id::ASPECT, (0, 0), payload).unwrap()
}

#[test]
fn every_reader_gets_what_the_flight_found_and_the_counts_add_up() {
    let (near, far) = SerialPort::pair().unwrap();
    let mut serial = near;
    let ((lines, to_lines), (packets, to_packets)) = (reader(), reader());
    let address = free_address();
    let rig = fly([
        output(&to_lines, Format::Jsonl),
        output(&format!("tcp-listen:{address}"), Format::Jsonl),
        output(&format!("serial:{}", far.name()), Format::Nmea),
        output(&to_packets, Format::Ccsds),
    ]);
    let client = connect(address);
    client.set_read_timeout(Some(LONG)).unwrap();
    let mut client = BufReader::new(client);
    let mut sentences = String::new();
    let mut fine = 0;
    for number in 0..FRAMES {
        rig.frames.send(sunny(number)).unwrap();
        let frame = rig.solved.recv_timeout(LONG).unwrap();
        let expected = expected_line(&frame);
        assert_eq!(String::from_utf8(datagram(&lines)).unwrap(), expected);
        let mut line = String::new();
        client.read_line(&mut line).unwrap();
        assert_eq!(line, expected);
        let line: serde_json::Value = serde_json::from_str(&line).unwrap();

        let mut buffer = [0; 256];
        while !sentences.ends_with('\n') {
            let count = serial.read(&mut buffer, LONG).unwrap();
            sentences += std::str::from_utf8(&buffer[..count]).unwrap();
        }
        let sentence = fields(&std::mem::take(&mut sentences));
        let utc = line["utc"].as_str().unwrap();
        assert_eq!(sentence[1], utc[11..22].replace(':', ""));
        let quality = ["none", "coarse", "fine"][sentence[2].parse::<usize>().unwrap()];
        assert_eq!(line["quality"], quality);
        let offset = line["offset_deg"].as_object();
        for (field, key) in [(3, "azimuth"), (4, "elevation"), (5, "sigma")] {
            match offset.map(|offset| offset[key].as_f64().unwrap()) {
                Some(value) => {
                    let sent: f64 = sentence[field].parse().unwrap();
                    assert!((sent - value).abs() < 6e-7, "{key}: {sent} of {value}");
                }
                None => assert_eq!(sentence[field], ""),
            }
        }
        fine += u64::from(frame.solved.quality == Quality::Fine && offset.is_some());
    }
    assert!(fine >= FRAMES / 2, "{fine} fine");

    // The line and the space packet have the same housekeeping.
    let packet = telemetry(&datagram(&packets));
    assert!(Housekeeping::decode(&packet).is_some());
    let (mut far, mut parser) = (rig.far, Parser::new(Direction::ToController));
    let (start, mut buffer) = (Instant::now(), [0; 4096]);
    let is_same = |other: &Packet| matches!(other, Packet::Telemetry(other) if other.payload() == packet.payload());
    loop {
        let count = far.read(&mut buffer, LONG).unwrap();
        let heard = parser.feed(&buffer[..count], start.elapsed());
        if heard.iter().any(is_same) {
            break;
        }
        assert!(start.elapsed() < LONG, "no such packet on the line");
    }

    rig.service.stop();
    let tally = rig.service.join().unwrap();
    let [lines, clients, sentences, packets] = &tally.outputs[..] else {
        panic!("{tally}");
    };
    for output in [lines, clients, sentences] {
        assert_eq!((output.sent, output.dropped), (FRAMES, 0), "{tally}");
    }
    assert!(packets.sent >= 1 && packets.dropped == 0, "{tally}");
    assert!(tally.to_string().contains(&format!(
        "\noutput     jsonl to {to_lines}: 6 sent, 0 dropped"
    )));
}

#[test]
fn readers_that_take_nothing_cost_only_counted_messages() {
    const FRAMES: u64 = 60;
    let (_unread, far) = SerialPort::pair().unwrap();
    let [listening, lonely] = [free_address(), free_address()];
    let rig = fly([
        output(&format!("serial:{}", far.name()), Format::Jsonl),
        output("serial:/nowhere/tty", Format::Nmea),
        output(&format!("tcp-listen:{listening}"), Format::Jsonl),
        output(&format!("tcp-listen:{lonely}"), Format::Nmea),
        output("udp:127.0.0.1:9", Format::Jsonl),
    ]);
    let _silent = connect(listening);
    let (mut far, start, mut buffer) = (rig.far, Instant::now(), [0; 4096]);
    let track = order("start_tracking", &[], Computer::One).unwrap();
    ask(&mut far, &track, 1, LONG).unwrap();
    for number in 0..FRAMES {
        rig.frames.send(dark(number)).unwrap();
        rig.solved.recv_timeout(LONG).unwrap();
        while far.read(&mut buffer, Duration::ZERO).unwrap() > 0 {}
    }
    let settled = || {
        let tally = rig.service.tally();
        let mut all = tally.outputs.iter();
        all.all(|output| output.sent + output.dropped == FRAMES)
    };
    while !settled() {
        assert!(start.elapsed() < LONG, "{}", rig.service.tally());
        std::thread::sleep(Duration::from_millis(5));
    }
    rig.service.stop();
    let tally = rig.service.join().unwrap();
    let dropped: Vec<u64> = tally.outputs.iter().map(|output| output.dropped).collect();
    assert!(0 < dropped[0] && dropped[0] < FRAMES, "{tally}");
    assert_eq!(dropped[1..], [FRAMES, 0, FRAMES, 0], "{tally}");
    // Every frame was announced and answered on the line, and nothing counts as lost.
    assert_eq!(tally.counts.announced, FRAMES, "{tally}");
    assert_eq!(tally.counts.errors, FRAMES, "{tally}");
    assert_eq!((tally.lost(), tally.restarts), (0, 0), "{tally}");
}

#[test]
fn outputs_work_where_there_is_no_line() {
    let (packets, to) = reader();
    let demo = instrument::builtin("demo").unwrap();
    let (_frames, given) = unbounded();
    let config = Config {
        outputs: Outputs::from_iter([output(&to, Format::Ccsds)]),
        ..Config::default()
    };
    let flight = Flight {
        config,
        ..Flight::of(vec![FlightCamera::of_plate(demo, Given(given))])
    };
    let service = Service::start(flight).unwrap();
    let counts = [(); 2].map(|()| {
        let packet = datagram(&packets);
        assert!(Housekeeping::decode(&telemetry(&packet)).is_some());
        let read = CcsdsPacketReader::new(&packet, None).unwrap();
        read.psc().seq_count.value()
    });
    assert_eq!(counts, [0, 1]);
    service.stop();
    service.join().unwrap();
}
