//! A picture received in pieces.

use super::table::{Nanoseconds, timestamp};
use crate::frame::{Frame, FrameInfo, Pixels};
use crate::instrument::Role;
use crate::link::picture::{Section, Tag};
use image::{Rgb, RgbImage};

/// Missing pixels: a hatch of these colours.
const MISSING: [Rgb<u8>; 2] = [Rgb([70, 90, 120]), Rgb([95, 115, 145])];
const HATCH_PX: u32 = 8;
/// Maximum number of stored keywords of a picture: a frame has fewer.
const MOST_TAGS: usize = 256;

/// A picture with the pixels received so far.
#[derive(Debug, Clone)]
pub struct Partial {
    pub width: usize,
    pub height: usize,
    /// 8-bit pixels, `None` if not received.
    pixels: Vec<Option<u8>>,
    pub received: usize,
    pub tags: Vec<Tag>,
    /// Number of keywords that exceeded the limit.
    pub tags_lost: u64,
    /// Time of the frame, carried by its packets.
    pub time: Nanoseconds,
    /// Time of arrival of its last packet.
    pub arrived: Nanoseconds,
    /// Increases with every packet.
    pub version: u64,
}

impl Partial {
    /// A picture of which only the time is known.
    pub fn begun(time: Nanoseconds, arrived: Nanoseconds) -> Self {
        Self {
            width: 0,
            height: 0,
            pixels: Vec::new(),
            received: 0,
            tags: Vec::new(),
            tags_lost: 0,
            time,
            arrived,
            version: 0,
        }
    }

    /// Takes in a run of pixels. A run with a different picture size than the previous ones is ignored.
    pub fn take_section(&mut self, section: &Section) {
        if self.pixels.is_empty() {
            (self.width, self.height) = (section.width, section.height);
            self.pixels = vec![None; section.width * section.height];
        }
        if (self.width, self.height) != (section.width, section.height) {
            return;
        }
        let places = self.pixels.iter_mut().skip(section.first);
        for (place, pixel) in places.zip(section.pixels) {
            self.received += usize::from(place.is_none());
            *place = Some(*pixel);
        }
    }

    /// Takes in a keyword; a later one replaces an earlier one of the same name.
    pub fn take_tag(&mut self, tag: Tag) {
        self.tags.retain(|known| known.name != tag.name);
        if self.tags.len() >= MOST_TAGS {
            self.tags.remove(0);
            self.tags_lost += 1;
        }
        self.tags.push(tag);
    }

    /// The picture with a hatch for missing pixels.
    pub fn image(&self) -> RgbImage {
        RgbImage::from_fn(self.width as u32, self.height as u32, |x, y| {
            let pixel = self.pixels.get(y as usize * self.width + x as usize);
            match pixel.copied().flatten() {
                Some(grey) => Rgb([grey; 3]),
                None => MISSING[((x + y) / HATCH_PX % 2) as usize],
            }
        })
    }

    /// The picture as a frame, if it is complete.
    pub fn frame(&self) -> Option<Frame> {
        let pixels: Option<Vec<u8>> = self.pixels.iter().copied().collect();
        let info = FrameInfo {
            mid_exposure: Some(timestamp(self.time)),
            ..FrameInfo::default()
        };
        let pixels = Pixels::U8(pixels?);
        Frame::new(self.width, self.height, pixels, u8::MAX.into(), info).ok()
    }
}

/// Name of a camera by its number on the serial line.
pub fn camera_name(number: u8) -> String {
    Role::numbered(number).unwrap_or_else(|| format!("camera {number}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn section(first: usize, pixels: &[u8]) -> Section<'_> {
        Section {
            camera: 1,
            width: 4,
            height: 3,
            first,
            last: false,
            pixels,
        }
    }

    #[test]
    fn pieces_in_any_order_and_twice_make_the_picture() {
        let mut picture = Partial::begun(5, 5);
        for (first, pixels) in [(8, [9, 10, 11, 12]), (0, [1, 2, 3, 4]), (0, [1, 2, 3, 4])] {
            picture.take_section(&section(first, &pixels));
        }
        assert_eq!(picture.received, 8);
        assert!(MISSING.contains(picture.image().get_pixel(0, 1)));
        assert!(picture.frame().is_none());
        picture.take_section(&section(4, &[5, 6, 7, 8]));
        assert_eq!(picture.received, 12);
        assert_eq!(picture.image().get_pixel(3, 2).0, [12; 3]);
        assert!(picture.frame().is_some());
    }

    #[test]
    fn a_piece_beyond_the_picture_is_cut_and_one_of_another_size_ignored() {
        let mut picture = Partial::begun(0, 0);
        picture.take_section(&section(10, &[1, 2, 3, 4]));
        assert_eq!(picture.received, 2);
        let other = Section {
            width: 5,
            ..section(0, &[1])
        };
        picture.take_section(&other);
        assert_eq!((picture.received, picture.width), (2, 4));
    }
}
