//! Parts of a flight.

use super::frames::stations;
use super::messages::Station;
use crate::archive::disk::{LocalDisk, Lock};
use crate::archive::{ArchiveError, Store};
use crate::bounded::within;
use crate::camera::{Camera, CameraError, FrameSource, Source};
use crate::clock::FlightClock;
use crate::commands::controls::{SavedError, SavedValues};
use crate::config::{Config, Refused};
use crate::instrument::Instrument;
use crate::link::{Connection, LocalEnd, PortAddress};
use crate::navigation::NavigationSettings;
use crate::plan::{Plan, PlannedCamera, PlannedNavigation, Replay};
use crate::pointing::Target;
use crate::provenance::sha256;
use crate::sky::Ephemeris;
use std::fmt::Write;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

/// Parts of a flight.
pub struct Flight {
    pub config: Config,
    /// Target of the telescope until a command changes it.
    pub target: Target,
    pub ephemeris: Ephemeris,
    /// All cameras of the flight. The first pitch-yaw camera, to which commands refer, comes before all others.
    pub cameras: Vec<FlightCamera>,
    /// The line to the controller.
    pub line: Connection,
    /// Attitude propagation between frames; `None` without a navigation filter.
    pub navigation: Option<Navigation>,
    /// The archives on the disks; empty if frames are not kept.
    pub stores: Vec<Store>,
    /// The lock of the saved values, if they are [claimed](Self::claim).
    pub saved_values: Option<Lock>,
}

