//! `solaspect plate`: whether a plate will work, and its artwork.

use super::options;
use super::output::{make_folder, say};
use crate::aspect::SolverSettings;
use crate::instrument::Instrument;
use crate::plate::artwork::{Artwork, Tone};
use crate::plate::{Cross, MarkShape};
use crate::plate_check::{self, CheckSettings, PlateCheck, Rotations};
use crate::plate_design::{self, DesignSettings};
use anyhow::Context;
use clap::{Args, Subcommand, ValueEnum};
use indicatif::ProgressBar;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Check the plate of an instrument before it is made, and draw it at true scale for a print shop
#[derive(Debug, Args)]
pub struct PlateArgs {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, Subcommand)]
enum Action {
    Check(CheckArgs),
    Design(DesignArgs),
    Draw(DrawArgs),
}

/// Design a plate for an instrument: its marks, an instrument's file, the check of it and its artwork
///
/// Every place of the Sun in the field has so many marks fully lit, and no two places look alike: several plates are drawn by the seed,
/// each improved by displacing marks where the flight's identification is least sure, and the best is written. Exit code 1 where the plate
/// fails its check.
#[derive(Debug, Args)]
struct DesignArgs {
    /// The instrument whose lens, camera and mounting the plate is for: a TOML file, or the name of a built-in one
    #[arg(long, value_name = "FILE|NAME", default_value = "demo")]
    instrument: PathBuf,
    /// The Sun may stand within this of the plate's centre, mil
    #[arg(long, value_name = "MIL")]
    field_mil: f64,
    /// Marks that are fully lit wherever it stands
    #[arg(long, value_name = "N", default_value_t = 4)]
    marks_in_view: usize,
    /// What the marks are
    #[arg(long, value_enum, default_value_t = ShapeName::Cross)]
    shape: ShapeName,
    /// Length of a cross's arms from tip to tip, or diameter of a dot, mil [default: 15.6 px, or 9 px of a dot, at the instrument's scale]
    #[arg(long, value_name = "MIL")]
    size_mil: Option<f64>,
    /// The camera may be turned anyhow, whatever the instrument states
    #[arg(long)]
    any_rotation: bool,
    /// The same seed designs the same plate
    #[arg(long, value_name = "S", default_value_t = 1)]
    seed: u64,
    /// Plates that are tried
    #[arg(long, value_name = "N", default_value_t = 4)]
    trials: u64,
    /// The folder for marks.csv, instrument.toml, plate.html, plate.json and the artwork; it is made if it is missing
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
}

#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
enum ShapeName {
    Cross,
    Dot,
}

/// Say whether frames can be read with the Sun anywhere in the plate's field
///
/// The Sun is put all over the field (plate.field_radius_mil), the camera as far off its stated mounting as its sigmas say. The flight's own
/// identification judges the marks that would be detected. Exit code 1 where part of the field has too few marks or can be read in more than
/// one way.
#[derive(Debug, Args)]
struct CheckArgs {
    /// The instrument: a TOML file, or the name of a built-in one
    instrument: PathBuf,
    /// Write a page with maps, plate.html, and all places, plate.json, to this folder; it is made if it is missing
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// The camera may be turned anyhow, whatever the instrument states
    #[arg(long)]
    any_rotation: bool,
    /// Places of the Sun
    #[arg(long, value_name = "N", default_value_t = CheckSettings::default().places)]
    places: usize,
    /// Mountings of the camera that are drawn at each place
    #[arg(long, value_name = "N", default_value_t = CheckSettings::default().draws)]
    draws: u64,
    /// The same seed draws the same mountings
    #[arg(long, value_name = "S", default_value_t = CheckSettings::default().seed)]
    seed: u64,
}

/// Write the artwork of a plate: plate.svg, plate.dxf and plate.gbr (Gerber), in mm at true scale
///
/// Every mark is where the drawing has it; measured places do not enter. +X is to the right and +Y up, as a person sees the drawn
/// side. Which side of the plate is printed, and whether the artwork is mirrored for it, is for the print shop to state. Seen with the
/// scale bar below the marks, the triangle is at the upper right, on a mirrored print at the upper left. In DXF marks and ground are
/// closed outlines, which the shop fills. Gerber has the words as comments only.
#[derive(Debug, Args)]
struct DrawArgs {
    /// The instrument: a TOML file, or the name of a built-in one
    instrument: PathBuf,
    /// The folder for the files; it is made if it is missing
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Clear marks on a dark ground, instead of dark marks on clear ground
    #[arg(long)]
    clear: bool,
}

