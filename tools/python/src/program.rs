//! Commands of the program, called with their options.

use crate::arguments;
use crate::errors::Failure;
use clap::Parser;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use solaspect::cli::calibrate::{self, CalibrateArgs};
use solaspect::cli::refine::{self, RefineArgs};

#[derive(Parser)]
#[command(name = "solaspect")]
enum Command {
    Calibrate(CalibrateArgs),
    Refine(RefineArgs),
}

/// Runs `solaspect COMMAND OPTIONS...` in this process.
#[pyfunction]
pub fn run(py: Python<'_>, options: Vec<String>) -> PyResult<()> {
    let command = parse(options)?;
    let outcome = py.detach(|| match command {
        Command::Calibrate(args) => calibrate::run(args),
        Command::Refine(args) => refine::run(&args),
    });
    outcome.map_err(Failure::from)?;
    Ok(())
}

/// A time as the program's options take it.
#[pyfunction]
pub fn time_text(time: &Bound<'_, PyAny>) -> PyResult<String> {
    Ok(arguments::time(time)?.to_string())
}

/// A place as the program's options take it.
#[pyfunction]
pub fn place_text(place: &Bound<'_, PyAny>) -> PyResult<String> {
    let place = arguments::place(place)?;
    let (latitude, longitude) = (place.latitude_deg, place.longitude_deg);
    Ok(format!("{latitude},{longitude},{}", place.height_m))
}

/// Options as the program reads them.
///
/// # Errors
/// An option that the program refuses, by name.
pub fn parse<P: Parser>(options: Vec<String>) -> PyResult<P> {
    let words = std::iter::once("solaspect".to_owned()).chain(options);
    P::try_parse_from(words).map_err(|error| {
        let text = error.to_string();
        let first = text.lines().next().unwrap_or_default();
        PyValueError::new_err(first.trim_start_matches("error: ").to_owned())
    })
}
