//! The planned flight: the configuration with its files, checked.
//!
//! ```text
//! configuration + options -> Plan and Remarks -> Flight
//! ```
//!
//! `preflight`, `config check` and `fly` make the same plan, with the same checks of every value against the others. A plan with errors
//! is not flown, unless it is forced.

mod check;
mod cross_checks;
mod remarks;
mod words;

pub use check::device;
pub use remarks::{Faulty, Remark, Remarks, Severity};

use crate::archive::plain;
use crate::aspect;
use crate::camera::{
    self, Camera, CameraError, FrameSource, Source, SourceContext, TakenFiles, give_names,
};
use crate::clock::FlightClock;
use crate::commands::controls::{Controls, Proof};
use crate::config::{Config, ConfiguredCamera};
use crate::instrument::toml_file::{document, read_text};
use crate::instrument::{Dated, Instrument, Stated};
use crate::link::{LocalEnd, PortAddress};
use crate::navigation;
use crate::plate_check::{self, CheckSettings};
use crate::pointing::{Feature, HelioprojectiveArcsec, PointingError, Target};
use crate::sky::{Ephemeris, OrientationTable, SkyError, TableError};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

/// Options of the command line that replace the configuration's values.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Options {
    pub instrument: Option<PathBuf>,
    pub camera: Option<Source>,
    /// The controller's port.
    pub serial: Option<String>,
    /// The archive's folders, the second one if any; empty if the configuration's apply.
    pub archive: Vec<PathBuf>,
}

impl Options {
    /// Replaces values of the configuration by the stated options.
    pub fn apply(&self, config: &mut Config) {
        let mut folders = self.archive.iter().cloned();
        if let Some(first) = folders.next() {
            config.archive.directory = Some(first);
            config.archive.second_directory = folders.next();
        }
        if let Some(instrument) = &self.instrument {
            config.cameras.first_mut().instrument = Some(instrument.clone());
        }
        if let Some(source) = &self.camera {
            config.cameras.first_mut().source = Some(source.clone());
        }
        if let Some(port) = &self.serial {
            config.link.port = Some(port.clone());
        }
    }
}

/// A camera of the planned flight.
#[derive(Debug, Clone)]
pub struct PlannedCamera {
    pub camera: Camera,
    pub configured: ConfiguredCamera,
    pub source: Source,
    /// Dates at which values of its instrument were measured.
    pub dates: Vec<Dated>,
}

/// The navigation of the planned flight.
#[derive(Debug, Clone)]
pub struct PlannedNavigation {
    pub settings: navigation::NavigationSettings,
    /// The text of the settings' file, unchanged.
    pub toml: String,
    /// The IMU's own line; `None` if it uses the controller's.
    pub imu: Option<PortAddress>,
    pub gps: Option<PortAddress>,
}

/// The planned flight.
#[derive(Debug, Clone)]
pub struct Plan {
    pub config: Config,
    /// Cameras in the order of their tables.
    pub cameras: Vec<PlannedCamera>,
    /// Address of the controller, and the local end of a UDP line.
    pub line: Option<(PortAddress, LocalEnd)>,
    /// `None` if the flight has no navigation filter.
    pub navigation: Option<PlannedNavigation>,
    pub orientation: Arc<OrientationTable>,
    pub target: Target,
    /// The clock; a simulated flight begins when it is planned.
    pub clock: FlightClock,
}

/// Replay of frames from a plan's cameras.
#[derive(Debug, Clone, Copy)]
pub struct Replay {
    /// Length of a simulated run; `None` without end.
    pub duration: Option<Duration>,
    /// Speed of the replay of a folder, relative to the original.
    pub speed: f64,
}

impl Default for Replay {
    /// Endless, at the original speed.
    fn default() -> Self {
        let (duration, speed) = (None, 1.0);
        Self { duration, speed }
    }
}

impl Plan {
    /// Reads a configuration (the defaults without a file) and the files of its instruments, navigation and sky, and checks all against
    /// each other. Faulty parts are omitted from the plan, or keep their defaults, and are reported as errors among the remarks.
    pub fn survey(file: Option<&Path>, options: &Options) -> (Self, Remarks) {
        let nobody = match *options == Options::default() {
            true => "defaults",
            false => "the command line",
        };
        let mut remarks = Remarks::of(file.unwrap_or(Path::new(nobody)));
        let mut config = Config::default();
        let read = |file: &Path| {
            let text = read_text(file)?;
            document(file, &text)?;
            Ok(text)
        };
        let text = file.map(|file| (file, remarks.noted(read(file))));
        let was_read = !matches!(text, Some((_, None)));
        if let Some((file, Some(text))) = text {
            let (read, errors) = Config::parse_all(file, &text);
            config = read;
            errors.into_iter().for_each(|what| remarks.wrong(what));
        }
        options.apply(&mut config);
        if was_read {
            cross_checks::check(&config, &mut remarks);
        }
        (Self::of(config, &mut remarks), remarks)
    }

