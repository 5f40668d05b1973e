//! The ground's commands in flight: one table of commands, their settings, and their description in words.
//!
//! To add a command, add a row to the [table](COMMANDS). It sets or reads a parameter of the configuration, or a [setting] that
//! only commands have; a command with a new effect needs an [`Action`], too.
//!
//! A key's top 4 bits select the computers it is for, its low 4 bits give the number of its variables; the table omits
//! the computers. Source: HEROES flight program, 2013.

pub mod controls;
mod dictionary;
mod note;
pub mod order;
mod protocol;
pub mod setting;
mod table;
mod text;
mod variable;
pub mod words;

pub use controls::Controls;
pub use dictionary::{Dictionary, Framing};
pub use note::CommandNote;
pub use order::{OrderError, order};
pub use protocol::protocol_page;
pub use table::{Action, COMMANDS, CommandRow, row_of};
pub use variable::{Kind, Variable};

use crate::link::AspectCommand;
use setting::Setting;

/// A command of the table, with its variables in natural units.
#[derive(Debug, Clone, PartialEq)]
pub struct Command {
    pub row: &'static CommandRow,
    /// As many as the row has variables.
    pub numbers: Vec<f64>,
}

impl Command {
    /// Settings of its variables, with kind and number of each.
    pub fn settings(&self) -> impl Iterator<Item = (Setting, Kind, f64)> {
        let variables = self.row.variables.iter().zip(&self.numbers);
        variables.flat_map(|(variable, number)| {
            let settings = variable.settings.iter();
            settings.map(|setting| (*setting, variable.kind, *number))
        })
    }
}

/// Reason why a command is not in the table.
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
        let row = row_of(key).ok_or(CommandError::Unknown { key })?;
        // A command has as many variables as its key states, so a key of the table has all of its row's.
        let codes = row.variables.iter().zip(command.variables());
        let number = |(variable, code): (&Variable, &u16)| match (variable.kind, *code) {
            (Kind::Switch, found @ 2..) => Err(CommandError::Switch { key, found }),
            (kind, code) => Ok(kind.value(code)),
        };
        let numbers = codes.map(number).collect::<Result<_, _>>()?;
        Ok(Self { row, numbers })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::link::Computer;
    use crate::link::computer::COMPUTERS;
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
            assert_eq!(command.unwrap().row, row);
            let reads = matches!(
                row.action,
                Action::Read | Action::ReadNumbered | Action::ReadDisk
            );
            assert_eq!(reads, row.reads.is_some(), "{}", row.name);
            let sets = row.variables.iter().any(|v| !v.settings.is_empty());
            assert_eq!(row.action == Action::Set, sets, "{}", row.name);
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
        // Between two steps: it is refused, as otherwise another value would be set.
        assert_eq!(Kind::Angle.code(0.26), None);
        assert_eq!(Kind::Angle.nearest_code(0.26), Kind::Angle.code(0.25));
    }

    #[test]
    fn a_switch_is_on_or_off_and_nothing_else() {
        let set = |state| Command::try_from(&AspectCommand::new(0x1431, vec![state]).unwrap());
        let numbers = |state| set(state).map(|command| command.numbers);
        assert_eq!(numbers(1), Ok(vec![1.0]));
        assert_eq!(numbers(0), Ok(vec![0.0]));
        let (key, found) = (0x1431, 2);
        assert_eq!(set(2), Err(CommandError::Switch { key, found }));
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
