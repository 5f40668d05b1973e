//! A photon's position on the Sun, with its uncertainty.

use super::detectors::{Detector, Detectors, FromBoresight};
use super::times::TimeSystem;
use crate::columns::{Column, float, logical};
use crate::fits::{AmendedTable, DiskHdu, FileError, NumberColumn, Problem};
use crate::pointing::HelioprojectiveArcsec;
use crate::pointing_history::{LineOfSight, PointingHistory};
use nalgebra::{Matrix2x3, Matrix3, UnitVector3, Vector3};

/// Greatest distance of a photon from the boresight: tangent of 45 deg.
const FARTHEST: f64 = 1.0;

/// Result for a photon.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Photon {
    /// UTC, s since 1970.
    pub unix_s: Option<f64>,
    /// `None` if time, position or pointing is unknown.
    pub place: Option<Place>,
    /// The reason why the position is invalid; `None` if it is valid.
    pub invalid: Option<&'static str>,
}

/// Position of a photon's origin, with 1 sigma per axis.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Place {
    pub helioprojective_arcsec: HelioprojectiveArcsec,
    /// 1 sigma from the random part of the pointing.
    pub sigma_arcsec: f64,
    /// 1 sigma from the calibration, and from the stated mounting of the detector.
    pub systematic_arcsec: f64,
}

fn place(photon: &Photon, value: fn(&Place) -> f64) -> Option<f64> {
    photon.place.as_ref().map(value)
}

/// The columns that are added to the photons' table.
#[rustfmt::skip]
pub const PHOTON_COLUMNS: &[Column<Photon>] = &[
    float("HPX", "arcsec", "helioprojective longitude, to solar west", |p| place(p, |at| at.helioprojective_arcsec.x)),
    float("HPY", "arcsec", "helioprojective latitude, to solar north", |p| place(p, |at| at.helioprojective_arcsec.y)),
    float("HP_SIGMA", "arcsec", "1 sigma per axis of the pointing, random part", |p| place(p, |at| at.sigma_arcsec)),
    float("HP_SYS", "arcsec", "1 sigma per axis of calibration and detector", |p| place(p, |at| at.systematic_arcsec)),
    logical("HP_VALID", "whether the place may be used", |p| p.invalid.is_none()),
];

/// The columns of a table with the times and positions of photons.
pub struct Measured {
    time: NumberColumn,
    x: NumberColumn,
    y: NumberColumn,
    id: Option<NumberColumn>,
    energy: Option<NumberColumn>,
    times: TimeSystem,
}

/// A photon's row; NaN for missing values.
pub struct PhotonRow {
    time: f64,
    /// Position measured by the detector.
    pub position: [f64; 2],
    id: Option<f64>,
    /// Energy in the unit of its column, if selected.
    pub energy: Option<f64>,
}

impl Measured {
    /// The columns of a table; that of the energy if selected.
    ///
    /// # Errors
    /// If the table has no such column.
    pub fn of(
        hdu: &DiskHdu,
        detectors: &Detectors,
        energy: Option<&str>,
        times: TimeSystem,
    ) -> Result<Self, Problem> {
        let names = &detectors.columns;
        let time = hdu.column(&names.time)?;
        Ok(Self {
            times: times.in_unit(&format!("unit of {}", time.name), time.unit.as_deref())?,
            time,
            x: hdu.column(&names.x)?,
            y: hdu.column(&names.y)?,
            id: names.id.as_deref().map(|id| hdu.column(id)).transpose()?,
            energy: energy.map(|energy| hdu.column(energy)).transpose()?,
        })
    }

    /// Range of positions from TLMINn and TLMAXn; for integers, to the edges of the first and the last pixel.
    ///
    /// # Errors
    /// If the values are not numbers.
    pub fn stated_field(&self, hdu: &DiskHdu) -> Result<Option<[[f64; 2]; 2]>, Problem> {
        let range = |column: &NumberColumn| {
            let number = |keyword: &str| hdu.header.number(&format!("{keyword}{}", column.number));
            let ends = number("TLMIN")?.zip(number("TLMAX")?);
            let half = match column.is_whole {
                true => number("TSCAL")?.unwrap_or(1.0).abs() / 2.0,
                false => 0.0,
            };
            Ok(ends.map(|(low, high)| [low - half, high + half]))
        };
        let (x, y) = (range(&self.x)?, range(&self.y)?);
        Ok(x.zip(y).map(|(x, y)| [x, y]))
    }

