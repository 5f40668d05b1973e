//! A camera with frames drawn in advance, so that drawing takes no time from the service; it fails on command.

use jiff::{SignedDuration, Timestamp};
use solaspect::camera::{CameraError, Exposure, FrameSource, Take};
use solaspect::frame::{Frame, Pixels};
use solaspect::instrument::{Instrument, MountedCamera};
use solaspect::simulate::earth::SwingingGondola;
use solaspect::simulate::{Course, Depth, EXPOSURE, FORT_SUMNER, FlightScenes};
use solaspect::sky;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread;
use std::time::{Duration, Instant};

/// Number of frames that are drawn.
const DRAWN: usize = 48;
const SEED: u64 = 1;
/// Number of frames that the camera's buffers hold for a late computer; further frames are not taken.
const BUFFERS: u64 = 16;
/// Duration of a hanging call.
pub const HANG: Duration = Duration::from_secs(12);

/// Fault of a frame that is due.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum CameraFault {
    /// The camera returns an error instead of the frame.
    Error,
    /// The camera reports that there is no frame yet.
    Silence,
    /// The camera's thread panics.
    Panic,
    /// The call does not return for [`HANG`].
    Hang,
    /// The frame has another size than the instrument's.
    WrongSize,
    /// The frame has no time.
    NoTime,
    /// The frame has the time of a clock that was never set.
    UnsetClock,
}

/// Counts of the due frames by result. Their sum is the number of frames due.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Frames {
    pub given: u64,
    /// Frames replaced by an error.
    pub failed: u64,
    pub not_taken: u64,
}

impl Frames {
    pub fn due(&self) -> u64 {
        self.given + self.failed + self.not_taken
    }
}

/// The camera itself, which outlives its thread: it shows the drawn frames forwards and backwards, so that the Sun never
/// jumps.
pub struct Ring {
    drawn: Arc<[Frame]>,
    period: Duration,
    end: u64,
    state: Mutex<State>,
}

#[derive(Default)]
struct State {
    start: Option<Instant>,
    /// Number of the frame that is due next.
    number: u64,
    fault: Option<CameraFault>,
    /// Number of frames that the fault will still affect.
    left: u64,
    frames: Frames,
}

impl Ring {
    pub fn new(
        instrument: &Instrument,
        course: Course,
        depth: Depth,
        rate_hz: f64,
        duration: Duration,
    ) -> anyhow::Result<Self> {
        let now = Timestamp::now();
        let radius_mil = instrument.optics.radius_mil(sky::sun_angular_radius(now)?);
        let mut scenes = FlightScenes::new(instrument, course, radius_mil, SEED)?;
        scenes.template.depth = depth;
        let period = Duration::from_secs_f64(1.0 / rate_hz);
        let draw = |n: usize| Ok(scenes.scene(n as u64, period * n as u32)?.picture()?.frame);
        let drawn = (0..DRAWN).map(draw).collect::<anyhow::Result<_>>()?;
        Ok(Self::of(drawn, rate_hz, duration))
    }

    /// A camera that sees the horizon from a swinging gondola, at the same rate.
    pub fn of_horizon(
        camera: &MountedCamera,
        rate_hz: f64,
        duration: Duration,
    ) -> anyhow::Result<Self> {
        let gondola = SwingingGondola::new(camera, &FORT_SUMNER, SEED);
        let period = Duration::from_secs_f64(1.0 / rate_hz);
        let draw = |n: usize| Ok(gondola.scene(n as u64, period * n as u32, 1.0).frame()?);
        let drawn = (0..DRAWN).map(draw).collect::<anyhow::Result<_>>()?;
        Ok(Self::of(drawn, rate_hz, duration))
    }

    fn of(drawn: Vec<Frame>, rate_hz: f64, duration: Duration) -> Self {
        Self {
            drawn: drawn.into(),
            period: Duration::from_secs_f64(1.0 / rate_hz),
            end: (duration.as_secs_f64() * rate_hz).round() as u64,
            state: Mutex::default(),
        }
    }

    /// The same camera at the beginning of another run.
    pub fn again(&self) -> Self {
        Self {
            drawn: Arc::clone(&self.drawn),
            state: Mutex::default(),
            ..*self
        }
    }

    /// Memory of the drawn frames, which a real camera does not need.
    pub fn drawn_bytes(&self) -> f64 {
        self.drawn.len() as f64 * self.frame_bytes()
    }

