//! Counts of the GPS receiver's data by kind; unusable data are logged at their 1st, 2nd, 4th, 8th ... time.

use super::rows::gps_row;
use super::{Filter, Navigator};
use crate::log::worth_a_line;
use crate::navigation::nmea::{Received, Refusal, Refused, TimedFix};
use crate::navigation::{Fix, Measurement};
use crate::service::messages::NavigationLog;
use crate::service::tally::NavigationTally;
use crate::units::Place;

/// Largest difference of a fix's time from the IMU's; beyond it the fix is of another day, or stale.
const FIX_WITHIN_S: f64 = 3.0;

impl Navigator {
    /// Makes the place of frames follow the receiver; `false` if the fix is a jump, which is not passed to the filter either.
    pub(super) fn follow(&self, fix: &TimedFix) -> bool {
        let follows = self.controls.follow(fix.place);
        if !follows {
            let Place {
                latitude_deg,
                longitude_deg,
                ..
            } = fix.place;
            let why = format!("latitude {latitude_deg:.4}, longitude {longitude_deg:.4} deg");
            self.tally.lock().refuse_fix(Refusal::Jump, why);
        }
        follows
    }
}

impl Filter<'_> {
    pub(super) fn fix(&mut self, timed: &TimedFix) {
        if self.last_fix.replace(timed.utc) == Some(timed.utc) {
            // A receiver that repeats its fix adds nothing.
            let why = timed.utc.to_string();
            return self.nav.tally.lock().refuse_fix(Refusal::Repeated, why);
        }
        let t_s = self.since_epoch_s(timed.utc) - self.nav.settings.gps.delay_s;
        let fix = timed.fix(t_s);
        let off_s = self.live.newest_s().map(|newest_s| t_s - newest_s);
        if let Some(off_s) = off_s.filter(|off_s| off_s.abs() > FIX_WITHIN_S) {
            let why = format!("{}, {off_s:+.1} s from the IMU's clock", timed.utc);
            return self.nav.tally.lock().refuse_fix(Refusal::OutOfTime, why);
        }
        let motion = self.live.now().and_then(|row| row.attitude);
        self.targets.note(Fix {
            // A jump of the fix does not change the Sun's direction.
            position_m: motion.map_or(fix.position_m, |(motion, _)| motion.position_m),
            ..fix
        });
        self.live.measure(Measurement::Fix(fix));
        self.queue_row(NavigationLog::Gps, gps_row(timed.utc, &fix));
    }
}

impl NavigationTally {
    /// Counts the GPS receiver's data, and logs unusable ones.
    pub(super) fn note_gps(&mut self, sentence: &Received) {
        let count = self.gps.note(sentence);
        if !worth_a_line(count) {
            return;
        }
        match sentence {
            Received::Fix(_) => {}
            Received::Refused(why) => tracing::warn!(count, %why, "a GPS fix is not used"),
            Received::Unreadable(why) => {
                tracing::warn!(count, %why, "a sentence of the GPS receiver cannot be read");
            }
        }
    }

    /// Counts and logs a fix that is inconsistent with earlier ones.
    pub(super) fn refuse_fix(&mut self, refusal: Refusal, why: String) {
        self.note_gps(&Received::Refused(Refused::new(refusal, why)));
    }

    /// Notes the total number of the GPS receiver's bytes that were part of no sentence, and logs it each time it has doubled.
    pub(super) fn note_gps_noise(&mut self, bytes: u64) {
        let before = std::mem::replace(&mut self.gps.noise_bytes, bytes);
        if before.checked_ilog2() != bytes.checked_ilog2() {
            tracing::warn!(
                bytes,
                "bytes of the GPS receiver are no sentence of NMEA 0183"
            );
        }
    }
}
