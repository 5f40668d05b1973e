//! Commands of the program, called with their options.

use crate::arguments;
use crate::errors::Failure;
use clap::Parser;
use pyo3::exceptions::PyValueError;
use pyo3::prelude::*;
use solaspect::cli::calibrate::CalibrateArgs;
use solaspect::cli::events::EventsArgs;
use solaspect::cli::refine::RefineArgs;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::Duration;

#[derive(Parser)]
#[command(name = "solaspect")]
enum Command {
    Calibrate(CalibrateArgs),
    Events(EventsArgs),
    Refine(RefineArgs),
}

/// Runs `solaspect COMMAND OPTIONS...` in this process. KeyboardInterrupt ends it at the next frame; finished frames of a refinement are in its
/// journal.
#[pyfunction]
pub fn run(py: Python<'_>, options: Vec<String>) -> PyResult<()> {
    let command = parse(options)?;
    let cancelled = Arc::new(AtomicBool::new(false));
    let work = || match command {
        Command::Calibrate(args) => args.run(&cancelled),
        Command::Events(args) => args.run(&cancelled),
        Command::Refine(args) => args.run(&cancelled),
    };
    let (outcome, interrupted) = py.detach(|| {
        thread::scope(|scope| {
            let work = scope.spawn(work);
            let mut interrupted = None;
            // Python handles signals only on request, and the work does not check.
            while !work.is_finished() {
                thread::sleep(POLL);
                if let Err(error) = Python::attach(|py| py.check_signals()) {
                    cancelled.store(true, Ordering::Relaxed);
                    interrupted.get_or_insert(error);
                }
            }
            (work.join(), interrupted)
        })
    });
    if let Some(interrupted) = interrupted {
        return Err(interrupted);
    }
    match outcome {
        Ok(outcome) => outcome.map_err(Failure::from)?,
        Err(panic) => std::panic::resume_unwind(panic),
    };
    Ok(())
}

/// Interval at which Python's signals are checked.
const POLL: Duration = Duration::from_millis(20);

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

/// Parses options as the program does.
///
/// # Errors
/// An option that the program rejects, by name.
pub fn parse<P: Parser>(options: Vec<String>) -> PyResult<P> {
    let words = std::iter::once("solaspect".to_owned()).chain(options);
    P::try_parse_from(words).map_err(|error| {
        let text = error.to_string();
        let first = text.lines().next().unwrap_or_default();
        PyValueError::new_err(first.trim_start_matches("error: ").to_owned())
    })
}
