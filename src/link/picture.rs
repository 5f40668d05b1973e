//! A picture on its way to the ground: telemetry of types 0x82 (sections) and 0x83 (tags).
//!
//! A section is a run of pixels, row by row, of 8 bits each:
//!
//! | bytes | what |
//! |---|---|
//! | u32 | bits 31-8: number of the section's first pixel; bit 0: this is the last section |
//! | u32 | bits 31-20: width; 19-8: height; 7-4: camera; 3-1: 3 (8 bits a pixel); 0: 0 |
//! | rest | pixels |
//!
//! A tag is a keyword of its header: 16 bytes of value, type (as in cfitsio: 16 text, 41 i32, 82 f64), camera, 8 bytes of
//! name, 32 of comment. Source: HEROES flight program, 2013, whose sections had 1000 pixels; the sections here are short, so that a
//! solution on a serial line never waits long for one.

use super::fields::unix_time;
use super::message::MessageError;
use super::number::Codes;
use super::packet::{TelemetryPacket, id, telemetry_type};
use crate::frame::{Frame, Pixels};
use jiff::Timestamp;

/// Number of pixels of a section. With both headers it takes 124 bytes, 11 ms at 115200 baud.
pub const SECTION_PIXELS: usize = 100;
/// The largest width and height that fit into 12 bits.
const LARGEST: usize = 4095;
const EIGHT_BITS: u32 = 3;

/// Types of a tag's value.
#[rustfmt::skip] // One row, one line.
pub static TAG_TYPES: Codes = Codes { name: "tag_type", rows: &[
    (16, "text", "text, padded with zeros"),
    (41, "whole", "i32"),
    (82, "number", "f64"),
] };

/// Value of a tag.
#[derive(Debug, Clone, PartialEq)]
pub enum TagValue {
    Text(String),
    Whole(i32),
    Number(f64),
}

/// A keyword of a picture.
#[derive(Debug, Clone, PartialEq)]
pub struct Tag {
    pub name: String,
    pub value: TagValue,
    pub comment: String,
}

/// A picture of 8-bit pixels with its tags.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    camera: u8,
    width: usize,
    height: usize,
    pixels: Vec<u8>,
    tags: Vec<Tag>,
    time: (u32, u32),
}

impl Picture {
    /// The picture of a frame; pixels of more than 8 bits are scaled so that saturation becomes 255.
    /// `time` goes into every packet. `None` if the frame is larger than 4095 px in either direction.
    pub fn new(
        frame: &Frame,
        camera: u8,
        tags: Vec<Tag>,
        time: Timestamp,
    ) -> Result<Option<Self>, MessageError> {
        let (width, height) = (frame.width(), frame.height());
        if width > LARGEST || height > LARGEST {
            return Ok(None);
        }
        let full = u32::from(frame.saturation_dn()).max(1);
        let scaled = |dn: &u16| (u32::from(*dn) * 255 / full).min(255) as u8;
        let pixels = match frame.pixels() {
            Pixels::U8(pixels) => pixels.clone(),
            Pixels::U16(pixels) => pixels.iter().map(scaled).collect(),
        };
        let time = unix_time(telemetry_type::PICTURE.into(), time)?;
        Ok(Some(Self {
            camera: camera & 15,
            width,
            height,
            pixels,
            tags,
            time,
        }))
    }

    /// Number of its packets.
    pub fn parts(&self) -> usize {
        self.tags.len() + self.pixels.len().div_ceil(SECTION_PIXELS)
    }

    /// One of its packets, the tags first; `None` after the last.
    pub fn part(&self, number: usize) -> Option<TelemetryPacket> {
        let (kind, payload) = match self.tags.get(number) {
            Some(tag) => (telemetry_type::PICTURE_TAG, tag.payload(self.camera)),
            None => {
                let section = self.section(number - self.tags.len())?;
                (telemetry_type::PICTURE, section)
            }
        };
        TelemetryPacket::new(kind, id::ASPECT, self.time, payload).ok()
    }

    fn section(&self, number: usize) -> Option<Vec<u8>> {
        let first = number * SECTION_PIXELS;
        let pixels = self.pixels.get(first..)?;
        let pixels = &pixels[..pixels.len().min(SECTION_PIXELS)];
        if pixels.is_empty() {
            return None;
        }
        let last = first + pixels.len() == self.pixels.len();
        let place = (first as u32) << 8 | u32::from(last);
        let format = (self.width as u32) << 20
            | (self.height as u32) << 8
            | u32::from(self.camera) << 4
            | EIGHT_BITS << 1;
        let mut payload = Vec::with_capacity(8 + pixels.len());
        payload.extend(place.to_le_bytes());
        payload.extend(format.to_le_bytes());
        payload.extend_from_slice(pixels);
        Some(payload)
    }
}

impl Tag {
    fn payload(&self, camera: u8) -> Vec<u8> {
        let (kind, bytes) = match &self.value {
            TagValue::Text(text) => (16, text.as_bytes().to_vec()),
            TagValue::Whole(value) => (41, value.to_le_bytes().to_vec()),
            TagValue::Number(value) => (82, value.to_le_bytes().to_vec()),
        };
        let mut payload = padded(&bytes, 16);
        payload.extend([kind, camera]);
        payload.extend(padded(self.name.as_bytes(), 8));
        payload.extend(padded(self.comment.as_bytes(), 32));
        payload
    }

