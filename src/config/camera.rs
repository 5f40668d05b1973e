//! A camera of the flight: where its frames come from, and how it is run.

use crate::camera::{AutoExposureSettings, PixelFormat, Settings, Source};
use crate::frame::Region;
use std::path::PathBuf;

/// Which camera plays a role, and how it is run.
#[derive(Debug, Clone, PartialEq)]
pub struct Camera {
    /// `None` where nobody plays the role.
    pub source: Option<Source>,
    /// The instrument's file, or that of a camera that sees the horizon.
    pub instrument: Option<PathBuf>,
    pub rate_hz: f64,
    pub exposure_us: u32,
    pub analogue_gain: Option<f64>,
    pub preamp_gain: Option<f64>,
    pub region_px: Option<Region>,
    pub pixel_format: PixelFormat,
    pub auto_exposure: Switch,
    pub auto_exposure_target: f64,
    pub auto_exposure_band: f64,
    pub auto_exposure_max_factor: f64,
    pub auto_exposure_hold_frames: u32,
    pub auto_exposure_min_us: u32,
    pub auto_exposure_max_us: u32,
}

/// Whether something is done.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Switch {
    Off,
    On,
}

impl Switch {
    pub const KINDS: [Self; 2] = [Self::Off, Self::On];

    /// As the configuration gives it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Off => "off",
            Self::On => "on",
        }
    }
}

impl Camera {
    /// What the camera is told.
    pub fn settings(&self) -> Settings {
        Settings {
            rate_hz: self.rate_hz,
            exposure_us: self.exposure_us,
            analogue_gain: self.analogue_gain,
            preamp_gain: self.preamp_gain,
            region: self.region_px,
            pixel_format: self.pixel_format,
        }
    }

    /// How the exposure is held; `None` where it is not.
    pub fn auto_exposure(&self) -> Option<AutoExposureSettings> {
        (self.auto_exposure == Switch::On).then_some(AutoExposureSettings {
            target: self.auto_exposure_target,
            band: self.auto_exposure_band,
            max_factor: self.auto_exposure_max_factor,
            hold_frames: self.auto_exposure_hold_frames,
            min_us: self.auto_exposure_min_us,
            max_us: self.auto_exposure_max_us,
        })
    }
}

impl Default for Camera {
    fn default() -> Self {
        let settings = Settings::default();
        let auto = AutoExposureSettings::default();
        Self {
            source: None,
            instrument: None,
            rate_hz: settings.rate_hz,
            exposure_us: settings.exposure_us,
            analogue_gain: settings.analogue_gain,
            preamp_gain: settings.preamp_gain,
            region_px: settings.region,
            pixel_format: settings.pixel_format,
            auto_exposure: Switch::Off,
            auto_exposure_target: auto.target,
            auto_exposure_band: auto.band,
            auto_exposure_max_factor: auto.max_factor,
            auto_exposure_hold_frames: auto.hold_frames,
            auto_exposure_min_us: auto.min_us,
            auto_exposure_max_us: auto.max_us,
        }
    }
}
