//! `solaspect refine`: the best aspect history of a flight.

use super::attitude::{self, AttitudeArgs, parse_rate};
use super::options::interrupted;
use super::output::{Follower, say};
use crate::clock::parse_utc;
use crate::film;
use crate::observe::{Shard, Span};
use crate::refine::{
    self, Counts, Navigation, Options, Overrides, Refined, RefinedCamera, RollSummary, Summary,
};
use crate::units::{Place, counted};
use clap::Args;
use jiff::Timestamp;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::AtomicBool;

/// Compute the best aspect history from a flight's archive
///
/// The first pass solves every frame on its own and records it in a journal in --out: a run that was killed continues where it
/// was. The second pass uses the flight as a whole and writes aspect.fits, aspect.csv, summary.json and report.html. On a cluster
/// each machine does its --shard, and a last run with --merge merges their journals.
/// A frame that several files hold counts once. Unreadable files get a row with the reason and are counted in the summary; they do not change the
/// exit code, unless another attempt may read them or nothing could be read at all. Each of several cameras has its own history, in a
/// folder of --out, and all have one report. Frames of the roll camera give roll.fits, roll.csv and roll.json, and the roll of the
/// offsets. With --imu and --gps the attitude at every IMU sample is estimated from all frames of the flight.
/// With --rate the telescope's offset at that rate, along the smoothed path between frames, is in stabilisation.fits and .csv. With --film
/// there is a film of where the telescope pointed on the Sun.
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
    /// Rows a second of the table POINTING [default: 10]
    #[arg(long, value_name = "HZ", value_parser = parse_rate)]
    pointing_rate: Option<f64>,
    #[command(flatten)]
    navigation: NavigationArgs,
    #[command(flatten)]
    film: FilmArgs,
}

#[derive(Debug, Args)]
#[command(next_help_heading = "A film")]
struct FilmArgs {
    /// A film of where the telescope pointed on the Sun: FILE.gif, FILE.apng or FILE.png, or a folder for numbered pictures
    #[arg(id = "film", long, value_name = "DIR|FILE")]
    path: Option<film::Destination>,
    /// From picture to picture [default: such that there are about 300, but not below the frames' own step]
    #[arg(id = "film_step", long = "film-step", value_name = "SECONDS", value_parser = parse_step, requires = "film")]
    step: Option<f64>,
    /// Show the Sun as this FITS image does, one with helioprojective coordinates, as of SDO [default: a limb-darkened disc]
    #[arg(
        id = "film_context",
        long = "film-context",
        value_name = "MAP.fits",
        requires = "film"
    )]
    context: Option<PathBuf>,
    /// Show the frame nearest in time beside the Sun, with what is found in it
    #[arg(id = "film_frames", long = "film-frames", requires = "film")]
    frames: bool,
}

impl FilmArgs {
    fn options(&self) -> Option<film::Options> {
        Some(film::Options {
            destination: self.path.clone()?,
            step_s: self.step,
            context: self.context.clone(),
            has_frames: self.frames,
        })
    }
}

fn parse_step(text: &str) -> Result<f64, String> {
    let step: Option<f64> = text.parse().ok();
    step.filter(|step| (film::LEAST_STEP_S..=1e5).contains(step))
        .ok_or_else(|| format!("expected a number from 0.01 to 100000 s, found \"{text}\""))
}

#[derive(Debug, Args)]
#[command(next_help_heading = "Attitude by gyros")]
struct NavigationArgs {
    /// Samples of the IMU: attitude.csv, attitude.fits and offsets.csv hold the attitude between frames, too
    #[arg(long, value_name = "CSV", num_args = 1.., requires = "gps")]
    imu: Vec<PathBuf>,
    /// Fixes of GPS
    #[arg(long, value_name = "CSV", num_args = 1.., requires = "imu")]
    gps: Vec<PathBuf>,
    /// What the sensors are [default: the archive's newest navigation_*.toml]
    #[arg(long, value_name = "NAV.toml", requires = "imu")]
    navigation: Option<PathBuf>,
    #[command(flatten)]
    wanted: AttitudeArgs,
}

