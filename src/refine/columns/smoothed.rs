//! The columns of the smoothed path.

use super::{Cell, ColumnRow, column};
use crate::refine::flight::Flight;
use crate::refine::follow::is_known;

/// The extension that holds the smoothed path: at every frame that has a time, and half-way between two.
pub const SMOOTHED: &str = "SMOOTHED";

/// A moment of the smoothed path.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SmoothedRow {
    pub unix_s: f64,
    /// Place, 1 sigma, speed; none where the gap between frames is too long to say.
    pub point: Option<[[f64; 2]; 3]>,
}

fn smoothed(row: &SmoothedRow, what: usize, axis: usize) -> Cell {
    Cell::Float(row.point.map(|point| point[what][axis]))
}

/// The columns of [`SMOOTHED`].
pub const SMOOTHED_COLUMNS: &[ColumnRow<SmoothedRow>] = &[
    column("UNIX_S", "s", "time, UTC, since 1970-01-01", |r| {
        Cell::Float(Some(r.unix_s))
    }),
    column(
        "SUN_X_MIL",
        "mil",
        "the Sun's centre on the plate, smoothed",
        |r| smoothed(r, 0, 0),
    ),
    column(
        "SUN_Y_MIL",
        "mil",
        "the Sun's centre on the plate, smoothed",
        |r| smoothed(r, 0, 1),
    ),
    column("SIGMA_X_MIL", "mil", "1 sigma of SUN_X_MIL", |r| {
        smoothed(r, 1, 0)
    }),
    column("SIGMA_Y_MIL", "mil", "1 sigma of SUN_Y_MIL", |r| {
        smoothed(r, 1, 1)
    }),
    column("SPEED_X_MIL_PER_S", "mil/s", "how fast it moves", |r| {
        smoothed(r, 2, 0)
    }),
    column("SPEED_Y_MIL_PER_S", "mil/s", "how fast it moves", |r| {
        smoothed(r, 2, 1)
    }),
];

impl Flight {
    /// The smoothed path as rows.
    pub fn smoothed_rows(&self) -> Vec<SmoothedRow> {
        let points = self.path.iter().flat_map(|path| &path.points);
        points
            .zip(&self.path_times_s)
            .map(|(point, unix_s)| {
                let told = [point.place, point.variance.map(f64::sqrt), point.speed];
                SmoothedRow {
                    unix_s: *unix_s,
                    point: is_known(point).then_some(told),
                }
            })
            .collect()
    }
}
