//! The payloads of messages and telemetry as tables of fields. Lengths of messages are known by them, and the link is described
//! to other programs by them ([`schema`](super::schema)).

use super::packet::{Direction, telemetry_type};
use Direction::{ToAspect, ToController};
use Number::{F32, F64, U16, U32};

/// The keys of messages.
pub mod key {
    pub const GPS: u16 = 0x000A;
    pub const START_TRACKING: u16 = 0x1000;
    pub const STOP_TRACKING: u16 = 0x1001;
    pub const ASPECT_COMMAND: u16 = 0x10FF;
    pub const TRACKING_ON: u16 = 0x1100;
    pub const TRACKING_OFF: u16 = 0x1101;
    pub const SOLUTION: u16 = 0x1102;
    pub const ERROR: u16 = 0x1103;
    pub const EXPOSURE_START: u16 = 0x1104;
    pub const PROPAGATED: u16 = 0x1105;
    pub use crate::link::moon::{
        FOUND as MOON_FOUND, NOT_FOUND_KEY as MOON_NOT_FOUND, NOT_VISIBLE_KEY as MOON_NOT_VISIBLE,
        REQUEST as MOON_REQUEST,
    };
}

/// How a number travels, little-endian.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Number {
    U8,
    U16,
    I16,
    U32,
    F32,
    F64,
}

impl Number {
    /// Its length.
    pub const fn bytes(self) -> usize {
        match self {
            Self::U8 => 1,
            Self::U16 | Self::I16 => 2,
            Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }
}

/// A field of a payload: one number, or several of a kind.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Field {
    pub name: &'static str,
    pub number: Number,
    pub count: usize,
    /// Empty for counts and codes.
    pub unit: &'static str,
    pub documentation: &'static str,
}

impl Field {
    /// Its length.
    pub const fn bytes(&self) -> usize {
        self.count * self.number.bytes()
    }
}

/// A message of a command packet. The aspect command has the words of its variables after its fields.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct MessageRow {
    pub key: u16,
    pub name: &'static str,
    pub direction: Direction,
    /// After the key.
    pub fields: &'static [Field],
    pub documentation: &'static str,
}

impl MessageRow {
    /// The length of its fields.
    pub fn bytes(&self) -> usize {
        self.fields.iter().map(Field::bytes).sum()
    }
}

/// A type of telemetry.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct TelemetryRow {
    pub kind: u8,
    pub name: &'static str,
    pub direction: Direction,
    pub payload: Payload,
    pub documentation: &'static str,
}

/// What a telemetry packet carries.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Payload {
    Fields(&'static [Field]),
    /// The layout's number, and the fields of [`housekeeping::FIELDS`](super::housekeeping::FIELDS) that it has.
    Housekeeping,
    PictureSection,
    PictureTag,
}

const fn field(
    name: &'static str,
    number: Number,
    unit: &'static str,
    documentation: &'static str,
) -> Field {
    Field {
        name,
        number,
        count: 1,
        unit,
        documentation,
    }
}

const fn message(
    key: u16,
    name: &'static str,
    direction: Direction,
    fields: &'static [Field],
    documentation: &'static str,
) -> MessageRow {
    MessageRow {
        key,
        name,
        direction,
        fields,
        documentation,
    }
}

const fn telemetry(
    kind: u8,
    name: &'static str,
    direction: Direction,
    payload: Payload,
    documentation: &'static str,
) -> TelemetryRow {
    TelemetryRow {
        kind,
        name,
        direction,
        payload,
        documentation,
    }
}

const AZIMUTH: Field = field(
    "azimuth_deg",
    F64,
    "deg",
    "offset in azimuth, pointing minus target",
);
const ELEVATION: Field = field("elevation_deg", F64, "deg", "offset in elevation");
const ERROR: Field = field(
    "error_deg",
    F64,
    "deg",
    "the offset's 1 sigma per axis of true angle",
);
const SECONDS: Field = field("seconds", U32, "s", "its time, UTC since 1970");
const MILLISECONDS: Field = field("milliseconds", U16, "ms", "of its time");
const REQUEST: Field = field(
    "request",
    U16,
    "",
    "sequence number of the request's packet",
);

#[rustfmt::skip] // One row, one line.
const SOLUTION: &[Field] = &[
    AZIMUTH, ELEVATION,
    field("roll_deg", F64, "deg", "the body's roll by the horizon; 0 where it is not known"),
    ERROR, SECONDS, MILLISECONDS,
];

#[rustfmt::skip] // One row, one line.
const PROPAGATED: &[Field] = &[
    AZIMUTH, ELEVATION,
    field("roll_deg", F64, "deg", "roll about the boresight"),
    ERROR, SECONDS, MILLISECONDS,
    field("age_ms", U16, "ms", "age of the last frame that it rests on; 65535 for more"),
];

#[rustfmt::skip] // One row, one line.
const MOON_FOUND: &[Field] = &[
    REQUEST,
    field("x_px", F64, "px", "the disc's centre"),
    field("y_px", F64, "px", "the disc's centre"),
    field("covariance_xx_px2", F64, "px^2", "covariance of the centre"),
    field("covariance_xy_px2", F64, "px^2", "covariance of the centre"),
    field("covariance_yy_px2", F64, "px^2", "covariance of the centre"),
    field("direction_x", F64, "", "unit vector in the camera's axes, to the right"),
    field("direction_y", F64, "", "down"),
    field("direction_z", F64, "", "forward"),
    field("seconds", U32, "s", "mid-exposure, UTC since 1970"), MILLISECONDS,
];

