//! The limb's light across its edge, and from it the edge to a part of a pixel.
//!
//! The edge is where the limb has half of its brightness above the dark sky. Brightness varies along the limb, and clouds lie beside
//! it, so that half is found in two steps: the frame's mean profile tells where half is, and each place is held against that profile
//! where no cloud reaches, with a darkness, a brightness and a shift of its own.

use super::edge::EdgePoint;
use super::sphere::{Cone, Sphere};
use crate::estimation::median;
use crate::frame::{Region, Sample, View};
use crate::geometry::camera::Camera;
use crate::units::{Measured, SensorPx};
use nalgebra::{Matrix3, UnitVector3, Vector2, Vector3};
use std::f64::consts::TAU;
use std::ops::Range;

/// Distance of places along the edge; many overlap what noise leaves to tell.
const SPACING_PX: f64 = 12.0;
const LEAST_PLACES: usize = 96;
const MOST_PLACES: usize = 960;
/// Samples of a profile to each side of the edge.
const LEAST_SAMPLES: usize = 6;
const MOST_SAMPLES: usize = 48;
/// The outer part of a profile shows the dark sky.
const SKY_SHARE: f64 = 0.15;
/// Of the mean profile's brightness: clouds may show where it is brighter. They raise that brightness, too, and blur reaches above them.
const CLOUDLESS: f64 = 0.7;
/// Over a pixel's noise: a profile that fits less well has clouds in it.
const CLOUDED: f64 = 1.25;
const CLOUDED_SHARE: f64 = 0.05;
/// Profiles and their mean are found in so many rounds.
const ROUNDS: usize = 2;
/// Places that are averaged, and the share of them that has no cloud, where the limb's brightness is read.
const AVERAGED_PLACES: usize = 5;
/// Less, and the places that a flare or the Sun spoils would count.
const CLOUDLESS_SHARE: f64 = 0.1;
/// By so many sigmas noise makes the last of these places darker (normal distribution).
const CLOUDLESS_SIGMAS: f64 = 1.282;
/// 1 sigma of the usual blur of lens, pixels and interpolation.
const BLUR_PX: f64 = 0.9;
/// What blur takes from the limb's peak is known to this share of it.
const BLUR_SIGMA: f64 = 0.5;
/// The limb's brightness is known to this share of it.
const BRIGHTNESS_SIGMA: f64 = 0.005;
/// The darkest places may have clouds, too: 1 sigma, over what the middle one is brighter.
const CLOUDS_LEFT: f64 = 0.6;
/// Of the limb's brightness: light beyond the profile. More is glare.
const MOST_BEYOND: f64 = 0.04;
/// Noise of the light between four pixels over that of one, on average.
const INTERPOLATED_NOISE: f64 = 2.0 / 3.0;
/// A place whose shift is known less well shows no edge.
const MOST_SIGMA_STEPS: f64 = 2.0;
/// A limb may be so much darker than the middle one, as it is near the terminator.
const LEAST_BRIGHTNESS: f64 = 0.15;

/// A place of the edge: where the picture shows what lies some steps outside of it, c0 + c1 t + c2 t^2, px.
#[derive(Debug, Clone, Copy)]
struct Place {
    path: [Vector2<f64>; 3],
}

impl Place {
    fn at(&self, steps: f64) -> SensorPx {
        let [c0, c1, c2] = self.path;
        (c0 + (c1 + c2 * steps) * steps).into()
    }

    fn point(&self, steps: f64, sigma_steps: f64) -> EdgePoint {
        let per_step = self.path[1] + self.path[2] * (2.0 * steps);
        EdgePoint {
            at: self.at(steps),
            inward: -per_step.normalize(),
            sigma_px: sigma_steps * per_step.norm(),
        }
    }
}

/// The edge as the profiles show it.
pub(super) struct Edge {
    pub points: Vec<EdgePoint>,
    /// How well it is known where the edge has half of the limb's brightness, all around alike.
    pub sigma_rad: f64,
    /// Share of the places with clouds.
    pub clouded: f64,
}

