//! The disc without its own brightness.

use super::darkening::{Darkening, RINGS, ring};
use crate::frame::{Frame, Levels, Region, Sample, View};
use crate::geometry::Ellipse;
use crate::lanes::{LANES, counted_lanes, first_lanes};
use crate::units::SensorPx;
use crate::with_view;
use multiversion::multiversion;
use nalgebra::Vector2;
use std::ops::Range;

/// The darkness of every pixel about the disc: 0 on the clean disc and outside it, 1 where no light is left.
#[derive(Debug, Clone, PartialEq)]
pub struct FlatDisc {
    pub outline: Ellipse,
    sensor_px: [f64; 2],
    /// The sensor's pixel that the first value belongs to; the square about the disc may reach over the sensor.
    left: isize,
    top: isize,
    side: usize,
    darkness: Vec<f32>,
    /// 1 sigma of the darkness by ring.
    noise: [f32; RINGS],
}

impl FlatDisc {
    /// Flattens a disc by the medians of its rings, which marks are too small to move, and by the light's tilt across it,
    /// with a margin of darkness 0 about it. Pixels brighter than the noise allows (scratches, hot pixels) are clipped.
    /// `None` when the disc is not on the sensor.
    pub fn new(frame: &Frame, outline: Ellipse, levels: &Levels, margin_px: f64) -> Option<Self> {
        let reach = outline.mean_radius() * 1.02;
        let (width, height) = (frame.width(), frame.height());
        let region = Region::around(outline.centre.into(), reach, width, height)?;
        with_view!(frame, view => Some(Self::of(&view, region, outline, levels, margin_px)))
    }

    fn of<T: Sample>(
        view: &View<'_, T>,
        region: Region,
        outline: Ellipse,
        levels: &Levels,
        margin_px: f64,
    ) -> Self {
        let darkening = Darkening::measure(view, region, &outline, levels);
        let reach = outline.mean_radius() * 1.02 + margin_px;
        let left = (outline.centre.x - reach).floor() as isize;
        let top = (outline.centre.y - reach).floor() as isize;
        let side = (2.0 * reach).ceil() as usize + 2;
        let mut darkness = Vec::with_capacity(side * side);
        for y in top..top + side as isize {
            let first = darkness.len();
            darkness.resize(first + side, 0.0);
            let Some(y) = usize::try_from(y)
                .ok()
                .filter(|y| (region.y0..region.y1).contains(y))
            else {
                continue;
            };
            let row = &mut darkness[first..];
            let values = &mut row[(region.x0 as isize - left) as usize..][..region.width()];
            let seen = &view.pixels[y * view.width..][region.x0..region.x1];
            if let Some(row) = Row::new(&outline, &darkening.tilt, region.x0, y) {
                flatten_row(&darkening, &row, seen, values);
            }
        }
        Self {
            outline,
            sensor_px: [view.width as f64, view.height as f64],
            left,
            top,
            side,
            darkness,
            noise: darkening.noise,
        }
    }

    /// Pixels in a row, and rows.
    pub fn side(&self) -> usize {
        self.side
    }

    /// The darkness, row by row.
    pub(super) fn values(&self) -> &[f32] {
        &self.darkness
    }

    /// The sensor position of a value's index.
    pub(super) fn position(&self, index: usize) -> SensorPx {
        let (row, column) = (index / self.side, index % self.side);
        SensorPx::new(
            (self.left + column as isize) as f64,
            (self.top + row as isize) as f64,
        )
    }

    /// Values of a row about a position's nearest pixel: from `reach` left of it, the `row`-th from `reach` above it.
    pub(super) fn row_from(
        &self,
        at: SensorPx,
        reach: usize,
        row: usize,
        count: usize,
    ) -> Option<&[f32]> {
        let from = |v: f64, first: isize| {
            usize::try_from(v.round() as isize - first - reach as isize).ok()
        };
        let (x, y) = (from(at.x, self.left)?, from(at.y, self.top)? + row);
        (x + count <= self.side && y < self.side)
            .then(|| &self.darkness[y * self.side + x..][..count])
    }

