//! The archive on one disk and on two disks that share the work, fill up, fail, disappear and return: no frame is lost
//! while one of them works, and solving continues if none does.

use crate::common::disk::{Fault, FaultyDisk};
use crate::common::flight::{self, frames_in, numbers_in};
use solaspect::archive::disk::LocalDisk;
use solaspect::archive::{Overflow, Sharing, Store};
use solaspect::config;
use solaspect::fits::Compression;
use solaspect::service::FlightTally;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Arc;
use std::time::Duration;
use tempfile::TempDir;

const FRAMES: u64 = 40;
/// Longer than the pause of a disk after its first failures.
const SLOW: Duration = Duration::from_millis(50);

fn two() -> [TempDir; 2] {
    [(); 2].map(|()| tempfile::tempdir().unwrap())
}

fn open(root: &Path) -> Store {
    Store::open(root, "demo", Compression::Rice).unwrap()
}

fn faulty(root: &Path, disk: &Arc<FaultyDisk>) -> Store {
    Store::new(disk.clone(), root, "demo", Compression::Rice)
}

fn settings(sharing: Sharing) -> config::Archive {
    config::Archive {
        sharing,
        // Independent of the machine's free space.
        warn_free_percent: 0.0,
        thin_free_percent: 0.0,
        stop_free_percent: 0.0,
        ..config::Archive::default()
    }
}

/// Asserts that every frame is on exactly one of the disks.
#[track_caller]
fn assert_each_once(roots: [&Path; 2]) {
    let mut numbers = [numbers_in(roots[0]), numbers_in(roots[1])].concat();
    numbers.sort_unstable();
    assert_eq!(numbers, (0..FRAMES).collect::<Vec<_>>());
}

fn fly(stores: Vec<Store>, settings: config::Archive, pause: Duration) -> FlightTally {
    flight::dark(stores, settings, FRAMES, pause, |_| {})
}

#[test]
fn two_disks_share_the_frames() {
    let disks = two();
    let roots = [disks[0].path(), disks[1].path()];
    let tally = fly(
        roots.map(open).into(),
        settings(Sharing::Alternate),
        SLOW / 5,
    );
    assert_eq!((tally.counts.stored, tally.counts.unstored), (FRAMES, 0));
    assert_each_once(roots);
    for root in roots {
        assert!(frames_in(root).len() >= 5, "{}", frames_in(root).len());
    }
}

#[test]
fn two_disks_that_mirror_hold_the_same_files() {
    let disks = two();
    let roots = [disks[0].path(), disks[1].path()];
    let tally = fly(roots.map(open).into(), settings(Sharing::Mirror), SLOW / 5);
    assert_eq!((tally.counts.stored, tally.counts.unstored), (FRAMES, 0));
    let files = roots.map(|root| {
        let relative = |path: PathBuf| path.strip_prefix(root).unwrap().to_owned();
        frames_in(root)
            .into_iter()
            .map(relative)
            .collect::<Vec<_>>()
    });
    assert_eq!(files[0].len() as u64, FRAMES);
    assert_eq!(files[0], files[1]);
    for file in &files[0] {
        let [one, other] = roots.map(|root| fs::read(root.join(file)).unwrap());
        assert!(one == other, "{}", file.display());
    }
}

#[test]
fn a_disk_that_fills_leaves_the_rest_to_the_other_and_serves_again_when_it_can() {
    let disks = two();
    let roots = [disks[0].path(), disks[1].path()];
    let disk = FaultyDisk::new(LocalDisk);
    let stores = vec![faulty(roots[0], &disk), open(roots[1])];
    let quota = Fault::Quota { bytes: 60_000 };
    let mut at_full = 0;
    let tally = flight::dark(
        stores,
        settings(Sharing::Alternate),
        FRAMES,
        SLOW,
        |number| match number {
            0 => disk.set(Some(quota)),
            20 => {
                at_full = frames_in(roots[0]).len();
                disk.set(None);
            }
            _ => {}
        },
    );
    assert_eq!((tally.counts.stored, tally.counts.unstored), (FRAMES, 0));
    assert!(tally.archive.refused > 0);
    assert_each_once(roots);
    assert!(frames_in(roots[0]).len() > at_full, "{at_full}");
}

#[test]
fn whatever_step_a_disk_fails_at_the_other_takes_the_frame_and_nothing_half_is_seen() {
    for step in ["create", "write", "sync", "rename_new"] {
        let disks = two();
        let roots = [disks[0].path(), disks[1].path()];
        let disk = FaultyDisk::new(LocalDisk);
        let stores = vec![faulty(roots[0], &disk), open(roots[1])];
        disk.set(Some(Fault::Step(step)));
        let tally = fly(stores, settings(Sharing::Alternate), Duration::ZERO);
        assert_eq!((tally.counts.stored, tally.counts.unstored), (FRAMES, 0));
        assert_eq!(frames_in(roots[0]), [] as [PathBuf; 0], "{step}");
        assert_eq!(numbers_in(roots[1]).len() as u64, FRAMES, "{step}");
    }
}

