//! The disc's light by rows of pixels, as marks' fits ask for it.

use super::Profile;
use super::band::outwards;
use crate::geometry::Ellipse;
use crate::lanes::split;
use multiversion::multiversion;

/// Near the limb light bends: entries of the table for each pixel.
const NEAR_PER_PX: f32 = 8.0;
/// What is near the limb, in blurs; deeper inside an entry a pixel is enough.
const NEAR_BLURS: (f64, f64) = (8.0, 6.0);

/// The disc's blurred light without marks.
#[derive(Debug, Clone, PartialEq)]
pub struct DiscLight {
    outline: Ellipse,
    /// Light above the background, DN, and what leads to the next entry: by pixels from the middle, then near the limb.
    table: Vec<[f32; 2]>,
    places: Steps,
}

/// Where distances from the outline are in the table.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Steps {
    first_px: f32,
    near_px: f32,
    /// The first entry that is near the limb.
    near: f32,
    last: f32,
}

impl DiscLight {
    pub(super) fn new(outline: &Ellipse, profile: &Profile) -> Self {
        let deep_px = (1.1 * outline.mean_radius()).ceil();
        let near_px = (NEAR_BLURS.0 * profile.blur_px).ceil().min(deep_px);
        let beyond_px = NEAR_BLURS.1 * profile.blur_px;
        let deep = (deep_px - near_px) as usize;
        let near = ((near_px + beyond_px) * f64::from(NEAR_PER_PX)) as usize + 2;
        let distances = (0..deep)
            .map(|n| n as f64 - deep_px)
            .chain((0..near).map(|n| n as f64 / f64::from(NEAR_PER_PX) - near_px));
        let light = distances.map(|d| (profile.both(d).0 - profile.background_dn) as f32);
        let values: Vec<f32> = light.chain([0.0]).collect();
        let table: Vec<[f32; 2]> = values.windows(2).map(|v| [v[0], v[1] - v[0]]).collect();
        Self {
            outline: *outline,
            places: Steps {
                first_px: -deep_px as f32,
                near_px: -near_px as f32,
                near: deep as f32,
                last: (table.len() - 1) as f32,
            },
            table,
        }
    }

    /// The light on a row's pixels from column `x` on, DN above the background.
    pub fn fill(&self, x: f64, y: f64, light: &mut [f32]) {
        let from = [x - self.outline.centre.x, y - self.outline.centre.y].map(|v| v as f32);
        let inverse = self.outline.inverse().cast::<f32>();
        let inverse = [inverse.m11, inverse.m12, inverse.m22];
        find_steps(from, inverse, &self.places, light);
        let last = self.table.len() - 1;
        for light in light {
            let (entry, part) = split(*light);
            let [here, on] = self.table[(entry as usize).min(last)];
            *light = here + on * part;
        }
    }
}

/// How many entries into the table a row's pixels are.
#[multiversion(targets("x86_64+avx2"))]
fn find_steps(from: [f32; 2], inverse: [f32; 3], places: &Steps, steps: &mut [f32]) {
    let Steps {
        first_px,
        near_px,
        near,
        last,
    } = *places;
    let y = from[1];
    for (n, steps) in steps.iter_mut().enumerate() {
        let x = from[0] + n as i32 as f32;
        let (_, out) = outwards(inverse, x, y);
        let deep = out - first_px;
        let along = near + (out - near_px) * NEAR_PER_PX;
        *steps = if out < near_px { deep } else { along }.clamp(0.0, last);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix2, Vector2};

    #[test]
    fn rows_hold_the_profile_s_light() {
        let root = Matrix2::new(95.3, 0.2, 0.2, 94.8);
        let outline = Ellipse::new(Vector2::new(300.2, 250.7), root).unwrap();
        let profile = Profile {
            background_dn: 4.0,
            even_dn: 90.0,
            darkened_dn: 115.0,
            blur_px: 0.945,
            radius_px: 95.05,
        };
        let light = DiscLight::new(&outline, &profile);
        for y in [160.0, 200.0, 250.0, 251.0, 330.0] {
            let mut row = [0.0; 220];
            light.fill(190.0, y, &mut row);
            for (n, found) in row.iter().enumerate() {
                let at = Vector2::new(190.0 + n as f64, y);
                let expected = profile.at(outline.excess(at)) - 4.0;
                assert!(
                    (f64::from(*found) - expected).abs() < 0.2,
                    "{at} {found} {expected}"
                );
            }
        }
    }
}
