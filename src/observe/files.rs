//! Frames given as files or folders: their files, their hashes, a pass over them, and the rejected ones.

use super::pass::Watch;
use crate::fits::{self, FRAME_ENDINGS, Unlisted};
use crate::frame::{Compared, Copies, Frame, Identity, PixelDigest, Unreadable, Warning, Warnings};
use crate::provenance;
use crate::report::html::Page;
use crate::units::counted;
use rayon::prelude::*;
use sha2::{Digest, Sha256};
use std::fmt;
use std::path::{Path, PathBuf};

/// A rejected frame, with the reason.
#[derive(Debug, Clone, PartialEq)]
pub struct RejectedFrame {
    pub file: PathBuf,
    pub reason: String,
}

impl RejectedFrame {
    pub fn new(file: impl Into<PathBuf>, reason: impl Into<String>) -> Self {
        Self {
            file: file.into(),
            reason: reason.into(),
        }
    }

    /// The number of rejected frames, and the first reason: context for an error that may result.
    pub fn count_and_first(rejected: &[Self]) -> String {
        match rejected.first() {
            Some(first) => {
                let frames = counted(rejected.len() as u64, "frame");
                format!("{frames} rejected, the first {first}")
            }
            None => "no calibration".into(),
        }
    }

    /// All of them as a section of a page.
    pub fn section(page: &mut Page, rejected: &[Self]) {
        page.heading(&format!("Rejected frames: {}", rejected.len()));
        let row = |frame: &Self| vec![frame.file.display().to_string(), frame.reason.clone()];
        let rows: Vec<_> = rejected.iter().map(row).collect();
        page.table(&["frame", "reason"], &rows);
    }
}

impl fmt::Display for RejectedFrame {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "{}: {}", self.file.display(), self.reason)
    }
}

/// Reasons for which the frames cannot be listed, or not all of them are read.
#[derive(Debug, thiserror::Error)]
pub enum InputError {
    #[error("{path}: cannot read: {cause}", path = .path.display())]
    Unreadable {
        path: PathBuf,
        cause: std::io::Error,
    },
    #[error("{}: expected frames (files that end in {}), found none", .0.display(), FRAME_ENDINGS.join(", "))]
    NoFrames(PathBuf),
    #[error("cancelled")]
    Cancelled,
}

impl From<Unlisted> for InputError {
    fn from(Unlisted { folder, cause }: Unlisted) -> Self {
        Self::Unreadable {
            path: folder,
            cause,
        }
    }
}

/// Which frames of a given folder are listed.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Depth {
    /// Frames in the folder; if it contains none, those in its direct subfolders.
    Nearest,
    /// Frames in the folder and in all folders below it.
    All,
}

/// The files of frames and of folders of them, folders in the order of their names.
///
/// # Errors
/// If a path cannot be read, or a folder has no frames.
pub fn list(given: &[PathBuf], depth: Depth) -> Result<Vec<PathBuf>, InputError> {
    let mut files = Vec::new();
    for path in given {
        let kind = std::fs::metadata(path).map_err(|cause| InputError::Unreadable {
            path: path.clone(),
            cause,
        })?;
        let mut found = match (kind.is_dir(), depth) {
            (false, _) => vec![path.clone()],
            (true, Depth::Nearest) => nearest(path)?,
            (true, Depth::All) => fits::list_tree(path)?,
        };
        if found.is_empty() {
            return Err(InputError::NoFrames(path.clone()));
        }
        files.append(&mut found);
    }
    Ok(files)
}

/// The files among `given` as they are named, and the frames of each folder; a folder without frames is kept, so that it can be reported.
///
/// # Errors
/// If a folder cannot be listed.
pub fn named(given: &[PathBuf]) -> Result<Vec<PathBuf>, Unlisted> {
    let mut files = Vec::new();
    for path in given {
        let mut frames = match path.is_dir() {
            true => fits::list_tree(path)?,
            false => Vec::new(),
        };
        if frames.is_empty() {
            frames.push(path.clone());
        }
        files.append(&mut frames);
    }
    Ok(files)
}

