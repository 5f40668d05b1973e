//! The kernel of the limb fit: sums over the pixels of a sector, eight of them in parallel (SIMD).
//!
//! With Tukey's weights w a step by the normal equations is too short, since the weights change during the step: Newton's
//! step has d(r w)/dr in place of w. One such sum, for the shift, is enough: it gives the factor by which the step must be
//! lengthened.

use super::limb::EdgeLight;
use super::{LANES, larger};
use multiversion::multiversion;

/// Quantities of a sector: shift, illumination, background, variance of the blur, coma.
pub const SECTOR: usize = 5;
/// Derivatives of the model by a sector's quantities and, last, the residual.
pub const COLUMNS: usize = SECTOR + 1;
/// Weights of a pixel: in the sums, in Newton's step, and without Tukey's weight.
const WEIGHTS: usize = 3;
/// Sums beside the products: Newton's, and two for the mean brightness.
const OTHERS: usize = 3;

/// The model of a sector, and the parameters of a pixel's weight.
#[derive(Clone, Copy)]
pub struct Weighing {
    pub light: EdgeLight,
    /// The same with the blur of the light that coma displaces.
    pub wide: EdgeLight,
    /// Level without the light of the disc, DN.
    pub background_dn: f32,
    pub illumination: f32,
    /// The displaced fraction of the light times its displacement, px.
    pub coma_px: f32,
    /// Variance of a pixel without light, DN^2, and per DN of light, DN.
    pub dark_dn2: f32,
    pub per_light_dn: f32,
    /// Uncertainty of illumination and limb in the model, 1 sigma: residuals of this size are no outliers.
    pub illumination_sigma: f32,
    pub shift_sigma_px: f32,
    pub saturated_dn: f32,
    /// Squared residual in sigmas above which Tukey's weight is 0.
    pub tukey2: f32,
}

/// The sums over a sector.
#[derive(Clone, Copy)]
pub struct Sums {
    /// Weighted sums of the products of every two columns.
    pub products: [[f64; COLUMNS]; COLUMNS],
    /// Sum of the squared derivative by the shift, with the weight of Newton's step.
    pub newton: f64,
    /// Ratio of the observed light to the profile's, without Tukey's weights.
    pub light: f64,
}

/// The derivatives and the residual of a pixel, and its weights (1 / DN^2): in the sums, in Newton's step, and equal
/// weight.
#[inline(always)]
fn terms(model: &Weighing, distance_px: f32, light_dn: f32) -> ([f32; COLUMNS], [f32; WEIGHTS]) {
    let (light, slope, bend) = model.light.at(distance_px);
    let (_, slope_wide, _) = model.wide.at(distance_px);
    let expected = (1.0 + model.illumination) * light - model.coma_px * slope_wide;
    let residual = light_dn - model.background_dn - expected;
    let variance = model.dark_dn2 + model.per_light_dn * larger(light, 0.0);
    let by_illumination = model.illumination_sigma * light;
    let by_shift = model.shift_sigma_px * slope;
    let spread2 = variance + by_illumination * by_illumination + by_shift * by_shift;
    let within = larger(1.0 - residual * residual / (model.tukey2 * spread2), 0.0);
    let alike = if light < model.saturated_dn {
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
pub fn sector_sums(model: &Weighing, distance_px: &[f32], light_dn: &[f32]) -> Sums {
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

#[multiversion(targets("x86_64+avx2"))]
fn add(
    model: &Weighing,
    distance_px: &[f32],
    light_dn: &[f32],
    sums: &mut [[[f32; LANES]; COLUMNS]; COLUMNS],
    others: &mut [[f32; LANES]; OTHERS],
) {
    let (mut local, mut local_others) = (*sums, *others);
    let (whole, rest) = distance_px.as_chunks::<LANES>();
    let (whole_light, rest_light) = light_dn.as_chunks::<LANES>();
    // The last group is padded with pixels that do not count.
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
            local_others[1][k] += by_light * (light[k] - model.background_dn);
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
        let profile = EdgeLight {
            even_dn: 90.0,
            darkened_dn: 115.0,
            per_blur: 1.0 / 0.95,
            per_radius: 1.0 / 95.0,
        };
        let model = Weighing {
            light: profile,
            wide: EdgeLight {
                per_blur: profile.per_blur / 2.1,
                ..profile
            },
            background_dn: 0.8,
            illumination: 0.01,
            coma_px: 0.02,
            dark_dn2: 20.0,
            per_light_dn: 0.1,
            illumination_sigma: 0.02,
            shift_sigma_px: 0.1,
            saturated_dn: 240.0,
            tukey2: 22.0,
        };
        let distance: Vec<f32> = (0..77).map(|n| n as f32 * 0.2 - 8.0).collect();
        let light: Vec<f32> = distance
            .iter()
            .enumerate()
            .map(|(n, d)| profile.at(*d).0 + (n * 7919 % 13) as f32 - 6.0)
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
            seen += f64::from(alike) * f64::from(columns[1]) * (f64::from(*l) - 0.8);
            expected += f64::from(alike) * f64::from(columns[1]).powi(2);
        }
        assert!((share / (seen / expected) - 1.0).abs() < 1e-5);
    }
}
