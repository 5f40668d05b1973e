//! Record of one frame of the horizon: a row of the journal.

use super::super::record::{Grade, InFlight};
use super::super::timeline::Dated;
use crate::fits::Header;
use crate::frame::FrameInfo;
use crate::geometry::attitude::Direction;
use crate::horizon::{Flag, Quality, Solution};
use crate::observe::FrameFacts;
use crate::pointing::{body_pitch_deg, body_roll_deg};
use crate::reasons::Stopped;
use nalgebra::{Matrix3, Rotation3, UnitVector3, Vector3};
use serde::{Deserialize, Serialize};

/// Record of one frame.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct HorizonRecord {
    pub facts: FrameFacts,
    pub quality: Grade,
    /// The reason why there is no nadir.
    pub reason: Option<String>,
    /// Objects beside the edge, or in front of it.
    pub flags: String,
    /// The nadir in the body's axes.
    pub nadir: Option<NadirRecord>,
    /// Points of the edge in view, and those that agree with the nadir.
    pub places: usize,
    pub agreeing: usize,
    /// The body's roll and 1 sigma as the flight's program wrote them into the header, deg.
    pub in_flight_deg: Option<[f64; 2]>,
}

/// A direction with its covariance, row by row, rad^2.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct NadirRecord {
    unit: [f64; 3],
    covariance_rad2: [[f64; 3]; 3],
}

impl NadirRecord {
    fn of(direction: &Direction) -> Self {
        Self {
            unit: direction.unit.into_inner().into(),
            covariance_rad2: direction.covariance_rad2.transpose().into(),
        }
    }

    pub fn direction(&self) -> Direction {
        Direction {
            unit: UnitVector3::new_normalize(Vector3::from(self.unit)),
            covariance_rad2: Matrix3::from(self.covariance_rad2).transpose(),
        }
    }
}

impl Dated for HorizonRecord {
    fn facts(&self) -> &FrameFacts {
        &self.facts
    }

    /// Roll and pitch, deg.
    fn place(&self) -> Option<[f64; 2]> {
        let nadir = self.nadir?.direction();
        Some([body_roll_deg(&nadir).value, body_pitch_deg(&nadir).value])
    }
}

impl HorizonRecord {
    /// Makes the record of a frame, with its file's facts; `body_from_camera` rotates directions of the camera to the body's axes.
    pub fn new(
        info: &FrameInfo,
        header: &Header,
        solution: &Solution,
        body_from_camera: &Rotation3<f64>,
    ) -> Self {
        let flags = solution.flags().into_iter().map(Flag::name);
        let nadir = solution.nadir.as_ref();
        let in_body = |direction: &Direction| direction.turned(body_from_camera);
        Self {
            facts: FrameFacts::of(info),
            quality: match solution.quality() {
                Quality::None => Grade::None,
                Quality::Coarse => Grade::Coarse,
                Quality::Fine => Grade::Fine,
            },
            reason: nadir.err().map(|Stopped { stage, rejected }| {
                let (stage, reason) = (stage.name(), rejected.reason);
                let (measured, limit) = (rejected.measured, rejected.limit);
                format!("{stage}: {reason} (measured {measured:.4}, limit {limit:.4})")
            }),
            flags: flags.collect::<Vec<_>>().join(" "),
            nadir: nadir
                .ok()
                .map(|nadir| NadirRecord::of(&in_body(&nadir.direction))),
            places: solution.places,
            agreeing: solution.agreeing(),
            in_flight_deg: InFlight::of(header).roll_deg,
        }
    }
}
