//! The fields of a payload. A table of them (the macro `fields`) makes the struct, its codec, and its description; each error names its message and
//! what was expected.

use super::number::{Codes, Field, Number};
use super::packet::PacketError;
use jiff::{SignedDuration, Timestamp};

/// A row of a table for a field: see [`Field`].
pub struct Said {
    pub name: &'static str,
    pub unit: &'static str,
    pub documentation: &'static str,
    pub codes: Option<&'static Codes>,
    pub range: Option<(f64, f64)>,
}

impl Said {
    fn field(&self, number: Number) -> Field {
        Field {
            name: self.name,
            number,
            count: 1,
            unit: self.unit,
            documentation: self.documentation,
            codes: self.codes,
            range: self.range,
        }
    }
}

/// Encoding of a value as one number or several.
pub trait Wire<T = Self> {
    /// Length of the encoded value.
    const BYTES: usize;

    /// Its fields, one for each number, described by the rows.
    fn fields(said: &[Said]) -> Vec<Field>;

    /// Reads the value; `field` is its name in errors.
    fn read(input: &mut Reader, field: &'static str) -> Result<T, MessageError>;

    fn write(value: &T, out: &mut Writer, field: &'static str) -> Result<(), MessageError>;
}

macro_rules! whole {
    ($($type:ty, $number:ident);*) => {$(
        impl Wire for $type {
            const BYTES: usize = size_of::<$type>();

            fn fields(said: &[Said]) -> Vec<Field> {
                said.iter().map(|said| said.field(Number::$number)).collect()
            }

            fn read(input: &mut Reader, _: &'static str) -> Result<Self, MessageError> {
                input.take().map(Self::from_le_bytes)
            }

            fn write(value: &Self, out: &mut Writer, _: &'static str) -> Result<(), MessageError> {
                out.bytes.extend(value.to_le_bytes());
                Ok(())
            }
        }
    )*};
}

whole!(u16, U16; i16, I16; u32, U32);

macro_rules! real {
    ($($type:ty, $number:ident);*) => {$(
        impl Wire for $type {
            const BYTES: usize = size_of::<$type>();

            fn fields(said: &[Said]) -> Vec<Field> {
                said.iter().map(|said| said.field(Number::$number)).collect()
            }

            fn read(input: &mut Reader, field: &'static str) -> Result<Self, MessageError> {
                let value = Self::from_le_bytes(input.take()?);
                finite(input.key, field, value.into()).map(|()| value)
            }

            fn write(value: &Self, out: &mut Writer, field: &'static str) -> Result<(), MessageError> {
                finite(out.key, field, (*value).into())?;
                out.bytes.extend(value.to_le_bytes());
                Ok(())
            }
        }
    )*};
}

real!(f32, F32; f64, F64);

impl<T: Wire> Wire for [T; 3] {
    const BYTES: usize = 3 * T::BYTES;

    fn fields(said: &[Said]) -> Vec<Field> {
        T::fields(said)
    }

    fn read(input: &mut Reader, field: &'static str) -> Result<Self, MessageError> {
        Ok([
            T::read(input, field)?,
            T::read(input, field)?,
            T::read(input, field)?,
        ])
    }

    fn write(value: &Self, out: &mut Writer, field: &'static str) -> Result<(), MessageError> {
        value.iter().try_for_each(|one| T::write(one, out, field))
    }
}

/// Pairs of numbers, one after the other: one field of the table, which counts them all.
impl<const N: usize> Wire for [[i16; 2]; N] {
    const BYTES: usize = 2 * N * i16::BYTES;

    fn fields(said: &[Said]) -> Vec<Field> {
        let fields = i16::fields(said).into_iter();
        let count = 2 * N;
        fields.map(|field| Field { count, ..field }).collect()
    }

    fn read(input: &mut Reader, field: &'static str) -> Result<Self, MessageError> {
        let mut pairs = [[0; 2]; N];
        for number in pairs.as_flattened_mut() {
            *number = i16::read(input, field)?;
        }
        Ok(pairs)
    }

    fn write(pairs: &Self, out: &mut Writer, field: &'static str) -> Result<(), MessageError> {
        let mut numbers = pairs.as_flattened().iter();
        numbers.try_for_each(|number| i16::write(number, out, field))
    }
}

/// Seconds and milliseconds since 1970. The whole time is rounded, so that .9996 s becomes 0 ms of the next second.
pub struct Milliseconds;

impl Wire<Timestamp> for Milliseconds {
    const BYTES: usize = 6;

    fn fields(said: &[Said]) -> Vec<Field> {
        let numbers = [Number::U32, Number::U16];
        let parts = said.iter().zip(numbers);
        parts.map(|(said, number)| said.field(number)).collect()
    }

    /// Accepts up to 1000 ms: the flight program of 2013 rounded without carrying.
    fn read(input: &mut Reader, field: &'static str) -> Result<Timestamp, MessageError> {
        let seconds = u32::from_le_bytes(input.take()?);
        let milliseconds = u16::read(input, field)?;
        let refused = || MessageError::Time {
            key: input.key,
            found: format!("{seconds} s {milliseconds} ms"),
        };
        let millisecond = i64::from(seconds) * 1000 + i64::from(milliseconds);
        match milliseconds {
            0..=1000 => Timestamp::from_millisecond(millisecond).map_err(|_| refused()),
            _ => Err(refused()),
        }
    }

    fn write(time: &Timestamp, out: &mut Writer, field: &'static str) -> Result<(), MessageError> {
        let (seconds, nanoseconds) = unix_time(out.key, *time)?;
        let milliseconds = (nanoseconds + 500_000) / 1_000_000;
        let carried = seconds.checked_add(milliseconds / 1000);
        let seconds = carried.ok_or_else(|| MessageError::Time {
            key: out.key,
            found: time.to_string(),
        })?;
        out.bytes.extend(seconds.to_le_bytes());
        u16::write(&((milliseconds % 1000) as u16), out, field)
    }
}

/// Seconds since 1970 as one number.
pub struct Seconds;

impl Wire<Timestamp> for Seconds {
    const BYTES: usize = f64::BYTES;

    fn fields(said: &[Said]) -> Vec<Field> {
        f64::fields(said)
    }

    fn read(input: &mut Reader, field: &'static str) -> Result<Timestamp, MessageError> {
        let time = f64::read(input, field)?;
        let refused = || MessageError::Time {
            key: input.key,
            found: format!("{time} s"),
        };
        if !(0.0..=f64::from(u32::MAX)).contains(&time) {
            return Err(refused());
        }
        // Rounded on their own, the nanoseconds may make a whole second.
        let nanoseconds = (time.fract() * 1e9).round() as i64;
        let seconds = Timestamp::from_second(time as i64).map_err(|_| refused())?;
        seconds
            .checked_add(SignedDuration::from_nanos(nanoseconds))
            .map_err(|_| refused())
    }

    fn write(time: &Timestamp, out: &mut Writer, field: &'static str) -> Result<(), MessageError> {
        let (seconds, nanoseconds) = unix_time(out.key, *time)?;
        f64::write(
            &(f64::from(seconds) + f64::from(nanoseconds) / 1e9),
            out,
            field,
        )
    }
}

/// The codec of a field: its own type, or the type that is named.
macro_rules! codec {
    ($type:ty) => {
        $type
    };
    ($type:ty, $codec:ty) => {
        $codec
    };
}

/// Payloads, each a struct with a row for each field: the name, the type (`as` another codec than its own), the unit and the description; then,
/// if it has any, its [`Codes`] (`=> CODES`) or the range for a person's input (`in low, high`). A value of several numbers has a row for each
/// in brackets; a payload within another has none. The sentence of a payload gives it in words, with its fields by name.
macro_rules! fields {
    ($(
        $(#[$about:meta])*
        $name:ident, $words:expr => {$(
            $(#[$note:meta])*
            $field:ident: $type:ty $(as $codec:ty)?
                $(, $unit:literal, $documentation:literal $(=> $codes:ident)? $(in $low:literal, $high:literal)?)?
                $([$($part:literal, $part_unit:literal, $part_documentation:literal;)*])?;
        )*}
    )*) => {$(
        $(#[$about])*
        #[derive(Debug, Clone, Copy, PartialEq)]
        pub struct $name {$(
            $(#[doc = $documentation])?
            $(#[$note])*
            pub $field: $type,
        )*}

        impl $crate::link::fields::Wire for $name {
            const BYTES: usize = 0 $(+ <$crate::link::fields::codec!($type $(, $codec)?) as $crate::link::fields::Wire<$type>>::BYTES)*;

            fn fields(_: &[$crate::link::fields::Said]) -> Vec<$crate::link::number::Field> {
                let fields = [$(
                    <$crate::link::fields::codec!($type $(, $codec)?) as $crate::link::fields::Wire<$type>>::fields(&[
                        $($crate::link::fields::Said {
                            name: stringify!($field),
                            unit: $unit,
                            documentation: $documentation,
                            codes: None $(.or(Some(&$codes)))?,
                            range: None $(.or(Some(($low, $high))))?,
                        })?
                        $($($crate::link::fields::Said {
                            name: $part,
                            unit: $part_unit,
                            documentation: $part_documentation,
                            codes: None,
                            range: None,
                        }),*)?
                    ]),
                )*];
                fields.concat()
            }

            fn read(input: &mut $crate::link::fields::Reader, _: &'static str) -> Result<Self, $crate::link::fields::MessageError> {
                Ok(Self {$(
                    $field: <$crate::link::fields::codec!($type $(, $codec)?) as $crate::link::fields::Wire<$type>>::read(input, stringify!($field))?,
                )*})
            }

            fn write(value: &Self, out: &mut $crate::link::fields::Writer, _: &'static str) -> Result<(), $crate::link::fields::MessageError> {
                $(<$crate::link::fields::codec!($type $(, $codec)?) as $crate::link::fields::Wire<$type>>::write(&value.$field, out, stringify!($field))?;)*
                Ok(())
            }
        }

        impl $name {
            /// The payload in words.
            #[allow(unused_variables, reason = "a sentence may leave a field out")]
            pub fn words(&self) -> String {
                let Self { $($field),* } = self;
                $words
            }
        }
    )*};
}

pub(super) use {codec, fields};

/// Reason why a message cannot be read or written.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum MessageError {
    #[error("message: expected a key of 2 bytes, found {found} bytes")]
    NoKey { found: usize },
    #[error("message: expected a known key, found {key:#06x}")]
    UnknownKey { key: u16 },
    #[error("message {key:#06x}: expected {expected} bytes, found {found}")]
    Short {
        key: u16,
        expected: usize,
        found: usize,
    },
    #[error("message {key:#06x}, {field}: expected a finite number, found {found}")]
    NotFinite {
        key: u16,
        field: &'static str,
        found: f64,
    },
    #[error("message {key:#06x}, time: expected a time from 1970 to 2106, found {found}")]
    Time { key: u16, found: String },
    #[error("aspect command {key:#06x}: expected {expected} variables, found {found}")]
    Variables {
        key: u16,
        expected: usize,
        found: usize,
    },
    #[error("telemetry: expected type 01 (receipt) or e1 (result), found {kind:02x}")]
    UnknownTelemetry { kind: u8 },
    #[error(transparent)]
    Packet(#[from] PacketError),
}

/// Seconds and nanoseconds since 1970, if they fit 32 bits.
pub fn unix_time(key: u16, time: Timestamp) -> Result<(u32, u32), MessageError> {
    let found = || MessageError::Time {
        key,
        found: time.to_string(),
    };
    let seconds = u32::try_from(time.as_second()).map_err(|_| found())?;
    let nanoseconds = u32::try_from(time.subsec_nanosecond()).map_err(|_| found())?;
    Ok((seconds, nanoseconds))
}

/// Writes a message's key and fields.
pub struct Writer {
    key: u16,
    bytes: Vec<u8>,
}

impl Writer {
    pub fn new(key: u16) -> Self {
        let bytes = key.to_le_bytes().to_vec();
        Self { key, bytes }
    }

    /// Writes fields without a key; the key is only for errors.
    pub fn after_key(key: u16) -> Self {
        Self {
            key,
            bytes: Vec::new(),
        }
    }

    pub fn finish(self) -> Vec<u8> {
        self.bytes
    }
}

/// Reads a message's fields in order.
pub struct Reader<'a> {
    key: u16,
    rest: &'a [u8],
}

impl<'a> Reader<'a> {
    pub fn new(payload: &'a [u8]) -> Result<Self, MessageError> {
        let (key, rest) = payload.split_first_chunk().ok_or(MessageError::NoKey {
            found: payload.len(),
        })?;
        Ok(Self::after_key(u16::from_le_bytes(*key), rest))
    }

    /// Reads the rest after a key that has already been read.
    pub fn after_key(key: u16, rest: &'a [u8]) -> Self {
        Self { key, rest }
    }

    pub fn key(&self) -> u16 {
        self.key
    }

    fn take<const N: usize>(&mut self) -> Result<[u8; N], MessageError> {
        let (bytes, rest) = self.rest.split_first_chunk().ok_or(MessageError::Short {
            key: self.key,
            expected: N,
            found: self.rest.len(),
        })?;
        self.rest = rest;
        Ok(*bytes)
    }

    /// The rest, as 16-bit numbers; a last single byte is dropped.
    pub fn words(&self) -> impl Iterator<Item = u16> {
        let pairs = self.rest.chunks_exact(2);
        pairs.map(|pair| u16::from_le_bytes([pair[0], pair[1]]))
    }
}

fn finite(key: u16, field: &'static str, found: f64) -> Result<(), MessageError> {
    if found.is_finite() {
        Ok(())
    } else {
        Err(MessageError::NotFinite { key, field, found })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::link::message::key;
    use crate::link::{ExposureStart, Message, Solution};

    fn solution_at(time: &str) -> Solution {
        Solution {
            azimuth_deg: 0.0,
            elevation_deg: 0.0,
            roll_deg: 0.0,
            error_deg: 0.0,
            time: time.parse().unwrap(),
        }
    }

    fn read_back(message: Message) -> Message {
        let packet = message.packet(1, 1).unwrap();
        Message::decode(packet.payload()).unwrap()
    }

    #[test]
    fn the_last_half_millisecond_of_a_second_belongs_to_the_next() {
        let sent = solution_at("2013-09-21T17:59:59.9996Z");
        let expected = solution_at("2013-09-21T18:00:00Z");
        assert_eq!(
            read_back(Message::Solution(sent)),
            Message::Solution(expected)
        );
    }

    #[test]
    fn a_thousand_milliseconds_are_a_second_and_more_are_refused() {
        let sent = Message::Solution(solution_at("2013-09-21T18:00:00Z"));
        let mut payload = sent.packet(1, 1).unwrap().payload().to_vec();
        let at = payload.len() - 2;
        payload[at..].copy_from_slice(&1000_u16.to_le_bytes());
        let expected = solution_at("2013-09-21T18:00:01Z");
        assert_eq!(Message::decode(&payload), Ok(Message::Solution(expected)));
        payload[at..].copy_from_slice(&1001_u16.to_le_bytes());
        assert!(matches!(
            Message::decode(&payload),
            Err(MessageError::Time { .. })
        ));
    }

    #[test]
    fn numbers_that_are_not_finite_and_times_beyond_32_bits_are_neither_sent_nor_read() {
        let not_finite = Solution {
            azimuth_deg: f64::NAN,
            ..solution_at("2013-09-21T18:00:00Z")
        };
        let refused = Message::Solution(not_finite).packet(1, 1);
        assert!(matches!(
            refused,
            Err(MessageError::NotFinite {
                field: "azimuth_deg",
                ..
            })
        ));
        for time in [
            "1969-12-31T23:59:59Z",
            "2106-02-07T06:28:15.9999Z",
            "2107-01-01T00:00:00Z",
        ] {
            assert!(
                Message::Solution(solution_at(time)).packet(1, 1).is_err(),
                "{time}"
            );
        }
        let exposure = |time: f64| {
            let mut payload = key::EXPOSURE_START.to_le_bytes().to_vec();
            payload.extend([1, 0]);
            payload.extend(time.to_le_bytes());
            Message::decode(&payload)
        };
        assert!(exposure(1e9).is_ok());
        for time in [f64::NAN, f64::INFINITY, -1.0, 1e30] {
            assert!(exposure(time).is_err(), "{time}");
        }
    }

    #[test]
    fn an_exposure_keeps_its_time_to_a_microsecond() {
        for time in [
            "2013-09-21T18:00:00.123456Z",
            "2026-07-01T00:00:00.999999999Z",
        ] {
            let sent = ExposureStart {
                camera: 1,
                time: time.parse().unwrap(),
            };
            let Message::ExposureStart(read) = read_back(Message::ExposureStart(sent)) else {
                panic!("another message came back");
            };
            assert!(read.time.duration_since(sent.time).abs() < SignedDuration::from_micros(1));
        }
    }

    #[test]
    fn bytes_that_pad_a_message_are_ignored_and_bytes_that_lack_are_reported() {
        let payload = [0x0A, 0, 0, 0, 0x0A, 0x42, 0, 0, 0xC8, 0x41];
        for length in 0..payload.len() {
            assert!(
                Message::decode(&payload[..length]).is_err(),
                "{length} bytes"
            );
        }
        let padded = [&payload[..], &[0; 3]].concat();
        assert_eq!(Message::decode(&payload), Message::decode(&padded));
    }
}
