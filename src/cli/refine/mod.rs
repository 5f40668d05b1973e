//! `solaspect refine`: the best aspect history of a flight.

mod files;
mod navigation;
mod passes;

use super::options;
use super::output::{make_folder, say};
use crate::archive::{ArchiveReader, StoredFile};
use crate::clock::parse_utc;
use crate::refine::{
    self, CameraFrames, CameraHeaders, Flight, Recipe, Report, RollHistory, RollRecipe,
    RollSummary, Shard, Sky, Summary,
};
use crate::units::{Place, counted};
use anyhow::ensure;
use clap::Args;
use jiff::Timestamp;
use navigation::NavigationArgs;
use passes::{InputsRead, expect_all_read, journal_name, print_shard};
use std::path::PathBuf;
use std::process::ExitCode;

/// Compute the best aspect history from a flight's archive
///
/// The first pass solves every frame on its own and records it in a journal in --out: a run that was killed continues where it
/// was. The second pass uses the flight as a whole and writes aspect.fits, aspect.csv, summary.json and report.html. On a cluster
/// each machine does its --shard, and a last run with --merge merges their journals.
/// A frame that several files hold counts once. Unreadable files get a row with the reason and are counted in the summary; they do not change the
/// exit code, unless another attempt may read them or nothing could be read at all. Each of several cameras has its own history, in a
/// folder of --out, and all have one report. Frames of the roll camera give roll.fits, roll.csv and roll.json, and the roll of the
/// offsets. With --imu and --gps the attitude at every IMU sample is estimated from all frames of the flight.
/// With --rate the telescope's offset at that rate, along the smoothed path between frames, is in stabilisation.fits and .csv.
#[derive(Debug, Args)]
#[command(allow_negative_numbers = true)]
pub struct RefineArgs {
    /// A folder tree of FITS frames, or the URL of objects such as s3://bucket/flight
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
    /// Frames read and solved at a time [default: number of cores; eight times that from a URL]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    jobs: Option<u16>,
    /// Only every Nth frame from the Ith on, and only the first pass: options of the second are not used
    #[arg(long, value_name = "I/N", conflicts_with = "merge")]
    shard: Option<Shard>,
    /// Merge the journals of other runs of the same archive, instrument and settings; what they lack is solved
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
    let archive = ArchiveReader::open(&args.archive, &args.out)?;
    let jobs = args.jobs(&archive);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(jobs).build()?;
    pool.install(|| args.run(&archive))
}

