//! Rice compression as in FITS 4.0 (section 10.4.1): differences of neighbouring pixels, in blocks, each
//! with its own number of low bits.
//!
//! A stream begins with its first pixel, not compressed. Each difference d between neighbours is folded to an unsigned number: 2 d, or
//! -2 d - 1 if d is negative. All except its low k bits are coded as that number of zeros, ended by a 1 bit; the low k bits follow unchanged. Each
//! block states its k. Two more values of k mean that all differences of the block are zero, and that they are not compressed.

use multiversion::multiversion;
use std::borrow::Cow;
use std::mem;
use std::sync::LazyLock;

/// Layout of the numbers of a Rice stream.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Rice {
    /// Pixels in a block.
    pub block: usize,
    /// Bytes of a number before compression.
    pub width: Width,
}

/// Bytes of a number: unsigned for 1, signed for 2 or 4.
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

    /// Mask of the bits of a number.
    fn mask(self) -> u32 {
        u32::MAX >> (u32::BITS - 8 * self.bytes() as u32)
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
    /// Fills `numbers` from a stream. `None` if the stream ends too soon.
    pub fn decode(self, stream: &[u8], numbers: &mut [i32]) -> Option<()> {
        match self.width {
            Width::One => decode(self, stream, numbers, |bits| (bits as u8).into()),
            Width::Two => decode(self, stream, numbers, |bits| (bits as i16).into()),
            Width::Four => decode(self, stream, numbers, |bits| bits as i32),
        }
    }

    /// Fills `pixels` from a stream of numbers of their width.
    pub fn decode_pixels<T: StoredPixel>(self, stream: &[u8], pixels: &mut [T]) -> Option<()> {
        decode(self, stream, pixels, T::of_stored)
    }
}

/// Number of bits that hold most codes with few low bits.
const INDEX_BITS: u32 = 12;
/// Difference encoded by a code with these first bits; [`LONG`] if the code has more bits.
type Differences = [u32; 1 << INDEX_BITS];
/// Larger than the sum of the differences of a group.
const LONG: u32 = 1 << 20;

/// Tables for each number of low bits for which most codes are that short.
static OF_BYTES: LazyLock<Vec<Differences>> = LazyLock::new(|| differences(Width::One));
static OF_WORDS: LazyLock<Vec<Differences>> = LazyLock::new(|| differences(Width::Two));

fn differences(width: Width) -> Vec<Differences> {
    let difference = |low, index: usize| {
        let stream = &(index << (usize::BITS - INDEX_BITS)).to_be_bytes();
        let mut bits = Bits::of(stream, width);
        let folded = bits.one(low).filter(|_| bits.at <= INDEX_BITS as usize);
        folded.map_or(LONG, |folded| unfolded(folded) & width.mask())
    };
    let of_low = |low| std::array::from_fn(|index| difference(low, index));
    (0..width.parameter().1.min(8)).map(of_low).collect()
}

/// The difference that was folded: even numbers represent non-negative ones, odd numbers negative ones.
#[inline(always)]
fn unfolded(folded: u32) -> u32 {
    (folded >> 1) ^ (folded & 1).wrapping_neg()
}

/// As [`Rice::decode`]; `of` makes a number from the lowest bits. Variable shifts of a register are one instruction if the processor has them.
#[multiversion(targets("x86_64+avx2+bmi1+bmi2+lzcnt"))]
fn decode<T>(rice: Rice, stream: &[u8], numbers: &mut [T], of: impl Fn(u32) -> T) -> Option<()> {
    let tables: &[Differences] = match rice.width {
        Width::One => &OF_BYTES,
        Width::Two => &OF_WORDS,
        Width::Four => &[],
    };
    let mask = rice.width.mask();
    let (parameter_bits, uncompressed) = rice.width.parameter();
    let mut bits = Bits::of(stream, rice.width);
    bits.last = bits.take(8 * rice.width.bytes() as u32);
    for block in numbers.chunks_mut(rice.block) {
        let parameter = bits.take(parameter_bits);
        let low = parameter.wrapping_sub(1);
        let computed = |window: u64| {
            let zeros = window.leading_zeros();
            // The 1 bit is the highest now, and contributes 2^low below.
            let code = window.wrapping_shl(zeros) >> (63 - low);
            unfolded((zeros << low) + code as u32 - (1 << low)) & mask
        };
        // As many at a time as usually fit into a window.
        if let Some(table) = tables.get(low as usize) {
            let known = |window: u64| table[(window >> (u64::BITS - INDEX_BITS)) as usize];
            match low {
                0..=4 => bits.groups::<8, T>(low, mask, block, known, &of)?,
                _ => bits.groups::<4, T>(low, mask, block, known, &of)?,
            }
        } else if low < uncompressed.min(11) {
            bits.groups::<4, T>(low, mask, block, computed, &of)?;
        } else {
            bits = bits.one_by_one(parameter, block, &of)?;
        }
    }
    (bits.at <= 8 * stream.len()).then_some(())
}

