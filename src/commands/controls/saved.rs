//! Values set by commands, saved in a file for the next start.
//!
//! The file is a header line with a checksum, then TOML: one key and value per line. It is replaced atomically, by a new
//! file that is on the disk before it is renamed: a reader finds the old values or the new ones, never
//! a mixture. The checksum detects later damage by the disk. The header distinguishes this file from all others: another file that is named by
//! mistake is neither read nor replaced.
//!
//! Tracking and the last GPS fix are saved, too, but only for a flight that continues: they are restored within the same
//! boot of the computer, or if they were saved a short time ago. A computer that is switched on the next day in the
//! laboratory does not steer. While there is such a value, the file is rewritten each minute, with the time.

mod file;

pub use file::SavedValues;

use super::Controls;
use crate::archive::disk::Lock;
use crate::backoff::Backoff;
use crate::commands::CommandNote;
use crate::commands::setting::{LATITUDE, LONGITUDE, TRACKING};
use crate::commands::words::CommandInWords;
use crate::config::saved::HEADER;
use crate::config::{Refused, Value};
use crate::log::worth_a_line;
use crc::{CRC_32_ISO_HDLC, Crc};
use crossbeam_channel::Sender;
use jiff::Timestamp;
use std::collections::BTreeMap;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

static CRC: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);
/// How long the thread waits for a change before it checks whether it must end.
const TIMEOUT: Duration = Duration::from_millis(100);
/// How often the file is rewritten while it holds a short-lived value.
const REFRESH: Duration = Duration::from_secs(60);
/// The keys with short-lived values.
const SHORT_LIVED: [&str; 3] = [TRACKING.key(), LATITUDE.key(), LONGITUDE.key()];
/// The keys that state when the file was written: the time, and the boot of the computer.
const WRITTEN_UTC: &str = "written.utc";
const WRITTEN_BOOT: &str = "written.boot";
/// File in which Linux gives a number that changes with each boot.
const BOOT_ID: &str = "/proc/sys/kernel/random/boot_id";

/// Reason why saved values cannot be used, or could not be saved.
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
    #[error("{}: saved values: expected a file that this program has written, or none, found {found}", .path.display())]
    Foreign { path: PathBuf, found: String },
    #[error("{}: saved values: expected to be the only program that flies with them, found another program", .path.display())]
    Taken { path: PathBuf },
}

/// Time at which a file was written.
#[derive(Debug, Clone, PartialEq)]
struct Written {
    utc: Timestamp,
    /// `None` if the system does not report it.
    boot: Option<String>,
}

impl Written {
    fn now() -> Self {
        let boot = std::fs::read_to_string(BOOT_ID).ok();
        Self {
            utc: Timestamp::now(),
            boot: boot.map(|id| id.trim().to_owned()),
        }
    }

    /// Removes it from the values of a file and returns it.
    fn take(values: &mut BTreeMap<String, Value>) -> Option<Self> {
        let mut text = |key| match values.remove(key) {
            Some(Value::Text(text)) => Some(text),
            _ => None,
        };
        let (utc, boot) = (text(WRITTEN_UTC), text(WRITTEN_BOOT));
        Some(Self {
            utc: utc?.parse().ok()?,
            boot,
        })
    }

    /// Whether a flight of `then` continues now. If the clock has been set back, only the boot counts.
    fn is_recent(&self, then: &Self, limit: Duration) -> bool {
        let same_boot = self.boot.is_some() && self.boot == then.boot;
        let age = Duration::try_from(self.utc.duration_since(then.utc));
        same_boot || age.is_ok_and(|age| age <= limit)
    }
}

/// Sets the saved values, except for keys that have been commanded since. All errors are logged, none is fatal: a damaged file is renamed,
/// a refused value is omitted. Returns the number of values set.
pub fn restore(controls: &Controls, file: &SavedValues) -> usize {
    let restored = restore_at(controls, file, &Written::now());
    let differences = controls.differences();
    if !differences.is_empty() {
        let (file, values) = (file.path().display(), differences.join(", "));
        tracing::warn!(%file, values, "saved values fly instead of the configuration's");
    }
    restored
}

