//! The blurred cross as a table: it is asked for hundreds of thousands of times a frame.

use super::CrossShape;
use crate::lanes::{Scratch, split};
use multiversion::multiversion;
use wide::f32x4;

/// Entries of the table for each pixel; straight lines between them miss the coverage by 2e-4 at most.
const STEPS_PER_PX: f32 = 16.0;
/// How far beyond its edge a bar is seen, in units of the blur: what lies beyond is 3e-5 of the light.
const REACH_SIGMA: f64 = 4.0;

/// A bar as long and one as wide as an arm of the cross, across their ends: shares of the light they cover and slopes.
///
/// The cross is two bars less their common middle, and a blurred bar is its profile along times its profile across.
#[derive(Debug, Clone)]
pub(super) struct Profile {
    steps: Vec<Step>,
}

/// `[long, slope of long, wide, slope of wide]` at a distance from the middle, and what leads to the next entry.
#[derive(Debug, Clone, Copy)]
struct Step {
    here: f32x4,
    on: f32x4,
}

/// What a cross covers at a place, and how that changes along its two arms, per px.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Coverage {
    pub share: f32,
    pub slope_u: f32,
    pub slope_v: f32,
}

/// The same of many places, one entry a place.
pub(super) struct Shares {
    pub share: Scratch<f32>,
    pub slope_u: Scratch<f32>,
    pub slope_v: Scratch<f32>,
}

impl Shares {
    pub(super) fn new(count: usize) -> Self {
        let [share, slope_u, slope_v] = std::array::from_fn(|_| Scratch::of_length(count));
        Self {
            share,
            slope_u,
            slope_v,
        }
    }
}

/// Where in the table places are, along one arm: the entry, how far towards the next one, and the side.
struct Along {
    entry: Scratch<u16>,
    part: Scratch<f32>,
    side: Scratch<f32>,
}

impl Along {
    fn new(count: usize) -> Self {
        Self {
            entry: Scratch::of_length(count),
            part: Scratch::of_length(count),
            side: Scratch::of_length(count),
        }
    }
}

impl Profile {
    pub(super) fn new(shape: &CrossShape) -> Self {
        let reach = shape.half_length_px + REACH_SIGMA * shape.blur_px;
        let last = (reach * f64::from(STEPS_PER_PX)).ceil() as usize;
        let value = |n: usize| {
            let at = n as f64 / f64::from(STEPS_PER_PX);
            let (long, long_slope) = shape.bar(at, shape.half_length_px);
            let (wide, wide_slope) = shape.bar(at, shape.half_width_px);
            f32x4::from([long, long_slope, wide, wide_slope].map(|v| v as f32))
        };
        // Beyond the last entry nothing is covered; one more stands in for all of it.
        let values: Vec<f32x4> = (0..=last).map(value).chain([f32x4::ZERO; 2]).collect();
        let step = |pair: &[f32x4]| Step {
            here: pair[0],
            on: pair[1] - pair[0],
        };
        Self {
            steps: values.windows(2).map(step).collect(),
        }
    }

    /// The coverage at many places of the sensor, about a middle; `to_arms` (by rows) leads from an offset on the sensor to
    /// one along the arms, px.
    pub(super) fn shares(
        &self,
        x: &[f32],
        y: &[f32],
        middle: [f32; 2],
        to_arms: [f32; 4],
        shares: &mut Shares,
    ) {
        let [mut along_u, mut along_v] = [x.len(); 2].map(Along::new);
        let last = (self.steps.len() - 1) as f32;
        let [ux, uy, vx, vy] = to_arms;
        find_along(x, y, middle, [ux, uy], last, &mut along_u);
        find_along(x, y, middle, [vx, vy], last, &mut along_v);
        let steps = |along: &Along, n: usize| {
            let step = &self.steps[usize::from(along.entry[n])];
            (step.here + step.on * f32x4::splat(along.part[n])).to_array()
        };
        for n in 0..x.len() {
            let [long_u, long_slope_u, wide_u, wide_slope_u] = steps(&along_u, n);
            let [long_v, long_slope_v, wide_v, wide_slope_v] = steps(&along_v, n);
            let (arm_u, arm_v) = (long_u - wide_u, long_v - wide_v);
            shares.share[n] = long_u * wide_v + wide_u * arm_v;
            shares.slope_u[n] = (long_slope_u * wide_v + wide_slope_u * arm_v) * along_u.side[n];
            shares.slope_v[n] = (long_slope_v * wide_u + wide_slope_v * arm_u) * along_v.side[n];
        }
    }

