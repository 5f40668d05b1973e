//! Contents of packets: the messages of the control loop, the ground's commands, and our answers.
//!
//! A payload holds one message or several, one after the other ([`Messages`]). A message begins with a key (u16) that
//! identifies it and fixes the rest. A key of zero, or a rest too short for a key, ends the reading, so that
//! padded packets are understood.
//!
//! To add a message, add its row to the table of messages and its fields above; the codec, the words, the page on the protocol and the
//! descriptions for other programs are derived from it.

pub use super::fields::MessageError;

use super::fields::{Milliseconds, Reader, Said, Seconds, Wire, Writer, fields};
use super::moon::{MoonAnswer, MoonFix, MoonOutcome, NOT_FOUND, NOT_VISIBLE};
use super::number::{Codes, Field};
use super::packet::CommandPacket;
use super::packet::Direction::{self, ToAspect, ToController};
use crate::units::{Place, PlaceError};
use jiff::Timestamp;

/// Error code of a frame whose Sun was found, but time or place is not known.
pub const NO_OFFSET: u16 = 100;

/// Codes for a frame without a solution: 1 to 7 for the stage at which it stopped.
#[rustfmt::skip] // One row, one line.
pub static ERROR_CODES: Codes = Codes { name: "error_code", rows: &[
    (1, "levels", "levels: no disc stands out of the background"),
    (2, "limb", "limb: no disc was found"),
    (3, "marks", "marks: too few were seen"),
    (4, "identification", "identification: the marks could not be identified"),
    (5, "registration", "registration: no mapping fits the marks"),
    (6, "aspect", "aspect: the Sun's place on the plate is not known"),
    (7, "pointing", "pointing: the target cannot be pointed at from here"),
    (NO_OFFSET, "no_offset", "the Sun was found, but time or place of the frame is not known"),
] };

/// The camera's number in an exposure packet: 1, whichever computer sends it.
pub const CAMERA: u16 = 1;

fields! {
    /// Pointing of the telescope minus the target, at the start of an exposure.
    Solution, format!("solution azimuth {azimuth_deg} elevation {elevation_deg} roll {roll_deg} error {error_deg} deg at {time}") => {
        azimuth_deg: f64, "deg", "offset in azimuth, pointing minus target (coordinate difference, no cos(elevation) factor)";
        elevation_deg: f64, "deg", "offset in elevation";
        roll_deg: f64, "deg", "the body's roll by the horizon (0 where it is not known), or about the boresight where the offset is one by the gyros";
        error_deg: f64, "deg", "the offset's 1 sigma per axis of true angle";
        /// The time that its exposure packet announced; sent to the nearest millisecond.
        time: Timestamp as Milliseconds [
            "seconds", "s", "its time, UTC since 1970";
            "milliseconds", "ms", "of its time";
        ];
    }

    /// Pointing of the telescope minus the target, propagated by the gyros since a frame.
    Propagated, format!("by gyros {}, {age_ms} ms after a frame", solution.words().trim_start_matches("solution ")) => {
        /// Its time is that of the attitude.
        solution: Solution;
        age_ms: u16, "ms", "age of the last frame that it rests on (65535 for more)";
    }

    /// No solution for an announced exposure.
    NoSolution, format!("no solution, error {code}") => {
        code: u16, "", "why" => ERROR_CODES;
    }

    /// An exposure is about to start.
    ExposureStart, format!("exposure of camera {camera} at {time}") => {
        camera: u16, "", "1";
        time: Timestamp as Seconds, "s", "start of the exposure, UTC since 1970";
    }

    /// The gondola's place, sent by the ground.
    GpsFix, format!("GPS latitude {latitude_deg} longitude {longitude_deg} deg") => {
        latitude_deg: f32, "deg", "the gondola's latitude" in -90.0, 90.0;
        longitude_deg: f32, "deg", "its longitude, east positive" in -360.0, 360.0;
    }

    /// The platform requests the Moon's place, and states its own.
    MoonRequest, format!("where is the Moon from latitude {latitude_deg} longitude {longitude_deg} deg height {height_m} m") => {
        latitude_deg: f64, "deg", "the platform's latitude" in -90.0, 90.0;
        longitude_deg: f64, "deg", "its longitude, east positive" in -180.0, 360.0;
        height_m: f64, "m", "its height above the WGS 84 ellipsoid" in -1000.0, 2_000_000.0;
    }

    /// The Moon was found in a picture begun after the request.
    MoonFound, format!("Moon of seq {request}: {}", fix.words()) => {
        request: u16, "", "sequence number of the request's packet";
        fix: MoonFix;
    }

    /// By the ephemeris the Moon cannot be seen.
    MoonNotVisible, format!("Moon of seq {request}: not visible ({code}): {}", reason(&NOT_VISIBLE, *code)) => {
        request: u16, "", "sequence number of the request's packet";
        code: u16, "", "why" => NOT_VISIBLE;
    }

    /// The Moon should be in the picture and is not found.
    MoonNotFound, format!("Moon of seq {request}: not found ({code}): {}", reason(&NOT_FOUND, *code)) => {
        request: u16, "", "sequence number of the request's packet";
        code: u16, "", "why" => NOT_FOUND;
    }
}

