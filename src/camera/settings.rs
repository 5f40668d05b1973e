//! The settings of a camera.

use crate::frame::Region;
use std::time::Duration;

/// Settings for a camera. A setting that is `None` is not changed.
#[derive(Debug, Clone, PartialEq)]
pub struct CameraSettings {
    pub rate_hz: f64,
    pub exposure_us: u32,
    /// Gain on the camera's own scale.
    pub analogue_gain: Option<f64>,
    /// Gain on the camera's own scale.
    pub preamp_gain: Option<f64>,
    /// The part of the sensor that is read; `None` for all of it.
    pub region: Option<Region>,
    pub pixel_format: PixelFormat,
}

impl Default for CameraSettings {
    fn default() -> Self {
        Self {
            rate_hz: 4.0,
            exposure_us: 15_000,
            analogue_gain: None,
            preamp_gain: None,
            region: None,
            pixel_format: PixelFormat::Mono8,
        }
    }
}

impl CameraSettings {
    pub fn exposure(&self) -> Duration {
        Duration::from_micros(self.exposure_us.into())
    }

    /// Time from one frame to the next.
    pub fn period(&self) -> Duration {
        period(self.rate_hz)
    }
}

/// Time from one frame to the next; zero for an invalid rate.
pub(super) fn period(rate_hz: f64) -> Duration {
    Duration::try_from_secs_f64(1.0 / rate_hz).unwrap_or(Duration::ZERO)
}

/// Bit depth of a camera's pixels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum PixelFormat {
    /// 8 bits.
    #[default]
    Mono8,
    /// 10 bits, two bytes per pixel.
    Mono10,
    /// 12 bits, two bytes per pixel.
    Mono12,
    /// 16 bits, or as many of them as the camera uses.
    Mono16,
}

impl PixelFormat {
    pub const KINDS: [Self; 4] = [Self::Mono8, Self::Mono10, Self::Mono12, Self::Mono16];
    pub const NAMES: [&'static str; 4] = {
        let [a, b, c, d] = Self::KINDS;
        [a.name(), b.name(), c.name(), d.name()]
    };

    /// The name in configurations.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Mono8 => "mono8",
            Self::Mono10 => "mono10",
            Self::Mono12 => "mono12",
            Self::Mono16 => "mono16",
        }
    }

    /// Significant bits of a pixel.
    pub const fn bits(self) -> usize {
        match self {
            Self::Mono8 => 8,
            Self::Mono10 => 10,
            Self::Mono12 => 12,
            Self::Mono16 => 16,
        }
    }

    /// Bytes per pixel in a frame.
    pub const fn bytes(self) -> usize {
        self.bits().div_ceil(8)
    }
}
