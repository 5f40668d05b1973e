//! The file of values set by command: how it is recognised, and which other files may not be in its place.

/// How the file begins; a checksum follows.
pub const HEADER: &str = "# solaspect: values set by command. crc32 ";

/// The largest such file, bytes.
pub const LARGEST: u64 = 1 << 20;

/// One in so many bytes of the head may be wrong: disks do that, and no other file begins like this.
const LIKE: usize = 8;

/// Whether a file that begins so is one of saved values, whole or damaged: a file of anything else is neither set aside nor replaced.
/// A disk may leave an empty file, or one of zeros, of such a file.
pub fn is_ours(bytes: &[u8]) -> bool {
    if bytes.iter().all(|byte| *byte == 0) {
        return true;
    }
    let head = HEADER.bytes().zip(bytes);
    let compared = head.clone().count();
    let wrong = head.filter(|(ours, found)| ours != *found).count();
    wrong * LIKE <= compared
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_of_saved_values_is_known_by_its_head_cut_or_damaged_and_no_other_is() {
        let whole = format!("{HEADER}00000000\n\"store.roll\" = 0\n").into_bytes();
        for length in 0..whole.len() {
            assert!(is_ours(&whole[..length]), "the first {length} bytes");
        }
        for bit in 0..8 * whole.len() {
            let mut flipped = whole.clone();
            flipped[bit / 8] ^= 1 << (bit % 8);
            assert!(is_ours(&flipped), "bit {bit}");
        }
        assert!(is_ours(&[0; 4096]));
        for other in [
            &b"# the flight's configuration\n[camera]\n"[..],
            b"[camera]\nsource = \"simulated\"\n",
            b"SIMPLE  =                    T",
            b"\xFF\xFE",
            b"x",
        ] {
            assert!(!is_ours(other), "{}", other.escape_ascii());
        }
    }
}
