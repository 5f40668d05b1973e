//! Reading the marks' ids from the code in their spacings.
//!
//! Scale and rotation, but for the quarter turn, are known before any mark is read: from the disc's radius and from the
//! crosses' arms. So a reading is fixed by one detection's id and a quarter turn, and those that put the plate's
//! centre anywhere near the instrument's value are few enough to try them all. Each is followed over all detections
//! and scored by its likelihood: what it explains and how closely, and what it would show and does not.
//!
//! A pair, an L or a 2 x 2 block alone reads consistently at any quarter turn, a row at any place along the other
//! axis. So a reading must beat every other that contradicts it, and chance, decisively; else all are refused.
//!
//! # When it fails
//! A row of marks at the pattern's edge is misread when a spot that is no mark falls, to a pixel, where the next row's
//! mark would be: once in ten thousand readings if every frame had such a spot.

use super::reading::{Evidence, Placement, Reading};
use super::{Detection, Lighting, Settings};
use crate::geometry::{Circle, Handedness};
use crate::plate::{MarkId, Plate};
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
    /// From plate to sensor but for the shift, at every quarter turn.
    fn turned(&self) -> impl Iterator<Item = Placement> {
        let unturned = self.handedness.axes() / self.scale_mil_per_px.value;
        [0.0, 90.0, 180.0, 270.0]
            .into_iter()
            .filter_map(move |quarter| {
                let rotation = Rotation2::new((self.quarter_rotation_deg + quarter).to_radians());
                Placement::new(Vector2::zeros(), rotation.matrix() * unturned)
            })
    }

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

/// Readings are tried up to this much beyond the largest shift of the plate's centre: were the true one left out, a
/// wrong one would stand unrivalled.
const TRIED_BEYOND: f64 = 1.3;
/// A reading must beat any that contradicts it by this much, logarithm of the odds: two marks that should be seen and
/// are not, or one that is seen and not explained.
const DECISIVE_ODDS: f64 = 4.5;
/// The score that chance reaches: the first mark explained is no evidence, since the plate was shifted on to it.
const CHANCE_SCORE: f64 = 12.0;

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
    let marks: Vec<_> = plate.marks().collect();
    let evidence = Evidence {
        detections,
        sight,
        marks: &marks,
        settings,
    };
    decide(readings(&evidence), sight, settings)
}

/// The best reading, if nothing that contradicts it fits nearly as well.
fn decide(
    mut readings: Vec<Reading>,
    sight: &Sight,
    settings: &Settings,
) -> Result<Identification, Rejected> {
    let reject = |reason, measured, limit| {
        Err(Rejected {
            reason,
            measured,
            limit,
        })
    };
    readings.sort_by(|a, b| b.score.total_cmp(&a.score));
    let least = settings.min_marks as f64;
    let Some(best) = readings.first() else {
        return reject("the marks' spacings allow no reading", 0.0, least);
    };
    if best.full < settings.min_marks {
        let reason = "the best reading explains too few fully lit marks";
        return reject(reason, best.full as f64, least);
    }
    let over_chance = best.score - CHANCE_SCORE;
    if over_chance < DECISIVE_ODDS {
        let reason = "the best reading leaves too much unexplained";
        return reject(reason, over_chance, DECISIVE_ODDS);
    }
    if let Some(rival) = readings.iter().find(|other| other.contradicts(best))
        && best.score - rival.score < DECISIVE_ODDS
    {
        let reason = "two readings of the marks fit alike";
        return reject(reason, best.score - rival.score, DECISIVE_ODDS);
    }
    let shift_px = best.plate_centre.distance(sight.plate_centre);
    if shift_px > settings.max_centre_shift_px {
        let reason = "the best reading puts the plate's centre too far away";
        return reject(reason, shift_px, settings.max_centre_shift_px);
    }
    Ok(Identification {
        ids: best.ids.clone(),
    })
}

/// Every reading that some fully lit mark, some id for it and some quarter turn lead to.
fn readings(evidence: &Evidence<'_>) -> Vec<Reading> {
    let (sight, settings) = (evidence.sight, evidence.settings);
    let farthest_px = TRIED_BEYOND * settings.max_centre_shift_px;
    let full = |(_, detection): &(usize, &Detection)| detection.lighting == Lighting::Full;
    let anchors = evidence.detections.iter().enumerate().filter(full);
    // A reading with enough marks has one of them among all but so many.
    let spare = settings.min_marks.saturating_sub(1);
    let anchors = anchors.clone().take(anchors.count().saturating_sub(spare));
    let mut readings = Vec::new();
    for turned in sight.turned() {
        let mut so_turned: Vec<Reading> = Vec::new();
        for (n, detection) in anchors.clone() {
            for (id, printed) in evidence.marks {
                let guess = turned.shifted(*printed, detection.at);
                let near = (guess.centre - sight.plate_centre.vector()).norm() < farthest_px;
                let known = || so_turned.iter().any(|r| r.ids.contains(&(n, *id)));
                if near && !known() {
                    so_turned.extend(evidence.follow(&guess, *printed));
                }
            }
        }
        readings.append(&mut so_turned);
    }
    readings
}
