//! The plate: drawn and printed positions of every mark, and the shape of a mark.
//!
//! A plate's drawing is the pattern of 2013 ([`heroes`]) or a list of marks ([`read_table`]). Measured positions are kept
//! beside the drawn ones.

pub mod artwork;
mod drawing;
pub mod heroes;
mod shape;
mod table;

pub use shape::{Cross, MarkShape};
pub use table::{TableError, read_table, table_text};

use crate::units::PlateMil;
use serde::{Deserialize, Serialize};
use std::fmt;

/// Maximum number of marks of a plate.
pub const MOST_MARKS: usize = 2000;
/// Minimum distance between two marks, in their size: nearer ones would look like one mark.
pub const LEAST_APART_SIZES: f64 = 2.0;
/// Maximum absolute value of each index of an id.
pub const MAX_INDEX: i32 = 9999;

/// The id of a mark. Ids of the plate of 2013 are positions in the pattern, others are those of the drawing; a plate with
/// numbered marks uses (n, 0).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub struct MarkId {
    pub i: i32,
    pub j: i32,
}

impl MarkId {
    /// The id, if both indices are within [`MAX_INDEX`].
    pub fn new(i: i32, j: i32) -> Option<Self> {
        let range = -MAX_INDEX..=MAX_INDEX;
        (range.contains(&i) && range.contains(&j)).then_some(Self { i, j })
    }
}

impl fmt::Display for MarkId {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "({}, {})", self.i, self.j)
    }
}

/// Source of a plate's drawing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Pattern {
    /// The coded pattern of 2013.
    Heroes,
    /// A table of marks in a file of its own.
    Table,
    /// The marks that the instrument's file lists.
    Listed,
}

/// Position of a mark on the plate, and its uncertainty.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MarkPlace {
    pub at: PlateMil,
    /// 1 sigma per axis.
    pub sigma_mil: [f64; 2],
}

impl MarkPlace {
    /// Position of a mark with the same sigma in both axes.
    pub fn new(at: PlateMil, sigma_mil: f64) -> Self {
        Self {
            at,
            sigma_mil: [sigma_mil; 2],
        }
    }

    /// Mean variance of both axes.
    pub fn variance_mil2(&self) -> f64 {
        let [x, y] = self.sigma_mil;
        (x * x + y * y) / 2.0
    }
}

/// A mark of a plate, as drawn and as known now.
#[derive(Debug, Clone, Copy, PartialEq)]
struct PlateMark {
    id: MarkId,
    drawn: MarkPlace,
    place: MarkPlace,
}

/// A plate: position and uncertainty of every mark.
#[derive(Debug, Clone, PartialEq)]
pub struct Plate {
    pub shape: MarkShape,
    /// The Sun's centre may be within this distance of the plate's centre.
    pub field_radius_mil: f64,
    pattern: Pattern,
    drawing_sigma_mil: f64,
    /// The marks, ordered by id.
    marks: Vec<PlateMark>,
    /// Variance of the best known mark's position, per axis.
    least_variance_mil2: f64,
}

impl Plate {
    /// The plate of 2013 as drawn, with every mark within `sigma_mil` (1 sigma per axis) of its drawn position.
    pub fn heroes(shape: MarkShape, sigma_mil: f64) -> Self {
        let place = |id| (id, MarkPlace::new(heroes::position(id), sigma_mil));
        Self::new(Pattern::Heroes, shape, sigma_mil, heroes::ids().map(place))
    }

    /// A plate of marks with unique ids; `sigma_mil` is the default for marks without a sigma of their own.
    pub fn new(
        pattern: Pattern,
        shape: MarkShape,
        sigma_mil: f64,
        marks: impl IntoIterator<Item = (MarkId, MarkPlace)>,
    ) -> Self {
        let mark = |(id, drawn)| PlateMark {
            id,
            drawn,
            place: drawn,
        };
        let mut marks: Vec<PlateMark> = marks.into_iter().map(mark).collect();
        marks.sort_by_key(|mark| mark.id);
        /// If the field is not stated, its radius is this fraction of the marks' extent.
        const FIELD: f64 = 0.7;
        let mut plate = Self {
            shape,
            field_radius_mil: 0.0,
            pattern,
            drawing_sigma_mil: sigma_mil,
            marks,
            least_variance_mil2: 0.0,
        };
        plate.find_least_variance();
        plate.field_radius_mil = match pattern {
            Pattern::Heroes => heroes::FIELD_RADIUS_MIL,
            Pattern::Table | Pattern::Listed => FIELD * plate.reach_mil(),
        };
        plate
    }

