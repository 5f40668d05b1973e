//! Measuring the instrument: from frames to the TOML file that everything else reads.

pub mod compare;
pub mod plate;
