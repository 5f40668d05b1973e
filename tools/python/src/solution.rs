//! Results of a frame, stage by stage. Positions are arrays of two numbers; results of stages not reached are `None`.

use crate::mapping::Mapping;
use crate::marks::{Detection, Mark};
use crate::numbers::{Pair, Pairs, as_json, datetime, matrix, pair, pairs};
use crate::offset::Offset;
use crate::pickled;
use jiff::Timestamp;
use numpy::PyArray1;
use pyo3::prelude::*;
use pyo3::types::{PyBytes, PyDateTime};
use serde::{Deserialize, Serialize};
use solaspect::aspect;
use solaspect::calibrate::check::Contradiction;
use solaspect::pointing;
use solaspect::record::Record;
use std::time::Duration;

/// Solution of a frame, stage by stage. Results of stages not reached are None, or have no rows.
#[pyclass(frozen, module = "solaspect")]
#[derive(Serialize, Deserialize)]
pub struct Solution {
    pub inner: aspect::Solution,
    pub utc: Option<Timestamp>,
    pub offset: Option<pointing::Offset>,
    pub contradictions: Vec<Contradiction>,
    pub solve_time: Duration,
}

impl Solution {
    fn of_aspect<T>(&self, of: impl FnOnce(&aspect::Aspect) -> T) -> Option<T> {
        self.inner.aspect.as_ref().map(of)
    }

    fn record(&self) -> Record {
        let time = Some(self.solve_time);
        Record::new("", self.utc, &self.inner, self.offset, time)
    }
}

#[pymethods]
impl Solution {
    /// A solution as `pickle` keeps it.
    #[new]
    fn of_pickled(bytes: &[u8]) -> PyResult<Self> {
        pickled::value(bytes)
    }

