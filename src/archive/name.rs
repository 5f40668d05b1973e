//! The names of archived frames: they sort by time, and each folder covers an hour.

use crate::instrument::Role;
use jiff::Timestamp;
use std::path::{Path, PathBuf};

/// The role and the ordinal (from 1) of the camera to which a file belongs, by its name; `None` if an instrument names the camera.
pub fn role_of(path: &Path) -> Option<(Role, usize)> {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let (camera, _) = stem.split_once('_')?;
    Role::labelled(camera)
}

/// The time in a frame's name.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum NameTime {
    MidExposure(Timestamp),
    /// Time of writing, because the frame has no time. Such a frame goes to a folder of its own, so that this is not mistaken for the time of the
    /// exposure.
    Written(Timestamp),
}

/// Path of a frame under the archive's root:
/// `20130921T18/heroes-pyas-f_20130921T180000.250_00000042.fits`, or `undated/...` without a time. A frame without
/// a number has none in its name. Times are UTC.
pub fn name(instrument: &str, time: NameTime, number: Option<u64>) -> PathBuf {
    let (folder, instant) = match time {
        NameTime::MidExposure(instant) => (instant.strftime("%Y%m%dT%H").to_string(), instant),
        NameTime::Written(instant) => ("undated".into(), instant),
    };
    let instant = instant.strftime("%Y%m%dT%H%M%S.%3f");
    let number = number.map_or(String::new(), |number| format!("_{number:08}"));
    let instrument = plain(instrument);
    PathBuf::from(folder).join(format!("{instrument}_{instant}{number}.fits"))
}

/// The name of an instrument without characters that have a meaning for a shell, a file system or the parts of a file's name: it is used in the names
/// of folders and files.
pub fn plain(instrument: &str) -> String {
    let kept = |c: char| if c.is_ascii_alphanumeric() { c } else { '-' };
    match instrument {
        "" => "unnamed".into(),
        name => name.chars().map(kept).collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn dated(utc: &str, number: u64) -> String {
        let time = NameTime::MidExposure(utc.parse().unwrap());
        name("pyas-f", time, Some(number)).display().to_string()
    }

    #[test]
    fn a_name_gives_instrument_time_and_number() {
        assert_eq!(
            dated("2013-09-21T18:00:00.2504Z", 42),
            "20130921T18/pyas-f_20130921T180000.250_00000042.fits"
        );
        let written = NameTime::Written("2026-01-02T03:04:05Z".parse().unwrap());
        assert_eq!(
            name("a/../b c", written, None).display().to_string(),
            "undated/a----b-c_20260102T030405.000.fits"
        );
    }

    #[test]
    fn names_sort_by_time() {
        let times = [
            "2013-09-21T09:59:59.999Z",
            "2013-09-21T10:00:00Z",
            "2013-09-21T10:00:00.001Z",
            "2013-09-21T23:59:59.999Z",
            "2013-10-01T00:00:00Z",
        ];
        let names: Vec<String> = times.iter().zip(0..).map(|(t, n)| dated(t, n)).collect();
        assert!(names.is_sorted(), "{names:?}");
    }
}
