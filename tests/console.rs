//! The ground console: the data for a browser, the authorisation of commands, and robustness against hostile clients.

use jiff::Timestamp;
use serde_json::{Value, json};
use solaspect::aspect;
use solaspect::console::{ConsoleSettings, Ground, Running, Secret, Source};
use solaspect::demo::{self, Demo, Faults};
use solaspect::instrument::builtin;
use solaspect::link::byte_log::{self, Burst};
use solaspect::link::picture::Picture;
use solaspect::link::{Computer, Connection, Housekeeping, Key, Message, Solution, id};
use solaspect::pointing::Target;
use solaspect::simulate::{Conditions, FORT_SUMNER, RandomScenes};
use solaspect::sky::{Ephemeris, OrientationTable};
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{Ipv4Addr, SocketAddr, TcpStream, UdpSocket};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

const LONG: Duration = Duration::from_secs(30);
const TOKEN: &str = "the token of this test's console";

fn ground(archive: Option<&Path>) -> Ground {
    Ground {
        instrument: builtin("demo").unwrap(),
        settings: aspect::SolverSettings::default(),
        target: Target::default(),
        place: Some(FORT_SUMNER),
        ephemeris: Ephemeris::new(OrientationTable::built_in()),
        archive: archive.map(Path::to_owned),
    }
}

fn settings(source: Source) -> ConsoleSettings {
    ConsoleSettings {
        source,
        line: None,
        gondola: None,
        key: None,
        baud: 115_200,
        relays: Vec::new(),
        recording: None,
        command_log: "/nonexistent/commands.csv".into(),
        keep: Duration::from_secs(48 * 3600),
        ground: ground(None),
        listen: local(0),
        token: None,
        public_origin: None,
        training: None,
    }
}

fn local(port: u16) -> SocketAddr {
    (Ipv4Addr::LOCALHOST, port).into()
}

/// An unused UDP port of this machine.
fn free_port() -> u16 {
    let socket = UdpSocket::bind(local(0)).unwrap();
    socket.local_addr().unwrap().port()
}

/// A console that receives datagrams, and a socket that sends them.
fn over_udp(change: impl FnOnce(&mut ConsoleSettings)) -> (Running, UdpSocket) {
    let port = free_port();
    let mut settings = settings(Source::Udp(local(port)));
    change(&mut settings);
    let console = Running::start(settings).unwrap();
    let socket = UdpSocket::bind(local(0)).unwrap();
    socket.connect(local(port)).unwrap();
    (console, socket)
}

/// An answer: its status and body.
struct Answer {
    status: u16,
    head: String,
    body: Vec<u8>,
}

impl Answer {
    fn json(&self) -> Value {
        let text = String::from_utf8_lossy(&self.body);
        serde_json::from_slice(&self.body).unwrap_or_else(|_| panic!("{}: {text}", self.status))
    }
}

/// Sends a request with given headers and returns the answer.
fn ask(console: SocketAddr, method: &str, path: &str, headers: &str, body: &str) -> Answer {
    let mut stream = TcpStream::connect(console).unwrap();
    stream.set_read_timeout(Some(LONG)).unwrap();
    let length = body.len();
    let request = format!(
        "{method} {path} HTTP/1.1\r\nConnection: close\r\nContent-Length: {length}\r\n{headers}\r\n{body}"
    );
    stream.write_all(request.as_bytes()).unwrap();
    let mut bytes = Vec::new();
    stream.read_to_end(&mut bytes).unwrap();
    let end = bytes
        .windows(4)
        .position(|four| four == b"\r\n\r\n")
        .unwrap();
    let head = String::from_utf8_lossy(&bytes[..end]).into_owned();
    Answer {
        status: head.split(' ').nth(1).unwrap().parse().unwrap(),
        head,
        body: bytes[end + 4..].to_vec(),
    }
}

fn get(console: SocketAddr, path: &str) -> Answer {
    ask(console, "GET", path, &format!("Host: {console}\r\n"), "")
}

/// A request as the console's own page sends it, with a session's cookie.
fn post(console: SocketAddr, path: &str, cookie: &str, body: &Value) -> Answer {
    let headers = format!(
        "Host: {console}\r\nOrigin: http://{console}\r\nContent-Type: application/json\r\nCookie: {cookie}\r\n"
    );
    ask(console, "POST", path, &headers, &body.to_string())
}

/// Logs in and returns the cookie.
fn logged_in(console: SocketAddr) -> String {
    let answer = post(console, "/api/login", "", &json!({"token": TOKEN}));
    assert_eq!(answer.status, 204);
    let cookie = answer
        .head
        .lines()
        .find_map(|line| line.strip_prefix("set-cookie: "));
    cookie.unwrap().split(';').next().unwrap().into()
}

