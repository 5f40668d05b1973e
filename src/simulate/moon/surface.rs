//! The Moon's surface: its light at every place of the disc.

use super::{MoonConditions, MoonScene};
use crate::moon::Shading;
use crate::simulate::Purpose;
use crate::simulate::coverage::Footprint;
use crate::simulate::texture::{LastCell, Pattern, Random};
use nalgebra::{Rotation3, Vector2, Vector3};
use std::array::from_fn;

/// Amplitude of the albedo; number of cells of its largest pattern across the radius; amplitude of value noise in five octaves about its mean of 0.5.
const ALBEDO: f64 = 0.25;
const ALBEDO_CELLS: f64 = 3.0;
const PATTERN_REACH: f64 = 0.3;
/// Albedo of seas relative to other ground; their size in radii; and the width of the shore in units of the pattern.
const SEA: f64 = 0.5;
const SEA_RADII: f64 = 0.8;
const SHORE: f64 = 0.06;

pub(super) struct Surface {
    sun: Vector3<f64>,
    shading: Shading,
    earthshine: f64,
    ground: Option<Ground>,
    seas: Option<Seas>,
}

/// Craters, and dark and bright ground.
struct Ground {
    craters: Craters,
    albedo: Pattern,
    turn: Rotation3<f64>,
}

impl Surface {
    pub fn new(conditions: &MoonConditions, scene: &MoonScene) -> Self {
        let turn = Rotation3::from_axis_angle(&Vector3::z_axis(), scene.turn_deg.to_radians());
        Self {
            sun: scene.sun(),
            shading: conditions.shading,
            earthshine: conditions.earthshine,
            ground: conditions.craters.then(|| Ground {
                craters: Craters::new(scene.seed, scene.number),
                albedo: Pattern::new(Purpose::Albedo, scene.seed, scene.number),
                turn,
            }),
            seas: conditions.seas.then(|| Seas {
                pattern: Pattern::new(Purpose::Seas, scene.seed, scene.number),
                turn,
            }),
        }
    }

    /// Light of a sub-sample around a place on the disc; 0 outside. If the limb crosses it, its fraction inside counts.
    pub fn light(&self, x: f64, y: f64, footprint: &Footprint) -> f64 {
        /// Distance from the limb within which craters and mountains may cover or reveal a place.
        const NEAR_LIMB: f64 = 0.02;
        let distance = x.hypot(y);
        let radius = match &self.ground {
            Some(ground) if (distance - 1.0).abs() < NEAR_LIMB => {
                1.0 + ground.relief(&(Vector3::new(x, y, 0.0) / distance)).0
            }
            _ => 1.0,
        };
        let outwards = Vector2::new(x, y) / distance.max(f64::MIN_POSITIVE);
        let edge = footprint.edge(outwards);
        let within = edge.coverage(radius - distance);
        if within == 0.0 {
            return 0.0;
        }
        // The middle of the part inside.
        let middle = distance.min(radius - edge.reach() * within / 2.0) / radius;
        let scale = middle.max(0.0) / distance.max(f64::MIN_POSITIVE);
        let place = Vector3::new(
            x * scale,
            y * scale,
            (1.0 - middle * middle).max(0.0).sqrt(),
        );
        let (normal, albedo) = match &self.ground {
            Some(ground) => (ground.normal(&place), ground.albedo(&place)),
            None => (place, 1.0),
        };
        let sea = self.seas.as_ref().map_or(1.0, |seas| seas.albedo(&place));
        within
            * albedo
            * sea
            * (self.shading.light(normal.dot(&self.sun), place.z) + self.earthshine)
    }
}

/// Large dark plains, which shift the centroid of the light to one side.
struct Seas {
    pattern: Pattern,
    turn: Rotation3<f64>,
}

impl Seas {
    fn albedo(&self, place: &Vector3<f64>) -> f64 {
        let off = self.pattern.at(&(self.turn * place / SEA_RADII)) - 0.5;
        let land = (off / SHORE + 0.5).clamp(0.0, 1.0);
        SEA + (1.0 - SEA) * land
    }
}

impl Ground {
    /// Height in radii, and its gradient.
    fn relief(&self, place: &Vector3<f64>) -> (f64, Vector3<f64>) {
        let (height, slope) = self.craters.at(&(self.turn * place));
        (height, self.turn.inverse() * slope)
    }

    fn albedo(&self, place: &Vector3<f64>) -> f64 {
        let off = self.albedo.at(&(self.turn * place * ALBEDO_CELLS)) - 0.5;
        1.0 + (off * (ALBEDO / PATTERN_REACH)).clamp(-ALBEDO, ALBEDO)
    }

