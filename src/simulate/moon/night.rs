//! Clouds at night, lit by a hidden Moon.

use super::MoonScene;
use crate::simulate::texture::Pattern;
use crate::simulate::{Purpose, generator};
use nalgebra::{Vector2, Vector3};
use rand::RngExt;
use std::ops::Range;

/// Light in the middle of the glow: much of it may be saturated.
const GLOW_DN: Range<f64> = 40.0..2000.0;
/// Reach of the glow, as a fraction of the picture's width: uniform in its logarithm, like its brightness.
const GLOW_SHARE: Range<f64> = 0.01..0.5;
/// Size of the clouds, as a fraction of the picture's width.
const CLOUD_SHARE: Range<f64> = 0.05..0.6;
/// Width of the clouds' edges in units of their pattern: the smaller, the sharper.
const EDGE: Range<f64> = 0.005..0.5;
/// Light of clouds that are lit from below.
const FROM_BELOW_DN: f64 = 120.0;

/// Profile of the glow.
#[derive(Debug, Clone, Copy)]
enum Glow {
    None,
    /// Gaussian, by haze.
    Haze,
    /// Diffraction by drops of one size (a corona): a bright disc with an edge, and rings.
    Corona,
}

/// A lit sky of clouds.
pub(super) struct Clouds {
    glow: Glow,
    middle: Vector2<f64>,
    glow_dn: f64,
    reach_px: f64,
    from_below_dn: f64,
    pattern: Pattern,
    size_px: f64,
    edge: f64,
    /// Smallest fraction of the light in the clouds' pattern.
    thinnest: f64,
}

impl Clouds {
    /// The clouds of a scene, around the place of its Moon.
    pub fn of(scene: &MoonScene) -> Self {
        let mut random = generator(scene.seed, Purpose::NightSky, scene.number);
        let width_px = scene.conditions.width_px as f64;
        let mut even_in_log = |range: Range<f64>| {
            let log = random.random_range(range.start.ln()..range.end.ln());
            log.exp()
        };
        let (glow_dn, reach_px) = (even_in_log(GLOW_DN), even_in_log(GLOW_SHARE) * width_px);
        let (size_px, edge) = (even_in_log(CLOUD_SHARE) * width_px, even_in_log(EDGE));
        Self {
            glow: [Glow::None, Glow::Haze, Glow::Corona][random.random_range(0..3)],
            middle: scene.centre.vector(),
            glow_dn,
            reach_px,
            from_below_dn: FROM_BELOW_DN * random.random::<f64>(),
            pattern: Pattern::new(Purpose::NightSky, scene.seed, scene.number),
            size_px,
            edge,
            thinnest: random.random(),
        }
    }

    /// Adds their light to a picture's, row by row.
    pub fn add(&self, width_px: usize, light: &mut [f32]) {
        for (n, dn) in light.iter_mut().enumerate() {
            let at = Vector2::new((n % width_px) as f64, (n / width_px) as f64);
            let cell = at / self.size_px;
            let off = self.pattern.at(&Vector3::new(cell.x, cell.y, 0.5)) - 0.5;
            let thick = (off / self.edge + 0.5).clamp(0.0, 1.0);
            let seen = self.thinnest + (1.0 - self.thinnest) * thick;
            let glow_dn = self.glow_dn * self.glow((at - self.middle).norm() / self.reach_px);
            *dn += (seen * glow_dn + thick * self.from_below_dn) as f32;
        }
    }

    /// The glow at a distance from its middle, in units of its reach, relative to that in the middle.
    fn glow(&self, distance: f64) -> f64 {
        match self.glow {
            Glow::None => 0.0,
            Glow::Haze => (-distance * distance).exp(),
            Glow::Corona => {
                // Diffraction by a round drop (Airy 1835); its first dark ring is at the reach.
                let x = (3.831_706 * distance).max(1e-6);
                (2.0 * libm::j1(x) / x).powi(2)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulate::moon::{MoonConditions, Shown};

    #[test]
    fn a_corona_is_a_disc_with_a_dark_ring_at_its_reach_and_haze_falls_off_evenly() {
        let conditions = MoonConditions {
            shown: Shown::Clouds,
            ..MoonConditions::clear(15.0)
        };
        let of = |glow| Clouds {
            glow,
            ..Clouds::of(&conditions.scene(1, 1))
        };
        for glow in [Glow::Haze, Glow::Corona] {
            assert!((of(glow).glow(0.0) - 1.0).abs() < 1e-6, "{glow:?}");
        }
        let corona = of(Glow::Corona);
        assert!(corona.glow(1.0) < 1e-9);
        // The first ring of the Airy pattern has 1.75 % of the middle's light.
        let ring = corona.glow(5.135_622 / 3.831_706);
        assert!((ring - 0.0175).abs() < 1e-4, "{ring}");
        let haze = of(Glow::Haze);
        assert!((haze.glow(1.0) - (-1.0_f64).exp()).abs() < 1e-12);
        assert_eq!(of(Glow::None).glow(0.0), 0.0);
    }
}