    fn __getnewargs__<'py>(&self, py: Python<'py>) -> PyResult<(Bound<'py, PyBytes>,)> {
        Ok((PyBytes::new(py, &pickled::bytes(self)?),))
    }

    /// "fine" (disc and mapping from this very frame), "coarse" (part of the disc, or a borrowed mapping) or "none".
    #[getter]
    fn quality(&self) -> &'static str {
        self.inner.quality.name()
    }

    /// Why the frame is not fine.
    #[getter]
    fn reason(&self) -> Option<Reason> {
        self.inner.stopped.map(|stopped| Reason {
            stage: stopped.stage.name(),
            code: stopped.rejected.reason.code,
            reason: stopped.rejected.reason.sentence,
            measured: stopped.rejected.measured,
            limit: stopped.rejected.limit,
        })
    }

    /// Mid-exposure, UTC, to the microsecond.
    #[getter]
    fn time<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyDateTime>>> {
        self.utc.map(|utc| datetime(py, utc)).transpose()
    }

    /// Brightness levels, DN.
    #[getter]
    fn levels(&self) -> Option<Levels> {
        self.inner.levels.map(|levels| Levels {
            background_dn: levels.background_dn,
            noise_dn: levels.noise_dn,
            disc_dn: levels.disc_dn,
        })
    }

    /// Points of the limb to which the disc is fitted, (n, 2), px.
    #[getter]
    fn limb_px<'py>(&self, py: Python<'py>) -> PyResult<Pairs<'py>> {
        pairs(py, self.inner.limb.iter().map(|p| [p.at.x, p.at.y]))
    }

    /// 1 sigma of the limb points across the limb, (n,), px.
    #[getter]
    fn limb_sigma_px<'py>(&self, py: Python<'py>) -> Pair<'py> {
        PyArray1::from_iter(py, self.inner.limb.iter().map(|point| point.sigma_px))
    }

    /// Blur of the limb, 1 sigma, px; pixel response removed in quadrature.
    #[getter]
    fn limb_blur_px(&self) -> Option<f64> {
        self.inner.limb_blur_px
    }

    /// Visible part of the limb, 0 to 1.
    #[getter]
    fn limb_fraction(&self) -> Option<f64> {
        self.of_aspect(|aspect| aspect.limb_fraction)
    }

    /// Marks that were found, identified or not; none where the prior predicted them.
    #[getter]
    fn detections(&self) -> Vec<Detection> {
        let marks = &self.inner.detections.marks;
        marks.iter().map(|&inner| Detection { inner }).collect()
    }

    /// Marks with their ids.
    #[getter]
    fn marks(&self) -> Vec<Mark> {
        let marks = &self.inner.marks;
        marks.iter().map(|&inner| Mark { inner }).collect()
    }

    /// The sensor-to-plate transformation.
    #[getter]
    fn mapping(&self) -> Option<Mapping> {
        let mapping = self.inner.mapping.clone().zip(self.inner.aspect);
        mapping.map(|(inner, aspect)| Mapping { inner, aspect })
    }

    /// The image of the disc's centre on the sensor, px.
    #[getter]
    fn sun_px<'py>(&self, py: Python<'py>) -> Option<Pair<'py>> {
        self.of_aspect(|a| pair(py, [a.sun_px.position.x, a.sun_px.position.y]))
    }

    /// 1 sigma of sun_px, px.
    #[getter]
    fn sun_px_sigma<'py>(&self, py: Python<'py>) -> Option<Pair<'py>> {
        self.of_aspect(|aspect| pair(py, aspect.sun_px.sigma()))
    }

    /// Covariance of sun_px, (2, 2), px^2.
    #[getter]
    fn sun_px_covariance<'py>(&self, py: Python<'py>) -> PyResult<Option<Pairs<'py>>> {
        self.of_aspect(|aspect| matrix(py, &aspect.sun_px.covariance))
            .transpose()
    }

    /// The disc's radius at the mapping's scale there, px.
    #[getter]
    fn sun_radius_px(&self) -> Option<f64> {
        self.of_aspect(|aspect| aspect.sun_radius_px.value)
    }

    /// 1 sigma of sun_radius_px, px.
    #[getter]
    fn sun_radius_px_sigma(&self) -> Option<f64> {
        self.of_aspect(|aspect| aspect.sun_radius_px.sigma)
    }

    /// The disc's centre on the plate, mil.
    #[getter]
    fn sun_plate_mil<'py>(&self, py: Python<'py>) -> Option<Pair<'py>> {
        self.of_aspect(|a| pair(py, [a.sun_plate.position.x, a.sun_plate.position.y]))
    }

    /// 1 sigma of sun_plate_mil, mil; the mapping's uncertainty included.
    #[getter]
    fn sun_plate_sigma_mil<'py>(&self, py: Python<'py>) -> Option<Pair<'py>> {
        self.of_aspect(|aspect| pair(py, aspect.sun_plate.sigma()))
    }

    /// Covariance of sun_plate_mil, (2, 2), mil^2.
    #[getter]
    fn sun_plate_covariance_mil2<'py>(&self, py: Python<'py>) -> PyResult<Option<Pairs<'py>>> {
        self.of_aspect(|aspect| matrix(py, &aspect.sun_plate.covariance))
            .transpose()
    }

    /// The telescope's offset from its target; None without time, place or Sun.
    #[getter]
    fn offset(&self) -> Option<Offset> {
        self.offset.map(|inner| Offset { inner })
    }

    /// Tracking prior for the next frame: `solve`'s `prior`.
    #[getter]
    fn track(&self) -> Option<Track> {
        self.inner.track.clone().map(|inner| Track { inner })
    }

    /// Values of the instrument's file that the frame contradicts by more than five sigma.
    #[getter]
    fn contradictions(&self) -> Vec<String> {
        self.contradictions
            .iter()
            .map(ToString::to_string)
            .collect()
    }

    /// Wall time of the solver alone, us.
    #[getter]
    fn solve_us(&self) -> u64 {
        self.solve_time.as_micros() as u64
    }

    /// The fields of a line of `solaspect solve --format jsonl`, without the file.
    fn to_dict<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let record = as_json(py, &self.record())?;
        record.del_item("file")?;
        Ok(record)
    }

    fn __repr__(&self) -> String {
        let mut parts = vec![self.quality().to_string()];
        if let Some(aspect) = &self.inner.aspect {
            let (px, mil) = (aspect.sun_px.position, aspect.sun_plate.position);
            let [sx, sy] = aspect.sun_plate.sigma();
            parts.push(format!("Sun at ({:.3}, {:.3}) px", px.x, px.y));
            parts.push(format!(
                "({:.2} +- {sx:.2}, {:.2} +- {sy:.2}) mil",
                mil.x, mil.y
            ));
            let count = self.inner.marks.len() as u64;
            parts.push(solaspect::units::counted(count, "mark"));
        }
        if let Some(mapping) = &self.inner.mapping {
            parts.push(mapping.name().into());
        }
        if let Some(offset) = &self.offset {
            let (azimuth, elevation) = (offset.azimuth_deg, offset.elevation_deg);
            parts.push(format!("offset ({azimuth:+.4}, {elevation:+.4}) deg"));
        }
        parts.extend(self.inner.stopped.map(|stopped| stopped.to_string()));
        format!("Solution({})", parts.join(", "))
    }
}

/// Why processing stopped: stage, reason with its code, measured value and limit, in the unit of the tested quantity.
#[pyclass(frozen, get_all, module = "solaspect")]
pub struct Reason {
    stage: &'static str,
    code: &'static str,
    reason: &'static str,
    measured: f64,
    limit: f64,
}

#[pymethods]
impl Reason {
    fn __str__(&self) -> String {
        format!("{}: {}", self.stage, self.reason)
    }

    fn __repr__(&self) -> String {
        let (measured, limit) = (self.measured, self.limit);
        format!(
            "Reason(\"{}\", measured={measured}, limit={limit})",
            self.__str__()
        )
    }
}

/// Brightness levels of a frame, DN: background, 1 sigma of its noise, the bright part of the disc.
#[pyclass(frozen, get_all, module = "solaspect")]
pub struct Levels {
    background_dn: f64,
    noise_dn: f64,
    disc_dn: f64,
}

#[pymethods]
impl Levels {
    fn __repr__(&self) -> String {
        let (background, noise, disc) = (self.background_dn, self.noise_dn, self.disc_dn);
        format!("Levels(background {background:.2} DN, noise {noise:.2} DN, disc {disc:.2} DN)")
    }
}

/// Tracking prior from one frame for the next.
#[pyclass(frozen, module = "solaspect")]
pub struct Track {
    pub inner: aspect::Track,
}

#[pymethods]
impl Track {
    fn __repr__(&self) -> String {
        let disc = &self.inner.disc;
        let (x, y, radius) = (disc.centre.x, disc.centre.y, disc.radius);
        format!("Track(disc of {radius:.2} px at ({x:.2}, {y:.2}) px)")
    }
}
