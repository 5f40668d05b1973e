//! Figures as SVG: curves over logarithmic axes, series over linear ones or over time, histograms, maps. Input is numbers and
//! labels.
//!
//! - `axis`: what axes span, and their ticks.
//! - `sheet`: what is drawn on: title, legend above the panel, grid, shapes.
//! - `thin`: long series made short without losing what stands out.
//! - `series`, `curves`, `histogram`, `map`: a kind of figure each.

mod axis;
mod curves;
mod histogram;
mod labels;
mod map;
mod series;
mod sheet;
mod thin;

pub use curves::{Curve, Stroke, curves};
pub use histogram::{Density, histogram};
pub use labels::{Horizontal, Labels, PlotError};
pub use map::{Arrow, Cell, scalar_map, vector_map};
pub use series::{Figure, Mark, Series, series, square, stack};