    /// Reads the files named in the configuration.
    fn of(config: Config, remarks: &mut Remarks) -> Self {
        let cameras = cameras(&config, remarks);
        let orientation = orientation(&config).map_err(|error| {
            let expected = "a table as tools/iers makes it";
            remarks.error("sky.earth_orientation", expected, error.to_string());
        });
        let known = orientation.is_ok();
        let orientation = orientation.unwrap_or_else(|()| OrientationTable::built_in());
        let mut ephemeris = Ephemeris::new(Arc::clone(&orientation));
        let target = target(&config, &mut ephemeris).map_err(|error| match error {
            // The reason was already reported.
            _ if !known => {}
            NoTarget::Epoch(error) => {
                let expected = "a time of which the sky is known";
                remarks.error("target.epoch_utc", expected, error.to_string());
            }
            NoTarget::Place(error) => {
                let expected = "a place on the disc, for one with an epoch";
                remarks.error("target", expected, error.to_string());
            }
        });
        // A line with errors is not used, because its guard may be wrong.
        let line = match remarks
            .errors()
            .any(|one| one.what.field.starts_with("link."))
        {
            true => None,
            false => config
                .link
                .address()
                .ok()
                .flatten()
                .zip(config.link.local_end().ok()),
        };
        let plan = Self {
            navigation: navigation(&config, remarks),
            line,
            cameras,
            orientation,
            target: target.unwrap_or_default(),
            clock: config.clock(),
            config,
        };
        plan.prove(remarks);
        plan
    }

    /// Tests whether the solver still finds a Sun with the configured settings.
    fn prove(&self, remarks: &mut Remarks) {
        let instrument = self.cameras.iter().find_map(|one| one.camera.sees.plate());
        let is_changed = self.config.solver() != aspect::SolverSettings::default();
        if let Some(instrument) = instrument.filter(|_| is_changed)
            && let Err(refused) =
                Proof::of(instrument).check("[limb], [fiducial], [registration]", &self.config)
        {
            remarks.error(&refused.key, refused.expected, refused.found);
        }
    }

    /// Settings that the ground may change during such a flight.
    pub fn controls(&self) -> Controls {
        let cameras = self.cameras.iter().map(|one| &one.camera);
        Controls::of_flight(self.config.clone(), self.target, cameras)
    }

    /// Whether the camera to which commands apply exists: without it there is no flight.
    pub fn has_first_camera(&self) -> bool {
        let first = &self.config.cameras.first().name;
        self.cameras
            .first()
            .is_some_and(|one| one.camera.name == *first)
    }

    pub fn ephemeris(&self) -> Ephemeris {
        Ephemeris::new(Arc::clone(&self.orientation))
    }

    /// The archive's folders, the preferred one first.
    pub fn folders(&self) -> Vec<PathBuf> {
        let archive = &self.config.archive;
        let both = [&archive.directory, &archive.second_directory];
        both.into_iter().flatten().cloned().collect()
    }

    /// Record of the files already taken by a camera from a followed folder: stored in the first of the archive's folders; without an
    /// archive, in memory.
    pub fn taken_files(&self, planned: &PlannedCamera) -> TakenFiles {
        let archive = self.folders().into_iter().next();
        archive.map_or_else(TakenFiles::default, |archive| {
            let file = format!("taken_{}.txt", plain(&planned.camera.name));
            TakenFiles::kept_in(&archive.join(file))
        })
    }

    /// Makes the function that opens the camera, as often as needed; `taken` records the files already taken from a followed folder.
    ///
    /// # Errors
    /// Those of [`camera::open`].
    pub fn camera_factory(
        &self,
        planned: &PlannedCamera,
        replay: Replay,
        taken: TakenFiles,
    ) -> impl Fn() -> Result<Box<dyn FrameSource>, CameraError> + Send + Sync + use<> {
        let context = SourceContext {
            sees: planned.camera.sees.clone(),
            clock: self.clock,
            seed: self.config.simulation.seed,
            duration: replay.duration,
            speed: replay.speed,
            taken,
        };
        let (source, settings) = (planned.source.clone(), planned.configured.settings());
        move || camera::open(&source, &settings, &context)
    }
}

