//! Parsing of NMEA 0183 sentences in a byte stream: their limits, their checksum, and the fields of those that describe a
//! fix.

use std::str::FromStr;

/// A sentence has at most 82 characters; some receivers exceed that.
const LONGEST: usize = 200;
/// A sentence's address, such as `GPGGA` or `PUBX`.
const ADDRESS: std::ops::RangeInclusive<usize> = 3..=8;
const DAY_S: f64 = 86_400.0;

/// Why a sentence cannot be read.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Unreadable {
    #[error("expected a checksum, found the sentence's end: \"{0}\"")]
    NoChecksum(String),
    #[error("expected the checksum {expected:02X}, found \"{found}\": \"{text}\"")]
    Checksum {
        expected: u8,
        found: String,
        text: String,
    },
    #[error("expected at most {LONGEST} characters, found more: \"{0}\"")]
    TooLong(String),
    #[error("expected printable characters up to the checksum, found a binary byte: \"{0}\"")]
    Binary(String),
    #[error("{field}: expected {expected}, found \"{found}\"")]
    Field {
        field: &'static str,
        expected: &'static str,
        found: String,
    },
}

/// Result of processing a byte.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Piece {
    /// The characters between `$` and `*`, with a valid checksum.
    Sentence(String),
    Unreadable(Unreadable),
}

/// Splits bytes into sentences. A sentence begins at any `$` and ends with its checksum; anything after the checksum is
/// ignored.
#[derive(Debug, Default)]
pub(super) struct Framer {
    /// Bytes since `$`; `None` between sentences.
    line: Option<String>,
    /// Bytes outside any sentence, except line ends and blanks.
    noise_bytes: u64,
}

impl Framer {
    pub fn noise_bytes(&self) -> u64 {
        self.noise_bytes
    }

    pub fn push(&mut self, byte: u8) -> Option<Piece> {
        if byte == b'$' {
            return self.line.replace(String::new()).and_then(|line| {
                // Truncated by the next sentence.
                self.broken(line, Unreadable::NoChecksum)
            });
        }
        let Some(line) = &mut self.line else {
            self.noise_bytes += u64::from(!byte.is_ascii_whitespace());
            return None;
        };
        if byte == b'\r' || byte == b'\n' {
            let line = self.line.take()?;
            return self.broken(line, Unreadable::NoChecksum);
        }
        if !(b' '..=b'~').contains(&byte) {
            self.noise_bytes += 1;
            let line = self.line.take()?;
            return self.broken(line, Unreadable::Binary);
        }
        line.push(byte.into());
        if line.len() > LONGEST {
            let line = self.line.take()?;
            return self.broken(line, Unreadable::TooLong);
        }
        // `*` and two digits.
        let star = line.find('*')?;
        if line.len() < star + 3 {
            return None;
        }
        let line = self.line.take()?;
        Some(checked(&line, star))
    }

    /// A sentence without a valid end. Text without an address is not a sentence: binary messages contain `$` as well.
    fn broken(&mut self, line: String, why: fn(String) -> Unreadable) -> Option<Piece> {
        match line.find(',') {
            Some(at) if ADDRESS.contains(&at) && is_address(&line[..at]) => {
                Some(Piece::Unreadable(why(line)))
            }
            _ => {
                self.noise_bytes += 1 + line.len() as u64;
                None
            }
        }
    }
}

fn is_address(text: &str) -> bool {
    text.bytes()
        .all(|byte| byte.is_ascii_uppercase() || byte.is_ascii_digit())
}

/// A sentence built from the characters between `$` and `*`, with its checksum and line end.
pub fn summed(text: &str) -> String {
    format!("${text}*{:02X}\r\n", checksum(text))
}

fn checksum(text: &str) -> u8 {
    text.bytes().fold(0, |sum, byte| sum ^ byte)
}

fn checked(line: &str, star: usize) -> Piece {
    let (text, found) = (&line[..star], &line[star + 1..]);
    let expected = checksum(text);
    match u8::from_str_radix(found, 16) {
        Ok(sum) if sum == expected => Piece::Sentence(text.into()),
        _ => Piece::Unreadable(Unreadable::Checksum {
            expected,
            found: found.into(),
            text: text.into(),
        }),
    }
}

