//! Normal points: many points of an outline condensed to few of the same information.
//!
//! Whatever a mapping does to the outline is smooth along it: it moves and stretches an ellipse. So the mean distance of
//! neighbouring points from an ellipse near them, at their mean direction, holds as much information as the points themselves.

use crate::geometry::{Ellipse, turns};
use crate::units::SensorPx;
use nalgebra::Vector2;

/// Normal points all round: an ellipse needs five, and one of these averages the stretch to one part in a hundred.
pub(super) const ARCS: usize = 24;

/// The normal points of points with 1 sigma across the outline, px. The ellipse is close to the outline.
pub(super) fn normal_points(
    points: &[(SensorPx, f64)],
    ellipse: &Ellipse,
) -> impl Iterator<Item = (SensorPx, f64)> {
    let mut arcs = [Arc::default(); ARCS];
    for (at, sigma_px) in points {
        let w = ellipse.to_disc(at.vector());
        let arc = (turns(w) * ARCS as f64) as usize % ARCS;
        let weight = 1.0 / (sigma_px * sigma_px);
        arcs[arc].weight += weight;
        arcs[arc].direction += w * weight;
        arcs[arc].excess_px += ellipse.excess_at(w) * weight;
    }
    let filled = arcs.into_iter().filter(|arc| arc.weight > 0.0);
    filled.map(|arc| {
        let w = arc.direction.normalize();
        let out = ellipse.normal(w) * (arc.excess_px / arc.weight);
        ((ellipse.from_disc(w) + out).into(), 1.0 / arc.weight.sqrt())
    })
}

/// Weighted sums over an arc of the outline.
#[derive(Debug, Clone, Copy, Default)]
struct Arc {
    weight: f64,
    direction: Vector2<f64>,
    excess_px: f64,
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Matrix2;

    #[test]
    fn normal_points_lie_where_their_points_lie_on_average() {
        let root = Matrix2::new(95.2, 0.1, 0.1, 94.9);
        let ellipse = Ellipse::new(Vector2::new(400.0, 300.0), root).unwrap();
        let point = |n: i32| {
            let (sin, cos) = (f64::from(n) * 0.035).sin_cos();
            let w = Vector2::new(cos, sin);
            // The disc stands 0.3 px to the right; the points scatter about it.
            let out = 0.3 * ellipse.normal(w).x + 0.05 * f64::from(n % 2 * 2 - 1);
            let at = ellipse.from_disc(w) + ellipse.normal(w) * out;
            (at.into(), 0.1)
        };
        let points: Vec<(SensorPx, f64)> = (0..180).map(point).collect();
        let few: Vec<_> = normal_points(&points, &ellipse).collect();
        assert_eq!(few.len(), ARCS);
        for (at, sigma_px) in few {
            let at = at.vector();
            let right = ellipse.normal(ellipse.to_disc(at)).x;
            assert!((ellipse.excess(at) - 0.3 * right).abs() < 0.02);
            assert!((sigma_px - 0.1 / 7.5_f64.sqrt()).abs() < 0.004);
        }
    }
}
