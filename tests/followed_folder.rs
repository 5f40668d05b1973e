//! A folder that another program fills: each frame is taken once, when its file is complete, and none is lost or repeated,
//! whatever happens to writer, thread and program.

use crate::common::flight::{frames_in, numbers_in};
use crossbeam_channel::unbounded;
use jiff::{SignedDuration, Timestamp};
use solaspect::archive::Store;
use solaspect::aspect::Quality;
use solaspect::camera::{
    self, Backlog, Camera, CameraSettings, FollowedFolder, FrameSource, Source, SourceContext,
    Take, TakenFiles,
};
use solaspect::fits::{self, Compression};
use solaspect::frame::{Frame, FrameInfo, Pixels};
use solaspect::instrument::{Role, builtin};
use solaspect::plan::{Options, Plan};
use solaspect::service::{Flight, FlightCamera, FlightTally, Service};
use solaspect::simulate::{Conditions, RandomScenes};
use std::fs::{self, File};
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::Arc;
use std::thread;
use std::time::{Duration, Instant};
use tempfile::TempDir;

/// Timeout of waits, far longer than any step takes.
const LONG: Duration = Duration::from_secs(120);

#[track_caller]
fn wait_until(what: &str, mut done: impl FnMut() -> bool) {
    let start = Instant::now();
    while !done() {
        assert!(start.elapsed() < LONG, "{what}: it never came");
        thread::sleep(Duration::from_millis(5));
    }
}

/// A FITS file of a few pixels with this frame number.
fn file(number: u64) -> Vec<u8> {
    let info = FrameInfo {
        number: Some(number),
        ..FrameInfo::default()
    };
    let frame = Frame::new(2, 1, Pixels::U8(vec![5, 7]), 255, info).unwrap();
    fits::encode_frame(&frame, &[], &[], Compression::None).unwrap()
}

/// Puts a file in a folder by renaming it into place.
fn put(folder: &Path, name: &str, bytes: &[u8]) {
    let part = folder.join(format!(".{name}.part"));
    fs::write(&part, bytes).unwrap();
    fs::rename(part, folder.join(name)).unwrap();
}

/// A folder that contains the frames 0, 1, ..., followed from then on.
struct Followed {
    folder: TempDir,
    taken: TakenFiles,
    source: FollowedFolder,
}

impl Followed {
    fn new(backlog: Backlog, there: u64) -> Self {
        let folder = tempfile::tempdir().unwrap();
        (0..there).for_each(|n| put(folder.path(), &format!("{n}.fits"), &file(n)));
        let taken = TakenFiles::default();
        let source = FollowedFolder::open(folder.path(), backlog, &taken);
        Self {
            folder,
            taken,
            source,
        }
    }

