//! The native part of the Python package `solaspect`: the library on NumPy arrays, with the GIL released while it works.

mod arguments;
mod errors;
mod instrument;
mod mapping;
mod marks;
mod numbers;
mod offset;
mod pickled;
mod pixels;
mod pointing;
mod program;
mod simulate;
mod solution;
mod solve;

use pyo3::prelude::*;

#[pymodule]
mod _native {
    #[pymodule_export]
    use super::instrument::{Instrument, compare, load};
    #[pymodule_export]
    use super::mapping::Mapping;
    #[pymodule_export]
    use super::marks::{Detection, Mark};
    #[pymodule_export]
    use super::offset::Offset;
    #[pymodule_export]
    use super::pointing::PointingHistory;
    #[pymodule_export]
    use super::program::{place_text, run, time_text};
    #[pymodule_export]
    use super::simulate::{SimulatedFrame, simulate};
    #[pymodule_export]
    use super::solution::{Levels, Reason, Solution, Track};
    #[pymodule_export]
    use super::solve::solve;

    #[pymodule_export]
    const VERSION: &str = solaspect::provenance::VERSION;
}
