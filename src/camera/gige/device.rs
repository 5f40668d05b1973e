//! An open camera: its settings, its stream, and one frame at a time.

use super::configure::{Actual, adjust, configure, has};
use super::numbers::Numbers;
use crate::camera::{CameraError, CameraHealth, CameraSettings};
use crate::frame::{Frame, FrameInfo, Pixels};
use aravis::prelude::*;
use aravis::{Aravis, Buffer, BufferStatus, Camera, PixelFormat, Stream};
use jiff::{SignedDuration, Timestamp};
use std::net::IpAddr;
use std::sync::{Arc, LazyLock, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Buffers of a stream: frames that may arrive before they are fetched.
const BUFFERS: usize = 4;
/// How long a frame may be on its way after the exposure.
const TRANSFER: Duration = Duration::from_millis(500);
/// A camera that gives no frame so often in a row is gone.
const SILENT_FRAMES: u32 = 3;
/// How often the temperature is asked for.
const TEMPERATURE_PERIOD: Duration = Duration::from_secs(1);

/// The library's list of cameras belongs to one thread at a time.
static LIBRARY: LazyLock<Option<Mutex<Aravis>>> =
    LazyLock::new(|| Aravis::initialize().ok().map(Mutex::new));

/// Counters that the camera's thread and its owner share.
pub(super) type SharedHealth = Arc<Mutex<CameraHealth>>;

pub(super) fn count(health: &SharedHealth, note: impl FnOnce(&mut CameraHealth)) {
    note(&mut health.lock().unwrap_or_else(PoisonError::into_inner));
}

/// How a camera is opened.
pub(super) struct Opening {
    pub address: String,
    pub settings: CameraSettings,
    /// Zero of the monotonic times.
    pub zero: Instant,
    /// Number of the first frame.
    pub next_number: u64,
    pub health: SharedHealth,
}

/// Why there is no frame.
pub(super) enum Fault {
    /// This frame was lost; the next may be good.
    Frame(CameraError),
    /// The camera is gone.
    Camera(CameraError),
}

/// An open camera that waits for triggers.
pub(super) struct Device {
    address: String,
    name: String,
    camera: Camera,
    stream: Stream,
    settings: CameraSettings,
    /// As the camera has them.
    actual: Actual,
    temperature: Option<(Instant, f64)>,
    numbers: Numbers,
    zero: Instant,
    silent: u32,
    gone: bool,
    counted: Counted,
    health: SharedHealth,
}

/// What the stream has counted so far.
#[derive(Debug, Clone, Copy, Default)]
struct Counted {
    lost_packets: u64,
    underruns: u64,
}

impl Device {
    /// Opens the camera, applies every setting and lets it wait for triggers. A setting that it does not take is logged and
    /// counted.
    pub(super) fn open(opening: Opening) -> Result<Self, CameraError> {
        let Opening { address, .. } = opening;
        let problem = |error: &dyn ToString| CameraError::Gige {
            address: address.clone(),
            problem: error.to_string(),
        };
        let camera = find(&address).map_err(|error| problem(&error))?;
        prepare(&camera).map_err(|error| problem(&error))?;
        let (actual, refused) = configure(&camera, &opening.settings);
        for error in &refused {
            tracing::warn!(%error, address, "the camera did not take a setting");
        }
        count(&opening.health, |health| {
            health.refused_settings += refused.len() as u64;
        });
        let stream = start(&camera).map_err(|error| problem(&error))?;
        Ok(Self {
            name: name(&camera),
            address,
            camera,
            stream,
            settings: opening.settings,
            actual,
            temperature: None,
            numbers: Numbers::from(opening.next_number),
            zero: opening.zero,
            silent: 0,
            gone: false,
            counted: Counted::default(),
            health: opening.health,
        })
    }

    fn problem(&self, problem: impl ToString) -> CameraError {
        CameraError::Gige {
            address: self.address.clone(),
            problem: problem.to_string(),
        }
    }

    /// Applies every setting. Inner error: a setting that the camera did not take; outer: the camera is gone.
    pub(super) fn apply(
        &mut self,
        settings: &CameraSettings,
    ) -> Result<Result<(), CameraError>, CameraError> {
        let reshaped = settings.region != self.settings.region
            || settings.pixel_format != self.settings.pixel_format;
        if reshaped {
            // Size and format are locked while the stream runs, and its buffers are made for them.
            self.camera
                .stop_acquisition()
                .map_err(|e| self.problem(e))?;
        }
        let (actual, refused) = if reshaped {
            configure(&self.camera, settings)
        } else {
            adjust(&self.camera, settings)
        };
        if reshaped {
            self.stream = start(&self.camera).map_err(|e| self.problem(e))?;
            self.counted = Counted::default();
            self.numbers.restart();
        }
        self.actual = actual;
        self.settings = settings.clone();
        count(&self.health, |health| {
            health.refused_settings += refused.len() as u64;
        });
        Ok(refused.into_iter().next().map_or(Ok(()), Err))
    }

    /// Triggers a frame and waits for it.
    pub(super) fn take_frame(&mut self) -> Result<Frame, Fault> {
        // Whatever still arrived belongs to a trigger that was given up.
        while let Some(late) = self.stream.try_pop_buffer() {
            self.stream.push_buffer(late);
        }
        let (before, utc) = (Instant::now(), Timestamp::now());
        if let Err(error) = self.camera.software_trigger() {
            return Err(self.is_gone(error));
        }
        // The camera got the trigger half-way between the order and its answer.
        let on_the_way = before.elapsed() / 2;
        let exposure = self.actual.exposure.unwrap_or(self.settings.exposure());
        let wait = exposure + TRANSFER;
        let buffer = self.stream.timeout_pop_buffer(wait.as_micros() as u64);
        self.count_losses();
        let buffer = buffer.ok_or_else(|| self.silence())?;
        self.silent = 0;
        let to_middle = on_the_way + exposure / 2;
        let frame = self.frame(&buffer).map(|mut frame| {
            let info = &mut frame.info;
            info.exposure = Some(exposure);
            info.monotonic = Some(before.duration_since(self.zero) + to_middle);
            let to_middle = SignedDuration::try_from(to_middle).unwrap_or_default();
            info.mid_exposure = utc.checked_add(to_middle).ok();
            frame
        });
        self.stream.push_buffer(buffer);
        frame.map_err(Fault::Frame)
    }

    fn is_gone(&mut self, problem: impl ToString) -> Fault {
        self.gone = true;
        Fault::Camera(self.problem(problem))
    }

    /// No frame came.
    fn silence(&mut self) -> Fault {
        self.silent += 1;
        count(&self.health, |health| health.missing += 1);
        if self.silent >= SILENT_FRAMES {
            self.is_gone(format!("{SILENT_FRAMES} triggers and no frame"))
        } else {
            Fault::Frame(self.problem("no frame came of a trigger"))
        }
    }

    fn count_losses(&mut self) {
        let (_, _, underruns) = self.stream.statistics();
        let now = Counted {
            lost_packets: self.stream.info_uint64_by_name("n_missing_packets"),
            underruns,
        };
        let before = std::mem::replace(&mut self.counted, now);
        count(&self.health, |health| {
            health.lost_packets += now.lost_packets.saturating_sub(before.lost_packets);
            health.underruns += now.underruns.saturating_sub(before.underruns);
        });
    }

    /// The picture in a buffer, where all of it arrived, with what is known of it but for its time.
    fn frame(&mut self, buffer: &Buffer) -> Result<Frame, CameraError> {
        let number = self.numbers.number(buffer.frame_id());
        let status = buffer.status();
        if status != BufferStatus::Success {
            count(&self.health, |health| health.incomplete += 1);
            return Err(self.problem(format!("frame {number} is incomplete: {status:?}")));
        }
        let size = |pixels: i32| usize::try_from(pixels).unwrap_or(0);
        let (x, y, width, height) = buffer.image_region();
        let (width, height) = (size(width), size(height));
        let (pixels, saturation_dn) = pixels(buffer).ok_or_else(|| {
            let format = buffer.image_pixel_format().raw();
            self.problem(format!(
                "expected Mono8 or Mono12, found format {format:#x}"
            ))
        })?;
        let info = FrameInfo {
            number: Some(number),
            camera_clock: Some(Duration::from_nanos(buffer.timestamp())),
            analogue_gain: self.actual.analogue_gain,
            preamp_gain: self.actual.preamp_gain,
            camera_temperature_c: self.temperature_c(),
            corner_px: self.settings.region.map(|_| (size(x), size(y))),
            camera: Some(self.name.clone()),
            ..FrameInfo::default()
        };
        Frame::new(width, height, pixels, saturation_dn, info).map_err(|error| self.problem(error))
    }

    /// The camera's temperature, asked for once in a while; `None` where it has no thermometer.
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

impl Drop for Device {
    fn drop(&mut self) {
        // One that is gone would keep this waiting.
        if !self.gone {
            let _ = self.camera.stop_acquisition();
        }
    }
}

/// Opens a camera by IP address, or by serial number or Aravis id.
///
/// Opened by its name, without listing first, a camera on some hosts sends its stream to the wrong interface: so the
/// name serves to find the address only.
fn find(address: &str) -> Result<Camera, String> {
    let library = LIBRARY.as_ref().ok_or("Aravis is in use already")?;
    let library = library.lock().unwrap_or_else(PoisonError::into_inner);
    if address.parse::<IpAddr>().is_ok() {
        return Camera::new(Some(address))
            .map_err(|error| format!("no camera answers at this address ({error})"));
    }
    let listed = library.get_device_list();
    let text = |text: &std::ffi::CStr| text.to_string_lossy().into_owned();
    let ids: Vec<String> = listed.iter().map(|device| text(&device.id)).collect();
    let found = listed.iter().zip(&ids).find(|(device, id)| {
        *id == address
            || id.ends_with(&format!("-{address}"))
            || text(&device.physical_id) == address
    });
    let Some((device, _)) = found else {
        let found = if ids.is_empty() {
            "none".into()
        } else {
            ids.join(", ")
        };
        return Err(format!("no camera has this serial number; found {found}"));
    };
    Camera::new(Some(&text(&device.address))).map_err(|error| error.to_string())
}

fn name(camera: &Camera) -> String {
    let words = [
        camera.vendor_name(),
        camera.model_name(),
        camera.device_serial_number(),
    ];
    let words: Vec<String> = words.into_iter().flatten().map(Into::into).collect();
    words.join(" ")
}

/// What every flight needs: frames one at a time, each when triggered.
fn prepare(camera: &Camera) -> Result<(), String> {
    let failed = |error: aravis::glib::Error| error.to_string();
    if !has(camera, "TriggerSoftware") {
        return Err("it cannot be triggered by software".into());
    }
    // What the camera's own description rules out is not even sent.
    camera.set_range_check_policy(aravis::RangeCheckPolicy::Enable);
    // One that was left running takes no settings.
    let _ = camera.stop_acquisition();
    camera
        .set_acquisition_mode(aravis::AcquisitionMode::Continuous)
        .map_err(failed)?;
    camera.set_trigger("Software").map_err(failed)
}

/// A stream with buffers for the present size, and the acquisition started.
fn start(camera: &Camera) -> Result<Stream, aravis::glib::Error> {
    let payload = camera.payload()?;
    let stream = camera.create_stream()?;
    for _ in 0..BUFFERS {
        stream.push_buffer(Buffer::new_allocate(payload as usize));
    }
    camera.start_acquisition()?;
    Ok(stream)
}

/// The pixels in a buffer, and where they saturate; `None` for a format that is not understood.
fn pixels(buffer: &Buffer) -> Option<(Pixels, u16)> {
    let bytes = buffer.image_data();
    let format = buffer.image_pixel_format();
    if format == PixelFormat::MONO_8 {
        return Some((Pixels::U8(bytes), 255));
    }
    if format != PixelFormat::MONO_12 {
        return None;
    }
    let dn = |pair: &[u8; 2]| u16::from_le_bytes(*pair);
    Some((
        Pixels::U16(bytes.as_chunks().0.iter().map(dn).collect()),
        4095,
    ))
}
