//! Execution of commands.

use super::{Controls, State};
use crate::commands::setting::{
    CLOCK_OFFSET, CLOCKING, LATITUDE, LONGITUDE, SITE_LATITUDE, SITE_LONGITUDE, Setting, TWIST,
};
use crate::commands::{Action, Command, CommandError, Kind, row_of};
use crate::config::{Allowed, Parameter, Value, by_command, by_key};
use crate::instrument::Role;
use crate::link::{AspectCommand, Carried, CommandResult, Control, GpsFix, MoonRequest};
use crate::log::worth_a_line;
use std::sync::atomic::Ordering;

impl Control for Controls {
    fn knows(&self, key: u16) -> bool {
        row_of(key).is_some()
    }

    fn carry_out(&mut self, command: &AspectCommand) -> Carried {
        let command = match Command::try_from(command) {
            Ok(command) => command,
            Err(CommandError::Switch { .. }) => return CommandResult::Refused.into(),
            Err(CommandError::Unknown { .. }) => return CommandResult::Unknown.into(),
        };
        match command.row.action {
            Action::StartSending => Carried::StartSending,
            Action::StopSending => Carried::StopSending,
            _ => self.execute(&command).into(),
        }
    }

    fn take_reason(&mut self) -> Option<String> {
        self.state().reason.take()
    }

    fn request_moon(&mut self, request: &MoonRequest) -> CommandResult {
        let mut state = self.state();
        if !state.cameras.contains(&Role::Moon) {
            return CommandResult::NotImplemented;
        }
        match request.place() {
            Ok(_) => CommandResult::Done,
            Err(wrong) => {
                state.reason = Some(wrong.to_string());
                CommandResult::Refused
            }
        }
    }

    fn take_fix(&mut self, fix: GpsFix) -> CommandResult {
        let accepted = self.state().own.accepts_gps;
        let reason = match accepted {
            false => Some("GPS is not accepted"),
            true => (!self.accepts(fix)).then_some("not believed"),
        };
        if let Some(reason) = reason {
            self.state().reason = Some(reason.into());
            return CommandResult::Refused;
        }
        self.move_to(fix)
    }
}

impl Controls {
    /// Executes commands that go beyond the conversation.
    fn execute(&self, command: &Command) -> CommandResult {
        match command.row.action {
            Action::NoOp => CommandResult::Done,
            // Commands of the conversation itself are executed elsewhere.
            Action::StartSending | Action::StopSending => CommandResult::NotImplemented,
            Action::Quit => {
                self.0.quit_requested.store(true, Ordering::Relaxed);
                CommandResult::Done
            }
            Action::SendPicture(role) => self.want_picture(role),
            Action::Set => self.set_by_command(command.settings()),
            Action::SetNumbered => self.set_numbered(command),
            Action::ResetValues => {
                let reset = self.reset();
                tracing::warn!(values = reset, "returned to the configuration by command");
                CommandResult::Done
            }
            Action::Read | Action::ReadNumbered | Action::ReadDisk => {
                let read = self.state().read(command);
                let code = command.row.reads.zip(read);
                code.and_then(|(reads, number)| reads.kind.nearest_code(number))
                    .map_or(CommandResult::Unknown, CommandResult::Value)
            }
        }
    }

    /// Takes an accepted place. It is saved together with the next changed values: a fix each second is no reason to write a file each second.
    pub(super) fn move_to(&self, fix: GpsFix) -> CommandResult {
        match self.apply(&[
            (LATITUDE.key(), Value::Number(fix.latitude_deg.into())),
            (LONGITUDE.key(), Value::Number(fix.longitude_deg.into())),
        ]) {
            Ok(_) => CommandResult::Done,
            Err(_) => CommandResult::Refused,
        }
    }

    pub(super) fn accepts(&self, fix: GpsFix) -> bool {
        let mut state = self.state();
        let accepted = state.gps.accepts(fix);
        let refused = state.gps.refused();
        drop(state);
        if !accepted && worth_a_line(refused) {
            let (latitude_deg, longitude_deg) = (fix.latitude_deg, fix.longitude_deg);
            tracing::warn!(
                latitude_deg,
                longitude_deg,
                refused,
                "a GPS fix was rejected as implausible"
            );
        }
        accepted
    }

