//! Points of the limb: at every azimuth the edge's profile is fitted to the pixels about it.
//!
//! # Method
//! The pixels within a band about a first outline, but for those that marks hide, are taken in strips that cross the limb.
//! The medians at each distance, taken all round, give the [`Profile`]. In each sector of azimuth the profile is then
//! shifted and scaled to the pixels by linear least squares, with Tukey's weights against hot pixels and scratches: the
//! shift is the limb's distance from the first outline, the scale takes up what tilts the light across the disc, which
//! is nearly alike in neighbouring sectors. Once all sectors have told that tilt, each is solved again with it.
//!
//! All pixels of the limb serve, so a point is as good as their noise allows (Cramer-Rao) but for what the scale costs.
//! What one look teaches (profile, noise, the light's tilt) serves the next one about a better outline.

use super::appearance::{Appearance, Noise, TILT, Tilt};
use super::band::{Band, Reach, middle_of_sector};
use super::hidden::{HIDDEN_DN, Hidden};
use super::profile::{Profile, lay_light};
use super::typical::medians;
use crate::estimation::{TUKEY_SIGMAS, clipped_sigma};
use crate::frame::{Frame, Levels, ROUNDING_NOISE_DN};
use crate::geometry::Ellipse;
use crate::lanes::{LANES, Scratch, groups, groups_mut, larger};
use crate::units::SensorPx;
use multiversion::multiversion;
use nalgebra::{Matrix2, Vector2};

/// A point of the limb.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LimbPoint {
    pub at: SensorPx,
    /// 1 sigma across the limb, from the pixels' noise.
    pub sigma_px: f64,
}

/// The band about the first outline that is looked at, in blurs and at least so many px.
const BAND_INSIDE: (f64, f64) = (5.0, 7.0);
const BAND_OUTSIDE: (f64, f64) = (3.5, 3.5);
/// How far the light in a sector may be from what was expected once its tilt across the disc is known, 1 sigma.
const UNEVEN: f64 = 0.02;
/// How far the limb may be from an outline before and after a first look, px.
const FIRST_SHIFT_PX: f64 = 0.7;
const LATER_SHIFT_PX: f64 = 0.05;
/// Where less than this of what tells the shift is its own, a few pixels tell light and shift together.
const LEAST_OWN_PART: f64 = 1e-3;
/// A point so uncertain tells nothing.
const MAX_SIGMA_PX: f64 = 0.7;
/// A shift so large is no shift of the limb.
const MAX_SHIFT_PX: f64 = 3.0;

/// Points of the limb, and how it appears.
pub(super) struct EdgeFit {
    pub points: Vec<LimbPoint>,
    pub appearance: Appearance,
}

/// Where to look.
pub(super) struct EdgeSearch<'a> {
    pub frame: &'a Frame,
    pub outline: &'a Ellipse,
    pub hidden: &'a Hidden,
    pub sectors: usize,
}

