//! The sensor's pixel properties and temperature values in the file, all of them optional.

use super::{Checker, Entry, RawCamera};
use crate::instrument::{Noise, Sensor, Thermal, TomlError, Vignetting};
use crate::units::{Measured, SensorPx};
use serde::Deserialize;

#[derive(Deserialize)]
pub(super) struct RawNoise {
    saturation_dn: Entry<u16>,
    dark_dn: Entry<f64>,
    read_noise_dn: Entry<f64>,
    gain_dn_per_electron: Option<Entry<f64>>,
}

#[derive(Deserialize)]
pub(super) struct RawVignetting {
    centre_px: Entry<[f64; 2]>,
    radial_per_px2: Entry<f64>,
    radial_per_px4: Option<Entry<f64>>,
}

#[derive(Deserialize)]
pub(super) struct RawThermal {
    reference_c: Entry<f64>,
    blur_px_per_c: Option<Entry<f64>>,
    scale_per_c: Option<Entry<f64>>,
}

impl Checker<'_> {
    pub(super) fn sensor(&self, raw: &RawCamera) -> Result<Sensor, TomlError> {
        let hot = raw.hot_pixels_px.iter().flat_map(|entry| &entry.value);
        let hot_pixels: Vec<(usize, usize)> = hot.map(|[x, y]| (*x, *y)).collect();
        let (width, height) = (raw.width_px.value, raw.height_px.value);
        if let Some((x, y)) = hot_pixels.iter().find(|(x, y)| *x >= width || *y >= height) {
            let expected = format!("pixels of a sensor of {width} x {height}");
            return Err(self.error("camera.hot_pixels_px", &expected, format!("[{x}, {y}]")));
        }
        if let Some(entry) = &raw.hot_pixels_px {
            self.provenance("camera.hot_pixels_px", entry)?;
        }
        Ok(Sensor {
            noise: raw.noise.as_ref().map(|n| self.noise(n)).transpose()?,
            vignetting: raw
                .vignetting
                .as_ref()
                .map(|v| self.vignetting(v))
                .transpose()?,
            hot_pixels,
        })
    }

    fn noise(&self, raw: &RawNoise) -> Result<Noise, TomlError> {
        let table = "camera.noise";
        let field = |key: &str| format!("{table}.{key}");
        let saturation_dn = raw.saturation_dn.value;
        let whole = f64::from(saturation_dn);
        self.within(&field("saturation_dn"), whole, 1.0..=65_535.0, "DN")?;
        self.provenance(&field("saturation_dn"), &raw.saturation_dn)?;
        let gain = raw.gain_dn_per_electron.as_ref();
        let gain = gain.map(|g| self.number(&field("gain_dn_per_electron"), g, 0.0..=whole));
        Ok(Noise {
            saturation_dn,
            dark_dn: self.number(&field("dark_dn"), &raw.dark_dn, 0.0..=whole)?,
            read_noise_dn: self.number(&field("read_noise_dn"), &raw.read_noise_dn, 0.0..=whole)?,
            gain_dn_per_electron: gain.transpose()?,
        })
    }

    fn vignetting(&self, raw: &RawVignetting) -> Result<Vignetting, TomlError> {
        let field = |key: &str| format!("camera.vignetting.{key}");
        let [x, y] = self.pair(&field("centre_px"), &raw.centre_px, 65_536.0)?;
        let square = self.number(&field("radial_per_px2"), &raw.radial_per_px2, -1e-4..=1e-4)?;
        let fourth = match &raw.radial_per_px4 {
            Some(entry) => self.number(&field("radial_per_px4"), entry, -1e-8..=1e-8)?,
            None => Measured::new(0.0, 0.0),
        };
        Ok(Vignetting {
            centre: SensorPx::new(x, y),
            radial: [square, fourth],
        })
    }

    pub(super) fn thermal(&self, raw: &RawThermal) -> Result<Thermal, TomlError> {
        let field = |key: &str| format!("optics.temperature.{key}");
        let slope = |key: &str, entry: &Option<Entry<f64>>| {
            let entry = entry.as_ref();
            entry
                .map(|e| self.number(&field(key), e, -1.0..=1.0))
                .transpose()
        };
        let reference = self.number(&field("reference_c"), &raw.reference_c, -150.0..=150.0)?;
        Ok(Thermal {
            reference_c: reference.value,
            blur_px_per_c: slope("blur_px_per_c", &raw.blur_px_per_c)?,
            scale_per_c: slope("scale_per_c", &raw.scale_per_c)?,
        })
    }
}
