//! The attitude between frames: the refined directions together with the flight's IMU and GPS.

use super::attitude::{self, Attitude, AttitudeFound, NavigationFile, Wanted, add_attitude};
use super::comparison::Difference;
use super::pointing::{Slow, States, nearest};
use super::roll::RollRow;
use super::row::RefinedRow;
use super::sky::Sky;
use crate::archive::ArchiveReader;
use crate::geometry::attitude::Direction;
use crate::instrument::role::one_of_several;
use crate::instrument::{Directions, Instrument, Role};
use crate::navigation::files::{read_gps, read_imu};
use crate::navigation::{
    self, Axis, DirectionObservation, Fix, ImuSample, Measurement, Target, Targets,
};
use crate::observe::CameraFrames;
use crate::pointing::{calibration_rad2, measured_sun_in_telescope};
use crate::pointing_history::{Basis, State};
use crate::report::html::Page;
use anyhow::{Context, bail, ensure};
use jiff::Timestamp;
use nalgebra::{Matrix3, UnitQuaternion, Vector3};
use std::ops::RangeInclusive;
use std::path::{Path, PathBuf};

/// Longest interval assumed for the first sample, s.
const LONGEST_S: f64 = 10.0;

/// The files of a flight's IMU and GPS.
#[derive(Debug, Clone)]
pub struct Navigation {
    pub imu: Vec<PathBuf>,
    pub gps: Vec<PathBuf>,
    /// Description of the sensors, NAV.toml; the archive's newest one where it is not named.
    pub settings: Option<PathBuf>,
    pub wanted: Wanted,
}

impl Navigation {
    /// Reads the flight's sensor files. Times count from 1970 where NAV.toml states no epoch.
    pub(super) fn read(
        &self,
        archive: &ArchiveReader,
        in_archive: &[String],
    ) -> anyhow::Result<Sensors<'_>> {
        let mut file = match (&self.settings, in_archive.last()) {
            (Some(path), _) => NavigationFile::read(path)?,
            // The file name holds the time at which the program was started.
            (None, Some(newest)) => NavigationFile::of(archive.text(newest)?)?,
            (None, None) => bail!(
                "{}: expected navigation_*.toml, found none: name a NAV.toml with --navigation",
                archive.name().display()
            ),
        };
        // A flight may have more cameras: their table names end in `_camera`.
        let cameras = file.settings.cameras.clone();
        let further = cameras.iter().map(|camera| camera.name.as_str());
        let further = further.filter(|name| name.ends_with("_camera"));
        let names: Vec<&str> = Role::table_names().into_iter().chain(further).collect();
        file.settings = file.settings.for_flight(&file.path, &names)?;
        let epoch = file.settings.epoch_utc;
        Ok(Sensors {
            epoch: *file
                .settings
                .epoch_utc
                .insert(epoch.unwrap_or(Timestamp::UNIX_EPOCH)),
            runs: read_imu(&self.imu, &file.settings)?,
            fixes: read_gps(&self.gps, &file.settings)?,
            observed: Vec::new(),
            file,
            of: self,
        })
    }
}

/// Attitude by the gyros of a flight.
pub(super) struct ByGyros {
    pub found: AttitudeFound,
    pub states: States,
    /// Differences of the cameras from these states.
    pub differences: Vec<Difference>,
    /// The report's section on this attitude.
    pub page: Page,
}

/// A direction observed in a frame.
struct ObservedDirection {
    t_s: f64,
    camera: usize,
    target: Target,
    direction: Direction,
}

/// IMU and GPS of a flight, and the directions observed in its frames.
pub(super) struct Sensors<'a> {
    of: &'a Navigation,
    file: NavigationFile,
    /// The instant of t_s = 0.
    epoch: Timestamp,
    runs: Vec<Vec<ImuSample>>,
    fixes: Vec<Fix>,
    observed: Vec<ObservedDirection>,
}

