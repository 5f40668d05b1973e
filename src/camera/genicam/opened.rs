//! An open camera: its settings, its stream, and one frame at a time.

use super::configure::{Actual, adjust, configure, has};
use super::frames::Frames;
use super::numbers::Numbers;
use super::open::open;
use crate::camera::{CameraError, CameraHealth, CameraSettings, Device, MonoFormat};
use crate::frame::{Frame, FrameInfo, Pixels, SIMULATED_CAMERA};
use aravis::prelude::*;
use aravis::{Buffer, BufferStatus, Camera};
use jiff::{SignedDuration, Timestamp};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Longest transfer time of a frame after the exposure.
const TRANSFER: Duration = Duration::from_millis(500);
/// Number of successive triggers without a frame after which a camera is lost.
const SILENT_FRAMES: u32 = 3;
/// Interval between readings of the temperature.
const TEMPERATURE_PERIOD: Duration = Duration::from_secs(1);

/// Counters shared by the camera's thread and its owner.
pub(super) type SharedHealth = Arc<Mutex<CameraHealth>>;

pub(super) fn count(health: &SharedHealth, note: impl FnOnce(&mut CameraHealth)) {
    note(&mut health.lock().unwrap_or_else(PoisonError::into_inner));
}

/// Inputs for opening a camera.
pub(super) struct Opening {
    pub device: Device,
    pub settings: CameraSettings,
    /// Origin of the monotonic times.
    pub zero: Instant,
    /// Number of the first frame.
    pub next_number: u64,
    pub health: SharedHealth,
}

/// Reason why there is no frame.
pub(super) enum Fault {
    /// This frame was lost; the next may be good.
    Frame(CameraError),
    /// The camera is gone.
    Camera(CameraError),
}

/// An open camera that waits for triggers.
pub(super) struct OpenCamera {
    device: Device,
    name: String,
    camera: Camera,
    /// `None` only if the stream could not be restarted: the camera is lost then.
    frames: Option<Frames>,
    settings: CameraSettings,
    /// Settings as read back from the camera.
    actual: Actual,
    temperature: Option<(Instant, f64)>,
    numbers: Numbers,
    zero: Instant,
    silent: u32,
    gone: bool,
    health: SharedHealth,
}

impl OpenCamera {
    /// Opens the camera, applies every setting and makes it wait for triggers. A setting that it does not take is logged and
    /// counted.
    pub(super) fn open(opening: Opening) -> Result<Self, CameraError> {
        let Opening { device, .. } = opening;
        let camera = open(&device).map_err(|error| CameraError::of(&device, error))?;
        let (actual, refused) = configure(&camera, &opening.settings);
        for error in &refused {
            tracing::warn!(%error, camera = %device, "the camera did not accept a setting");
        }
        count(&opening.health, |health| {
            health.refused_settings += refused.len() as u64;
        });
        let frames = Frames::start(&camera).map_err(|error| CameraError::of(&device, error))?;
        Ok(Self {
            name: name(&camera, &device),
            device,
            camera,
            frames: Some(frames),
            settings: opening.settings,
            actual,
            temperature: None,
            numbers: Numbers::from(opening.next_number),
            zero: opening.zero,
            silent: 0,
            gone: false,
            health: opening.health,
        })
    }

    fn problem(&self, problem: impl ToString) -> CameraError {
        CameraError::of(&self.device, problem)
    }

    /// Applies every setting. Inner error: a setting that the camera did not take; outer: the camera is lost.
    pub(super) fn apply(
        &mut self,
        settings: &CameraSettings,
    ) -> Result<Result<(), CameraError>, CameraError> {
        let reshaped = settings.region != self.settings.region
            || settings.pixel_format != self.settings.pixel_format;
        let (actual, refused) = if reshaped {
            // Size and format are locked while the stream runs, and its buffers are made for them. If a USB3 stream ended after the
            // next has begun, it would end that one, too.
            self.camera
                .stop_acquisition()
                .map_err(|e| self.problem(e))?;
            self.frames = None;
            let configured = configure(&self.camera, settings);
            self.frames = Some(Frames::start(&self.camera).map_err(|e| self.problem(e))?);
            self.numbers.restart();
            configured
        } else {
            adjust(&self.camera, settings)
        };
        self.actual = actual;
        self.settings = settings.clone();
        count(&self.health, |health| {
            health.refused_settings += refused.len() as u64;
        });
        Ok(refused.into_iter().next().map_or(Ok(()), Err))
    }

    /// Triggers a frame and waits for it.
    pub(super) fn take_frame(&mut self) -> Result<Frame, Fault> {
        let Some(mut frames) = self.frames.take() else {
            return Err(self.is_gone("its stream has ended"));
        };
        let taken = self.take_from(&mut frames);
        self.frames = Some(frames);
        taken
    }

