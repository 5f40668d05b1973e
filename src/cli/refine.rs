//! `solaspect refine`: the best aspect history from a flight's archive.

use super::options;
use super::output::{make_folder, progress_bar, say};
use crate::archive::check::Tree;
use crate::archive::{CONFIGURATION, Flown, FlownFile, FlownFiles, INSTRUMENT};
use crate::config::Config;
use crate::instrument::Instrument;
use crate::refine::{self, Done, Flight, Input, Recipe, Shard, Sky, Span, Summary};
use crate::units::Place;
use anyhow::{Context, bail, ensure};
use clap::Args;
use jiff::Timestamp;
use std::path::PathBuf;
use std::process::ExitCode;

/// Make the best aspect history from a flight's archive
///
/// The first pass solves every frame on its own and notes each in a journal in --out: killed and run again, it goes on where it
/// was. The second looks at the flight as a whole and writes aspect.fits, aspect.csv, summary.json and report.html. On a cluster
/// each machine does its --shard, and a last run with --merge takes their journals together.
/// Files that cannot be read have a row that says why, and are no failure.
#[derive(Debug, Args)]
#[command(allow_negative_numbers = true)]
pub struct RefineArgs {
    /// A folder tree of FITS frames
    #[arg(value_name = "ARCHIVE")]
    archive: PathBuf,
    /// Where journal and results go; made if it is not there
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// The instrument's TOML file [default: the archive's, else the built-in instrument "demo"]
    #[arg(long, value_name = "FILE")]
    instrument: Option<PathBuf>,
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
    let inputs = args.inputs(tree);
    let config = args.configuration(&archived)?;
    let (instrument, text) = args.instrument(&archived)?;
    let mut ephemeris = options::ephemeris(&config)?;
    let recipe = Recipe {
        instrument,
        settings: config.solver(),
        flown: Flown::new(config.to_toml(), Some(text)),
        archived: args.authority(archived),
    };
    let sky = Sky {
        instrument: recipe.instrument.clone(),
        target: options::target(&config, &mut ephemeris)?,
        place: config.site.place(),
        ephemeris,
    };
    make_folder(&args.out)?;
    let jobs = args.jobs.map_or(0, usize::from);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(jobs).build()?;
    pool.install(|| args.refine(&inputs, &recipe, &sky))
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

    /// The instrument of `--instrument`, else the archive's, else the built-in demo; with its text.
    fn instrument(&self, archived: &FlownFiles) -> anyhow::Result<(Instrument, String)> {
        let flown = |file: &FlownFile| -> anyhow::Result<_> {
            let instrument = Instrument::parse(&file.path, &file.text)
                .context("the archive's instrument cannot be used: name one with --instrument")?;
            Ok((instrument, file.text.clone()))
        };
        let mut texts: Vec<&FlownFile> = Vec::new();
        for file in archived.of(INSTRUMENT) {
            if !texts.iter().any(|other| other.text == file.text) {
                texts.push(file);
            }
        }
        match (&self.instrument, texts.as_slice()) {
            (None, [one]) => flown(one),
            (None, [_, _, ..]) => bail!(
                "{}: expected one instrument, found {} that differ in its instrument_*.toml: name one with --instrument",
                self.archive.display(),
                texts.len()
            ),
            (told, flown) => {
                let (instrument, text) = options::instrument_with_text(told.as_deref())?;
                refuse_other_sensor(&instrument, flown)?;
                Ok((instrument, text))
            }
        }
    }

    /// What frames may name: of what was told instead, anything.
    fn authority(&self, mut archived: FlownFiles) -> FlownFiles {
        for (told, kind) in [
            (&self.config, CONFIGURATION),
            (&self.instrument, INSTRUMENT),
        ] {
            if told.is_some() {
                archived = archived.without(kind);
            }
        }
        archived
    }

    fn refine(&self, inputs: &[Input], recipe: &Recipe, sky: &Sky) -> anyhow::Result<ExitCode> {
        let mut done = self.first_pass(recipe, inputs)?;
        if self.shard.is_some() {
            return Ok(ExitCode::SUCCESS);
        }
        let flight = self.second_pass(&mut done, inputs, recipe, sky)?;
        let summary = refine::write(&self.out, &flight, recipe)?;
        refine::write_report(
            &self.out,
            &self.archive,
            &flight,
            &summary,
            &recipe.instrument,
        )?;
        print(&summary)?;
        Ok(ExitCode::SUCCESS)
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
        sky.fill(&mut flight.rows, &flight.places);
        Ok(flight)
    }
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
        let [x, y] = jump.shift_px;
        say(format_args!(
            "the mapping jumps by {x:.2}, {y:.2} px before {}",
            jump.file
        ))?;
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
