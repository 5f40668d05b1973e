//! What a flight's navigation has.

use crate::link::Connection;
use crate::navigation::Settings;

/// The navigation of a flight.
pub struct Navigation {
    pub settings: Settings,
    /// The file of the settings, letter by letter, for the archive.
    pub settings_toml: String,
    /// The IMU's own line; none where it speaks on the controller's.
    pub imu: Option<Connection>,
    pub gps: Option<Connection>,
}