/// Pixels of a block in streams that are written.
pub(super) const BLOCK: usize = 32;

/// A stream needs at most this many bytes plus, for each pixel, one more than the pixel has: for the first pixel, the end of the last byte, and the 8
/// bytes that each [`Writer::put`] stores. There are fewer than four zeros per pixel, because k follows the block's mean.
const OVERHEAD_BYTES: usize = 16;

/// A pixel in the form stored in a file.
pub(super) trait StoredPixel: Copy + Default + Into<u32> {
    const WIDTH: Width;

    /// The stored number, as its bits.
    fn stored(self) -> u32;

    /// The pixel whose stored number is in the lowest of these bits.
    fn of_stored(bits: u32) -> Self;

    /// The bytes of the stored numbers, the highest of each first.
    fn bytes(row: &[Self]) -> Cow<'_, [u8]>;

    /// The folded difference from the previous pixel.
    fn folded(self, before: Self) -> Self;

    /// Four numbers side by side, the first in the lowest bits.
    fn beside(four: [Self; 4]) -> u64;
}

impl StoredPixel for u8 {
    const WIDTH: Width = Width::One;

    fn stored(self) -> u32 {
        self.into()
    }

    fn of_stored(bits: u32) -> Self {
        bits as Self
    }

    fn bytes(row: &[Self]) -> Cow<'_, [u8]> {
        row.into()
    }

    fn folded(self, before: Self) -> Self {
        let difference = self.wrapping_sub(before) as i8;
        ((difference << 1) ^ (difference >> 7)) as Self
    }

    fn beside(four: [Self; 4]) -> u64 {
        u32::from_le_bytes(four).into()
    }
}

impl StoredPixel for u16 {
    const WIDTH: Width = Width::Two;

    /// The 16-bit numbers of FITS have a sign: the stored value is less by 32768.
    fn stored(self) -> u32 {
        (self ^ 0x8000).into()
    }

    fn of_stored(bits: u32) -> Self {
        bits as Self ^ 0x8000
    }

    fn bytes(row: &[Self]) -> Cow<'_, [u8]> {
        let bytes = row.iter().flat_map(|dn| (dn ^ 0x8000).to_be_bytes());
        bytes.collect::<Vec<u8>>().into()
    }

    fn folded(self, before: Self) -> Self {
        let difference = self.wrapping_sub(before) as i16;
        ((difference << 1) ^ (difference >> 15)) as Self
    }

    fn beside([a, b, c, d]: [Self; 4]) -> u64 {
        u64::from(a) | u64::from(b) << 16 | u64::from(c) << 32 | u64::from(d) << 48
    }
}

/// Makes streams of rows, in memory that is reused for each.
pub(super) struct Encoder<T> {
    folded: Vec<T>,
    /// Sum of the folded differences of each whole block.
    sums: Vec<u32>,
    fours: Fours,
    stream: Vec<u8>,
}

/// For each group of four pixels of whole blocks: the number of low bits, the four codes joined, and their length in bits.
struct Fours {
    low: Vec<u64>,
    codes: Vec<u64>,
    lengths: Vec<u32>,
}

impl<T: StoredPixel> Encoder<T> {
    /// An encoder for rows of this many pixels.
    pub fn new(pixels: usize) -> Self {
        let blocks = pixels / BLOCK;
        let fours = blocks * FOURS;
        Self {
            folded: vec![T::default(); pixels],
            sums: vec![0; blocks],
            fours: Fours {
                low: vec![0; fours],
                codes: vec![0; fours],
                lengths: vec![0; fours],
            },
            stream: vec![0; OVERHEAD_BYTES + pixels * (T::WIDTH.bytes() + 1)],
        }
    }

