//! What is done with every frame.

use crate::cost::{Cost, Of};
use crate::frames::Solved;
use anyhow::{Context, ensure};
use solaspect::archive::Store;
use solaspect::fits::{self, Compression};
use std::hint::black_box;
use std::path::Path;
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

#[derive(Clone, Copy)]
pub enum Work {
    /// To the bytes of a file.
    Encode(Compression),
    /// To a file on the disk, with its name: encoding, writing, fsync of file and folder, renaming.
    Store(Compression),
    /// `fpack` with an option that names its compression: reading and writing files, without fsync.
    Fpack(&'static str, Compression),
}

impl Work {
    pub const ALL: [Self; 8] = [
        Self::Encode(Compression::Rice),
        Self::Encode(Compression::Gzip),
        Self::Encode(Compression::None),
        Self::Store(Compression::Rice),
        Self::Store(Compression::Gzip),
        Self::Store(Compression::None),
        Self::Fpack("-r", Compression::Rice),
        Self::Fpack("-g", Compression::Gzip),
    ];

    pub fn name(self) -> &'static str {
        match self {
            Self::Encode(_) => "encode",
            Self::Store(_) => "store",
            Self::Fpack(..) => "fpack",
        }
    }

    pub fn compression(self) -> Compression {
        match self {
            Self::Encode(compression) | Self::Store(compression) | Self::Fpack(_, compression) => {
                compression
            }
        }
    }

    /// One pass over all frames, in a new folder under `folder`.
    pub fn pass(self, frames: &[Solved], folder: &Path, cost: &mut Cost) -> anyhow::Result<()> {
        let folder = tempfile::tempdir_in(folder)?;
        let folder = folder.path();
        match self {
            Self::Encode(compression) => cost.add(frames.len(), Of::Ourselves, |wall| {
                each(
                    frames,
                    wall,
                    |solved| Ok(encode(solved, compression)?.len()),
                )
            }),
            Self::Store(compression) => {
                let store = Store::open(folder, "demo", compression)?;
                cost.add(frames.len(), Of::Ourselves, |wall| {
                    each(frames, wall, |solved| {
                        let Solved {
                            frame,
                            cards,
                            tables,
                        } = solved;
                        let path = store.write(frame, cards, tables)?;
                        Ok(std::fs::metadata(path)?.len() as usize)
                    })
                })
            }
            Self::Fpack(option, _) => {
                let mut command = Command::new("fpack");
                command
                    .arg(option)
                    .current_dir(folder)
                    .stdout(Stdio::null());
                for (n, solved) in frames.iter().enumerate() {
                    let name = format!("{n}.fits");
                    std::fs::write(folder.join(&name), encode(solved, Compression::None)?)?;
                    command.arg(name);
                }
                cost.add(frames.len(), Of::Children, |_| {
                    ensure!(command.status()?.success(), "fpack failed");
                    packed_bytes(folder, frames.len())
                })
            }
        }
    }
}

/// The bytes of a frame's file.
#[inline(never)]
pub fn encode(solved: &Solved, compression: Compression) -> anyhow::Result<Vec<u8>> {
    let Solved {
        frame,
        cards,
        tables,
    } = solved;
    Ok(black_box(fits::encode_frame(
        frame,
        cards,
        tables,
        compression,
    )?))
}

/// Does a work on every frame and notes its time; the sum of the bytes that it returns.
fn each(
    frames: &[Solved],
    wall: &mut Vec<Duration>,
    work: impl Fn(&Solved) -> anyhow::Result<usize>,
) -> anyhow::Result<u64> {
    let mut bytes = 0;
    for solved in frames {
        let start = Instant::now();
        bytes += work(solved)? as u64;
        wall.push(start.elapsed());
    }
    Ok(bytes)
}

fn packed_bytes(folder: &Path, count: usize) -> anyhow::Result<u64> {
    let bytes = |n| {
        let path = folder.join(format!("{n}.fits.fz"));
        let metadata = std::fs::metadata(path).context("a file that fpack was to write")?;
        Ok(metadata.len())
    };
    (0..count).map(bytes).sum()
}

/// The version of `fpack`, if it can be run.
pub fn fpack_version() -> Option<String> {
    let output = Command::new("fpack").arg("-V").output().ok()?;
    let said = [output.stdout, output.stderr].concat();
    let said = String::from_utf8_lossy(&said);
    Some(said.lines().next()?.trim().into())
}
