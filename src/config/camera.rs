//! A camera of the flight: its source of frames, and its settings.

use crate::camera::{AutoExposureSettings, CameraSettings, PixelFormat, Source};
use crate::frame::Region;
use crate::instrument::Role;
use std::path::PathBuf;

/// The cameras of a configuration, by their tables: those of [`Role::tables`], with the first pitch-yaw camera first, and any that a file adds.
#[derive(Debug, Clone, PartialEq)]
pub struct Cameras(Vec<ConfiguredCamera>);

impl Default for Cameras {
    fn default() -> Self {
        let cameras = Role::tables().map(|(table, role)| ConfiguredCamera::new(table, role));
        Self(cameras.collect())
    }
}

impl Cameras {
    /// The first pitch-yaw camera.
    pub fn first(&self) -> &ConfiguredCamera {
        &self.0[0]
    }

    pub fn first_mut(&mut self) -> &mut ConfiguredCamera {
        &mut self.0[0]
    }

    pub fn named(&self, name: &str) -> Option<&ConfiguredCamera> {
        self.iter().find(|camera| camera.name == name)
    }

    pub fn named_mut(&mut self, name: &str) -> Option<&mut ConfiguredCamera> {
        self.0.iter_mut().find(|camera| camera.name == name)
    }

    pub fn iter(&self) -> impl Iterator<Item = &ConfiguredCamera> {
        self.0.iter()
    }

    /// Cameras that fly: those with a source.
    pub fn flying(&self) -> impl Iterator<Item = &ConfiguredCamera> {
        self.iter().filter(|camera| camera.source.is_some())
    }

    /// Adds a camera, sorted by name among the added ones: numbers on the line follow their order.
    pub(super) fn push(&mut self, camera: ConfiguredCamera) {
        let standard = Role::tables().count();
        let later = self.0[standard..]
            .iter()
            .position(|other| other.name > camera.name);
        self.0
            .insert(later.map_or(self.0.len(), |at| standard + at), camera);
    }
}

/// A camera as its table configures it.
#[derive(Debug, Clone, PartialEq)]
pub struct ConfiguredCamera {
    /// Name of the table.
    pub name: String,
    pub role: Role,
    /// `None` if there is no such camera.
    pub source: Option<Source>,
    /// The camera's calibration file.
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

/// Whether a function is on.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Switch {
    Off,
    On,
}

impl Switch {
    pub const KINDS: [Self; 2] = [Self::Off, Self::On];

    /// Name in the configuration.
    pub fn name(self) -> &'static str {
        match self {
            Self::Off => "off",
            Self::On => "on",
        }
    }
}

impl ConfiguredCamera {
    /// The settings for the camera.
    pub fn settings(&self) -> CameraSettings {
        CameraSettings {
            rate_hz: self.rate_hz,
            exposure_us: self.exposure_us,
            analogue_gain: self.analogue_gain,
            preamp_gain: self.preamp_gain,
            region: self.region_px,
            pixel_format: self.pixel_format,
        }
    }

    /// Settings of the automatic exposure; `None` if it is off.
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

impl ConfiguredCamera {
    /// A camera with the defaults, and no source.
    pub fn new(name: &str, role: Role) -> Self {
        let settings = CameraSettings::default();
        let auto = AutoExposureSettings::default();
        Self {
            name: name.into(),
            role,
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
