//! `solaspect archive`: lists and checks an archive.

use super::output::{make_folder, progress_bar};
use crate::archive::check::{
    self, BadFile, ContradictingFile, CopiedFile, Gap, KeywordRow, MissingFile, Report, Tree,
};
use crate::fits::{self, FitsFile};
use crate::log;
use crate::units::counted;
use anyhow::{Context, ensure};
use clap::{Args, Subcommand};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// List, check and export the frames of an archive
#[derive(Debug, Args)]
pub struct ArchiveArgs {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, Subcommand)]
enum Command {
    Check(CheckArgs),
    List(ListArgs),
    Show(ShowArgs),
    Export(ExportArgs),
}

/// Check every file of an archive, and that none is missing
///
/// Structure, checksums, picture and keywords of each file, its name, and that times do not go back in the order of
/// names; that every file is there that a solution log names, on this disk or on the other. Gaps are steps in time longer than
/// 1.5 times the median step, and missing frame numbers. Exit code 1 if any file is bad, or listed in a log and missing; gaps,
/// copies of frames and partial files are reported and do not change the exit code.
#[derive(Debug, Args)]
struct CheckArgs {
    /// The archive's folder; of an archive on two disks, both together
    #[arg(value_name = "DIR", required = true)]
    folders: Vec<PathBuf>,
    /// Print one JSON object
    #[arg(long)]
    json: bool,
}

/// List the frames of an archive, one a line
///
/// A file that cannot be read has its error on its line, and the exit code is 1.
#[derive(Debug, Args)]
struct ListArgs {
    /// The archive's folder
    #[arg(value_name = "DIR")]
    folder: PathBuf,
    /// Print one JSON object a line
    #[arg(long)]
    json: bool,
}

/// Show the header and the solution of a frame
#[derive(Debug, Args)]
struct ShowArgs {
    /// An archived frame
    #[arg(value_name = "FILE")]
    file: PathBuf,
}

/// Export frames as pictures, or their keywords as a table
///
/// A file that cannot be read is reported on standard error, or in the table's last column; the rest go on, and the exit
/// code is 1.
#[derive(Debug, Args)]
#[command(group = clap::ArgGroup::new("what").required(true))]
struct ExportArgs {
    /// Frames, and folders of frames
    #[arg(required = true, value_name = "DIR|FILE")]
    frames: Vec<PathBuf>,
    /// A picture of each frame, stretched from its darkest to its brightest pixels, to the folder of --out
    #[arg(long, group = "what", requires = "out")]
    png: bool,
    /// A table with a row for each frame and a column for each keyword, to the file of --out
    #[arg(long, group = "what")]
    csv: bool,
    /// Where it goes to: a folder for --png, a file for --csv [default for --csv: standard output]
    #[arg(long, value_name = "OUT")]
    out: Option<PathBuf>,
}

pub fn run(args: ArchiveArgs) -> anyhow::Result<ExitCode> {
    let all_well = match &args.command {
        Command::Check(args) => run_check(args)?,
        Command::List(args) => run_list(args)?,
        Command::Show(args) => run_show(&args.file)?,
        Command::Export(args) => run_export(args)?,
    };
    Ok(if all_well {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    })
}

fn run_check(args: &CheckArgs) -> anyhow::Result<bool> {
    let tree = Tree::of_all(&args.folders)?;
    let progress = progress_bar(tree.files.len(), "files");
    let report = check::check(&tree, &|| progress.inc(1));
    progress.finish_and_clear();
    let mut out = std::io::stdout().lock();
    if args.json {
        writeln!(out, "{}", serde_json::to_string(&report)?)?;
    } else {
        print_report(&mut out, &report)?;
    }
    Ok(report.is_sound())
}

fn print_report(out: &mut impl Write, report: &Report) -> std::io::Result<()> {
    for BadFile { file, error } in &report.bad_files {
        writeln!(out, "bad  {file}: {error}")?;
    }
    for MissingFile { file, log } in &report.missing_files {
        writeln!(out, "missing  {file}: named in {log}")?;
    }
    for CopiedFile { file, same_as } in &report.copy_list {
        writeln!(out, "copy  {file}: the same frame as {same_as}")?;
    }
    for ContradictingFile { file, other } in &report.contradiction_list {
        writeln!(
            out,
            "warning  {file}: the number and time of {other}, but other pixels"
        )?;
    }
    for gap in &report.gap_list {
        writeln!(out, "gap  {}", gap_line(gap))?;
    }
    let missing = match report.missing_frames {
        0 => String::new(),
        frames => format!(" ({} missing by number)", counted(frames, "frame")),
    };
    let elsewhere = match report.on_other_disk {
        0 => String::new(),
        frames => format!(", {frames} on the other disk"),
    };
    let copies = match report.copies {
        0 => String::new(),
        1 => ", 1 copy".into(),
        files => format!(", {files} copies"),
    };
    writeln!(
        out,
        "{}: {} bad, {} missing, {}{missing}, {} unfinished, {} without a time{elsewhere}{copies}",
        counted(report.files as u64, "file"),
        report.bad,
        report.missing,
        counted(report.gaps as u64, "gap"),
        report.unfinished,
        report.undated
    )?;
    if let (Some(first), Some(last)) = (report.first_utc, report.last_utc) {
        let minutes = last.duration_since(first).as_secs_f64() / 60.0;
        writeln!(out, "{first:.3} to {last:.3}, {minutes:.1} min")?;
    }
    Ok(())
}

fn gap_line(gap: &Gap) -> String {
    let name = |file: &str| {
        let name = Path::new(file).file_name().unwrap_or_default();
        name.to_string_lossy().into_owned()
    };
    format!(
        "{} .. {}: {:.3} s, median {:.3} s, {} missing",
        name(&gap.after),
        name(&gap.before),
        gap.step_s,
        gap.median_step_s,
        counted(gap.missing_frames, "number")
    )
}

