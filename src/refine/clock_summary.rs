//! What the summary says of the computer's clock.

use super::flight::Flight;
use super::load::ClockStep;
use crate::units::Measured;
use serde::Serialize;

/// What the computer's clock did.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ClockSummary {
    /// By how much UTC gains on the monotonic clock, parts in a million: value and 1 sigma.
    pub drift_ppm: Option<[f64; 2]>,
    pub steps: Vec<ClockStepSummary>,
    /// Frames whose time is corrected.
    pub corrected: usize,
}

impl ClockSummary {
    pub(super) fn of(flight: &Flight) -> Self {
        let pair = |measured: Measured| [measured.value, measured.sigma];
        let step = |step: &ClockStep| ClockStepSummary {
            file: step.file.clone(),
            step_s: pair(step.step_s),
        };
        let corrected = flight
            .rows
            .iter()
            .filter(|row| row.utc_correction_s.is_some());
        Self {
            drift_ppm: flight.clock.drift_ppm.map(pair),
            steps: flight.clock.steps.iter().map(step).collect(),
            corrected: corrected.count(),
        }
    }

    /// What people should know of it: name and value.
    pub fn lines(&self) -> impl Iterator<Item = [String; 2]> {
        let drift = self.drift_ppm.map(|[drift, sigma]| {
            // No "-0.000".
            let drift = (drift * 1e3).round() / 1e3 + 0.0;
            let value = format!("{drift:.3} \u{b1} {sigma:.3} parts in a million");
            ["UTC gains on the monotonic clock".into(), value]
        });
        let step = |step: &ClockStepSummary| {
            let [step_s, sigma_s] = step.step_s;
            let value = format!("{step_s:+.4} \u{b1} {sigma_s:.4} s before {}", step.file);
            ["step of UTC".into(), value]
        };
        drift.into_iter().chain(self.steps.iter().map(step))
    }
}

/// A step of UTC.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ClockStepSummary {
    /// The first frame after it.
    pub file: String,
    /// Value and 1 sigma.
    pub step_s: [f64; 2],
}
