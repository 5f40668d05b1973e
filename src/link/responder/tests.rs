use super::*;
use crate::link::MoonOutcome;
use crate::link::control::result;
use crate::link::message::GpsFix;
use crate::link::packet::{Direction, Packet};

fn time(second: i64) -> Timestamp {
    Timestamp::from_second(1_379_786_400 + second).unwrap()
}

fn solution(second: i64) -> Solution {
    Solution {
        azimuth_deg: 0.01,
        elevation_deg: -0.02,
        roll_deg: 0.0,
        error_deg: 1e-5,
        time: time(second),
    }
}

fn exposure(second: i64) -> Exposure {
    Exposure {
        camera: 1,
        start: time(second),
    }
}

fn conclude(responder: &mut Responder, second: i64) -> Result<Option<Vec<u8>>, MessageError> {
    responder.solution(exposure(second), &solution(second))
}

/// A service that sets targets, refuses settings of cameras, reads 4711, and knows no other command.
struct Desk;

impl Control for Desk {
    fn knows(&self, key: u16) -> bool {
        key & 0x0FF0 < 0x0F00
    }

    fn carry_out(&mut self, command: &AspectCommand) -> Carried {
        match command.key() & 0x0FFF {
            0x0030 => Carried::StartSending,
            0x0040 => Carried::StopSending,
            0x0000 | 0x0412 => CommandResult::Done.into(),
            0x0421 | 0x0451 | 0x0481 | 0x0491 => CommandResult::Refused.into(),
            0x0800..0x0E00 => CommandResult::Value(4711).into(),
            0x0F00.. => CommandResult::Unknown.into(),
            _ => CommandResult::NotImplemented.into(),
        }
    }

    fn take_fix(&mut self, fix: GpsFix) -> CommandResult {
        match fix.may_follow(None) && fix.latitude_deg > 0.0 {
            true => CommandResult::Done,
            false => CommandResult::Refused,
        }
    }

    fn request_moon(&mut self, request: &MoonRequest) -> CommandResult {
        match request.place() {
            Ok(_) => CommandResult::Done,
            Err(_) => CommandResult::Refused,
        }
    }
}

/// Content of a packet to the controller, without its sequence number and time.
#[derive(Debug, PartialEq)]
enum Said {
    Message(Message),
    Answer(Telemetry),
}

fn said(bytes: &[u8]) -> Said {
    match Packet::decode(Direction::ToController, bytes).unwrap() {
        Packet::Command(packet) => Said::Message(Message::decode(packet.payload()).unwrap()),
        Packet::Telemetry(packet) => Said::Answer(Telemetry::decode(&packet).unwrap()),
    }
}

fn answers(sequence: u16, key: u16, value: u16) -> Vec<Said> {
    let receipt = Telemetry::Receipt(Receipt { sequence });
    let outcome = Telemetry::Result(CommandOutcome {
        sequence,
        key,
        value,
    });
    vec![Said::Answer(receipt), Said::Answer(outcome)]
}

fn send(responder: &mut Responder, message: &Message) -> (Vec<Said>, bool) {
    send_payload(responder, message.packet(id::ASPECT, 5).unwrap().payload())
}

fn send_payload(responder: &mut Responder, payload: &[u8]) -> (Vec<Said>, bool) {
    let packet = CommandPacket::new(id::ASPECT, 5, payload.to_vec()).unwrap();
    let reply = responder.handle(&packet, time(0), &mut Desk).unwrap();
    (
        reply.packets.iter().map(|p| said(p)).collect(),
        reply.changed,
    )
}

fn aspect(key: u16, variables: &[u16]) -> Message {
    Message::Aspect(AspectCommand::new(key, variables.to_vec()).unwrap())
}

/// A state in which no solutions are wanted yet.
fn sending(sending: bool) -> LinkState {
    let tracking = false;
    LinkState { tracking, sending }
}

fn computer_one() -> Responder {
    Responder::new(Computer::One, sending(true))
}

#[test]
fn start_and_stop_of_tracking_get_a_receipt_a_result_and_their_answer() {
    let mut responder = computer_one();
    assert!(!responder.state().tracking);
    let (packets, change) = send(&mut responder, &Message::StartTracking);
    let mut expected = answers(5, 0x1000, 0);
    expected.push(Said::Message(Message::TrackingOn));
    assert_eq!((packets, change), (expected, true));
    let (packets, change) = send(&mut responder, &Message::StopTracking);
    let mut expected = answers(5, 0x1001, 0);
    expected.push(Said::Message(Message::TrackingOff));
    assert_eq!((packets, change), (expected, true));
}