    /// Sets keys to received numbers. A number equal to the one that a read returns leaves the value unchanged: it may lie between the
    /// numbers that can be sent.
    fn set_by_command(
        &self,
        settings: impl Iterator<Item = (Setting, Kind, f64)>,
    ) -> CommandResult {
        let state = self.state().clone();
        let stands = |(setting, kind, number): &(Setting, Kind, f64)| {
            let now = state.value(*setting);
            now.is_some_and(|now| *number != now && kind.nearest_code(now) == kind.code(*number))
        };
        let settings: Vec<(&str, Value)> = settings
            .filter(|setting| !stands(setting))
            .map(|(setting, kind, number)| (setting.key(), value(kind, number)))
            .collect();
        match self.set(&settings) {
            Ok(()) => {
                // The same value again changes nothing, and must not fill the log.
                let before = |key| state.commanded.get(key);
                for (key, value) in settings.iter().filter(|s| before(s.0) != Some(&s.1)) {
                    tracing::info!(key, %value, "set by command");
                }
                CommandResult::Done
            }
            Err(refused) => {
                let times = self.count_refusal(&refused.key);
                self.state().reason = Some(refused.to_string());
                if worth_a_line(times) {
                    tracing::warn!(%refused, times, "a command was refused");
                }
                CommandResult::Refused
            }
        }
    }

    /// Counts a refusal of the key; returns the number so far.
    fn count_refusal(&self, key: &str) -> u64 {
        let mut state = self.state();
        let times = state.refusals.entry(key.into()).or_default();
        *times += 1;
        *times
    }

    /// Sets a parameter by its number, if the parameter has the command's kind.
    fn set_numbered(&self, command: &Command) -> CommandResult {
        if let [number, set] = command.numbers[..]
            && let [_, variable] = command.row.variables
            && let Some(parameter) = numbered(number, variable.kind)
        {
            let setting = Setting::new(parameter.key);
            return self.set_by_command(std::iter::once((setting, variable.kind, set)));
        }
        self.state().reason = Some("no parameter of this number and type".into());
        CommandResult::Refused
    }

    fn want_picture(&self, role: Role) -> CommandResult {
        if !self.state().cameras.contains(&role) {
            return CommandResult::NotImplemented;
        }
        self.0.pictures[role as usize].store(true, Ordering::Relaxed);
        CommandResult::Done
    }
}

/// A number as a value for a setting.
fn value(kind: Kind, number: f64) -> Value {
    match kind {
        Kind::Angle => Value::Number(number),
        Kind::Unsigned | Kind::Signed | Kind::Switch => Value::Whole(number as i64),
    }
}

/// The parameter with this number, if its values can be sent in this kind.
fn numbered(number: f64, kind: Kind) -> Option<&'static Parameter> {
    let parameter = by_command(number as u16)?;
    let fits = match kind {
        Kind::Angle => matches!(parameter.allowed, Allowed::Number(..)),
        _ => matches!(parameter.allowed, Allowed::Whole(..)),
    };
    fits.then_some(parameter)
}

impl State {
    /// Value of a reading command, in natural units; `None` if it is not known.
    fn read(&self, command: &Command) -> Option<f64> {
        let number = command.numbers.first().copied();
        match command.row.action {
            Action::Read => self.value(*command.row.reads?.settings.first()?),
            Action::ReadNumbered => {
                let kind = command.row.reads?.kind;
                self.value(Setting::new(numbered(number?, kind)?.key))
            }
            Action::ReadDisk => {
                let at = (number? as usize).checked_sub(1)?;
                (*self.disks.get(at)?).map(f64::from)
            }
            _ => None,
        }
    }

    /// The number of a readable setting.
    fn value(&self, setting: Setting) -> Option<f64> {
        match setting {
            TWIST => self
                .own
                .twist_deg
                .or(self.stated.map(|stated| stated.twist_deg)),
            CLOCKING => {
                let stated = self.stated.map(|stated| stated.clocking_deg.value);
                self.own.clocking_deg.or(stated)
            }
            // The place that GPS may have overridden.
            SITE_LATITUDE => Some(self.place?.latitude_deg),
            SITE_LONGITUDE => Some(self.place?.longitude_deg),
            CLOCK_OFFSET => self.clock_offset_us.map(|us| us as f64),
            setting => match by_key(setting.key())?.get(&self.config)? {
                Value::Whole(value) => Some(value as f64),
                Value::Number(value) => Some(value),
                Value::Text(_) => None,
            },
        }
    }
}
