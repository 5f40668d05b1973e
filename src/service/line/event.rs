//! What the link is told, and what it says of a frame without a solution.

use crate::aspect::Stopped;
use crate::link::message::NO_OFFSET;
use crate::link::{Exposure, Housekeeping, Picture, Propagated, Solution};
use crate::pointing::{Offset, Roll};
use crate::units::Measured;
use std::time::{Duration, Instant};

/// What the link is told.
pub enum LinkEvent {
    ExposureStarts(Exposure),
    Outcome(Box<Outcome>),
    /// An offset by the gyros.
    Propagated(PropagatedEvent),
    /// The second's housekeeping.
    Housekeeping(Box<Housekeeping>),
    /// A picture for the ground: it takes minutes, between other packets. A new one takes the place of an old one.
    Picture(Box<Picture>),
}

/// An offset by the gyros.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PropagatedEvent {
    pub propagated: Propagated,
    /// When the sample was read that it rests on.
    pub read: Instant,
}

/// What came of an exposure.
pub struct Outcome {
    pub exposure: Exposure,
    /// When the frame was there.
    pub arrived: Instant,
    /// How long the shutter was open, where it is known.
    pub shutter: Option<Duration>,
    pub offset: Option<Offset>,
    /// The body's, where it is known.
    pub roll_deg: Option<Measured>,
    /// When the frame was there that it rests on.
    pub roll_arrived: Option<Instant>,
    pub stopped: Option<Stopped>,
}

impl Outcome {
    /// Since mid-exposure.
    pub fn age(&self) -> Duration {
        self.arrived.elapsed() + self.shutter.unwrap_or_default() / 2
    }

    pub fn solution(&self) -> Option<Solution> {
        let offset = self.offset?;
        // The packet has no other word for a roll that is not known, or that the offset does not rest on.
        let roll_deg = match (offset.roll, self.roll_deg) {
            (Roll::Measured(_), Some(roll)) => roll.value,
            _ => 0.0,
        };
        let numbers = [
            offset.azimuth_deg,
            offset.elevation_deg,
            roll_deg,
            offset.sigma_deg,
        ];
        numbers.iter().all(|n| n.is_finite()).then_some(Solution {
            azimuth_deg: offset.azimuth_deg,
            elevation_deg: offset.elevation_deg,
            roll_deg,
            error_deg: offset.sigma_deg,
            time: self.exposure.start,
        })
    }

    /// What the controller is told where there is no solution.
    pub fn error_code(&self) -> u16 {
        self.stopped
            .map_or(NO_OFFSET, |stopped| stopped.stage as u16 + 1)
    }
}
