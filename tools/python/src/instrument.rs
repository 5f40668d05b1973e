//! The instrument.

use crate::arguments;
use crate::errors::Failure;
use crate::numbers::{as_json, pair, pairs, rows};
use numpy::{PyArray1, PyArray2};
use pyo3::prelude::*;
use pyo3::sync::PyOnceLock;
use solaspect::{calibrate, instrument};
use std::path::PathBuf;

/// Camera, plate, optics and mounting, read from a TOML file and checked.
#[pyclass(frozen, module = "solaspect")]
pub struct Instrument {
    pub inner: instrument::Instrument,
    /// The path of its file, or the name of the built-in one.
    #[pyo3(get)]
    path: PathBuf,
}

impl Instrument {
    /// The built-in "demo", read once.
    pub fn demo(py: Python<'_>) -> PyResult<Bound<'_, Self>> {
        static DEMO: PyOnceLock<Py<Instrument>> = PyOnceLock::new();
        let demo = DEMO.get_or_try_init(py, || Py::new(py, Self::load("demo".into())?))?;
        Ok(demo.bind(py).clone())
    }
}

#[pymethods]
impl Instrument {
    /// Read the file, or the built-in instrument of that name where there is no such file.
    #[staticmethod]
    pub fn load(path: PathBuf) -> PyResult<Self> {
        let inner = instrument::Instrument::read(&path).map_err(Failure::from)?;
        Ok(Self { inner, path })
    }

    /// Names of the built-in instruments.
    #[staticmethod]
    fn builtin_names() -> Vec<&'static str> {
        instrument::builtin_names()
    }

    /// Its name.
    #[getter]
    fn name(&self) -> &str {
        &self.inner.name
    }

    /// Rows and columns, as an array's shape.
    #[getter]
    fn shape(&self) -> (usize, usize) {
        (self.inner.camera.height_px, self.inner.camera.width_px)
    }

    /// Bits of a pixel as the camera digitises it.
    #[getter]
    fn bits(&self) -> u32 {
        self.inner.camera.bits
    }

    /// Stated plate length per pixel, mil/px.
    #[getter]
    fn scale_mil_per_px(&self) -> f64 {
        self.inner.mounting.scale_mil_per_px.value
    }

    /// Plate scale at the optical axis, arcsec/mil.
    #[getter]
    fn arcsec_per_mil(&self) -> f64 {
        self.inner.optics.arcsec_per_mil()
    }

    /// Distance from the lens to the plate, mm.
    #[getter]
    fn plate_distance_mm(&self) -> f64 {
        self.inner.optics.plate_distance_mm.value
    }

    /// Wavelength of the band-pass filter, nm.
    #[getter]
    fn wavelength_nm(&self) -> f64 {
        self.inner.optics.wavelength_nm
    }

    /// Angle of the plate's +Y from the direction to the zenith, deg.
    #[getter]
    fn clocking_deg(&self) -> f64 {
        self.inner.mounting.clocking_deg.value
    }

    /// Sun-image position on the plate for zero pointing error, mil.
    #[getter]
    fn boresight_mil<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        let at = self.inner.mounting.boresight_mil;
        pair(py, [at.x, at.y])
    }

    /// Ids of all marks of the plate, (n, 2).
    #[getter]
    fn mark_ids<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<i32>>> {
        let ids = self.inner.plate.marks().flat_map(|(id, _)| [id.i, id.j]);
        rows(py, ids.collect(), 2)
    }

    /// Their positions on the plate, (n, 2), mil.
    #[getter]
    fn marks_mil<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        pairs(py, self.inner.plate.marks().map(|(_, at)| [at.x, at.y]))
    }

    fn __repr__(&self) -> String {
        let (camera, scale) = (&self.inner.camera, self.scale_mil_per_px());
        format!(
            "Instrument(\"{}\", {} x {} px, {scale} mil/px, {:.4} arcsec/mil)",
            self.inner.name,
            camera.width_px,
            camera.height_px,
            self.arcsec_per_mil()
        )
    }
}

/// An `Instrument` of whatever stands for one.
#[pyfunction]
pub fn load<'py>(given: &Bound<'py, PyAny>) -> PyResult<Bound<'py, Instrument>> {
    arguments::instrument(given.py(), Some(given))
}

#[pyfunction]
pub fn compare<'py>(
    py: Python<'py>,
    before: &Bound<'py, PyAny>,
    after: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyAny>> {
    let [before, after] = [before, after].map(|given| arguments::instrument(py, Some(given)));
    let comparison = calibrate::compare::compare(&before?.get().inner, &after?.get().inner);
    as_json(py, &comparison)
}
