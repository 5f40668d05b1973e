//! `solaspect plate`: check of a plate's design, and its artwork.

use super::options;
use super::output::{make_folder, say};
use crate::aspect::SolverSettings;
use crate::instrument::{Instrument, MEAN_SUN_ARCSEC};
use crate::plate::artwork::{Artwork, Tone};
use crate::plate::{self, MarkShape};
use crate::plate_check::{self, CheckSettings, PlateCheck, Rotations};
use crate::plate_design::{self, DesignSettings, cross_of, usual_cross, usual_dot};
use anyhow::{Context, bail};
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
/// Every place of the Sun in the field has so many marks fully lit, and no two places show the same pattern: several plates are drawn by the seed,
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
    /// The Sun's mean radius on the plate, mil: takes another lens, before which it is this, with the camera's view as much larger
    /// [default: by the instrument's lens]
    #[arg(long, value_name = "MIL")]
    radius_mil: Option<f64>,
    /// Marks that are fully lit wherever it stands
    #[arg(long, value_name = "N", default_value_t = 4)]
    marks_in_view: usize,
    /// Keep so many marks even where fewer would do: more of them determine the Sun's place better
    #[arg(long, value_name = "N", default_value_t = 0)]
    least_marks: usize,
    /// What the marks are
    #[arg(long, value_enum, default_value_t = ShapeName::Cross)]
    shape: ShapeName,
    /// Length of a cross's arms from tip to tip, mil; they are 2/15 of it wide [default: 15.6 px at the camera's scale, at most 1/6 of the Sun's radius]
    #[arg(long, value_name = "MIL", conflicts_with = "dot_diameter_mil")]
    arm_length_mil: Option<f64>,
    /// Diameter of a dot, mil [default: 9 px at the camera's scale, at most 1/10 of the Sun's radius]
    #[arg(long, value_name = "MIL")]
    dot_diameter_mil: Option<f64>,
    /// The camera may be turned by any angle, whatever the instrument states
    #[arg(long)]
    any_rotation: bool,
    /// The same seed designs the same plate
    #[arg(long, value_name = "S", default_value_t = 1)]
    seed: u64,
    /// Plates that are tried
    #[arg(long, value_name = "N", default_value_t = plate_design::TRIALS, value_parser = clap::value_parser!(u64).range(1..))]
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
    /// The camera may be turned by any angle, whatever the instrument states
    #[arg(long)]
    any_rotation: bool,
    /// Places of the Sun
    #[arg(long, value_name = "N", default_value_t = CheckSettings::default().places, value_parser = clap::value_parser!(u64).range(1..))]
    places: u64,
    /// Mountings of the camera that are drawn at each place
    #[arg(long, value_name = "N", default_value_t = CheckSettings::default().draws, value_parser = clap::value_parser!(u64).range(1..))]
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
/// closed outlines, which the shop fills. Gerber has no letters: the words are made of small rectangles.
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
    let (before, text) = options::instrument_with_text(Some(&args.instrument))?;
    let start = camera(&before, args)?;
    let settings = DesignSettings {
        shape: shape(args, &start)?,
        rotations: rotations(args.any_rotation),
        least_marks: args.least_marks,
        trials: args.trials,
        seed: args.seed,
        ..DesignSettings::new(args.field_mil, args.marks_in_view)
    };
    let progress = ProgressBar::new(args.trials * settings.exchanges as u64);
    let designed = plate_design::design(&start, &settings, &|| progress.inc(1))?;
    progress.finish_and_clear();
    let source = format!("solaspect plate design, seed {}", args.seed);
    let text = plate_design::file((&args.instrument, &text), &before, &designed, &source)?;
    make_folder(&args.out)?;
    let marks = plate::table_text(&designed.plate);
    write(&args.out.join("marks.csv"), marks.as_bytes())?;
    let file = args.out.join("instrument.toml");
    write(&file, text.as_bytes())?;
    // All later steps read the file that was written.
    let designed = Instrument::read(&file)?;
    let check = CheckSettings {
        rotations: settings.rotations,
        ..CheckSettings::default()
    };
    let found = plate_check::check(&designed, &SolverSettings::default(), &check);
    write_check(&args.out, &found)?;
    write_artwork(&args.out, &designed, Tone::DarkMarks)?;
    let [scale, stated] = [&designed, &before].map(|i| i.mounting.scale_mil_per_px.value);
    if scale != stated {
        say(format_args!(
            "camera     {scale:.3} mil/px, to see the whole Sun all over the field; {:?} states {stated:.3}",
            before.name
        ))?;
    }
    say(&found)?;
    Ok(exit_code(&found))
}

/// The instrument with the lens and the view for which the plate is made.
fn camera(before: &Instrument, args: &DesignArgs) -> anyhow::Result<Instrument> {
    positive("--field-mil", Some(args.field_mil))?;
    let mean_mil = before.optics.radius_mil(MEAN_SUN_ARCSEC);
    let mut start = match positive("--radius-mil", args.radius_mil)? {
        Some(radius_mil) => before.clone().scaled(radius_mil / mean_mil),
        None => before.clone(),
    };
    if args.any_rotation {
        start.mounting.rotation_deg.sigma = 180.0;
    }
    Ok(start.seeing(args.field_mil))
}

/// An option's length, which must be positive.
fn positive(name: &str, mil: Option<f64>) -> anyhow::Result<Option<f64>> {
    if let Some(mil) = mil.filter(|mil| !(mil.is_finite() && *mil > 0.0)) {
        bail!("{name}: expected a length above 0 mil, found {mil}");
    }
    Ok(mil)
}

fn shape(args: &DesignArgs, start: &Instrument) -> anyhow::Result<MarkShape> {
    let arm_length_mil = positive("--arm-length-mil", args.arm_length_mil)?;
    let dot_diameter_mil = positive("--dot-diameter-mil", args.dot_diameter_mil)?;
    Ok(match (args.shape, arm_length_mil, dot_diameter_mil) {
        (ShapeName::Cross, Some(length_mil), None) => cross_of(length_mil),
        (ShapeName::Cross, None, None) => usual_cross(start),
        (ShapeName::Dot, None, Some(diameter_mil)) => MarkShape::Dot { diameter_mil },
        (ShapeName::Dot, None, None) => usual_dot(start),
        (ShapeName::Cross, _, Some(_)) => bail!("--dot-diameter-mil: expected --shape dot"),
        (ShapeName::Dot, Some(_), _) => bail!("--arm-length-mil: expected --shape cross"),
    })
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
        plate_check::json(found)?.as_bytes(),
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