/// Differences of a file of saved values from the configuration, each in words, and those that would be refused; none if there is no
/// file. Nothing is changed.
///
/// # Errors
/// If the file cannot be read, or is damaged.
pub fn differences(
    controls: &Controls,
    file: &SavedValues,
) -> Result<(Vec<String>, Vec<Refused>), SavedError> {
    let mut values = read(file)?;
    Written::take(&mut values);
    let refused = values.iter().filter_map(|(key, value)| {
        let setting = (key.as_str(), value.clone());
        controls.set(std::slice::from_ref(&setting)).err()
    });
    let refused = refused.collect();
    Ok((controls.differences(), refused))
}

fn restore_at(controls: &Controls, file: &SavedValues, now: &Written) -> usize {
    let path = file.path();
    let mut values = match read(file) {
        Ok(values) => values,
        Err(error) => {
            tracing::error!(%error, "starting without the saved values");
            if matches!(error, SavedError::Damaged { .. }) {
                set_aside(path);
            }
            return 0;
        }
    };
    let written = Written::take(&mut values);
    let limit = Duration::from_secs(controls.config().link.restore_tracking_s.into());
    if !written.is_some_and(|then| now.is_recent(&then, limit)) {
        let before = values.len();
        values.retain(|key, _| !SHORT_LIVED.contains(&key.as_str()));
        if values.len() < before {
            let (file, limit_s) = (path.display(), limit.as_secs());
            tracing::warn!(%file, limit_s, "saved too long ago: tracking and GPS start fresh");
        }
    }
    let commanded = controls.state().commanded.clone();
    values.retain(|key, _| !commanded.contains_key(key));
    // First all together, because half a place is refused; one by one, if not all can be set.
    let mut settings: Vec<(&str, Value)> = values
        .iter()
        .map(|(k, v)| (k.as_str(), v.clone()))
        .collect();
    // The fix last: if there is one, it is newer than a place set by command.
    settings.sort_by_key(|(key, _)| SHORT_LIVED.contains(key));
    let note = |(name, value): &(&str, Value), result: &str| {
        let command = CommandInWords {
            key: None,
            name: (*name).into(),
            values: value.to_string(),
        };
        controls.note_command(CommandNote::now(path.display(), command, result));
    };
    if controls.set(&settings).is_ok() {
        settings
            .iter()
            .for_each(|setting| note(setting, "restored"));
        return settings.len();
    }
    let set = settings.iter().filter(|setting| {
        let result = controls.set(std::slice::from_ref(setting));
        match &result {
            Ok(()) => note(setting, "restored"),
            Err(refused) => note(setting, &format!("refused: {refused}")),
        }
        if let Err(refused) = &result {
            tracing::error!(file = %path.display(), %refused, "a saved value was rejected");
        }
        result.is_ok()
    });
    set.count()
}

/// A damaged file is kept for inspection.
fn set_aside(path: &Path) {
    let now = Timestamp::now().strftime("%Y%m%dT%H%M%SZ");
    let mut name = path.as_os_str().to_owned();
    name.push(format!(".damaged-{now}"));
    match std::fs::rename(path, &name) {
        Ok(()) => tracing::warn!(file = %Path::new(&name).display(), "the damaged file is kept"),
        Err(error) => tracing::error!(%error, "the damaged file could not be set aside"),
    }
}

/// The values of a file; none if there is no file.
fn read(file: &SavedValues) -> Result<BTreeMap<String, Value>, SavedError> {
    let Some(bytes) = file.bytes()? else {
        return Ok(BTreeMap::new());
    };
    decode(&bytes).map_err(|(expected, found)| SavedError::Damaged {
        path: file.path().into(),
        expected,
        found,
    })
}

/// The values in a file's bytes, or the expected and the found content.
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

fn encode(values: &BTreeMap<String, Value>, written: &Written) -> String {
    let mut values = values.clone();
    values.insert(WRITTEN_UTC.into(), Value::Text(written.utc.to_string()));
    if let Some(boot) = &written.boot {
        values.insert(WRITTEN_BOOT.into(), Value::Text(boot.clone()));
    }
    let lines = values.iter().map(|(key, value)| match value {
        // A number without a decimal point would be read as an integer.
        Value::Number(number) => format!("{key:?} = {number:?}\n"),
        value => format!("{key:?} = {value}\n"),
    });
    let body: String = lines.collect();
    let crc = CRC.checksum(body.as_bytes());
    format!("{HEADER}{crc:08x}\n{body}")
}

