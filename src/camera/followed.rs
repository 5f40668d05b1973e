//! A folder that another program fills, as a camera: it gives each frame once, as soon as its file is complete.
//!
//! ```text
//! reports of the kernel, listings -> complete ---------> a frame
//!                                 -> unfinished -> complete
//! ```
//!
//! A file is complete when it has been closed after writing or renamed into place, or has not changed for 1 s, and can be read. The frames come in
//! the order in which their files became complete; those found at the same time, in the order of their names. A file that cannot be read for 5 s
//! after its last change is bad: it is reported once as an error. It does not delay the others.

use super::folder_watch::{Change, FileState, FolderWatch, state_of};
use super::pace::TIMEOUT;
use super::taken_files::{TakenFiles, name_in_list};
use super::{CameraError, Exposure, FrameSource, Take};
use crate::backoff::Backoff;
use crate::fits;
use crate::frame::Warnings;
use crate::log::worth_a_line;
use jiff::Timestamp;
use std::collections::{BTreeMap, VecDeque};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant, SystemTime};

/// Time for the first listing of the folder before the flight begins; a longer listing continues during the flight.
const OPENING: Duration = Duration::from_secs(2);
/// Time without a change after which a file that was not reported as complete is read.
const QUIET: Duration = Duration::from_secs(1);
/// Time after its last change at which a file that cannot be read is bad.
const GIVE_UP: Duration = Duration::from_secs(5);
/// How often unfinished files are checked.
const CHECK_EVERY: Duration = TIMEOUT;

/// Use of the frames that are already in a folder when it is first found.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Backlog {
    /// They are skipped.
    Skipped,
    /// They are taken, except for those that an earlier run has taken.
    Taken,
}

/// Takes the frames that another program writes into a folder, and the folders in it.
pub struct FollowedFolder {
    folder: PathBuf,
    backlog: Backlog,
    taken: TakenFiles,
    /// `None` while there is no such folder.
    watch: Option<FolderWatch>,
    backoff: Backoff,
    /// Time of the next search for a folder that is missing.
    due: Instant,
    /// Files believed to be complete, in the order in which they became so.
    complete: VecDeque<PathBuf>,
    /// Files that may still be written.
    unfinished: BTreeMap<PathBuf, Unfinished>,
    /// Time of the next check of the unfinished files.
    check_due: Instant,
    /// Number of files that were rewritten under a name that had already been taken.
    rewritten: u64,
    warnings: Warnings,
}

/// A file that may still be written.
struct Unfinished {
    state: Option<FileState>,
    /// Time at which it was found in this state.
    since: Instant,
    /// Whether an attempt to read it in this state has failed.
    is_tried: bool,
}

impl Unfinished {
    fn new(file: &Path) -> Self {
        Self {
            state: state_of(file),
            since: Instant::now(),
            is_tried: false,
        }
    }

    /// Whether it is time to read it, or read it again.
    fn is_due(&self) -> bool {
        let limit = if self.is_tried { GIVE_UP } else { QUIET };
        self.since.elapsed() >= limit
    }
}

impl FollowedFolder {
    /// Follows a folder, which need not exist yet.
    pub fn open(folder: &Path, backlog: Backlog, taken: &TakenFiles) -> Self {
        let now = Instant::now();
        let mut followed = Self {
            folder: folder.into(),
            backlog,
            taken: taken.clone(),
            watch: None,
            backoff: Backoff::DEVICE,
            due: now,
            complete: VecDeque::new(),
            unfinished: BTreeMap::new(),
            check_due: now,
            rewritten: 0,
            warnings: Warnings::default(),
        };
        while !taken.has_started() && now.elapsed() < OPENING {
            // A missing folder is reported when frames are requested.
            if followed.follow(TIMEOUT).is_err() {
                followed.due = now;
                break;
            }
        }
        followed
    }

    /// Waits for events in the folder, and notes them.
    fn follow(&mut self, timeout: Duration) -> Result<(), CameraError> {
        let wait = self.due.saturating_duration_since(Instant::now());
        if self.watch.is_none() && !wait.is_zero() {
            std::thread::sleep(wait.min(timeout));
            return Ok(());
        }
        let changes = self.watched().and_then(|watch| watch.wait(timeout));
        match changes {
            Ok(changes) => changes.into_iter().for_each(|change| self.note(change)),
            Err(error) => {
                self.watch = None;
                self.due = Instant::now() + self.backoff.wait();
                return Err(error);
            }
        }
        Ok(())
    }

