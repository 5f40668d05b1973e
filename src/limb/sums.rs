//! The kernel of the limb's fit: sums over the pixels of a sector, eight of them side by side.
//!
//! With Tukey's weights w a step by the normal equations is too short, since weights change on the way: Newton's step has d(r w)/dr
//! in place of w. Of that one sum is enough, for the shift: it says how much longer the step ought to be.

use super::profile::Profile;
use crate::estimation::TUKEY_SIGMAS;
use crate::frame::PixelNoise;
use crate::kernels::{LANES, larger};
use multiversion::multiversion;

/// Quantities of a sector: shift, illumination, background, variance of the blur, coma.
pub(super) const SECTOR: usize = 5;
/// Derivatives of the model by a sector's quantities and, last, the residual.
pub(super) const COLUMNS: usize = SECTOR + 1;
/// In the sums, in Newton's step, and among all.
const WEIGHTS: usize = 3;
/// Newton's sum, and the two that tell how much light there is.
const OTHERS: usize = 3;

/// The model of a sector, and what decides how much a pixel counts.
#[derive(Clone, Copy)]
pub(super) struct Weighing<'a> {
    pub profile: &'a Profile,
    /// The same behind the blur of the light that coma displaces.
    pub wide: &'a Profile,
    pub course: [f32; SECTOR],
    pub noise: PixelNoise,
    /// How far illumination and limb may be from the model, 1 sigma: residuals as large are no outliers.
    pub illumination_sigma: f64,
    pub shift_sigma_px: f64,
    pub saturated_dn: f64,
}

/// The sums over a sector.
#[derive(Clone, Copy)]
pub(super) struct Sums {
    /// Weighted, of the products of every two columns.
    pub products: [[f64; COLUMNS]; COLUMNS],
    /// Of the squared derivative by the shift, weighted as Newton's step has it.
    pub newton: f64,
    /// The light that is seen over the profile's, by all pixels alike.
    pub light: f64,
}

/// The derivatives and the residual of a pixel, and how much it counts (1 / DN^2): in the sums, in Newton's step, and as one among all.
#[inline(always)]
fn terms(
    model: &Weighing<'_>,
    distance_px: f32,
    light_dn: f32,
) -> ([f32; COLUMNS], [f32; WEIGHTS]) {
    let (light, slope, bend) = model.profile.light_and_bend(distance_px);
    let (_, slope_wide) = model.wide.light(distance_px);
    let [_, illumination, background, _, coma] = model.course;
    let expected = (1.0 + illumination) * light - coma * slope_wide;
    let residual = light_dn - model.profile.background_dn as f32 - background - expected;
    let variance = model.noise.dark_dn2 as f32 + model.noise.per_light_dn as f32 * light.max(0.0);
    let by_illumination = model.illumination_sigma as f32 * light;
    let by_shift = model.shift_sigma_px as f32 * slope;
    let spread2 = variance + by_illumination * by_illumination + by_shift * by_shift;
    const TUKEY2: f32 = (TUKEY_SIGMAS * TUKEY_SIGMAS) as f32;
    let within = larger(1.0 - residual * residual / (TUKEY2 * spread2), 0.0);
    let alike = if light < model.saturated_dn as f32 {
        1.0 / variance
    } else {
        0.0
    };
    let weight = within * alike;
    (
        [-slope, light, 1.0, 0.5 * bend, -slope_wide, residual],
        [within * weight, (5.0 * within - 4.0) * weight, alike],
    )
}

/// Sums over a sector's pixels.
pub(super) fn sector_sums(model: &Weighing<'_>, distance_px: &[f32], light_dn: &[f32]) -> Sums {
    let mut sums = [[[0.0; LANES]; COLUMNS]; COLUMNS];
    let mut others = [[0.0; LANES]; OTHERS];
    add(model, distance_px, light_dn, &mut sums, &mut others);
    let total = |lanes: &[f32; LANES]| f64::from(lanes.iter().sum::<f32>());
    let mut products = [[0.0; COLUMNS]; COLUMNS];
    for m in 0..COLUMNS {
        for n in m..COLUMNS {
            products[m][n] = total(&sums[m][n]);
            products[n][m] = products[m][n];
        }
    }
    let [newton, seen, expected] = others.map(|lanes| total(&lanes));
    Sums {
        products,
        newton,
        light: seen / expected.max(f64::MIN_POSITIVE),
    }
}