#[test]
fn the_carried_out_commands_are_done_the_other_known_ones_not_and_the_rest_unknown() {
    let mut responder = computer_one();
    let mut result = |key, variables: &[u16]| send(&mut responder, &aspect(key, variables)).0;
    assert_eq!(result(0x1000, &[]), answers(5, 0x1000, 0));
    assert_eq!(result(0x1040, &[]), answers(5, 0x1040, 0));
    assert_eq!(result(0x1030, &[]), answers(5, 0x1030, 0));
    assert_eq!(result(0x1412, &[1, 2]), answers(5, 0x1412, 0));
    assert_eq!(result(0x1210, &[]), answers(5, 0x1210, 1));
    assert_eq!(result(0x1FF0, &[]), answers(5, 0x1FF0, 0xFFFF));
}

#[test]
fn a_command_without_its_variables_is_refused_and_an_unknown_message_is_unknown() {
    let mut responder = computer_one();
    let mut send = |payload: &[u8]| send_payload(&mut responder, payload);
    assert_eq!(
        send(&[0xFF, 0x10, 0x12, 0x14, 1, 0]),
        (answers(5, 0x1412, 1), false)
    );
    assert_eq!(
        send(&[0xFF, 0x10, 0xF2, 0x1F, 1, 0]),
        (answers(5, 0x1FF2, 0xFFFF), false)
    );
    assert_eq!(send(&[0x0A, 0, 0, 0]), (answers(5, 0x000A, 1), false));
    assert_eq!(send(&[0x34, 0x12]), (answers(5, 0x1234, 0xFFFF), false));
    assert_eq!(send(&[0x00, 0x11]), (answers(5, 0x1100, 0xFFFF), false));
}

#[test]
fn what_is_not_for_this_computer_is_ignored_unanswered() {
    let mut responder = computer_one();
    for key in [0x2040, 0x0040, 0x4040] {
        assert_eq!(send(&mut responder, &aspect(key, &[])), (vec![], false));
    }
    for payload in [&[][..], &[0xFF], &[0xFF, 0x10], &[0xFF, 0x10, 0x40]] {
        assert_eq!(send_payload(&mut responder, payload), (vec![], false));
    }
    let elsewhere = Message::StartTracking.packet(id::CONTROLLER, 1).unwrap();
    assert_eq!(
        responder.handle(&elsewhere, time(0), &mut Desk),
        Ok(Reply::default())
    );
    assert_eq!(responder.state(), computer_one().state());

    let to_everyone = Message::StartTracking.packet(id::EVERYONE, 1).unwrap();
    assert_eq!(
        responder
            .handle(&to_everyone, time(0), &mut Desk)
            .unwrap()
            .packets
            .len(),
        3
    );
    assert_eq!(
        send(&mut responder, &aspect(0x3040, &[])).0,
        answers(5, 0x3040, 0)
    );
}

#[test]
fn what_the_service_says_of_a_command_is_its_result() {
    let mut responder = computer_one();
    let mut result = |key, variables: &[u16]| {
        let (said, changed) = send(&mut responder, &aspect(key, variables));
        assert!(!changed);
        said
    };
    assert_eq!(result(0x1412, &[1, 2]), answers(5, 0x1412, result::DONE));
    assert_eq!(result(0x1451, &[0]), answers(5, 0x1451, result::REFUSED));
    assert_eq!(result(0x1D10, &[]), answers(5, 0x1D10, 4711));
    let fix = |latitude_deg| GpsFix {
        latitude_deg,
        longitude_deg: 1.0,
    };
    let mut gps = |latitude| send(&mut responder, &Message::Gps(fix(latitude))).0;
    assert_eq!(gps(34.0), answers(5, 0x000A, result::DONE));
    assert_eq!(gps(0.0), answers(5, 0x000A, result::REFUSED));
}

#[test]
fn every_command_of_a_packet_is_carried_out_and_answered_in_order() {
    let mut responder = computer_one();
    // As the ground of HEROES writes it: the target, then the analogue gain.
    let packet = "9ac3300e7100d498ff1012140b001600ff1081140500";
    let bytes = crate::link::hex::from_hex(packet).unwrap();
    let Ok(Packet::Command(packet)) = Packet::decode(Direction::ToAspect, &bytes) else {
        panic!("no packet");
    };
    let reply = responder.handle(&packet, time(0), &mut Desk).unwrap();
    let result = |key, value| {
        let sequence = 0x71;
        Said::Answer(Telemetry::Result(CommandOutcome {
            sequence,
            key,
            value,
        }))
    };
    let mut expected = answers(0x71, 0x1412, result::DONE);
    expected.push(result(0x1481, result::REFUSED));
    let heard: Vec<Said> = reply.packets.iter().map(|p| said(p)).collect();
    assert_eq!((heard, reply.commands.len()), (expected, 2));
}

