//! Conversion to the 16-bit integers of frames, for pixels that are no unsigned integers of a camera: floating-point pixels, scaled ones, and
//! negative or undefined values among integers.
//!
//! Integers that fit into 16 bits are unchanged, except for an offset if some are negative. All others are scaled to the whole
//! range, so that a step is far below their noise. A value is impossible if it is so far from the median that no camera could
//! represent both: beyond a range of 16 bits, in steps as large as the noise, and many times the range of nearly all pixels.

use super::header::Header;
use super::values::Values;
use super::{Problem, saturation};
use crate::estimation::median;
use crate::frame::{Frame, FrameInfo, Pixels, Warning};

/// The largest pixel value of a frame.
const TOP: f32 = u16::MAX as f32;
/// Sampling interval of the pixels from which spread and noise are estimated.
const SAMPLED: usize = 61;
/// Fraction of the pixels below and above the spread of nearly all.
const OUTSIDE: f64 = 0.01;
/// Factor of that spread that is still possible: frames that are means of many have little noise.
const SPREADS: f32 = 100.0;
/// Number of pixels with the largest value from which it counts as saturation.
const SATURATED_PIXELS: usize = 100;

/// Storage of pixels that are not plain integers (FITS 4.0, sections 4.4.2.5 and 7).
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Coding {
    /// BITPIX.
    pub bits: i64,
    pub scale: f64,
    pub zero: f64,
    /// Integer that means a missing value.
    pub blank: Option<i64>,
}

impl Coding {
    /// Reads the coding of an image's header; for a compressed one, `prefix` is Z.
    pub fn read(header: &Header, prefix: &str) -> Result<Self, Problem> {
        let blank = ["BLANK", "ZBLANK"].into_iter();
        let mut blanks = blank.map(|keyword| header.integer(keyword).ok().flatten());
        let field = format!("{prefix}BITPIX");
        let bits = match header.integer(&field)? {
            Some(bits @ (8 | 16 | 32 | 64 | -32 | -64)) => bits,
            bits => {
                let found = bits.map_or("nothing".into(), |bits| bits.to_string());
                return Err(Problem::field(field, "8, 16, 32, 64, -32 or -64", found));
            }
        };
        Ok(Self {
            bits,
            scale: header.number("BSCALE")?.unwrap_or(1.0),
            zero: header.number("BZERO")?.unwrap_or(0.0),
            blank: blanks.find_map(|blank| blank),
        })
    }

    pub fn bytes(self) -> usize {
        self.bits.unsigned_abs() as usize / 8
    }

    /// The value of an integer as stored; NaN if it has none.
    pub fn whole(self, number: i64) -> f32 {
        match Some(number) == self.blank {
            true => f32::NAN,
            false => (self.zero + self.scale * number as f64) as f32,
        }
    }

    /// The values of big-endian numbers as stored.
    pub fn values(self, data: &[u8]) -> Vec<f32> {
        let real = |number: f64| (self.zero + self.scale * number) as f32;
        let numbers = data.chunks_exact(self.bytes());
        let value = |bytes: &[u8]| match *bytes {
            [a] => self.whole(a.into()),
            [a, b] => self.whole(i16::from_be_bytes([a, b]).into()),
            [a, b, c, d] if self.bits > 0 => self.whole(i32::from_be_bytes([a, b, c, d]).into()),
            [a, b, c, d] => real(f32::from_be_bytes([a, b, c, d]).into()),
            [a, b, c, d, e, f, g, h] if self.bits > 0 => {
                self.whole(i64::from_be_bytes([a, b, c, d, e, f, g, h]))
            }
            [a, b, c, d, e, f, g, h] => real(f64::from_be_bytes([a, b, c, d, e, f, g, h])),
            _ => f32::NAN,
        };
        numbers.map(value).collect()
    }
}

/// Values converted to the pixels of a frame.
pub(super) struct Digitised {
    pub pixels: Pixels,
    /// Pixels that have no value, or an impossible one.
    pub unusable: Vec<bool>,
    pub warnings: Vec<Warning>,
    /// A pixel is (value - `zero`) / `step`.
    zero: f32,
    step: f32,
    /// The largest value, if many pixels have it.
    saturation: Option<u16>,
}

impl Digitised {
    /// The value at which pixels saturate: from SATURATE, in the unit of the values; else from the pixels.
    pub fn saturation_dn(&self, values: &mut Values) -> u16 {
        if self.zero == 0.0 && self.step == 1.0 {
            return saturation::saturation_dn(values, self.pixels.as_slice());
        }
        let stated = values.number("SATURATE");
        self.dn(stated).or(self.saturation).unwrap_or(u16::MAX)
    }

    /// The pixel with this value; `None` if it is below the smallest.
    fn dn(&self, value: Option<f64>) -> Option<u16> {
        let dn = (value? - f64::from(self.zero)) / f64::from(self.step);
        (dn >= 1.0).then_some(dn.min(TOP.into()) as u16)
    }
}

