//! Figures as SVG: curves over logarithmic axes, series over linear ones or over time, histograms, maps. Input is numbers and
//! labels.
//!
//! - `axis`: what axes span, and their ticks.
//! - `sheet`: what is drawn on: title, legend above the panel, grid, shapes.
//! - `thin`: long series made short without losing what stands out.
//! - `clip`: the parts of lines in a panel.
//! - `ground`: the square field of maps, and the scale of colours beside it.
//! - `series`, `curves`, `histogram`, `map`, `path_map`: a kind of figure each.

mod axis;
mod clip;
mod curves;
mod ground;
mod histogram;
mod labels;
mod map;
mod path_map;
mod series;
mod sheet;
mod thin;

pub use curves::{Curve, Stroke, curves};
pub use ground::{Ground, Line};
pub use histogram::{Density, histogram};
pub use labels::{Horizontal, Labels, PlotError};
pub use map::{Arrow, Cell, binned, cell_of, scalar_map, vector_map};
pub use path_map::{Ellipse, Passage, path_map};
pub use series::{Figure, Mark, Series, series, square, stack};
