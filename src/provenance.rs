//! Origin of a file: the program, its version and the commit it was built from, and the hash of its inputs.

use sha2::{Digest, Sha256};
use std::fs::File;
use std::io::{self, BufRead, BufReader};
use std::path::Path;

/// Name and version of the program.
pub const PROGRAM: &str = concat!("solaspect ", env!("CARGO_PKG_VERSION"));

/// The version alone.
pub const VERSION: &str = env!("CARGO_PKG_VERSION");

/// The commit that the program was built from, 12 hexadecimal digits, followed by "-dirty" if its sources were modified.
/// `None` if it was not built from a checkout.
pub const COMMIT: Option<&str> = option_env!("SOLASPECT_COMMIT");

/// The version and, if it is known, the commit: "0.2.0 (0123456789ab)".
pub const LONG_VERSION: &str = env!("SOLASPECT_VERSION");

/// SHA-256 of bytes, in hexadecimal digits.
pub fn sha256(bytes: impl AsRef<[u8]>) -> String {
    hexadecimal(&Sha256::digest(bytes))
}

/// SHA-256 of a file, in hexadecimal digits.
///
/// # Errors
/// If the file cannot be read.
pub fn sha256_of_file(path: &Path) -> io::Result<String> {
    let mut file = BufReader::with_capacity(1 << 20, File::open(path)?);
    let mut hash = Sha256::new();
    while let bytes = file.fill_buf()?
        && !bytes.is_empty()
    {
        let count = bytes.len();
        hash.update(bytes);
        file.consume(count);
    }
    Ok(hexadecimal(&hash.finalize()))
}

fn hexadecimal(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The hash of FIPS 180-2, appendix B.1.
    #[test]
    fn a_text_has_the_hash_that_sha256sum_gives() {
        let stated = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
        assert_eq!(sha256("abc"), stated);
    }

    #[test]
    fn a_commit_is_twelve_digits_and_says_whether_the_sources_were_modified() {
        let Some(commit) = COMMIT else {
            return;
        };
        let digits = commit.strip_suffix("-dirty").unwrap_or(commit);
        assert!(digits.len() >= 12, "{commit}");
        assert!(
            digits.bytes().all(|byte| byte.is_ascii_hexdigit()),
            "{commit}"
        );
        assert!(LONG_VERSION.contains(commit));
    }
}
