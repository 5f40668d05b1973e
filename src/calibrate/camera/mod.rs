//! How the camera answers to light: dark level, read noise, gain, hot pixels, vignetting, blur, and how blur and scale go
//! with temperature.
//!
//! # Method
//! - `dark`: the median of every pixel over frames without light (dark frames, else the unlit parts of the Sun's frames) gives
//!   level and hot pixels; differences of frames that follow each other give the read noise.
//! - `transfer`: photon transfer. The variance of the difference of two evenly lit frames grows with their light by the gain, DN per
//!   photo-electron. Without such frames, the grain of the Sun's disc between the marks does instead.
//! - `flat`: how the light of evenly lit frames, else the brightness of the Sun's disc, falls off from the middle.
//! - `focus`: the blur of the Sun's limb, and of blur and scale how they go with the camera's temperature.
//!
//! What the frames do not determine keeps the instrument's value, with the reason.

mod dark;
mod flat;
mod focus;
mod report;
mod shots;
mod transfer;

pub use report::page;
pub use shots::{Shots, SunShot, load, look};

use super::revision::{Provenance, Revision};
use crate::instrument::Instrument;
use crate::report::plot::Dots;
use crate::units::Measured;
use toml_edit::{Array, Value};

/// The frames of a calibration, by what they show.
#[derive(Debug, Default)]
pub struct Inputs {
    pub dark: Shots,
    pub flat: Shots,
    /// Frames of the Sun on the plate that are kept whole.
    pub sun: Shots,
    /// What every frame of the Sun gave.
    pub suns: Vec<SunShot>,
}

/// One quantity: its value, or why there is none.
#[derive(Debug, Clone, PartialEq)]
pub struct Finding {
    pub name: &'static str,
    /// Dotted key of the instrument's file.
    pub key: &'static str,
    pub unit: &'static str,
    pub found: Result<Measured, String>,
    /// How it was got, for people.
    pub remark: String,
}

/// Points for the report.
#[derive(Debug, Clone, PartialEq)]
pub struct Figure {
    pub title: &'static str,
    pub x: &'static str,
    pub y: &'static str,
    pub series: Vec<Dots>,
}

/// What came of a calibration.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct CameraCalibration {
    pub saturation_dn: u16,
    pub findings: Vec<Finding>,
    /// Columns and rows; `None` where the frames do not tell.
    pub hot_pixels: Option<Vec<(usize, usize)>>,
    /// The middle of the vignetting that was fitted.
    pub middle_px: [f64; 2],
    /// The mean temperature where there is a dependence on it.
    pub reference_c: Option<f64>,
    pub figures: Vec<Figure>,
}

/// Why the frames give no calibration.
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
    #[error(
        "mixed instruments: expected frames that all saturate at {expected_dn} DN, found {name}, which saturates at {found_dn} DN; give the frames of each setting on their own"
    )]
    MixedDepth {
        name: String,
        expected_dn: u16,
        found_dn: u16,
    },
    #[error(
        "mixed instruments: expected frames of one {what}, found {a} and {b}; give each on its own"
    )]
    Mixed {
        what: &'static str,
        a: String,
        b: String,
    },
}

/// Calibrates the camera of an instrument from its frames.
///
/// # Errors
/// Too few frames, or frames of several cameras or settings.
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
    shots::one_setting(all())?;
    let unlit = if inputs.dark.frames.is_empty() {
        &inputs.sun
    } else {
        &inputs.dark
    };
    let dark = dark::measure(unlit);
    let (gain, transfer) = match inputs.flat.frames.is_empty() {
        true => transfer::by_suns(&inputs.sun, stated, &dark),
        false => transfer::by_pairs(&inputs.flat, &dark),
    };
    let (vignetting, map) = match inputs.flat.frames.is_empty() {
        true => flat::by_suns(&inputs.suns, stated),
        false => flat::by_flats(&inputs.flat, &dark),
    };
    let focus = focus::measure(&inputs.suns);
    let mut findings = vec![dark.level_finding(), dark.noise_finding(), gain];
    findings.extend(vignetting);
    findings.extend(focus.findings);
    if findings.iter().all(|f| f.found.is_err()) && dark.hot.is_none() {
        return Err(too_few);
    }
    let middle = |pixels: usize| (pixels as f64 - 1.0) / 2.0;
    Ok(CameraCalibration {
        saturation_dn: first.frame.saturation_dn(),
        findings,
        hot_pixels: dark.hot,
        middle_px: [middle(first.frame.width()), middle(first.frame.height())],
        reference_c: focus.reference_c,
        figures: [transfer, map]
            .into_iter()
            .flatten()
            .chain(focus.figures)
            .collect(),
    })
}

impl CameraCalibration {
    fn measured(&self, key: &str) -> Option<Measured> {
        let finding = self.findings.iter().find(|f| f.key == key)?;
        finding.found.clone().ok()
    }

    /// Writes what was determined into an instrument's file; what was not stays as it is.
    pub fn revise(&self, revision: &mut Revision, provenance: &Provenance) {
        let number = |value: f64| Value::from(value);
        let noise = self
            .measured("camera.noise.dark_dn")
            .zip(self.measured("camera.noise.read_noise_dn"));
        if noise.is_some() {
            let saturation = i64::from(self.saturation_dn).into();
            revision.set("camera.noise.saturation_dn", saturation, None, provenance);
        }
        if self.measured("camera.vignetting.radial_per_px2").is_some() {
            let centre = Value::Array(self.middle_px.into_iter().collect());
            revision.set("camera.vignetting.centre_px", centre, None, provenance);
        }
        if let Some(reference) = self.reference_c {
            let reference = number((reference * 100.0).round() / 100.0);
            revision.set(
                "optics.temperature.reference_c",
                reference,
                None,
                provenance,
            );
        }
        for finding in &self.findings {
            // A gain without the dark level beside it says nothing.
            let without = finding.key.starts_with("camera.noise.") && noise.is_none();
            if let (Ok(found), false) = (&finding.found, without) {
                revision.set_measured(finding.key, *found, provenance);
            }
        }
        if let Some(hot) = &self.hot_pixels {
            revision.set("camera.hot_pixels_px", listed(hot), None, provenance);
        }
        revision.sign(provenance);
    }
}

/// The pixels as an array, each on a line of its own.
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
