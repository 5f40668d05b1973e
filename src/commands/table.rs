//! The commands of the ground in one table. Source: HEROES flight program, 2013.

use super::setting::{self, Setting, camera_parameter, parameter};
use super::variable::{Kind, Variable};
use crate::instrument::Role;
use crate::link::computer::COMPUTERS;
use crate::link::{AspectCommand, Computer, MessageError};
use Action::{
    NoOp, Quit, Read, ReadDisk, ReadNumbered, ResetValues, SendPicture, Set, SetNumbered,
    StartSending, StopSending,
};
use Role::{Moon, PitchYaw, Roll};

/// Effect of a command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Action {
    NoOp,
    StartSending,
    StopSending,
    Quit,
    SendPicture(Role),
    /// Sets the settings of its variables.
    Set,
    /// Sets the parameter whose number is the first variable to the second.
    SetNumbered,
    /// Resets values set by commands to the configuration.
    ResetValues,
    /// Reads the setting of its result.
    Read,
    /// Reads the parameter whose number is the variable.
    ReadNumbered,
    /// Reads the used fraction of the disk whose number, from 1, is the variable.
    ReadDisk,
}

impl Action {
    /// Whether it changes the flight: all actions except reads and requests for pictures.
    pub fn changes_flight(self) -> bool {
        match self {
            NoOp | SendPicture(_) | Read | ReadNumbered | ReadDisk => false,
            StartSending | StopSending | Quit | Set | SetNumbered | ResetValues => true,
        }
    }
}

/// A command the ground may send.
#[derive(Debug, PartialEq, Eq)]
pub struct CommandRow {
    /// The key without the computers' bits.
    pub key: u16,
    pub name: &'static str,
    pub variables: &'static [Variable],
    pub action: Action,
    /// Its result if it is a read.
    pub reads: Option<Variable>,
    pub documentation: &'static str,
}

impl CommandRow {
    /// The command as sent, for one computer; the row's variables in order.
    pub fn command(
        &self,
        computer: Computer,
        variables: &[u16],
    ) -> Result<AspectCommand, MessageError> {
        AspectCommand::new(computer.bit() | self.key, variables.to_vec())
    }
}

const fn variable(
    name: &'static str,
    kind: Kind,
    unit: &'static str,
    settings: &'static [Setting],
) -> Variable {
    Variable {
        name,
        kind,
        unit,
        settings,
    }
}

const fn does(
    key: u16,
    name: &'static str,
    variables: &'static [Variable],
    action: Action,
    documentation: &'static str,
) -> CommandRow {
    CommandRow {
        key,
        name,
        variables,
        action,
        reads: None,
        documentation,
    }
}

const fn set(
    key: u16,
    name: &'static str,
    variables: &'static [Variable],
    documentation: &'static str,
) -> CommandRow {
    does(key, name, variables, Set, documentation)
}

const fn get(
    key: u16,
    name: &'static str,
    reads: Variable,
    documentation: &'static str,
) -> CommandRow {
    find(key, name, &[], reads, Read, documentation)
}

const fn find(
    key: u16,
    name: &'static str,
    variables: &'static [Variable],
    reads: Variable,
    action: Action,
    documentation: &'static str,
) -> CommandRow {
    CommandRow {
        reads: Some(reads),
        ..does(key, name, variables, action, documentation)
    }
}

const fn switch(settings: &'static [Setting]) -> Variable {
    variable("state", Kind::Switch, "", settings)
}

const fn exposure(settings: &'static [Setting]) -> Variable {
    variable("exposure", Kind::Unsigned, "us", settings)
}

const fn analogue(settings: &'static [Setting]) -> Variable {
    variable("gain", Kind::Unsigned, "", settings)
}

const fn preamp(settings: &'static [Setting]) -> Variable {
    variable("gain", Kind::Signed, "", settings)
}

#[rustfmt::skip] // One row, one line.
mod variables {
    use super::*;

