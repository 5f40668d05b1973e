//! The frames of a camera: their triggers, their buffers, and losses in transport.

use super::numbers::Ids;
use aravis::glib::object::ObjectExt;
use aravis::prelude::*;
use aravis::{Buffer, Camera, FakeDevice, Stream};
use std::time::Duration;

/// Number of buffers of a stream: frames that may arrive before they are fetched.
const BUFFERS: usize = 4;

/// Interface of a camera.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Transport {
    GigeVision,
    /// USB3 Vision.
    Other,
    /// Aravis's fake device. It ignores triggers, and fills every buffer that it is given: here, one for each trigger.
    Fake,
}

impl Transport {
    fn of(camera: &Camera) -> Self {
        let is_fake = |device: aravis::Device| device.is::<FakeDevice>();
        if camera.is_gv_device() {
            Self::GigeVision
        } else if camera.device().is_some_and(is_fake) {
            Self::Fake
        } else {
            Self::Other
        }
    }
}

/// Losses of a stream.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Losses {
    /// Lost packets; GigE Vision only.
    pub packets: u64,
    /// Frames for which no buffer was free.
    pub underruns: u64,
}

/// A stream of frames, one for each trigger.
pub(super) struct Frames {
    transport: Transport,
    stream: Stream,
    /// The fake device's buffer, while it waits for a trigger.
    spare: Option<Buffer>,
    /// Losses so far.
    lost: Losses,
}

impl Frames {
    /// Starts a stream with buffers for the present size, and the acquisition. The previous stream must be gone.
    pub(super) fn start(camera: &Camera) -> Result<Self, aravis::glib::Error> {
        let payload = camera.payload()? as usize;
        let mut frames = Self {
            transport: Transport::of(camera),
            stream: camera.create_stream()?,
            spare: None,
            lost: Losses::default(),
        };
        let buffers = match frames.transport {
            Transport::Fake => 1,
            Transport::GigeVision | Transport::Other => BUFFERS,
        };
        for _ in 0..buffers {
            frames.give_back(Buffer::new_allocate(payload));
        }
        camera.start_acquisition()?;
        Ok(frames)
    }

    /// The form of the camera's frame ids.
    pub(super) fn ids(&self) -> Ids {
        match self.transport {
            Transport::GigeVision | Transport::Fake => Ids::Short,
            Transport::Other => Ids::Long,
        }
    }

    /// Drops frames that still arrived: they belong to triggers that were given up.
    pub(super) fn drop_late(&mut self) {
        while let Some(late) = self.stream.try_pop_buffer() {
            self.give_back(late);
        }
    }

    pub(super) fn trigger(&mut self, camera: &Camera) -> Result<(), aravis::glib::Error> {
        if let Some(buffer) = self.spare.take() {
            self.stream.push_buffer(buffer);
        }
        camera.software_trigger()
    }

    /// The frame of a trigger; `None` if none comes in time.
    pub(super) fn wait(&self, wait: Duration) -> Option<Buffer> {
        self.stream.timeout_pop_buffer(wait.as_micros() as u64)
    }

    /// Makes a buffer available again.
    pub(super) fn give_back(&mut self, buffer: Buffer) {
        match self.transport {
            Transport::Fake => self.spare = Some(buffer),
            Transport::GigeVision | Transport::Other => self.stream.push_buffer(buffer),
        }
    }

    /// Losses since the last call.
    pub(super) fn new_losses(&mut self) -> Losses {
        let now = self.losses();
        let before = std::mem::replace(&mut self.lost, now);
        Losses {
            packets: now.packets.saturating_sub(before.packets),
            underruns: now.underruns.saturating_sub(before.underruns),
        }
    }

    fn losses(&self) -> Losses {
        let (_, _, underruns) = self.stream.statistics();
        match self.transport {
            Transport::GigeVision => Losses {
                packets: self.stream.info_uint64_by_name("n_missing_packets"),
                underruns,
            },
            // Other cameras do not have that number, and Aravis complains about a request for it.
            Transport::Other => Losses {
                packets: 0,
                underruns,
            },
            // It counts every request for a buffer when none was free.
            Transport::Fake => Losses::default(),
        }
    }
}
