//! Random requests and broken packets: nothing panics, and nothing changes.

use super::access::{Access, Secret};
use super::ground::Ground;
use super::history::History;
use super::orders::Orders;
use super::request::{Console, Parts};
use super::shared::Shared;
use super::source::Source;
use super::table::nanoseconds;
use super::view::{Detail, View};
use crate::aspect;
use crate::instrument::builtin;
use crate::link::housekeeping::MarkIds;
use crate::link::picture::SECTION_PIXELS;
use crate::link::{Direction, FrameMarks, Housekeeping, Packet, Parser, TelemetryPacket, id};
use crate::pointing::Target;
use crate::sky::{Ephemeris, OrientationTable};
use axum::body::Body;
use axum::extract::ConnectInfo;
use axum::http::Request;
use jiff::Timestamp;
use rand::seq::IndexedRandom;
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use serde_json::Value;
use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::sync::Arc;
use std::time::Duration;
use tower::ServiceExt;

fn at(second: i64) -> Timestamp {
    Timestamp::from_second(1_379_786_400 + second).unwrap()
}

fn history() -> History {
    let mut history = History::new(Duration::from_secs(3600));
    for second in 0..20 {
        let housekeeping = Housekeeping {
            uptime_s: second,
            ..Housekeeping::default()
        };
        let packet = housekeeping.packet(at(second.into())).unwrap();
        history.take(&Packet::Telemetry(packet), at(second.into()));
    }
    history
}

fn console() -> Console {
    let shared = Shared::new(history(), Orders::default());
    let (outbox, _) = crossbeam_channel::bounded(16);
    let listen = SocketAddr::from((Ipv4Addr::LOCALHOST, 8080));
    Console::new(Parts {
        shared: Arc::new(shared),
        source: Source::Udp(listen),
        access: Access::new(Some(Secret::of("nobody knows this token")), listen, None),
        ground: Ground {
            instrument: builtin("demo").unwrap(),
            settings: aspect::SolverSettings::default(),
            target: Target::default(),
            place: None,
            ephemeris: Ephemeris::new(OrientationTable::built_in()),
            archive: Some("/nonexistent".into()),
        },
        outbox: Some(outbox),
        recording: None,
        training: None,
    })
}

const PATHS: [&str; 23] = [
    "/",
    "/plots",
    "/style.css",
    "/api/flight",
    "/api/now",
    "/api/picture.png",
    "/api/plate.svg",
    "/api/plot.svg",
    "/api/spectrum.svg",
    "/api/table.csv",
    "/api/frames",
    "/api/frame.png",
    "/api/frame.fits",
    "/api/recording",
    "/api/commands",
    "/api/commands/log",
    "/api/commands/compose",
    "/api/commands/arm",
    "/api/commands/send",
    "/api/training",
    "/api/login",
    "/api/logout",
    "/../../etc/passwd",
];
/// Requests as sent by the pages.
const USUAL: [&str; 8] = [
    "/api/now?at=2013-09-21T18:00:10Z",
    "/api/plot.svg?fields=housekeeping.taken,received.azimuth_deg",
    "/api/plot.svg?fields=housekeeping.disk_2&from=2013-09-21T18:00:10Z",
    "/api/table.csv?fields=housekeeping.taken,housekeeping.fine",
    "/api/spectrum.svg?to=2013-09-21T18:00:10Z",
    "/api/picture.png?camera=1&version=3",
    "/api/frames?quality=fine&count=5",
    "/api/frame.png?file=20130921T18/a.fits",
];
const NAMES: [&str; 12] = [
    "at", "from", "to", "fields", "camera", "overlay", "file", "quality", "reason", "before",
    "count", "x",
];
const VALUES: [&str; 16] = [
    "2013-09-21T18:00:10Z",
    "9999-12-31T23:59:59Z",
    "-9999-01-01T00:00:00Z",
    "now",
    "1",
    "255",
    "-1",
    "99999999999999999999",
    "NaN",
    "housekeeping.taken",
    "housekeeping.disk_9",
    "received.azimuth_deg,gyros.roll_deg",
    "..%2f..%2fetc%2fpasswd",
    "%00%ff",
    "",
    "a.b.c",
];
const BODIES: [&str; 8] = [
    "",
    "{}",
    "{\"name\":\"quit\"}",
    "{\"name\":\"set_target\",\"values\":[\"1e999\",\"x\"],\"computer\":9}",
    "{\"armed\":\"guess\",\"confirmed\":true}",
    "{\"token\":\"guess\"}",
    "[[[[[[[[",
    "\u{fffd}\u{0}",
];

