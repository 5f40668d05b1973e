//! A camera whose frames were drawn beforehand, so that drawing takes nothing from the service.

use jiff::{SignedDuration, Timestamp};
use solaspect::camera::{CameraError, Exposure, FrameSource, Take};
use solaspect::frame::{Frame, Pixels};
use solaspect::instrument::Instrument;
use solaspect::simulate::{Depth, EXPOSURE, FlightScenes, Trajectory};
use solaspect::sky;
use std::time::{Duration, Instant};

/// Frames that are drawn.
const DRAWN: usize = 48;
const SEED: u64 = 1;

/// Shows the frames there and back again, so that the Sun never jumps.
pub struct RingCamera {
    frames: Vec<Frame>,
    start: Instant,
    period: Duration,
    number: u64,
    end: u64,
}

impl RingCamera {
    pub fn new(
        instrument: &Instrument,
        depth: Depth,
        rate_hz: f64,
        duration: Duration,
    ) -> anyhow::Result<Self> {
        let now = Timestamp::now();
        let radius_mil = instrument.optics.radius_mil(sky::sun_angular_radius(now)?);
        let trajectory = Trajectory::flight(instrument, radius_mil, SEED)?;
        let mut scenes = FlightScenes::new(instrument, trajectory, radius_mil, SEED)?;
        scenes.template.depth = depth;
        let period = Duration::from_secs_f64(1.0 / rate_hz);
        let draw = |n: usize| Ok(scenes.scene(n as u64, period * n as u32)?.picture()?.frame);
        Ok(Self {
            frames: (0..DRAWN).map(draw).collect::<anyhow::Result<_>>()?,
            start: Instant::now(),
            period,
            number: 0,
            end: (duration.as_secs_f64() * rate_hz).round() as u64,
        })
    }

    /// Memory that the drawn frames take; no camera has them.
    pub fn drawn_bytes(&self) -> f64 {
        let bytes = |frame: &Frame| match frame.pixels() {
            Pixels::U8(pixels) => size_of_val(pixels.as_slice()),
            Pixels::U16(pixels) => size_of_val(pixels.as_slice()),
        };
        self.frames.iter().map(bytes).sum::<usize>() as f64
    }

    fn frame(&self, number: u64) -> Frame {
        let lap = 2 * DRAWN as u64;
        let at = (number % lap) as usize;
        self.frames[at.min(lap as usize - 1 - at)].clone()
    }
}

impl FrameSource for RingCamera {
    fn next(&mut self, starts: &mut dyn FnMut(Timestamp)) -> Result<Take, CameraError> {
        let number = self.number;
        if number == self.end {
            return Ok(Take::End);
        }
        if number == 0 {
            self.start = Instant::now();
        }
        self.number += 1;
        let due = self.period.mul_f64(number as f64);
        std::thread::sleep(due.saturating_sub(self.start.elapsed()));
        let announced = Timestamp::now();
        starts(announced);
        let mut frame = self.frame(number);
        frame.info.number = Some(number);
        let middle = SignedDuration::try_from(EXPOSURE / 2)?;
        frame.info.mid_exposure = Some(announced.checked_add(middle)?);
        std::thread::sleep(EXPOSURE);
        Ok(Take::Exposure(Box::new(Exposure { frame, announced })))
    }
}
