//! The commands: each file reads its arguments, calls the library and prints. No logic here.

pub mod accuracy;
pub mod archive;
mod attitude;
pub mod calibrate;
pub mod config;
pub mod demo;
pub mod fly;
mod frames;
pub mod horizon;
pub mod link;
pub mod moon;
pub mod navigate;
mod options;
mod output;
pub mod preflight;
pub mod refine;
pub mod simulate;
pub mod sky;
pub mod solve;
