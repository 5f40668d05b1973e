//! Covers of a part of the Sun: the Moon in an eclipse, the edge of a cloud, a strut.

use super::{Purpose, generator};
use crate::geometry::unit;
use crate::kernels::normal_tail;
use nalgebra::Vector2;
use rand::RngExt;
use std::f64::consts::TAU;
use std::ops::Range;

/// An object in front of the Sun; it moves with the Sun's image.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Cover {
    /// A dark disc as sharp as the Sun: the Moon.
    Disc {
        /// Offset from the Sun's centre.
        offset_mil: Vector2<f64>,
        radius_mil: f64,
    },
    /// A shadow with straight edges: a strut, or a cloud, whose second edge is at infinity.
    Shadow {
        /// Direction across it, from +x towards +y on the plate, rad.
        across_rad: f64,
        /// Positions of its two edges in that direction, from the Sun's centre.
        edges_mil: [f64; 2],
        /// Gaussian softness of its edges, 1 sigma.
        soft_mil: f64,
        /// Fraction of the light that it absorbs, 0 to 1.
        depth: f64,
    },
}

impl Cover {
    /// Fraction of the light that passes at an offset from the Sun's centre, 0 to 1.
    pub fn left(&self, offset_mil: Vector2<f64>) -> f64 {
        match *self {
            Self::Disc {
                offset_mil: centre,
                radius_mil,
            } => f64::from(u8::from((offset_mil - centre).norm() > radius_mil)),
            Self::Shadow {
                across_rad,
                edges_mil,
                soft_mil,
                depth,
            } => {
                let along = offset_mil.dot(&unit(across_rad));
                let behind = |edge: f64| normal_tail(((edge - along) / soft_mil) as f32).0;
                let [begun, ended] = edges_mil.map(behind);
                1.0 - depth * f64::from(begun - ended)
            }
        }
    }
}

/// Extent of the covers of each kind. Directions, places and softness are drawn at random.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Covers {
    /// Fraction of the Sun's diameter that the Moon covers.
    pub eclipse: f64,
    /// Fraction of the light that a cloud absorbs, 0 to 1; its edge crosses the disc.
    pub cloud: f64,
    /// Width of a dark strut across the disc, in radii of the Sun.
    pub strut: f64,
}

/// Ratio of the Moon's radius to the Sun's.
const MOON_RADII: Range<f64> = 0.93..1.07;
/// Softness of the edges of a cloud and of a strut out of focus, 1 sigma, in solar radii: uniform in its logarithm.
const CLOUD_SOFT_RADII: Range<f64> = 0.02..0.5;
const STRUT_SOFT_RADII: Range<f64> = 0.01..0.1;

impl Covers {
    /// Covers drawn for a Sun of this radius.
    pub(super) fn random(&self, radius_mil: f64, seed: u64) -> Vec<Cover> {
        let mut rng = generator(seed, Purpose::Covers, 0);
        // Everything is drawn whether it is used or not, so that one more effect changes no other.
        let [moon, cloud, strut]: [f64; 3] = std::array::from_fn(|_| rng.random_range(0.0..TAU));
        let moon_mil = rng.random_range(MOON_RADII) * radius_mil;
        let mut soft_mil = |radii: Range<f64>| {
            let log = rng.random_range(radii.start.ln()..radii.end.ln());
            log.exp() * radius_mil
        };
        let (cloud_soft_mil, strut_soft_mil) =
            (soft_mil(CLOUD_SOFT_RADII), soft_mil(STRUT_SOFT_RADII));
        let [cloud_mil, strut_mil]: [f64; 2] =
            std::array::from_fn(|_| rng.random_range(-1.0..1.0) * radius_mil);
        let apart_mil = radius_mil + moon_mil - 2.0 * radius_mil * self.eclipse;
        let half_mil = self.strut * radius_mil / 2.0;
        let covers = [
            (self.eclipse > 0.0).then(|| Cover::Disc {
                offset_mil: unit(moon) * apart_mil,
                radius_mil: moon_mil,
            }),
            (self.cloud > 0.0).then_some(Cover::Shadow {
                across_rad: cloud,
                edges_mil: [cloud_mil, f64::INFINITY],
                soft_mil: cloud_soft_mil,
                depth: self.cloud,
            }),
            (self.strut > 0.0).then_some(Cover::Shadow {
                across_rad: strut,
                edges_mil: [strut_mil - half_mil, strut_mil + half_mil],
                soft_mil: strut_soft_mil,
                depth: 1.0,
            }),
        ];
        covers.into_iter().flatten().collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_eclipse_covers_the_part_of_the_diameter_that_it_says() {
        for seed in 0..20 {
            let covers = Covers {
                eclipse: 0.3,
                ..Covers::default()
            };
            let covers = covers.random(550.0, seed);
            let [Cover::Disc { offset_mil, .. }] = covers[..] else {
                panic!("{covers:?}");
            };
            let towards = offset_mil.normalize();
            let left = |radii: f64| covers[0].left(towards * 550.0 * radii);
            assert_eq!((left(0.39), left(0.41), left(0.99)), (1.0, 0.0, 0.0));
        }
    }

    #[test]
    fn a_cloud_takes_its_share_beyond_its_edge_and_a_strut_all_between_its_own() {
        let shadow = |edges_mil, depth| Cover::Shadow {
            across_rad: 0.0,
            edges_mil,
            soft_mil: 10.0,
            depth,
        };
        let cloud = shadow([100.0, f64::INFINITY], 0.75);
        let left = |cover: &Cover, x: f64| cover.left(Vector2::new(x, 300.0));
        for (x, expected) in [(0.0, 1.0), (100.0, 0.625), (200.0, 0.25)] {
            assert!((left(&cloud, x) - expected).abs() < 1e-4, "{x}");
        }
        let strut = shadow([-50.0, 50.0], 1.0);
        for (x, expected) in [(-150.0, 1.0), (0.0, 0.0), (50.0, 0.5), (150.0, 1.0)] {
            assert!((left(&strut, x) - expected).abs() < 1e-4, "{x}");
        }
    }
}