impl RefineArgs {
    fn run(&self, archive: &ArchiveReader) -> anyhow::Result<ExitCode> {
        let listing = archive.list()?;
        let archived = archive.flown(&listing.flown)?;
        let config = self.configuration(&archived)?;
        let mut sensors = match self.shard {
            Some(_) => None,
            None => self.navigation.read(archive, &listing.navigation)?,
        };
        make_folder(&self.out)?;
        let Cameras { plate, roll, moon } = self.cameras(archive, listing.frames)?;
        // What may be missing is told before hours of work.
        let recipes = plate
            .iter()
            .map(|camera| self.recipe(camera, &archived, &config));
        let recipes = recipes.collect::<anyhow::Result<Vec<_>>>()?;
        if let Some(sensors) = &sensors {
            sensors.check(&plate)?;
        }
        let roll_recipe = roll
            .as_ref()
            .map(|camera| self.roll_recipe(camera, &archived, &config));
        let roll_recipe = roll_recipe.transpose()?.flatten();
        ensure!(
            !plate.is_empty() || roll.is_none() || roll_recipe.is_some(),
            "{}: expected frames of a camera that sees the plate or the file of the roll camera (--roll-camera), found the roll camera's frames \
             alone",
            self.archive.display()
        );
        let mut ephemeris = options::ephemeris(&config)?;
        let sky = Sky {
            target: options::target(&config, &mut ephemeris)?,
            place: config.site.place(),
            ephemeris,
        };
        let mut report = Report::default();
        let mut read = InputsRead::default();
        if let Some(camera) = moon {
            read.frames += camera.inputs.len();
            let frames = counted(camera.inputs.len() as u64, "frame");
            let text =
                format!("left alone: {frames} of the Moon camera; `solaspect moon` solves them");
            say(format_args!("{text}"))?;
            report.note(&text);
        }
        let refined_roll = match (&roll, &roll_recipe) {
            (Some(camera), Some(recipe)) => self.refine_roll(archive, camera, recipe)?,
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
        if let Some(history) = history {
            read.add(history.rows.len(), &history.inputs);
        }
        for (camera, recipe) in plate.iter().zip(recipes) {
            let label = (plate.len() > 1).then_some(camera.label.as_str());
            let mut shared = Shared {
                archive,
                sky: &sky,
                roll: history,
                report: &mut report,
            };
            let flight = self.refine(camera, label, &recipe, &mut shared)?;
            if let Some(flight) = &flight {
                read.add(flight.rows.len(), &flight.inputs);
            }
            if let Some((sensors, flight)) = sensors.as_mut().zip(flight) {
                sensors.see_sun(camera, &flight, &recipe.instrument)?;
            }
        }
        if let Some(((history, summary), recipe)) = refined_roll.as_ref().zip(roll_recipe) {
            report.add_roll(archive, history, summary, &recipe);
        }
        let mut code = ExitCode::SUCCESS;
        if let Some(mut sensors) = sensors {
            history
                .into_iter()
                .for_each(|history| sensors.see_nadir(history));
            code = sensors.find_attitude(&sky, [&self.archive, &self.out], &mut report)?;
        }
        if self.shard.is_none() {
            report.write(&self.out)?;
        }
        expect_all_read(archive)?;
        if self.shard.is_none() {
            read.expect_frames(archive)?;
        }
        Ok(code)
    }

    /// The archive's cameras by the headers of its frames, or of this shard's.
    fn cameras(&self, archive: &ArchiveReader, frames: Vec<StoredFile>) -> anyhow::Result<Cameras> {
        let frames = match self.shard {
            Some(shard) => shard.part(frames),
            None => frames,
        };
        let done = self.first_pass(archive, "headers", &CameraHeaders, &frames)?;
        let distinct = self.distinct(archive, &done, frames)?;
        let mut cameras = refine::cameras(&done, distinct)?;
        let mut taken = |is_one: fn(&CameraFrames) -> bool| {
            CameraFrames::together(cameras.extract_if(.., |camera| is_one(camera)).collect())
        };
        Ok(Cameras {
            roll: taken(CameraFrames::is_roll_camera),
            moon: taken(CameraFrames::is_moon_camera),
            plate: cameras,
        })
    }

    /// Makes the history of one camera; of several, in a folder of its own. None of a shard.
    fn refine(
        &self,
        camera: &CameraFrames,
        label: Option<&str>,
        recipe: &Recipe,
        shared: &mut Shared,
    ) -> anyhow::Result<Option<Flight>> {
        let Shared {
            archive,
            sky,
            roll,
            report,
        } = shared;
        self.expect_journals(&journal_name(recipe))?;
        let done = self.first_pass(archive, "frames", recipe, &camera.inputs)?;
        if let Some(shard) = self.shard {
            print_shard(shard, &camera.label, &done, &camera.inputs)?;
            return Ok(None);
        }
        let mut flight = self.second_pass(archive, &done, camera, recipe)?;
        if let Some(roll) = roll {
            roll.fill(&mut flight.rows);
        }
        sky.fill(&recipe.instrument, &mut flight.rows, &flight.places);
        let folder = label.map_or(self.out.clone(), |label| self.out.join(label));
        make_folder(&folder)?;
        let summary = refine::write(&folder, &flight, recipe)?;
        report.add(label, archive, &flight, &summary, &recipe.instrument);
        if let Some(label) = label {
            say(format_args!("{label}:"))?;
        }
        print(&summary)?;
        if let Some(rate_hz) = self.navigation.rate_hz() {
            let rows = refine::stabilisation(&flight, rate_hz, &recipe.instrument, sky, *roll)?;
            refine::write_stabilisation(&folder, &rows, &recipe.flown)?;
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
        archive: &ArchiveReader,
        camera: &CameraFrames,
        recipe: &RollRecipe,
    ) -> anyhow::Result<Option<(RollHistory, RollSummary)>> {
        let done = self.first_pass(archive, "frames", recipe, &camera.inputs)?;
        if let Some(shard) = self.shard {
            print_shard(shard, &camera.label, &done, &camera.inputs)?;
            return Ok(None);
        }
        let history = RollHistory::new(&done, camera, recipe, &self.span())?;
        let summary = refine::write_roll(&self.out, &history, recipe)?;
        print_roll(&summary)?;
        Ok(Some((history, summary)))
    }
}

/// The cameras of an archive.
struct Cameras {
    /// Those that see the plate.
    plate: Vec<CameraFrames>,
    roll: Option<CameraFrames>,
    moon: Option<CameraFrames>,
}

/// What the histories of all cameras share.
struct Shared<'a> {
    archive: &'a ArchiveReader,
    sky: &'a Sky,
    roll: Option<&'a RollHistory>,
    report: &'a mut Report,
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
    for line in summary.inputs.lines() {
        say(format_args!("  {line}"))?;
    }
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
    for line in summary.inputs.lines() {
        say(format_args!("  {line}"))?;
    }
    for (remark, count) in &summary.remarks {
        say(format_args!("  {count} not fine: {remark}"))?;
    }
    for (odd, count) in &summary.odd {
        say(format_args!("  {count} odd: {odd}"))?;
    }
    if let Some((frame, smoothed)) = summary.frame_sigma_deg.zip(summary.smoothed_sigma_deg) {
        say(format_args!(
            "  median sigma of the roll {frame:.4} deg, smoothed {smoothed:.4} deg"
        ))?;
    }
    Ok(())
}
