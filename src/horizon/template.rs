//! The profile of a place as the mean one, moved.

use super::profile::{INTERPOLATED_NOISE, Profiles};
use nalgebra::{Matrix3, Vector3};
use std::ops::Range;

/// Of the mean profile's brightness: clouds may show where it is brighter. They raise that brightness, too, and blur reaches above them.
const CLOUDLESS: f64 = 0.7;
/// Over a pixel's noise: a profile that fits less well has clouds in it.
const CLOUDED: f64 = 1.25;
/// In more of the places than this, clouds count.
pub(super) const CLOUDED_SHARE: f64 = 0.05;

/// What a place's profile says.
#[derive(Debug, Clone, Copy)]
pub(super) struct Limb {
    pub dark_dn: f64,
    /// In units of the mean profile's.
    pub brightness_dn: f64,
    /// Outwards from the mean profile.
    pub shift_steps: f64,
    pub shift_sigma_steps: f64,
    /// Rms of what the fit leaves.
    pub scatter_dn: f64,
}

/// Fits of the mean profile to a place's: to all of it, and to the air above any cloud.
pub(super) struct LimbFits {
    whole: TemplateFit,
    air: TemplateFit,
    most_scatter_dn: f64,
}

impl LimbFits {
    /// `None` of no limb.
    pub fn new(mean: &[f64], edge: usize, noise_dn: f64) -> Option<Self> {
        let brightness = mean.get(..=edge)?.iter().copied().reduce(f64::max)?;
        let air = mean.iter().rposition(|v| *v > CLOUDLESS * brightness)?;
        Some(Self {
            whole: TemplateFit::new(mean, 1)?,
            air: TemplateFit::new(mean, air.max(1))?,
            most_scatter_dn: CLOUDED * INTERPOLATED_NOISE * noise_dn,
        })
    }

    /// The limb at each place by the air above any clouds.
    pub fn above_clouds(&self, profiles: &Profiles) -> Vec<Limb> {
        profiles.light().map(|light| self.air.limb(light)).collect()
    }

    /// The limb at each place, and the share of places with clouds. Whole profiles tell the brightness best; where clouds stand in more
    /// than a few, the air alone is fair to all.
    pub fn limbs(&self, profiles: &Profiles) -> (Vec<Limb>, f64) {
        let by = |fit: &TemplateFit| profiles.light().map(|light| fit.limb(light)).collect();
        let whole: Vec<Limb> = by(&self.whole);
        let clouded = whole
            .iter()
            .filter(|limb| limb.scatter_dn > self.most_scatter_dn);
        let clouded = clouded.count() as f64 / whole.len() as f64;
        match clouded > CLOUDED_SHARE {
            true => (by(&self.air), clouded),
            false => (whole, clouded),
        }
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

    fn limb(&self, light: &[f32]) -> Limb {
        let pairs = || self.rows.iter().zip(&light[self.samples.clone()]);
        let gradient: Vector3<f64> = pairs().map(|(row, dn)| row * f64::from(*dn)).sum();
        let found = self.inverse * gradient;
        let squares: f64 = pairs()
            .map(|(row, dn)| (f64::from(*dn) - row.dot(&found)).powi(2))
            .sum();
        let scatter_dn = (squares / (self.rows.len() - 3) as f64).sqrt();
        let brightness_dn = found.y;
        Limb {
            dark_dn: found.x,
            brightness_dn,
            shift_steps: found.z / brightness_dn,
            shift_sigma_steps: scatter_dn * self.inverse.m33.sqrt() / brightness_dn.abs(),
            scatter_dn,
        }
    }
}
