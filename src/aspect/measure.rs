//! Measurement: limb and marks from their own pixels, with a mapping that predicts the marks.
//!
//! The mapping is the prior's or an acquired one. Only the starting positions of the fits and the selection of marks depend
//! on it. The marks validate it: if they are not at their predicted positions, it was wrong.

use super::stages::{DISC_REACH, DiscImage, Pipeline, at, marks_mask};
use super::{Mark, Stage, Stopped, Track};
use crate::estimation::median;
use crate::fiducial::{Lighting, RefinedMark, Refiner};
use crate::frame::{Cutout, Mask};
use crate::geometry::Mapping;
use crate::limb::{COMA_BLURS, DiscLight, Limb};
use crate::units::Estimate;
use nalgebra::{Matrix2, Vector2};

/// A mark farther than this from its predicted place is false, or the camera moved; px.
const MAX_DRIFT_PX: f64 = 1.0;
/// Minimum depth of a measured mark's centre inside the limb, in half lengths.
const LEAST_INSIDE: f64 = 0.3;
/// A mark whose residuals exceed the pixels' stated variance by this factor is false, or covered by something.
const MAX_CHI2: f64 = 16.0;
/// All marks of a plate have the same contrast; a mark outside this range, relative to the fully lit ones, is something
/// else, or more than one.
const COMMON_CONTRAST: std::ops::Range<f64> = 0.45..2.2;
/// A cut mark with a less certain position is rejected, px.
const MOST_CUT_SIGMA_PX: f64 = 0.3;
/// Number of predicted marks required beyond the minimum of a labelling: a wrong mapping that fits a few by chance does not
/// fit these.
const MORE_MARKS: usize = 2;
/// After this many frames the marks are detected and identified again, so that a wrong id does not persist.
const MOST_IN_SUCCESSION: u32 = 30;
/// Relative uncertainty of a shift by coma, since the blur of the displaced light is uncertain: see [`COMA_BLURS`].
const COMA_OPEN: f64 = 0.05;

/// Limb and marks measured from their own pixels.
pub struct Measured {
    pub limb: Limb,
    /// The marks, or the reason for having none.
    pub marks: Result<Vec<Mark>, Stopped>,
    /// Number of fully lit marks that were not found at their predicted positions.
    pub missing: usize,
}

/// Shift of the marks against the limb by coma.
struct ComaShift {
    shift_px: Vector2<f64>,
    /// Variance that the shift adds to each mark.
    covariance_px2: Matrix2<f64>,
}

impl ComaShift {
    fn removed_from(&self, found: RefinedMark) -> RefinedMark {
        let place = Estimate {
            position: (found.place.position.vector() - self.shift_px).into(),
            covariance: found.place.covariance + self.covariance_px2,
        };
        RefinedMark { place, ..found }
    }
}

