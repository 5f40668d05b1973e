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

use super::control::result;
use super::packet::id;

/// Numbers with a name and what they mean.
type Names = [(u16, &'static str, &'static str)];

/// Results of commands that read nothing.
#[rustfmt::skip] // One row, one line.
const RESULTS: &Names = &[
    (result::DONE, "done", "done"),
    (result::NOT_IMPLEMENTED, "not_implemented", "not implemented, or the packet lacks variables"),
    (result::REFUSED, "refused", "a value is out of range, or there is no such parameter; nothing has changed"),
    (result::UNKNOWN, "unknown", "no such command; of a read: not known"),
];

/// Who packets are for, or from.
const PARTIES: &Names = &[
    (id::CONTROLLER as u16, "controller", "the controller"),
    (id::ASPECT as u16, "aspect_system", "the aspect system"),
    (id::EVERYONE as u16, "everyone", "everyone"),
];

/// Types of the value of a picture's tag.
const TAG_TYPES: &Names = &[
    (16, "text", "text, padded with zeros"),
    (41, "whole", "i32"),
    (82, "number", "f64"),
];

const CHECKSUM: &str =
    "CRC-16/MODBUS over the whole packet with these two bytes zero; stored high byte first";

#[cfg(test)]
mod tests;
