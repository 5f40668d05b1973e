//! `solaspect solve`: one answer per frame.

use super::frames::{FramesArgs, Outcome, OutputRow, REMARKS, bad_file};
use super::options;
use crate::aspect::{self, Expected, Track};
use crate::calibrate::check::{self, Contradiction, Quantity};
use crate::instrument::Instrument;
use crate::pointing::{self, Target};
use crate::record::{Reason, Record};
use crate::report;
use crate::sky::Ephemeris;
use crate::units::{Place, counted};
use clap::Args;
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Instant;

/// Find the Sun's position on the plate in frames, and the telescope's offset from its target
///
/// Reads FITS (plain or compressed), PNG, TIFF and JPEG. One answer per frame, in the order of the arguments. A frame
/// without a solution is no failure; a file that cannot be read gives an error on its line, the rest go on, and the
/// exit code is 1.
#[derive(Debug, Args)]
#[command(allow_negative_numbers = true)]
pub struct SolveArgs {
    #[command(flatten)]
    frames: FramesArgs,
    /// The instrument: a TOML file, or the name of a built-in one [default: demo]
    #[arg(long, value_name = "FILE|NAME")]
    instrument: Option<PathBuf>,
    /// The configuration's TOML file
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Start each frame from the result of the one before
    #[arg(long, conflicts_with = "jobs")]
    track: bool,
    /// Where the frames were taken, for frames that do not say so
    #[arg(long, value_name = "LAT,LON,HEIGHT_M", allow_hyphen_values = true)]
    place: Option<Place>,
}

pub fn run(mut args: SolveArgs) -> anyhow::Result<ExitCode> {
    args.frames.prepare()?;
    let config = options::config(args.config.as_deref())?;
    let mut ephemeris = options::ephemeris(&config)?;
    let batch = Batch {
        instrument: options::instrument(args.instrument.as_deref())?,
        place: args.place.or(config.site.place()),
        target: options::target(&config, &mut ephemeris)?,
        ephemeris,
        settings: config.solver(),
        args: &args.frames,
    };
    let mut warned = Vec::new();
    let mut lack_place = 0;
    let code = args.frames.print::<Line>(|print| {
        let take = |solved: Solved| -> anyhow::Result<()> {
            if let Ok(line) = &solved.result {
                batch.warn_of(&solved.contradictions, &line.record.file, &mut warned);
            }
            lack_place += u64::from(solved.lacks_place);
            print(solved.result)
        };
        batch.solve(args.track, take)
    })?;
    if lack_place > 0 {
        let frames = counted(lack_place, "frame");
        tracing::warn!(
            "no offset for {frames} without a place: name it with --place LAT,LON,HEIGHT_M or as [site] of --config"
        );
    }
    Ok(code)
}

/// Result for a file.
struct Solved {
    result: Outcome<Line>,
    /// Whether only the place is missing for an offset.
    lacks_place: bool,
    track: Option<Track>,
    /// Contradictions between the frame and the instrument.
    contradictions: Vec<Contradiction>,
}

/// Shared inputs of all frames of a batch.
struct Batch<'a> {
    instrument: Instrument,
    place: Option<Place>,
    target: Target,
    ephemeris: Ephemeris,
    settings: aspect::SolverSettings,
    args: &'a FramesArgs,
}

