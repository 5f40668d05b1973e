//! The plate's calibration from simulated frames with known truth.

mod counted;
mod folders;
mod frames;
mod full_size;
mod judged;
mod observations;
mod poses;
mod refusals;
mod scenes;
mod slips;
