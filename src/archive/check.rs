//! Checks that an archive is sound: every file by itself, and the files as a sequence.
//!
//! A file is sound when its structure is complete, the checksums of every HDU match, the picture unpacks, the keywords have
//! the types that the [table](crate::fits::keyword) states, its marks can be read, it has the name that it was given, and its time is not
//! before that of the file before it, and the configuration and the instrument that it names are those of the archive, if it holds any. A file that a
//! solution log names must be present, on this disk or on the other. Frames that are missing only by their times or numbers make a gap, which is no
//! fault of the files that are present; nor is a copy of a frame a fault.

mod files;
mod keywords;
mod logged;
mod marks;
mod picture;
mod sequence;

pub use files::{Tree, TreeError, frames_of};
#[cfg(feature = "object-store")]
pub(super) use files::{is_fits, is_flown, is_navigation};
pub use keywords::{Group, KeywordRow, csv_header, csv_row, grouped};
pub use logged::MissingFile;
pub use marks::{Mark, marks};
pub use picture::stretched;
pub use sequence::Gap;

use super::flown::{FlownFiles, flown_sha256};
use crate::fits::{FileError, FitsFile, Problem, Value};
use crate::frame::{Compared, Copies, Identity, PixelDigest};
use jiff::Timestamp;
use rayon::prelude::*;
use sequence::Dated;
use serde::{Serialize, Serializer};
use std::path::{Path, PathBuf};

/// Findings of an archive.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Report {
    /// Files whose names end in `.fits`.
    pub files: usize,
    /// Entries of `bad_files`.
    pub bad: usize,
    /// Entries of `gap_list`.
    pub gaps: usize,
    /// Entries of `missing_files`.
    pub missing: usize,
    /// Frames that according to a log are on the other disk, which is not checked.
    pub on_other_disk: usize,
    /// Files whose names begin with a dot and end in `.part`: incomplete at a power cut.
    pub unfinished: usize,
    /// Sound files whose frames have no time.
    pub undated: usize,
    /// Entries of `copy_list`.
    pub copies: usize,
    /// Entries of `contradiction_list`.
    pub contradictions: usize,
    /// Number of frames missing from the sequence of frame numbers.
    pub missing_frames: u64,
    /// Mid-exposure of the earliest sound frame.
    #[serde(serialize_with = "milliseconds")]
    pub first_utc: Option<Timestamp>,
    /// Mid-exposure of the latest sound frame.
    #[serde(serialize_with = "milliseconds")]
    pub last_utc: Option<Timestamp>,
    pub bad_files: Vec<BadFile>,
    pub gap_list: Vec<Gap>,
    /// Files that a log names and that do not exist.
    pub missing_files: Vec<MissingFile>,
    /// Files that hold the same frame as another one.
    pub copy_list: Vec<CopiedFile>,
    /// Files whose frames have the camera, number and time of another file's frame, but other pixels.
    pub contradiction_list: Vec<ContradictingFile>,
}

/// A file, and another file with the same frame.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct CopiedFile {
    pub file: String,
    pub same_as: String,
}

/// A file, and the file whose frame its header claims.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct ContradictingFile {
    pub file: String,
    pub other: String,
}

impl Report {
    /// Whether every file is sound, and every file that a log names exists.
    pub fn is_sound(&self) -> bool {
        self.bad == 0 && self.missing == 0
    }
}

/// A file and its fault, in one line.
#[derive(Debug, Clone, PartialEq, Eq, PartialOrd, Ord, Serialize)]
pub struct BadFile {
    pub file: String,
    pub error: String,
}

impl From<FileError> for BadFile {
    fn from(error: FileError) -> Self {
        Self {
            file: error.path.display().to_string(),
            error: error.problem.to_string(),
        }
    }
}

/// Result of checking one file.
#[derive(Default)]
struct Checked {
    /// Identity and pixels of the file's frame, if it can be read.
    frame: Option<(Identity, PixelDigest)>,
    fault: Option<FileError>,
    /// Error if the file does not have the name that it was given: a fault, unless it is a copy.
    misnamed: Option<FileError>,
}

