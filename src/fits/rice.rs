//! Rice decompression as FITS 4.0 (section 10.4.1) describes it: differences of neighbouring pixels, in blocks, each
//! with its own number of low bits.

/// How the numbers of a Rice stream are laid out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Rice {
    /// Pixels in a block.
    pub block: usize,
    /// Bytes of a number before compression.
    pub width: Width,
}

/// Bytes of a number: unsigned where it is one, signed otherwise.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Width {
    One,
    Two,
    Four,
}

impl Width {
    pub fn bytes(self) -> usize {
        match self {
            Self::One => 1,
            Self::Two => 2,
            Self::Four => 4,
        }
    }

    /// The number in these low bits.
    fn number(self, bits: u32) -> i32 {
        match self {
            Self::One => i32::from(bits as u8),
            Self::Two => i32::from(bits as i16),
            Self::Four => bits as i32,
        }
    }

    /// Bits of a block's parameter, and its value for a block that is not compressed.
    fn parameter(self) -> (u32, u32) {
        match self {
            Self::One => (3, 6),
            Self::Two => (4, 14),
            Self::Four => (5, 25),
        }
    }
}

impl Rice {
    /// Fills `pixels` from a stream. `None` where the stream ends too soon.
    pub fn decode(self, stream: &[u8], pixels: &mut [i32]) -> Option<()> {
        let mut bits = Bits::new(stream);
        let full = 8 * self.width.bytes() as u32;
        let (parameter_bits, uncompressed) = self.width.parameter();
        let mut last = bits.take(full)?;
        let mut next = |folded: u32| {
            // Even numbers stand for what is not negative, odd ones for what is.
            last = last.wrapping_add((folded >> 1) ^ (folded & 1).wrapping_neg());
            self.width.number(last)
        };
        for block in pixels.chunks_mut(self.block) {
            match bits.take(parameter_bits)?.checked_sub(1) {
                None => block.fill(next(0)),
                Some(low) if low < uncompressed => {
                    for pixel in block {
                        *pixel = next(bits.folded(low)?);
                    }
                }
                Some(_) => {
                    for pixel in block {
                        *pixel = next(bits.take(full)?);
                    }
                }
            }
        }
        Some(())
    }
}

/// Bits of a stream, the highest of each byte first.
struct Bits<'a> {
    rest: &'a [u8],
    /// The next bits from the top down. Below the `count` that are ours stand bits of `rest`, or zeros.
    window: u64,
    count: u32,
}

impl<'a> Bits<'a> {
    fn new(stream: &'a [u8]) -> Self {
        Self {
            rest: stream,
            window: 0,
            count: 0,
        }
    }

    /// Takes in as many whole bytes as fit, at least 57 bits in all unless the stream ends.
    fn fill(&mut self) {
        if let Some(next) = self.rest.first_chunk() {
            self.window |= u64::from_be_bytes(*next) >> self.count;
            let bytes = (63 - self.count) / 8;
            self.rest = &self.rest[bytes as usize..];
            self.count += 8 * bytes;
            return;
        }
        while let (0..=56, Some((byte, rest))) = (self.count, self.rest.split_first()) {
            self.window |= u64::from(*byte) << (56 - self.count);
            self.count += 8;
            self.rest = rest;
        }
    }

    /// A folded difference: zeros up to a one say how often 2^`low` goes into it, and `low` bits, at most 25, the rest.
    fn folded(&mut self, low: u32) -> Option<u32> {
        if self.count < 32 {
            self.fill();
        }
        let zeros = self.window.leading_zeros();
        let used = zeros + 1 + low;
        if used > self.count {
            return Some(self.zeros()?.wrapping_shl(low) | self.take(low)?);
        }
        // In two steps each: a shift by all 64 bits is none.
        let rest = self.window << zeros << 1;
        self.window = rest << low;
        self.count -= used;
        Some(zeros << low | (rest >> 1 >> (63 - low)) as u32)
    }

    /// The next `count` bits, at most 32, as a number.
    fn take(&mut self, count: u32) -> Option<u32> {
        if self.count < count {
            self.fill();
        }
        self.count = self.count.checked_sub(count)?;
        let number = self.window.checked_shr(64 - count).unwrap_or(0);
        self.window <<= count;
        Some(number as u32)
    }

    /// Takes zeros up to the next one, and that one; how many zeros.
    fn zeros(&mut self) -> Option<u32> {
        let mut zeros = 0;
        loop {
            let run = self.window.leading_zeros();
            if run < self.count {
                // In two steps, for a run of 63.
                self.window = self.window << run << 1;
                self.count -= run + 1;
                return Some(zeros + run);
            }
            zeros += self.count;
            self.window = 0;
            self.count = 0;
            self.fill();
            if self.count == 0 {
                return None;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The first pixel's bytes, and then bits, which blanks may part; the last byte is filled with zeros.
    fn stream(first: &[u8], bits: &str) -> Vec<u8> {
        let bits: Vec<u8> = bits
            .bytes()
            .filter(|b| *b != b' ')
            .map(|b| b - b'0')
            .collect();
        let byte = |bits: &[u8]| (0..8).fold(0, |n, k| n << 1 | bits.get(k).unwrap_or(&0));
        [first, &bits.chunks(8).map(byte).collect::<Vec<_>>()].concat()
    }

    fn decoded<const N: usize>(width: Width, stream: &[u8]) -> Option<[i32; N]> {
        let mut pixels = [0; N];
        let rice = Rice { block: 4, width };
        rice.decode(stream, &mut pixels).map(|()| pixels)
    }

    #[test]
    fn a_block_with_parameter_zero_repeats_its_pixel() {
        let stream = stream(&[7], "000");
        assert_eq!(decoded(Width::One, &stream), Some([7; 4]));
    }

    #[test]
    fn differences_are_zeros_a_one_and_low_bits() {
        // No low bits: 0, +1, -1 and +2, folded to 0, 2, 1 and 4.
        let none = stream(&[7], "001 1 001 01 00001");
        assert_eq!(decoded(Width::One, &none), Some([7, 8, 7, 9]));
        // One low bit: +1, folded to 2.
        let one = stream(&[0xff, 0xfe], "0010 01 0");
        assert_eq!(decoded(Width::Two, &one), Some([-1]));
    }

    #[test]
    fn a_block_that_does_not_compress_has_its_differences_in_full() {
        // -7 and +1, folded to 13 and 2.
        let stream = stream(&[7], "111 00001101 00000010");
        assert_eq!(decoded(Width::One, &stream), Some([0, 1]));
    }

    #[test]
    fn each_block_has_its_own_parameter() {
        let stream = stream(&[7], "000 001 001 1");
        assert_eq!(decoded(Width::One, &stream), Some([7, 7, 7, 7, 8, 8]));
    }

    #[test]
    fn a_stream_that_ends_too_soon_is_none() {
        assert_eq!(decoded::<4>(Width::One, &[]), None);
        assert_eq!(decoded::<4>(Width::One, &[7]), None);
        assert_eq!(decoded::<4>(Width::Two, &[7, 0, 0x20, 0, 0]), None);
    }
}