/// Profiles of light across the edge of a cone at places along it, DN, from the inside outwards.
pub(super) struct Profiles {
    places: Vec<Place>,
    /// Those of the first place, then the next.
    light_dn: Vec<f32>,
    /// Samples of each, and which of them lies on the edge.
    length: usize,
    edge: usize,
    step_rad: f64,
    step_px: f64,
}

/// Where to look across the edge.
#[derive(Debug, Clone, Copy)]
struct Steps {
    step_rad: f64,
    inside: usize,
    outside: usize,
}

impl Steps {
    fn of(sphere: &Sphere, camera: &Camera) -> Self {
        let reach = sphere.inside_rad.max(sphere.outside_rad);
        let step_rad = (1.0 / camera.mean_focal_px()).max(reach / MOST_SAMPLES as f64);
        let samples = |reach_rad: f64| ((reach_rad / step_rad) as usize).max(LEAST_SAMPLES);
        Self {
            step_rad,
            inside: samples(sphere.inside_rad),
            outside: samples(sphere.outside_rad),
        }
    }
}

impl Profiles {
    /// Profiles at all places of a cone's edge that are in view with their whole profile, and not masked.
    pub fn of<T: Sample>(
        view: &View<'_, T>,
        mask: &[Region],
        camera: &Camera,
        sphere: &Sphere,
        nadir: &UnitVector3<f64>,
    ) -> Self {
        let steps = Steps::of(sphere, camera);
        let length = steps.inside + 1 + steps.outside;
        let around = TAU * camera.mean_focal_px() * sphere.half_angle_rad.value.sin();
        let count = ((around / SPACING_PX) as usize).clamp(LEAST_PLACES, MOST_PLACES);
        let cone = Cone::new(sphere, nadir);
        let is_seen = |at: SensorPx| is_inside(view, mask, at);
        let around_rad = |n: usize| TAU * n as f64 / count as f64;
        let places: Vec<Place> = (0..count)
            .filter_map(|n| place(&cone, camera, &steps, around_rad(n), is_seen))
            .collect();
        let mut light_dn = Vec::with_capacity(places.len() * length);
        for place in &places {
            let from_edge = |n: usize| n as f64 - steps.inside as f64;
            light_dn.extend((0..length).map(|n| interpolated(view, place.at(from_edge(n)))));
        }
        Self {
            places,
            light_dn,
            length,
            edge: steps.inside,
            step_rad: steps.step_rad,
            step_px: steps.step_rad * camera.mean_focal_px(),
        }
    }

    /// Places that are in view.
    pub fn len(&self) -> usize {
        self.places.len()
    }

    fn light(&self) -> impl Iterator<Item = &[f32]> {
        self.light_dn.chunks_exact(self.length)
    }

    /// The samples that show the sky.
    fn sky(&self) -> Range<usize> {
        let outside = self.length - self.edge;
        let sky = ((outside as f64 * SKY_SHARE) as usize).max(2);
        self.length - sky..self.length
    }

    /// Where each profile falls through the middle of its own light: the edge as it is where nothing is known of the profile.
    pub fn crossings(&self, least_contrast_dn: f64) -> Vec<EdgePoint> {
        const SIGMA_STEPS: f64 = 1.0;
        let crossing = |(place, light): (&Place, &[f32])| {
            let dark = mean(&light[self.sky()]);
            let bright = f64::from(light.iter().copied().fold(f32::MIN, f32::max));
            if bright - dark < least_contrast_dn {
                return None;
            }
            let steps = falls_through(light, (dark + bright) / 2.0)? - self.edge as f64;
            Some(place.point(steps, SIGMA_STEPS))
        };
        self.places
            .iter()
            .zip(self.light())
            .filter_map(crossing)
            .collect()
    }