/// Polls a path until its answer is as wanted.
fn wait_for(console: SocketAddr, path: &str, mut is_wanted: impl FnMut(&Value) -> bool) -> Value {
    let start = Instant::now();
    loop {
        let answer = get(console, path).json();
        if is_wanted(&answer) {
            return answer;
        }
        assert!(start.elapsed() < LONG, "{path}: {answer}");
        std::thread::sleep(Duration::from_millis(20));
    }
}

/// Events of the live stream as they come.
struct Stream(BufReader<TcpStream>);

impl Stream {
    fn open(console: SocketAddr, query: &str) -> Self {
        let mut stream = TcpStream::connect(console).unwrap();
        stream.set_read_timeout(Some(LONG)).unwrap();
        write!(
            stream,
            "GET /api/live{query} HTTP/1.1\r\nHost: {console}\r\n\r\n"
        )
        .unwrap();
        Self(BufReader::new(stream))
    }

    /// The kinds of events up to and including the next one of kind `last`.
    fn kinds_until(&mut self, last: &str) -> Vec<String> {
        let mut kinds = Vec::new();
        while kinds.last().is_none_or(|kind| kind != last) {
            let mut line = String::new();
            assert!(self.0.read_line(&mut line).unwrap() > 0);
            kinds.extend(line.strip_prefix("event: ").map(|kind| kind.trim().into()));
        }
        kinds
    }

    /// The next event of a kind.
    fn next(&mut self, kind: &str) -> Value {
        let mut is_it = false;
        loop {
            let mut line = String::new();
            assert!(
                self.0.read_line(&mut line).unwrap() > 0,
                "the stream has ended"
            );
            if let Some(event) = line.strip_prefix("event: ") {
                is_it = event.trim() == kind;
            }
            if let Some(data) = line.strip_prefix("data: ").filter(|_| is_it) {
                return serde_json::from_str(data).unwrap();
            }
        }
    }
}

fn at(second: i64) -> Timestamp {
    Timestamp::from_second(1_379_786_400 + second).unwrap()
}

fn housekeeping_of(second: u32) -> Housekeeping {
    Housekeeping {
        computer: 1,
        tracking: true,
        sending: true,
        storing: true,
        uptime_s: second,
        taken: 4 * second,
        fine: 4 * second,
        plate_x_mil: Some(100.0),
        plate_y_mil: Some(-200.0),
        plate_sigma_mil: Some(0.05),
        ..Housekeeping::default()
    }
}

fn housekeeping(second: u32) -> Vec<u8> {
    housekeeping_of(second)
        .packet(at(second.into()))
        .unwrap()
        .encode()
}

fn solution(second: i64, azimuth_deg: f64) -> Vec<u8> {
    let solution = Solution {
        azimuth_deg,
        elevation_deg: -0.5,
        roll_deg: 0.25,
        error_deg: 1e-5,
        time: at(second),
    };
    let message = Message::Solution(solution);
    message
        .packet(id::CONTROLLER, second as u16)
        .unwrap()
        .encode()
}

#[test]
fn what_arrives_is_shown_in_its_own_numbers_and_lost_doubled_and_late_packets_are_counted() {
    let (console, gondola) = over_udp(|_| {});
    let address = console.address();
    for second in [1, 2, 2, 5, 4, 6] {
        gondola.send(&housekeeping(second)).unwrap();
    }
    gondola.send(&solution(6, 0.125)).unwrap();
    gondola.send(b"no packet at all").unwrap();
    let now = wait_for(address, "/api/now", |now| {
        now["solution"]["azimuth_deg"] == 0.125
    });
    let fields = &now["housekeeping"]["fields"];
    assert_eq!(
        (&fields["uptime_s"], &fields["taken"]),
        (&json!(6.0), &json!(24.0))
    );
    assert_eq!(
        (&fields["residual_px"], &fields["stopped_pointing"]),
        (&Value::Null, &json!(0.0))
    );
    assert_eq!(
        now["solution"]["sigma_arcsec"]
            .as_f64()
            .map(|s| (s * 1e5).round()),
        Some(3600.0)
    );
    let line = &now["state"]["line"];
    let counts = ["doubled", "late", "missing"].map(|name| line[name].as_u64());
    assert_eq!(counts, [Some(1), Some(1), Some(1)], "{line}");
    let earlier = get(address, "/api/now?at=2013-09-21T18:00:05Z").json();
    assert_eq!(earlier["housekeeping"]["fields"]["uptime_s"], 5.0);
    console.end();
}