    /// The stream of a row, bit for bit as cfitsio writes it.
    pub fn encode(&mut self, row: &[T]) -> &[u8] {
        let bytes = encode(row, self);
        &self.stream[..bytes]
    }
}

/// Each step is a pass of its own over the row, so that the compiler vectorises it.
#[multiversion(targets("x86_64+avx2+bmi1+bmi2+lzcnt"))]
fn encode<T: StoredPixel>(row: &[T], encoder: &mut Encoder<T>) -> usize {
    let Some(first) = row.first() else {
        return 0;
    };
    let folded = &mut encoder.folded[..row.len()];
    // The first pixel of a row has no predecessor.
    folded[0] = T::default();
    for ((folded, pixel), before) in folded[1..].iter_mut().zip(&row[1..]).zip(row) {
        *folded = pixel.folded(*before);
    }
    let (blocks, rest) = folded.as_chunks::<BLOCK>();
    let (fours, _) = folded.as_chunks::<4>();
    let Fours {
        low,
        codes,
        lengths,
    } = &mut encoder.fours;
    let (low, _) = low.as_chunks_mut::<FOURS>();
    for ((block, sum), low) in blocks.iter().zip(&mut encoder.sums).zip(&mut *low) {
        *sum = block.iter().fold(0, |sum, folded| sum + (*folded).into());
        *low = [low_bits(*sum, BLOCK as u32).into(); FOURS];
    }
    let of_four = fours
        .iter()
        .zip(low.as_flattened())
        .zip(&mut *codes)
        .zip(&mut *lengths);
    for (((four, low), code), length) in of_four {
        (*code, *length) = strung(T::beside(*four), *low, T::WIDTH);
    }
    let mut bits = Writer {
        out: &mut encoder.stream,
        window: 0,
        count: 0,
    };
    bits.put(first.stored().into(), 8 * T::WIDTH.bytes() as u32);
    let (codes, _) = codes.as_chunks::<FOURS>();
    let (lengths, _) = lengths.as_chunks::<FOURS>();
    let strung = codes.iter().zip(lengths);
    for ((block, sum), strung) in blocks.iter().zip(&encoder.sums).zip(strung) {
        bits.put_whole_block(block, *sum, strung);
    }
    if !rest.is_empty() {
        bits.put_block(rest);
    }
    let left = bits.left();
    encoder.stream.len() - left
}

/// The joined codes of four folded differences with `low` low bits, and their length; invalid if the length is above [`MAX_PUT_BITS`].
#[inline(always)]
fn strung(four: u64, low: u64, width: Width) -> (u64, u32) {
    let bits = 8 * width.bytes() as u32;
    let (mut codes, mut length) = (0_u64, 0);
    for n in 0..4 {
        let folded = four >> (n * bits) & ((1 << bits) - 1);
        let bits = (folded >> low) + 1 + low;
        codes = codes.wrapping_shl(bits as u32) | code(folded, low);
        length += bits;
    }
    (codes, length as u32)
}

/// Writes bits to bytes, the highest of each byte first.
struct Writer<'a> {
    /// Space for all bytes, and for a window after them.
    out: &'a mut [u8],
    /// The last `count` bits, fewer than 8, that do not fill a byte yet, from the top down.
    window: u64,
    count: u32,
}

/// Most bits that are added at once: seven more may wait in the window.
const MAX_PUT_BITS: u32 = 56;
/// Groups of four pixels in a block.
const FOURS: usize = BLOCK / 4;