    fn find_least_variance(&mut self) {
        let variances = self.marks.iter().map(|mark| mark.place.variance_mil2());
        self.least_variance_mil2 = variances.fold(f64::INFINITY, f64::min);
    }

    pub fn pattern(&self) -> Pattern {
        self.pattern
    }

    /// Uncertainty of the print relative to the drawing: 1 sigma per axis of marks without a sigma of their own, mil.
    pub fn drawing_sigma_mil(&self) -> f64 {
        self.drawing_sigma_mil
    }

    /// Number of marks.
    pub fn count(&self) -> usize {
        self.marks.len()
    }

    fn mark(&self, id: MarkId) -> Option<&PlateMark> {
        let index = self.marks.binary_search_by_key(&id, |mark| mark.id).ok()?;
        self.marks.get(index)
    }

    /// Replaces a mark's drawn position by a measured one; ignores an id that the plate does not have.
    pub fn set(&mut self, id: MarkId, position: PlateMil, sigma_mil: [f64; 2]) {
        let index = self.marks.binary_search_by_key(&id, |mark| mark.id);
        let Some(mark) = index.ok().and_then(|index| self.marks.get_mut(index)) else {
            return;
        };
        mark.place = MarkPlace {
            at: position,
            sigma_mil,
        };
        self.find_least_variance();
    }

    /// Position of a mark; `None` for an id that the plate does not have.
    pub fn position(&self, id: MarkId) -> Option<PlateMil> {
        Some(self.mark(id)?.place.at)
    }

    /// Position of a mark and its uncertainty; `None` for an id that the plate does not have.
    pub fn place(&self, id: MarkId) -> Option<MarkPlace> {
        Some(self.mark(id)?.place)
    }

    /// Drawn position of a mark.
    pub fn drawn_position(&self, id: MarkId) -> Option<PlateMil> {
        Some(self.mark(id)?.drawn.at)
    }

    /// Measured position of a mark: its position or sigma differs from the drawing's.
    pub fn measured(&self, id: MarkId) -> Option<MarkPlace> {
        let mark = self.mark(id)?;
        (mark.place != mark.drawn).then_some(mark.place)
    }

    /// The plate scaled by a factor, including its marks and their sigmas.
    pub fn scaled(&self, by: f64) -> Self {
        let scaled = |mark: &PlateMark| {
            let place = MarkPlace {
                at: (mark.drawn.at.vector() * by).into(),
                sigma_mil: mark.drawn.sigma_mil.map(|sigma| sigma * by),
            };
            (mark.id, place)
        };
        let (shape, sigma_mil) = (self.shape.scaled(by), self.drawing_sigma_mil * by);
        Self::new(
            Pattern::Listed,
            shape,
            sigma_mil,
            self.marks.iter().map(scaled),
        )
    }

    /// The plate as drawn, without measured positions.
    pub fn as_drawn(&self) -> Self {
        let mut drawn = self.clone();
        for mark in &mut drawn.marks {
            mark.place = mark.drawn;
        }
        drawn.find_least_variance();
        drawn
    }

    /// Difference between the variance of a mark's position and that of the plate's best known mark, mil^2 per axis: zero
    /// if all marks are known equally well.
    pub fn excess_variance_mil2(&self, id: MarkId) -> f64 {
        self.mark(id).map_or(0.0, |mark| {
            mark.place.variance_mil2() - self.least_variance_mil2
        })
    }

