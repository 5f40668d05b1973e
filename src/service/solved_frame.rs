//! A solved frame: its row of the logs, and its result in words.

use super::messages::{Found, ReceivesFrames, Recent, Solved, SolvedFrame, SolvedSun};
use super::shared::Shared;
use crate::aspect;
use crate::record::{LoggedRow, Record, RollRecord};
use crossbeam_channel::Sender;

impl SolvedFrame {
    /// Result of a frame of the plate.
    pub fn sun(&self) -> Option<&SolvedSun> {
        match &self.solved.found {
            Found::Sun(sun) => Some(sun),
            _ => None,
        }
    }

    /// Its row of the logs, before its picture is stored.
    pub(super) fn row(&self) -> LoggedRow {
        let (info, solved) = (&self.exposure.frame.info, &*self.solved);
        let (utc, time) = (info.mid_exposure, solved.solve_time);
        let row = match &solved.found {
            Found::Sun(sun) => {
                let record = Record::new("", utc, &sun.solution, sun.offset, Some(time));
                LoggedRow::new(info.number, &sun.solution, record)
            }
            Found::Nadir(solution) => {
                LoggedRow::bare(info.number, Record::of_horizon(utc, solution, time))
            }
            Found::Moon(moon) => {
                let record = Record::of_moon(utc, &moon.found, moon.direction.as_ref(), time);
                LoggedRow::bare(info.number, record)
            }
            Found::Nothing => {
                let record = Record::unsolved(utc, solved.stopped.as_ref(), time);
                LoggedRow {
                    stopped: solved.stopped.map(|_| aspect::Stage::Levels),
                    ..LoggedRow::bare(info.number, record)
                }
            }
        };
        LoggedRow {
            quality: solved.quality,
            levels: solved.levels,
            record: Record {
                roll_deg: solved.roll.map(|roll| RollRecord::from(roll.deg)),
                ..row.record
            },
            ..row
        }
    }
}

impl ReceivesFrames for Shared<Recent> {
    fn receive(&self, frame: &SolvedFrame) {
        /// Number of solve times kept: more frames than any camera takes between two packets.
        const MOST: usize = 1000;
        let mut recent = self.lock();
        recent.frame = Some(frame.clone());
        if recent.solve_times.len() < MOST {
            recent.solve_times.push(frame.solved.solve_time);
        }
    }
}

impl ReceivesFrames for Sender<SolvedFrame> {
    fn receive(&self, frame: &SolvedFrame) {
        // A receiver that has left needs no frame.
        let _ = self.send(frame.clone());
    }
}

impl Solved {
    /// Result of a frame, in words; `None` if it shows nothing.
    pub fn in_words(&self) -> Option<String> {
        match &self.found {
            Found::Sun(sun) => sun_in_words(sun),
            Found::Nadir(solution) => {
                let roll = self.roll?.deg;
                let (agreeing, places) = (solution.agreeing(), solution.places);
                Some(format!(
                    "roll {:.3} +- {:.3} deg, {agreeing} of {places} places of the limb",
                    roll.value, roll.sigma
                ))
            }
            Found::Moon(moon) => {
                let disc = moon.found.as_ref().ok()?;
                let (centre, [x, y]) = (disc.centre.position, disc.centre.sigma());
                Some(format!(
                    "centre at {:.2}, {:.2} px (+- {x:.2}, {y:.2}), radius {:.2} px, {:.0} % lit",
                    centre.x,
                    centre.y,
                    disc.radius_px.value,
                    100.0 * disc.lit().value
                ))
            }
            Found::Nothing => None,
        }
    }
}

fn sun_in_words(sun: &SolvedSun) -> Option<String> {
    let plate = sun.solution.aspect.as_ref()?.sun_plate;
    let ([sx, sy], at) = (plate.sigma(), plate.position);
    let sigma_arcsec = sun.instrument.optics.arcsec_per_mil() * (0.5 * (sx * sx + sy * sy)).sqrt();
    let offset = match sun.offset {
        Some(offset) => format!(
            "offset {:.4}, {:.4} deg",
            offset.azimuth_deg, offset.elevation_deg
        ),
        None => "no offset: time, place or ephemeris is missing".into(),
    };
    Some(format!(
        "the Sun at {:.1}, {:.1} mil, 1 sigma {sigma_arcsec:.2} arcsec, {} marks; {offset}",
        at.x,
        at.y,
        sun.solution.marks.len()
    ))
}
