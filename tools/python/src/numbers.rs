//! Numbers of the library as NumPy arrays and Python's times.

use crate::errors::Failure;
use jiff::Timestamp;
use jiff::tz::Offset;
use nalgebra::Matrix2;
use numpy::{Element, PyArray1, PyArray2, PyArrayMethods};
use pyo3::prelude::*;
use pyo3::types::{PyDateTime, PyTzInfo};
use serde::Serialize;

pub type Pair<'py> = Bound<'py, PyArray1<f64>>;
pub type Pairs<'py> = Bound<'py, PyArray2<f64>>;

/// An array of shape (2,).
pub fn pair<'py>(py: Python<'py>, pair: [f64; 2]) -> Pair<'py> {
    PyArray1::from_slice(py, &pair)
}

/// An array of shape (n, 2).
pub fn pairs<'py>(py: Python<'py>, pairs: impl Iterator<Item = [f64; 2]>) -> PyResult<Pairs<'py>> {
    rows(py, pairs.flatten().collect(), 2)
}

/// An array of rows of `width` numbers.
pub fn rows<T: Element>(
    py: Python<'_>,
    numbers: Vec<T>,
    width: usize,
) -> PyResult<Bound<'_, PyArray2<T>>> {
    let height = numbers.len() / width;
    PyArray1::from_vec(py, numbers).reshape([height, width])
}

/// An array of shape (2, 2).
pub fn matrix<'py>(py: Python<'py>, m: &Matrix2<f64>) -> PyResult<Pairs<'py>> {
    rows(py, vec![m.m11, m.m12, m.m21, m.m22], 2)
}

/// A `datetime` in UTC, to the microsecond.
pub fn datetime(py: Python<'_>, utc: Timestamp) -> PyResult<Bound<'_, PyDateTime>> {
    let at = Offset::UTC.to_datetime(utc);
    PyDateTime::new(
        py,
        at.year().into(),
        at.month() as u8,
        at.day() as u8,
        at.hour() as u8,
        at.minute() as u8,
        at.second() as u8,
        (at.subsec_nanosecond() / 1000) as u32,
        Some(&PyTzInfo::utc(py)?.to_owned()),
    )
}

/// The JSON form of a value, as Python's own types.
pub fn as_json<'py>(py: Python<'py>, value: &impl Serialize) -> PyResult<Bound<'py, PyAny>> {
    let text = serde_json::to_string(value).map_err(anyhow::Error::from);
    py.import("json")?
        .call_method1("loads", (text.map_err(Failure::from)?,))
}