fn reason(codes: &Codes, code: u16) -> &'static str {
    codes.meaning(code).unwrap_or("unknown reason")
}

impl MoonRequest {
    /// The platform's place.
    ///
    /// # Errors
    /// If a coordinate is out of range.
    pub fn place(&self) -> Result<Place, PlaceError> {
        Place::new(self.latitude_deg, self.longitude_deg, self.height_m)
    }
}

/// A command of the ground to the aspect system, as sent: a key, and as many variables as its low 4 bits state.
/// Its top 4 bits select the computers it is for; its meaning is in the table of commands.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AspectCommand {
    key: u16,
    variables: Vec<u16>,
}

impl AspectCommand {
    /// A command whose number of variables must be the one that its key states.
    pub fn new(key: u16, variables: Vec<u16>) -> Result<Self, MessageError> {
        let (expected, found) = (variable_count(key), variables.len());
        if found != expected {
            return Err(MessageError::Variables {
                key,
                expected,
                found,
            });
        }
        Ok(Self { key, variables })
    }

    /// The key, including the computers' bits.
    pub fn key(&self) -> u16 {
        self.key
    }

    pub fn variables(&self) -> &[u16] {
        &self.variables
    }

    fn words(&self) -> String {
        format!("aspect command {:#06x} {:?}", self.key, self.variables)
    }
}

/// Its fields and length are those before the variables.
impl Wire for AspectCommand {
    const BYTES: usize = u16::BYTES;

    fn fields(_: &[Said]) -> Vec<Field> {
        u16::fields(&[Said {
            name: "key",
            unit: "",
            documentation: "top 4 bits: computers, low 4 bits: number of variables",
            codes: None,
            range: None,
        }])
    }

    fn read(input: &mut Reader, field: &'static str) -> Result<Self, MessageError> {
        let key = u16::read(input, field)?;
        let variables = input.words().take(variable_count(key)).collect();
        Self::new(key, variables)
    }

    fn write(value: &Self, out: &mut Writer, field: &'static str) -> Result<(), MessageError> {
        u16::write(&value.key, out, field)?;
        let mut variables = value.variables.iter();
        variables.try_for_each(|variable| u16::write(variable, out, field))
    }
}

/// A message of a command packet, as a row of the table.
#[derive(Debug, Clone, Copy)]
pub struct MessageRow {
    pub key: u16,
    pub name: &'static str,
    pub direction: Direction,
    pub documentation: &'static str,
    /// Length of its fields.
    pub bytes: usize,
    fields: fn() -> Vec<Field>,
}

impl MessageRow {
    /// The fields after the key. Those of the aspect command are followed by its variables.
    pub fn fields(&self) -> Vec<Field> {
        (self.fields)()
    }
}

