//! A magnified colour picture on which sensor positions can be drawn.

use crate::frame::{Frame, Region};
use crate::units::SensorPx;
use crate::with_view;
use embedded_graphics::mono_font::ascii::{FONT_9X15, FONT_9X15_BOLD};
use embedded_graphics::mono_font::{MonoTextStyle, MonoTextStyleBuilder};
use embedded_graphics::pixelcolor::Rgb888;
use embedded_graphics::prelude::*;
use embedded_graphics::primitives::{Circle, Line, PrimitiveStyle, Rectangle};
use embedded_graphics::text::Text;
use image::{Rgb, RgbImage};
use std::convert::Infallible;

/// A colour: red, green, blue.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Colour(pub u8, pub u8, pub u8);

impl Colour {
    pub const WHITE: Self = Self(255, 255, 255);
    pub const RED: Self = Self(255, 80, 80);
    pub const GREEN: Self = Self(90, 230, 90);
    pub const BLUE: Self = Self(110, 190, 255);
    pub const YELLOW: Self = Self(255, 220, 60);
    pub const MAGENTA: Self = Self(255, 90, 255);
    pub const ORANGE: Self = Self(255, 150, 30);

    fn rgb(self) -> Rgb888 {
        Rgb888::new(self.0, self.1, self.2)
    }
}

/// A magnified part of a frame, or another picture, with a strip for text below it.
#[derive(Clone)]
pub struct Canvas {
    image: RgbImage,
    region: Region,
    zoom: u32,
}

/// Space before a line of text, px.
const MARGIN_PX: u32 = 6;

impl Canvas {
    /// Height of a line of text in the strip, px.
    pub const LINE_PX: u32 = 18;
    /// Width of a letter, px.
    pub const LETTER_PX: u32 = 9;

    /// A region of a frame, each pixel magnified to `zoom` x `zoom`, brightness scaled from `black_dn` to `white_dn`, with space for
    /// `text_lines` below.
    pub fn of_frame(
        frame: &Frame,
        region: Region,
        zoom: u32,
        (black_dn, white_dn): (f64, f64),
        text_lines: u32,
    ) -> Self {
        let (width, height) = (region.width() as u32 * zoom, region.height() as u32 * zoom);
        let mut image = RgbImage::new(width, height + text_lines * Self::LINE_PX);
        let range = (white_dn - black_dn).max(1.0);
        with_view!(frame, view => {
            for (x, y, pixel) in image.enumerate_pixels_mut().filter(|(_, y, _)| *y < height) {
                let dn = view.dn(region.x0 + (x / zoom) as usize, region.y0 + (y / zoom) as usize);
                let grey = (255.0 * (f64::from(dn) - black_dn) / range).clamp(0.0, 255.0);
                *pixel = Rgb([grey as u8; 3]);
            }
        });
        Self {
            image,
            region,
            zoom,
        }
    }

    /// A colour picture, each pixel of which is one position, with space for `text_lines` below.
    pub fn of_image(picture: &RgbImage, text_lines: u32) -> Self {
        let (width, height) = picture.dimensions();
        let mut image = RgbImage::new(width, height + text_lines * Self::LINE_PX);
        image::imageops::replace(&mut image, picture, 0, 0);
        Self {
            image,
            region: Region::sized(0, 0, width as usize, height as usize),
            zoom: 1,
        }
    }

    /// The picture.
    pub fn into_image(self) -> RgbImage {
        self.image
    }

    /// A straight line between two sensor positions.
    pub fn line(&mut self, from: SensorPx, to: SensorPx, colour: Colour) {
        let line = Line::new(self.place(from), self.place(to));
        self.draw(&line.into_styled(PrimitiveStyle::with_stroke(colour.rgb(), 1)));
    }

    /// A circle about a sensor position, radius in sensor pixels.
    pub fn circle(&mut self, centre: SensorPx, radius_px: f64, colour: Colour) {
        let diameter = (2.0 * radius_px * f64::from(self.zoom)).round() as u32;
        let circle = Circle::with_center(self.place(centre), diameter);
        self.draw(&circle.into_styled(PrimitiveStyle::with_stroke(colour.rgb(), 1)));
    }

    /// A dot on a sensor position.
    pub fn dot(&mut self, at: SensorPx, colour: Colour) {
        let dot = Circle::with_center(self.place(at), self.zoom.max(3));
        self.draw(&dot.into_styled(PrimitiveStyle::with_fill(colour.rgb())));
    }

