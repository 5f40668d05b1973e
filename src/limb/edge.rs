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

use super::band::{Band, HIDDEN_DN, Hidden, Reach, middle_of_sector};
use super::outline::TUKEY_SIGMAS;
use super::profile::Profile;
use super::typical::medians;
use crate::frame::{Frame, Levels, ROUNDING_NOISE_DN};
use crate::geometry::Ellipse;
use crate::units::SensorPx;
use multiversion::multiversion;
use nalgebra::{Matrix2, Matrix3, Vector2, Vector3};

/// A point of the limb.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LimbPoint {
    pub at: SensorPx,
    /// 1 sigma across the limb, from the pixels' noise.
    pub sigma_px: f64,
}

/// The band about the first outline that is looked at, in blurs and at least so many px.
const BAND_INSIDE: (f64, f64) = (5.0, 8.0);
const BAND_OUTSIDE: (f64, f64) = (4.0, 4.5);
/// How far the light at one azimuth may be from what was expected before its own scale is known, 1 sigma.
const TILT: f64 = 0.04;
/// The same once the light's tilt across the disc is known.
const UNEVEN: f64 = 0.02;
/// How far the limb may be from an outline before and after a first look, px.
const FIRST_SHIFT_PX: f64 = 0.7;
const LATER_SHIFT_PX: f64 = 0.05;
/// A point so uncertain tells nothing.
const MAX_SIGMA_PX: f64 = 0.7;
/// A shift so large is no shift of the limb.
const MAX_SHIFT_PX: f64 = 3.0;
/// Fewest pixels that tell a noise.
const MIN_PIXELS: f32 = 10.0;

/// What a look at the limb teaches beside its points.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Appearance {
    pub profile: Profile,
    noise: Noise,
    light: Tilt,
}

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
        let mut edge = Edge::new(&band, profile, shift_px, self.saturation_dn(), noise);
        let mut sectors = vec![Sector::default(); self.sectors];
        let mut unexplained = vec![0.0; band.dn.len()];
        edge.weigh(&Slack {
            light: TILT,
            shift_px: FIRST_SHIFT_PX,
        });
        edge.sum(&mut sectors, &mut unexplained);
        for sector in &mut sectors {
            let rough = sector.solve(0.0);
            *sector = Sector::expecting(
                rough.map_or(0.0, |found| found.excess_light),
                rough.map_or(0.0, |found| found.px),
            );
        }
        edge.weigh(&Slack {
            light: UNEVEN,
            shift_px: LATER_SHIFT_PX,
        });
        edge.sum(&mut sectors, &mut unexplained);
        Some(self.look(&edge, &sectors, &unexplained))
    }

    /// The limb about an outline that is nearly right, as it appeared before.
    pub(super) fn look_again(&self, before: &Appearance) -> Look {
        let band = self.band(before.profile.blur_px);
        let profile = before.profile;
        let mut edge = Edge::new(&band, profile, 0.0, self.saturation_dn(), before.noise);
        let expected = |n| {
            let light = before.light.at(middle_of_sector(n, self.sectors));
            Sector::expecting(light, 0.0)
        };
        let mut sectors: Vec<Sector> = (0..self.sectors).map(expected).collect();
        let mut unexplained = vec![0.0; band.dn.len()];
        edge.weigh(&Slack {
            light: UNEVEN,
            shift_px: LATER_SHIFT_PX,
        });
        edge.sum(&mut sectors, &mut unexplained);
        self.look(&edge, &sectors, &unexplained)
    }

    fn look(&self, edge: &Edge<'_>, sectors: &[Sector], unexplained: &[f32]) -> Look {
        let shifts: Vec<Option<Shift>> = sectors
            .iter()
            .map(|sector| sector.solve(UNEVEN.powi(-2)))
            .collect();
        let directions = |n: usize| middle_of_sector(n, self.sectors);
        let found = || {
            let found = shifts.iter().enumerate();
            found.filter_map(|(n, shift)| Some((directions(n), shift.as_ref()?)))
        };
        let point = |(w, shift): (Vector2<f64>, &Shift)| LimbPoint {
            at: (self.outline.from_disc(w) + self.outline.normal(w) * (shift.px + edge.shift_px))
                .into(),
            sigma_px: shift.sigma_px,
        };
        Look {
            points: found().map(point).collect(),
            appearance: Appearance {
                profile: edge.profile,
                noise: edge.noise(unexplained),
                light: Tilt::of(found().map(|(w, shift)| (w, shift.excess_light))),
            },
        }
    }
}

/// Noise of a pixel, 1 sigma, on both sides of the limb.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Noise {
    outside_dn: f64,
    inside_dn: f64,
}

/// Light over the profile's, less 1, as it changes across the disc.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Tilt {
    mean: f64,
    slope: Vector2<f64>,
}

