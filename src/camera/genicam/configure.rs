//! Settings of a camera: written, read back and compared.

use crate::camera::{CameraError, CameraSettings, MonoFormat};
use aravis::Camera;
use aravis::prelude::*;
use std::time::Duration;

/// Settings as read back from the camera.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Actual {
    pub exposure: Option<Duration>,
    pub analogue_gain: Option<f64>,
    pub preamp_gain: Option<f64>,
    /// The largest possible value of a pixel.
    pub largest_dn: Option<i64>,
}

pub(super) fn has(camera: &Camera, feature: &str) -> bool {
    camera.is_feature_available(feature).unwrap_or(false)
}

/// Applies every setting, reads it back, and reports those that the camera did not take.
pub(super) fn configure(camera: &Camera, settings: &CameraSettings) -> (Actual, Vec<CameraError>) {
    let mut refused = Vec::new();
    refused.extend(set_format(camera, settings).err());
    refused.extend(set_region(camera, settings).err());
    let (actual, others) = adjust(camera, settings);
    refused.extend(others);
    (actual, refused)
}

/// Applies the settings that may change while the stream runs.
pub(super) fn adjust(camera: &Camera, settings: &CameraSettings) -> (Actual, Vec<CameraError>) {
    let mut refused = Vec::new();
    refused.extend(set_exposure(camera, settings).err());
    if let Some(gain) = settings.analogue_gain {
        refused.extend(set_gain(camera, "analogue_gain", &ANALOGUE_GAIN, gain).err());
    }
    if let Some(gain) = settings.preamp_gain {
        refused.extend(set_gain(camera, "preamp_gain", &PREAMP_GAIN, gain).err());
    }
    let exposure = camera.exposure_time().ok();
    let actual = Actual {
        exposure: exposure.and_then(|us| Duration::try_from_secs_f64(1e-6 * us).ok()),
        analogue_gain: gain(camera, &ANALOGUE_GAIN),
        preamp_gain: gain(camera, &PREAMP_GAIN),
        largest_dn: has(camera, LARGEST_DN)
            .then(|| camera.integer(LARGEST_DN).ok())
            .flatten(),
    };
    (actual, refused)
}

const LARGEST_DN: &str = "PixelDynamicRangeMax";

fn refusal(
    setting: &'static str,
    expected: impl ToString,
    found: Result<impl ToString, aravis::glib::Error>,
) -> CameraError {
    CameraError::Setting {
        setting,
        expected: expected.to_string(),
        found: found.map_or_else(|error| error.to_string(), |found| found.to_string()),
    }
}

/// Sets the first format of the wanted depth that the camera offers.
fn set_format(camera: &Camera, settings: &CameraSettings) -> Result<(), CameraError> {
    let named = || MonoFormat::of_depth(settings.pixel_format).map(|format| format.name);
    let wanted = || named().collect::<Vec<_>>().join(" or ");
    let offered = camera
        .dup_available_pixel_formats_as_strings()
        .map_err(|error| refusal("pixel_format", wanted(), Err::<String, _>(error)))?;
    let Some(format) = named().find(|name| offered.iter().any(|offered| offered == name)) else {
        return Err(refusal("pixel_format", wanted(), Ok(offered.join(", "))));
    };
    let found = camera
        .set_pixel_format_from_string(format)
        .and_then(|()| camera.pixel_format_as_string());
    match found {
        Ok(found) if found == format => Ok(()),
        found => Err(refusal("pixel_format", format, found)),
    }
}

fn set_region(camera: &Camera, settings: &CameraSettings) -> Result<(), CameraError> {
    let wanted = match settings.region {
        Some(region) => [region.x0, region.y0, region.width(), region.height()]
            .map(|pixels| i32::try_from(pixels).unwrap_or(i32::MAX)),
        None => {
            let size = camera.sensor_size();
            size.map(|(width, height)| [0, 0, width, height])
                .map_err(|error| {
                    refusal("region_px", "the sensor's size", Err::<String, _>(error))
                })?
        }
    };
    let [x, y, width, height] = wanted;
    let found = camera
        .set_region(x, y, width, height)
        .and_then(|()| camera.region());
    let shown = |[x, y, w, h]: [i32; 4]| format!("{x},{y},{w},{h}");
    match found {
        Ok(found) if found == wanted.into() => Ok(()),
        found => Err(refusal(
            "region_px",
            shown(wanted),
            found.map(|found| shown(found.into())),
        )),
    }
}

fn set_exposure(camera: &Camera, settings: &CameraSettings) -> Result<(), CameraError> {
    let wanted_us = f64::from(settings.exposure_us);
    // Cameras without an automatic exposure have nothing to switch off.
    let _ = camera.set_exposure_time_auto(aravis::Auto::Off);
    let found = camera
        .set_exposure_time(wanted_us)
        .and_then(|()| camera.exposure_time());
    match found {
        // Cameras quantise the exposure.
        Ok(found_us) if (found_us - wanted_us).abs() <= (0.01 * wanted_us).max(20.0) => Ok(()),
        found => Err(refusal("exposure_us", wanted_us, found)),
    }
}

/// Feature names that cameras use for the gain, the most common one first.
const ANALOGUE_GAIN: [&str; 3] = ["GainRaw", "Gain", "AnalogGain"];
const PREAMP_GAIN: [&str; 3] = ["PreAmpRaw", "PreAmpGain", "PreAmp"];

fn feature<'a>(camera: &Camera, names: &[&'a str]) -> Option<&'a str> {
    names.iter().copied().find(|name| has(camera, name))
}

/// The value of an integer or floating-point feature.
fn number(camera: &Camera, feature: &str) -> Result<f64, aravis::glib::Error> {
    match camera.integer(feature) {
        Ok(whole) => Ok(whole as f64),
        Err(_) => camera.float(feature),
    }
}

fn gain(camera: &Camera, names: &[&str]) -> Option<f64> {
    number(camera, feature(camera, names)?).ok()
}

fn set_gain(
    camera: &Camera,
    setting: &'static str,
    names: &[&str],
    wanted: f64,
) -> Result<(), CameraError> {
    let Some(feature) = feature(camera, names) else {
        let nothing = format!("no feature named {}", names.join(", "));
        return Err(refusal(setting, wanted, Ok(nothing)));
    };
    let _ = camera.set_gain_auto(aravis::Auto::Off);
    let found = camera
        .set_float(feature, wanted)
        .or_else(|_| camera.set_integer(feature, wanted as i64))
        .and_then(|()| number(camera, feature));
    match found {
        Ok(found) if (found - wanted).abs() <= 0.01 * wanted.abs().max(1.0) => Ok(()),
        found => Err(refusal(setting, wanted, found)),
    }
}