pub fn run(args: &PlateArgs) -> anyhow::Result<ExitCode> {
    match &args.action {
        Action::Check(args) => check(args),
        Action::Design(args) => design(args),
        Action::Draw(args) => draw(args),
    }
}

fn design(args: &DesignArgs) -> anyhow::Result<ExitCode> {
    const EXCHANGES: usize = 40;
    let (start, text) = options::instrument_with_text(Some(&args.instrument))?;
    let settings = DesignSettings {
        field_mil: args.field_mil,
        marks_in_view: args.marks_in_view,
        shape: shape(args, start.mounting.scale_mil_per_px.value),
        rotations: rotations(args.any_rotation),
        trials: args.trials,
        exchanges: EXCHANGES,
        seed: args.seed,
    };
    let progress = ProgressBar::new(args.trials * EXCHANGES as u64);
    let (designed, found) = plate_design::design(&start, &settings, &|| progress.inc(1))?;
    progress.finish_and_clear();
    make_folder(&args.out)?;
    write(
        &args.out.join("marks.csv"),
        plate_design::table(&designed.plate).as_bytes(),
    )?;
    let file = args.out.join("instrument.toml");
    let source = format!("solaspect plate design, seed {}", args.seed);
    write(
        &file,
        plate_design::file(&text, &designed.plate, &source)?.as_bytes(),
    )?;
    // What was written is what everything else reads.
    Instrument::read(&file)?;
    write_check(&args.out, &found)?;
    write_artwork(&args.out, &designed, Tone::DarkMarks)?;
    say(&found)?;
    Ok(exit_code(&found))
}

fn shape(args: &DesignArgs, scale_mil_per_px: f64) -> MarkShape {
    const ARMS_PX: f64 = 15.6;
    /// Of an arm's length.
    const ARM_WIDTH: f64 = 12.0 / 90.0;
    const DOT_PX: f64 = 9.0;
    // To a mil: a drawing with round numbers.
    let usual = |px: f64| (px * scale_mil_per_px).round().max(1.0);
    match args.shape {
        ShapeName::Cross => {
            let arm_length_mil = args.size_mil.unwrap_or_else(|| usual(ARMS_PX));
            MarkShape::Cross(Cross {
                arm_length_mil,
                arm_width_mil: ARM_WIDTH * arm_length_mil,
                arm_angle_deg: 0.0,
            })
        }
        ShapeName::Dot => MarkShape::Dot {
            diameter_mil: args.size_mil.unwrap_or_else(|| usual(DOT_PX)),
        },
    }
}

fn rotations(any: bool) -> Rotations {
    match any {
        true => Rotations::Any,
        false => Rotations::Stated,
    }
}

fn exit_code(found: &PlateCheck) -> ExitCode {
    match found.passes() {
        true => ExitCode::SUCCESS,
        false => ExitCode::FAILURE,
    }
}

fn write_check(folder: &Path, found: &PlateCheck) -> anyhow::Result<()> {
    write(
        &folder.join("plate.html"),
        plate_check::html(found)?.as_bytes(),
    )?;
    write(
        &folder.join("plate.json"),
        &serde_json::to_vec_pretty(found)?,
    )
}

fn check(args: &CheckArgs) -> anyhow::Result<ExitCode> {
    let instrument = Instrument::read(&args.instrument)?;
    let settings = CheckSettings {
        places: args.places,
        draws: args.draws,
        rotations: rotations(args.any_rotation),
        seed: args.seed,
        ..CheckSettings::default()
    };
    let found = plate_check::check(&instrument, &SolverSettings::default(), &settings);
    if let Some(folder) = &args.out {
        make_folder(folder)?;
        write_check(folder, &found)?;
    }
    say(&found)?;
    Ok(exit_code(&found))
}

fn write(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    std::fs::write(path, bytes).with_context(|| format!("{}: cannot write", path.display()))
}

fn draw(args: &DrawArgs) -> anyhow::Result<ExitCode> {
    let instrument = Instrument::read(&args.instrument)?;
    let tone = match args.clear {
        true => Tone::ClearMarks,
        false => Tone::DarkMarks,
    };
    make_folder(&args.out)?;
    write_artwork(&args.out, &instrument, tone)?;
    Ok(ExitCode::SUCCESS)
}

fn write_artwork(folder: &Path, instrument: &Instrument, tone: Tone) -> anyhow::Result<()> {
    let artwork = Artwork::new(&instrument.name, &instrument.plate, tone);
    for (name, bytes) in artwork.files()? {
        let path = folder.join(name);
        write(&path, &bytes)?;
        say(path.display())?;
    }
    Ok(())
}
