//! Check of the archive's disks: whether they are present, have free space, and are fast enough.

use super::Finding;
use super::bounded::findings_within;
use crate::archive::disk::{Disk, LocalDisk};
use crate::archive::{ArchiveError, FreeSpace, Sharing, SpaceLimits, Store};
use crate::fits::Packing;
use crate::plan::{Plan, PlannedCamera, device};
use std::io::{self, ErrorKind};
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Size of a frame if no file states it.
const DEFAULT_PX: [usize; 2] = [1296, 966];
const TIMEOUT: Duration = Duration::from_secs(20);
/// Writing is timed for this long, and with at most this many files.
const TIMED: Duration = Duration::from_millis(500);
const FILES: u32 = 26;
/// A disk with space for less than this time of frames is useless.
const LEAST_S: f64 = 60.0;
const SILENT: &str = "the disk hangs: check its cable, its power and the kernel's messages (dmesg)";
const FREE: &str = "free the disk, or name another folder in archive.directory";

/// Demand on one disk.
#[derive(Debug, Clone)]
pub struct Demand {
    pub instrument: String,
    pub packing: Packing,
    pub limits: SpaceLimits,
    /// Bytes of a frame before compression.
    pub frame_bytes: usize,
    /// Rate of the frames for this disk.
    pub rate_hz: f64,
    /// Required space, in hours of frames.
    pub min_hours: f64,
}

impl Demand {
    fn of(plan: &Plan, disks: usize) -> Self {
        let archive = &plan.config.archive;
        // A camera whose size no file states is assumed to have the usual one.
        let size = |one: &PlannedCamera| {
            let [width, height] = one.camera.sees.size_px().unwrap_or(DEFAULT_PX);
            width * height * one.configured.pixel_format.bytes()
        };
        let rates = plan.cameras.iter().map(|one| one.configured.rate_hz);
        let rate_hz: f64 = rates.sum();
        let shares = match archive.sharing {
            Sharing::Alternate => disks.max(1) as f64,
            Sharing::Mirror => 1.0,
        };
        Self {
            instrument: plan
                .cameras
                .first()
                .map_or(String::new(), |one| one.camera.label.clone()),
            packing: archive.packing(),
            limits: archive.space_limits(),
            frame_bytes: plan.cameras.iter().map(size).max().unwrap_or(0),
            rate_hz: rate_hz / shares,
            min_hours: plan.config.preflight.min_archive_hours,
        }
    }
}

pub(super) fn check(plan: &Plan) -> Vec<Finding> {
    let folders = plan.folders();
    if folders.is_empty() {
        let found = "no folder: frames would not be kept";
        return vec![Finding::warn("archive", found, "set archive.directory")];
    }
    let demand = Demand::of(plan, folders.len());
    let mut findings = Vec::new();
    for folder in &folders {
        let (demand, work_folder) = (demand.clone(), folder.clone());
        let check = format!("disk {}", folder.display());
        findings.extend(findings_within(TIMEOUT, &check, SILENT, move || {
            check_folder(Arc::new(LocalDisk), &work_folder, &demand)
        }));
    }
    if let [first, second] = folders.as_slice() {
        findings.push(separate_devices(first, second));
    }
    findings
}

/// Remedy for a disk that refuses.
fn remedy(error: &ArchiveError) -> &'static str {
    match error {
        ArchiveError::Io { cause, .. } => remedy_for(cause),
        _ => FREE,
    }
}

fn remedy_for(cause: &io::Error) -> &'static str {
    match cause.kind() {
        ErrorKind::NotFound => {
            "is the disk mounted? mount it, or make the folder that is to hold the archive's"
        }
        ErrorKind::ResourceBusy => {
            "another program writes to this archive: stop the service first (systemctl stop solaspect)"
        }
        ErrorKind::ReadOnlyFilesystem => {
            "remount the disk writable; one that has turned read-only by itself is failing (dmesg)"
        }
        ErrorKind::PermissionDenied => "let the service's user write to the folder",
        ErrorKind::StorageFull | ErrorKind::QuotaExceeded => FREE,
        ErrorKind::NotADirectory | ErrorKind::AlreadyExists => {
            "name a folder in archive.directory, not a file"
        }
        _ => "see the kernel's messages (dmesg)",
    }
}

/// Opens one folder of the archive, as the flight does, measures its free space and times its writing. The files it writes are removed again.
pub fn check_folder(disk: Arc<dyn Disk>, folder: &Path, demand: &Demand) -> Vec<Finding> {
    let check = format!("disk {}", folder.display());
    let store = Store::new(
        Arc::clone(&disk),
        folder,
        &demand.instrument,
        demand.packing,
    );
    if let Err(error) = store.prepare() {
        return vec![Finding::fail(check, error.to_string(), remedy(&error))];
    }
    vec![
        free_space(&check, &store, demand),
        speed(&check, disk.as_ref(), folder, demand),
    ]
}

