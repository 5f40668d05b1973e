//! The commands of the ground in one table. Source: HEROES flight program, 2013.

use crate::link::code::{angle_code, angle_from_code};
use crate::link::message::{AspectCommand, MessageError};
use crate::link::number::Number;
use Action::{
    NoOp, Quit, Read, ReadDisk, ReadNumbered, ResetValues, SendPicture, Set, SetNumbered,
    StartSending, StopSending,
};
use CameraRole::{Moon, PitchYaw, Roll};

/// The bits of a key that name computers.
pub(super) const COMPUTERS: u16 = 0xF000;

/// One of the two computers of the aspect system.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Computer {
    One,
    Two,
}

impl Computer {
    /// The computer of a number, 1 or 2.
    pub fn numbered(number: u32) -> Option<Self> {
        match number {
            1 => Some(Self::One),
            2 => Some(Self::Two),
            _ => None,
        }
    }

    pub fn number(self) -> u8 {
        match self {
            Self::One => 1,
            Self::Two => 2,
        }
    }

    /// Whether it sends solutions before a command says anything.
    pub fn sends_by_default(self) -> bool {
        self == Self::One
    }

    /// Whether a command with this key is for this computer. One may be for both, or for none.
    pub fn is_addressed_by(self, key: u16) -> bool {
        key & self.bit() != 0
    }

    fn bit(self) -> u16 {
        match self {
            Self::One => 0x1000,
            Self::Two => 0x2000,
        }
    }
}

/// The cameras that commands tell apart.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum CameraRole {
    PitchYaw,
    Roll,
    Moon,
}

impl CameraRole {
    pub const COUNT: usize = 3;
}

/// What a command does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Action {
    NoOp,
    StartSending,
    StopSending,
    Quit,
    SendPicture(CameraRole),
    /// Sets settings by their dotted keys, each to the variable of its place, or all to the only one.
    Set(&'static [&'static str]),
    /// Sets the parameter that has the first variable as its number to the second.
    SetNumbered,
    /// Returns what commands have set to the configuration.
    ResetValues,
    /// Reads a setting, or what else has a dotted key.
    Read(&'static str),
    /// Reads the parameter that has the variable as its number.
    ReadNumbered,
    /// Reads how full the disk is that has the variable as its number, from 1.
    ReadDisk,
}

impl Action {
    /// Whether the flight is another one after it: all but reading and asking for pictures.
    pub fn changes_flight(self) -> bool {
        match self {
            NoOp | SendPicture(_) | Read(_) | ReadNumbered | ReadDisk => false,
            StartSending | StopSending | Quit | Set(_) | SetNumbered | ResetValues => true,
        }
    }
}

/// How a number travels in the 16 bits of a variable or a result.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Kind {
    /// As it is, from 0 to 65535.
    Unsigned,
    /// As it is, from -32768 to 32767.
    Signed,
    /// As an angle code: in steps of 1/8 from -1024 to 7167.875.
    Angle,
    /// 1 for on, 0 for off.
    Switch,
}

impl Kind {
    /// The 16 bits of a number in its natural unit; `None` where they cannot hold it.
    pub fn code(self, value: f64) -> Option<u16> {
        let whole = |low: f64, high: f64| {
            let fits = value.fract() == 0.0 && (low..=high).contains(&value);
            fits.then_some(value as i32 as u16)
        };
        match self {
            Self::Unsigned => whole(0.0, u16::MAX.into()),
            Self::Signed => whole(i16::MIN.into(), i16::MAX.into()),
            Self::Angle => angle_code(value).filter(|code| angle_from_code(*code) == value),
            Self::Switch => whole(0.0, 1.0),
        }
    }

    /// The 16 bits of the nearest number that they can hold: what a read tells.
    pub fn nearest_code(self, value: f64) -> Option<u16> {
        match self {
            Self::Unsigned | Self::Switch => Some(value.round() as u16),
            Self::Signed => Some((value.round() as i16).cast_unsigned()),
            Self::Angle => angle_code(value),
        }
    }

    /// The number that 16 bits stand for.
    pub fn value(self, code: u16) -> f64 {
        match self {
            Self::Unsigned | Self::Switch => code.into(),
            Self::Signed => code.cast_signed().into(),
            Self::Angle => angle_from_code(code),
        }
    }

    /// The 16 bits as a number.
    pub fn number(self) -> Number {
        match self {
            Self::Unsigned | Self::Angle | Self::Switch => Number::U16,
            Self::Signed => Number::I16,
        }
    }