#[test]
fn the_state_says_in_words_what_is_wrong_and_since_when_and_its_alarm_outlasts_it() {
    let (console, gondola) = over_udp(|_| {});
    let address = console.address();
    let lost = |second: u32, lost: u32| {
        let packet = Housekeeping {
            lost,
            ..housekeeping_of(second)
        }
        .packet(at(second.into()));
        gondola.send(&packet.unwrap().encode()).unwrap();
    };
    (0..3).for_each(|second| lost(second, 0));
    (3..70).for_each(|second| lost(second, 2));
    let state = wait_for(address, "/api/now", |now| {
        now["housekeeping"]["fields"]["uptime_s"] == 69.0
    });
    assert_eq!(state["state"]["severity"], "good", "{}", state["state"]);
    let at = get(address, "/api/now?at=2013-09-21T18:00:30Z").json();
    let sentence = &at["state"]["sentences"][0];
    assert_eq!(
        sentence["words"],
        "2 frames lost by camera or solver in the last minute, 2 since the start"
    );
    assert_eq!(sentence["since"], "2013-09-21T18:00:03.000Z");
    let alarm = &state["state"]["alarms"][0];
    assert_eq!(
        (&alarm["rule"], &alarm["until"]),
        (&json!("lost"), &json!("2013-09-21T18:01:03.000Z"))
    );
    assert_eq!(
        at["state"]["alarms"][0]["until"],
        Value::Null,
        "it lasted then"
    );
    let silent = get(address, "/api/now?at=2013-09-21T18:02:09Z").json();
    assert_eq!(
        silent["state"]["sentences"][0]["words"],
        "no housekeeping for 60 s"
    );
    console.end();
}

#[test]
fn the_state_is_sent_each_second_also_where_all_but_the_housekeeping_comes() {
    let (console, gondola) = over_udp(|_| {});
    let mut viewer = Stream::open(console.address(), "");
    viewer.next("state");
    for n in 0..60 {
        gondola.send(&solution(n, 0.1)).unwrap();
        std::thread::sleep(Duration::from_millis(50));
    }
    gondola.send(&housekeeping(60)).unwrap();
    let kinds = viewer.kinds_until("housekeeping");
    let states = kinds.iter().filter(|kind| *kind == "state").count();
    // One state comes with the housekeeping, and at least two in the three seconds before.
    assert!(states >= 3, "{kinds:?}");
    console.end();
}

#[test]
fn a_picture_is_shown_as_it_arrives_and_solved_when_it_is_whole() {
    let (console, gondola) = over_udp(|_| {});
    let address = console.address();
    let instrument = builtin("demo").unwrap();
    let scenes = RandomScenes::new(&instrument, &Conditions::of(&instrument), 3).unwrap();
    let frame = scenes.scene(1).unwrap().frame().unwrap();
    let picture = Picture::new(&frame, 1, Vec::new(), at(0)).unwrap().unwrap();
    let received = |count: usize| move |now: &Value| now["pictures"][0]["received"] == count;
    // A datagram that does not fit into the queue is lost, so each 100 datagrams wait until the console has received them.
    let send = |parts: std::ops::Range<usize>| {
        for part in parts {
            gondola.send(&picture.part(part).unwrap().encode()).unwrap();
            if part % 100 == 99 {
                wait_for(address, "/api/now", received(100 * (part + 1)));
            }
        }
    };
    let half = picture.parts() / 2;
    send(0..half);
    wait_for(address, "/api/now", received(100 * half));
    let image = get(address, "/api/picture.png?camera=1");
    assert_eq!(image.status, 200);
    let shown = image::load_from_memory(&image.body).unwrap().into_rgb8();
    assert_ne!(
        shown.get_pixel(0, 965)[0],
        shown.get_pixel(0, 965)[2],
        "a hatch of blue"
    );
    assert_eq!(
        get(address, "/api/picture.png?camera=1&overlay=1").status,
        409
    );
    send(half..picture.parts());
    wait_for(address, "/api/now", received(1296 * 966));
    let overlay = get(address, "/api/picture.png?camera=1&overlay=1");
    assert_eq!(overlay.status, 200);
    assert!(image::load_from_memory(&overlay.body).unwrap().height() > 400);
    console.end();
}

#[test]
fn a_console_without_a_token_shows_and_does_nothing_else() {
    let refused = Running::start(ConsoleSettings {
        listen: (Ipv4Addr::UNSPECIFIED, 0).into(),
        ..settings(Source::Udp(local(free_port())))
    });
    let error = refused.err().unwrap().to_string();
    assert!(
        error.contains("--listen 0.0.0.0:0") && error.contains("--token-file"),
        "{error}"
    );
    let (console, _gondola) = over_udp(|_| {});
    let address = console.address();
    let no_op = json!({"name": "no_op"});
    let composed = post(address, "/api/commands/compose", "", &no_op);
    assert_eq!(
        (composed.status, composed.json()["changes_flight"].as_bool()),
        (200, Some(false))
    );
    assert_eq!(post(address, "/api/commands/arm", "", &no_op).status, 403);
    assert_eq!(
        post(address, "/api/login", "", &json!({"token": TOKEN})).status,
        401
    );
    let page = get(address, "/");
    assert!(
        page.head
            .contains("content-security-policy: default-src 'none'; script-src 'self'")
    );
    console.end();
}

