//! What can be said of a configuration without touching camera, line or disk: every error at once.

use super::Finding;
use super::bounded::within;
use super::plan::{self, NoTarget, Options, Plan, PlannedCamera};
use crate::camera::{CameraError, FolderCamera, Source};
use crate::commands::CameraRole;
use crate::commands::controls::{Controls, Proof, SavedValues, differences};
use crate::config::{self, Config, saved};
use crate::files;
use crate::instrument::toml_file::{document, read_text};
use crate::instrument::{DirectionCamera, Instrument, MountedCamera, SkyCamera, TomlError};
use crate::navigation::Settings;
use crate::pointing::{HelioprojectiveArcsec, Target};
use crate::simulate::Pieces;
use crate::sky::{Ephemeris, OrientationTable};
use serde::Serialize;
use std::fmt;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Severity {
    Error,
    /// It would fly, though perhaps not as was meant.
    Warning,
}

/// One thing that is wrong with a configuration, or odd.
#[derive(Debug, Clone, PartialEq)]
pub struct Remark {
    pub severity: Severity,
    pub what: TomlError,
    /// What to do about it.
    pub remedy: &'static str,
}

/// A folder of a day's frames may take seconds to list.
const PATIENCE: Duration = Duration::from_secs(20);
const PARAMETERS: &str = "see docs/parameters.md";
const BUILD: &str = "take a program built with `--features gige`, or another camera";

impl fmt::Display for Remark {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let severity = match self.severity {
            Severity::Error => "error",
            Severity::Warning => "warning",
        };
        write!(out, "{severity}: {}", self.what)
    }
}

/// Keys of which the checks before a flight tell more.
const CHECKED_LATER: [&str; 4] = [
    "archive.directory",
    "archive.second_directory",
    "link.port",
    "site",
];

impl Remark {
    /// Whether a line of the page will say the same.
    pub(super) fn is_checked_later(&self) -> bool {
        let key = self.what.field.as_str();
        self.severity == Severity::Warning && CHECKED_LATER.contains(&key)
    }

    pub(super) fn finding(&self) -> Finding {
        let what = self.what.to_string();
        match self.severity {
            Severity::Error => Finding::fail("configuration", what, self.remedy),
            Severity::Warning => Finding::warn("configuration", what, self.remedy),
        }
    }
}

/// The remarks on a configuration, in the order of the looking.
#[derive(Debug, Clone, Default)]
pub struct Remarks {
    file: PathBuf,
    pub list: Vec<Remark>,
}

impl Remarks {
    fn add(&mut self, severity: Severity, what: TomlError) {
        let remedy = match what.path == self.file {
            true => PARAMETERS,
            false => "name a file that is there and sound",
        };
        self.list.push(Remark {
            severity,
            what,
            remedy,
        });
    }

    /// An error in a key of the configuration.
    fn error(&mut self, key: &str, expected: impl Into<String>, found: impl Into<String>) {
        let what = TomlError::new(&self.file, key, expected, found);
        self.add(Severity::Error, what);
    }

    fn warn(&mut self, key: &str, expected: impl Into<String>, found: impl Into<String>) {
        let what = TomlError::new(&self.file, key, expected, found);
        self.add(Severity::Warning, what);
    }

    /// The value of a file, or the error noted.
    fn noted<T>(&mut self, result: Result<T, TomlError>) -> Option<T> {
        result.map_err(|what| self.add(Severity::Error, what)).ok()
    }

    /// What `work` gives, or an error in a key of the configuration where the disk that it looks at hangs.
    fn answered<T: Send + 'static>(
        &mut self,
        key: &str,
        work: impl FnOnce() -> T + Send + 'static,
    ) -> Option<T> {
        within(PATIENCE, work)
            .map_err(|none| self.error(key, "a disk that answers", none.to_string()))
            .ok()
    }

    pub fn has_errors(&self) -> bool {
        let is_error = |remark: &Remark| remark.severity == Severity::Error;
        self.list.iter().any(is_error)
    }
}

/// Reads a configuration (the defaults without a file) and every file that it names. There is a plan where there is no
/// error.
pub fn survey(file: Option<&Path>, options: &Options) -> (Option<Plan>, Remarks) {
    let (plan, remarks) = survey_anyway(file, options);
    (Some(plan).filter(|_| !remarks.has_errors()), remarks)
}

