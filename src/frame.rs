//! A picture with the circumstances of its exposure.

mod copies;
mod cutout;
mod pixels;
mod region;
mod unreadable;
mod unusable;
mod warning;

use crate::clock::Utc;
use crate::kernels::any_above;
use crate::units::{Place, SensorPx};
pub use copies::{Compared, Copies, Identity, PixelDigest, may_be_copies};
pub use cutout::{Background, Cutout, Mask, PixelNoise};
use jiff::{SignedDuration, Timestamp};
use pixels::{OnDemand, PixelStorage, Shared};
pub use pixels::{PixelSlice, Pixels, RowSource, Sample, SharedPixels, View};
pub use region::{NoRegion, Region};
use serde::{Deserialize, Serialize};
use std::ops::Range;
use std::sync::Arc;
use std::time::Duration;
pub use unreadable::Unreadable;
use unusable::Unusable;
pub use warning::{Warning, Warnings};

/// Camera name of frames made by the simulator, which distinguishes them from real ones.
pub const SIMULATED_CAMERA: &str = "simulated";

/// Circumstances of a frame's exposure. A value that the source does not state is `None`.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct FrameInfo {
    /// Number of the frame in its sequence.
    pub number: Option<u64>,
    /// The middle of the exposure, UTC: the time of the aspect.
    pub mid_exposure: Option<Timestamp>,
    /// Whether the middle lies in a leap second, which has the same count as the second after it.
    pub in_leap_second: bool,
    /// The middle of the exposure on the host's monotonic clock, since an arbitrary start.
    pub monotonic: Option<Duration>,
    /// Step of UTC against the monotonic clock since the previous frame, if there was one.
    pub utc_step: Option<SignedDuration>,
    /// The camera's own clock for this frame, since an arbitrary start.
    pub camera_clock: Option<Duration>,
    /// Exposure time.
    pub exposure: Option<Duration>,
    /// Analogue gain, the camera's own units.
    pub analogue_gain: Option<f64>,
    /// Pre-amplifier gain, the camera's own units.
    pub preamp_gain: Option<f64>,
    /// Temperature of the camera, deg C.
    pub camera_temperature_c: Option<f64>,
    /// Column and row of the sensor of the frame's first pixel, if only a part of the sensor was read.
    pub corner_px: Option<(usize, usize)>,
    /// Place where the frame was taken.
    pub place: Option<Place>,
    /// The camera's name in the source.
    pub camera: Option<String>,
    /// The instrument's name in the header.
    pub instrument: Option<String>,
    /// Values of the file that were not used as stored; empty for a good file.
    pub warnings: Vec<Warning>,
    /// The warning that explains why the frame has no time although its file states one.
    pub untimed: Option<Warning>,
    /// The warning that explains why the frame has no place although its file states one.
    pub unplaced: Option<Warning>,
}

/// Instrument and camera of a frame, from its header.
#[derive(Debug, Clone, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub struct TakenBy {
    /// `OBSRVTRY`.
    pub instrument: Option<String>,
    /// `CAMERA`, else `INSTRUME`.
    pub camera: Option<String>,
}

impl FrameInfo {
    /// The middle of the exposure.
    pub fn utc(&self) -> Option<Utc> {
        let utc = |time| Utc {
            time,
            in_leap_second: self.in_leap_second,
        };
        self.mid_exposure.map(utc)
    }

    pub fn taken_by(&self) -> TakenBy {
        TakenBy {
            instrument: self.instrument.clone(),
            camera: self.camera.clone(),
        }
    }

    /// Whether the frame was made by the simulator.
    pub fn is_simulated(&self) -> bool {
        self.camera.as_deref() == Some(SIMULATED_CAMERA)
    }

    /// The start of the exposure, if both its middle and its length are known.
    pub fn exposure_start(&self) -> Option<Timestamp> {
        let half = SignedDuration::try_from(self.exposure? / 2).ok()?;
        self.mid_exposure?.checked_sub(half).ok()
    }

    /// The end of the exposure, if both its middle and its length are known.
    pub fn exposure_end(&self) -> Option<Timestamp> {
        let half = SignedDuration::try_from(self.exposure? / 2).ok()?;
        self.mid_exposure?.checked_add(half).ok()
    }
}

