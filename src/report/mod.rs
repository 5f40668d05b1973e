//! Drawing: pictures of a frame with shapes and text laid over it, and figures of numbers. Input is pixels, numbers and
//! colours.

mod canvas;
pub mod html;
pub mod plot;

pub use canvas::{Canvas, Colour};