    fn take_from(&mut self, frames: &mut Frames) -> Result<Frame, Fault> {
        frames.drop_late();
        let (before, utc) = (Instant::now(), Timestamp::now());
        if let Err(error) = frames.trigger(&self.camera) {
            return Err(self.is_gone(error));
        }
        // The camera received the trigger half-way between the order and its answer.
        let on_the_way = before.elapsed() / 2;
        let exposure = self.actual.exposure.unwrap_or(self.settings.exposure());
        let buffer = frames.wait(exposure + TRANSFER);
        let lost = frames.new_losses();
        count(&self.health, |health| {
            health.lost_packets += lost.packets;
            health.underruns += lost.underruns;
        });
        let buffer = buffer.ok_or_else(|| self.silence())?;
        self.silent = 0;
        let number = self.numbers.number(buffer.frame_id(), frames.ids());
        let to_middle = on_the_way + exposure / 2;
        let frame = self.frame(number, &buffer).map(|mut frame| {
            let info = &mut frame.info;
            info.monotonic = Some(before.duration_since(self.zero) + to_middle);
            let to_middle = SignedDuration::try_from(to_middle).unwrap_or_default();
            info.mid_exposure = utc.checked_add(to_middle).ok();
            frame
        });
        frames.give_back(buffer);
        frame.map_err(Fault::Frame)
    }

    fn is_gone(&mut self, problem: impl ToString) -> Fault {
        self.gone = true;
        Fault::Camera(self.problem(problem))
    }

    /// Handles a trigger without a frame.
    fn silence(&mut self) -> Fault {
        self.silent += 1;
        count(&self.health, |health| health.missing += 1);
        if self.silent >= SILENT_FRAMES {
            self.is_gone(format!("{SILENT_FRAMES} triggers and no frame"))
        } else {
            Fault::Frame(self.problem("no frame came of a trigger"))
        }
    }

    /// The picture in a buffer, if it arrived completely, with its data except for the time.
    fn frame(&mut self, number: u64, buffer: &Buffer) -> Result<Frame, CameraError> {
        let status = buffer.status();
        if status != BufferStatus::Success {
            count(&self.health, |health| health.incomplete += 1);
            return Err(self.problem(format!("frame {number} is incomplete: {status:?}")));
        }
        let size = |pixels: i32| usize::try_from(pixels).unwrap_or(0);
        let (x, y, width, height) = buffer.image_region();
        let (width, height) = (size(width), size(height));
        let (pixels, saturation_dn) = self.pixels(buffer, width * height)?;
        let clock = Duration::from_nanos(buffer.timestamp());
        let info = FrameInfo {
            number: Some(number),
            // A camera without a clock gives 0.
            camera_clock: (!clock.is_zero()).then_some(clock),
            exposure: self.actual.exposure,
            analogue_gain: self.actual.analogue_gain,
            preamp_gain: self.actual.preamp_gain,
            camera_temperature_c: self.temperature_c(),
            corner_px: self.settings.region.map(|_| (size(x), size(y))),
            camera: Some(self.name.clone()),
            ..FrameInfo::default()
        };
        Frame::new(width, height, pixels, saturation_dn, info).map_err(|error| self.problem(error))
    }

    /// The pixels in a buffer, and where they saturate.
    fn pixels(&self, buffer: &Buffer, count: usize) -> Result<(Pixels, u16), CameraError> {
        let code = buffer.image_pixel_format().raw();
        let Some(format) = MonoFormat::of_code(code) else {
            let known = MonoFormat::names();
            return Err(self.problem(format!("expected one of {known}, found format {code:#x}")));
        };
        if let (padding @ 1.., _) = buffer.image_padding() {
            let problem = format!("expected lines without padding, found {padding} bytes");
            return Err(self.problem(problem));
        }
        let bytes = buffer.image_data();
        let found = bytes.len();
        let pixels = format.unpack(bytes, count).ok_or_else(|| {
            let expected = format!("{count} pixels of {}", format.name);
            self.problem(format!("expected {expected}, found {found} bytes"))
        })?;
        let saturation_dn = format.saturation_dn(&pixels, self.actual.largest_dn);
        Ok((pixels, saturation_dn))
    }

    /// The camera's temperature, read at intervals; `None` if it has no thermometer.
    fn temperature_c(&mut self) -> Option<f64> {
        let fresh = self
            .temperature
            .is_some_and(|(read, _)| read.elapsed() < TEMPERATURE_PERIOD);
        if !fresh {
            self.temperature = if has(&self.camera, "DeviceTemperature") {
                let celsius = self.camera.float("DeviceTemperature").ok();
                celsius.map(|celsius| (Instant::now(), celsius))
            } else {
                None
            };
            let now = self.temperature.map(|(_, celsius)| celsius);
            count(&self.health, |health| health.temperature_c = now);
        }
        self.temperature.map(|(_, celsius)| celsius)
    }
}

impl Drop for OpenCamera {
    fn drop(&mut self) {
        // A lost camera would make this wait.
        if !self.gone {
            let _ = self.camera.stop_acquisition();
        }
    }
}

/// Its maker, model and serial number. The fake device is marked as simulated.
fn name(camera: &Camera, device: &Device) -> String {
    if device.is_fake() {
        return SIMULATED_CAMERA.into();
    }
    let words = [
        camera.vendor_name(),
        camera.model_name(),
        camera.device_serial_number(),
    ];
    let words: Vec<String> = words.into_iter().flatten().map(Into::into).collect();
    words.join(" ")
}