    /// Distance of the plate's edge from its centre, mil: for the pattern of 2013, of the outermost mark on an axis; for
    /// other drawings, of the outermost mark.
    pub fn edge_mil(&self) -> f64 {
        match self.pattern {
            Pattern::Heroes => heroes::position(heroes::EDGE).vector().norm(),
            Pattern::Table | Pattern::Listed => {
                let out = self.marks.iter().map(|mark| mark.drawn.at.vector().norm());
                out.fold(0.0, f64::max)
            }
        }
    }

    /// Largest distance of a drawn mark from the plate's axes, mil.
    pub fn reach_mil(&self) -> f64 {
        let reach = self.marks.iter().map(|mark| mark.drawn.at);
        reach
            .map(|at| at.x.abs().max(at.y.abs()))
            .fold(0.0, f64::max)
    }

    /// Mean number of marks per area, 1 / mil^2, over the bounding rectangle of all marks.
    pub fn density_per_mil2(&self) -> f64 {
        let side = |of: fn(&PlateMil) -> f64| {
            let along = || self.marks.iter().map(|mark| of(&mark.drawn.at));
            along().fold(f64::NEG_INFINITY, f64::max) - along().fold(f64::INFINITY, f64::min)
        };
        let area = side(|at| at.x) * side(|at| at.y);
        self.marks.len() as f64 / area.max(self.shape.size_mil().powi(2))
    }

    /// Every mark with its position, in the order of their ids.
    pub fn marks(&self) -> impl Iterator<Item = (MarkId, PlateMil)> + '_ {
        self.marks.iter().map(|mark| (mark.id, mark.place.at))
    }

    /// Every mark with its drawn position, in the order of their ids.
    pub fn drawn_marks(&self) -> impl Iterator<Item = (MarkId, PlateMil)> + '_ {
        self.marks.iter().map(|mark| (mark.id, mark.drawn.at))
    }

    /// The marks in a square of half width `reach_mil` around a position, ordered by id.
    pub fn marks_about(
        &self,
        at: PlateMil,
        reach_mil: f64,
    ) -> impl Iterator<Item = (MarkId, PlateMil)> + '_ {
        self.marks()
            .filter(move |(_, p)| (p.x - at.x).abs() < reach_mil && (p.y - at.y).abs() < reach_mil)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const DOT: MarkShape = MarkShape::Dot { diameter_mil: 50.0 };

    #[test]
    fn marks_about_a_place_are_those_of_the_square_about_it() {
        let plate = Plate::heroes(DOT, 0.2);
        let at = PlateMil::new(300.0, -500.0);
        let within = |p: &PlateMil| (p.x - at.x).abs() < 700.0 && (p.y - at.y).abs() < 700.0;
        let expected: Vec<_> = plate.marks().filter(|(_, p)| within(p)).collect();
        assert!(expected.len() > 9);
        assert_eq!(plate.marks_about(at, 700.0).collect::<Vec<_>>(), expected);
    }

    #[test]
    fn a_measured_mark_stands_beside_the_drawn_one() {
        let [a, b] = [(7, 0), (-300, 0)].map(|(i, j)| MarkId { i, j });
        let place = |x: f64| MarkPlace::new(PlateMil::new(x, 0.0), 1.0);
        let mut plate = Plate::new(
            Pattern::Listed,
            DOT,
            1.0,
            [(a, place(100.0)), (b, place(-300.0))],
        );
        assert_eq!(plate.marks().next(), Some((b, PlateMil::new(-300.0, 0.0))));
        plate.set(a, PlateMil::new(101.0, 0.5), [0.1; 2]);
        let measured = plate.measured(a).map(|place| place.at);
        assert_eq!(measured, Some(PlateMil::new(101.0, 0.5)));
        assert_eq!(plate.drawn_position(a), Some(PlateMil::new(100.0, 0.0)));
        assert!((plate.excess_variance_mil2(b) - 0.99).abs() < 1e-12);
        assert_eq!(
            (plate.measured(b), plate.as_drawn().measured(a)),
            (None, None)
        );
        assert_eq!(plate.position(MarkId { i: 7, j: 1 }), None);
    }
}
