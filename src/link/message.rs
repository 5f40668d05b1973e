//! What packets say: the messages of the control loop, the ground's commands, and our answers.
//!
//! A payload holds one message or several, one after the other ([`Messages`]). A message begins with a key (u16) that
//! names it; the rest is fixed by the key. A key of zero, or a rest too short for a key, ends the reading, so that a
//! sender that pads its packets is understood.

pub use super::fields::MessageError;
pub use super::layout::key;

use super::fields::{Reader, Writer, unix_time};
use super::layout::message_of;
use super::moon::{MoonAnswer, MoonRequest};
use super::packet::{CommandPacket, TelemetryPacket, id, telemetry_type};
use jiff::Timestamp;

/// Error code of a frame whose Sun was found but whose time or place is not known.
pub const NO_OFFSET: u16 = 100;

/// What the controller is told of a frame without a solution: 1 to 7 for the stage that it did not pass. Code, name, meaning.
#[rustfmt::skip] // One row, one line.
pub const ERROR_CODES: &[(u16, &str, &str)] = &[
    (1, "levels", "levels: no disc stands out of the background"),
    (2, "limb", "limb: no disc was found"),
    (3, "marks", "marks: too few were seen"),
    (4, "identification", "identification: the marks could not be told apart"),
    (5, "registration", "registration: no mapping fits the marks"),
    (6, "aspect", "aspect: the Sun's place on the plate is not known"),
    (7, "pointing", "pointing: the target cannot be pointed at from here"),
    (NO_OFFSET, "no_offset", "the Sun was found, but time or place of the frame is not known"),
];

/// The camera's number in an exposure packet: 1, whichever computer sends it.
pub const CAMERA: u16 = 1;

/// Where the telescope points, minus the target, at the start of an exposure.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Solution {
    /// Plain difference of azimuths, deg.
    pub azimuth_deg: f64,
    pub elevation_deg: f64,
    pub roll_deg: f64,
    /// 1 sigma per axis of true angle, deg.
    pub error_deg: f64,
    /// The time its exposure packet announced; sent to the nearest millisecond.
    pub time: Timestamp,
}

impl Solution {
    fn write(&self, out: &mut Writer) -> Result<(), MessageError> {
        out.f64("azimuth", self.azimuth_deg)?;
        out.f64("elevation", self.elevation_deg)?;
        out.f64("roll", self.roll_deg)?;
        out.f64("error", self.error_deg)?;
        out.time_to_millisecond(self.time)
    }

    fn read(input: &mut Reader) -> Result<Self, MessageError> {
        Ok(Self {
            azimuth_deg: input.f64("azimuth")?,
            elevation_deg: input.f64("elevation")?,
            roll_deg: input.f64("roll")?,
            error_deg: input.f64("error")?,
            time: input.time_to_millisecond()?,
        })
    }
}

/// Where the telescope points, minus the target, by the gyros since a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Propagated {
    /// Its time is that of the attitude.
    pub solution: Solution,
    /// Of the last frame that the attitude rests on; 65535 stands for more.
    pub age_ms: u16,
}

/// An exposure is about to start.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ExposureStart {
    pub camera: u16,
    pub time: Timestamp,
}

/// The gondola's place, as the ground sends it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct GpsFix {
    pub latitude_deg: f32,
    /// East positive.
    pub longitude_deg: f32,
}

/// A command of the ground to the aspect system, as it travels: a key and as many variables as its low 4 bits say.
/// Its top 4 bits name the computers it is for; [`Command`](super::Command) is what it means.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct AspectCommand {
    key: u16,
    variables: Vec<u16>,
}

impl AspectCommand {
    /// A command whose number of variables is the one its key states.
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

    fn read(input: &mut Reader) -> Result<Self, MessageError> {
        let key = input.u16()?;
        let variables = input.words().take(variable_count(key)).collect();
        Self::new(key, variables)
    }

    /// The key with the computers' bits.
    pub fn key(&self) -> u16 {
        self.key
    }

    pub fn variables(&self) -> &[u16] {
        &self.variables
    }
}

/// A message in a command packet.
#[derive(Debug, Clone, PartialEq)]
pub enum Message {
    // From us to the controller.
    TrackingOn,
    TrackingOff,
    Solution(Solution),
    /// No solution for an announced exposure, with the reason's number.
    Error {
        code: u16,
    },
    ExposureStart(ExposureStart),
    Propagated(Propagated),
    Moon(MoonAnswer),
    // To us, from the controller or the ground.
    StartTracking,
    StopTracking,
    Gps(GpsFix),
    MoonRequest(MoonRequest),
    Aspect(AspectCommand),
}

impl Message {
    pub fn key(&self) -> u16 {
        match self {
            Self::TrackingOn => key::TRACKING_ON,
            Self::TrackingOff => key::TRACKING_OFF,
            Self::Solution(_) => key::SOLUTION,
            Self::Error { .. } => key::ERROR,
            Self::ExposureStart(_) => key::EXPOSURE_START,
            Self::Propagated(_) => key::PROPAGATED,
            Self::StartTracking => key::START_TRACKING,
            Self::StopTracking => key::STOP_TRACKING,
            Self::Gps(_) => key::GPS,
            Self::MoonRequest(_) => key::MOON_REQUEST,
            Self::Moon(answer) => answer.sight.key(),
            Self::Aspect(_) => key::ASPECT_COMMAND,
        }
    }

    /// The message as a packet. Numbers that are not finite and times that do not fit are refused.
    pub fn packet(&self, target: u8, sequence: u16) -> Result<CommandPacket, MessageError> {
        Ok(CommandPacket::new(target, sequence, self.payload()?)?)
    }

