//! The disc without its own brightness.

use super::darkening::{Darkening, RINGS, Row, ring};
use crate::frame::{Frame, Levels, Region, Sample, View};
use crate::geometry::Ellipse;
use crate::lanes::LANES;
use crate::units::SensorPx;
use crate::with_view;
use multiversion::multiversion;

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
        // Pairs of columns come in whole lanes.
        let side = ((2.0 * reach).ceil() as usize + 2).next_multiple_of(2 * LANES);
        let mut darkness = Vec::with_capacity(side * side);
        for y in top..top + side as isize {
            let first = darkness.len();
            darkness.resize(first + side, 0.0);
            let rows = region.y0..region.y1;
            let Some(y) = usize::try_from(y).ok().filter(|y| rows.contains(y)) else {
                continue;
            };
            let Some(row) = Row::new(&outline, region.x0, y, region.width()) else {
                continue;
            };
            let values = &mut darkness[first..][(region.x0 as isize - left) as usize..];
            let seen = &view.pixels[y * view.width..][region.x0..view.width];
            // Whole lanes: what lies beyond the disc is not judged.
            let count = row.inside.len().next_multiple_of(LANES);
            let to = seen.len().min(values.len()).min(row.inside.start + count);
            let inside = row.inside.start..to;
            flatten_row(&darkening, &row, &seen[inside.clone()], &mut values[inside]);
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

    /// The index of the value nearest to a position; `None` beyond the square.
    pub(super) fn index(&self, at: SensorPx) -> Option<usize> {
        let column = at.x.round() - self.left as f64;
        let row = at.y.round() - self.top as f64;
        let within = |v: f64| (0.0..self.side as f64).contains(&v);
        (within(column) && within(row)).then(|| row as usize * self.side + column as usize)
    }

    /// 1 sigma of the darkness at a position.
    pub fn noise(&self, at: SensorPx) -> f64 {
        let w = self.outline.to_disc(at.vector());
        f64::from(self.noise[ring((1.0 - w.norm_squared()) as f32) as usize])
    }

    /// Whether a position is lit: inside the limb and on the sensor, by a margin.
    pub fn is_lit(&self, at: SensorPx, margin_px: f64) -> bool {
        let within = |v: f64, size: f64| v >= margin_px && v <= size - 1.0 - margin_px;
        self.outline.excess(at.vector()) < -margin_px
            && within(at.x, self.sensor_px[0])
            && within(at.y, self.sensor_px[1])
    }
}

/// The darkness of a row's pixels in the disc.
#[multiversion(targets("x86_64+avx2"))]
fn flatten_row<T: Sample>(darkening: &Darkening, row: &Row, seen: &[T], darkness: &mut [f32]) {
    let [middle, half2, bend] = row.parabola;
    let first = row.inside.start as f32;
    let tilt = 1.0 - darkening.tilt.dot(&row.first);
    let tilt_step = -darkening.tilt.dot(&row.step);
    for (n, (seen, darkness)) in seen.iter().zip(darkness).enumerate() {
        let along = first + n as i32 as f32;
        let off = along - middle;
        let light = (seen.dn() - darkening.background_dn) * (tilt + tilt_step * along);
        *darkness = darkening.darkness(light, bend * (half2 - off * off));
    }
}
