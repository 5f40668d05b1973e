//! Frames of random scenes with the truth about them.

use crate::errors::Failure;
use crate::numbers::{datetime, pair, pairs, rows};
use crate::program::parse;
use jiff::Timestamp;
use numpy::{PyArray1, PyArray2};
use pyo3::prelude::*;
use pyo3::types::PyDateTime;
use solaspect::cli::simulate::SimulateArgs;
use solaspect::frame::Pixels;
use solaspect::simulate::{Picture, Truth, TruthOfSun};

#[derive(clap::Parser)]
struct Command {
    #[command(flatten)]
    simulate: SimulateArgs,
}

/// Frames by the options of `solaspect simulate`.
#[pyfunction]
pub fn simulate(py: Python<'_>, options: Vec<String>) -> PyResult<Vec<SimulatedFrame>> {
    let command: Command = parse(options)?;
    let pictures = py.detach(|| {
        let mut scenes = command.simulate.scenes()?;
        let pictures = command.simulate.pictures(&mut scenes);
        pictures.collect::<anyhow::Result<Vec<Picture>>>()
    });
    let pictures = pictures.map_err(Failure::from)?;
    pictures
        .into_iter()
        .map(|picture| SimulatedFrame::new(py, &picture))
        .collect()
}

/// A frame of a simulated scene, and the truth about it.
#[pyclass(frozen, module = "solaspect")]
pub struct SimulatedFrame {
    array: Py<PyAny>,
    utc: Option<Timestamp>,
    saturation_dn: u16,
    truth: Truth,
}

impl SimulatedFrame {
    fn new(py: Python<'_>, picture: &Picture) -> PyResult<Self> {
        let frame = &picture.frame;
        let array = match frame.pixels() {
            Pixels::U8(pixels) => rows(py, pixels.clone(), frame.width())?.into_any(),
            Pixels::U16(pixels) => rows(py, pixels.clone(), frame.width())?.into_any(),
        };
        Ok(Self {
            array: array.unbind(),
            utc: frame.info.mid_exposure,
            saturation_dn: frame.saturation_dn(),
            truth: picture.truth.clone(),
        })
    }

    fn of_sun<T>(&self, of: impl FnOnce(&TruthOfSun) -> T) -> Option<T> {
        self.truth.sun.as_ref().map(of)
    }
}

#[pymethods]
impl SimulatedFrame {
    /// The pixels, rows by columns, uint8, or uint16 of 12 bits.
    #[getter]
    fn array(&self, py: Python<'_>) -> Py<PyAny> {
        self.array.clone_ref(py)
    }

    /// Mid-exposure, UTC.
    #[getter]
    fn time<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyDateTime>>> {
        self.utc.map(|utc| datetime(py, utc)).transpose()
    }

    /// The value at which a pixel saturates, DN.
    #[getter]
    fn saturation_dn(&self) -> u16 {
        self.saturation_dn
    }

    /// The image of the disc's centre, px; None without Sun.
    #[getter]
    fn sun_px<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray1<f64>>> {
        self.of_sun(|sun| pair(py, [sun.px.x, sun.px.y]))
    }

    /// The disc's centre on the plate, mil.
    #[getter]
    fn sun_plate_mil<'py>(&self, py: Python<'py>) -> Option<Bound<'py, PyArray1<f64>>> {
        self.of_sun(|sun| pair(py, [sun.plate.x, sun.plate.y]))
    }

    /// The disc's radius at the mapping's scale at its centre, px.
    #[getter]
    fn sun_radius_px(&self) -> Option<f64> {
        self.of_sun(|sun| sun.radius_px)
    }

    /// Ids of the marks that the Sun lights, wholly or in part, (n, 2).
    #[getter]
    fn mark_ids<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<i32>>> {
        let ids = self
            .truth
            .marks
            .iter()
            .flat_map(|mark| [mark.id.i, mark.id.j]);
        rows(py, ids.collect(), 2)
    }

    /// Their positions on the sensor, (n, 2), px.
    #[getter]
    fn marks_px<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyArray2<f64>>> {
        pairs(
            py,
            self.truth.marks.iter().map(|mark| [mark.px.x, mark.px.y]),
        )
    }

    fn __repr__(&self) -> String {
        let sun = self.of_sun(|sun| format!("Sun at ({:.3}, {:.3}) px", sun.px.x, sun.px.y));
        let time = self.utc.map_or(String::new(), |utc| format!(", {utc:.3}"));
        format!(
            "SimulatedFrame({}{time})",
            sun.as_deref().unwrap_or("no Sun")
        )
    }
}