/// A pattern for the body of a message.
macro_rules! bind {
    ($name:pat, $body:ident) => {
        $name
    };
}

/// A row for each message, with the struct of its fields if it has any: the constant of its key, the key, its direction, name and meaning.
macro_rules! messages {
    ($($message:ident $(($body:ident))? = $constant:ident, $key:literal, $direction:ident, $name:literal, $documentation:literal;)*) => {
        /// The keys of messages.
        pub mod key {
            $(pub const $constant: u16 = $key;)*
        }

        /// A message in a command packet.
        #[derive(Debug, Clone, PartialEq)]
        pub enum Message {
            $(#[doc = $documentation] $message $(($body))?,)*
        }

        /// The messages, in the order of their keys.
        pub const MESSAGES: &[MessageRow] = &[$(MessageRow {
            key: $key,
            name: $name,
            direction: $direction,
            documentation: $documentation,
            bytes: 0 $(+ <$body as Wire>::BYTES)?,
            fields: || [Vec::new() $(, <$body as Wire>::fields(&[]))?].concat(),
        }),*];

        impl Message {
            pub fn key(&self) -> u16 {
                match self {
                    $(Self::$message $((bind!(_, $body)))? => $key,)*
                }
            }

            /// The message as sent: its key and its fields.
            pub fn payload(&self) -> Result<Vec<u8>, MessageError> {
                let mut out = Writer::new(self.key());
                match self {
                    $(Self::$message $((bind!(body, $body)))? => {
                        $(<$body as Wire>::write(body, &mut out, $name)?;)?
                    })*
                }
                Ok(out.finish())
            }

            /// Reads the first message of a command packet's payload.
            pub fn decode(payload: &[u8]) -> Result<Self, MessageError> {
                let mut input = Reader::new(payload)?;
                match input.key() {
                    $($key => Ok(Self::$message $((<$body as Wire>::read(&mut input, $name)?))?),)*
                    key => Err(MessageError::UnknownKey { key }),
                }
            }

            /// The message in words.
            pub fn words(&self) -> String {
                match self {
                    $(Self::$message $((bind!(body, $body)))? => {
                        let words = None $(.or(Some($body::words(body))))?;
                        words.unwrap_or_else(|| $documentation.into())
                    })*
                }
            }
        }
    };
}

messages! {
    Gps(GpsFix) = GPS, 0x000A, ToAspect, "gps", "take this as the gondola's place";
    StartTracking = START_TRACKING, 0x1000, ToAspect, "start_tracking", "start tracking";
    StopTracking = STOP_TRACKING, 0x1001, ToAspect, "stop_tracking", "stop tracking";
    MoonRequest(MoonRequest) = MOON_REQUEST, 0x1010, ToAspect, "moon", "say where the Moon is, seen from a place";
    Aspect(AspectCommand) = ASPECT_COMMAND, 0x10FF, ToAspect, "aspect_command", "a command of the ground; as many variables, 16 bits each, as its key says";
    TrackingOn = TRACKING_ON, 0x1100, ToController, "tracking_on", "tracking is on";
    TrackingOff = TRACKING_OFF, 0x1101, ToController, "tracking_off", "tracking is off";
    Solution(Solution) = SOLUTION, 0x1102, ToController, "solution", "offset of an announced exposure";
    Error(NoSolution) = ERROR, 0x1103, ToController, "error", "no solution for an announced exposure";
    ExposureStart(ExposureStart) = EXPOSURE_START, 0x1104, ToController, "exposure_start", "an exposure is about to start";
    Propagated(Propagated) = PROPAGATED, 0x1105, ToController, "propagated", "an offset by the gyros";
    MoonFound(MoonFound) = MOON_FOUND, 0x1110, ToController, "moon_found", "the Moon is found";
    MoonNotVisible(MoonNotVisible) = MOON_NOT_VISIBLE, 0x1111, ToController, "moon_not_visible", "the Moon is not visible";
    MoonNotFound(MoonNotFound) = MOON_NOT_FOUND, 0x1112, ToController, "moon_not_found", "the Moon is not found";
}

impl From<MoonAnswer> for Message {
    fn from(MoonAnswer { request, outcome }: MoonAnswer) -> Self {
        match outcome {
            MoonOutcome::Found(fix) => Self::MoonFound(MoonFound { request, fix }),
            MoonOutcome::NotVisible { code } => {
                Self::MoonNotVisible(MoonNotVisible { request, code })
            }
            MoonOutcome::NotFound { code } => Self::MoonNotFound(MoonNotFound { request, code }),
        }
    }
}

impl Message {
    /// The answer to a request for the Moon, if the message is one.
    pub fn moon_answer(&self) -> Option<MoonAnswer> {
        let (request, outcome) = match *self {
            Self::MoonFound(MoonFound { request, fix }) => (request, MoonOutcome::Found(fix)),
            Self::MoonNotVisible(MoonNotVisible { request, code }) => {
                (request, MoonOutcome::NotVisible { code })
            }
            Self::MoonNotFound(MoonNotFound { request, code }) => {
                (request, MoonOutcome::NotFound { code })
            }
            _ => return None,
        };
        Some(MoonAnswer { request, outcome })
    }

    /// The message as a packet. It refuses numbers that are not finite and times that do not fit.
    pub fn packet(&self, target: u8, sequence: u16) -> Result<CommandPacket, MessageError> {
        Ok(CommandPacket::new(target, sequence, self.payload()?)?)
    }
}

/// The messages of a payload in their order, each with its own bytes.
///
/// A message that cannot be read is an error in its place. If its key does not give its length, or the payload is too
/// short for it, it is the last one, and its bytes stay in the [rest](Self::rest).
#[derive(Debug, Clone)]
pub struct Messages<'a> {
    rest: &'a [u8],
    begun: bool,
    ended: bool,
}

