use super::*;
use crate::commands::COMMANDS;
use crate::commands::setting::CLOCK_OFFSET;
use crate::instrument::builtin;
use crate::link::code::angle_code;
use crate::link::{AspectCommand, Carried, CommandResult, Computer, Control, GpsFix};

fn controls() -> Controls {
    let mounting = builtin("demo").unwrap().mounting;
    Controls::new(Config::default(), Target::default(), mounting)
}

fn camera(controls: &Controls, name: &str) -> ConfiguredCamera {
    controls.config().cameras.named(name).unwrap().clone()
}

/// Result of a command by name, with its variables as sent.
fn order(controls: &Controls, name: &str, variables: &[u16]) -> CommandResult {
    let row = COMMANDS.iter().find(|row| row.name == name).unwrap();
    let command = row.command(Computer::One, variables).unwrap();
    match controls.clone().carry_out(&command) {
        Carried::Result(result) => result,
        wish => panic!("{wish:?}"),
    }
}

fn signed(value: i16) -> u16 {
    value.cast_unsigned()
}

fn angle(value: f64) -> u16 {
    angle_code(value).unwrap()
}

const DONE: CommandResult = CommandResult::Done;
const REFUSED: CommandResult = CommandResult::Refused;
const UNKNOWN: CommandResult = CommandResult::Unknown;

#[test]
fn a_switch_that_is_neither_on_nor_off_is_refused_and_an_unknown_key_is_unknown() {
    let mut controls = controls();
    let mut carried = |key, variables| {
        let command = AspectCommand::new(key, variables).unwrap();
        controls.carry_out(&command)
    };
    assert_eq!(carried(0x1421, vec![2]), Carried::Result(REFUSED));
    assert_eq!(carried(0x1421, vec![1]), Carried::Result(DONE));
    assert_eq!(carried(0x1FF0, vec![]), Carried::Result(UNKNOWN));
    assert_eq!(carried(0x1030, vec![]), Carried::StartSending);
    assert_eq!(carried(0x1040, vec![]), Carried::StopSending);
}

#[test]
fn every_key_of_the_command_table_is_a_setting() {
    for row in COMMANDS {
        let variables = row.variables.iter().chain(&row.reads);
        for setting in variables.flat_map(|variable| variable.settings) {
            let key = setting.key();
            let own = [Value::Whole(1), Value::Number(1.0)];
            let known =
                by_key(key).is_some() || own.iter().any(|v| CommandOnly::new().set(key, v).is_ok());
            assert!(known || *setting == CLOCK_OFFSET, "{}: {key}", row.name);
        }
    }
}

#[test]
fn what_a_command_sets_a_command_reads() {
    let controls = controls();
    let signed = |value: i16| vec![signed(value)];
    for (set, variables, get, which) in [
        (
            "set_pitch_yaw_exposure",
            vec![12_000],
            "get_pitch_yaw_exposure",
            None,
        ),
        (
            "set_pitch_yaw_analogue_gain",
            vec![400],
            "get_pitch_yaw_analogue_gain",
            None,
        ),
        (
            "set_pitch_yaw_preamp_gain",
            signed(-3),
            "get_pitch_yaw_preamp_gain",
            None,
        ),
        ("set_roll_exposure", vec![50_000], "get_roll_exposure", None),
        (
            "set_roll_analogue_gain",
            vec![300],
            "get_roll_analogue_gain",
            None,
        ),
        (
            "set_roll_preamp_gain",
            signed(6),
            "get_roll_preamp_gain",
            None,
        ),
        ("set_clocking", vec![angle(-32.375)], "get_clocking", None),
        ("set_twist", vec![angle(180.0)], "get_twist", None),
        ("set_integer", vec![2, 4], "get_integer", Some(2)),
        ("set_float", vec![1, angle(2.5)], "get_float", Some(1)),
    ] {
        assert_eq!(order(&controls, set, &variables), DONE, "{set}");
        let number: Vec<u16> = which.into_iter().collect();
        let read = order(&controls, get, &number);
        assert_eq!(
            read,
            CommandResult::Value(*variables.last().unwrap()),
            "{get}"
        );
    }
    assert_eq!(camera(&controls, "camera").exposure_us, 12_000);
    assert_eq!(camera(&controls, "roll_camera").exposure_us, 50_000);
    assert_eq!(controls.config().link.solution_divisor, 4);
    assert_eq!(camera(&controls, "camera").rate_hz, 2.5);
}