    /// The values within a radius of a position, as far as there are any: row by row, with where the row's first one is on
    /// the sensor.
    pub(super) fn around(
        &self,
        middle: SensorPx,
        radius_px: f64,
    ) -> impl Iterator<Item = (Vector2<f64>, &[f32])> {
        // Numbers of pixels from the first to the last within a reach of a place, as far as there are any.
        let span = |place: f64, reach: f64| {
            let low = (place - reach).ceil().max(0.0) as usize;
            let high = (place + reach).floor() + 1.0;
            low..(high.max(0.0) as usize).min(self.side)
        };
        let from_first = middle.vector() - Vector2::new(self.left as f64, self.top as f64);
        span(from_first.y, radius_px).filter_map(move |row| {
            let dy = row as f64 - from_first.y;
            let half = (radius_px * radius_px - dy * dy).max(0.0).sqrt();
            let columns = span(from_first.x, half);
            let first = Vector2::new(
                (self.left + columns.start as isize) as f64,
                (self.top + row as isize) as f64,
            );
            let values = self.darkness[row * self.side..][..self.side].get(columns)?;
            Some((first, values))
        })
    }

    /// 1 sigma of the darkness at a position.
    pub fn noise(&self, at: SensorPx) -> f64 {
        let w = self.outline.to_disc(at.vector());
        f64::from(self.noise[ring((1.0 - w.norm_squared()).max(0.0) as f32)])
    }

    /// Whether a position is lit: inside the limb and on the sensor, by a margin.
    pub fn is_lit(&self, at: SensorPx, margin_px: f64) -> bool {
        let within = |v: f64, size: f64| v >= margin_px && v <= size - 1.0 - margin_px;
        self.outline.excess(at.vector()) < -margin_px
            && within(at.x, self.sensor_px[0])
            && within(at.y, self.sensor_px[1])
    }
}

/// A row of the sensor across the disc.
struct Row {
    /// Along the row mu^2 = bend (half^2 - (x - middle)^2): middle, half^2, bend; x from the row's first pixel.
    parabola: [f32; 3],
    /// What takes the tilt off the light, at the first pixel and per column.
    tilt: [f32; 2],
    /// The pixels in the disc.
    inside: Range<usize>,
}

impl Row {
    /// From column `x0` on; `None` where the row passes the disc by.
    fn new(outline: &Ellipse, tilt: &Vector2<f32>, x0: usize, y: usize) -> Option<Self> {
        let first = outline.to_disc(Vector2::new(x0 as f64, y as f64));
        let step = outline.to_disc(Vector2::new(x0 as f64 + 1.0, y as f64)) - first;
        // The row's part in the disc lies between the parabola's roots.
        let (bend, slope) = (step.norm_squared(), step.dot(&first));
        let middle = -slope / bend;
        let half2 = middle * middle - (first.norm_squared() - 1.0) / bend;
        (half2 > 0.0).then(|| {
            let from = (middle - half2.sqrt()).ceil().max(0.0) as usize;
            let to = ((middle + half2.sqrt()).floor() + 1.0).max(0.0) as usize;
            Self {
                parabola: [middle, half2, bend].map(|v| v as f32),
                tilt: [1.0 - tilt.dot(&first.cast()), -tilt.dot(&step.cast())],
                inside: from..to,
            }
        })
    }
}

/// The darkness of a row's pixels, of which those outside the disc have none.
#[multiversion(targets("x86_64+avx2"))]
fn flatten_row<T: Sample>(darkening: &Darkening, row: &Row, seen: &[T], darkness: &mut [f32]) {
    let [middle, half2, bend] = row.parabola;
    let [tilt, tilt_step] = row.tilt;
    let end = row.inside.end.min(seen.len());
    for from in (row.inside.start..end).step_by(LANES) {
        // A last group that reaches beyond the disc finds nothing to be judged there.
        let along = counted_lanes(from as f32);
        let mut light = first_lanes(&seen[from..]);
        let mut mu2 = [0.0; LANES];
        for k in 0..LANES {
            let off = along[k] - middle;
            mu2[k] = bend * (half2 - off * off);
            light[k] = (light[k] - darkening.background_dn) * (tilt + tilt_step * along[k]);
        }
        let dark = darkening.darkness(&light, &mu2);
        match darkness[from..].first_chunk_mut::<LANES>() {
            Some(whole) => *whole = dark,
            None => darkness[from..]
                .iter_mut()
                .zip(dark)
                .for_each(|(darkness, dark)| *darkness = dark),
        }
    }
}
