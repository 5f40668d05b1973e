//! A printed mark in the camera's image, behind a Gaussian blur.

use super::blurred_dot::BlurredDot;
use crate::frame::PIXEL_VARIANCE_PX2;
use crate::kernels::marks::{Bars, Coverage, Offsets, cover};
use crate::plate::MarkShape;
use nalgebra::{Matrix2, Rotation2, Vector2};

/// Image of a mark on the sensor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MarkImage {
    pub form: MarkForm,
    /// Half the length of a cross from tip to tip, or a dot's radius.
    pub half_length_px: f64,
    /// Gaussian blur of lens and pixel combined, 1 sigma.
    pub blur_px: f64,
}

/// Image of a mark on the sensor.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum MarkForm {
    Cross { half_width_px: f64 },
    Dot,
}

/// Margin of the search window beyond a mark's tips, in blurs: a wider window gains nothing and includes neighbouring
/// structure.
const TIP_BLURS: f64 = 1.5;
/// Margin around a cross that is included in its fit, in widths of an arm: it determines the brightness and its tilt. A
/// wider one includes neighbouring structure.
const GROUND_WIDTHS: f64 = 1.6;
/// The same for a dot, in its radius.
const GROUND_RADII: f64 = 0.5;
/// The minimum of the margin, in blurs: the blurred edge must end within it.
const GROUND_BLURS: f64 = 1.3;
const GROUND_BLURS_OF_DOT: f64 = 3.0;
/// Minimum fit radius for any mark: fewer pixels do not determine its position and the illumination.
const LEAST_FIT_REACH_PX: f64 = 5.2;

impl MarkImage {
    /// A mark of the plate at a given scale, behind a lens's blur (1 sigma), on pixels of finite size.
    pub fn new(shape: &MarkShape, scale_mil_per_px: f64, lens_blur_px: f64) -> Self {
        let (half_length_mil, form) = match shape {
            MarkShape::Cross(cross) => {
                let half_width_px = cross.arm_width_mil / 2.0 / scale_mil_per_px;
                (
                    cross.arm_length_mil / 2.0,
                    MarkForm::Cross { half_width_px },
                )
            }
            MarkShape::Dot { diameter_mil } => (diameter_mil / 2.0, MarkForm::Dot),
        };
        Self {
            form,
            half_length_px: half_length_mil / scale_mil_per_px,
            blur_px: (lens_blur_px.powi(2) + PIXEL_VARIANCE_PX2).sqrt(),
        }
    }

    /// Shift of the fitted mark by light that is displaced and blurred more, divided by the product of that light's
    /// fraction and its displacement. `blurs` is the blur of the displaced light relative to that of the rest.
    ///
    /// The fit interprets the projection of the displaced profile b' on the slope f' of an arm's own profile as a shift:
    /// the integral of f' b' divided by that of f'^2. For a bar of half width h behind Gaussian blurs both are differences
    /// of Gaussians. A dot's edge counts as that of a bar of the same width.
    pub fn coma_shift(&self, blurs: f64) -> f64 {
        let (h2, own) = (self.half_width_px().powi(2), self.blur_px.powi(2));
        let both = own * (1.0 + blurs.powi(2));
        let overlap = |variance: f64| -(-2.0 * h2 / variance).exp_m1() / variance.sqrt();
        overlap(both) / overlap(2.0 * own)
    }

    fn half_width_px(&self) -> f64 {
        match self.form {
            MarkForm::Cross { half_width_px } => half_width_px,
            MarkForm::Dot => self.half_length_px,
        }
    }

    /// Whether the camera resolves a cross's arms; a dot has none, and a small cross looks like a dot.
    pub fn shows_arms(&self) -> bool {
        /// Minimum length from tip to tip.
        const LEAST_LENGTH_PX: f64 = 7.0;
        match self.form {
            MarkForm::Cross { .. } => 2.0 * self.half_length_px > LEAST_LENGTH_PX,
            MarkForm::Dot => false,
        }
    }

    /// Depth of the mark's centre inside the limb from which it is found at any contrast, px. In simulated frames all
    /// crosses are found from half of half their length on; the limb cuts every dot that is nearer than its radius.
    pub fn sure_depth_px(&self) -> f64 {
        let of_half_length = match self.form {
            MarkForm::Cross { .. } => 0.75,
            MarkForm::Dot => 1.2,
        };
        of_half_length * self.half_length_px
    }

    /// Radius within which the mark clearly darkens the image, px.
    pub fn reach_px(&self) -> f64 {
        self.half_length_px + TIP_BLURS * self.blur_px
    }

    /// Radius of the pixels that are included in its fit, px.
    pub(super) fn fit_reach_px(&self) -> f64 {
        let ground_px = match self.form {
            MarkForm::Cross { half_width_px } => {
                (GROUND_WIDTHS * 2.0 * half_width_px).max(GROUND_BLURS * self.blur_px)
            }
            MarkForm::Dot => {
                (GROUND_RADII * self.half_length_px).max(GROUND_BLURS_OF_DOT * self.blur_px)
            }
        };
        (self.half_length_px + ground_px).max(LEAST_FIT_REACH_PX)
    }

    /// Half the blurred width of an arm, or blurred radius of a dot, px: a position farther off than this is beside the
    /// mark.
    pub(super) fn blurred_half_width_px(&self) -> f64 {
        self.half_width_px().hypot(self.blur_px)
    }

