//! A frame's file is complete or absent, whenever the power fails.
//!
//! Tested in two ways: on a model of a disk that loses data not yet synchronised, cut after every single step; and with a
//! process that is killed, at step boundaries and at random times, while it writes to a real disk.

use crate::common::disk::{Memory, PausingDisk, Persisted};
use crate::common::flight::{dark_frame, frames_in};
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use solaspect::archive::disk::LocalDisk;
use solaspect::archive::{MARK, Store};
use solaspect::fits::{self, Compression};
use solaspect::frame::Frame;
use solaspect::instrument;
use std::collections::BTreeSet;
use std::fs;
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{ChildStdout, Command, Stdio};
use std::sync::Arc;
use std::time::Duration;

fn frame(number: u64) -> Frame {
    dark_frame(&instrument::builtin("demo").unwrap(), number)
}

#[test]
fn after_a_power_cut_at_any_step_every_visible_file_is_whole_and_every_stored_frame_is_there() {
    let root = Path::new("/disk/aspect");
    // Frame 20, at 18:00:00, begins another hour's folder.
    let frames = [18, 19, 20].map(frame);
    let mut cut = 0;
    loop {
        let memory = Arc::new(Memory::cut_after(cut));
        let store = Store::new(memory.clone(), root, "demo", Compression::Rice);
        let stored = frames
            .iter()
            .take_while(|frame| store.write(frame, &[], &[]).is_ok());
        let stored = stored.count();
        for persisted in [Persisted::OnlyWhatWasSynced, Persisted::AllNames] {
            let files = memory.files_after_the_cut(persisted);
            let visible = files
                .iter()
                .filter(|(path, _)| path.extension().is_some_and(|e| e == "fits"));
            let mut seen = 0;
            for (path, bytes) in visible {
                let copy = tempfile::NamedTempFile::new().unwrap();
                fs::write(copy.path(), bytes).unwrap();
                fits::check_sums(copy.path()).unwrap();
                let found = fits::read_frame(copy.path()).unwrap();
                assert!(
                    frames.contains(&found),
                    "{} after {cut} steps",
                    path.display()
                );
                seen += 1;
            }
            assert!(
                seen >= stored,
                "{seen} of {stored} stored frames after {cut} steps"
            );
        }
        if stored == frames.len() {
            break;
        }
        cut += 1;
    }
    assert!(cut > 15, "{cut} steps for three frames");
}

/// Not a test but the process to be killed. It stores frames forever and prints the number of each.
#[test]
#[ignore = "started by the tests, which kill it"]
fn writer() {
    let Ok(root) = std::env::var("SOLASPECT_KILLED_ROOT") else {
        return;
    };
    let number = |name: &str| std::env::var(name).ok().and_then(|n| n.parse::<u64>().ok());
    let first = number("SOLASPECT_KILLED_FIRST").unwrap();
    let disk = PausingDisk::new(LocalDisk, number("SOLASPECT_KILLED_STEP"), || {
        println!("step")
    });
    let store = Store::new(Arc::new(disk), root.as_ref(), "demo", Compression::Rice);
    store.prepare().unwrap();
    println!("swept {}", store.swept());
    for number in first.. {
        store.write(&frame(number), &[], &[]).unwrap();
        println!("stored {number}");
    }
}

/// Time at which a writer is killed.
#[derive(Clone, Copy)]
enum Moment {
    /// While it is blocked before this disk operation; operations are counted from the first frame on.
    Step(u64),
    /// This long after it stored its first frame.
    After(Duration),
}

struct Killed {
    swept: usize,
    stored: Vec<u64>,
}

/// Starts a writer that stores frames from `first` on, and kills it.
fn killed(root: &Path, first: u64, moment: Moment) -> Killed {
    let mut command = Command::new(std::env::current_exe().unwrap());
    command
        .args([
            "--exact",
            "power_cut::writer",
            "--ignored",
            "--nocapture",
            "--test-threads=1",
        ])
        .env("SOLASPECT_KILLED_ROOT", root)
        .env("SOLASPECT_KILLED_FIRST", first.to_string())
        .stdout(Stdio::piped())
        .stderr(Stdio::null());
    if let Moment::Step(step) = moment {
        command.env("SOLASPECT_KILLED_STEP", step.to_string());
    }
    let mut child = command.spawn().unwrap();
    let mut lines = BufReader::new(child.stdout.take().unwrap());
    let mut killed = Killed {
        swept: 0,
        stored: Vec::new(),
    };
    loop {
        let said = next_word(&mut lines).expect("the writer ended");
        match (said, moment) {
            (Said::AtStep, _) => break,
            (Said::Swept(count), _) => killed.swept = count,
            (Said::Stored(number), Moment::Step(_)) => killed.stored.push(number),
            (Said::Stored(number), Moment::After(pause)) => {
                killed.stored.push(number);
                std::thread::sleep(pause);
                break;
            }
        }
    }
    child.kill().unwrap();
    child.wait().unwrap();
    // Read what it printed before it was killed.
    while let Some(said) = next_word(&mut lines) {
        if let Said::Stored(number) = said {
            killed.stored.push(number);
        }
    }
    killed
}

