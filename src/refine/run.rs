//! Refines an archive to its history: `solaspect refine` as a function.

use super::attitude::AttitudeFound;
use super::comparison::{Compared, Difference, Dips};
use super::files::{Files, Overrides};
use super::films::make_film;
use super::history::{History, HistoryError};
use super::navigation::{Navigation, Sensors, ordinal};
use super::output::{PointingFacts, Summary, Written, write, write_rows, write_stabilisation};
use super::pointing::States;
use super::recipe::Recipe;
use super::report::{Report, Rows};
use super::roll::{RollHistory, RollRecipe};
use super::roll_output::{RollSummary, write_roll};
use super::roll_report::RollRows;
use super::sky::Sky;
use super::solar_path::SolarPath;
use super::stabilisation::stabilisation;
use crate::archive::ArchiveReader;
use crate::config::Config;
use crate::film::{self, Film};
use crate::frame::Unreadable;
use crate::instrument::Role;
use crate::observe::{
    self, CameraFrames, Cameras, InputSummary, Observer, Pass, Shard, Span, Watch,
};
use crate::plan;
use crate::pointing_history::PointingHistory;
use crate::report::html::Page;
use crate::units::counted;
use anyhow::{Context, bail, ensure};
use std::collections::BTreeMap;
use std::fs::create_dir_all;
use std::path::{Path, PathBuf, absolute};
use std::thread::available_parallelism;

/// Frames read in parallel from an object store for each core: waiting for the network takes several times as long as solving.
const REMOTE_JOBS: usize = 8;
/// Default rate of the table POINTING.
const POINTING_RATE_HZ: f64 = 10.0;

/// Options of a refinement.
#[derive(Debug, Clone, Default)]
pub struct Options {
    /// The folder of journal and results; made if missing.
    pub out: PathBuf,
    pub overrides: Overrides,
    /// Frames read and solved in parallel; by default one for each core, from an object store eight.
    pub jobs: Option<usize>,
    /// A part of the frames, which are observed only.
    pub shard: Option<Shard>,
    /// Folders of other runs of the same archive, instrument and settings, whose journals are read.
    pub merge: Vec<PathBuf>,
    pub span: Span,
    /// Rows a second of the table of offsets between frames.
    pub rate_hz: Option<f64>,
    /// Rows a second of the table POINTING; 10 by default.
    pub pointing_rate_hz: Option<f64>,
    pub navigation: Option<Navigation>,
    pub film: Option<film::Options>,
}

/// Results, which are also written to the folder.
#[derive(Default)]
pub struct Refined {
    /// The cameras of a shard, which have no history.
    pub shard: Vec<ShardDone>,
    pub cameras: Vec<RefinedCamera>,
    pub roll: Option<RefinedRoll>,
    pub attitude: Option<AttitudeFound>,
    /// Frames that were ignored, with the reason.
    pub notes: Vec<String>,
    /// Files that could not be read for now, each with the reason.
    pub unread: BTreeMap<String, String>,
    /// Frames that were read, and files that cannot be.
    frames: usize,
    unreadable: Unreadable,
}

/// The frames of a camera that a shard has observed.
pub struct ShardDone {
    pub shard: Shard,
    pub label: String,
    pub files: usize,
    pub unreadable: usize,
}

/// The history of a camera that sees the plate.
pub struct RefinedCamera {
    /// Name that distinguishes it from others; none of a single camera.
    pub label: Option<String>,
    pub history: History,
    pub pointing: PointingHistory,
    pub summary: Summary,
    pub stabilised: Option<Stabilised>,
    pub film: Option<film::Made>,
}

/// The table of offsets between frames.
#[derive(Debug, Clone, Copy)]
pub struct Stabilised {
    pub rate_hz: f64,
    pub rows: usize,
    /// Rows with a known offset.
    pub valid: usize,
}

pub struct RefinedRoll {
    pub history: RollHistory,
    pub summary: RollSummary,
}

impl Refined {
    /// Refuses an incomplete run: some files could not be read for now, or no frame at all was read.
    ///
    /// # Errors
    /// The first such file; the reason why the files cannot be read.
    pub fn check(&self, archive: &Path) -> anyhow::Result<()> {
        if let Some((file, why)) = self.unread.first_key_value() {
            bail!(
                "{}: expected to read all files, found {} that could not be read, such as {file}: {why}; run again to try again",
                archive.display(),
                self.unread.len()
            );
        }
        match self.unreadable.line() {
            Some(why) if self.frames == 0 => bail!(
                "{}: expected frames that can be read, found none: {why}",
                archive.display()
            ),
            _ => Ok(()),
        }
    }

