//! The live line of a flight, for whoever watches it at a terminal.

use crate::link::Housekeeping;
use crate::log;
use crate::service::Service;
use std::io::IsTerminal;
use std::time::{Duration, Instant};

/// How often it is renewed.
const EVERY: Duration = Duration::from_millis(500);

/// Shown where standard error is a terminal, and nowhere else.
pub(super) struct LiveLine {
    on_terminal: bool,
    shown: Instant,
}

impl LiveLine {
    pub fn new() -> Self {
        Self {
            on_terminal: std::io::stderr().is_terminal(),
            shown: Instant::now(),
        }
    }

    /// Shows how the flight is, if it is time to.
    pub fn renew(&mut self, service: &Service) {
        if !self.on_terminal || self.shown.elapsed() < EVERY {
            return;
        }
        self.shown = Instant::now();
        if let Some(told) = service.housekeeping() {
            log::show(line(&told));
        }
    }

    /// Leaves nothing of it.
    pub fn end(self) {
        if self.on_terminal {
            log::show(String::new());
        }
    }
}

/// What the ground is told, on one line.
fn line(told: &Housekeeping) -> String {
    let offset = match told.azimuth_deg.zip(told.elevation_deg) {
        Some((azimuth, elevation)) => {
            format!("azimuth {azimuth:+.4} elevation {elevation:+.4} deg")
        }
        None => "no offset".into(),
    };
    let disks: Vec<String> = [told.disk_1, told.disk_2]
        .into_iter()
        .flatten()
        .map(|used| format!("{used} %"))
        .collect();
    let link = match (told.tracking, told.sending) {
        (true, true) => "tracking",
        (false, true) => "not tracking",
        (_, false) => "not sending",
    };
    format!(
        "{}{} frames: {} fine, {} coarse, {} none | {offset} | {} stored, {} not; disks {} | {link}, {} sent",
        if told.simulated { "SIMULATED " } else { "" },
        told.taken,
        told.fine,
        told.coarse,
        told.none,
        told.stored,
        told.unstored,
        if disks.is_empty() {
            "none".into()
        } else {
            disks.join(", ")
        },
        told.solutions,
    )
}