    fn payload(&self) -> Result<Vec<u8>, MessageError> {
        let mut out = Writer::new(self.key());
        match self {
            Self::TrackingOn | Self::TrackingOff | Self::StartTracking | Self::StopTracking => {}
            Self::Solution(solution) => solution.write(&mut out)?,
            Self::Propagated(propagated) => {
                propagated.solution.write(&mut out)?;
                out.u16(propagated.age_ms);
            }
            Self::Error { code } => out.u16(*code),
            Self::ExposureStart(exposure) => {
                out.u16(exposure.camera);
                let (seconds, nanoseconds) = unix_time(key::EXPOSURE_START, exposure.time)?;
                out.f64("time", f64::from(seconds) + f64::from(nanoseconds) / 1e9)?;
            }
            Self::Gps(fix) => {
                out.f32("latitude", fix.latitude_deg)?;
                out.f32("longitude", fix.longitude_deg)?;
            }
            Self::MoonRequest(request) => request.write(&mut out)?,
            Self::Moon(answer) => answer.write(&mut out)?,
            Self::Aspect(command) => {
                out.u16(command.key);
                command.variables.iter().for_each(|&v| out.u16(v));
            }
        }
        Ok(out.finish())
    }

    /// Reads the first message of a command packet's payload.
    pub fn decode(payload: &[u8]) -> Result<Self, MessageError> {
        let mut input = Reader::new(payload)?;
        Ok(match input.key() {
            key::TRACKING_ON => Self::TrackingOn,
            key::TRACKING_OFF => Self::TrackingOff,
            key::SOLUTION => Self::Solution(Solution::read(&mut input)?),
            key::PROPAGATED => Self::Propagated(Propagated {
                solution: Solution::read(&mut input)?,
                age_ms: input.u16()?,
            }),
            key::ERROR => Self::Error { code: input.u16()? },
            key::EXPOSURE_START => Self::ExposureStart(ExposureStart {
                camera: input.u16()?,
                time: input.time_f64()?,
            }),
            key::START_TRACKING => Self::StartTracking,
            key::STOP_TRACKING => Self::StopTracking,
            key::GPS => Self::Gps(GpsFix {
                latitude_deg: input.f32("latitude")?,
                longitude_deg: input.f32("longitude")?,
            }),
            key::MOON_REQUEST => Self::MoonRequest(MoonRequest::read(&mut input)?),
            key::MOON_FOUND | key::MOON_NOT_VISIBLE | key::MOON_NOT_FOUND => {
                Self::Moon(MoonAnswer::read(&mut input)?)
            }
            key::ASPECT_COMMAND => Self::Aspect(AspectCommand::read(&mut input)?),
            key => return Err(MessageError::UnknownKey { key }),
        })
    }
}

/// The messages of a payload in their order, each with its own bytes.
///
/// A message that cannot be read is an error in its place. Where its key does not tell its length, or the payload is too
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

    /// What has not been read; after the last message, padding or what is not understood.
    pub fn rest(&self) -> &'a [u8] {
        self.rest
    }

    /// How many bytes of the rest are not understood: none of padding with zeros.
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
        // A payload without any message is an error of its first one.
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
    Some(2 + message_of(key)?.bytes() + 2 * variables)
}

fn first_word(bytes: &[u8]) -> Option<u16> {
    bytes.first_chunk().map(|word| u16::from_le_bytes(*word))
}

/// What a telemetry packet of the link says: every command is answered by a receipt and a result.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Telemetry {
    /// The command with this sequence number has arrived.
    Receipt { sequence: u16 },
    /// What came of it: `value` is 0 (done), 1 (not implemented), 0xFFFF (unknown), or what a read has read.
    Result { sequence: u16, key: u16, value: u16 },
}

impl Telemetry {
    /// The answer as a packet made at `time`.
    pub fn packet(&self, time: Timestamp) -> Result<TelemetryPacket, MessageError> {
        let (kind, words) = match *self {
            Self::Receipt { sequence } => (telemetry_type::RECEIPT, vec![sequence]),
            Self::Result {
                sequence,
                key,
                value,
            } => (telemetry_type::RESULT, vec![sequence, key, value]),
        };
        let payload = words.iter().flat_map(|word| word.to_le_bytes()).collect();
        let time = unix_time(kind.into(), time)?;
        Ok(TelemetryPacket::new(kind, id::ASPECT, time, payload)?)
    }

    /// Reads a receipt or a result.
    pub fn decode(packet: &TelemetryPacket) -> Result<Self, MessageError> {
        let kind = packet.kind();
        let mut input = Reader::after_key(kind.into(), packet.payload());
        match kind {
            telemetry_type::RECEIPT => Ok(Self::Receipt {
                sequence: input.u16()?,
            }),
            telemetry_type::RESULT => Ok(Self::Result {
                sequence: input.u16()?,
                key: input.u16()?,
                value: input.u16()?,
            }),
            kind => Err(MessageError::UnknownTelemetry { kind }),
        }
    }
}

/// How many variables an aspect command has: the low 4 bits of its key.
pub fn variable_count(key: u16) -> usize {
    usize::from(key & 0x000F)
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::link::moon::{MoonFix, MoonSight};

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
            Message::Error { code: 8 },
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
            Message::Moon(MoonAnswer {
                request: 9,
                sight: MoonSight::Found(MoonFix {
                    x_px: 359.5,
                    y_px: 288.25,
                    covariance_px2: [1e-3, -2e-4, 4e-3],
                    direction: [0.0, 0.6, 0.8],
                    time,
                }),
            }),
            Message::Moon(MoonAnswer {
                request: 10,
                sight: MoonSight::NotVisible { code: 2 },
            }),
            Message::Moon(MoonAnswer {
                request: 11,
                sight: MoonSight::NotFound { code: 1 },
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
