//! The plate's calibration against simulated frames of which the truth is known.

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
