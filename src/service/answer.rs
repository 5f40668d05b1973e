//! What is said of a solved frame.

use super::messages::{Answer, Found, Hears, Recent, SolvedSun};
use super::shared::Shared;
use crate::aspect;
use crate::record::{Record, RollRecord, Row};
use crossbeam_channel::Sender;

impl Answer {
    /// What a frame of the plate shows.
    pub fn sun(&self) -> Option<&SolvedSun> {
        match &self.solved.found {
            Found::Sun(sun) => Some(sun),
            _ => None,
        }
    }

    /// What the logs tell of it, before its picture is stored.
    pub(super) fn row(&self) -> Row {
        let (info, solved) = (&self.exposure.frame.info, &*self.solved);
        let (utc, time) = (info.mid_exposure, solved.solve_time);
        let (mut record, stopped) = match &solved.found {
            Found::Sun(sun) => {
                let solution = &sun.solution;
                let record = Record::new("", utc, solution, sun.offset, Some(time));
                (record, solution.stopped.map(|stopped| stopped.stage))
            }
            Found::Nadir(solution) => (Record::of_horizon(utc, solution, time), None),
            Found::Moon(moon) => {
                let direction = moon.direction.as_ref();
                (Record::of_moon(utc, &moon.found, direction, time), None)
            }
            Found::Nothing => {
                let stopped = solved.stopped.map(|_| aspect::Stage::Levels);
                (
                    Record::unsolved(utc, solved.stopped.as_ref(), time),
                    stopped,
                )
            }
        };
        record.roll_deg = solved.roll.map(|roll| RollRecord::from(roll.deg));
        Row {
            quality: solved.quality,
            levels: solved.levels,
            stopped,
            ..Row::bare(info.number, record)
        }
    }
}

impl Hears for Shared<Recent> {
    fn hear(&self, answer: &Answer) {
        /// More than any camera takes between two packets.
        const MOST: usize = 1000;
        let mut recent = self.lock();
        recent.answer = Some(answer.clone());
        if recent.solve_times.len() < MOST {
            recent.solve_times.push(answer.solved.solve_time);
        }
    }
}

impl Hears for Sender<Answer> {
    fn hear(&self, answer: &Answer) {
        // A watcher that has left misses nothing that matters.
        let _ = self.send(answer.clone());
    }
}
