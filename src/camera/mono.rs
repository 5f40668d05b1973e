//! Monochrome pixel formats of GenICam cameras, with the names and numbers of the Pixel Format Naming Convention, and the unpacking
//! of their pixels.

use super::PixelFormat;
use crate::frame::Pixels;

/// A monochrome pixel format.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MonoFormat {
    /// Name used by cameras.
    pub name: &'static str,
    /// Number of the format in a frame.
    pub code: u32,
    /// Significant bits of a pixel.
    pub bits: usize,
    packing: Packing,
}

/// Packing of the pixels in memory. Lines follow each other without a gap.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Packing {
    /// One byte per pixel.
    Bytes,
    /// Two bytes per pixel, the lower one first.
    Words,
    /// Without gaps, the lowest bit first.
    LowestFirst,
    /// Two pixels in three bytes: the upper eight bits of the first, the lower bits of both, the upper eight bits of the second.
    Pairs,
}

const fn format(name: &'static str, code: u32, bits: usize, packing: Packing) -> MonoFormat {
    MonoFormat {
        name,
        code,
        bits,
        packing,
    }
}

/// Among formats of the same depth the first is the easiest to read.
const FORMATS: [MonoFormat; 8] = [
    format("Mono8", 0x0108_0001, 8, Packing::Bytes),
    format("Mono10", 0x0110_0003, 10, Packing::Words),
    format("Mono10p", 0x010a_0046, 10, Packing::LowestFirst),
    format("Mono10Packed", 0x010c_0004, 10, Packing::Pairs),
    format("Mono12", 0x0110_0005, 12, Packing::Words),
    format("Mono12p", 0x010c_0047, 12, Packing::LowestFirst),
    format("Mono12Packed", 0x010c_0006, 12, Packing::Pairs),
    format("Mono16", 0x0110_0007, 16, Packing::Words),
];

impl MonoFormat {
    /// The format with this number.
    pub fn of_code(code: u32) -> Option<Self> {
        FORMATS.into_iter().find(|format| format.code == code)
    }

    /// All formats of this depth, the preferred one first.
    pub fn of_depth(depth: PixelFormat) -> impl Iterator<Item = Self> {
        let is_it = move |format: &Self| format.bits == depth.bits();
        FORMATS.into_iter().filter(is_it)
    }

    /// The names of all formats, for messages.
    pub fn names() -> String {
        FORMATS.map(|format| format.name).join(", ")
    }

    /// The first `count` pixels; `None` if there are too few bytes.
    pub fn unpack(self, mut bytes: Vec<u8>, count: usize) -> Option<Pixels> {
        bytes.truncate(self.bytes(count));
        if bytes.len() < self.bytes(count) {
            return None;
        }
        let mut pixels = match self.packing {
            Packing::Bytes => return Some(Pixels::U8(bytes)),
            Packing::Words => bytes
                .as_chunks()
                .0
                .iter()
                .copied()
                .map(u16::from_le_bytes)
                .collect(),
            Packing::LowestFirst => lowest_first(&bytes, self.bits),
            Packing::Pairs => pairs(&bytes, self.bits),
        };
        pixels.truncate(count);
        Some(Pixels::U16(pixels))
    }

    /// Number of bytes of this many pixels.
    fn bytes(self, count: usize) -> usize {
        match self.packing {
            Packing::Bytes => count,
            Packing::Words => 2 * count,
            Packing::LowestFirst => (self.bits * count).div_ceil(8),
            Packing::Pairs => (12 * count).div_ceil(8),
        }
    }

    /// The value at which pixels saturate, DN: the largest number of this many bits. Of 16 bits a camera may use fewer. If no pixel has any of the
    /// lowest bits set, it uses the upper ones; if it has `stated` its largest number and no pixel contradicts that, it uses the lower ones.
    pub fn saturation_dn(self, pixels: &Pixels, stated: Option<i64>) -> u16 {
        let largest = u16::MAX >> (16 - self.bits);
        if self.bits < 16 {
            return largest;
        }
        let set = pixels.as_slice().bits_set();
        let stated = stated.and_then(|dn| u16::try_from(dn).ok());
        match set.trailing_zeros() {
            0 => stated.filter(|dn| *dn >= set).unwrap_or(largest),
            unused => largest << unused.min(8),
        }
    }
}

