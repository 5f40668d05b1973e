//! Files that cfitsio opens: tables larger than memory, and tables of other programs, whose forms the reader in this module need not know.
//!
//! A name is that of a file on disk: cfitsio's extended names, which may name filters, other computers or programs, are not interpreted.

use super::Problem;
use fitsio::errors::{Error, FitsError};
use fitsio::sys::{self, fitsfile};
use fitsio::{FileOpenMode, FitsFile};
use std::ffi::CString;
use std::os::unix::ffi::OsStrExt;
use std::path::Path;

/// Opens a file on disk.
///
/// # Errors
/// A file that is missing, cannot be read or written, or is no FITS.
pub fn open_disk_file(path: &Path, mode: FileOpenMode) -> Result<FitsFile, Error> {
    let name = CString::new(path.as_os_str().as_bytes())
        .map_err(|_| Error::Message("a name without NUL was expected".into()))?;
    let (mut file, mut status) = (std::ptr::null_mut(), 0);
    let access = match mode {
        FileOpenMode::READONLY => sys::READONLY,
        FileOpenMode::READWRITE => sys::READWRITE,
    };
    // SAFETY: the name ends with NUL and outlives the call; the result is null or an open file, which FitsFile closes.
    unsafe {
        sys::ffdkopn(&raw mut file, name.as_ptr(), access as i32, &raw mut status);
        match status {
            0 => FitsFile::from_raw(file, mode),
            status => Err(FitsError {
                status,
                message: message(status),
            }
            .into()),
        }
    }
}

/// Result of a call of cfitsio, which gets the open file and a place for its status; `action` names the operation.
pub(super) fn called<T>(
    file: &mut FitsFile,
    action: &str,
    call: impl FnOnce(*mut fitsfile, &mut i32) -> T,
) -> Result<T, Problem> {
    let mut status = 0;
    // SAFETY: the pointer is that of an open file, and is not used after the call.
    let given = call(unsafe { file.as_raw() }, &mut status);
    match status {
        0 => Ok(given),
        status => Err(Problem::field(
            "cfitsio",
            format!("to {action}"),
            format!("\"{}\"", message(status)),
        )),
    }
}

/// cfitsio's message for a file that it does not open.
pub(super) fn unopened(cause: Error) -> String {
    match cause {
        Error::Fits(FitsError { message, .. }) => format!("\"{message}\""),
        other => other.to_string(),
    }
}

/// cfitsio's message for a status.
pub fn message(status: i32) -> String {
    let mut text = [0u8; 31];
    // SAFETY: cfitsio writes at most 30 characters and NUL.
    unsafe { sys::ffgerr(status, text.as_mut_ptr().cast()) };
    let text = text.split(|byte| *byte == 0).next().unwrap_or_default();
    String::from_utf8_lossy(text).into_owned()
}