impl Sensors<'_> {
    /// Refuses the cameras if it is ambiguous which one is the telescope's own.
    pub fn check(&self, cameras: &[CameraFrames]) -> anyhow::Result<()> {
        let first = cameras.iter().filter(|camera| ordinal(camera) == 1);
        let first: Vec<&str> = first.map(|camera| camera.label.as_str()).collect();
        let second = cameras.iter().filter(|camera| ordinal(camera) == 2).count();
        ensure!(
            first.len() <= 1 && second <= 1,
            "--imu: expected one camera, and a second one whose name ends in \"-2\", found {} and {second} of these: refine the folder of one",
            first.join(", ")
        );
        Ok(())
    }

    /// Refuses an instrument whose directions are not relative to the telescope.
    pub fn check_instrument(&self, instrument: &Instrument) -> anyhow::Result<()> {
        let directions = instrument.mounting.directions;
        ensure!(
            directions == Directions::Telescope,
            "{}: mounting.directions: expected \"telescope\", for --imu, found \"{}\"",
            instrument.name,
            directions.name()
        );
        Ok(())
    }

    /// Records the Sun of a refined frame of the pitch-yaw camera with this ordinal.
    pub fn add_sun(&mut self, ordinal: usize, row: &RefinedRow, instrument: &Instrument) {
        let name = Role::PitchYaw.table(ordinal);
        if let Some((utc, sun)) = row.utc().zip(row.sun_at_time()) {
            let direction = measured_sun_in_telescope(&sun, instrument);
            self.add(name, Target::Sun, utc, direction);
        }
    }

    /// Records the nadir of a frame of the roll camera with this ordinal.
    pub fn add_nadir(&mut self, ordinal: usize, row: &RollRow) {
        if let Some((utc, nadir)) = row.utc().zip(row.nadir_at_time()) {
            self.add(Role::Roll.table(ordinal), Target::Nadir, utc, nadir);
        }
    }

    /// Records a direction; directions of a camera that NAV.toml does not name are ignored.
    fn add(&mut self, name: Option<&str>, target: Target, utc: Timestamp, direction: Direction) {
        if let Some(camera) = name.and_then(|name| self.file.settings.camera(name)) {
            let delay_s = self.file.settings.cameras[camera].delay_s;
            self.observed.push(ObservedDirection {
                t_s: utc.duration_since(self.epoch).as_secs_f64() - delay_s,
                camera,
                target,
                direction,
            });
        }
    }

    /// Determines the attitude from all sensors, and writes it with the telescope's offsets.
    pub fn find_attitude(
        mut self,
        sky: &Sky,
        instrument: Option<&Instrument>,
        [archive, out]: [&Path; 2],
    ) -> anyhow::Result<ByGyros> {
        self.expect_frames()?;
        let mut targets = self.targets(sky);
        let observations = self.observations(&mut targets)?;
        let measurements = Measurement::in_order(observations, &self.fixes);
        let imu = std::mem::take(&mut self.runs);
        let runs = navigation::Flight::of_runs(&self.file.settings, imu, measurements);
        let mut attitude =
            Attitude::solve(&runs, attitude::Basis::WholeFlight, out, &self.of.wanted)?;
        drop(runs);
        attitude.write(Some(self.epoch), true)?;
        attitude.write_calibrated(&self.file, Some(self.epoch), self.files(archive))?;
        self.write_offsets(&mut attitude, &mut targets, sky, out)?;
        let (summary, counts) = (&attitude.summary, &attitude.counts);
        let mut page = Page::default();
        add_attitude(&mut page, &self.file.settings, summary, counts)?;
        let states = match instrument {
            Some(instrument) => self.states(&mut attitude, &mut targets, instrument)?,
            None => States::default(),
        };
        let epoch_s = self.epoch.as_duration().as_secs_f64();
        let difference = |(axis, one): &(Axis, navigation::Difference)| Difference {
            unix_s: epoch_s + one.t_s,
            axis: *axis,
            sigmas: one.sigmas,
        };
        Ok(ByGyros {
            differences: attitude
                .summary
                .differences
                .iter()
                .map(difference)
                .collect(),
            found: attitude.found(),
            states,
            page,
        })
    }

    /// The states of the telescope's pointing: one at each sample of the IMU that has an attitude.
    fn states(
        &self,
        attitude: &mut Attitude,
        targets: &mut Targets,
        instrument: &Instrument,
    ) -> anyhow::Result<States> {
        let epoch_s = self.epoch.as_duration().as_secs_f64();
        let of_body = self.file.settings.body_from_telescope();
        let suns = self.observed.iter().filter(|one| one.target == Target::Sun);
        let mut suns_s: Vec<f64> = suns.map(|one| one.t_s).collect();
        suns_s.sort_by(f64::total_cmp);
        let mut states = States::default();
        for row in attitude.all_rows()? {
            let row = row?;
            let Some((motion, covariance_rad2)) = row.attitude else {
                continue;
            };
            let attitude = motion.attitude * UnitQuaternion::from_rotation_matrix(&of_body);
            let sees_sun = nearest(&suns_s, |sun_s| *sun_s, row.t_s).is_some();
            let state = State {
                unix_s: epoch_s + row.t_s,
                attitude,
                rate_rad_s: Vector3::zeros(),
                covariance_rad2: of_boresight(&covariance_rad2, &attitude),
                basis: if sees_sun { Basis::Both } else { Basis::Gyros },
                is_contradicted: row.status.is_doubted(),
            };
            let to_sun = targets.direction(Target::Sun, row.t_s)?;
            states.push(state, || Slow {
                unix_s: state.unix_s,
                position_m: motion.position_m,
                systematic_rad2: calibration_rad2(
                    &attitude.inverse_transform_vector(&to_sun),
                    instrument,
                ),
            });
        }
        set_rates(&mut states.states);
        Ok(states)
    }

    fn files(&self, archive: &Path) -> Vec<String> {
        let files = self.of.imu.iter().chain(&self.of.gps);
        let files = files.map(PathBuf::as_path).chain([archive]);
        files.map(|path| path.display().to_string()).collect()
    }

    /// The time span from the IMU's first sample to its last.
    fn during_s(&self) -> anyhow::Result<RangeInclusive<f64>> {
        let first = self.runs.first().and_then(|run| run.first());
        let last = self.runs.last().and_then(|run| run.last());
        let (first, last) = first
            .zip(last)
            .context("--imu: expected samples, found none")?;
        Ok(first.t_s..=last.t_s)
    }

    /// Refuses a flight without frames during the IMU's samples, for example because its times count from another epoch.
    fn expect_frames(&self) -> anyhow::Result<()> {
        let during = self.during_s()?;
        let is_during = |one: &ObservedDirection| during.contains(&one.t_s);
        ensure!(
            self.observed.iter().any(is_during),
            "--imu: expected frames that show a direction from {} to {} s since {}, found none of {}",
            during.start(),
            during.end(),
            self.epoch,
            self.observed.len()
        );
        Ok(())
    }

    fn targets(&self, sky: &Sky) -> Targets {
        let sky = navigation::Sky::Ephemeris {
            ephemeris: Box::new(sky.ephemeris.clone()),
            epoch: self.epoch,
        };
        Targets::new(sky, self.fixes.clone())
    }

    fn observations(&self, targets: &mut Targets) -> anyhow::Result<Vec<DirectionObservation>> {
        let settings = &self.file.settings;
        let during = self.during_s()?;
        let during = during.start() - LONGEST_S..=*during.end();
        // Frames of another day are not used, so the ephemeris need not cover them.
        let is_during = |one: &&ObservedDirection| during.contains(&one.t_s);
        let observation = |one: &ObservedDirection| {
            Ok(DirectionObservation {
                t_s: one.t_s,
                camera: one.camera,
                target: one.target,
                unit: one.direction.unit,
                sigma_rad: settings.sigma_rad(one.target, &one.direction),
                towards: targets.towards(one.target, one.t_s)?,
            })
        };
        self.observed
            .iter()
            .filter(is_during)
            .map(observation)
            .collect()
    }

    fn write_offsets(
        &self,
        attitude: &mut Attitude,
        targets: &mut Targets,
        sky: &Sky,
        out: &Path,
    ) -> anyhow::Result<()> {
        let axes = self.file.settings.body_from_telescope();
        let offset = |row: &navigation::NavigationRow| {
            let towards = targets.aim(&sky.target, row.t_s).ok()?;
            navigation::offset(row, &axes, &towards).ok()?
        };
        attitude.write_offsets(&out.join("offsets.csv"), offset)
    }
}

