//! `solaspect refine`: the best aspect history from a flight's archive.

use super::options;
use super::output::{make_folder, progress_bar, say};
use crate::archive::check::Tree;
use crate::archive::{CONFIGURATION, Flown, FlownFile, FlownFiles, INSTRUMENT};
use crate::config::Config;
use crate::instrument::{Instrument, SECOND, builtin_text};
use crate::refine::{
    self, CameraFrames, Done, Flight, Input, Recipe, Report, Shard, Sky, Span, Summary,
};
use crate::units::Place;
use anyhow::{Context, bail, ensure};
use clap::Args;
use jiff::Timestamp;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Make the best aspect history from a flight's archive
///
/// The first pass solves every frame on its own and notes each in a journal in --out: killed and run again, it goes on where it
/// was. The second looks at the flight as a whole and writes aspect.fits, aspect.csv, summary.json and report.html. On a cluster
/// each machine does its --shard, and a last run with --merge takes their journals together.
/// Files that cannot be read have a row that says why, and are no failure. Frames of several cameras make a history each, in a
/// folder of --out, and one report.
#[derive(Debug, Args)]
#[command(allow_negative_numbers = true)]
pub struct RefineArgs {
    /// A folder tree of FITS frames
    #[arg(value_name = "ARCHIVE")]
    archive: PathBuf,
    /// Where journal and results go; made if it is not there
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// The instrument's TOML file; for several cameras, once for each [default: the archive's, else the built-in one that the
    /// frames name, else "demo"]
    #[arg(long, value_name = "FILE")]
    instrument: Vec<PathBuf>,
    /// The configuration's TOML file [default: the archive's solver, place and target, if it holds a configuration]
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Frames at a time [default: as many as there are cores]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    jobs: Option<u16>,
    /// Only every Nth frame from the Ith on, and only the first pass
    #[arg(long, value_name = "I/N", conflicts_with = "merge")]
    shard: Option<Shard>,
    /// Take the journals of other runs of the same archive, instrument and settings together
    #[arg(long, value_name = "DIR", num_args = 1..)]
    merge: Vec<PathBuf>,
    /// Only frames whose mid-exposure is not before this, UTC
    #[arg(long, value_name = "TIME")]
    since: Option<Timestamp>,
    /// Only frames whose mid-exposure is not after this, UTC
    #[arg(long, value_name = "TIME")]
    until: Option<Timestamp>,
    /// Where the frames were taken, for frames that do not say so
    #[arg(long, value_name = "LAT,LON,HEIGHT_M", allow_hyphen_values = true)]
    place: Option<Place>,
}

pub fn run(args: &RefineArgs) -> anyhow::Result<ExitCode> {
    let tree = Tree::of(&args.archive)?;
    let archived = FlownFiles::read(&tree.flown)?;
    let config = args.configuration(&archived)?;
    let jobs = args.jobs.map_or(0, usize::from);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(jobs).build()?;
    pool.install(|| {
        let inputs = args.inputs(tree);
        let cameras = refine::cameras(&args.archive, inputs);
        let (roll, cameras): (Vec<_>, Vec<_>) = cameras
            .into_iter()
            .partition(|camera| camera.is_roll_camera());
        ensure!(
            roll.is_empty() || !cameras.is_empty(),
            "{}: expected frames of a camera that sees the plate, found the roll camera's alone",
            args.archive.display()
        );
        let several = cameras.len() > 1;
        // What may be missing is told before hours of work.
        let recipes = cameras
            .iter()
            .map(|camera| args.recipe(camera, &archived, &config));
        let recipes = recipes.collect::<anyhow::Result<Vec<_>>>()?;
        let mut ephemeris = options::ephemeris(&config)?;
        let sky = Sky {
            target: options::target(&config, &mut ephemeris)?,
            place: config.site.place(),
            ephemeris,
        };
        make_folder(&args.out)?;
        let mut report = Report::default();
        for frames in roll.iter().map(|camera| camera.inputs.len()) {
            let text = format!(
                "{frames} frames of the roll camera: they show no plate and are not refined"
            );
            say(format_args!("{text}"))?;
            report.note(&text);
        }
        for (camera, recipe) in cameras.iter().zip(recipes) {
            let label = several.then_some(camera.label.as_str());
            args.refine(camera, label, &recipe, &sky, &mut report)?;
        }
        if args.shard.is_none() {
            report.write(&args.out)?;
        }
        Ok(ExitCode::SUCCESS)
    })
}

impl RefineArgs {
    /// The configuration of `--config`, else what the archive's say of solver, place and target, else the defaults.
    fn configuration(&self, archived: &FlownFiles) -> anyhow::Result<Config> {
        let mut config = match &self.config {
            Some(path) => Config::read(path)?,
            None => self.archived_configuration(archived)?,
        };
        if let Some(place) = self.place {
            config.site = place.into();
        }
        Ok(config)
    }

