//! A rectangle of a sensor's pixels.

use crate::units::SensorPx;
use std::fmt;
use std::str::FromStr;

/// A rectangle of pixels: columns `x0..x1`, rows `y0..y1`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Region {
    pub x0: usize,
    pub y0: usize,
    pub x1: usize,
    pub y1: usize,
}

impl Region {
    /// The pixels within `reach` px of a position in both axes, clipped to a sensor of `width` x `height`. `None` if there
    /// are none.
    pub fn around(centre: SensorPx, reach: f64, width: usize, height: usize) -> Option<Self> {
        let span = |at: f64, size: usize| {
            let low = (at - reach).floor().clamp(0.0, size as f64) as usize;
            let high = (at + reach + 1.0).ceil().clamp(0.0, size as f64) as usize;
            (low < high).then_some((low, high))
        };
        let (x0, x1) = span(centre.x, width)?;
        let (y0, y1) = span(centre.y, height)?;
        Some(Self { x0, y0, x1, y1 })
    }

    /// A region of `width` x `height` pixels with the given corner.
    pub fn sized(x0: usize, y0: usize, width: usize, height: usize) -> Self {
        Self {
            x0,
            y0,
            x1: x0 + width,
            y1: y0 + height,
        }
    }

    pub fn contains(&self, x: usize, y: usize) -> bool {
        (self.x0..self.x1).contains(&x) && (self.y0..self.y1).contains(&y)
    }

    /// Whether a position lies on the region's pixels, at least `margin_px` inside its edge.
    pub fn holds(&self, at: SensorPx, margin_px: f64) -> bool {
        let within = |v: f64, from: usize, to: usize| {
            v >= from as f64 + margin_px && v <= to as f64 - 1.0 - margin_px
        };
        within(at.x, self.x0, self.x1) && within(at.y, self.y0, self.y1)
    }

    /// The intersection of two regions; `None` if it is empty.
    pub fn intersection(&self, other: &Self) -> Option<Self> {
        let common = Self {
            x0: self.x0.max(other.x0),
            y0: self.y0.max(other.y0),
            x1: self.x1.min(other.x1),
            y1: self.y1.min(other.y1),
        };
        (common.x0 < common.x1 && common.y0 < common.y1).then_some(common)
    }

    pub fn width(&self) -> usize {
        self.x1 - self.x0
    }

    pub fn height(&self) -> usize {
        self.y1 - self.y0
    }
}

impl fmt::Display for Region {
    /// Format: column and row of the corner, width and height, "100,50,640,480".
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (width, height) = (self.width(), self.height());
        write!(out, "{},{},{width},{height}", self.x0, self.y0)
    }
}

impl FromStr for Region {
    type Err = NoRegion;

    fn from_str(text: &str) -> Result<Self, NoRegion> {
        let numbers: Result<Vec<u16>, _> = text.split(',').map(|n| n.trim().parse()).collect();
        match numbers.map_err(|_| NoRegion)?[..] {
            [x0, y0, width, height] if width > 0 && height > 0 => {
                let [x0, y0, width, height] = [x0, y0, width, height].map(usize::from);
                Ok(Self::sized(x0, y0, width, height))
            }
            _ => Err(NoRegion),
        }
    }
}

/// A text that is not a region.
#[derive(Debug, Clone, Copy, PartialEq, thiserror::Error)]
#[error("expected LEFT,TOP,WIDTH,HEIGHT in px")]
pub struct NoRegion;
