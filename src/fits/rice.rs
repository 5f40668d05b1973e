//! Rice compression as FITS 4.0 (section 10.4.1) describes it: differences of neighbouring pixels, in blocks, each
//! with its own number of low bits.
//!
//! A stream begins with its first pixel in full. A difference is folded: what is not negative is doubled, what is negative follows the
//! even numbers between. Of a folded difference all but the low bits are told by as many zeros and a one. How many bits are low depends on the
//! block's mean; a block that would not shrink has its differences in full, one without any difference is a parameter alone.

use multiversion::multiversion;

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
        decode(self, stream, pixels)
    }
}

/// As [`Rice::decode`]; shifts by what a register holds are one instruction where the processor has them.
#[multiversion(targets("x86_64+avx2+bmi1+bmi2+lzcnt"))]
fn decode(rice: Rice, stream: &[u8], pixels: &mut [i32]) -> Option<()> {
    let Rice { block, width } = rice;
    let mut bits = Bits::new(stream);
    let full = 8 * width.bytes() as u32;
    let (parameter_bits, uncompressed) = width.parameter();
    let mut last = bits.take(full)?;
    for block in pixels.chunks_mut(block) {
        match bits.take(parameter_bits)?.checked_sub(1) {
            None => block.fill(0),
            Some(low) if low < uncompressed => bits.folded(low, block)?,
            Some(_) => {
                for pixel in &mut *block {
                    *pixel = bits.take(full)? as i32;
                }
            }
        }
        match width {
            Width::One => last = unfold(block, last, |bits| i32::from(bits as u8)),
            Width::Two => last = unfold(block, last, |bits| i32::from(bits as i16)),
            Width::Four => last = unfold(block, last, |bits| bits as i32),
        }
    }
    Some(())
}

/// From folded differences to the pixels behind `last`; the last of these. `number` is what the low bits stand for.
#[inline(always)]
fn unfold(block: &mut [i32], mut last: u32, number: impl Fn(u32) -> i32) -> u32 {
    // Side by side, before they are added up.
    for pixel in &mut *block {
        let folded = *pixel as u32;
        // Even numbers stand for what is not negative, odd ones for what is.
        *pixel = ((folded >> 1) ^ (folded & 1).wrapping_neg()) as i32;
    }
    for pixel in block {
        last = last.wrapping_add(*pixel as u32);
        *pixel = number(last);
    }
    last
}

/// Pixels of a block that is written.
pub(super) const BLOCK: usize = 32;

/// A stream needs no more bytes than these, and for each pixel one more than the pixel has: a block's mean chooses the low bits so that the
/// zeros are fewer than four a pixel.
const MOST_BYTES: usize = 16;

/// A pixel as Rice takes it.
pub(super) trait Folded: Copy {
    const WIDTH: Width;

    /// The number that a stream begins with.
    fn first(self) -> u32;

    /// The folded difference from the pixel before.
    fn folded(self, before: Self) -> u32;
}

impl Folded for u8 {
    const WIDTH: Width = Width::One;

    fn first(self) -> u32 {
        self.into()
    }

    fn folded(self, before: Self) -> u32 {
        let difference = self.wrapping_sub(before) as i8;
        ((difference << 1) ^ (difference >> 7)) as u8 as u32
    }
}

impl Folded for u16 {
    const WIDTH: Width = Width::Two;

    /// FITS's 16 bits have a sign: what is stored is 32768 less.
    fn first(self) -> u32 {
        (self ^ 0x8000).into()
    }

    fn folded(self, before: Self) -> u32 {
        let difference = self.wrapping_sub(before) as i16;
        ((difference << 1) ^ (difference >> 15)) as u16 as u32
    }
}

/// Adds a row of pixels to `out` as a stream, bit for bit as cfitsio writes it.
#[multiversion(targets("x86_64+avx2+bmi1+bmi2+lzcnt"))]
pub(super) fn encode<T: Folded>(row: &[T], out: &mut Vec<u8>) {
    let Some(first) = row.first() else {
        return;
    };
    let start = out.len();
    out.resize(start + MOST_BYTES + row.len() * (T::WIDTH.bytes() + 1), 0);
    let mut bits = Writer {
        out: &mut out[start..],
        written: 0,
        window: 0,
        count: 0,
    };
    bits.put(first.first().into(), 8 * T::WIDTH.bytes() as u32);
    for begin in (0..row.len()).step_by(BLOCK) {
        let block = &row[begin..row.len().min(begin + BLOCK)];
        // The first pixel of a row differs from itself.
        let before = if begin == 0 { row } else { &row[begin - 1..] };
        let mut folded = [0; BLOCK];
        match (block.try_into(), before.first_chunk()) {
            (Ok(block), Some(before)) if begin > 0 => fold::<T>(block, before, &mut folded),
            _ => {
                for (n, folded) in folded[..block.len()].iter_mut().enumerate() {
                    let at = begin + n;
                    *folded = row[at].folded(row[at.saturating_sub(1)]);
                }
            }
        }
        bits.put_block(&folded[..block.len()], T::WIDTH);
    }
    let written = bits.finish();
    out.truncate(start + written);
}

