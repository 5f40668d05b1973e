//! The circle through three of an outline's eight extremities: at any phase, three of them lie on the true limb.
//!
//! "The Development of a Moon Sensor" (2005), section 3.3.1.

use crate::geometry::Circle;
use nalgebra::{Rotation2, Vector2};
use std::f64::consts::FRAC_PI_4;

/// The circle of an outline; `None` if its extremities are collinear.
///
/// The extremities in the directions x, x + y, y and so on form four pairs. The longest pair divides the light across its
/// phase; the extremity farthest from the line between them lies on the limb, and so do its two neighbours.
pub(super) fn circle(points: &[Vector2<f64>]) -> Option<Circle> {
    let furthest_along = |n: usize| {
        let axis = Rotation2::new(n as f64 * FRAC_PI_4) * Vector2::x();
        let place = |point: &&Vector2<f64>| axis.dot(point);
        points.iter().max_by(|a, b| place(a).total_cmp(&place(b)))
    };
    let ends: Vec<Vector2<f64>> = (0..8).filter_map(furthest_along).copied().collect();
    let length = |n: &usize| (ends[n + 4] - ends[*n]).norm();
    let pairs = 0..ends.len() / 2;
    let longest = pairs.max_by(|a, b| length(a).total_cmp(&length(b)))?;
    let along = ends[longest + 4] - ends[longest];
    let off = |n: &usize| along.perp(&(ends[*n] - ends[longest])).abs();
    let middle = (0..8).max_by(|a, b| off(a).total_cmp(&off(b)))?;
    Circle::through(ends[(middle + 7) % 8], ends[middle], ends[(middle + 1) % 8])
}