enum Said {
    AtStep,
    Swept(usize),
    Stored(u64),
}

/// The writer's next message; `None` at its end. The test harness prints other lines, and the last line may be incomplete.
fn next_word(lines: &mut BufReader<ChildStdout>) -> Option<Said> {
    loop {
        let mut line = String::new();
        lines.read_line(&mut line).unwrap();
        let line = line.strip_suffix('\n')?;
        let words: Vec<&str> = line.split_whitespace().rev().take(2).collect();
        match words[..] {
            ["step", ..] => return Some(Said::AtStep),
            [count, "swept"] => return Some(Said::Swept(count.parse().unwrap())),
            [number, "stored"] => return Some(Said::Stored(number.parse().unwrap())),
            _ => {}
        }
    }
}

/// Reads a file by cfitsio; asserts that all checksums match, and returns the pixels.
fn cfitsio_reads(path: &Path) -> Vec<u8> {
    let mut file = fitsio::FitsFile::open(path).unwrap();
    for n in 0..2 {
        file.hdu(n).unwrap();
        let (mut data, mut hdu, mut status) = (0, 0, 0);
        // SAFETY: the handle is open, and the three variables outlive the call.
        unsafe { fitsio_sys::ffvcks(file.as_raw(), &mut data, &mut hdu, &mut status) };
        assert_eq!((data, hdu, status), (1, 1, 0), "{}", path.display());
    }
    let hdu = file.hdu("FRAME").unwrap();
    hdu.read_image(&mut file).unwrap()
}

fn half_written(root: &Path) -> usize {
    let mut count = 0;
    let mut folders = vec![root.to_path_buf()];
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                folders.push(path.clone());
            }
            count += usize::from(path.file_name().unwrap().to_string_lossy().starts_with('.'));
        }
    }
    count
}

/// Kills a writer at each moment, run after run on the same archive, and checks the whole archive after each run.
fn survive(root: &Path, moments: &[Moment]) {
    let mut checked = BTreeSet::new();
    let (mut half, mut swept, mut swept_expected) = (0, 0, 0);
    let mut stored = BTreeSet::new();
    for (run, &moment) in moments.iter().enumerate() {
        let first = 1000 * run as u64;
        let killed = killed(root, first, moment);
        swept_expected += half;
        swept += killed.swept;
        half = half_written(root);
        assert!(half <= 1, "{half} partial files in run {run}");
        stored.extend(killed.stored);
        for path in frames_in(root) {
            if !checked.insert(path.clone()) {
                continue;
            }
            let found = fits::read_frame(&path).unwrap();
            let number = found.info.number.unwrap();
            assert_eq!(found, frame(number), "{}", path.display());
            assert!(cfitsio_reads(&path).iter().all(|&dn| dn == 7));
            stored.remove(&number);
        }
        assert!(
            stored.is_empty(),
            "named as stored, and not there: {stored:?}"
        );
    }
    let last = Store::open(root, "demo", Compression::Rice).unwrap();
    assert_eq!(swept + last.swept(), swept_expected + half);
    assert_eq!(half_written(root), 0);
    println!(
        "{} kills: {} files whole, {} partial files removed",
        moments.len(),
        checked.len(),
        swept + last.swept()
    );
}

/// The first `steps` disk operations, then random times.
fn moments(steps: u64, random: usize) -> Vec<Moment> {
    let mut random_number = Xoshiro256PlusPlus::seed_from_u64(5);
    let mut after = || Moment::After(Duration::from_micros(random_number.random_range(0..40_000)));
    let steps = (0..steps).map(Moment::Step);
    steps.chain((0..random).map(|_| after())).collect()
}

#[test]
fn a_writer_killed_at_any_moment_leaves_whole_files_only() {
    let root = tempfile::tempdir().unwrap();
    survive(root.path(), &moments(13, 7));
    assert!(root.path().join(MARK).is_file());
}

/// Uses the folder named by `SOLASPECT_KILLED_KEEP`, so that other programs can read the files.
#[test]
#[ignore = "the full size: 200 kills"]
fn a_writer_killed_two_hundred_times_leaves_whole_files_only() {
    let temporary = tempfile::tempdir().unwrap();
    let kept = std::env::var_os("SOLASPECT_KILLED_KEEP").map(std::path::PathBuf::from);
    let root = kept.as_deref().unwrap_or(temporary.path());
    // A writer killed at its first operation has not created the folder.
    fs::create_dir_all(root).unwrap();
    survive(root, &moments(40, 160));
}