    /// A line from one sensor position to another with a head at its end.
    pub fn arrow(&mut self, from: SensorPx, to: SensorPx, colour: Colour) {
        self.line(from, to, colour);
        let along = to.vector() - from.vector();
        let across = nalgebra::Vector2::new(-along.y, along.x);
        for side in [-0.06, 0.06] {
            let barb = to.vector() - along * 0.12 + across * side;
            self.line(to, barb.into(), colour);
        }
    }

    /// Text on black beside a sensor position. Near the edge of the picture the text moves inwards and stays whole.
    pub fn label(&mut self, at: SensorPx, text: &str, colour: Colour) {
        let (at, picture) = (self.place(at), self.picture_size());
        let mut place = at + Point::new(6, -6);
        if Rectangle::new(Point::zero(), picture).contains(at) {
            let text_px = Self::LETTER_PX * text.chars().count() as u32;
            let rightmost = picture.width.saturating_sub(text_px) as i32;
            place.x = place.x.min(rightmost);
            place.y = place.y.max(FONT_9X15_BOLD.baseline as i32);
        }
        let style = MonoTextStyleBuilder::new()
            .font(&FONT_9X15_BOLD)
            .text_color(colour.rgb())
            .background_color(Rgb888::BLACK)
            .build();
        self.draw(&Text::new(text, place, style));
    }

    /// A line of text in the strip below the picture, counted from 0. A longer text widens the strip.
    pub fn caption(&mut self, line: u32, text: &str, colour: Colour) {
        let width = MARGIN_PX + Self::LETTER_PX * (text.chars().count() as u32 + 1);
        if width > self.image.width() {
            let wide = RgbImage::new(width, self.image.height());
            let narrow = std::mem::replace(&mut self.image, wide);
            image::imageops::replace(&mut self.image, &narrow, 0, 0);
        }
        let place = Point::new(MARGIN_PX as i32, self.baseline(line));
        self.draw(&Text::new(
            text,
            place,
            MonoTextStyle::new(&FONT_9X15, colour.rgb()),
        ));
    }

    /// The legend, in the strip below the picture from `first_line`; continues in the next line if one is full. Returns the first free line.
    pub fn legend(&mut self, first_line: u32, entries: &[(&str, Colour)]) -> u32 {
        const SWATCH_PX: u32 = 12;
        let (mut line, mut x) = (first_line, 6);
        for (text, colour) in entries {
            let width =
                SWATCH_PX as i32 + Self::LETTER_PX as i32 * (text.chars().count() as i32 + 2);
            if x > 6 && x + width > self.image.width() as i32 {
                (line, x) = (line + 1, 6);
            }
            let y = self.baseline(line);
            let corner = Point::new(x, y - SWATCH_PX as i32 + 1);
            let swatch = Rectangle::new(corner, Size::new(SWATCH_PX, SWATCH_PX));
            self.draw(&swatch.into_styled(PrimitiveStyle::with_fill(colour.rgb())));
            let style = MonoTextStyle::new(&FONT_9X15, Colour::WHITE.rgb());
            let place = Point::new(x + SWATCH_PX as i32 + 5, y);
            self.draw(&Text::new(text, place, style));
            x += width;
        }
        line + 1
    }

    /// A scale bar in the strip below the picture, `length_px` sensor pixels long, with its length as text.
    pub fn scale_bar(&mut self, line: u32, length_px: f64, text: &str) {
        let y = self.baseline(line) - 5;
        let length = (length_px * f64::from(self.zoom)).round() as i32;
        let (left, right) = (Point::new(6, y), Point::new(6 + length, y));
        let ends = [left, right].map(|at| (at - Point::new(0, 4), at + Point::new(0, 4)));
        for (from, to) in [(left, right), ends[0], ends[1]] {
            let stroke = PrimitiveStyle::with_stroke(Colour::WHITE.rgb(), 2);
            self.draw(&Line::new(from, to).into_styled(stroke));
        }
        let style = MonoTextStyle::new(&FONT_9X15, Colour::WHITE.rgb());
        self.draw(&Text::new(text, Point::new(6 + length + 10, y + 5), style));
    }

    /// Baseline of a line of text in the strip, px.
    fn baseline(&self, line: u32) -> i32 {
        (self.picture_size().height + (line + 1) * Self::LINE_PX) as i32 - 5
    }

