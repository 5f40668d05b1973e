//! Instructions for encoding and decoding a frame, counted by callgrind.

use crate::callgrind::instructions;
use crate::frames::{CONDITIONS, solved};
use crate::work::{Work, decode, encode, write_all};
use anyhow::bail;

/// Environment variable that tells this program to run under callgrind, with the numbers of the conditions and of the task.
pub const COUNTED_VARIABLE: &str = "SOLASPECT_COUNTED_WORK";

/// Number of frames; the first is not counted, because it includes the library's initialisation.
const FRAMES: u64 = 3;

#[inline(never)]
fn counted<T>(frames: &[T], work: impl Fn(&T) -> anyhow::Result<()>) -> anyhow::Result<()> {
    frames.iter().try_for_each(work)
}

/// Runs the task given by `counted_as`, for callgrind to count.
pub fn work_through(counted_as: &str) -> anyhow::Result<()> {
    let parts = counted_as.split_once(' ').and_then(|(n, work)| {
        let conditions = CONDITIONS.get(n.parse::<usize>().ok()?)?;
        Some((conditions, *Work::ALL.get(work.parse::<usize>().ok()?)?))
    });
    let Some((conditions, work)) = parts else {
        bail!("{COUNTED_VARIABLE}: expected two numbers, found {counted_as}");
    };
    let frames = solved(conditions, FRAMES)?;
    match work {
        Work::Encode(packing) => {
            encode(&frames[0], packing)?;
            counted(&frames[1..], |solved| encode(solved, packing).map(drop))
        }
        Work::Decode(compression) => {
            let folder = tempfile::tempdir()?;
            let files = write_all(&frames, compression, folder.path())?;
            decode(&files[0])?;
            counted(&files[1..], |file| decode(file).map(drop))
        }
        work => bail!("{} is not counted", work.name()),
    }
}

/// Mean instructions of a frame under the n-th conditions; `work` is the index in [`Work::ALL`].
pub fn count(n: usize, work: usize) -> anyhow::Result<u64> {
    let counted_as = format!("{n} {work}");
    let total = instructions("*counts*counted*", COUNTED_VARIABLE, &counted_as)?;
    Ok(total / (FRAMES - 1))
}
