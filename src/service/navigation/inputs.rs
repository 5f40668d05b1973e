//! The filter's inputs: samples of the IMU, fixes of GPS, and directions observed by cameras.

use crate::link::{Counters, ImuPacket, TelemetryPacket};
use crate::log::worth_a_line;
use crate::navigation::Target;
use crate::pointing::measured_sun_in_telescope;
use crate::service::messages::{
    Found, Input, ObservedDirection, ReceivesFrames, ReceivesSamples, SolvedFrame,
};
use crate::service::shared::Shared;
use crate::service::tally::NavigationTally;
use crossbeam_channel::{Receiver, Sender, TrySendError, bounded};
use std::sync::Arc;
use std::time::Instant;

/// Five seconds of an IMU at 200 Hz.
const INPUTS: usize = 1024;

/// The sensors' end of the filter's queue. No thread waits for the filter.
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

    /// Passes an input to the filter. If its queue is full, the input is lost and counted: later ones matter more.
    pub fn take(&self, input: Input) {
        // A filter that has ended with the cameras needs no more.
        if let Err(TrySendError::Full(_)) = self.queue.try_send(input) {
            let lost = self.counters.navigation_lost.count();
            if worth_a_line(lost) {
                tracing::error!(lost, "the navigation filter is too slow: inputs are lost");
            }
        }
    }
}

impl ReceivesSamples for Inputs {
    fn receive_sample(&self, packet: &TelemetryPacket, read: Instant) {
        match ImuPacket::decode(packet) {
            Ok(sample) => self.take(Input::Imu(sample, read)),
            Err(error) => {
                let mut tally = self.tally.lock();
                tally.unreadable += 1;
                if worth_a_line(tally.unreadable) {
                    tracing::warn!(%error, "a sample of the IMU cannot be read");
                }
            }
        }
    }
}

impl ReceivesFrames for Inputs {
    /// Passes the direction that a frame gives to the filter.
    fn receive(&self, frame: &SolvedFrame) {
        if let Some(direction) = direction(frame) {
            self.take(Input::Direction(direction));
        }
    }
}

/// The direction that a frame gives; `None` if it gives none, or has no time.
fn direction(frame: &SolvedFrame) -> Option<ObservedDirection> {
    let (target, direction) = match &frame.solved.found {
        Found::Sun(sun) => {
            let plate = sun.solution.aspect.as_ref()?.sun_plate;
            let direction = measured_sun_in_telescope(&plate, &sun.instrument);
            (Target::Sun, direction)
        }
        Found::Nadir(solution) => {
            let camera = frame.station.camera.sees.horizon()?;
            let nadir = solution.nadir.as_ref().ok()?;
            let in_body = nadir.direction.turned(&camera.body_from_camera);
            (Target::Nadir, in_body)
        }
        Found::Moon(moon) => (Target::Moon, moon.direction?),
        Found::Nothing => return None,
    };
    Some(ObservedDirection {
        camera: frame.station.index,
        target,
        utc: frame.exposure.frame.info.mid_exposure?,
        direction,
    })
}
