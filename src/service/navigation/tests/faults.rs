//! Faults of an IMU: offsets sent during and after them have correct uncertainties, or are not sent.

use super::*;
use crate::simulate::navigation::{FaultyImu, IMU_FAULTS, ImuFault, Shows};

/// Start of a fault while frames show the Sun, and in a gap between frames, s.
const BEGINS_S: [f64; 2] = [30.0, 60.0];
const GAP_S: std::ops::Range<f64> = 58.0..80.0;
const END_S: f64 = 100.0;
/// Time after which a repeated value is recognised, s.
const SEEN_TO_REPEAT_S: f64 = 0.03;
/// Error in sigmas beyond which an offset is wrong.
const MOST_SIGMAS: f64 = 6.0;
/// Time after the next fine frame from which no wrong offset may be sent, s.
const MENDED_S: f64 = 0.5;

/// Conditions of a flight: frames per second, and duration of the fault.
#[derive(Clone, Copy)]
struct Trial {
    frames_hz: u64,
    fault_s: f64,
}

const TRIALS: [Trial; 2] = [
    Trial {
        frames_hz: 4,
        fault_s: 10.0,
    },
    Trial {
        frames_hz: 25,
        fault_s: 5.0,
    },
];

/// Errors of a flight with a fault: the time, and the error in sigmas.
struct Flown {
    sent: Vec<(f64, f64)>,
    tally: NavigationTally,
}

fn is_seen(t_s: f64) -> bool {
    !GAP_S.contains(&t_s)
}

fn flown(trial: Trial, fault: &ImuFault, seed: u64) -> Flown {
    let mut imu = FaultyImu::new(seed);
    let corrupt = |n: u64, sample: ImuPacket| {
        let t_s = n as f64 / 100.0;
        let since = BEGINS_S.map(|begin_s| t_s - begin_s);
        let since_s = since
            .into_iter()
            .find(|since_s| (0.0..trial.fault_s).contains(since_s));
        imu.sample(sample, since_s.map(|since_s| (fault, since_s)))
    };
    let seen = (trial.frames_hz, is_seen);
    let (judged, tally) = fly_judged(
        END_S as u64,
        seed,
        seen,
        corrupt,
        as_received,
        |_| true,
        &[],
    );
    // Two axes each.
    let worst = judged
        .sigmas
        .chunks(2)
        .map(|both| both[0].abs().max(both[1].abs()));
    Flown {
        sent: judged.sent_s.iter().copied().zip(worst).collect(),
        tally,
    }
}

/// Whether an offset at this time may be wrong: from a fault's start, or its end, to 0.5 s after the next frame.
fn excuses(trial: Trial, fault: &ImuFault, t_s: f64) -> bool {
    let frames = 1.0 / trial.frames_hz as f64;
    BEGINS_S.into_iter().any(|first_s| {
        let mut begins = fault.begins_s(trial.fault_s).chain([trial.fault_s]);
        begins.any(|since_s| {
            let begin_s = first_s + since_s;
            let next = (begin_s / frames).floor() * frames + frames;
            let (next_s, shown_s) = match GAP_S.contains(&next) {
                false => (next, f64::INFINITY),
                true if fault.shows == Shows::InTheSamples => (GAP_S.end, SEEN_TO_REPEAT_S),
                true => (GAP_S.end, f64::INFINITY),
            };
            let until_s = (next_s + MENDED_S).min(begin_s + shown_s);
            (begin_s..=until_s).contains(&t_s)
        })
    })
}

/// Wrong offsets outside these times: first and last time, their number, and the largest error in sigmas.
fn judge(trial: Trial, fault: &ImuFault, flown: &Flown) -> Option<String> {
    let is_wrong =
        |(t_s, sigmas): &&(f64, f64)| *sigmas > MOST_SIGMAS && !excuses(trial, fault, *t_s);
    let wrong: Vec<_> = flown.sent.iter().filter(is_wrong).collect();
    let ((first_s, _), (last_s, _)) = (wrong.first()?, wrong.last()?);
    let most = wrong.iter().map(|(_, sigmas)| *sigmas).fold(0.0, f64::max);
    let (name, count) = (fault.name, wrong.len());
    Some(format!(
        "{name}: {count} wrong offsets from {first_s} to {last_s} s, up to {most:.0} sigma"
    ))
}

fn judge_all(trial: Trial, seeds: u64) {
    assert!(IMU_FAULTS.len() >= 40);
    let mut wrong = Vec::new();
    for fault in IMU_FAULTS {
        let flights: Vec<Flown> = (1..=seeds).map(|seed| flown(trial, fault, seed)).collect();
        let share = |from_s: f64, to_s: f64| {
            let sent = flights.iter().flat_map(|flown| &flown.sent);
            let sent = sent.filter(|(t_s, _)| (from_s..to_s).contains(t_s)).count();
            sent as f64 / (20.0 * (to_s - from_s) * seeds as f64)
        };
        let over_s = BEGINS_S[0] + trial.fault_s;
        println!(
            "{:45} sent: {:.2} beside frames, {:.2} in the 15 s after; {:.2} in the gap, {:.2} after its end and 5 s; restarts {}, refused {}",
            fault.name,
            share(BEGINS_S[0], over_s),
            share(over_s, over_s + 15.0),
            share(60.0, 80.0),
            share(85.0, 100.0),
            flights
                .iter()
                .map(|flown| flown.tally.restarts)
                .sum::<u64>(),
            flights.iter().map(|flown| flown.tally.refused).sum::<u64>(),
        );
        wrong.extend(
            flights
                .iter()
                .filter_map(|flown| judge(trial, fault, flown)),
        );
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn no_fault_of_an_imu_sends_an_offset_that_is_wrong_with_confidence() {
    judge_all(TRIALS[0], 1);
}

#[test]
#[ignore = "minutes"]
fn no_fault_of_an_imu_sends_an_offset_that_is_wrong_with_confidence_five_times() {
    TRIALS.iter().for_each(|trial| judge_all(*trial, 5));
}