impl EdgeSearch<'_> {
    fn band(&self, blur_px: f64) -> Band {
        let reach = |(blurs, least): (f64, f64)| (blurs * blur_px).max(least);
        let reach = Reach {
            inside_px: reach(BAND_INSIDE),
            outside_px: reach(BAND_OUTSIDE),
        };
        Band::about(self.frame, self.outline, reach, self.hidden, self.sectors)
    }

    fn saturation_dn(&self) -> f64 {
        f64::from(self.frame.saturation_dn())
    }

    /// The limb where only levels and a typical profile are known. `None` when the pixels determine no profile.
    pub(super) fn first_look(&self, start: &Profile, levels: &Levels) -> Option<EdgeFit> {
        let band = self.band(start.blur_px);
        let typical = medians(&band, self.saturation_dn());
        let (profile, shift_px) = start.fitted(&typical, levels.noise_dn)?;
        let noise = Noise {
            outside_dn: levels.noise_dn,
            inside_dn: levels.noise_dn,
        };
        let slack = Slack {
            light: TILT,
            shift_px: FIRST_SHIFT_PX,
        };
        let edge = Edge::new(&band, profile, shift_px, self.saturation_dn(), noise, slack);
        Some(self.look(&edge, Tilt::NONE, 0.0))
    }

    /// The limb about an outline that is nearly right, as it appeared before.
    pub(super) fn look_again(&self, before: &Appearance) -> EdgeFit {
        let band = self.band(before.profile.blur_px);
        let slack = Slack {
            light: UNEVEN,
            shift_px: LATER_SHIFT_PX,
        };
        let saturation_dn = self.saturation_dn();
        let edge = Edge::new(
            &band,
            before.profile,
            0.0,
            saturation_dn,
            before.noise,
            slack,
        );
        self.look(&edge, before.light, UNEVEN.powi(-2))
    }

    /// Fits every sector: first for the light's tilt across the disc, from what was expected of it with some information that
    /// it is so, then for the limb with that tilt.
    fn look(&self, edge: &Edge<'_>, expected: Tilt, information: f64) -> EdgeFit {
        let directions: Vec<Vector2<f64>> = (0..self.sectors)
            .map(|n| middle_of_sector(n, self.sectors))
            .collect();
        let expecting = |w: &Vector2<f64>| Sector::expecting(expected.at(*w));
        let mut sectors: Vec<Sector> = directions.iter().map(expecting).collect();
        let unexplained = edge.sum(&mut sectors);
        let solved = |light: Tilt, information: f64| -> Vec<(Vector2<f64>, Shift)> {
            let all = directions.iter().zip(&sectors);
            all.filter_map(|(w, sector)| Some((*w, sector.solve(light.at(*w), information)?)))
                .collect()
        };
        let free = solved(expected, information);
        let light = Tilt::of(free.iter().map(|(w, shift)| (*w, shift.excess_light)));
        let found = solved(light, UNEVEN.powi(-2));
        let point = |(w, shift): &(Vector2<f64>, Shift)| LimbPoint {
            at: (self.outline.from_disc(*w) + self.outline.normal(*w) * (shift.px + edge.shift_px))
                .into(),
            sigma_px: shift.sigma_px,
        };
        // What is left of a sector's pixels holds what its light exceeds the expected one by.
        let more: Vec<f32> = directions
            .iter()
            .map(|w| (light.at(*w) - expected.at(*w)) as f32)
            .collect();
        EdgeFit {
            points: found.iter().map(point).collect(),
            appearance: Appearance {
                profile: edge.profile,
                noise: edge.noise(&unexplained, &more),
                light,
            },
        }
    }
}

/// What may differ from the expectation before a sector is fitted, 1 sigma.
struct Slack {
    /// Part of the light.
    light: f64,
    shift_px: f64,
}

/// The profile laid about the first outline.
struct Edge<'a> {
    band: &'a Band,
    profile: Profile,
    shift_px: f64,
    noise: Noise,
    slack: Slack,
    /// Where the disc saturates, light above the background.
    saturated_dn: f64,
    /// Light above the background that is expected of every entry of the band, and its change per px outwards.
    light: Scratch<f32>,
    slope: Scratch<f32>,
}

impl<'a> Edge<'a> {
    fn new(
        band: &'a Band,
        profile: Profile,
        shift_px: f64,
        saturation_dn: f64,
        noise: Noise,
        slack: Slack,
    ) -> Self {
        let count = band.dn.len();
        let [mut light, mut slope] = [(); 2].map(|()| Scratch::of_length(count));
        let shift = shift_px as f32;
        lay_light(&profile, shift, &band.distance_px, &mut light, &mut slope);
        Self {
            band,
            profile,
            shift_px,
            noise,
            slack,
            saturated_dn: saturation_dn - 2.0 * noise.outside_dn - profile.background_dn,
            light,
            slope,
        }
    }

