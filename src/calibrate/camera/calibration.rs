//! Calibrates the camera from frames.

use super::dark;
use super::flat;
use super::focus;
use super::light::{self, WrongLight};
use super::shots::{Shot, Shots, SunShot};
use super::transfer;
use crate::calibrate::frames::{Setting, WrongFrames, check_settings};
use crate::calibrate::quantity::{CalibratedQuantity, Verdict};
use crate::calibrate::revision::{Provenance, Revision};
use crate::instrument::Instrument;
use crate::report::plot::Figure;
use toml_edit::{Array, Value};

/// The frames of a calibration, by kind.
#[derive(Debug, Default)]
pub struct Inputs {
    pub dark: Shots,
    pub flat: Shots,
    /// Frames of the Sun on the plate whose pixels are kept.
    pub sun: Shots,
    /// Results of every frame of the Sun.
    pub suns: Vec<SunShot>,
}

/// The result of a calibration.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct CameraCalibration {
    pub saturation_dn: u16,
    pub quantities: Vec<CalibratedQuantity>,
    /// Columns and rows; `None` where the frames do not determine them.
    pub hot_pixels: Option<Vec<(usize, usize)>>,
    /// The middle of the fitted vignetting.
    pub middle_px: [f64; 2],
    /// The mean temperature, if there is a dependence on it.
    pub reference_c: Option<f64>,
    pub figures: Vec<Figure>,
}

/// Reasons for which the frames give no calibration.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum CameraError {
    #[error(
        "too few frames: expected at least 3 dark frames (--dark), or pairs of evenly lit frames at equal exposure (--flat), or frames of the Sun, found {dark}, {flat} and {sun}"
    )]
    TooFew {
        dark: usize,
        flat: usize,
        sun: usize,
    },
    #[error(transparent)]
    WrongFrames(#[from] WrongFrames),
    #[error(transparent)]
    WrongLight(#[from] WrongLight),
}

/// Calibrates the camera of an instrument from its frames.
///
/// # Errors
/// If there are too few frames, frames of several cameras or settings, or frames that are not dark or not evenly illuminated.
pub fn calibrate(inputs: &Inputs, stated: &Instrument) -> Result<CameraCalibration, CameraError> {
    let all = || {
        inputs
            .dark
            .frames
            .iter()
            .chain(&inputs.flat.frames)
            .chain(&inputs.sun.frames)
    };
    let too_few = CameraError::TooFew {
        dark: inputs.dark.frames.len(),
        flat: inputs.flat.frames.len(),
        sun: inputs.suns.len(),
    };
    let Some(first) = all().next() else {
        return Err(too_few);
    };
    let settings: Vec<Setting> = all().map(Shot::setting).collect();
    check_settings(&settings, stated)?;
    let unlit = if inputs.dark.frames.is_empty() {
        &inputs.sun
    } else {
        &inputs.dark
    };
    light::check_dark(&inputs.dark)?;
    let dark = dark::measure(unlit);
    light::check_even(&inputs.flat, &dark)?;
    let ((gain, transfer), (vignetting, map)) = match inputs.flat.frames.is_empty() {
        true => (
            transfer::by_suns(&inputs.sun, stated, &dark),
            flat::by_suns(&inputs.suns, stated),
        ),
        false => (
            transfer::by_pairs(&inputs.flat, &dark),
            flat::by_flats(&inputs.flat, &dark),
        ),
    };
    let focus = focus::measure(&inputs.suns);
    let mut quantities = vec![dark.level_quantity(), dark.noise_quantity(), gain];
    quantities.extend(vignetting);
    quantities.extend(focus.quantities);
    let is_kept = |quantity: &CalibratedQuantity| quantity.verdict == Verdict::Kept;
    if quantities.iter().all(is_kept) && dark.hot.is_none() {
        return Err(too_few);
    }
    let middle = stated.camera.middle_px();
    Ok(CameraCalibration {
        saturation_dn: first.frame.saturation_dn(),
        quantities,
        hot_pixels: dark.hot,
        middle_px: [middle.x, middle.y],
        reference_c: focus.reference_c,
        figures: [transfer, map]
            .into_iter()
            .flatten()
            .chain(focus.figures)
            .collect(),
    })
}

impl CameraCalibration {
    fn is_determined(&self, key: &str) -> bool {
        let mut determined = self.quantities.iter();
        determined.any(|q| q.key == Some(key) && q.verdict == Verdict::Determined)
    }

    /// Writes the determined values into an instrument's file; the other values stay.
    pub fn revise(&self, revision: &mut Revision, provenance: &Provenance) {
        let mut set = |key, value| revision.set(key, value, None, provenance);
        let noise_keys = ["camera.noise.dark_dn", "camera.noise.read_noise_dn"];
        let noise = noise_keys.iter().all(|key| self.is_determined(key));
        if noise {
            let saturation_dn = i64::from(self.saturation_dn);
            set("camera.noise.saturation_dn", saturation_dn.into());
        }
        if self.is_determined("camera.vignetting.radial_per_px2") {
            let centre = Value::Array(self.middle_px.into_iter().collect());
            set("camera.vignetting.centre_px", centre);
        }
        if let Some(reference_c) = self.reference_c {
            let reference_c = (reference_c * 100.0).round() / 100.0;
            set("optics.temperature.reference_c", reference_c.into());
        }
        for quantity in &self.quantities {
            let key = quantity.key.unwrap_or_default();
            // A gain without the corresponding dark level is useless.
            if noise || !key.starts_with("camera.noise.") {
                quantity.revise(revision, provenance);
            }
        }
        if let Some(hot) = &self.hot_pixels {
            revision.set("camera.hot_pixels_px", listed(hot), None, provenance);
        }
        revision.sign(provenance);
    }
}

/// The pixels as an array, one per line.
fn listed(pixels: &[(usize, usize)]) -> Value {
    let mut array = Array::new();
    for (x, y) in pixels {
        let mut pixel = Value::Array([*x as i64, *y as i64].into_iter().collect());
        pixel.decor_mut().set_prefix("\n    ");
        array.push_formatted(pixel);
    }
    if !pixels.is_empty() {
        array.set_trailing("\n");
        array.set_trailing_comma(true);
    }
    Value::Array(array)
}