    /// The ground's normal, which is tilted by its slope along the sphere.
    fn normal(&self, place: &Vector3<f64>) -> Vector3<f64> {
        let (_, slope) = self.relief(place);
        (place - (slope - place * slope.dot(place))).normalize()
    }
}

/// Craters of some sizes: intersections of the sphere with balls at random places in the cells of space. Each is a bowl with a rim.
struct Craters {
    random: Random,
    /// The craters around the last cell, for each size.
    around: [LastCell<[Crater; 8]>; Self::SIZES],
}

impl Craters {
    /// Cell size of the largest craters, in radii; each further size is half the previous one.
    const CELL: f64 = 0.2;
    const SIZES: usize = 3;
    /// Radii of the balls, in cells.
    const RADII: [f64; 2] = [0.25, 0.5];
    /// Depth over radius, so that the ground's rms height is a thousandth of the Moon's radius.
    const DEPTH: f64 = 0.108;

    fn new(seed: u64, number: u64) -> Self {
        Self {
            random: Random::new(Purpose::Craters, seed, number),
            around: from_fn(|_| LastCell::none()),
        }
    }

    /// Height in radii, and its gradient.
    fn at(&self, place: &Vector3<f64>) -> (f64, Vector3<f64>) {
        let (mut height, mut slope) = (0.0, Vector3::zeros());
        for size in 0..Self::SIZES {
            let cell = Self::CELL / f64::from(1 << size);
            let first = (place / cell).map(|v| (v - 0.5).floor());
            let around = || self.craters(&first, size, cell);
            for crater in self.around[size].value(&first, around) {
                let (deeper, steeper) = crater.at(place);
                height += deeper;
                slope += steeper;
            }
        }
        (height, slope)
    }

    /// The craters of a cell and of its seven neighbours towards +x, +y and +z.
    fn craters(&self, first: &Vector3<f64>, size: usize, cell: f64) -> [Crater; 8] {
        from_fn(|n| {
            let offset = [n & 1, n >> 1 & 1, n >> 2 & 1].map(|step| step as f64);
            self.crater(&(first + Vector3::from(offset)), size, cell)
        })
    }

    fn crater(&self, corner: &Vector3<f64>, size: usize, cell: f64) -> Crater {
        let draw = |n: u64| self.random.at(corner, 4 * size as u64 + n);
        let [least, most] = Self::RADII;
        Crater {
            centre: (corner + Vector3::new(draw(0), draw(1), draw(2))) * cell,
            radius: (least + (most - least) * draw(3)) * cell,
        }
    }
}

#[derive(Clone, Copy)]
struct Crater {
    centre: Vector3<f64>,
    radius: f64,
}

impl Crater {
    /// Height at a place, and its gradient.
    fn at(&self, place: &Vector3<f64>) -> (f64, Vector3<f64>) {
        let away = (place - self.centre) / self.radius;
        let square = away.norm_squared();
        if square >= 1.0 {
            return (0.0, Vector3::zeros());
        }
        let depth = Craters::DEPTH * self.radius;
        let inner = 1.0 - square;
        let height = -depth * inner * inner * (1.0 - 3.0 * square);
        let slope = away * (2.0 * depth / self.radius * inner * (5.0 - 9.0 * square));
        (height, slope)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sky::sphere::direction;

    #[test]
    fn the_grounds_relief_is_a_thousandth_of_the_radius_about_none_and_its_slope_is_its_heights() {
        let (mut sum, mut squares, mut count) = (0.0, 0.0, 0.0);
        for number in 0..20 {
            let craters = Craters::new(5, number);
            for n in 0..5000 {
                // A spiral that covers the sphere evenly.
                let latitude = (1.0 - (f64::from(n) + 0.5) / 2500.0).asin().to_degrees();
                let place = direction(137.507_764 * f64::from(n), latitude);
                let (height, slope) = craters.at(&place);
                sum += height;
                squares += height * height;
                count += 1.0;
                let step = Vector3::new(1e-6, -2e-6, 1.5e-6);
                let (there, _) = craters.at(&(place + step));
                assert!((there - height - slope.dot(&step)).abs() < 1e-9);
            }
        }
        let (mean, rms) = (sum / count, f64::sqrt(squares / count));
        println!("mean {mean:.6}, rms {rms:.6}");
        assert!(mean.abs() < 5e-5, "{mean}");
        assert!((rms - 0.001).abs() < 1e-4, "{rms}");
    }
}
