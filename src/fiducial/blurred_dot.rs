//! The profile of a filled disc behind a Gaussian blur, as a table by the distance from its centre.

use crate::kernels::marks::{Coverage, Offsets};
use crate::kernels::normal_tail;
use std::f64::consts::{PI, TAU};

/// Steps of the table per pixel.
const STEPS_PER_PX: f64 = 8.0;
/// Distance from the disc's edge, in blurs, beyond which the share is 1 or 0.
const EDGE_BLURS: f64 = 4.5;
/// Number of chords of the disc in the sum.
const CHORDS: i32 = 32;

/// A filled disc behind a Gaussian blur.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct BlurredDot {
    /// Share of the light that the dot absorbs, by distance.
    shares: Vec<f32>,
}

impl BlurredDot {
    /// For the disc's radius and the blur's 1 sigma, px.
    pub(super) fn new(radius_px: f64, blur_px: f64) -> Self {
        let reach = radius_px + EDGE_BLURS * blur_px;
        // One more step, which gives the slope at the end.
        let steps = (reach * STEPS_PER_PX).ceil() as usize + 2;
        let share = |n: usize| share(n as f64 / STEPS_PER_PX, radius_px, blur_px);
        Self {
            shares: (0..steps).map(|n| share(n) as f32).collect(),
        }
    }

    /// The share at a distance from the centre, and its slope, 1/px: a parabola through the nearest three values of the
    /// table.
    fn at(&self, distance_px: f32) -> (f32, f32) {
        let at = distance_px * STEPS_PER_PX as f32;
        let nearest = at.round() as usize;
        let [Some(here), Some(after)] = [nearest, nearest + 1].map(|n| self.shares.get(n)) else {
            return (0.0, 0.0);
        };
        // The profile is even about its centre.
        let before = &self.shares[nearest.abs_diff(1)];
        let part = at - nearest as f32;
        let (slope, bend) = ((after - before) / 2.0, after + before - 2.0 * here);
        let share = here + part * (slope + part * bend / 2.0);
        (share, (slope + part * bend) * STEPS_PER_PX as f32)
    }

    /// Share and slopes along x and y at an offset from the centre; `to_dot` maps, by rows, an offset to one in which the
    /// dot is round.
    fn cover_at(&self, [ux, uy, vx, vy]: [f32; 4], x: f32, y: f32) -> [f32; 3] {
        let (u, v) = (ux * x + uy * y, vx * x + vy * y);
        let distance = u.hypot(v);
        let (share, slope) = self.at(distance);
        let per_px = slope / distance.max(f32::MIN_POSITIVE);
        let (slope_u, slope_v) = (per_px * u, per_px * v);
        [
            share,
            ux * slope_u + vx * slope_v,
            uy * slope_u + vy * slope_v,
        ]
    }

    pub(super) fn cover(&self, to_dot: [f32; 4], offsets: Offsets<'_>, coverage: &mut Coverage) {
        let Offsets { from, x, y } = offsets;
        coverage.resize(x.len());
        for (n, (x, y)) in x.iter().zip(y).enumerate() {
            let [share, slope_x, slope_y] = self.cover_at(to_dot, from[0] + x, from[1] + y);
            coverage.share[n] = share;
            coverage.slope_x[n] = slope_x;
            coverage.slope_y[n] = slope_y;
        }
    }
}

/// The share absorbed at a distance from the disc's centre: the integral over the blur along that direction of the share
/// absorbed by the disc's chord across it. A chord's length grows as a square root at the disc's edge, but smoothly in the
/// sine of an angle.
fn share(distance: f64, radius: f64, blur: f64) -> f64 {
    let first = ((-radius - distance) / blur).max(-EDGE_BLURS);
    let last = ((radius - distance) / blur).min(EDGE_BLURS);
    if first >= last {
        return 0.0;
    }
    let (middle, half) = ((first + last) / 2.0, (last - first) / 2.0);
    let step = PI / f64::from(CHORDS);
    let chord = |n: i32| {
        let (sin, cos) = ((f64::from(n) + 0.5) * step - PI / 2.0).sin_cos();
        let z = middle + half * sin;
        let half_chord = (radius * radius - (distance + blur * z).powi(2))
            .max(0.0)
            .sqrt();
        let beyond = f64::from(normal_tail((half_chord / blur) as f32).0);
        (-0.5 * z * z).exp() * (1.0 - 2.0 * beyond) * cos
    };
    (0..CHORDS).map(chord).sum::<f64>() * half * step / TAU.sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The blurred disc by its definition: a sum over a fine grid.
    fn by_brute_force(distance: f64, radius: f64, blur: f64) -> f64 {
        let steps = 300;
        let step = 2.0 * radius / f64::from(steps);
        let place = |n: i32| (f64::from(n) + 0.5) * step - radius;
        let inside = (0..steps)
            .flat_map(|m| (0..steps).map(move |n| (place(m), place(n))))
            .filter(|(x, y)| x.hypot(*y) < radius);
        let gauss = |(x, y): (f64, f64)| {
            let z2 = ((x - distance).powi(2) + y * y) / (blur * blur);
            (-0.5 * z2).exp() / (std::f64::consts::TAU * blur * blur)
        };
        inside.map(gauss).sum::<f64>() * step * step
    }

    #[test]
    fn the_profile_is_that_of_the_blurred_disc_and_its_slope() {
        for (radius, blur) in [(1.5, 0.95), (5.2, 0.95), (5.2, 2.0)] {
            let dot = BlurredDot::new(radius, blur);
            for n in 0..24 {
                let distance = 0.03 + f64::from(n) * 0.4;
                let expected = by_brute_force(distance, radius, blur);
                let (share, slope) = dot.at(distance as f32);
                assert!(
                    (f64::from(share) - expected).abs() < 4e-3,
                    "{share} {expected}"
                );
                let beside = |step: f64| by_brute_force(distance + step, radius, blur);
                let expected = (beside(0.05) - beside(-0.05)) / 0.1;
                assert!(
                    (f64::from(slope) - expected).abs() < 8e-3,
                    "{slope} {expected}"
                );
            }
        }
    }
}
