//! The moments of a flight and the marks observed then.

use crate::refine::record::symmetric;
use crate::units::PlateMil;
use nalgebra::{Matrix2, Vector2};
use std::ops::Range;

/// A mark observed in a frame, for the flight's mapping.
#[derive(Debug, Clone, Copy)]
pub struct MarkObservation {
    /// Position on the ideal sensor, px.
    pub observed: Vector2<f64>,
    /// Position of the mark on the plate.
    pub printed: PlateMil,
    /// Inverse covariance, px^-2: xx, xy, yy. In single precision to save memory.
    pub information: [f32; 3],
    /// Robust weight, 0 to 1.
    pub weight: f32,
}

impl MarkObservation {
    pub fn information(&self) -> Matrix2<f64> {
        symmetric(self.information.map(f64::from))
    }
}

/// The moments of the flight, and the marks observed then. All marks share one allocation, so that their memory is released.
#[derive(Debug, Clone)]
pub struct Observations {
    marks: Vec<MarkObservation>,
    moments: Vec<Moment>,
}

#[derive(Debug, Clone)]
struct Moment {
    /// Time since the first moment, s.
    time_s: f64,
    /// End of its marks; they begin at the end of the previous moment's.
    end: u32,
}

impl Observations {
    /// Takes the marks moment by moment, and each moment's time in s with the end of its marks.
    pub fn new(marks: Vec<MarkObservation>, moments: impl Iterator<Item = (f64, u32)>) -> Self {
        let moment = |(time_s, end)| Moment { time_s, end };
        Self {
            marks,
            moments: moments.map(moment).collect(),
        }
    }

    pub fn len(&self) -> usize {
        self.moments.len()
    }

    /// Time from the previous moment, s; 0 for the first one, or where time goes back.
    pub fn step_s(&self, moment: usize) -> f64 {
        let time_s = |moment: usize| self.moments[moment].time_s;
        (time_s(moment) - time_s(moment.saturating_sub(1))).max(0.0)
    }

    /// The marks of a moment.
    pub fn at(&self, moment: usize) -> &[MarkObservation] {
        &self.marks[self.range(moment)]
    }

    pub fn at_mut(&mut self, moment: usize) -> &mut [MarkObservation] {
        let range = self.range(moment);
        &mut self.marks[range]
    }

    fn range(&self, moment: usize) -> Range<usize> {
        let end = |moment: usize| self.moments[moment].end as usize;
        moment.checked_sub(1).map_or(0, end)..end(moment)
    }

    /// Whether any mark of a moment has weight.
    pub fn counts(&self, moment: usize) -> bool {
        self.at(moment).iter().any(|mark| mark.weight > 0.0)
    }
}