#[test]
fn another_sites_page_can_neither_read_nor_command() {
    let folder = tempfile::tempdir().unwrap();
    let (console, _gondola) = over_udp(|settings| {
        settings.token = Some(Secret::of(TOKEN));
        settings.gondola = Some(local(9));
        settings.command_log = folder.path().join("log.csv");
    });
    let address = console.address();
    let cookie = logged_in(address);
    let body = json!({"name": "quit"}).to_string();
    let json_type = "Content-Type: application/json\r\n";
    let own = format!("Host: {address}\r\nCookie: {cookie}\r\n{json_type}");
    let origin = |origin: &str| format!("{own}Origin: {origin}\r\n");
    let arm = |headers: &str| ask(address, "POST", "/api/commands/arm", headers, &body).status;
    assert_eq!(arm(&own), 403, "without an origin");
    assert_eq!(arm(&origin("http://evil.example")), 403);
    assert_eq!(arm(&origin(&format!("http://{address}"))), 200);
    let simple = origin(&format!("http://{address}")).replace("application/json", "text/plain");
    assert_eq!(arm(&simple), 415, "a form of another site cannot send JSON");
    let rebound = format!("Host: evil.example\r\nCookie: {cookie}\r\n");
    assert_eq!(ask(address, "GET", "/api/now", &rebound, "").status, 421);
    let large = json!({"token": "x".repeat(20_000)});
    assert_eq!(post(address, "/api/login", "", &large).status, 413);
    console.end();
}

#[test]
fn behind_a_proxy_even_viewing_needs_a_login_and_the_cookie_is_for_tls_alone() {
    let (console, _gondola) = over_udp(|settings| {
        settings.token = Some(Secret::of(TOKEN));
        settings.public_origin = Some("HTTPS://Console.Example.org:443/".parse().unwrap());
    });
    let address = console.address();
    let host = "Host: console.example.org\r\n";
    assert_eq!(ask(address, "GET", "/api/now", host, "").status, 401);
    let flight = ask(address, "GET", "/api/flight", host, "").json();
    assert_eq!(
        (&flight["needs_login"], &flight["source"]),
        (&json!(true), &Value::Null)
    );
    let headers =
        format!("{host}Origin: https://console.example.org\r\nContent-Type: application/json\r\n");
    let login = json!({"token": TOKEN}).to_string();
    let answer = ask(address, "POST", "/api/login", &headers, &login);
    assert_eq!(answer.status, 204);
    let cookie = answer
        .head
        .lines()
        .find_map(|line| line.strip_prefix("set-cookie: "))
        .unwrap();
    for word in ["HttpOnly", "SameSite=Strict", "Secure"] {
        assert!(cookie.contains(word), "{cookie}");
    }
    let with = format!("{host}Cookie: {}\r\n", cookie.split(';').next().unwrap());
    assert_eq!(ask(address, "GET", "/api/now", &with, "").status, 200);
    console.end();
}

/// A flight program that is killed at the end of the test.
struct Fly(Child);