    fn count(&mut self, files: usize, inputs: &InputSummary) {
        self.frames += inputs.frames(files);
        self.unreadable.add(&inputs.unreadable);
    }
}

/// Refines an archive: a folder tree of FITS frames, or the URL of objects. `watch` receives the progress and may cancel; completed
/// frames stay in the journal.
///
/// # Errors
/// If archive, options or files do not match, the frames are not of the instrument's camera, the folder cannot be written, or
/// `watch` cancels. Single bad frames are rows with the reason.
pub fn refine(archive: &Path, options: &Options, watch: &dyn Watch) -> anyhow::Result<Refined> {
    let archive = ArchiveReader::open(archive, &options.out)?;
    let cores = available_parallelism().map_or(1, usize::from);
    let default = if archive.is_remote() {
        REMOTE_JOBS * cores
    } else {
        cores
    };
    let jobs = options.jobs.unwrap_or(default);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(jobs).build()?;
    pool.install(|| {
        Run {
            archive: &archive,
            options,
        }
        .refine(watch)
    })
}

/// Inputs of a run that all cameras share.
struct Run<'a> {
    archive: &'a ArchiveReader,
    options: &'a Options,
}

impl Run<'_> {
    fn refine(&self, watch: &dyn Watch) -> anyhow::Result<Refined> {
        let (archive, options) = (self.archive, self.options);
        let listing = archive.list()?;
        let files = Files {
            archive: archive.name(),
            archived: archive.flown(&listing.flown)?,
            overrides: &options.overrides,
        };
        let config = files.configuration()?;
        let navigation = options
            .navigation
            .as_ref()
            .filter(|_| options.shard.is_none());
        let sensors = navigation.map(|n| n.read(archive, &listing.navigation));
        let sensors = sensors.transpose()?;
        make_folder(&options.out)?;
        let pass = Pass {
            archive,
            out: &options.out,
            merge: &options.merge,
            shard: options.shard,
            span: options.span,
            watch,
        };
        let cameras = observe::cameras(&pass, listing.frames)?;
        // Refuse missing inputs before hours of work.
        let film = options.film.as_ref().map(|film| self.film(film));
        let film = film.transpose()?;
        let recipes = Recipes::of(&files, &cameras, &config)?;
        if let Some(sensors) = &sensors {
            sensors.check(&cameras.plate)?;
            let instruments = recipes.plate.iter().map(|recipe| &recipe.instrument);
            instruments
                .into_iter()
                .try_for_each(|i| sensors.check_instrument(i))?;
        }
        match options.shard {
            Some(shard) => observe_shard(&pass, shard, &cameras, &recipes),
            None => {
                let mut refined = self.histories(&pass, cameras, recipes, &config, sensors)?;
                for camera in &mut refined.cameras {
                    let of = (&camera.history, &camera.pointing);
                    let label = camera.label.as_deref();
                    let make = |film: &Film| make_film(film, label, of, archive, watch);
                    camera.film = film.as_ref().map(make).transpose()?.flatten();
                }
                Ok(refined)
            }
        }
    }

    /// Files of the film, which must not be in the archive: there its pictures would be taken for frames.
    fn film(&self, film: &film::Options) -> anyhow::Result<Film> {
        let path = absolute(&film.destination.path)?;
        let folder = path
            .ancestors()
            .find_map(|folder| folder.canonicalize().ok());
        let is_in = |other: &Path| {
            let other = other.canonicalize().ok();
            folder
                .as_ref()
                .zip(other)
                .is_some_and(|(folder, other)| folder.starts_with(other))
        };
        ensure!(
            !is_in(self.archive.name()) || is_in(&self.options.out),
            "{}: expected a film outside of the archive or within --out, found one in {}",
            path.display(),
            self.archive.name().display()
        );
        Ok(Film::new(film)?)
    }

    /// Makes the histories of all cameras, and writes them with their report.
    fn histories(
        &self,
        pass: &Pass<'_>,
        cameras: Cameras,
        recipes: Recipes,
        config: &Config,
        mut sensors: Option<Sensors<'_>>,
    ) -> anyhow::Result<Refined> {
        let mut ephemeris = plan::ephemeris(config)?;
        let sky = Sky {
            target: plan::target(config, &mut ephemeris)?,
            place: config.site.place(),
            ephemeris,
        };
        let (mut refined, mut report) = (Refined::default(), Report::default());
        refined.notes = ignored_frames(&cameras, &recipes);
        refined.frames = cameras.others.iter().map(|other| other.inputs.len()).sum();
        refined.notes.iter().for_each(|note| report.note(note));
        let (mut roll_rows, mut dips) = (RollRows::default(), Dips::default());
        if let Some((camera, recipe)) = cameras.roll.zip(recipes.roll.as_ref()) {
            let roll_ordinal = ordinal(&camera);
            let done = pass.run(recipe, "frames", &camera.inputs)?;
            let history = RollHistory::new(done, camera, recipe, &pass.span)?;
            let summary = write_roll(pass.out, &history, recipe, |row| {
                roll_rows.take(row);
                dips.add(row);
                sensors
                    .iter_mut()
                    .for_each(|sensors| sensors.add_nadir(roll_ordinal, row));
            })?;
            refined.count(history.len(), history.inputs());
            refined.roll = Some(RefinedRoll { history, summary });
        }
        let is_one = cameras.plate.len() == 1;
        let mut results = Vec::new();
        for (camera, recipe) in cameras.plate.into_iter().zip(recipes.plate) {
            let (label, ordinal) = (camera.label.clone(), ordinal(&camera));
            let history = self.history(pass, camera, recipe, &sky, refined.roll.as_ref())?;
            let label = Some(label).filter(|_| !is_one);
            let folder = label
                .as_ref()
                .map_or(pass.out.to_owned(), |l| pass.out.join(l));
            make_folder(&folder)?;
            let mut rows = Rows::default();
            let written = write_rows(&folder, &history, |row| {
                rows.take(row);
                let see = |sensors: &mut Sensors| {
                    sensors.add_sun(ordinal, row, history.instrument());
                };
                sensors.iter_mut().for_each(see);
            })?;
            refined.count(history.len(), history.inputs());
            results.push(CameraResult {
                label,
                folder,
                history,
                rows,
                written,
            });
        }
        let (mut states, mut differences) = (States::default(), Vec::new());
        let mut of_gyros = Page::default();
        if let Some(sensors) = sensors {
            let names = [pass.archive.name(), pass.out];
            let instrument = results.first().map(|result| result.history.instrument());
            let by_gyros = sensors.find_attitude(&sky, instrument, names)?;
            (states, differences) = (by_gyros.states, by_gyros.differences);
            of_gyros = by_gyros.page;
            refined.attitude = Some(by_gyros.found);
        }
        let others = OtherSensors {
            roll: refined.roll.as_ref().map(|roll| &roll.history),
            states: &states,
            differences: &differences,
            dips: &dips,
        };
        for result in results {
            let camera = self.finish(result, &others, pass.archive, &mut report)?;
            refined.cameras.push(camera);
        }
        if let Some((roll, recipe)) = refined.roll.as_ref().zip(recipes.roll.as_ref()) {
            report.add_roll(pass.archive, &roll_rows, &roll.summary, recipe);
        }
        report.append(of_gyros);
        report.write(pass.out)?;
        refined.unread = pass.archive.unread_files();
        Ok(refined)
    }

    /// Makes the history of one camera that sees the plate.
    fn history(
        &self,
        pass: &Pass<'_>,
        camera: CameraFrames,
        recipe: Recipe,
        sky: &Sky,
        roll: Option<&RefinedRoll>,
    ) -> anyhow::Result<History> {
        pass.expect_journals(&recipe)?;
        let done = pass.run(&recipe, "frames", &camera.inputs)?;
        let history = History::new(done, camera, recipe, sky.clone(), pass);
        let history = history.map_err(|error| match error {
            HistoryError::Pass(error) => anyhow::Error::from(error),
            error => anyhow::anyhow!("{}: {error}", pass.archive.name().display()),
        })?;
        Ok(match roll {
            Some(roll) => history.with_roll(&roll.history),
            None => history,
        })
    }

    /// Writes the pointing from a camera's history and the gyros.
    fn finish(
        &self,
        result: CameraResult,
        others: &OtherSensors<'_>,
        archive: &ArchiveReader,
        report: &mut Report,
    ) -> anyhow::Result<RefinedCamera> {
        let CameraResult {
            label,
            folder,
            history,
            rows,
            written,
        } = result;
        let mut pointing = history.pointing_with(others.roll, others.states)?;
        let compared = Compared::of(others.differences, others.dips, &pointing);
        for finding in compared.iter().flat_map(|compared| &compared.findings) {
            tracing::warn!("{finding}");
            pointing.contradict(finding.during_s);
        }
        let rate_hz = self.options.pointing_rate_hz.unwrap_or(POINTING_RATE_HZ);
        let solar_path = SolarPath::of(&pointing, history.sky());
        let facts = PointingFacts {
            cameras_against_gyros: compared,
            on_target: solar_path.on_target(),
        };
        let summary = write(&folder, &history, written, facts, &pointing, rate_hz)?;
        let label_text = label.as_deref();
        report.add(label_text, archive, &history, &summary, &rows, &solar_path);
        Ok(RefinedCamera {
            stabilised: self.stabilise(&folder, &history, &pointing)?,
            film: None,
            label,
            history,
            pointing,
            summary,
        })
    }

    /// Writes the table of offsets between frames, if selected.
    fn stabilise(
        &self,
        folder: &Path,
        history: &History,
        pointing: &PointingHistory,
    ) -> anyhow::Result<Option<Stabilised>> {
        let Some(rate_hz) = self.options.rate_hz else {
            return Ok(None);
        };
        let rows = stabilisation(history, pointing, rate_hz)?;
        write_stabilisation(folder, &rows, history, pointing)?;
        Ok(Some(Stabilised {
            rate_hz,
            rows: rows.len(),
            valid: rows.iter().filter(|row| row.offset.is_some()).count(),
        }))
    }
}