impl Tilt {
    /// By least squares, twice: the second time without what is far from the first.
    fn of(seen: impl Iterator<Item = (Vector2<f64>, f64)> + Clone) -> Self {
        let mut tilt = Self {
            mean: 0.0,
            slope: Vector2::zeros(),
        };
        for limit in [4.0 * TILT, 2.0 * TILT] {
            // A little information of none at all, for what a short arc does not tell.
            let mut matrix = Matrix3::identity();
            let mut right = Vector3::zeros();
            for (w, excess) in seen.clone() {
                let left = excess - tilt.at(w);
                if left.abs() < limit {
                    let row = Vector3::new(1.0, w.x, w.y);
                    matrix += row * row.transpose();
                    right += row * excess;
                }
            }
            let Some(fit) = matrix.cholesky().map(|root| root.solve(&right)) else {
                break;
            };
            tilt.mean = fit.x;
            tilt.slope = Vector2::new(fit.y, fit.z);
        }
        tilt
    }

    fn at(&self, direction: Vector2<f64>) -> f64 {
        self.mean + self.slope.dot(&direction)
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
    /// Where the profile is brighter, pixels saturate.
    clipped_dn: f64,
}

/// What is expected at a distance.
#[derive(Clone, Copy)]
struct Expected {
    /// Slope outwards, light above the background, brightness, nothing.
    here: [f32; 4],
    /// What leads from there to the next entry.
    step: [f32; 4],
    /// One over the variance; 0 where pixels saturate.
    weight: f32,
    /// One over the square of what is out of the question.
    per_limit2: f32,
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
    ) -> Self {
        let reach = &band.reach;
        let first_px = -reach.inside_px - MARGIN_PX;
        let count = ((reach.outside_px + MARGIN_PX - first_px) * PER_PX) as usize + 2;
        let at = |n: usize| {
            let distance_px = first_px + n as f64 / PER_PX - shift_px;
            let (dn, slope) = profile.both(distance_px);
            [slope, dn - profile.background_dn, dn, 0.0].map(|v| v as f32)
        };
        let values: Vec<[f32; 4]> = (0..=count).map(at).collect();
        let entry = |pair: &[[f32; 4]]| Expected {
            here: pair[0],
            step: std::array::from_fn(|k| pair[1][k] - pair[0][k]),
            weight: 0.0,
            per_limit2: 0.0,
        };
        Self {
            band,
            profile,
            shift_px,
            noise,
            table: values.windows(2).map(entry).collect(),
            first_px,
            clipped_dn: saturation_dn - 2.0 * noise.outside_dn,
        }
    }

    /// Sets the weights by the noise, and what is out of the question by the slack.
    fn weigh(&mut self, slack: &Slack) {
        let peak = self.table.first().map_or(1.0, |e| e.here[1].max(1.0));
        let (outside2, inside2) = (
            self.noise.outside_dn.powi(2) as f32,
            self.noise.inside_dn.powi(2) as f32,
        );
        let (light2, shift2) = (slack.light.powi(2) as f32, slack.shift_px.powi(2) as f32);
        for entry in &mut self.table {
            let [slope, light, dn, _] = entry.here;
            let share = (light / peak).clamp(0.0, 1.0);
            let variance = outside2 + (inside2 - outside2) * share;
            let spread2 = variance + light2 * light * light + shift2 * slope * slope;
            entry.per_limit2 = 1.0 / (spread2 * (TUKEY_SIGMAS * TUKEY_SIGMAS) as f32);
            entry.weight = if f64::from(dn) > self.clipped_dn {
                0.0
            } else {
                1.0 / variance
            };
        }
    }

    /// Adds every pixel to its sector's normal equations, and notes what the sector's expectation does not explain.
    fn sum(&self, sectors: &mut [Sector], unexplained: &mut [f32]) {
        let band = self.band;
        let pixels = Pixels {
            distance_px: &band.distance_px,
            dn: &band.dn,
            sector: &band.sector,
        };
        sum_pixels(
            &pixels,
            &self.table,
            self.first_px as f32,
            sectors,
            unexplained,
        );
    }

    /// The pixels' noise from what is left unexplained well away from the limb.
    fn noise(&self, unexplained: &[f32]) -> Noise {
        let clear = (3.0 * self.profile.blur_px) as f32;
        let limb = self.shift_px as f32;
        let distance_px = &self.band.distance_px;
        let within = |from: f32, to: f32, start: f64| {
            clipped_sigma(
                &left_between(distance_px, unexplained, from, to),
                start as f32,
            )
        };
        let outside = within(limb + clear, f32::INFINITY, self.noise.outside_dn);
        let inside = within(f32::NEG_INFINITY, limb - clear, self.noise.inside_dn);
        Noise {
            outside_dn: outside.unwrap_or(self.noise.outside_dn),
            inside_dn: inside.unwrap_or(self.noise.inside_dn),
        }
    }
}

