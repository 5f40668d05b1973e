//! `solaspect refine`: the best aspect history of a flight.

mod files;
mod navigation;

use super::options;
use super::output::{make_folder, progress_bar, say};
use crate::archive::FlownFiles;
use crate::archive::check::Tree;
use crate::clock::parse_utc;
use crate::refine::{
    self, CameraFrames, Done, FirstPass, Flight, FrameRecord, Input, Recipe, Report, RollHistory,
    RollRecipe, RollSummary, Shard, Sky, Span, Summary,
};
use crate::units::{Place, counted};
use anyhow::{bail, ensure};
use clap::Args;
use jiff::Timestamp;
use navigation::NavigationArgs;
use std::path::PathBuf;
use std::process::ExitCode;

/// Compute the best aspect history from a flight's archive
///
/// The first pass solves every frame on its own and records it in a journal in --out: a run that was killed continues where it
/// was. The second pass uses the flight as a whole and writes aspect.fits, aspect.csv, summary.json and report.html. On a cluster
/// each machine does its --shard, and a last run with --merge merges their journals.
/// Unreadable files get a row with the reason; they do not change the exit code. Each of several cameras has its own history, in a
/// folder of --out, and all have one report. Frames of the roll camera give roll.fits, roll.csv and roll.json, and the roll of the
/// offsets. With --imu and --gps the attitude at every IMU sample is estimated from all frames of the flight.
/// With --rate the telescope's offset at that rate, along the smoothed path between frames, is in stabilisation.fits and .csv.
#[derive(Debug, Args)]
#[command(allow_negative_numbers = true)]
pub struct RefineArgs {
    /// A folder tree of FITS frames
    #[arg(value_name = "ARCHIVE")]
    archive: PathBuf,
    /// Folder for journal and results; created if missing
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// The instrument: a TOML file, or the name of a built-in one; for several cameras, once for each [default: the archive's, else
    /// the built-in one that the frames name, else demo]
    #[arg(long, value_name = "FILE|NAME")]
    instrument: Vec<PathBuf>,
    /// The roll camera's TOML file, with body_from_camera [default: the archive's]
    #[arg(long, value_name = "CAM.toml")]
    roll_camera: Option<PathBuf>,
    /// The configuration's TOML file [default: the archive's solver, place and target, if it holds a configuration]
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Frames solved at a time [default: number of cores]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    jobs: Option<u16>,
    /// Only every Nth frame from the Ith on, and only the first pass
    #[arg(long, value_name = "I/N", conflicts_with = "merge")]
    shard: Option<Shard>,
    /// Merge the journals of other runs of the same archive, instrument and settings
    #[arg(long, value_name = "DIR", num_args = 1..)]
    merge: Vec<PathBuf>,
    /// Only frames whose mid-exposure is not before this: a date, or date and time
    #[arg(long, value_name = "UTC", value_parser = parse_utc)]
    since: Option<Timestamp>,
    /// Only frames whose mid-exposure is not after this
    #[arg(long, value_name = "UTC", value_parser = parse_utc)]
    until: Option<Timestamp>,
    /// Where the frames were taken, for frames that do not say so
    #[arg(long, value_name = "LAT,LON,HEIGHT_M", allow_hyphen_values = true)]
    place: Option<Place>,
    #[command(flatten)]
    navigation: NavigationArgs,
}