#[test]
fn commands_of_the_other_computer_are_skipped_and_an_unknown_one_ends_the_packet() {
    let mut responder = computer_one();
    let payload = [
        &[0xFF, 0x10, 0x40, 0x20][..],
        &[0x00, 0x10],
        &[0xFF, 0x10, 0xF1, 0x1F, 9, 0],
        &[0xFF, 0x10, 0x12, 0x14, 1, 0, 2, 0],
        &[0x34, 0x12, 1],
    ]
    .concat();
    let (heard, changed) = send_payload(&mut responder, &payload);
    let mut expected = answers(5, 0x1000, 0);
    expected.push(Said::Message(Message::TrackingOn));
    for (key, value) in [(0x1FF1, 0xFFFF), (0x1412, 0), (0x1234, 0xFFFF)] {
        expected.extend(answers(5, key, value).into_iter().skip(1));
    }
    assert_eq!((heard, changed), (expected, true));
}

#[test]
fn padding_is_no_command() {
    let mut responder = computer_one();
    for padding in 0..6 {
        let payload = [&[0x01, 0x10][..], &vec![0; padding]].concat();
        let mut expected = answers(5, 0x1001, 0);
        expected.push(Said::Message(Message::TrackingOff));
        assert_eq!(send_payload(&mut responder, &payload).0, expected);
    }
}

#[test]
fn a_place_that_is_no_number_is_refused() {
    let mut responder = computer_one();
    let mut payload = vec![0x0A, 0];
    payload.extend(f32::NAN.to_le_bytes());
    payload.extend(1_f32.to_le_bytes());
    let said = send_payload(&mut responder, &payload).0;
    assert_eq!(said, answers(5, 0x000A, result::REFUSED));
}

#[test]
fn an_exposure_is_announced_while_sending_is_enabled_tracking_or_not() {
    let mut responder = computer_one();
    let packet = responder.exposure_starts(exposure(1)).unwrap().unwrap();
    let announced = ExposureStart {
        camera: 1,
        time: time(1),
    };
    assert_eq!(
        said(&packet),
        Said::Message(Message::ExposureStart(announced))
    );
    send(&mut responder, &aspect(0x1040, &[]));
    assert_eq!(responder.exposure_starts(exposure(2)), Ok(None));
    let mut second = Responder::new(Computer::Two, sending(false));
    assert_eq!(second.exposure_starts(exposure(1)), Ok(None));
}

#[test]
fn a_solution_goes_only_while_tracking_and_sending_and_after_its_own_announcement_and_once() {
    let mut responder = computer_one();
    responder.exposure_starts(exposure(1)).unwrap();
    assert_eq!(conclude(&mut responder, 1), Ok(None), "not tracking");
    send(&mut responder, &Message::StartTracking);
    assert_eq!(conclude(&mut responder, 2), Ok(None), "not announced");
    responder.exposure_starts(exposure(3)).unwrap();
    responder.exposure_starts(exposure(4)).unwrap();
    let packet = conclude(&mut responder, 3).unwrap().unwrap();
    assert_eq!(said(&packet), Said::Message(Message::Solution(solution(3))));
    assert_eq!(conclude(&mut responder, 3), Ok(None), "sent already");
    let packet = responder.error(exposure(4), 8).unwrap().unwrap();
    assert_eq!(
        said(&packet),
        Said::Message(Message::Error(NoSolution { code: 8 }))
    );
    assert_eq!(
        conclude(&mut responder, 4),
        Ok(None),
        "an error went instead"
    );
    responder.exposure_starts(exposure(5)).unwrap();
    responder.forget(exposure(5));
    assert_eq!(
        conclude(&mut responder, 5),
        Ok(None),
        "its announcement did not go"
    );
    responder.exposure_starts(exposure(6)).unwrap();
    send(&mut responder, &Message::StopTracking);
    assert_eq!(
        conclude(&mut responder, 6),
        Ok(None),
        "not tracking any more"
    );
}

#[test]
fn an_older_solution_never_goes_after_a_newer_one() {
    let mut responder = computer_one();
    send(&mut responder, &Message::StartTracking);
    for second in 1..=3 {
        responder.exposure_starts(exposure(second)).unwrap();
    }
    assert!(conclude(&mut responder, 2).unwrap().is_some());
    assert_eq!(conclude(&mut responder, 1), Ok(None));
    assert!(conclude(&mut responder, 3).unwrap().is_some());
}

#[test]
fn exposures_of_two_cameras_at_one_time_are_distinguished() {
    let mut responder = computer_one();
    send(&mut responder, &Message::StartTracking);
    responder.exposure_starts(exposure(1)).unwrap();
    let other = Exposure {
        camera: 2,
        ..exposure(1)
    };
    assert_eq!(responder.solution(other, &solution(1)), Ok(None));
    assert!(conclude(&mut responder, 1).unwrap().is_some());
}