#[test]
fn target_and_place_are_set_together_and_read_one_by_one() {
    let controls = controls();
    assert_eq!(order(&controls, "set_target", &[signed(-300), 450]), DONE);
    assert_eq!(
        controls.snapshot().target,
        Target::Fixed(HelioprojectiveArcsec {
            x: -300.0,
            y: 450.0
        })
    );
    let read = |name| order(&controls, name, &[]);
    assert_eq!(read("get_target_x"), CommandResult::Value(signed(-300)));
    assert_eq!(read("get_target_y"), CommandResult::Value(450));
    assert_eq!(read("get_latitude"), UNKNOWN);
    let place = [angle(34.5), angle(-104.25)];
    assert_eq!(order(&controls, "set_place", &place), DONE);
    assert_eq!(
        controls.snapshot().place,
        Place::new(34.5, -104.25, 0.0).ok()
    );
    assert_eq!(read("get_latitude"), CommandResult::Value(place[0]));
    assert_eq!(read("get_longitude"), CommandResult::Value(place[1]));
}

#[test]
fn what_is_out_of_range_is_refused_and_changes_nothing() {
    let controls = controls();
    let before = controls.config();
    for (name, variables) in [
        ("set_target", vec![signed(-32_768), 0]),
        ("set_target", vec![0, signed(-32_768)]),
        ("set_pitch_yaw_exposure", vec![0]),
        ("set_roll_exposure", vec![0]),
        ("set_clocking", vec![angle(361.0)]),
        ("set_twist", vec![angle(-361.0)]),
        ("set_place", vec![angle(91.0), angle(0.0)]),
        ("set_place", vec![angle(34.5), angle(-181.0)]),
        ("set_integer", vec![2, 0]),
        ("set_integer", vec![2, signed(-1)]),
        ("set_integer", vec![1, 5]),
        ("set_integer", vec![9999, 1]),
        ("set_float", vec![1, angle(101.0)]),
        ("set_float", vec![1, angle(0.0)]),
        ("set_float", vec![2, angle(1.0)]),
        ("set_float", vec![9999, angle(1.0)]),
    ] {
        assert_eq!(
            order(&controls, name, &variables),
            REFUSED,
            "{name} {variables:?}"
        );
    }
    assert_eq!(controls.config(), before);
    assert_eq!(
        camera(&controls, "roll_camera"),
        *before.cameras.named("roll_camera").unwrap()
    );
    let snapshot = controls.snapshot();
    assert_eq!((snapshot.clocking_deg, snapshot.twist_deg), (None, None));
    assert_eq!(snapshot.place, None, "not half of it either");
}

#[test]
fn what_is_not_known_is_read_as_unknown() {
    let controls = controls();
    for (name, variables) in [
        ("get_disk_use", vec![1]),
        ("get_disk_use", vec![0]),
        ("get_integer", vec![1]),
        ("get_float", vec![2]),
        ("get_integer", vec![9999]),
        ("get_pitch_yaw_analogue_gain", vec![]),
        ("get_longitude", vec![]),
        ("get_clock_offset", vec![]),
    ] {
        assert_eq!(order(&controls, name, &variables), UNKNOWN, "{name}");
    }
    controls.note_disk_use(1, Some(87));
    controls.note_clock_offset(Some(-120));
    assert_eq!(order(&controls, "get_disk_use", &[1]), UNKNOWN);
    assert_eq!(
        order(&controls, "get_disk_use", &[2]),
        CommandResult::Value(87)
    );
    let offset = order(&controls, "get_clock_offset", &[]);
    assert_eq!(offset, CommandResult::Value(signed(-120)));
    controls.note_clock_offset(Some(5_000_000));
    let offset = order(&controls, "get_clock_offset", &[]);
    assert_eq!(
        offset,
        CommandResult::Value(signed(i16::MAX)),
        "as far as it reaches"
    );
}

