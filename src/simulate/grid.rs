//! The sub-samples at which a scene is rendered, and their positions on the plate.

use super::coverage::Footprint;
use super::scene::{Scene, Sun};
use crate::geometry::Mapping;
use crate::units::{PlateMil, SensorPx};
use std::ops::Range;

/// Spacing of the pixels at which the mapping is computed; between them it is interpolated linearly. Under a keystone of 3 deg
/// the interpolation error is less than 5e-5 px.
const NODE_STEP_PX: usize = 4;

/// The pixels that the Sun's light reaches.
pub(super) struct Window {
    pub x: usize,
    pub y: usize,
    pub width: usize,
    pub height: usize,
}

impl Window {
    /// `None` if the Sun does not reach the sensor.
    pub(super) fn around(sun: &Sun, scene: &Scene, margin_px: usize) -> Option<Self> {
        let smear = sun.smear_mil.norm() / 2.0 / local_scale(sun, &scene.mapping);
        let (low, high) = bounds(sun.limb_px(&scene.mapping));
        let reach = smear + margin_px as f64 + 1.0;
        let span = |low: f64, high: f64, pixels: usize| {
            let first = (low - reach).floor().max(0.0);
            let last = (high + reach).ceil().min(pixels as f64 - 1.0);
            (first <= last).then(|| (first as usize, (last - first) as usize + 1))
        };
        let (x, width) = span(low.x, high.x, scene.width_px)?;
        let (y, height) = span(low.y, high.y, scene.height_px)?;
        Some(Self {
            x,
            y,
            width,
            height,
        })
    }
}

fn local_scale(sun: &Sun, mapping: &Mapping) -> f64 {
    mapping.scale_mil_per_px(mapping.to_sensor(sun.centre))
}

/// The smallest upright rectangle around some positions.
fn bounds(positions: impl Iterator<Item = SensorPx>) -> (SensorPx, SensorPx) {
    let nothing = (
        SensorPx::new(f64::INFINITY, f64::INFINITY),
        SensorPx::new(f64::NEG_INFINITY, f64::NEG_INFINITY),
    );
    positions.fold(nothing, |(low, high), p| {
        (
            SensorPx::new(low.x.min(p.x), low.y.min(p.y)),
            SensorPx::new(high.x.max(p.x), high.y.max(p.y)),
        )
    })
}

/// The sub-samples of a window and its margin, with their positions on the plate relative to the Sun's centre.
pub(super) struct Grid {
    pub origin: PlateMil,
    /// Sensor position of the first sub-sample.
    first: SensorPx,
    samples_per_px: usize,
    pub columns: usize,
    pub rows: usize,
    node_columns: usize,
    nodes: Vec<[f64; 2]>,
    pub footprint: Footprint,
}

impl Grid {
    pub(super) fn new(
        scene: &Scene,
        sun: &Sun,
        window: &Window,
        margin_px: usize,
        samples_per_px: usize,
    ) -> Self {
        let start = 0.5 / samples_per_px as f64 - 0.5 - margin_px as f64;
        let first = SensorPx::new(window.x as f64 + start, window.y as f64 + start);
        let (width, height) = (window.width + 2 * margin_px, window.height + 2 * margin_px);
        let node_columns = width.div_ceil(NODE_STEP_PX) + 1;
        let node_rows = height.div_ceil(NODE_STEP_PX) + 1;
        let step = NODE_STEP_PX as f64;
        let per_px = scene
            .mapping
            .plate_jacobian(scene.mapping.to_sensor(sun.centre));
        let nodes = (0..node_rows * node_columns).map(|node| {
            let (row, column) = (node / node_columns, node % node_columns);
            let seen = SensorPx::new(first.x + column as f64 * step, first.y + row as f64 * step);
            let plate = scene.mapping.to_plate(seen);
            [plate.x - sun.centre.x, plate.y - sun.centre.y]
        });
        Self {
            origin: sun.centre,
            first,
            samples_per_px,
            columns: width * samples_per_px,
            rows: height * samples_per_px,
            node_columns,
            nodes: nodes.collect(),
            footprint: Footprint {
                column: per_px.column(0) / samples_per_px as f64,
                row: per_px.column(1) / samples_per_px as f64,
            },
        }
    }

    /// Plate positions of a row of sub-samples, from the origin, mil.
    pub(super) fn row(&self, row: usize, xs: &mut [f32], ys: &mut [f32]) {
        let step = NODE_STEP_PX * self.samples_per_px;
        let down = (row % step) as f64 / step as f64;
        let above = &self.nodes[row / step * self.node_columns..][..self.node_columns];
        let below = &self.nodes[(row / step + 1) * self.node_columns..][..self.node_columns];
        let node = |c: usize, axis: usize| above[c][axis] * (1.0 - down) + below[c][axis] * down;
        for (axis, positions) in [xs, ys].into_iter().enumerate() {
            for (c, between) in positions.chunks_mut(step).enumerate() {
                let (left, right) = (node(c, axis), node(c + 1, axis));
                let slope = ((right - left) / step as f64) as f32;
                for (k, position) in between.iter_mut().enumerate() {
                    *position = left as f32 + slope * k as f32;
                }
            }
        }
    }

    /// Rows and columns of the sub-samples within some sensor positions, with a margin of two pixels; `None` if the grid contains none.
    pub(super) fn span(
        &self,
        corners: impl Iterator<Item = SensorPx>,
    ) -> Option<(Range<usize>, Range<usize>)> {
        const SPARE_PX: f64 = 2.0;
        let (low, high) = bounds(corners);
        let samples = |low: f64, high: f64, count: usize| {
            let s = self.samples_per_px as f64;
            let start = ((low - SPARE_PX) * s).floor().clamp(0.0, count as f64);
            let end = ((high + SPARE_PX) * s).ceil().clamp(0.0, count as f64);
            (start < end).then_some(start as usize..end as usize)
        };
        let rows = samples(low.y - self.first.y, high.y - self.first.y, self.rows)?;
        let columns = samples(low.x - self.first.x, high.x - self.first.x, self.columns)?;
        Some((rows, columns))
    }
}