    fn put(&self, name: &str, number: u64) {
        put(self.folder.path(), name, &file(number));
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Number of the next frame; asserts that its exposure is announced once.
    #[track_caller]
    fn next(&mut self) -> u64 {
        next(&mut self.source)
    }

    /// Asserts that no frame is left: a frame added now is the next one.
    #[track_caller]
    fn is_exhausted(&mut self) {
        self.put("zzz.fits", 999);
        assert_eq!(self.next(), 999);
    }
}

#[track_caller]
fn next(source: &mut dyn FrameSource) -> u64 {
    let start = Instant::now();
    let mut announced = 0;
    loop {
        match source.next(&mut |_| announced += 1).unwrap() {
            Take::Exposure(exposure) => {
                assert_eq!(announced, 1);
                return exposure.frame.info.number.unwrap();
            }
            Take::NotYet => assert!(start.elapsed() < LONG, "no frame came"),
            Take::End => panic!("it ended"),
        }
    }
}

#[test]
fn frames_come_once_in_the_order_in_which_their_files_became_whole() {
    let mut followed = Followed::new(Backlog::Skipped, 2);
    for (name, number) in [("c.fits", 10), ("a.FIT", 11), ("b.fits", 12)] {
        followed.put(name, number);
    }
    followed.put("no_frame.txt", 13);
    fs::write(followed.path(".hidden.fits"), file(14)).unwrap();
    assert_eq!([(); 3].map(|()| followed.next()), [10, 11, 12]);
    followed.is_exhausted();
}

#[test]
fn a_file_that_is_being_written_is_waited_for_and_holds_up_no_other() {
    let mut followed = Followed::new(Backlog::Skipped, 0);
    let bytes = file(1);
    let mut slow = File::create(followed.path("0.fits")).unwrap();
    for (n, chunk) in (10..).zip(bytes.chunks(bytes.len().div_ceil(3))) {
        slow.write_all(chunk).unwrap();
        slow.flush().unwrap();
        followed.put(&format!("{n}.fits"), n);
        assert_eq!(followed.next(), n);
    }
    drop(slow);
    assert_eq!(followed.next(), 1);
    // A file that is closed and reopened is no frame until it is complete.
    let (begin, end) = bytes.split_at(bytes.len() / 2);
    fs::write(followed.path("2.fits"), begin).unwrap();
    followed.put("3.fits", 3);
    assert_eq!(followed.next(), 3);
    let mut rest = File::options().append(true).open(followed.path("2.fits"));
    rest.as_mut().unwrap().write_all(end).unwrap();
    drop(rest);
    assert_eq!(followed.next(), 1);
    // A hard link is complete, although nothing was written to it.
    fs::hard_link(followed.path("3.fits"), followed.path("4.fits")).unwrap();
    assert_eq!(followed.next(), 3);
    followed.is_exhausted();
}

#[test]
fn a_file_that_stays_bad_is_named_once_and_the_next_goes_on() {
    let mut followed = Followed::new(Backlog::Skipped, 0);
    let half = &file(1)[..3000];
    let left = File::create(followed.path("left.fits")).unwrap();
    (&left).write_all(half).unwrap();
    fs::write(followed.path("half.fits"), half).unwrap();
    followed.put("whole.fits", 2);
    let (mut numbers, mut faults) = (Vec::new(), Vec::new());
    wait_until("both faults", || {
        match followed.source.next(&mut |_| {}) {
            Ok(Take::Exposure(exposure)) => numbers.push(exposure.frame.info.number.unwrap()),
            Ok(_) => {}
            Err(error) => faults.push(error.to_string()),
        }
        faults.len() == 2
    });
    assert_eq!(numbers, [2], "the good one was not waiting for them");
    faults.sort();
    for (fault, name) in faults.iter().zip(["half.fits", "left.fits"]) {
        assert!(
            fault.contains(name) && fault.contains("expected"),
            "{fault}"
        );
    }
    drop(left);
    followed.is_exhausted();
}

#[test]
fn what_lay_there_is_taken_where_that_is_asked_for_in_the_order_of_names() {
    let mut followed = Followed::new(Backlog::Taken, 3);
    followed.put("00.fits", 7);
    let mut numbers = [(); 4].map(|()| followed.next());
    assert!(
        numbers.iter().filter(|n| **n < 7).is_sorted(),
        "{numbers:?}"
    );
    numbers.sort_unstable();
    assert_eq!(numbers, [0, 1, 2, 7]);
    followed.is_exhausted();
}

#[test]
fn a_thread_that_starts_again_repeats_none_and_loses_none() {
    let mut followed = Followed::new(Backlog::Skipped, 2);
    followed.put("a.fits", 10);
    assert_eq!(followed.next(), 10);
    followed.put("b.fits", 11);
    followed.put("c.fits", 12);
    let folder = followed.folder.path();
    followed.source = FollowedFolder::open(folder, Backlog::Skipped, &followed.taken);
    assert_eq!([(); 2].map(|()| followed.next()), [11, 12]);
    followed.is_exhausted();
}

#[test]
fn folders_that_come_are_followed_with_what_is_in_them_and_renaming_makes_no_new_frame() {
    let mut followed = Followed::new(Backlog::Skipped, 1);
    let outside = tempfile::tempdir().unwrap();
    put(outside.path(), "o.fits", &file(20));
    let deep = followed.path("day/hour");
    fs::create_dir_all(&deep).unwrap();
    put(&deep, "a.fits", &file(10));
    assert_eq!(followed.next(), 10);
    put(&deep, "b.fits", &file(11));
    assert_eq!(followed.next(), 11);
    let same_disk = followed.path(".outside");
    fs::create_dir(&same_disk).unwrap();
    fs::copy(outside.path().join("o.fits"), same_disk.join("o.fits")).unwrap();
    fs::rename(&same_disk, followed.path("inside")).unwrap();
    assert_eq!(followed.next(), 20);
    // Renaming gives no new frame, of a file or of a folder; a name that is used again does.
    fs::rename(followed.path("0.fits"), followed.path("old.fits")).unwrap();
    fs::rename(deep.join("b.fits"), followed.path("b.fits")).unwrap();
    fs::rename(followed.path("day"), followed.path("yesterday")).unwrap();
    followed.is_exhausted();
    for number in [30, 31] {
        followed.put("now.fits", number);
        assert_eq!(followed.next(), number);
        let done = followed.path(&format!("done_{number}.fits"));
        fs::rename(followed.path("now.fits"), done).unwrap();
    }
    put(&followed.path("yesterday/hour"), "c.fits", &file(12));
    assert_eq!(followed.next(), 12);
}

#[test]
fn more_than_the_kernel_reports_is_found_by_listing_anew() {
    let mut followed = Followed::new(Backlog::Skipped, 1);
    let most = fs::read_to_string("/proc/sys/fs/inotify/max_queued_events").unwrap();
    let most: u64 = most.trim().parse().unwrap();
    followed.put("a.fits", 10);
    // The kernel merges identical successive events, so two files alternate.
    for n in 0..=most {
        drop(File::create(followed.path([".x", ".y"][n as usize % 2])).unwrap());
    }
    followed.put("c.fits", 12);
    followed.put("b.fits", 11);
    assert_eq!([(); 3].map(|()| followed.next()), [10, 11, 12]);
    followed.is_exhausted();
}

#[test]
fn a_folder_that_is_not_there_is_named_and_searched_until_it_is() {
    let above = tempfile::tempdir().unwrap();
    let folder = above.path().join("frames");
    let taken = TakenFiles::default();
    let mut source = FollowedFolder::open(&folder, Backlog::Taken, &taken);
    let mut error = String::new();
    let mut fails = |source: &mut FollowedFolder| {
        wait_until("an error", || {
            let failed = source.next(&mut |_| {}).err();
            failed.is_some_and(|failed| {
                error = failed.to_string();
                true
            })
        });
        error.clone()
    };
    let named = format!(
        "{}: expected a folder of frames, found \"No such",
        folder.display()
    );
    let said = fails(&mut source);
    assert!(said.starts_with(&named), "{said}");
    let next_patiently = |source: &mut FollowedFolder| {
        let mut number = None;
        wait_until("a frame", || {
            if let Ok(Take::Exposure(exposure)) = source.next(&mut |_| {}) {
                number = exposure.frame.info.number;
            }
            number.is_some()
        });
        number
    };
    fs::create_dir(&folder).unwrap();
    put(&folder, "0.fits", &file(0));
    assert_eq!(next_patiently(&mut source), Some(0));
    // Another folder takes its place; it contains a frame with a known name.
    fs::rename(&folder, above.path().join("gone")).unwrap();
    fs::create_dir(&folder).unwrap();
    put(&folder, "0.fits", &file(0));
    put(&folder, "1.fits", &file(1));
    let said = fails(&mut source);
    assert!(said.contains("another one in its place"), "{said}");
    assert_eq!(next_patiently(&mut source), Some(1));
}

fn settings(rate_hz: f64) -> CameraSettings {
    CameraSettings {
        rate_hz,
        ..CameraSettings::default()
    }
}

/// Frames of the demo instrument, drawn once and written repeatedly with other numbers and times.
struct Writer {
    drawn: Vec<Frame>,
    folder: PathBuf,
    written: u64,
}

impl Writer {
    fn new(folder: &Path) -> Self {
        let demo = builtin("demo").unwrap();
        let scenes = RandomScenes::new(&demo, &Conditions::of(&demo), 1).unwrap();
        let drawn = (0..4).map(|n| scenes.scene(n).unwrap().frame().unwrap());
        Self {
            drawn: drawn.collect(),
            folder: folder.into(),
            written: 0,
        }
    }

