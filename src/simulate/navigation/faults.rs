//! Faults of an IMU: each kind as a change of its samples.

use crate::link::ImuPacket;
use jiff::SignedDuration;
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use rand_xoshiro::Xoshiro256PlusPlus;

/// A fault's change of a sample, given the seconds since it began; `None` if the sample is lost.
type Corrupt = fn(&mut FaultyImu, f64, ImuPacket) -> Option<ImuPacket>;

/// Data in which a fault can be detected.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Shows {
    /// The samples themselves.
    InTheSamples,
    /// The next direction that a camera measures.
    InFrames,
}
use Shows::{InFrames, InTheSamples};

/// One kind of fault.
#[derive(Debug)]
pub struct ImuFault {
    pub name: &'static str,
    pub shows: Shows,
    corrupt: Corrupt,
    /// Interval after which it begins again while it lasts, s.
    again_s: f64,
}

impl ImuFault {
    /// Times at which it begins, s after its first begin, if it lasts for `length_s`.
    pub fn begins_s(&self, length_s: f64) -> impl Iterator<Item = f64> {
        let again = (0..).map(|n| {
            if n == 0 {
                0.0
            } else {
                f64::from(n) * self.again_s
            }
        });
        again.take_while(move |begin_s| *begin_s < length_s)
    }
}

/// An IMU with faults at times.
pub struct FaultyImu {
    /// The last sample before the fault.
    held: Option<ImuPacket>,
    random: Xoshiro256PlusPlus,
}

impl FaultyImu {
    pub fn new(seed: u64) -> Self {
        Self {
            held: None,
            random: Xoshiro256PlusPlus::seed_from_u64(seed),
        }
    }

    /// A sample with the fault that applies; `fault` gives it with the time since its begin, s.
    pub fn sample(
        &mut self,
        sample: ImuPacket,
        fault: Option<(&ImuFault, f64)>,
    ) -> Option<ImuPacket> {
        match fault {
            Some((fault, since_s)) => (fault.corrupt)(self, since_s, sample),
            None => {
                self.held = Some(sample);
                Some(sample)
            }
        }
    }

    fn held(&self, sample: &ImuPacket) -> ImuPacket {
        self.held.unwrap_or(*sample)
    }

    fn normal(&mut self) -> f32 {
        self.random.sample::<f32, _>(StandardNormal)
    }
}

const fn fault(name: &'static str, shows: Shows, corrupt: Corrupt) -> ImuFault {
    ImuFault {
        name,
        shows,
        corrupt,
        again_s: f64::INFINITY,
    }
}

const fn again(again_s: f64, fault: ImuFault) -> ImuFault {
    ImuFault { again_s, ..fault }
}

/// Whether the time within a period of `period_s` seconds is in this range of milliseconds.
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

fn frozen(faulty: &FaultyImu, sample: ImuPacket, axes: [bool; 3]) -> Option<ImuPacket> {
    let held = faulty.held(&sample).rate_rad_s;
    rates(sample, |rate| {
        [0, 1, 2].map(|n| if axes[n] { held[n] } else { rate[n] })
    })
}

fn late(mut sample: ImuPacket, ms: i64) -> Option<ImuPacket> {
    sample.time += SignedDuration::from_millis(ms);
    Some(sample)
}

/// Kinds of fault, each with a descriptive name.
pub const IMU_FAULTS: &[ImuFault] = &[
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
