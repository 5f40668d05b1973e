//! Tasks that are run on every frame.

use crate::cost::{Cost, Of};
use crate::frames::Solved;
use anyhow::{Context, ensure};
use solaspect::archive::Store;
use solaspect::fits::{self, Compression, FitsFile, Packing};
use std::ffi::OsString;
use std::hint::black_box;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::time::{Duration, Instant};

#[derive(Clone, Copy)]
pub enum Work {
    /// Encoding to the bytes of a file.
    Encode(Packing),
    /// To a named file on the disk: encoding, writing, fsync of file and folder, renaming.
    Store(Compression),
    /// From a file to the frame, with its data checksum verified.
    Decode(Compression),
    /// `fpack` with the option for its compression: reading and writing files, without fsync.
    Fpack(&'static str, Compression),
    /// `funpack` of our files: reading and writing files, without fsync.
    Funpack(Compression),
}

const fn on_threads(threads: usize, compression: Compression) -> Packing {
    Packing {
        compression,
        threads,
    }
}

impl Work {
    pub const ALL: [Self; 14] = [
        Self::Encode(on_threads(1, Compression::Rice)),
        Self::Encode(on_threads(1, Compression::Gzip)),
        Self::Encode(on_threads(2, Compression::Gzip)),
        Self::Encode(on_threads(1, Compression::None)),
        Self::Store(Compression::Rice),
        Self::Store(Compression::Gzip),
        Self::Store(Compression::None),
        Self::Decode(Compression::Rice),
        Self::Decode(Compression::Gzip),
        Self::Decode(Compression::None),
        Self::Fpack("-r", Compression::Rice),
        Self::Fpack("-g", Compression::Gzip),
        Self::Funpack(Compression::Rice),
        Self::Funpack(Compression::Gzip),
    ];

    pub fn name(self) -> &'static str {
        match self {
            Self::Encode(Packing { threads: 1, .. }) => "encode",
            Self::Encode(_) => "encode, 2 threads",
            Self::Store(_) => "store",
            Self::Decode(_) => "decode",
            Self::Fpack(..) => "fpack",
            Self::Funpack(_) => "funpack",
        }
    }

    pub fn compression(self) -> Compression {
        match self {
            Self::Encode(packing) => packing.compression,
            Self::Store(compression)
            | Self::Decode(compression)
            | Self::Fpack(_, compression)
            | Self::Funpack(compression) => compression,
        }
    }

    /// Whether it is run by cfitsio's programs.
    pub fn is_foreign(self) -> bool {
        matches!(self, Self::Fpack(..) | Self::Funpack(_))
    }

    /// One pass over all frames, in a new folder under `folder`.
    pub fn pass(self, frames: &[Solved], folder: &Path, cost: &mut Cost) -> anyhow::Result<()> {
        let folder = tempfile::tempdir_in(folder)?;
        let folder = folder.path();
        match self {
            Self::Encode(packing) => cost.add(frames.len(), Of::Ourselves, |wall| {
                each(frames, wall, |solved| Ok(encode(solved, packing)?.len()))
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
            Self::Decode(compression) => {
                let files = write_all(frames, compression, folder)?;
                cost.add(frames.len(), Of::Ourselves, |wall| {
                    each(&files, wall, |file| decode(file))?;
                    sizes(&files)
                })
            }
            Self::Fpack(option, compression) => {
                let files = write_all(frames, Compression::None, folder)?;
                let packed: Vec<PathBuf> = files.iter().map(|file| appended(file, ".fz")).collect();
                let command = command("fpack", &[option], &files);
                run(command, files.len(), || sizes(&packed), cost).context(compression.name())
            }
            Self::Funpack(compression) => {
                let files = write_all(frames, compression, folder)?;
                let packed = sizes(&files)?;
                let command = command("funpack", &["-F"], &files);
                run(command, files.len(), || Ok(packed), cost)
            }
        }
    }
}

/// The bytes of a frame's file.
#[inline(never)]
pub fn encode(solved: &Solved, packing: impl Into<Packing>) -> anyhow::Result<Vec<u8>> {
    let Solved {
        frame,
        cards,
        tables,
    } = solved;
    Ok(black_box(fits::encode_frame(
        frame, cards, tables, packing,
    )?))
}

/// Reads the frame of a file; returns its number of pixels.
#[inline(never)]
pub fn decode(file: &Path) -> anyhow::Result<usize> {
    let frame = black_box(FitsFile::open(file)?.frame()?);
    Ok(frame.pixels().len())
}

/// Writes each frame to its own file.
pub fn write_all(
    frames: &[Solved],
    compression: Compression,
    folder: &Path,
) -> anyhow::Result<Vec<PathBuf>> {
    let write = |(n, solved)| {
        let path = folder.join(format!("{n}.fits"));
        std::fs::write(&path, encode(solved, compression)?)?;
        Ok(path)
    };
    frames.iter().enumerate().map(write).collect()
}

/// Runs a task on every frame and records its time; returns the sum of the bytes.
fn each<T>(
    frames: &[T],
    wall: &mut Vec<Duration>,
    work: impl Fn(&T) -> anyhow::Result<usize>,
) -> anyhow::Result<u64> {
    let mut bytes = 0;
    for frame in frames {
        let start = Instant::now();
        bytes += work(frame)? as u64;
        wall.push(start.elapsed());
    }
    Ok(bytes)
}

/// One of cfitsio's programs on all files.
fn command(program: &str, options: &[&str], files: &[PathBuf]) -> Command {
    let mut command = Command::new(program);
    let names = files.iter().filter_map(|file| file.file_name());
    command.args(options).args(names).stdout(Stdio::null());
    if let Some(folder) = files.first().and_then(|file| file.parent()) {
        command.current_dir(folder);
    }
    command
}

/// Runs a command; `bytes` is the size of the packed files.
fn run(
    mut command: Command,
    files: usize,
    bytes: impl Fn() -> anyhow::Result<u64>,
    cost: &mut Cost,
) -> anyhow::Result<()> {
    cost.add(files, Of::Children, |_| {
        ensure!(command.status()?.success(), "{command:?} failed");
        bytes()
    })
}

fn sizes(files: &[PathBuf]) -> anyhow::Result<u64> {
    let size = |file: &PathBuf| {
        Ok(file
            .metadata()
            .with_context(|| file.display().to_string())?
            .len())
    };
    files.iter().map(size).sum()
}

fn appended(file: &Path, ending: &str) -> PathBuf {
    let mut name = OsString::from(file);
    name.push(ending);
    name.into()
}

/// The version of `fpack`, if it can be run.
pub fn fpack_version() -> Option<String> {
    let output = Command::new("fpack").arg("-V").output().ok()?;
    let said = [output.stdout, output.stderr].concat();
    let said = String::from_utf8_lossy(&said);
    Some(said.lines().next()?.trim().into())
}
