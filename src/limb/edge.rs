//! Points of the limb: at every azimuth the edge's profile is fitted to the pixels about it.
//!
//! # Method
//! The pixels within a band about a first outline, but for those that marks hide, are sorted by distance from it and by
//! sector. The medians at each distance, taken all round, give the [`Profile`]. In each sector the profile is then
//! shifted and scaled to the pixels by linear least squares, with Tukey's weights against hot pixels and scratches: the
//! shift is the limb's distance from the first outline, the scale takes up what tilts the light across the disc.
//!
//! All pixels of the limb serve, so a point is as good as their noise allows (Cramer-Rao) but for a tenth that the
//! scale costs.

use super::outline::TUKEY_SIGMAS;
use super::profile::{Brightness, Profile};
use crate::frame::{Frame, Levels, ROUNDING_NOISE_DN, Region, Sample, View};
use crate::geometry::Ellipse;
use crate::units::SensorPx;
use crate::with_view;
use nalgebra::{Matrix2, Vector2};

/// A point of the limb.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LimbPoint {
    pub at: SensorPx,
    /// 1 sigma across the limb, from the pixels' noise.
    pub sigma_px: f64,
}

/// Pixels that show no bare limb: marks lie on them.
#[derive(Debug, Clone, PartialEq)]
pub struct Hidden {
    region: Region,
    covered: Vec<bool>,
}

impl Hidden {
    /// Nothing hidden, in a region.
    pub fn nothing(region: Region) -> Self {
        let covered = vec![false; region.width() * region.height()];
        Self { region, covered }
    }

    /// Hides those of the pixels within `reach` px of a position that `covers` holds for.
    pub fn hide(&mut self, at: SensorPx, reach: f64, covers: impl Fn(SensorPx) -> bool) {
        let r = self.region;
        let Some(near) = Region::around(at, reach, r.x1, r.y1) else {
            return;
        };
        for y in near.y0.max(r.y0)..near.y1 {
            for x in near.x0.max(r.x0)..near.x1 {
                if covers(SensorPx::new(x as f64, y as f64)) {
                    self.covered[(y - r.y0) * r.width() + x - r.x0] = true;
                }
            }
        }
    }

    /// Whether a pixel is hidden; outside the region none is.
    pub fn covers(&self, x: usize, y: usize) -> bool {
        let r = self.region;
        (r.x0..r.x1).contains(&x)
            && (r.y0..r.y1).contains(&y)
            && self.covered[(y - r.y0) * r.width() + x - r.x0]
    }
}

/// The band about the first outline that is looked at, in blurs and at least so many px.
const BAND_INSIDE: (f64, f64) = (5.0, 10.0);
const BAND_OUTSIDE: (f64, f64) = (4.0, 6.0);
/// Distances that share a median, px.
const STEP_PX: f64 = 0.25;
/// Fewest pixels that make a median, and a point.
const MIN_PIXELS: usize = 10;
/// How far the light at one azimuth may be from the mean of all, before its own scale is known.
const TILT: f64 = 0.04;
/// A point so uncertain tells nothing.
const MAX_SIGMA_PX: f64 = 0.7;
/// A shift so large is no shift of the limb.
const MAX_SHIFT_PX: f64 = 3.0;

/// Points of the limb about a first outline, in `sectors` sectors, and the profile that they show.
pub fn limb_points(
    frame: &Frame,
    outline: &Ellipse,
    start: &Profile,
    levels: &Levels,
    hidden: &Hidden,
    sectors: usize,
) -> Option<(Vec<LimbPoint>, Profile)> {
    let saturation_dn = f64::from(frame.saturation_dn());
    let band = with_view!(frame, view => {
        Band::collect(&view, outline, start.blur_px, hidden, sectors)
    });
    let noise = Noise {
        outside_dn: levels.noise_dn,
        inside_dn: levels.noise_dn,
    };
    let (profile, shift_px) = start.fitted(&band.medians(saturation_dn), levels.noise_dn)?;
    let edge = Edge {
        profile,
        shift_px,
        table: profile_table(&profile, shift_px, &band),
        first_px: -band.inside_px,
        clipped_dn: saturation_dn - 2.0 * levels.noise_dn,
    };
    let rough = edge.fit_sectors(&band, &noise, None);
    let noise = edge.noise(&band, &rough);
    let shifts = edge.fit_sectors(&band, &noise, Some(&rough));
    let points = shifts.iter().filter_map(|shift| {
        let shift = shift.as_ref()?;
        let w = shift.direction.normalize();
        let at = outline.from_disc(w) + outline.normal(w) * (shift.px + shift_px);
        Some(LimbPoint {
            at: at.into(),
            sigma_px: shift.sigma_px,
        })
    });
    Some((points.collect(), profile))
}

