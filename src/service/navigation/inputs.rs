//! What the filter is told: samples of the IMU, fixes of GPS, and the directions that cameras have seen.

use super::NavigationTally;
use crate::commands::controls::Seat;
use crate::geometry::attitude::Direction;
use crate::instrument::SkyCamera;
use crate::link::{Counters, ImuPacket, TelemetryPacket};
use crate::log::worth_a_line;
use crate::navigation::Target;
use crate::navigation::nmea::TimedFix;
use crate::pointing::measured_sun_in_telescope;
use crate::service::answer::Answer;
use crate::service::shared::Shared;
use crossbeam_channel::{Receiver, Sender, TrySendError, bounded};
use jiff::Timestamp;
use std::sync::Arc;
use std::time::Instant;

/// Five seconds of an IMU at 200 Hz.
const INPUTS: usize = 1024;

/// What one of the sensors has said.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::service) enum Input {
    /// A sample, and when it was read.
    Imu(ImuPacket, Instant),
    Fix(TimedFix),
    Seen(Seen),
}

/// A direction that a camera has seen.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(in crate::service) struct Seen {
    pub seat: Seat,
    pub target: Target,
    /// Mid-exposure.
    pub utc: Timestamp,
    /// In axes that are forward, right and down in the telescope or the body that carries the camera; a Moon camera's own.
    pub direction: Direction,
}

/// The sensors' end of the filter's queue. Nobody waits for the filter.
#[derive(Clone)]
pub(in crate::service) struct Inputs {
    queue: Sender<Input>,
    tally: Shared<NavigationTally>,
    counters: Arc<Counters>,
}

impl Inputs {
    pub fn new(tally: Shared<NavigationTally>, counters: Arc<Counters>) -> (Self, Receiver<Input>) {
        let (queue, inputs) = bounded(INPUTS);
        let own = Self {
            queue,
            tally,
            counters,
        };
        (own, inputs)
    }

    /// Tells the filter. Where its queue is full the input is lost and counted: later ones are worth more.
    pub fn tell(&self, input: Input) {
        // A filter that has ended with the cameras needs no more.
        if let Err(TrySendError::Full(_)) = self.queue.try_send(input) {
            let lost = self.counters.navigation_lost.count();
            if worth_a_line(lost) {
                tracing::error!(lost, "the navigation filter cannot follow: inputs are lost");
            }
        }
    }

    /// Tells the filter a sample of the IMU.
    pub fn tell_imu(&self, packet: &TelemetryPacket, read: Instant) {
        match ImuPacket::decode(packet) {
            Ok(sample) => self.tell(Input::Imu(sample, read)),
            Err(error) => {
                let mut tally = self.tally.lock();
                tally.unreadable += 1;
                if worth_a_line(tally.unreadable) {
                    tracing::warn!(%error, "a sample of the IMU cannot be read");
                }
            }
        }
    }

    /// Tells the filter what a frame shows.
    pub fn tell_seen(&self, answer: &Answer) {
        if let Some(seen) = seen(answer) {
            self.tell(Input::Seen(seen));
        }
    }
}

/// The direction that a frame tells; `None` where it shows none, or has no time.
fn seen(answer: &Answer) -> Option<Seen> {
    let station = &answer.station;
    let (target, direction) = match station.seat {
        Seat::PitchYaw | Seat::SecondPitchYaw => {
            let sun = answer.solution.aspect?.sun_plate;
            (
                Target::Sun,
                measured_sun_in_telescope(&sun, &station.instrument),
            )
        }
        Seat::Roll => {
            let Some(SkyCamera::Horizon(camera)) = &station.sky else {
                return None;
            };
            let nadir = answer.horizon.as_ref()?.nadir.as_ref().ok()?;
            let in_body = nadir.direction.turned(&camera.body_from_camera);
            (Target::Nadir, in_body)
        }
        Seat::Moon => (Target::Moon, answer.moon.as_ref()?.direction?),
    };
    Some(Seen {
        seat: station.seat,
        target,
        utc: answer.exposure.frame.info.mid_exposure?,
        direction,
    })
}