    /// Reads photons of a number of rows, from a first one on.
    ///
    /// # Errors
    /// If the table cannot be read.
    pub fn read(
        &self,
        table: &mut AmendedTable,
        first: u64,
        count: usize,
    ) -> Result<impl Iterator<Item = PhotonRow> + use<>, FileError> {
        let mut numbers = |column: &NumberColumn| {
            let mut numbers = vec![0.0; count];
            let read = table.read(column, first, &mut numbers);
            read.map(|()| numbers)
        };
        let (times, x, y) = (numbers(&self.time)?, numbers(&self.x)?, numbers(&self.y)?);
        let ids = self.id.as_ref().map(&mut numbers).transpose()?;
        let energies = self.energy.as_ref().map(numbers).transpose()?;
        let known = |column: &Option<Vec<f64>>, n: usize| {
            column
                .as_ref()
                .map(|numbers| numbers[n])
                .filter(|number| !number.is_nan())
        };
        let row = move |n: usize| PhotonRow {
            time: times[n],
            position: [x[n], y[n]],
            id: known(&ids, n),
            energy: known(&energies, n),
        };
        Ok((0..count).map(row))
    }

    /// Determines the position of a row's photon on the Sun, and the index of its detector in DET.toml.
    ///
    /// # Errors
    /// If no detector has the id.
    pub fn place(
        &self,
        row: &PhotonRow,
        detectors: &Detectors,
        history: &PointingHistory,
    ) -> Result<(Photon, usize), Problem> {
        let known = detectors.of_id(row.id);
        let (number, detector) = known.ok_or_else(|| self.unknown(row.id, detectors))?;
        Ok((self.placed(row, detector, history), number))
    }

    fn placed(&self, row: &PhotonRow, detector: &Detector, history: &PointingHistory) -> Photon {
        let located = detector.locate(row.position.into());
        let time = Some(row.time).filter(|time| time.is_finite());
        let unix_s = time.and_then(|time| self.times.unix_s(time));
        let Some(at) = unix_s else {
            return Photon {
                unix_s,
                place: None,
                invalid: Some("no time"),
            };
        };
        let pointed = history.at(at);
        let place = pointed
            .line_of_sight
            .and_then(|line_of_sight| on_the_sun(&line_of_sight, &located));
        let invalid = match (pointed.invalid, place) {
            (Some(why), _) => Some(why.name()),
            (None, None) => Some("no position"),
            (None, Some(_)) => None,
        };
        Photon {
            unix_s,
            place,
            invalid,
        }
    }

    fn unknown(&self, id: Option<f64>, detectors: &Detectors) -> Problem {
        let column = self.id.as_ref().map_or("", |column| &column.name);
        let expected = format!("the id of a detector ({})", detectors.ids());
        let found = id.map_or("none".into(), |id| id.to_string());
        Problem::field(format!("column {column}"), expected, found)
    }
}

/// The position of a photon; `None` if its measured position is not a number, or is further from the boresight than [`FARTHEST`].
fn on_the_sun(line_of_sight: &LineOfSight, located: &FromBoresight) -> Option<Place> {
    let FromBoresight {
        right_rad,
        up_rad,
        variance_arcsec2,
    } = *located;
    // NaN is outside the range.
    let distance = Some(right_rad.hypot(up_rad));
    distance.filter(|distance| (0.0..=FARTHEST).contains(distance))?;
    let towards = UnitVector3::new_normalize(Vector3::new(1.0, right_rad, -up_rad));
    let variance = |covariance: &Matrix3<f64>| per_axis(covariance, right_rad, up_rad);
    Some(Place {
        helioprojective_arcsec: line_of_sight.helioprojective(&towards),
        sigma_arcsec: variance(&line_of_sight.random_arcsec2).sqrt(),
        systematic_arcsec: (variance(&line_of_sight.systematic_arcsec2) + variance_arcsec2).sqrt(),
    })
}

/// The variance of a direction, mean of its two axes: small rotations move it with the boresight, and about that.
fn per_axis(covariance: &Matrix3<f64>, right: f64, up: f64) -> f64 {
    let moved = Matrix2x3::new(1.0, 0.0, up, 0.0, 1.0, -right);
    (moved * covariance * moved.transpose()).trace() / 2.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::columns::markdown;

    #[test]
    fn the_page_has_these_columns() {
        let page = include_str!("../../docs/events.md");
        assert!(
            page.contains(&markdown(PHOTON_COLUMNS)),
            "{}",
            markdown(PHOTON_COLUMNS)
        );
    }
}
