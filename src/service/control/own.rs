//! The settings in flight that are no parameters of the configuration.

use crate::config::{Refused, Value};
use crate::instrument::TURN_DEG;
use crate::link::CameraRole;

/// The key that tells whether the controller wants solutions.
pub(super) const TRACKING: &str = "link.tracking";
/// The keys of the last GPS fix.
pub(super) const LATITUDE: &str = "gps.latitude_deg";
pub(super) const LONGITUDE: &str = "gps.longitude_deg";

/// What belongs to the conversation with controller and ground, and not to the flight's settings.
pub(super) const KEPT: [&str; 5] = [
    TRACKING,
    LATITUDE,
    LONGITUDE,
    "link.sending",
    "link.stamp_ns",
];

/// What only commands set. `None` where they have not.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Own {
    pub accepts_gps: bool,
    /// By role.
    pub stores: [bool; CameraRole::COUNT],
    pub sending: Option<bool>,
    /// Whether the controller wants solutions.
    pub tracking: bool,
    /// The newest stamp of a signed datagram, ns since 1970; 0 without one.
    pub stamp_ns: i64,
    pub clocking_deg: Option<f64>,
    pub twist_deg: Option<f64>,
    /// The last GPS fix that was believed.
    pub latitude_deg: Option<f64>,
    pub longitude_deg: Option<f64>,
}

impl Own {
    pub fn new() -> Self {
        Self {
            accepts_gps: true,
            stores: [true; CameraRole::COUNT],
            sending: None,
            tracking: false,
            stamp_ns: 0,
            clocking_deg: None,
            twist_deg: None,
            latitude_deg: None,
            longitude_deg: None,
        }
    }

    /// Whether a key has this value.
    pub fn is(&self, key: &str, value: &Value) -> bool {
        let mut set = self.clone();
        set.set(key, value).is_ok() && set == *self
    }

    /// Sets a key, or says why not; a name that is not known is refused, too.
    pub fn set(&mut self, key: &str, value: &Value) -> Result<(), Refused> {
        match key {
            "gps.accept" => self.accepts_gps = switch("gps.accept", value)?,
            "store.pitch_yaw" => self.stores[0] = switch("store.pitch_yaw", value)?,
            "store.roll" => self.stores[1] = switch("store.roll", value)?,
            "store.moon" => self.stores[2] = switch("store.moon", value)?,
            "link.sending" => self.sending = Some(switch("link.sending", value)?),
            TRACKING => self.tracking = switch(TRACKING, value)?,
            LATITUDE => self.latitude_deg = Some(angle(LATITUDE, value)?),
            LONGITUDE => self.longitude_deg = Some(angle(LONGITUDE, value)?),
            "link.stamp_ns" => match value {
                // It never goes back: a copy of an old datagram must not become new again.
                Value::Whole(stamp) => self.stamp_ns = self.stamp_ns.max(*stamp),
                _ => return Err(refused("link.stamp_ns", "a whole number, ns", value)),
            },
            "mounting.clocking_deg" => {
                self.clocking_deg = Some(angle("mounting.clocking_deg", value)?);
            }
            "mounting.twist_deg" => self.twist_deg = Some(angle("mounting.twist_deg", value)?),
            _ => return Err(refused("settings", "a key that commands set", value)),
        }
        Ok(())
    }
}

fn switch(key: &'static str, value: &Value) -> Result<bool, Refused> {
    match value {
        Value::Whole(0) => Ok(false),
        Value::Whole(1) => Ok(true),
        _ => Err(refused(key, "1 (on) or 0 (off)", value)),
    }
}

fn angle(key: &'static str, value: &Value) -> Result<f64, Refused> {
    match value {
        Value::Number(angle) if TURN_DEG.contains(angle) => Ok(*angle),
        _ => Err(refused(key, "an angle from -360 to 360 deg", value)),
    }
}

fn refused(key: &'static str, expected: &str, value: &Value) -> Refused {
    Refused {
        key,
        expected: expected.into(),
        found: value.to_string(),
    }
}
