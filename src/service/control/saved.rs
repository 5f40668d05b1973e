//! What commands have set, kept in a file over a restart.
//!
//! The file is a header line with a checksum, then TOML: one key and value a line. It is replaced as a whole, by a new
//! file that is on the disk before it takes the old one's name: a reader finds the old values or the new ones, never
//! half of them. The checksum is for what disks do later.

use super::Controls;
use crate::config::Value;
use crc::{CRC_32_ISO_HDLC, Crc};
use jiff::Timestamp;
use std::collections::BTreeMap;
use std::io::{self, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

const HEADER: &str = "# solaspect: values set by command. crc32 ";
static CRC: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);
/// How long the keeper waits for a change before it looks whether it is to end.
const PATIENCE: Duration = Duration::from_millis(100);
/// After a failure, the next attempt.
const RETRY: Duration = Duration::from_secs(10);

/// Why saved values cannot be used, or could not be saved.
#[derive(Debug, thiserror::Error)]
pub enum SavedError {
    #[error("{}: saved values: {cause}", .path.display())]
    File { path: PathBuf, cause: io::Error },
    #[error("{}: saved values: expected {expected}, found {found}", .path.display())]
    Damaged {
        path: PathBuf,
        expected: String,
        found: String,
    },
}

/// Sets what was saved. Whatever is wrong is logged, never fatal: a damaged file is set aside under another name, a value that is
/// refused is left out. Returns how many values were set.
pub fn restore(controls: &Controls, path: &Path) -> usize {
    let values = match read(path) {
        Ok(values) => values,
        Err(error) => {
            tracing::error!(%error, "starting without the saved values");
            if matches!(error, SavedError::Damaged { .. }) {
                set_aside(path);
            }
            return 0;
        }
    };
    // Together first: a place is refused by halves. One by one, where not all may be set.
    let settings: Vec<(&str, Value)> = values
        .iter()
        .map(|(k, v)| (k.as_str(), v.clone()))
        .collect();
    if controls.set(&settings).is_ok() {
        return settings.len();
    }
    let set = settings.iter().filter(|setting| {
        let result = controls.set(std::slice::from_ref(setting));
        if let Err(refused) = &result {
            tracing::error!(file = %path.display(), %refused, "a saved value was left out");
        }
        result.is_ok()
    });
    set.count()
}

/// A damaged file is kept for whoever wants to know.
fn set_aside(path: &Path) {
    let now = Timestamp::now().strftime("%Y%m%dT%H%M%SZ");
    let mut name = path.as_os_str().to_owned();
    name.push(format!(".damaged-{now}"));
    match std::fs::rename(path, &name) {
        Ok(()) => tracing::warn!(file = %Path::new(&name).display(), "the damaged file is kept"),
        Err(error) => tracing::error!(%error, "the damaged file could not be set aside"),
    }
}

/// The values of a file; none where there is no file.
fn read(path: &Path) -> Result<BTreeMap<String, Value>, SavedError> {
    let bytes = match std::fs::read(path) {
        Ok(bytes) => bytes,
        Err(error) if error.kind() == io::ErrorKind::NotFound => return Ok(BTreeMap::new()),
        Err(cause) => {
            let path = path.into();
            return Err(SavedError::File { path, cause });
        }
    };
    decode(&bytes).map_err(|(expected, found)| SavedError::Damaged {
        path: path.into(),
        expected,
        found,
    })
}

