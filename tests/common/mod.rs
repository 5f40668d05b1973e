//! Shared code of the tests of archive and service.
#![allow(dead_code, unused_imports)] // Each test takes what it needs.

pub mod camera;
pub mod disk;
pub mod flight;
pub mod refined;
pub mod sun_picture;
