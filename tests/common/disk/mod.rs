//! Disks to test the archive with, behind the trait of the real one.

mod faulty;
mod memory;
mod pausing;

pub use faulty::{Fault, FaultyDisk};
pub use memory::{Memory, Persisted};
pub use pausing::PausingDisk;
