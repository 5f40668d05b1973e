//! The two passes over one camera's frames, with the journals of this and other runs.

use super::RefineArgs;
use crate::archive::{ArchiveReader, StoredFile};
use crate::cli::output::{Progress, say};
use crate::frame::Unreadable;
use crate::refine::{
    self, CameraFrames, CameraHeader, Distinct, Done, FirstPass, Flight, FrameRecord, InputSummary,
    PixelDigests, Recipe, Shard, Span,
};
use crate::units::counted;
use anyhow::{bail, ensure};
use serde::{Serialize, de::DeserializeOwned};
use std::path::PathBuf;
use std::thread::available_parallelism;

/// Frames that are read from an object store for each core: each waits for the network several times as long as it is solved.
const REMOTE_JOBS: usize = 8;

impl RefineArgs {
    /// Frames that are read and solved at a time.
    pub(super) fn jobs(&self, archive: &ArchiveReader) -> usize {
        let cores = available_parallelism().map_or(1, usize::from);
        let usual = match archive.is_remote() {
            true => REMOTE_JOBS * cores,
            false => cores,
        };
        self.jobs.map_or(usual, usize::from)
    }

    pub(super) fn span(&self) -> Span {
        Span {
            since: self.since,
            until: self.until,
        }
    }

    /// Refuses to merge where no folder holds a journal of this name, and names folders that hold none: a run with another
    /// instrument would solve all frames again.
    pub(super) fn expect_journals(&self, name: &str) -> anyhow::Result<()> {
        let without = self
            .merge
            .iter()
            .filter(|folder| !folder.join(name).is_file());
        let without: Vec<&PathBuf> = without.collect();
        let lack = |folder: &PathBuf| {
            format!(
                "{}: expected a journal of the same version, instrument and settings ({name}), found none",
                folder.display()
            )
        };
        if let Some(first) = without.first() {
            ensure!(without.len() < self.merge.len(), lack(first));
        }
        for folder in without {
            tracing::warn!("{}: its frames are solved here", lack(folder));
        }
        Ok(())
    }

    /// Solves the frames that neither this run's journal nor a merged one holds.
    pub(super) fn first_pass<R: FirstPass>(
        &self,
        archive: &ArchiveReader,
        what: &str,
        recipe: &R,
        inputs: &[StoredFile],
    ) -> anyhow::Result<Done<R::Frame>> {
        let name = journal_name(recipe);
        let others = self.merge.iter().map(|folder| folder.join(&name));
        let others: Vec<PathBuf> = others.filter(|path| path.is_file()).collect();
        let mut done = Done::open(&self.out.join(&name), &others)?;
        let left = inputs.iter().filter(|input| !done.holds(input)).count();
        let progress = Progress::new("refine", left, what);
        done.work(archive, inputs, recipe, &self.span(), &|| progress.step())?;
        progress.finish();
        expect_answers(archive)?;
        Ok(done)
    }

    /// The files of frames without copies. A shard does not look for them: other shards may have the frames that its own are copies of.
    pub(super) fn distinct(
        &self,
        archive: &ArchiveReader,
        headers: &Done<CameraHeader>,
        inputs: Vec<StoredFile>,
    ) -> anyhow::Result<Distinct> {
        let alike = match self.shard {
            Some(_) => Vec::new(),
            None => refine::may_be_copied(headers, &inputs)?,
        };
        if alike.is_empty() {
            return Ok(Distinct {
                inputs,
                ..Distinct::default()
            });
        }
        let digests = self.first_pass(archive, "frames compared", &PixelDigests, &alike)?;
        let distinct = refine::distinct(headers, &digests, inputs)?;
        if let Some([first, other]) = distinct.contradicting.first() {
            tracing::warn!(
                "{other}: expected another number or time than that of {first}, found the same and other pixels ({})",
                counted(distinct.contradicting.len() as u64, "such frame")
            );
        }
        Ok(distinct)
    }

    pub(super) fn second_pass(
        &self,
        archive: &ArchiveReader,
        done: &Done<FrameRecord>,
        camera: &CameraFrames,
        recipe: &Recipe,
    ) -> anyhow::Result<Flight> {
        let flight = refine::second_pass(done, archive, camera, recipe, &self.span())?;
        expect_answers(archive)?;
        ensure!(
            !flight.rows.is_empty(),
            "{}: expected frames from --since to --until, found none",
            self.archive.display()
        );
        if let Some(contradiction) = &flight.contradiction {
            bail!("{}: {contradiction}", self.archive.display());
        }
        Ok(flight)
    }
}

pub(super) fn journal_name(recipe: &impl FirstPass) -> String {
    format!("{}{:016x}.journal", recipe.prefix(), recipe.hash())
}

/// An object store that no longer answers ends the run: what is done is in the journal.
fn expect_answers(archive: &ArchiveReader) -> anyhow::Result<()> {
    if !archive.is_lost() {
        return Ok(());
    }
    let why = archive.unread_files().into_values().next();
    bail!(
        "{}: expected answers, found none to many requests, such as: {}; run again to go on",
        archive.name().display(),
        why.unwrap_or_default()
    )
}

/// Files that could not be read, though they may be another time, make the run a failure.
pub(super) fn expect_all_read(archive: &ArchiveReader) -> anyhow::Result<()> {
    let unread = archive.unread_files();
    if let Some((file, why)) = unread.first_key_value() {
        bail!(
            "{}: expected to read all files, found {} that could not be read, such as {file}: {why}; run again to try again",
            archive.name().display(),
            unread.len()
        );
    }
    Ok(())
}

/// What the cameras' files gave.
#[derive(Default)]
pub(super) struct InputsRead {
    pub frames: usize,
    unreadable: Unreadable,
}

impl InputsRead {
    pub fn add(&mut self, files: usize, inputs: &InputSummary) {
        self.frames += inputs.frames(files);
        self.unreadable.add(&inputs.unreadable);
    }

    /// An archive of which nothing could be read makes the run a failure.
    pub fn expect_frames(&self, archive: &ArchiveReader) -> anyhow::Result<()> {
        match self.unreadable.line() {
            Some(why) if self.frames == 0 => bail!(
                "{}: expected frames that can be read, found none: {why}",
                archive.name().display()
            ),
            _ => Ok(()),
        }
    }
}

pub(super) fn print_shard<T: Serialize + DeserializeOwned + Clone + Send>(
    shard: Shard,
    label: &str,
    done: &Done<T>,
    inputs: &[StoredFile],
) -> anyhow::Result<()> {
    let unreadable = done.unreadable(inputs)?;
    let Shard { number, of } = shard;
    let files = inputs.len();
    say(format_args!(
        "shard {number}/{of}: {label}: {files} files, {unreadable} of them unreadable"
    ))
}
