//! Rendering: the Sun's light on the plate, sampled finer than the pixels, blurred and brought to the sensor.

use super::blemish::Scratch;
use super::blur::Kernel;
use super::coverage::{Edge, Footprint};
use super::scene::{Scene, Sun, Sunspot};
use crate::geometry::Mapping;
use crate::units::{PlateMil, SensorPx};
use nalgebra::Vector2;
use std::ops::Range;

/// Sub-samples of a pixel in each axis. Against 9, a pixel changes by a few hundredths of a DN.
pub const SAMPLES_PER_PX: usize = 3;

/// The mapping is computed every so many pixels and drawn straight between. Under a keystone of 3 deg straight
/// lines miss it by less than 5e-5 px.
const NODE_STEP_PX: usize = 4;

/// Light on the sensor in 8-bit DN, row by row: before noise, digitising and hot pixels.
pub fn render_exact(scene: &Scene) -> Vec<f32> {
    render_oversampled(scene, SAMPLES_PER_PX)
}

/// As [`render_exact`], with `samples_per_px` sub-samples of a pixel in each axis.
pub fn render_oversampled(scene: &Scene, samples_per_px: usize) -> Vec<f32> {
    let mut light = vec![0.0; scene.width_px * scene.height_px];
    let kernel = Kernel::new(scene.blur_px, samples_per_px.max(1));
    if let Some(sun) = &scene.sun
        && let Some(window) = Window::around(sun, scene, kernel.margin_px())
    {
        let grid = Grid::new(scene, sun, &window, kernel.margin_px(), samples_per_px);
        let field = lit_plate(scene, sun, &grid);
        let pixels = kernel.apply(&field, grid.columns, window.width, window.height);
        for (row, values) in pixels.chunks_exact(window.width).enumerate() {
            let start = (window.y + row) * scene.width_px + window.x;
            light[start..start + window.width].copy_from_slice(values);
        }
    }
    scene.blemishes.shade(scene, &mut light);
    let background = scene.background_dn as f32;
    light.iter_mut().for_each(|l| *l += background);
    light
}

/// The pixels that the Sun reaches.
struct Window {
    x: usize,
    y: usize,
    width: usize,
    height: usize,
}

