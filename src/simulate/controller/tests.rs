use super::*;
use crate::link::{CommandOutcome, NoSolution, Receipt};

/// A port whose other end sends given bytes and keeps what it receives.
#[derive(Default)]
struct Script {
    to_say: VecDeque<Vec<u8>>,
    heard: Vec<Vec<u8>>,
}

impl BytePort for Script {
    fn read(&mut self, buffer: &mut [u8], _: Duration) -> Result<usize, PortError> {
        let bytes = self.to_say.pop_front().unwrap_or_default();
        buffer[..bytes.len()].copy_from_slice(&bytes);
        Ok(bytes.len())
    }

    fn write(&mut self, bytes: &[u8], _: Duration) -> Result<(), PortError> {
        self.heard.push(bytes.to_vec());
        Ok(())
    }
}

fn time(millisecond: i64) -> Timestamp {
    Timestamp::from_millisecond(1_379_786_400_000 + millisecond).unwrap()
}

fn announcement(millisecond: i64) -> Message {
    let time = time(millisecond);
    Message::ExposureStart(ExposureStart { camera: 1, time })
}

fn solution(millisecond: i64) -> Message {
    Message::Solution(Solution {
        azimuth_deg: 0.1,
        elevation_deg: 0.2,
        roll_deg: 0.0,
        error_deg: 1e-5,
        time: time(millisecond),
    })
}

/// The report after these messages in this order, numbered from 1.
fn report_of(messages: &[Message]) -> Report {
    let numbered = (1..).zip(messages);
    report_of_packets(numbered.map(|(n, m)| m.packet(id::CONTROLLER, n).unwrap().encode()))
}

fn report_of_packets(packets: impl Iterator<Item = Vec<u8>>) -> Report {
    let mut port = Script {
        to_say: packets.collect(),
        ..Script::default()
    };
    let mut controller = Controller::new();
    while !port.to_say.is_empty() {
        controller.poll(&mut port, Duration::ZERO).unwrap();
    }
    controller.report().clone()
}

#[test]
fn all_messages_of_a_packet_are_taken() {
    let payload = [Message::TrackingOn, announcement(0), solution(0)]
        .iter()
        .flat_map(|message| {
            message
                .packet(id::CONTROLLER, 1)
                .unwrap()
                .payload()
                .to_vec()
        })
        .chain([0, 0, 0])
        .collect();
    let packet = CommandPacket::new(id::CONTROLLER, 1, payload).unwrap();
    let report = report_of_packets([packet.encode()].into_iter());
    assert_eq!(report.faults, Faults::default());
    assert_eq!(
        (
            report.tracking_on,
            report.announcements,
            report.solutions.len()
        ),
        (1, 1, 1)
    );
}

#[test]
fn a_flawless_conversation_has_no_fault() {
    let report = report_of(&[
        Message::TrackingOn,
        announcement(0),
        announcement(250),
        solution(0),
        solution(250),
        announcement(500),
        Message::Error(NoSolution { code: 3 }),
        Message::TrackingOff,
    ]);
    assert_eq!(report.faults, Faults::default());
    assert_eq!(
        (report.solutions.len(), report.announcements, report.errors),
        (2, 3, 1)
    );
    assert_eq!((report.tracking_on, report.tracking_off), (1, 1));
}

#[test]
fn a_solution_that_was_not_announced_or_comes_twice_is_a_fault() {
    assert_eq!(
        report_of(&[announcement(0), solution(2)])
            .faults
            .unannounced,
        1
    );
    let twice = [announcement(0), solution(0), solution(0)];
    assert_eq!(report_of(&twice).faults.unannounced, 1);
}

#[test]
fn a_solution_after_tracking_is_off_is_a_fault() {
    let report = report_of(&[announcement(0), Message::TrackingOff, solution(0)]);
    assert_eq!(report.faults.unasked, 1);
    assert_eq!(report.faults.total(), 1);
}

#[test]
fn lost_broken_unreadable_and_unexpected_packets_are_faults() {
    let packet = |n, m: Message| m.packet(id::CONTROLLER, n).unwrap().encode();
    let mut broken = packet(2, announcement(0));
    broken[9] ^= 0x40;
    let mut not_finite = packet(4, solution(0));
    not_finite[10..18].copy_from_slice(&f64::NAN.to_le_bytes());
    let not_finite = CommandPacket::new(id::CONTROLLER, 4, not_finite[8..].to_vec()).unwrap();
    let stray_answer = Telemetry::Receipt(Receipt { sequence: 77 })
        .packet(time(0))
        .unwrap();
    let refusal = Telemetry::Result(CommandOutcome {
        sequence: 1,
        key: 0x1000,
        value: 1,
    });
    let report = report_of_packets(
        [
            packet(1, announcement(0)),
            broken,
            packet(3, announcement(0)),
            not_finite.encode(),
            packet(5, Message::StartTracking),
            stray_answer.encode(),
            refusal.packet(time(0)).unwrap().encode(),
        ]
        .into_iter(),
    );
    let expected = Faults {
        broken: 1,
        out_of_sequence: 1,
        unreadable: 1,
        unexpected: 2,
        refused: 1,
        ..Faults::default()
    };
    assert_eq!(report.faults, expected);
    assert_eq!(expected.total(), 6);
}

#[test]
fn tracking_is_asked_for_until_it_is_on() {
    let mut controller = Controller::new();
    let mut port = Script::default();
    let start = Duration::from_secs(100);
    for second in [0.0, 0.5, 0.99, 1.0, 1.5, 2.0] {
        let now = start + Duration::from_secs_f64(second);
        controller.poll(&mut port, now).unwrap();
    }
    assert_eq!(port.heard.len(), 3);
    let on = Message::TrackingOn.packet(id::CONTROLLER, 1).unwrap();
    port.to_say.push_back(on.encode());
    controller.poll(&mut port, start + 2 * TIMEOUT).unwrap();
    assert!(controller.is_obeyed());
    controller.poll(&mut port, start + 100 * TIMEOUT).unwrap();
    assert_eq!(port.heard.len(), 3);
    controller.stop_tracking();
    controller.poll(&mut port, start + 100 * TIMEOUT).unwrap();
    let stop = Message::StopTracking.packet(id::ASPECT, 4).unwrap();
    assert_eq!(port.heard.last(), Some(&stop.encode()));
}
