//! One small file per command; no logic.

pub mod simulate;
