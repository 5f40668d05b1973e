//! Response of the sensor to light, as measured by `calibrate camera`. All of it is optional: for an instrument without it,
//! each frame's own statistics are used.

use crate::frame::Frame;
use crate::units::{Measured, SensorPx};

/// Properties of the sensor's pixels.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Sensor {
    pub noise: Option<Noise>,
    pub vignetting: Option<Vignetting>,
    /// Columns and rows of pixels that are bright in the dark.
    pub hot_pixels: Vec<(usize, usize)>,
}

impl Sensor {
    /// The sensor restricted to a part, with positions relative to the part's corner.
    pub(super) fn windowed(&self, corner_px: (usize, usize), size_px: (usize, usize)) -> Self {
        let within = |(x, y): &(usize, usize)| {
            let at = (x.checked_sub(corner_px.0)?, y.checked_sub(corner_px.1)?);
            (at.0 < size_px.0 && at.1 < size_px.1).then_some(at)
        };
        let from_corner = |v: &Vignetting| Vignetting {
            centre: SensorPx::new(
                v.centre.x - corner_px.0 as f64,
                v.centre.y - corner_px.1 as f64,
            ),
            ..*v
        };
        Self {
            noise: self.noise,
            vignetting: self.vignetting.as_ref().map(from_corner),
            hot_pixels: self.hot_pixels.iter().filter_map(within).collect(),
        }
    }
}

/// Noise of a pixel, in the DN of frames that saturate at `saturation_dn`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Noise {
    pub saturation_dn: u16,
    /// Level in the dark.
    pub dark_dn: Measured,
    /// Noise of a pixel in the dark, 1 sigma, rounding included.
    pub read_noise_dn: Measured,
    /// DN per photo-electron.
    pub gain_dn_per_electron: Option<Measured>,
}

impl Noise {
    /// Whether the frame uses the same DN.
    pub fn is_of(&self, frame: &Frame) -> bool {
        frame.saturation_dn() == self.saturation_dn
    }

    /// 1 sigma of a pixel with the given light, DN.
    pub fn at(&self, light_dn: f64) -> f64 {
        let photons = self
            .gain_dn_per_electron
            .map_or(0.0, |gain| gain.value * light_dn.max(0.0));
        (self.read_noise_dn.value.powi(2) + photons).sqrt()
    }
}

/// Decrease of the brightness from the centre of the picture: at a distance r the transmitted fraction is 1 + a r^2 + b
/// r^4.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Vignetting {
    pub centre: SensorPx,
    /// a, per px^2, and b, per px^4.
    pub radial: [Measured; 2],
}

impl Vignetting {
    /// The transmitted fraction at a position.
    pub fn share(&self, at: SensorPx) -> f64 {
        let r2 = at.distance(self.centre).powi(2);
        1.0 + r2 * (self.radial[0].value + r2 * self.radial[1].value)
    }
}

/// Change of focus and scale with the camera's temperature.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Thermal {
    /// Temperature at which blur and scale have their stated values, deg C.
    pub reference_c: f64,
    pub blur_px_per_c: Option<Measured>,
    /// Relative change of the plate length per pixel, per deg C.
    pub scale_per_c: Option<Measured>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hot_pixels_of_a_window_count_from_its_corner() {
        let sensor = Sensor {
            hot_pixels: vec![(10, 20), (99, 60), (100, 60), (130, 159), (130, 160)],
            ..Sensor::default()
        };
        let window = sensor.windowed((100, 50), (200, 110));
        assert_eq!(window.hot_pixels, [(0, 10), (30, 109)]);
    }
}
