//! Time, camera and instrument from the frames' headers.

use super::pass::{Observer, Span, Unsolved};
use crate::archive::{ArchiveReader, StoredFile, flown_sha256, role_of};
use crate::frame::Identity;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Camera and instrument's file named in a frame's header.
#[derive(Debug, Clone, Serialize, Deserialize)]
pub struct CameraHeader {
    pub(super) identity: Identity,
}

/// Reads the headers of all frames, of whichever camera.
#[derive(Debug, Clone, Copy)]
pub struct CameraHeaders;

impl Observer for CameraHeaders {
    type Output = CameraHeader;

    fn prefix(&self) -> &'static str {
        "cameras-"
    }

    fn observe(
        &self,
        archive: &ArchiveReader,
        input: &StoredFile,
        _: &Span,
    ) -> Result<Option<CameraHeader>, Unsolved> {
        let (info, header) = archive.info(input)?;
        // Roll and Moon cameras have no plate instrument that their headers could name.
        let by_name = || {
            let (role, ordinal) = role_of(Path::new(&input.file))?;
            role.label(ordinal)
        };
        let mut identity = Identity::of(&info);
        identity.flown_sha256 = flown_sha256(&header);
        let instrument = &mut identity.taken_by.instrument;
        *instrument = instrument.take().or_else(by_name);
        Ok(Some(CameraHeader { identity }))
    }
}
