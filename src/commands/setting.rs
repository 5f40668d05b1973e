//! Settings that commands set and read in flight: parameters of the configuration, and settings by commands alone.

use crate::config::{Refused, Value};
use crate::instrument::{Role, TURN_DEG};

/// A quantity that a command sets or reads. It is made from a field of the configuration (the macro `parameter`) or named here: a misspelled one
/// does not compile.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Setting(&'static str);

impl Setting {
    pub(super) const fn new(key: &'static str) -> Self {
        Self(key)
    }

    /// Its dotted key in the configuration and in the file of saved values.
    pub const fn key(self) -> &'static str {
        self.0
    }
}

/// The setting of a parameter, by its field in the configuration.
macro_rules! parameter {
    ($table:ident . $field:ident) => {{
        let _: fn(&$crate::config::Config) = |config| {
            let _ = &config.$table.$field;
        };
        $crate::commands::setting::Setting::new(concat!(
            stringify!($table),
            ".",
            stringify!($field)
        ))
    }};
}
pub(super) use parameter;

/// The same for a camera's parameter, by the camera's table, which a test checks: only a misspelled field does not compile.
macro_rules! camera_parameter {
    ($table:ident . $field:ident) => {{
        let _: fn(&$crate::config::ConfiguredCamera) = |camera| {
            let _ = &camera.$field;
        };
        $crate::commands::setting::Setting::new(concat!(
            stringify!($table),
            ".",
            stringify!($field)
        ))
    }};
}
pub(super) use camera_parameter;

/// The place, which GPS may override.
pub const SITE_LATITUDE: Setting = parameter!(site.latitude_deg);
pub const SITE_LONGITUDE: Setting = parameter!(site.longitude_deg);
/// Lead of the host's clock over true time. It is read only.
pub const CLOCK_OFFSET: Setting = Setting("clock.offset_us");
pub const ACCEPT_GPS: Setting = Setting("gps.accept");
pub const STORE_PITCH_YAW: Setting = Setting("store.pitch_yaw");
pub const STORE_ROLL: Setting = Setting("store.roll");
pub const STORE_MOON: Setting = Setting("store.moon");
pub const CLOCKING: Setting = Setting("mounting.clocking_deg");
pub const TWIST: Setting = Setting("mounting.twist_deg");
/// Whether this computer sends solutions.
pub const SENDING: Setting = Setting("link.sending");
/// Whether the controller requests solutions.
pub const TRACKING: Setting = Setting("link.tracking");
/// The newest stamp of a signed datagram, ns since 1970.
pub const STAMP: Setting = Setting("link.stamp_ns");
/// The last GPS fix.
pub const LATITUDE: Setting = Setting("gps.latitude_deg");
pub const LONGITUDE: Setting = Setting("gps.longitude_deg");

/// Settings of the conversation with controller and ground, and not of the flight.
pub(super) const KEPT: [Setting; 5] = [TRACKING, LATITUDE, LONGITUDE, SENDING, STAMP];

/// Settings by commands alone. `None` if they have not been set.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct CommandOnly {
    pub accepts_gps: bool,
    /// Whether frames are stored, by role.
    pub stores: [bool; Role::COUNT],
    pub sending: Option<bool>,
    /// Whether the controller requests solutions.
    pub tracking: bool,
    /// The newest stamp of a signed datagram, ns since 1970; 0 without one.
    pub stamp_ns: i64,
    pub clocking_deg: Option<f64>,
    pub twist_deg: Option<f64>,
    /// The last GPS fix that was accepted.
    pub latitude_deg: Option<f64>,
    pub longitude_deg: Option<f64>,
}

/// Field in which a setting is stored.
enum Field {
    Switch(fn(&mut CommandOnly) -> &mut bool),
    Sending(fn(&mut CommandOnly) -> &mut Option<bool>),
    Angle(fn(&mut CommandOnly) -> &mut Option<f64>),
    Stamp(fn(&mut CommandOnly) -> &mut i64),
}

/// The settings in [`CommandOnly`].
const FIELDS: &[(Setting, Field)] = &[
    (ACCEPT_GPS, Field::Switch(|own| &mut own.accepts_gps)),
    (STORE_PITCH_YAW, Field::Switch(|own| &mut own.stores[0])),
    (STORE_ROLL, Field::Switch(|own| &mut own.stores[1])),
    (STORE_MOON, Field::Switch(|own| &mut own.stores[2])),
    (SENDING, Field::Sending(|own| &mut own.sending)),
    (TRACKING, Field::Switch(|own| &mut own.tracking)),
    (STAMP, Field::Stamp(|own| &mut own.stamp_ns)),
    (CLOCKING, Field::Angle(|own| &mut own.clocking_deg)),
    (TWIST, Field::Angle(|own| &mut own.twist_deg)),
    (LATITUDE, Field::Angle(|own| &mut own.latitude_deg)),
    (LONGITUDE, Field::Angle(|own| &mut own.longitude_deg)),
];

impl CommandOnly {
    pub fn new() -> Self {
        Self {
            accepts_gps: true,
            stores: [true; Role::COUNT],
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

    /// Sets a key, or returns the reason for refusing it; an unknown name is refused, too.
    pub fn set(&mut self, key: &str, value: &Value) -> Result<(), Refused> {
        let Some((setting, field)) = FIELDS.iter().find(|(setting, _)| setting.key() == key) else {
            return Err(refused("settings", "a key that commands set", value));
        };
        let switch = match value {
            Value::Whole(0) => Some(false),
            Value::Whole(1) => Some(true),
            _ => None,
        };
        let refused = |expected| refused(setting.key(), expected, value);
        let not_switched = || refused("1 (on) or 0 (off)");
        match (field, value) {
            (Field::Switch(field), _) => *field(self) = switch.ok_or_else(not_switched)?,
            (Field::Sending(field), _) => {
                *field(self) = Some(switch.ok_or_else(not_switched)?);
            }
            (Field::Angle(field), Value::Number(angle)) if TURN_DEG.contains(angle) => {
                *field(self) = Some(*angle);
            }
            (Field::Angle(_), _) => return Err(refused("an angle from -360 to 360 deg")),
            // It never decreases: a copy of an old datagram must not become new again.
            (Field::Stamp(field), Value::Whole(stamp)) => {
                let newest = field(self);
                *newest = (*newest).max(*stamp);
            }
            (Field::Stamp(_), _) => return Err(refused("a whole number, ns")),
        }
        Ok(())
    }
}

fn refused(key: &'static str, expected: &str, value: &Value) -> Refused {
    Refused {
        key: key.into(),
        expected: expected.into(),
        found: value.to_string(),
    }
}