/// Data of a camera once its rows are written.
struct CameraResult {
    label: Option<String>,
    folder: PathBuf,
    history: History,
    rows: Rows,
    written: Written,
}

/// Other sensors' measurements of the telescope's pointing.
struct OtherSensors<'a> {
    roll: Option<&'a RollHistory>,
    /// States of the pointing, by gyros.
    states: &'a States,
    /// Differences of cameras from the gyros.
    differences: &'a [Difference],
    dips: &'a Dips,
}

/// The recipes for the frames of each camera.
struct Recipes {
    plate: Vec<Recipe>,
    /// None where the roll camera's file is missing.
    roll: Option<RollRecipe>,
}

impl Recipes {
    fn of(files: &Files<'_>, cameras: &Cameras, config: &Config) -> anyhow::Result<Self> {
        let plate = cameras
            .plate
            .iter()
            .map(|camera| files.recipe(camera, config));
        let plate = plate.collect::<anyhow::Result<Vec<_>>>()?;
        let roll = cameras
            .roll
            .as_ref()
            .map(|camera| files.roll_recipe(camera, config));
        let roll = roll.transpose()?.flatten();
        ensure!(
            !plate.is_empty() || cameras.roll.is_none() || roll.is_some(),
            "{}: expected frames of a camera that sees the plate or the file of the roll camera (--roll-camera), found the roll camera's frames \
             alone",
            files.archive.display()
        );
        Ok(Self { plate, roll })
    }
}

