//! The light of a disc: across its edge, and on the pixels of the sensor. The formulas are those of
//! [`Profile`](crate::limb::Profile).

use super::{LANES, groups, larger, normal_tail, smaller};
use multiversion::multiversion;

/// Brightness across the edge of a disc.
#[derive(Debug, Clone, Copy)]
pub struct EdgeLight {
    /// Brightness of the uniform part, and of the part that falls to zero at the edge.
    pub even_dn: f32,
    pub darkened_dn: f32,
    /// 1 / sigma of the blur.
    pub per_blur: f32,
    pub per_radius: f32,
}

impl EdgeLight {
    /// Brightness at a distance outwards from the edge, DN, and its first and second derivative, per px.
    #[inline(always)]
    pub fn at(&self, distance_px: f32) -> (f32, f32, f32) {
        let (even, darkened, per_blur) = (self.even_dn, self.darkened_dn, self.per_blur);
        let parts = self.parts(distance_px);
        let slope = darkened * parts.root_slope - even * parts.density;
        let bend = darkened * parts.root_bend + even * parts.density * distance_px * per_blur;
        (
            even * parts.tail + darkened * parts.root,
            slope * per_blur,
            bend * per_blur * per_blur,
        )
    }

    /// The two parts of the brightness at a distance, relative to the centre of an unblurred disc.
    #[inline(always)]
    pub fn parts(&self, distance_px: f32) -> Parts {
        let (per_blur, per_radius) = (self.per_blur, self.per_radius);
        let depth = smaller(larger(-distance_px, 0.0), 1.0 / per_radius);
        // Converts F(z)^2 to 1 - r^2 / R^2 with r = R + distance.
        let scale2 = (2.0 - depth * per_radius) * (per_radius / per_blur);
        Parts::at(distance_px * per_blur, scale2)
    }
}

/// The blurred disc's two parts at a distance outwards from the limb, in blurs.
pub struct Parts {
    /// E(z), and the normal distribution's density, by which it decreases.
    pub tail: f32,
    density: f32,
    /// F(z), scaled, and its first and second derivative by z.
    pub root: f32,
    root_slope: f32,
    root_bend: f32,
}

impl Parts {
    /// With d = max(0, x - z), <sqrt d> is at most sqrt(<1> <d>) and <1 / sqrt d> at least sqrt(<1>^3 / <d>), where <1> is
    /// the tail and <d> the density minus z times the tail. Deep in the disc they equal these bounds, and far outside they
    /// differ by a sixth (less) and three quarters (more); in between, factors fitted to the integrals interpolate. F is
    /// accurate to 0.004 and its slope to 0.008, which are 0.05 DN and 0.1 DN per px for a Sun of 200 DN.
    #[inline(always)]
    fn at(z: f32, scale2: f32) -> Self {
        let (tail, density) = normal_tail(z);
        // Far outside, where <d> is lost in rounding, it is at most a tenth of the tail.
        let beyond = larger(density - z * tail, 0.1 * tail);
        let bound = (scale2 * tail * beyond + f32::MIN_POSITIVE).sqrt();
        let per_far = 1.0 / (z * z + 2.5).sqrt();
        let out = z * per_far;
        let factor = 0.9169 + out * (0.07366 * out - 0.01016);
        let slope_factor = 1.56246 + out * (0.22187 - 0.35538 * out);
        let factor_slope = (0.22187 - 0.71076 * out) * 2.5 * per_far * per_far * per_far;
        // Common factor of both derivatives: -s / 2 of the scale s, times tail over bound.
        let common = -0.5 * scale2 * tail / bound;
        let root_bend =
            factor_slope * tail - slope_factor * (1.5 * density - 0.5 * tail * tail / beyond);
        Self {
            tail,
            density,
            root: factor * bound,
            root_slope: common * slope_factor * tail,
            root_bend: common * root_bend,
        }
    }
}

/// A limb-darkened disc on the sensor.
pub struct Disc {
    pub edge: EdgeLight,
    /// Inverse of the outline's square root: xx, xy, yy, 1/px.
    pub inverse: [f32; 3],
}

/// Brightness at some positions, DN, its slopes, DN/px, and its Laplacian (div grad), DN/px^2.
#[derive(Debug, Clone, Default)]
pub struct Lit {
    pub light: Vec<f32>,
    pub slope_x: Vec<f32>,
    pub slope_y: Vec<f32>,
    pub bend: Vec<f32>,
}

