//! Commands become keys and values.

use super::own::{LATITUDE, LONGITUDE};
use super::{Controls, switch};
use crate::config::{Allowed, Value, by_command};
use crate::link::{CameraRole, CameraSetting, Command, CommandResult, Control, GpsFix};
use crate::service::tally::worth_a_line;
use std::sync::atomic::Ordering;

impl Control for Controls {
    fn carry_out(&mut self, command: &Command) -> CommandResult {
        let whole = |value: i64| Value::Whole(value);
        match *command {
            Command::NoOp => CommandResult::Done,
            // The responder's own.
            Command::StartSending | Command::StopSending => CommandResult::NotImplemented,
            Command::Quit => {
                self.0.quits.store(true, Ordering::Relaxed);
                CommandResult::Done
            }
            Command::SendPicture(role) => self.want_picture(role),
            Command::SetTarget { x_arcsec, y_arcsec } => self.set_by_command(&[
                ("target.x_arcsec", Value::Number(x_arcsec.into())),
                ("target.y_arcsec", Value::Number(y_arcsec.into())),
            ]),
            Command::StoreFrames { cameras, on } => {
                let settings: Vec<_> = cameras
                    .iter()
                    .map(|role| (store_key(*role), switch(on)))
                    .collect();
                self.set_by_command(&settings)
            }
            Command::AcceptGps { on } => self.set_by_command(&[("gps.accept", switch(on))]),
            Command::SetCamera(role, setting) => {
                let (key, value) = camera_setting(role, setting);
                self.set_by_command(&[(&key, value)])
            }
            Command::SetClocking { angle_deg } => {
                self.set_by_command(&[("mounting.clocking_deg", Value::Number(angle_deg))])
            }
            Command::SetTwist { angle_deg } => {
                self.set_by_command(&[("mounting.twist_deg", Value::Number(angle_deg))])
            }
            Command::SetPlace {
                latitude_deg,
                longitude_deg,
            } => self.set_by_command(&[
                ("site.latitude_deg", Value::Number(latitude_deg)),
                ("site.longitude_deg", Value::Number(longitude_deg)),
            ]),
            Command::SetInteger { parameter, value } => {
                let fits = |allowed| matches!(allowed, Allowed::Whole(..));
                self.set_numbered(parameter, fits, whole(value.into()))
            }
            Command::SetFloat { parameter, value } => {
                let fits = |allowed| matches!(allowed, Allowed::Number(..));
                self.set_numbered(parameter, fits, Value::Number(value))
            }
            Command::Read(reading) => {
                let value = self.state().read(reading);
                value.map_or(CommandResult::Unknown, CommandResult::Value)
            }
        }
    }

    fn take_reason(&mut self) -> Option<String> {
        self.state().reason.take()
    }

    fn take_fix(&mut self, fix: GpsFix) -> CommandResult {
        let accepted = self.state().own.accepts_gps;
        let reason = match accepted {
            false => Some("GPS is not accepted"),
            true => (!self.believes(fix)).then_some("not believed"),
        };
        if let Some(reason) = reason {
            self.state().reason = Some(reason.into());
            return CommandResult::Refused;
        }
        // Kept with the next values that are saved: a fix a second is no reason to write a file a second.
        match self.apply(&[
            (LATITUDE, Value::Number(fix.latitude_deg.into())),
            (LONGITUDE, Value::Number(fix.longitude_deg.into())),
        ]) {
            Ok(_) => CommandResult::Done,
            Err(_) => CommandResult::Refused,
        }
    }
}

impl Controls {
    fn believes(&self, fix: GpsFix) -> bool {
        let mut state = self.state();
        let believed = state.gps.believes(fix);
        let refused = state.gps.refused();
        drop(state);
        if !believed && worth_a_line(refused) {
            let (latitude_deg, longitude_deg) = (fix.latitude_deg, fix.longitude_deg);
            tracing::warn!(
                latitude_deg,
                longitude_deg,
                refused,
                "a GPS fix is not believed"
            );
        }
        believed
    }

    fn set_by_command(&self, settings: &[(&str, Value)]) -> CommandResult {
        let before = self.state().commanded.clone();
        match self.set(settings) {
            Ok(()) => {
                // The same again changes nothing, and must not fill the log.
                for (key, value) in settings.iter().filter(|s| before.get(s.0) != Some(&s.1)) {
                    tracing::info!(key, %value, "set by command");
                }
                CommandResult::Done
            }
            Err(refused) => {
                let times = self.count_refusal(refused.key);
                self.state().reason = Some(refused.to_string());
                if worth_a_line(times) {
                    tracing::warn!(%refused, times, "a command was refused");
                }
                CommandResult::Refused
            }
        }
    }

    /// How often the key has been refused by now.
    fn count_refusal(&self, key: &'static str) -> u64 {
        let mut state = self.state();
        let times = state.refusals.entry(key).or_default();
        *times += 1;
        *times
    }

    /// By its number; `fits` says whether the parameter is of the command's kind.
    fn set_numbered(&self, number: u16, fits: fn(Allowed) -> bool, value: Value) -> CommandResult {
        match by_command(number) {
            Some(parameter) if fits(parameter.allowed) => {
                self.set_by_command(&[(parameter.key, value)])
            }
            _ => {
                self.state().reason = Some(format!("no parameter {number} of this type"));
                CommandResult::Refused
            }
        }
    }

    fn want_picture(&self, role: CameraRole) -> CommandResult {
        if !self.state().cameras.contains(&role) {
            return CommandResult::NotImplemented;
        }
        self.0.pictures[role as usize].store(true, Ordering::Relaxed);
        CommandResult::Done
    }
}

fn store_key(role: CameraRole) -> &'static str {
    match role {
        CameraRole::PitchYaw => "store.pitch_yaw",
        CameraRole::Roll => "store.roll",
    }
}

fn camera_setting(role: CameraRole, setting: CameraSetting) -> (String, Value) {
    let table = match role {
        CameraRole::PitchYaw => "camera",
        CameraRole::Roll => "roll_camera",
    };
    let (name, value) = match setting {
        CameraSetting::ExposureUs(value) => ("exposure_us", Value::Whole(value.into())),
        CameraSetting::AnalogueGain(value) => ("analogue_gain", Value::Number(value.into())),
        CameraSetting::PreampGain(value) => ("preamp_gain", Value::Number(value.into())),
    };
    (format!("{table}.{name}"), value)
}