    /// The edge at every place that shows one, given what a pixel of the sky far from the limb holds, if any is in view. `None` where the
    /// profiles show no limb.
    pub fn edge(
        &self,
        least_contrast_dn: f64,
        noise_dn: f64,
        far_sky_dn: Option<f64>,
    ) -> Option<Edge> {
        let mut limbs: Vec<Limb> = self.light().map(|light| self.seen(light)).collect();
        let (mut mean, mut clouded) = (Vec::new(), 0.0);
        for _ in 0..ROUNDS {
            mean = self.mean_profile(&limbs, least_contrast_dn);
            let fits = LimbFits::new(&mean, self.edge, noise_dn)?;
            (limbs, clouded) = fits.limbs(self);
        }
        let half = self.half_brightness(&limbs, &mean, noise_dn, far_sky_dn)?;
        let brightness = median(limbs.iter().map(|limb| limb.brightness_dn))?;
        let least = least_contrast_dn.max(LEAST_BRIGHTNESS * brightness);
        let shows_edge =
            |limb: &Limb| limb.brightness_dn > least && limb.shift_sigma_steps < MOST_SIGMA_STEPS;
        let all = self.places.iter().zip(&limbs);
        let points = all
            .filter(|(_, limb)| shows_edge(limb))
            .map(|(place, limb)| {
                let steps = half.value - self.edge as f64 + limb.shift_steps;
                place.point(steps, limb.shift_sigma_steps)
            })
            .collect();
        Some(Edge {
            points,
            sigma_rad: half.sigma * self.step_rad,
            clouded,
        })
    }

    /// The light of a place by the ends of its profile.
    fn seen(&self, light: &[f32]) -> Limb {
        let dark_dn = mean(&light[self.sky()]);
        Limb {
            dark_dn,
            brightness_dn: mean(&light[..=self.edge]) - dark_dn,
            shift_steps: 0.0,
            shift_sigma_steps: 0.0,
        }
    }

    /// The middle of all profiles, each less its darkness and over its brightness. Nothing of no limb.
    fn mean_profile(&self, limbs: &[Limb], least_contrast_dn: f64) -> Vec<f64> {
        let normal = self.normalised(limbs, least_contrast_dn);
        (0..self.length)
            .filter_map(|n| median(normal.iter().map(|profile| profile[n])))
            .collect()
    }

    fn normalised(&self, limbs: &[Limb], least_contrast_dn: f64) -> Vec<Vec<f64>> {
        let bright = limbs.iter().zip(self.light());
        bright
            .filter(|(limb, _)| limb.brightness_dn > least_contrast_dn)
            .map(|(limb, light)| {
                let above_dark = |dn: &f32| (f64::from(*dn) - limb.dark_dn) / limb.brightness_dn;
                light.iter().map(above_dark).collect()
            })
            .collect()
    }

    /// Where the mean profile has half of the limb's brightness above the dark sky, in samples. The brightness is read where no cloud adds to
    /// it: among the darkest of the places, each averaged with its neighbours, and less what noise makes of the darkest.
    fn half_brightness(
        &self,
        limbs: &[Limb],
        mean: &[f64],
        noise_dn: f64,
        far_sky_dn: Option<f64>,
    ) -> Option<Measured> {
        let normal = self.normalised(limbs, 0.0);
        let limb_dn = median(limbs.iter().map(|limb| limb.brightness_dn))?;
        let noise = INTERPOLATED_NOISE * noise_dn / limb_dn / (AVERAGED_PLACES as f64).sqrt();
        let brightest = |share: f64| {
            let at = |n: usize| {
                let averaged = normal.windows(AVERAGED_PLACES.min(normal.len().max(1)));
                let mut averaged: Vec<f64> = averaged
                    .map(|some| {
                        some.iter().map(|profile| profile[n]).sum::<f64>() / some.len() as f64
                    })
                    .collect();
                let place = (averaged.len() as f64 * share) as usize;
                (!averaged.is_empty())
                    .then(|| *averaged.select_nth_unstable_by(place, f64::total_cmp).1)
            };
            (0..=self.edge).filter_map(at).reduce(f64::max)
        };
        let cloudless = brightest(CLOUDLESS_SHARE)? + CLOUDLESS_SIGMAS * noise;
        let clouds = (brightest(0.5)? - cloudless).max(0.0);
        // The limb's light reaches beyond the profile, above all to a balloon, which has some air above itself.
        let sky_dn = median(limbs.iter().map(|limb| limb.dark_dn))?;
        let beyond = far_sky_dn.map_or(0.0, |far_dn| (sky_dn - far_dn) / limb_dn);
        let beyond = beyond.clamp(0.0, MOST_BEYOND);
        let light: Vec<f32> = mean.iter().map(|v| *v as f32).collect();
        let blurred = self.taken_by_blur(mean);
        let half = falls_through(&light, (cloudless + blurred - beyond) / 2.0)?;
        let n = (half as usize).clamp(1, mean.len() - 2);
        let fall = (mean[n - 1] - mean[n + 1]) / 2.0;
        let left = (CLOUDS_LEFT * clouds).hypot(BLUR_SIGMA * blurred);
        Some(Measured::new(
            half,
            left.hypot(BRIGHTNESS_SIGMA) / 2.0 / fall,
        ))
    }