struct Pixels<'a> {
    distance_px: &'a [f32],
    dn: &'a [f32],
    sector: &'a [u16],
}

#[multiversion(targets("x86_64+avx2"))]
fn sum_pixels(
    pixels: &Pixels<'_>,
    table: &[Expected],
    first_px: f32,
    sectors: &mut [Sector],
    unexplained: &mut [f32],
) {
    let count = unexplained.len();
    let (distance_px, dn) = (&pixels.distance_px[..count], &pixels.dn[..count]);
    let of_sector = &pixels.sector[..count];
    let last = (table.len() - 1) as f32;
    for n in 0..count {
        let along = ((distance_px[n] - first_px) * PER_PX as f32).clamp(0.0, last);
        let entry = along as i32;
        let part = along - entry as f32;
        let expected = &table[entry as usize];
        let mut item: [f32; 4] =
            std::array::from_fn(|k| expected.here[k] + part * expected.step[k]);
        let residual = dn[n] - item[2];
        item[2] = residual;
        let sector = &mut sectors[usize::from(of_sector[n])];
        let left = residual - (sector.light * item[1] - sector.shift_px * item[0]);
        unexplained[n] = if expected.weight > 0.0 {
            left
        } else {
            HIDDEN_DN
        };
        let within = (1.0 - left * left * expected.per_limit2).max(0.0);
        let weight = within * within * expected.weight;
        let (by_slope, by_light) = (weight * item[0], weight * item[1]);
        for k in 0..4 {
            sector.by_slope[k] += by_slope * item[k];
            sector.by_light[k] += by_light * item[k];
        }
    }
}

/// What is left of every second pixel between two distances: enough to tell a noise.
fn left_between(distance_px: &[f32], left: &[f32], from_px: f32, to_px: f32) -> Vec<f32> {
    let pairs = distance_px.iter().zip(left).step_by(2);
    let within = pairs.filter(|(distance, _)| **distance > from_px && **distance < to_px);
    within.map(|(_, left)| *left).collect()
}

/// 1 sigma of what is left, from what lies within three of it: in rounds, since the limit rests on the result. `None` of
/// too few.
#[multiversion(targets("x86_64+avx2"))]
fn clipped_sigma(left: &[f32], start: f32) -> Option<f64> {
    /// What the normal distribution keeps of its sigma within three of it.
    const KEPT: f32 = 0.9866;
    const ROUNDS: usize = 4;
    /// The start may be of another part of the picture.
    const FIRST_LIMIT: f32 = 5.0;
    const LANES: usize = 8;
    let mut limit = FIRST_LIMIT * start;
    let mut sigma = None;
    for _ in 0..ROUNDS {
        let limit2 = limit * limit;
        let (mut counts, mut squares) = ([0.0_f32; LANES], [0.0_f32; LANES]);
        for left in left.chunks_exact(LANES) {
            for k in 0..LANES {
                let square = left[k] * left[k];
                counts[k] += if square < limit2 { 1.0 } else { 0.0 };
                squares[k] += if square < limit2 { square } else { 0.0 };
            }
        }
        let count: f32 = counts.iter().sum();
        if count < MIN_PIXELS {
            return None;
        }
        let found = (squares.iter().sum::<f32>() / count).sqrt() / KEPT;
        let found = found.max(ROUNDING_NOISE_DN as f32);
        sigma = Some(f64::from(found));
        limit = 3.0 * found;
    }
    sigma
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

/// One sector: what is expected of it, and its normal equations for shift and excess light.
#[derive(Clone, Copy, Default)]
struct Sector {
    light: f32,
    shift_px: f32,
    /// Products of slope, and of light, with slope, light and residual.
    by_slope: [f32; 4],
    by_light: [f32; 4],
}

impl Sector {
    fn expecting(light: f64, shift_px: f64) -> Self {
        Self {
            light: light as f32,
            shift_px: shift_px as f32,
            ..Self::default()
        }
    }

    /// The fit, with some information that the light is the expected one.
    fn solve(&self, information: f64) -> Option<Shift> {
        let [slope2, slope_light, slope_residual, _] = self.by_slope.map(f64::from);
        let [_, light2, light_residual, _] = self.by_light.map(f64::from);
        let normal = Matrix2::new(slope2, -slope_light, -slope_light, light2 + information);
        let inverse = normal.try_inverse()?;
        let light_residual = light_residual + information * f64::from(self.light);
        let fit = inverse * Vector2::new(-slope_residual, light_residual);
        let sigma_px = inverse.m11.max(0.0).sqrt();
        (sigma_px < MAX_SIGMA_PX && fit.x.abs() < MAX_SHIFT_PX).then_some(Shift {
            px: fit.x,
            sigma_px,
            excess_light: fit.y,
        })
    }
}
