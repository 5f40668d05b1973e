//! The short way of a frame whose prior knows the mapping: the marks are where it predicts them, or the frame goes the
//! long way.
//!
//! Camera and plate hardly move from frame to frame; only the Sun moves over both. So every mark that must be lit is measured
//! by its own pixels. All of them must be there, each near its predicted place: a mapping whose ids were wrong would
//! predict marks where the pattern has none. Nothing else of the prior enters the solution but the place where the fits start.

use super::marks::MarkScene;
use super::stages::{DISC_ROOM, Pipeline};
use super::{DiscAndMarks, Mark};
use crate::estimation::median;
use crate::fiducial::{Lighting, RefinedMark};
use crate::frame::{Cutout, Levels};
use crate::geometry::{Ellipse, Mapping};
use crate::limb::Limb;
use crate::units::SensorPx;
use nalgebra::{Matrix2, Vector2};

/// A mark farther than this from its predicted place means that the camera moved, px.
const MAX_DRIFT_PX: f64 = 1.0;
/// How far inside the limb and the sensor's edge the tips of a mark are that must be seen, px.
const SURE_MARGIN_PX: f64 = 1.0;
/// What of a mark must lie inside the limb for it to be measured, in half lengths from its middle.
const LEAST_INSIDE: f64 = 0.3;
/// A mark whose residuals exceed the pixels' stated variance by so much is none, or not only one.
const MAX_CHI2: f64 = 4.0;
/// So many marks beyond those that make a labelling must be predicted: a wrong mapping that fits a few by chance does not fit these.
const MORE_MARKS: usize = 2;
/// After so many frames the marks are detected and identified again: a wrong id must not last.
const MOST_IN_SUCCESSION: u32 = 30;
/// All marks of a plate have the same contrast; what differs by more from the fully lit ones is something else, or more than one.
const COMMON_CONTRAST: std::ops::Range<f64> = 0.6..1.6;
/// A cut mark whose place is less certain is rejected, px.
const MOST_CUT_SIGMA_PX: f64 = 0.3;

impl Pipeline<'_> {
    /// Limb and marks as the prior's mapping predicts them. `None` where there is no such mapping or not all is as it
    /// predicts.
    pub(super) fn predicted(
        &self,
        levels: &Levels,
        cutout: &mut Cutout,
        found: SensorPx,
    ) -> Option<DiscAndMarks> {
        let prior = self.prior?;
        if prior.predicted >= MOST_IN_SUCCESSION {
            return None;
        }
        let mapping = &prior.registration.as_ref()?.mapping;
        let start = self.predicted_outline(mapping, found)?;
        let mask = self.marks_mask(cutout.region(), &start, mapping);
        let limb = self.limb_fit(levels, cutout).near(&start, &mask).ok()?;
        cutout.noise = limb.noise();
        let predicted = self.predicted_marks(&limb, mapping);
        let full = |mark: &Mark| mark.lighting == Lighting::Full;
        let enough = self.settings.fiducial.min_marks + MORE_MARKS;
        if predicted.iter().filter(|m| full(m)).count() < enough {
            return None;
        }
        let scene = MarkScene {
            cutout,
            limb: &limb,
            mapping,
        };
        let marks = self.found_where_predicted(&scene, &predicted)?;
        Some(DiscAndMarks {
            limb,
            marks: Ok(marks),
            predicted: prior.predicted + 1,
        })
    }

    /// The disc's outline about a place, as a mapping shows the Sun there.
    fn predicted_outline(&self, mapping: &Mapping, found: SensorPx) -> Option<Ellipse> {
        let on_plate = mapping.to_plate(found);
        let picture = mapping.sensor_jacobian(on_plate) * self.radius_mil.value;
        Ellipse::of_unit_circle(found.vector(), &picture)
    }

    /// The plate's marks that the disc illuminates, where a mapping puts them.
    fn predicted_marks(&self, limb: &Limb, mapping: &Mapping) -> Vec<Mark> {
        let plate = &self.instrument.plate;
        let reach_px = self.shape.half_length_px;
        let outline = &limb.outline.ellipse;
        let centre = SensorPx::from(outline.centre);
        let about_mil = DISC_ROOM * outline.mean_radius() * mapping.scale_mil_per_px(centre);
        let near = plate.marks_about(mapping.to_plate(centre), about_mil);
        let marks = near.filter_map(|(id, printed)| {
            let at = mapping.to_sensor(printed);
            let inside = outline.excess(at.vector()) < -LEAST_INSIDE * reach_px;
            let on_sensor = self.is_on_sensor(at.vector(), 0.0);
            (inside && on_sensor).then(|| Mark {
                id,
                at,
                covariance_px2: Matrix2::zeros(),
                lighting: self.predicted_lighting(limb, mapping.sensor_jacobian(printed), at),
            })
        });
        marks.collect()
    }

    fn predicted_lighting(&self, limb: &Limb, jacobian: Matrix2<f64>, at: SensorPx) -> Lighting {
        let half_mil = self.instrument.plate.cross.arm_length_mil / 2.0;
        let arms = [Vector2::x(), Vector2::y()].map(|arm| jacobian * arm * half_mil);
        let mut tips = arms
            .iter()
            .flat_map(|arm| [at.vector() + arm, at.vector() - arm]);
        let lit = |tip: Vector2<f64>| {
            limb.outline.ellipse.excess(tip) < -SURE_MARGIN_PX
                && self.is_on_sensor(tip, SURE_MARGIN_PX)
        };
        if tips.all(lit) {
            Lighting::Full
        } else {
            Lighting::Cut
        }
    }

    fn is_on_sensor(&self, at: Vector2<f64>, margin_px: f64) -> bool {
        let within = |v: f64, pixels: usize| (margin_px..pixels as f64 - margin_px).contains(&v);
        within(at.x, self.frame.width()) && within(at.y, self.frame.height())
    }

    /// The marks by their own pixels. `None` where one that must be seen is not; one that the limb cuts may be missing.
    fn found_where_predicted(
        &self,
        scene: &MarkScene<'_>,
        predicted: &[Mark],
    ) -> Option<Vec<Mark>> {
        let refined = self.refine(scene, predicted);
        let full = |(mark, found): (&Mark, &Option<RefinedMark>)| {
            let found = found.filter(|_| mark.lighting == Lighting::Full);
            found.map(|found| found.contrast)
        };
        let usual = median(predicted.iter().zip(&refined).filter_map(full))?;
        let least = self.settings.fiducial.min_contrast;
        let is_mark = |mark: &Mark, found: &RefinedMark| {
            found.contrast > least
                && COMMON_CONTRAST.contains(&(found.contrast / usual))
                && found.reduced_chi2 < MAX_CHI2
                && found.place.position.distance(mark.at) < MAX_DRIFT_PX
                && (mark.lighting == Lighting::Full
                    || largest_variance(&found.place.covariance) < MOST_CUT_SIGMA_PX.powi(2))
        };
        let mut marks = Vec::with_capacity(predicted.len());
        for (mark, found) in predicted.iter().zip(&refined) {
            match found.as_ref().filter(|found| is_mark(mark, found)) {
                Some(found) => marks.push(mark.placed(found)),
                None if mark.lighting == Lighting::Full => return None,
                None => {}
            }
        }
        Some(marks)
    }
}

/// Along the direction that is known worst.
fn largest_variance(covariance: &Matrix2<f64>) -> f64 {
    let half_difference = (covariance.m11 - covariance.m22) / 2.0;
    covariance.trace() / 2.0 + half_difference.hypot(covariance.m12)
}
