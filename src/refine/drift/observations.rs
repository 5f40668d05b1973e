//! The moments of a flight and the marks observed then.

use crate::refine::record::symmetric;
use crate::units::PlateMil;
use nalgebra::{Matrix2, Vector2};
use std::ops::Range;

/// A mark observed in a frame, for the flight's mapping.
#[derive(Debug, Clone, Copy)]
pub struct MarkObservation {
    /// Position on the ideal sensor, px.
    pub seen: Vector2<f64>,
    /// Where the mark is on the plate.
    pub printed: PlateMil,
    /// Inverse covariance, px^-2: xx, xy, yy. There are many of these.
    pub information: [f32; 3],
    /// 0 to 1.
    pub weight: f32,
}

impl MarkObservation {
    pub fn information(&self) -> Matrix2<f64> {
        symmetric(self.information.map(f64::from))
    }
}

/// The moments of the flight, and the marks observed then. All marks lie in one allocation, so that their memory is given back.
#[derive(Debug, Clone)]
pub struct Observations {
    marks: Vec<MarkObservation>,
    moments: Vec<Moment>,
}

#[derive(Debug, Clone)]
struct Moment {
    /// Since the first moment.
    time_s: f64,
    /// Its marks lie between the end of the moment before and this.
    end: u32,
}

impl Observations {
    /// The marks moment by moment, and each moment with its time in s and the end of its marks among all.
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

    /// From the moment before to a moment; 0 where there is none before, or where time goes back.
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

    /// Whether any mark of a moment counts.
    pub fn counts(&self, moment: usize) -> bool {
        self.at(moment).iter().any(|mark| mark.weight > 0.0)
    }
}