/// The values of a file's bytes, or what was expected and what was found.
fn decode(bytes: &[u8]) -> Result<BTreeMap<String, Value>, (String, String)> {
    let text = str::from_utf8(bytes).map_err(|e| ("UTF-8 text".into(), e.to_string()))?;
    let (header, body) = text.split_once('\n').unwrap_or((text, ""));
    let stated = header
        .strip_prefix(HEADER)
        .and_then(|hex| u32::from_str_radix(hex, 16).ok())
        .ok_or_else(|| {
            (
                format!("a first line \"{HEADER}...\""),
                format!("{header:?}"),
            )
        })?;
    let found = CRC.checksum(body.as_bytes());
    if found != stated {
        return Err((format!("crc32 {stated:08x}"), format!("{found:08x}")));
    }
    let table: toml::Table =
        toml::from_str(body).map_err(|error| ("TOML".into(), error.message().to_string()))?;
    let value = |key: &str, value: &toml::Value| {
        let of_a_kind = || {
            (
                format!("a number or a text as {key}"),
                value.type_str().into(),
            )
        };
        Value::from_toml(value).ok_or_else(of_a_kind)
    };
    table
        .iter()
        .map(|(k, v)| Ok((k.clone(), value(k, v)?)))
        .collect()
}

fn encode(values: &BTreeMap<String, Value>) -> String {
    let lines = values.iter().map(|(key, value)| match value {
        // A whole number would come back as one.
        Value::Number(number) => format!("{key:?} = {number:?}\n"),
        value => format!("{key:?} = {value}\n"),
    });
    let body: String = lines.collect();
    let crc = CRC.checksum(body.as_bytes());
    format!("{HEADER}{crc:08x}\n{body}")
}

/// Replaces the file as a whole.
fn write(path: &Path, values: &BTreeMap<String, Value>) -> Result<(), SavedError> {
    let folder = match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    };
    let replace = || -> io::Result<()> {
        let mut file = tempfile::Builder::new()
            .prefix(".values-")
            .tempfile_in(folder)?;
        file.write_all(encode(values).as_bytes())?;
        file.as_file().sync_all()?;
        file.persist(path)?;
        // The name, too, is to survive a power cut.
        std::fs::File::open(folder)?.sync_all()
    };
    replace().map_err(|cause| SavedError::File {
        path: path.into(),
        cause,
    })
}

/// Saves what commands set, on a thread of its own: a disk that hangs does not hold up an answer.
pub struct Keeper {
    controls: Controls,
    path: PathBuf,
}

impl Keeper {
    pub fn new(controls: Controls, path: PathBuf) -> Self {
        Self { controls, path }
    }

    /// Saves after every change until told to end, and then what is left to save. Returns how often it failed.
    pub fn run(self, ends: &AtomicBool) -> u64 {
        let changes = self.controls.0.changed.1.clone();
        let mut failed = 0;
        let mut retry_at = None;
        loop {
            let last = ends.load(Ordering::Relaxed);
            let changed = changes.recv_timeout(PATIENCE).is_ok();
            let due = retry_at.is_some_and(|at| std::time::Instant::now() >= at || last);
            if changed || due {
                retry_at = None;
                if let Err(error) = self.save() {
                    failed += 1;
                    tracing::error!(%error, failed, "values set by command were not saved");
                    retry_at = Some(std::time::Instant::now() + RETRY);
                }
            }
            if last {
                return failed;
            }
        }
    }