    /// Reads a telemetry packet of type 0x83: the camera and its tag; `None` if it is of another type.
    pub fn decode(packet: &TelemetryPacket) -> Option<(u8, Self)> {
        if packet.kind() != telemetry_type::PICTURE_TAG {
            return None;
        }
        let (bytes, rest) = packet.payload().split_first_chunk::<16>()?;
        let (&[kind, camera], rest) = rest.split_first_chunk::<2>()?;
        let (name, rest) = rest.split_first_chunk::<8>()?;
        let comment = rest.first_chunk::<32>()?;
        let value = match kind {
            16 => TagValue::Text(unpadded(bytes)),
            41 => TagValue::Whole(i32::from_le_bytes(*bytes.first_chunk()?)),
            82 => TagValue::Number(f64::from_le_bytes(*bytes.first_chunk()?)),
            _ => return None,
        };
        let (name, comment) = (unpadded(name), unpadded(comment));
        Some((
            camera,
            Self {
                name,
                value,
                comment,
            },
        ))
    }
}

fn unpadded(bytes: &[u8]) -> String {
    let text = bytes.split(|byte| *byte == 0).next().unwrap_or_default();
    String::from_utf8_lossy(text).into_owned()
}

fn padded(bytes: &[u8], length: usize) -> Vec<u8> {
    let mut padded = bytes.to_vec();
    padded.resize(length, 0);
    padded
}

/// A section, read by the ground.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Section<'a> {
    pub camera: u8,
    pub width: usize,
    pub height: usize,
    /// Number of its first pixel.
    pub first: usize,
    pub last: bool,
    pub pixels: &'a [u8],
}

impl<'a> Section<'a> {
    /// Reads a telemetry packet of type 0x82; `None` if it is of another type.
    pub fn decode(packet: &'a TelemetryPacket) -> Option<Self> {
        if packet.kind() != telemetry_type::PICTURE {
            return None;
        }
        let (place, rest) = packet.payload().split_first_chunk()?;
        let (format, pixels) = rest.split_first_chunk()?;
        let (place, format) = (u32::from_le_bytes(*place), u32::from_le_bytes(*format));
        Some(Self {
            camera: (format >> 4 & 15) as u8,
            width: (format >> 20) as usize,
            height: (format >> 8 & 0xFFF) as usize,
            first: (place >> 8) as usize,
            last: place & 1 == 1,
            pixels,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::FrameInfo;

    fn picture(pixels: Pixels, saturation_dn: u16) -> Picture {
        let info = FrameInfo::default();
        let frame = Frame::new(13, 17, pixels, saturation_dn, info).unwrap();
        let tag = Tag {
            name: "EXPTIME".into(),
            value: TagValue::Number(0.015),
            comment: "s".into(),
        };
        let time = Timestamp::from_second(1_379_786_400).unwrap();
        Picture::new(&frame, 1, vec![tag], time).unwrap().unwrap()
    }

    #[test]
    fn a_picture_put_together_again_is_the_picture() {
        let sent: Vec<u8> = (0..13 * 17).map(|n| n as u8).collect();
        let picture = picture(Pixels::U8(sent.clone()), 255);
        let packets: Vec<_> = (0..).map_while(|n| picture.part(n)).collect();
        assert_eq!(packets.len(), picture.parts());
        assert_eq!(packets[0].kind(), telemetry_type::PICTURE_TAG);
        assert_eq!(packets[0].payload().len(), 16 + 2 + 8 + 32);
        assert_eq!(Tag::decode(&packets[0]), Some((1, picture.tags[0].clone())));
        let mut received = vec![0; sent.len()];
        let sections: Vec<_> = packets[1..]
            .iter()
            .map(|p| Section::decode(p).unwrap())
            .collect();
        for (number, section) in sections.iter().enumerate() {
            assert_eq!((section.camera, section.width, section.height), (1, 13, 17));
            assert_eq!(section.last, number == sections.len() - 1);
            received[section.first..][..section.pixels.len()].copy_from_slice(section.pixels);
        }
        assert_eq!(received, sent);
    }

    #[test]
    fn twelve_bits_become_eight() {
        let mut dn = vec![0_u16; 13 * 17];
        (dn[1], dn[2], dn[3]) = (4095, 2048, 65535);
        let picture = picture(Pixels::U16(dn), 4095);
        assert_eq!(picture.pixels[..4], [0, 255, 127, 255]);
    }

    #[test]
    fn the_bits_of_a_section_are_those_of_2013() {
        let picture = picture(Pixels::U8(vec![7; 13 * 17]), 255);
        let packet = picture.part(3).unwrap();
        // First pixel 200, the last section; 13 x 17, camera 1, 8 bits.
        let expected = [
            (200_u32 << 8 | 1).to_le_bytes(),
            (13_u32 << 20 | 17 << 8 | 1 << 4 | 6).to_le_bytes(),
        ];
        assert_eq!(packet.payload()[..8], expected.concat());
        assert_eq!(packet.payload().len(), 8 + 21);
    }
}
