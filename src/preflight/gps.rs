//! Check of the GPS receiver: whether it has a fix that the flight would use.

use super::Finding;
use super::bounded::within;
use crate::clock::FlightClock;
use crate::link::{LocalEnd, PortAddress, PortError};
use crate::navigation::nmea::{GpsCounts, Nmea, Received, Refusal, Refused, TimedFix};
use crate::plan::Plan;
use crate::sky::sphere::{direction, separation_rad};
use crate::units::Place;
use std::time::{Duration, Instant};

/// How long the receiver is observed, besides the time to open its port.
const GPS: Duration = Duration::from_secs(5);
const TIMEOUT: Duration = Duration::from_secs(10);
/// Difference from the configured site beyond which a fix belongs to another site.
const FAR_DEG: f64 = 1.0;

const GPS_PORT: &str =
    "is the receiver on, is navigation.gps_port its line and navigation.gps_baud its speed?";

pub(super) fn check(plan: &Plan) -> Finding {
    let address = plan.navigation.as_ref().and_then(|one| one.gps.clone());
    let Some(address) = address else {
        let found = "no receiver: the filter never begins";
        return Finding::fail("gps", found, "set navigation.gps_port");
    };
    let baud = plan.config.navigation.gps_baud;
    let clock = plan.clock;
    let tried = within(TIMEOUT + GPS, move || read_gps(&address, baud, clock));
    match tried {
        Ok(Ok(receiver)) => receiver.judge(plan.config.site.place()),
        Ok(Err(error)) => Finding::fail("gps", error.to_string(), GPS_PORT),
        Err(no_answer) => Finding::fail("gps", no_answer.to_string(), GPS_PORT),
    }
}

/// Data of the receiver until the first fix.
#[derive(Debug, Default)]
struct Receiver {
    fix: Option<TimedFix>,
    counts: GpsCounts,
    /// The last unusable fix, and the last unreadable sentence.
    refused: Option<Refused>,
    unreadable: Option<String>,
}

/// Listens until the first fix.
fn read_gps(address: &PortAddress, baud: u32, clock: FlightClock) -> Result<Receiver, PortError> {
    let mut port = address.open(baud, LocalEnd::default())?;
    let (mut sentences, mut receiver) = (Nmea::default(), Receiver::default());
    let mut buffer = [0; 2048];
    let start = Instant::now();
    while start.elapsed() < GPS && receiver.fix.is_none() {
        let count = port.read(&mut buffer, Duration::from_millis(100))?;
        for sentence in sentences.feed(&buffer[..count], clock.now()) {
            receiver.note(sentence);
        }
    }
    receiver.counts.noise_bytes = sentences.noise_bytes();
    Ok(receiver)
}

impl Receiver {
    fn note(&mut self, sentence: Received) {
        self.counts.note(&sentence);
        match sentence {
            Received::Fix(fix) => self.fix = self.fix.or(Some(fix)),
            Received::Refused(refused) => self.refused = Some(refused),
            Received::Unreadable(why) => self.unreadable = Some(why.to_string()),
        }
    }

    fn judge(&self, site: Option<Place>) -> Finding {
        if let Some(fix) = &self.fix {
            return place(site, fix);
        }
        let (counts, seconds) = (&self.counts, GPS.as_secs_f64());
        let lines = format!(
            "{} sentences and {} bytes unreadable",
            counts.unreadable, counts.noise_bytes
        );
        match (&self.refused, &self.unreadable) {
            (Some(last), _) => {
                let found =
                    format!("no fix in {seconds:.0} s; {counts}, the last one {last}; {lines}");
                match remedy(last.refusal) {
                    Some(remedy) => Finding::fail("gps", found, remedy),
                    None => Finding::warn("gps", found, "give its antenna the sky"),
                }
            }
            (None, Some(last)) => {
                let found = format!("no fix in {seconds:.0} s; {lines}, the last one {last}");
                Finding::fail("gps", found, GPS_PORT)
            }
            (None, None) => Finding::fail(
                "gps",
                format!("no fix in {seconds:.0} s; {lines}"),
                GPS_PORT,
            ),
        }
    }
}

