//! The telescope's offset from its target.

use crate::numbers::{Pairs, matrix};
use pyo3::prelude::*;
use solaspect::pointing;

/// Pointing of the telescope minus its target.
#[pyclass(frozen, module = "solaspect")]
pub struct Offset {
    pub inner: pointing::Offset,
}

#[pymethods]
impl Offset {
    /// Difference of azimuths, deg, -180 to 180.
    #[getter]
    fn azimuth_deg(&self) -> f64 {
        self.inner.azimuth_deg
    }

    /// Difference of elevations, deg.
    #[getter]
    fn elevation_deg(&self) -> f64 {
        self.inner.elevation_deg
    }

    /// True angle across, deg, from the target's vertical circle towards larger azimuth.
    #[getter]
    fn cross_elevation_deg(&self) -> f64 {
        self.inner.cross_elevation_deg
    }

    /// 1 sigma per axis of true angle, of this frame, deg.
    #[getter]
    fn sigma_deg(&self) -> f64 {
        self.inner.sigma_deg
    }

    /// Covariance of this frame in true angle, across and in elevation, (2, 2), deg^2.
    #[getter]
    fn covariance_deg2<'py>(&self, py: Python<'py>) -> PyResult<Pairs<'py>> {
        matrix(py, &self.inner.covariance_deg2)
    }

    /// 1 sigma per axis from the calibration, common to all frames, deg.
    #[getter]
    fn calibration_sigma_deg(&self) -> f64 {
        self.inner.calibration_sigma_deg()
    }

    /// Covariance from the calibration, across and in elevation, (2, 2), deg^2.
    #[getter]
    fn calibration_covariance_deg2<'py>(&self, py: Python<'py>) -> PyResult<Pairs<'py>> {
        matrix(py, &self.inner.calibration_deg2)
    }

    fn __repr__(&self) -> String {
        let (azimuth, elevation) = (self.inner.azimuth_deg, self.inner.elevation_deg);
        let sigma = self.inner.sigma_deg;
        format!(
            "Offset(azimuth {azimuth:+.5} deg, elevation {elevation:+.5} deg, sigma {sigma:.5} deg)"
        )
    }
}