/// Why pixels do not make a frame.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum FrameError {
    #[error("expected {width} x {height} = {expected} pixels, found {found}")]
    Size {
        width: usize,
        height: usize,
        expected: usize,
        found: usize,
    },
    #[error("expected a frame of at least one pixel, found {width} x {height}")]
    Empty { width: usize, height: usize },
}

/// A picture with the circumstances of its exposure.
#[derive(Debug, Clone, PartialEq)]
pub struct Frame {
    width: usize,
    height: usize,
    pixels: PixelStorage,
    /// None if all pixels are usable.
    unusable: Option<Unusable>,
    saturation_dn: u16,
    pub info: FrameInfo,
}

impl Frame {
    /// A frame of `width` x `height` pixels, row by row, whose pixels saturate at `saturation_dn`.
    pub fn new(
        width: usize,
        height: usize,
        pixels: Pixels,
        saturation_dn: u16,
        info: FrameInfo,
    ) -> Result<Self, FrameError> {
        check_count(width, height, pixels.len())?;
        Ok(Self {
            width,
            height,
            pixels: PixelStorage::Whole(pixels),
            unusable: None,
            saturation_dn,
            info,
        })
    }

    /// The same for pixels in the caller's memory, which are not copied.
    pub fn shared(
        width: usize,
        height: usize,
        pixels: Box<dyn SharedPixels>,
        saturation_dn: u16,
        info: FrameInfo,
    ) -> Result<Self, FrameError> {
        check_count(width, height, pixels.pixels().len())?;
        Ok(Self {
            width,
            height,
            pixels: PixelStorage::Shared(Arc::new(Shared::new(pixels))),
            unusable: None,
            saturation_dn,
            info,
        })
    }

    /// A frame of `height` rows that are taken from `source` on first access. They have the length and the type of `dark`,
    /// which replaces a damaged row.
    pub fn on_demand(
        dark: Pixels,
        height: usize,
        source: Box<dyn RowSource>,
        saturation_dn: u16,
        info: FrameInfo,
    ) -> Result<Self, FrameError> {
        let width = dark.len();
        if width * height == 0 {
            return Err(FrameError::Empty { width, height });
        }
        let rows = OnDemand::new(source, dark, height);
        Ok(Self {
            width,
            height,
            pixels: PixelStorage::OnDemand(Arc::new(rows)),
            unusable: None,
            saturation_dn,
            info,
        })
    }

    /// Number of pixels in a row.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Number of rows.
    pub fn height(&self) -> usize {
        self.height
    }

    /// The whole sensor.
    pub fn region(&self) -> Region {
        Region {
            x0: 0,
            y0: 0,
            x1: self.width,
            y1: self.height,
        }
    }

    /// All pixels.
    pub fn pixels(&self) -> &Pixels {
        self.pixels.whole()
    }

    /// Bits of a stored pixel.
    pub fn bits(&self) -> u32 {
        self.pixels.bits()
    }

