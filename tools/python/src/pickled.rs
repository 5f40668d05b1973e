//! Results as bytes, for `pickle`: results of one process can be used in another.

use crate::errors::value_error;
use pyo3::PyResult;
use serde::Serialize;
use serde::de::DeserializeOwned;
use solaspect::provenance::LONG_VERSION;

/// The bytes of a value, preceded by the version: only the same build can read them.
pub fn bytes(value: &impl Serialize) -> PyResult<Vec<u8>> {
    let bytes = postcard::to_stdvec(&(LONG_VERSION, value));
    bytes.map_err(|cause| value_error("pickle", cause))
}

/// The value from its bytes.
///
/// # Errors
/// If the bytes are from another version, or invalid.
pub fn value<T: DeserializeOwned>(bytes: &[u8]) -> PyResult<T> {
    let wrong = |found: &dyn std::fmt::Display| {
        value_error(
            "pickle",
            format_args!("expected one of solaspect {LONG_VERSION}, found {found}"),
        )
    };
    let (version, rest): (&str, _) =
        postcard::take_from_bytes(bytes).map_err(|cause| wrong(&cause))?;
    if version != LONG_VERSION {
        return Err(wrong(&format_args!("one of {version}")));
    }
    postcard::from_bytes(rest).map_err(|cause| wrong(&cause))
}
