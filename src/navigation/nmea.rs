//! Fixes of a GPS receiver that speaks NMEA 0183: of each second a sentence GGA, with the height, and a sentence RMC, with date and speed.

use super::earth::{ecef_m, north_east_up};
use super::measurement::{Climb, Fix};
use crate::units::Place;
use jiff::Timestamp;
use nalgebra::Vector3;
use nmea::sentences::rmc::RmcStatusOfFix;
use nmea::sentences::{FixType, GgaData, RmcData};
use nmea::{ParseResult, parse_str};

/// A sentence has at most 82 characters; some receivers exceed that.
const LONGEST: usize = 200;
const KNOT_M_S: f64 = 1852.0 / 3600.0;
/// Slower than this a receiver stands.
const STANDS_M_S: f64 = 0.2;

/// The receiver's words, as they come.
#[derive(Debug, Default)]
pub struct Nmea {
    line: Vec<u8>,
    gga: Option<GgaData>,
    rmc: Option<RmcData>,
    counts: SentenceCounts,
}

/// What became of sentences.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct SentenceCounts {
    pub fixes: u64,
    /// Sentences by which the receiver says that it has no fix.
    pub without_fix: u64,
    /// Lines that are no sentence, or whose checksum is wrong.
    pub unreadable: u64,
}

/// A fix with its time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TimedFix {
    pub utc: Timestamp,
    pub place: Place,
    /// Level: towards north and east, m/s.
    pub north_m_s: f64,
    pub east_m_s: f64,
}

impl TimedFix {
    /// In ECEF, at a time of the filter's clock.
    pub fn fix(&self, t_s: f64) -> Fix {
        let position_m = ecef_m(&self.place);
        let level = Vector3::new(self.north_m_s, self.east_m_s, 0.0);
        Fix {
            t_s,
            position_m,
            velocity_m_s: north_east_up(&position_m) * level,
            climb: Climb::Unknown,
        }
    }
}

impl Nmea {
    /// Takes bytes in any pieces; the fixes that they complete.
    pub fn feed(&mut self, bytes: &[u8]) -> Vec<TimedFix> {
        let mut fixes = Vec::new();
        for byte in bytes {
            match byte {
                b'\n' => {
                    let line = std::mem::take(&mut self.line);
                    fixes.extend(self.take(line.trim_ascii()));
                }
                // What follows is not worth keeping: no sentence is so long.
                _ if self.line.len() > LONGEST => {}
                byte => self.line.push(*byte),
            }
        }
        fixes
    }

    pub fn counts(&self) -> SentenceCounts {
        self.counts
    }

    fn take(&mut self, line: &[u8]) -> Option<TimedFix> {
        if line.is_empty() {
            return None;
        }
        match str::from_utf8(line).ok().map(parse_str) {
            Some(Ok(ParseResult::GGA(gga))) => self.gga = Some(gga),
            Some(Ok(ParseResult::RMC(rmc))) => self.rmc = Some(rmc),
            // Good sentences of other kinds.
            Some(
                Ok(_)
                | Err(
                    nmea::Error::DisabledSentence
                    | nmea::Error::Unsupported(_)
                    | nmea::Error::Unknown(_),
                ),
            ) => {
                return None;
            }
            None | Some(Err(_)) => {
                self.counts.unreadable += 1;
                return None;
            }
        }
        let (gga, rmc) = (self.gga.as_ref()?, self.rmc.as_ref()?);
        if gga.fix_time != rmc.fix_time {
            return None;
        }
        let fix = timed_fix(gga, rmc);
        match fix {
            Some(_) => self.counts.fixes += 1,
            None => self.counts.without_fix += 1,
        }
        (self.gga, self.rmc) = (None, None);
        fix
    }
}

