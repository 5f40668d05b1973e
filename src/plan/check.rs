//! Checks of the files and folders named in a plan. A flight opens its sources by itself, and does not wait for saved values or archive.

use super::{Plan, Remarks};
use crate::camera::{CameraError, FolderCamera, Source};
use crate::commands::controls::{SavedValues, differences};
use crate::config::{ConfiguredCamera, saved};
use crate::files;
use crate::instrument::TomlError;
use crate::simulate::Pieces;
use std::os::unix::fs::MetadataExt;
use std::path::Path;

impl Plan {
    /// Checks the folders and files that only the flight itself opens.
    pub fn check(&self, remarks: &mut Remarks) {
        for camera in self.config.cameras.flying() {
            source(camera, remarks);
        }
        if let [first, second] = &self.folders()[..] {
            let key = "archive.second_directory";
            let folders = [first, second].map(Clone::clone);
            let devices = move || folders.map(|folder| device(&folder));
            let devices = remarks.answered(key, devices);
            if first != second
                && devices.is_some_and(|[first, second]| first.is_some() && first == second)
            {
                let found = format!("{} on that of {}", second.display(), first.display());
                remarks.warn(key, "a folder on another disk", found);
            }
        }
        if let Some(file) = &self.config.link.saved_values {
            values_file(file, remarks);
        }
        self.saved_values(remarks);
    }

    /// Checks saved values of commands, which would replace the configuration's in flight.
    fn saved_values(&self, remarks: &mut Remarks) {
        let Some(file) = SavedValues::of(&self.config) else {
            return;
        };
        match differences(&self.controls(), &file) {
            Ok((differences, refused)) => {
                let expected = format!("the configuration's values in {}", file.path().display());
                for difference in differences {
                    remarks.warn("saved values", expected.clone(), difference);
                }
                for refused in refused {
                    let found = format!("{} (ignored)", refused.found);
                    remarks.warn(&refused.key, refused.expected, found);
                }
            }
            Err(error) => {
                remarks.warn("saved values", "a file that can be read", error.to_string())
            }
        }
    }
}

/// The device of a folder, or of its nearest existing parent.
pub fn device(folder: &Path) -> Option<u64> {
    let there = |folder: &Path| folder.metadata().ok();
    folder.ancestors().find_map(there).map(|found| found.dev())
}

/// Only checks whether they can be read and stored: the flight checks their checksum, and starts without them if it is wrong. A file with
/// other contents is never replaced.
fn values_file(file: &Path, remarks: &mut Remarks) {
    let key = "link.saved_values";
    let path = file.display();
    let folder = file
        .parent()
        .filter(|folder| !folder.as_os_str().is_empty());
    let folder = folder.unwrap_or(Path::new(".")).to_owned();
    let is_there = remarks.answered(key, move || folder.is_dir());
    if is_there == Some(false) {
        remarks.error(key, "a file in a folder that is there", path.to_string());
    }
    if is_there != Some(true) {
        return;
    }
    match files::read(file, saved::LARGEST) {
        Err(unread) if unread.is_absent() => {}
        Err(unread) => remarks.error(
            key,
            unread.expected(),
            format!("{path}: {}", unread.found()),
        ),
        Ok(bytes) if !saved::is_values_file(&bytes) => {
            let expected = "a file of saved values, or none: no other is replaced";
            remarks.error(key, expected, format!("{path}: another file"));
        }
        Ok(bytes) => {
            let parsed = String::from_utf8_lossy(&bytes).parse::<toml::Table>();
            remarks.noted(
                parsed.map_err(|error| TomlError::new(file, "", "valid TOML", error.message())),
            );
        }
    }
}

fn source(camera: &ConfiguredCamera, remarks: &mut Remarks) {
    let key = format!("{}.source", camera.name);
    match &camera.source {
        Some(Source::Folder(folder)) => {
            let (folder, rate_hz) = (folder.clone(), camera.rate_hz);
            let open = move || FolderCamera::open(&folder, rate_hz, 1.0).map(drop);
            match remarks.answered(&key, open) {
                None | Some(Ok(())) => {}
                Some(Err(CameraError::Folder { folder, found })) => {
                    let found = format!("{found} in {}", folder.display());
                    remarks.error(&key, "a folder of frames", found);
                }
                Some(Err(error)) => {
                    remarks.error(&key, "a folder of frames", error.to_string());
                }
            }
        }
        // If it does not exist, the flight keeps searching for it.
        Some(Source::Followed(folder, _)) => {
            let folder = folder.clone();
            let found = remarks.answered(&key, move || (folder.is_dir(), folder));
            if let Some((false, folder)) = found {
                let found = format!("none at {}", folder.display());
                remarks.error(&key, "a folder that another program fills", found);
            }
        }
        Some(Source::Simulated(Some(file))) => {
            remarks.noted(Pieces::read(file));
        }
        Some(Source::Device(_) | Source::Simulated(None) | Source::Own) | None => {}
    }
}
