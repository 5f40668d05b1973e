//! What the computer's clock did in a flight.

use super::clock::ClockStep;
use crate::units::Measured;
use serde::Serialize;

/// What the computer's clock did in a flight.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct ClockFacts {
    /// By how much UTC gains on the monotonic clock, parts in a million.
    pub drift_ppm: Option<Measured>,
    /// Each by the first file after it.
    pub steps: Vec<ClockStep<String>>,
    /// Frames whose time is corrected.
    pub corrected: usize,
}

impl ClockFacts {
    /// What people should know of it: name and value.
    pub fn lines(&self) -> impl Iterator<Item = [String; 2]> {
        let drift = self.drift_ppm.map(|Measured { value, sigma }| {
            // No "-0.000".
            let drift = (value * 1e3).round() / 1e3 + 0.0;
            let value = format!("{drift:.3} \u{b1} {sigma:.3} parts in a million");
            ["UTC gains on the monotonic clock".into(), value]
        });
        let step = |ClockStep { frame, step_s }: &ClockStep<String>| {
            let Measured { value, sigma } = step_s;
            let value = format!("{value:+.4} \u{b1} {sigma:.4} s before {frame}");
            ["step of UTC".into(), value]
        };
        drift.into_iter().chain(self.steps.iter().map(step))
    }
}
