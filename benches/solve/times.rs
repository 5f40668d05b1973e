//! Time of a frame, compared with that of copying it.

use crate::flight::{Exposure, Flight};
use solaspect::aspect;
use solaspect::frame::Pixels;
use std::fmt;
use std::hint::black_box;
use std::time::{Duration, Instant};

/// Number of passes over all frames, of which the fastest counts: the others were disturbed by other load on the machine.
const PASSES: usize = 25;

/// Time of a frame.
pub struct Times {
    copying: Duration,
    acquiring: Duration,
    tracking: Duration,
}

/// Each pass runs one task on all frames in turn, so that no task finds its frame in a cache filled by another one.
pub fn measure(flight: &Flight) -> Times {
    let mut copy = flight.exposures.first().map(|e| e.frame.pixels().clone());
    let mut works: [Vec<Duration>; 3] = Default::default();
    for _ in 0..PASSES {
        let times = [
            per_frame(flight, |exposure| copy_out(exposure, &mut copy)),
            per_frame(flight, |exposure| solve(flight, exposure, None)),
            per_frame(flight, |exposure| {
                solve(flight, exposure, Some(&exposure.prior))
            }),
        ];
        works
            .iter_mut()
            .zip(times)
            .for_each(|(all, time)| all.push(time));
    }
    let [copying, acquiring, tracking] =
        works.map(|times| times.into_iter().min().unwrap_or_default());
    Times {
        copying,
        acquiring,
        tracking,
    }
}

fn per_frame(flight: &Flight, mut work: impl FnMut(&Exposure)) -> Duration {
    let start = Instant::now();
    flight.exposures.iter().for_each(&mut work);
    start.elapsed() / flight.exposures.len() as u32
}

fn solve(flight: &Flight, exposure: &Exposure, prior: Option<&aspect::Track>) {
    let solution = aspect::solve(&exposure.frame, &flight.instrument, flight.expected, prior);
    black_box(solution);
}

fn copy_out(exposure: &Exposure, copy: &mut Option<Pixels>) {
    match (exposure.frame.pixels(), copy.as_mut()) {
        (Pixels::U8(from), Some(Pixels::U8(to))) => to.copy_from_slice(from),
        (Pixels::U16(from), Some(Pixels::U16(to))) => to.copy_from_slice(from),
        _ => unreachable!("the frames of a flight are of one depth"),
    }
    black_box(copy);
}

impl fmt::Display for Times {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let us = |time: Duration| time.as_secs_f64() * 1e6;
        let copying = us(self.copying);
        write!(out, "{copying:>12.0}")?;
        for time in [self.acquiring, self.tracking] {
            write!(out, "{:>12.0} = {:>4.1} x", us(time), us(time) / copying)?;
        }
        Ok(())
    }
}