impl<'a> Messages<'a> {
    pub fn of(payload: &'a [u8]) -> Self {
        Self {
            rest: payload,
            begun: false,
            ended: false,
        }
    }

    /// The unread rest: after the last message, padding or bytes that are not understood.
    pub fn rest(&self) -> &'a [u8] {
        self.rest
    }

    /// Number of bytes of the rest that are not understood; 0 for padding with zeros.
    pub fn not_understood(&self) -> usize {
        match self.rest.iter().any(|&byte| byte != 0) {
            true => self.rest.len(),
            false => 0,
        }
    }
}

impl<'a> Iterator for Messages<'a> {
    type Item = (&'a [u8], Result<Message, MessageError>);

    fn next(&mut self) -> Option<Self::Item> {
        let key = first_word(self.rest).unwrap_or_default();
        // In a payload without any message, the first message is an error.
        if self.ended || (self.begun && key == 0) {
            return None;
        }
        self.begun = true;
        let message = Message::decode(self.rest);
        let length = stated_length(self.rest);
        match length.and_then(|length| self.rest.split_at_checked(length)) {
            Some((bytes, rest)) => {
                self.rest = rest;
                Some((bytes, message))
            }
            None => {
                self.ended = true;
                Some((self.rest, message))
            }
        }
    }
}

/// The length of the message that begins a payload, as its key states it, bytes.
fn stated_length(payload: &[u8]) -> Option<usize> {
    let key = first_word(payload)?;
    let variables = match key {
        key::ASPECT_COMMAND => variable_count(first_word(payload.get(2..)?)?),
        _ => 0,
    };
    Some(2 + message_of(key)?.bytes + 2 * variables)
}

fn first_word(bytes: &[u8]) -> Option<u16> {
    bytes.first_chunk().map(|word| u16::from_le_bytes(*word))
}

/// The row of a message's key.
pub fn message_of(key: u16) -> Option<&'static MessageRow> {
    MESSAGES.iter().find(|row| row.key == key)
}

