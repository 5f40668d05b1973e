//! Where the telescope of a refined flight pointed, at many times at once.

use crate::errors::Failure;
use crate::numbers::rows;
use numpy::{PyArray1, PyArray2, PyReadonlyArray1};
use pyo3::prelude::*;
use solaspect::pointing_history::{self, Pointed, Sight};
use std::path::PathBuf;

/// The pointing of a refined flight as a function of time.
#[pyclass(frozen, module = "solaspect")]
pub struct PointingHistory {
    inner: pointing_history::PointingHistory,
}

/// The pointing at some times; what is not known is NaN.
#[pyclass(frozen, get_all, module = "solaspect")]
pub struct Pointings {
    /// (n,), arcsec.
    hpln: Py<PyArray1<f64>>,
    hplt: Py<PyArray1<f64>>,
    /// (n,), deg.
    north_angle: Py<PyArray1<f64>>,
    azimuth: Py<PyArray1<f64>>,
    elevation: Py<PyArray1<f64>>,
    roll: Py<PyArray1<f64>>,
    /// (n, 9), arcsec^2.
    random: Py<PyArray2<f64>>,
    systematic: Py<PyArray2<f64>>,
    /// (n, 3), ECEF, m.
    position_m: Py<PyArray2<f64>>,
    valid: Py<PyArray1<bool>>,
    invalid: Vec<&'static str>,
    source: Vec<&'static str>,
}

#[pymethods]
impl PointingHistory {
    /// The history that a refined flight's folder holds.
    #[staticmethod]
    fn read(py: Python<'_>, folder: PathBuf) -> PyResult<Self> {
        let read = || pointing_history::PointingHistory::read(&folder);
        let inner = py.detach(read).map_err(anyhow::Error::from);
        Ok(Self {
            inner: inner.map_err(Failure::from)?,
        })
    }

    /// The first and the last time that is known, s since 1970.
    #[getter]
    fn ends_s(&self) -> Option<[f64; 2]> {
        self.inner.ends_s()
    }

    /// The pointing at times, s since 1970.
    #[pyo3(signature = (unix_s, most_sigma_arcsec, fastest_arcsec_per_s))]
    fn at(
        &self,
        py: Python<'_>,
        unix_s: PyReadonlyArray1<'_, f64>,
        most_sigma_arcsec: f64,
        fastest_arcsec_per_s: f64,
    ) -> PyResult<Pointings> {
        let times_s = unix_s.as_array().to_vec();
        let limits = pointing_history::Limits {
            most_sigma_arcsec,
            fastest_arcsec_per_s,
        };
        let (pointed, places): (Vec<Pointed>, Vec<[f64; 3]>) = py.detach(|| {
            let of = |time_s: &f64| {
                let place = self.inner.position_m(*time_s);
                let place = place.map_or([f64::NAN; 3], Into::into);
                (self.inner.within(&limits, *time_s), place)
            };
            times_s.iter().map(of).unzip()
        });
        let sights: Vec<Option<&Sight>> = pointed.iter().map(|one| one.sight.as_ref()).collect();
        let column = |value: fn(&Sight) -> f64| {
            let values = sights.iter().map(|sight| sight.map_or(f64::NAN, value));
            PyArray1::from_iter(py, values).unbind()
        };
        let matrices = |value: fn(&Sight) -> [f64; 9]| {
            let values = sights.iter().flat_map(|sight| sight.map_or([f64::NAN; 9], value));
            Ok::<_, PyErr>(rows(py, values.collect(), 9)?.unbind())
        };
        Ok(Pointings {
            hpln: column(|sight| sight.helioprojective_arcsec.x),
            hplt: column(|sight| sight.helioprojective_arcsec.y),
            north_angle: column(|sight| sight.north_angle_deg),
            azimuth: column(|sight| sight.horizontal.azimuth_deg),
            elevation: column(|sight| sight.horizontal.elevation_deg),
            roll: column(|sight| sight.roll_deg),
            random: matrices(|sight| numbers(&sight.random_arcsec2))?,
            systematic: matrices(|sight| numbers(&sight.systematic_arcsec2))?,
            position_m: rows(py, places.into_iter().flatten().collect(), 3)?.unbind(),
            valid: PyArray1::from_iter(py, pointed.iter().map(Pointed::is_valid)).unbind(),
            invalid: pointed
                .iter()
                .map(|one| one.invalid.map_or("", |why| why.name()))
                .collect(),
            source: sights
                .iter()
                .map(|sight| sight.map_or("", |sight| sight.basis.name()))
                .collect(),
        })
    }
}

/// A symmetric matrix, row by row.
fn numbers(matrix: &nalgebra::Matrix3<f64>) -> [f64; 9] {
    std::array::from_fn(|n| matrix[(n / 3, n % 3)])
}
