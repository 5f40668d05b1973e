//! Housekeeping: the report of the aspect system to the ground each second, in one telemetry packet of type 0x70.
//!
//! The table below defines the layout, the struct and the page on the protocol. The first byte of the payload is the
//! layout's number: a field that is added, removed or changed requires a new one.

use super::fields;
use super::message::MessageError;
use super::number::{self, Codes, Number};
use super::packet::{TelemetryPacket, id, telemetry_type};
use jiff::Timestamp;
use std::fmt;
use std::str::FromStr;
use std::sync::atomic::{AtomicU64, Ordering};

/// The layout that this program writes. It also reads the earlier ones.
pub const LAYOUT: u8 = 9;

/// The earlier layouts, and the first field that the next layout added to each.
const EARLIER: [(u8, &str); 8] = [
    (1, "takeovers"),
    (2, "commit"),
    (3, "roll_deg"),
    (4, "night"),
    (5, "navigation"),
    (6, "gps_no_fix"),
    (7, "values_set"),
    (8, "gyro_right_sigmas"),
];

/// A field as the page on the protocol shows it.
#[derive(Debug, Clone, Copy)]
pub struct Field {
    pub name: &'static str,
    /// Its element type and number of elements.
    pub number: Number,
    pub count: usize,
    pub bytes: usize,
    /// Whether it holds a number, rather than digits or ids.
    pub is_number: bool,
    pub unit: &'static str,
    /// Meaning of its number.
    pub codes: Option<&'static Codes>,
    about: &'static str,
    kind: fn() -> String,
    value: fn(&[u8]) -> Option<f64>,
}

impl Field {
    /// Its number, from its bytes in a payload; `None` if it is not known.
    pub fn value(&self, bytes: &[u8]) -> Option<f64> {
        (self.value)(bytes)
    }

    /// The same as a field of a general payload.
    pub fn plain(&self) -> number::Field {
        number::Field {
            name: self.name,
            number: self.number,
            count: self.count,
            unit: self.unit,
            documentation: self.about,
            codes: self.codes,
            range: None,
        }
    }

    /// Its description.
    pub fn documentation(&self) -> String {
        match self.codes {
            Some(codes) => format!("{}: {}", self.about, codes.in_words()),
            None => self.about.into(),
        }
    }

    /// Its type, in words.
    pub fn kind(&self) -> String {
        (self.kind)()
    }

    /// Its description and type.
    pub fn in_words(&self) -> String {
        format!("{} ({})", self.documentation(), self.kind())
    }
}

fn value_of<T: Wire>(mut bytes: &[u8]) -> Option<f64> {
    T::read(&mut bytes)?.value()
}

macro_rules! codes {
    () => {
        None
    };
    ($codes:ident) => {
        Some(&$codes)
    };
}

