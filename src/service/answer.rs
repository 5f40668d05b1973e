//! A solved frame, and what of it waits for the next housekeeping.

use super::flight::Station;
use crate::archive::{Record, RollRecord, Row};
use crate::aspect::{Quality, Solution};
use crate::camera::Exposure;
use crate::horizon;
use crate::pointing::{Offset, Target};
use crate::units::Measured;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// A solved frame.
#[derive(Debug, Clone)]
pub struct Answer {
    /// Of the camera that took the frame.
    pub station: Arc<Station>,
    pub exposure: Arc<Exposure>,
    pub solution: Arc<Solution>,
    /// From `target`.
    pub offset: Option<Offset>,
    /// Of a roll camera that looks at the horizon.
    pub horizon: Option<Arc<horizon::Solution>>,
    /// The body's, deg: by this frame of the horizon, or by the one nearest to this frame of the Sun.
    pub roll_deg: Option<Measured>,
    /// When that frame of the horizon was there.
    pub roll_arrived: Option<Instant>,
    pub target: Target,
    pub solve_time: Duration,
    /// Whether the picture goes to the archive; the row always does.
    pub to_be_stored: bool,
}

impl Answer {
    /// What the logs tell of it, before its picture is stored.
    pub(super) fn row(&self) -> Row {
        let info = &self.exposure.frame.info;
        let solution = &self.solution;
        let solve_time = Some(self.solve_time);
        let mut record = match &self.horizon {
            Some(horizon) => {
                Record::of_horizon(info.mid_exposure, horizon, self.roll_deg, self.solve_time)
            }
            None => Record::new("", info.mid_exposure, solution, self.offset, solve_time),
        };
        record.roll_deg = self.roll_deg.map(RollRecord::from);
        let row = Row::new(info.number, solution, record);
        match &self.horizon {
            Some(horizon) => Row {
                quality: quality(horizon.quality()),
                ..row
            },
            None => row,
        }
    }
}

fn quality(horizon: horizon::Quality) -> Quality {
    match horizon {
        horizon::Quality::Fine => Quality::Fine,
        horizon::Quality::Coarse => Quality::Coarse,
        horizon::Quality::None => Quality::None,
    }
}

/// What the solver of the sending camera leaves for the next packet.
#[derive(Debug, Default)]
pub(super) struct Recent {
    pub answer: Option<Answer>,
    /// Of the frames since the last packet.
    pub solve_times: Vec<Duration>,
}

impl Recent {
    pub fn note(&mut self, answer: &Answer) {
        /// More than any camera takes between two packets.
        const MOST: usize = 1000;
        self.answer = Some(answer.clone());
        if self.solve_times.len() < MOST {
            self.solve_times.push(answer.solve_time);
        }
    }
}