    /// The points of the mark farthest from its centre, as offsets: a cross's tips, or points of a dot's edge. `arms` has
    /// two neighbouring tips, or two perpendicular radii, as columns.
    pub fn tips(&self, arms: &Matrix2<f64>) -> impl Iterator<Item = Vector2<f64>> + use<> {
        let (a, b) = (arms.column(0).into_owned(), arms.column(1).into_owned());
        let (sum, difference) = (a + b, a - b);
        let slanting = match self.form {
            MarkForm::Cross { .. } => None,
            MarkForm::Dot => {
                Some([sum, difference].map(|tip| tip * std::f64::consts::FRAC_1_SQRT_2))
            }
        };
        let tips = [a, b].into_iter().chain(slanting.into_iter().flatten());
        tips.flat_map(|tip| [tip, -tip])
    }

    /// The share of the light that the mark absorbs at offsets from its centre, px. `to_arms` maps an offset on the sensor
    /// to one along the arms, both px.
    pub(super) fn coverage(&self, x: &[f32], y: &[f32], to_arms: &Matrix2<f64>) -> Coverage {
        let from = [0.0; 2];
        let mut coverage = Coverage::default();
        Cover::new(self).at(rows(to_arms), Offsets { from, x, y }, &mut coverage);
        coverage
    }

    /// Uncertainty of a detected mark's position, 1 sigma per axis, px, for a noise relative to the mark's darkness.
    pub fn place_sigma_px(&self, noise: f64) -> f64 {
        let reach = self.reach_px().ceil() as i32;
        let along = || (-reach..=reach).map(|n| n as f32);
        let (x, y): (Vec<f32>, Vec<f32>) =
            along().flat_map(|y| along().map(move |x| (x, y))).unzip();
        let coverage = self.coverage(&x, &y, &Matrix2::identity());
        noise / coverage.slope_energy().sqrt()
    }

    pub(super) fn bars(&self, half_width_px: f64) -> Bars {
        Bars {
            half_length: self.half_length_px as f32,
            half_width: half_width_px as f32,
            per_blur: 1.0 / self.blur_px as f32,
        }
    }

    pub(super) fn dot(&self) -> BlurredDot {
        BlurredDot::new(self.half_length_px, self.blur_px)
    }
}

/// Share of the light absorbed by a mark, and its derivatives.
#[derive(Debug, Clone)]
pub(super) enum Cover {
    Cross(Bars),
    Dot(BlurredDot),
}

impl Cover {
    pub fn new(image: &MarkImage) -> Self {
        match image.form {
            MarkForm::Cross { half_width_px } => Self::Cross(image.bars(half_width_px)),
            MarkForm::Dot => Self::Dot(image.dot()),
        }
    }

    /// Coverage at offsets from the centre; `to_arms` maps, by rows, an offset on the sensor to one along the arms, both
    /// px.
    pub fn at(&self, to_arms: [f32; 4], offsets: Offsets<'_>, coverage: &mut Coverage) {
        match self {
            Self::Cross(bars) => cover(bars, to_arms, offsets, coverage),
            Self::Dot(dot) => dot.cover(to_arms, offsets, coverage),
        }
    }
}

/// The elements of a matrix by rows.
pub(super) fn rows(matrix: &Matrix2<f64>) -> [f32; 4] {
    [matrix.m11, matrix.m12, matrix.m21, matrix.m22].map(|v| v as f32)
}

/// From an offset on the sensor to one along arms that are rotated from the sensor's axes.
pub(super) fn turned(rotation_deg: f64) -> Matrix2<f64> {
    Rotation2::new(-rotation_deg.to_radians()).into_inner()
}

#[cfg(test)]
pub(super) const USUAL_CROSS: MarkImage = MarkImage {
    form: MarkForm::Cross {
        half_width_px: 1.05,
    },
    half_length_px: 7.8,
    blur_px: 0.95,
};

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_mark_takes_the_light_of_its_area() {
        let (length, width) = (2.0 * 7.8, 2.0 * 1.05);
        let dot = MarkImage {
            form: MarkForm::Dot,
            half_length_px: 4.2,
            blur_px: 0.95,
        };
        for (mark, expected) in [
            (USUAL_CROSS, 2.0 * length * width - width * width),
            (dot, std::f64::consts::PI * 4.2 * 4.2),
        ] {
            let (x, y): (Vec<f32>, Vec<f32>) = (-15..=15)
                .flat_map(|y| (-15..=15).map(move |x| (x as f32, y as f32)))
                .unzip();
            let area: f32 = mark.coverage(&x, &y, &turned(17.0)).share.iter().sum();
            assert!(
                (f64::from(area) - expected).abs() < 0.02,
                "{area} of {expected}"
            );
        }
    }

    #[test]
    fn a_dots_edge_is_as_far_from_its_middle_all_round() {
        let dot = MarkImage {
            form: MarkForm::Dot,
            ..USUAL_CROSS
        };
        let arms = turned(10.0) * 3.0;
        assert_eq!(USUAL_CROSS.tips(&arms).count(), 4);
        let tips: Vec<_> = dot.tips(&arms).collect();
        assert!(tips.len() == 8 && tips.iter().all(|tip| (tip.norm() - 3.0).abs() < 1e-12));
    }
}