    pub const TARGET_X: Variable = variable("x", Kind::Signed, "arcsec", &[parameter!(target.x_arcsec)]);
    pub const TARGET_Y: Variable = variable("y", Kind::Signed, "arcsec", &[parameter!(target.y_arcsec)]);
    pub const STORE: Variable = switch(&[setting::STORE_PITCH_YAW, setting::STORE_ROLL, setting::STORE_MOON]);
    pub const STORE_PITCH_YAW: Variable = switch(&[setting::STORE_PITCH_YAW]);
    pub const STORE_ROLL: Variable = switch(&[setting::STORE_ROLL]);
    pub const STORE_MOON: Variable = switch(&[setting::STORE_MOON]);
    pub const ACCEPT_GPS: Variable = switch(&[setting::ACCEPT_GPS]);
    pub const EXPOSURE: Variable = exposure(&[camera_parameter!(camera.exposure_us)]);
    pub const ANALOGUE: Variable = analogue(&[camera_parameter!(camera.analogue_gain)]);
    pub const PREAMP: Variable = preamp(&[camera_parameter!(camera.preamp_gain)]);
    pub const ROLL_EXPOSURE: Variable = exposure(&[camera_parameter!(roll_camera.exposure_us)]);
    pub const ROLL_ANALOGUE: Variable = analogue(&[camera_parameter!(roll_camera.analogue_gain)]);
    pub const ROLL_PREAMP: Variable = preamp(&[camera_parameter!(roll_camera.preamp_gain)]);
    pub const MOON_EXPOSURE: Variable = exposure(&[camera_parameter!(moon_camera.exposure_us)]);
    pub const CLOCKING: Variable = variable("angle", Kind::Angle, "deg", &[setting::CLOCKING]);
    pub const TWIST: Variable = variable("angle", Kind::Angle, "deg", &[setting::TWIST]);
    pub const LATITUDE: Variable = variable("latitude", Kind::Angle, "deg", &[setting::SITE_LATITUDE]);
    pub const LONGITUDE: Variable = variable("longitude", Kind::Angle, "deg", &[setting::SITE_LONGITUDE]);
    pub const CLOCK_OFFSET: Variable = variable("offset", Kind::Signed, "us", &[setting::CLOCK_OFFSET]);
    pub const PARAMETER: Variable = variable("parameter", Kind::Unsigned, "", &[]);
    pub const INTEGER: Variable = variable("value", Kind::Signed, "", &[]);
    pub const FLOAT: Variable = variable("value", Kind::Angle, "", &[]);
    pub const DISK: Variable = variable("disk", Kind::Unsigned, "", &[]);
    pub const PERCENT: Variable = variable("use", Kind::Unsigned, "%", &[]);
}
use variables::*;

