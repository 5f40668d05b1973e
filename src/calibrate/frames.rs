//! The frames that a calibration is given: their files, their hash, whether one camera took them, and those rejected.

use crate::fits::{self, FRAME_ENDINGS, Unlisted};
use crate::frame::{Compared, Copies, Frame, Identity, PixelDigest, TakenBy, Unreadable, Warnings};
use crate::instrument::{Instrument, WrongCamera};
use crate::provenance;
use crate::report::html::Page;
use crate::units::counted;
use rayon::prelude::*;
use sha2::{Digest, Sha256};
use std::collections::BTreeMap;
use std::fmt;
use std::path::{Path, PathBuf};

/// A frame that a calibration does not use, and why.
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

    /// How many frames are rejected, and why the first is: the context of an error that may come of it.
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

/// Why the frames cannot be listed.
#[derive(Debug, thiserror::Error)]
pub enum InputError {
    #[error("{path}: cannot read: {cause}", path = .path.display())]
    Unreadable {
        path: PathBuf,
        cause: std::io::Error,
    },
    #[error("{}: expected frames (files that end in {}), found none", .0.display(), FRAME_ENDINGS.join(", "))]
    NoFrames(PathBuf),
}

impl From<Unlisted> for InputError {
    fn from(Unlisted { folder, cause }: Unlisted) -> Self {
        Self::Unreadable {
            path: folder,
            cause,
        }
    }
}

/// Which of the frames below a given folder are meant.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Depth {
    /// Those in it; where it holds none, those in the folders in it.
    Nearest,
    /// Those in it and in all folders below it.
    All,
}

/// The files of frames and of folders of them, folders in the order of their names.
///
/// # Errors
/// A path that cannot be read, a folder without frames.
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

fn nearest(folder: &Path) -> Result<Vec<PathBuf>, Unlisted> {
    let mut listing = fits::list_folder(folder)?;
    if listing.files.is_empty() {
        for folder in &listing.folders {
            listing.files.append(&mut fits::list_folder(folder)?.files);
        }
    }
    Ok(listing.files)
}

/// The files without copies of others' frames, in the order given, and the copies as rejected ones. Of a file of several images the one of `size_px` is compared. Warns of files that cannot be read, of
/// which each calibration says more, of values of headers that are not used, and of frames in one folder that cannot be told apart.
pub fn each_once(files: Vec<PathBuf>, size_px: [usize; 2]) -> (Vec<PathBuf>, Vec<RejectedFrame>) {
    let read = |file: &PathBuf| {
        let frame = fits::read_frame_of_size(file, size_px);
        let frame = frame.map_err(|error| error.problem.to_string())?;
        Ok((
            Identity::of(&frame.info),
            PixelDigest::of(&frame),
            frame.info,
        ))
    };
    let frames: Vec<Result<_, String>> = files.par_iter().map(read).collect();
    let (mut warnings, mut unreadable) = (Warnings::default(), Unreadable::default());
    let (mut compared, mut at) = (Vec::new(), Vec::new());
    for (n, (path, frame)) in files.iter().zip(&frames).enumerate() {
        match frame {
            Ok((identity, digest, info)) => {
                let name = path.display().to_string();
                warnings.note(&name, &info.warnings);
                at.push(n);
                let digest = Some(*digest);
                compared.push(Compared {
                    path,
                    identity,
                    digest,
                });
            }
            Err(error) => unreadable.note(error),
        }
    }
    let found = Copies::among(&compared);
    let mut first_of = vec![None; files.len()];
    for (n, first) in found.of.iter().enumerate() {
        first_of[at[n]] = first.map(|first| at[first]);
    }
    warn_of(&warnings, &unreadable);
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
    let (mut distinct, mut copies) = (Vec::new(), Vec::new());
    for (file, first) in files.iter().zip(first_of) {
        match first {
            Some(first) => {
                let reason = format!("the same frame as {}", files[first].display());
                copies.push(RejectedFrame::new(file, reason));
            }
            None => distinct.push(file.clone()),
        }
    }
    (distinct, copies)
}

