//! Files of an archive, read for viewers: only inside the archive, and with a time limit, because a disk may hang.
//!
//! Each read has its own thread. One that hangs keeps its thread until the disk answers; others continue.

use std::path::{Component, Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use tokio::sync::oneshot;

/// Maximum number of simultaneous reads, in all and of one file.
const MOST: usize = 16;
const MOST_OF_ONE: usize = 2;
/// Time limit of a read.
const LIMIT: Duration = Duration::from_secs(5);

/// Why a file was not read.
#[derive(Debug, thiserror::Error)]
pub enum Unread {
    #[error("{0}: {1} files wait for the disk: try again")]
    Busy(String, usize),
    #[error("{0}: the disk does not answer")]
    Hangs(String),
    #[error("{0}: {1}")]
    Failed(String, String),
}

/// The unfinished reads, by their files.
#[derive(Debug, Clone, Default)]
pub struct Reads(Arc<Mutex<Vec<String>>>);

impl Reads {
    /// Result of `read` on a named file under a folder.
    pub async fn read<T: Send + 'static>(
        &self,
        folder: PathBuf,
        name: String,
        read: impl FnOnce(&Path) -> anyhow::Result<T> + Send + 'static,
    ) -> Result<T, Unread> {
        let file = name.clone();
        let work = move || read(&within(&folder, &file)?);
        self.timely(name, LIMIT, work).await
    }

    async fn timely<T: Send + 'static>(
        &self,
        name: String,
        limit: Duration,
        work: impl FnOnce() -> anyhow::Result<T> + Send + 'static,
    ) -> Result<T, Unread> {
        let turn = self.turn(&name)?;
        let (done, result) = oneshot::channel();
        let thread = std::thread::Builder::new().name("read".into());
        let started = thread.spawn(move || {
            // The receiver may have gone.
            let _ = done.send(work());
            drop(turn);
        });
        let failed = |why: String| Unread::Failed(name.clone(), why);
        started.map_err(|error| failed(error.to_string()))?;
        match tokio::time::timeout(limit, result).await {
            Ok(Ok(Ok(read))) => Ok(read),
            Ok(Ok(Err(error))) => Err(failed(format!("{error:#}"))),
            Ok(Err(_)) => Err(failed("it could not be read".into())),
            Err(_) => Err(Unread::Hangs(name)),
        }
    }

    /// Registers a read, if the limits allow it.
    fn turn(&self, name: &str) -> Result<Turn, Unread> {
        let mut reads = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let of_one = reads.iter().filter(|other| *other == name).count();
        if of_one >= MOST_OF_ONE || reads.len() >= MOST {
            return Err(Unread::Busy(name.into(), reads.len()));
        }
        reads.push(name.into());
        Ok(Turn {
            reads: self.clone(),
            name: name.into(),
        })
    }
}

struct Turn {
    reads: Reads,
    name: String,
}

impl Drop for Turn {
    fn drop(&mut self) {
        let mut reads = self.reads.0.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(own) = reads.iter().position(|name| *name == self.name) {
            reads.swap_remove(own);
        }
    }
}

/// The regular file with a given name inside a folder, with links resolved.
fn within(folder: &Path, name: &str) -> anyhow::Result<PathBuf> {
    let relative = Path::new(name);
    let is_plain = |component| matches!(component, Component::Normal(_));
    if name.is_empty() || !relative.components().all(is_plain) {
        anyhow::bail!("expected a name inside the archive");
    }
    let root = folder.canonicalize()?;
    let path = root.join(relative).canonicalize()?;
    if !path.starts_with(&root) {
        anyhow::bail!("expected a file inside the archive, found a link that leaves it");
    }
    // Reading a pipe would block until it has a writer.
    if !path.metadata()?.is_file() {
        anyhow::bail!("expected a regular file");
    }
    Ok(path)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;
    use std::os::unix::fs::symlink;

    #[test]
    fn no_name_and_no_link_leads_out_of_the_archive() {
        let folder = tempfile::tempdir().unwrap();
        let archive = folder.path().join("archive");
        fs::create_dir_all(archive.join("hour")).unwrap();
        fs::write(folder.path().join("secret.txt"), "secret").unwrap();
        fs::write(archive.join("hour/frame.fits"), "frame").unwrap();
        symlink("/etc", archive.join("etc")).unwrap();
        symlink("../secret.txt", archive.join("link.fits")).unwrap();
        symlink("hour/frame.fits", archive.join("own.fits")).unwrap();
        for name in [
            "../secret.txt",
            "hour/../../secret.txt",
            "/etc/passwd",
            "etc/passwd",
            "link.fits",
            "",
            "hour",
            "/dev/zero",
        ] {
            assert!(within(&archive, name).is_err(), "{name:?}");
        }
        for name in ["hour/frame.fits", "own.fits"] {
            assert_eq!(fs::read(within(&archive, name).unwrap()).unwrap(), b"frame");
        }
    }

    #[test]
    fn a_pipe_is_refused_and_not_waited_for() {
        let folder = tempfile::tempdir().unwrap();
        let pipe = folder.path().join("frame.fits");
        nix::unistd::mkfifo(&pipe, nix::sys::stat::Mode::S_IRWXU).unwrap();
        assert!(within(folder.path(), "frame.fits").is_err());
    }

    #[test]
    fn a_file_that_hangs_costs_its_own_requests_and_no_others() {
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build();
        runtime.unwrap().block_on(async {
            let reads = Reads::default();
            let soon = Duration::from_millis(20);
            let (answer, wait) = crossbeam_channel::bounded::<()>(0);
            let mut statuses = Vec::new();
            for _ in 0..40 {
                let wait = wait.clone();
                let hang = move || Ok(wait.recv()?);
                let failed = reads.timely("hangs.fits".into(), soon, hang).await;
                statuses.push(failed.err());
            }
            let hang = |why: &Option<Unread>| matches!(why, Some(Unread::Hangs(_)));
            let wait = |why: &Option<Unread>| matches!(why, Some(Unread::Busy(..)));
            assert!(statuses[..2].iter().all(hang), "{statuses:?}");
            assert!(statuses[2..].iter().all(wait), "{statuses:?}");
            let read = reads.timely("good.fits".into(), LIMIT, || Ok(7)).await;
            assert_eq!(read.ok(), Some(7));
            // The disk answers.
            drop(answer);
            while !reads.0.lock().unwrap().is_empty() {
                tokio::time::sleep(Duration::from_millis(1)).await;
            }
            let read = reads.timely("hangs.fits".into(), LIMIT, || Ok(7)).await;
            assert_eq!(read.ok(), Some(7));
        });
    }
}
