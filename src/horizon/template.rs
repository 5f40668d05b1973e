//! Fit of the mean profile to the profile of a place.

use super::profile::{INTERPOLATED_NOISE, Profiles};
use crate::kernels::paths::fit_columns;
use nalgebra::{Matrix3, Vector3};

/// Relative to the mean profile's brightness: clouds may show above this level. They raise that brightness as well, and
/// blur extends above them.
const CLOUDLESS: f64 = 0.7;
/// Relative to a pixel's noise: a profile with a larger scatter contains clouds.
const CLOUDED: f64 = 1.25;
/// Minimum share of clouded places for which clouds are taken into account.
pub(super) const CLOUDED_SHARE: f64 = 0.05;

/// Fitted parameters of a place's profile.
#[derive(Debug, Clone, Copy)]
pub(super) struct Limb {
    pub dark_dn: f64,
    /// Brightness in units of the mean profile's.
    pub brightness_dn: f64,
    /// Shift outwards from the mean profile.
    pub shift_steps: f64,
    pub shift_sigma_steps: f64,
    /// Rms of the residuals.
    pub scatter_dn: f64,
}

/// Fits of the mean profile to a place's profile: to all of it, and to the air above any cloud.
pub(super) struct LimbFits {
    whole: TemplateFit,
    air: TemplateFit,
    most_scatter_dn: f64,
}

impl LimbFits {
    /// `None` if there is no limb.
    pub fn new(mean: &[f64], profiles: &Profiles, noise_dn: f64) -> Option<Self> {
        let brightness = mean
            .get(..=profiles.edge)?
            .iter()
            .copied()
            .reduce(f64::max)?;
        let air = mean.iter().rposition(|v| *v > CLOUDLESS * brightness)?;
        Some(Self {
            whole: TemplateFit::new(mean, 1, profiles.stride)?,
            air: TemplateFit::new(mean, air.max(1), profiles.stride)?,
            most_scatter_dn: CLOUDED * INTERPOLATED_NOISE * noise_dn,
        })
    }

    /// The limb at each place from the air above any clouds.
    pub fn above_clouds(&self, profiles: &Profiles) -> Vec<Limb> {
        self.air.limbs(profiles)
    }

    /// The limb at each place, and the share of places with clouds. Whole profiles determine the brightness best; if more
    /// than a few places have clouds, all are fitted to the air alone, to treat them equally.
    pub fn limbs(&self, profiles: &Profiles) -> (Vec<Limb>, f64) {
        let whole = self.whole.limbs(profiles);
        let clouded = whole
            .iter()
            .filter(|limb| limb.scatter_dn > self.most_scatter_dn);
        let clouded = clouded.count() as f64 / whole.len() as f64;
        match clouded > CLOUDED_SHARE {
            true => (self.air.limbs(profiles), clouded),
            false => (whole, clouded),
        }
    }
}

/// A profile as the mean one with an offset, a brightness and a small shift: linear least squares.
struct TemplateFit {
    /// At each sample: 1, the mean profile, and its derivative by a shift outwards; 0 at samples that do not count.
    columns: [Vec<f32>; 3],
    inverse: Matrix3<f64>,
    /// Degrees of freedom: samples minus the three unknowns.
    freedom: f64,
}

impl TemplateFit {
    /// From the samples from `first` on, of profiles padded to `length`. `None` if they do not determine the three
    /// unknowns.
    fn new(mean: &[f64], first: usize, length: usize) -> Option<Self> {
        let samples = first..mean.len().checked_sub(1)?;
        let freedom = samples.len().checked_sub(3).filter(|left| *left > 0)?;
        let mut columns = [(); 3].map(|()| vec![0.0; length]);
        let mut normal = Matrix3::zeros();
        for n in samples {
            let row = Vector3::new(1.0, mean[n], -(mean[n + 1] - mean[n - 1]) / 2.0);
            normal += row * row.transpose();
            for (column, value) in columns.iter_mut().zip(&row) {
                column[n] = *value as f32;
            }
        }
        Some(Self {
            columns,
            inverse: normal.try_inverse()?,
            freedom: freedom as f64,
        })
    }

    fn limbs(&self, profiles: &Profiles) -> Vec<Limb> {
        let columns = self.columns.each_ref().map(Vec::as_slice);
        let inverse = self.inverse.cast::<f32>().data.0;
        let limb = |light: &[f32]| {
            let (found, squares) = fit_columns(columns, &inverse, light);
            let [dark_dn, brightness_dn, shift] = found.map(f64::from);
            let scatter_dn = (f64::from(squares) / self.freedom).sqrt();
            Limb {
                dark_dn,
                brightness_dn,
                shift_steps: shift / brightness_dn,
                shift_sigma_steps: scatter_dn * self.inverse.m33.sqrt() / brightness_dn.abs(),
                scatter_dn,
            }
        };
        profiles.filled_up().map(limb).collect()
    }
}
