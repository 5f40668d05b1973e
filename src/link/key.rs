//! Signed datagrams: a packet, the time at which it was signed, and an HMAC-SHA256 over both.
//!
//! | bytes | what |
//! |---|---|
//! | as many as the packet has | the packet |
//! | 8 | the stamp: UTC since 1970, ns, i64, little-endian |
//! | 32 | HMAC-SHA256 over packet and stamp |

use hmac::{Hmac, KeyInit, Mac};
use sha2::Sha256;
use std::fmt;
use std::io;
use std::path::{Path, PathBuf};

const STAMP: usize = 8;
const TAG: usize = 32;
/// The shortest secret that is taken, bytes.
const SHORTEST: usize = 16;

/// Why a file is no key.
#[derive(Debug, thiserror::Error)]
pub enum KeyError {
    #[error("{}: key: cannot be read: {cause}", .path.display())]
    File { path: PathBuf, cause: io::Error },
    #[error("{}: key: expected {SHORTEST} bytes or more, found {found}", .path.display())]
    Short { path: PathBuf, found: usize },
}

/// A secret that ground and flight share.
#[derive(Clone)]
pub struct Key(Hmac<Sha256>);

impl fmt::Debug for Key {
    /// Tells nothing of the secret.
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str("Key")
    }
}

impl Key {
    /// Reads the secret from a file: all of its bytes but white space at its end.
    ///
    /// # Errors
    /// A file that cannot be read, or holds less than 16 bytes.
    pub fn read(path: &Path) -> Result<Self, KeyError> {
        let bytes = std::fs::read(path).map_err(|cause| {
            let path = path.into();
            KeyError::File { path, cause }
        })?;
        let secret = bytes.trim_ascii_end();
        Self::new(secret).ok_or_else(|| KeyError::Short {
            path: path.into(),
            found: secret.len(),
        })
    }

    /// A key of a secret; `None` where that is shorter than 16 bytes.
    pub fn new(secret: &[u8]) -> Option<Self> {
        if secret.len() < SHORTEST {
            return None;
        }
        Hmac::new_from_slice(secret).ok().map(Self)
    }

    /// The datagram of a packet; `stamp` is the time, ns since 1970.
    pub fn sign(&self, packet: &[u8], stamp: i64) -> Vec<u8> {
        let mut datagram = [packet, &stamp.to_le_bytes()].concat();
        let tag = self.0.clone().chain_update(&datagram).finalize();
        datagram.extend(tag.into_bytes());
        datagram
    }

    /// Packet and stamp of a datagram; `None` where it was not signed with this key.
    pub fn verified<'a>(&self, datagram: &'a [u8]) -> Option<(&'a [u8], i64)> {
        let (signed, tag) = datagram.split_last_chunk::<TAG>()?;
        let (packet, stamp) = signed.split_last_chunk::<STAMP>()?;
        let mac = self.0.clone().chain_update(signed);
        // In constant time.
        mac.verify_slice(tag).ok()?;
        Some((packet, i64::from_le_bytes(*stamp)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_datagram_with_any_one_bit_wrong_or_another_key_is_not_verified() {
        let key = Key::new(b"sixteen bytes or more").unwrap();
        let datagram = key.sign(b"packet", 1_379_786_400_000_000_000);
        let verified = key.verified(&datagram);
        assert_eq!(verified, Some((&b"packet"[..], 1_379_786_400_000_000_000)));
        for bit in 0..8 * datagram.len() {
            let mut wrong = datagram.clone();
            wrong[bit / 8] ^= 1 << (bit % 8);
            assert_eq!(key.verified(&wrong), None, "bit {bit}");
        }
        for length in 0..datagram.len() {
            assert_eq!(key.verified(&datagram[..length]), None);
        }
        let other = Key::new(b"another secret of ours").unwrap();
        assert_eq!(other.verified(&datagram), None);
    }

    #[test]
    fn a_key_file_may_end_in_a_new_line_and_a_short_one_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("key");
        std::fs::write(&path, "sixteen bytes or more\n").unwrap();
        let signed = Key::read(&path).unwrap().sign(b"packet", 1);
        let key = Key::new(b"sixteen bytes or more").unwrap();
        assert!(key.verified(&signed).is_some());
        std::fs::write(&path, "short\n").unwrap();
        let error = Key::read(&path).unwrap_err().to_string();
        assert!(
            error.contains("expected 16 bytes or more, found 5"),
            "{error}"
        );
    }
}