    /// What the number may be, in words.
    pub fn range(self) -> &'static str {
        match self {
            Self::Unsigned => "a whole number from 0 to 65535",
            Self::Signed => "a whole number from -32768 to 32767",
            Self::Angle => "a number from -1024 to 7167.875 in steps of 0.125",
            Self::Switch => "1 (on) or 0 (off)",
        }
    }

    fn name(self) -> &'static str {
        match self {
            Self::Unsigned => "u16",
            Self::Signed => "i16",
            Self::Angle => "angle code",
            Self::Switch => "1 on, 0 off",
        }
    }
}

/// A number that travels with a command or comes back as its result.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Variable {
    pub name: &'static str,
    pub kind: Kind,
    /// Empty for counts, switches and the cameras' own scales.
    pub unit: &'static str,
}

impl std::fmt::Display for Variable {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { name, kind, unit } = self;
        match unit.is_empty() {
            true => write!(out, "{name} ({})", kind.name()),
            false => write!(out, "{name} ({}, {unit})", kind.name()),
        }
    }
}

/// A command the ground may send.
#[derive(Debug, PartialEq, Eq)]
pub struct CommandRow {
    /// Without the computers' bits.
    pub key: u16,
    pub name: &'static str,
    pub variables: &'static [Variable],
    pub action: Action,
    /// What its result is where it is a read.
    pub reads: Option<Variable>,
    pub documentation: &'static str,
}

impl CommandRow {
    /// The command as it travels, for one computer; the row's variables in order.
    pub fn command(
        &self,
        computer: Computer,
        variables: &[u16],
    ) -> Result<AspectCommand, MessageError> {
        AspectCommand::new(computer.bit() | self.key, variables.to_vec())
    }
}

const fn number(name: &'static str, kind: Kind, unit: &'static str) -> Variable {
    Variable { name, kind, unit }
}