/// A sentence that describes a fix.
#[derive(Debug, Clone, PartialEq)]
pub(super) enum Sentence {
    Gga(Gga),
    Rmc(Rmc),
    Zda(Zda),
    /// Any other kind.
    Other,
}

/// Position and height. A field left empty by the receiver is `None`.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Gga {
    pub time: Option<TimeOfDay>,
    /// Latitude and longitude, deg, north and east positive.
    pub at_deg: Option<[f64; 2]>,
    /// Quality of the fix: '0' is no fix.
    pub quality: Option<char>,
    /// Height above mean sea level, and that of mean sea level above the ellipsoid.
    pub altitude_m: Option<f64>,
    pub geoid_m: Option<f64>,
}

/// Date and velocity.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Rmc {
    pub time: Option<TimeOfDay>,
    /// 'V' means no fix.
    pub status: Option<char>,
    pub speed_knots: Option<f64>,
    pub course_deg: Option<f64>,
    pub date: Option<jiff::civil::Date>,
    /// Mode of the fix, from NMEA 2.3 on.
    pub mode: Option<char>,
}

/// Date.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Zda {
    pub time: Option<TimeOfDay>,
    pub date: Option<jiff::civil::Date>,
}

/// Microseconds since midnight, UTC. Second 60 counts as the first second of the next minute: Unix time cannot represent a
/// leap second, and some receivers round 59.999 up to 60.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct TimeOfDay {
    pub micros: i64,
}

impl Sentence {
    /// Parses the characters between `$` and `*`. Any two letters may name the talker: GP, GN, GL, GA, GB.
    ///
    /// # Errors
    /// The first non-empty field that cannot be parsed.
    pub fn parse(text: &str) -> Result<Self, Unreadable> {
        let (address, rest) = text.split_once(',').unwrap_or((text, ""));
        let fields = Fields(rest.split(',').map(str::trim).collect());
        // Proprietary sentences begin with P, and have no talker.
        let kind = address.get(2..).filter(|_| !address.starts_with('P'));
        Ok(match kind {
            Some("GGA") => Self::Gga(Gga {
                time: fields.time(0)?,
                at_deg: fields.place(1)?,
                quality: fields.letter(5),
                altitude_m: fields.number(8, "altitude")?,
                geoid_m: fields.number(10, "geoid separation")?,
            }),
            Some("RMC") => Self::Rmc(Rmc {
                time: fields.time(0)?,
                status: fields.letter(1),
                speed_knots: fields.number(6, "speed")?,
                course_deg: fields.number(7, "course")?,
                date: fields.short_date(8)?,
                mode: fields.letter(11),
            }),
            Some("ZDA") => Self::Zda(Zda {
                time: fields.time(0)?,
                date: fields.long_date(1)?,
            }),
            _ => Self::Other,
        })
    }
}

/// The fields after the address.
struct Fields<'a>(Vec<&'a str>);

