//! Parts of a picture, or of a plate: three by three.

/// Names of the parts, from the upper left.
pub const PARTS: [&str; 9] = [
    "the upper left",
    "the top",
    "the upper right",
    "the left",
    "the middle",
    "the right",
    "the lower left",
    "the bottom",
    "the lower right",
];

/// The part at a position, from 0 at the left and at the top to 1.
pub fn part(from_left: f64, from_top: f64) -> usize {
    let [column, row] = [from_left, from_top].map(|at| ((3.0 * at).max(0.0) as usize).min(2));
    3 * row + column
}

/// The names of the parts for which `is_so` holds.
pub fn named(is_so: impl Fn(usize) -> bool) -> Vec<&'static str> {
    let parts = PARTS.iter().enumerate();
    parts
        .filter(|(n, _)| is_so(*n))
        .map(|(_, name)| *name)
        .collect()
}