impl Drop for Fly {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// Sends a command, confirmed where it changes the flight, and waits for its row in the log with the result.
fn sent(console: SocketAddr, cookie: &str, name: &str, values: &[&str]) -> Value {
    let command = json!({"name": name, "values": values});
    let armed = post(console, "/api/commands/arm", cookie, &command).json();
    assert!(armed["words"].as_str().unwrap().contains(name), "{armed}");
    let release = |confirmed: bool| {
        let release = json!({"armed": armed["armed"], "confirmed": confirmed});
        post(console, "/api/commands/send", cookie, &release)
    };
    if armed["changes_flight"] == true {
        assert_eq!(release(false).status, 409, "{name} is asked twice");
    }
    let number = release(true).json()["number"].clone();
    assert_eq!(release(true).status, 409, "a command is sent once");
    let of = |log: &Value| {
        let rows = log["rows"].as_array().unwrap();
        rows.iter().find(|row| row["number"] == number).cloned()
    };
    let log = wait_for(console, "/api/commands/log", |log| {
        of(log).is_some_and(|row| !row["good"].is_null())
    });
    of(&log).unwrap()
}

#[test]
fn a_command_reaches_the_flight_program_is_acknowledged_and_what_changes_the_flight_is_asked_twice()
{
    let folder = tempfile::tempdir().unwrap();
    let log = folder.path().join("log.csv");
    let gondola = free_port();
    let port = free_port();
    let console = Running::start(ConsoleSettings {
        gondola: Some(local(gondola)),
        token: Some(Secret::of(TOKEN)),
        command_log: log.clone(),
        ..settings(Source::Udp(local(port)))
    });
    let console = console.unwrap();
    let address = console.address();
    let line = format!("udp:127.0.0.1:{port}@{gondola}");
    let fly = Command::new(env!("CARGO_BIN_EXE_solaspect"))
        .args([
            "fly",
            "--camera",
            "simulated",
            "--serial",
            &line,
            "--archive",
        ])
        .arg(folder.path().join("flight"))
        .stderr(Stdio::null())
        .stdout(Stdio::null())
        .spawn();
    let _fly = Fly(fly.unwrap());
    wait_for(address, "/api/now", |now| {
        now["housekeeping"]["fields"]["simulated"] == 1.0
    });
    let cookie = logged_in(address);
    let send = |name: &str, values: &[&str]| sent(address, &cookie, name, values);
    let row = send("set_target", &["-300", "450"]);
    assert_eq!(
        (&row["result"], &row["good"]),
        (&json!("done"), &json!(true))
    );
    assert!(row["received"].is_string() && row["answered"].is_string());
    assert_eq!(send("get_target_x", &[])["result"], "x -300 arcsec");
    let table = get(address, "/api/commands").json();
    let commands = table["commands"].as_array().unwrap();
    let target = commands
        .iter()
        .find(|row| row["name"] == "set_target")
        .unwrap();
    assert_eq!(target["variables"][0]["present"]["value"], -300.0);
    assert_eq!(
        send("set_clocking", &["1000"])["good"],
        false,
        "beyond its range"
    );
    let kept = std::fs::read_to_string(log).unwrap();
    assert_eq!(kept.lines().count(), 1 + 2 * 3, "{kept}");
    assert!(!kept.contains(TOKEN));
    console.end();
}

#[test]
fn fifty_viewers_see_all_and_one_that_stalls_harms_nobody() {
    let (console, gondola) = over_udp(|_| {});
    let address = console.address();
    gondola.send(&housekeeping(1)).unwrap();
    let stalled: Vec<Stream> = (0..5).map(|_| Stream::open(address, "")).collect();
    let mut viewers: Vec<Stream> = (0..50).map(|_| Stream::open(address, "")).collect();
    for viewer in &mut viewers {
        assert_eq!(viewer.next("housekeeping")["fields"]["uptime_s"], 1.0);
    }
    for second in 2..12 {
        gondola.send(&housekeeping(second)).unwrap();
        for viewer in &mut viewers {
            while viewer.next("housekeeping")["fields"]["uptime_s"] != f64::from(second) {}
        }
    }
    assert_eq!(get(address, "/api/now").json()["state"]["viewers"], 55);
    drop((stalled, viewers));
    wait_for(address, "/api/now", |now| now["state"]["viewers"] == 0);
    console.end();
}

#[test]
fn a_viewer_on_a_slow_line_gets_what_fits_it_and_learns_what_is_left_out() {
    let (console, gondola) = over_udp(|_| {});
    let mut viewer = Stream::open(console.address(), "?bits_per_s=6000");
    let start = Instant::now();
    let mut second = 0;
    let mut report = None;
    while report.is_none() {
        assert!(start.elapsed() < LONG);
        second += 1;
        gondola.send(&housekeeping(second)).unwrap();
        gondola.send(&solution(second.into(), 0.1)).unwrap();
        std::thread::sleep(Duration::from_millis(50));
        if start.elapsed() > Duration::from_secs(12) {
            report = Some(viewer.next("left_out"));
        }
    }
    let read = start.elapsed().as_secs_f64();
    assert!(report.unwrap()["updates"].as_u64().unwrap() > 100);
    // The rest of the received bytes counts, too: all of it must fit the line.
    viewer
        .0
        .get_ref()
        .set_read_timeout(Some(Duration::from_millis(200)))
        .unwrap();
    let mut rest = Vec::new();
    let _ = viewer.0.read_to_end(&mut rest);
    assert!(
        (rest.len() as f64) < 750.0 * (read + 2.0),
        "{} bytes in {read} s",
        rest.len()
    );
    console.end();
}

fn flown(folder: &Path, seconds: u64) {
    let demo = Demo::lasting(Duration::from_secs(seconds), folder, 3);
    demo::run(&demo, &mut None, |_| {}, || false).unwrap();
}

#[test]
fn an_archive_is_shown_with_its_frames_and_replayed_at_any_speed() {
    let folder = tempfile::tempdir().unwrap();
    flown(folder.path(), 6);
    let console = Running::start(ConsoleSettings {
        ground: ground(Some(folder.path())),
        ..settings(Source::Archive(folder.path().into()))
    });
    let console = console.unwrap();
    let address = console.address();
    let frames = wait_for(address, "/api/frames?count=500", |frames| {
        frames["total"].as_u64() > Some(30)
    });
    let file = frames["frames"]
        .as_array()
        .unwrap()
        .iter()
        .find(|row| row["quality"] == "fine")
        .unwrap();
    let (name, utc) = (
        file["file"].as_str().unwrap(),
        file["utc"].as_str().unwrap(),
    );
    let fits = get(address, &format!("/api/frame.fits?file={name}"));
    assert_eq!(
        (fits.status, fits.body),
        (200, std::fs::read(folder.path().join(name)).unwrap())
    );
    assert_eq!(
        get(address, &format!("/api/frame.png?file={name}&overlay=1")).status,
        200
    );
    for escaping in ["../secret.fits", "/etc/passwd", ""] {
        assert_eq!(
            get(address, &format!("/api/frame.fits?file={escaping}")).status,
            404
        );
    }
    let now = get(address, &format!("/api/now?at={utc}")).json();
    assert_eq!(
        (&now["solution"]["quality"], &now["pictures"][0]["file"]),
        (&json!("fine"), &json!(name))
    );
    assert_eq!(
        get(address, &format!("/api/plate.svg?at={utc}")).status,
        200
    );
    let plot = get(
        address,
        "/api/plot.svg?fields=solutions.sun_x_px,housekeeping.taken",
    );
    let svg = String::from_utf8(plot.body).unwrap();
    assert!(svg.contains("data-from=\"2013-09-21T18:00:0") && svg.contains("sun_x_px"));
    let csv = get(address, "/api/table.csv?fields=solutions.sun_x_px");
    assert!(
        String::from_utf8(csv.body)
            .unwrap()
            .starts_with("utc,sun_x_px [px]\n2013-09-21T18:00:0")
    );
    let mut replay = Stream::open(address, "?at=2013-09-21T18:00:01Z&speed=20");
    let first = replay.next("state");
    assert_eq!(first["view"], "2013-09-21T18:00:01.000Z");
    replay.next("end");
    console.end();
}

#[test]
fn what_was_received_is_recorded_relayed_and_replayed_as_it_was() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("flight.log");
    let far_port = free_port();
    let far = Running::start(settings(Source::Udp(local(far_port)))).unwrap();
    let (console, gondola) = over_udp(|settings| {
        settings.recording = Some(path.clone());
        settings.relays = vec![local(far_port)];
    });
    (1..5).for_each(|second| _ = gondola.send(&housekeeping(second)).unwrap());
    let last = |now: &Value| now["housekeeping"]["fields"]["uptime_s"] == 4.0;
    let shown = wait_for(console.address(), "/api/now", last);
    let passed_on = wait_for(far.address(), "/api/now", last);
    assert_eq!(
        passed_on["housekeeping"]["fields"],
        shown["housekeeping"]["fields"]
    );
    let download = get(console.address(), "/api/recording");
    assert_eq!(download.body, std::fs::read(&path).unwrap());
    console.end();
    far.end();
    let replayed = Running::start(settings(Source::Record(path.clone()))).unwrap();
    let again = wait_for(replayed.address(), "/api/now", last);
    assert_eq!(
        again["housekeeping"]["fields"],
        shown["housekeeping"]["fields"]
    );
    replayed.end();
    std::fs::write(&path, "no recording\n").unwrap();
    let error = Running::start(settings(Source::Record(path.clone())))
        .err()
        .unwrap();
    let error = format!("{error:#}");
    assert!(
        error.contains("flight.log") && error.contains("expected a byte log"),
        "{error}"
    );
}