    /// What blur has taken from the peak of a profile: as much, for its variance, as more blur takes again.
    fn taken_by_blur(&self, mean: &[f64]) -> f64 {
        // Of the weights 1/4, 1/2, 1/4, in steps.
        const VARIANCE: f64 = 0.5;
        let inner = 1..=self.edge.min(mean.len().saturating_sub(2));
        let peak = inner.max_by(|a, b| mean[*a].total_cmp(&mean[*b]));
        let taken = |n: usize| mean[n] - (mean[n - 1] + 2.0 * mean[n] + mean[n + 1]) / 4.0;
        let blur_steps = BLUR_PX / self.step_px;
        peak.map_or(0.0, |n| taken(n).max(0.0) * blur_steps.powi(2) / VARIANCE)
    }
}

/// What a place's profile says.
#[derive(Debug, Clone, Copy)]
struct Limb {
    dark_dn: f64,
    /// In units of the mean profile's.
    brightness_dn: f64,
    /// Outwards from the mean profile.
    shift_steps: f64,
    shift_sigma_steps: f64,
}

/// Fits of the mean profile to a place's: to all of it, and to the air above any cloud.
struct LimbFits {
    whole: TemplateFit,
    air: TemplateFit,
    most_scatter_dn: f64,
}

impl LimbFits {
    /// `None` of no limb.
    fn new(mean: &[f64], edge: usize, noise_dn: f64) -> Option<Self> {
        let brightness = mean.get(..=edge)?.iter().copied().reduce(f64::max)?;
        let air = mean.iter().rposition(|v| *v > CLOUDLESS * brightness)?;
        Some(Self {
            whole: TemplateFit::new(mean, 1)?,
            air: TemplateFit::new(mean, air.max(1))?,
            most_scatter_dn: CLOUDED * INTERPOLATED_NOISE * noise_dn,
        })
    }

    /// The limb at each place, and the share of places with clouds. Whole profiles tell the brightness best; where clouds stand in more
    /// than a few, the air alone is fair to all.
    fn limbs(&self, profiles: &Profiles) -> (Vec<Limb>, f64) {
        let whole: Vec<(Limb, f64)> = profiles
            .light()
            .map(|light| self.whole.limb(light))
            .collect();
        let clouded = whole
            .iter()
            .filter(|(_, scatter_dn)| *scatter_dn > self.most_scatter_dn);
        let clouded = clouded.count() as f64 / whole.len() as f64;
        let limbs = match clouded > CLOUDED_SHARE {
            true => profiles
                .light()
                .map(|light| self.air.limb(light).0)
                .collect(),
            false => whole.into_iter().map(|(limb, _)| limb).collect(),
        };
        (limbs, clouded)
    }
}

/// A profile as the mean one with a darkness, a brightness and a small shift: linear least squares.
struct TemplateFit {
    samples: Range<usize>,
    /// 1, the mean profile, and its change by a step outwards, at each sample.
    rows: Vec<Vector3<f64>>,
    inverse: Matrix3<f64>,
}

