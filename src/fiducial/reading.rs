//! A reading: one way to give the marks their ids, and how well it explains what is seen.

use super::identify::Sight;
use super::{Detection, Lighting, Settings};
use crate::geometry::{Distortion, Mapping, SimilarityParameters};
use crate::plate::{MarkId, Plate};
use crate::units::PlateMil;
use nalgebra::{Matrix2, Vector2};

/// How far from a printed mark a detection may fall: in the first guess, and once the reading's own marks have been
/// fitted, mil. Neighbouring codes differ by 36 mil.
const FIRST_TOLERANCE_MIL: f64 = 14.0;
const FIRST_TOLERANCE_SLOPE: f64 = 0.02;
const FITTED_TOLERANCE_MIL: f64 = 9.0;
/// How far a mark of the right reading may be from its place: print, keystone and noise together, 1 sigma. A wrong
/// reading that keeps the scale misses by 5 mil and more.
const MISFIT_MIL: f64 = 2.5;
/// How far the scale of a reading may be from the known one.
const SCALE_SIGMAS: f64 = 3.0;

/// Ids given to detections (by index), with a score: marks explained, less marks that should be seen and are not,
/// less half of what is seen and not explained, less the misfit.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Reading {
    pub ids: Vec<(usize, MarkId)>,
    pub score: f64,
}

impl Reading {
    /// Whether two readings cannot both be true: they name a detection differently, or have none in common.
    pub(super) fn contradicts(&self, other: &Self) -> bool {
        let mut shared = self.ids.iter().filter_map(|(n, id)| {
            let elsewhere = other.ids.iter().find(|(m, _)| m == n)?;
            Some(elsewhere.1 == *id)
        });
        match shared.next() {
            None => true,
            Some(first_agrees) => !first_agrees || shared.any(|agrees| !agrees),
        }
    }
}

/// What readings are held against.
pub(super) struct Evidence<'a> {
    pub detections: &'a [Detection],
    pub sight: &'a Sight,
    pub plate: &'a Plate,
    pub settings: &'a Settings,
}

impl Evidence<'_> {
    /// The reading that follows when detections `a` and `b` are the given neighbours; `None` when it explains fewer
    /// than three marks or puts the plate's centre where it cannot be.
    pub(super) fn follow(&self, a: (usize, MarkId), b: (usize, MarkId)) -> Option<Reading> {
        let guess = self.similarity(&[a, b])?;
        let near = self.centre_shift_px(&guess) < 1.3 * self.settings.max_centre_shift_px;
        if !near || !self.has_right_scale(&guess) {
            return None;
        }
        let from = self.plate.position(a.1);
        let ids = self.matches(&guess, |at| {
            FIRST_TOLERANCE_MIL + FIRST_TOLERANCE_SLOPE * at.distance(from)
        });
        if ids.len() < self.settings.min_marks {
            return None;
        }
        let fitted = self.similarity(&ids)?;
        let ids = self.matches(&fitted, |_| FITTED_TOLERANCE_MIL);
        let shifted = self.centre_shift_px(&fitted) > self.settings.max_centre_shift_px;
        let scaled = self.has_right_scale(&fitted);
        if ids.len() < self.settings.min_marks || shifted || !scaled {
            return None;
        }
        Some(Reading {
            score: self.score(&fitted, &ids),
            ids,
        })
    }

    /// The least-squares similarity through marks and their printed places, in closed form.
    fn similarity(&self, ids: &[(usize, MarkId)]) -> Option<Mapping> {
        let axes = self.sight.handedness.axes();
        let count = ids.len() as f64;
        let points = ids.iter().map(|(n, id)| {
            let printed = axes * self.plate.position(*id).vector();
            (self.detections[*n].at.vector(), printed)
        });
        let sums = points
            .clone()
            .fold((Vector2::zeros(), Vector2::zeros()), |sum, p| {
                (sum.0 + p.0, sum.1 + p.1)
            });
        let (seen_mean, printed_mean) = (sums.0 / count, sums.1 / count);
        let (mut along, mut across, mut square) = (0.0, 0.0, 0.0);
        for (seen, printed) in points {
            let (seen, printed) = (seen - seen_mean, printed - printed_mean);
            along += printed.dot(&seen);
            across += printed.perp(&seen);
            square += printed.norm_squared();
        }
        let turn = Matrix2::new(along, -across, across, along) / square;
        let centre = seen_mean - turn * printed_mean;
        let parameters = SimilarityParameters {
            plate_centre: centre.into(),
            scale_mil_per_px: square / along.hypot(across),
            rotation_deg: across.atan2(along).to_degrees(),
            handedness: self.sight.handedness,
        };
        Mapping::similarity(parameters, Distortion::NONE)
    }

    /// A reading may not stretch the plate: a wrong one would turn 288 mil into 306 that way.
    fn has_right_scale(&self, mapping: &Mapping) -> bool {
        let scale = mapping.scale_mil_per_px(self.sight.disc.centre.into());
        let known = self.sight.scale_mil_per_px;
        (scale - known.value).abs() < SCALE_SIGMAS * known.sigma
    }

    fn centre_shift_px(&self, mapping: &Mapping) -> f64 {
        let centre = mapping.to_sensor(PlateMil::new(0.0, 0.0));
        centre.distance(self.sight.plate_centre)
    }

    /// Every detection with the printed mark it falls on, each mark once.
    fn matches(
        &self,
        mapping: &Mapping,
        tolerance_mil: impl Fn(PlateMil) -> f64,
    ) -> Vec<(usize, MarkId)> {
        let mut found: Vec<(f64, usize, MarkId)> = Vec::new();
        for (n, detection) in self.detections.iter().enumerate() {
            let at = mapping.to_plate(detection.at);
            if let Some((id, distance)) = self.plate.nearest(at)
                && distance < tolerance_mil(at)
            {
                found.push((distance, n, id));
            }
        }
        found.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut matches: Vec<(usize, MarkId)> = Vec::new();
        for (_, n, id) in found {
            if matches.iter().all(|(_, taken)| *taken != id) {
                matches.push((n, id));
            }
        }
        matches.sort_by_key(|(n, _)| *n);
        matches
    }

    fn score(&self, mapping: &Mapping, ids: &[(usize, MarkId)]) -> f64 {
        let read = |n: usize| ids.iter().any(|(m, _)| *m == n);
        let unexplained = self
            .detections
            .iter()
            .enumerate()
            .filter(|(n, detection)| detection.lighting == Lighting::Full && !read(*n))
            .count();
        let missing = self
            .plate
            .marks()
            .filter(|(id, position)| {
                let seen = mapping.to_sensor(*position);
                let inside = -self.sight.disc.excess(seen.vector());
                inside > self.sight.sure_depth_px
                    && self.sight.on_sensor(seen)
                    && ids.iter().all(|(_, read)| read != id)
            })
            .count();
        let misfit: f64 = ids
            .iter()
            .map(|(n, id)| {
                let miss = mapping
                    .to_plate(self.detections[*n].at)
                    .distance(self.plate.position(*id));
                0.5 * (miss / MISFIT_MIL).powi(2)
            })
            .sum();
        ids.len() as f64 - missing as f64 - 0.5 * unexplained as f64 - misfit
    }
}