#[test]
fn a_frame_that_waits_out_a_short_outage_of_the_only_disk_is_not_lost() {
    let root = tempfile::tempdir().unwrap();
    let disk = FaultyDisk::new(LocalDisk);
    let stores = vec![faulty(root.path(), &disk)];
    let tally = flight::dark(
        stores,
        settings(Sharing::Alternate),
        FRAMES,
        SLOW,
        |number| match number {
            10 => disk.set(Some(Fault::Step("sync"))),
            20 => {
                disk.wait_until_refused();
                disk.set(None);
            }
            _ => {}
        },
    );
    assert!(tally.archive.refused > 0);
    assert_eq!((tally.counts.stored, tally.counts.unstored), (FRAMES, 0));
    assert_eq!(numbers_in(root.path()), (0..FRAMES).collect::<Vec<_>>());
}

#[test]
fn with_both_disks_failing_every_frame_is_solved_and_counted() {
    let disks = two();
    let disk = FaultyDisk::new(LocalDisk);
    disk.set(Some(Fault::Step("create")));
    let stores = disks
        .iter()
        .map(|root| faulty(root.path(), &disk))
        .collect();
    let settings = config::Archive {
        queue_frames: 8,
        ..settings(Sharing::Alternate)
    };
    let tally = fly(stores, settings, Duration::ZERO);
    assert_eq!(tally.solved(), FRAMES);
    assert_eq!((tally.counts.stored, tally.counts.unstored), (0, FRAMES));
    let given_up = tally.archive.overflowed + tally.archive.failed;
    assert_eq!(given_up, FRAMES);
}

#[test]
fn nothing_is_written_where_a_disk_was_unmounted_and_it_serves_again_when_it_is_back() {
    let disks = two();
    let parent = tempfile::tempdir().unwrap();
    let (mounted, away) = (parent.path().join("disk"), parent.path().join("away"));
    let roots = [mounted.as_path(), disks[1].path()];
    let stores = roots.map(open).into();
    let mut before = 0;
    let tally = flight::dark(
        stores,
        settings(Sharing::Alternate),
        FRAMES,
        SLOW,
        |number| match number {
            10 => {
                fs::rename(&mounted, &away).unwrap();
                fs::create_dir(&mounted).unwrap();
            }
            20 => {
                assert_eq!(fs::read_dir(&mounted).unwrap().count(), 0);
                before = frames_in(&away).len();
                fs::remove_dir(&mounted).unwrap();
                fs::rename(&away, &mounted).unwrap();
            }
            _ => {}
        },
    );
    assert_eq!((tally.counts.stored, tally.counts.unstored), (FRAMES, 0));
    assert_each_once(roots);
    assert!(frames_in(&mounted).len() > before);
}

#[test]
fn as_a_disk_fills_frames_are_thinned_and_then_stopped_and_the_log_goes_on() {
    let root = tempfile::tempdir().unwrap();
    for (free_percent, stored) in [(5.0, FRAMES), (2.0, FRAMES / 4), (0.5, 0)] {
        let root = root.path().join(format!("{free_percent}"));
        let disk = FaultyDisk::new(LocalDisk);
        disk.set(Some(Fault::Free(free_percent)));
        let stores = vec![faulty(&root, &disk)];
        let rules = config::Archive {
            queue_frames: FRAMES as usize,
            ..config::Archive::default()
        };
        let tally = fly(stores, rules, Duration::ZERO);
        assert_eq!(tally.counts.stored, stored, "{free_percent} %");
        assert_eq!(tally.archive.disk_full, FRAMES - stored);
        assert_eq!(flight::rows_in(&root), FRAMES as usize);
    }
}

#[test]
fn what_a_slow_disk_gives_up_is_what_the_configuration_says() {
    for &overflow in Overflow::KINDS {
        let root = tempfile::tempdir().unwrap();
        let disk = FaultyDisk::new(LocalDisk);
        disk.set(Some(Fault::Stuck));
        let rules = config::Archive {
            queue_frames: 4,
            overflow,
            ..settings(Sharing::Alternate)
        };
        let stores = vec![faulty(root.path(), &disk)];
        let tally = flight::dark(stores, rules, FRAMES, Duration::ZERO, |number| {
            match number {
                // The first frame is being written and is blocked by the disk.
                1 => disk.wait_until_stuck(),
                FRAMES => disk.set(None),
                _ => {}
            }
        });
        assert_eq!(tally.archive.overflowed, tally.counts.unstored);
        let expected = match overflow {
            Overflow::DropOldest => [0, 36, 37, 38, 39],
            Overflow::EveryNth | Overflow::SolutionsOnly => [0, 1, 2, 3, 4],
        };
        assert_eq!(numbers_in(root.path()), expected);
        assert_eq!(flight::rows_in(root.path()), FRAMES as usize);
    }
}