    /// The light at the band's inner edge, where it hardly changes any more.
    fn plateau_dn(&self) -> f32 {
        let inner = -self.band.reach.inside_px - self.shift_px;
        (self.profile.at(inner) - self.profile.background_dn) as f32
    }

    /// Adds every pixel to its sector's normal equations; what the sectors' expectations do not explain, pixel by pixel.
    fn sum(&self, sectors: &mut [Sector]) -> Scratch<f32> {
        let mut unexplained = Scratch::of_length(self.band.dn.len());
        let weighing = Weighing::new(self);
        add_pixels(self, &weighing, sectors, &mut unexplained);
        unexplained
    }

    /// The pixels' noise from what is left unexplained well away from the limb, once every sector has so much `more`
    /// light than was expected.
    fn noise(&self, unexplained: &[f32], more: &[f32]) -> Noise {
        let [mut outside, mut inside] = [(); 2].map(|()| Scratch::empty(unexplained.len()));
        tell_noise(self, unexplained, more, &mut outside, &mut inside);
        let sigma = |left: &[f32], start: f64| {
            clipped_sigma(left, start as f32, ROUNDING_NOISE_DN).unwrap_or(start)
        };
        Noise {
            outside_dn: sigma(&outside, self.noise.outside_dn),
            inside_dn: sigma(&inside, self.noise.inside_dn),
        }
    }
}

/// What is left unexplained well outside the limb and well inside it, every sector having so much `more` light than was
/// expected.
#[multiversion(targets("x86_64+avx2"))]
fn tell_noise(
    edge: &Edge<'_>,
    unexplained: &[f32],
    more: &[f32],
    outside: &mut Vec<f32>,
    inside: &mut Vec<f32>,
) {
    let (limb, clear) = (edge.shift_px as f32, (3.0 * edge.profile.blur_px) as f32);
    let (plateau, saturated) = (edge.plateau_dn(), edge.saturated_dn as f32);
    for strip in edge.band.sample() {
        let distance = groups(&edge.band.distance_px[strip.entries.clone()]);
        let light = groups(&edge.light[strip.entries.clone()]);
        let left = groups(&unexplained[strip.entries.clone()]);
        let more = strip
            .sectors
            .map(|sector| more[usize::from(sector)] * plateau);
        for ((distance, light), left) in distance.iter().zip(light).zip(left) {
            // What is of no use is told from noise by its size; where the disc saturates its noise does not show.
            let (mut far, mut deep) = ([0.0; LANES], [0.0; LANES]);
            for k in 0..LANES {
                let (out, own) = (distance[k] - limb, left[k] - more[k]);
                let shows = (out < -clear) & (light[k] < saturated);
                far[k] = left[k] + if out > clear { 0.0 } else { HIDDEN_DN };
                deep[k] = own + if shows { 0.0 } else { HIDDEN_DN };
            }
            outside.extend_from_slice(&far);
            inside.extend_from_slice(&deep);
        }
    }
}

/// How pixels are weighed by the light that is expected of them.
struct Weighing {
    background_dn: f32,
    saturated_dn: f32,
    /// Variance of the pixels' noise outside, and how it changes with the light.
    outside: f32,
    by_light: f32,
    /// Variance of what the light, in units of it squared, and the slope may differ by.
    light: f32,
    slope: f32,
}

impl Weighing {
    fn new(edge: &Edge<'_>) -> Self {
        let [outside, inside] = [0.0, 1.0].map(|share| edge.noise.variance(share));
        Self {
            background_dn: edge.profile.background_dn as f32,
            saturated_dn: edge.saturated_dn as f32,
            outside,
            by_light: (inside - outside) / edge.plateau_dn().max(1.0),
            light: edge.slack.light.powi(2) as f32,
            slope: edge.slack.shift_px.powi(2) as f32,
        }
    }

