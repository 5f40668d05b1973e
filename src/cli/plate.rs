//! `solaspect plate`: the plate as a print shop needs it.

use super::output::{make_folder, say};
use crate::instrument::Instrument;
use crate::plate::artwork::{Artwork, Tone};
use anyhow::Context;
use clap::{Args, Subcommand};
use std::path::PathBuf;
use std::process::ExitCode;

/// Draw the plate of an instrument at true scale, for a print shop
#[derive(Debug, Args)]
pub struct PlateArgs {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, Subcommand)]
enum Action {
    Draw(DrawArgs),
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
        Action::Draw(args) => draw(args),
    }
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
        std::fs::write(&path, bytes)
            .with_context(|| format!("{}: cannot write", path.display()))?;
        say(path.display())?;
    }
    Ok(ExitCode::SUCCESS)
}