/// The cameras with their instruments; a faulty file is reported, and its camera omitted. If there are several, each has its own folder.
fn cameras(config: &Config, remarks: &mut Remarks) -> Vec<PlannedCamera> {
    let mut planned = Vec::new();
    for configured in config.cameras.flying() {
        let Some(source) = configured.source.clone() else {
            continue;
        };
        let (name, role) = (&configured.name, configured.role);
        let stated = Stated::read(role, configured.instrument.as_deref());
        let Some(Stated { sees, toml, dates }) = remarks.noted(stated) else {
            continue;
        };
        if let Some(instrument) = sees.plate() {
            plate(name, instrument, config, remarks);
        }
        planned.push(PlannedCamera {
            camera: Camera {
                toml,
                ..Camera::new(name, role, sees)
            },
            configured: configured.clone(),
            source,
            dates,
        });
    }
    let mut cameras: Vec<Camera> = planned.iter().map(|one| one.camera.clone()).collect();
    give_names(&mut cameras, plain);
    let is_alone = config.cameras.flying().count() == 1;
    for (planned, camera) in planned.iter_mut().zip(cameras) {
        planned.camera = camera;
        if !is_alone {
            planned.camera.folder = plain(&planned.camera.label).into();
        }
    }
    planned
}

/// Checks whether frames of a camera's plate can be identified: an error if none can, a warning if those of some of the field cannot.
fn plate(camera: &str, instrument: &Instrument, config: &Config, remarks: &mut Remarks) {
    /// A smaller part of the field corresponds to randomly drawn mountings that are off by three sigma or more.
    const NOTABLE_PART: f64 = 0.025;
    let (key, least_marks) = (format!("{camera}.instrument"), config.fiducial.min_marks);
    let found = plate_check::check(instrument, &config.solver(), &CheckSettings::quick());
    if let Some(misfit) = &found.misfit {
        return remarks.error(&key, misfit.expected(least_marks), misfit.to_string());
    }
    if let Some((part, meaning)) = found.unreadable().filter(|(part, _)| *part > NOTABLE_PART) {
        let expected =
            "a plate of which frames can be read all over its field (see `solaspect plate check`)";
        let part = 100.0 * part;
        remarks.warn(&key, expected, format!("{part:.0} % of it where {meaning}"));
    }
}

fn navigation(config: &Config, remarks: &mut Remarks) -> Option<PlannedNavigation> {
    let own = &config.navigation;
    let path = own.settings.as_deref().filter(|_| own.is_enabled())?;
    let names: Vec<&str> = config.cameras.iter().map(|one| one.name.as_str()).collect();
    let toml = remarks.noted(read_text(path))?;
    let settings = navigation::NavigationSettings::parse(path, &toml);
    let settings = settings.and_then(|settings| settings.for_flight(path, &names));
    let settings = remarks.noted(settings)?;
    // Their errors were already reported.
    let (imu, gps) = (own.imu_address().ok()?, own.gps_address().ok()?);
    if settings.plumb_rad <= 0.0 && settings.cameras.len() < 2 {
        let expected = "filter.plumb_sigma_deg in its file, or a second camera: one direction determines no attitude";
        remarks.warn("navigation.settings", expected, "neither");
    }
    Some(PlannedNavigation {
        settings,
        toml,
        imu,
        gps,
    })
}

/// The ephemeris with the configured table of Earth orientation, or else the built-in one.
///
/// # Errors
/// If the table is refused.
pub fn ephemeris(config: &Config) -> Result<Ephemeris, TableError> {
    orientation(config).map(Ephemeris::new)
}

fn orientation(config: &Config) -> Result<Arc<OrientationTable>, TableError> {
    match &config.sky.earth_orientation {
        Some(path) => OrientationTable::read(path).map(Arc::new),
        None => Ok(OrientationTable::built_in()),
    }
}

/// Reasons for which a configured target has no position.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum NoTarget {
    #[error("target.epoch_utc: {0}")]
    Epoch(#[from] SkyError),
    #[error("target: {0}")]
    Place(#[from] PointingError),
}

/// The configured target; with an epoch, the feature at that position then.
///
/// # Errors
/// If the sky is not known at the epoch, or the feature is off the disc.
pub fn target(config: &Config, ephemeris: &mut Ephemeris) -> Result<Target, NoTarget> {
    let at = HelioprojectiveArcsec {
        x: config.target.x_arcsec,
        y: config.target.y_arcsec,
    };
    let Some(epoch) = config.target.epoch_utc else {
        return Ok(Target::Fixed(at));
    };
    let disc = ephemeris.disc(epoch)?;
    Ok(Target::Feature(Feature::seen(at, epoch, &disc)?))
}
