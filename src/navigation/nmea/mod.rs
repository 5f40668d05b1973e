//! Fixes of a GPS receiver with NMEA 0183 output: for each time a sentence GGA, with position and height, and a sentence
//! RMC, with date and velocity. A receiver without RMC gives fixes without velocity, dated by its ZDA or by the clock.

mod judge;
mod sentence;

pub use judge::{Refusal, Refused};
pub use sentence::{Unreadable, summed};

use super::measurement::{Climb, Fix};
use crate::geometry::earth::{ecef_m, north_east_up};
use crate::units::Place;
use jiff::Timestamp;
use judge::Said;
use nalgebra::Vector3;
use sentence::{Framer, Piece, Sentence, TimeOfDay};
use std::fmt;

/// A fix with its time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TimedFix {
    pub utc: Timestamp,
    pub place: Place,
    /// Horizontal velocity towards north and east, m/s. `None` if the receiver gives no velocity, or a speed without a
    /// course.
    pub level_m_s: Option<[f64; 2]>,
}

impl TimedFix {
    /// The fix in ECEF, with the time of the filter's clock.
    pub fn fix(&self, t_s: f64) -> Fix {
        let position_m = ecef_m(&self.place);
        let level =
            |[north, east]: [f64; 2]| north_east_up(&position_m) * Vector3::new(north, east, 0.0);
        Fix {
            t_s,
            position_m,
            velocity_m_s: self.level_m_s.map(level),
            climb: Climb::Unknown,
        }
    }
}

/// Result of parsing a receiver's bytes.
#[derive(Debug, Clone, PartialEq)]
pub enum Received {
    Fix(TimedFix),
    Refused(Refused),
    Unreadable(Unreadable),
}

/// Counts of a receiver's bytes.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct GpsCounts {
    pub fixes: u64,
    /// Rejected fixes, in the order of [`Refusal::ALL`].
    refused: [u64; Refusal::ALL.len()],
    /// Sentences that are truncated, or have a wrong checksum or invalid fields.
    pub unreadable: u64,
    /// Bytes outside any sentence.
    pub noise_bytes: u64,
}

impl GpsCounts {
    /// Counts a result; returns the count of its kind.
    pub fn note(&mut self, heard: &Received) -> u64 {
        let count = match heard {
            Received::Fix(_) => &mut self.fixes,
            Received::Refused(refused) => &mut self.refused[refused.refusal as usize],
            Received::Unreadable(_) => &mut self.unreadable,
        };
        *count += 1;
        *count
    }

    pub fn refused(&self, refusal: Refusal) -> u64 {
        self.refused[refusal as usize]
    }

    /// The kinds of rejected fixes, with their counts.
    pub fn refusals(&self) -> impl Iterator<Item = (Refusal, u64)> {
        let counts = Refusal::ALL.into_iter().zip(self.refused);
        counts.filter(|(_, count)| *count > 0)
    }
}

/// Rejected sentences, by kind.
impl fmt::Display for GpsCounts {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let kinds = self.refusals();
        let kinds = kinds.map(|(refusal, count)| format!("{count} {}", refusal.name()));
        let kinds: Vec<String> = kinds.collect();
        match kinds.is_empty() {
            true => write!(out, "none refused"),
            false => write!(out, "refused: {}", kinds.join(", ")),
        }
    }
}

/// Parser of the receiver's sentences.
#[derive(Debug, Default)]
pub struct Nmea {
    framer: Framer,
    /// Sentences of the latest time, until they are combined to a fix.
    said: Said,
    time: Option<TimeOfDay>,
}

impl Nmea {
    /// Takes bytes in pieces of any size; returns the completed results. `now` is the flight's time.
    pub fn feed(&mut self, bytes: &[u8], now: Timestamp) -> Vec<Received> {
        let mut heard = Vec::new();
        for byte in bytes {
            match self.framer.push(*byte) {
                Some(Piece::Sentence(text)) => self.take(&text, now, &mut heard),
                Some(Piece::Unreadable(why)) => heard.push(Received::Unreadable(why)),
                None => {}
            }
        }
        heard
    }

    /// Number of bytes outside any sentence.
    pub fn noise_bytes(&self) -> u64 {
        self.framer.noise_bytes()
    }

    fn take(&mut self, text: &str, now: Timestamp, heard: &mut Vec<Received>) {
        match Sentence::parse(text) {
            Ok(Sentence::Gga(gga)) => {
                self.turn_to(gga.time, self.said.gga == Some(gga), now, heard);
                self.said.gga = Some(gga);
            }
            Ok(Sentence::Rmc(rmc)) => {
                self.turn_to(rmc.time, self.said.rmc == Some(rmc), now, heard);
                self.said.rmc = Some(rmc);
            }
            Ok(Sentence::Zda(zda)) => {
                self.turn_to(zda.time, false, now, heard);
                self.said.zda = Some(zda);
            }
            Ok(Sentence::Other) => return,
            Err(why) => return heard.push(Received::Unreadable(why)),
        }
        if self.said.gga.is_some() && self.said.rmc.is_some() {
            self.finish(now, heard);
        }
    }

    /// Begins a new time: the data of the previous one are complete. This also applies if a hanging receiver repeats a
    /// time.
    fn turn_to(
        &mut self,
        time: Option<TimeOfDay>,
        is_said_again: bool,
        now: Timestamp,
        heard: &mut Vec<Received>,
    ) {
        if self.time != time || time.is_none() || is_said_again {
            self.finish(now, heard);
            self.time = time;
        }
    }

    fn finish(&mut self, now: Timestamp, heard: &mut Vec<Received>) {
        let said = std::mem::take(&mut self.said);
        if said.gga.is_some() || said.rmc.is_some() {
            heard.push(match said.judge(now) {
                Ok(fix) => Received::Fix(fix),
                Err(refused) => Received::Refused(refused),
            });
        }
    }
}

#[cfg(test)]
mod tests;
