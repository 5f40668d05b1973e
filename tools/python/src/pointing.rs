//! Pointing of a refined flight's telescope, for many times in one call.

use crate::errors::Failure;
use crate::numbers::{Pairs, pairs, rows};
use jiff::Timestamp;
use nalgebra::Matrix3;
use numpy::{PyArray1, PyReadonlyArray1};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use solaspect::pointing::HelioprojectiveArcsec;
use solaspect::pointing_history::{self, Limits, LineOfSight, Pointed};
use solaspect::report;
use solaspect::sky::Ephemeris;
use std::path::PathBuf;

/// Values of a line of sight, with their names in Python.
type Named<T> = (&'static str, fn(&LineOfSight) -> T);

/// The pointing of a refined flight as a function of time.
#[pyclass(frozen, module = "solaspect")]
pub struct PointingHistory {
    inner: pointing_history::PointingHistory,
}

#[pymethods]
impl PointingHistory {
    /// Reads the history from a refined flight's folder.
    #[staticmethod]
    fn read(py: Python<'_>, folder: PathBuf) -> PyResult<Self> {
        let read = || pointing_history::PointingHistory::read(&folder);
        let inner = py.detach(read).map_err(anyhow::Error::from);
        Ok(Self {
            inner: inner.map_err(Failure::from)?,
        })
    }

    /// First and last time of the history, s since 1970.
    #[getter]
    fn ends_s(&self) -> Option<(f64, f64)> {
        self.inner.ends_s().map(Into::into)
    }

    /// The Sun's limb, (n, 2), and a heliographic grid with the given spacing, a list of such lines, at a time in s since 1970: arcsec to
    /// solar west and north.
    #[staticmethod]
    fn graticule<'py>(
        py: Python<'py>,
        unix_s: f64,
        apart_deg: u32,
    ) -> PyResult<(Pairs<'py>, Vec<Pairs<'py>>)> {
        let utc = Timestamp::from_nanosecond((unix_s * 1e9) as i128).map_err(anyhow::Error::from);
        let utc = utc.map_err(Failure::from)?;
        let disc = Ephemeris::default().disc(utc).map_err(anyhow::Error::from);
        let disc = disc.map_err(Failure::from)?;
        let line = |places: Vec<HelioprojectiveArcsec>| {
            pairs(py, places.into_iter().map(|at| [at.x, at.y]))
        };
        let lines = report::graticule(&disc, apart_deg.max(1))
            .into_iter()
            .map(line);
        Ok((line(report::limb(&disc))?, lines.collect::<PyResult<_>>()?))
    }

    /// The pointing at n times, s since 1970, as arrays by name: hpln and hplt, arcsec; north_angle, azimuth, elevation and roll, deg; random
    /// and systematic, (n, 9), arcsec^2; position_m, (n, 3), ECEF; valid; and lists of text, invalid and source. Unknown values are NaN.
    fn at<'py>(
        &self,
        py: Python<'py>,
        unix_s: PyReadonlyArray1<'py, f64>,
        most_sigma_arcsec: f64,
        fastest_arcsec_per_s: f64,
    ) -> PyResult<Bound<'py, PyDict>> {
        let times_s = unix_s.as_array().to_vec();
        let limits = Limits {
            most_sigma_arcsec,
            fastest_arcsec_per_s,
        };
        let (pointed, places): (Vec<Pointed>, Vec<[f64; 3]>) = py.detach(|| {
            let at = |time_s: &f64| {
                let place = self.inner.position_m(*time_s);
                let place = place.map_or([f64::NAN; 3], Into::into);
                (self.inner.within(&limits, *time_s), place)
            };
            times_s.iter().map(at).unzip()
        });
        let lines_of_sight: Vec<Option<&LineOfSight>> = pointed
            .iter()
            .map(|one| one.line_of_sight.as_ref())
            .collect();
        let found = PyDict::new(py);
        let columns: [Named<f64>; 6] = [
            ("hpln", |line_of_sight| {
                line_of_sight.helioprojective_arcsec.x
            }),
            ("hplt", |line_of_sight| {
                line_of_sight.helioprojective_arcsec.y
            }),
            ("north_angle", |line_of_sight| line_of_sight.north_angle_deg),
            ("azimuth", |line_of_sight| {
                line_of_sight.horizontal.azimuth_deg
            }),
            ("elevation", |line_of_sight| {
                line_of_sight.horizontal.elevation_deg
            }),
            ("roll", |line_of_sight| line_of_sight.roll_deg),
        ];
        for (name, value) in columns {
            let values = lines_of_sight
                .iter()
                .map(|line_of_sight| line_of_sight.map_or(f64::NAN, value));
            found.set_item(name, PyArray1::from_iter(py, values))?;
        }
        let matrices: [Named<Matrix3<f64>>; 2] = [
            ("random", |line_of_sight| line_of_sight.random_arcsec2),
            ("systematic", |line_of_sight| {
                line_of_sight.systematic_arcsec2
            }),
        ];
        for (name, value) in matrices {
            let unknown = Matrix3::from_element(f64::NAN);
            let values = lines_of_sight
                .iter()
                .map(|line_of_sight| line_of_sight.map_or(unknown, value));
            // Symmetric, so the order of rows and columns does not matter.
            let numbers = values.flat_map(|matrix| <[f64; 9]>::try_from(matrix.as_slice()));
            found.set_item(name, rows(py, numbers.flatten().collect(), 9)?)?;
        }
        let places = places.into_iter().flatten().collect();
        found.set_item("position_m", rows(py, places, 3)?)?;
        let valid = pointed.iter().map(Pointed::is_valid);
        found.set_item("valid", PyArray1::from_iter(py, valid))?;
        let invalid = pointed
            .iter()
            .map(|one| one.invalid.map_or("", |why| why.name()));
        found.set_item("invalid", invalid.collect::<Vec<&str>>())?;
        let source = lines_of_sight.iter().map(|line_of_sight| {
            line_of_sight.map_or("", |line_of_sight| line_of_sight.basis.name())
        });
        found.set_item("source", source.collect::<Vec<&str>>())?;
        Ok(found)
    }
}
