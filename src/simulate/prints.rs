//! The print on the plate, sub-sample by sub-sample: marks and scratches.

use super::coverage::{Edge, Footprint};
use super::grid::Grid;
use super::scene::{Scene, Scratch};
use crate::plate::MarkShape;
use crate::units::PlateMil;
use nalgebra::Vector2;
use std::ops::Range;

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

/// A filled disc on the plate, in the grid's coordinates.
#[derive(Clone, Copy)]
struct Disc {
    centre: Vector2<f64>,
    radius: f64,
    footprint: Footprint,
}

impl Disc {
    /// Coverage of a sub-sample; its edge counts as straight over a sub-sample.
    fn coverage(&self, at: Vector2<f64>) -> f64 {
        let from_centre = at - self.centre;
        let distance = from_centre.norm();
        let inside = self.radius - distance;
        if inside.abs() > self.footprint.reach() {
            return if inside > 0.0 { 1.0 } else { 0.0 };
        }
        let outward = from_centre / distance.max(f64::MIN_POSITIVE);
        self.footprint.edge(outward).coverage(inside)
    }
}

/// A print on the plate that changes its reflected light, and the sub-samples that it covers.
pub(super) struct Print {
    shape: Shape,
    pub rows: Range<usize>,
    pub columns: Range<usize>,
}

enum Shape {
    /// Two arms that absorb a fraction of the light.
    Cross { arms: [Bar; 2], contrast: f64 },
    /// A disc that absorbs a fraction of the light.
    Dot { disc: Disc, contrast: f64 },
    /// A bar that reflects `brightness` times the light.
    Scratch { bar: Bar, brightness: f64 },
}

impl Print {
    pub(super) fn change(&self, xs: &[f32], ys: &[f32], light: &mut [f32]) {
        let positions = xs.iter().zip(ys);
        for (light, (&x, &y)) in light.iter_mut().zip(positions) {
            let at = Vector2::new(f64::from(x), f64::from(y));
            let change = match &self.shape {
                Shape::Cross { arms, contrast } => {
                    let [a, b] = arms.map(|arm| arm.coverage(at));
                    1.0 - contrast * (a + b - a * b)
                }
                Shape::Dot { disc, contrast } => 1.0 - contrast * disc.coverage(at),
                Shape::Scratch { bar, brightness } => 1.0 + (brightness - 1.0) * bar.coverage(at),
            };
            *light *= change as f32;
        }
    }
}

/// The marks and scratches within the grid.
pub(super) fn prints(scene: &Scene, grid: &Grid) -> Vec<Print> {
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
    let shape = scene.plate.shape;
    let reach = shape.size_mil() / 2.0;
    let corners = [(-1.0, -1.0), (-1.0, 1.0), (1.0, -1.0), (1.0, 1.0)]
        .map(|(x, y)| PlateMil::new(position.x + x * reach, position.y + y * reach));
    let (rows, columns) = grid.span(corners.iter().map(|c| scene.mapping.to_sensor(*c)))?;
    let contrast = scene.mark_contrast;
    let shape = match shape {
        MarkShape::Cross(cross) => {
            let (length, width) = (cross.arm_length_mil, cross.arm_width_mil);
            let arm = |along| Bar::new(grid, position, along, length, width);
            let along = shape.arms();
            let arms = [0, 1].map(|n| arm(along.column(n).into_owned()));
            Shape::Cross { arms, contrast }
        }
        MarkShape::Dot { .. } => {
            let disc = Disc {
                centre: position.vector() - grid.origin.vector(),
                radius: reach,
                footprint: grid.footprint,
            };
            Shape::Dot { disc, contrast }
        }
    };
    Some(Print {
        shape,
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