impl RefineArgs {
    fn options(&self) -> Options {
        let navigation = &self.navigation;
        Options {
            out: self.out.clone(),
            overrides: Overrides {
                instruments: self.instrument.clone(),
                roll_camera: self.roll_camera.clone(),
                configuration: self.config.clone(),
                place: self.place,
            },
            jobs: self.jobs.map(usize::from),
            shard: self.shard,
            merge: self.merge.clone(),
            span: Span {
                since: self.since,
                until: self.until,
            },
            rate_hz: navigation.wanted.rate,
            pointing_rate_hz: self.pointing_rate,
            navigation: (!navigation.imu.is_empty()).then(|| Navigation {
                imu: navigation.imu.clone(),
                gps: navigation.gps.clone(),
                settings: navigation.navigation.clone(),
                wanted: navigation.wanted.wanted(),
            }),
            film: self.film.options(),
        }
    }

    /// Refines, and prints the result. `cancelled` ends it at the next frame.
    ///
    /// # Errors
    /// As [`refine::refine`], and if files cannot be read.
    pub fn run(&self, cancelled: &Arc<AtomicBool>) -> anyhow::Result<ExitCode> {
        let follower = Follower::new("refine", cancelled);
        let refined = refine::refine(&self.archive, &self.options(), &follower)?;
        let code = print(&refined)?;
        refined.check(&self.archive)?;
        Ok(code)
    }
}

pub fn run(args: &RefineArgs) -> anyhow::Result<ExitCode> {
    args.run(&interrupted()?)
}

fn print(refined: &Refined) -> anyhow::Result<ExitCode> {
    for note in &refined.notes {
        say(note)?;
    }
    for done in &refined.shard {
        let Shard { number, of } = done.shard;
        say(format_args!(
            "shard {number}/{of}: {}: {} files, {} of them unreadable",
            done.label, done.files, done.unreadable
        ))?;
    }
    if let Some(roll) = &refined.roll {
        print_roll(&roll.summary)?;
    }
    for RefinedCamera {
        label,
        summary,
        stabilised,
        film,
        ..
    } in &refined.cameras
    {
        if let Some(label) = label {
            say(format_args!("{label}:"))?;
        }
        print_summary(summary)?;
        if let Some(table) = stabilised {
            say(format_args!(
                "stabilisation: {} rows at {} Hz, {} of them valid",
                table.rows, table.rate_hz, table.valid
            ))?;
        }
        film.iter().try_for_each(say)?;
    }
    match &refined.attitude {
        Some(found) => attitude::print(found),
        None => Ok(ExitCode::SUCCESS),
    }
}

fn print_summary(summary: &Summary) -> anyhow::Result<()> {
    let Counts {
        files,
        fine,
        coarse,
        none,
        flagged,
        ..
    } = &summary.counts;
    say(format_args!(
        "{}: {fine} fine ({} when solved alone), {coarse} coarse, {none} none",
        counted(*files as u64, "file"),
        summary.own_fine
    ))?;
    for line in summary.inputs.lines() {
        say(format_args!("  {line}"))?;
    }
    for (flag, count) in flagged {
        say(format_args!("  {count} flagged: {flag}"))?;
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
    if let Some(on_target) = &summary.pointing.on_target {
        say(on_target)?;
    }
    if let Some(compared) = &summary.pointing.cameras_against_gyros {
        say(compared)?;
        compared.findings.iter().try_for_each(say)?;
    }
    Ok(())
}

fn print_roll(summary: &RollSummary) -> anyhow::Result<()> {
    let counts = &summary.counts;
    say(format_args!(
        "roll camera: {}: {} fine, {} coarse, {} none",
        counted(counts.files as u64, "file"),
        counts.fine,
        counts.coarse,
        counts.none
    ))?;
    for line in summary.inputs.lines() {
        say(format_args!("  {line}"))?;
    }
    for (remark, count) in &summary.remarks {
        say(format_args!("  {count} not fine: {remark}"))?;
    }
    for (flag, count) in &counts.flagged {
        say(format_args!("  {count} flagged: {flag}"))?;
    }
    if let Some((frame, smoothed)) = summary.frame_sigma_deg.zip(summary.smoothed_sigma_deg) {
        say(format_args!(
            "  median sigma of the roll {frame:.4} deg, smoothed {smoothed:.4} deg"
        ))?;
    }
    Ok(())
}