/// `None` where the receiver says that it has none, or a field is missing.
fn timed_fix(gga: &GgaData, rmc: &RmcData) -> Option<TimedFix> {
    let is_valid = rmc.status_of_fix != RmcStatusOfFix::Invalid
        && gga.fix_type.is_some_and(|kind| kind != FixType::Invalid);
    if !is_valid {
        return None;
    }
    // jiff knows no types of chrono; both write ISO 8601.
    let utc = format!("{}T{}Z", rmc.fix_date?, rmc.fix_time?);
    // GGA counts the height from the geoid.
    let height_m = f64::from(gga.altitude?) + f64::from(gga.geoid_separation.unwrap_or(0.0));
    let speed_m_s = f64::from(rmc.speed_over_ground?) * KNOT_M_S;
    // A receiver that stands tells no course.
    let course_deg = rmc
        .true_course
        .or((speed_m_s < STANDS_M_S).then_some(0.0))?;
    let course = f64::from(course_deg).to_radians();
    Some(TimedFix {
        utc: utc.parse().ok()?,
        place: Place::new(gga.latitude?, gga.longitude?, height_m).ok()?,
        north_m_s: speed_m_s * course.cos(),
        east_m_s: speed_m_s * course.sin(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// As gpsd's documentation of NMEA has them; the sums are those of the standard.
    const GGA: &str = "$GPGGA,123519.50,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,*71\r\n";
    const RMC: &str = "$GPRMC,123519.50,A,4807.038,N,01131.000,E,022.4,084.4,230324,003.1,W*79\r\n";

    fn summed(body: &str) -> String {
        let sum = body.bytes().fold(0, |sum, byte| sum ^ byte);
        format!("${body}*{sum:02X}\r\n")
    }

    #[test]
    fn two_sentences_of_a_second_make_a_fix_in_whatever_pieces_they_come() {
        let text = [GGA, RMC].concat();
        let (gga, rmc) = (
            &text[1..text.find('*').unwrap()],
            &RMC[1..RMC.find('*').unwrap()],
        );
        let text = [summed(gga), summed(rmc)].concat();
        for pieces in [1, 7, 500] {
            let mut receiver = Nmea::default();
            let fixes: Vec<_> = text
                .as_bytes()
                .chunks(pieces)
                .flat_map(|piece| receiver.feed(piece))
                .collect();
            let [fix] = fixes.as_slice() else {
                panic!("{fixes:?}");
            };
            assert_eq!(fix.utc.to_string(), "2024-03-23T12:35:19.5Z");
            assert!((fix.place.latitude_deg - 48.1173).abs() < 1e-6);
            assert!((fix.place.longitude_deg - 11.516_666_7).abs() < 1e-6);
            assert!((fix.place.height_m - 592.3).abs() < 1e-3);
            // 22.4 knots, 84.4 deg from north towards east.
            assert!((fix.east_m_s - 11.4686).abs() < 1e-3, "{}", fix.east_m_s);
            assert!((fix.north_m_s - 1.1245).abs() < 1e-3, "{}", fix.north_m_s);
        }
    }

    #[test]
    fn what_is_no_fix_is_counted_and_what_is_noise_too() {
        let mut receiver = Nmea::default();
        let lost = [
            summed("GPGGA,123519.00,,,,,0,00,,,M,,M,,"),
            summed("GPRMC,123519.00,V,,,,,,,230324,,,N"),
        ];
        assert!(receiver.feed(lost.concat().as_bytes()).is_empty());
        assert_eq!(receiver.counts().without_fix, 1);
        let broken = RMC.replace("022.4", "922.4");
        assert!(receiver.feed(broken.as_bytes()).is_empty());
        assert!(receiver.feed(&[0xFF; 10_000]).is_empty());
        assert!(receiver.feed(b"\r\n").is_empty());
        assert_eq!(receiver.counts().unreadable, 2);
        // Another kind of sentence is none of ours.
        receiver.feed(summed("GPVTG,084.4,T,087.5,M,022.4,N,041.5,K").as_bytes());
        assert_eq!(receiver.counts().unreadable, 2);
    }
}
