//! Propagation of the attitude between frames.

use super::{Refused, Switch};
use crate::link::PortAddress;
use crate::link::connection::EXPECTED;
use std::path::PathBuf;

defaults! {
    /// Settings of the navigation filter.
    Navigation {
        enabled: Switch = Switch::Off,
        /// Path of NAV.toml.
        settings: Option<PathBuf> = None,
        imu_port: Option<String> = None,
        gps_port: Option<String> = None,
        gps_baud: u32 = 9600,
        rate_hz: f64 = 20.0,
        send: Switch = Switch::Off,
        max_sigma_arcsec: f64 = 60.0,
    }
}

impl Navigation {
    pub fn is_enabled(&self) -> bool {
        self.enabled == Switch::On
    }

    pub fn max_sigma_deg(&self) -> f64 {
        self.max_sigma_arcsec / 3600.0
    }

    /// The IMU's own line; `None` if it sends on the controller's.
    ///
    /// # Errors
    /// Expected and found value of `navigation.imu_port`.
    pub fn imu_address(&self) -> Result<Option<PortAddress>, Refused> {
        address("navigation.imu_port", self.imu_port.as_deref())
    }

    /// The GPS receiver's line.
    ///
    /// # Errors
    /// As [`imu_address`](Self::imu_address).
    pub fn gps_address(&self) -> Result<Option<PortAddress>, Refused> {
        address("navigation.gps_port", self.gps_port.as_deref())
    }
}

fn address(key: &'static str, text: Option<&str>) -> Result<Option<PortAddress>, Refused> {
    let refused = |expected: &str| Refused {
        key: key.into(),
        expected: expected.into(),
        found: format!("\"{}\"", text.unwrap_or_default()),
    };
    let parsed = text.map(str::parse).transpose();
    match parsed.map_err(|_: String| refused(EXPECTED))? {
        // A sensor cannot send to a port that the system chooses freely.
        Some(PortAddress::Udp {
            local_port: None, ..
        }) => Err(refused(
            "udp:HOST:PORT@LOCALPORT, LOCALPORT being where the sensor sends to",
        )),
        address => Ok(address),
    }
}