    /// The weight of a pixel that is `left` from what was expected.
    #[inline(always)]
    fn weight(&self, light: f32, slope: f32, left: f32) -> f32 {
        const TUKEY2: f32 = (TUKEY_SIGMAS * TUKEY_SIGMAS) as f32;
        let variance = self.outside + self.by_light * light;
        let spread2 = variance + self.light * light * light + self.slope * slope * slope;
        let within = larger(1.0 - left * left / (TUKEY2 * spread2), 0.0);
        let weight = within * within / variance;
        if light > self.saturated_dn {
            0.0
        } else {
            weight
        }
    }
}

/// Adds every pixel to its sector; what that does not explain.
#[multiversion(targets("x86_64+avx2"))]
fn add_pixels(
    edge: &Edge<'_>,
    weighing: &Weighing,
    sectors: &mut [Sector],
    unexplained: &mut [f32],
) {
    for strip in &edge.band.strips {
        let light = groups(&edge.light[strip.entries.clone()]);
        let slope = groups(&edge.slope[strip.entries.clone()]);
        let dn = groups(&edge.band.dn[strip.entries.clone()]);
        let unexplained = groups_mut(&mut unexplained[strip.entries.clone()]);
        let expected = strip
            .sectors
            .map(|sector| sectors[usize::from(sector)].light);
        let mut sums = [[0.0; LANES]; 5];
        for (((light, slope), dn), unexplained) in light.iter().zip(slope).zip(dn).zip(unexplained)
        {
            for k in 0..LANES {
                let residual = dn[k] - weighing.background_dn - light[k];
                let left = residual - expected[k] * light[k];
                unexplained[k] = left;
                let weight = weighing.weight(light[k], slope[k], left);
                let (by_slope, by_light) = (weight * slope[k], weight * light[k]);
                sums[0][k] += by_slope * slope[k];
                sums[1][k] += by_slope * light[k];
                sums[2][k] += by_light * light[k];
                sums[3][k] += by_slope * residual;
                sums[4][k] += by_light * residual;
            }
        }
        for (k, sector) in strip.sectors.iter().enumerate() {
            sectors[usize::from(*sector)].add(sums.map(|sum| sum[k]));
        }
    }
}

/// How the limb stands in one sector.
#[derive(Clone, Copy)]
struct Shift {
    /// Outwards from the shifted profile.
    px: f64,
    sigma_px: f64,
    /// Light over the profile's, less 1.
    excess_light: f64,
}

/// One sector: the light that is expected of it, and its normal equations for shift and excess light.
#[derive(Clone, Copy, Default)]
struct Sector {
    light: f32,
    slope2: f32,
    slope_light: f32,
    light2: f32,
    slope_residual: f32,
    light_residual: f32,
}

impl Sector {
    fn expecting(light: f64) -> Self {
        Self {
            light: light as f32,
            ..Self::default()
        }
    }

    fn add(&mut self, [slope2, slope_light, light2, slope_residual, light_residual]: [f32; 5]) {
        self.slope2 += slope2;
        self.slope_light += slope_light;
        self.light2 += light2;
        self.slope_residual += slope_residual;
        self.light_residual += light_residual;
    }

    /// The fit, with some information that the light is the expected one.
    fn solve(&self, light: f64, information: f64) -> Option<Shift> {
        let cross = -f64::from(self.slope_light);
        let light2 = f64::from(self.light2) + information;
        let normal = Matrix2::new(f64::from(self.slope2), cross, cross, light2);
        if normal.determinant() < LEAST_OWN_PART * normal.m11 * normal.m22 {
            return None;
        }
        let inverse = normal.try_inverse()?;
        let light_residual = f64::from(self.light_residual) + information * light;
        let fit = inverse * Vector2::new(-f64::from(self.slope_residual), light_residual);
        let sigma_px = inverse.m11.max(0.0).sqrt();
        (sigma_px < MAX_SIGMA_PX && fit.x.abs() < MAX_SHIFT_PX).then_some(Shift {
            px: fit.x,
            sigma_px,
            excess_light: fit.y,
        })
    }
}