    fn watched(&mut self) -> Result<&mut FolderWatch, CameraError> {
        Ok(match self.watch.take() {
            Some(watch) => self.watch.insert(watch),
            None => self.watch.insert(FolderWatch::start(&self.folder)?),
        })
    }

    fn name(&self, file: &Path) -> String {
        name_in_list(&self.folder, file)
    }

    /// Whether a file is a frame that is not yet taken.
    fn is_new(&self, file: &Path) -> bool {
        fits::is_frame_name(file) && !self.taken.knows(&self.name(file))
    }

    fn note(&mut self, change: Change) {
        match change {
            Change::Listed(files) => self.note_listed(files),
            Change::Created(file) if self.is_new(&file) => self.note_created(file),
            Change::Created(_) => {}
            Change::Complete(file) => self.note_complete(file),
            Change::Gone(file) => self.forget(&file),
            Change::Renamed { from, to } => {
                self.forget(&from);
                let before = self.name(&from);
                match self.taken.knows(&before) {
                    true => {
                        // The next file with that name is a different one.
                        self.taken.release(&before);
                        self.taken.record(&self.name(&to), None);
                    }
                    false => self.note_complete(to),
                }
            }
            Change::Moved(files) => {
                let names = files.iter().map(|file| self.name(file));
                names.for_each(|name| self.taken.record(&name, None));
            }
        }
    }

    fn note_listed(&mut self, files: Vec<(PathBuf, FileState)>) {
        self.backoff.reset();
        if !self.taken.has_started() && self.skips_existing(&files) {
            return;
        }
        let is_old = |(_, changed): FileState| {
            let age = SystemTime::now().duration_since(changed);
            age.is_ok_and(|age| age > GIVE_UP)
        };
        for (file, state) in files {
            match self.is_new(&file) {
                true if is_old(state) => self.complete.push_back(file),
                true => self.note_created(file),
                false => {}
            }
        }
    }

    /// Whether these files, which are in the folder when it is first found, are skipped.
    fn skips_existing(&self, files: &[(PathBuf, FileState)]) -> bool {
        if self.backlog == Backlog::Taken {
            match self.taken.start_with_list() {
                Ok(()) => return false,
                Err(error) => {
                    let folder = self.folder.display().to_string();
                    tracing::error!(folder, %error, "the record of taken files cannot be read: files that are there are passed over");
                }
            }
        }
        let names: Vec<String> = files.iter().map(|(file, _)| self.name(file)).collect();
        self.taken.skip_existing(names.iter().map(String::as_str));
        true
    }

    fn note_created(&mut self, file: PathBuf) {
        let entry = self.unfinished.entry(file);
        entry.or_insert_with_key(|file| Unfinished::new(file));
    }

    fn note_complete(&mut self, file: PathBuf) {
        if self.is_new(&file) {
            self.unfinished.remove(&file);
            self.complete.push_back(file);
        } else if fits::is_frame_name(&file) {
            self.rewritten += 1;
            if worth_a_line(self.rewritten) {
                let (file, times) = (file.display().to_string(), self.rewritten);
                tracing::warn!(
                    file,
                    times,
                    "written again under a name that was taken: it is left alone"
                );
            }
        }
    }

    /// Notes that a file no longer has this name.
    fn forget(&mut self, file: &Path) {
        if fits::is_frame_name(file) {
            self.unfinished.remove(file);
            self.complete.retain(|other| other != file);
        }
    }

    /// Checks which of the unfinished files may be complete by now.
    fn check(&mut self) {
        let now = Instant::now();
        if now < self.check_due {
            return;
        }
        self.check_due = now + CHECK_EVERY;
        let (taken, folder, complete) = (&self.taken, &self.folder, &mut self.complete);
        self.unfinished.retain(|file, unfinished| {
            let state = state_of(file);
            if state.is_none() || taken.knows(&name_in_list(folder, file)) {
                return false;
            }
            if state != unfinished.state {
                *unfinished = Unfinished::new(file);
            } else if unfinished.is_due() && !complete.contains(file) {
                complete.push_back(file.clone());
            }
            true
        });
    }

