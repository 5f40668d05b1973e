//! Findings on the computer's clock in a flight.

use super::clock::ClockStep;
use crate::units::Measured;
use serde::Serialize;

/// The smallest drift that is reported as a number, parts in a million.
const LEAST_PPM: f64 = 0.001;

/// Findings on the computer's clock in a flight.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct ClockFacts {
    /// Rate of UTC relative to the monotonic clock, parts in a million.
    pub drift_ppm: Option<Measured>,
    /// Steps, each with the first file after it.
    pub steps: Vec<ClockStep<String>>,
    /// Frames whose time is corrected.
    pub corrected: usize,
}

impl ClockFacts {
    /// Lines for people: name and value.
    pub fn lines(&self) -> impl Iterator<Item = [String; 2]> {
        let drift = self.drift_ppm.map(|Measured { value, sigma }| {
            let least = value.abs() + 2.0 * sigma < LEAST_PPM;
            let value = match least {
                true => format!("less than {LEAST_PPM} parts in a million"),
                false => format!("{value:.3} \u{b1} {sigma:.3} parts in a million"),
            };
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_drift_that_is_not_significant_has_no_number() {
        let line = |value: f64, sigma: f64| {
            let facts = ClockFacts {
                drift_ppm: Some(Measured::new(value, sigma)),
                ..ClockFacts::default()
            };
            facts.lines().next().unwrap()[1].clone()
        };
        assert_eq!(line(-2e-12, 0.0), "less than 0.001 parts in a million");
        assert_eq!(line(-0.25, 0.01), "-0.250 \u{b1} 0.010 parts in a million");
    }
}