/// Folds a block side by side.
#[inline(always)]
fn fold<T: Folded>(block: &[T; BLOCK], before: &[T; BLOCK], folded: &mut [u32; BLOCK]) {
    for (folded, (pixel, before)) in folded.iter_mut().zip(block.iter().zip(before)) {
        *folded = pixel.folded(*before);
    }
}

/// Bits that become bytes, the highest of each byte first.
struct Writer<'a> {
    /// Room for all.
    out: &'a mut [u8],
    written: usize,
    /// The last `count` bits, below 32, are not yet bytes.
    window: u64,
    count: u32,
}

impl Writer<'_> {
    /// Adds the low `bits`, at most 32, of a number that has no others.
    #[inline(always)]
    fn put(&mut self, number: u64, bits: u32) {
        self.window = self.window << bits | number;
        self.count += bits;
        if self.count >= 32 {
            self.count -= 32;
            let whole = (self.window >> self.count) as u32;
            self.out[self.written..self.written + 4].copy_from_slice(&whole.to_be_bytes());
            self.written += 4;
        }
    }

    #[inline(always)]
    fn put_block(&mut self, folded: &[u32], width: Width) {
        let (parameter_bits, uncompressed) = width.parameter();
        let sum: u32 = folded.iter().sum();
        if sum == 0 {
            return self.put(0, parameter_bits);
        }
        let low = low_bits(sum, folded.len() as u32);
        if low >= uncompressed {
            self.put(u64::from(uncompressed) + 1, parameter_bits);
            let full = 8 * width.bytes() as u32;
            return folded
                .iter()
                .for_each(|folded| self.put((*folded).into(), full));
        }
        self.put(u64::from(low) + 1, parameter_bits);
        let most = folded.iter().fold(0, |most, folded| most.max(*folded));
        // Two codes at a time where none is longer than 16 bits.
        if let (Ok(folded), 0..=16) = (folded.try_into(), (most >> low) + 1 + low) {
            return self.put_pairs(folded, low);
        }
        for folded in folded {
            self.put_zeros(folded >> low);
            self.put(code(*folded, low).into(), 1 + low);
        }
    }

    #[inline(always)]
    fn put_pairs(&mut self, folded: &[u32; BLOCK], low: u32) {
        // Side by side, before they are strung together.
        let (mut lengths, mut codes) = ([0; BLOCK], [0; BLOCK]);
        for ((length, one_code), folded) in lengths.iter_mut().zip(&mut codes).zip(folded) {
            *length = (folded >> low) + 1 + low;
            *one_code = code(*folded, low);
        }
        let pairs = codes
            .as_chunks::<2>()
            .0
            .iter()
            .zip(lengths.as_chunks::<2>().0);
        for ([a, b], [a_length, b_length]) in pairs {
            self.put(u64::from(a << b_length | b), a_length + b_length);
        }
    }

    fn put_zeros(&mut self, mut zeros: u32) {
        while zeros > 0 {
            let some = zeros.min(32);
            self.put(0, some);
            zeros -= some;
        }
    }

    /// Fills the last byte with zeros; how many bytes there are.
    fn finish(self) -> usize {
        let rest = (self.window << (32 - self.count)) as u32;
        let bytes = self.count.div_ceil(8) as usize;
        self.out[self.written..self.written + bytes].copy_from_slice(&rest.to_be_bytes()[..bytes]);
        self.written + bytes
    }
}

/// A one and the low bits: what follows a folded difference's zeros.
#[inline(always)]
fn code(folded: u32, low: u32) -> u32 {
    let one = 1 << low;
    one | folded & (one - 1)
}

