//! The columns of the table for stabilising images.

use super::{Cell, ColumnRow, column};
use crate::pointing::Offset;

/// The extension that holds the telescope's offset at a constant rate.
pub const STABILISATION: &str = "STABILISATION";

/// The telescope's offset at a moment between frames.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct StabilisationRow {
    pub unix_s: f64,
    /// None where the path, the place or the target is not known.
    pub offset: Option<Offset>,
}

fn offset(row: &StabilisationRow, value: impl Fn(&Offset) -> f64) -> Cell {
    Cell::Float(row.offset.as_ref().map(value))
}

/// The columns of [`STABILISATION`].
pub const STABILISATION_COLUMNS: &[ColumnRow<StabilisationRow>] = &[
    column("UNIX_S", "s", "time, UTC, since 1970-01-01", |r| {
        Cell::Float(Some(r.unix_s))
    }),
    column(
        "OFFSET_AZ_DEG",
        "deg",
        "azimuth, pointing minus target",
        |r| offset(r, |o| o.azimuth_deg),
    ),
    column(
        "OFFSET_EL_DEG",
        "deg",
        "elevation, pointing minus target",
        |r| offset(r, |o| o.elevation_deg),
    ),
    column(
        "OFFSET_XEL_DEG",
        "deg",
        "true angle across, pointing from target, to larger azimuth",
        |r| offset(r, |o| o.cross_elevation_deg),
    ),
    column(
        "VAR_XEL_DEG2",
        "deg2",
        "variance across, of the path and the roll",
        |r| offset(r, |o| o.covariance_deg2[(0, 0)]),
    ),
    column(
        "VAR_EL_DEG2",
        "deg2",
        "variance in elevation, of the path and the roll",
        |r| offset(r, |o| o.covariance_deg2[(1, 1)]),
    ),
    column(
        "COV_XEL_EL_DEG2",
        "deg2",
        "covariance of OFFSET_XEL_DEG and OFFSET_EL_DEG",
        |r| offset(r, |o| o.covariance_deg2[(0, 1)]),
    ),
    column("VALID", "", "1 where the offset is known, else 0", |r| {
        Cell::Integer(r.offset.is_some().into())
    }),
];