impl Writer<'_> {
    /// Adds the low `bits`, at most [`MAX_PUT_BITS`], of a number without higher bits.
    #[inline(always)]
    fn put(&mut self, number: u64, bits: u32) {
        self.count += bits;
        self.window |= number << (64 - self.count);
        // Without a branch: the processor could not predict whether a byte is complete.
        self.out[..8].copy_from_slice(&self.window.to_be_bytes());
        // Less than 8, so that the compiler needs no bounds check.
        let bytes = self.count / 8 % 8;
        self.out = &mut mem::take(&mut self.out)[bytes as usize..];
        self.window <<= 8 * bytes;
        self.count %= 8;
    }

    #[inline(always)]
    fn put_whole_block<T: StoredPixel>(
        &mut self,
        folded: &[T; BLOCK],
        sum: u32,
        (codes, lengths): (&[u64; FOURS], &[u32; FOURS]),
    ) {
        let low = low_bits(sum, BLOCK as u32);
        let (parameter_bits, uncompressed) = T::WIDTH.parameter();
        let longest = lengths.iter().fold(0, |most, length| most.max(*length));
        if sum == 0 || low >= uncompressed || longest > MAX_PUT_BITS {
            return self.put_block(folded);
        }
        self.put(u64::from(low) + 1, parameter_bits);
        for (codes, length) in codes.iter().zip(lengths) {
            self.put(*codes, *length);
        }
    }

    fn put_block<T: StoredPixel>(&mut self, folded: &[T]) {
        let (parameter_bits, uncompressed) = T::WIDTH.parameter();
        let folded = || folded.iter().map(|folded| u64::from((*folded).into()));
        let sum: u64 = folded().sum();
        if sum == 0 {
            return self.put(0, parameter_bits);
        }
        let low = low_bits(sum as u32, folded().len() as u32);
        if low >= uncompressed {
            self.put(u64::from(uncompressed) + 1, parameter_bits);
            let full = 8 * T::WIDTH.bytes() as u32;
            return folded().for_each(|folded| self.put(folded, full));
        }
        self.put(u64::from(low) + 1, parameter_bits);
        for folded in folded() {
            self.put_zeros((folded >> low) as u32);
            self.put(code(folded, low.into()), 1 + low);
        }
    }

    fn put_zeros(&mut self, mut zeros: u32) {
        while zeros > 0 {
            let some = zeros.min(MAX_PUT_BITS);
            self.put(0, some);
            zeros -= some;
        }
    }

    /// Bytes of the space that were not needed; zeros fill the last byte.
    fn left(self) -> usize {
        self.out.len() - self.count.div_ceil(8) as usize
    }
}

/// The part of a code after the zeros: a 1 bit and the low bits.
#[inline(always)]
fn code(folded: u64, low: u64) -> u64 {
    let one = 1 << low;
    one | folded & (one - 1)
}

/// Number of low bits of a block, by the sum of its folded differences.
fn low_bits(sum: u32, pixels: u32) -> u32 {
    let mean = sum.saturating_sub(pixels / 2 + 1) / pixels;
    u32::BITS - (mean >> 1).leading_zeros()
}

/// Reads the bits of a stream, the highest of each byte first; zeros after its end.
#[derive(Clone, Copy)]
struct Bits<'a> {
    stream: &'a [u8],
    /// Position of the next bit.
    at: usize,
    width: Width,
    /// The last number, as its bits.
    last: u32,
}

/// Number of valid bits of a window, whatever bit of a byte it begins with: 64 - 7.
const WINDOW_BITS: u32 = 57;
/// The bit after them.
const END: u64 = 1 << (u64::BITS - 1 - WINDOW_BITS);

