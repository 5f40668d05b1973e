//! Rice compression as FITS 4.0 (section 10.4.1) describes it: differences of neighbouring pixels, in blocks, each
//! with its own number of low bits.
//!
//! A stream begins with its first pixel, not compressed. Each difference d between neighbours is folded to a number without a sign: 2 d, or
//! -2 d - 1 where d is negative. All but its low k bits are counted by zeros, which a 1 bit ends; the low k bits follow as they are. Each block states its k.
//! Two more values of k say that all differences of the block are zero, and that they are not compressed.

use multiversion::multiversion;
use std::borrow::Cow;

/// How the numbers of a Rice stream are laid out.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Rice {
    /// Pixels in a block.
    pub block: usize,
    /// Bytes of a number before compression.
    pub width: Width,
}

/// Bytes of a number: without a sign where it is 1, with a sign where they are 2 or 4.
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
    let mut bits = Bits { stream, at: 0 };
    let mut last = bits.take(8 * rice.width.bytes() as u32);
    for block in pixels.chunks_mut(rice.block) {
        bits.block(rice.width, block)?;
    }
    // In passes of their own, so that the compiler makes all but the sums side by side.
    for pixel in &mut *pixels {
        let folded = *pixel as u32;
        // Even numbers stand for what is not negative, odd ones for what is.
        *pixel = ((folded >> 1) ^ (folded & 1).wrapping_neg()) as i32;
    }
    for pixel in &mut *pixels {
        last = last.wrapping_add(*pixel as u32);
        *pixel = last as i32;
    }
    match rice.width {
        Width::One => pixels
            .iter_mut()
            .for_each(|bits| *bits = i32::from(*bits as u8)),
        Width::Two => pixels
            .iter_mut()
            .for_each(|bits| *bits = i32::from(*bits as i16)),
        Width::Four => {}
    }
    (bits.at <= 8 * stream.len()).then_some(())
}

/// Pixels of a block that is written.
pub(super) const BLOCK: usize = 32;

/// A stream needs no more bytes than these and, for each pixel, one more than the pixel has: the first pixel, what ends the last byte, and the 8 bytes
/// that each [`Writer::put`] stores. There are fewer than four zeros a pixel, because k follows the block's mean.
const OVERHEAD_BYTES: usize = 16;

/// A pixel as a file holds it.
pub(super) trait StoredPixel: Copy {
    const WIDTH: Width;

    /// The number that is stored, as its bits.
    fn stored(self) -> u32;

    /// The bytes of the numbers that are stored, the highest of each first.
    fn bytes(row: &[Self]) -> Cow<'_, [u8]>;

    /// The folded difference from the pixel before.
    fn folded(self, before: Self) -> u32;
}

impl StoredPixel for u8 {
    const WIDTH: Width = Width::One;

    fn stored(self) -> u32 {
        self.into()
    }

    fn bytes(row: &[Self]) -> Cow<'_, [u8]> {
        row.into()
    }

    fn folded(self, before: Self) -> u32 {
        let difference = self.wrapping_sub(before) as i8;
        ((difference << 1) ^ (difference >> 7)) as u8 as u32
    }
}

impl StoredPixel for u16 {
    const WIDTH: Width = Width::Two;

    /// FITS's 16 bits have a sign: what is stored is 32768 less.
    fn stored(self) -> u32 {
        (self ^ 0x8000).into()
    }

    fn bytes(row: &[Self]) -> Cow<'_, [u8]> {
        let bytes = row.iter().flat_map(|dn| (dn ^ 0x8000).to_be_bytes());
        bytes.collect::<Vec<u8>>().into()
    }

    fn folded(self, before: Self) -> u32 {
        let difference = self.wrapping_sub(before) as i16;
        ((difference << 1) ^ (difference >> 15)) as u16 as u32
    }
}

/// Makes streams of rows, in memory that all of them use.
pub(super) struct Encoder {
    folded: Vec<u32>,
    stream: Vec<u8>,
}