/// Sections of rows, each a struct of its own, in the order of the payload: counts of the threads (`count`), status of the latest frame
/// (`frame`), and so on. A row has the field, its type, its unit, its description, and the meaning of its numbers.
macro_rules! housekeeping {
    ($([$section:ident] $($field:ident: $type:ty, $unit:literal, $documentation:literal $(=> $codes:ident)?;)*)*) => {
        /// The status of one second. `None` means not known.
        #[derive(Debug, Clone, PartialEq, Default)]
        pub struct Housekeeping {
            $($(#[doc = $documentation] pub $field: $type,)*)*
        }

        /// The fields of the payload after the layout's number, in order.
        pub const FIELDS: &[Field] = &[$($(Field {
            name: stringify!($field),
            number: <$type as Wire>::NUMBER,
            count: <$type as Wire>::COUNT,
            bytes: <$type as Wire>::BYTES,
            is_number: <$type as Wire>::IS_NUMBER,
            unit: $unit,
            codes: codes!($($codes)?),
            about: $documentation,
            kind: <$type as Wire>::kind,
            value: value_of::<$type>,
        },)*)*];

        impl Housekeeping {
            /// The payload of its packet: the layout's number, then the fields.
            pub fn payload(&self) -> Vec<u8> {
                let mut bytes = vec![LAYOUT];
                $($(self.$field.write(&mut bytes);)*)*
                bytes
            }

            /// Reads a payload of this layout or an earlier one.
            pub fn from_payload(payload: &[u8]) -> Option<Self> {
                let earlier = EARLIER.iter().find(|(layout, _)| payload.first() == Some(layout));
                let payload = match earlier {
                    Some((_, added)) => completed(payload, added)?,
                    None => payload.to_vec(),
                };
                let mut rest = payload.strip_prefix(&[LAYOUT])?;
                Some(Self { $($($field: Wire::read(&mut rest)?,)*)* })
            }

            /// The values as fields of a CSV row, in the order of [`FIELDS`]; unknown ones are empty.
            pub fn csv_row(&self) -> Vec<String> {
                vec![$($(self.$field.text(),)*)*]
            }

            /// Reads the row that [`csv_row`](Self::csv_row) writes; `value` gives the text of a field, `None` if the row lacks it.
            /// `None` if a text is no value of its field.
            pub fn from_csv<'a>(mut value: impl FnMut(&str) -> Option<&'a str>) -> Option<Self> {
                Some(Self { $($($field: match value(stringify!($field)) {
                    Some(text) => Wire::parse(text)?,
                    None => Default::default(),
                },)*)* })
            }

            /// Every field with its value in words.
            pub fn lines(&self) -> Vec<String> {
                vec![$($(format!("{} {:?} {}", stringify!($field), self.$field, $unit).trim_end().into(),)*)*]
            }
        }

        sections!(Counts, count, $($section { $($field: $type, $documentation;)* })*);
        sections!(FrameStatus, frame, $($section { $($field: $type, $documentation;)* })*);
        sections!(CamerasStatus, cameras, $($section { $($field: $type, $documentation;)* })*);
        sections!(LineStatus, line, $($section { $($field: $type, $documentation;)* })*);
        sections!(ArchiveStatus, archive, $($section { $($field: $type, $documentation;)* })*);
        sections!(NavigationStatus, navigation, $($section { $($field: $type, $documentation;)* })*);
        sections!(GpsStatus, gps, $($section { $($field: $type, $documentation;)* })*);
        sections!(SystemStatus, system, $($section { $($field: $type, $documentation;)* })*);

        impl From<Parts> for Housekeeping {
            fn from(parts: Parts) -> Self {
                Self { $($($field: parts.$section.$field.into_field(),)*)* }
            }
        }
    };
}

/// The struct of a section: only the rows of that name.
macro_rules! sections {
    // A row of the section, or of another section.
    (@count $struct:ident [$($done:tt)*] count { $($rows:tt)* } $($rest:tt)*) => { sections!(@count $struct [$($done)* $($rows)*] $($rest)*); };
    (@frame $struct:ident [$($done:tt)*] frame { $($rows:tt)* } $($rest:tt)*) => { sections!(@frame $struct [$($done)* $($rows)*] $($rest)*); };
    (@cameras $struct:ident [$($done:tt)*] cameras { $($rows:tt)* } $($rest:tt)*) => { sections!(@cameras $struct [$($done)* $($rows)*] $($rest)*); };
    (@line $struct:ident [$($done:tt)*] line { $($rows:tt)* } $($rest:tt)*) => { sections!(@line $struct [$($done)* $($rows)*] $($rest)*); };
    (@archive $struct:ident [$($done:tt)*] archive { $($rows:tt)* } $($rest:tt)*) => { sections!(@archive $struct [$($done)* $($rows)*] $($rest)*); };
    (@navigation $struct:ident [$($done:tt)*] navigation { $($rows:tt)* } $($rest:tt)*) => { sections!(@navigation $struct [$($done)* $($rows)*] $($rest)*); };
    (@gps $struct:ident [$($done:tt)*] gps { $($rows:tt)* } $($rest:tt)*) => { sections!(@gps $struct [$($done)* $($rows)*] $($rest)*); };
    (@system $struct:ident [$($done:tt)*] system { $($rows:tt)* } $($rest:tt)*) => { sections!(@system $struct [$($done)* $($rows)*] $($rest)*); };
    (@$section:ident $struct:ident [$($done:tt)*] $other:ident { $($rows:tt)* } $($rest:tt)*) => { sections!(@$section $struct [$($done)*] $($rest)*); };
    (@count $struct:ident [$($field:ident: $type:ty, $documentation:literal;)*]) => {
        /// Counts of the threads of a flight.
        #[derive(Debug, Default)]
        pub struct Counters {
            $(#[doc = $documentation] pub $field: Counter,)*
        }

        /// The counters at one time.
        #[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
        pub struct $struct {
            $(#[doc = $documentation] pub $field: u64,)*
        }

        impl Counters {
            pub fn now(&self) -> $struct {
                $struct { $($field: self.$field.get(),)* }
            }
        }
    };
    (@$section:ident $struct:ident [$($field:ident: $type:ty, $documentation:literal;)*]) => {
        #[doc = concat!("The fields of the section `", stringify!($section), "`.")]
        #[derive(Debug, Clone, PartialEq, Default)]
        pub struct $struct {
            $(#[doc = $documentation] pub $field: $type,)*
        }
    };
    ($struct:ident, $section:ident, $($rest:tt)*) => { sections!(@$section $struct [] $($rest)*); };
}

/// All values of the housekeeping, by the part of the program that supplies them. For a new field the compiler shows where it is missing.
#[derive(Debug, Clone, Default)]
pub struct Parts {
    pub count: Counts,
    pub frame: FrameStatus,
    pub cameras: CamerasStatus,
    pub line: LineStatus,
    pub archive: ArchiveStatus,
    pub navigation: NavigationStatus,
    pub gps: GpsStatus,
    pub system: SystemStatus,
}

/// Conversion of a part's value to that of its field: unchanged; counts saturate at the largest that fits.
trait IntoField<T> {
    fn into_field(self) -> T;
}

impl<T> IntoField<T> for T {
    fn into_field(self) -> T {
        self
    }
}

impl IntoField<u16> for u64 {
    fn into_field(self) -> u16 {
        saturated(self)
    }
}

impl IntoField<u32> for u64 {
    fn into_field(self) -> u32 {
        saturated(self)
    }
}

/// A number that threads count up.
#[derive(Debug, Default)]
pub struct Counter(AtomicU64);

impl Counter {
    /// Adds one; returns the new count.
    pub fn count(&self) -> u64 {
        self.add(1)
    }

    /// Adds to it; returns the new count.
    pub fn add(&self, more: u64) -> u64 {
        self.0.fetch_add(more, Ordering::Relaxed) + more
    }

    pub fn get(&self) -> u64 {
        self.0.load(Ordering::Relaxed)
    }
}

/// A count that fits a field, saturated if need be.
pub fn saturated<T: TryFrom<u64> + Most>(count: u64) -> T {
    T::try_from(count).unwrap_or(T::MOST)
}

/// The largest number of a type.
pub trait Most {
    const MOST: Self;
}

impl Most for u8 {
    const MOST: Self = Self::MAX;
}

impl Most for u16 {
    const MOST: Self = Self::MAX;
}

impl Most for u32 {
    const MOST: Self = Self::MAX;
}

static QUALITY: Codes = Codes {
    name: "quality",
    rows: &[
        (0, "none", "none"),
        (1, "coarse", "coarse"),
        (2, "fine", "fine"),
    ],
};

#[rustfmt::skip] // One row, one line.
static MAPPING: Codes = Codes { name: "mapping", rows: &[
    (0, "none", "none"),
    (1, "similarity", "similarity"),
    (2, "affine", "affine"),
    (3, "homography", "homography"),
    (4, "prior", "of the prior"),
    (5, "calibration", "of the calibration"),
    (6, "keystone", "keystone"),
] };

#[rustfmt::skip] // One row, one line.
static NAVIGATION: Codes = Codes { name: "navigation", rows: &[
    (0, "none", "none or without samples"),
    (1, "waiting", "waiting"),
    (2, "aligned", "aligned"),
    (3, "coasting", "coasting"),
    (4, "restarted", "restarted"),
    (5, "contradicted", "contradicted by directions"),
    (6, "unsound", "with an unsound IMU"),
] };

#[rustfmt::skip] // One row, one line.
static GYRO_AGREEMENT: Codes = Codes { name: "gyro_agreement", rows: &[
    (0, "none", "none compared"),
    (1, "within", "within 5 sigma on each axis"),
    (2, "beyond", "beyond on one"),
    (3, "contradicted", "contradicted: beyond for 10 s or more"),
] };

housekeeping! {
    [system]
    computer: u8, "", "which of the two computers";
    [line]
    tracking: bool, "", "the controller requests solutions";
    sending: bool, "", "this computer sends them";
    [system]
    storing: bool, "", "frames of the pitch-yaw camera are stored";
    [cameras]
    clock_stepped: bool, "", "UTC has made a step since the last packet";
    [system]
    uptime_s: u32, "s", "since the start of the program";
    [count]
    taken: u32, "", "frames taken";
    [cameras]
    lost: u32, "", "frames that the camera or the solver lost";
    incomplete: u16, "", "frames that arrived from the camera with parts missing, and were not used";
    reconnects: u16, "", "reconnections of cameras";
    fine: u32, "", "fine frames";
    coarse: u32, "", "coarse frames";
    none: u32, "", "frames without a Sun";
    stopped_levels: u16, "", "frames whose processing stopped at levels; wraps to 0 after 65535, as the next six";
    stopped_limb: u16, "", "frames whose processing stopped at limb";
    stopped_marks: u16, "", "frames whose processing stopped at marks";
    stopped_identification: u16, "", "frames whose processing stopped at identification";
    stopped_registration: u16, "", "frames whose processing stopped at registration";
    stopped_aspect: u16, "", "frames whose processing stopped at aspect";
    stopped_pointing: u16, "", "frames whose processing stopped at pointing";
    [frame]
    number: u32, "", "number of the latest frame, to which the fields up to preamp_gain belong";
    quality: u8, "", "the solution's quality" => QUALITY;
    background_dn: Option<f32>, "DN", "level of the background";
    disc_dn: Option<f32>, "DN", "level of the disc";
    noise_dn: Option<f32>, "DN", "noise of the background, 1 sigma";
    sun_x_px: Option<f32>, "px", "the Sun's centre on the sensor";
    sun_y_px: Option<f32>, "px", "the Sun's centre on the sensor";
    sun_sigma_px: Option<f32>, "px", "its 1 sigma per axis";
    plate_x_mil: Option<f32>, "mil", "the Sun's centre on the plate";
    plate_y_mil: Option<f32>, "mil", "the Sun's centre on the plate";
    plate_sigma_mil: Option<f32>, "mil", "its 1 sigma per axis";
    limb_points: u16, "", "points of the limb";
    marks: u8, "", "marks with ids";
    ids: MarkIds, "", "the first 16 of their ids, a byte each: 16 (i + 8) + (j + 8), 0 for none; only of the plate of 2013, those of others are in telemetry of type 0x73";
    mapping: u8, "", "the kind of the mapping" => MAPPING;
    scale_mil_per_px: Option<f32>, "mil/px", "the mapping's scale";
    rotation_deg: Option<f32>, "deg", "the mapping's rotation";
    residual_px: Option<f32>, "px", "rms residual of the marks per axis";
    azimuth_deg: Option<f32>, "deg", "offset in azimuth";
    elevation_deg: Option<f32>, "deg", "offset in elevation";
    offset_sigma_deg: Option<f32>, "deg", "its 1 sigma per axis of true angle";
    exposure_us: u32, "us", "exposure time";
    analogue_gain: Option<f32>, "", "analogue gain";
    preamp_gain: Option<f32>, "", "pre-amplifier gain";
    [cameras]
    camera_c: Option<f32>, "deg C", "temperature of the camera";
    [system]
    computer_c: Option<f32>, "deg C", "temperature of the computer";
    [archive]
    disk_1: Option<u8>, "%", "used part of the archive's first disk";
    disk_2: Option<u8>, "%", "used part of its second disk";
    [count]
    stored: u32, "", "frames stored";
    unstored: u32, "", "frames stored on no disk";
    announced: u32, "", "exposures announced to the controller";
    solutions: u32, "", "solutions sent";
    errors: u32, "", "errors sent instead of solutions";
    outdated: u32, "", "solutions too old to be sent";
    [line]
    unsent: u32, "", "packets that could not be sent";
    reopened: u16, "", "times that the line was reopened";
    rejected: u32, "", "corrupt packets received";
    latency_ms: Option<f32>, "ms", "latency from frame to packet, median over the second";
    latency_99_ms: Option<f32>, "ms", "the same, 99th percentile";
    [cameras]
    solve_ms: Option<f32>, "ms", "processing time of a frame, median over the second";
    [system]
    clock_offset_us: Option<f32>, "us", "offset of the clock: the clock minus true time";
    restarts: u16, "", "threads restarted";
    takeovers: u16, "", "of these, threads that hung and were replaced";
    [frame]
    simulated: bool, "", "the frames come from the simulator";
    [cameras]
    calibration_contradicted: bool, "", "fine frames contradict the instrument's rotation, scale or centre by more than 5 sigma";
    silent_s: u32, "s", "time without frames from a camera that should deliver them";
    queued_frames: u16, "", "frames waiting for a solver";
    [archive]
    queued_pictures: u16, "", "solved frames waiting for a disk";
    queued_rows: u16, "", "rows waiting for the logs";
    [line]
    queued_events: u16, "", "events waiting for the line";
    [archive]
    disk_1_refusals: u32, "", "refusals by the archive's first disk";
    disk_2_refusals: u32, "", "refusals by its second disk";
    rows_refused: u32, "", "rows not written to a log, or not taken into its queue";
    [system]
    gps_refused: u16, "", "GPS fixes rejected";
    [count]
    datagrams_refused: u32, "", "datagrams refused: unknown sender, replayed, or not authentic";
    [system]
    log_lines_lost: u32, "", "log lines dropped because standard error was too slow";
    commit: Digits, "", "commit that the program was built from, its first 8 hexadecimal digits";
    modified: bool, "", "the sources of the program were modified after that commit";
    configuration: Digits, "", "SHA-256 of the flight's configuration (`CONFSHA` of the frames), its first 8 hexadecimal digits";
    [frame]
    roll_deg: Option<f32>, "deg", "roll by the horizon at the latest frame, right side low positive";
    roll_sigma_deg: Option<f32>, "deg", "its 1 sigma";
    [cameras]
    roll_fine: u32, "", "fine frames of the horizon";
    roll_coarse: u32, "", "coarse frames of the horizon";
    roll_none: u32, "", "frames without a horizon";
    roll_too_bright: u32, "", "of these, frames that were too bright all over";
    roll_too_dark: u32, "", "of these, frames that were too dark";
    night: Option<u8>, "", "at the Moon camera's latest frame, by the ephemeris: 1 night, 0 day";
    moon_found: u32, "", "frames in which the Moon was found";
    moon_none: u32, "", "frames that should show the Moon and do not";
    moon_hidden: u32, "", "frames taken while the Moon could not be seen";
    moon_x_px: Option<f32>, "px", "the centre of the Moon's disc in the latest frame";
    moon_y_px: Option<f32>, "px", "the centre of the Moon's disc in the latest frame";
    [navigation]
    navigation: u8, "", "state of the inertial filter" => NAVIGATION;
    propagated_azimuth_deg: Option<f32>, "deg", "its latest offset in azimuth";
    propagated_elevation_deg: Option<f32>, "deg", "its latest offset in elevation";
    propagated_sigma_deg: Option<f32>, "deg", "the offset's 1 sigma per axis of true angle";
    propagated_roll_deg: Option<f32>, "deg", "roll about the boresight, right side low positive";
    [count]
    propagated: u32, "", "offsets by the gyros sent";
    imu_samples: u32, "", "samples of the IMU";
    [navigation]
    imu_lost: u16, "", "samples that are missing by their counter, or cannot be read";
    [gps]
    gps_fixes: u16, "", "fixes of the GPS receiver";
    gps_without_fix: u16, "", "times that it had none, or repeated one";
    [navigation]
    navigation_refused: u16, "", "fixes and directions that contradict the filter";
    navigation_out_of_time: u16, "", "fixes and directions that came too late or too early";
    [count]
    navigation_lost: u16, "", "inputs that did not fit into the filter's queue";
    [navigation]
    navigation_restarts: u16, "", "restarts of the filter";
    [gps]
    gps_no_fix: u16, "", "times that the GPS receiver reported no fix";
    gps_estimated: u16, "", "fixes not used: by dead reckoning";
    gps_manual: u16, "", "the same: a position entered by hand";
    gps_simulator: u16, "", "the same: the receiver is in simulator mode";
    gps_incomplete: u16, "", "the same: a sentence or a field is missing";
    gps_week_rollover: u16, "", "the same: the date is off by a multiple of 1024 weeks";
    gps_another_day: u16, "", "the same: the date differs from the clock's";
    gps_no_place: u16, "", "the same: latitude and longitude are both about 0";
    gps_out_of_range: u16, "", "the same: position, height or speed impossible";
    gps_jumps: u16, "", "the same: far from the last ones and not confirmed";
    gps_repeated: u16, "", "the same: with the time of the fix before";
    gps_out_of_time: u16, "", "the same: more than 3 s from the IMU's clock";
    gps_unreadable: u16, "", "sentences of the receiver with a wrong checksum, wrong fields or no end";
    gps_noise_bytes: u32, "", "bytes from the receiver outside of sentences";
    [system]
    values_set: u16, "", "values set by command that differ from the configuration";
    [navigation]
    gyro_right_sigmas: Option<f32>, "", "the Sun along the telescope's right, measured minus predicted by the gyros, in its 1 sigma";
    gyro_up_sigmas: Option<f32>, "", "the same along its up";
    gyro_roll_sigmas: Option<f32>, "", "roll by the nadir, measured minus predicted by the gyros, in its 1 sigma";
    gyro_agreement: u8, "", "agreement of cameras and gyros" => GYRO_AGREEMENT;
}

/// The ids of up to sixteen marks of the plate of 2013: i and j, each from -7 to 7.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct MarkIds([Option<[i32; 2]>; 16]);

impl MarkIds {
    /// The first sixteen ids. An id that does not fit a byte is omitted, so that it is not read as another.
    pub fn new(ids: impl IntoIterator<Item = [i32; 2]>) -> Self {
        let mut own = Self::default();
        let fits = |id: &[i32; 2]| id.iter().all(|index| (-7..=7).contains(index));
        for (place, id) in own.0.iter_mut().zip(ids.into_iter().filter(fits)) {
            *place = Some(id);
        }
        own
    }

    pub fn iter(&self) -> impl Iterator<Item = [i32; 2]> {
        self.0.iter().flatten().copied()
    }
}

/// Ids in the form used by logs and pages.
pub fn ids_in_words(ids: impl Iterator<Item = [i32; 2]>) -> String {
    let ids: Vec<String> = ids.map(|[i, j]| format!("{i},{j}")).collect();
    ids.join(" ")
}

/// The first 8 of a number's hexadecimal digits; `None` if it is not known.
#[derive(Clone, Copy, PartialEq, Eq, Default)]
pub struct Digits(Option<u32>);

impl Digits {
    /// The digits with which a text begins.
    pub fn of(text: &str) -> Self {
        let first = text.get(..8);
        Self(first.and_then(|digits| u32::from_str_radix(digits, 16).ok()))
    }
}

impl fmt::Debug for Digits {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.0 {
            Some(digits) => write!(out, "{digits:08x}"),
            None => out.write_str("unknown"),
        }
    }
}

/// The fields after the layout's number, each with the first layout that contains it.
pub fn fields_by_layout() -> impl Iterator<Item = (u8, &'static Field)> {
    let mut layout = 1;
    FIELDS.iter().map(move |field| {
        let began = EARLIER.iter();
        let mut ended = began.filter(|(_, added)| *added == field.name);
        layout = ended.next().map_or(layout, |(earlier, _)| earlier + 1);
        (layout, field)
    })
}

/// A payload of an earlier layout converted to this one: fields added since, from `added` on, are zero or not known.
fn completed(payload: &[u8], added: &str) -> Option<Vec<u8>> {
    let added = FIELDS.iter().skip_while(|field| field.name != added);
    let added: usize = added.map(|field| field.bytes).sum();
    let mut completed = Housekeeping::default().payload();
    let known = completed.len() - added;
    let (known_bytes, _) = completed.split_at_mut_checked(known)?;
    known_bytes.copy_from_slice(payload.get(..known_bytes.len())?);
    completed[0] = LAYOUT;
    Some(completed)
}

impl Housekeeping {
    /// The packet made at `time`.
    pub fn packet(&self, time: Timestamp) -> Result<TelemetryPacket, MessageError> {
        let kind = telemetry_type::HOUSEKEEPING;
        let time = fields::unix_time(kind.into(), time)?;
        Ok(TelemetryPacket::new(
            kind,
            id::ASPECT,
            time,
            self.payload(),
        )?)
    }

    /// Reads a packet; `None` if it is of another type or layout, or too short.
    pub fn decode(packet: &TelemetryPacket) -> Option<Self> {
        (packet.kind() == telemetry_type::HOUSEKEEPING)
            .then(|| Self::from_payload(packet.payload()))
            .flatten()
    }
}

/// Encoding of a field as one or more numbers of a type.
trait Wire: Sized {
    const NUMBER: Number;
    const COUNT: usize = 1;
    const BYTES: usize = Self::COUNT * Self::NUMBER.bytes();
    /// Its type, in words.
    fn kind() -> String;
    fn write(&self, bytes: &mut Vec<u8>);
    fn read(rest: &mut &[u8]) -> Option<Self>;
    /// In words; empty if not known.
    fn text(&self) -> String;
    /// Reads the text that [`text`](Self::text) writes.
    fn parse(text: &str) -> Option<Self>;
    /// Whether its number is meaningful to a reader.
    const IS_NUMBER: bool;
    /// `None` if not known.
    fn value(&self) -> Option<f64>;
}

/// A field that is one number, which double precision represents exactly.
trait Single: Sized {
    const NUMBER: Number;
    /// Note added to the number's type.
    const NOTE: &'static str = "";
    /// The number as sent.
    fn number(&self) -> f64;
    fn of(number: f64) -> Self;
    fn in_words(&self) -> String;
    fn from_words(text: &str) -> Option<Self>;
    const IS_NUMBER: bool = true;
    /// `None` if not known.
    fn known(&self) -> Option<f64> {
        Some(self.number())
    }
}

impl<T: Single> Wire for T {
    const NUMBER: Number = <T as Single>::NUMBER;
    const IS_NUMBER: bool = <T as Single>::IS_NUMBER;

    fn kind() -> String {
        format!("{}{}", <T as Single>::NUMBER.name(), T::NOTE)
    }

    fn write(&self, bytes: &mut Vec<u8>) {
        <T as Single>::NUMBER.write(self.number(), bytes);
    }

    fn read(rest: &mut &[u8]) -> Option<Self> {
        let (number, after) = <T as Single>::NUMBER.read(rest)?;
        *rest = after;
        Some(Self::of(number))
    }

    fn text(&self) -> String {
        self.in_words()
    }

    fn parse(text: &str) -> Option<Self> {
        Self::from_words(text)
    }

    fn value(&self) -> Option<f64> {
        self.known()
    }
}

macro_rules! whole {
    ($($type:ty, $number:ident);*) => {$(
        impl Single for $type {
            const NUMBER: Number = Number::$number;

            fn number(&self) -> f64 {
                (*self).into()
            }

            fn of(number: f64) -> Self {
                number as Self
            }

            fn in_words(&self) -> String {
                self.to_string()
            }

            fn from_words(text: &str) -> Option<Self> {
                text.parse().ok()
            }
        }
    )*};
}

whole!(u8, U8; u16, U16; u32, U32);

impl Single for bool {
    const NUMBER: Number = Number::U8;
    const NOTE: &'static str = ", 1 or 0";

    fn number(&self) -> f64 {
        u8::from(*self).into()
    }

    fn of(number: f64) -> Self {
        number != 0.0
    }

    fn in_words(&self) -> String {
        u8::from(*self).to_string()
    }

    fn from_words(text: &str) -> Option<Self> {
        u8::from_str(text).ok().map(|byte| byte != 0)
    }
}

impl Single for Option<f32> {
    const NUMBER: Number = Number::F32;
    const NOTE: &'static str = ", NaN where not known";

    fn number(&self) -> f64 {
        self.map_or(f64::NAN, f64::from)
    }

    fn of(number: f64) -> Self {
        (!number.is_nan()).then_some(number as f32)
    }

    fn in_words(&self) -> String {
        self.map_or(String::new(), |value| value.to_string())
    }

    fn from_words(text: &str) -> Option<Self> {
        parse_known(text)
    }

    fn known(&self) -> Option<f64> {
        self.map(f64::from)
    }
}

impl Single for Option<u8> {
    const NUMBER: Number = Number::U8;
    const NOTE: &'static str = ", 255 where not known";

    fn number(&self) -> f64 {
        self.unwrap_or(u8::MAX).into()
    }

    fn of(number: f64) -> Self {
        Some(number as u8).filter(|byte| *byte != u8::MAX)
    }

    fn in_words(&self) -> String {
        self.map_or(String::new(), |value| value.to_string())
    }

    fn from_words(text: &str) -> Option<Self> {
        parse_known(text)
    }

    fn known(&self) -> Option<f64> {
        self.map(f64::from)
    }
}

/// Reads a value that is empty if not known.
fn parse_known<T: FromStr>(text: &str) -> Option<Option<T>> {
    match text {
        "" => Some(None),
        text => text.parse().ok().map(Some),
    }
}

impl Single for Digits {
    const NUMBER: Number = Number::U32;
    const NOTE: &'static str = ", 0 where not known";
    const IS_NUMBER: bool = false;

    fn number(&self) -> f64 {
        self.0.unwrap_or(0).into()
    }

    fn of(number: f64) -> Self {
        Self(Some(number as u32).filter(|digits| *digits != 0))
    }

    fn in_words(&self) -> String {
        self.0
            .map_or(String::new(), |digits| format!("{digits:08x}"))
    }

    fn from_words(text: &str) -> Option<Self> {
        match text {
            "" => Some(Self(None)),
            text => u32::from_str_radix(text, 16).ok().map(|n| Self(Some(n))),
        }
    }

    fn known(&self) -> Option<f64> {
        None
    }
}

impl Wire for MarkIds {
    const NUMBER: Number = Number::U8;
    const COUNT: usize = 16;
    const IS_NUMBER: bool = false;

    fn kind() -> String {
        "16 x u8".into()
    }

    fn write(&self, bytes: &mut Vec<u8>) {
        // From -8 to 7, for any bytes that were read.
        let nibble = |index: i32| (index + 8) as u8;
        let byte = |id: &Option<[i32; 2]>| id.map_or(0, |[i, j]| nibble(i) << 4 | nibble(j));
        bytes.extend(self.0.iter().map(byte));
    }

    fn read(rest: &mut &[u8]) -> Option<Self> {
        let (bytes, after) = rest.split_first_chunk::<16>()?;
        *rest = after;
        let index = |nibble: u8| i32::from(nibble) - 8;
        Some(Self(bytes.map(|byte| {
            let (i, j) = (index(byte >> 4), index(byte & 15));
            (byte != 0).then_some([i, j])
        })))
    }

    fn text(&self) -> String {
        ids_in_words(self.iter())
    }

    fn parse(text: &str) -> Option<Self> {
        let id = |text: &str| {
            let (i, j) = text.split_once(',')?;
            Some([i.parse().ok()?, j.parse().ok()?])
        };
        let ids: Option<Vec<[i32; 2]>> = text.split_whitespace().map(id).collect();
        ids.map(Self::new)
    }

    fn value(&self) -> Option<f64> {
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn full() -> Housekeeping {
        Housekeeping {
            computer: 2,
            tracking: true,
            stopped_levels: 1,
            stopped_pointing: 65535,
            disc_dn: Some(205.5),
            sun_x_px: Some(-3.25),
            ids: MarkIds::new([[-7, 7], [0, 0]]),
            marks: 2,
            disk_1: Some(87),
            latency_ms: Some(3.5),
            restarts: 1,
            disk_2_refusals: 70_000,
            simulated: true,
            commit: Digits::of("0123456789ab-dirty"),
            modified: true,
            configuration: Digits::of("fedcba98"),
            gyro_up_sigmas: Some(-7.5),
            gyro_agreement: 2,
            ..Housekeeping::default()
        }
    }

    #[test]
    fn what_is_sent_is_what_is_received() {
        let time = Timestamp::from_second(1_379_786_400).unwrap();
        for housekeeping in [Housekeeping::default(), full()] {
            let packet = housekeeping.packet(time).unwrap();
            assert_eq!(Housekeeping::decode(&packet), Some(housekeeping));
        }
    }

    #[test]
    fn a_row_of_a_log_is_read_as_it_was_written() {
        for housekeeping in [Housekeeping::default(), full()] {
            let row = housekeeping.csv_row();
            let value = |name: &str| {
                let at = FIELDS.iter().position(|field| field.name == name)?;
                Some(row[at].as_str())
            };
            assert_eq!(Housekeeping::from_csv(value), Some(housekeeping));
        }
        assert_eq!(
            Housekeeping::from_csv(|_| None),
            Some(Housekeeping::default())
        );
        assert_eq!(Housekeeping::from_csv(|_| Some("x")), None);
    }

    #[test]
    fn the_numbers_of_a_field_are_read_from_its_bytes_alone() {
        let payload = full().payload();
        let mut at = 1;
        let mut numbers = std::collections::BTreeMap::new();
        for field in FIELDS {
            let bytes = &payload[at..at + field.bytes];
            numbers.insert(field.name, field.value(bytes));
            at += field.bytes;
        }
        assert_eq!(numbers["computer"], Some(2.0));
        assert_eq!(numbers["stopped_pointing"], Some(65535.0));
        assert_eq!(numbers["sun_x_px"], Some(-3.25));
        assert_eq!(numbers["sun_y_px"], None);
        assert_eq!(numbers["disk_1"], Some(87.0));
        assert_eq!(numbers["disk_2"], None);
        assert_eq!(numbers["ids"], None);
    }

    #[test]
    fn an_id_without_a_byte_of_its_own_is_packed_as_no_other() {
        let ids = MarkIds::new([[8, 0], [7, -7], [-8, -8], [0, 101], [-7, 7]]);
        assert_eq!(ids.iter().collect::<Vec<_>>(), [[7, -7], [-7, 7]]);
        let mut bytes = Vec::new();
        Wire::write(&ids, &mut bytes);
        assert_eq!(bytes[..3], [0xF1, 0x1F, 0]);
    }

    #[test]
    fn the_table_gives_the_length_and_it_is_short() {
        let length: usize = FIELDS.iter().map(|field| field.bytes).sum();
        assert_eq!(full().payload().len(), 1 + length);
        // 3.5 % of the 11,520 bytes that the line carries in a second.
        assert!(length <= 400, "{length} bytes");
    }

    #[test]
    fn another_layout_and_a_cut_payload_are_not_read() {
        let payload = full().payload();
        for length in 0..payload.len() {
            assert_eq!(Housekeeping::from_payload(&payload[..length]), None);
        }
        let mut other = payload;
        other[0] += 1;
        assert_eq!(Housekeeping::from_payload(&other), None);
    }

    #[test]
    fn a_packet_of_an_earlier_layout_is_read_without_what_it_did_not_have() {
        let layout_8 = Housekeeping {
            gyro_up_sigmas: None,
            gyro_agreement: 0,
            ..full()
        };
        let layout_2 = Housekeeping {
            commit: Digits::default(),
            modified: false,
            configuration: Digits::default(),
            ..layout_8.clone()
        };
        let layout_1 = Housekeeping {
            disk_2_refusals: 0,
            simulated: false,
            ..layout_2.clone()
        };
        for (layout, stated_length, housekeeping) in [
            (1, 207, layout_1),
            (2, 245, layout_2),
            (4, 282, layout_8.clone()),
            (8, 374, layout_8),
        ] {
            let added = EARLIER.iter().find(|(number, _)| *number == layout);
            let (_, added) = added.unwrap();
            let known = FIELDS.iter().take_while(|field| field.name != *added);
            let length = 1 + known.map(|field| field.bytes).sum::<usize>();
            assert_eq!(
                length, stated_length,
                "layout {layout} does not change any more"
            );
            let mut payload = full().payload();
            payload[0] = layout;
            assert_eq!(
                Housekeeping::from_payload(&payload[..length]),
                Some(housekeeping)
            );
            for shorter in 0..length {
                assert_eq!(Housekeeping::from_payload(&payload[..shorter]), None);
            }
        }
    }
}
