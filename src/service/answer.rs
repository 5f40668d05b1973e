//! A solved frame, and what of it waits for the next housekeeping.

use super::flight::Station;
use crate::archive::{Record, Row};
use crate::aspect::Solution;
use crate::camera::Exposure;
use crate::pointing::{Offset, Target};
use std::sync::Arc;
use std::time::Duration;

/// A solved frame.
#[derive(Debug, Clone)]
pub struct Answer {
    /// Of the camera that took the frame.
    pub station: Arc<Station>,
    pub exposure: Arc<Exposure>,
    pub solution: Arc<Solution>,
    /// From `target`.
    pub offset: Option<Offset>,
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
        let record = Record::new("", info.mid_exposure, solution, self.offset, solve_time);
        Row::new(info.number, solution, record)
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