#[test]
fn switches_quit_and_pictures_reach_those_who_ask() {
    let controls = controls();
    let stores = || [Role::PitchYaw, Role::Roll].map(|role| controls.stores(role));
    assert_eq!(stores(), [true, true]);
    assert_eq!(order(&controls, "store_frames", &[0]), DONE);
    assert_eq!(stores(), [false, false]);
    assert_eq!(order(&controls, "store_pitch_yaw_frames", &[1]), DONE);
    assert_eq!(stores(), [true, false]);
    assert_eq!(order(&controls, "store_roll_frames", &[1]), DONE);
    assert_eq!(stores(), [true, true]);

    assert!(!controls.takes_picture(Role::PitchYaw));
    assert_eq!(order(&controls, "send_pitch_yaw_picture", &[]), DONE);
    assert!(controls.takes_picture(Role::PitchYaw));
    assert!(!controls.takes_picture(Role::PitchYaw), "one picture only");
    let without = order(&controls, "send_roll_picture", &[]);
    assert_eq!(
        without,
        CommandResult::NotImplemented,
        "there is no such camera"
    );
    controls.note_cameras(&[Role::PitchYaw, Role::Roll]);
    assert_eq!(order(&controls, "send_roll_picture", &[]), DONE);

    assert!(!controls.quit_requested());
    assert_eq!(order(&controls, "quit", &[]), DONE);
    assert!(controls.quit_requested());
}

#[test]
fn a_place_from_gps_is_taken_while_it_is_accepted_and_no_jump() {
    let mut controls = controls();
    let fix = |latitude_deg, longitude_deg| GpsFix {
        latitude_deg,
        longitude_deg,
    };
    assert_eq!(controls.take_fix(fix(34.5, -104.25)), DONE);
    assert_eq!(controls.take_fix(fix(0.0, 0.0)), REFUSED);
    assert_eq!(controls.take_fix(fix(40.0, -104.25)), REFUSED);
    assert_eq!(controls.gps_refused(), 2);
    assert_eq!(order(&controls, "accept_gps", &[0]), DONE);
    assert_eq!(controls.take_fix(fix(34.6, -104.25)), REFUSED);
    assert_eq!(
        controls.snapshot().place,
        Place::new(34.5, -104.25, 0.0).ok()
    );
    let elsewhere = [angle(-77.5), angle(166.5)];
    assert_eq!(order(&controls, "set_place", &elsewhere), DONE);
    assert_eq!(order(&controls, "accept_gps", &[1]), DONE);
    assert_eq!(
        controls.take_fix(fix(-77.75, 166.0)),
        DONE,
        "a place set by command starts the check again"
    );
}

#[test]
fn a_change_is_seen_by_those_whom_it_concerns() {
    let controls = controls();
    let versions = || {
        [
            Topic::Aim,
            Topic::Mounting,
            Topic::Solver,
            Topic::Cameras,
            Topic::Link,
        ]
        .map(|topic| controls.version(topic))
    };
    let mut before = versions();
    for (name, variables, at) in [
        ("set_target", vec![1, 2], 0),
        ("set_twist", vec![angle(90.0)], 1),
        ("set_integer", vec![13, 4], 2),
        ("set_roll_exposure", vec![100], 3),
        ("set_integer", vec![2, 4], 4),
    ] {
        assert_eq!(order(&controls, name, &variables), DONE, "{name}");
        let after = versions();
        for topic in 0..before.len() {
            assert_eq!(after[topic] > before[topic], topic == at, "{name}");
        }
        before = after;
    }
    assert_eq!(controls.snapshot().solver.limb.min_run_px, 4);
}

#[test]
fn a_twist_turns_the_mounting_from_where_it_is_stated() {
    let controls = controls();
    let stated = builtin("heroes-pyas-f").unwrap().mounting;
    assert_eq!(controls.snapshot().mounting(&stated), stated);
    assert_eq!(stated.twist_deg, 180.0);
    order(&controls, "set_twist", &[angle(170.0)]);
    order(&controls, "set_clocking", &[angle(-30.0)]);
    let mounting = controls.snapshot().mounting(&stated);
    let turned = mounting.rotation_deg.value - stated.rotation_deg.value;
    assert!((turned + 10.0).abs() < 1e-9, "{turned}");
    assert_eq!(mounting.clocking_deg.value, -30.0);
}