const fn set(
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

const fn get(
    key: u16,
    name: &'static str,
    variables: &'static [Variable],
    reads: Variable,
    action: Action,
    documentation: &'static str,
) -> CommandRow {
    CommandRow {
        key,
        name,
        variables,
        action,
        reads: Some(reads),
        documentation,
    }
}

const SWITCH: Variable = number("state", Kind::Switch, "");
const EXPOSURE: Variable = number("exposure", Kind::Unsigned, "us");
const ANALOGUE: Variable = number("gain", Kind::Unsigned, "");
const PREAMP: Variable = number("gain", Kind::Signed, "");
const ANGLE: Variable = number("angle", Kind::Angle, "deg");
const LATITUDE: Variable = number("latitude", Kind::Angle, "deg");
const LONGITUDE: Variable = number("longitude", Kind::Angle, "deg");
const X: Variable = number("x", Kind::Signed, "arcsec");
const Y: Variable = number("y", Kind::Signed, "arcsec");
const PARAMETER: Variable = number("parameter", Kind::Unsigned, "");
const INTEGER: Variable = number("value", Kind::Signed, "");
const FLOAT: Variable = number("value", Kind::Angle, "");
const DISK: Variable = number("disk", Kind::Unsigned, "");
const PERCENT: Variable = number("use", Kind::Unsigned, "%");
const MICROSECONDS: Variable = number("offset", Kind::Signed, "us");

/// Every command that is known, in the order of the keys.
#[rustfmt::skip] // One row, one line.
pub const COMMANDS: &[CommandRow] = &[
    set(0x0000, "no_op", &[], NoOp, "do nothing but answer"),
    set(0x0030, "start_sending", &[], StartSending, "start sending solutions to the controller, from the next exposure on"),
    set(0x0040, "stop_sending", &[], StopSending, "stop sending solutions to the controller, after the one that has been announced"),
    set(0x0050, "quit", &[], Quit, "end the flight program"),
    set(0x0210, "send_pitch_yaw_picture", &[], SendPicture(PitchYaw), "send the pitch-yaw camera's next picture to the ground"),
    set(0x0220, "send_roll_picture", &[], SendPicture(Roll), "send the roll camera's next picture to the ground"),
    set(0x0230, "send_moon_picture", &[], SendPicture(Moon), "send the Moon camera's next picture to the ground"),
    set(0x0412, "set_target", &[X, Y], Set(&["target.x_arcsec", "target.y_arcsec"]), "point at this helioprojective position"),
    set(0x0421, "store_frames", &[SWITCH], Set(&["store.pitch_yaw", "store.roll", "store.moon"]), "store the frames of all cameras"),
    set(0x0431, "accept_gps", &[SWITCH], Set(&["gps.accept"]), "take the gondola's place from GPS messages"),
    set(0x0441, "store_pitch_yaw_frames", &[SWITCH], Set(&["store.pitch_yaw"]), "store the frames of the pitch-yaw camera"),
    set(0x0451, "set_pitch_yaw_exposure", &[EXPOSURE], Set(&["camera.exposure_us"]), "set the pitch-yaw camera's exposure"),
    set(0x0481, "set_pitch_yaw_analogue_gain", &[ANALOGUE], Set(&["camera.analogue_gain"]), "set the pitch-yaw camera's analogue gain"),
    set(0x0491, "set_pitch_yaw_preamp_gain", &[PREAMP], Set(&["camera.preamp_gain"]), "set the pitch-yaw camera's pre-amplifier gain"),
    set(0x0541, "store_roll_frames", &[SWITCH], Set(&["store.roll"]), "store the frames of the roll camera"),
    set(0x0551, "set_roll_exposure", &[EXPOSURE], Set(&["roll_camera.exposure_us"]), "set the roll camera's exposure"),
    set(0x0581, "set_roll_analogue_gain", &[ANALOGUE], Set(&["roll_camera.analogue_gain"]), "set the roll camera's analogue gain"),
    set(0x0591, "set_roll_preamp_gain", &[PREAMP], Set(&["roll_camera.preamp_gain"]), "set the roll camera's pre-amplifier gain"),
    set(0x05A1, "store_moon_frames", &[SWITCH], Set(&["store.moon"]), "store the frames of the Moon camera"),
    set(0x05B1, "set_moon_exposure", &[EXPOSURE], Set(&["moon_camera.exposure_us"]), "set the Moon camera's exposure"),
    set(0x0621, "set_clocking", &[ANGLE], Set(&["mounting.clocking_deg"]), "set the plate's clocking"),
    set(0x06A2, "set_place", &[LATITUDE, LONGITUDE], Set(&["site.latitude_deg", "site.longitude_deg"]), "set the gondola's place"),
    set(0x0712, "set_integer", &[PARAMETER, INTEGER], SetNumbered, "set an integer parameter"),
    set(0x0722, "set_float", &[PARAMETER, FLOAT], SetNumbered, "set a float parameter"),
    set(0x0731, "set_twist", &[ANGLE], Set(&["mounting.twist_deg"]), "set the camera's twist"),
    set(0x0740, "reset_values", &[], ResetValues, "return every value that commands have set to the configuration's; sending, tracking and the GPS fix stay"),
    get(0x0850, "get_pitch_yaw_exposure", &[], EXPOSURE, Read("camera.exposure_us"), "read the pitch-yaw camera's exposure"),
    get(0x0860, "get_pitch_yaw_analogue_gain", &[], ANALOGUE, Read("camera.analogue_gain"), "read the pitch-yaw camera's analogue gain"),
    get(0x0870, "get_pitch_yaw_preamp_gain", &[], PREAMP, Read("camera.preamp_gain"), "read the pitch-yaw camera's pre-amplifier gain"),
    get(0x0881, "get_disk_use", &[DISK], PERCENT, ReadDisk, "read how full a disk of the archive is; the first is 1"),
    get(0x0950, "get_roll_exposure", &[], EXPOSURE, Read("roll_camera.exposure_us"), "read the roll camera's exposure"),
    get(0x0960, "get_roll_analogue_gain", &[], ANALOGUE, Read("roll_camera.analogue_gain"), "read the roll camera's analogue gain"),
    get(0x0970, "get_roll_preamp_gain", &[], PREAMP, Read("roll_camera.preamp_gain"), "read the roll camera's pre-amplifier gain"),
    get(0x0980, "get_moon_exposure", &[], EXPOSURE, Read("moon_camera.exposure_us"), "read the Moon camera's exposure"),
    get(0x0A10, "get_target_x", &[], X, Read("target.x_arcsec"), "read the target's x"),
    get(0x0A20, "get_target_y", &[], Y, Read("target.y_arcsec"), "read the target's y"),
    get(0x0B11, "get_integer", &[PARAMETER], INTEGER, ReadNumbered, "read an integer parameter"),
    get(0x0B21, "get_float", &[PARAMETER], FLOAT, ReadNumbered, "read a float parameter"),
    get(0x0B30, "get_twist", &[], ANGLE, Read("mounting.twist_deg"), "read the camera's twist"),
    get(0x0C20, "get_clocking", &[], ANGLE, Read("mounting.clocking_deg"), "read the plate's clocking"),
    get(0x0CA0, "get_latitude", &[], LATITUDE, Read("site.latitude_deg"), "read the gondola's latitude"),
    get(0x0CB0, "get_longitude", &[], LONGITUDE, Read("site.longitude_deg"), "read the gondola's longitude"),
    get(0x0D10, "get_clock_offset", &[], MICROSECONDS, Read("clock.offset_us"), "read the clock's offset"),
];

/// The row of a key, whatever its computers' bits.
pub fn row_of(key: u16) -> Option<&'static CommandRow> {
    COMMANDS.iter().find(|row| row.key == key & !COMPUTERS)
}

/// The row of a name.
pub fn row_named(name: &str) -> Option<&'static CommandRow> {
    COMMANDS.iter().find(|row| row.name == name)
}
