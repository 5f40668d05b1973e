//! Slowly changing quantities, once a second: the balloon's position, the Sun as seen from there, and the uncertainty from the calibration.

use crate::geometry::earth::north_east_up;
use nalgebra::{Matrix3, UnitVector3, Vector3};

/// Quantities of a whole second.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Second {
    /// Time since 1970.
    pub unix_s: i64,
    /// Position in ECEF, the axes of the directions below.
    pub position_m: Vector3<f64>,
    pub to_sun: UnitVector3<f64>,
    /// Solar north, perpendicular to the direction to the Sun.
    pub north: UnitVector3<f64>,
    /// Covariance of the calibration: right, up and about the boresight.
    pub systematic_rad2: Matrix3<f64>,
}

/// The same at any moment, with axes as columns.
pub(super) struct Axes {
    /// North, east and up at the balloon.
    pub horizon: Matrix3<f64>,
    /// To the Sun, solar west, solar north.
    pub sun: Matrix3<f64>,
    pub systematic_rad2: Matrix3<f64>,
}

/// Seconds in the order of time; some may be missing.
#[derive(Debug, Clone)]
pub(super) struct Seconds {
    pub rows: Vec<Second>,
    /// Up at each second.
    up: Vec<Vector3<f64>>,
}

impl Seconds {
    pub fn new(rows: Vec<Second>) -> Self {
        let up = |second: &Second| north_east_up(&second.position_m).column(2).into();
        Self {
            up: rows.iter().map(up).collect(),
            rows,
        }
    }

    /// The row of the second that contains a time.
    pub fn row(&self, unix_s: f64) -> Option<&Second> {
        self.rows.get(self.index(unix_s)?)
    }

    fn index(&self, unix_s: f64) -> Option<usize> {
        let whole = unix_s.floor() as i64;
        let since_first = whole.checked_sub(self.rows.first()?.unix_s)?;
        let without_gaps = usize::try_from(since_first).ok()?;
        match self.rows.get(without_gaps) {
            Some(row) if row.unix_s == whole => Some(without_gaps),
            _ => self
                .rows
                .binary_search_by_key(&whole, |row| row.unix_s)
                .ok(),
        }
    }

    /// Interpolates linearly between two seconds, accurate to a thousandth of an arcsecond.
    pub fn at(&self, unix_s: f64) -> Option<Axes> {
        let before = self.index(unix_s)?;
        let from = &self.rows[before];
        let part = unix_s - from.unix_s as f64;
        let follows = |to: &&Second| to.unix_s == from.unix_s + 1;
        let (after, to) = match self.rows.get(before + 1).filter(follows) {
            Some(to) => (before + 1, to),
            None if part == 0.0 => (before, from),
            None => return None,
        };
        let mean = |from: &Vector3<f64>, to: &Vector3<f64>| from.lerp(to, part).normalize();
        let up = mean(&self.up[before], &self.up[after]);
        let east = Vector3::z().cross(&up).normalize();
        let to_sun = mean(&from.to_sun, &to.to_sun);
        let north = mean(&from.north, &to.north);
        let west = to_sun.cross(&north).normalize();
        Some(Axes {
            horizon: Matrix3::from_columns(&[up.cross(&east), east, up]),
            sun: Matrix3::from_columns(&[to_sun, west, west.cross(&to_sun)]),
            systematic_rad2: from.systematic_rad2 * (1.0 - part) + to.systematic_rad2 * part,
        })
    }
}