    /// The coverage at an offset from the cross's middle, along its arms, px.
    pub(super) fn coverage(&self, u: f32, v: f32) -> Coverage {
        let [long_u, long_slope_u, wide_u, wide_slope_u] = self.bars(u);
        let [long_v, long_slope_v, wide_v, wide_slope_v] = self.bars(v);
        Coverage {
            share: long_u * wide_v + wide_u * (long_v - wide_v),
            slope_u: long_slope_u * wide_v + wide_slope_u * (long_v - wide_v),
            slope_v: long_slope_v * wide_u + wide_slope_v * (long_u - wide_u),
        }
    }

    /// Sum over pixels of the squared slope of the coverage along one axis: what a position's noise is divided by. A
    /// quarter turn leaves the cross as it is, so the sum is the same along every axis.
    pub(super) fn slope_energy(&self, reach_px: f64) -> f64 {
        let reach = reach_px.ceil() as i32;
        // One quadrant, and the axis between it and the next, stand for all four.
        let quadrant = (0..=reach).flat_map(|v| (1..=reach).map(move |u| (u as f32, v as f32)));
        let along_both = quadrant.map(|(u, v)| {
            let seen = self.coverage(u, v);
            f64::from(seen.slope_u.powi(2) + seen.slope_v.powi(2))
        });
        2.0 * along_both.sum::<f64>()
    }

    /// Both bars at an offset, and their slopes, which are odd.
    fn bars(&self, offset: f32) -> [f32; 4] {
        let along = (offset.abs() * STEPS_PER_PX).min((self.steps.len() - 1) as f32);
        let (n, part) = split(along);
        let step = &self.steps[n as usize];
        let bars = step.here + step.on * f32x4::splat(part);
        let side = 1.0_f32.copysign(offset);
        (bars * f32x4::from([1.0, side, 1.0, side])).to_array()
    }
}

/// Where along an arm places of the sensor lie, about a middle.
#[multiversion(targets("x86_64+avx2"))]
fn find_along(
    x: &[f32],
    y: &[f32],
    [middle_x, middle_y]: [f32; 2],
    [by_x, by_y]: [f32; 2],
    last: f32,
    along: &mut Along,
) {
    let count = x.len();
    let y = &y[..count];
    let entry = &mut along.entry[..count];
    let (part, side) = (&mut along.part[..count], &mut along.side[..count]);
    for n in 0..count {
        let offset = by_x * (x[n] - middle_x) + by_y * (y[n] - middle_y);
        let steps = (offset.abs() * STEPS_PER_PX).min(last);
        let (whole, left) = split(steps);
        (entry[n], part[n]) = (whole as u16, left);
        side[n] = 1.0_f32.copysign(offset);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SHAPE: CrossShape = CrossShape {
        half_length_px: 7.8,
        half_width_px: 1.05,
        blur_px: 0.95,
    };

    /// The blurred cross straight from its definition.
    fn true_share(u: f64, v: f64) -> f64 {
        let bar = |x: f64, half: f64| SHAPE.bar(x, half).0;
        let (long_u, long_v) = (bar(u, SHAPE.half_length_px), bar(v, SHAPE.half_length_px));
        let (wide_u, wide_v) = (bar(u, SHAPE.half_width_px), bar(v, SHAPE.half_width_px));
        long_u * wide_v + wide_u * long_v - wide_u * wide_v
    }

    #[test]
    fn the_table_holds_the_blurred_cross_and_its_slopes() {
        let profile = Profile::new(&SHAPE);
        for n in 0..60 {
            let (u, v) = (f64::from(n) * 0.41 - 12.0, f64::from(n) * 0.17 - 5.0);
            let seen = profile.coverage(u as f32, v as f32);
            assert!((f64::from(seen.share) - true_share(u, v)).abs() < 3e-4);
            const H: f64 = 1e-4;
            let slope_u = (true_share(u + H, v) - true_share(u - H, v)) / (2.0 * H);
            let slope_v = (true_share(u, v + H) - true_share(u, v - H)) / (2.0 * H);
            assert!((f64::from(seen.slope_u) - slope_u).abs() < 1e-3);
            assert!((f64::from(seen.slope_v) - slope_v).abs() < 1e-3);
        }
    }

    #[test]
    fn the_cross_has_the_area_of_its_arms() {
        let (length, width) = (2.0 * SHAPE.half_length_px, 2.0 * SHAPE.half_width_px);
        let profile = Profile::new(&SHAPE);
        let (sin, cos) = 0.3_f32.sin_cos();
        let area: f32 = (-15..=15)
            .flat_map(|y| (-15..=15).map(move |x| (x as f32, y as f32)))
            .map(|(x, y)| profile.coverage(cos * x + sin * y, cos * y - sin * x).share)
            .sum();
        assert!((f64::from(area) - (2.0 * length * width - width * width)).abs() < 0.02);
    }
}
