//! CHECKSUM and DATASUM (FITS 4.0, section 4.4.2.7 and appendix J): ones'-complement sums of 32-bit words.

use super::structure::{BLOCK, Hdu};
use super::{Header, Problem, Value};
use multiversion::multiversion;

/// Checksums of a sound file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Checksums {
    /// HDUs in the file.
    pub hdus: usize,
    /// Number of these that have both CHECKSUM and DATASUM.
    pub guarded: usize,
}

/// Checks every checksum of a file, and that no bytes follow which no checksum covers.
pub(super) fn check_all(bytes: &[u8], hdus: &[Hdu]) -> Result<Checksums, Problem> {
    for (n, hdu) in hdus.iter().enumerate() {
        let data = data_sum(bytes, hdu);
        check_data_sum(hdu, data)?;
        let header = sum(&bytes[hdu.header_bytes.start..hdu.data_bytes.start]);
        let found = added(header, data);
        if hdu.header.get("CHECKSUM").is_some() && found != 0 && found != u32::MAX {
            let expected = format!("HDU {n} as it was written");
            return Err(Problem::field("CHECKSUM", expected, "changed bytes"));
        }
    }
    let end = hdus.last().map_or(0, |hdu| hdu.bytes(bytes.len()).end);
    if end < bytes.len() {
        let found = format!("{} more bytes", bytes.len() - end);
        let expected = format!("the end of the file, or XTENSION, at byte {end}");
        return Err(Problem::content(expected, found));
    }
    let guarded = |header: &Header| {
        ["CHECKSUM", "DATASUM"]
            .iter()
            .all(|keyword| header.get(keyword).is_some())
    };
    Ok(Checksums {
        hdus: hdus.len(),
        guarded: hdus.iter().filter(|hdu| guarded(&hdu.header)).count(),
    })
}

/// Checks the sum of an HDU's data, if its header states one.
pub(super) fn check_data(bytes: &[u8], hdu: &Hdu) -> Result<(), Problem> {
    match hdu.header.get("DATASUM") {
        Some(_) => check_data_sum(hdu, data_sum(bytes, hdu)),
        None => Ok(()),
    }
}

/// The sum of an HDU's data with the fill of their last block.
fn data_sum(bytes: &[u8], hdu: &Hdu) -> u32 {
    let end = hdu.bytes(bytes.len()).end.max(hdu.data_bytes.start);
    sum(&bytes[hdu.data_bytes.start..end])
}

/// Compares the sum of an HDU's data with the one that its header states, if any.
fn check_data_sum(hdu: &Hdu, found: u32) -> Result<(), Problem> {
    let stated: u32 = match hdu.header.get("DATASUM") {
        None => return Ok(()),
        Some(Value::Text(text)) => text.trim().parse().ok(),
        Some(Value::Integer(number)) => u32::try_from(*number).ok(),
        Some(_) => None,
    }
    .ok_or_else(|| Problem::field("DATASUM", "a sum of 32 bits", "something else"))?;
    // Both are zero in ones' complement.
    let same = stated == found || [stated, found].iter().all(|s| matches!(*s, 0 | u32::MAX));
    if same {
        return Ok(());
    }
    let expected = format!("data with the sum {stated}, as they were written");
    Err(Problem::field("DATASUM", expected, found))
}

/// The sum of big-endian words, with each carry added at the low end. An incomplete last word is padded
/// with zeros.
#[multiversion(targets("x86_64+avx2"))]
pub(super) fn sum(bytes: &[u8]) -> u32 {
    let (words, rest) = bytes.as_chunks::<4>();
    let mut last = [0; 4];
    last[..rest.len()].copy_from_slice(rest);
    // A file has far fewer than 2^32 words, so 64 bits hold the sum before the carries are folded in.
    let mut total = u64::from(u32::from_be_bytes(last));
    for word in words {
        total += u64::from(u32::from_be_bytes(*word));
    }
    while total > u64::from(u32::MAX) {
        total = (total & 0xFFFF_FFFF) + (total >> 32);
    }
    total as u32
}

/// The sum of two sums.
pub(super) fn added(a: u32, b: u32) -> u32 {
    let (sum, carry) = a.overflowing_add(b);
    sum + u32::from(carry)
}

/// A sum as 16 letters and digits, which add up to it at their place in a CHECKSUM card (appendix J.2).
pub(super) fn encoded(sum: u32) -> String {
    let mut characters = [0; 16];
    for (n, byte) in sum.to_be_bytes().into_iter().enumerate() {
        // Four characters that add up to the byte and four zeros.
        let mut parts = [byte / 4 + b'0'; 4];
        parts[0] += byte % 4;
        let is_sign = |c: u8| !c.is_ascii_alphanumeric();
        while parts.iter().any(|part| is_sign(*part)) {
            for pair in parts.chunks_exact_mut(2) {
                if pair.iter().any(|part| is_sign(*part)) {
                    pair[0] += 1;
                    pair[1] -= 1;
                }
            }
        }
        for (k, part) in parts.into_iter().enumerate() {
            // The text begins at byte 11 of its card: a word's last byte comes first.
            characters[(4 * k + n + 1) % 16] = part;
        }
    }
    characters.map(char::from).iter().collect()
}

const _: () = assert!(BLOCK.is_multiple_of(4));