/// Frames that are ignored, in words.
fn ignored_frames(cameras: &Cameras, recipes: &Recipes) -> Vec<String> {
    let frames = |camera: &CameraFrames| counted(camera.inputs.len() as u64, "frame");
    let others = cameras.others.iter().map(|camera| {
        let (frames, label) = (frames(camera), &camera.label);
        match camera.named_role() {
            Some((Role::Moon, 1)) => {
                format!("skipped: {frames} of the Moon camera; `solaspect moon` solves them")
            }
            Some((Role::Roll, _)) => format!(
                "skipped: {frames} of another roll camera, \"{label}\": refine its folder by itself"
            ),
            _ => format!("skipped: {frames} of camera \"{label}\""),
        }
    });
    let roll = cameras.roll.as_ref().filter(|_| recipes.roll.is_none());
    let roll = roll.map(|camera| {
        let frames = frames(camera);
        format!(
            "{frames} of the roll camera: its file is not in the archive; --roll-camera names it"
        )
    });
    others.chain(roll).collect()
}

/// Observes a part of the frames only.
fn observe_shard(
    pass: &Pass<'_>,
    shard: Shard,
    cameras: &Cameras,
    recipes: &Recipes,
) -> anyhow::Result<Refined> {
    let mut refined = Refined::default();
    if let Some((camera, recipe)) = cameras.roll.as_ref().zip(recipes.roll.as_ref()) {
        refined.shard.push(shard_of(pass, shard, camera, recipe)?);
    }
    for (camera, recipe) in cameras.plate.iter().zip(&recipes.plate) {
        pass.expect_journals(recipe)?;
        refined.shard.push(shard_of(pass, shard, camera, recipe)?);
    }
    refined.notes = ignored_frames(cameras, recipes);
    refined.unread = pass.archive.unread_files();
    Ok(refined)
}

fn shard_of(
    pass: &Pass<'_>,
    shard: Shard,
    camera: &CameraFrames,
    observer: &impl Observer,
) -> anyhow::Result<ShardDone> {
    let done = pass.run(observer, "frames", &camera.inputs)?;
    Ok(ShardDone {
        shard,
        label: camera.label.clone(),
        files: camera.inputs.len(),
        unreadable: done.unreadable(&camera.inputs)?,
    })
}

fn make_folder(folder: &Path) -> anyhow::Result<()> {
    create_dir_all(folder)
        .with_context(|| format!("{}: cannot create the folder", folder.display()))
}
