//! What several tests of the archive and the service share.
#![allow(dead_code)] // Each test takes what it needs.

pub mod disk;
pub mod flight;