impl Window {
    /// `None` where the Sun does not reach the sensor.
    fn around(sun: &Sun, scene: &Scene, margin_px: usize) -> Option<Self> {
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

/// The sub-samples of a window and its margin, and where each lies on the plate, from the Sun's centre.
struct Grid {
    origin: PlateMil,
    /// Sensor position of the first sub-sample.
    first: SensorPx,
    samples_per_px: usize,
    columns: usize,
    rows: usize,
    node_columns: usize,
    nodes: Vec<[f64; 2]>,
    footprint: Footprint,
}

impl Grid {
    fn new(
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
        let per_px = (scene.mapping).plate_jacobian(scene.mapping.to_sensor(sun.centre));
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
    fn row(&self, row: usize, xs: &mut [f32], ys: &mut [f32]) {
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

    /// Rows and columns of the sub-samples within some sensor positions, two pixels to spare; `None` when the grid holds none.
    fn span(
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

/// Light that the plate sends to the camera from every sub-sample, above the background.
fn lit_plate(scene: &Scene, sun: &Sun, grid: &Grid) -> Vec<f32> {
    let suns = exposures(sun, grid);
    let prints = prints(scene, grid);
    let (mut xs, mut ys) = (vec![0.0; grid.columns], vec![0.0; grid.columns]);
    let mut light = vec![0.0; grid.columns];
    let mut field = vec![0.0; grid.rows * grid.columns];
    for (row, field) in field.chunks_exact_mut(grid.columns).enumerate() {
        grid.row(row, &mut xs, &mut ys);
        for sun in &suns {
            sun.shine(&xs, &ys, &mut light);
            for (sum, &l) in field.iter_mut().zip(&light) {
                *sum += l;
            }
        }
        for print in prints.iter().filter(|print| print.rows.contains(&row)) {
            let columns = print.columns.clone();
            print.change(
                &xs[columns.clone()],
                &ys[columns.clone()],
                &mut field[columns],
            );
        }
    }
    field
}

/// The Sun at one moment of the exposure, in the grid's coordinates.
struct Disc {
    centre: Vector2<f32>,
    radius: f32,
    peak: f32,
    darkening: f32,
    spots: Vec<(Vector2<f32>, f32, f32)>,
    footprint: Footprint,
}

/// The Sun at as many moments as its smear needs, one sub-sample apart at most; the exposure shares its light
/// among them.
fn exposures(sun: &Sun, grid: &Grid) -> Vec<Disc> {
    let step_mil = grid.footprint.column.norm();
    let moments = (sun.smear_mil.norm() / step_mil).ceil().max(1.0);
    let at = |k: f64| (sun.smear_mil * ((k + 0.5) / moments - 0.5)).cast::<f32>();
    let spot = |centre: Vector2<f32>, s: &Sunspot| {
        let place = centre + s.offset_mil.cast::<f32>();
        (place, s.radius_mil as f32, s.contrast as f32)
    };
    (0..moments as usize)
        .map(|k| {
            let centre = at(k as f64);
            Disc {
                centre,
                radius: sun.radius_mil as f32,
                peak: (sun.peak_dn / moments) as f32,
                darkening: sun.limb_darkening as f32,
                spots: sun.spots.iter().map(|s| spot(centre, s)).collect(),
                footprint: grid.footprint,
            }
        })
        .collect()
}

impl Disc {
    /// The disc's light at each position of a row.
    fn shine(&self, xs: &[f32], ys: &[f32], light: &mut [f32]) {
        let (plain, darkened) = (1.0 - self.darkening, self.darkening);
        let inverse = 1.0 / (self.radius * self.radius);
        for ((light, x), y) in light.iter_mut().zip(xs).zip(ys) {
            let (dx, dy) = (x - self.centre.x, y - self.centre.y);
            let cosine2 = 1.0 - (dx * dx + dy * dy) * inverse;
            let shade = self.peak * (plain + darkened * cosine2.max(0.0).sqrt());
            *light = if cosine2 > 0.0 { shade } else { 0.0 };
        }
        self.round_off(xs, ys, light);
        for &(place, radius, contrast) in &self.spots {
            let reach = radius + self.footprint.reach() as f32;
            near_circle(xs, ys, place, 0.0..reach, |n, from_centre, r| {
                let edge = self.edge(from_centre, r);
                let share = edge.coverage(f64::from(radius) - r);
                light[n] *= 1.0 - contrast * share as f32;
            });
        }
    }

    /// At the limb, where light falls as the root of the depth and ends, takes the mean over each sub-sample.
    fn round_off(&self, xs: &[f32], ys: &[f32], light: &mut [f32]) {
        let (plain, darkened) = (1.0 - self.darkening, f64::from(self.darkening));
        let radius = f64::from(self.radius);
        let band = 1.2 * self.footprint.reach() as f32;
        let rim = self.radius - band..self.radius + band;
        near_circle(xs, ys, self.centre, rim, |n, from_centre, r| {
            let (edge, inside) = (self.edge(from_centre, r), radius - r);
            // cos theta = sqrt(2 depth / R) x sqrt(1 - depth / 2 R), the second root nearly 1 here.
            let slope = (2.0 / radius * (1.0 - inside.max(0.0) / (2.0 * radius))).sqrt();
            let cosine = slope * edge.mean_root(inside);
            let share = f64::from(plain) * edge.coverage(inside) + darkened * cosine;
            light[n] = self.peak * share as f32;
        });
    }

    fn edge(&self, from_centre: Vector2<f32>, r: f64) -> Edge {
        self.footprint.edge(from_centre.cast::<f64>() / r.max(1e-9))
    }
}

/// Calls with number, offset and distance for those positions whose distance from a centre lies in a range.
fn near_circle(
    xs: &[f32],
    ys: &[f32],
    centre: Vector2<f32>,
    distances: Range<f32>,
    mut visit: impl FnMut(usize, Vector2<f32>, f64),
) {
    let squares = distances.start.max(0.0).powi(2)..distances.end.powi(2);
    for (n, (x, y)) in xs.iter().zip(ys).enumerate() {
        let offset = Vector2::new(x - centre.x, y - centre.y);
        if squares.contains(&offset.norm_squared()) {
            visit(n, offset, offset.cast::<f64>().norm());
        }
    }
}

/// A straight bar on the plate, in the grid's coordinates.
#[derive(Clone, Copy)]
struct Bar {
    centre: Vector2<f64>,
    /// Unit vector along it.
    along: Vector2<f64>,
    half_length: f64,
    half_width: f64,
    ends: Edge,
    sides: Edge,
}

impl Bar {
    /// A bar by its middle, direction, length and width, mil.
    fn new(
        grid: &Grid,
        middle: PlateMil,
        along: Vector2<f64>,
        length_mil: f64,
        width_mil: f64,
    ) -> Self {
        Self {
            centre: middle.vector() - grid.origin.vector(),
            along,
            half_length: length_mil / 2.0,
            half_width: width_mil / 2.0,
            ends: grid.footprint.edge(along),
            sides: grid.footprint.edge(Vector2::new(-along.y, along.x)),
        }
    }

    fn coverage(&self, at: Vector2<f64>) -> f64 {
        let from_centre = at - self.centre;
        let between = |edge: &Edge, half: f64, offset: f64| {
            edge.coverage(half - offset) - edge.coverage(-half - offset)
        };
        let across = between(&self.sides, self.half_width, self.along.perp(&from_centre));
        if across == 0.0 {
            return 0.0;
        }
        across * between(&self.ends, self.half_length, self.along.dot(&from_centre))
    }
}

/// Something on the plate that changes the light it sends back, and the sub-samples it concerns.
struct Print {
    shape: Shape,
    rows: Range<usize>,
    columns: Range<usize>,
}

enum Shape {
    /// Two arms that take a share of the light.
    Mark { arms: [Bar; 2], contrast: f64 },
    /// A bar that sends back so many times the light.
    Scratch { bar: Bar, brightness: f64 },
}

impl Print {
    fn change(&self, xs: &[f32], ys: &[f32], light: &mut [f32]) {
        let positions = xs.iter().zip(ys);
        for (light, (&x, &y)) in light.iter_mut().zip(positions) {
            let at = Vector2::new(f64::from(x), f64::from(y));
            let change = match &self.shape {
                Shape::Mark { arms, contrast } => {
                    let [a, b] = arms.map(|arm| arm.coverage(at));
                    1.0 - contrast * (a + b - a * b)
                }
                Shape::Scratch { bar, brightness } => 1.0 + (brightness - 1.0) * bar.coverage(at),
            };
            *light *= change as f32;
        }
    }
}

/// The marks and scratches within the grid.
fn prints(scene: &Scene, grid: &Grid) -> Vec<Print> {
    let marks = scene
        .plate
        .marks()
        .filter(|_| scene.mark_contrast != 0.0)
        .filter_map(|(_, position)| mark(scene, grid, position));
    let scratches = scene.blemishes.scratches.iter();
    marks
        .chain(scratches.filter_map(|s| scratch(scene, grid, s)))
        .collect()
}

fn mark(scene: &Scene, grid: &Grid, position: PlateMil) -> Option<Print> {
    let cross = scene.plate.cross;
    let reach = cross.arm_length_mil / 2.0;
    let corners = [(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)]
        .map(|(x, y)| PlateMil::new(position.x + x * reach, position.y + y * reach));
    let (rows, columns) = grid.span(corners.iter().map(|c| scene.mapping.to_sensor(*c)))?;
    let arm = |along| {
        Bar::new(
            grid,
            position,
            along,
            cross.arm_length_mil,
            cross.arm_width_mil,
        )
    };
    Some(Print {
        shape: Shape::Mark {
            arms: [arm(Vector2::x()), arm(Vector2::y())],
            contrast: scene.mark_contrast,
        },
        rows,
        columns,
    })
}

fn scratch(scene: &Scene, grid: &Grid, scratch: &Scratch) -> Option<Print> {
    let run = scratch.end.vector() - scratch.start.vector();
    let middle = (scratch.end.vector() + scratch.start.vector()) / 2.0;
    let ends = [scratch.start, scratch.end];
    let (rows, columns) = grid.span(ends.iter().map(|e| scene.mapping.to_sensor(*e)))?;
    let along = run.try_normalize(0.0)?;
    Some(Print {
        shape: Shape::Scratch {
            bar: Bar::new(grid, middle.into(), along, run.norm(), scratch.width_mil),
            brightness: scratch.brightness,
        },
        rows,
        columns,
    })
}