/// As [`survey`], with a plan of what could be read where there are errors: defaults for the rest, and no camera whose
/// instrument is wrong.
pub(super) fn survey_anyway(file: Option<&Path>, options: &Options) -> (Plan, Remarks) {
    let mut remarks = Remarks {
        file: file.unwrap_or(Path::new("defaults")).into(),
        list: Vec::new(),
    };
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
        let errors = errors.into_iter();
        errors.for_each(|what| remarks.add(Severity::Error, what));
    }
    options.over(&mut config);
    if was_read {
        cross_check(&config, &mut remarks);
    }
    let plan = files(config, &mut remarks);
    (plan, remarks)
}

/// The cameras' tables.
fn tables(config: &Config) -> [(&'static str, CameraRole, Option<Source>, &config::Camera); 4] {
    let first = &config.camera;
    let (second, roll, moon) = (
        &config.second_camera,
        &config.roll_camera,
        &config.moon_camera,
    );
    [
        ("camera", CameraRole::PitchYaw, first.source.clone(), first),
        (
            "second_camera",
            CameraRole::PitchYaw,
            second.source.clone(),
            second,
        ),
        ("roll_camera", CameraRole::Roll, roll.source.clone(), roll),
        ("moon_camera", CameraRole::Moon, moon.source.clone(), moon),
    ]
}

fn navigation(config: &Config, remarks: &mut Remarks) {
    let own = &config.navigation;
    for address in [own.imu_address(), own.gps_address()] {
        if let Err(refused) = address {
            remarks.error(refused.key, refused.expected, refused.found);
        }
    }
    let Some(path) = own.settings.as_deref().filter(|_| own.is_enabled()) else {
        return;
    };
    let settings = Settings::read(path).and_then(|settings| settings.for_flight(path));
    let settings = remarks.noted(settings);
    if own.gps_port.is_none() {
        let expected = "a GPS receiver: without a fix the filter never begins";
        remarks.warn("navigation.gps_port", expected, "none");
    }
    let begins = |settings: &Settings| settings.plumb_rad > 0.0 || settings.cameras.len() > 1;
    if settings.is_some_and(|settings| !begins(&settings)) {
        let expected = "filter.plumb_sigma_deg in its file, or a second camera: one direction tells no attitude";
        remarks.warn("navigation.settings", expected, "neither");
    }
}

fn cross_check(config: &Config, remarks: &mut Remarks) {
    for fault in config.faults() {
        remarks.error(fault.key, fault.expected, fault.found);
    }
    for (table, _, source, camera) in tables(config) {
        if source.is_some() {
            exposure(table, camera, remarks);
        }
    }
    roll(config, remarks);
    moon(config, remarks);
    same_sources(config, remarks);
    archive(&config.archive, remarks);
    link(config, remarks);
    navigation(config, remarks);
    if config.site.place().is_none() {
        remarks.warn(
            "site",
            "a place, for offsets where neither frames nor GPS tell one",
            "none",
        );
    }
}

/// A roll that is too old for the next frame of the Sun before the next of the horizon comes.
fn roll(config: &Config, remarks: &mut Remarks) {
    let camera = &config.roll_camera;
    let period_s = 1.0 / camera.rate_hz;
    if camera.instrument.is_some() && config.roll.max_age_s < period_s {
        let expected =
            format!("{period_s:.3} s or more, as from frame to frame at roll_camera.rate_hz");
        remarks.warn(
            "roll.max_age_s",
            expected,
            config.roll.max_age_s.to_string(),
        );
    }
}

/// A request for the Moon waits for the exposure that runs, the next one, and its reading.
fn moon(config: &Config, remarks: &mut Remarks) {
    let camera = &config.moon_camera;
    let least_s = 2.0 / camera.rate_hz;
    if camera.source.is_some() && config.moon.answer_within_s < least_s {
        let expected = format!("{least_s:.3} s or more, two periods of moon_camera.rate_hz");
        remarks.warn(
            "moon.answer_within_s",
            expected,
            config.moon.answer_within_s.to_string(),
        );
    }
}

fn exposure(table: &str, camera: &config::Camera, remarks: &mut Remarks) {
    let (shortest, longest) = (camera.auto_exposure_min_us, camera.auto_exposure_max_us);
    let period_us = 1e6 / camera.rate_hz;
    let key = |name: &str| format!("{table}.{name}");
    if camera.auto_exposure().is_none() || shortest >= longest {
        return;
    }
    if !(shortest..=longest).contains(&camera.exposure_us) {
        let expected =
            format!("one that automatic exposure may choose, {shortest} to {longest} us");
        remarks.warn(
            &key("exposure_us"),
            expected,
            camera.exposure_us.to_string(),
        );
    }
    if f64::from(longest) > period_us {
        let expected = format!("less than the {period_us:.0} us from frame to frame at rate_hz");
        remarks.warn(&key("auto_exposure_max_us"), expected, longest.to_string());
    }
}

/// A camera can be opened once; a folder or the simulator may serve twice, if that is meant.
fn same_sources(config: &Config, remarks: &mut Remarks) {
    let tables = tables(config);
    for (n, (table, role, source, camera)) in tables.iter().enumerate() {
        let namesake = |(_, _, other, _): &&(_, _, Option<Source>, _)| other == source;
        let Some((other, ..)) = tables[..n].iter().find(namesake) else {
            continue;
        };
        let key = format!("{table}.source");
        let expected = format!("another source than that of {other}");
        let sees_sky = *role != CameraRole::PitchYaw && camera.instrument.is_some();
        match source {
            None => {}
            // The simulator then draws the horizon or the Moon.
            Some(Source::Simulated(_)) if sees_sky => {}
            Some(source @ Source::Gige(_)) => remarks.error(&key, expected, source.to_string()),
            Some(source) => remarks.warn(&key, expected, source.to_string()),
        }
    }
}

fn archive(archive: &config::Archive, remarks: &mut Remarks) {
    match (&archive.directory, &archive.second_directory) {
        (None, None) => remarks.warn("archive.directory", "a folder, to keep frames", "none"),
        (Some(first), Some(second)) if first == second => {
            let found = second.display().to_string();
            remarks.error(
                "archive.second_directory",
                "another folder than the first",
                found,
            );
        }
        (Some(first), Some(second)) => {
            let folders = [first, second].map(Clone::clone);
            let devices = move || folders.map(|folder| super::disks::device(&folder));
            let devices = remarks.answered("archive.second_directory", devices);
            if devices.is_some_and(|[first, second]| first.is_some() && first == second) {
                let found = format!("{} on that of {}", second.display(), first.display());
                remarks.warn(
                    "archive.second_directory",
                    "a folder on another disk",
                    found,
                );
            }
        }
        _ => {}
    }
}

fn link(config: &Config, remarks: &mut Remarks) {
    let link = &config.link;
    match link.address() {
        Ok(None) => remarks.warn(
            "link.port",
            "the controller's port",
            "none: nothing is sent",
        ),
        Ok(Some(_)) => {
            let rest = [link.local_end().map(drop), link.guard().map(drop)];
            for refused in rest.into_iter().filter_map(Result::err) {
                remarks.error(refused.key, refused.expected, refused.found);
            }
        }
        Err(refused) => remarks.error(refused.key, refused.expected, refused.found),
    }
    if let Some(values) = &config.link.saved_values {
        saved_values(values, remarks);
    }
}

/// Only whether they can be read and kept: what flies checks their sum, and starts without them where it is wrong. A file of something else
/// is never replaced.
fn saved_values(file: &Path, remarks: &mut Remarks) {
    let key = "link.saved_values";
    let path = file.display();
    let folder = file
        .parent()
        .filter(|folder| !folder.as_os_str().is_empty());
    let folder = folder.unwrap_or(Path::new(".")).to_owned();
    let is_there = remarks.answered(key, move || folder.is_dir());
    if is_there == Some(false) {
        remarks.error(key, "a file in a folder that is there", path.to_string());
    }
    if is_there != Some(true) {
        return;
    }
    match files::read(file, saved::LARGEST) {
        Err(unread) if unread.is_absent() => {}
        Err(unread) => remarks.error(
            key,
            unread.expected(),
            format!("{path}: {}", unread.found()),
        ),
        Ok(bytes) if !saved::is_ours(&bytes) => {
            let expected = "a file of saved values, or none: no other is replaced";
            remarks.error(key, expected, format!("{path}: another file"));
        }
        Ok(bytes) => {
            let parsed = String::from_utf8_lossy(&bytes).parse::<toml::Table>();
            remarks.noted(
                parsed.map_err(|error| TomlError::new(file, "", "valid TOML", error.message())),
            );
        }
    }
}

/// What the files say that the configuration names.
fn files(config: Config, remarks: &mut Remarks) -> Plan {
    let cameras = cameras(&config, remarks);
    values(&config, &cameras, remarks);
    let orientation = plan::orientation(&config).map_err(|error| {
        let expected = "a table as tools/iers makes it";
        remarks.error("sky.earth_orientation", expected, error.to_string());
    });
    let known = orientation.is_ok();
    let orientation = orientation.unwrap_or_else(|()| OrientationTable::built_in());
    let mut ephemeris = Ephemeris::new(Arc::clone(&orientation));
    let target = plan::target(&config, &mut ephemeris).map_err(|error| match error {
        // It has been said why.
        _ if !known => {}
        NoTarget::Epoch(error) => {
            remarks.error(
                "target.epoch_utc",
                "a time of which the sky is known",
                error.to_string(),
            );
        }
        NoTarget::Place(error) => {
            remarks.error(
                "target",
                "a place on the disc, for one with an epoch",
                error.to_string(),
            );
        }
    });
    let centre = HelioprojectiveArcsec { x: 0.0, y: 0.0 };
    Plan {
        cameras,
        orientation,
        target: target.unwrap_or(Target::Fixed(centre)),
        config,
    }
}

/// Whether the solver's settings leave a Sun, and what was saved of commands that would fly instead of the configuration.
fn values(config: &Config, cameras: &[PlannedCamera], remarks: &mut Remarks) {
    let sees_plate = |camera: &&PlannedCamera| camera.role == CameraRole::PitchYaw;
    let Some(first) = cameras.iter().find(sees_plate) else {
        return;
    };
    let tried = Proof::of(&first.instrument).check("limb.level_fraction", config);
    if let Err(refused) = tried {
        remarks.error(
            "[limb], [fiducial], [registration]",
            refused.expected,
            refused.found,
        );
    }
    let target = Target::Fixed(HelioprojectiveArcsec { x: 0.0, y: 0.0 });
    let controls = Controls::new(config.clone(), target, first.instrument.mounting);
    let roles: Vec<CameraRole> = cameras.iter().map(|camera| camera.role).collect();
    controls.note_cameras(&roles);
    controls.note_instrument(&first.instrument);
    let Some(file) = SavedValues::of(config) else {
        return;
    };
    match differences(&controls, &file) {
        Ok((differences, refused)) => {
            let expected = format!("the configuration's values in {}", file.path().display());
            for difference in differences {
                remarks.warn("saved values", expected.clone(), difference);
            }
            for refused in refused {
                let found = format!("{} (left out)", refused.found);
                remarks.warn(refused.key, refused.expected, found);
            }
        }
        Err(error) => remarks.warn("saved values", "a file that can be read", error.to_string()),
    }
}

/// The cameras with their instruments; each file that is wrong is noted, and its camera left out.
fn cameras(config: &Config, remarks: &mut Remarks) -> Vec<PlannedCamera> {
    let mut planned = Vec::new();
    for (table, role, source, camera) in tables(config) {
        let Some(source) = source else { continue };
        check_source(table, &source, camera, remarks);
        let file = camera.instrument.as_deref();
        let plate = file.filter(|_| role == CameraRole::PitchYaw);
        let sky = file.and_then(|file| match role {
            CameraRole::PitchYaw => None,
            CameraRole::Roll => {
                let camera = MountedCamera::read(file).map(SkyCamera::Horizon);
                remarks.noted(camera)
            }
            CameraRole::Moon => {
                let camera = DirectionCamera::read(file).map(SkyCamera::Moon);
                remarks.noted(camera)
            }
        });
        let instrument = remarks.noted(Instrument::read_with_dates(plate));
        planned.extend(instrument.map(|(instrument, dates)| PlannedCamera {
            table,
            role,
            source,
            config: camera.clone(),
            instrument,
            sky,
            dates,
        }));
    }
    planned
}

fn check_source(table: &str, source: &Source, camera: &config::Camera, remarks: &mut Remarks) {
    let key = format!("{table}.source");
    match source {
        Source::Folder(folder) => {
            let (folder, rate_hz) = (folder.clone(), camera.rate_hz);
            let open = move || FolderCamera::open(&folder, rate_hz, 1.0).map(drop);
            match remarks.answered(&key, open) {
                None | Some(Ok(())) => {}
                Some(Err(CameraError::Folder { folder, found })) => {
                    let found = format!("{found} in {}", folder.display());
                    remarks.error(&key, "a folder of frames", found);
                }
                Some(Err(error)) => {
                    remarks.error(&key, "a folder of frames", error.to_string());
                }
            }
        }
        Source::Simulated(Some(file)) => {
            remarks.noted(Pieces::read(file));
        }
        Source::Gige(_) if cfg!(not(feature = "gige")) => {
            let expected = "a program built with `--features gige` for such a camera";
            let what = TomlError::new(&remarks.file, &key, expected, source.to_string());
            let severity = Severity::Error;
            remarks.list.push(Remark {
                severity,
                what,
                remedy: BUILD,
            });
        }
        Source::Gige(_) | Source::Simulated(None) => {}
    }
}
