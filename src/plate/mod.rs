//! The printed pattern: 15 x 15 crosses whose spacings are a code.
//!
//! With f(n) = 45 n + 3 n (n - 1) for n >= 0 and 48 n - 3 n (n + 1) for n < 0, mark (i, j) is printed at
//! X = 6 (f(i) - 15 j), Y = 6 (f(j) + 15 i), mil from the plate's centre (HEROES flight program, 2013; the
//! idea in Cramer 2014, section 2.4 and figure 4). A step in i is a fixed 90 mil along Y and a spacing along X
//! that occurs once in the pattern; a step in j is 90 mil along -X and a coded spacing along Y.

use crate::units::PlateMil;
use serde::{Deserialize, Serialize};
use std::fmt;

/// The largest |i| and |j| of a mark.
pub const MAX_INDEX: i32 = 7;
/// Marks in a row or column.
const SIDE: i32 = 2 * MAX_INDEX + 1;
/// Marks of the whole pattern.
pub const MARKS: usize = (SIDE * SIDE) as usize;

/// The fixed part of a step between neighbours, mil.
pub const FIXED_SPACING_MIL: f64 = 90.0;

/// The name of a mark: its place in the pattern, each index from -7 to 7.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub struct MarkId {
    pub i: i32,
    pub j: i32,
}

impl MarkId {
    /// The id, where both indices lie in the pattern.
    pub fn new(i: i32, j: i32) -> Option<Self> {
        let range = -MAX_INDEX..=MAX_INDEX;
        (range.contains(&i) && range.contains(&j)).then_some(Self { i, j })
    }

    /// Every mark of the pattern.
    pub fn all() -> impl Iterator<Item = Self> {
        let range = -MAX_INDEX..=MAX_INDEX;
        range
            .clone()
            .flat_map(move |i| range.clone().map(move |j| Self { i, j }))
    }

    fn index(self) -> usize {
        ((self.i + MAX_INDEX) * SIDE + self.j + MAX_INDEX) as usize
    }

    fn of_index(index: usize) -> Self {
        let index = index as i32;
        Self {
            i: index / SIDE - MAX_INDEX,
            j: index % SIDE - MAX_INDEX,
        }
    }
}

impl fmt::Display for MarkId {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "({}, {})", self.i, self.j)
    }
}

/// The coded coordinate of index n, in units of 6 mil.
fn code(n: i32) -> f64 {
    let value = if n >= 0 {
        45 * n + 3 * n * (n - 1)
    } else {
        48 * n - 3 * n * (n + 1)
    };
    f64::from(value)
}

/// The coded spacing from index n to n + 1, mil: 270, 306, ... 486 upwards from n = 0 and 288, 324, ... 504
/// downwards from n = -1. Each occurs once.
pub fn coded_spacing_mil(n: i32) -> f64 {
    6.0 * (code(n + 1) - code(n))
}

/// Where the drawing puts a mark.
pub fn drawn_position(id: MarkId) -> PlateMil {
    PlateMil::new(
        6.0 * (code(id.i) - 15.0 * f64::from(id.j)),
        6.0 * (code(id.j) + 15.0 * f64::from(id.i)),
    )
}

/// The cross that is printed at every mark: two arms, dark on white.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Cross {
    /// Tip to tip.
    pub arm_length_mil: f64,
    pub arm_width_mil: f64,
}

/// A plate: where every mark is, and how well that is known.
#[derive(Debug, Clone, PartialEq)]
pub struct Plate {
    pub cross: Cross,
    drawing_sigma_mil: f64,
    positions: Vec<PlateMil>,
    sigmas_mil: Vec<[f64; 2]>,
    /// Variance of the best known mark's position, per axis.
    least_variance_mil2: f64,
}

impl Plate {
    /// The plate as drawn, every mark within `sigma_mil` (1 sigma per axis) of its drawn position.
    pub fn drawn(cross: Cross, sigma_mil: f64) -> Self {
        Self {
            cross,
            drawing_sigma_mil: sigma_mil,
            positions: MarkId::all().map(drawn_position).collect(),
            sigmas_mil: MarkId::all().map(|_| [sigma_mil; 2]).collect(),
            least_variance_mil2: variance(&[sigma_mil; 2]),
        }
    }

    /// How well the drawing is known to be printed: 1 sigma per axis of marks that were not measured, mil.
    pub fn drawing_sigma_mil(&self) -> f64 {
        self.drawing_sigma_mil
    }

    /// Replaces a mark's drawn position by a measured one.
    pub fn set(&mut self, id: MarkId, position: PlateMil, sigma_mil: [f64; 2]) {
        self.positions[id.index()] = position;
        self.sigmas_mil[id.index()] = sigma_mil;
        let variances = self.sigmas_mil.iter().map(variance);
        self.least_variance_mil2 = variances.fold(f64::INFINITY, f64::min);
    }

