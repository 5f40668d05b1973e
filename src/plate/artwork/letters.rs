//! Letters of a bitmap font as rectangles, for a format without text.

use super::{Rectangle, point};
use embedded_graphics::mono_font::MonoTextStyle;
use embedded_graphics::mono_font::iso_8859_1::FONT_9X15;
use embedded_graphics::mono_font::mapping::ISO_8859_1;
use embedded_graphics::pixelcolor::BinaryColor;
use embedded_graphics::prelude::*;
use embedded_graphics::text::{Baseline, Text};
use nalgebra::Vector2;
use std::convert::Infallible;

/// Height of a capital letter of the font, in rows.
const CAPITAL_PX: f64 = 10.0;

/// The letters of a text: a rectangle for each run of set pixels in a row. The baseline begins at `start`, capital letters are `height_mm`
/// high. A character without a glyph is a blank.
pub(super) fn rectangles(
    start: Vector2<f64>,
    height_mm: f64,
    text: &str,
) -> impl Iterator<Item = Rectangle> {
    let pixel_mm = height_mm / CAPITAL_PX;
    let corner = move |x: i32, y: i32| {
        let [x, y] = [x, y].map(|n| f64::from(n) * pixel_mm);
        point(start.x + x, start.y + y)
    };
    runs(text).into_iter().map(move |Run { x, y, length }| {
        // The font's rows grow downwards, and row 0 lies on the baseline.
        Rectangle {
            low: corner(x, -y),
            high: corner(x + length, 1 - y),
        }
    })
}

/// Adjacent set pixels in a row, the first at (x, y).
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Run {
    x: i32,
    y: i32,
    length: i32,
}

/// The runs of a text, row by row; the baseline begins at (0, 0).
fn runs(text: &str) -> Vec<Run> {
    let glyphs = text.chars().map(|c| match ISO_8859_1.contains(c) {
        true => c,
        false => ' ',
    });
    let glyphs: String = glyphs.collect();
    let style = MonoTextStyle::new(&FONT_9X15, BinaryColor::On);
    let text = Text::with_baseline(&glyphs, Point::zero(), style, Baseline::Alphabetic);
    let mut pixels = SetPixels::default();
    let Ok(_) = text.draw(&mut pixels);
    pixels.0.sort_by_key(|pixel| (pixel.y, pixel.x));
    let runs = pixels.0.chunk_by(|a, b| *b == *a + Point::new(1, 0));
    runs.filter_map(|run| {
        let Point { x, y } = *run.first()?;
        let length = run.len() as i32;
        Some(Run { x, y, length })
    })
    .collect()
}

/// Collects the set pixels of a text, without bounds.
#[derive(Debug, Default)]
struct SetPixels(Vec<Point>);

impl DrawTarget for SetPixels {
    type Color = BinaryColor;
    type Error = Infallible;

    fn draw_iter<I: IntoIterator<Item = Pixel<BinaryColor>>>(
        &mut self,
        pixels: I,
    ) -> Result<(), Infallible> {
        let set = pixels.into_iter().filter(|pixel| pixel.1.is_on());
        self.0.extend(set.map(|pixel| pixel.0));
        Ok(())
    }
}

impl Dimensions for SetPixels {
    fn bounding_box(&self) -> embedded_graphics::primitives::Rectangle {
        let half = i32::MAX / 2;
        let size = Size::new_equal(i32::MAX as u32);
        embedded_graphics::primitives::Rectangle::new(Point::new_equal(-half), size)
    }
}