impl Fields<'_> {
    /// A field's text; `None` if it is empty or missing.
    fn text(&self, n: usize) -> Option<&str> {
        self.0.get(n).copied().filter(|text| !text.is_empty())
    }

    fn letter(&self, n: usize) -> Option<char> {
        self.text(n)?.chars().next()
    }

    fn number(&self, n: usize, field: &'static str) -> Result<Option<f64>, Unreadable> {
        let Some(text) = self.text(n) else {
            return Ok(None);
        };
        let number = plain_number(text);
        number.map(Some).ok_or_else(|| Unreadable::Field {
            field,
            expected: "a number",
            found: text.into(),
        })
    }

    /// `hhmmss`, with or without a fraction.
    fn time(&self, n: usize) -> Result<Option<TimeOfDay>, Unreadable> {
        let Some(text) = self.text(n) else {
            return Ok(None);
        };
        let time = time_of_day(text);
        time.map(Some).ok_or_else(|| Unreadable::Field {
            field: "time",
            expected: "hhmmss.ss",
            found: text.into(),
        })
    }

    /// Four fields: `ddmm.mm`, N or S, `dddmm.mm`, E or W.
    fn place(&self, first: usize) -> Result<Option<[f64; 2]>, Unreadable> {
        let mut at_deg = [0.0; 2];
        for (axis, names) in [["N", "S"], ["E", "W"]].into_iter().enumerate() {
            let n = first + 2 * axis;
            let (Some(text), Some(side)) = (self.text(n), self.text(n + 1)) else {
                return Ok(None);
            };
            let sign = names.iter().position(|name| *name == side);
            let signed = sign.map(|at| if at == 0 { 1.0 } else { -1.0 });
            let angle = signed.zip(degrees(text));
            let (sign, angle_deg) = angle.ok_or_else(|| Unreadable::Field {
                field: ["latitude", "longitude"][axis],
                expected: "degrees and minutes below 60, and N, S, E or W",
                found: format!("{text},{side}"),
            })?;
            at_deg[axis] = sign * angle_deg;
        }
        Ok(Some(at_deg))
    }

    /// `ddmmyy`: GPS began in 1980.
    fn short_date(&self, n: usize) -> Result<Option<jiff::civil::Date>, Unreadable> {
        let Some(text) = self.text(n) else {
            return Ok(None);
        };
        let date = || {
            let part = |at: usize| whole(text.get(at..at + 2)?);
            let year: i16 = part(4)?;
            let century = if year < 80 { 2000 } else { 1900 };
            let day = (text.len() == 6).then(|| part(0)).flatten()?;
            jiff::civil::Date::new(century + year, part(2)? as i8, day as i8).ok()
        };
        date().map(Some).ok_or_else(|| Unreadable::Field {
            field: "date",
            expected: "ddmmyy",
            found: text.into(),
        })
    }

    /// Three fields: day, month and year.
    fn long_date(&self, first: usize) -> Result<Option<jiff::civil::Date>, Unreadable> {
        let [day, month, year] = [0, 1, 2].map(|n| self.text(first + n));
        let (Some(day), Some(month), Some(year)) = (day, month, year) else {
            return Ok(None);
        };
        let date = || jiff::civil::Date::new(whole(year)?, whole(month)?, whole(day)?).ok();
        date().map(Some).ok_or_else(|| Unreadable::Field {
            field: "date",
            expected: "day, month and year",
            found: format!("{day},{month},{year}"),
        })
    }
}

/// A number without infinities, exponents and the like.
fn plain_number(text: &str) -> Option<f64> {
    let is_plain = |byte: u8| byte.is_ascii_digit() || b"+-.".contains(&byte);
    let number: f64 = text.bytes().all(is_plain).then(|| text.parse().ok())??;
    number.is_finite().then_some(number)
}

fn whole<T: FromStr>(digits: &str) -> Option<T> {
    let all = digits.bytes().all(|byte| byte.is_ascii_digit());
    all.then(|| digits.parse().ok()).flatten()
}

fn time_of_day(text: &str) -> Option<TimeOfDay> {
    let part = |at: usize| whole::<u32>(text.get(at..at + 2)?);
    let (hours, minutes) = (part(0)?, part(2)?);
    let _whole_seconds = part(4)?;
    let seconds = plain_number(text.get(4..)?)?;
    let is_time = hours < 24 && minutes < 60 && (0.0..61.0).contains(&seconds);
    let since_s = f64::from(3600 * hours + 60 * minutes) + seconds;
    // Second 60 of the day's last minute belongs to the next day.
    debug_assert!(!is_time || since_s < DAY_S + 1.0);
    is_time.then(|| TimeOfDay {
        micros: (since_s * 1e6).round() as i64,
    })
}

/// Degrees and minutes from one number, whose last two digits before the point are the minutes.
fn degrees(text: &str) -> Option<f64> {
    let point = text.find('.').unwrap_or(text.len());
    let (degrees, minutes) = text.split_at_checked(point.checked_sub(2)?)?;
    let degrees: u16 = whole(degrees)?;
    let _two_digits: u16 = whole(minutes.get(..2)?)?;
    let minutes = plain_number(minutes).filter(|minutes| *minutes < 60.0)?;
    Some(f64::from(degrees) + minutes / 60.0)
}