    pub fn position(&self, id: MarkId) -> PlateMil {
        self.positions[id.index()]
    }

    /// 1 sigma of a mark's position, mil.
    pub fn sigma_mil(&self, id: MarkId) -> [f64; 2] {
        self.sigmas_mil[id.index()]
    }

    /// Whether a mark was measured: it is not where the drawing has it, or known otherwise than the drawing.
    pub fn is_measured(&self, id: MarkId) -> bool {
        self.position(id) != drawn_position(id) || self.sigma_mil(id) != [self.drawing_sigma_mil; 2]
    }

    /// The plate as it was drawn, nothing of it measured.
    pub fn as_drawn(&self) -> Self {
        Self::drawn(self.cross, self.drawing_sigma_mil)
    }

    /// By how much the variance of a mark's position exceeds that of the plate's best known mark, mil^2 per axis: nothing on
    /// a plate of which all marks are known alike.
    pub fn excess_variance_mil2(&self, id: MarkId) -> f64 {
        variance(&self.sigma_mil(id)) - self.least_variance_mil2
    }

    /// The mark nearest to a position, and its distance in mil.
    pub fn nearest(&self, at: PlateMil) -> Option<(MarkId, f64)> {
        self.marks()
            .map(|(id, position)| (id, position.distance(at)))
            .min_by(|a, b| a.1.total_cmp(&b.1))
    }

    /// Every mark with its position.
    pub fn marks(&self) -> impl Iterator<Item = (MarkId, PlateMil)> + '_ {
        MarkId::all().map(|id| (id, self.position(id)))
    }

    /// The marks in the square that reaches so far about a position, in the order of all.
    pub fn marks_about(
        &self,
        at: PlateMil,
        reach_mil: f64,
    ) -> impl Iterator<Item = (MarkId, PlateMil)> + '_ {
        let about =
            move |p: &PlateMil| (p.x - at.x).abs() < reach_mil && (p.y - at.y).abs() < reach_mil;
        let found = self.positions.iter().enumerate();
        found
            .filter(move |(_, position)| about(position))
            .map(|(n, position)| (MarkId::of_index(n), *position))
    }
}

/// Mean of both axes.
fn variance([x, y]: &[f64; 2]) -> f64 {
    (x * x + y * y) / 2.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_coded_spacing_occurs_once() {
        let mut spacings: Vec<f64> = (-MAX_INDEX..MAX_INDEX).map(coded_spacing_mil).collect();
        spacings.sort_by(f64::total_cmp);
        let expected: Vec<f64> = (0..14).map(|k| 270.0 + 18.0 * f64::from(k)).collect();
        assert_eq!(spacings, expected);
    }

    #[test]
    fn steps_are_fixed_in_one_axis_and_coded_in_the_other() {
        for id in MarkId::all() {
            let here = drawn_position(id);
            if let Some(next) = MarkId::new(id.i + 1, id.j) {
                let step = drawn_position(next).vector() - here.vector();
                assert_eq!(
                    (step.x, step.y),
                    (coded_spacing_mil(id.i), FIXED_SPACING_MIL)
                );
            }
            if let Some(next) = MarkId::new(id.i, id.j + 1) {
                let step = drawn_position(next).vector() - here.vector();
                assert_eq!(
                    (step.x, step.y),
                    (-FIXED_SPACING_MIL, coded_spacing_mil(id.j))
                );
            }
        }
    }

    #[test]
    fn the_pattern_begins_as_printed() {
        assert_eq!(
            drawn_position(MarkId { i: 0, j: 0 }),
            PlateMil::new(0.0, 0.0)
        );
        assert_eq!(
            drawn_position(MarkId { i: 1, j: 0 }),
            PlateMil::new(270.0, 90.0)
        );
        assert_eq!(
            drawn_position(MarkId { i: -1, j: 2 }),
            PlateMil::new(-468.0, 486.0)
        );
    }

    #[test]
    fn marks_about_a_place_are_those_of_the_square_about_it() {
        let plate = Plate::drawn(
            Cross {
                arm_length_mil: 100.0,
                arm_width_mil: 10.0,
            },
            0.2,
        );
        let at = PlateMil::new(300.0, -500.0);
        let within = |p: &PlateMil| (p.x - at.x).abs() < 700.0 && (p.y - at.y).abs() < 700.0;
        let expected: Vec<_> = plate.marks().filter(|(_, p)| within(p)).collect();
        assert!(expected.len() > 9);
        assert_eq!(plate.marks_about(at, 700.0).collect::<Vec<_>>(), expected);
    }
}