/// Converts a covariance about Earth-fixed axes to rotations that move the boresight right and up, and about the boresight.
fn of_boresight(covariance_rad2: &Matrix3<f64>, attitude: &UnitQuaternion<f64>) -> Matrix3<f64> {
    // A rotation about down moves forward to the right, one about right moves it up.
    let [forward, right, down] = [Vector3::x(), Vector3::y(), Vector3::z()].map(|v| attitude * v);
    let axes = Matrix3::from_columns(&[down, right, forward]);
    axes.tr_mul(covariance_rad2) * axes
}

/// Sets the rates of closely spaced states by differences between each state's neighbours.
fn set_rates(states: &mut [State]) {
    for n in 0..states.len() {
        let [before, after] = [n.saturating_sub(1), (n + 1).min(states.len() - 1)];
        let [before, after] = [before, after].map(|n| states[n]);
        let turned = before.attitude.inverse() * after.attitude;
        let length_s = after.unix_s - before.unix_s;
        if length_s > 0.0 {
            states[n].rate_rad_s = turned.scaled_axis() / length_s;
        }
    }
}

/// Ordinal of a camera within its role, from 1, by its name.
pub(super) fn ordinal(camera: &CameraFrames) -> usize {
    let name = camera.taken_by.instrument.as_deref();
    name.map_or(1, |name| one_of_several(name).1)
}