impl Pipeline<'_> {
    /// Limb and marks by the prior's mapping, and the number of frames in succession that were measured so. `None` if there
    /// is no such mapping, or if not all is as it predicts: a mapping with wrong ids would predict marks where the pattern
    /// has none.
    pub(super) fn tracked(
        &self,
        image: &DiscImage,
        prior: Option<&Track>,
    ) -> Option<(Measured, u32)> {
        let prior = prior.filter(|prior| prior.predicted < MOST_IN_SUCCESSION)?;
        let mapping = &prior.registration.as_ref()?.mapping;
        let measured = self.measure(image, mapping).ok()?;
        let enough = self.settings.fiducial.min_marks + MORE_MARKS;
        let full = fully_lit(measured.marks.as_ref().ok()?);
        (measured.missing == 0 && full >= enough).then(|| (measured, prior.predicted + 1))
    }

    /// The limb without masked pixels; if too many are masked, the limb including them is the lesser evil.
    pub(super) fn limb_beside(&self, image: &DiscImage, mask: &Mask) -> Result<Limb, Stopped> {
        self.limb(image, mask)
            .or_else(|_| self.limb(image, &image.cutout.mask))
            .map_err(at(Stage::Limb))
    }

    /// Limb and marks of a disc that is roughly known, with a mapping.
    pub fn measure(&self, image: &DiscImage, mapping: &Mapping) -> Result<Measured, Stopped> {
        let DiscImage { cutout, light, .. } = image;
        let mask = marks_mask(cutout, self.instrument, &light.outline, mapping);
        let limb = self.limb_beside(image, &mask)?;
        let predicted = self.predicted_marks(cutout, &limb, mapping);
        let refined = self.refine(cutout, &limb, mapping, &predicted);
        let found = || predicted.iter().zip(&refined);
        let full = found().filter(|(mark, _)| mark.lighting == Lighting::Full);
        let usual = median(full.filter_map(|(_, found)| Some(found.as_ref()?.contrast)));
        let marks = found().filter_map(|(mark, found)| {
            let found = found.filter(|found| self.is_mark(mark, found, usual))?;
            Some(mark.placed(&found))
        });
        let marks: Vec<Mark> = marks.collect();
        Ok(Measured {
            missing: fully_lit(&predicted) - fully_lit(&marks),
            limb,
            marks: Ok(marks),
        })
    }

    fn is_mark(&self, predicted: &Mark, found: &RefinedMark, usual_contrast: Option<f64>) -> bool {
        let like_others = |usual| COMMON_CONTRAST.contains(&(found.contrast / usual));
        found.contrast > self.settings.fiducial.min_contrast
            && usual_contrast.is_some_and(like_others)
            && found.reduced_chi2 < MAX_CHI2
            && found.place.position.distance(predicted.at) < MAX_DRIFT_PX
            && (predicted.lighting == Lighting::Full
                || largest_variance(&found.place.covariance) < MOST_CUT_SIGMA_PX.powi(2))
    }

    /// The plate's marks illuminated by the disc, at the positions that a mapping predicts.
    fn predicted_marks(&self, cutout: &Cutout, limb: &Limb, mapping: &Mapping) -> Vec<Mark> {
        let plate = &self.instrument.plate;
        let arms = plate.shape.arms() * (plate.shape.size_mil() / 2.0);
        let (outline, region) = (&limb.outline.ellipse, cutout.region());
        let centre = outline.centre.into();
        let about_mil = DISC_REACH * outline.mean_radius() * mapping.scale_mil_per_px(centre);
        let near = plate.marks_about(mapping.to_plate(centre), about_mil);
        let marks = near.filter_map(|(id, printed)| {
            let at = mapping.to_sensor(printed);
            let tips = self.shape.tips(&(mapping.sensor_jacobian(printed) * arms));
            let inside = outline.excess(at.vector()) < -LEAST_INSIDE * self.shape.half_length_px;
            (inside && region.holds(at, 0.0)).then(|| Mark {
                id,
                at,
                covariance_px2: Matrix2::zeros(),
                lighting: Lighting::of(at, tips, outline, &region),
            })
        });
        marks.collect()
    }

    /// Marks measured from their own pixels and corrected for the shift by coma against the limb; none if the pixels do not
    /// agree with a cross.
    pub fn refine(
        &self,
        cutout: &Cutout,
        limb: &Limb,
        mapping: &Mapping,
        marks: &[Mark],
    ) -> Vec<Option<RefinedMark>> {
        let light = &limb.light;
        let plate = &self.instrument.plate;
        let mut refiner = Refiner::new(
            &plate.shape,
            self.disc_scale(light),
            self.mark_blur_px(light),
            light.noise(),
        );
        let coma = self.coma_shift(light, marks.len());
        let refined = |mark: &Mark| {
            let jacobian = mapping.sensor_jacobian(plate.position(mark.id)?);
            let found = refiner.refine(cutout, light, &jacobian, mark.at)?;
            Some(coma.removed_from(found))
        };
        marks.iter().map(refined).collect()
    }

    /// Shift of the marks against the limb by coma. Its uncertainty is common to all marks: the average over many marks
    /// must not reduce it.
    fn coma_shift(&self, light: &DiscLight, marks: usize) -> ComaShift {
        let (coma, covariance) = light.coma();
        let response = self.disc_shape(light).coma_shift(COMA_BLURS);
        let open = covariance + Matrix2::identity() * (COMA_OPEN * coma.norm()).powi(2);
        ComaShift {
            shift_px: response * coma,
            covariance_px2: marks as f64 * response.powi(2) * open,
        }
    }
}

impl Mark {
    /// The mark at its measured position.
    fn placed(&self, found: &RefinedMark) -> Self {
        Self {
            at: found.place.position,
            covariance_px2: found.place.covariance,
            ..*self
        }
    }
}

fn fully_lit(marks: &[Mark]) -> usize {
    let full = |mark: &&Mark| mark.lighting == Lighting::Full;
    marks.iter().filter(full).count()
}

/// Variance along the least certain direction.
fn largest_variance(covariance: &Matrix2<f64>) -> f64 {
    let half_difference = (covariance.m11 - covariance.m22) / 2.0;
    covariance.trace() / 2.0 + half_difference.hypot(covariance.m12)
}