pub fn run(args: &RefineArgs) -> anyhow::Result<ExitCode> {
    let tree = Tree::of(&args.archive)?;
    let archived = FlownFiles::read(&tree.flown)?;
    let config = args.configuration(&archived)?;
    let jobs = args.jobs.map_or(0, usize::from);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(jobs).build()?;
    pool.install(|| {
        let cameras = refine::cameras(&args.archive, args.inputs(tree));
        let (moon, cameras): (Vec<_>, Vec<_>) = cameras
            .into_iter()
            .partition(|camera| camera.is_moon_camera());
        let (roll, cameras): (Vec<_>, Vec<_>) = cameras
            .into_iter()
            .partition(|camera| camera.is_roll_camera());
        let several = cameras.len() > 1;
        // What may be missing is told before hours of work.
        let recipes = cameras
            .iter()
            .map(|camera| args.recipe(camera, &archived, &config));
        let recipes = recipes.collect::<anyhow::Result<Vec<_>>>()?;
        let mut sensors = args.navigation.read(&args.archive)?;
        if let Some(sensors) = &sensors {
            sensors.check(&cameras)?;
        }
        let roll = CameraFrames::together(roll);
        let roll_recipe = roll
            .as_ref()
            .map(|camera| args.roll_recipe(camera, &archived, &config));
        let roll_recipe = roll_recipe.transpose()?.flatten();
        ensure!(
            !cameras.is_empty() || roll.is_none() || roll_recipe.is_some(),
            "{}: expected frames of a camera that sees the plate or the file of the roll camera (--roll-camera), found the roll camera's frames \
             alone",
            args.archive.display()
        );
        let mut ephemeris = options::ephemeris(&config)?;
        let sky = Sky {
            target: options::target(&config, &mut ephemeris)?,
            place: config.site.place(),
            ephemeris,
        };
        make_folder(&args.out)?;
        let mut report = Report::default();
        if let Some(camera) = CameraFrames::together(moon) {
            let frames = counted(camera.inputs.len() as u64, "frame");
            let text = format!("left alone: {frames} of the Moon camera; `solaspect moon` solves them");
            say(format_args!("{text}"))?;
            report.note(&text);
        }
        let refined_roll = match (&roll, &roll_recipe) {
            (Some(camera), Some(recipe)) => args.refine_roll(camera, recipe)?,
            (Some(camera), None) => {
                let frames = counted(camera.inputs.len() as u64, "frame");
                let text = format!(
                    "{frames} of the roll camera: its file is not in the archive; --roll-camera names it"
                );
                say(format_args!("{text}"))?;
                report.note(&text);
                None
            }
            (None, _) => None,
        };
        let history = refined_roll.as_ref().map(|(history, _)| history);
        for (camera, recipe) in cameras.iter().zip(recipes) {
            let label = several.then_some(camera.label.as_str());
            let flight = args.refine(camera, label, &recipe, &sky, history, &mut report)?;
            if let Some((sensors, flight)) = sensors.as_mut().zip(flight) {
                sensors.see_sun(camera, &flight, &recipe.instrument)?;
            }
        }
        if let Some(((history, summary), recipe)) = refined_roll.as_ref().zip(roll_recipe) {
            report.add_roll(&args.archive, history, summary, &recipe);
        }
        let mut code = ExitCode::SUCCESS;
        if let Some(mut sensors) = sensors {
            history.into_iter().for_each(|history| sensors.see_nadir(history));
            code = sensors.find_attitude(&sky, [&args.archive, &args.out], &mut report)?;
        }
        if args.shard.is_none() {
            report.write(&args.out)?;
        }
        Ok(code)
    })
}

impl RefineArgs {
    /// Makes the history of one camera; of several, in a folder of its own. None of a shard.
    fn refine(
        &self,
        camera: &CameraFrames,
        label: Option<&str>,
        recipe: &Recipe,
        sky: &Sky,
        roll: Option<&RollHistory>,
        report: &mut Report,
    ) -> anyhow::Result<Option<Flight>> {
        let inputs = &camera.inputs;
        let done = self.first_pass(recipe, inputs, &self.merge)?;
        if self.shard.is_some() {
            return Ok(None);
        }
        let mut flight = self.second_pass(&done, inputs, recipe)?;
        if let Some(roll) = roll {
            roll.fill(&mut flight.rows);
        }
        sky.fill(&recipe.instrument, &mut flight.rows, &flight.places);
        let folder = label.map_or(self.out.clone(), |label| self.out.join(label));
        make_folder(&folder)?;
        let summary = refine::write(&folder, &flight, recipe)?;
        report.add(label, &self.archive, &flight, &summary, &recipe.instrument);
        if let Some(label) = label {
            say(format_args!("{label}:"))?;
        }
        print(&summary)?;
        if let Some(rate_hz) = self.navigation.rate_hz() {
            let rows = refine::stabilisation(&flight, rate_hz, &recipe.instrument, sky, roll)?;
            refine::write_stabilisation(&folder, &rows)?;
            let valid = rows.iter().filter(|row| row.offset.is_some()).count();
            let count = rows.len();
            say(format_args!(
                "stabilisation: {count} rows at {rate_hz} Hz, {valid} of them valid"
            ))?;
        }
        Ok(Some(flight))
    }

