//! Signed datagrams: a packet, the time at which it was signed, and an HMAC-SHA256 over both and the recipient.
//!
//! | bytes | what |
//! |---|---|
//! | as many as the packet has | the packet |
//! | 8 | the stamp: UTC since 1970, ns, i64, little-endian |
//! | 32 | HMAC-SHA256 over the recipient's label, the packet and the stamp |
//!
//! The label, `solaspect: to computer 1` or `2`, is not sent: sender and recipient know the recipient. So a packet that was signed for one computer
//! is invalid for another that has the same secret, and so is a packet that a computer would sign for the ground.

use super::computer::Computer;
use crate::files::{self, Unread};
use hmac::{Hmac, KeyInit, Mac};
use jiff::Timestamp;
use sha2::Sha256;
use std::fmt;
use std::path::{Path, PathBuf};

const STAMP: usize = 8;
const TAG: usize = 32;
/// Shortest secret that is accepted, bytes.
const SHORTEST: usize = 16;
/// Largest file that is accepted as a secret, bytes.
const LONGEST: u64 = 1 << 16;

/// Reason why a file is no key.
#[derive(Debug, thiserror::Error)]
pub enum KeyError {
    #[error("{}: key: {cause}", .path.display())]
    File { path: PathBuf, cause: Unread },
    #[error("{}: key: expected {SHORTEST} bytes or more, found {found}", .path.display())]
    Short { path: PathBuf, found: usize },
}

/// A secret shared by ground and flight.
#[derive(Clone)]
pub struct Key(Hmac<Sha256>);

/// Signs packets to one computer, and verifies packets signed for it.
#[derive(Clone)]
pub struct Seal(Hmac<Sha256>);

impl fmt::Debug for Seal {
    /// Does not show the secret.
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str("Seal")
    }
}

impl fmt::Debug for Key {
    /// Does not show the secret.
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        out.write_str("Key")
    }
}

impl Key {
    /// Reads the secret from a file: all of its bytes except white space at its end.
    ///
    /// # Errors
    /// If the file cannot be read, or holds less than 16 bytes.
    pub fn read(path: &Path) -> Result<Self, KeyError> {
        let bytes = files::read(path, LONGEST).map_err(|cause| {
            let path = path.into();
            KeyError::File { path, cause }
        })?;
        let secret = bytes.trim_ascii_end();
        Self::new(secret).ok_or_else(|| KeyError::Short {
            path: path.into(),
            found: secret.len(),
        })
    }

    /// A key from a secret; `None` if that is shorter than 16 bytes.
    pub fn new(secret: &[u8]) -> Option<Self> {
        if secret.len() < SHORTEST {
            return None;
        }
        Hmac::new_from_slice(secret).ok().map(Self)
    }

    /// The seal of packets to this computer.
    pub fn towards(&self, computer: Computer) -> Seal {
        let label = format!("solaspect: to computer {}", computer.number());
        Seal(self.0.clone().chain_update(label))
    }
}

impl Seal {
    /// The datagram of a packet, signed with the present time.
    pub fn sign_now(&self, packet: &[u8]) -> Vec<u8> {
        // Valid until the year 2262.
        self.sign(packet, Timestamp::now().as_nanosecond() as i64)
    }

    /// The signed datagram of a packet; `stamp` is the time, ns since 1970.
    pub fn sign(&self, packet: &[u8], stamp: i64) -> Vec<u8> {
        let mut datagram = [packet, &stamp.to_le_bytes()].concat();
        let tag = self.0.clone().chain_update(&datagram).finalize();
        datagram.extend(tag.into_bytes());
        datagram
    }

    /// Packet and stamp of a datagram; `None` if it was not signed with this key, or not for this computer.
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
    use crate::link::hex::hex;

    fn seal(computer: Computer) -> Seal {
        let key = Key::new(b"sixteen bytes or more").unwrap();
        key.towards(computer)
    }

    #[test]
    fn a_datagram_with_any_one_bit_wrong_or_another_key_is_not_verified() {
        let key = seal(Computer::One);
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
        assert_eq!(other.towards(Computer::One).verified(&datagram), None);
    }

    #[test]
    fn what_is_signed_for_one_computer_is_signed_for_no_other() {
        let computers = [Computer::One, Computer::Two];
        for (to, other) in [(0, 1), (1, 0)].map(|(a, b)| (computers[a], computers[b])) {
            let datagram = seal(to).sign(b"packet", 1);
            assert!(seal(to).verified(&datagram).is_some());
            assert_eq!(seal(other).verified(&datagram), None);
        }
    }

    #[test]
    fn a_seal_is_an_hmac_of_what_the_protocol_says() {
        // Python: hmac.new(secret, b"solaspect: to computer 2" + b"packet" + (1).to_bytes(8, "little"), "sha256").hexdigest()
        let tag = "e58d11c271c40e30769e79f5c7ccc4f85be279a66087dd983f0b9352bd8221b7";
        let datagram = seal(Computer::Two).sign(b"packet", 1);
        assert_eq!(hex(&datagram[14..]).replace(' ', "").to_lowercase(), tag);
    }

    #[test]
    fn a_key_file_may_end_in_a_new_line_and_a_short_one_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("key");
        std::fs::write(&path, "sixteen bytes or more\n").unwrap();
        let key = Key::read(&path).unwrap().towards(Computer::One);
        let signed = key.sign(b"packet", 1);
        assert!(seal(Computer::One).verified(&signed).is_some());
        std::fs::write(&path, "short\n").unwrap();
        let error = Key::read(&path).unwrap_err().to_string();
        assert!(
            error.contains("expected 16 bytes or more, found 5"),
            "{error}"
        );
    }
}
