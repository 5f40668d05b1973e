//! Figures as SVG: curves over logarithmic axes, series over linear ones or over time, histograms, maps. The inputs are numbers and labels.
//!
//! - `axis`: range and ticks of axes.
//! - `sheet`: the drawing area: title, legend above the panel, grid, shapes.
//! - `thin`: reduction of long series that preserves extreme values.
//! - `clip`: the parts of lines in a panel.
//! - `field`: the square field of maps, and their colour scale.
//! - `series`, `curves`, `histogram`, `map`, `path_map`: one kind of figure each.

mod axis;
mod clip;
mod curves;
mod field;
mod histogram;
mod labels;
mod map;
mod path_map;
mod series;
mod sheet;
mod thin;

pub use curves::{Curve, Stroke, curves};
pub use field::{Line, MapField};
pub use histogram::{Density, histogram};
pub use labels::{Horizontal, Labels, PlotError};
pub use map::{Arrow, Cell, binned, cell_of, scalar_map, vector_map};
pub use path_map::{Ellipse, PathPosition, path_map};
pub use series::{Figure, Mark, Series, series, square, stack};
