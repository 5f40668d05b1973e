//! Resources that a process uses on its machine (Linux).

use anyhow::Context;
use std::collections::BTreeMap;
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

/// Processor time by thread name.
pub type ProcessorTimes = BTreeMap<String, Duration>;

/// Processor time that the threads of this process have used.
pub fn processor_times() -> anyhow::Result<ProcessorTimes> {
    let mut times = ProcessorTimes::new();
    for thread in fs::read_dir("/proc/self/task")? {
        let path = thread?.path();
        let text = |name| fs::read_to_string(path.join(name));
        let (Ok(name), Ok(used)) = (text("comm"), text("schedstat")) else {
            continue;
        };
        let nanoseconds = used.split_whitespace().next().and_then(|n| n.parse().ok());
        *times.entry(name.trim().into()).or_default() +=
            Duration::from_nanos(nanoseconds.unwrap_or(0));
    }
    Ok(times)
}

/// The heap, bytes.
#[derive(Debug, Clone, Copy, Default)]
pub struct Heap {
    /// Memory in use by the program.
    pub live: f64,
    /// Memory freed by the program and kept by the C library for the next request. Part of it may not be resident.
    pub kept: f64,
}

/// The heap of all threads, as counted by the C library.
#[cfg(target_env = "gnu")]
pub fn heap() -> Heap {
    // SAFETY: mallinfo2 only reads the allocator's own counts, under its own locks, and takes no argument.
    let info = unsafe { libc::mallinfo2() };
    Heap {
        live: (info.uordblks + info.hblkhd) as f64,
        kept: info.fordblks as f64,
    }
}

/// Other C libraries do not report it.
#[cfg(not(target_env = "gnu"))]
pub fn heap() -> Heap {
    Heap::default()
}

/// Memory at one moment, bytes.
#[derive(Debug, Clone, Copy)]
pub struct Sample {
    pub time_s: f64,
    pub resident: f64,
    pub heap: Heap,
}

/// Memory over a run.
pub struct MemoryLog {
    start: Instant,
    samples: Vec<Sample>,
    largest: f64,
}

impl MemoryLog {
    /// A log allocated for a number of samples, so that it does not grow itself.
    pub fn new(samples: usize) -> Self {
        Self {
            start: Instant::now(),
            samples: Vec::with_capacity(samples),
            largest: 0.0,
        }
    }

    /// Measures the memory; the sample counts for the growth only if `kept`.
    pub fn note(&mut self, kept: bool) -> anyhow::Result<()> {
        let sample = Sample {
            time_s: self.start.elapsed().as_secs_f64(),
            resident: resident_bytes()? as f64,
            heap: heap(),
        };
        self.largest = self.largest.max(sample.resident);
        if kept {
            self.samples.push(sample);
        }
        Ok(())
    }

    pub fn largest_bytes(&self) -> f64 {
        self.largest
    }

    pub fn samples(&self) -> &[Sample] {
        &self.samples
    }

    /// Growth of a quantity by least squares, bytes/s, from `settled` on, when one-time allocations are done. `None` for
    /// fewer than ten samples.
    pub fn growth(&self, settled: Duration, of: impl Fn(&Sample) -> f64) -> Option<f64> {
        let late = |s: &&Sample| s.time_s >= settled.as_secs_f64();
        let points: Vec<_> = self.samples.iter().filter(late).collect();
        let n = points.len() as f64;
        let mean_t = points.iter().map(|s| s.time_s).sum::<f64>() / n;
        let mean_b = points.iter().map(|s| of(s)).sum::<f64>() / n;
        let tt: f64 = points.iter().map(|s| (s.time_s - mean_t).powi(2)).sum();
        let tb: f64 = points
            .iter()
            .map(|s| (s.time_s - mean_t) * (of(s) - mean_b))
            .sum();
        (points.len() >= 10 && tt > 0.0).then(|| tb / tt)
    }
}
