//! The commands of the ground: one table, and what a command of it means.
//!
//! A key's top 4 bits name the computers it is for, its low 4 bits the number of its variables; the table leaves
//! the computers out. Source: HEROES flight program, 2013.

use super::message::{AspectCommand, MessageError};

/// The bits of a key that name computers.
const COMPUTERS: u16 = 0xF000;

/// One of the two computers of the aspect system.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Computer {
    One,
    Two,
}

impl Computer {
    /// Whether a command with this key is for this computer. One may be for both, or for none.
    pub fn is_addressed_by(self, key: u16) -> bool {
        let bit = match self {
            Self::One => 0x1000,
            Self::Two => 0x2000,
        };
        key & bit != 0
    }
}

/// A command the ground may send.
#[derive(Debug, PartialEq, Eq)]
pub struct CommandRow {
    /// Without the computers' bits.
    pub key: u16,
    pub name: &'static str,
    /// The variables, each a u16 unless its text says otherwise.
    pub variables: &'static [&'static str],
    pub documentation: &'static str,
}

const NO_OP: u16 = 0x0000;
const START_SENDING: u16 = 0x0030;
const STOP_SENDING: u16 = 0x0040;
const SET_TARGET: u16 = 0x0412;

const fn row(
    key: u16,
    name: &'static str,
    variables: &'static [&'static str],
    documentation: &'static str,
) -> CommandRow {
    CommandRow {
        key,
        name,
        variables,
        documentation,
    }
}

/// Every command that is known, in the order of the keys.
#[rustfmt::skip] // One row, one line.
pub const COMMANDS: &[CommandRow] = &[
    row(NO_OP, "no_op", &[], "do nothing but answer"),
    row(START_SENDING, "start_sending", &[], "start sending solutions to the controller"),
    row(STOP_SENDING, "stop_sending", &[], "stop sending solutions to the controller"),
    row(0x0050, "quit", &[], "end the flight program"),
    row(0x0210, "send_pitch_yaw_picture", &[], "send a picture of the pitch-yaw camera to the ground"),
    row(0x0220, "send_roll_picture", &[], "send a picture of the roll camera to the ground"),
    row(SET_TARGET, "set_target", &["x (i16, arcsec)", "y (i16, arcsec)"], "point at this helioprojective position"),
    row(0x0421, "store_frames", &["on (1), off (0)"], "store the frames of both cameras"),
    row(0x0431, "accept_gps", &["on (1), off (0)"], "take the gondola's place from GPS messages"),
    row(0x0441, "store_pitch_yaw_frames", &["on (1), off (0)"], "store the frames of the pitch-yaw camera"),
    row(0x0451, "set_pitch_yaw_exposure", &["exposure (us)"], "set the pitch-yaw camera's exposure"),
    row(0x0481, "set_pitch_yaw_analogue_gain", &["gain"], "set the pitch-yaw camera's analogue gain"),
    row(0x0491, "set_pitch_yaw_preamp_gain", &["gain (i16)"], "set the pitch-yaw camera's pre-amplifier gain"),
    row(0x0541, "store_roll_frames", &["on (1), off (0)"], "store the frames of the roll camera"),
    row(0x0551, "set_roll_exposure", &["exposure (us)"], "set the roll camera's exposure"),
    row(0x0581, "set_roll_analogue_gain", &["gain"], "set the roll camera's analogue gain"),
    row(0x0591, "set_roll_preamp_gain", &["gain (i16)"], "set the roll camera's pre-amplifier gain"),
    row(0x0621, "set_clocking", &["angle (angle code, deg)"], "set the plate's clocking"),
    row(0x06A2, "set_place", &["latitude (angle code, deg)", "longitude (angle code, deg)"], "set the gondola's place"),
    row(0x0712, "set_integer", &["parameter", "value (i16)"], "set an integer parameter"),
    row(0x0722, "set_float", &["parameter", "value (angle code)"], "set a float parameter"),
    row(0x0731, "set_twist", &["angle (angle code, deg)"], "set the camera's twist"),
    row(0x0850, "get_pitch_yaw_exposure", &[], "read the pitch-yaw camera's exposure (us)"),
    row(0x0860, "get_pitch_yaw_analogue_gain", &[], "read the pitch-yaw camera's analogue gain"),
    row(0x0870, "get_pitch_yaw_preamp_gain", &[], "read the pitch-yaw camera's pre-amplifier gain (i16)"),
    row(0x0881, "get_disk_use", &["disk"], "read how full a disk is (%)"),
    row(0x0950, "get_roll_exposure", &[], "read the roll camera's exposure (us)"),
    row(0x0960, "get_roll_analogue_gain", &[], "read the roll camera's analogue gain"),
    row(0x0970, "get_roll_preamp_gain", &[], "read the roll camera's pre-amplifier gain (i16)"),
    row(0x0A10, "get_target_x", &[], "read the target's x (i16, arcsec)"),
    row(0x0A20, "get_target_y", &[], "read the target's y (i16, arcsec)"),
    row(0x0B11, "get_integer", &["parameter"], "read an integer parameter (i16)"),
    row(0x0B21, "get_float", &["parameter"], "read a float parameter (angle code)"),
    row(0x0B30, "get_twist", &[], "read the camera's twist (angle code, deg)"),
    row(0x0C20, "get_clocking", &[], "read the plate's clocking (angle code, deg)"),
    row(0x0CA0, "get_latitude", &[], "read the gondola's latitude (angle code, deg)"),
    row(0x0CB0, "get_longitude", &[], "read the gondola's longitude (angle code, deg)"),
    row(0x0D10, "get_clock_offset", &[], "read the clock's offset (i16, us)"),
];

