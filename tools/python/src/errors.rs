//! Errors of the library as Python's exceptions.

use pyo3::exceptions::{PyTypeError, PyValueError};
use pyo3::prelude::*;
use solaspect::fits::{FileError, Problem};
use solaspect::instrument::TomlError;
use std::fmt::Display;

/// Content of a `SolaspectError`: a message, with the file and the field concerned.
pub struct Failure {
    message: String,
    file: Option<String>,
    field: Option<String>,
}

impl From<anyhow::Error> for Failure {
    fn from(error: anyhow::Error) -> Self {
        let places = error.chain().find_map(|cause| {
            let toml = cause.downcast_ref().map(place_in_toml);
            toml.or_else(|| cause.downcast_ref().map(place_in_file))
        });
        let (file, field) = places.unwrap_or_default();
        let message = format!("{error:#}");
        Self {
            message,
            file,
            field,
        }
    }
}

impl From<TomlError> for Failure {
    fn from(error: TomlError) -> Self {
        anyhow::Error::from(error).into()
    }
}

type Place = (Option<String>, Option<String>);

fn place_in_toml(error: &TomlError) -> Place {
    let field = Some(error.field.clone()).filter(|field| !field.is_empty());
    (Some(error.path.display().to_string()), field)
}

fn place_in_file(error: &FileError) -> Place {
    let field = match &error.problem {
        Problem::Field { field, .. } => Some(field.clone()),
        _ => None,
    };
    (Some(error.path.display().to_string()), field)
}

impl From<Failure> for PyErr {
    fn from(failure: Failure) -> Self {
        Python::attach(|py| {
            let error = py
                .import("solaspect.errors")
                .and_then(|module| module.getattr("SolaspectError"))
                .and_then(|class| class.call1((failure.message, failure.file, failure.field)));
            error.map_or_else(|error| error, Self::from_value)
        })
    }
}

/// The error for an argument of the right type with an invalid value.
pub fn value_error(argument: &str, problem: impl Display) -> PyErr {
    PyValueError::new_err(format!("{argument}: {problem}"))
}

/// The error for an argument of a wrong type.
pub fn type_error(argument: &str, expected: &str, found: &Bound<'_, PyAny>) -> PyErr {
    let name = found.get_type().name();
    let name = name.map_or_else(|_| "something else".into(), |name| name.to_string());
    PyTypeError::new_err(format!("{argument}: expected {expected}, found {name}"))
}
