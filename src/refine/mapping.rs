//! The mapping of the whole flight: one slowly varying view of the plate, with jumps, from the marks of all frames.

use super::drift::Estimate;
use super::view::{Reference, unpacked};
use crate::geometry::{LocalSimilarity, Mapping};
use crate::units::{Measured, PlateMil};
use nalgebra::Matrix2;
use serde::Serialize;

/// Use of a frame's marks in the flight's mapping.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum MarkUse {
    /// No marks were identified.
    Unmarked,
    /// The marks agree with the flight's mapping.
    Agrees,
    /// The plate's position differs from that in the frames before and after: the camera was knocked, or is about to be.
    Displaced,
    /// The marks are misidentified: no knock moves the camera so far.
    WrongIds,
}

/// A sudden change of the mapping.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Jump {
    /// The first frame after it, and the last one before it with identified marks.
    #[serde(skip)]
    pub after: usize,
    #[serde(skip)]
    pub before: usize,
    /// Change of the plate's centre on the sensor.
    pub shift_px: [f64; 2],
    /// Change of rotation.
    pub turn_deg: f64,
}

/// Summary of the mapping in a flight.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MappingFacts {
    /// Jumps; the summary names their frames.
    #[serde(skip)]
    pub jumps: Vec<Jump>,
    /// Process noise of the view, px after a second: shift; rotation at 1000 mil from the plate's centre.
    pub process_noise_px: [f64; 2],
    /// Factor by which the marks' sigmas were inflated.
    pub inflation: f64,
    pub temperature: TemperatureDependence,
}

/// Dependence of the mapping on the camera's temperature.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
#[serde(tag = "dependence", rename_all = "snake_case")]
pub enum TemperatureDependence {
    /// The headers hold no temperature that changes.
    NotObservable,
    /// Temperature does not increase the likelihood of the marks enough; the gain is a natural logarithm.
    Insignificant { gain: f64 },
    /// The mapping depends linearly on it.
    Linear {
        gain: f64,
        /// Change of shift x and y, stretch and rotation at 1000 mil from the plate's centre.
        px_per_degc: [Measured; 4],
    },
}

/// The mapping of a flight, frame by frame.
pub struct FlightMapping {
    pub(super) reference: Reference,
    pub(super) estimates: Vec<Estimate>,
    pub mark_use: Vec<MarkUse>,
    pub facts: MappingFacts,
}

/// The mapping in conventional numbers.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MappingNumbers {
    /// Sensor position of the plate's centre.
    pub centre_px: [Measured; 2],
    /// Scale and rotation there.
    pub there: LocalSimilarity,
}

impl FlightMapping {
    /// The mapping at a frame. `None` where it cannot be inverted.
    pub fn at(&self, frame: usize) -> Option<Mapping> {
        self.reference.mapping(&self.estimates[frame].state)
    }

    /// Covariance of a plate position by the mapping of a frame, mil^2.
    pub fn covariance_mil2(&self, frame: usize, at: PlateMil, mapping: &Mapping) -> Matrix2<f64> {
        let covariance = unpacked(&self.estimates[frame].covariance);
        let own = self
            .reference
            .view
            .covariance_mil2(at, mapping, &covariance);
        match self.own_jump(frame) {
            Some(size_px) => {
                let scale = mapping.scale_mil_per_px(mapping.to_sensor(at));
                own + Matrix2::identity() * (size_px * scale / 2.0).powi(2)
            }
            None => own,
        }
    }

    /// Size of the jump at a marked frame, or since the previous marked one, px.
    pub fn own_jump(&self, frame: usize) -> Option<f64> {
        let [x, y] = self.jump_at(frame)?.shift_px;
        Some(x.hypot(y))
    }

    fn jump_at(&self, frame: usize) -> Option<&Jump> {
        let is_marked = self.mark_use[frame] != MarkUse::Unmarked;
        let mut jumps = self.facts.jumps.iter().filter(|_| is_marked);
        jumps.find(|jump| (jump.before + 1..=jump.after).contains(&frame))
    }

    /// The mapping of a frame in numbers; at a jump, whose time is not known, half of it counts as 1 sigma. `None` if the mapping cannot
    /// be inverted.
    pub fn numbers(&self, frame: usize) -> Option<MappingNumbers> {
        let mapping = self.at(frame)?;
        let middle = PlateMil::new(0.0, 0.0);
        let centre = mapping.to_sensor(middle);
        let covariance = unpacked(&self.estimates[frame].covariance);
        let view = &self.reference.view;
        let mut there = view.local_similarity(centre, &mapping, &covariance);
        let (shift_px, turn_deg) = match self.jump_at(frame) {
            Some(jump) => (jump.shift_px, jump.turn_deg),
            None => ([0.0; 2], 0.0),
        };
        let sigma = &mut there.rotation_deg.sigma;
        *sigma = sigma.hypot(turn_deg / 2.0);
        let centre_sigma_px = [0, 1].map(|axis| {
            let own_px = covariance[(axis, axis)].max(0.0).sqrt();
            own_px.hypot(shift_px[axis] / 2.0)
        });
        Some(MappingNumbers {
            centre_px: [
                Measured::new(centre.x, centre_sigma_px[0]),
                Measured::new(centre.y, centre_sigma_px[1]),
            ],
            there,
        })
    }
}
