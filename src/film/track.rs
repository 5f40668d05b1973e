//! The path of the boresight over the Sun, in equal steps.

use crate::pointing::HelioprojectiveArcsec;
use crate::pointing_history::{Invalid, PointingHistory};

/// Greatest time between two points of the path: a gondola swings within seconds.
const STEP_S: f64 = 0.25;

/// A moment of the path.
#[derive(Debug, Clone, Copy)]
pub struct Point {
    /// Time, s since 1970.
    pub unix_s: f64,
    /// Position of the boresight; `None` if it is not known.
    pub place: Option<HelioprojectiveArcsec>,
    /// The reason why the pointing is invalid; `None` if it is valid.
    pub invalid: Option<Invalid>,
}

/// The path, with the same number of points between successive pictures.
#[derive(Debug, Clone)]
pub struct Track {
    pub points: Vec<Point>,
    pub points_per_picture: usize,
}

impl Track {
    /// Track with a picture every `step_s` seconds from the first known time; `None` if the pointing is never known.
    pub fn of(pointing: &PointingHistory, step_s: f64) -> Option<Self> {
        let [first_s, last_s] = pointing.ends_s()?;
        // Frames' times are rounded: the last may seem slightly early.
        let steps = ((last_s - first_s) / step_s + 1e-3).floor() as usize;
        let points_per_picture = (step_s / STEP_S).ceil().max(1.0) as usize;
        let point = |n: usize| {
            let since_s = n as f64 * step_s / points_per_picture as f64;
            let unix_s = (first_s + since_s).min(last_s);
            let pointed = pointing.at(unix_s);
            Point {
                unix_s,
                place: pointed
                    .line_of_sight
                    .map(|line_of_sight| line_of_sight.helioprojective_arcsec),
                invalid: pointed.invalid,
            }
        };
        Some(Self {
            points: (0..=steps * points_per_picture).map(point).collect(),
            points_per_picture,
        })
    }

    pub fn pictures(&self) -> usize {
        self.points.len().div_ceil(self.points_per_picture)
    }

    /// The index in the path of a picture, counted from 0.
    pub fn at_picture(&self, picture: usize) -> usize {
        picture * self.points_per_picture
    }

    pub fn middle_s(&self) -> f64 {
        let last = self.points.len() - 1;
        (self.points[0].unix_s + self.points[last].unix_s) / 2.0
    }

    /// The positions of valid pointing.
    pub fn valid(&self) -> impl Iterator<Item = HelioprojectiveArcsec> {
        let valid = self.points.iter().filter(|point| point.invalid.is_none());
        valid.filter_map(|point| point.place)
    }
}