    fn archived_configuration(&self, archived: &FlownFiles) -> anyhow::Result<Config> {
        let mut found: Vec<Config> = Vec::new();
        for file in archived.of(CONFIGURATION) {
            let flown = Config::parse(&file.path, &file.text)
                .context("the archive's configuration cannot be used: name one with --config")?;
            // The rest is of the flight's computer alone.
            let config = Config {
                site: flown.site,
                target: flown.target,
                limb: flown.limb,
                fiducial: flown.fiducial,
                registration: flown.registration,
                ..Config::default()
            };
            if !found.contains(&config) {
                found.push(config);
            }
        }
        ensure!(
            found.len() <= 1,
            "{}: expected one [site], [target], [limb], [fiducial] and [registration], found {} in its configuration_*.toml: \
             name a configuration with --config",
            self.archive.display(),
            found.len()
        );
        Ok(found.pop().unwrap_or_default())
    }

    /// What a camera's frames are refined with.
    fn recipe(
        &self,
        camera: &CameraFrames,
        archived: &FlownFiles,
        config: &Config,
    ) -> anyhow::Result<Recipe> {
        let (instrument, text) = self.instrument(archived, camera)?;
        Ok(Recipe {
            instrument,
            settings: config.solver(),
            flown: Flown::new(config.to_toml(), Some(text)),
            archived: self.authority(archived.clone()),
        })
    }

    /// A camera's instrument, with its text: the one of `--instrument` that is its own, else the archive's, else the built-in one
    /// that its frames name, else the demo.
    fn instrument(
        &self,
        archived: &FlownFiles,
        camera: &CameraFrames,
    ) -> anyhow::Result<(Instrument, String)> {
        let flown = flown_with(archived, camera);
        if !self.instrument.is_empty() {
            let (instrument, text) = self.told_instrument(camera)?;
            refuse_other_sensor(&instrument, &flown)?;
            return Ok((instrument, text));
        }
        match flown.as_slice() {
            [one] => {
                let instrument = Instrument::parse(&one.path, &one.text).context(
                    "the archive's instrument cannot be used: name one with --instrument",
                )?;
                Ok((instrument, one.text.clone()))
            }
            [] => built_in(camera).with_context(|| self.archive.display().to_string()),
            several => bail!(
                "{}: expected one instrument, found {} that differ in its instrument_*.toml: name one with --instrument",
                self.archive.display(),
                several.len()
            ),
        }
    }

    /// The first of `--instrument` that a camera's frames do not contradict.
    fn told_instrument(&self, camera: &CameraFrames) -> anyhow::Result<(Instrument, String)> {
        let mut refused = None;
        for path in &self.instrument {
            let (instrument, text) = options::instrument_with_text(Some(path))?;
            match instrument.check_taken_by(&camera.taken_by) {
                Ok(()) => return Ok((instrument, text)),
                Err(wrong) => refused = Some((path, wrong)),
            }
        }
        let (path, wrong) = refused.context("expected a file of --instrument, found none")?;
        let frame = camera.inputs.first().map_or("", |input| &input.file);
        bail!(
            "{}: {frame}: {wrong}: {} is not of the camera that took these frames",
            self.archive.display(),
            path.display()
        )
    }

    /// What frames may name: of what was told instead, anything.
    fn authority(&self, mut archived: FlownFiles) -> FlownFiles {
        let told = [
            (self.config.is_some(), CONFIGURATION),
            (!self.instrument.is_empty(), INSTRUMENT),
        ];
        for (_, kind) in told.iter().filter(|(is_told, _)| *is_told) {
            archived = archived.without(*kind);
        }
        archived
    }

    /// Makes the history of one camera; of several, in a folder of its own.
    fn refine(
        &self,
        camera: &CameraFrames,
        label: Option<&str>,
        recipe: &Recipe,
        sky: &Sky,
        report: &mut Report,
    ) -> anyhow::Result<()> {
        let inputs = &camera.inputs;
        let mut done = self.first_pass(recipe, inputs)?;
        if self.shard.is_some() {
            return Ok(());
        }
        let flight = self.second_pass(&mut done, inputs, recipe, sky)?;
        let folder = label.map_or(self.out.clone(), |label| self.out.join(label));
        make_folder(&folder)?;
        let summary = refine::write(&folder, &flight, recipe)?;
        report.add(label, &self.archive, &flight, &summary, &recipe.instrument);
        if let Some(label) = label {
            say(format_args!("{label}:"))?;
        }
        print(&summary)
    }

    fn inputs(&self, tree: Tree) -> Vec<Input> {
        let inputs = refine::inputs(&tree, &self.archive, &self.out);
        let Some(shard) = self.shard else {
            return inputs;
        };
        let (skip, every) = (shard.number as usize - 1, shard.of as usize);
        inputs.into_iter().skip(skip).step_by(every).collect()
    }

    fn span(&self) -> Span {
        Span {
            since: self.since,
            until: self.until,
        }
    }

