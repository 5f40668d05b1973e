//! Arguments of Python's functions; errors name the argument.

use crate::errors::{type_error, value_error};
use crate::instrument::Instrument;
use crate::solution::Track;
use jiff::Timestamp;
use pyo3::conversion::FromPyObjectOwned;
use pyo3::exceptions::{PyOverflowError, PyTypeError, PyValueError};
use pyo3::prelude::*;
use pyo3::types::{PyDateTime, PyString, PyTzInfo};
use solaspect::pointing::{HelioprojectiveArcsec, Target};
use solaspect::units::Place;
use std::path::PathBuf;

const TIMES: &str =
    "a str with its zone (\"2013-09-21T18:00:00Z\"), a datetime with its zone or an astropy Time";

/// A time: text with its zone, a `datetime` with its zone, or astropy's `Time`.
pub fn time(value: &Bound<'_, PyAny>) -> PyResult<Timestamp> {
    if let Ok(text) = value.cast::<PyString>() {
        return instant(text.to_str()?);
    }
    if value.is_instance_of::<PyDateTime>() {
        if value.call_method0("utcoffset")?.is_none() {
            let problem =
                format!("expected a datetime with its zone (tzinfo), found {value} without one");
            return Err(value_error("time", problem));
        }
        let utc = value.call_method1("astimezone", (PyTzInfo::utc(value.py())?,))?;
        return instant(&utc.call_method0("isoformat")?.extract::<String>()?);
    }
    if !value.hasattr("isot")? {
        return Err(type_error("time", TIMES, value));
    }
    if !value.getattr("isscalar")?.extract::<bool>()? {
        return Err(value_error(
            "time",
            "expected one time, found an array of them",
        ));
    }
    let utc = value.getattr("utc")?.call_method0("copy")?;
    utc.setattr("precision", 9)?;
    instant(&format!("{}Z", utc.getattr("isot")?.extract::<String>()?))
}

fn instant(text: &str) -> PyResult<Timestamp> {
    text.parse().map_err(|_| {
        let problem = format!(
            "expected a time with its zone such as \"2013-09-21T18:00:00Z\", found \"{text}\""
        );
        value_error("time", problem)
    })
}

/// A place: latitude (deg), longitude (deg, east positive) and height (m), or astropy's `EarthLocation`.
pub fn place(value: &Bound<'_, PyAny>) -> PyResult<Place> {
    let [latitude, longitude, height] = if value.hasattr("to_geodetic")? {
        let (longitude, latitude, height): (Bound<PyAny>, Bound<PyAny>, Bound<PyAny>) =
            value.call_method1("to_geodetic", ("WGS84",))?.extract()?;
        [
            latitude.call_method1("to_value", ("deg",))?.extract()?,
            longitude.call_method1("to_value", ("deg",))?.extract()?,
            height.call_method1("to_value", ("m",))?.extract()?,
        ]
    } else {
        let expected =
            "(latitude, longitude, height) in deg, deg and m, or an astropy EarthLocation";
        extracted(value, "place", expected)?
    };
    Place::new(latitude, longitude, height).map_err(|error| value_error("place", error))
}

/// A target: arcsec from the Sun's centre, towards solar west and solar north.
pub fn target(value: &Bound<'_, PyAny>) -> PyResult<Target> {
    let expected = "(x, y) in arcsec from the Sun's centre, towards solar west and north";
    let [x, y]: [f64; 2] = extracted(value, "target", expected)?;
    if !(x.is_finite() && y.is_finite()) {
        return Err(value_error("target", "expected finite numbers"));
    }
    Ok(Target::Fixed(HelioprojectiveArcsec { x, y }))
}

/// The tracking prior from the previous frame.
pub fn prior<'a, 'py>(value: &'a Bound<'py, PyAny>) -> PyResult<&'a Bound<'py, Track>> {
    let track = value.cast::<Track>();
    track.map_err(|_| type_error("prior", "the track of a Solution", value))
}

/// Saturation value of a pixel, DN.
pub fn saturation_dn(value: &Bound<'_, PyAny>) -> PyResult<u16> {
    extracted(value, "saturation_dn", "a whole number from 0 to 65535 DN")
}

/// Column and row of the sensor at which an array begins.
pub fn corner_px(value: &Bound<'_, PyAny>) -> PyResult<(usize, usize)> {
    let expected = "(column, row), two whole numbers from 0 on";
    extracted(value, "corner_px", expected)
}

/// Converts an argument to the required type.
fn extracted<'py, T: FromPyObjectOwned<'py>>(
    value: &Bound<'py, PyAny>,
    argument: &str,
    expected: &str,
) -> PyResult<T> {
    value.extract::<T>().map_err(|error| {
        let error: PyErr = error.into();
        let found = value.repr();
        let found = found.map_or_else(|_| "another".into(), |text| text.to_string());
        let text = format!("{argument}: expected {expected}, found {found}");
        match error.is_instance_of::<PyOverflowError>(value.py()) {
            true => PyValueError::new_err(text),
            false => PyTypeError::new_err(text),
        }
    })
}

/// An `Instrument`, the path of its file, or the name of a built-in one; by default "demo".
pub fn instrument<'py>(
    py: Python<'py>,
    value: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, Instrument>> {
    let Some(value) = value else {
        return Instrument::demo(py);
    };
    if let Ok(instrument) = value.cast::<Instrument>() {
        return Ok(instrument.clone());
    }
    let path: PathBuf = value.extract().map_err(|_| {
        let expected = "an Instrument, the path of its file or the name of a built-in one";
        type_error("instrument", expected, value)
    })?;
    Bound::new(py, Instrument::load(path)?)
}
