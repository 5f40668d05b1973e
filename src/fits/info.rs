//! Exposure data of a frame, from keywords.
//!
//! None of them is needed to find the Sun: a value that cannot be used is a [`Warning`] of the frame.

use super::place::read_place;
use super::times::{LONGEST_S, heroes_monotonic, mid_exposure};
use super::values::Values;
use crate::clock::Utc;
use crate::frame::{FrameInfo, Warning};
use jiff::SignedDuration;
use std::time::Duration;

/// Reads the exposure data of a frame, except for the part of the sensor that it shows. The warnings stay with the values.
pub(super) fn read_info(values: &mut Values) -> FrameInfo {
    let exposure = ["EXPTIME", "XPOSURE", "EXPOSURE"]
        .into_iter()
        .find_map(|keyword| seconds(values, keyword));
    let (mid_exposure, untimed) = mid_exposure(values, exposure);
    let (place, unplaced) = read_place(values);
    let camera = values.text("CAMERA").or_else(|| values.text("INSTRUME"));
    FrameInfo {
        number: values.whole("FRAMENUM"),
        mid_exposure: mid_exposure.map(|utc: Utc| utc.time),
        in_leap_second: mid_exposure.is_some_and(|utc| utc.in_leap_second),
        monotonic: seconds(values, "MONOTIME").or_else(|| heroes_monotonic(values, exposure)),
        instrument: values.text("OBSRVTRY"),
        utc_step: step(values),
        camera_clock: values.whole("CAMCLOCK").map(Duration::from_nanos),
        exposure,
        analogue_gain: values.first_number(["GAIN", "GAIN_ANA"]),
        preamp_gain: values.first_number(["PREAMP", "GAIN_PRE"]),
        camera_temperature_c: values.first_number(["CAMTEMP", "TEMPCCD"]),
        corner_px: None,
        place,
        camera,
        warnings: Vec::new(),
        untimed,
        unplaced,
    }
}

/// A duration.
fn seconds(values: &mut Values, keyword: &str) -> Option<Duration> {
    let seconds = values.within(keyword, 0.0..=LONGEST_S, "a time from 0 to 1e9 s")?;
    Some(Duration::from_secs_f64(seconds))
}

fn step(values: &mut Values) -> Option<SignedDuration> {
    let seconds = values.number("UTCSTEP")?;
    let step = SignedDuration::try_from_secs_f64(seconds);
    step.inspect_err(|_| values.warn(Warning::new("UTCSTEP", "a time in seconds", seconds)))
        .ok()
}