/// The frame numbers in the only solution log of a folder, in its order, and the number of rows of its housekeeping.
fn logged_in(root: &Path) -> (Vec<u64>, usize) {
    let entries = fs::read_dir(root).unwrap();
    let paths: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    let read = |what: &str| {
        let name = |path: &Path| path.file_name().unwrap().to_string_lossy().into_owned();
        let is_log = |path: &&PathBuf| name(path).starts_with(what) && name(path).ends_with(".csv");
        let logs: Vec<&PathBuf> = paths.iter().filter(is_log).collect();
        assert!(logs.len() < 2, "{logs:?}");
        let rows = logs.iter().flat_map(|log| {
            let mut log = csv::Reader::from_path(log).unwrap();
            let rows = log.records().map(|row| row.unwrap()[0].to_owned());
            rows.collect::<Vec<_>>()
        });
        rows.collect::<Vec<String>>()
    };
    let frames = read("solutions_").into_iter().map(|n| n.parse().unwrap());
    (frames.collect(), read("housekeeping_").len())
}

#[test]
fn a_disk_that_came_back_gets_its_logs_again() {
    let root = tempfile::tempdir().unwrap();
    let disk = FaultyDisk::new(LocalDisk);
    let stores = vec![faulty(root.path(), &disk)];
    let mut noted = 0;
    let tally = flight::dark(
        stores,
        settings(Sharing::Alternate),
        FRAMES,
        SLOW,
        |number| match number {
            10 => disk.set(Some(Fault::Gone)),
            20 => disk.set(None),
            // More than a second of housekeeping with the disk back.
            30 => {
                noted = logged_in(root.path()).1;
                std::thread::sleep(Duration::from_millis(2500));
            }
            _ => {}
        },
    );
    let (frames, notes) = logged_in(root.path());
    assert_eq!(frames, (0..FRAMES).collect::<Vec<_>>());
    assert!(
        notes > noted,
        "{notes} rows of housekeeping, {noted} before"
    );
    assert!(tally.archive.rows_refused > 0);
    assert_eq!((tally.archive.rows_lost, tally.lost()), (0, 0), "{tally}");
}

/// A copy of a folder, as if its disk were mounted again: the same bytes in new files.
fn copy(from: &Path, to: &Path) {
    fs::create_dir(to).unwrap();
    for entry in fs::read_dir(from).unwrap() {
        let entry = entry.unwrap();
        let (from, to) = (entry.path(), to.join(entry.file_name()));
        match entry.file_type().unwrap() {
            kind if kind.is_dir() => copy(&from, &to),
            kind if kind.is_file() => drop(fs::copy(from, to).unwrap()),
            _ => {}
        }
    }
}

#[test]
fn the_only_disks_logs_go_on_where_it_was_mounted_anew_and_nothing_is_written_in_its_place() {
    let parent = tempfile::tempdir().unwrap();
    let (mounted, away) = (parent.path().join("disk"), parent.path().join("away"));
    let tally = flight::dark(
        vec![open(&mounted)],
        settings(Sharing::Alternate),
        FRAMES,
        SLOW,
        |number| match number {
            10 => {
                fs::rename(&mounted, &away).unwrap();
                fs::create_dir(&mounted).unwrap();
            }
            20 => {
                assert_eq!(fs::read_dir(&mounted).unwrap().count(), 0);
                fs::remove_dir(&mounted).unwrap();
                copy(&away, &parent.path().join("anew"));
                fs::rename(parent.path().join("anew"), &mounted).unwrap();
                fs::remove_dir_all(&away).unwrap();
            }
            _ => {}
        },
    );
    assert_eq!(numbers_in(&mounted), (0..FRAMES).collect::<Vec<_>>());
    assert_eq!(logged_in(&mounted).0, (0..FRAMES).collect::<Vec<_>>());
    assert_eq!(tally.lost(), 0, "{tally}");
}

#[test]
fn a_row_that_one_of_two_disks_refused_is_counted_and_not_lost() {
    let disks = two();
    let roots = [disks[0].path(), disks[1].path()];
    let disk = FaultyDisk::new(LocalDisk);
    let stores = vec![faulty(roots[0], &disk), open(roots[1])];
    disk.set(Some(Fault::Step("create")));
    let tally = fly(stores, settings(Sharing::Alternate), Duration::ZERO);
    assert!(tally.archive.rows_refused >= FRAMES, "{tally}");
    assert_eq!((tally.archive.rows_lost, tally.lost()), (0, 0), "{tally}");
    assert_eq!(flight::rows_in(roots[1]) as u64, FRAMES);
}