    pub fn frame_bytes(&self) -> f64 {
        let bytes = match self.drawn[0].pixels() {
            Pixels::U8(pixels) => size_of_val(pixels.as_slice()),
            Pixels::U16(pixels) => size_of_val(pixels.as_slice()),
        };
        bytes as f64
    }

    /// Number of frames of the whole run.
    pub fn end(&self) -> u64 {
        self.end
    }

    pub fn frames(&self) -> Frames {
        self.state().frames
    }

    /// Applies this fault to the next `count` frames.
    pub fn fail(&self, fault: CameraFault, count: u64) {
        let mut state = self.state();
        (state.fault, state.left) = (Some(fault), count);
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The number of the next frame and how long to wait for it; `None` after the last.
    fn next_due(&self) -> Option<(u64, Duration)> {
        let mut state = self.state();
        let elapsed = state.start.get_or_insert_with(Instant::now).elapsed();
        let periods = (elapsed.as_secs_f64() / self.period.as_secs_f64()) as u64;
        if periods > state.number + BUFFERS {
            let next = periods.min(self.end);
            state.frames.not_taken += next - state.number;
            state.number = next;
        }
        if state.number == self.end {
            return None;
        }
        let number = state.number;
        state.number += 1;
        let due = self.period.mul_f64(number as f64);
        Some((number, due.saturating_sub(elapsed)))
    }

    /// The fault of the frame that is due now; counts it.
    fn meet(&self) -> Option<CameraFault> {
        let mut state = self.state();
        let fault = state.fault.filter(|_| state.left > 0);
        state.left = state.left.saturating_sub(1);
        let count = match fault {
            Some(CameraFault::Error) => &mut state.frames.failed,
            Some(CameraFault::Silence | CameraFault::Panic | CameraFault::Hang) => {
                &mut state.frames.not_taken
            }
            Some(CameraFault::WrongSize | CameraFault::NoTime | CameraFault::UnsetClock) | None => {
                &mut state.frames.given
            }
        };
        *count += 1;
        fault
    }

    /// The time of a clock that was at 1970 when the run began.
    fn since_1970(&self) -> Result<Timestamp, jiff::Error> {
        let elapsed = self.state().start.map(|start| start.elapsed());
        Timestamp::UNIX_EPOCH.checked_add(elapsed.unwrap_or_default())
    }

    fn frame(&self, number: u64) -> Frame {
        let lap = 2 * DRAWN as u64;
        let at = (number % lap) as usize;
        let mut frame = self.drawn[at.min(lap as usize - 1 - at)].clone();
        frame.info.number = Some(number);
        frame
    }
}

/// The camera as opened by one thread.
pub struct RingCamera(pub Arc<Ring>);

impl FrameSource for RingCamera {
    fn next(&mut self, starts: &mut dyn FnMut(Timestamp)) -> Result<Take, CameraError> {
        let Some((number, wait)) = self.0.next_due() else {
            return Ok(Take::End);
        };
        thread::sleep(wait);
        let fault = self.0.meet();
        match fault {
            Some(CameraFault::Error) => return Err(error("a fault of the camera")),
            Some(CameraFault::Silence) => return Ok(Take::NotYet),
            Some(CameraFault::Panic) => panic!("a fault of the camera"),
            Some(CameraFault::Hang) => {
                thread::sleep(HANG);
                return Ok(Take::NotYet);
            }
            _ => {}
        }
        let announced = match fault {
            Some(CameraFault::UnsetClock) => self.0.since_1970()?,
            _ => Timestamp::now(),
        };
        starts(announced);
        let mut frame = self.0.frame(number);
        let middle = SignedDuration::try_from(EXPOSURE / 2)?;
        frame.info.mid_exposure = Some(announced.checked_add(middle)?);
        match fault {
            Some(CameraFault::WrongSize) => frame = small(&frame)?,
            Some(CameraFault::NoTime) => frame.info.mid_exposure = None,
            _ => {}
        }
        thread::sleep(EXPOSURE);
        Ok(Take::Exposure(Box::new(Exposure { frame, announced })))
    }
}

fn error(problem: &str) -> CameraError {
    CameraError::Device {
        camera: "soak".into(),
        problem: problem.into(),
    }
}

/// A frame of a sensor other than the instrument's.
fn small(frame: &Frame) -> Result<Frame, CameraError> {
    let pixels = Pixels::U8(vec![20; 64 * 48]);
    Frame::new(64, 48, pixels, 255, frame.info.clone())
        .map_err(|refused| error(&refused.to_string()))
}
