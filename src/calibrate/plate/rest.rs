//! Whether the camera rested in each pose, as the plate tells that was fitted.
//!
//! Where it moved, and the times of the frames do not tell when (all alike, or of several runs at once), a pose holds frames of several, and
//! the fit is of none of them. The marks of a frame, taken together, then lie away from where its pose has them, and so do those of the other
//! frames that were taken before the camera moved, or after: these are the poses.

use super::fit::{PlateFit, Residual};
use super::motion::{Displacement, motion};
use crate::calibrate::numbers::median;
use crate::estimation::MEDIAN_LENGTH_2D;
use crate::plate::MarkId;
use crate::units::SensorPx;
use nalgebra::{Vector2, Vector4};
use std::collections::BTreeMap;

/// A frame that lies so many sigmas off does not rest.
const OFF_SIGMAS: f64 = 5.0;
/// A pose is at rest though this part of its frames is off.
const FEW: f64 = 0.1;
/// Fewest frames of a part.
const LEAST_FRAMES: usize = 3;
/// So many frames a part has on the mean at least: what falls into more parts does not rest at all.
const LEAST_MEAN: usize = 8;
/// A motion is fitted to the frames that agree with it so often.
const ROUNDS: usize = 3;
/// 1 sigma of a median of normal values over that of their mean.
const MEDIAN_SIGMA: f64 = 1.25;

/// The frames of a fit, and how far off they lie.
pub(super) struct Shifts<'a> {
    fit: &'a PlateFit,
    /// The residuals of each frame's marks, by pose.
    frames: Vec<BTreeMap<usize, Vec<&'a Residual>>>,
    /// Of the marks within the frames, over what these state.
    scatter: f64,
}

impl<'a> Shifts<'a> {
    pub fn of(fit: &'a PlateFit) -> Self {
        let mut frames: Vec<BTreeMap<usize, Vec<&Residual>>> =
            vec![BTreeMap::new(); fit.poses.len()];
        for residual in &fit.residuals {
            let of_pose = &mut frames[residual.pose];
            of_pose.entry(residual.frame).or_default().push(residual);
        }
        let within = frames.iter().flat_map(BTreeMap::values).flat_map(|marks| {
            let shift = shift(marks, |r| r.residual_px).moved_px;
            let freedom = (1.0 - 1.0 / marks.len() as f64).sqrt();
            let left =
                move |r: &&Residual| (r.residual_px - shift).norm() / (r.stated_px * freedom);
            marks.iter().map(left)
        });
        let scatter = (median(within) / MEDIAN_LENGTH_2D).max(1.0);
        Self {
            fit,
            frames,
            scatter,
        }
    }

    /// How many frames are off in the poses that do not rest.
    pub fn restless(&self) -> usize {
        (0..self.frames.len()).map(|pose| self.off(pose)).sum()
    }

    /// How many frames of a pose are off; none where it rests.
    pub fn off(&self, pose: usize) -> usize {
        let frames = &self.frames[pose];
        let is_off = |marks: &&Vec<&Residual>| {
            let shift = shift(marks, |r| r.residual_px);
            shift.moved_px.norm() > OFF_SIGMAS * self.scatter * shift.sigma_px
        };
        let off = frames.values().filter(is_off).count();
        let few = LEAST_FRAMES.max((FEW * frames.len() as f64) as usize);
        if off < few { 0 } else { off }
    }

    /// The frames of some poses, whose mappings are nearly one, by parts that each rest. `None` where they do not make any.
    pub fn parts(&self, poses: &[usize]) -> Option<Vec<Vec<usize>>> {
        let mapping = self.fit.poses[*poses.first()?].mapping;
        let marks = self.fit.marks.iter();
        let places: BTreeMap<MarkId, SensorPx> = marks
            .map(|mark| (mark.id, mapping.to_sensor(mark.position)))
            .collect();
        let frames = poses.iter().flat_map(|pose| &self.frames[*pose]);
        let mut rest: BTreeMap<usize, Displacement> = frames
            .filter_map(|(frame, marks)| {
                let known = marks.iter().copied();
                let known: Vec<&Residual> = known.filter(|r| places.contains_key(&r.id)).collect();
                let mut shift = shift(&known, |r| r.at.vector() - places[&r.id].vector());
                shift.sigma_px *= self.scatter;
                (!known.is_empty()).then_some((*frame, shift))
            })
            .collect();
        let all = rest.len();
        let mut parts = Vec::new();
        while let Some(part) = most_agreeing(&rest).filter(|part| part.len() >= LEAST_FRAMES) {
            part.iter().for_each(|n| _ = rest.remove(n));
            parts.push(part);
        }
        let are_parts = LEAST_MEAN * parts.len() <= all && rest.len() as f64 <= FEW * all as f64;
        are_parts.then_some(parts)
    }
}

/// How far the marks of a frame are off, together: their median, whatever a few of them say that it misread.
fn shift(marks: &[&Residual], off_px: impl Fn(&Residual) -> Vector2<f64>) -> Displacement {
    let middle = |of: &dyn Fn(&Residual) -> f64| median(marks.iter().map(|r| of(r)));
    let stated_px = middle(&|r| r.stated_px);
    Displacement {
        at: Vector2::new(middle(&|r| r.at.x), middle(&|r| r.at.y)),
        moved_px: Vector2::new(middle(&|r| off_px(r).x), middle(&|r| off_px(r).y)),
        sigma_px: MEDIAN_SIGMA * stated_px / (marks.len() as f64).sqrt(),
    }
}

/// The frames that agree with one motion: that of the frame with which most agree.
fn most_agreeing(shifts: &BTreeMap<usize, Displacement>) -> Option<Vec<usize>> {
    let with = |motion: &Vector4<f64>, sigmas: f64| -> Vec<usize> {
        let agree = shifts
            .iter()
            .filter(|(_, shift)| shift.left_by(motion).norm() < sigmas);
        agree.map(|(n, _)| *n).collect()
    };
    let of_frame =
        |shift: &Displacement| Vector4::new(shift.moved_px.x, shift.moved_px.y, 0.0, 0.0);
    let first = shifts.values().map(of_frame);
    // Both of two frames have their errors.
    let mut part = first
        .map(|motion| with(&motion, OFF_SIGMAS * 2_f64.sqrt()))
        .max_by_key(Vec::len)?;
    for _ in 0..ROUNDS {
        let slopes = part.iter().map(|n| (&shifts[n], shifts[n].slopes()));
        part = with(&motion(slopes).ok()?.parameters, OFF_SIGMAS);
    }
    Some(part)
}