impl TemplateFit {
    /// By the samples from `first` on. `None` where they do not tell the three.
    fn new(mean: &[f64], first: usize) -> Option<Self> {
        let samples = first..mean.len().checked_sub(1)?;
        let row = |n: usize| Vector3::new(1.0, mean[n], -(mean[n + 1] - mean[n - 1]) / 2.0);
        let rows: Vec<Vector3<f64>> = samples.clone().map(row).collect();
        let normal: Matrix3<f64> = rows.iter().map(|row| row * row.transpose()).sum();
        let inverse = normal.try_inverse()?;
        (rows.len() > 3).then_some(Self {
            samples,
            rows,
            inverse,
        })
    }

    /// The limb, and the rms of what the fit leaves, DN.
    fn limb(&self, light: &[f32]) -> (Limb, f64) {
        let pairs = || self.rows.iter().zip(&light[self.samples.clone()]);
        let gradient: Vector3<f64> = pairs().map(|(row, dn)| row * f64::from(*dn)).sum();
        let found = self.inverse * gradient;
        let squares: f64 = pairs()
            .map(|(row, dn)| (f64::from(*dn) - row.dot(&found)).powi(2))
            .sum();
        let scatter_dn = (squares / (self.rows.len() - 3) as f64).sqrt();
        let brightness_dn = found.y;
        let limb = Limb {
            dark_dn: found.x,
            brightness_dn,
            shift_steps: found.z / brightness_dn,
            shift_sigma_steps: scatter_dn * self.inverse.m33.sqrt() / brightness_dn.abs(),
        };
        (limb, scatter_dn)
    }
}

/// The place of a cone's edge at an angle around the nadir; `None` where the ends or the middle of its profile are not seen.
fn place(
    cone: &Cone<'_>,
    camera: &Camera,
    steps: &Steps,
    around_rad: f64,
    is_seen: impl Fn(SensorPx) -> bool,
) -> Option<Place> {
    let seen = |t: f64| {
        let at = camera.pixel(&cone.ray(around_rad, t * steps.step_rad))?;
        is_seen(at).then(|| at.vector())
    };
    let (low, high) = (-(steps.inside as f64), steps.outside as f64);
    // The parabola through three pixels of the profile. Most places of a wide cone fail with the first.
    let (on, below, above) = (seen(0.0)?, seen(low)?, seen(high)?);
    let (to_low, to_high) = ((below - on) / low, (above - on) / high);
    let curvature = (to_high - to_low) / (high - low);
    Some(Place {
        path: [on, to_low - curvature * low, curvature],
    })
}

/// Whether the picture has all pixels about a position, and none of them is masked.
fn is_inside<T>(view: &View<'_, T>, mask: &[Region], at: SensorPx) -> bool {
    let within = |v: f64, size: usize| (0.0..size as f64 - 1.0).contains(&v);
    within(at.x, view.width)
        && within(at.y, view.height)
        && !mask
            .iter()
            .any(|region| region.contains(at.x.round() as usize, at.y.round() as usize))
}

/// The light between four pixels, DN. The position must be inside the picture.
fn interpolated<T: Sample>(view: &View<'_, T>, at: SensorPx) -> f32 {
    let (x, y) = (at.x as usize, at.y as usize);
    let (fx, fy) = ((at.x - x as f64) as f32, (at.y - y as f64) as f32);
    let along = |row: &[T]| {
        let pair = &row[x..x + 2];
        pair[0].dn() + (pair[1].dn() - pair[0].dn()) * fx
    };
    let (above, below) = (along(view.row(y)), along(view.row(y + 1)));
    above + (below - above) * fy
}

fn mean(light: &[f32]) -> f64 {
    light.iter().map(|dn| f64::from(*dn)).sum::<f64>() / light.len() as f64
}

/// The last place, in samples, where the light falls below a level.
fn falls_through(light: &[f32], level: f64) -> Option<f64> {
    let level = level as f32;
    let n = light
        .windows(2)
        .rposition(|pair| pair[0] >= level && pair[1] < level)?;
    Some(n as f64 + f64::from((light[n] - level) / (light[n] - light[n + 1])))
}
