//! From an array to a solution.

use crate::errors::value_error;
use crate::solution::Solution;
use crate::{arguments, pixels};
use pyo3::prelude::*;
use solaspect::aspect::{self, Expected, SolverSettings};
use solaspect::calibrate::check;
use solaspect::frame::FrameInfo;
use solaspect::pointing;
use solaspect::sky::Ephemeris;
use std::time::Instant;

#[pyfunction]
#[pyo3(signature = (array, *, instrument=None, time=None, place=None, target=None, prior=None, saturation_dn=None, corner_px=None))]
#[expect(
    clippy::too_many_arguments,
    reason = "each is one of Python's keywords"
)]
pub fn solve<'py>(
    py: Python<'py>,
    array: &Bound<'py, PyAny>,
    instrument: Option<&Bound<'py, PyAny>>,
    time: Option<&Bound<'py, PyAny>>,
    place: Option<&Bound<'py, PyAny>>,
    target: Option<&Bound<'py, PyAny>>,
    prior: Option<&Bound<'py, PyAny>>,
    saturation_dn: Option<&Bound<'py, PyAny>>,
    corner_px: Option<&Bound<'py, PyAny>>,
) -> PyResult<Solution> {
    let instrument = arguments::instrument(py, instrument)?;
    let utc = time.map(arguments::time).transpose()?;
    let place = place.map(arguments::place).transpose()?;
    let target = target.map(arguments::target).transpose()?;
    let saturation_dn = saturation_dn.map(arguments::saturation_dn).transpose()?;
    let corner_px = corner_px.map(arguments::corner_px).transpose()?;
    let info = FrameInfo {
        mid_exposure: utc,
        place,
        corner_px,
        ..FrameInfo::default()
    };
    let frame = pixels::frame(array, saturation_dn, info)?;
    let seen = instrument.get().inner.seen_by(&frame);
    let instrument = seen.map_err(|wrong| value_error("array", wrong))?;
    let prior = prior.map(arguments::prior).transpose()?;
    let prior = prior.map(|track| &track.get().inner);
    Ok(py.detach(|| {
        let expected = utc.and_then(Expected::at);
        let settings = SolverSettings::default();
        let start = Instant::now();
        let mut inner = aspect::solve_with(&settings, &frame, &instrument, expected, prior);
        let solve_time = start.elapsed();
        let (target, mut ephemeris) = (target.unwrap_or_default(), Ephemeris::default());
        let offset = pointing::offset_of(
            &mut inner,
            utc,
            place,
            &target,
            None,
            &instrument,
            &mut ephemeris,
        );
        Solution {
            contradictions: check::contradictions(&inner, &instrument),
            inner,
            utc,
            offset,
            solve_time,
        }
    }))
}
