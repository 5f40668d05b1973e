//! A plan in words.

use super::{Plan, PlannedCamera};
use crate::config::{ConfiguredCamera, Switch};
use std::fmt;

impl fmt::Display for PlannedCamera {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let ConfiguredCamera {
            rate_hz,
            exposure_us,
            pixel_format,
            ..
        } = &self.configured;
        write!(
            out,
            "{}: {} at {rate_hz} Hz, {exposure_us} us{}, {}",
            self.camera.name,
            self.source,
            match self.configured.auto_exposure() {
                Some(_) => " to begin with",
                None => "",
            },
            pixel_format.name()
        )?;
        write!(out, ", {}", self.camera.sees.in_words())
    }
}

/// One line for each part of the flight.
impl fmt::Display for Plan {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        for camera in &self.cameras {
            writeln!(out, "{camera}")?;
        }
        let link = &self.config.link;
        match &link.port {
            Some(port) => writeln!(
                out,
                "link: {port}, {} baud, computer {}",
                link.baud, link.computer
            )?,
            None => writeln!(out, "link: none")?,
        }
        let navigation = &self.config.navigation;
        if navigation.is_enabled() {
            writeln!(
                out,
                "navigation: {} Hz, IMU by {}, GPS by {}, offsets {}",
                navigation.rate_hz,
                navigation.imu_port.as_deref().unwrap_or("link"),
                navigation.gps_port.as_deref().unwrap_or("no port"),
                match navigation.send {
                    Switch::On => "sent",
                    Switch::Off => "not sent",
                }
            )?;
        }
        for (_, output) in self.config.outputs.flying() {
            if let Some(to) = &output.to {
                writeln!(out, "output: {} to {to}", output.format.name())?;
            }
        }
        let archive = &self.config.archive;
        let folders: Vec<String> = self
            .folders()
            .iter()
            .map(|f| f.display().to_string())
            .collect();
        match folders.as_slice() {
            [] => writeln!(out, "archive: none")?,
            [one] => writeln!(out, "archive: {one}, {}", archive.compression.name())?,
            both => {
                let (sharing, compression) = (archive.sharing.name(), archive.compression.name());
                writeln!(
                    out,
                    "archive: {}, {sharing}, {compression}",
                    both.join(" and ")
                )?;
            }
        }
        let target = &self.config.target;
        write!(
            out,
            "target: {}, {} arcsec",
            target.x_arcsec, target.y_arcsec
        )?;
        match target.epoch_utc {
            Some(epoch) => write!(out, " at {epoch}, turning with the Sun"),
            None => Ok(()),
        }
    }
}
