//! Changes in the sensor's response to light.

use crate::calibrate::numbers::{sigma_text, value_text};
use crate::instrument::{Instrument, Noise};
use crate::units::{Measured, SensorPx};
use serde::Serialize;
use std::collections::BTreeSet;

/// A quantity before and after: value and 1 sigma; none if the instrument does not state it.
pub type Renewed = [Option<[f64; 2]>; 2];

/// Changes of the sensor, each in the DN of its instrument.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SensorChange {
    pub saturation_dn: [Option<u16>; 2],
    pub dark_dn: Renewed,
    pub read_noise_dn: Renewed,
    pub gain_dn_per_electron: Renewed,
    /// Fraction of the light lost in the darkest corner.
    pub corner_loss: [Option<f64>; 2],
    pub hot_pixels_before: usize,
    pub hot_pixels_after: usize,
    pub hot_pixels_in_both: usize,
}

pub(super) fn change(a: &Instrument, b: &Instrument) -> SensorChange {
    let of_both = |value: fn(&Noise) -> Option<Measured>| {
        [a, b].map(|i| {
            let found = i.sensor.noise.as_ref().and_then(value)?;
            Some([found.value, found.sigma])
        })
    };
    let hot = |i: &Instrument| BTreeSet::from_iter(i.sensor.hot_pixels.iter().copied());
    let (before, after) = (hot(a), hot(b));
    SensorChange {
        saturation_dn: [a, b].map(|i| Some(i.sensor.noise.as_ref()?.saturation_dn)),
        dark_dn: of_both(|noise| Some(noise.dark_dn)),
        read_noise_dn: of_both(|noise| Some(noise.read_noise_dn)),
        gain_dn_per_electron: of_both(|noise| noise.gain_dn_per_electron),
        corner_loss: [a, b].map(corner_loss),
        hot_pixels_before: before.len(),
        hot_pixels_after: after.len(),
        hot_pixels_in_both: before.intersection(&after).count(),
    }
}

fn corner_loss(instrument: &Instrument) -> Option<f64> {
    let vignetting = instrument.sensor.vignetting?;
    let right = (instrument.camera.width_px - 1) as f64;
    let bottom = (instrument.camera.height_px - 1) as f64;
    let corners = [(0.0, 0.0), (right, 0.0), (0.0, bottom), (right, bottom)];
    let shares = corners.map(|(x, y)| vignetting.share(SensorPx::new(x, y)));
    Some(1.0 - shares.into_iter().fold(f64::INFINITY, f64::min))
}

impl SensorChange {
    /// A line for each quantity that either instrument states.
    pub(super) fn lines(&self) -> Vec<String> {
        let mut lines = Vec::new();
        let mut line = |name: &str, unit: &str, [before, after]: [Option<String>; 2]| {
            if before.is_some() || after.is_some() {
                let [before, after] = [before, after].map(|v| v.unwrap_or("not stated".into()));
                lines.push(
                    format!("{name:<13} {before} -> {after} {unit}")
                        .trim_end()
                        .into(),
                );
            }
        };
        if self.saturation_dn[0] != self.saturation_dn[1] {
            let saturation = self.saturation_dn.map(|dn| dn.map(|dn| dn.to_string()));
            line("saturation", "DN", saturation);
        }
        for (name, unit, renewed) in [
            ("dark level", "DN", self.dark_dn),
            ("read noise", "DN", self.read_noise_dn),
            ("gain", "DN/electron", self.gain_dn_per_electron),
        ] {
            line(name, unit, renewed.map(|v| v.map(text)));
        }
        let percent = |loss: f64| format!("{:.2} %", 100.0 * loss);
        let loss = self.corner_loss.map(|loss| loss.map(percent));
        line("vignetting", "lost in a corner", loss);
        if self.hot_pixels_before + self.hot_pixels_after > 0 {
            lines.push(format!(
                "hot pixels    {} -> {}, {} in both",
                self.hot_pixels_before, self.hot_pixels_after, self.hot_pixels_in_both
            ));
        }
        lines
    }
}

/// Rounds to two digits of the sigma; to six without a sigma, as in the truth of a simulation.
fn text([value, sigma]: [f64; 2]) -> String {
    if sigma > 0.0 {
        let digits = value_text(Measured::new(value, sigma));
        return format!("{digits} +- {}", sigma_text(sigma));
    }
    let rounded = format!("{value:.5e}").parse::<f64>();
    rounded.unwrap_or(value).to_string()
}
