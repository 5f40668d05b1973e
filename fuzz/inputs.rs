//! External inputs, each kind as one function of its bytes: for the fuzz targets, and for the test that replays the stored
//! seeds. A function panics if the library does, or if a property that must hold for any bytes is violated.

use crc::{CRC_32_ISO_HDLC, Crc};
use solaspect::calibrate::mounting::{AttitudeLog, PointingLog};
use solaspect::clock::{Scale, parse_utc, read_utc, utc_of_mjd, utc_text};
use solaspect::commands::controls::{Controls, SavedValues, restore};
use solaspect::commands::words::describe;
use solaspect::config::Config;
use solaspect::fits::{self, FitsFile};
use solaspect::instrument::{Instrument, Mounting, Role, builtin};
use solaspect::link::byte_log::{self, Burst};
use solaspect::link::{Direction, Parser};
use solaspect::navigation::NavigationSettings;
use solaspect::navigation::files::{self, read_gps, read_imu, read_sun, read_vectors};
use solaspect::navigation::nmea::{Nmea, Received};
use solaspect::observe::Journal;
use solaspect::pointing::Target;
use solaspect::refine::FrameRecord;
use solaspect::simulate::{Course, Pieces};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::LazyLock;
use std::time::Duration;
use tempfile::TempDir;

const CRC: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);

static MOUNTING: LazyLock<Mounting> =
    LazyLock::new(|| builtin("demo").expect("the demo instrument").mounting);

static NAVIGATION: LazyLock<NavigationSettings> = LazyLock::new(|| {
    let text =
        "[[camera]]\nname = \"camera\"\nbody_from_camera = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]\n";
    NavigationSettings::parse(Path::new("NAV.toml"), text).expect("a camera")
});