#[test]
fn consoles_that_relay_in_a_ring_pass_each_datagram_on_once() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("flight.log");
    let far_port = free_port();
    let port = free_port();
    let near = Running::start(ConsoleSettings {
        recording: Some(path.clone()),
        relays: vec![local(far_port)],
        ..settings(Source::Udp(local(port)))
    });
    let far = Running::start(ConsoleSettings {
        relays: vec![local(port)],
        ..settings(Source::Udp(local(far_port)))
    });
    let (near, far) = (near.unwrap(), far.unwrap());
    let gondola = UdpSocket::bind(local(0)).unwrap();
    // The second datagram is sent after the first could have looped many times.
    for second in 1..3 {
        gondola.send_to(&housekeeping(second), local(port)).unwrap();
        let back = |now: &Value| now["state"]["line"]["doubled"].as_u64() >= Some(second.into());
        wait_for(near.address(), "/api/now", back);
        std::thread::sleep(Duration::from_millis(50));
    }
    let recorded = std::fs::read_to_string(&path).unwrap();
    assert_eq!(
        recorded.lines().count(),
        1 + 2 * 2,
        "as sent, and as it came back"
    );
    near.end();
    far.end();
}

#[test]
fn a_command_is_signed_for_the_computer_that_it_is_composed_for() {
    let folder = tempfile::tempdir().unwrap();
    let gondola = UdpSocket::bind(local(0)).unwrap();
    gondola.set_read_timeout(Some(LONG)).unwrap();
    let key = Key::new(b"sixteen bytes or more").unwrap();
    let (console, _) = over_udp(|settings| {
        settings.gondola = Some(gondola.local_addr().unwrap());
        settings.token = Some(Secret::of(TOKEN));
        settings.key = Some(key.clone());
        settings.command_log = folder.path().join("log.csv");
    });
    let address = console.address();
    let cookie = logged_in(address);
    for (number, to, other) in [
        (1, Computer::One, Computer::Two),
        (2, Computer::Two, Computer::One),
    ] {
        let command = json!({"name": "start_tracking", "values": [], "computer": number});
        let armed = post(address, "/api/commands/arm", &cookie, &command).json();
        let release = json!({"armed": armed["armed"], "confirmed": true});
        let sent = post(address, "/api/commands/send", &cookie, &release);
        assert_eq!(sent.json()["computer"], number);
        let mut datagram = [0; 512];
        let (length, _) = gondola.recv_from(&mut datagram).unwrap();
        let datagram = &datagram[..length];
        assert!(key.towards(to).verified(datagram).is_some());
        assert!(key.towards(other).verified(datagram).is_none());
    }
    console.end();
}

