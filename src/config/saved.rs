//! The file of values set by command: its recognition among other files.

/// Beginning of the file; a checksum follows.
pub const HEADER: &str = "# solaspect: values set by command. crc32 ";

/// The largest such file, bytes.
pub const LARGEST: u64 = 1 << 20;

/// One in this many bytes of the beginning may be wrong: disks cause such errors, and no other file begins like this.
const LIKE: usize = 8;

/// Whether a file with this beginning is a file of saved values, intact or damaged: any other file is neither renamed nor replaced.
/// A disk may have left such a file empty, or filled with zeros.
pub fn is_values_file(bytes: &[u8]) -> bool {
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
            assert!(is_values_file(&whole[..length]), "the first {length} bytes");
        }
        for bit in 0..8 * whole.len() {
            let mut flipped = whole.clone();
            flipped[bit / 8] ^= 1 << (bit % 8);
            assert!(is_values_file(&flipped), "bit {bit}");
        }
        assert!(is_values_file(&[0; 4096]));
        for other in [
            &b"# the flight's configuration\n[camera]\n"[..],
            b"[camera]\nsource = \"simulated\"\n",
            b"SIMPLE  =                    T",
            b"\xFF\xFE",
            b"x",
        ] {
            assert!(!is_values_file(other), "{}", other.escape_ascii());
        }
    }
}
