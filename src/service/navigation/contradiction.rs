//! Directions that contradict the gyros for 10 s: a log line when that begins, and one when it ends.

use crate::log::worth_a_line;
use crate::navigation::{Agreement, Axis, Comparison, NavigationSettings};
use crate::service::tally::NavigationTally;

/// Whether directions contradicted the gyros at the last note.
#[derive(Debug, Default)]
pub(super) struct LastingContradiction {
    is_on: bool,
}

impl LastingContradiction {
    /// Notes the agreement of cameras and gyros; the 1st, 2nd, 4th ... contradiction is logged.
    pub fn note(
        &mut self,
        comparison: &Comparison,
        settings: &NavigationSettings,
        tally: &mut NavigationTally,
    ) {
        tally.differences = Axis::ALL.map(|axis| comparison.sigmas(axis));
        tally.agreement = comparison.agreement();
        let is_on = tally.agreement == Some(Agreement::LastingContradiction);
        let was_on = std::mem::replace(&mut self.is_on, is_on);
        tally.contradicted += u64::from(is_on && !was_on);
        if is_on == was_on || !worth_a_line(tally.contradicted) {
            return;
        }
        let times = tally.contradicted;
        match tally.agreement {
            Some(Agreement::LastingContradiction) => {
                let axes = lasting(comparison, settings);
                tracing::warn!(axes, times, "directions contradict the gyros for 10 s");
            }
            Some(_) => tracing::info!(times, "directions no longer contradict the gyros"),
            None => tracing::info!(times, "directions are compared with the gyros again"),
        }
    }
}

/// The cameras that contradict the gyros, with axis and difference.
fn lasting(comparison: &Comparison, settings: &NavigationSettings) -> String {
    let lasting = comparison.latest().filter(|(.., one)| one.lasts());
    let words = lasting.map(|(axis, camera, one)| {
        let camera = &settings.cameras[camera].name;
        format!("{camera} {}: {:.1} sigma", axis.name(), one.sigmas)
    });
    words.collect::<Vec<_>>().join(", ")
}