#[test]
fn a_row_that_no_disk_took_is_lost() {
    let root = tempfile::tempdir().unwrap();
    let disk = FaultyDisk::new(LocalDisk);
    disk.set(Some(Fault::Step("write")));
    let stores = vec![faulty(root.path(), &disk)];
    let tally = fly(stores, settings(Sharing::Alternate), Duration::ZERO);
    assert_eq!(tally.archive.rows_lost, FRAMES, "{tally}");
    assert_eq!(tally.lost(), 2 * FRAMES, "frames and rows");
}

#[test]
fn frames_and_rows_in_the_hands_of_a_disk_that_hangs_are_counted_at_the_end() {
    let root = tempfile::tempdir().unwrap();
    let disk = FaultyDisk::new(LocalDisk);
    let stores = vec![faulty(root.path(), &disk)];
    let tally = flight::dark_asked_to_end(
        stores,
        settings(Sharing::Alternate),
        FRAMES,
        Duration::ZERO,
        |number| match number {
            10 => disk.set(Some(Fault::Stuck)),
            20 => disk.wait_until_stuck(),
            _ => {}
        },
    );
    let archive = &tally.archive;
    assert_eq!(tally.counts.taken, FRAMES);
    assert_eq!(
        tally.counts.stored + tally.counts.unstored,
        FRAMES,
        "{tally}"
    );
    assert!(
        tally.counts.unstored >= 20 && archive.unfinished > 0,
        "{tally}"
    );
    assert!(archive.rows_lost >= 20, "{tally}");
    assert!(tally.lost() >= tally.counts.unstored + archive.rows_lost);
    disk.set(None);
}

#[test]
fn a_second_program_may_not_write_to_an_archive() {
    let root = tempfile::tempdir().unwrap();
    let _first = open(root.path());
    let error = Store::open(root.path(), "demo", Compression::Rice)
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("archive.lock: expected to be the only program"),
        "{error}"
    );
}

/// A small file system in memory, if this user may mount one.
struct Tmpfs(TempDir);

impl Tmpfs {
    fn mount(options: &str) -> Option<Self> {
        let folder = tempfile::tempdir().unwrap();
        let mount = Command::new("mount")
            .args(["-t", "tmpfs", "-o", options, "tmpfs"])
            .arg(folder.path())
            .output();
        mount
            .is_ok_and(|run| run.status.success())
            .then_some(Self(folder))
    }
}

impl Tmpfs {
    fn unmount(&self) {
        let _ = Command::new("umount").arg("-l").arg(self.0.path()).output();
    }
}

impl Drop for Tmpfs {
    fn drop(&mut self) {
        self.unmount();
    }
}

#[test]
fn a_real_file_system_that_fills_leaves_the_rest_to_the_other() {
    let Some(small) = Tmpfs::mount("size=600k") else {
        return println!("not run: this user may not mount a tmpfs");
    };
    let second = tempfile::tempdir().unwrap();
    let roots = [small.0.path(), second.path()];
    let tally = fly(
        roots.map(open).into(),
        settings(Sharing::Alternate),
        SLOW / 5,
    );
    assert_eq!((tally.counts.stored, tally.counts.unstored), (FRAMES, 0));
    assert!(tally.archive.refused > 0);
    assert_each_once(roots);
    assert!(!frames_in(roots[0]).is_empty());
}

#[test]
fn a_real_file_system_that_is_unmounted_leaves_the_rest_to_the_other() {
    let Some(fading) = Tmpfs::mount("size=8m") else {
        return println!("not run: this user may not mount a tmpfs");
    };
    let second = tempfile::tempdir().unwrap();
    let roots = [fading.0.path(), second.path()];
    let mut gone = Vec::new();
    let tally = flight::dark(
        roots.map(open).into(),
        settings(Sharing::Alternate),
        FRAMES,
        SLOW / 5,
        |number| {
            if number == 20 {
                let stored = || {
                    roots
                        .iter()
                        .map(|root| frames_in(root).len())
                        .sum::<usize>()
                };
                while stored() < 20 {
                    std::thread::yield_now();
                }
                gone = numbers_in(roots[0]);
                fading.unmount();
            }
        },
    );
    assert_eq!((tally.counts.stored, tally.counts.unstored), (FRAMES, 0));
    assert_eq!(fs::read_dir(roots[0]).unwrap().count(), 0);
    let kept = numbers_in(roots[1]);
    let lost: Vec<u64> = (0..FRAMES).filter(|n| !kept.contains(n)).collect();
    assert!(!gone.is_empty() && kept.len() >= 20);
    // One more frame may have been written between the check and the unmounting.
    assert!(
        lost.starts_with(&gone) && lost.len() <= gone.len() + 1,
        "{gone:?} {lost:?}"
    );
}