/// The pixels about an outline.
struct Band {
    inside_px: f64,
    outside_px: f64,
    sectors: usize,
    pixels: Vec<EdgePixel>,
}

#[derive(Clone, Copy)]
struct EdgePixel {
    distance_px: f32,
    dn: f32,
    /// Position in disc units: its direction matters.
    w: [f32; 2],
    sector: u16,
}

impl Band {
    fn collect<T: Sample>(
        view: &View<'_, T>,
        outline: &Ellipse,
        blur_px: f64,
        hidden: &Hidden,
        sectors: usize,
    ) -> Self {
        let reach = |(blurs, least): (f64, f64)| (blurs * blur_px).max(least);
        let (inside_px, outside_px) = (reach(BAND_INSIDE), reach(BAND_OUTSIDE));
        let mut band = Self {
            inside_px,
            outside_px,
            sectors,
            pixels: Vec::with_capacity(8192),
        };
        let radius = outline.mean_radius();
        // An ellipse's half axes differ from the mean by less than this.
        let spare = 0.02 * radius + 1.0;
        let (least, most) = (
            (radius - inside_px - spare).max(0.0),
            radius + outside_px + spare,
        );
        let rows = span(outline.centre.y, most, view.height);
        for y in rows {
            let dy = y as f64 - outline.centre.y;
            let half = |r: f64| (r * r - dy * dy).max(0.0).sqrt();
            let (hole, end) = (half(least), half(most));
            let c = outline.centre.x;
            for (from, to) in [(c - end, c - hole), (c + hole, c + end)] {
                let first = from.ceil().clamp(0.0, view.width as f64) as usize;
                let last = (to.floor() + 1.0).clamp(0.0, view.width as f64) as usize;
                for x in first..last {
                    band.take(view, outline, hidden, x, y);
                }
            }
        }
        band
    }

    fn take<T: Sample>(
        &mut self,
        view: &View<'_, T>,
        outline: &Ellipse,
        hidden: &Hidden,
        x: usize,
        y: usize,
    ) {
        let at = Vector2::new(x as f64, y as f64);
        let distance = outline.excess(at);
        if distance < -self.inside_px || distance > self.outside_px || hidden.covers(x, y) {
            return;
        }
        let w = outline.to_disc(at);
        self.pixels.push(EdgePixel {
            distance_px: distance as f32,
            dn: view.dn(x, y),
            w: [w.x as f32, w.y as f32],
            sector: (turn(w) * self.sectors as f64) as u16,
        });
    }

    /// The typical brightness at each distance. Where the disc saturates it says nothing.
    fn medians(&self, saturation_dn: f64) -> Vec<Brightness> {
        let count = ((self.inside_px + self.outside_px) / STEP_PX).ceil() as usize + 1;
        let mut bins: Vec<Vec<f32>> = vec![Vec::new(); count];
        let bin = |d: f32| ((f64::from(d) + self.inside_px) / STEP_PX) as usize;
        for pixel in &self.pixels {
            bins[bin(pixel.distance_px).min(count - 1)].push(pixel.dn);
        }
        let middle = |n: usize| (n as f64 + 0.5) * STEP_PX - self.inside_px;
        let typical = bins.iter_mut().enumerate().filter_map(|(n, values)| {
            (values.len() >= MIN_PIXELS).then(|| Brightness {
                distance_px: middle(n),
                dn: median(values),
                // A median is worth 64 % of a mean.
                weight: 0.64 * values.len() as f64,
            })
        });
        typical.filter(|b| b.dn < saturation_dn - 1.0).collect()
    }
}