/// A kind of input: the name of its target and of its folder of seeds, and the function that reads it.
pub type Kind = (&'static str, fn(&[u8]));

pub const KINDS: [Kind; 13] = [
    ("packets", packets),
    ("fits", fits),
    ("instrument", instrument),
    ("configuration", configuration),
    ("values", values),
    ("journal", journal),
    ("pointing_log", pointing_log),
    ("flight_pieces", flight_pieces),
    ("link_log", link_log),
    ("nmea", nmea),
    ("nav_toml", nav_toml),
    ("tables", tables),
    ("dates", dates),
];

/// A time as text, after a letter for the time scale that a header would name. A parsed time must be parsed again from its
/// own text, and differ from UTC by no more than the offsets of scales and zones.
pub fn dates(bytes: &[u8]) {
    let (scale, text) = bytes.split_first().unwrap_or((&b' ', &[]));
    let scale = match scale {
        b'U' => Some(Scale::Utc),
        b'A' => Some(Scale::Tai),
        b'T' => Some(Scale::Tt),
        b'G' => Some(Scale::Gps),
        _ => None,
    };
    let text = String::from_utf8_lossy(text);
    if let Ok(utc) = read_utc(&text, scale) {
        let again = read_utc(&utc_text(utc, 9), None);
        assert_eq!(again, Ok(utc), "{text}");
        assert!(parse_utc(&text).is_ok() || scale.is_some(), "{text}");
    }
    if let Err(why) = parse_utc(&text) {
        assert!(why.contains("expected"), "{why}");
    }
    if let Ok(days) = text.trim().parse()
        && let Ok(utc) = utc_of_mjd(days, scale.unwrap_or(Scale::Utc))
    {
        assert_eq!(read_utc(&utc_text(utc, 9), None), Ok(utc), "{days}");
    }
}

/// Bytes of a serial line, in both directions: no byte is lost, and every packet has a description.
pub fn packets(bytes: &[u8]) {
    for direction in [Direction::ToAspect, Direction::ToController] {
        let mut parser = Parser::new(direction);
        let mut taken = 0;
        for (n, piece) in bytes.chunks(7).enumerate() {
            for packet in parser.feed(piece, Duration::from_millis(n as u64)) {
                assert!(!describe(&packet).is_empty());
                taken += packet.encode().len();
            }
        }
        parser.abandon();
        let rejected = parser.rejected().bytes as usize;
        assert_eq!(taken + rejected, bytes.len(), "bytes of {direction:?}");
    }
}

/// A FITS, PNG, TIFF or JPEG file: a frame, the values of its header, keywords, tables and checksums, or an error that
/// names the file.
pub fn fits(bytes: &[u8]) {
    let (_folder, path) = file("frame.fits", bytes);
    let named = |error: fits::FileError| assert!(error.to_string().contains("frame.fits"));
    if let Err(error) = fits::read_frame(&path) {
        named(error);
    }
    let on_demand = FitsFile::open(&path).and_then(|file| file.with_frame(|f| f.pixels().len()));
    if let Err(error) = on_demand {
        named(error);
    }
    if let Err(error) = fits::read_info(&path) {
        named(error);
    }
    if let Err(error) = fits::read_keywords(&path) {
        named(error);
    }
    if let Err(error) = fits::check_sums(&path) {
        named(error);
    }
    if let Err(error) = fits::read_table(&path, "SOLUTION") {
        named(error);
    }
}

/// An instrument's TOML file: an accepted one has a finite mapping and scale.
pub fn instrument(bytes: &[u8]) {
    let Ok(text) = str::from_utf8(bytes) else {
        return;
    };
    match Instrument::parse(Path::new("fuzz.toml"), text) {
        Ok(instrument) => {
            assert!(instrument.optics.arcsec_per_mil().is_finite());
            assert!(instrument.nominal_mapping().is_some());
        }
        Err(error) => assert!(error.to_string().contains("fuzz.toml")),
    }
}

/// A configuration's TOML file.
pub fn configuration(bytes: &[u8]) {
    let Ok(text) = str::from_utf8(bytes) else {
        return;
    };
    let (config, errors) = Config::parse_all(Path::new("fuzz.toml"), text);
    for error in errors {
        assert!(error.to_string().contains("fuzz.toml"));
    }
    let _ = (config.faults(), config.solver(), config.site.place());
}

/// Saved values: as the file's bytes, and as its lines below a header with a valid checksum.
pub fn values(bytes: &[u8]) {
    let header = "# solaspect: values set by command. crc32 ";
    let headed = [
        format!("{header}{:08x}\n", CRC.checksum(bytes)).as_bytes(),
        bytes,
    ]
    .concat();
    for bytes in [bytes, &headed] {
        let (_folder, path) = file("values.toml", bytes);
        let controls = Controls::new(Config::default(), Target::default(), *MOUNTING);
        restore(&controls, &SavedValues::at(&path));
    }
}

/// A journal of refine: as the file's bytes, and as one record with a valid length and checksum.
pub fn journal(bytes: &[u8]) {
    let magic = b"solasp1\n".as_slice();
    let length = (bytes.len() as u32).to_le_bytes();
    let record = [magic, &length, &CRC.checksum(bytes).to_le_bytes(), bytes].concat();
    for bytes in [bytes, &record] {
        let (_folder, path) = file("journal", bytes);
        let mut places = Vec::new();
        if let Ok(journal) = Journal::<FrameRecord>::read(&path, |_, place| places.push(place)) {
            for place in places {
                let again = journal.record(place);
                assert!(again.is_ok(), "a record that was read once");
            }
        }
    }
}

/// A log of pointings, and of the body's attitude: an accepted one gives finite angles at its own times.
pub fn pointing_log(bytes: &[u8]) {
    let (_folder, path) = file("pointing.csv", bytes);
    let times = [
        "2013-09-21T18:00:00Z",
        "2013-09-21T18:00:00.5Z",
        "1970-01-01T00:00:00Z",
    ];
    let times = times.map(|text| text.parse().expect("a time"));
    match PointingLog::read(&path) {
        Ok(log) => {
            for at in times.into_iter().filter_map(|time| log.at(time).ok()) {
                assert!(
                    at.azimuth_deg.is_finite() && at.elevation_deg.abs() <= 90.0,
                    "{at:?}"
                );
            }
        }
        Err(error) => assert!(error.to_string().contains("pointing.csv")),
    }
    match AttitudeLog::read(&path) {
        Ok(log) => {
            for at in times.into_iter().filter_map(|time| log.at(time).ok()) {
                assert!(at.iter().all(|angle| angle.abs() <= 80.0), "{at:?}");
            }
        }
        Err(error) => assert!(error.to_string().contains("pointing.csv")),
    }
}

/// A simulated flight that a file describes piece by piece: an accepted one has a position at any time.
pub fn flight_pieces(bytes: &[u8]) {
    let Ok(text) = str::from_utf8(bytes) else {
        return;
    };
    match Pieces::parse(Path::new("fuzz.toml"), text) {
        Ok(pieces) => {
            let course = Course::from(pieces);
            for time_s in [0, 1, 1000, 1_000_000] {
                let at = course.position(Duration::from_secs(time_s));
                assert!(at.x.is_finite() && at.y.is_finite(), "{at:?}");
            }
        }
        Err(error) => assert!(error.to_string().contains("fuzz.toml")),
    }
}

/// A recording of a line: read in one piece or in many, it gives the same bursts and the same bad lines. Written again,
/// each burst is one line.
pub fn link_log(bytes: &[u8]) {
    let (bursts, whole) = byte_log::read(bytes);
    let mut reader = byte_log::Reader::default();
    let mut again: Vec<Burst> = bytes
        .chunks(7)
        .flat_map(|piece| reader.feed(piece))
        .collect();
    again.extend(reader.finish());
    assert_eq!(again, bursts);
    assert_eq!(reader.skipped(), whole.skipped());
    if let Err(error) = whole.check() {
        assert!(bursts.is_empty() && error.to_string().contains("expected a byte log"));
    }
    let direction = byte_log::likely_direction(&bursts);
    for (_, packet) in byte_log::packets(&bursts, direction).packets {
        assert!(!describe(&packet).is_empty());
    }
    let lines: String = bursts.iter().map(|burst| format!("{burst}\n")).collect();
    let (written, reader) = byte_log::read(lines.as_bytes());
    let skipped = reader.skipped().total() as usize;
    assert_eq!(written.len() + skipped, bursts.len());
}

/// Bytes of a GPS receiver: the result does not depend on how they are split, and each fix is near the Earth and on the
/// clock's day.
pub fn nmea(bytes: &[u8]) {
    let now = "2026-11-25T14:28:00Z".parse().expect("a time");
    let mut whole = Nmea::default();
    let heard = whole.feed(bytes, now);
    let mut piecewise = Nmea::default();
    let pieces = bytes.chunks(7);
    let again: Vec<Received> = pieces
        .flat_map(|piece| piecewise.feed(piece, now))
        .collect();
    assert_eq!(heard, again, "bytes in pieces");
    assert_eq!(whole.noise_bytes(), piecewise.noise_bytes());
    assert!(whole.noise_bytes() <= bytes.len() as u64);
    for one in heard {
        match one {
            Received::Fix(fix) => {
                assert!(fix.utc.duration_since(now).as_hours().abs() <= 12);
                assert!(fix.fix(0.0).check().is_ok());
            }
            Received::Refused(why) => assert!(!why.to_string().is_empty()),
            Received::Unreadable(why) => assert!(!why.to_string().is_empty()),
        }
    }
}

/// NAV.toml: the sensors of a flight.
pub fn nav_toml(bytes: &[u8]) {
    let Ok(text) = str::from_utf8(bytes) else {
        return;
    };
    let path = Path::new("fuzz.toml");
    let settings = NavigationSettings::parse(path, text)
        .and_then(|settings| settings.for_flight(path, &Role::table_names()));
    if let Err(error) = settings {
        assert!(error.to_string().contains("fuzz.toml"), "{error}");
    }
}

/// Tables of IMU, GPS, directions and Sun: as the file's bytes, and as rows below a heading. The rows are returned in the
/// order of time; an error names the file.
pub fn tables(bytes: &[u8]) {
    let vectors = "t_s,camera,target,x,y,z,sigma_rad\n".to_owned();
    let headings = [
        String::new(),
        files::IMU.join(",") + "\n",
        files::GPS.join(",") + ",climb\n",
        vectors,
        "t_s,x,y,z\n".into(),
    ];
    for heading in headings {
        let (_folder, path) = file("table.csv", &[heading.as_bytes(), bytes].concat());
        let paths = [path.clone(), path];
        let path = &paths[0];
        let named = |error: String| assert!(error.contains("table.csv"), "{error}");
        match read_imu(&paths, &NAVIGATION) {
            Ok(runs) => {
                let times = runs.iter().flatten().map(|sample| sample.t_s);
                assert!(times.is_sorted_by(|a, b| a < b), "samples in order");
            }
            Err(error) => named(error.to_string()),
        }
        match read_gps(&paths, &NAVIGATION) {
            Ok(fixes) => assert!(fixes.is_sorted_by(|a, b| a.t_s < b.t_s), "fixes in order"),
            Err(error) => named(error.to_string()),
        }
        match read_vectors(path, &NAVIGATION) {
            Ok(seen) => assert!(seen.is_sorted_by_key(|one| one.t_s), "directions in order"),
            Err(error) => named(error.to_string()),
        }
        match read_sun(path) {
            Ok(sun) => assert!(sun.is_sorted_by(|a, b| a.0 < b.0), "the Sun in order"),
            Err(error) => named(error.to_string()),
        }
    }
}

fn file(name: &str, bytes: &[u8]) -> (TempDir, PathBuf) {
    // In memory if possible: a fuzzer writes thousands of files per second.
    let memory = Path::new("/dev/shm");
    let folder = match memory.is_dir() {
        true => TempDir::new_in(memory),
        false => TempDir::new(),
    };
    let folder = folder.expect("a temporary folder");
    let path = folder.path().join(name);
    fs::write(&path, bytes).expect("a temporary file");
    (folder, path)
}