    /// A typed view of the pixels. The type must be that of the pixels.
    pub fn view<T: Sample>(&self) -> View<'_, T> {
        self.pixels.view(self.width, self.height)
    }

    /// The value of column `x`, row `y`, DN.
    pub fn dn(&self, x: usize, y: usize) -> f32 {
        crate::with_view!(self, view => view.dn(x, y))
    }

    /// Whether at least one of the columns of a row is brighter than `dn`. The comparison uses integers, which quickly
    /// skips dark rows, the majority.
    pub fn is_brighter(&self, y: usize, columns: Range<usize>, dn: f64) -> bool {
        crate::with_view!(self, view => {
            any_above(&view.row(y)[columns], Sample::floor(dn))
        })
    }

    /// Counts the values of some columns of a row; values beyond the last count as the last.
    pub fn count(&self, y: usize, columns: Range<usize>, counts: &mut [u32]) {
        let Some((last, others)) = counts.split_last_mut() else {
            return;
        };
        crate::with_view!(self, view => {
            for pixel in &view.row(y)[columns] {
                let value: u32 = (*pixel).into();
                *others.get_mut(value as usize).unwrap_or(&mut *last) += 1;
            }
        });
    }

    /// The values of some columns of a row, DN.
    pub fn row_dn(&self, y: usize, columns: Range<usize>) -> Vec<f32> {
        let mut list = Vec::new();
        self.read_row(y, columns, &mut list);
        list
    }

    /// The values of some rows of a column, DN.
    pub fn column_dn(&self, x: usize, rows: Range<usize>) -> Vec<f32> {
        let mut list = Vec::new();
        self.read_column(x, rows, &mut list);
        list
    }

    /// Replaces the contents of a list by the values of some columns of a row, DN.
    pub fn read_row(&self, y: usize, columns: Range<usize>, list: &mut Vec<f32>) {
        list.clear();
        crate::with_view!(self, view => {
            list.extend(view.row(y)[columns].iter().map(|pixel| pixel.dn()));
        });
    }

    /// Replaces the contents of a list by the values of some rows of a column, DN.
    pub fn read_column(&self, x: usize, rows: Range<usize>, list: &mut Vec<f32>) {
        list.clear();
        crate::with_view!(self, view => list.extend(rows.map(|y| view.dn(x, y))));
    }

    /// The pixels within `reach` px of a position in both axes; `None` if none is on the sensor.
    pub fn around(&self, centre: SensorPx, reach: f64) -> Option<Region> {
        Region::around(centre, reach, self.width, self.height)
    }

    /// The part of the frame within a region; `None` if the region is empty or extends beyond the frame.
    pub fn cropped(&self, region: Region) -> Option<Self> {
        let within = region.x1 <= self.width && region.y1 <= self.height;
        if !within || region.x0 >= region.x1 || region.y0 >= region.y1 {
            return None;
        }
        let pixels = match self.pixels() {
            Pixels::U8(pixels) => Pixels::U8(cropped(pixels, self.width, region)),
            Pixels::U16(pixels) => Pixels::U16(cropped(pixels, self.width, region)),
        };
        let unusable = self.unusable.as_ref();
        let unusable = unusable.map(|unusable| cropped(unusable, self.width, region).into());
        let (x0, y0) = self.info.corner_px.unwrap_or((0, 0));
        Some(Self {
            width: region.width(),
            height: region.height(),
            pixels: PixelStorage::Whole(pixels),
            unusable,
            saturation_dn: self.saturation_dn,
            info: FrameInfo {
                corner_px: Some((x0 + region.x0, y0 + region.y0)),
                ..self.info.clone()
            },
        })
    }

    /// The value at which a pixel saturates, DN.
    pub fn saturation_dn(&self) -> u16 {
        self.saturation_dn
    }
}

/// Checks that the number of pixels matches the size of the frame.
fn check_count(width: usize, height: usize, found: usize) -> Result<(), FrameError> {
    let expected = width * height;
    if expected == 0 {
        return Err(FrameError::Empty { width, height });
    }
    if found != expected {
        return Err(FrameError::Size {
            width,
            height,
            expected,
            found,
        });
    }
    Ok(())
}

/// The pixels of rows of `width` that lie within a region.
fn cropped<T: Copy>(pixels: &[T], width: usize, region: Region) -> Vec<T> {
    pixels
        .chunks_exact(width)
        .skip(region.y0)
        .take(region.height())
        .flat_map(|row| &row[region.x0..region.x1])
        .copied()
        .collect()
}

/// Variance of a uniform distribution over one pixel, px^2: the contribution of the pixel's size to the blur.
pub const PIXEL_VARIANCE_PX2: f64 = 1.0 / 12.0;

/// Noise from rounding to integers, 1 sigma, DN: the minimum of any frame.
pub const ROUNDING_NOISE_DN: f64 = 0.2887;

/// Brightness levels of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Levels {
    pub background_dn: f64,
    /// 1 sigma of the background.
    pub noise_dn: f64,
    /// The disc's bright part.
    pub disc_dn: f64,
}

impl Levels {
    /// The threshold that defines the limb, DN.
    pub fn threshold_dn(&self, fraction: f64) -> f64 {
        self.background_dn + fraction * (self.disc_dn - self.background_dn)
    }
}
