//! Error of a refused file: always one line that names the file, the field and the expected content.

use std::io;
use std::path::{Path, PathBuf};

/// A file that could not be read or written, with the reason.
#[derive(Debug, thiserror::Error)]
#[error("{}: {problem}", .path.display())]
pub struct FileError {
    pub path: PathBuf,
    pub problem: Problem,
}

/// Fault of a file, or of data to be written to it.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Problem {
    /// The operating system refused.
    #[error("expected to {action} the file, found \"{cause}\"")]
    Io {
        action: &'static str,
        cause: io::Error,
    },
    /// The file as a whole is not of the expected kind.
    #[error("expected {expected}, found {found}")]
    Content { expected: String, found: String },
    /// A keyword, a column or the pixels do not have the expected content.
    #[error("{field}: expected {expected}, found {found}")]
    Field {
        field: String,
        expected: String,
        found: String,
    },
}

impl Problem {
    /// The operating system failed to read.
    pub(crate) fn unread(cause: io::Error) -> Self {
        let action = "read";
        Self::Io { action, cause }
    }

    /// The operating system failed to write.
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

    /// Adds the table of the field to the message.
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

    /// Adds the file of the problem to the message.
    pub(crate) fn in_file(self, path: &Path) -> FileError {
        FileError {
            path: path.into(),
            problem: self,
        }
    }
}
