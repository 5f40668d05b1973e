//! The commands of the ground: one table, and what a command of it means.
//!
//! A key's top 4 bits name the computers it is for, its low 4 bits the number of its variables; the table leaves
//! the computers out. Source: HEROES flight program, 2013.

mod table;

pub use table::{COMMANDS, CommandRow, Kind, Variable, row_named, row_of};

use super::code::angle_from_code;
use super::message::AspectCommand;
use table::COMPUTERS;

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

    pub(super) fn bit(self) -> u16 {
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
}

/// What a command asks for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Command {
    NoOp,
    StartSending,
    StopSending,
    Quit,
    SendPicture(CameraRole),
    /// Point at this helioprojective position: x to solar west, y to solar north.
    SetTarget {
        x_arcsec: i16,
        y_arcsec: i16,
    },
    StoreFrames {
        cameras: &'static [CameraRole],
        on: bool,
    },
    AcceptGps {
        on: bool,
    },
    SetCamera(CameraRole, CameraSetting),
    SetClocking {
        angle_deg: f64,
    },
    SetTwist {
        angle_deg: f64,
    },
    SetPlace {
        latitude_deg: f64,
        longitude_deg: f64,
    },
    SetInteger {
        parameter: u16,
        value: i16,
    },
    SetFloat {
        parameter: u16,
        value: f64,
    },
    Read(Reading),
}

/// A camera's setting with its value.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CameraSetting {
    ExposureUs(u16),
    AnalogueGain(u16),
    PreampGain(i16),
}

/// What a command reads.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Reading {
    /// us
    Exposure(CameraRole),
    AnalogueGain(CameraRole),
    PreampGain(CameraRole),
    /// %, of a disk that is counted from 1.
    DiskUse(u16),
    TargetX,
    TargetY,
    Integer(u16),
    Float(u16),
    Twist,
    Clocking,
    Latitude,
    Longitude,
    ClockOffset,
}

/// Why a command is not one of the table.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum CommandError {
    #[error("aspect command: expected a key of the command table, found {key:#06x}")]
    Unknown { key: u16 },
    #[error("aspect command {key:#06x}: expected 1 (on) or 0 (off), found {found}")]
    Switch { key: u16, found: u16 },
}

impl TryFrom<&AspectCommand> for Command {
    type Error = CommandError;

    fn try_from(command: &AspectCommand) -> Result<Self, CommandError> {
        let key = command.key();
        let variables = Variables { key, command };
        match key & !COMPUTERS {
            0x0000 => Ok(Self::NoOp),
            0x0030 => Ok(Self::StartSending),
            0x0040 => Ok(Self::StopSending),
            0x0050 => Ok(Self::Quit),
            0x0210 => Ok(Self::SendPicture(CameraRole::PitchYaw)),
            0x0220 => Ok(Self::SendPicture(CameraRole::Roll)),
            0x0800.. => {
                let number = command.variables().first().copied();
                let reading = reading(key, number.unwrap_or_default());
                Ok(Self::Read(reading.ok_or(CommandError::Unknown { key })?))
            }
            _ => setting(&variables),
        }
    }
}

/// The variables of a command, each as what it stands for.
struct Variables<'a> {
    key: u16,
    command: &'a AspectCommand,
}

impl Variables<'_> {
    /// A command has as many variables as its key says, so a key of the table has all of its row's.
    fn u16(&self, at: usize) -> Result<u16, CommandError> {
        let key = self.key;
        let variable = self.command.variables().get(at);
        variable.copied().ok_or(CommandError::Unknown { key })
    }

    fn i16(&self, at: usize) -> Result<i16, CommandError> {
        self.u16(at).map(u16::cast_signed)
    }

    fn angle(&self, at: usize) -> Result<f64, CommandError> {
        self.u16(at).map(angle_from_code)
    }

    fn switch(&self) -> Result<bool, CommandError> {
        match self.u16(0)? {
            0 => Ok(false),
            1 => Ok(true),
            found => Err(CommandError::Switch {
                key: self.key,
                found,
            }),
        }
    }
}

fn setting(v: &Variables) -> Result<Command, CommandError> {
    use CameraRole::{PitchYaw, Roll};
    use CameraSetting::{AnalogueGain, ExposureUs, PreampGain};
    Ok(match v.key & !COMPUTERS {
        0x0412 => Command::SetTarget {
            x_arcsec: v.i16(0)?,
            y_arcsec: v.i16(1)?,
        },
        0x0421 => store(&[PitchYaw, Roll], v.switch()?),
        0x0431 => Command::AcceptGps { on: v.switch()? },
        0x0441 => store(&[PitchYaw], v.switch()?),
        0x0451 => Command::SetCamera(PitchYaw, ExposureUs(v.u16(0)?)),
        0x0481 => Command::SetCamera(PitchYaw, AnalogueGain(v.u16(0)?)),
        0x0491 => Command::SetCamera(PitchYaw, PreampGain(v.i16(0)?)),
        0x0541 => store(&[Roll], v.switch()?),
        0x0551 => Command::SetCamera(Roll, ExposureUs(v.u16(0)?)),
        0x0581 => Command::SetCamera(Roll, AnalogueGain(v.u16(0)?)),
        0x0591 => Command::SetCamera(Roll, PreampGain(v.i16(0)?)),
        0x0621 => Command::SetClocking {
            angle_deg: v.angle(0)?,
        },
        0x06A2 => Command::SetPlace {
            latitude_deg: v.angle(0)?,
            longitude_deg: v.angle(1)?,
        },
        0x0712 => Command::SetInteger {
            parameter: v.u16(0)?,
            value: v.i16(1)?,
        },
        0x0722 => Command::SetFloat {
            parameter: v.u16(0)?,
            value: v.angle(1)?,
        },
        0x0731 => Command::SetTwist {
            angle_deg: v.angle(0)?,
        },
        _ => return Err(CommandError::Unknown { key: v.key }),
    })
}