/// A frame of values of any kind, in the order of its pixels: as 16-bit integers, scaled if need be. `bits` is BITPIX,
/// and `saturation` is the value at which they saturate, in their own unit.
///
/// # Errors
/// If no pixel has a value, or there are not `width` x `height` values.
pub fn frame_of_values(
    values: &[f32],
    bits: i64,
    [width, height]: [usize; 2],
    saturation: Option<f64>,
    info: FrameInfo,
) -> Result<Frame, Problem> {
    let mut digitised = digitise(values, bits)?;
    let mut warnings = info.warnings;
    warnings.append(&mut digitised.warnings);
    let by_pixels = || {
        digitised
            .saturation
            .unwrap_or(digitised.pixels.as_slice().assumed_saturation_dn())
    };
    let saturation = digitised.dn(saturation).unwrap_or_else(by_pixels);
    let info = FrameInfo { warnings, ..info };
    let frame = Frame::new(width, height, digitised.pixels, saturation, info);
    let frame = frame.map_err(|error| Problem::content("a frame", error.to_string()))?;
    Ok(frame.with_unusable(digitised.unusable))
}

/// Converts values to pixels; `bits` is BITPIX.
///
/// # Errors
/// If no pixel has a value.
pub(super) fn digitise(values: &[f32], bits: i64) -> Result<Digitised, Problem> {
    let none = || Problem::field("pixels", "some pixel with a value", "none");
    let (low, high) = range(values).ok_or_else(none)?;
    let is_possible = |value: f32| value.is_finite() && (low..=high).contains(&value);
    let possible = || values.iter().copied().filter(|value| is_possible(*value));
    let least = possible().fold(f32::INFINITY, f32::min);
    let most = possible().fold(f32::NEG_INFINITY, f32::max);
    let is_whole = possible().all(|value| value.fract() == 0.0) && most - least.min(0.0) <= TOP;
    let (zero, step) = match is_whole {
        true => (least.min(0.0), 1.0),
        false => (least, ((most - least) / TOP).max(f32::MIN_POSITIVE)),
    };
    let unusable: Vec<bool> = values.iter().map(|value| !is_possible(*value)).collect();
    let dn = |value: &f32| match is_possible(*value) {
        true => ((value - zero) / step).round() as u16,
        false => 0,
    };
    let pixels: Vec<u16> = values.iter().map(dn).collect();
    let top = ((most - zero) / step).round() as u16;
    let at_top = pixels.iter().filter(|dn| **dn == top).count();
    let mut warnings = Vec::new();
    if !is_whole {
        let expected = "whole numbers of at most 16 bit";
        let found = format!("{least} to {most}, scaled to 16 bit");
        warnings.push(Warning::new("pixels", expected, found));
    } else if zero < 0.0 {
        let found = format!("{zero}; {} was added to all", -zero);
        warnings.push(Warning::new("pixels", "numbers from 0", found));
    }
    let masked = unusable.iter().filter(|unusable| **unusable).count();
    if masked > 0 {
        let found = format!("{masked} without one, or with an impossible one, masked");
        warnings.push(Warning::new("pixels", "a value in each", found));
    }
    Ok(Digitised {
        pixels: match bits == 8 && is_whole && most <= 255.0 && zero == 0.0 {
            true => Pixels::U8(pixels.iter().map(|dn| *dn as u8).collect()),
            false => Pixels::U16(pixels),
        },
        unusable,
        warnings,
        zero,
        step,
        saturation: (!is_whole && at_top >= SATURATED_PIXELS).then_some(top),
    })
}

/// The smallest and the largest possible value; `None` if there is no value.
fn range(values: &[f32]) -> Option<(f32, f32)> {
    let finite = |value: &f32| value.is_finite().then_some(*value);
    let mut sample: Vec<f32> = values.iter().step_by(SAMPLED).filter_map(finite).collect();
    if sample.is_empty() {
        sample = values.iter().filter_map(finite).collect();
    }
    sample.sort_by(f32::total_cmp);
    let last = sample.len().checked_sub(1)?;
    let outside = (OUTSIDE * last as f64) as usize;
    let (low, middle, high) = (sample[outside], sample[last / 2], sample[last - outside]);
    let differences = values.windows(2).step_by(SAMPLED).filter_map(|pair| {
        let difference = f64::from((pair[1] - pair[0]).abs());
        (difference.is_finite() && difference > 0.0).then_some(difference)
    });
    let noise = median(differences).unwrap_or(0.0) as f32;
    let reach = (TOP * noise).max(SPREADS * (high - low));
    match reach > 0.0 {
        true => Some((middle - reach, middle + reach)),
        false => Some((f32::MIN, f32::MAX)),
    }
}

/// Warning that a picture's luminance is read.
pub(super) fn luminance_warning(kind: &str) -> Warning {
    let found = format!("{kind}: its luminance, which is seldom proportional to light");
    Warning::new("picture", "greyscale of 8 or 16 bit", found)
}