/// All known commands, in the order of their keys.
#[rustfmt::skip] // One row, one line.
pub const COMMANDS: &[CommandRow] = &[
    does(0x0000, "no_op", &[], NoOp, "do nothing but answer"),
    does(0x0030, "start_sending", &[], StartSending, "start sending solutions to the controller, from the next exposure on"),
    does(0x0040, "stop_sending", &[], StopSending, "stop sending solutions to the controller, after the one that has been announced"),
    does(0x0050, "quit", &[], Quit, "end the flight program"),
    does(0x0210, "send_pitch_yaw_picture", &[], SendPicture(PitchYaw), "send the pitch-yaw camera's next picture to the ground"),
    does(0x0220, "send_roll_picture", &[], SendPicture(Roll), "send the roll camera's next picture to the ground"),
    does(0x0230, "send_moon_picture", &[], SendPicture(Moon), "send the Moon camera's next picture to the ground"),
    set(0x0412, "set_target", &[TARGET_X, TARGET_Y], "point at this helioprojective position"),
    set(0x0421, "store_frames", &[STORE], "store the frames of all cameras"),
    set(0x0431, "accept_gps", &[ACCEPT_GPS], "take the gondola's place from GPS messages"),
    set(0x0441, "store_pitch_yaw_frames", &[STORE_PITCH_YAW], "store the frames of the pitch-yaw camera"),
    set(0x0451, "set_pitch_yaw_exposure", &[EXPOSURE], "set the pitch-yaw camera's exposure"),
    set(0x0481, "set_pitch_yaw_analogue_gain", &[ANALOGUE], "set the pitch-yaw camera's analogue gain"),
    set(0x0491, "set_pitch_yaw_preamp_gain", &[PREAMP], "set the pitch-yaw camera's pre-amplifier gain"),
    set(0x0541, "store_roll_frames", &[STORE_ROLL], "store the frames of the roll camera"),
    set(0x0551, "set_roll_exposure", &[ROLL_EXPOSURE], "set the roll camera's exposure"),
    set(0x0581, "set_roll_analogue_gain", &[ROLL_ANALOGUE], "set the roll camera's analogue gain"),
    set(0x0591, "set_roll_preamp_gain", &[ROLL_PREAMP], "set the roll camera's pre-amplifier gain"),
    set(0x05A1, "store_moon_frames", &[STORE_MOON], "store the frames of the Moon camera"),
    set(0x05B1, "set_moon_exposure", &[MOON_EXPOSURE], "set the Moon camera's exposure"),
    set(0x0621, "set_clocking", &[CLOCKING], "set the plate's clocking"),
    set(0x06A2, "set_place", &[LATITUDE, LONGITUDE], "set the gondola's place"),
    does(0x0712, "set_integer", &[PARAMETER, INTEGER], SetNumbered, "set an integer parameter"),
    does(0x0722, "set_float", &[PARAMETER, FLOAT], SetNumbered, "set a float parameter"),
    set(0x0731, "set_twist", &[TWIST], "set the camera's twist"),
    does(0x0740, "reset_values", &[], ResetValues, "return every value that commands have set to the configuration's; sending, tracking and the GPS fix stay"),
    get(0x0850, "get_pitch_yaw_exposure", EXPOSURE, "read the pitch-yaw camera's exposure"),
    get(0x0860, "get_pitch_yaw_analogue_gain", ANALOGUE, "read the pitch-yaw camera's analogue gain"),
    get(0x0870, "get_pitch_yaw_preamp_gain", PREAMP, "read the pitch-yaw camera's pre-amplifier gain"),
    find(0x0881, "get_disk_use", &[DISK], PERCENT, ReadDisk, "read how full a disk of the archive is; the first is 1"),
    get(0x0950, "get_roll_exposure", ROLL_EXPOSURE, "read the roll camera's exposure"),
    get(0x0960, "get_roll_analogue_gain", ROLL_ANALOGUE, "read the roll camera's analogue gain"),
    get(0x0970, "get_roll_preamp_gain", ROLL_PREAMP, "read the roll camera's pre-amplifier gain"),
    get(0x0980, "get_moon_exposure", MOON_EXPOSURE, "read the Moon camera's exposure"),
    get(0x0A10, "get_target_x", TARGET_X, "read the target's x"),
    get(0x0A20, "get_target_y", TARGET_Y, "read the target's y"),
    find(0x0B11, "get_integer", &[PARAMETER], INTEGER, ReadNumbered, "read an integer parameter"),
    find(0x0B21, "get_float", &[PARAMETER], FLOAT, ReadNumbered, "read a float parameter"),
    get(0x0B30, "get_twist", TWIST, "read the camera's twist"),
    get(0x0C20, "get_clocking", CLOCKING, "read the plate's clocking"),
    get(0x0CA0, "get_latitude", LATITUDE, "read the gondola's latitude"),
    get(0x0CB0, "get_longitude", LONGITUDE, "read the gondola's longitude"),
    get(0x0D10, "get_clock_offset", CLOCK_OFFSET, "read the clock's offset"),
];

/// The row of a key, whatever its computers' bits.
pub fn row_of(key: u16) -> Option<&'static CommandRow> {
    COMMANDS.iter().find(|row| row.key == key & !COMPUTERS)
}

/// The row with this name.
pub fn row_named(name: &str) -> Option<&'static CommandRow> {
    COMMANDS.iter().find(|row| row.name == name)
}
