//! Attitude of a simulated gondola under its balloon: everything that it carries swings with it.

use crate::geometry::attitude::Direction;
use crate::pointing::body_nadir;
use crate::units::Measured;
use std::f64::consts::TAU;
use std::time::Duration;

/// Swings of a balloon's gondola: amplitude, deg, and period, s. The long one is that of the whole flight train, the short one the gondola's own.
const ROLL: [(f64, f64); 2] = [(0.8, 12.3), (0.2, 3.7)];
const PITCH: [(f64, f64); 1] = [(0.3, 12.3)];
/// Constant roll, deg.
const TILT_DEG: f64 = 1.5;

/// A gondola under its balloon.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Gondola {
    /// Level.
    #[default]
    Still,
    Swinging,
}

impl Gondola {
    /// Roll, positive with the right side low, at a time after the start.
    pub fn roll_deg(self, after: Duration) -> f64 {
        match self {
            Self::Still => 0.0,
            Self::Swinging => TILT_DEG + swing_deg(&ROLL, after),
        }
    }

    /// Pitch, positive with the forward end high.
    pub fn pitch_deg(self, after: Duration) -> f64 {
        match self {
            Self::Still => 0.0,
            Self::Swinging => swing_deg(&PITCH, after),
        }
    }

    /// Nadir in its axes: forward, right and down.
    pub fn nadir(self, after: Duration) -> Direction {
        let [roll, pitch] = [self.roll_deg(after), self.pitch_deg(after)];
        body_nadir(Measured::new(roll, 0.0), Measured::new(pitch, 0.0))
    }
}

fn swing_deg(swings: &[(f64, f64)], after: Duration) -> f64 {
    let swing = |(deg, period_s): &(f64, f64)| deg * (TAU * after.as_secs_f64() / period_s).sin();
    swings.iter().map(swing).sum()
}