fn store(cameras: &'static [CameraRole], on: bool) -> Command {
    Command::StoreFrames { cameras, on }
}

/// What a key reads; `number` is its variable, where it has one.
fn reading(key: u16, number: u16) -> Option<Reading> {
    use CameraRole::{PitchYaw, Roll};
    Some(match key & !COMPUTERS {
        0x0850 => Reading::Exposure(PitchYaw),
        0x0860 => Reading::AnalogueGain(PitchYaw),
        0x0870 => Reading::PreampGain(PitchYaw),
        0x0881 => Reading::DiskUse(number),
        0x0950 => Reading::Exposure(Roll),
        0x0960 => Reading::AnalogueGain(Roll),
        0x0970 => Reading::PreampGain(Roll),
        0x0A10 => Reading::TargetX,
        0x0A20 => Reading::TargetY,
        0x0B11 => Reading::Integer(number),
        0x0B21 => Reading::Float(number),
        0x0B30 => Reading::Twist,
        0x0C20 => Reading::Clocking,
        0x0CA0 => Reading::Latitude,
        0x0CB0 => Reading::Longitude,
        0x0D10 => Reading::ClockOffset,
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::link::message::variable_count;

    #[test]
    fn every_key_states_the_number_of_its_variables_and_none_occurs_twice() {
        for (number, row) in COMMANDS.iter().enumerate() {
            assert_eq!(variable_count(row.key), row.variables.len(), "{}", row.name);
            assert_eq!(row.key & COMPUTERS, 0, "{}", row.name);
            let later = &COMMANDS[number + 1..];
            assert!(
                later
                    .iter()
                    .all(|other| other.key > row.key && other.name != row.name)
            );
        }
    }

    #[test]
    fn every_row_of_the_table_is_a_command_and_reads_what_it_says() {
        for row in COMMANDS {
            let zeros = vec![0; row.variables.len()];
            let command = Command::try_from(&row.command(Computer::One, &zeros).unwrap());
            let reads = matches!(command.unwrap(), Command::Read(_));
            assert_eq!(reads, row.reads.is_some(), "{}", row.name);
        }
    }

    #[test]
    fn every_number_survives_its_code() {
        for (kind, values) in [
            (Kind::Unsigned, [0.0, 65535.0, 7.0]),
            (Kind::Signed, [-32768.0, 32767.0, -1.0]),
            (Kind::Angle, [-1024.0, 7167.875, -32.375]),
            (Kind::Switch, [0.0, 1.0, 1.0]),
        ] {
            for value in values {
                assert_eq!(kind.value(kind.code(value).unwrap()), value);
            }
            for wrong in [1e6, -1e6, f64::NAN, f64::INFINITY] {
                assert_eq!(kind.code(wrong), None, "{kind:?} {wrong}");
            }
        }
        assert_eq!(Kind::Signed.code(0.5), None);
    }

    #[test]
    fn a_switch_is_on_or_off_and_nothing_else() {
        let set = |state| Command::try_from(&AspectCommand::new(0x1431, vec![state]).unwrap());
        assert_eq!(set(1), Ok(Command::AcceptGps { on: true }));
        assert_eq!(set(0), Ok(Command::AcceptGps { on: false }));
        let (key, found) = (0x1431, 2);
        assert_eq!(set(2), Err(CommandError::Switch { key, found }));
    }

    #[test]
    fn a_command_may_be_for_one_computer_for_both_or_for_none() {
        let both = [Computer::One, Computer::Two];
        let addressed = |key| both.map(|computer| computer.is_addressed_by(key));
        assert_eq!(addressed(0x1412), [true, false]);
        assert_eq!(addressed(0x2412), [false, true]);
        assert_eq!(addressed(0x3412), [true, true]);
        assert_eq!(addressed(0x0412), [false, false]);
        assert_eq!(addressed(0x4412), [false, false]);
    }

    #[test]
    fn a_command_outside_the_table_is_unknown() {
        let command = AspectCommand::new(0x1FF0, vec![]).unwrap();
        assert_eq!(
            Command::try_from(&command),
            Err(CommandError::Unknown { key: 0x1FF0 })
        );
    }
}
