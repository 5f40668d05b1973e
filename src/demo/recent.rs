//! Recent frames of a demonstration without end.

use crate::fits::list_tree;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use std::{fs, io};

/// How long a frame is kept: those of both cameras at 4 Hz are 3.6 MB/s.
const KEPT: Duration = Duration::from_secs(600);
/// How often older frames are searched for.
const CHECK_EVERY: Duration = Duration::from_secs(60);

/// An archive that keeps its newest frames. Logs stay.
pub(super) struct Recent {
    folder: PathBuf,
    checked: Instant,
}

impl Recent {
    pub fn of(folder: &Path) -> Self {
        Self {
            folder: folder.into(),
            checked: Instant::now(),
        }
    }

    /// Removes the older frames from time to time.
    pub fn tidy(&mut self) {
        if self.checked.elapsed() < CHECK_EVERY {
            return;
        }
        self.checked = Instant::now();
        if let Err(error) = remove_old(&self.folder, KEPT) {
            tracing::warn!(%error, "old frames of the demonstration were not removed");
        }
    }
}

/// Removes the frames below a folder that were written longer ago than `kept`.
fn remove_old(folder: &Path, kept: Duration) -> io::Result<()> {
    for frame in list_tree(folder).map_err(|unlisted| unlisted.cause)? {
        let age = fs::metadata(&frame)?.modified()?.elapsed();
        if age.unwrap_or_default() > kept {
            fs::remove_file(frame)?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs::File;
    use std::time::SystemTime;

    #[test]
    fn frames_that_are_old_go_and_all_else_stays() {
        let folder = tempfile::tempdir().unwrap();
        let hour = folder.path().join("20130921T18");
        fs::create_dir(&hour).unwrap();
        let old = SystemTime::now() - 2 * KEPT;
        for (name, time) in [
            ("old.fits", old),
            ("old.csv", old),
            ("new.fits", SystemTime::now()),
        ] {
            let file = File::create(hour.join(name)).unwrap();
            file.set_modified(time).unwrap();
        }
        remove_old(folder.path(), KEPT).unwrap();
        let left = ["old.fits", "old.csv", "new.fits"].map(|name| hour.join(name).exists());
        assert_eq!(left, [false, true, true]);
    }
}