    /// Size of the picture above the strip, px.
    fn picture_size(&self) -> Size {
        Size::new(self.region.width() as u32, self.region.height() as u32) * self.zoom
    }

    /// The picture's pixel of a sensor position: pixel (0, 0) of the sensor has its centre in the middle of its
    /// magnified square.
    fn place(&self, at: SensorPx) -> Point {
        let along = |v: f64, first: usize| {
            let magnified = (v - first as f64 + 0.5) * f64::from(self.zoom);
            magnified.clamp(-1e6, 1e6) as i32
        };
        Point::new(along(at.x, self.region.x0), along(at.y, self.region.y0))
    }

    fn draw(&mut self, item: &impl Drawable<Color = Rgb888>) {
        let Ok(_) = item.draw(self);
    }
}

impl OriginDimensions for Canvas {
    fn size(&self) -> Size {
        Size::new(self.image.width(), self.image.height())
    }
}

impl DrawTarget for Canvas {
    type Color = Rgb888;
    type Error = Infallible;

    fn draw_iter<I>(&mut self, pixels: I) -> Result<(), Infallible>
    where
        I: IntoIterator<Item = Pixel<Rgb888>>,
    {
        for Pixel(at, colour) in pixels {
            let (Ok(x), Ok(y)) = (u32::try_from(at.x), u32::try_from(at.y)) else {
                continue;
            };
            if x < self.image.width() && y < self.image.height() {
                let rgb = Rgb([colour.r(), colour.g(), colour.b()]);
                self.image.put_pixel(x, y, rgb);
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::{FrameInfo, Pixels};

    #[test]
    fn a_dot_covers_the_middle_of_its_own_pixel() {
        let pixels = Pixels::U8(vec![0; 20 * 10]);
        let frame = Frame::new(20, 10, pixels, 255, FrameInfo::default()).unwrap();
        let mut canvas = Canvas::of_frame(&frame, frame.region(), 5, (0.0, 255.0), 1);
        canvas.dot(SensorPx::new(7.0, 3.0), Colour::RED);
        canvas.line(
            SensorPx::new(-50.0, 4.0),
            SensorPx::new(500.0, 4.0),
            Colour::BLUE,
        );
        let image = canvas.into_image();
        assert_eq!((image.width(), image.height()), (100, 50 + Canvas::LINE_PX));
        assert_eq!(image.get_pixel(37, 17).0, [255, 80, 80]);
        assert_eq!(image.get_pixel(0, 22).0, [110, 190, 255]);
    }

    #[test]
    fn a_label_at_the_edge_of_the_picture_is_whole_and_one_beyond_it_is_not_drawn() {
        let frame = Frame::new(
            100,
            60,
            Pixels::U8(vec![200; 6000]),
            255,
            FrameInfo::default(),
        );
        let frame = frame.unwrap();
        let blank = Canvas::of_frame(&frame, frame.region(), 1, (0.0, 255.0), 0);
        let drawn = |x: f64, y: f64| {
            let mut canvas = blank.clone();
            canvas.label(SensorPx::new(x, y), "(-1,2)", Colour::BLUE);
            let drawn = canvas.into_image();
            let before = blank.clone().into_image();
            let pairs = drawn.pixels().zip(before.pixels());
            pairs.filter(|(now, before)| now != before).count()
        };
        let whole = drawn(30.0, 30.0);
        assert!(whole > 500, "{whole}");
        assert_eq!(
            [drawn(97.0, 30.0), drawn(30.0, 2.0), drawn(97.0, 2.0)],
            [whole; 3]
        );
        assert_eq!(drawn(200.0, 30.0), 0);
    }

    #[test]
    fn a_caption_is_whole_however_narrow_the_picture() {
        let pixels = Pixels::U8(vec![0; 20 * 10]);
        let frame = Frame::new(20, 10, pixels, 255, FrameInfo::default()).unwrap();
        let mut canvas = Canvas::of_frame(&frame, frame.region(), 1, (0.0, 255.0), 1);
        canvas.caption(0, "longer than the picture", Colour::WHITE);
        let image = canvas.into_image();
        let last = image.width() - 2 * Canvas::LETTER_PX..image.width();
        let is_written = |x: u32| (10..image.height()).any(|y| image.get_pixel(x, y).0 != [0; 3]);
        assert!(image.width() > 20 && last.into_iter().any(is_written));
    }
}