/// Checks every file of a tree, several at a time; `checked` is called after each.
pub fn check(tree: &Tree, checked: &(dyn Fn() + Sync)) -> Report {
    let (flown, unread) = match FlownFiles::read(&tree.flown) {
        Ok(flown) => (flown, None),
        Err(error) => (FlownFiles::default(), Some(error)),
    };
    let check_one = |path: &PathBuf| {
        let outcome = check_file(path, &flown);
        checked();
        outcome
    };
    let checked: Vec<Checked> = tree.files.par_iter().map(check_one).collect();
    let (first_of, contradiction_list) = compare(&tree.files, &checked);
    let mut bad_files = tree.unlisted.clone();
    let mut dated = Vec::new();
    let mut undated = 0;
    let mut copy_list = Vec::new();
    for ((path, checked), first) in tree.files.iter().zip(checked).zip(first_of) {
        if let Some(first) = first {
            copy_list.push(CopiedFile {
                file: path.display().to_string(),
                same_as: tree.files[first].display().to_string(),
            });
            bad_files.extend(checked.fault.map(BadFile::from));
            continue;
        }
        let fault = checked.fault.or(checked.misnamed);
        let identity = checked.frame.map(|(identity, _)| identity);
        match (fault, identity) {
            (None, Some(identity)) => match identity.utc() {
                Some(utc) => dated.push(Dated::sound(path, utc, identity.number)),
                None => undated += 1,
            },
            (fault, _) => {
                dated.push(Dated::bad(path));
                bad_files.extend(fault.map(BadFile::from));
            }
        }
    }
    let absent = logged::find_absent(&tree.logs);
    dated.extend(absent.elsewhere.iter().filter_map(Dated::elsewhere));
    let sequence = sequence::examine(dated);
    bad_files.extend(unread.map(|error| BadFile {
        file: error.path.display().to_string(),
        error: format!("expected {}, found {}", error.expected, error.found),
    }));
    bad_files.extend(sequence.backward);
    bad_files.extend(absent.bad);
    bad_files.sort();
    Report {
        files: tree.files.len(),
        bad: bad_files.len(),
        gaps: sequence.gaps.len(),
        missing: absent.missing.len(),
        on_other_disk: absent.elsewhere.len(),
        unfinished: tree.unfinished,
        undated,
        copies: copy_list.len(),
        contradictions: contradiction_list.len(),
        missing_frames: sequence.gaps.iter().map(|gap| gap.missing_frames).sum(),
        first_utc: sequence.first,
        last_utc: sequence.last,
        bad_files,
        gap_list: sequence.gaps,
        missing_files: absent.missing,
        copy_list,
        contradiction_list,
    }
}

/// For each file the one of which it is a copy; and files that contradict each other.
fn compare(files: &[PathBuf], checked: &[Checked]) -> (Vec<Option<usize>>, Vec<ContradictingFile>) {
    let (mut compared, mut at) = (Vec::new(), Vec::new());
    for (n, (path, checked)) in files.iter().zip(checked).enumerate() {
        if let Some((identity, digest)) = &checked.frame {
            at.push(n);
            compared.push(Compared {
                path,
                identity,
                digest: Some(*digest),
            });
        }
    }
    let found = Copies::among(&compared);
    let mut first_of = vec![None; files.len()];
    for (n, first) in found.of.iter().enumerate() {
        first_of[at[n]] = first.map(|first| at[first]);
    }
    let name = |n: usize| files[at[n]].display().to_string();
    let contradicting = found
        .contradicting
        .iter()
        .map(|[first, n]| ContradictingFile {
            file: name(*n),
            other: name(*first),
        });
    (first_of, contradicting.collect())
}

/// Checks one file by itself.
fn check_file(path: &Path, flown: &FlownFiles) -> Checked {
    let mut checked = Checked::default();
    checked.fault = checked.read(path, flown).err();
    checked
}

impl Checked {
    fn read(&mut self, path: &Path, flown: &FlownFiles) -> Result<(), FileError> {
        let file = FitsFile::open(path)?;
        let frame = file.frame();
        let shown = frame.as_ref().ok();
        self.frame = shown.map(|frame| (Identity::of(&frame.info), PixelDigest::of(frame)));
        let sums = file.checksums()?;
        if sums.guarded < sums.hdus {
            let expected = format!("both in each of {} HDUs", sums.hdus);
            let found = format!("both in {} of them", sums.guarded);
            return Err(field("CHECKSUM, DATASUM", expected, found).in_file(path));
        }
        frame?;
        let header = keywords::checked(&file)?;
        if let Some((identity, _)) = &mut self.frame {
            identity.flown_sha256 = flown_sha256(&header);
        }
        marks(&file)?;
        flown
            .check(&header)
            .map_err(|problem| problem.in_file(path))?;
        let name = path.file_name().unwrap_or_default().to_string_lossy();
        if let Some(Value::Text(given)) = header.get("FILENAME")
            && *given != *name
        {
            let expected = format!("'{name}', the name that the file has");
            let problem = field("FILENAME", expected, format!("'{given}'"));
            self.misnamed = Some(problem.in_file(path));
        }
        Ok(())
    }
}

fn field(field: &str, expected: impl Into<String>, found: impl Into<String>) -> Problem {
    Problem::Field {
        field: field.into(),
        expected: expected.into(),
        found: found.into(),
    }
}

fn milliseconds<S: Serializer>(utc: &Option<Timestamp>, serializer: S) -> Result<S::Ok, S::Error> {
    utc.map(|utc| format!("{utc:.3}")).serialize(serializer)
}