    fn first_pass(&self, recipe: &Recipe, inputs: &[Input]) -> anyhow::Result<Done> {
        let name = format!("{:016x}.journal", recipe.hash());
        let others = journals(&self.merge, &name)?;
        let mut done = Done::open(&self.out.join(&name), &others)?;
        let left = inputs.iter().filter(|input| !done.holds(input)).count();
        let progress = progress_bar(left, "frames");
        let each = || progress.inc(1);
        done.work(&self.archive, inputs, recipe, &self.span(), &each)?;
        progress.finish_and_clear();
        Ok(done)
    }

    fn second_pass(
        &self,
        done: &mut Done,
        inputs: &[Input],
        recipe: &Recipe,
        sky: &Sky,
    ) -> anyhow::Result<Flight> {
        let mut flight = refine::second_pass(done, &self.archive, inputs, recipe, &self.span())?;
        ensure!(
            !flight.rows.is_empty(),
            "{}: expected frames from --since to --until, found none",
            self.archive.display()
        );
        if let Some(contradiction) = &flight.contradiction {
            bail!("{}: {contradiction}", self.archive.display());
        }
        sky.fill(&recipe.instrument, &mut flight.rows, &flight.places);
        Ok(flight)
    }
}

/// The archive's files of a camera's instrument, of which none is another's letter by letter: those that its frames name by their hash,
/// else those that do not contradict them.
fn flown_with<'a>(archived: &'a FlownFiles, camera: &CameraFrames) -> Vec<&'a FlownFile> {
    let mut different: Vec<&FlownFile> = Vec::new();
    for file in archived.of(INSTRUMENT) {
        if !different.iter().any(|other| other.text == file.text) {
            different.push(file);
        }
    }
    let is_named = |file: &&&FlownFile| camera.instruments_sha256.contains(file.sha256());
    if different.iter().any(|file| is_named(&file)) {
        return different.iter().filter(is_named).copied().collect();
    }
    // One that only a newer program can read contradicts nothing.
    different.retain(|file| {
        let instrument = Instrument::parse(&file.path, &file.text);
        instrument.is_ok_and(|instrument| instrument.check_taken_by(&camera.taken_by).is_ok())
    });
    different
}

/// The built-in instrument that a camera's frames name; the demo where they name none.
fn built_in(camera: &CameraFrames) -> anyhow::Result<(Instrument, String)> {
    let Some(named) = camera.taken_by.instrument.as_deref() else {
        return options::instrument_with_text(None);
    };
    let name = named.strip_suffix(SECOND).unwrap_or(named);
    let text = builtin_text(name).with_context(|| {
        format!(
            "expected the file of instrument \"{name}\", which the frames name (OBSRVTRY), found none in the archive and none built in: \
             name it with --instrument"
        )
    })?;
    Ok((Instrument::parse(Path::new(name), text)?, text.into()))
}

/// Refuses an instrument of another camera than those that the archive was flown with.
fn refuse_other_sensor(told: &Instrument, flown: &[&FlownFile]) -> anyhow::Result<()> {
    let size = |instrument: &Instrument| (instrument.camera.width_px, instrument.camera.height_px);
    let flown = flown
        .iter()
        .map(|file| Instrument::parse(&file.path, &file.text));
    // One that only a newer program can read contradicts nothing.
    let sizes: Vec<_> = flown
        .flatten()
        .map(|instrument| size(&instrument))
        .collect();
    ensure!(
        sizes.is_empty() || sizes.contains(&size(told)),
        "instrument \"{}\": expected a sensor of the archive's instrument, {:?} px, found {:?} px",
        told.name,
        sizes[0],
        size(told)
    );
    Ok(())
}

/// The journals of other runs: one in each folder, of the same name, for it tells instrument and settings.
fn journals(folders: &[PathBuf], name: &str) -> anyhow::Result<Vec<PathBuf>> {
    let journal = |folder: &PathBuf| -> anyhow::Result<PathBuf> {
        let path = folder.join(name);
        let found = path.is_file();
        ensure!(
            found,
            "{}: expected a journal of the same version, instrument and settings ({name}), found none",
            folder.display()
        );
        Ok(path)
    };
    folders.iter().map(journal).collect()
}

fn print(summary: &Summary) -> anyhow::Result<()> {
    say(format_args!(
        "{} files: {} fine ({} by themselves), {} coarse, {} none",
        summary.files, summary.fine, summary.own_fine, summary.coarse, summary.none
    ))?;
    for (odd, count) in &summary.odd {
        say(format_args!("  {count} odd: {odd}"))?;
    }
    if let Some(sigma) = summary.median_sigma_mil {
        say(format_args!("median sigma {sigma:.4} mil per axis"))?;
    }
    for jump in summary.mapping.iter().flat_map(|mapping| &mapping.jumps) {
        say(format_args!("the mapping jumps by {}", jump.text()))?;
    }
    for [name, value] in summary.clock.lines() {
        say(format_args!("{name}: {value}"))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_without_the_journal_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let error = journals(&[folder.path().into()], "x.journal").unwrap_err();
        let name = folder.path().display().to_string();
        assert!(error.to_string().starts_with(&name), "{error}");
    }
}