/// Of each kind of warning its first file was named already.
fn warn_of(warnings: &Warnings, unreadable: &Unreadable) {
    for (kind, files) in warnings.counts().filter(|(_, files)| *files > 1) {
        tracing::warn!("{}: {kind}", counted(files, "file"));
    }
    if let Some(line) = unreadable.line() {
        tracing::warn!("{line}");
    }
}

/// SHA-256 over the sorted SHA-256 of the files that can be read, hexadecimal: whatever their names and order.
pub fn sha256<F: AsRef<Path> + Sync>(files: &[F]) -> String {
    let one = |file: &F| Some(Sha256::digest(fits::read_bytes(file.as_ref()).ok()?));
    let mut hashes: Vec<_> = files.par_iter().filter_map(one).collect();
    hashes.sort_unstable();
    provenance::sha256(hashes.concat())
}

/// What all frames of one calibration must have in common.
#[derive(Debug, Clone, PartialEq)]
pub struct Setting {
    file: PathBuf,
    /// What the frame says of instrument and camera.
    taken_by: TakenBy,
    /// Name and value of each property that the frame states.
    properties: Vec<(&'static str, String)>,
}

impl Setting {
    /// The camera and the depth of a frame.
    pub fn of(file: &Path, frame: &Frame) -> Self {
        let depth = format!("pixels that saturate at {} DN", frame.saturation_dn());
        let camera = frame.info.camera.as_ref();
        let camera = camera.map(|name| ("camera", format!("camera \"{name}\"")));
        Self {
            file: file.into(),
            taken_by: frame.info.taken_by(),
            properties: camera.into_iter().chain([("depth", depth)]).collect(),
        }
    }

    /// The camera's name, as the frame has it.
    pub fn camera(&self) -> Option<String> {
        self.taken_by.camera.clone()
    }

    /// Its size as well.
    pub fn with_size(mut self, frame: &Frame) -> Self {
        let size = format!("{} x {} px", frame.width(), frame.height());
        self.properties.push(("size", size));
        self
    }

    /// Its gains as well.
    pub fn with_gains(mut self, frame: &Frame) -> Self {
        let gains = [
            ("analogue gain", frame.info.analogue_gain),
            ("pre-amplifier gain", frame.info.preamp_gain),
        ];
        let stated = gains
            .into_iter()
            .filter_map(|(name, gain)| Some((name, gain?)));
        let stated = stated.map(|(name, gain)| (name, format!("{name} {gain}")));
        self.properties.extend(stated);
        self
    }
}

/// Two frames that differ in what all must have in common.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error(
    "mixed instruments: expected frames of one {what}, found {found} in {} and {other} in {}; give the frames of one camera and setting only",
    .file.display(), .other_file.display()
)]
pub struct Mixed {
    pub what: &'static str,
    pub file: PathBuf,
    pub found: String,
    pub other_file: PathBuf,
    pub other: String,
}

/// Frames that make no calibration of an instrument.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum WrongFrames {
    #[error(transparent)]
    Mixed(#[from] Box<Mixed>),
    #[error("{}: {wrong}; name the instrument of these frames with --instrument", .file.display())]
    Foreign {
        file: PathBuf,
        wrong: Box<WrongCamera>,
    },
}

/// Whether one camera, which is the instrument's, took all frames at one setting.
///
/// # Errors
/// The first two that differ, and the first of another instrument or camera.
pub fn check_settings<'a>(
    settings: impl IntoIterator<Item = &'a Setting>,
    instrument: &Instrument,
) -> Result<(), WrongFrames> {
    let mut known: BTreeMap<&str, (&Path, &str)> = BTreeMap::new();
    for setting in settings {
        let Setting {
            file,
            taken_by,
            properties,
        } = setting;
        instrument
            .check_taken_by(taken_by)
            .map_err(|wrong| WrongFrames::Foreign {
                file: file.clone(),
                wrong: Box::new(wrong),
            })?;
        for (what, value) in properties {
            let (first, found) = known.entry(what).or_insert((file, value));
            if *found != value {
                return Err(WrongFrames::from(Box::new(Mixed {
                    what,
                    file: first.to_path_buf(),
                    found: (*found).into(),
                    other_file: file.clone(),
                    other: value.clone(),
                })));
            }
        }
    }
    Ok(())
}
