//! A solved frame, and what of it waits for the next housekeeping.

use super::flight::Station;
use crate::aspect::{Quality, Solution};
use crate::camera::Exposure;
use crate::geometry::attitude::Direction;
use crate::horizon;
use crate::moon::{self, Disc, Stopped};
use crate::pointing::{Offset, Target};
use crate::record::{Record, RollRecord, Row};
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
    /// Of a Moon camera.
    pub moon: Option<Arc<SolvedMoon>>,
    /// The body's, deg: by this frame of the horizon, or by the one nearest to this frame of the Sun.
    pub roll_deg: Option<Measured>,
    /// When that frame of the horizon was there.
    pub roll_arrived: Option<Instant>,
    pub target: Target,
    pub solve_time: Duration,
    /// Whether the picture goes to the archive; the row always does.
    pub to_be_stored: bool,
}

/// What a frame of the Moon camera shows.
#[derive(Debug, Clone, PartialEq)]
pub struct SolvedMoon {
    pub found: Result<Disc, Stopped>,
    /// In the camera's axes.
    pub direction: Option<Direction>,
}

impl Answer {
    /// What the logs tell of it, before its picture is stored.
    pub(super) fn row(&self) -> Row {
        let info = &self.exposure.frame.info;
        let solution = &self.solution;
        let solve_time = Some(self.solve_time);
        let utc = info.mid_exposure;
        let mut record = match (&self.horizon, &self.moon) {
            (Some(horizon), _) => Record::of_horizon(utc, horizon, self.roll_deg, self.solve_time),
            (_, Some(moon)) => {
                Record::of_moon(utc, &moon.found, moon.direction.as_ref(), self.solve_time)
            }
            _ => Record::new("", utc, solution, self.offset, solve_time),
        };
        record.roll_deg = self.roll_deg.map(RollRecord::from);
        let row = Row::new(info.number, solution, record);
        let quality = match (&self.horizon, &self.moon) {
            (Some(horizon), _) => quality(horizon.quality()),
            (_, Some(moon)) => moon.quality(),
            _ => row.quality,
        };
        Row { quality, ..row }
    }
}

impl SolvedMoon {
    fn quality(&self) -> Quality {
        match self.found.as_ref().map(|disc| disc.quality) {
            Ok(moon::Quality::Fine) => Quality::Fine,
            Ok(moon::Quality::Coarse) => Quality::Coarse,
            Err(_) => Quality::None,
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
