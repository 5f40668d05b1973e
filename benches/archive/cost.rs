//! Cost of a task: wall time per frame, processor time, and bytes.

use nix::sys::resource::{UsageWho, getrusage};
use nix::sys::time::TimeValLike;
use std::time::{Duration, Instant};

/// User and system time of this process, or of its terminated children.
#[derive(Clone, Copy)]
pub enum Of {
    Ourselves,
    Children,
}

impl Of {
    fn processor_time(self) -> anyhow::Result<Duration> {
        let usage = getrusage(match self {
            Self::Ourselves => UsageWho::RUSAGE_SELF,
            Self::Children => UsageWho::RUSAGE_CHILDREN,
        })?;
        let spent = usage.user_time() + usage.system_time();
        Ok(Duration::from_micros(spent.num_microseconds() as u64))
    }
}

/// Accumulated cost of the passes over all frames.
#[derive(Default)]
pub struct Cost {
    /// One value per frame and pass, or the mean of each pass if frames cannot be distinguished.
    wall: Vec<Duration>,
    /// Mean per frame of each pass.
    processor: Vec<Duration>,
    /// Total size of the files of one pass.
    pub file_bytes: u64,
}

impl Cost {
    /// Adds a pass over a number of frames; `pass` returns the bytes of its files, and records the wall time of each frame
    /// if it can measure it.
    pub fn add(
        &mut self,
        frames: usize,
        of: Of,
        pass: impl FnOnce(&mut Vec<Duration>) -> anyhow::Result<u64>,
    ) -> anyhow::Result<()> {
        let mut wall = Vec::new();
        let (before, start) = (of.processor_time()?, Instant::now());
        self.file_bytes = pass(&mut wall)?;
        let (elapsed, after) = (start.elapsed(), of.processor_time()?);
        if wall.is_empty() {
            wall.push(elapsed / frames as u32);
        }
        self.wall.extend(wall);
        self.processor.push((after - before) / frames as u32);
        Ok(())
    }

    /// Median wall time per frame.
    pub fn wall(&self) -> Duration {
        median(&self.wall)
    }

    /// Median processor time per frame.
    pub fn processor(&self) -> Duration {
        median(&self.processor)
    }
}

fn median(times: &[Duration]) -> Duration {
    let mut sorted = times.to_vec();
    sorted.sort();
    sorted.get(sorted.len() / 2).copied().unwrap_or_default()
}