fn random_request(random: &mut Xoshiro256PlusPlus) -> Request<Body> {
    let of = |random: &mut Xoshiro256PlusPlus, list: &[&'static str]| *list.choose(random).unwrap();
    let method = of(
        random,
        &[
            "GET", "GET", "GET", "POST", "POST", "PUT", "DELETE", "HEAD", "OPTIONS", "BREW",
        ],
    );
    let pairs: Vec<String> = (0..random.random_range(0..4))
        .map(|_| format!("{}={}", of(random, &NAMES), of(random, &VALUES)))
        .collect();
    let uri = match random.random_bool(0.3) {
        true => of(random, &USUAL).into(),
        false => format!("{}?{}", of(random, &PATHS), pairs.join("&")),
    };
    let mut body = of(random, &BODIES).as_bytes().to_vec();
    if random.random_bool(0.1) {
        body = (0..random.random_range(0..30_000))
            .map(|_| random.random())
            .collect();
    }
    let host = of(
        random,
        &["127.0.0.1:8080", "127.0.0.1:8080", "evil.example", ""],
    );
    let origin = of(
        random,
        &[
            "http://127.0.0.1:8080",
            "http://127.0.0.1:8080",
            "http://evil.example",
        ],
    );
    let kind = of(
        random,
        &["application/json", "application/json", "text/plain"],
    );
    // Many addresses, so that the rate limit of one does not reject all.
    let peer = IpAddr::V4(Ipv4Addr::from(0x0A00_0000 + random.random_range(0..1000)));
    Request::builder()
        .method(method)
        .uri(uri)
        .header("host", host)
        .header("origin", origin)
        .header("content-type", kind)
        .header("cookie", "solaspect_session=guess; =; a")
        .extension(ConnectInfo(SocketAddr::from((peer, 1))))
        .body(Body::from(body))
        .unwrap()
}

#[test]
fn ten_thousand_random_requests_change_nothing_and_none_panics() {
    let console = console();
    let router = super::server::router(console.clone());
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .unwrap();
    let mut random = Xoshiro256PlusPlus::seed_from_u64(28);
    let (mut answered, mut drawn) = (0, 0);
    for _ in 0..10_000 {
        let request = random_request(&mut random);
        let (method, uri) = (request.method().clone(), request.uri().clone());
        let response = runtime.block_on(router.clone().oneshot(request)).unwrap();
        assert_ne!(response.status(), 500, "{method} {uri}");
        answered += usize::from(response.status().is_success());
        drawn += usize::from(response.status().is_success() && uri.path().ends_with(".svg"));
    }
    assert!(
        answered > 500 && drawn > 100,
        "{answered} answered, {drawn} drawn"
    );
    assert_eq!(console.shared().orders().rows().count(), 0);
    let history = console.shared().history();
    assert_eq!(
        (history.line.packets, history.housekeeping.times.len()),
        (20, 20)
    );
}

/// Packets of all types with random payloads, some with a valid checksum.
fn broken_packet(random: &mut Xoshiro256PlusPlus) -> Vec<u8> {
    let kind = *[0x01, 0x03, 0x70, 0x71, 0x72, 0x73, 0x82, 0x83, 0xE1, 0x00]
        .choose(random)
        .unwrap();
    let length = random.random_range(0..=400);
    let mut payload: Vec<u8> = (0..length).map(|_| random.random()).collect();
    if let (0x70, Some(layout)) = (kind, payload.first_mut()) {
        *layout = random.random_range(0..8);
    }
    let time = (random.random(), random.random());
    let packet = TelemetryPacket::new(kind, id::ASPECT, time, payload).unwrap();
    let mut bytes = packet.encode();
    if random.random_bool(0.5) {
        let at = random.random_range(0..bytes.len());
        bytes[at] ^= 1 << random.random_range(0..8);
    }
    bytes
}

#[test]
fn a_thousand_broken_packets_do_no_harm() {
    let mut history = history();
    let mut parser = Parser::new(Direction::ToController);
    let mut random = Xoshiro256PlusPlus::seed_from_u64(29);
    let mut time = Duration::ZERO;
    for _ in 0..1000 {
        time += Duration::from_millis(200);
        for packet in parser.feed(&broken_packet(&mut random), time) {
            history.take(&packet, at(30));
        }
    }
    let pixels: usize = history
        .pictures
        .values()
        .map(|picture| picture.width * picture.height)
        .sum();
    assert!(pixels < 12 * 4096 * 4096);
    const { assert!(SECTION_PIXELS < 400) };
    for (row, time) in history.housekeeping.times.iter().enumerate() {
        history.findings(row);
        assert!(history.housekeeping.at_row(row).is_some(), "{time}");
    }
    assert!(history.housekeeping.times.is_sorted());
    assert!(history.span().is_some());
}

#[test]
fn ids_of_any_plate_are_shown_with_the_housekeeping_of_their_second() {
    let mut history = history();
    let mut take = |second: i64, packet: TelemetryPacket| {
        history.take(&Packet::Telemetry(packet), at(second));
    };
    for (camera, ids) in [
        (3, &[[9999, -9999]][..]),
        (1, &[[101, 0], [102, -7]]),
        (2, &[]),
    ] {
        let marks = FrameMarks::new(camera, 7, ids).unwrap();
        take(19, marks.packet(at(19)).unwrap());
    }
    let housekeeping = Housekeeping {
        uptime_s: 20,
        ids: MarkIds::new([[-7, 7]]),
        ..Housekeeping::default()
    };
    take(20, housekeeping.packet(at(20)).unwrap());
    let shown = |second: i64| {
        let view = View {
            history: &history,
            at: Some(nanoseconds(at(second))),
            now: at(30),
            is_live: false,
        };
        view.housekeeping(Detail::All).unwrap()["fields"]["ids"].clone()
    };
    assert_eq!(shown(18), Value::Null);
    assert_eq!(
        shown(19),
        "camera 1: 101,0 102,-7; camera 2:; camera 3: 9999,-9999"
    );
    assert_eq!(shown(20), "-7,7", "of the plate of 2013");
}

#[test]
fn two_packets_of_another_decade_drop_nothing_and_lose_nothing() {
    let mut history = history();
    let housekeeping = |uptime_s| Housekeeping {
        uptime_s,
        ..Housekeeping::default()
    };
    for second in 20..22 {
        let packet = housekeeping(second).packet(at(i64::from(second) + 315_360_000));
        history.take(&Packet::Telemetry(packet.unwrap()), at(second.into()));
    }
    for second in 22..30 {
        let packet = housekeeping(second).packet(at(second.into())).unwrap();
        history.take(&Packet::Telemetry(packet), at(second.into()));
    }
    assert_eq!(history.housekeeping.times.len(), 28);
    assert_eq!((history.line.missing, history.line.doubtful), (2, 2));
    // More than an hour later the first data are dropped.
    for second in 7200..7202 {
        let packet = housekeeping(second).packet(at(second.into())).unwrap();
        history.take(&Packet::Telemetry(packet), at(second.into()));
    }
    assert_eq!(history.housekeeping.times.len(), 2);
    assert_eq!(history.row(None), Some(1));
}

#[test]
fn forged_keywords_and_reasons_take_no_more_space_than_a_frame_has() {
    use super::pictures::Partial;
    use crate::link::picture::{Tag, TagValue};
    let mut picture = Partial::begun(0, 0);
    let mut history = history();
    for n in 0..40_000 {
        picture.take_tag(Tag {
            name: format!("K{n}"),
            value: TagValue::Whole(1),
            comment: String::new(),
        });
        history.reason(&format!("reason {n}"));
    }
    assert_eq!(picture.tags.len(), 256);
    assert_eq!(picture.tags_lost, 40_000 - 256);
    assert!(history.reasons.len() <= 501);
    assert!(history.reason("reason 50000").is_some());
}
