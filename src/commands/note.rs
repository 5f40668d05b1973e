//! The command log: every command with its time, its sender and its result.

use super::words::CommandInWords;
use jiff::Timestamp;

/// A row of the command log.
#[derive(Debug, Clone, PartialEq)]
pub struct CommandNote {
    pub utc: Timestamp,
    /// The port from which it came, or the file.
    pub sender: String,
    pub command: CommandInWords,
    /// Its result.
    pub result: String,
}

impl CommandNote {
    pub const COLUMNS: [&'static str; 6] = ["utc", "sender", "key", "name", "values", "result"];

    /// A row with the present time.
    pub fn now(sender: impl ToString, command: CommandInWords, result: impl ToString) -> Self {
        Self {
            utc: Timestamp::now(),
            sender: sender.to_string(),
            command,
            result: result.to_string(),
        }
    }

    /// The fields of the columns; unknown values are empty.
    pub fn fields(&self) -> [String; 6] {
        let command = &self.command;
        [
            format!("{:.3}", self.utc),
            self.sender.clone(),
            command
                .key
                .map_or(String::new(), |key| format!("{key:#06x}")),
            command.name.clone(),
            command.values.clone(),
            self.result.clone(),
        ]
    }
}
