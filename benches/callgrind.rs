//! Instructions of a function of a bench, counted by callgrind.

use anyhow::{Context, ensure};
use std::fs;
use std::process::{Command, Stdio};

/// Runs this same program under callgrind with an environment variable set, and returns the instructions spent in functions
/// that match `collected`.
pub fn instructions(collected: &str, variable: &str, value: &str) -> anyhow::Result<u64> {
    let folder = tempfile::tempdir()?;
    let counts = folder.path().join("counts");
    let status = Command::new("valgrind")
        .arg("--tool=callgrind")
        .arg(format!("--toggle-collect={collected}"))
        .arg(format!("--callgrind-out-file={}", counts.display()))
        .arg(std::env::current_exe()?)
        .env(variable, value)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .status()
        .context("valgrind does not start")?;
    ensure!(status.success(), "valgrind ended with {status}");
    let counts = fs::read_to_string(counts)?;
    let total = counts
        .lines()
        .find_map(|line| line.strip_prefix("totals: "));
    let total: u64 = total.context("callgrind wrote no total")?.trim().parse()?;
    ensure!(total > 0, "callgrind did not find the function");
    Ok(total)
}
