//! Why a file was refused: always one line that names the file, the field and what was expected there.

use std::io;
use std::path::{Path, PathBuf};

/// A file that could not be read or written, and why.
#[derive(Debug, thiserror::Error)]
#[error("{}: {problem}", .path.display())]
pub struct FileError {
    pub path: PathBuf,
    pub problem: Problem,
}

/// Fault of a file, or of data that were to be written to it.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Problem {
    /// The operating system refused.
    #[error("expected to {action} the file, found \"{cause}\"")]
    Io {
        action: &'static str,
        cause: io::Error,
    },
    /// The file as a whole is not what it should be.
    #[error("expected {expected}, found {found}")]
    Content { expected: String, found: String },
    /// A keyword, a column or the pixels hold something else than they should.
    #[error("{field}: expected {expected}, found {found}")]
    Field {
        field: String,
        expected: String,
        found: String,
    },
}

impl Problem {
    /// That the operating system did not read.
    pub(crate) fn unread(cause: io::Error) -> Self {
        let action = "read";
        Self::Io { action, cause }
    }

    /// That the operating system did not write.
    pub(crate) fn unwritten(cause: io::Error) -> Self {
        let action = "write";
        Self::Io { action, cause }
    }

    pub(crate) fn content(expected: impl Into<String>, found: impl Into<String>) -> Self {
        Self::Content {
            expected: expected.into(),
            found: found.into(),
        }
    }

    pub(crate) fn field(
        field: impl Into<String>,
        expected: impl Into<String>,
        found: impl ToString,
    ) -> Self {
        Self::Field {
            field: field.into(),
            expected: expected.into(),
            found: found.to_string(),
        }
    }

    /// Names the table that a field is in.
    pub(crate) fn within(self, table: &str) -> Self {
        match self {
            Self::Field {
                field,
                expected,
                found,
            } => Self::Field {
                field: format!("{table}: {field}"),
                expected,
                found,
            },
            other => other,
        }
    }

    /// Names the file that the problem is in.
    pub(crate) fn in_file(self, path: &Path) -> FileError {
        FileError {
            path: path.into(),
            problem: self,
        }
    }
}
