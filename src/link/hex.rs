//! Bytes as hexadecimal text.

/// Bytes in hexadecimal.
pub fn hex(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Bytes from hexadecimal; white space between them is ignored.
pub fn from_hex(text: &str) -> Option<Vec<u8>> {
    let digits: Vec<u8> = text.bytes().filter(|b| !b.is_ascii_whitespace()).collect();
    if !digits.len().is_multiple_of(2) || !digits.iter().all(u8::is_ascii_hexdigit) {
        return None;
    }
    let byte = |pair: &[u8]| u8::from_str_radix(str::from_utf8(pair).ok()?, 16).ok();
    digits.chunks_exact(2).map(byte).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hexadecimal_is_read_with_white_space_and_nothing_else() {
        assert_eq!(from_hex("9A c3\n01"), Some(vec![0x9A, 0xC3, 1]));
        assert_eq!(from_hex("9ac"), None);
        assert_eq!(from_hex("+1"), None);
        assert_eq!(from_hex("packets.bin"), None);
    }
}
