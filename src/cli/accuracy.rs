//! `solaspect accuracy`: errors of the pipeline relative to the truth, condition by condition.

use super::output::say;
use crate::accuracy::{Case, Figures, Page, Program, Report, Size, case_text, frame_columns, text};
use crate::columns::write_csv;
use crate::fits::{self, Compression, FileError};
use crate::instrument::Instrument;
use anyhow::Context;
use clap::Args;
use indicatif::{ProgressBar, ProgressStyle};
use std::io::ErrorKind;
use std::path::{Path, PathBuf};
use std::process::{Command, ExitCode};

/// Measure the errors of the pipeline on simulated frames with known truth
///
/// One table: errors by condition, the requirements, and the Cramer-Rao bound. Exit code 1 if a requirement is not met.
#[derive(Debug, Args)]
pub struct AccuracyArgs {
    /// As many frames as for the documentation's tables, instead of the tests'
    #[arg(long)]
    full: bool,
    /// Write the report into the pages accuracy.md, plate.md, moon.md and horizon.md of this folder, between the two lines that mark its place, and the figures
    /// (SVG) into its folder accuracy; `--full --out docs` renews the documentation
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Write a line of CSV for each frame of the rows and runs: quality, error and sigma of the Sun's centre on the plate
    #[arg(long, value_name = "FILE", conflicts_with = "seed")]
    frames: Option<PathBuf>,
    /// Only this part: a row's name, "rows", "marks", "plates", "designs", "mixed", "motion", "moon", "horizon" or "figures"; may be given several times
    #[arg(long, value_name = "NAME")]
    only: Vec<String>,
    /// Only the frame of this seed, of the one row or run that --only names, in detail; --out keeps it as FITS
    #[arg(long, value_name = "S", requires = "only", conflicts_with = "full")]
    seed: Option<u64>,
    /// Measure with this instrument, a TOML file or the name of a built-in one, instead of the demo; limits in arcsec, which are the demo's, and the
    /// parts about other instruments are skipped
    #[arg(long, value_name = "FILE|NAME")]
    instrument: Option<PathBuf>,
}

pub fn run(args: &AccuracyArgs) -> anyhow::Result<ExitCode> {
    match (args.seed, args.only.as_slice()) {
        (Some(seed), [part]) => one_frame(part, seed, args),
        (Some(_), _) => anyhow::bail!("expected one --only beside --seed"),
        (None, _) => all_frames(args),
    }
}

/// The instrument of `--instrument`.
fn instrument(args: &AccuracyArgs) -> anyhow::Result<Option<Instrument>> {
    let read = args.instrument.as_deref().map(Instrument::read);
    Ok(read.transpose()?)
}

fn one_frame(part: &str, seed: u64, args: &AccuracyArgs) -> anyhow::Result<ExitCode> {
    let case = Case::new(part, seed, instrument(args)?)?;
    say(case_text(&case).trim_end())?;
    if let Some(folder) = &args.out {
        std::fs::create_dir_all(folder)
            .with_context(|| format!("cannot create {}", folder.display()))?;
        let file = folder.join(format!("{part}-{seed}.fits"));
        fits::write_frame(&file, &case.scene.frame()?, &[], &[], Compression::Rice)?;
    }
    Ok(ExitCode::SUCCESS)
}

fn all_frames(args: &AccuracyArgs) -> anyhow::Result<ExitCode> {
    let size = if args.full { Size::Full } else { Size::Small };
    let figures = match args.out {
        Some(_) => Figures::Drawn,
        None => Figures::Left,
    };
    let program = Program::new(size, &args.only, figures, instrument(args)?).context("--only")?;
    // Before the run, during which a commit may be made.
    let commit = commit();
    let progress = ProgressBar::new(program.frames());
    if let Ok(style) =
        ProgressStyle::with_template("{bar:40} {pos}/{len} frames {elapsed} of {duration}")
    {
        progress.set_style(style);
    }
    let report = program.run(&|| progress.inc(1))?;
    progress.finish_and_clear();
    say(text(&report).trim_end())?;
    if let Some(path) = &args.frames {
        let frames = report.frames().map(Ok::<_, FileError>);
        write_csv(path, &frame_columns(), frames)?;
    }
    if let Some(folder) = &args.out {
        for page in Page::of(&report) {
            write_page(folder, page, &report, commit.as_deref())?;
        }
        for (name, svg) in report.figures()? {
            write(&folder.join("accuracy"), name, &svg)?;
        }
    }
    Ok(match report.unmet().is_empty() {
        true => ExitCode::SUCCESS,
        false => ExitCode::FAILURE,
    })
}

/// Writes the report into a page of the folder, between the lines that mark its place.
fn write_page(
    folder: &Path,
    page: Page,
    report: &Report,
    commit: Option<&str>,
) -> anyhow::Result<()> {
    let path = folder.join(page.file());
    let before = match std::fs::read_to_string(&path) {
        Ok(text) => Some(text),
        Err(error) if error.kind() == ErrorKind::NotFound => None,
        Err(error) => {
            return Err(error).with_context(|| format!("cannot read {}", path.display()));
        }
    };
    let text = page
        .with(report, commit, before.as_deref())
        .with_context(|| {
            format!(
                "{}: expected the lines that mark the place of the report",
                path.display()
            )
        })?;
    write(folder, page.file(), &text)
}

fn write(folder: &Path, name: &str, text: &str) -> anyhow::Result<()> {
    std::fs::create_dir_all(folder)
        .and_then(|()| std::fs::write(folder.join(name), text))
        .with_context(|| format!("cannot write {}", folder.join(name).display()))
}

/// The commit of the source from which the program was built, if the source is still available.
fn commit() -> Option<String> {
    let answer = Command::new("git")
        .args(["-C", env!("CARGO_MANIFEST_DIR")])
        .args(["rev-parse", "--short=12", "HEAD"])
        .output()
        .ok()?;
    let text = String::from_utf8(answer.stdout).ok()?;
    answer.status.success().then(|| text.trim().into())
}
