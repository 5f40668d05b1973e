//! `solaspect solve`: frames in, answers out.

use super::options;
use super::output::{make_folder, progress_bar, say};
use crate::archive::Record;
use crate::aspect::{self, Contradiction, Expected, Quantity, Solution, Track};
use crate::fits;
use crate::frame::Frame;
use crate::instrument::Instrument;
use crate::pointing::{self, Roll, Target};
use crate::sky::Ephemeris;
use crate::units::Place;
use anyhow::{Context, ensure};
use clap::{Args, ValueEnum};
use indicatif::ProgressBar;
use rayon::prelude::*;
use serde::Serialize;
use std::io::{IsTerminal, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;

/// Find the Sun on the plate in frames, and the telescope's offset from its target
///
/// Reads FITS (plain or compressed, 8 or 16 bit), PNG and TIFF. One answer per frame, in the order of the arguments. A frame
/// without a solution is no failure; a file that cannot be read gives an error on its line, the rest go on, and the
/// exit code is 1.
#[derive(Debug, Args)]
#[command(allow_negative_numbers = true)]
pub struct SolveArgs {
    /// Frames to solve
    #[arg(required = true, value_name = "FRAME")]
    frames: Vec<PathBuf>,
    /// The instrument's TOML file [default: the built-in instrument "demo"]
    #[arg(long, value_name = "FILE")]
    instrument: Option<PathBuf>,
    /// The configuration's TOML file
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Solve N frames at a time
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = clap::value_parser!(u16).range(1..=1024))]
    jobs: u16,
    /// How answers are written [default: table on a terminal, else jsonl]
    #[arg(long, value_enum)]
    format: Option<Format>,
    /// Write a picture of every solved frame to this folder
    #[arg(long, value_name = "DIR")]
    overlay: Option<PathBuf>,
    /// Let each frame start from what the one before it taught
    #[arg(long, conflicts_with = "jobs")]
    track: bool,
    /// Where the frames were taken, for frames that do not say so
    #[arg(long, value_name = "LAT,LON,HEIGHT_M", allow_hyphen_values = true)]
    place: Option<Place>,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum Format {
    Jsonl,
    Csv,
    Table,
}

pub fn run(args: SolveArgs) -> anyhow::Result<ExitCode> {
    let config = options::config(args.config.as_deref())?;
    let mut ephemeris = options::ephemeris(&config)?;
    let batch = Batch {
        instrument: options::instrument(args.instrument.as_deref())?,
        place: args.place.or(config.site.place()),
        target: options::target(&config, &mut ephemeris)?,
        ephemeris,
        settings: config.solver(),
        overlay: args.overlay,
    };
    if let Some(folder) = &batch.overlay {
        make_folder(folder)?;
        let names: std::collections::BTreeSet<_> =
            args.frames.iter().map(|f| picture_name(f)).collect();
        ensure!(
            names.len() == args.frames.len(),
            "--overlay: expected frames whose pictures have different names, found two alike"
        );
    }
    let mut printer = Printer::new(args.format)?;
    let progress = progress_of(args.frames.len());
    let mut failed = false;
    let mut told = Vec::new();
    let mut take = |solved: Vec<Solved>| -> anyhow::Result<()> {
        for Solved {
            answer,
            contradictions,
            ..
        } in solved
        {
            failed |= answer.is_err();
            progress.suspend(|| printer.print(&answer))?;
            progress.inc(1);
            if let Ok(record) = &answer {
                progress.suspend(|| batch.warn_of(&contradictions, &record.file, &mut told));
            }
        }
        Ok(())
    };
    if args.track {
        let mut track: Option<Track> = None;
        for path in &args.frames {
            let mut solved = batch.solve_file(path, track.as_ref());
            track = solved.track.take().or(track);
            take(vec![solved])?;
        }
    } else {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(usize::from(args.jobs))
            .build()?;
        for some in args.frames.chunks(usize::from(args.jobs)) {
            let solve = |path: &PathBuf| batch.solve_file(path, None);
            take(pool.install(|| some.par_iter().map(solve).collect()))?;
        }
    }
    progress.finish_and_clear();
    Ok(if failed {
        ExitCode::FAILURE
    } else {
        ExitCode::SUCCESS
    })
}

/// A frame's record, or the file and what is wrong with it.
type Answer = Result<Record, (String, String)>;

/// What came of a file.
struct Solved {
    answer: Answer,
    track: Option<Track>,
    /// What the frame contradicts of the instrument.
    contradictions: Vec<Contradiction>,
}

/// The line of a file that could not be read.
#[derive(Serialize)]
struct BadFile<'a> {
    file: &'a str,
    error: &'a str,
}

/// What all frames of a batch share.
struct Batch {
    instrument: Instrument,
    place: Option<Place>,
    target: Target,
    ephemeris: Ephemeris,
    settings: aspect::Settings,
    overlay: Option<PathBuf>,
}

impl Batch {
    fn solve_file(&self, path: &Path, prior: Option<&Track>) -> Solved {
        let name = path.display().to_string();
        self.try_solve(path, prior).unwrap_or_else(|error| {
            // The line names the file already.
            let text = format!("{error:#}");
            let text = text.strip_prefix(&format!("{name}: ")).unwrap_or(&text);
            Solved {
                answer: Err((name, text.into())),
                track: None,
                contradictions: Vec::new(),
            }
        })
    }

    /// Warns of every stated quantity that a fine frame contradicts, once in a run.
    fn warn_of(&self, found: &[Contradiction], file: &str, told: &mut Vec<Quantity>) {
        for contradiction in found {
            if !told.contains(&contradiction.quantity) {
                told.push(contradiction.quantity);
                let instrument = &self.instrument.name;
                tracing::warn!("{file} contradicts instrument \"{instrument}\": {contradiction}");
            }
        }
    }