    /// Makes the history of the roll camera; none of a shard.
    fn refine_roll(
        &self,
        camera: &CameraFrames,
        recipe: &RollRecipe,
    ) -> anyhow::Result<Option<(RollHistory, RollSummary)>> {
        // A part of few frames may have held none of this camera.
        let name = journal_name(recipe);
        let with_roll = self
            .merge
            .iter()
            .filter(|folder| folder.join(&name).is_file());
        let merged: Vec<PathBuf> = with_roll.cloned().collect();
        let done = self.first_pass(recipe, &camera.inputs, &merged)?;
        if self.shard.is_some() {
            return Ok(None);
        }
        let history = RollHistory::new(&done, &camera.inputs, recipe, &self.span())?;
        let summary = refine::write_roll(&self.out, &history, recipe)?;
        print_roll(&summary)?;
        Ok(Some((history, summary)))
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

    fn first_pass<R: FirstPass>(
        &self,
        recipe: &R,
        inputs: &[Input],
        merged: &[PathBuf],
    ) -> anyhow::Result<Done<R::Frame>> {
        let name = journal_name(recipe);
        let others = journals(merged, &name)?;
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
        done: &Done<FrameRecord>,
        inputs: &[Input],
        recipe: &Recipe,
    ) -> anyhow::Result<Flight> {
        let flight = refine::second_pass(done, &self.archive, inputs, recipe, &self.span())?;
        ensure!(
            !flight.rows.is_empty(),
            "{}: expected frames from --since to --until, found none",
            self.archive.display()
        );
        if let Some(contradiction) = &flight.contradiction {
            bail!("{}: {contradiction}", self.archive.display());
        }
        Ok(flight)
    }
}

fn journal_name(recipe: &impl FirstPass) -> String {
    format!("{:016x}.journal", recipe.hash())
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
        "{}: {} fine ({} by themselves), {} coarse, {} none",
        counted(summary.files as u64, "file"),
        summary.fine,
        summary.own_fine,
        summary.coarse,
        summary.none
    ))?;
    for (odd, count) in &summary.odd {
        say(format_args!("  {count} odd: {odd}"))?;
    }
    if let (Some(mil), Some(arcsec)) = (summary.median_sigma_mil, summary.median_sigma_arcsec) {
        say(format_args!(
            "median sigma {arcsec:.4} arcsec per axis ({mil:.4} mil)"
        ))?;
    }
    for jump in summary.mapping.iter().flat_map(|mapping| &mapping.jumps) {
        say(format_args!("the mapping jumps by {}", jump.text()))?;
    }
    for [name, value] in summary.clock.lines() {
        say(format_args!("{name}: {value}"))?;
    }
    Ok(())
}

fn print_roll(summary: &RollSummary) -> anyhow::Result<()> {
    say(format_args!(
        "roll camera: {}: {} fine, {} coarse, {} none",
        counted(summary.files as u64, "file"),
        summary.fine,
        summary.coarse,
        summary.none
    ))?;
    for (remark, count) in &summary.remarks {
        say(format_args!("  {count} not fine: {remark}"))?;
    }
    if let Some((frame, smoothed)) = summary.frame_sigma_deg.zip(summary.smoothed_sigma_deg) {
        say(format_args!(
            "  median sigma of the roll {frame:.4} deg, smoothed {smoothed:.4} deg"
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