#[test]
fn sending_stops_when_the_announced_exposure_is_concluded_and_says_so_then() {
    let mut responder = computer_one();
    send(&mut responder, &Message::StartTracking);
    responder.exposure_starts(exposure(1)).unwrap();
    let (said, changed) = send(&mut responder, &aspect(0x1040, &[]));
    let receipt = Said::Answer(Telemetry::Receipt(Receipt { sequence: 5 }));
    assert_eq!((said, changed), (vec![receipt], false));
    assert!(responder.is_stopping());
    assert_eq!(responder.stopped(time(1)), Ok(vec![]));
    assert_eq!(
        responder.exposure_starts(exposure(2)),
        Ok(None),
        "no other exposure"
    );
    assert!(conclude(&mut responder, 1).unwrap().is_some());
    let packets = responder.stopped(time(1)).unwrap();
    let said: Vec<Said> = packets.iter().map(|p| super::tests::said(p)).collect();
    assert_eq!(said, answers(5, 0x1040, 0)[1..]);
    assert!(!responder.state().sending && !responder.is_stopping());
    assert_eq!(responder.stopped(time(1)), Ok(vec![]));
}

#[test]
fn sending_stops_at_once_where_nothing_is_to_be_concluded() {
    let mut responder = computer_one();
    responder.exposure_starts(exposure(1)).unwrap();
    let stop = aspect(0x1040, &[]);
    assert_eq!(
        send(&mut responder, &stop),
        (answers(5, 0x1040, 0), true),
        "not tracking"
    );
    send(&mut responder, &Message::StartTracking);
    assert_eq!(conclude(&mut responder, 1), Ok(None), "sending disabled");
    assert_eq!(send(&mut responder, &stop), (answers(5, 0x1040, 0), false));
}

#[test]
fn a_start_overtakes_a_stop_that_waits_and_both_are_answered() {
    let mut responder = computer_one();
    send(&mut responder, &Message::StartTracking);
    responder.exposure_starts(exposure(1)).unwrap();
    send(&mut responder, &aspect(0x1040, &[]));
    assert_eq!(
        send(&mut responder, &aspect(0x1030, &[])),
        (answers(5, 0x1030, 0), false)
    );
    assert_eq!(responder.stopped(time(1)).unwrap().len(), 1);
    assert!(responder.state().sending);
    assert!(responder.exposure_starts(exposure(2)).unwrap().is_some());
}

#[test]
fn dropped_exposures_end_the_waiting() {
    let mut responder = computer_one();
    send(&mut responder, &Message::StartTracking);
    responder.exposure_starts(exposure(1)).unwrap();
    send(&mut responder, &aspect(0x1040, &[]));
    responder.forget_all();
    assert_eq!(responder.stopped(time(1)).unwrap().len(), 1);
    assert!(!responder.state().sending);
}

#[test]
fn packets_to_the_controller_are_numbered_one_by_one() {
    let mut responder = computer_one();
    responder.sequence = u16::MAX - 1;
    let mut sequence = |second| {
        let packet = responder
            .exposure_starts(exposure(second))
            .unwrap()
            .unwrap();
        u16::from_le_bytes([packet[4], packet[5]])
    };
    assert_eq!([sequence(1), sequence(2), sequence(3)], [u16::MAX, 0, 1]);
}

#[test]
fn a_request_for_the_moon_is_answered_at_once_by_its_result_and_waits_for_what_is_found() {
    let mut responder = Responder::new(Computer::Two, sending(false));
    let request = |latitude_deg| MoonRequest {
        latitude_deg,
        longitude_deg: -104.25,
        height_m: 550_000.0,
    };
    let ask = |responder: &mut Responder, request| {
        let packet = Message::MoonRequest(request).packet(id::ASPECT, 5).unwrap();
        responder.handle(&packet, time(0), &mut Desk).unwrap()
    };
    let reply = ask(&mut responder, request(91.0));
    assert!(reply.moon_requests.is_empty());
    let said_of = |reply: &Reply| -> Vec<Said> { reply.packets.iter().map(|p| said(p)).collect() };
    assert_eq!(
        said_of(&reply),
        answers(5, key::MOON_REQUEST, result::REFUSED)
    );
    let reply = ask(&mut responder, request(34.5));
    assert_eq!(reply.moon_requests, [(5, request(34.5))]);
    assert_eq!(said_of(&reply), answers(5, key::MOON_REQUEST, result::DONE));
    let heard = Some(Message::MoonRequest(request(34.5)));
    assert_eq!(reply.commands[0].message, heard);
    let answer = MoonAnswer {
        request: 5,
        outcome: MoonOutcome::NotFound { code: 1 },
    };
    let packet = responder.moon(answer).unwrap();
    assert_eq!(said(&packet), Said::Message(answer.into()));
}