    fn try_solve(&self, path: &Path, prior: Option<&Track>) -> anyhow::Result<Solved> {
        let frame = fits::read_frame(path)?;
        let instrument = &*self.instrument.seen_by(&frame)?;
        let utc = frame.info.mid_exposure;
        let expected = utc.and_then(Expected::at);
        let start = Instant::now();
        let mut solution = aspect::solve_with(&self.settings, &frame, instrument, expected, prior);
        let solve_time = start.elapsed();
        let place = frame.info.place.or(self.place);
        let offset = pointing::offset_of(
            &mut solution,
            utc,
            place,
            &self.target,
            Roll::Stated,
            instrument,
            &mut self.ephemeris.clone(),
        );
        let name = path.display().to_string();
        self.draw(path, &frame, &solution)?;
        let record = Record::new(&name, utc, &solution, offset, Some(solve_time));
        Ok(Solved {
            answer: Ok(record),
            contradictions: aspect::contradictions(&solution, instrument),
            track: solution.track,
        })
    }

    fn draw(&self, path: &Path, frame: &Frame, solution: &Solution) -> anyhow::Result<()> {
        let Some(folder) = &self.overlay else {
            return Ok(());
        };
        let title = path.file_name().unwrap_or_default().to_string_lossy();
        let picture = aspect::overlay(frame, solution, &self.instrument.plate, &title);
        let file = folder.join(picture_name(path));
        let written = picture.save(&file);
        written.with_context(|| format!("{}: cannot write the overlay", file.display()))
    }
}

/// The frame's folder and name, so that frames of several folders do not meet in one.
fn picture_name(path: &Path) -> String {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    let folder = path.parent().and_then(Path::file_name);
    match folder {
        Some(folder) => format!("{}_{name}.png", folder.to_string_lossy()),
        None => format!("{name}.png"),
    }
}

/// None beside a table on the same terminal, where a bar only flickers.
fn progress_of(frames: usize) -> ProgressBar {
    if frames < 2 || std::io::stdout().is_terminal() {
        return ProgressBar::hidden();
    }
    progress_bar(frames, "frames")
}

/// Writes answers to standard output in one format.
struct Printer {
    format: Format,
    csv: csv::Writer<std::io::Stdout>,
}

impl Printer {
    fn new(format: Option<Format>) -> anyhow::Result<Self> {
        let on_terminal = std::io::stdout().is_terminal();
        let format = format.unwrap_or(if on_terminal {
            Format::Table
        } else {
            Format::Jsonl
        });
        let mut csv = csv::Writer::from_writer(std::io::stdout());
        match format {
            Format::Jsonl => {}
            Format::Csv => {
                csv.write_record(Record::CSV_COLUMNS.iter().chain(&["error"]))?;
                csv.flush()?;
            }
            Format::Table => say(format_args!(
                "{:<32} {:<6} {:>19} {:>23} {:>13} {:>5} {:>21}  reason",
                "file",
                "",
                "Sun, px",
                "Sun on plate, mil",
                "sigma, mil",
                "marks",
                "offset az, el, deg"
            ))?,
        }
        Ok(Self { format, csv })
    }

    fn print(&mut self, answer: &Answer) -> anyhow::Result<()> {
        let mut out = std::io::stdout().lock();
        match (self.format, answer) {
            (Format::Jsonl, Ok(record)) => writeln!(out, "{}", serde_json::to_string(record)?)?,
            (Format::Jsonl, Err((file, error))) => {
                writeln!(out, "{}", serde_json::to_string(&BadFile { file, error })?)?;
            }
            (Format::Csv, _) => {
                drop(out);
                self.print_csv(answer)?;
            }
            (Format::Table, Ok(record)) => writeln!(out, "{}", table_row(record))?,
            (Format::Table, Err((file, error))) => {
                writeln!(out, "{:<32} error: {error}", tail(file))?
            }
        }
        Ok(())
    }

    fn print_csv(&mut self, answer: &Answer) -> anyhow::Result<()> {
        let (row, error) = match answer {
            Ok(record) => (record.csv_row(), ""),
            Err((file, error)) => {
                let mut row = std::array::from_fn(|_| String::new());
                row[0].clone_from(file);
                (row, error.as_str())
            }
        };
        self.csv
            .write_record(row.iter().map(String::as_str).chain([error]))?;
        self.csv.flush()?;
        Ok(())
    }
}

fn table_row(record: &Record) -> String {
    let pair = |pair: Option<[f64; 2]>, digits: usize| {
        pair.map_or(String::new(), |[x, y]| {
            format!("{x:.digits$}, {y:.digits$}")
        })
    };
    let marks = record
        .marks
        .as_ref()
        .map_or(String::new(), |m| m.len().to_string());
    let offset = record.offset_deg.as_ref().map(|o| [o.azimuth, o.elevation]);
    format!(
        "{:<32} {:<6} {:>19} {:>23} {:>13} {:>5} {:>21}  {}",
        tail(&record.file),
        record.quality,
        pair(record.sun_px, 3),
        pair(record.sun_plate_mil, 3),
        pair(record.sun_plate_sigma_mil, 3),
        marks,
        pair(offset, 5),
        record.reason_text().unwrap_or_default(),
    )
}

/// The end of a path, where frames differ.
fn tail(file: &str) -> String {
    const LENGTH: usize = 32;
    let count = file.chars().count();
    if count <= LENGTH {
        return file.into();
    }
    let end: String = file.chars().skip(count - LENGTH + 2).collect();
    format!("..{end}")
}
