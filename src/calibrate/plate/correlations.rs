//! The largest correlations of a fit: unknowns that the frames do not separate.

use super::adjust::{Adjusted, Unknown};
use super::camera::LENS;
use crate::geometry::view::PARAMETERS;
use crate::plate::MarkId;

/// Two unknowns and the correlation of their errors, -1 to 1.
#[derive(Debug, Clone, PartialEq)]
pub struct Correlation {
    pub between: [Parameter; 2],
    pub value: f64,
}

/// An unknown of the fit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Parameter {
    /// A term of the lens: radial r^2, radial r^4, decentring 1, decentring 2.
    Lens(usize),
    /// A mark's position along an axis.
    Mark(MarkId, usize),
    /// A pose's parameter, in the order of [`crate::geometry::view::Parameters`].
    View(usize, usize),
    /// A pose's drift: pose, term (the first is linear in time) and axis.
    Drift(usize, usize, usize),
}

const AXES: [&str; 2] = ["x", "y"];

impl Parameter {
    /// Name in words; poses count from 1.
    pub fn name(self) -> String {
        const LENS_TERMS: [&str; LENS] =
            ["radial r^2", "radial r^4", "decentring 1", "decentring 2"];
        const VIEW_TERMS: [&str; PARAMETERS] = [
            "centre x",
            "centre y",
            "similarity a",
            "similarity b",
            "stretch c",
            "stretch d",
            "tilt x",
            "tilt y",
        ];
        match self {
            Self::Lens(term) => format!("lens, {}", LENS_TERMS[term]),
            Self::Mark(id, axis) => format!("mark {id}, {}", AXES[axis].to_uppercase()),
            Self::View(pose, term) => format!("pose {}, {}", pose + 1, VIEW_TERMS[term]),
            Self::Drift(pose, term, axis) => {
                let (pose, degree) = (pose + 1, term + 1);
                format!("pose {pose}, drift {} of degree {degree}", AXES[axis])
            }
        }
    }

    fn is_mark(self) -> bool {
        matches!(self, Self::Mark(..))
    }

    /// Whether two parameters belong to the same mark.
    fn is_of_same_mark(self, other: Self) -> bool {
        matches!((self, other), (Self::Mark(a, _), Self::Mark(b, _)) if a == b)
    }
}

/// The largest correlations by size: `count` that involve lens or poses, and `count` between different marks.
pub(super) fn largest(solved: &Adjusted, ids: &[MarkId], count: usize) -> Vec<Correlation> {
    let covariance = solved.covariance();
    let parameter = |n: usize| match solved.state.unknown(n) {
        Unknown::Lens(term) => Parameter::Lens(term),
        Unknown::Mark(mark, axis) => Parameter::Mark(ids[mark], axis),
        Unknown::View(pose, term) => Parameter::View(pose, term),
        Unknown::Drift(pose, term, axis) => Parameter::Drift(pose, term, axis),
    };
    let free: Vec<usize> = (0..covariance.nrows())
        .filter(|n| covariance[(*n, *n)] > 0.0)
        .collect();
    let sigmas: Vec<f64> = free.iter().map(|n| covariance[(*n, *n)].sqrt()).collect();
    let (mut of_camera, mut of_marks) = (Vec::new(), Vec::new());
    for (row, n) in free.iter().enumerate() {
        for (column, m) in free[..row].iter().enumerate() {
            let between = [parameter(*m), parameter(*n)];
            if between[0].is_of_same_mark(between[1]) {
                continue;
            }
            let value = covariance[(*n, *m)] / (sigmas[row] * sigmas[column]);
            let list = match between.iter().all(|p| p.is_mark()) {
                true => &mut of_marks,
                false => &mut of_camera,
            };
            list.push(Correlation { between, value });
        }
    }
    let first = |mut list: Vec<Correlation>| {
        list.sort_by(|a, b| b.value.abs().total_cmp(&a.value.abs()));
        list.truncate(count);
        list
    };
    [first(of_camera), first(of_marks)].concat()
}
