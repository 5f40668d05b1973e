//! Misfit between a disc's whole edge and the light of a sphere.

use super::candidate::View;
use super::profile::{Blur, Profile};
use super::sector::{LEAST_PIXELS, PIXELS, Parameters, SLACK_PX, Sectors, circle_of, from_middle};
use super::shading::Sphere;

/// Additional depth of the pixels behind the limb compared with the fit, in radii: the shading there shows the side of the
/// light.
const DEPTH: f64 = 0.12;
const LEAST_SQUARES: f64 = 1e-9;

/// Sums over the pixels of a sector.
#[derive(Debug, Clone, Copy, Default)]
struct Sums {
    pixels: f64,
    light: f64,
    dn: f64,
    light_light: f64,
    light_dn: f64,
    dn_dn: f64,
}

impl Sums {
    fn add(&mut self, light: f64, dn: f64) {
        self.pixels += 1.0;
        self.light += light;
        self.dn += dn;
        self.light_light += light * light;
        self.light_dn += light * dn;
        self.dn_dn += dn * dn;
    }

    /// Mean squared residual, DN^2, after a fit of a sky level and a brightness.
    fn left(&self) -> f64 {
        let about_mean = |products: f64, one: f64, other: f64| products - one * other / self.pixels;
        let light_light = about_mean(self.light_light, self.light, self.light);
        let light_dn = about_mean(self.light_dn, self.light, self.dn);
        let dn_dn = about_mean(self.dn_dn, self.dn, self.dn);
        let explained = light_dn.max(0.0).powi(2) / light_light.max(LEAST_SQUARES);
        (dn_dn - explained).max(0.0) / self.pixels
    }
}

/// The mean logarithm of the residual variance, DN^2, of a smooth sphere with the given parameters, over the pixels along
/// its whole circle, lit or not: of two spheres, the one with the smaller value is more likely.
pub(super) fn misfit(view: &View, at: &Parameters) -> f64 {
    let circle = circle_of(at);
    let (sphere, blur) = (Sphere::new(view.shading, at[4]), Blur::new(at[3]));
    let sectors = Sectors::of_radius(circle.radius);
    let pixels = PIXELS.start..PIXELS.end + DEPTH * circle.radius;
    let depths = pixels.start - SLACK_PX..pixels.end + SLACK_PX;
    let profile = |n: usize| {
        let angle_rad = from_middle(sectors.angle_rad(n), at[5]);
        Profile::new(&sphere, circle.radius, &blur, &depths, angle_rad)
    };
    let profiles: Vec<Profile> = (0..sectors.count).map(profile).collect();
    let mut sums = vec![Sums::default(); sectors.count];
    (view.plane).each_near(view.frame, &circle, &pixels, 1, |place, dn| {
        let (away, dn) = (place - circle.centre, f64::from(dn));
        if dn < view.levels.saturated_dn {
            let (n, _) = sectors.at(&away);
            let light = profiles[n].at(circle.radius - away.norm()).light;
            sums[n].add(light, dn - view.levels.dark_dn);
        }
    });
    let noise = view.levels.noise_dn.powi(2);
    let seen = sums
        .iter()
        .filter(|sums| sums.pixels >= LEAST_PIXELS as f64);
    let (mut total, mut pixels) = (0.0, 0.0);
    for sums in seen {
        total += sums.pixels * (sums.left() + noise).ln();
        pixels += sums.pixels;
    }
    total / f64::max(pixels, 1.0)
}