impl Lit {
    pub fn lists(&mut self) -> [&mut Vec<f32>; 4] {
        [
            &mut self.light,
            &mut self.slope_x,
            &mut self.slope_y,
            &mut self.bend,
        ]
    }
}

impl Disc {
    /// Squared radius, in disc radii, inside which the blur hardly changes the brightness.
    fn deep2(&self) -> f32 {
        const DEEP_BLURS: f32 = 8.0;
        let deep = 1.0 - DEEP_BLURS * self.edge.per_radius / self.edge.per_blur;
        larger(deep, 0.0) * larger(deep, 0.0)
    }

    /// The brightness there and its derivative by the squared radius, DN, for an unblurred disc.
    #[inline(always)]
    fn deep_light(&self, r2: f32) -> (f32, f32) {
        let EdgeLight {
            even_dn,
            darkened_dn,
            ..
        } = self.edge;
        let root = (1.0 - r2).sqrt();
        (even_dn + darkened_dn * root, -0.5 * darkened_dn / root)
    }

    /// The squared distance of a position from the disc's centre, in units of the radius, and half of its gradient, 1/px.
    #[inline(always)]
    fn radial(&self, [x, y]: [f32; 2]) -> ([f32; 2], f32) {
        let [a, b, c] = self.inverse;
        let (u, v) = (a * x + b * y, b * x + c * y);
        ([a * u + b * v, b * u + c * v], u * u + v * v)
    }

    /// The brightness at a position, from its first-order distance outwards from the edge.
    #[inline(always)]
    fn edge_light(&self, place: [f32; 2]) -> f32 {
        let ([nx, ny], r2) = self.radial(place);
        // The gradient has no direction at the very centre.
        let per_disc = (nx * nx + ny * ny + f32::MIN_POSITIVE).sqrt();
        self.edge.at((r2 - r2.sqrt()) / per_disc).0
    }

    /// The brightness on adjacent pixels of a row from a position on.
    #[inline(always)]
    fn run_light(&self, first: f32, y: f32, deep2: f32) -> [f32; LANES] {
        // Along a row the squared radius is a polynomial of the pixel's index.
        let [a, b, _] = self.inverse;
        let ([slope, _], start) = self.radial([first, y]);
        let r2 = |k: usize| {
            let k = k as i32 as f32;
            start + k * (2.0 * slope + k * (a * a + b * b))
        };
        let mut light = [0.0; LANES];
        // The ends of a row are farther out than the pixels between them.
        if larger(start, r2(LANES - 1)) < deep2 {
            for (k, light) in light.iter_mut().enumerate() {
                (*light, _) = self.deep_light(r2(k));
            }
        } else {
            for (k, light) in light.iter_mut().enumerate() {
                *light = self.edge_light([first + k as i32 as f32, y]);
            }
        }
        light
    }

    /// The brightness on a row's pixels from a position on, relative to the disc's centre, px.
    pub fn fill(&self, x: f32, y: f32, light: &mut [f32]) {
        fill(self, x, y, light);
    }

    /// The brightness at positions in whole lanes. They are relative to `from`, which is relative to the disc's centre, px.
    pub fn at(&self, from: [f32; 2], x: &[f32], y: &[f32], lit: &mut Lit) {
        for list in lit.lists() {
            list.clear();
            list.reserve(x.len());
        }
        light_at(self, from, x, y, lit);
    }
}

#[multiversion(targets("x86_64+avx2"))]
fn fill(disc: &Disc, first: f32, y: f32, light: &mut [f32]) {
    let deep2 = disc.deep2();
    for (n, light) in light.chunks_mut(LANES).enumerate() {
        let found = disc.run_light(first + (n * LANES) as i32 as f32, y, deep2);
        // A copy of constant length compiles to one instruction.
        match light.len() {
            LANES => light.copy_from_slice(&found),
            left => light.copy_from_slice(&found[..left]),
        }
    }
}

/// A pixel and its neighbours, whose differences give the slopes at the edge.
const STENCIL: [[f32; 2]; 5] = [[0.0, 0.0], [-1.0, 0.0], [1.0, 0.0], [0.0, -1.0], [0.0, 1.0]];