/// Pixels of 10 or 12 bits, four to a group of five or six bytes.
fn lowest_first(bytes: &[u8], bits: usize) -> Vec<u16> {
    let mask = u16::MAX >> (16 - bits);
    unpacked(bytes, bits / 2, |eight: [u8; 8]| {
        let word = u64::from_le_bytes(eight);
        [0, 1, 2, 3].map(|k| (word >> (k * bits)) as u16 & mask)
    })
}

fn pairs(bytes: &[u8], bits: usize) -> Vec<u16> {
    let low = bits - 8;
    let mask = u8::MAX >> (8 - low);
    let joined = |high: u8, lower: u8| u16::from(high) << low | u16::from(lower & mask);
    unpacked(bytes, 3, |[first, lower, second]| {
        [joined(first, lower), joined(second, lower >> 4)]
    })
}

/// The pixels of every group of `BYTES` bytes, each group with the bytes after it, or zeros.
fn unpacked<const BYTES: usize, const PIXELS: usize>(
    bytes: &[u8],
    group: usize,
    pixels: impl Fn([u8; BYTES]) -> [u16; PIXELS],
) -> Vec<u16> {
    let mut all = vec![0; PIXELS * bytes.len().div_ceil(group)];
    for (n, slot) in all.as_chunks_mut().0.iter_mut().enumerate() {
        let rest = &bytes[n * group..];
        let read = match rest.first_chunk() {
            Some(read) => *read,
            None => {
                let mut read = [0; BYTES];
                read[..rest.len()].copy_from_slice(rest);
                read
            }
        };
        *slot = pixels(read);
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    fn named(name: &str) -> MonoFormat {
        let mut formats = FORMATS.into_iter();
        formats.find(|format| format.name == name).unwrap()
    }

    /// Five pixels, so that a packed picture ends within a group, and the bytes that encode them.
    #[test]
    fn known_pixels_of_every_format_of_a_camera_are_unpacked() {
        let ten = [0x001, 0x3fe, 0x155, 0x2aa, 0x300];
        let twelve = [0x001, 0xffe, 0x555, 0xaaa, 0x123];
        let sixteen = [0x0001, 0xfffe, 0x5555, 0xaaaa, 0x1234];
        // Each row follows the convention. "p": the lowest bit of the first pixel is the lowest bit of the first byte, and the
        // next pixel begins at the next bit. "Packed": upper eight bits of one pixel, a nibble of each, upper eight bits of the other.
        let cases: [(&str, &[u16], &[u8]); 8] = [
            ("Mono8", &[1, 0, 255, 4, 128], &[1, 0, 255, 4, 128]),
            (
                "Mono10",
                &ten,
                &[0x01, 0x00, 0xfe, 0x03, 0x55, 0x01, 0xaa, 0x02, 0x00, 0x03],
            ),
            (
                "Mono12",
                &twelve,
                &[0x01, 0x00, 0xfe, 0x0f, 0x55, 0x05, 0xaa, 0x0a, 0x23, 0x01],
            ),
            (
                "Mono16",
                &sixteen,
                &[0x01, 0x00, 0xfe, 0xff, 0x55, 0x55, 0xaa, 0xaa, 0x34, 0x12],
            ),
            // Bits from the lowest: 1000000000 0111111111 1010101010 0101010101 0000000011.
            ("Mono10p", &ten, &[0x01, 0xf8, 0x5f, 0x95, 0xaa, 0x00, 0x03]),
            // By nibbles from the lowest: 1 0 0, e f f, 5 5 5, a a a, 3 2 1.
            (
                "Mono12p",
                &twelve,
                &[0x01, 0xe0, 0xff, 0x55, 0xa5, 0xaa, 0x23, 0x01],
            ),
            // 0x001 is 00 and 01, 0x3fe is ff and 10, 0x155 is 55 and 01, 0x2aa is aa and 10, 0x300 is c0 and 00.
            (
                "Mono10Packed",
                &ten,
                &[0x00, 0x21, 0xff, 0x55, 0x21, 0xaa, 0xc0, 0x00],
            ),
            (
                "Mono12Packed",
                &twelve,
                &[0x00, 0xe1, 0xff, 0x55, 0xa5, 0xaa, 0x12, 0x03],
            ),
        ];
        for (name, expected, bytes) in cases {
            let format = named(name);
            let found = format.unpack(bytes.to_vec(), 5).unwrap();
            let found: Vec<u16> = match found {
                Pixels::U8(pixels) => pixels.into_iter().map(u16::from).collect(),
                Pixels::U16(pixels) => pixels,
            };
            assert_eq!(found, expected, "{name}");
            // Bytes after the picture do not belong to it, and a part of a picture is refused.
            let followed = [bytes, &[0xff; 4]].concat();
            assert_eq!(format.unpack(followed, 5).unwrap().len(), 5, "{name}");
            let short = bytes[..bytes.len() - 1].to_vec();
            assert!(format.unpack(short, 5).is_none(), "{name}");
        }
    }

    #[test]
    fn packed_pixels_that_fill_their_bytes_come_back_from_a_plain_packer() {
        let pixels: Vec<u16> = (0..400).map(|n: u16| n.wrapping_mul(2_654)).collect();
        for (name, bits) in [("Mono10p", 10), ("Mono12p", 12)] {
            let pixels: Vec<u16> = pixels.iter().map(|dn| dn & ((1 << bits) - 1)).collect();
            let mut bytes = vec![0_u8; pixels.len() * bits / 8];
            for (n, dn) in pixels.iter().enumerate() {
                for k in 0..bits {
                    let at = n * bits + k;
                    bytes[at / 8] |= ((dn >> k & 1) as u8) << (at % 8);
                }
            }
            let found = named(name).unpack(bytes, pixels.len());
            assert_eq!(found, Some(Pixels::U16(pixels)), "{name}");
        }
    }

    #[test]
    fn the_numbers_of_formats_give_the_bits_that_a_pixel_takes() {
        for format in FORMATS {
            // In the convention's numbers the third byte is the size of a pixel in bits.
            let bits = (format.code >> 16 & 0xff) as usize;
            assert_eq!(format.bytes(8), bits, "{}", format.name);
            assert_eq!(MonoFormat::of_code(format.code), Some(format));
        }
        // RGB8.
        assert_eq!(MonoFormat::of_code(0x0218_0014), None);
    }

    #[test]
    fn formats_of_a_depth_are_tried_from_the_plainest_on() {
        let names = |depth| MonoFormat::of_depth(depth).map(|format| format.name);
        assert_eq!(names(PixelFormat::Mono8).collect::<Vec<_>>(), ["Mono8"]);
        assert_eq!(
            names(PixelFormat::Mono12).collect::<Vec<_>>(),
            ["Mono12", "Mono12p", "Mono12Packed"]
        );
        for depth in PixelFormat::KINDS {
            assert!(names(depth).next().is_some(), "{depth:?}");
        }
    }

    #[test]
    fn full_scale_follows_from_the_format_and_of_16_bits_from_those_that_are_used() {
        let pixels = |dn: &[u16]| Pixels::U16(dn.to_vec());
        let dark = pixels(&[3, 17]);
        for (name, expected) in [("Mono10p", 1023), ("Mono12", 4095), ("Mono12Packed", 4095)] {
            assert_eq!(named(name).saturation_dn(&dark, Some(65_535)), expected);
        }
        let eight = Pixels::U8(vec![255]);
        assert_eq!(named("Mono8").saturation_dn(&eight, None), 255);
        let sixteen = |dn: &[u16], stated| named("Mono16").saturation_dn(&pixels(dn), stated);
        assert_eq!(sixteen(&[3, 17], None), 65_535);
        assert_eq!(sixteen(&[3, 17], Some(4095)), 4095);
        // Pixels that contradict the stated largest number.
        assert_eq!(sixteen(&[3, 4096], Some(4095)), 65_535);
        // Twelve bits, aligned to the left.
        assert_eq!(sixteen(&[0x10, 0xfff0], Some(4095)), 0xfff0);
    }
}
