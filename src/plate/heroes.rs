//! The pattern of 2013: 15 x 15 marks whose spacings are a code.
//!
//! With f(n) = 45 n + 3 n (n - 1) for n >= 0 and 48 n - 3 n (n + 1) for n < 0, mark (i, j) is printed at
//! X = 6 (f(i) - 15 j), Y = 6 (f(j) + 15 i), mil from the plate's centre (HEROES flight program, 2013; the
//! idea in Cramer 2014, section 2.4 and figure 4). A step in i is a fixed 90 mil along Y and a spacing along X
//! that occurs once in the pattern; a step in j is 90 mil along -X and a coded spacing along Y.

use super::MarkId;
use crate::units::PlateMil;

/// The largest |i| and |j| of a mark.
const MAX_INDEX: i32 = 7;

/// The Sun's centre may be within this distance of the plate's centre.
pub const FIELD_RADIUS_MIL: f64 = 2000.0;
/// The outermost mark on an axis: displacements at the plate's edge are stated there.
pub const EDGE: MarkId = MarkId {
    i: -MAX_INDEX,
    j: 0,
};

/// The ids of the pattern, in order.
pub fn ids() -> impl Iterator<Item = MarkId> {
    let range = -MAX_INDEX..=MAX_INDEX;
    range
        .clone()
        .flat_map(move |i| range.clone().map(move |j| MarkId { i, j }))
}

/// Whether the pattern has a mark of this id.
pub fn holds(id: MarkId) -> bool {
    id.i.abs() <= MAX_INDEX && id.j.abs() <= MAX_INDEX
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

/// Drawn position of a mark of the pattern.
pub fn position(id: MarkId) -> PlateMil {
    PlateMil::new(
        6.0 * (code(id.i) - 15.0 * f64::from(id.j)),
        6.0 * (code(id.j) + 15.0 * f64::from(id.i)),
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The fixed part of a step between neighbours, mil.
    const FIXED_SPACING_MIL: f64 = 90.0;

    /// The coded spacing from index n to n + 1, mil.
    fn coded_spacing_mil(n: i32) -> f64 {
        6.0 * (code(n + 1) - code(n))
    }

    #[test]
    fn each_coded_spacing_occurs_once() {
        let mut spacings: Vec<f64> = (-MAX_INDEX..MAX_INDEX).map(coded_spacing_mil).collect();
        spacings.sort_by(f64::total_cmp);
        let expected: Vec<f64> = (0..14).map(|k| 270.0 + 18.0 * f64::from(k)).collect();
        assert_eq!(spacings, expected);
    }

    #[test]
    fn steps_are_fixed_in_one_axis_and_coded_in_the_other() {
        for MarkId { i, j } in ids() {
            let step = |next: MarkId| {
                let step = position(next).vector() - position(MarkId { i, j }).vector();
                holds(next).then_some((step.x, step.y))
            };
            let along_i = step(MarkId { i: i + 1, j });
            assert!(along_i.is_none_or(|s| s == (coded_spacing_mil(i), FIXED_SPACING_MIL)));
            let along_j = step(MarkId { i, j: j + 1 });
            assert!(along_j.is_none_or(|s| s == (-FIXED_SPACING_MIL, coded_spacing_mil(j))));
        }
        assert_eq!(ids().count(), 225);
    }

    #[test]
    fn the_pattern_begins_as_printed() {
        for ((i, j), x, y) in [
            ((0, 0), 0.0, 0.0),
            ((1, 0), 270.0, 90.0),
            ((-1, 2), -468.0, 486.0),
        ] {
            assert_eq!(position(MarkId { i, j }), PlateMil::new(x, y));
        }
    }
}