#[multiversion(targets("x86_64+avx2"))]
fn light_at(disc: &Disc, from: [f32; 2], x: &[f32], y: &[f32], lit: &mut Lit) {
    let deep2 = disc.deep2();
    let [a, b, c] = disc.inverse;
    let trace = a * a + 2.0 * b * b + c * c;
    for (x, y) in groups(x).iter().zip(groups(y)) {
        let mut r2 = [0.0; LANES];
        for k in 0..LANES {
            (_, r2[k]) = disc.radial([from[0] + x[k], from[1] + y[k]]);
        }
        let mut found = [[0.0; LANES]; 4];
        if r2.iter().copied().fold(0.0, larger) < deep2 {
            for k in 0..LANES {
                let ([nx, ny], r2) = disc.radial([from[0] + x[k], from[1] + y[k]]);
                let (light, by_r2) = disc.deep_light(r2);
                let slope = 2.0 * by_r2;
                found[0][k] = light;
                found[1][k] = slope * nx;
                found[2][k] = slope * ny;
                found[3][k] = slope * (trace + (nx * nx + ny * ny) / (1.0 - r2));
            }
        } else {
            let mut about = [[0.0; LANES]; 5];
            for (about, [dx, dy]) in about.iter_mut().zip(STENCIL) {
                for k in 0..LANES {
                    about[k] = disc.edge_light([from[0] + dx + x[k], from[1] + dy + y[k]]);
                }
            }
            let [here, left, right, above, below] = about;
            for k in 0..LANES {
                found[0][k] = here[k];
                found[1][k] = (right[k] - left[k]) / 2.0;
                found[2][k] = (below[k] - above[k]) / 2.0;
                found[3][k] = left[k] + right[k] + above[k] + below[k] - 4.0 * here[k];
            }
        }
        for (list, found) in lit.lists().into_iter().zip(found) {
            list.extend(found);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_blurred_parts_are_those_of_their_definition() {
        let density = |x: f64| (-0.5 * x * x).exp() / std::f64::consts::TAU.sqrt();
        for n in -60..=32 {
            let z = f64::from(n) * 0.25;
            // The substitution x = z + s^2 removes the square root: F = integral of 2 s^2 density, F' = -integral of
            // density.
            let step = (8.0 - z).max(1.0).sqrt() / 2000.0;
            let cells = (0..2000).map(|n| (n as f64 + 0.5) * step);
            let (root, slope) = cells.fold((0.0, 0.0), |(root, slope), s| {
                let here = density(z + s * s) * step;
                (root + 2.0 * s * s * here, slope - here)
            });
            let parts = Parts::at(z as f32, 1.0);
            assert!((f64::from(parts.root) - root).abs() < 0.004, "{z}");
            assert!((f64::from(parts.root_slope) - slope).abs() < 0.008, "{z}");
            let tail = 0.5 * libm::erfc(z / std::f64::consts::SQRT_2);
            assert!((f64::from(parts.tail) - tail).abs() < 2e-5, "{z}");
        }
    }

    #[test]
    fn slopes_and_bends_are_those_of_the_light() {
        let disc = Disc {
            edge: EdgeLight {
                even_dn: 90.0,
                darkened_dn: 115.0,
                per_blur: 1.0 / 0.95,
                per_radius: 1.0 / 95.0,
            },
            inverse: [1.0 / 95.1, 1e-5, 1.0 / 94.9],
        };
        const STEP: f32 = 1.0;
        for start in [0.0_f32, 40.0, 60.5] {
            let places: Vec<f32> = (0..LANES).map(|n| start + n as f32).collect();
            let lit_at = |dx: f32, dy: f32| {
                let mut lit = Lit::default();
                disc.at([dx, dy], &places, &places, &mut lit);
                lit
            };
            let here = lit_at(0.0, 0.0);
            let [right, left] = [STEP, -STEP].map(|by| lit_at(by, 0.0).light);
            let [below, above] = [STEP, -STEP].map(|by| lit_at(0.0, by).light);
            for k in 0..LANES {
                let mut row = [0.0];
                disc.fill(places[k], places[k], &mut row);
                assert!((here.light[k] - row[0]).abs() < 0.3);
                assert!((here.slope_x[k] - (right[k] - left[k]) / (2.0 * STEP)).abs() < 1.0);
                assert!((here.slope_y[k] - (below[k] - above[k]) / (2.0 * STEP)).abs() < 1.0);
                let sum = right[k] + left[k] + below[k] + above[k];
                let bend = (sum - 4.0 * here.light[k]) / (STEP * STEP);
                assert!((here.bend[k] - bend).abs() < 2.5, "{} {bend}", here.bend[k]);
            }
        }
    }
}