#[rustfmt::skip] // One row, one line.
const IMU_SAMPLE: &[Field] = &[
    field("counter", U16, "", "counts the samples; after 65535 comes 0"),
    field("force_x_m_s2", F32, "m/s^2", "mean specific force along the IMU's x axis"),
    field("force_y_m_s2", F32, "m/s^2", "along its y axis"),
    field("force_z_m_s2", F32, "m/s^2", "along its z axis"),
    field("rate_x_rad_s", F32, "rad/s", "mean rate against inertial space about the x axis"),
    field("rate_y_rad_s", F32, "rad/s", "about the y axis"),
    field("rate_z_rad_s", F32, "rad/s", "about the z axis"),
];

/// The messages, in the order of their keys.
#[rustfmt::skip] // One row, one line.
pub const MESSAGES: &[MessageRow] = &[
    message(key::GPS, "gps", ToAspect, &[
        field("latitude_deg", F32, "deg", "the gondola's latitude"),
        field("longitude_deg", F32, "deg", "its longitude, east positive"),
    ], "the gondola's place"),
    message(key::START_TRACKING, "start_tracking", ToAspect, &[], "start tracking"),
    message(key::STOP_TRACKING, "stop_tracking", ToAspect, &[], "stop tracking"),
    message(key::MOON_REQUEST, "moon", ToAspect, &[
        field("latitude_deg", F64, "deg", "the platform's latitude"),
        field("longitude_deg", F64, "deg", "its longitude, east positive"),
        field("height_m", F64, "m", "its height above the WGS 84 ellipsoid"),
    ], "where is the Moon?"),
    message(key::ASPECT_COMMAND, "aspect_command", ToAspect, &[
        field("key", U16, "", "top 4 bits: computers; low 4 bits: number of variables"),
    ], "a command of the ground; as many variables, 16 bits each, as its key says"),
    message(key::TRACKING_ON, "tracking_on", ToController, &[], "tracking is on"),
    message(key::TRACKING_OFF, "tracking_off", ToController, &[], "tracking is off"),
    message(key::SOLUTION, "solution", ToController, SOLUTION, "offset of an announced exposure"),
    message(key::ERROR, "error", ToController, &[
        field("code", U16, "", "why"),
    ], "no solution for an announced exposure"),
    message(key::EXPOSURE_START, "exposure_start", ToController, &[
        field("camera", U16, "", "1"),
        field("time", F64, "s", "start of the exposure, UTC since 1970"),
    ], "an exposure is about to start"),
    message(key::PROPAGATED, "propagated", ToController, PROPAGATED, "an offset by the gyros"),
    message(key::MOON_FOUND, "moon_found", ToController, MOON_FOUND, "the Moon is found"),
    message(key::MOON_NOT_VISIBLE, "moon_not_visible", ToController, &[
        REQUEST, field("code", U16, "", "why"),
    ], "the Moon is not visible"),
    message(key::MOON_NOT_FOUND, "moon_not_found", ToController, &[
        REQUEST, field("code", U16, "", "why"),
    ], "the Moon is not found"),
];

/// The types of telemetry.
#[rustfmt::skip] // One row, one line.
pub const TELEMETRY: &[TelemetryRow] = &[
    telemetry(telemetry_type::RECEIPT, "receipt", ToController, Payload::Fields(&[
        field("sequence", U16, "", "sequence number of the command"),
    ]), "a command has arrived"),
    telemetry(telemetry_type::IDLE, "idle", ToController, Payload::Fields(&[]), "nothing to tell"),
    telemetry(telemetry_type::HOUSEKEEPING, "housekeeping", ToController, Payload::Housekeeping, "status, each second"),
    telemetry(telemetry_type::IMU, "imu_sample", ToAspect, Payload::Fields(IMU_SAMPLE),
        "a sample of the IMU; the header's time is the end of its interval"),
    telemetry(telemetry_type::PICTURE, "picture_section", ToController, Payload::PictureSection, "pixels of a picture, row by row"),
    telemetry(telemetry_type::PICTURE_TAG, "picture_tag", ToController, Payload::PictureTag, "a keyword of a picture"),
    telemetry(telemetry_type::RESULT, "result", ToController, Payload::Fields(&[
        field("sequence", U16, "", "sequence number of the command"),
        field("key", U16, "", "key of the message, or of the aspect command with its computers"),
        field("value", U16, "", "0 done, 1 not implemented, 2 refused, 65535 unknown; of a read: its value"),
    ]), "what came of a command"),
];

/// What the numbers of a field of housekeeping stand for, as its documentation has it.
#[rustfmt::skip] // One row, one line.
pub const CHOICES: &[(&str, &[(u16, &str)])] = &[
    ("quality", &[(0, "none"), (1, "coarse"), (2, "fine")]),
    ("mapping", &[(0, "none"), (1, "similarity"), (2, "affine"), (3, "homography"), (4, "prior"), (5, "calibration"), (6, "keystone")]),
    ("navigation", &[(0, "none"), (1, "waiting"), (2, "aligned"), (3, "coasting"), (4, "restarted"), (5, "contradicted"), (6, "unsound")]),
    ("gyro_agreement", &[(0, "none"), (1, "within"), (2, "beyond"), (3, "contradicted")]),
];

/// The row of a message's key.
pub fn message_of(key: u16) -> Option<&'static MessageRow> {
    MESSAGES.iter().find(|row| row.key == key)
}

#[cfg(test)]
mod tests;