/// Reason why a flight does not begin: another program may be flying.
#[derive(Debug, thiserror::Error)]
pub enum ClaimError {
    #[error(transparent)]
    Archive(#[from] ArchiveError),
    #[error(transparent)]
    SavedValues(#[from] SavedError),
}

/// Error: no camera of this name has the source `own`.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error("[{0}]: expected a camera of the flight whose source is \"own\", found none")]
pub struct NoOwnCamera(String);

/// Longest wait for a disk at the start. A disk that hangs does not prevent the start.
const CLAIM: Duration = Duration::from_millis(500);

impl Flight {
    /// A flight of the given cameras with the defaults for everything else: no line, no archive, the disc's centre as target.
    pub fn of(cameras: Vec<FlightCamera>) -> Self {
        Self {
            config: Config::default(),
            target: Target::default(),
            ephemeris: Ephemeris::default(),
            cameras,
            line: Connection::none(),
            navigation: None,
            stores: Vec::new(),
            saved_values: None,
        }
    }

    /// The flight of a plan. Cameras, ports and disks are opened later; missing ones are searched for in flight.
    ///
    /// # Errors
    /// If a key of the line can no longer be read.
    pub fn of_plan(plan: &Plan, replay: Replay) -> Result<Self, Refused> {
        let camera = |planned: &PlannedCamera| FlightCamera {
            camera: planned.camera.clone(),
            source: None,
            open: Some(Arc::new(plan.camera_factory(
                planned,
                replay,
                plan.taken_files(planned),
            ))),
        };
        let archive = &plan.config.archive;
        let name = plan.cameras.first().map_or("", |one| &one.camera.label);
        let folders = plan.folders().into_iter();
        let store =
            |folder: PathBuf| Store::new(Arc::new(LocalDisk), &folder, name, archive.packing());
        Ok(Self {
            config: plan.config.clone(),
            target: plan.target,
            ephemeris: plan.ephemeris(),
            line: line(plan)?,
            navigation: plan.navigation.as_ref().map(|own| navigation(plan, own)),
            stores: folders.map(store).collect(),
            ..Self::of(plan.cameras.iter().map(camera).collect())
        })
    }

    /// Supplies the camera of a table whose source is `own`: `open` opens it, now and whenever its thread has failed.
    ///
    /// # Errors
    /// If no such camera flies.
    pub fn bring_camera<S: FrameSource + 'static>(
        &mut self,
        table: &str,
        open: impl Fn() -> Result<S, CameraError> + Send + Sync + 'static,
    ) -> Result<(), NoOwnCamera> {
        let configured = self.config.cameras.named(table);
        let is_own = configured.is_some_and(|one| one.source == Some(Source::Own));
        let flown = self.cameras.iter_mut().find(|one| one.camera.name == table);
        let camera = flown.filter(|_| is_own);
        let camera = camera.ok_or_else(|| NoOwnCamera(table.into()))?;
        camera.open = Some(Arc::new(move || Ok(Box::new(open()?))));
        Ok(())
    }

    /// Claims archives and saved values for this program alone, before anything is sent or a camera opened. Disks that are missing or
    /// hang are claimed later.
    ///
    /// # Errors
    /// If another program flies with one of them, or the file of saved values is not one.
    pub fn claim(&mut self) -> Result<(), ClaimError> {
        for store in &self.stores {
            store.claim_within(CLAIM)?;
        }
        if let Some(file) = SavedValues::of(&self.config) {
            self.saved_values = within(CLAIM, move || file.claim()).unwrap_or(Ok(None))?;
        }
        Ok(())
    }

    /// The effective configuration as a file that reproduces it. Comments at its head name the cameras' instruments with their
    /// hashes, so that the hash of this text covers the instruments, too.
    pub fn configuration_toml(&self) -> String {
        let mut text = String::new();
        for (number, FlightCamera { camera, .. }) in (1..).zip(&self.cameras) {
            let sha256 = camera.toml.as_ref().map(sha256);
            let sha256 = sha256.map_or("without a file".into(), |sha256| {
                format!("SHA-256 {sha256}")
            });
            // Writing to a String cannot fail.
            let _ = writeln!(
                text,
                "# camera {number}: instrument {:?}, {sha256}",
                camera.label
            );
        }
        if let Some(navigation) = &self.navigation {
            let sha256 = sha256(&navigation.settings_toml);
            let _ = writeln!(text, "# navigation: SHA-256 {sha256}");
        }
        text + &self.config.to_toml()
    }

    /// The cameras' stations; `configuration` is [that of the flight](Self::configuration_toml).
    pub(super) fn stations(&self, configuration: &str) -> Vec<Arc<Station>> {
        let cameras: Vec<&Camera> = self.cameras.iter().map(|one| &one.camera).collect();
        stations(&cameras, configuration)
    }

    /// Opens the cameras that are not open.
    ///
    /// # Errors
    /// The error of the first camera that cannot be opened.
    pub fn open_cameras(&mut self) -> Result<(), CameraError> {
        for camera in &mut self.cameras {
            if let (None, Some(open)) = (&camera.source, &camera.open) {
                camera.source = Some(open()?);
            }
        }
        Ok(())
    }
}

/// The line to the controller.
fn line(plan: &Plan) -> Result<Connection, Refused> {
    let Some((address, local)) = plan.line.clone() else {
        return Ok(Connection::none());
    };
    let link = &plan.config.link;
    Ok(Connection::to(address, link.baud, local).guarded(link.guard()?))
}

fn navigation(plan: &Plan, own: &PlannedNavigation) -> Navigation {
    let connection = |address: &Option<PortAddress>, baud| {
        let address = address.clone();
        address.map(|address| Connection::to(address, baud, LocalEnd::default()))
    };
    Navigation {
        settings: own.settings.clone(),
        settings_toml: own.toml.clone(),
        imu: connection(&own.imu, plan.config.link.baud),
        gps: connection(&own.gps, plan.config.navigation.gps_baud),
        clock: plan.clock,
    }
}

/// The navigation of a flight.
pub struct Navigation {
    pub settings: NavigationSettings,
    /// Verbatim text of the settings file, for the archive.
    pub settings_toml: String,
    /// The IMU's own line; `None` if it sends on the controller's.
    pub imu: Option<Connection>,
    pub gps: Option<Connection>,
    /// Clock against which the date of a fix is checked.
    pub clock: FlightClock,
}

/// A camera of a flight, and the source of its frames.
pub struct FlightCamera {
    pub camera: Camera,
    /// The source of its frames, if it is already open.
    pub source: Option<Box<dyn FrameSource>>,
    /// Opens the source, and opens it again when its thread has failed.
    pub open: Option<CameraFactory>,
}

impl FlightCamera {
    /// A camera that cannot be opened again.
    pub fn new(camera: Camera, source: impl FrameSource + 'static) -> Self {
        Self {
            camera,
            source: Some(Box::new(source)),
            open: None,
        }
    }

    /// The first pitch-yaw camera, which cannot be opened again.
    pub fn of_plate(instrument: Instrument, source: impl FrameSource + 'static) -> Self {
        Self::new(Camera::of_plate(instrument), source)
    }
}

/// Opens a camera.
pub type CameraFactory = Arc<dyn Fn() -> Result<Box<dyn FrameSource>, CameraError> + Send + Sync>;