    /// Reads a file that is believed to be complete.
    fn take(&mut self, file: &Path) -> Result<Option<Exposure>, CameraError> {
        let name = self.name(file);
        if !self.taken.claim(&name) {
            return Ok(None);
        }
        let state = state_of(file);
        let error = match fits::read_frame(file) {
            Ok(frame) => {
                self.unfinished.remove(file);
                self.taken.record(&name, None);
                let warnings = &frame.info.warnings;
                self.warnings.note(&file.display().to_string(), warnings);
                let start = frame.info.exposure_start();
                let announced = start.unwrap_or_else(Timestamp::now);
                return Ok(Some(Exposure { frame, announced }));
            }
            Err(error) => error,
        };
        if state.is_none() {
            // Renamed meanwhile, which will be reported, or removed.
            tracing::debug!(%error, "gone before it was read");
            self.taken.release(&name);
            return Ok(None);
        }
        let unfinished = self.unfinished.entry(file.into());
        let unfinished = unfinished.or_insert_with(|| Unfinished::new(file));
        if unfinished.is_tried && unfinished.is_due() {
            self.unfinished.remove(file);
            self.taken.record(&name, Some(&error.problem.to_string()));
            return Err(error.into());
        }
        unfinished.is_tried = true;
        self.taken.release(&name);
        Ok(None)
    }
}

impl FrameSource for FollowedFolder {
    /// Reports the start of an exposure when its frame is available.
    fn next(&mut self, starts: &mut dyn FnMut(Timestamp)) -> Result<Take, CameraError> {
        let timeout = match self.complete.is_empty() {
            true => TIMEOUT,
            false => Duration::ZERO,
        };
        self.follow(timeout)?;
        self.check();
        let Some(file) = self.complete.pop_front() else {
            return Ok(Take::NotYet);
        };
        let Some(exposure) = self.take(&file)? else {
            return Ok(Take::NotYet);
        };
        starts(exposure.announced);
        Ok(Take::Exposure(Box::new(exposure)))
    }

    fn frames_wait(&self) -> bool {
        true
    }

    fn falls_silent(&self) -> bool {
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fits::{Compression, encode_frame};
    use crate::frame::{Frame, FrameInfo, Pixels};
    use std::fs;

    fn file(number: u64) -> Vec<u8> {
        let info = FrameInfo {
            number: Some(number),
            ..FrameInfo::default()
        };
        let frame = Frame::new(2, 1, Pixels::U8(vec![5, 7]), 255, info).unwrap();
        encode_frame(&frame, &[], &[], Compression::None).unwrap()
    }

    fn next(followed: &mut FollowedFolder) -> u64 {
        let start = Instant::now();
        while start.elapsed() < Duration::from_secs(60) {
            if let Take::Exposure(exposure) = followed.next(&mut |_| {}).unwrap() {
                return exposure.frame.info.number.unwrap();
            }
        }
        panic!("no frame came");
    }

    #[test]
    fn a_folder_of_which_the_kernel_reports_nothing_is_listed_over_and_over() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        fs::write(at("0.fits"), file(0)).unwrap();
        let taken = TakenFiles::default();
        let mut followed = FollowedFolder::open(folder.path(), Backlog::Skipped, &taken);
        followed.watch = Some(FolderWatch::start_unreported(folder.path()).unwrap());
        fs::create_dir(at("day")).unwrap();
        fs::write(at("day/1.fits"), file(1)).unwrap();
        assert_eq!(next(&mut followed), 1);
        fs::write(at("2.fits"), &file(2)[..3000]).unwrap();
        fs::write(at("3.fits"), file(3)).unwrap();
        assert_eq!(next(&mut followed), 3);
        fs::write(at("2.fits"), file(2)).unwrap();
        assert_eq!(next(&mut followed), 2);
    }

    #[test]
    fn a_call_for_a_frame_that_does_not_come_returns_within_a_second() {
        let folder = tempfile::tempdir().unwrap();
        let taken = TakenFiles::default();
        let mut followed = FollowedFolder::open(folder.path(), Backlog::Skipped, &taken);
        let begun = Instant::now();
        assert!(matches!(followed.next(&mut |_| {}), Ok(Take::NotYet)));
        // It waits for a quarter of this time; the computer may be slow.
        assert!(begun.elapsed() < Duration::from_secs(5));
    }
}
