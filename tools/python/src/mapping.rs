//! The sensor-to-plate transformation.

use crate::errors::value_error;
use crate::numbers::{Pairs, rows};
use numpy::{
    AllowTypeChange, PyArray1, PyArrayDyn, PyArrayLikeDyn, PyArrayMethods, PyUntypedArrayMethods,
};
use pyo3::prelude::*;
use solaspect::aspect::{self, Adopted};
use solaspect::units::{PlateMil, SensorPx};

/// The sensor-to-plate transformation of a solution; scale and rotation are those at the Sun's place.
#[pyclass(frozen, module = "solaspect")]
pub struct Mapping {
    pub inner: Adopted,
    pub aspect: aspect::Aspect,
}

#[pymethods]
impl Mapping {
    /// "similarity", "keystone", "affine" or "homography".
    #[getter]
    fn kind(&self) -> &'static str {
        self.inner.mapping().kind().name()
    }

    /// Its origin: this "frame", the "prior" or the "calibration".
    #[getter]
    fn origin(&self) -> &'static str {
        match self.inner {
            Adopted::Own(_) => "frame",
            Adopted::Prior(_) => "prior",
            Adopted::Calibration(_) => "calibration",
        }
    }

    /// Root mean square residual of the marks per axis, px; None for a borrowed mapping.
    #[getter]
    fn residual_px(&self) -> Option<f64> {
        self.inner.residual_px()
    }

    /// Plate length per pixel, mil/px.
    #[getter]
    fn scale_mil_per_px(&self) -> f64 {
        self.aspect.mapping.scale_mil_per_px.value
    }

    /// 1 sigma of scale_mil_per_px, mil/px.
    #[getter]
    fn scale_sigma_mil_per_px(&self) -> f64 {
        self.aspect.mapping.scale_mil_per_px.sigma
    }

    /// Rotation, deg, positive from +x towards +y.
    #[getter]
    fn rotation_deg(&self) -> f64 {
        self.aspect.mapping.rotation_deg.value
    }

    /// 1 sigma of rotation_deg, deg.
    #[getter]
    fn rotation_sigma_deg(&self) -> f64 {
        self.aspect.mapping.rotation_deg.sigma
    }

    /// The homography from ideal sensor positions, corrected for the lens's distortion, to the plate.
    #[getter]
    fn matrix<'py>(&self, py: Python<'py>) -> PyResult<Pairs<'py>> {
        // nalgebra stores columns.
        let numbers = self
            .inner
            .mapping()
            .matrix()
            .transpose()
            .as_slice()
            .to_vec();
        rows(py, numbers, 3)
    }

    /// Plate positions (mil) of sensor positions (px), (..., 2).
    fn to_plate<'py>(
        &self,
        py: Python<'py>,
        px: PyArrayLikeDyn<'py, f64, AllowTypeChange>,
    ) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        mapped(py, "px", &px, |x, y| {
            let at = self.inner.mapping().to_plate(SensorPx::new(x, y));
            [at.x, at.y]
        })
    }

    /// Sensor positions (px) of plate positions (mil), (..., 2).
    fn to_sensor<'py>(
        &self,
        py: Python<'py>,
        mil: PyArrayLikeDyn<'py, f64, AllowTypeChange>,
    ) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
        mapped(py, "mil", &mil, |x, y| {
            let at = self.inner.mapping().to_sensor(PlateMil::new(x, y));
            [at.x, at.y]
        })
    }

    fn __repr__(&self) -> String {
        let (scale, rotation) = (self.scale_mil_per_px(), self.rotation_deg());
        format!(
            "Mapping({} of the {}, {scale:.4} mil/px, {rotation:.3} deg)",
            self.kind(),
            self.origin()
        )
    }
}

/// Maps positions along the last axis, which has length 2.
fn mapped<'py>(
    py: Python<'py>,
    argument: &str,
    positions: &PyArrayLikeDyn<'py, f64, AllowTypeChange>,
    map: impl Fn(f64, f64) -> [f64; 2],
) -> PyResult<Bound<'py, PyArrayDyn<f64>>> {
    let shape = positions.shape().to_vec();
    if shape.last() != Some(&2) {
        let problem =
            format!("expected positions (x, y) along the last axis, found shape {shape:?}");
        return Err(value_error(argument, problem));
    }
    let numbers: Vec<f64> = positions.as_array().iter().copied().collect();
    let mapped = numbers
        .as_chunks::<2>()
        .0
        .iter()
        .flat_map(|[x, y]| map(*x, *y));
    PyArray1::from_vec(py, mapped.collect()).reshape(shape)
}
