//! The responder's requests to the flight service: to execute commands, and to take the gondola's place.

use super::message::{AspectCommand, GpsFix, MoonRequest};
use super::number::Codes;
use crate::units::is_nowhere;

/// Results of commands; a read answers with its value instead.
pub mod result {
    pub const DONE: u16 = 0;
    /// Known, but this program does not implement it, or its packet lacks variables.
    pub const NOT_IMPLEMENTED: u16 = 1;
    /// A value was out of range; nothing was changed.
    pub const REFUSED: u16 = 2;
    /// No such command; for a read, the requested value is not known.
    pub const UNKNOWN: u16 = 0xFFFF;
}

/// Results of commands that read nothing.
#[rustfmt::skip] // One row, one line.
pub static RESULTS: Codes = Codes { name: "result_code", rows: &[
    (result::DONE, "done", "done"),
    (result::NOT_IMPLEMENTED, "not_implemented", "not implemented, or the packet lacks variables"),
    (result::REFUSED, "refused", "a value is out of range, or there is no such parameter; nothing has changed"),
    (result::UNKNOWN, "unknown", "no such command; of a read: not known (no such parameter or disk, a gain that was never set)"),
] };

/// Result of a command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum CommandResult {
    Done,
    /// Value of a read.
    Value(u16),
    /// Out of range: nothing was changed.
    Refused,
    NotImplemented,
    /// No such command, or the value to be read is not known.
    Unknown,
}

impl CommandResult {
    /// The number that is sent.
    pub fn code(self) -> u16 {
        match self {
            Self::Done => result::DONE,
            Self::Value(value) => value,
            Self::Refused => result::REFUSED,
            Self::NotImplemented => result::NOT_IMPLEMENTED,
            Self::Unknown => result::UNKNOWN,
        }
    }
}

/// Result of a command.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Carried {
    Result(CommandResult),
    /// A change of the conversation, which the responder makes.
    StartSending,
    StopSending,
}

impl From<CommandResult> for Carried {
    fn from(result: CommandResult) -> Self {
        Self::Result(result)
    }
}

/// Executes commands that go beyond the conversation: it sets settings and reads values.
pub trait Control {
    /// Whether there is a command with this key, whatever its computers' bits.
    fn knows(&self, key: u16) -> bool;

    fn carry_out(&mut self, command: &AspectCommand) -> Carried;

    /// Reason why the last command was refused, if known; the call removes it.
    fn take_reason(&mut self) -> Option<String> {
        None
    }

    /// A place from GPS.
    fn take_fix(&mut self, fix: GpsFix) -> CommandResult;

    /// Takes a request for the Moon; the result says whether it will be answered.
    fn request_moon(&mut self, request: &MoonRequest) -> CommandResult;
}

/// A fix this far from the last one counts as an error, deg.
const LATITUDE_JUMP_DEG: f32 = 5.0;
const LONGITUDE_JUMP_DEG: f32 = 15.0;
/// Fixes within this of each other, in latitude and in longitude, agree, deg.
const AGREEMENT_DEG: f32 = 1.0;

impl GpsFix {
    /// Whether it is a place on Earth, and not that of a receiver without a fix.
    pub fn is_possible(self) -> bool {
        let on_earth = self.latitude_deg.abs() <= 90.0 && self.longitude_deg.abs() <= 360.0;
        on_earth && !is_nowhere(self.latitude_deg.into(), self.longitude_deg.into())
    }

    /// Whether it is no jump from the last fix, if there is one: a jump is an error of the receiver or of the line.
    pub fn may_follow(self, last: Option<Self>) -> bool {
        last.is_none_or(|last| self.is_within(last, LATITUDE_JUMP_DEG, LONGITUDE_JUMP_DEG))
    }

    /// Whether two fixes are of one place, to about a degree.
    pub fn agrees_with(self, other: Self) -> bool {
        self.is_within(other, AGREEMENT_DEG, AGREEMENT_DEG)
    }

    fn is_within(self, other: Self, latitude_deg: f32, longitude_deg: f32) -> bool {
        let longitude = (self.longitude_deg - other.longitude_deg).rem_euclid(360.0);
        (self.latitude_deg - other.latitude_deg).abs() <= latitude_deg
            && longitude.min(360.0 - longitude) <= longitude_deg
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_place_is_believed_unless_it_is_nowhere_or_a_jump() {
        let mut last = None;
        let mut fix = |latitude_deg, longitude_deg| {
            let fix = GpsFix {
                latitude_deg,
                longitude_deg,
            };
            let believed = fix.is_possible() && fix.may_follow(last);
            if believed {
                last = Some(fix);
            }
            believed
        };
        assert!(!fix(0.0, 0.0) && !fix(0.001, -0.002));
        assert!(!fix(91.0, 10.0));
        assert!(fix(34.49, -104.25), "the first place, where none is known");
        assert!(!fix(0.0, 0.0));
        assert!(!fix(39.6, -104.25), "5.1 deg north");
        assert!(!fix(34.49, -89.0), "15.25 deg east");
        assert!(fix(39.4, -90.0));
        assert!(
            fix(39.0, -76.0),
            "judged by the last place that was believed"
        );
        assert!(fix(39.0, 284.5), "the same meridian counted the other way");
    }
}