/// A console program, and its address.
fn console_program(
    program: &str,
    source: &str,
    change: impl FnOnce(&mut Command),
) -> (Fly, SocketAddr) {
    let mut command = Command::new(program);
    command.args(["console", "--listen", "127.0.0.1:0", source]);
    command.stdout(Stdio::piped());
    change(&mut command);
    let mut console = Fly(command.spawn().unwrap());
    let mut line = String::new();
    let mut said = BufReader::new(console.0.stdout.take().unwrap());
    said.read_line(&mut line).unwrap();
    console.0.stdout = Some(said.into_inner());
    let address = line.trim().trim_end_matches('/').rsplit('/').next();
    (console, address.unwrap().parse().unwrap())
}

#[test]
fn only_the_demo_has_faults_and_only_who_may_command_puts_them_on() {
    let press = json!({"fault": "line_cut", "on": true});
    let demo = |token: Option<Secret>, folder: &Path| {
        let settings = ConsoleSettings {
            line: Some(Connection::none()),
            training: Some(Faults::default()),
            command_log: folder.join("log.csv"),
            token,
            ..settings(Source::Demo)
        };
        Running::start(settings).unwrap()
    };
    let folder = tempfile::tempdir().unwrap();
    let viewed = demo(None, folder.path());
    let console = viewed.address();
    assert_eq!(post(console, "/api/training", "", &press).status, 403);
    viewed.end();
    let commanded = demo(Some(Secret::of(TOKEN)), folder.path());
    let console = commanded.address();
    assert_eq!(post(console, "/api/training", "", &press).status, 401);
    let cookie = logged_in(console);
    let unknown = json!({"fault": "balloon", "on": true});
    assert_eq!(
        post(console, "/api/training", &cookie, &unknown).status,
        400
    );
    let foreign = format!(
        "Host: {console}\r\nOrigin: http://evil.example\r\nContent-Type: application/json\r\nCookie: {cookie}\r\n"
    );
    let foreign = ask(
        console,
        "POST",
        "/api/training",
        &foreign,
        &press.to_string(),
    );
    assert_eq!(foreign.status, 403);
    let panel = post(console, "/api/training", &cookie, &press).json();
    let on = |panel: &Value| {
        panel
            .as_array()
            .unwrap()
            .iter()
            .filter(|one| one["on"] == true)
            .count()
    };
    assert_eq!(on(&panel), 1);
    let found = Stream::open(console, "").next("training");
    assert_eq!(found, panel, "every viewer gets it");
    commanded.end();
    let (real, _gondola) = over_udp(|settings| {
        settings.token = Some(Secret::of(TOKEN));
        settings.gondola = Some(local(9));
        settings.command_log = folder.path().join("log.csv");
    });
    let cookie = logged_in(real.address());
    assert_eq!(
        post(real.address(), "/api/training", &cookie, &press).status,
        404
    );
    real.end();
}

