//! The moments of a flight and the marks that were read then.

use crate::refine::record::symmetric;
use crate::units::PlateMil;
use nalgebra::{Matrix2, Vector2};
use std::ops::Range;

/// A mark as the flight's mapping takes it.
#[derive(Debug, Clone, Copy)]
pub struct Sight {
    /// On the ideal sensor.
    pub seen: Vector2<f64>,
    pub printed: PlateMil,
    /// Inverse covariance, px^-2: xx, xy, yy. There are many of these.
    pub information: [f32; 3],
    /// What it counts, 0 to 1.
    pub weight: f32,
}

impl Sight {
    pub fn information(&self) -> Matrix2<f64> {
        symmetric(self.information.map(f64::from))
    }
}

/// The moments of the flight, and the marks that were read then. All marks lie in one piece, which is given back in one.
#[derive(Debug, Clone, Default)]
pub struct Sightings {
    sights: Vec<Sight>,
    moments: Vec<Moment>,
}

#[derive(Debug, Clone)]
struct Moment {
    /// Since the first moment.
    time_s: f64,
    marks: Range<usize>,
}

impl Sightings {
    /// `marks` are which of the sights belong to each of the moments, which are in order.
    pub fn new(sights: Vec<Sight>, moments: impl Iterator<Item = (f64, Range<usize>)>) -> Self {
        let moment = |(time_s, marks)| Moment { time_s, marks };
        Self {
            sights,
            moments: moments.map(moment).collect(),
        }
    }

    pub fn len(&self) -> usize {
        self.moments.len()
    }

    pub fn times_s(&self) -> Vec<f64> {
        self.moments.iter().map(|moment| moment.time_s).collect()
    }

    /// From the moment before to a moment; 0 where there is none before, or where time goes back.
    pub fn step_s(&self, moment: usize) -> f64 {
        let time_s = |moment: usize| self.moments[moment].time_s;
        (time_s(moment) - time_s(moment.saturating_sub(1))).max(0.0)
    }

    /// The marks of a moment.
    pub fn at(&self, moment: usize) -> &[Sight] {
        &self.sights[self.moments[moment].marks.clone()]
    }

    pub fn at_mut(&mut self, moment: usize) -> &mut [Sight] {
        &mut self.sights[self.moments[moment].marks.clone()]
    }

    /// Whether any mark of a moment counts.
    pub fn counts(&self, moment: usize) -> bool {
        self.at(moment).iter().any(|sight| sight.weight > 0.0)
    }
}
