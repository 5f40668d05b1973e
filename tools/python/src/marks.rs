//! Marks of the plate in a frame.

use crate::numbers::{Pair, Pairs, matrix, pair};
use pyo3::prelude::*;
use solaspect::aspect;
use solaspect::fiducial::{self, Lighting};

fn lighting_name(lighting: Lighting) -> &'static str {
    match lighting {
        Lighting::Full => "full",
        Lighting::Cut => "cut",
    }
}

/// A mark that was found on the disc, without an id.
#[pyclass(frozen, module = "solaspect")]
pub struct Detection {
    pub inner: fiducial::Detection,
}

#[pymethods]
impl Detection {
    /// Position, px.
    #[getter]
    fn px<'py>(&self, py: Python<'py>) -> Pair<'py> {
        pair(py, [self.inner.at.x, self.inner.at.y])
    }

    /// 1 sigma per axis, px.
    #[getter]
    fn sigma_px(&self) -> f64 {
        self.inner.sigma_px
    }

    /// Darkness of the cross as a fraction of the light around it.
    #[getter]
    fn contrast(&self) -> f64 {
        self.inner.contrast
    }

    /// Part of the structure at the position that a cross explains, 0 to 1.
    #[getter]
    fn likeness(&self) -> f64 {
        self.inner.likeness
    }

    /// "full", or "cut" by the limb or the edge of the sensor.
    #[getter]
    fn lighting(&self) -> &'static str {
        lighting_name(self.inner.lighting)
    }

    fn __repr__(&self) -> String {
        let (x, y) = (self.inner.at.x, self.inner.at.y);
        format!(
            "Detection(({x:.2}, {y:.2}) px, contrast {:.2})",
            self.inner.contrast
        )
    }
}

/// A fiducial mark with its id.
#[pyclass(frozen, module = "solaspect")]
pub struct Mark {
    pub inner: aspect::Mark,
}

#[pymethods]
impl Mark {
    /// Its place in the pattern, (i, j), each from -7 to 7.
    #[getter]
    fn id(&self) -> (i32, i32) {
        (self.inner.id.i, self.inner.id.j)
    }

    /// Position, px.
    #[getter]
    fn px<'py>(&self, py: Python<'py>) -> Pair<'py> {
        pair(py, [self.inner.at.x, self.inner.at.y])
    }

    /// Covariance of the position, (2, 2), px^2.
    #[getter]
    fn covariance_px2<'py>(&self, py: Python<'py>) -> PyResult<Pairs<'py>> {
        matrix(py, &self.inner.covariance_px2)
    }

    /// 1 sigma per axis, the mean of both, px.
    #[getter]
    fn sigma_px(&self) -> f64 {
        self.inner.sigma_px()
    }

    /// "full", or "cut" by the limb or the edge of the sensor.
    #[getter]
    fn lighting(&self) -> &'static str {
        lighting_name(self.inner.lighting)
    }

    fn __repr__(&self) -> String {
        let ((i, j), at) = (self.id(), self.inner.at);
        format!("Mark(({i}, {j}), ({:.3}, {:.3}) px)", at.x, at.y)
    }
}