#[test]
fn the_demo_is_commanded_and_each_of_its_faults_is_shown_and_ends() {
    let folder = tempfile::tempdir().unwrap();
    let token = folder.path().join("token");
    std::fs::write(&token, TOKEN).unwrap();
    let (mut demo, console) = console_program(env!("CARGO_BIN_EXE_solaspect"), "demo", |command| {
        command.arg("--token-file").arg(&token);
        command.current_dir(folder.path()).stderr(Stdio::null());
    });
    let panel = Stream::open(console, "").next("training");
    let cookie = logged_in(console);
    wait_for(console, "/api/now", |now| {
        now["housekeeping"]["fields"]["fine"].as_f64() > Some(0.0)
    });
    assert_eq!(
        sent(console, &cookie, "set_target", &["-300", "450"])["result"],
        "done"
    );
    let press = |fault: &str, on: bool| {
        let press = json!({"fault": fault, "on": on});
        assert_eq!(post(console, "/api/training", &cookie, &press).status, 200);
    };
    let rules_of = |fault: &str| -> Vec<String> {
        let one = panel
            .as_array()
            .unwrap()
            .iter()
            .find(|one| one["fault"] == fault);
        serde_json::from_value(one.unwrap()["rules"].clone()).unwrap()
    };
    let finds = |now: &Value, rule: &String| {
        let sentences = now["state"]["sentences"].as_array().unwrap();
        sentences.iter().any(|one| one["rule"] == **rule)
    };
    let shown = |fault: &str| {
        let rules = rules_of(fault);
        wait_for(console, "/api/now", |now| {
            rules.iter().all(|rule| finds(now, rule))
        });
    };
    press("camera_dead", true);
    press("disk_full", true);
    shown("camera_dead");
    shown("disk_full");
    press("camera_dead", false);
    press("disk_full", false);
    // Counts of the last minute fall to zero only a minute later; here it is enough that they no longer grow.
    let counts = |now: &Value| {
        let fields = &now["housekeeping"]["fields"];
        let of = |name: &str| fields[name].as_f64().unwrap();
        ([of("silent_s"), of("unstored")], [of("fine"), of("stored")])
    };
    let mut before = counts(&get(console, "/api/now").json());
    wait_for(console, "/api/now", |now| {
        let after = counts(now);
        let is_over = after.0 == before.0 && after.1[0] > before.1[0] && after.1[1] > before.1[1];
        if after.0 != before.0 {
            before = after;
        }
        is_over && !finds(now, &"disks_full".into())
    });
    press("line_cut", true);
    shown("line_cut");
    press("line_cut", false);
    wait_for(console, "/api/now", |now| !finds(now, &"silence".into()));
    assert_eq!(
        sent(console, &cookie, "get_target_x", &[])["result"],
        "x -300 arcsec"
    );
    let ended = Command::new("kill")
        .args(["-INT", &demo.0.id().to_string()])
        .status();
    assert!(ended.unwrap().success());
    let mut summary = String::new();
    demo.0
        .stdout
        .take()
        .unwrap()
        .read_to_string(&mut summary)
        .unwrap();
    assert!(demo.0.wait().unwrap().success());
    let cost = summary
        .lines()
        .find(|line| line.starts_with("training"))
        .unwrap();
    assert!(!cost.contains(" 0 "), "{cost}");
    assert!(!summary.contains("nothing was lost"), "{summary}");
}

/// Resident memory of a process, bytes.
fn resident(process: &Child) -> u64 {
    let status = std::fs::read_to_string(format!("/proc/{}/status", process.id())).unwrap();
    let line = status
        .lines()
        .find(|line| line.starts_with("VmRSS:"))
        .unwrap();
    1024 * line
        .split_whitespace()
        .nth(1)
        .unwrap()
        .parse::<u64>()
        .unwrap()
}

/// Writes a recording of `hours` with housekeeping at 1 Hz and solutions at 4 Hz.
fn record_hours(path: &Path, hours: u32) {
    let mut file = std::io::BufWriter::new(std::fs::File::create(path).unwrap());
    writeln!(file, "{}", byte_log::HEADER).unwrap();
    for second in 0..3600 * hours {
        let solutions =
            (0..4).flat_map(|_| solution(second.into(), (f64::from(second) / 600.0).sin() / 100.0));
        let bytes = housekeeping(second).into_iter().chain(solutions).collect();
        let time = at(second.into());
        writeln!(file, "{}", Burst { time, bytes }).unwrap();
    }
}

/// Prints memory and times for a day of flight and checks them against the stated limits; `SOLASPECT_PROGRAM` names the release
/// program. The documentation of the console has the numbers.
#[test]
#[ignore = "measures memory and time"]
fn a_day_of_a_flight_fits_150_mb_and_is_drawn_within_150_ms() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("day.log");
    record_hours(&path, 24);
    let program =
        std::env::var("SOLASPECT_PROGRAM").unwrap_or(env!("CARGO_BIN_EXE_solaspect").into());
    let source = format!("record:{}", path.display());
    let (console, address) = console_program(&program, &source, |_| {});
    wait_for(address, "/api/now", |now| {
        now["housekeeping"]["fields"]["uptime_s"] == 86_399.0
    });
    let memory = resident(&console.0);
    println!(
        "24 hours of housekeeping and 345,600 solutions: {:.0} MB",
        memory as f64 / 1e6
    );
    for fields in ["received.azimuth_deg", "housekeeping.taken"] {
        let mut times: Vec<f64> = (0..10)
            .map(|_| {
                let start = Instant::now();
                let plot = get(address, &format!("/api/plot.svg?fields={fields}"));
                assert!(
                    plot.status == 200 && plot.body.len() < 300_000,
                    "{}",
                    plot.body.len()
                );
                1e3 * start.elapsed().as_secs_f64()
            })
            .collect();
        times.sort_by(f64::total_cmp);
        println!(
            "{fields} of 24 hours: {:.0} ms, at most {:.0} ms",
            times[5], times[9]
        );
        assert!(times[5] < 150.0, "{times:?}");
    }
    assert!(memory < 150_000_000);
}
