//! The value at which a frame's pixels saturate.

use super::header::Header;
use super::values::Values;
use crate::frame::{PixelSlice, Warning};

/// Factor by which pixels must exceed a header's SATURATE to show that it is wrong: sensors respond beyond the end of linearity, but not so far.
const CONTRADICTED: u32 = 2;

/// The value of SATURATE.
pub(super) fn stated(values: &mut Values, pixels: PixelSlice<'_>) -> Option<u16> {
    let expected = "a level from 1 to 65535 DN";
    let level = values.within("SATURATE", 1.0..=65_535.0, expected)? as u16;
    Some(level.min(full(pixels)))
}

/// The value of SATURATE or BITDEPTH, unless pixels contradict it. Otherwise the range of 16-bit pixels is 0 to 4095, or all 16 bits
/// if a pixel exceeds 4095.
pub(super) fn saturation_dn(values: &mut Values, pixels: PixelSlice<'_>) -> u16 {
    let exceed = |most: u32| u32::from(pixels.bits_set()) > most;
    if let Some(level) = stated(values, pixels) {
        let most = (CONTRADICTED * u32::from(level)).next_power_of_two();
        if most >= full(pixels).into() || is_own(values.header) || !exceed(most) {
            return level;
        }
        contradicts(values, "SATURATE", format!("{level} DN"), pixels);
    } else if let Some(bits) = values.within("BITDEPTH", 1.0..=16.0, "1 to 16 bit") {
        let most = (1u32 << bits as u32) - 1;
        if !exceed(most) {
            return most.min(full(pixels).into()) as u16;
        }
        contradicts(values, "BITDEPTH", format!("{bits} bit"), pixels);
    }
    pixels.assumed_saturation_dn()
}

/// Whether this program wrote the file: then its SATURATE is valid, and rows that are decoded one by one need not be compared with it.
pub(super) fn is_own(header: &Header) -> bool {
    let creator = header.text("CREATOR").ok().flatten();
    creator.is_some_and(|creator| creator.starts_with(env!("CARGO_PKG_NAME")))
}

fn full(pixels: PixelSlice<'_>) -> u16 {
    match pixels {
        PixelSlice::U8(_) => 255,
        PixelSlice::U16(_) => u16::MAX,
    }
}

fn contradicts(values: &mut Values, keyword: &str, stated: String, pixels: PixelSlice<'_>) {
    let brightest = match pixels {
        PixelSlice::U8(p) => p.iter().copied().max().map(u16::from),
        PixelSlice::U16(p) => p.iter().copied().max(),
    };
    let found = format!("{stated} beside a pixel of {}", brightest.unwrap_or(0));
    values.warn(Warning::new(keyword, "what the pixels show", found));
}
