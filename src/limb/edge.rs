//! Points of the limb: at every azimuth the edge's profile is fitted to the pixels about it.
//!
//! # Method
//! The pixels within a band about a first outline, but for those that marks hide, are sorted by distance from it and by
//! sector. The medians at each distance, taken all round, give the [`Profile`]. In each sector the profile is then
//! shifted and scaled to the pixels by linear least squares, with Tukey's weights against hot pixels and scratches: the
//! shift is the limb's distance from the first outline, the scale takes up what tilts the light across the disc, which
//! is nearly alike in neighbouring sectors.
//!
//! All pixels of the limb serve, so a point is as good as their noise allows (Cramer-Rao) but for what the scale costs.
//! What one look teaches (profile, noise, the light's tilt) serves the next one about a better outline.

use super::appearance::{Appearance, Noise, TILT, Tilt};
use super::band::{Band, Reach, middle_of_sector};
use super::hidden::Hidden;
use super::outline::TUKEY_SIGMAS;
use super::profile::Profile;
use super::typical::medians;
use crate::frame::{Frame, Levels};
use crate::geometry::Ellipse;
use crate::lanes::{Scratch, larger, split};
use crate::statistics::clipped_sigma;
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
const BAND_OUTSIDE: (f64, f64) = (4.0, 4.0);
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
pub(super) struct Look {
    pub points: Vec<LimbPoint>,
    pub appearance: Appearance,
}

/// Where to look.
pub(super) struct Sight<'a> {
    pub frame: &'a Frame,
    pub outline: &'a Ellipse,
    pub hidden: &'a Hidden,
    pub sectors: usize,
}

