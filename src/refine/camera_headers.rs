//! What the frames' headers say of when, how and by which camera they were taken.

use super::first_pass::{FirstPass, JOURNAL_VERSION, Span, Unsolved, hash_of};
use crate::archive::{ArchiveReader, StoredFile, flown_sha256, sky_camera};
use crate::frame::Identity;
use crate::provenance;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// What a frame's header says of its camera and of the instrument's file.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct CameraHeader {
    pub(super) identity: Identity,
}

impl CameraHeader {
    /// Of the instrument's file that the frame names.
    pub(super) fn instrument_sha256(&self) -> Option<String> {
        let [_, instrument] = &self.identity.flown_sha256;
        instrument.clone()
    }
}

/// Reads the headers of all frames, whichever camera took them.
#[derive(Debug, Clone, Copy)]
pub struct CameraHeaders;

impl FirstPass for CameraHeaders {
    type Frame = CameraHeader;

    fn hash(&self) -> u64 {
        hash_of(format!("{} {JOURNAL_VERSION}", provenance::VERSION).as_bytes())
    }

    fn prefix(&self) -> &'static str {
        "cameras-"
    }

    fn solve(
        &self,
        archive: &ArchiveReader,
        input: &StoredFile,
        _: &Span,
    ) -> Result<Option<CameraHeader>, Unsolved> {
        let (info, header) = archive.info(input)?;
        // Roll and Moon camera have no instrument of the plate that their headers could name.
        let by_name = || sky_camera(Path::new(&input.file)).map(str::to_owned);
        let mut identity = Identity::of(&info);
        identity.flown_sha256 = flown_sha256(&header);
        let instrument = &mut identity.taken_by.instrument;
        *instrument = instrument.take().or_else(by_name);
        Ok(Some(CameraHeader { identity }))
    }
}