/// Takes the result of each item, in the order of the items, with `jobs` of them at a time.
///
/// # Errors
/// Any error of `take`.
pub fn in_order<I: Sync, O: Send>(
    items: &[I],
    jobs: usize,
    solve: impl Fn(&I) -> O + Sync,
    mut take: impl FnMut(O) -> anyhow::Result<()>,
) -> anyhow::Result<()> {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(jobs).build()?;
    for some in items.chunks(jobs.max(1)) {
        let solved: Vec<O> = pool.install(|| some.par_iter().map(&solve).collect());
        solved.into_iter().try_for_each(&mut take)?;
    }
    Ok(())
}

fn nearest(folder: &Path) -> Result<Vec<PathBuf>, Unlisted> {
    let mut listing = fits::list_folder(folder)?;
    if listing.files.is_empty() {
        for folder in &listing.folders {
            listing.files.append(&mut fits::list_folder(folder)?.files);
        }
    }
    Ok(listing.files)
}

/// Result of a pass over files.
#[derive(Debug)]
pub struct Observed<T> {
    /// Frames in the order given, without copies: the result, or the reason why the file cannot be read.
    pub frames: Vec<(PathBuf, Result<T, String>)>,
    /// Files that contain a copy of another one's frame.
    pub copies: Vec<RejectedFrame>,
}

impl<T> Observed<Result<T, String>> {
    /// Results of the frames, in the order of the files, and rejected files: each with the reason, copies last.
    pub fn split(self) -> (Vec<T>, Vec<RejectedFrame>) {
        let (mut given, mut rejected) = (Vec::new(), Vec::new());
        for (file, outcome) in self.frames {
            match outcome.flatten() {
                Ok(one) => given.push(one),
                Err(reason) => rejected.push(RejectedFrame::new(file, reason)),
            }
        }
        rejected.extend(self.copies);
        (given, rejected)
    }
}

/// Opens each file once, several at a time, and returns the result for its frame; in a file with several images it uses the one of
/// `size_px`. Warns of unreadable files, of ignored header values, and of frames in one folder that cannot be distinguished.
///
/// # Errors
/// [`InputError::Cancelled`].
pub fn each_frame<T: Send>(
    files: Vec<PathBuf>,
    size_px: [usize; 2],
    watch: &dyn Watch,
    observe: impl Fn(&Path, Frame) -> T + Sync,
) -> Result<Observed<T>, InputError> {
    watch.begin(files.len(), "frames");
    let one = |file: &PathBuf| {
        if watch.is_cancelled() {
            return Err(InputError::Cancelled);
        }
        let frame = fits::read_frame_of_size(file, size_px);
        let observed = frame
            .map_err(|error| error.problem.to_string())
            .map(|frame| {
                let facts = FileFacts::of(&frame);
                (facts, observe(file, frame))
            });
        watch.step();
        Ok(observed)
    };
    let observed = files.par_iter().map(one).collect::<Result<Vec<_>, _>>();
    watch.end();
    let observed = observed?;
    let facts: Vec<_> = observed.iter().map(|o| Some(&o.as_ref().ok()?.0)).collect();
    warn_of(&files, &observed);
    let first_of = first_of(&files, &facts);
    let mut all = Observed {
        frames: Vec::new(),
        copies: Vec::new(),
    };
    for ((file, first), observed) in files.iter().zip(first_of).zip(observed) {
        match first {
            Some(first) => {
                let reason = format!("the same frame as {}", files[first].display());
                all.copies.push(RejectedFrame::new(file, reason));
            }
            None => all
                .frames
                .push((file.clone(), observed.map(|(_, given)| given))),
        }
    }
    Ok(all)
}

/// Identity of a frame, and the unused parts of its file.
struct FileFacts {
    identity: Identity,
    digest: PixelDigest,
    warnings: Vec<Warning>,
}