    fn save(&self) -> Result<(), SavedError> {
        let values = self.controls.state().commanded.clone();
        write(&self.path, &values)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Config;
    use crate::instrument::builtin;
    use crate::link::CameraRole;
    use crate::pointing::Target;
    use crate::service::Seat;

    fn controls() -> Controls {
        let mounting = builtin("demo").unwrap().mounting;
        Controls::new(Config::default(), Target::default(), mounting)
    }

    /// Sets some of every kind of value.
    fn set_values(controls: &Controls) {
        controls
            .set(&[
                ("target.x_arcsec", Value::Number(-300.0)),
                ("target.y_arcsec", Value::Number(450.0)),
                ("site.latitude_deg", Value::Number(34.5)),
                ("site.longitude_deg", Value::Number(-104.25)),
                ("camera.exposure_us", Value::Whole(12_000)),
                ("roll_camera.preamp_gain", Value::Number(-3.0)),
                ("store.roll", Value::Whole(0)),
                ("link.sending", Value::Whole(0)),
                ("mounting.twist_deg", Value::Number(0.125)),
            ])
            .unwrap();
    }

    fn names(folder: &Path) -> Vec<String> {
        let entries = std::fs::read_dir(folder).unwrap();
        let name = |entry: io::Result<std::fs::DirEntry>| entry.unwrap().file_name();
        let mut names: Vec<_> = entries.map(|e| name(e).into_string().unwrap()).collect();
        names.sort();
        names
    }

    #[test]
    fn what_was_set_survives_a_restart() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("values.toml");
        let before = controls();
        let keeper = Keeper::new(before.clone(), path.clone());
        let ends = AtomicBool::new(true);
        set_values(&before);
        assert_eq!(keeper.run(&ends), 0);

        let after = controls();
        assert_eq!(restore(&after, &path), 9);
        assert_eq!(after.snapshot(), before.snapshot());
        assert_eq!(after.config(), before.config());
        assert_eq!(after.camera(Seat::Roll).preamp_gain, Some(-3.0));
        assert!(!after.stores(CameraRole::Roll));
        assert_eq!(after.sending(), Some(false));
        assert_eq!(
            names(folder.path()),
            ["values.toml"],
            "nothing else is left"
        );
    }

    #[test]
    fn without_a_file_nothing_is_set_and_nothing_is_wrong() {
        let folder = tempfile::tempdir().unwrap();
        let controls = controls();
        let before = controls.snapshot();
        assert_eq!(restore(&controls, &folder.path().join("values.toml")), 0);
        assert_eq!(controls.snapshot(), before);
        assert!(names(folder.path()).is_empty());
    }

    #[test]
    fn a_damaged_file_is_set_aside_and_the_flight_starts_without_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("values.toml");
        let good = controls();
        set_values(&good);
        write(&path, &good.state().commanded).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let middle = bytes.len() / 2;
        let mut flipped = bytes.clone();
        flipped[middle] ^= 1;
        let cut = bytes[..middle].to_vec();
        for damaged in [flipped, cut, b"\xFF\xFE".to_vec(), Vec::new()] {
            std::fs::write(&path, damaged).unwrap();
            let controls = controls();
            assert_eq!(restore(&controls, &path), 0);
            assert_eq!(controls.config(), Config::default());
            let names = names(folder.path());
            assert_eq!(names.len(), 1);
            assert!(names[0].starts_with("values.toml.damaged-"), "{names:?}");
            std::fs::remove_file(folder.path().join(&names[0])).unwrap();
        }
    }

    #[test]
    fn any_one_bit_wrong_is_found() {
        let good = controls();
        set_values(&good);
        let bytes = encode(&good.state().commanded).into_bytes();
        assert!(decode(&bytes).is_ok());
        for bit in 0..8 * bytes.len() {
            let mut wrong = bytes.clone();
            wrong[bit / 8] ^= 1 << (bit % 8);
            // Letters of the checksum's own hexadecimal digits may be of either case.
            if !wrong.eq_ignore_ascii_case(&bytes) {
                assert!(decode(&wrong).is_err(), "bit {bit}");
            }
        }
    }

    #[test]
    fn a_value_that_is_no_longer_allowed_is_left_out_and_the_others_are_set() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("values.toml");
        let values = BTreeMap::from([
            ("camera.exposure_us".to_owned(), Value::Whole(0)),
            ("no.such_key".to_owned(), Value::Whole(0)),
            ("store.roll".to_owned(), Value::Whole(0)),
        ]);
        write(&path, &values).unwrap();
        let controls = controls();
        assert_eq!(restore(&controls, &path), 1);
        assert!(!controls.stores(CameraRole::Roll));
        assert_eq!(controls.config(), Config::default());
    }

    #[test]
    fn a_folder_that_takes_nothing_is_counted_and_ends_nothing() {
        let controls = controls();
        set_values(&controls);
        let keeper = Keeper::new(controls, PathBuf::from("/nowhere/at/all/values.toml"));
        assert_eq!(keeper.run(&AtomicBool::new(true)), 1);
    }
}