impl Sight<'_> {
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
    pub(super) fn first_look(&self, start: &Profile, levels: &Levels) -> Option<Look> {
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
        let edge = Edge::new(
            &band,
            profile,
            shift_px,
            self.saturation_dn(),
            noise,
            &slack,
        );
        Some(self.look(&edge, Tilt::NONE, 0.0))
    }

    /// The limb about an outline that is nearly right, as it appeared before.
    pub(super) fn look_again(&self, before: &Appearance) -> Look {
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
            &slack,
        );
        self.look(&edge, before.light, UNEVEN.powi(-2))
    }

    /// Fits every sector: the light expected there, with some information that it is so.
    fn look(&self, edge: &Edge<'_>, expected: Tilt, information: f64) -> Look {
        let directions: Vec<Vector2<f64>> = (0..self.sectors)
            .map(|n| middle_of_sector(n, self.sectors))
            .collect();
        let expecting = |w: &Vector2<f64>| Sector::expecting(expected.at(*w));
        let mut sectors: Vec<Sector> = directions.iter().map(expecting).collect();
        let unexplained = edge.sum(&mut sectors);
        let found: Vec<(Vector2<f64>, Shift)> = directions
            .iter()
            .zip(&sectors)
            .filter_map(|(w, sector)| Some((*w, sector.solve(information)?)))
            .collect();
        let point = |(w, shift): &(Vector2<f64>, Shift)| LimbPoint {
            at: (self.outline.from_disc(*w) + self.outline.normal(*w) * (shift.px + edge.shift_px))
                .into(),
            sigma_px: shift.sigma_px,
        };
        let light = Tilt::of(found.iter().map(|(w, shift)| (*w, shift.excess_light)));
        // What is left of a sector's pixels holds what its light exceeds the expected one by.
        let more: Vec<f32> = directions
            .iter()
            .map(|w| (light.at(*w) - expected.at(*w)) as f32)
            .collect();
        Look {
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
    /// By distance from [`Edge::first_px`] on.
    table: Vec<Expected>,
    first_px: f64,
}

/// What is expected at a distance.
#[derive(Clone, Copy)]
struct Expected {
    here: Ordinates,
    /// What leads from there to the next entry.
    step: Ordinates,
    /// One over the variance; 0 where a pixel does not count.
    weight: f32,
    /// One over the square of what is out of the question.
    per_limit2: f32,
}

/// The profile at a distance.
#[derive(Clone, Copy)]
struct Ordinates {
    /// Change per px outwards.
    slope: f32,
    /// Above the background.
    light: f32,
    dn: f32,
}

impl Ordinates {
    fn to(self, next: Self) -> Self {
        Self {
            slope: next.slope - self.slope,
            light: next.light - self.light,
            dn: next.dn - self.dn,
        }
    }
}

/// Entries of the table for each pixel.
const PER_PX: f64 = 16.0;
/// A band's pixels may lie a little outside its reach.
const MARGIN_PX: f64 = 0.5;

impl<'a> Edge<'a> {
    fn new(
        band: &'a Band,
        profile: Profile,
        shift_px: f64,
        saturation_dn: f64,
        noise: Noise,
        slack: &Slack,
    ) -> Self {
        let reach = &band.reach;
        let first_px = -reach.inside_px - MARGIN_PX;
        let count = ((reach.outside_px + MARGIN_PX - first_px) * PER_PX) as usize + 2;
        let at = |n: usize| {
            let distance_px = first_px + n as f64 / PER_PX - shift_px;
            let (dn, slope) = profile.both(distance_px);
            Ordinates {
                slope: slope as f32,
                light: (dn - profile.background_dn) as f32,
                dn: dn as f32,
            }
        };
        let values: Vec<Ordinates> = (0..=count).map(at).collect();
        let clipped_dn = (saturation_dn - 2.0 * noise.outside_dn) as f32;
        let peak = values[0].light.max(1.0);
        let entry = |pair: &[Ordinates]| {
            let here = pair[0];
            let variance = noise.variance((here.light / peak).clamp(0.0, 1.0));
            let spread2 = variance + slack.variance(here.light, here.slope);
            Expected {
                here,
                step: here.to(pair[1]),
                weight: if here.dn > clipped_dn {
                    0.0
                } else {
                    1.0 / variance
                },
                per_limit2: 1.0 / (spread2 * (TUKEY_SIGMAS * TUKEY_SIGMAS) as f32),
            }
        };
        Self {
            band,
            profile,
            shift_px,
            noise,
            table: values.windows(2).map(entry).collect(),
            first_px,
        }
    }

    /// Adds every pixel to its sector's normal equations; what the sectors' expectations do not explain, pixel by pixel.
    fn sum(&self, sectors: &mut [Sector]) -> Scratch<f32> {
        let band = self.band;
        let count = band.dn.len();
        let (mut entry, mut part) = (Scratch::of_length(count), Scratch::of_length(count));
        let last = self.table.len().saturating_sub(1) as f32;
        find_places(
            &band.distance_px,
            self.first_px as f32,
            last,
            &mut entry,
            &mut part,
        );
        let mut unexplained = Scratch::of_length(count);
        add_pixels(
            &self.table,
            (&entry, &part),
            band,
            sectors,
            &mut unexplained,
        );
        unexplained
    }

    /// The pixels' noise from what is left unexplained well away from the limb, once every sector has so much `more`
    /// light than was expected.
    fn noise(&self, unexplained: &[f32], more: &[f32]) -> Noise {
        let clear = (3.0 * self.profile.blur_px) as f32;
        let limb = self.shift_px as f32;
        // Where the disc saturates its noise does not show.
        let dull = self.table.iter().position(|e| e.weight > 0.0).unwrap_or(0);
        let least = (self.first_px + dull as f64 / PER_PX) as f32;
        let plateau = self
            .table
            .get(PER_PX as usize)
            .map_or(0.0, |e| e.here.light);
        let band = self.band;
        let [mut outside, mut inside] = [(); 2].map(|()| Scratch::empty(band.dn.len()));
        // Every second pixel tells enough.
        let pixels = band
            .distance_px
            .iter()
            .zip(unexplained)
            .zip(band.sector.iter());
        for ((distance, left), sector) in pixels.step_by(2) {
            if *distance > limb + clear {
                outside.push(*left);
            } else if *distance < limb - clear && *distance > least {
                inside.push(left - more[usize::from(*sector)] * plateau);
            }
        }
        let sigma = |left: &[f32], start: f64| clipped_sigma(left, start as f32).unwrap_or(start);
        Noise {
            outside_dn: sigma(&outside, self.noise.outside_dn),
            inside_dn: sigma(&inside, self.noise.inside_dn),
        }
    }
}

impl Slack {
    /// What light and slope may differ by, DN^2.
    fn variance(&self, light: f32, slope: f32) -> f32 {
        (self.light as f32 * light).powi(2) + (self.shift_px as f32 * slope).powi(2)
    }
}

/// Adds every pixel to its sector; what that does not explain.
#[multiversion(targets("x86_64+avx2"))]
fn add_pixels(
    table: &[Expected],
    (entry, part): (&[u16], &[f32]),
    band: &Band,
    sectors: &mut [Sector],
    unexplained: &mut [f32],
) {
    let count = unexplained.len();
    let (entry, part) = (&entry[..count], &part[..count]);
    let (dn, of_sector) = (&band.dn[..count], &band.sector[..count]);
    for n in 0..count {
        let expected = &table[usize::from(entry[n])];
        let sector = &mut sectors[usize::from(of_sector[n])];
        unexplained[n] = sector.add(expected, part[n], dn[n]);
    }
}

/// Where in a table pixels are: the entry, and how far towards the next one.
#[multiversion(targets("x86_64+avx2"))]
fn find_places(distance_px: &[f32], first_px: f32, last: f32, entry: &mut [u16], part: &mut [f32]) {
    let count = distance_px.len();
    let (entry, part) = (&mut entry[..count], &mut part[..count]);
    for n in 0..count {
        let along = ((distance_px[n] - first_px) * PER_PX as f32).clamp(0.0, last);
        let (whole, left) = split(along);
        (entry[n], part[n]) = (whole as u16, left);
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

    /// Adds a pixel; what the expected light does not explain of it, DN.
    #[inline(always)]
    fn add(&mut self, expected: &Expected, part: f32, dn: f32) -> f32 {
        let Expected { here, step, .. } = expected;
        let slope = here.slope + part * step.slope;
        let light = here.light + part * step.light;
        let residual = dn - (here.dn + part * step.dn);
        let left = residual - self.light * light;
        let within = larger(1.0 - left * left * expected.per_limit2, 0.0);
        let weight = within * within * expected.weight;
        let (by_slope, by_light) = (weight * slope, weight * light);
        self.slope2 += by_slope * slope;
        self.slope_light += by_slope * light;
        self.light2 += by_light * light;
        self.slope_residual += by_slope * residual;
        self.light_residual += by_light * residual;
        left
    }

    /// The fit, with some information that the light is the expected one.
    fn solve(&self, information: f64) -> Option<Shift> {
        let cross = -f64::from(self.slope_light);
        let light2 = f64::from(self.light2) + information;
        let normal = Matrix2::new(f64::from(self.slope2), cross, cross, light2);
        if normal.determinant() < LEAST_OWN_PART * normal.m11 * normal.m22 {
            return None;
        }
        let inverse = normal.try_inverse()?;
        let light_residual = f64::from(self.light_residual) + information * f64::from(self.light);
        let fit = inverse * Vector2::new(-f64::from(self.slope_residual), light_residual);
        let sigma_px = inverse.m11.max(0.0).sqrt();
        (sigma_px < MAX_SIGMA_PX && fit.x.abs() < MAX_SHIFT_PX).then_some(Shift {
            px: fit.x,
            sigma_px,
            excess_light: fit.y,
        })
    }
}