impl<'a> Bits<'a> {
    fn of(stream: &'a [u8], width: Width) -> Self {
        Self {
            stream,
            at: 0,
            width,
            last: 0,
        }
    }

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
    fn last_bytes(self, first: usize) -> [u8; 8] {
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

    /// Takes zeros up to the next 1 bit, and that bit; returns the number of zeros. `None` if no 1 bit follows.
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

    /// The numbers of a block with `low` low bits, N at a time.
    #[inline(always)]
    fn groups<const N: usize, T>(
        &mut self,
        low: u32,
        mask: u32,
        block: &mut [T],
        difference: impl Fn(u64) -> u32,
        of: &impl Fn(u32) -> T,
    ) -> Option<()> {
        let (groups, rest) = block.as_chunks_mut::<N>();
        for group in groups {
            match self.group(low, group, &difference, of) {
                Some(last) => self.last = last & mask,
                None => *self = self.one_by_one(low + 1, group, of)?,
            }
        }
        if !rest.is_empty() {
            *self = self.one_by_one(low + 1, rest, of)?;
        }
        Some(())
    }

    /// Takes numbers whose codes all fit into one window; returns the last one, or `None` if they do not, or one of them is [`LONG`].
    #[inline(always)]
    fn group<const N: usize, T>(
        &mut self,
        low: u32,
        group: &mut [T; N],
        difference: &impl Fn(u64) -> u32,
        of: &impl Fn(u32) -> T,
    ) -> Option<u32> {
        // A 1 bit ends the window. It is gone if more bits were taken than the window held.
        let mut window = (self.window() | END) & END.wrapping_neg();
        let mut sum = self.last;
        for number in group {
            sum = sum.wrapping_add(difference(window));
            *number = of(sum);
            window = window.wrapping_shl(window.leading_zeros()) << (low + 1);
        }
        // Checked once, not after each number: that takes half as long.
        if sum >= LONG || window == 0 {
            return None;
        }
        self.at += (window.trailing_zeros() - END.trailing_zeros()) as usize;
        Some(sum)
    }

    /// The simple counterpart of [`Self::groups`], for a block with any parameter; returns the state after it. A copy, so that the compiler keeps the
    /// caller's in registers.
    #[inline(never)]
    fn one_by_one<T>(
        mut self,
        parameter: u32,
        numbers: &mut [T],
        of: &impl Fn(u32) -> T,
    ) -> Option<Self> {
        let uncompressed = self.width.parameter().1;
        for number in numbers {
            let folded = match parameter.checked_sub(1) {
                None => 0,
                Some(low) if low > uncompressed => return None,
                Some(low) if low == uncompressed => self.take(8 * self.width.bytes() as u32),
                Some(low) => self.one(low)?,
            };
            self.last = self.last.wrapping_add(unfolded(folded)) & self.width.mask();
            *number = of(self.last);
        }
        Some(self)
    }

    /// A folded difference: the number of zeros before a 1 bit is its quotient by 2^`low`, and `low` bits, at most 24, are the remainder.
    fn one(&mut self, low: u32) -> Option<u32> {
        Some(self.zeros()?.wrapping_shl(low) | self.take(low))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The first pixel's bytes, and then bits, in groups separated by blanks; the last byte is filled with zeros.
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

    /// The same, bit by bit as in the standard.
    fn plainly_encoded<T: StoredPixel>(row: &[T]) -> Vec<u8> {
        let mut bits: Vec<u8> = Vec::new();
        let mut put = |number: u32, count: u32| {
            bits.extend((0..count).rev().map(|n| (number >> n & 1) as u8));
        };
        let (parameter_bits, uncompressed) = T::WIDTH.parameter();
        let full = 8 * T::WIDTH.bytes() as u32;
        put(row[0].stored(), full);
        let before = |n: usize| row[n.saturating_sub(1)];
        let folded: Vec<u32> = (0..row.len())
            .map(|n| row[n].folded(before(n)).into())
            .collect();
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

    /// Rows of every roughness: constant, noisy, with spikes, random; and of lengths that end a block anywhere.
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
            let mut encoder = Encoder::new(row.len());
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

    /// The same as [`Rice::decode_pixels`], a number at a time.
    fn plainly_decoded<T: StoredPixel>(stream: &[u8], pixels: &mut [T]) -> Option<()> {
        let mut bits = Bits::of(stream, T::WIDTH);
        bits.last = bits.take(8 * T::WIDTH.bytes() as u32);
        for block in pixels.chunks_mut(BLOCK) {
            let parameter = bits.take(T::WIDTH.parameter().0);
            bits = bits.one_by_one(parameter, block, &T::of_stored)?;
        }
        (bits.at <= 8 * stream.len()).then_some(())
    }

    #[test]
    fn a_stream_is_decoded_as_one_by_one_whole_or_damaged() {
        fn check<T: StoredPixel + PartialEq + std::fmt::Debug>(stream: &[u8], pixels: usize) {
            let (block, width) = (BLOCK, T::WIDTH);
            let (mut fast, mut plain) = (vec![T::default(); pixels], vec![T::default(); pixels]);
            let decoded = Rice { block, width }.decode_pixels(stream, &mut fast);
            assert_eq!(decoded, plainly_decoded(stream, &mut plain));
            assert!(decoded.is_none() || fast == plain);
        }
        for row in rows(65_535) {
            let words: Vec<u16> = row.iter().map(|dn| *dn as u16).collect();
            let bytes: Vec<u8> = row.iter().map(|dn| *dn as u8).collect();
            check::<u8>(Encoder::new(row.len()).encode(&bytes), row.len());
            check::<u16>(Encoder::new(row.len()).encode(&words), row.len());
            check::<u8>(&bytes, row.len());
            check::<u16>(&bytes, row.len());
        }
    }

    #[test]
    fn a_stream_that_ends_too_soon_is_none() {
        assert_eq!(decoded::<4>(Width::One, &[]), None);
        assert_eq!(decoded::<4>(Width::One, &[7]), None);
        assert_eq!(decoded::<4>(Width::Two, &[7, 0, 0x20, 0, 0]), None);
    }
}
