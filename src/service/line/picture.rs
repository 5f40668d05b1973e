//! A picture on its way to the ground: it takes half of the line's capacity, and gives way to everything else.

use crate::link::packet::TELEMETRY_HEADER;
use crate::link::{Picture, TelemetryPacket};
use std::time::{Duration, Instant};

/// Fraction of the line's capacity that pictures take.
const SHARE: f64 = 0.5;
/// Bits per byte on the line, with start and stop bit.
const BITS: f64 = 10.0;
/// Largest part of its share that a picture makes up for after a pause.
const ARREARS: Duration = Duration::from_millis(20);
/// How long other packets may have to wait for parts already written, beyond the one that must be finished.
const AHEAD: Duration = Duration::from_millis(5);

/// The picture that is being sent.
pub(super) struct PictureUnderWay {
    picture: Box<Picture>,
    next_part: usize,
    pace: Pace,
}

impl PictureUnderWay {
    pub fn new(picture: Box<Picture>, now: Instant) -> Self {
        Self {
            picture,
            next_part: 0,
            pace: Pace { due: now },
        }
    }

    /// Whether all of it has been sent.
    pub fn is_complete(&self) -> bool {
        self.next_part >= self.picture.parts()
    }

    /// The next part, if it is due and the `backlog` (bytes that the system has not passed on) leaves space for it.
    pub fn next_due(&mut self, baud: u32, backlog: usize, now: Instant) -> Option<TelemetryPacket> {
        if !self.pace.is_due(now) {
            return None;
        }
        let part = self.picture.part(self.next_part)?;
        let bytes = TELEMETRY_HEADER + part.payload().len();
        if backlog > 0 && time_on_line(backlog + bytes, baud) > AHEAD {
            return None;
        }
        self.next_part += 1;
        self.pace.note(bytes, baud, now);
        Some(part)
    }
}

/// Time at which the next part is due.
struct Pace {
    due: Instant,
}

impl Pace {
    fn is_due(&self, now: Instant) -> bool {
        now >= self.due
    }

    /// A part was sent: the next one is due after its share of the line's time, counted from when this one was due,
    /// so that long turns of the thread do not slow the picture down.
    fn note(&mut self, bytes: usize, baud: u32, now: Instant) {
        let earliest = now.checked_sub(ARREARS).unwrap_or(self.due);
        self.due = self.due.max(earliest) + time_on_line(bytes, baud).div_f64(SHARE);
    }
}

fn time_on_line(bytes: usize, baud: u32) -> Duration {
    Duration::from_secs_f64(BITS * bytes as f64 / f64::from(baud))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Size of a part, bytes.
    const PART: usize = 124;

    /// Rate of sending, bytes/s, if the thread takes its turn at these times and the system passes bytes on at once.
    fn rate(baud: u32, turns: impl Iterator<Item = Duration>) -> f64 {
        let start = Instant::now();
        let mut pace = Pace { due: start };
        let (mut bytes, mut last) = (0, Duration::ZERO);
        for turn in turns {
            while pace.is_due(start + turn) {
                pace.note(PART, baud, start + turn);
                bytes += PART;
            }
            last = turn;
        }
        bytes as f64 / last.as_secs_f64()
    }

    #[test]
    fn a_picture_takes_half_of_the_line_at_any_speed_and_length_of_turns() {
        for baud in [9600, 115_200, 2_000_000, 4_000_000] {
            let half = f64::from(baud) / 20.0;
            for microseconds in [100, 1100, 4700, 12_000] {
                let turns = (0..100_000_000 / microseconds)
                    .map(|turn| Duration::from_micros(turn * microseconds));
                let rate = rate(baud, turns);
                assert!(
                    (rate / half - 1.0).abs() < 0.01,
                    "{rate} of {half} bytes/s at {baud} baud, turns of {microseconds} us"
                );
            }
        }
    }

    #[test]
    fn a_pause_is_not_made_up_for_by_a_burst() {
        let start = Instant::now();
        let mut pace = Pace { due: start };
        let late = start + Duration::from_secs(60);
        let mut bytes = 0;
        while pace.is_due(late) {
            pace.note(PART, 2_000_000, late);
            bytes += PART;
        }
        let most = 2_000_000.0 / 20.0 * ARREARS.as_secs_f64();
        assert!((bytes as f64) < most + 2.0 * PART as f64, "{bytes}");
    }

    #[test]
    fn a_part_waits_for_what_the_system_has_not_passed_on() {
        use crate::frame::{Frame, FrameInfo, Pixels};
        let pixels = Pixels::U8(vec![0; 1000]);
        let frame = Frame::new(50, 20, pixels, 255, FrameInfo::default()).unwrap();
        let time = jiff::Timestamp::from_second(1).unwrap();
        let picture = Picture::new(&frame, 1, vec![], time).unwrap().unwrap();
        let now = Instant::now();
        let mut under_way = PictureUnderWay::new(Box::new(picture), now);
        assert!(under_way.next_due(115_200, 1, now).is_none(), "11 ms");
        assert!(under_way.next_due(2_000_000, 2000, now).is_none(), "10 ms");
        assert!(under_way.next_due(2_000_000, 500, now).is_some(), "3 ms");
        for second in 1..10 {
            assert!(!under_way.is_complete());
            let later = now + Duration::from_secs(second);
            assert!(under_way.next_due(115_200, 0, later).is_some());
        }
        assert!(under_way.is_complete());
    }
}
