//! The instrument's file before and after a calibration.

use crate::calibrate::revision::Revision;
use crate::calibrate::revision::write_if;
use crate::cli::options;
use crate::cli::output::{make_folder, say};
use crate::instrument::Instrument;
use crate::observe::RejectedFrame;
use crate::provenance::sha256;
use crate::report::plot::PlotError;
use anyhow::Context;
use clap::Args;
use std::path::{Path, PathBuf};

/// The instrument before and after.
#[derive(Debug, Args)]
pub(super) struct Edition {
    /// The instrument as it is known so far: a TOML file, or the name of a built-in one [default: demo]
    #[arg(long, value_name = "FILE|NAME")]
    instrument: Option<PathBuf>,
    /// The new instrument file
    #[arg(long, value_name = "FILE")]
    pub out: PathBuf,
    /// Write a page with figures to this folder
    #[arg(long, value_name = "DIR")]
    report: Option<PathBuf>,
}

impl Edition {
    /// The present instrument, and its file open for new entries.
    pub fn open(&self) -> anyhow::Result<(Revision, Instrument)> {
        let path = self.instrument.as_deref();
        let (instrument, text) = options::instrument_with_text(path)?;
        Ok((
            Revision::of(path.unwrap_or(Path::new("demo")), &text)?,
            instrument,
        ))
    }

    /// Writes the new instrument if it can be read back; else the old file stays. Returns the SHA-256 of
    /// the new file.
    pub fn write(&self, revision: &Revision) -> anyhow::Result<String> {
        let (text, _) = revision.finish()?;
        write_if(&self.out, &text, |part| Instrument::read(part).map(drop))?;
        Ok(sha256(text))
    }

    /// Writes the page of the report if requested.
    pub fn write_page(
        &self,
        name: &str,
        page: impl FnOnce() -> Result<String, PlotError>,
    ) -> anyhow::Result<()> {
        let Some(folder) = &self.report else {
            return Ok(());
        };
        make_folder(folder)?;
        let file = folder.join(name);
        std::fs::write(&file, page()?).with_context(|| format!("{}: cannot write", file.display()))
    }
}

pub(super) fn print_rejected(rejected: &[RejectedFrame]) -> anyhow::Result<()> {
    let mut frames = rejected.iter();
    frames.try_for_each(|frame| say(format_args!("rejected: {frame}")))
}