/// Rows or columns within a reach of a place, as far as there are pixels.
fn span(middle: f64, reach: f64, pixels: usize) -> std::ops::Range<usize> {
    let first = (middle - reach).ceil().clamp(0.0, pixels as f64) as usize;
    let end = ((middle + reach).floor() + 1.0).clamp(0.0, pixels as f64) as usize;
    first..end.max(first)
}

/// A direction as a number from 0 to 1 that grows with its angle; cheaper than the angle.
fn turn(w: Vector2<f64>) -> f64 {
    let along = w.y / (w.x.abs() + w.y.abs()).max(1e-12);
    let quarters = if w.x >= 0.0 { 1.0 + along } else { 3.0 - along };
    (quarters / 4.0).clamp(0.0, 1.0 - 1e-9)
}

fn median(values: &mut [f32]) -> f64 {
    let middle = values.len() / 2;
    f64::from(*values.select_nth_unstable_by(middle, f32::total_cmp).1)
}

/// Noise of a pixel, 1 sigma, on both sides of the limb.
#[derive(Clone, Copy)]
struct Noise {
    outside_dn: f64,
    inside_dn: f64,
}

/// The profile laid about the first outline.
struct Edge {
    profile: Profile,
    shift_px: f64,
    /// Brightness above the background, and slope outwards, by distance.
    table: Vec<(f32, f32)>,
    first_px: f64,
    /// Where the profile is brighter, pixels saturate.
    clipped_dn: f64,
}

const PER_PX: f64 = 16.0;

fn profile_table(profile: &Profile, shift_px: f64, band: &Band) -> Vec<(f32, f32)> {
    let count = ((band.inside_px + band.outside_px) * PER_PX) as usize + 2;
    let distance = |n: usize| n as f64 / PER_PX - band.inside_px - shift_px;
    (0..count)
        .map(|n| {
            let light = profile.at(distance(n)) - profile.background_dn;
            (light as f32, profile.slope(distance(n)) as f32)
        })
        .collect()
}

/// How the limb stands in one sector.
#[derive(Clone, Copy)]
struct SectorShift {
    /// Outwards from the shifted profile.
    px: f64,
    sigma_px: f64,
    /// Light over the profile's, less 1.
    excess_light: f64,
    direction: Vector2<f64>,
}

impl Edge {
    /// Light above background and slope at a distance from the first outline.
    fn at(&self, distance_px: f32) -> (f32, f32) {
        let place = (distance_px - self.first_px as f32) * PER_PX as f32;
        let n = (place as usize).min(self.table.len() - 2);
        let part = place - n as f32;
        let (a, b) = (self.table[n], self.table[n + 1]);
        (a.0 + (b.0 - a.0) * part, a.1 + (b.1 - a.1) * part)
    }

    /// Fits every sector. With `rough` shifts known, weights follow from what these leave; without, from the profile,
    /// and the light may differ.
    fn fit_sectors(
        &self,
        band: &Band,
        noise: &Noise,
        rough: Option<&[Option<SectorShift>]>,
    ) -> Vec<Option<SectorShift>> {
        let mut sums = vec![SectorSums::default(); band.sectors];
        let background = self.profile.background_dn as f32;
        let peak = self.at(self.first_px as f32).0.max(1.0);
        let (outside2, inside2) = (noise.outside_dn.powi(2), noise.inside_dn.powi(2));
        for pixel in &band.pixels {
            let (light, slope) = self.at(pixel.distance_px);
            if f64::from(light + background) > self.clipped_dn {
                continue;
            }
            let residual = pixel.dn - background - light;
            let share = f64::from(light / peak).clamp(0.0, 1.0);
            let variance = (outside2 + (inside2 - outside2) * share) as f32;
            let (left, spread2) = match rough.and_then(|r| r[pixel.sector as usize]) {
                Some(s) => {
                    let explained = s.excess_light as f32 * light - s.px as f32 * slope;
                    (residual - explained, variance)
                }
                None => (residual, variance + (TILT as f32 * light).powi(2)),
            };
            let u2 = left * left / (spread2 * (TUKEY_SIGMAS * TUKEY_SIGMAS) as f32);
            if u2 < 1.0 {
                let weight = (1.0 - u2) * (1.0 - u2) / variance;
                sums[pixel.sector as usize].add(pixel, light, slope, residual, weight);
            }
        }
        sums.iter().map(SectorSums::solve).collect()
    }

