//! Instructions of encoding a frame, by callgrind.

use crate::frames::{CONDITIONS, solved};
use crate::work::encode;
use anyhow::{Context, ensure};
use solaspect::fits::Compression;
use std::fs;
use std::process::{Command, Stdio};

/// Tells this program that it is being counted, and in what: the number of the conditions and a compression.
pub const COUNTED_VARIABLE: &str = "SOLASPECT_COUNTED_ENCODING";

/// Frames that are encoded, the first not counted: it finds the library not initialised.
const FRAMES: u64 = 3;

#[inline(never)]
fn counted(solved: &[crate::frames::Solved], compression: Compression) -> anyhow::Result<()> {
    solved
        .iter()
        .try_for_each(|solved| encode(solved, compression).map(drop))
}

/// Encodes what `counted_as` says, for callgrind to count.
pub fn work_through(counted_as: &str) -> anyhow::Result<()> {
    let expected = || format!("{COUNTED_VARIABLE}: expected `N COMPRESSION`, found {counted_as}");
    let (n, name) = counted_as.split_once(' ').with_context(expected)?;
    let conditions = n.parse().ok().and_then(|n: usize| CONDITIONS.get(n));
    let compression = Compression::KINDS.into_iter().find(|c| c.name() == name);
    let compression = compression.with_context(expected)?;
    let frames = solved(conditions.with_context(expected)?, FRAMES)?;
    encode(&frames[0], compression)?;
    counted(&frames[1..], compression)
}

/// Mean instructions of encoding a frame under the n-th conditions.
pub fn count(n: usize, compression: Compression) -> anyhow::Result<u64> {
    let folder = tempfile::tempdir()?;
    let counts = folder.path().join("counts");
    let status = Command::new("valgrind")
        .args(["--tool=callgrind", "--toggle-collect=*counts*counted*"])
        .arg(format!("--callgrind-out-file={}", counts.display()))
        .arg(std::env::current_exe()?)
        .env(COUNTED_VARIABLE, format!("{n} {}", compression.name()))
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
    Ok(total / (FRAMES - 1))
}
