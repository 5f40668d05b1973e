//! Drawing: pictures of a frame with shapes and text overlaid, and figures of numbers.

mod canvas;
mod graticule;
pub mod html;
mod overlay;
pub mod plot;

pub use canvas::{Canvas, Colour};
pub use graticule::{graticule, limb};
pub use overlay::overlay;