/// Saves values set by commands, on a thread of its own: a disk that hangs does not delay an answer.
pub struct ValueSaver {
    controls: Controls,
    file: SavedValues,
    /// `None` until the file's folder exists.
    lock: Option<Lock>,
}

impl ValueSaver {
    /// `lock` is that of the file, if it is [claimed](SavedValues::claim) already.
    pub fn new(controls: Controls, file: SavedValues, lock: Option<Lock>) -> Self {
        Self {
            controls,
            file,
            lock,
        }
    }

    /// Restores the saved values, reports that to `restored`, and saves after every change until asked to end, and then the remaining
    /// changes. Returns the number of failures.
    pub fn run(mut self, restored: &Sender<()>, ends: &AtomicBool) -> u64 {
        match self.hold() {
            Err(error @ SavedError::Taken { .. }) => {
                tracing::error!(%error, "starting without the saved values");
            }
            // Even if no lock can be made, there may be a file.
            _ => _ = restore(&self.controls, &self.file),
        }
        // The receiver is gone if this came too late.
        let _ = restored.send(());
        let changes = self.controls.0.changed.1.clone();
        let mut failed: u64 = 0;
        let (mut due_at, mut retry) = (None, Backoff::DISK);
        loop {
            let last = ends.load(Ordering::Relaxed);
            let changed = changes.recv_timeout(TIMEOUT).is_ok();
            let due = due_at.is_some_and(|at| Instant::now() >= at || last);
            if changed || due {
                due_at = match self.save() {
                    Ok(kept) => {
                        retry.reset();
                        match kept {
                            ShortLived::Some => Some(Instant::now() + REFRESH),
                            ShortLived::None => None,
                        }
                    }
                    Err(error) => {
                        failed += 1;
                        if worth_a_line(failed) {
                            tracing::error!(%error, failed, "values set by command were not saved");
                        }
                        Some(Instant::now() + retry.wait())
                    }
                };
            }
            if last {
                return failed;
            }
        }
    }

    /// Locks the file for this program alone.
    fn hold(&mut self) -> Result<(), SavedError> {
        let file = &self.file;
        if !self.lock.as_ref().is_some_and(|lock| file.is_held_by(lock)) {
            // The old lock first: both may be of the same file.
            self.lock = None;
            self.lock = Some(file.lock()?);
        }
        Ok(())
    }

    fn save(&mut self) -> Result<ShortLived, SavedError> {
        let values = self.controls.state().commanded.clone();
        self.hold()?;
        self.file.replace(&encode(&values, &Written::now()))?;
        Ok(
            match SHORT_LIVED.iter().any(|key| values.contains_key(*key)) {
                true => ShortLived::Some,
                false => ShortLived::None,
            },
        )
    }
}

/// Whether a file holds short-lived values.
enum ShortLived {
    Some,
    None,
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::archive::MARK;
    use crate::config::{Config, ConfiguredCamera};
    use crate::instrument::{Role, builtin};
    use crate::link::{CommandResult, Control, GpsFix};
    use crate::pointing::Target;
    use crossbeam_channel::bounded;

    fn controls() -> Controls {
        let mounting = builtin("demo").unwrap().mounting;
        Controls::new(Config::default(), Target::default(), mounting)
    }

    fn camera(controls: &Controls, name: &str) -> ConfiguredCamera {
        controls.config().cameras.named(name).unwrap().clone()
    }

    /// Sets some values of every kind.
    fn set_values(controls: &Controls) {
        controls
            .set(&[
                ("site.latitude_deg", Value::Number(34.5)),
                ("site.longitude_deg", Value::Number(-104.25)),
            ])
            .unwrap();
        set_values_but_place(controls);
    }

    fn set_values_but_place(controls: &Controls) {
        controls
            .set(&[
                ("target.x_arcsec", Value::Number(-300.0)),
                ("target.y_arcsec", Value::Number(450.0)),
                ("camera.exposure_us", Value::Whole(12_000)),
                ("roll_camera.preamp_gain", Value::Number(-3.0)),
                ("store.roll", Value::Whole(0)),
                ("link.sending", Value::Whole(0)),
                ("mounting.twist_deg", Value::Number(0.125)),
            ])
            .unwrap();
    }