/// Number of variables of an aspect command: the low 4 bits of its key.
pub fn variable_count(key: u16) -> usize {
    usize::from(key & 0x000F)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::link::moon::{MoonAnswer, MoonFix, MoonOutcome};

    pub(in crate::link) fn every_message() -> Vec<Message> {
        let time = Timestamp::from_second(1_379_786_400).unwrap();
        vec![
            Message::TrackingOn,
            Message::ExposureStart(ExposureStart { camera: 1, time }),
            Message::Solution(Solution {
                azimuth_deg: 0.1,
                elevation_deg: 0.2,
                roll_deg: 0.3,
                error_deg: 1e-5,
                time,
            }),
            Message::Error(NoSolution { code: 8 }),
            Message::Propagated(Propagated {
                solution: Solution {
                    azimuth_deg: -0.1,
                    elevation_deg: 0.2,
                    roll_deg: 1.5,
                    error_deg: 2e-5,
                    time,
                },
                age_ms: 1250,
            }),
            Message::Aspect(AspectCommand::new(0x1412, vec![11, 22]).unwrap()),
            Message::Aspect(AspectCommand::new(0x1FF1, vec![7]).unwrap()),
            Message::Gps(GpsFix {
                latitude_deg: 34.5,
                longitude_deg: -104.25,
            }),
            Message::MoonRequest(MoonRequest {
                latitude_deg: 34.5,
                longitude_deg: -104.25,
                height_m: 38_000.0,
            }),
            Message::from(MoonAnswer {
                request: 9,
                outcome: MoonOutcome::Found(MoonFix {
                    x_px: 359.5,
                    y_px: 288.25,
                    covariance_px2: [1e-3, -2e-4, 4e-3],
                    direction: [0.0, 0.6, 0.8],
                    time,
                }),
            }),
            Message::from(MoonAnswer {
                request: 10,
                outcome: MoonOutcome::NotVisible { code: 2 },
            }),
            Message::from(MoonAnswer {
                request: 11,
                outcome: MoonOutcome::NotFound { code: 1 },
            }),
            Message::StartTracking,
            Message::StopTracking,
            Message::TrackingOff,
        ]
    }

    #[test]
    fn all_messages_of_a_payload_are_read_in_order_and_padding_is_none() {
        let messages = every_message();
        let mut payload: Vec<u8> = messages.iter().flat_map(|m| m.payload().unwrap()).collect();
        for padding in 0..5 {
            let mut read = Messages::of(&payload);
            let found: Vec<Message> = read.by_ref().map(|(_, m)| m.unwrap()).collect();
            assert_eq!(found, messages);
            assert_eq!((read.rest().len(), read.not_understood()), (padding, 0));
            payload.push(0);
        }
    }

    #[test]
    fn a_message_that_cannot_be_read_leaves_those_before_it_and_says_where_the_reading_ends() {
        let stop = Message::StopTracking.payload().unwrap();
        let nan = [&[0x0A, 0][..], &f32::NAN.to_le_bytes(), &[0; 4]].concat();
        for (bytes, errors, read_on, not_understood) in [
            (&[0x34, 0x12, 5][..], 1, false, 5),
            (&[0xFF, 0x10, 0x1F, 0x14, 1, 0], 1, false, 8),
            (&nan, 1, true, 0),
            (&[], 0, true, 0),
            (&[0, 0, 7], 0, false, 5),
        ] {
            let payload = [&stop[..], bytes, &stop].concat();
            let mut read = Messages::of(&payload);
            let found: Vec<_> = read.by_ref().map(|(_, message)| message).collect();
            assert_eq!(found[0], Ok(Message::StopTracking));
            assert_eq!(found.iter().filter(|m| m.is_err()).count(), errors);
            assert_eq!(
                found.last() == Some(&Ok(Message::StopTracking)),
                read_on || errors == 0
            );
            assert_eq!(read.not_understood(), not_understood, "{bytes:02x?}");
        }
    }

    #[test]
    fn a_payload_without_a_message_is_an_error() {
        for payload in [&[][..], &[0], &[0, 0]] {
            let mut read = Messages::of(payload);
            assert!(matches!(read.next(), Some((_, Err(_)))));
            assert!(read.next().is_none());
        }
    }
}