#[multiversion(targets("x86_64+avx2+fma"))]
fn add(
    model: &Weighing<'_>,
    distance_px: &[f32],
    light_dn: &[f32],
    sums: &mut [[[f32; LANES]; COLUMNS]; COLUMNS],
    others: &mut [[f32; LANES]; OTHERS],
) {
    let background_dn = model.profile.background_dn as f32 + model.course[2];
    let (mut local, mut local_others) = (*sums, *others);
    let (whole, rest) = distance_px.as_chunks::<LANES>();
    let (whole_light, rest_light) = light_dn.as_chunks::<LANES>();
    // The last group is filled up with pixels that do not count.
    let (mut distance, mut light, mut counts) = ([0.0; LANES], [0.0; LANES], [1.0; LANES]);
    for n in 0..=whole.len() {
        if n < whole.len() {
            (distance, light) = (whole[n], whole_light[n]);
        } else {
            distance[..rest.len()].copy_from_slice(rest);
            light[..rest.len()].copy_from_slice(rest_light);
            counts[rest.len()..].fill(0.0);
        }
        let mut columns = [[0.0; LANES]; COLUMNS];
        let mut weights = [0.0; LANES];
        for k in 0..LANES {
            let (values, [weight, newton, alike]) = terms(model, distance[k], light[k]);
            for (column, value) in columns.iter_mut().zip(values) {
                column[k] = value;
            }
            weights[k] = weight * counts[k];
            let by_light = alike * counts[k] * values[1];
            local_others[0][k] += newton * counts[k] * values[0] * values[0];
            local_others[1][k] += by_light * (light[k] - background_dn);
            local_others[2][k] += by_light * values[1];
        }
        for m in 0..COLUMNS {
            for n in m..COLUMNS {
                for k in 0..LANES {
                    local[m][n][k] += weights[k] * columns[m][k] * columns[n][k];
                }
            }
        }
    }
    (*sums, *others) = (local, local_others);
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sums_are_those_of_plain_arithmetic() {
        let profile = Profile {
            background_dn: 0.3,
            even_dn: 90.0,
            darkened_dn: 115.0,
            blur_px: 0.95,
            radius_px: 95.0,
        };
        let model = Weighing {
            profile: &profile,
            wide: &profile.with_blur(2.1 * profile.blur_px),
            course: [0.0, 0.01, 0.5, 0.0, 0.02],
            noise: PixelNoise {
                dark_dn2: 20.0,
                per_light_dn: 0.1,
            },
            illumination_sigma: 0.02,
            shift_sigma_px: 0.1,
            saturated_dn: 240.0,
        };
        let distance: Vec<f32> = (0..77).map(|n| n as f32 * 0.2 - 8.0).collect();
        let light: Vec<f32> = distance
            .iter()
            .enumerate()
            .map(|(n, d)| profile.light(*d).0 + (n * 7919 % 13) as f32 - 6.0)
            .collect();
        let Sums {
            products: found,
            newton,
            light: share,
        } = sector_sums(&model, &distance, &light);
        for m in 0..COLUMNS {
            for n in 0..COLUMNS {
                let product = |(d, l): (&f32, &f32)| {
                    let (columns, [weight, ..]) = terms(&model, *d, *l);
                    f64::from(weight) * f64::from(columns[m]) * f64::from(columns[n])
                };
                let plain: f64 = distance.iter().zip(&light).map(product).sum();
                let size = (found[m][m] * found[n][n]).sqrt();
                assert!((found[m][n] - plain).abs() < 1e-5 * size, "{m}, {n}");
            }
        }
        let pixels = || distance.iter().zip(&light);
        let plain = pixels().map(|(d, l)| {
            let (columns, [_, newton, _]) = terms(&model, *d, *l);
            f64::from(newton) * f64::from(columns[0]).powi(2)
        });
        assert!((newton / plain.sum::<f64>() - 1.0).abs() < 1e-5);
        let [mut seen, mut expected] = [0.0; 2];
        for (d, l) in pixels() {
            let (columns, [.., alike]) = terms(&model, *d, *l);
            seen += f64::from(alike) * f64::from(columns[1]) * (f64::from(*l) - 0.3 - 0.5);
            expected += f64::from(alike) * f64::from(columns[1]).powi(2);
        }
        assert!((share / (seen / expected) - 1.0).abs() < 1e-5);
    }
}
