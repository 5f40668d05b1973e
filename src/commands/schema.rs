//! The link described for other programs, from the tables that this one works by: Kaitai Struct and XTCE.
//!
//! The writers of YAML and XML are small ones of this module: no crate of this program writes either. YAML's texts are quoted as JSON's,
//! which YAML contains, by `serde_json`.

mod kaitai;
mod xml;
mod xtce;
mod yaml;

pub use kaitai::kaitai;
pub use xtce::xtce;

const CHECKSUM: &str =
    "CRC-16/MODBUS over the whole packet with these two bytes zero; stored high byte first";

#[cfg(test)]
mod tests;
