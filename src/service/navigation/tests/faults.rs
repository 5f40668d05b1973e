//! Faults of an IMU: what is sent meanwhile and after them is as certain as it says, or is not sent.

use super::*;

/// From when to when a fault lasts while frames show the Sun, and again in a gap between frames, s.
const BESIDE_FRAMES_S: std::ops::Range<f64> = 30.0..40.0;
const IN_GAP_S: std::ops::Range<f64> = 60.0..70.0;
const GAP_S: std::ops::Range<f64> = 58.0..80.0;
const END_S: f64 = 100.0;
/// A value that repeats is seen as such after so long.
const SEEN_TO_REPEAT_S: f64 = 0.03;
/// What is further off than so many sigmas is wrong with confidence.
const MOST_SIGMAS: f64 = 6.0;
/// So long after the next fine frame nothing wrong is sent any more.
const MENDED_S: f64 = 0.5;

/// What a fault makes of the n-th sample, t seconds after the fault began; some need the last good sample or chance.
type Spoil = fn(&mut Faulty, f64, ImuPacket) -> Option<ImuPacket>;

/// How a fault can be known.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Shows {
    /// By the samples themselves: nothing wrong is sent in a gap, either.
    InTheSamples,
    /// By the next frame.
    InFrames,
}
use Shows::{InFrames, InTheSamples};

struct Fault {
    name: &'static str,
    shows: Shows,
    spoil: Spoil,
    /// It begins anew so often while it lasts, s.
    again_s: f64,
}

struct Faulty {
    /// The last sample before the fault.
    held: Option<ImuPacket>,
    random: Xoshiro256PlusPlus,
}

impl Faulty {
    fn held(&self, sample: &ImuPacket) -> ImuPacket {
        self.held.unwrap_or(*sample)
    }

    fn normal(&mut self) -> f32 {
        self.random.sample::<f32, _>(StandardNormal)
    }
}

const fn fault(name: &'static str, shows: Shows, spoil: Spoil) -> Fault {
    Fault {
        name,
        shows,
        spoil,
        again_s: f64::INFINITY,
    }
}

const fn again(again_s: f64, fault: Fault) -> Fault {
    Fault { again_s, ..fault }
}

/// Whether it is so many milliseconds into a period of seconds.
fn at_ms(t_s: f64, period_s: f64, ms: std::ops::Range<f64>) -> bool {
    ms.contains(&(1e3 * (t_s + 1e-6).rem_euclid(period_s)))
}

fn rates(mut sample: ImuPacket, change: impl FnOnce([f32; 3]) -> [f32; 3]) -> Option<ImuPacket> {
    sample.rate_rad_s = change(sample.rate_rad_s);
    Some(sample)
}

fn forces(mut sample: ImuPacket, change: impl FnOnce([f32; 3]) -> [f32; 3]) -> Option<ImuPacket> {
    sample.force_m_s2 = change(sample.force_m_s2);
    Some(sample)
}

fn frozen(faulty: &Faulty, sample: ImuPacket, axes: [bool; 3]) -> Option<ImuPacket> {
    let held = faulty.held(&sample).rate_rad_s;
    rates(sample, |rate| {
        [0, 1, 2].map(|n| if axes[n] { held[n] } else { rate[n] })
    })
}

fn late(mut sample: ImuPacket, ms: i64) -> Option<ImuPacket> {
    sample.time += SignedDuration::from_millis(ms);
    Some(sample)
}

