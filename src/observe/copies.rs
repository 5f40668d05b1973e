//! Duplicate frames in an archive, such as those of both disks of a mirroring flight: each frame counts once.

use super::headers::CameraHeader;
use super::journal::JournalError;
use super::pass::{Observer, Recorded, Span, Unsolved};
use crate::archive::{ArchiveReader, StoredFile};
use crate::frame::{Compared, Copies, Identity, PixelDigest, may_be_copies};
use rayon::prelude::*;
use std::path::Path;

/// Reads the pixels of frames that may be copies.
#[derive(Debug, Clone, Copy)]
pub(super) struct PixelDigests;

impl Observer for PixelDigests {
    type Output = PixelDigest;

    fn prefix(&self) -> &'static str {
        "pixels-"
    }

    fn observe(
        &self,
        archive: &ArchiveReader,
        input: &StoredFile,
        _: &Span,
    ) -> Result<Option<PixelDigest>, Unsolved> {
        let file = archive.open_file(&input.file)?;
        let frame = file.frame()?;
        Ok(Some(PixelDigest::of(&frame)))
    }
}

/// A file that contains a copy of another file's frame.
#[derive(Debug, Clone, PartialEq)]
pub struct CopiedFrame {
    pub input: StoredFile,
    pub identity: Identity,
    /// The file whose frame is used.
    pub first: String,
}

impl CopiedFrame {
    /// The reason why the file gives no result.
    pub fn reason(&self) -> String {
        format!("the same frame as {}", self.first)
    }

    /// Whether its unused frame was taken within a span.
    pub fn is_in(&self, span: &Span) -> bool {
        span.holds(self.identity.utc())
    }
}

/// The files of frames, without copies.
#[derive(Debug, Default)]
pub struct Distinct {
    /// Files in the order given.
    pub inputs: Vec<StoredFile>,
    pub copies: Vec<CopiedFrame>,
    /// Files with the same camera, number and time as another file, but different pixels; with that file.
    pub contradicting: Vec<[String; 2]>,
}

/// The files whose pixels must be compared, by their headers.
///
/// # Errors
/// If a journal cannot be read.
pub(super) fn may_be_copied(
    headers: &Recorded<CameraHeader>,
    inputs: &[StoredFile],
) -> Result<Vec<StoredFile>, JournalError> {
    let identities = identities(headers, inputs)?;
    let known: Vec<_> = identities.iter().map(Option::as_ref).collect();
    let marked = inputs.iter().zip(may_be_copies(&known));
    let marked = marked.filter(|(_, is_marked)| *is_marked);
    Ok(marked.map(|(input, _)| input.clone()).collect())
}

/// Separates the frames from their copies.
///
/// # Errors
/// If a journal cannot be read.
pub(super) fn distinct(
    headers: &Recorded<CameraHeader>,
    digests: &Recorded<PixelDigest>,
    inputs: Vec<StoredFile>,
) -> Result<Distinct, JournalError> {
    let identities = identities(headers, &inputs)?;
    let (mut compared, mut at) = (Vec::new(), Vec::new());
    for (n, (input, identity)) in inputs.iter().zip(&identities).enumerate() {
        let digest = digests.record(input)?;
        let digest = digest.and_then(|record| record.outcome.ok());
        if let Some((identity, digest)) = identity.as_ref().zip(digest) {
            at.push(n);
            compared.push(Compared {
                path: Path::new(&input.file),
                identity,
                digest: Some(digest),
            });
        }
    }
    let found = Copies::among(&compared);
    let name = |n: usize| inputs[at[n]].file.clone();
    let mut firsts = vec![None; inputs.len()];
    for (n, first) in found.of.iter().enumerate() {
        firsts[at[n]] = first.map(name);
    }
    let contradicting = found.contradicting.iter();
    let mut distinct = Distinct {
        contradicting: contradicting.map(|pair| pair.map(name)).collect(),
        ..Distinct::default()
    };
    for ((input, identity), first) in inputs.into_iter().zip(identities).zip(firsts) {
        match identity.zip(first) {
            Some((identity, first)) => distinct.copies.push(CopiedFrame {
                input,
                identity,
                first,
            }),
            None => distinct.inputs.push(input),
        }
    }
    Ok(distinct)
}

fn identities(
    headers: &Recorded<CameraHeader>,
    inputs: &[StoredFile],
) -> Result<Vec<Option<Identity>>, JournalError> {
    let identity = |input: &StoredFile| {
        let record = headers.record(input)?;
        let header = record.and_then(|record| record.outcome.ok());
        Ok(header.map(|header| header.identity))
    };
    inputs.par_iter().map(identity).collect()
}
