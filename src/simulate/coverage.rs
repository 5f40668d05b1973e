//! Coverage of a sub-sample by an edge.
//!
//! A sub-sample weights the light around it with a tent: its square convolved with itself. A plain square would conserve the
//! light but move it to the sub-sample's middle, by thousandths of a pixel; with the tent the light's
//! first moment survives sampling exactly, whatever the phase.
//!
//! The square is a parallelogram on the plate. Across a straight edge the tent is the convolution of two boxes with the projected length of one side,
//! and two with that of the other. The mean of any function of the depth behind the edge is therefore
//! a fourth difference of that function's fourth integral.

use nalgebra::Vector2;

/// Variance that the tent adds to a picture beyond the square's own, in units of the square's side, squared.
pub(super) const TENT_VARIANCE: f64 = 1.0 / 12.0;

/// The sides of a sub-sample's square as they lie on the plate, mil.
#[derive(Debug, Clone, Copy)]
pub(super) struct Footprint {
    pub column: Vector2<f64>,
    pub row: Vector2<f64>,
}

/// A straight edge as projected onto the sides of a sub-sample.
#[derive(Debug, Clone, Copy)]
pub(super) struct Edge {
    /// Projections of the two sides of the square across the edge.
    long: f64,
    short: f64,
}

impl Footprint {
    /// An edge by its normal, a unit vector.
    pub(super) fn edge(&self, normal: Vector2<f64>) -> Edge {
        let (a, b) = (normal.dot(&self.column).abs(), normal.dot(&self.row).abs());
        let long = a.max(b);
        // Along an edge a box has no width; 1 % of the other width has no visible effect and avoids a division by zero.
        let short = a.min(b).max(0.01 * long);
        Edge { long, short }
    }

    /// Largest distance of an edge that can affect a sub-sample, mil.
    pub(super) fn reach(&self) -> f64 {
        self.column.norm() + self.row.norm()
    }
}

impl Edge {
    /// Largest distance at which the edge affects a sub-sample, mil.
    pub(super) fn reach(&self) -> f64 {
        self.long + self.short
    }

    /// The fraction of a sub-sample inside the edge, with its middle `inside` mil behind it.
    pub(super) fn coverage(&self, inside: f64) -> f64 {
        let reach = self.reach();
        if inside >= reach {
            1.0
        } else if inside <= -reach {
            0.0
        } else {
            self.mean(inside, |x| x.powi(4) / 24.0)
        }
    }

    /// Mean over the sub-sample of the square root of the depth inside the edge, zero outside.
    pub(super) fn mean_root(&self, inside: f64) -> f64 {
        self.mean(inside, |x| 16.0 / 945.0 * x.powi(4) * x.sqrt())
    }

    /// Mean of a function of the depth that is zero outside, from its fourth integral.
    fn mean(&self, inside: f64, fourth_integral: impl Fn(f64) -> f64) -> f64 {
        let integral = |x: f64| fourth_integral(x.max(0.0));
        let along_short =
            |x: f64| integral(x + self.short) - 2.0 * integral(x) + integral(x - self.short);
        let difference = along_short(inside + self.long) - 2.0 * along_short(inside)
            + along_short(inside - self.long);
        difference / (self.long * self.short).powi(2)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coverage_is_the_weight_of_the_tent_behind_the_edge() {
        let footprint = Footprint {
            column: Vector2::new(1.8, 0.5),
            row: Vector2::new(-0.5, 1.9),
        };
        let normal = Vector2::new(0.6, 0.8);
        let edge = footprint.edge(normal);
        for inside in [-1.3, -0.8, -0.1, 0.0, 0.4, 1.1, 1.5] {
            let n = 300;
            let (mut area, mut root, mut points) = (0.0, 0.0, 0.0);
            for k in 0..n * n {
                let place = |m: i32| 2.0 * (f64::from(m) + 0.5) / f64::from(n) - 1.0;
                let (u, v) = (place(k % n), place(k / n));
                let weight = (1.0 - u.abs()) * (1.0 - v.abs());
                let depth = inside + normal.dot(&(footprint.column * u + footprint.row * v));
                points += weight;
                area += weight * f64::from(u8::from(depth > 0.0));
                root += weight * depth.max(0.0).sqrt();
            }
            assert!((edge.coverage(inside) - area / points).abs() < 2e-3);
            assert!((edge.mean_root(inside) - root / points).abs() < 2e-3);
        }
    }
}
