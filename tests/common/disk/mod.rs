//! Test disks for the archive, which implement the trait of the real disk.

mod faulty;
mod memory;
mod pausing;

pub use faulty::{Fault, FaultyDisk};
pub use memory::{Memory, Persisted};
pub use pausing::PausingDisk;