    /// Writes the next frame by renaming it into place.
    fn write(&mut self) {
        let of_ring = self.written as usize % self.drawn.len();
        let frame = &mut self.drawn[of_ring];
        frame.info.number = Some(self.written);
        // On this day the Sun has the radius with which it was drawn.
        let start: Timestamp = "2013-09-21T18:00:00Z".parse().unwrap();
        let since_start = Duration::from_secs_f64(self.written as f64 / 26.0);
        frame.info.mid_exposure = Some(start + since_start);
        let bytes = fits::encode_frame(frame, &[], &[], Compression::None).unwrap();
        let file = self.file(self.written);
        put(
            &self.folder,
            file.file_name().unwrap().to_str().unwrap(),
            &bytes,
        );
        self.written += 1;
    }

    fn file(&self, number: u64) -> PathBuf {
        self.folder.join(format!("frame_{number:08}.fits"))
    }
}

/// A flight that follows one folder and archives to another.
fn flight(folder: &Path, archive: &Path, rate_hz: f64) -> Flight {
    let demo = builtin("demo").unwrap();
    let source: Source = format!("folder:{}?follow", folder.display())
        .parse()
        .unwrap();
    let camera = Camera::of_plate(demo);
    let context = SourceContext {
        sees: camera.sees.clone(),
        seed: 1,
        clock: solaspect::clock::FlightClock::default(),
        duration: None,
        speed: 1.0,
        taken: TakenFiles::default(),
    };
    let open = move || camera::open(&source, &settings(rate_hz), &context);
    let mut flight = Flight::of(vec![FlightCamera {
        camera,
        source: Some(open().unwrap()),
        open: Some(Arc::new(open)),
    }]);
    flight.config.cameras.first_mut().rate_hz = rate_hz;
    flight.stores = vec![Store::open(archive, "demo", Compression::Rice).unwrap()];
    flight
}

/// Flies this many frames at 26 frames/s until all are solved; the tally and the frames' numbers in the order of the solutions.
fn flown_at_26_hz(frames: u64) -> (FlightTally, Vec<u64>) {
    let [folder, archive] = [(); 2].map(|()| tempfile::tempdir().unwrap());
    let mut flight = flight(folder.path(), archive.path(), 26.0);
    // The queue is as long as this test needs: a slow machine stores late.
    flight.config.archive.queue_frames = 4 * 26;
    let (service, answers) = Service::start_watched(flight).unwrap();
    let mut writer = Writer::new(folder.path());
    let (to_remove, solved_ones) = unbounded::<u64>();
    let writing = thread::spawn(move || {
        let start = Instant::now();
        while writer.written < frames {
            writer.write();
            for solved in solved_ones.try_iter() {
                fs::remove_file(writer.file(solved)).unwrap();
            }
            let due = Duration::from_secs_f64(writer.written as f64 / 26.0);
            thread::sleep(due.saturating_sub(start.elapsed()));
        }
    });
    let mut solved = Vec::new();
    while (solved.len() as u64) < frames {
        let answer = answers.recv_timeout(LONG);
        let answer = answer.unwrap_or_else(|_| panic!("{}", service.tally()));
        let number = answer.exposure.frame.info.number.unwrap();
        // Fails only after the last frame, when the writer has ended.
        let _ = to_remove.send(number);
        solved.push(number);
    }
    writing.join().unwrap();
    service.stop();
    let tally = service.join().unwrap();
    println!("{tally}");
    assert_eq!(numbers_in(archive.path()).len() as u64, frames);
    (tally, solved)
}

fn loses_nothing(frames: u64) {
    let (tally, numbers) = flown_at_26_hz(frames);
    assert!(numbers.into_iter().eq(0..frames), "each once, in order");
    let counts = (tally.counts.taken, tally.solved(), tally.counts.stored);
    assert_eq!(counts, (frames, frames, frames), "{tally}");
    assert_eq!((tally.camera.lost, tally.camera.failed), (0, 0), "{tally}");
    let fine = tally.solver(Role::PitchYaw).of(Quality::Fine);
    assert!(fine >= frames / 2, "{tally}");
}

#[test]
fn a_flight_at_26_frames_a_second_loses_nothing() {
    loses_nothing(4 * 26);
}

#[test]
#[ignore = "ten minutes: cargo test --release --test promises followed_folder -- --ignored --nocapture"]
fn a_flight_of_ten_minutes_at_26_frames_a_second_loses_nothing() {
    loses_nothing(600 * 26);
}

#[test]
fn a_writer_that_stops_is_a_silent_camera_until_it_goes_on() {
    let [folder, archive] = [(); 2].map(|()| tempfile::tempdir().unwrap());
    let service = Service::start(flight(folder.path(), archive.path(), 4.0)).unwrap();
    let mut writer = Writer::new(folder.path());
    writer.write();
    wait_until("a frame", || service.tally().counts.taken == 1);
    wait_until("the silence", || {
        let housekeeping = service.housekeeping();
        housekeeping.is_some_and(|housekeeping| housekeeping.silent_s >= 1)
    });
    assert_eq!(service.tally().camera.silences, 1);
    writer.write();
    wait_until("the other frame", || service.tally().counts.taken == 2);
    service.stop();
    let tally = service.join().unwrap();
    assert_eq!((tally.camera.failed, tally.restarts), (0, 0), "{tally}");
    assert_eq!(numbers_in(archive.path()), [0, 1]);
}

/// Starts the program on all files in a folder.
fn solaspect_flies(folder: &Path, archive: &Path) -> Child {
    let mut command = Command::new(env!("CARGO_BIN_EXE_solaspect"));
    let source = format!("folder:{}?follow=all", folder.display());
    let command = command.args(["fly", "--instrument", "demo", "--camera", &source]);
    let command = command.arg("--archive").arg(archive);
    command.stderr(Stdio::null()).stdout(Stdio::null());
    command.spawn().unwrap()
}

#[test]
fn a_program_that_is_killed_and_started_again_repeats_none_of_them() {
    let [folder, archive] = [(); 2].map(|()| tempfile::tempdir().unwrap());
    let mut writer = Writer::new(folder.path());
    let list = archive.path().join("taken_camera.txt");
    let listed = || fs::read_to_string(&list).map_or(0, |list| list.lines().count());
    // More frames than the solver's queue holds.
    for frames in [12, 15] {
        while writer.written < frames {
            writer.write();
        }
        let mut flying = solaspect_flies(folder.path(), archive.path());
        wait_until("all that lies there", || {
            assert!(flying.try_wait().unwrap().is_none(), "it ended by itself");
            frames_in(archive.path()).len() as u64 >= frames && listed() as u64 >= frames
        });
        flying.kill().unwrap();
        flying.wait().unwrap();
        let expected: Vec<u64> = (0..frames).collect();
        assert_eq!(numbers_in(archive.path()), expected);
    }
}

/// Errors in the plan of a flight that follows one folder and archives to another.
fn errors_of(source: &str, archive: &Path) -> Vec<String> {
    let options = Options {
        camera: Some(source.parse().unwrap()),
        instrument: Some("demo".into()),
        archive: vec![archive.into()],
        ..Options::default()
    };
    let (plan, mut remarks) = Plan::survey(None, &options);
    plan.check(&mut remarks);
    remarks.errors().map(ToString::to_string).collect()
}

#[test]
fn an_archive_in_the_folder_that_is_followed_is_an_error_and_so_is_no_folder() {
    let above = tempfile::tempdir().unwrap();
    let at = |name: &str| above.path().join(name);
    fs::create_dir(at("frames")).unwrap();
    std::os::unix::fs::symlink(at("frames"), at("link")).unwrap();
    let follow = |name: &str| format!("folder:{}?follow", at(name).display());
    assert_eq!(errors_of(&follow("frames"), &at("archive")), [""; 0]);
    for (frames, archive) in [
        ("frames", "frames"),
        ("frames", "frames/archive"),
        ("frames", "link/new/archive"),
        ("link", "frames/../frames/archive"),
        ("frames", ""),
    ] {
        let errors = errors_of(&follow(frames), &at(archive));
        let expected = "camera.source: expected a folder apart from the archive";
        assert!(
            errors.len() == 1 && errors[0].contains(expected),
            "{archive}: {errors:?}"
        );
    }
    let errors = errors_of(&follow("nowhere"), &at("archive"));
    let expected = format!("found none at {}", at("nowhere").display());
    assert!(
        errors.len() == 1 && errors[0].contains(&expected),
        "{errors:?}"
    );
    // The frames are a real camera's, so the instrument must be named.
    let options = Options {
        camera: Some(follow("frames").parse().unwrap()),
        ..Options::default()
    };
    let (_, remarks) = Plan::survey(None, &options);
    let keys = remarks.errors().map(|error| error.what.field.clone());
    assert_eq!(keys.collect::<Vec<_>>(), ["camera.instrument"]);
}

#[test]
fn a_frame_without_times_is_announced_when_it_comes_and_one_with_times_by_its_own() {
    let mut followed = Followed::new(Backlog::Skipped, 0);
    let middle: Timestamp = "2013-09-21T18:00:00Z".parse().unwrap();
    let info = FrameInfo {
        number: Some(1),
        mid_exposure: Some(middle),
        exposure: Some(Duration::from_millis(20)),
        ..FrameInfo::default()
    };
    let frame = Frame::new(2, 1, Pixels::U8(vec![5, 7]), 255, info).unwrap();
    let bytes = fits::encode_frame(&frame, &[], &[], Compression::None).unwrap();
    let begun = Timestamp::now();
    followed.put("0.fits", 0);
    put(followed.folder.path(), "1.fits", &bytes);
    let mut announced = Vec::new();
    wait_until("both", || {
        let taken = followed.source.next(&mut |start| announced.push(start));
        if let Take::Exposure(exposure) = taken.unwrap() {
            assert_eq!(announced.last(), Some(&exposure.announced));
        }
        announced.len() == 2
    });
    assert!(announced[0] >= begun);
    assert_eq!(announced[1], middle - SignedDuration::from_millis(10));
}
