//! Reading the marks' ids from the code in their spacings.
//!
//! A pair of neighbours tells one half of an id by its coded spacing and leaves the other half, and the quarter turn
//! of the camera, open. So each pair proposes every reading it allows; a reading is followed over all detections
//! and scored by what it explains, what it would show and does not, and what it leaves unexplained. Pairs, an L or a
//! block alone read consistently at any quarter turn: the plate's centre, which a wrong reading puts hundreds of
//! pixels away, decides. When two readings that contradict each other fit nearly as well, both are refused.

use super::reading::{Evidence, Reading};
use super::{Detection, Lighting, Settings};
use crate::geometry::Handedness;
use crate::limb::Circle;
use crate::plate::{FIXED_SPACING_MIL, MAX_INDEX, MarkId, Plate, coded_spacing_mil};
use crate::units::{Measured, Rejected, SensorPx};
use nalgebra::{Rotation2, Vector2};

/// What is known of the picture before any mark is read.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sight {
    /// From the disc's radius and the ephemeris, known before any mark is read.
    pub scale_mil_per_px: Measured,
    /// Rotation of the picture modulo a quarter turn, from the arms of the crosses.
    pub quarter_rotation_deg: f64,
    pub handedness: Handedness,
    /// Where the instrument says the plate's centre is seen.
    pub plate_centre: SensorPx,
    pub disc: Circle,
    /// Depth inside the limb from which a mark must have been found, px.
    pub sure_depth_px: f64,
    /// Width and height of the sensor, px.
    pub sensor_px: [f64; 2],
}

impl Sight {
    /// Whether a mark at this position lies wholly on the sensor.
    pub(super) fn on_sensor(&self, at: SensorPx) -> bool {
        let margin = self.sure_depth_px;
        let inside = |v: f64, size: f64| v > margin && v < size - 1.0 - margin;
        inside(at.x, self.sensor_px[0]) && inside(at.y, self.sensor_px[1])
    }
}

/// Detections with their ids.
#[derive(Debug, Clone, PartialEq)]
pub struct Identification {
    /// Index into the detections, and the id.
    pub ids: Vec<(usize, MarkId)>,
}

/// How far a pair may be from the fixed and from the coded spacing, mil. The fixed one suffers from an error of the
/// rotation (9 mil a degree), the coded one from one of the scale (5 mil a percent).
const FIXED_TOLERANCE_MIL: f64 = 20.0;
const CODED_TOLERANCE_MIL: f64 = 14.0;
/// A reading must beat any that contradicts it by this much: one mark.
const DECISIVE_SCORE: f64 = 1.0;

/// Names the detections. Rejected when they allow no reading, or more than one.
pub fn identify(
    detections: &[Detection],
    sight: &Sight,
    plate: &Plate,
    settings: &Settings,
) -> Result<Identification, Rejected> {
    let full = detections
        .iter()
        .filter(|d| d.lighting == Lighting::Full)
        .count();
    if full < settings.min_marks {
        return Err(Rejected {
            reason: "too few fully lit marks",
            measured: full as f64,
            limit: settings.min_marks as f64,
        });
    }
    let evidence = Evidence {
        detections,
        sight,
        plate,
        settings,
    };
    let mut readings: Vec<Reading> = Vec::new();
    for (a, b) in proposals(detections, sight) {
        if let Some(reading) = evidence.follow(a, b)
            && !readings.contains(&reading)
        {
            readings.push(reading);
        }
    }
    decide(readings, settings)
}

/// The best reading, if no other contradicts it and fits nearly as well.
fn decide(mut readings: Vec<Reading>, settings: &Settings) -> Result<Identification, Rejected> {
    readings.sort_by(|a, b| b.score.total_cmp(&a.score));
    let Some(best) = readings.first() else {
        return Err(Rejected {
            reason: "the marks' spacings allow no reading",
            measured: 0.0,
            limit: settings.min_marks as f64,
        });
    };
    let rival = readings.iter().find(|other| other.contradicts(best));
    if let Some(rival) = rival
        && best.score - rival.score < DECISIVE_SCORE
    {
        return Err(Rejected {
            reason: "two readings of the marks fit alike",
            measured: best.score - rival.score,
            limit: DECISIVE_SCORE,
        });
    }
    let least = settings.min_marks as f64 - 0.5;
    if best.score < least {
        return Err(Rejected {
            reason: "the best reading leaves too much unexplained",
            measured: best.score,
            limit: least,
        });
    }
    Ok(Identification {
        ids: best.ids.clone(),
    })
}

type Named = (usize, MarkId);

/// Every way in which a pair of detections may be neighbours, at every quarter turn.
fn proposals(detections: &[Detection], sight: &Sight) -> Vec<(Named, Named)> {
    let mut proposals = Vec::new();
    for quarter in 0..4 {
        let rotation_deg = sight.quarter_rotation_deg + 90.0 * f64::from(quarter);
        let unrotate = Rotation2::new(-rotation_deg.to_radians());
        let to_plate = sight.handedness.axes() * unrotate.matrix() * sight.scale_mil_per_px.value;
        for (a, first) in detections.iter().enumerate() {
            for (b, second) in detections.iter().enumerate() {
                if a == b {
                    continue;
                }
                let step = to_plate * (second.at.vector() - first.at.vector());
                for (from, to) in neighbours_at(step) {
                    proposals.push(((a, from), (b, to)));
                }
            }
        }
    }
    proposals
}

/// The pairs of neighbouring marks that lie a plate vector apart.
fn neighbours_at(step: Vector2<f64>) -> Vec<(MarkId, MarkId)> {
    let coded = |spacing: f64| {
        (-MAX_INDEX..MAX_INDEX)
            .filter(move |n| (coded_spacing_mil(*n) - spacing).abs() < CODED_TOLERANCE_MIL)
    };
    let is_fixed = |spacing: f64| (spacing - FIXED_SPACING_MIL).abs() < FIXED_TOLERANCE_MIL;
    let mut pairs = Vec::new();
    for other in -MAX_INDEX..=MAX_INDEX {
        if is_fixed(step.y) {
            let id = |i| MarkId { i, j: other };
            pairs.extend(coded(step.x).map(|n| (id(n), id(n + 1))));
        }
        if is_fixed(-step.x) {
            let id = |j| MarkId { i: other, j };
            pairs.extend(coded(step.y).map(|n| (id(n), id(n + 1))));
        }
    }
    pairs
}