impl FileFacts {
    fn of(frame: &Frame) -> Self {
        Self {
            identity: Identity::of(&frame.info),
            digest: PixelDigest::of(frame),
            warnings: frame.info.warnings.clone(),
        }
    }
}

/// For each file with a copy, the file of the original frame.
fn first_of(files: &[PathBuf], facts: &[Option<&FileFacts>]) -> Vec<Option<usize>> {
    let read = facts
        .iter()
        .enumerate()
        .filter_map(|(n, facts)| Some((n, (*facts)?)));
    let (at, compared): (Vec<usize>, Vec<Compared>) = read
        .map(|(n, facts)| {
            let compared = Compared {
                path: &files[n],
                identity: &facts.identity,
                digest: Some(facts.digest),
            };
            (n, compared)
        })
        .unzip();
    let found = Copies::among(&compared);
    for [first, other] in found.contradicting {
        let (first, other) = (&files[at[first]], &files[at[other]]);
        if first.parent() == other.parent() {
            tracing::warn!(
                "{}: expected another number or time than that of {}, found the same and other pixels",
                other.display(),
                first.display()
            );
        }
    }
    let mut first_of = vec![None; files.len()];
    for (n, first) in found.of.iter().enumerate() {
        first_of[at[n]] = first.map(|first| at[first]);
    }
    first_of
}

/// Warns of unused inputs, and counts them.
fn warn_of<T>(files: &[PathBuf], observed: &[Result<(FileFacts, T), String>]) {
    let (mut warnings, mut unreadable) = (Warnings::default(), Unreadable::default());
    for (file, observed) in files.iter().zip(observed) {
        match observed {
            Ok((facts, _)) => warnings.note(&file.display().to_string(), &facts.warnings),
            Err(error) => unreadable.note(error),
        }
    }
    // The first file of each kind of warning was already named.
    for (kind, files) in warnings.counts().filter(|(_, files)| *files > 1) {
        tracing::warn!("{}: {kind}", counted(files, "file"));
    }
    if let Some(line) = unreadable.line() {
        tracing::warn!("{line}");
    }
}

/// The SHA-256 of a file.
pub type Hash = [u8; 32];

/// The hash of each file; none if it cannot be read.
pub fn hashes<F: AsRef<Path> + Sync>(files: &[F]) -> Vec<Option<Hash>> {
    let one = |file: &F| Some(Sha256::digest(fits::read_bytes(file.as_ref()).ok()?).into());
    files.par_iter().map(one).collect()
}

/// SHA-256 over sorted hashes, hexadecimal: independent of the names and order of the files.
pub fn sha256_of(hashes: &[Option<Hash>]) -> String {
    let mut hashes: Vec<&Hash> = hashes.iter().flatten().collect();
    hashes.sort_unstable();
    provenance::sha256(hashes.into_iter().flatten().copied().collect::<Vec<u8>>())
}

/// The same for the files that can be read.
pub fn sha256<F: AsRef<Path> + Sync>(files: &[F]) -> String {
    sha256_of(&hashes(files))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicUsize, Ordering};

    /// Ends a pass after this many frames.
    struct CancelAfter(AtomicUsize);

    impl Watch for CancelAfter {
        fn step(&self) {
            let less = |left: usize| Some(left.saturating_sub(1));
            let _ = self
                .0
                .fetch_update(Ordering::Relaxed, Ordering::Relaxed, less);
        }

        fn is_cancelled(&self) -> bool {
            self.0.load(Ordering::Relaxed) == 0
        }
    }

    #[test]
    fn a_cancelled_pass_ends_at_the_next_frame_and_says_so() {
        let files: Vec<PathBuf> = (0..100).map(|n| format!("{n}.fits").into()).collect();
        let pass = |frames| {
            let watch = CancelAfter(AtomicUsize::new(frames));
            each_frame(files.clone(), [8, 8], &watch, |_, _| ())
        };
        assert!(matches!(pass(10), Err(InputError::Cancelled)));
        // Missing files: one row with the reason for each.
        assert_eq!(pass(1000).unwrap().frames.len(), 100);
    }
}