impl Encoder {
    /// For rows of so many pixels.
    pub fn new<T: StoredPixel>(pixels: usize) -> Self {
        Self {
            folded: vec![0; pixels],
            stream: vec![0; OVERHEAD_BYTES + pixels * (T::WIDTH.bytes() + 1)],
        }
    }

    /// The stream of a row, bit for bit as cfitsio writes it.
    pub fn encode<T: StoredPixel>(&mut self, row: &[T]) -> &[u8] {
        let bytes = encode(row, &mut self.folded, &mut self.stream);
        &self.stream[..bytes]
    }
}

#[multiversion(targets("x86_64+avx2+bmi1+bmi2+lzcnt"))]
fn encode<T: StoredPixel>(row: &[T], folded: &mut [u32], stream: &mut [u8]) -> usize {
    let Some(first) = row.first() else {
        return 0;
    };
    let folded = &mut folded[..row.len()];
    // The first pixel of a row has none before it.
    folded[0] = 0;
    for ((folded, pixel), before) in folded[1..].iter_mut().zip(&row[1..]).zip(row) {
        *folded = pixel.folded(*before);
    }
    let mut bits = Writer {
        out: stream,
        written: 0,
        window: 0,
        count: 0,
    };
    bits.put(first.stored().into(), 8 * T::WIDTH.bytes() as u32);
    let (blocks, rest) = folded.as_chunks();
    for block in blocks {
        bits.put_whole_block(block, T::WIDTH);
    }
    if !rest.is_empty() {
        bits.put_block(rest, T::WIDTH);
    }
    bits.finish()
}

/// Bits that become bytes, the highest of each byte first.
struct Writer<'a> {
    /// Room for all, and for a window behind it.
    out: &'a mut [u8],
    written: usize,
    /// The last `count` bits, below 8, that are no whole byte yet, from the top down.
    window: u64,
    count: u32,
}

/// Bits that are added at once, at most: seven more may wait in the window.
const MAX_PUT_BITS: u32 = 56;

impl Writer<'_> {
    /// Adds the low `bits`, at most [`MAX_PUT_BITS`], of a number that has no others.
    #[inline(always)]
    fn put(&mut self, number: u64, bits: u32) {
        self.count += bits;
        self.window |= number << (64 - self.count);
        // Without a branch: whether a byte is whole could not be foretold.
        self.out[self.written..self.written + 8].copy_from_slice(&self.window.to_be_bytes());
        let bytes = self.count / 8;
        self.written += bytes as usize;
        self.window <<= 8 * bytes;
        self.count %= 8;
    }

    #[inline(always)]
    fn put_whole_block(&mut self, folded: &[u32; BLOCK], width: Width) {
        let most = folded.iter().fold(0, |most, folded| most.max(*folded));
        let sum: u32 = folded.iter().sum();
        let low = low_bits(sum, BLOCK as u32);
        let longest = (most >> low) + 1 + low;
        let (parameter_bits, uncompressed) = width.parameter();
        if sum > 0 && low < uncompressed && longest <= MAX_PUT_BITS / 4 {
            self.put((low + 1).into(), parameter_bits);
            self.put_in_fours(folded, low);
        } else {
            self.put_block(folded, width);
        }
    }

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
        for folded in folded {
            self.put_zeros(folded >> low);
            self.put(code(*folded, low).into(), 1 + low);
        }
    }

    /// Four codes at a time, none longer than a quarter of what is added at once.
    #[inline(always)]
    fn put_in_fours(&mut self, folded: &[u32; BLOCK], low: u32) {
        // Side by side, before they are strung together.
        let (mut lengths, mut codes) = ([0; BLOCK], [0; BLOCK]);
        for ((length, one_code), folded) in lengths.iter_mut().zip(&mut codes).zip(folded) {
            *length = (folded >> low) + 1 + low;
            *one_code = code(*folded, low);
        }
        let (mut pair_lengths, mut pair_codes) = ([0; BLOCK / 2], [0; BLOCK / 2]);
        for n in 0..BLOCK / 2 {
            let [length, next] = [lengths[2 * n], lengths[2 * n + 1]];
            pair_lengths[n] = length + next;
            pair_codes[n] = codes[2 * n] << next | codes[2 * n + 1];
        }
        for n in 0..BLOCK / 4 {
            let [length, next] = [pair_lengths[2 * n], pair_lengths[2 * n + 1]];
            let code = u64::from(pair_codes[2 * n]) << next | u64::from(pair_codes[2 * n + 1]);
            self.put(code, length + next);
        }
    }

    fn put_zeros(&mut self, mut zeros: u32) {
        while zeros > 0 {
            let some = zeros.min(MAX_PUT_BITS);
            self.put(0, some);
            zeros -= some;
        }
    }

    /// How many bytes there are, the last filled with zeros.
    fn finish(self) -> usize {
        self.written + self.count.div_ceil(8) as usize
    }
}