#[test]
fn a_value_that_contradicts_this_flight_is_refused_and_nothing_changes() {
    let controls = controls();
    controls.note_instrument(&builtin("demo").unwrap());
    let before = controls.config();
    let number = |key: &str| by_key(key).unwrap().command.unwrap();
    let integer = |key, value| order(&controls, "set_integer", &[number(key), signed(value)]);
    let float = |key, value| order(&controls, "set_float", &[number(key), angle(value)]);
    assert_eq!(
        integer("link.sending_camera", 2),
        REFUSED,
        "it is not there"
    );
    assert_eq!(order(&controls, "set_pitch_yaw_exposure", &[65_535]), DONE);
    controls.reset();
    // Each is allowed by itself, but no frame would show a Sun.
    assert_eq!(float("fiducial.min_likeness", 1.0), REFUSED);
    assert_eq!(float("fiducial.min_contrast", 1.0), REFUSED);
    assert_eq!(integer("limb.min_limb_points", 720), REFUSED);
    assert_eq!(integer("fiducial.min_marks", 225), REFUSED);
    assert_eq!(
        float("limb.min_contrast_sigma", 100.0),
        DONE,
        "the Sun is bright"
    );
    controls.reset();
    assert_eq!(controls.config(), before);
    controls.note_cameras(&[Role::PitchYaw, Role::Roll]);
    assert_eq!(integer("link.sending_camera", 2), REFUSED);
    controls.note_cameras(&[Role::PitchYaw, Role::Roll, Role::PitchYaw]);
    assert_eq!(integer("link.sending_camera", 2), DONE);
}

#[test]
fn saved_values_that_leave_no_sun_are_left_out() {
    let controls = controls();
    controls.note_instrument(&builtin("demo").unwrap());
    let hostile = [("fiducial.min_likeness", Value::Number(1.0))];
    let refused = controls.set(&hostile).unwrap_err().to_string();
    assert!(
        refused.starts_with("fiducial.min_likeness: expected settings"),
        "{refused}"
    );
    assert_eq!(controls.config(), Config::default());
}

#[test]
fn what_was_read_and_is_written_again_is_the_same_value() {
    let mut mounting = builtin("demo").unwrap().mounting;
    mounting.clocking_deg.value = -52.175;
    let mut config = Config::default();
    config.fiducial.min_contrast = 0.26;
    config.cameras.first_mut().exposure_us = 100_000;
    let controls = Controls::new(config.clone(), Target::default(), mounting);
    for (read, written) in [
        ("get_clocking", "set_clocking"),
        ("get_pitch_yaw_exposure", "set_pitch_yaw_exposure"),
    ] {
        let CommandResult::Value(code) = order(&controls, read, &[]) else {
            panic!("{read}");
        };
        assert_eq!(order(&controls, written, &[code]), DONE);
    }
    let number = by_key("fiducial.min_contrast").unwrap().command.unwrap();
    let CommandResult::Value(code) = order(&controls, "get_float", &[number]) else {
        panic!("get_float");
    };
    assert_eq!(order(&controls, "set_float", &[number, code]), DONE);
    assert_eq!(controls.config(), config);
    assert_eq!(controls.snapshot().clocking_deg, None);
    assert!(controls.differences().is_empty());
    // Another value is set as sent.
    assert_eq!(order(&controls, "set_clocking", &[angle(-52.0)]), DONE);
    assert_eq!(controls.snapshot().clocking_deg, Some(-52.0));
}

#[test]
fn reset_values_returns_to_the_configuration_and_keeps_the_conversation() {
    let controls = controls();
    let before = (controls.config(), controls.snapshot());
    controls.note_tracking(true);
    controls.note_stamp_ns(7);
    assert_eq!(order(&controls, "set_pitch_yaw_exposure", &[700]), DONE);
    assert_eq!(order(&controls, "set_target", &[signed(-300), 450]), DONE);
    assert_eq!(order(&controls, "set_twist", &[angle(0.5)]), DONE);
    assert_eq!(order(&controls, "store_roll_frames", &[0]), DONE);
    // The same value as in the configuration.
    assert_eq!(order(&controls, "accept_gps", &[1]), DONE);
    let differences = controls.differences().join("; ");
    assert_eq!(
        differences,
        "camera.exposure_us = 700 (configuration: 15000); mounting.twist_deg = 0.5 (set by command alone); \
         store.roll = 0 (set by command alone); target.x_arcsec = -300 (configuration: 0); \
         target.y_arcsec = 450 (configuration: 0)"
    );
    let version = controls.version(Topic::Cameras);
    assert_eq!(order(&controls, "reset_values", &[]), DONE);
    assert!(controls.version(Topic::Cameras) > version);
    assert_eq!((controls.config(), controls.snapshot()), before);
    assert!(controls.stores(Role::Roll) && controls.differences().is_empty());
    assert!(controls.tracking());
    assert_eq!(controls.stamp_ns(), 7);
}