/// The row of a key, whatever its computers' bits.
pub fn row_of(key: u16) -> Option<&'static CommandRow> {
    COMMANDS.iter().find(|row| row.key == key & !COMPUTERS)
}

/// What a command asks for.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Command {
    NoOp,
    StartSending,
    StopSending,
    /// Point at this helioprojective position: x to solar west, y to solar north.
    SetTarget {
        x_arcsec: i16,
        y_arcsec: i16,
    },
    /// A command of the table that this program does not carry out.
    NotImplemented(&'static CommandRow),
}

/// Why a command is not one of the table.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum CommandError {
    #[error("aspect command: expected a key of the command table, found {key:#06x}")]
    Unknown { key: u16 },
}

impl TryFrom<&AspectCommand> for Command {
    type Error = CommandError;

    fn try_from(command: &AspectCommand) -> Result<Self, CommandError> {
        let key = command.key();
        let row = row_of(key).ok_or(CommandError::Unknown { key })?;
        Ok(match (row.key, command.variables()) {
            (NO_OP, _) => Self::NoOp,
            (START_SENDING, _) => Self::StartSending,
            (STOP_SENDING, _) => Self::StopSending,
            (SET_TARGET, &[x, y]) => Self::SetTarget {
                x_arcsec: x.cast_signed(),
                y_arcsec: y.cast_signed(),
            },
            _ => Self::NotImplemented(row),
        })
    }
}

impl CommandRow {
    /// The command as it travels, for one computer; the row's variables in order.
    pub fn command(
        &self,
        computer: Computer,
        variables: &[u16],
    ) -> Result<AspectCommand, MessageError> {
        let bits = match computer {
            Computer::One => 0x1000,
            Computer::Two => 0x2000,
        };
        AspectCommand::new(bits | self.key, variables.to_vec())
    }
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

    #[test]
    fn the_page_on_the_protocol_holds_every_command() {
        let page = include_str!("../../docs/protocol.md");
        for row in COMMANDS {
            let variables = row.variables.join("; ");
            let line = format!(
                "| 0x{:04X} | `{}` | {variables} | {} |",
                row.key, row.name, row.documentation
            );
            assert!(page.contains(&line), "missing: {line}");
        }
    }
}