fn free_space(check: &str, store: &Store, demand: &Demand) -> Finding {
    let space = match store.space() {
        Ok(space) => space,
        Err(error) => return Finding::warn(check, error.to_string(), remedy(&error)),
    };
    let left = demand.limits.free_space(space.free_percent());
    let bytes_per_s = demand.frame_bytes as f64 * demand.rate_hz;
    let by_bytes_s = space.free_bytes as f64 / bytes_per_s.max(1.0);
    let files = space.free_files.map(|files| files as f64);
    let by_files_s = files.map_or(f64::INFINITY, |files| files / demand.rate_hz.max(1e-3));
    let seconds = by_bytes_s.min(by_files_s);
    let what = match files {
        Some(files) if by_files_s < by_bytes_s => {
            format!("; the disk takes {files} files more (inodes), a frame each")
        }
        _ => " before they are compressed".into(),
    };
    let found = format!(
        "{:.1} GB free ({:.0} %), for {} of frames{what}",
        space.free_bytes as f64 / 1e9,
        space.free_percent(),
        span(seconds)
    );
    let wanted = span(3600.0 * demand.min_hours);
    match left {
        _ if seconds < LEAST_S => {
            Finding::fail(check, format!("{found}: less than a minute"), FREE)
        }
        FreeSpace::Plenty if seconds < 3600.0 * demand.min_hours => {
            let found = format!("{found}: below min_archive_hours, {wanted}");
            Finding::warn(check, found, FREE)
        }
        FreeSpace::Plenty => Finding::pass(check, found),
        FreeSpace::Low => Finding::warn(check, format!("{found}: below warn_free_percent"), FREE),
        FreeSpace::Scarce => {
            Finding::fail(check, format!("{found}: frames would be thinned out"), FREE)
        }
        FreeSpace::None => {
            Finding::fail(check, format!("{found}: no frames would be stored"), FREE)
        }
    }
}

/// A duration in hours, or in minutes below one hour.
fn span(seconds: f64) -> String {
    match seconds < 3600.0 {
        true => format!("{:.1} min", seconds / 60.0),
        false => format!("{:.1} h", seconds / 3600.0),
    }
}

fn speed(check: &str, disk: &dyn Disk, folder: &Path, demand: &Demand) -> Finding {
    let files_per_s = match timed(disk, folder, demand.frame_bytes) {
        Ok(files_per_s) => files_per_s,
        Err(error) => {
            let found = format!("expected to write a frame's bytes, found \"{error}\"");
            return Finding::fail(check, found, remedy_for(&error));
        }
    };
    let (megabytes, rate_hz) = (demand.frame_bytes as f64 / 1e6, demand.rate_hz);
    let found = format!(
        "writes {files_per_s:.0} files/s of {megabytes:.1} MB, and is to take {rate_hz} frames/s"
    );
    match files_per_s >= rate_hz {
        true => Finding::pass(check, found),
        false => Finding::warn(
            check,
            format!("{found}: frames may be lost"),
            "take a faster disk, two that alternate, or a lower rate_hz",
        ),
    }
}

/// Number of files of this size that the disk stores per second; each is synced and removed again.
fn timed(disk: &dyn Disk, folder: &Path, bytes: usize) -> io::Result<f64> {
    // Bytes that no file system can compress.
    let content: Vec<u8> = (0..bytes as u64)
        .map(|n| (n.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 56) as u8)
        .collect();
    let start = Instant::now();
    let mut files = 0;
    while files < FILES && (files == 0 || start.elapsed() < TIMED) {
        // Files with this ending are removed at the next start, if this check is interrupted.
        let path = folder.join(format!(".preflight-{}-{files}.part", std::process::id()));
        let written = write(disk, folder, &path, &content);
        let removed = match disk.exists(&path) {
            true => disk.remove(&path),
            false => Ok(()),
        };
        written.and(removed)?;
        files += 1;
    }
    Ok(f64::from(files) / start.elapsed().as_secs_f64().max(1e-9))
}

fn write(disk: &dyn Disk, folder: &Path, path: &Path, content: &[u8]) -> io::Result<()> {
    let mut file = disk.create(path)?;
    file.write_all(content)?;
    file.sync()?;
    disk.sync_folder(folder)
}

fn separate_devices(first: &Path, second: &Path) -> Finding {
    let check = "two disks";
    match (device(first), device(second)) {
        (Some(a), Some(b)) if a != b => {
            Finding::pass(check, "the folders are on different devices")
        }
        (Some(_), Some(_)) => Finding::warn(
            check,
            "both folders are on one device: when it fails, both do",
            "mount the second disk, or leave second_directory out",
        ),
        _ => Finding::warn(
            check,
            "the system does not say on which devices they are",
            "make sure by other means that they are on two disks",
        ),
    }
}