const FAULTS: &[Fault] = &[
    fault("rates frozen", InTheSamples, |f, _, s| {
        frozen(f, s, [true; 3])
    }),
    fault("first rate frozen", InTheSamples, |f, _, s| {
        frozen(f, s, [true, false, false])
    }),
    fault("second rate frozen", InTheSamples, |f, _, s| {
        frozen(f, s, [false, true, false])
    }),
    fault("third rate frozen", InTheSamples, |f, _, s| {
        frozen(f, s, [false, false, true])
    }),
    again(
        2.0,
        fault(
            "rates frozen for a second, again and again",
            InTheSamples,
            |f, t, s| {
                if at_ms(t, 2.0, 0.0..15.0) {
                    f.held = Some(s);
                }
                frozen(f, s, [at_ms(t, 2.0, 0.0..1000.0); 3])
            },
        ),
    ),
    fault("all frozen", InTheSamples, |f, _, s| {
        let held = f.held(&s);
        Some(ImuPacket {
            time: s.time,
            counter: s.counter,
            ..held
        })
    }),
    fault("rates at a rail", InTheSamples, |_, _, s| {
        rates(s, |_| [0.05, -0.05, 0.05])
    }),
    fault("second rate at a rail", InTheSamples, |_, _, s| {
        rates(s, |[x, _, z]| [x, 0.02, z])
    }),
    fault("rates clipped", InTheSamples, |_, _, s| {
        rates(s, |rate| rate.map(|one| one.clamp(-2e-4, 2e-4)))
    }),
    again(
        3.0,
        fault("single spikes of 30 rad/s", InTheSamples, |_, t, s| {
            let spike = at_ms(t, 3.0, 0.0..5.0);
            rates(s, |[x, y, z]| [x, if spike { 30.0 } else { y }, z])
        }),
    ),
    again(
        3.0,
        fault("single spikes of 3 rad/s", InTheSamples, |_, t, s| {
            let spike = at_ms(t, 3.0, 0.0..5.0);
            rates(s, |[x, y, z]| [x, y, if spike { -3.0 } else { z }])
        }),
    ),
    again(
        3.0,
        fault("spikes for a fifth of a second", InTheSamples, |f, t, s| {
            let spike = if at_ms(t, 3.0, 0.0..200.0) {
                10.0 * f.normal()
            } else {
                0.0
            };
            rates(s, |[x, y, z]| [x + spike, y - spike, z])
        }),
    ),
    again(
        3.0,
        fault("spikes of 0.1 rad/s", InFrames, |_, t, s| {
            let spike = at_ms(t, 3.0, 0.0..5.0);
            rates(s, |[x, y, z]| [x, if spike { 0.1 } else { y }, z])
        }),
    ),
    fault("scale doubled", InFrames, |_, _, s| {
        rates(s, |rate| rate.map(|one| 2.0 * one))
    }),
    fault("scale halved", InFrames, |_, _, s| {
        rates(s, |rate| rate.map(|one| 0.5 * one))
    }),
    fault("scale off by a tenth", InFrames, |_, _, s| {
        rates(s, |rate| rate.map(|one| 1.1 * one))
    }),
    fault("rates in degrees", InFrames, |_, _, s| {
        rates(s, |rate| rate.map(f32::to_degrees))
    }),
    fault("signs turned", InFrames, |_, _, s| {
        rates(s, |rate| rate.map(|one| -one))
    }),
    fault("first two rates swapped", InFrames, |_, _, s| {
        rates(s, |[x, y, z]| [y, x, z])
    }),
    fault("last two rates swapped", InFrames, |_, _, s| {
        rates(s, |[x, y, z]| [x, z, y])
    }),
    fault("first and last rate swapped", InFrames, |_, _, s| {
        rates(s, |[x, y, z]| [z, y, x])
    }),
    fault("bias step of 0.1 rad/s", InFrames, |_, _, s| {
        rates(s, |[x, y, z]| [x, y + 0.1, z])
    }),
    fault("bias step of 0.01 rad/s", InFrames, |_, _, s| {
        rates(s, |[x, y, z]| [x, y, z - 0.01])
    }),
    fault("bias step of 1e-3 rad/s", InFrames, |_, _, s| {
        rates(s, |[x, y, z]| [x, y + 1e-3, z])
    }),
    fault("bias step of 1e-4 rad/s", InFrames, |_, _, s| {
        rates(s, |[x, y, z]| [x, y - 1e-4, z + 1e-4])
    }),
    fault("bias step of 1e-5 rad/s", InFrames, |_, _, s| {
        rates(s, |[x, y, z]| [x, y + 1e-5, z])
    }),
    fault("bias that grows", InFrames, |_, t, s| {
        rates(s, |[x, y, z]| [x, y + 1e-3 * t as f32, z])
    }),
    fault("all rates zero", InTheSamples, |_, _, s| {
        rates(s, |_| [0.0; 3])
    }),
    fault("second rate zero", InTheSamples, |_, _, s| {
        rates(s, |[x, _, z]| [x, 0.0, z])
    }),
    fault("noise of 0.01 rad/s", InTheSamples, |f, _, s| {
        let noise = [f.normal(), f.normal(), f.normal()];
        rates(s, |rate| [0, 1, 2].map(|n| rate[n] + 0.01 * noise[n]))
    }),
    fault("rates that are chance", InTheSamples, |f, _, s| {
        let noise = [f.normal(), f.normal(), f.normal()];
        rates(s, |_| noise)
    }),
    fault("steps of 1e-3 rad/s", InTheSamples, |_, _, s| {
        rates(s, |rate| rate.map(|one| (one * 1e3).round() * 1e-3))
    }),
    fault("dead", InTheSamples, |_, _, _| None),
    again(
        2.0,
        fault("dead for half a second", InTheSamples, |_, t, s| {
            (!at_ms(t, 2.0, 0.0..500.0)).then_some(s)
        }),
    ),
    again(
        3.0,
        fault("dead for 0.9 s", InTheSamples, |_, t, s| {
            (!at_ms(t, 3.0, 0.0..900.0)).then_some(s)
        }),
    ),
    fault("every second sample lost", InTheSamples, |_, t, s| {
        (!at_ms(t, 0.02, 0.0..5.0)).then_some(s)
    }),
    fault("times late by 0.1 s", InTheSamples, |_, _, s| late(s, 100)),
    fault("times late by 0.3 s", InTheSamples, |_, _, s| late(s, 300)),
    fault("times late by 2 s", InTheSamples, |_, _, s| late(s, 2000)),
    fault("times early by 0.05 s", InTheSamples, |_, _, s| {
        late(s, -50)
    }),
    fault("times that stand still", InTheSamples, |f, _, s| {
        let held = f.held(&s);
        Some(ImuPacket {
            time: held.time,
            ..s
        })
    }),
    fault("rates of 59 rad/s", InTheSamples, |_, _, s| {
        rates(s, |_| [0.0, 59.0, 0.0])
    }),
    fault("forces frozen", InFrames, |f, _, s| {
        let held = f.held(&s).force_m_s2;
        forces(s, |_| held)
    }),
    fault("forces zero", InFrames, |_, _, s| forces(s, |_| [0.0; 3])),
    fault("forces at a rail", InFrames, |_, _, s| {
        forces(s, |_| [20.0; 3])
    }),
    fault("force scale off by a tenth", InFrames, |_, _, s| {
        forces(s, |force| force.map(|one| 1.1 * one))
    }),
    fault("forces swapped", InFrames, |_, _, s| {
        forces(s, |[x, y, z]| [y, z, x])
    }),
    fault("force bias step of 0.5 m/s^2", InFrames, |_, _, s| {
        forces(s, |[x, y, z]| [x + 0.5, y, z])
    }),
    fault("force bias step of 0.1 m/s^2", InFrames, |_, _, s| {
        forces(s, |[x, y, z]| [x, y + 0.1, z])
    }),
    again(
        3.0,
        fault("spikes of 400 m/s^2", InFrames, |_, t, s| {
            let spike = at_ms(t, 3.0, 0.0..5.0);
            forces(s, |[x, y, z]| [if spike { 400.0 } else { x }, y, z])
        }),
    ),
];