impl Batch<'_> {
    /// Passes on the result for every file, in order.
    fn solve(
        &self,
        track: bool,
        mut take: impl FnMut(Solved) -> anyhow::Result<()>,
    ) -> anyhow::Result<()> {
        let files = &self.args.frames;
        if !track {
            let solve = |path: &PathBuf| self.solve_file(path, None);
            return self.args.in_order(files, solve, take);
        }
        let mut track: Option<Track> = None;
        files.iter().try_for_each(|path| {
            let mut solved = self.solve_file(path, track.as_ref());
            track = solved.track.take().or(track.take());
            take(solved)
        })
    }

    fn solve_file(&self, path: &Path, prior: Option<&Track>) -> Solved {
        self.try_solve(path, prior).unwrap_or_else(|error| Solved {
            result: bad_file(path, &error),
            lacks_place: false,
            track: None,
            contradictions: Vec::new(),
        })
    }

    /// Warns of every calibrated quantity that a fine frame contradicts, once per run.
    fn warn_of(&self, found: &[Contradiction], file: &str, warned: &mut Vec<Quantity>) {
        for contradiction in found {
            if !warned.contains(&contradiction.quantity) {
                warned.push(contradiction.quantity);
                let instrument = &self.instrument.name;
                tracing::warn!("{file} contradicts instrument \"{instrument}\": {contradiction}");
            }
        }
    }

    fn try_solve(&self, path: &Path, prior: Option<&Track>) -> anyhow::Result<Solved> {
        let size_px = self.instrument.camera.size_px();
        let frame = self.args.read(path, Some(size_px))?;
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
            None,
            instrument,
            &mut self.ephemeris.clone(),
        );
        let name = path.display().to_string();
        self.args.draw(path, |title| {
            report::overlay(&frame, &solution, &self.instrument, title)
        })?;
        let mut record = Record::new(&name, utc, &solution, offset, Some(solve_time));
        record.utc = frame.info.utc();
        let info = &frame.info;
        let untimed = || Some(Reason::of_file("time", info.untimed.as_ref()?));
        let unplaced = || {
            let warning = info.unplaced.as_ref().filter(|_| place.is_none());
            Some(Reason::of_file("place", warning?))
        };
        record.reason = record.reason.or_else(untimed).or_else(unplaced);
        Ok(Solved {
            lacks_place: place.is_none() && utc.is_some() && solution.aspect.is_some(),
            result: Ok(Line {
                record,
                arcsec_per_mil: instrument.optics.arcsec_per_mil(),
            }),
            contradictions: check::contradictions(&solution, instrument),
            track: solution.track,
        })
    }
}

/// Answer for a frame.
#[derive(Serialize)]
#[serde(transparent)]
struct Line {
    record: Record,
    /// Scale for the table.
    #[serde(skip)]
    arcsec_per_mil: f64,
}

impl OutputRow for Line {
    fn csv_columns() -> Vec<&'static str> {
        Record::csv_columns()
    }

    fn csv_row(&self) -> Vec<String> {
        self.record.csv_row()
    }

    fn table_columns() -> &'static [(&'static str, usize)] {
        &[
            ("", 6),
            ("Sun, px", 15),
            ("on plate, mil", 18),
            ("sigma, arcsec", 13),
            ("marks", 5),
            ("offset, arcsec", 16),
            ("", REMARKS),
        ]
    }

    fn table_row(&self) -> (&str, Vec<String>) {
        let pair = |pair: Option<[f64; 2]>, digits: usize| {
            pair.map_or(String::new(), |[x, y]| {
                format!("{x:.digits$}, {y:.digits$}")
            })
        };
        let record = &self.record;
        let marks = record.marks.as_ref();
        let offset = record.offset_deg.as_ref();
        let sigma = record.sun_plate_sigma_mil;
        let sigma_arcsec = sigma.map(|sigma| sigma.map(|mil| mil * self.arcsec_per_mil));
        let sigma_digits = match sigma_arcsec {
            Some([x, y]) if x.max(y) >= 10.0 => 1,
            _ => 3,
        };
        let fields = vec![
            record.quality.to_string(),
            pair(record.sun_px, 2),
            pair(record.sun_plate_mil, 2),
            pair(sigma_arcsec, sigma_digits),
            marks.map_or(String::new(), |marks| marks.len().to_string()),
            pair(
                offset.map(|o| [o.azimuth, o.elevation].map(|deg| deg * 3600.0)),
                1,
            ),
            record.reason_text().unwrap_or_default(),
        ];
        (&record.file, fields)
    }
}