/// How many bits of a block are low, by the sum of its folded differences.
fn low_bits(sum: u32, pixels: u32) -> u32 {
    let mean = sum.saturating_sub(pixels / 2 + 1) / pixels;
    u32::BITS - (mean >> 1).leading_zeros()
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
    #[inline(always)]
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

    /// A block of folded differences: zeros up to a one say how often 2^`low` goes into each, and `low` bits, at most 25, the rest.
    #[inline(always)]
    fn folded(&mut self, low: u32, block: &mut [i32]) -> Option<()> {
        let one = 1 << low;
        for pixel in block {
            if self.count < 32 {
                self.fill();
            }
            let zeros = self.window.leading_zeros();
            let used = zeros + 1 + low;
            if used > self.count {
                *pixel = self.long(low)? as i32;
                continue;
            }
            // The one stands on top now, and counts as 2^low below.
            let code = self.window << zeros;
            let rest = (code >> (63 - low)) as u32;
            *pixel = ((zeros << low) + rest - one) as i32;
            self.window = code << (low + 1);
            self.count -= used;
        }
        Some(())
    }

    /// A folded difference that is not whole in the window.
    #[cold]
    fn long(&mut self, low: u32) -> Option<u32> {
        Some(self.zeros()?.wrapping_shl(low) | self.take(low)?)
    }

    /// The next `count` bits, at most 32, as a number.
    #[inline(always)]
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

    /// The same by single bits, as the standard tells it.
    fn plainly_encoded<T: Folded>(row: &[T]) -> Vec<u8> {
        let mut bits: Vec<u8> = Vec::new();
        let mut put = |number: u32, count: u32| {
            bits.extend((0..count).rev().map(|n| (number >> n & 1) as u8));
        };
        let (parameter_bits, uncompressed) = T::WIDTH.parameter();
        let full = 8 * T::WIDTH.bytes() as u32;
        put(row[0].first(), full);
        let before = |n: usize| row[n.saturating_sub(1)];
        let folded: Vec<u32> = (0..row.len()).map(|n| row[n].folded(before(n))).collect();
        for block in folded.chunks(BLOCK) {
            let (sum, pixels) = (f64::from(block.iter().sum::<u32>()), block.len() as f64);
            let mean = ((sum - (pixels / 2.0).floor() - 1.0) / pixels).max(0.0) as u32;
            let mut low = 0;
            while mean >> 1 >> low > 0 {
                low += 1;
            }
            if low >= uncompressed {
                put(uncompressed + 1, parameter_bits);
                block.iter().for_each(|folded| put(*folded, full));
            } else if sum == 0.0 {
                put(0, parameter_bits);
            } else {
                put(low + 1, parameter_bits);
                for folded in block {
                    (0..folded >> low).for_each(|_| put(0, 1));
                    put(1, 1);
                    put(folded & ((1 << low) - 1), low);
                }
            }
        }
        let byte = |bits: &[u8]| (0..8).fold(0, |n, k| n << 1 | bits.get(k).unwrap_or(&0));
        bits.chunks(8).map(byte).collect()
    }

    /// Rows of every roughness: still, noisy, with spikes, wild; and of lengths that end a block anywhere.
    fn rows(most: u32) -> impl Iterator<Item = Vec<u32>> {
        let mut state = 7_u64;
        let mut random = move || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            (state >> 33) as u32
        };
        (0..400).map(move |n| {
            let (noise, length) = (1 << (n % 17), 1 + n % 131);
            let pixel = |k: u32, random: u32| match n % 5 {
                0 if random.is_multiple_of(40) => random % (most + 1),
                _ => (most / 3 + random % noise + k / 20) % (most + 1),
            };
            (0..length).map(|k| pixel(k, random())).collect()
        })
    }

    #[test]
    fn a_row_is_encoded_as_by_single_bits_and_decoded_to_what_it_was() {
        fn check<T: Folded + PartialEq + std::fmt::Debug>(row: &[T], number: impl Fn(T) -> i32) {
            let mut stream = Vec::new();
            encode(row, &mut stream);
            assert_eq!(stream, plainly_encoded(row), "{row:?}");
            let mut numbers = vec![0; row.len()];
            let rice = Rice {
                block: BLOCK,
                width: T::WIDTH,
            };
            rice.decode(&stream, &mut numbers).unwrap();
            let expected: Vec<i32> = row.iter().map(|pixel| number(*pixel)).collect();
            assert_eq!(numbers, expected);
        }
        for row in rows(255) {
            let row: Vec<u8> = row.into_iter().map(|dn| dn as u8).collect();
            check(&row, i32::from);
        }
        for row in rows(65_535) {
            let row: Vec<u16> = row.into_iter().map(|dn| dn as u16).collect();
            check(&row, |dn| i32::from(dn) - 32_768);
        }
    }

    #[test]
    fn a_stream_that_ends_too_soon_is_none() {
        assert_eq!(decoded::<4>(Width::One, &[]), None);
        assert_eq!(decoded::<4>(Width::One, &[7]), None);
        assert_eq!(decoded::<4>(Width::Two, &[7, 0, 0x20, 0, 0]), None);
    }
}
