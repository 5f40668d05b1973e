//! Drawing: pictures of a frame with shapes and text laid over it. It knows pixels and colours, nothing else.

mod canvas;

pub use canvas::{Canvas, Colour};