/// Remedy for fixes that would not be used in flight; `None` if the receiver only has to wait for satellites.
fn remedy(refusal: Refusal) -> Option<&'static str> {
    match refusal {
        Refusal::NoFix | Refusal::Estimated => None,
        Refusal::Manual | Refusal::Simulated => {
            Some("have the receiver measure: it is set to a place of its own")
        }
        Refusal::Incomplete => Some("have the receiver send GGA and RMC"),
        Refusal::WeekRollover => Some(
            "the receiver's firmware is too old for today: update it, or take another receiver",
        ),
        Refusal::AnotherDay => Some("set this computer's clock, or reset the receiver"),
        Refusal::Nowhere | Refusal::Impossible => Some("reset the receiver"),
        Refusal::Jump | Refusal::Repeated | Refusal::OutOfTime => Some(GPS_PORT),
    }
}

fn place(site: Option<Place>, fix: &TimedFix) -> Finding {
    let place = fix.place;
    let found = format!(
        "latitude {:.5}, longitude {:.5} deg, height {:.0} m at {}",
        place.latitude_deg, place.longitude_deg, place.height_m, fix.utc
    );
    let on_sphere = |longitude_deg, latitude_deg| direction(longitude_deg, latitude_deg);
    let away_deg = site.map(|site| {
        let here = on_sphere(place.longitude_deg, place.latitude_deg);
        let there = on_sphere(site.longitude_deg, site.latitude_deg);
        separation_rad(&here, &there).to_degrees()
    });
    match away_deg.filter(|away_deg| *away_deg > FAR_DEG) {
        Some(away_deg) => {
            let found = format!("{found}: {away_deg:.1} deg from [site]");
            Finding::warn("gps", found, "set [site] to where the flight begins")
        }
        None => Finding::pass("gps", found),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::preflight::Verdict;

    const CLOCK: &str = "2026-11-25T14:28:16Z";

    /// Finding for a receiver that sends GGA with a quality and a place, and RMC with a date.
    fn found(quality: &str, place: &str, date: &str) -> Finding {
        let summed = |body: String| {
            let sum = body.bytes().fold(0, |sum, byte| sum ^ byte);
            format!("${body}*{sum:02X}\r\n")
        };
        let text = summed(format!(
            "GNGGA,142816.00,{place},{quality},12,0.8,38405.0,M,-24.0,M,,"
        )) + &summed(format!("GNRMC,142816.00,A,{place},0.005,,{date},,,A"));
        let (mut sentences, mut receiver) = (Nmea::default(), Receiver::default());
        let read = sentences.feed(text.as_bytes(), CLOCK.parse().unwrap());
        read.into_iter().for_each(|one| receiver.note(one));
        receiver.judge(Some(Place::new(34.49, -104.2218, 1200.0).unwrap()))
    }

    #[test]
    fn a_receiver_passes_only_with_a_fix_that_the_flight_would_use() {
        const HERE: &str = "3429.40000,N,10413.30800,W";
        const NOWHERE: &str = "0000.00000,N,00000.00000,E";
        for (quality, place, date, verdict, words) in [
            ("1", HERE, "251126", Verdict::Pass, "latitude 34.49"),
            ("0", HERE, "251126", Verdict::Warn, "no fix"),
            ("6", HERE, "251126", Verdict::Warn, "estimated"),
            ("7", HERE, "251126", Verdict::Fail, "manual input"),
            ("8", HERE, "251126", Verdict::Fail, "simulator"),
            ("1", HERE, "110407", Verdict::Fail, "1024 weeks"),
            ("1", HERE, "241126", Verdict::Fail, "another day"),
            ("1", NOWHERE, "251126", Verdict::Fail, "no place"),
        ] {
            let finding = found(quality, place, date);
            assert_eq!(finding.verdict, verdict, "{finding:?}");
            assert!(finding.found.contains(words), "{finding:?} lacks {words}");
        }
    }
}
