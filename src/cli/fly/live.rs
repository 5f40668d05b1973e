//! The live line of a flight, for an operator at a terminal.

use crate::link::Housekeeping;
use crate::log;
use crate::service::Service;
use std::io::IsTerminal;
use std::time::{Duration, Instant};

/// Interval between updates.
const EVERY: Duration = Duration::from_millis(500);

/// Shown only if standard error is a terminal.
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

    /// Shows the state of the flight, if an update is due.
    pub fn renew(&mut self, service: &Service) {
        if !self.on_terminal || self.shown.elapsed() < EVERY {
            return;
        }
        self.shown = Instant::now();
        if let Some(housekeeping) = service.housekeeping() {
            log::show(line(&housekeeping));
        }
    }

    /// Clears the line.
    pub fn end(self) {
        if self.on_terminal {
            log::show(String::new());
        }
    }
}

/// The flight's state, on one line.
fn line(housekeeping: &Housekeeping) -> String {
    let offset = match housekeeping.azimuth_deg.zip(housekeeping.elevation_deg) {
        Some((azimuth, elevation)) => {
            format!("azimuth {azimuth:+.4} elevation {elevation:+.4} deg")
        }
        None => "no offset".into(),
    };
    let disks: Vec<String> = [housekeeping.disk_1, housekeeping.disk_2]
        .into_iter()
        .flatten()
        .map(|used| format!("{used} %"))
        .collect();
    let link = match (housekeeping.tracking, housekeeping.sending) {
        (true, true) => "tracking",
        (false, true) => "not tracking",
        (_, false) => "not sending",
    };
    format!(
        "{}{} frames: {} fine, {} coarse, {} none | {offset} | {} stored, {} not; disks {} | {link}, {} sent",
        if housekeeping.simulated {
            "SIMULATED "
        } else {
            ""
        },
        housekeeping.taken,
        housekeeping.fine,
        housekeeping.coarse,
        housekeeping.none,
        housekeeping.stored,
        housekeeping.unstored,
        if disks.is_empty() {
            "none".into()
        } else {
            disks.join(", ")
        },
        housekeeping.solutions,
    )
}