/// What a flight with a fault has sent: when, and by how many of its sigmas it was wrong.
struct Flown {
    sent: Vec<(f64, f64)>,
    tally: NavigationTally,
}

fn is_seen(t_s: f64) -> bool {
    !GAP_S.contains(&t_s)
}

fn flown(fault: &Fault, seed: u64) -> Flown {
    let mut faulty = Faulty {
        held: None,
        random: Xoshiro256PlusPlus::seed_from_u64(seed),
    };
    let spoil = |n: u64, sample: ImuPacket| {
        let t_s = n as f64 / 100.0;
        let lasting = [BESIDE_FRAMES_S, IN_GAP_S];
        match lasting.iter().find(|lasting| lasting.contains(&t_s)) {
            Some(lasting) => (fault.spoil)(&mut faulty, t_s - lasting.start, sample),
            None => {
                faulty.held = Some(sample);
                Some(sample)
            }
        }
    };
    let (judged, tally) = fly(END_S as u64, seed, is_seen, spoil, as_received);
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

impl Fault {
    /// Whether what is sent at a time may be wrong: from a fault's begin, or its end, to half a second after the next frame.
    fn excuses(&self, t_s: f64) -> bool {
        let frames = 1.0 / FRAMES_HZ as f64;
        [BESIDE_FRAMES_S, IN_GAP_S].into_iter().any(|lasting| {
            let mut begins = vec![lasting.end];
            let mut begin_s = lasting.start;
            while begin_s < lasting.end {
                begins.push(begin_s);
                begin_s += self.again_s;
            }
            begins.into_iter().any(|begin_s| {
                let next = (begin_s / frames).floor() * frames + frames;
                let (next_s, shown_s) = match GAP_S.contains(&next) {
                    false => (next, f64::INFINITY),
                    true if self.shows == InTheSamples => (GAP_S.end, SEEN_TO_REPEAT_S),
                    true => (GAP_S.end, f64::INFINITY),
                };
                let until_s = (next_s + MENDED_S).min(begin_s + shown_s);
                (begin_s..=until_s).contains(&t_s)
            })
        })
    }

    /// What was sent wrong, beyond any excuse: first and last time, how often, and the most sigmas.
    fn judge(&self, flown: &Flown) -> Option<String> {
        let is_wrong = |(t_s, sigmas): &&(f64, f64)| *sigmas > MOST_SIGMAS && !self.excuses(*t_s);
        let wrong: Vec<_> = flown.sent.iter().filter(is_wrong).collect();
        let ((first_s, _), (last_s, _)) = (wrong.first()?, wrong.last()?);
        let most = wrong.iter().map(|(_, sigmas)| *sigmas).fold(0.0, f64::max);
        let (name, count) = (self.name, wrong.len());
        Some(format!(
            "{name}: {count} wrong offsets from {first_s} to {last_s} s, up to {most:.0} sigma"
        ))
    }
}

fn judge_all(seeds: u64) {
    assert!(FAULTS.len() >= 40);
    let mut wrong = Vec::new();
    for fault in FAULTS {
        let flights: Vec<Flown> = (1..=seeds).map(|seed| flown(fault, seed)).collect();
        let share = |from_s: f64, to_s: f64| {
            let sent = flights.iter().flat_map(|flown| &flown.sent);
            let sent = sent.filter(|(t_s, _)| (from_s..to_s).contains(t_s)).count();
            sent as f64 / (20.0 * (to_s - from_s) * seeds as f64)
        };
        println!(
            "{:45} sent: {:.2} beside frames, {:.2} in the 15 s after; {:.2} in the gap, {:.2} after its end and 5 s; restarts {}, refused {}",
            fault.name,
            share(30.0, 40.0),
            share(40.0, 55.0),
            share(60.0, 80.0),
            share(85.0, 100.0),
            flights
                .iter()
                .map(|flown| flown.tally.restarts)
                .sum::<u64>(),
            flights.iter().map(|flown| flown.tally.refused).sum::<u64>(),
        );
        wrong.extend(flights.iter().filter_map(|flown| fault.judge(flown)));
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}

#[test]
fn no_fault_of_an_imu_sends_an_offset_that_is_wrong_with_confidence() {
    judge_all(1);
}

#[test]
#[ignore = "minutes"]
fn no_fault_of_an_imu_sends_an_offset_that_is_wrong_with_confidence_five_times() {
    judge_all(5);
}
