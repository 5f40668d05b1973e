//! Drawing: pictures of a frame with shapes and text laid over it, and figures of numbers. It knows pixels, numbers and
//! colours, nothing else.

mod canvas;
pub mod html;
pub mod plot;

pub use canvas::{Canvas, Colour};
