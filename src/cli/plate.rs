//! `solaspect plate`: whether a plate will work, and its artwork.

use super::output::{make_folder, say};
use crate::aspect::SolverSettings;
use crate::instrument::Instrument;
use crate::plate::artwork::{Artwork, Tone};
use crate::plate_check::{self, CheckSettings, Rotations};
use anyhow::Context;
use clap::{Args, Subcommand};
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
    Draw(DrawArgs),
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
        Action::Draw(args) => draw(args),
    }
}

fn check(args: &CheckArgs) -> anyhow::Result<ExitCode> {
    let instrument = Instrument::read(&args.instrument)?;
    let settings = CheckSettings {
        places: args.places,
        draws: args.draws,
        rotations: match args.any_rotation {
            true => Rotations::Any,
            false => Rotations::Stated,
        },
        seed: args.seed,
        ..CheckSettings::default()
    };
    let found = plate_check::check(&instrument, &SolverSettings::default(), &settings);
    if let Some(folder) = &args.out {
        make_folder(folder)?;
        write(
            &folder.join("plate.html"),
            plate_check::html(&found)?.as_bytes(),
        )?;
        write(
            &folder.join("plate.json"),
            &serde_json::to_vec_pretty(&found)?,
        )?;
    }
    say(&found)?;
    Ok(match found.passes() {
        true => ExitCode::SUCCESS,
        false => ExitCode::FAILURE,
    })
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
    let artwork = Artwork::new(&instrument.name, &instrument.plate, tone);
    make_folder(&args.out)?;
    for (name, bytes) in artwork.files()? {
        let path = args.out.join(name);
        write(&path, &bytes)?;
        say(path.display())?;
    }
    Ok(ExitCode::SUCCESS)
}