    fn write_values(path: &Path, values: &BTreeMap<String, Value>) {
        let text = encode(values, &Written::now());
        SavedValues::at(path).replace(&text).unwrap();
    }

    /// Runs a thread that is asked to end, after `set` has changed values; returns its number of failures.
    fn run(controls: &Controls, path: &Path, set: impl Fn(&Controls)) -> u64 {
        let (restored, _) = bounded(1);
        set(controls);
        let saver = ValueSaver::new(controls.clone(), SavedValues::at(path), None);
        saver.run(&restored, &AtomicBool::new(true))
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
        assert_eq!(run(&before, &path, set_values), 0);

        let after = controls();
        assert_eq!(restore(&after, &SavedValues::at(&path)), 9);
        assert_eq!(after.snapshot(), before.snapshot());
        assert_eq!(after.config(), before.config());
        assert_eq!(camera(&after, "roll_camera").preamp_gain, Some(-3.0));
        assert!(!after.stores(Role::Roll));
        assert_eq!(after.sending(), Some(false));
        let left = [".values.toml.lock", "values.toml"];
        assert_eq!(names(folder.path()), left, "nothing else is left");
    }

    fn written(utc: &str, boot: &str) -> Written {
        Written {
            utc: utc.parse().unwrap(),
            boot: Some(boot.into()),
        }
    }

    #[test]
    fn a_flight_goes_on_within_a_boot_or_a_short_time_and_no_laboratory_computer_steers() {
        let then = written("2013-09-21T18:00:00Z", "boot-1");
        let limit = Duration::from_secs(600);
        for (utc, boot, goes_on) in [
            ("2013-09-21T18:00:09Z", "boot-2", true),
            ("2013-09-21T18:10:00Z", "boot-2", true),
            ("2013-09-21T18:10:01Z", "boot-2", false),
            ("2013-09-22T18:00:00Z", "boot-2", false),
            ("2013-09-21T23:00:00Z", "boot-1", true),
            // The clock has been set back.
            ("2013-09-21T17:59:59Z", "boot-2", false),
            ("1970-01-01T00:00:10Z", "boot-1", true),
        ] {
            let now = written(utc, boot);
            assert_eq!(now.is_recent(&then, limit), goes_on, "{utc} {boot}");
        }
        let nowhere = |utc| Written {
            boot: None,
            ..written(utc, "")
        };
        let late = nowhere("2013-09-21T19:00:00Z");
        assert!(!late.is_recent(&nowhere("2013-09-21T18:00:00Z"), limit));
    }

    #[test]
    fn tracking_and_the_last_fix_survive_a_restart_of_a_flight_and_of_nothing_else() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("values.toml");
        let before = controls();
        let set = |controls: &Controls| {
            controls.note_tracking(true);
            let (latitude_deg, longitude_deg) = (-77.85, 166.67);
            let fix = GpsFix {
                latitude_deg,
                longitude_deg,
            };
            assert_eq!(controls.clone().take_fix(fix), CommandResult::Done);
            set_values_but_place(controls);
        };
        assert_eq!(run(&before, &path, set), 0);

        let after = controls();
        restore(&after, &SavedValues::at(&path));
        assert!(after.tracking());
        assert_eq!(after.snapshot(), before.snapshot());