    /// The pixels' noise from what the sectors' fits leave.
    fn noise(&self, band: &Band, fits: &[Option<SectorShift>]) -> Noise {
        let (mut outside, mut inside) = (Vec::new(), Vec::new());
        let background = self.profile.background_dn as f32;
        let clear = 3.0 * self.profile.blur_px as f32;
        for pixel in &band.pixels {
            let Some(fit) = fits[pixel.sector as usize] else {
                continue;
            };
            let from_limb = pixel.distance_px - self.shift_px as f32;
            let (light, slope) = self.at(pixel.distance_px);
            if f64::from(light + background) > self.clipped_dn {
                continue;
            }
            let explained = light * (1.0 + fit.excess_light as f32) - slope * fit.px as f32;
            let left = (pixel.dn - background - explained).abs();
            if from_limb > clear {
                outside.push(left);
            } else if from_limb < -clear {
                inside.push(left);
            }
        }
        let (outside, inside) = (clipped_sigma(&mut outside), clipped_sigma(&mut inside));
        let either = outside.or(inside).unwrap_or(1.0);
        Noise {
            outside_dn: outside.unwrap_or(either),
            inside_dn: inside.unwrap_or(either),
        }
    }
}

/// 1 sigma of residuals from those within three of it, which the median of all tells first: alone it would be coarse where
/// pixels hold few whole numbers.
fn clipped_sigma(sizes: &mut [f32]) -> Option<f64> {
    /// What the normal distribution keeps of its sigma within three of it.
    const KEPT: f64 = 0.9866;
    if sizes.len() < MIN_PIXELS {
        return None;
    }
    let most = (3.0 * 1.4826 * median(sizes).max(ROUNDING_NOISE_DN)) as f32;
    let kept = sizes.iter().filter(|size| **size < most);
    let (count, squares) = kept.fold((0_usize, 0.0), |(count, squares), size| {
        (count + 1, squares + f64::from(size * size))
    });
    let sigma = (squares / count.max(1) as f64).sqrt() / KEPT;
    Some(sigma.max(ROUNDING_NOISE_DN))
}

/// Normal equations of one sector for its shift and its excess light.
#[derive(Clone, Copy, Default)]
struct SectorSums {
    count: usize,
    slope2: f64,
    slope_light: f64,
    light2: f64,
    slope_residual: f64,
    light_residual: f64,
    direction: [f64; 2],
}

impl SectorSums {
    fn add(&mut self, pixel: &EdgePixel, light: f32, slope: f32, residual: f32, weight: f32) {
        let (ws, wl) = (f64::from(weight * slope), f64::from(weight * light));
        let slope2 = ws * f64::from(slope);
        self.count += 1;
        self.slope2 += slope2;
        self.slope_light += ws * f64::from(light);
        self.light2 += wl * f64::from(light);
        self.slope_residual += ws * f64::from(residual);
        self.light_residual += wl * f64::from(residual);
        self.direction[0] += slope2 * f64::from(pixel.w[0]);
        self.direction[1] += slope2 * f64::from(pixel.w[1]);
    }

    fn solve(&self) -> Option<SectorShift> {
        if self.count < MIN_PIXELS {
            return None;
        }
        let normal = Matrix2::new(
            self.slope2,
            -self.slope_light,
            -self.slope_light,
            self.light2,
        );
        let inverse = normal.try_inverse()?;
        let fit = inverse * Vector2::new(-self.slope_residual, self.light_residual);
        let sigma_px = inverse.m11.max(0.0).sqrt();
        let direction = Vector2::from(self.direction);
        (sigma_px < MAX_SIGMA_PX && fit.x.abs() < MAX_SHIFT_PX && direction.norm() > 0.0).then_some(
            SectorShift {
                px: fit.x,
                sigma_px,
                excess_light: fit.y,
                direction,
            },
        )
    }
}
