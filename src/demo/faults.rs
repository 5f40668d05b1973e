//! Faults that a trainer injects into a demonstration and removes again, each where real hardware would fail: at the camera, at the disk, on
//! the line.

use crate::archive::faulty::{DiskFault, FaultyDisk};
use crate::camera::{CameraError, CameraHealth, CameraSettings, FrameSource, Take};
use jiff::Timestamp;
use std::fmt;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

/// The part at fault.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Fault {
    /// The camera that sees the plate gives no frames, and reports nothing.
    CameraDead,
    /// The archive's disk takes no byte, and reports that none is free.
    DiskFull,
    /// Nothing passes the line between the aspect system and the controller, in either direction.
    LineCut,
}

impl Fault {
    pub const ALL: [Self; 3] = [Self::CameraDead, Self::DiskFull, Self::LineCut];

    /// Its name for programs.
    pub fn name(self) -> &'static str {
        match self {
            Self::CameraDead => "camera_dead",
            Self::DiskFull => "disk_full",
            Self::LineCut => "line_cut",
        }
    }
}

/// The faults of one demonstration, and the losses they have caused. Clones share them.
#[derive(Debug, Clone, Default)]
pub struct Faults {
    on: Arc<[AtomicBool; Fault::ALL.len()]>,
    disk: FaultyDisk,
    frames_withheld: Arc<AtomicU64>,
    bytes_cut: Arc<AtomicU64>,
}

impl Faults {
    pub fn begin(&self, fault: Fault) {
        self.set(fault, true);
    }

    pub fn end(&self, fault: Fault) {
        self.set(fault, false);
    }

    fn set(&self, fault: Fault, on: bool) {
        self.on[fault as usize].store(on, Ordering::Relaxed);
        if fault == Fault::DiskFull {
            self.disk.set(on.then_some(DiskFault::Full));
        }
    }

    pub fn is_on(&self, fault: Fault) -> bool {
        self.on[fault as usize].load(Ordering::Relaxed)
    }

    pub fn cost(&self) -> FaultCost {
        FaultCost {
            frames_withheld: self.frames_withheld.load(Ordering::Relaxed),
            bytes_cut: self.bytes_cut.load(Ordering::Relaxed),
        }
    }

    /// The archive's disk.
    pub(super) fn disk(&self) -> FaultyDisk {
        self.disk.clone()
    }

    /// Number of these bytes that pass the line: all of them, or none if it is cut.
    pub(super) fn passed(&self, bytes: usize) -> usize {
        if !self.is_on(Fault::LineCut) {
            return bytes;
        }
        self.bytes_cut.fetch_add(bytes as u64, Ordering::Relaxed);
        0
    }

    /// A camera that these faults silence.
    pub(super) fn on_camera<S: FrameSource>(&self, camera: S) -> TrainingCamera<S> {
        TrainingCamera {
            camera,
            faults: self.clone(),
        }
    }
}

/// Losses that the flight itself does not count: frames that the disk refused are in its own tally.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct FaultCost {
    /// Frames that the camera took and did not deliver.
    pub frames_withheld: u64,
    /// Bytes that did not pass the line, in both directions together.
    pub bytes_cut: u64,
}

impl fmt::Display for FaultCost {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            out,
            "training   {} frames not given by the camera, {} bytes cut off on the line",
            self.frames_withheld, self.bytes_cut
        )
    }
}

/// A simulated camera that may fall silent. Its frames do not wait, like those of a real camera: the flight loses them.
pub(super) struct TrainingCamera<S> {
    camera: S,
    faults: Faults,
}

impl<S: FrameSource> FrameSource for TrainingCamera<S> {
    fn next(&mut self, starts: &mut dyn FnMut(Timestamp)) -> Result<Take, CameraError> {
        if !self.faults.is_on(Fault::CameraDead) {
            return self.camera.next(starts);
        }
        // During the fault it continues: otherwise it would have to catch up with all its frames afterwards.
        Ok(match self.camera.next(&mut |_| {})? {
            Take::Exposure(_) => {
                self.faults.frames_withheld.fetch_add(1, Ordering::Relaxed);
                Take::NotYet
            }
            other => other,
        })
    }

    fn apply(&mut self, settings: &CameraSettings) -> Result<(), CameraError> {
        self.camera.apply(settings)
    }

    fn health(&self) -> CameraHealth {
        self.camera.health()
    }
}