        let next_day = Written {
            utc: Timestamp::now() + jiff::SignedDuration::from_hours(24),
            boot: Some("another".into()),
        };
        let in_the_laboratory = controls();
        restore_at(&in_the_laboratory, &SavedValues::at(&path), &next_day);
        assert!(!in_the_laboratory.tracking());
        assert_eq!(in_the_laboratory.snapshot().place, None);
        assert_eq!(camera(&in_the_laboratory, "camera").exposure_us, 12_000);
    }

    #[test]
    fn what_was_commanded_while_a_disk_hung_is_not_undone_by_what_was_saved() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("values.toml");
        assert_eq!(run(&controls(), &path, set_values), 0);
        let controls = controls();
        let newer = ("camera.exposure_us", Value::Whole(700));
        controls.set(std::slice::from_ref(&newer)).unwrap();
        restore(&controls, &SavedValues::at(&path));
        assert_eq!(camera(&controls, "camera").exposure_us, 700);
        assert_eq!(camera(&controls, "roll_camera").preamp_gain, Some(-3.0));
    }

    #[test]
    fn nothing_is_saved_into_the_empty_folder_of_a_disk_that_is_not_mounted() {
        let folder = tempfile::tempdir().unwrap();
        let mut config = Config::default();
        assert_eq!(SavedValues::of(&config), None, "nowhere to save them");
        config.archive.directory = Some(folder.path().into());
        let file = SavedValues::of(&config).unwrap();
        assert_eq!(file.path(), folder.path().join("values.toml"));
        assert!(file.claim().unwrap().is_none());
        assert!(file.replace("").is_err() && names(folder.path()).is_empty());
        std::fs::write(folder.path().join(MARK), "").unwrap();
        assert!(file.claim().unwrap().is_some() && file.replace("").is_ok());
    }

    #[test]
    fn without_a_file_nothing_is_set_and_nothing_is_wrong() {
        let folder = tempfile::tempdir().unwrap();
        let controls = controls();
        let before = controls.snapshot();
        assert_eq!(
            restore(
                &controls,
                &SavedValues::at(&folder.path().join("values.toml"))
            ),
            0
        );
        assert_eq!(controls.snapshot(), before);
        assert!(names(folder.path()).is_empty());
    }

    #[test]
    fn a_damaged_file_is_set_aside_and_the_flight_starts_without_it() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("values.toml");
        let good = controls();
        set_values(&good);
        write_values(&path, &good.state().commanded);
        let bytes = std::fs::read(&path).unwrap();
        let middle = bytes.len() / 2;
        let mut flipped = bytes.clone();
        flipped[middle] ^= 1;
        let cut = bytes[..middle].to_vec();
        let header = bytes[..HEADER.len() / 2].to_vec();
        let mut marred = bytes.clone();
        marred[3] ^= 4;
        for damaged in [flipped, cut, header, marred, Vec::new()] {
            std::fs::write(&path, damaged).unwrap();
            let controls = controls();
            assert_eq!(restore(&controls, &SavedValues::at(&path)), 0);
            assert_eq!(controls.config(), Config::default());
            let names = names(folder.path());
            assert_eq!(names.len(), 1);
            assert!(names[0].starts_with("values.toml.damaged-"), "{names:?}");
            std::fs::remove_file(folder.path().join(&names[0])).unwrap();
        }
    }

    #[test]
    fn a_file_of_somebody_else_is_neither_set_aside_nor_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("flight.toml");
        let text = "[camera]\nsource = \"simulated\"\n";
        std::fs::write(&path, text).unwrap();
        assert_eq!(run(&controls(), &path, set_values), 1);
        assert_eq!(std::fs::read_to_string(&path).unwrap(), text);
        assert_eq!(names(folder.path()), [".flight.toml.lock", "flight.toml"]);
    }

    #[test]
    fn values_of_a_flight_that_goes_on_are_neither_taken_nor_overwritten_by_another() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("values.toml");
        assert_eq!(run(&controls(), &path, set_values), 0);
        let before = std::fs::read(&path).unwrap();
        let first = SavedValues::at(&path).claim().unwrap();
        let second = controls();
        let set = |controls: &Controls| controls.note_tracking(true);
        assert_eq!(run(&second, &path, set), 1);
        assert_eq!(camera(&second, "roll_camera").preamp_gain, None);
        assert_eq!(std::fs::read(&path).unwrap(), before);
        drop(first);
    }

    #[test]
    fn any_one_bit_wrong_is_found() {
        let good = controls();
        set_values(&good);
        let bytes = encode(&good.state().commanded, &Written::now()).into_bytes();
        assert!(decode(&bytes).is_ok());
        for bit in 0..8 * bytes.len() {
            let mut wrong = bytes.clone();
            wrong[bit / 8] ^= 1 << (bit % 8);
            // Letters in the checksum's own hexadecimal digits may have either case.
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
        write_values(&path, &values);
        let controls = controls();
        assert_eq!(restore(&controls, &SavedValues::at(&path)), 1);
        assert!(!controls.stores(Role::Roll));
        assert_eq!(controls.config(), Config::default());
    }

    #[test]
    fn a_folder_that_takes_nothing_is_counted_and_ends_nothing() {
        let nowhere = Path::new("/nowhere/at/all/values.toml");
        assert_eq!(run(&controls(), nowhere, set_values), 1);
    }
}