fn run_list(args: &ListArgs) -> anyhow::Result<bool> {
    ensure!(
        args.folder.is_dir(),
        "{}: expected a folder of frames, found no folder",
        args.folder.display()
    );
    let files = check::frames_of(std::slice::from_ref(&args.folder))?;
    let rows: Vec<_> = files
        .par_iter()
        .map(|path| KeywordRow::read(path))
        .collect();
    let mut out = std::io::stdout().lock();
    let mut all_well = true;
    for row in rows {
        let row = row.map_err(BadFile::from);
        all_well &= row.is_ok();
        let line = match (row, args.json) {
            (Ok(row), true) => serde_json::to_string(&row)?,
            (Err(bad), true) => serde_json::to_string(&bad)?,
            (Ok(row), false) => list_line(&row, &args.folder),
            (Err(bad), false) => {
                format!("{}  error: {}", within(&bad.file, &args.folder), bad.error)
            }
        };
        writeln!(out, "{line}")?;
    }
    Ok(all_well)
}

fn list_line(row: &KeywordRow, folder: &Path) -> String {
    let or_dash = |text: &Option<String>| text.clone().unwrap_or_else(|| "-".into());
    let sun = row
        .sun_plate_mil
        .map_or("-".into(), |[x, y]| format!("{x:.3}, {y:.3} mil"));
    let number = row.number.map_or("-".into(), |number| number.to_string());
    format!(
        "{}  {:<24}  {:<6}  {number:>8}  {sun:>26}  {}",
        within(&row.file, folder),
        or_dash(&row.utc),
        or_dash(&row.quality),
        row.reason.as_deref().unwrap_or_default()
    )
    .trim_end()
    .into()
}

/// The path relative to the folder.
fn within(file: &str, folder: &Path) -> String {
    let path = Path::new(file);
    path.strip_prefix(folder)
        .unwrap_or(path)
        .display()
        .to_string()
}

fn run_show(path: &Path) -> anyhow::Result<bool> {
    let file = FitsFile::open(path)?;
    file.checksums()?;
    let groups = check::grouped(&file)?;
    let marks = check::marks(&file)?;
    let mut out = std::io::stdout().lock();
    for group in groups {
        writeln!(out, "{}", group.title)?;
        for (name, value, comment) in group.cards {
            writeln!(
                out,
                "{}",
                format!("  {name:<8}  {value:<30}  {comment}").trim_end()
            )?;
        }
        writeln!(out)?;
    }
    if marks.is_empty() {
        writeln!(out, "No marks")?;
        return Ok(true);
    }
    writeln!(
        out,
        "Marks\n  {:>4} {:>4}  {:>10}  {:>10}  {:>9}",
        "i", "j", "x, px", "y, px", "sigma, px"
    )?;
    for mark in marks {
        let ([i, j], [x, y]) = (mark.id, mark.px);
        writeln!(
            out,
            "  {i:>4} {j:>4}  {x:>10.3}  {y:>10.3}  {:>9.4}",
            mark.sigma_px
        )?;
    }
    Ok(true)
}

fn run_export(args: &ExportArgs) -> anyhow::Result<bool> {
    let files = check::frames_of(&args.frames)?;
    match &args.out {
        Some(folder) if args.png => export_pictures(&files, folder),
        out => export_table(&files, out.as_deref()),
    }
}

fn export_table(files: &[PathBuf], out: Option<&Path>) -> anyhow::Result<bool> {
    let progress = progress_bar(files.len(), "files");
    let row = |path: &PathBuf| {
        let row = check::csv_row(path);
        progress.inc(1);
        row
    };
    let rows: Vec<Vec<String>> = files.par_iter().map(row).collect();
    progress.finish_and_clear();
    let mut table = csv::Writer::from_writer(Vec::new());
    table.write_record(check::csv_header())?;
    let mut all_well = true;
    for row in rows {
        all_well &= row.last().is_some_and(String::is_empty);
        table.write_record(row)?;
    }
    let bytes = table.into_inner()?;
    match out {
        Some(file) => std::fs::write(file, bytes)
            .with_context(|| format!("{}: cannot write the table", file.display()))?,
        None => std::io::stdout().lock().write_all(&bytes)?,
    }
    Ok(all_well)
}

fn export_pictures(files: &[PathBuf], folder: &Path) -> anyhow::Result<bool> {
    let mut pictures: BTreeMap<PathBuf, &PathBuf> = BTreeMap::new();
    for file in files {
        let stem = file.file_stem().unwrap_or_default().to_string_lossy();
        let namesake = pictures.insert(folder.join(format!("{stem}.png")), file);
        if let Some(other) = namesake {
            let (file, other) = (file.display(), other.display());
            anyhow::bail!(
                "{file}: expected a frame whose picture has a name of its own, found that of {other}"
            );
        }
    }
    make_folder(folder)?;
    let progress = progress_bar(pictures.len(), "files");
    let export = |(picture, file): (&PathBuf, &&PathBuf)| -> anyhow::Result<()> {
        progress.inc(1);
        let frame = fits::read_frame(file)?;
        let saved = check::stretched(&frame).save(picture);
        saved.with_context(|| format!("{}: cannot write the picture", picture.display()))
    };
    let outcomes = pictures.par_iter().map(export);
    let errors: Vec<_> = outcomes.filter_map(Result::err).collect();
    progress.finish_and_clear();
    for error in &errors {
        log::say(&format!("solaspect: {error:#}"));
    }
    Ok(errors.is_empty())
}