/// A 1 bit and the low bits: what follows a folded difference's zeros.
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

/// Bits of a stream, the highest of each byte first; zeros behind its end.
struct Bits<'a> {
    stream: &'a [u8],
    /// The next bit.
    at: usize,
}

/// Bits of a window, whatever bit of a byte it begins with: 64 - 7.
const WINDOW_BITS: u32 = 57;

impl Bits<'_> {
    /// The next bits from the top down.
    #[inline(always)]
    fn window(&self) -> u64 {
        let first = self.at / 8;
        let bytes = match self.stream.get(first..first + 8) {
            Some(bytes) => bytes.try_into().unwrap_or_default(),
            None => self.last_bytes(first),
        };
        u64::from_be_bytes(bytes) << (self.at % 8)
    }

    #[cold]
    fn last_bytes(&self, first: usize) -> [u8; 8] {
        let mut bytes = [0; 8];
        let rest = self.stream.get(first..).unwrap_or_default();
        bytes[..rest.len()].copy_from_slice(rest);
        bytes
    }

    /// The next `count` bits, at most 32, as a number.
    #[inline(always)]
    fn take(&mut self, count: u32) -> u32 {
        let window = self.window();
        self.at += count as usize;
        window.checked_shr(64 - count).unwrap_or(0) as u32
    }

    /// Takes zeros up to the next 1 bit, and that bit; how many zeros. `None` where no 1 bit follows.
    fn zeros(&mut self) -> Option<u32> {
        let mut zeros = 0;
        while self.at < 8 * self.stream.len() {
            let run = self.window().leading_zeros();
            if run < WINDOW_BITS {
                self.at += run as usize + 1;
                return Some(zeros + run);
            }
            zeros += WINDOW_BITS;
            self.at += WINDOW_BITS as usize;
        }
        None
    }

    /// A block's folded differences.
    #[inline(always)]
    fn block(&mut self, width: Width, block: &mut [i32]) -> Option<()> {
        let (parameter_bits, uncompressed) = width.parameter();
        match self.take(parameter_bits).checked_sub(1) {
            None => block.fill(0),
            Some(low) if low > uncompressed => return None,
            Some(low) if low == uncompressed => {
                let full = 8 * width.bytes() as u32;
                block.fill_with(|| self.take(full) as i32);
            }
            // As many at a time as mostly stand in a window.
            Some(low @ 0..=4) => self.groups::<8>(low, block)?,
            Some(low @ 5..=10) => self.groups::<4>(low, block)?,
            Some(low) => self.one_by_one(low, block)?,
        }
        Some(())
    }

    #[inline(always)]
    fn groups<const N: usize>(&mut self, low: u32, block: &mut [i32]) -> Option<()> {
        let (groups, rest) = block.as_chunks_mut::<N>();
        for group in groups {
            if !self.group(low, group) {
                self.one_by_one(low, group)?;
            }
        }
        match rest {
            [] => Some(()),
            rest => self.one_by_one(low, rest),
        }
    }

    /// Folded differences of `low` low bits, at most 10, all from one window; whether they stood in it, and were taken.
    #[inline(always)]
    fn group<const N: usize>(&mut self, low: u32, group: &mut [i32; N]) -> bool {
        let one = 1 << low;
        let mut window = self.window();
        let mut bits = N as u32 * (low + 1);
        for folded in group {
            let zeros = window.leading_zeros();
            bits += zeros;
            // The 1 bit stands on top now, and counts as 2^low below.
            let code = window.wrapping_shl(zeros);
            *folded = ((zeros << low) + (code >> (63 - low)) as u32 - one) as i32;
            window = code << (low + 1);
        }
        // Asked once, not after each: that takes half as long.
        let were_in_it = bits <= WINDOW_BITS;
        if were_in_it {
            self.at += bits as usize;
        }
        were_in_it
    }

    /// The plain twin of [`Self::group`]: zeros up to a 1 bit count how often 2^`low` goes into a folded difference, and `low` bits, at most 24, tell the
    /// rest.
    fn one_by_one(&mut self, low: u32, block: &mut [i32]) -> Option<()> {
        for folded in block {
            *folded = (self.zeros()?.wrapping_shl(low) | self.take(low)) as i32;
        }
        Some(())
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
    fn plainly_encoded<T: StoredPixel>(row: &[T]) -> Vec<u8> {
        let mut bits: Vec<u8> = Vec::new();
        let mut put = |number: u32, count: u32| {
            bits.extend((0..count).rev().map(|n| (number >> n & 1) as u8));
        };
        let (parameter_bits, uncompressed) = T::WIDTH.parameter();
        let full = 8 * T::WIDTH.bytes() as u32;
        put(row[0].stored(), full);
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
        fn check<T: StoredPixel + PartialEq + std::fmt::Debug>(
            row: &[T],
            number: impl Fn(T) -> i32,
        ) {
            let mut encoder = Encoder::new::<T>(row.len());
            let stream = encoder.encode(row);
            assert_eq!(stream, plainly_encoded(row), "{row:?}");
            let mut numbers = vec![0; row.len()];
            let rice = Rice {
                block: BLOCK,
                width: T::WIDTH,
            };
            rice.decode(stream, &mut numbers).unwrap();
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
    fn a_group_is_read_as_one_by_one() {
        fn check<const N: usize>(stream: &[u8], low: u32) {
            let mut fast = Bits { stream, at: 0 };
            let mut plain = Bits { stream, at: 0 };
            let (mut together, mut apart) = ([0; N], [0; N]);
            while plain.one_by_one(low, &mut apart).is_some() {
                let begin = fast.at;
                if fast.group(low, &mut together) {
                    assert_eq!((together, fast.at), (apart, plain.at));
                } else {
                    assert_eq!(fast.at, begin);
                    assert!(plain.at - begin > WINDOW_BITS as usize || plain.at > 8 * stream.len());
                    fast.at = plain.at;
                }
            }
            assert!(!fast.group(low, &mut together) || fast.at > 8 * stream.len());
        }
        // Long runs of zeros, short ones, and ones.
        for spacing in [1, 2, 3, 5, 9, 17, 60] {
            let bits = (0..4000).map(|n| if n * n % 61 % spacing == 0 { '1' } else { '0' });
            let stream = stream(&[], &bits.collect::<String>());
            for low in 0..=10 {
                check::<4>(&stream, low);
                check::<8>(&stream, low);
            }
        }
    }

    #[test]
    fn a_stream_that_ends_too_soon_is_none() {
        assert_eq!(decoded::<4>(Width::One, &[]), None);
        assert_eq!(decoded::<4>(Width::One, &[7]), None);
        assert_eq!(decoded::<4>(Width::Two, &[7, 0, 0x20, 0, 0]), None);
    }
}
