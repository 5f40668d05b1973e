//! Properties of the limb over all places along an edge.

use super::profile::{INTERPOLATED_NOISE, Profiles};
use super::template::Limb;
use crate::estimation::median;
use crate::kernels::paths::{COLUMNS, column_quantiles};

/// Number of places in an average, and the quantile of the averages, without clouds, from which the limb's brightness is
/// read. With smaller values, places corrupted by a flare or the Sun would count.
const AVERAGED_PLACES: usize = 5;
const CLOUDLESS_SHARE: f64 = 0.1;
/// The brightest place is this quantile of the brightness.
const BRIGHTEST: f64 = 0.9;

/// Brightness levels of a frame, DN.
#[derive(Debug, Clone, Copy)]
pub(super) struct Light {
    /// Minimum brightness of the limb above the sky.
    pub least_dn: f64,
    /// Noise of a pixel, 1 sigma.
    pub noise_dn: f64,
    /// Maximum deviation of a place's profile from the mean one, beyond noise, relative to its brightness.
    pub most_unlike: f64,
    /// Level of a pixel of the sky far from the limb, if any is in view.
    pub far_sky_dn: Option<f64>,
}

/// Whether a place shows the limb as the others do, and not a part of the vehicle.
pub(super) fn is_limb(limb: &Limb, light: &Light) -> bool {
    limb.brightness_dn > light.least_dn && unlike(limb, light.noise_dn) < light.most_unlike
}

/// Residual of a place's profile against the mean one, beyond noise, relative to its brightness.
pub(super) fn unlike(limb: &Limb, noise_dn: f64) -> f64 {
    let noise_dn = INTERPOLATED_NOISE * noise_dn;
    (limb.scatter_dn.powi(2) - noise_dn.powi(2)).max(0.0).sqrt() / limb.brightness_dn
}

/// The first samples of all places that show the limb, each minus its darkness and divided by its brightness. One row per
/// place, padded to whole [`COLUMNS`].
struct Normalised {
    light: Vec<f32>,
    samples: usize,
    stride: usize,
}

impl Normalised {
    fn of(profiles: &Profiles, samples: usize, limbs: &[Limb], light: &Light) -> Self {
        let stride = samples.next_multiple_of(COLUMNS);
        let mut normal = Vec::with_capacity(limbs.len() * stride);
        let places = limbs.iter().zip(profiles.filled_up());
        for (limb, light_dn) in places.filter(|(limb, _)| is_limb(limb, light)) {
            let (dark_dn, per_dn) = (limb.dark_dn as f32, 1.0 / limb.brightness_dn as f32);
            normal.extend(light_dn[..stride].iter().map(|dn| (dn - dark_dn) * per_dn));
        }
        Self {
            light: normal,
            samples,
            stride,
        }
    }

    /// The means of so many successive rows.
    fn running_means(self, rows: usize) -> Self {
        let count = self.light.len().saturating_sub((rows - 1) * self.stride);
        let mut means = self.light[..count].to_vec();
        for row in 1..rows {
            let later = &self.light[row * self.stride..];
            means
                .iter_mut()
                .zip(later)
                .for_each(|(mean, light)| *mean += light);
        }
        let share = 1.0 / rows as f32;
        means.iter_mut().for_each(|mean| *mean *= share);
        Self {
            light: means,
            ..self
        }
    }

    /// The quantile of the rows at each sample. Empty if there are no rows.
    fn quantiles(&self, share: f64) -> Vec<f32> {
        if self.light.is_empty() {
            return Vec::new();
        }
        let below = share * (self.light.len() / self.stride) as f64;
        let mut quantiles = vec![0.0; self.stride];
        column_quantiles(&self.light, self.stride, below as usize, &mut quantiles);
        quantiles.truncate(self.samples);
        quantiles
    }
}

/// The median of all profiles. Empty if there is no limb.
pub(super) fn mean_profile(profiles: &Profiles, limbs: &[Limb], light: &Light) -> Vec<f64> {
    let middle = Normalised::of(profiles, profiles.length, limbs, light).quantiles(0.5);
    middle.into_iter().map(f64::from).collect()
}

/// Common properties of the places of a limb.
pub(super) struct OfPlaces {
    /// Median and highest brightness of the places, DN.
    pub limb_dn: f64,
    pub brightest_dn: f64,
    /// Level beyond the ends of their profiles.
    pub sky_dn: f64,
    /// Number of places in an average.
    pub averaged: usize,
    /// Brightness of the limb at its brightest height, relative to the mean profile's: of the places without clouds, and of
    /// the median place.
    pub cloudless: f64,
    pub middle: f64,
}

impl OfPlaces {
    /// `None` if there is no limb.
    pub fn new(profiles: &Profiles, limbs: &[Limb], light: &Light) -> Option<Self> {
        let alike = || limbs.iter().filter(|limb| is_limb(limb, light));
        let mut bright: Vec<f64> = alike().map(|limb| limb.brightness_dn).collect();
        bright.sort_unstable_by(f64::total_cmp);
        let of_share = |sorted: &[f64], share: f64| {
            let place = (sorted.len() as f64 * share) as usize;
            sorted.get(place).copied()
        };
        let averaged = AVERAGED_PLACES.min(bright.len()).max(1);
        let inside = Normalised::of(profiles, profiles.edge + 1, limbs, light);
        let running = inside.running_means(averaged);
        let most = |share: f64| {
            let quantiles = running.quantiles(share).into_iter();
            quantiles.reduce(f32::max).map(f64::from)
        };
        Some(Self {
            limb_dn: of_share(&bright, 0.5)?,
            brightest_dn: of_share(&bright, BRIGHTEST)?,
            sky_dn: median(alike().map(|limb| limb.dark_dn))?,
            averaged,
            cloudless: most(CLOUDLESS_SHARE)?,
            middle: most(0.5)?,
        })
    }
}
