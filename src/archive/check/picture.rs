//! A frame's picture for display.

use crate::frame::{Frame, Sample};
use crate::with_view;
use image::GrayImage;

/// Fraction of the pixels that may be clipped to black, and to white.
const CLIPPED: f64 = 0.001;

/// The frame, stretched so that its darkest pixels are black and its brightest white; so a faint disc is visible, too.
pub fn stretched(frame: &Frame) -> GrayImage {
    let values: Vec<f32> = with_view!(frame, view => view.pixels().map(|p| p.dn()).collect());
    let (black, white) = ends(&values, frame.saturation_dn());
    let grey = |dn: &f32| ((dn - black) / (white - black) * 255.0).round() as u8;
    let mut picture = GrayImage::new(frame.width() as u32, frame.height() as u32);
    for (pixel, dn) in picture.pixels_mut().zip(&values) {
        pixel.0 = [grey(dn)];
    }
    picture
}

/// The values mapped to black and white, DN; for a picture without contrast, the whole range.
fn ends(values: &[f32], saturation_dn: u16) -> (f32, f32) {
    let mut sorted = values.to_vec();
    let clipped = (CLIPPED * values.len() as f64) as usize;
    let mut at = |index: usize| *sorted.select_nth_unstable_by(index, f32::total_cmp).1;
    let (black, white) = (at(clipped), at(values.len() - 1 - clipped));
    if white > black {
        (black, white)
    } else {
        (0.0, f32::from(saturation_dn))
    }
}
