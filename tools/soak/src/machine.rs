//! What a process takes of its machine (Linux).

use anyhow::Context;
use std::fs;
use std::time::{Duration, Instant};

/// Resident memory, bytes.
pub fn resident_bytes() -> anyhow::Result<u64> {
    let status = fs::read_to_string("/proc/self/status")?;
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    let kilobytes = line.context("/proc/self/status: expected VmRSS, found none")?;
    let number = kilobytes.trim().trim_end_matches("kB").trim();
    Ok(1024 * number.parse::<u64>().context("/proc/self/status: VmRSS")?)
}

/// Processor time that the threads of this process have used.
pub fn processor_time() -> anyhow::Result<Duration> {
    let mut total = Duration::ZERO;
    for thread in fs::read_dir("/proc/self/task")? {
        let path = thread?.path().join("schedstat");
        let Ok(text) = fs::read_to_string(path) else {
            continue;
        };
        let nanoseconds = text.split_whitespace().next().and_then(|n| n.parse().ok());
        total += Duration::from_nanos(nanoseconds.unwrap_or(0));
    }
    Ok(total)
}

/// Resident memory over a run.
pub struct MemoryLog {
    start: Instant,
    samples: Vec<(f64, f64)>,
}

impl MemoryLog {
    pub fn new() -> Self {
        Self {
            start: Instant::now(),
            samples: Vec::new(),
        }
    }

    pub fn note(&mut self) -> anyhow::Result<()> {
        let seconds = self.start.elapsed().as_secs_f64();
        self.samples.push((seconds, resident_bytes()? as f64));
        Ok(())
    }

    pub fn largest_bytes(&self) -> f64 {
        self.samples.iter().map(|s| s.1).fold(0.0, f64::max)
    }

    /// Growth by least squares over the last three quarters of the run: the first is for what is made once.
    pub fn growth_bytes_per_s(&self) -> Option<f64> {
        let settled = &self.samples[self.samples.len() / 4..];
        let n = settled.len() as f64;
        let mean_t = settled.iter().map(|s| s.0).sum::<f64>() / n;
        let mean_b = settled.iter().map(|s| s.1).sum::<f64>() / n;
        let tt: f64 = settled.iter().map(|s| (s.0 - mean_t).powi(2)).sum();
        let tb: f64 = settled
            .iter()
            .map(|s| (s.0 - mean_t) * (s.1 - mean_b))
            .sum();
        (settled.len() >= 10 && tt > 0.0).then(|| tb / tt)
    }
}
