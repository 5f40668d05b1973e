//! How a frame was taken, from keywords and to keywords.
//!
//! Times are UTC. The middle of the exposure is DATE-AVG; where that is missing, DATE-OBS (or DATE-BEG) plus half
//! the exposure. A file that gives a start and no exposure is taken as a very short one. Files of the HEROES flight of
//! 2013 give the start as RT_SEC and RT_NSEC (s and ns since 1970), or as C's `asctime` writes it, to the second.

use super::header::{Header, Value};
use super::place::{place_cards, read_place};
use super::{Card, Problem};
use crate::clock::ClockStatus;
use crate::frame::{Frame, FrameInfo, PixelSlice};
use jiff::civil::DateTime;
use jiff::tz::TimeZone;
use jiff::{SignedDuration, Timestamp};
use std::time::Duration;

/// The longest exposure or monotonic time that is believed, s: thirty years.
const LONGEST_S: f64 = 1e9;

/// The latest RT_SEC that is believed: the year 9999.
const LONGEST_CLOCK_S: i64 = 253_370_764_800;

/// Reads how a frame was taken.
pub(super) fn read_info(header: &Header) -> Result<FrameInfo, Problem> {
    let exposure = match seconds(header, "EXPTIME")? {
        Some(exposure) => Some(exposure),
        None => seconds(header, "XPOSURE")?,
    };
    let camera = match header.text("CAMERA")? {
        Some(camera) => Some(camera),
        None => header.text("INSTRUME")?,
    };
    let whole = |keyword| match header.get(keyword) {
        Some(_) => header.size(keyword, 0..=i64::MAX).map(Some),
        None => Ok(None),
    };
    Ok(FrameInfo {
        number: whole("FRAMENUM")?,
        mid_exposure: mid_exposure(header, exposure)?,
        monotonic: match seconds(header, "MONOTIME")? {
            Some(monotonic) => Some(monotonic),
            None => heroes_monotonic(header, exposure)?,
        },
        instrument: header.text("OBSRVTRY")?,
        utc_step: step(header)?,
        camera_clock: whole("CAMCLOCK")?.map(Duration::from_nanos),
        exposure,
        analogue_gain: first_number(header, ["GAIN", "GAIN_ANA"])?,
        preamp_gain: first_number(header, ["PREAMP", "GAIN_PRE"])?,
        camera_temperature_c: first_number(header, ["CAMTEMP", "TEMPCCD"])?,
        corner_px: whole("CORNER-X")?
            .zip(whole("CORNER-Y")?)
            .map(|(x, y)| (x as usize, y as usize)),
        place: read_place(header)?,
        camera,
    })
}

/// The first of two keywords that stands there.
fn first_number(header: &Header, keywords: [&str; 2]) -> Result<Option<f64>, Problem> {
    match header.number(keywords[0])? {
        Some(number) => Ok(Some(number)),
        None => header.number(keywords[1]),
    }
}

fn seconds(header: &Header, keyword: &str) -> Result<Option<Duration>, Problem> {
    let Some(seconds) = header.number(keyword)? else {
        return Ok(None);
    };
    if !(0.0..=LONGEST_S).contains(&seconds) {
        let expected = format!("a time from 0 to {LONGEST_S} s");
        return Err(Problem::field(keyword, expected, seconds));
    }
    Ok(Some(Duration::from_secs_f64(seconds)))
}

fn step(header: &Header) -> Result<Option<SignedDuration>, Problem> {
    let Some(seconds) = header.number("UTCSTEP")? else {
        return Ok(None);
    };
    match SignedDuration::try_from_secs_f64(seconds) {
        Ok(step) => Ok(Some(step)),
        Err(_) => Err(Problem::field("UTCSTEP", "a time in seconds", seconds)),
    }
}

fn mid_exposure(header: &Header, exposure: Option<Duration>) -> Result<Option<Timestamp>, Problem> {
    if let Some(middle) = time(header, "DATE-AVG")? {
        return Ok(Some(middle));
    }
    let after = |keyword: &str, start: Timestamp| {
        let half = SignedDuration::try_from(exposure.unwrap_or_default() / 2);
        let middle = half.ok().and_then(|half| start.checked_add(half).ok());
        middle
            .map(Some)
            .ok_or_else(|| Problem::field(keyword, "a time before the year 9999", start))
    };
    if let Some(start) = clock_time(header)? {
        return after("RT_SEC", start);
    }
    for keyword in ["DATE-OBS", "DATE-BEG", "DATE_OBS"] {
        if let Some(start) = time(header, keyword)? {
            return after(keyword, start);
        }
    }
    Ok(None)
}

/// The computer's clock as HEROES wrote it, where no keyword of today's gives the time.
fn clock_time(header: &Header) -> Result<Option<Timestamp>, Problem> {
    let today = ["DATE-OBS", "DATE-BEG"].iter().any(|keyword| {
        let text = header.text(keyword).ok().flatten();
        text.is_some_and(|text| parse_time(&text).is_some())
    });
    if today {
        return Ok(None);
    }
    let clock = heroes_clock(header, ["RT_SEC", "RT_NSEC"], LONGEST_CLOCK_S)?;
    let start = clock.map(|(seconds, nanoseconds)| Timestamp::new(seconds, nanoseconds));
    start
        .transpose()
        .map_err(|_| Problem::field("RT_SEC", "a time before the year 9999", "a later one"))
}

/// Mid-exposure on the monotonic clock as HEROES wrote its start.
fn heroes_monotonic(
    header: &Header,
    exposure: Option<Duration>,
) -> Result<Option<Duration>, Problem> {
    let clock = heroes_clock(header, ["MON_SEC", "MON_NSEC"], LONGEST_S as i64)?;
    let start = clock.map(|(s, ns)| Duration::new(s as u64, ns as u32));
    Ok(start.map(|start| start + exposure.unwrap_or_default() / 2))
}

/// A clock in two keywords, seconds up to `most_s` and nanoseconds.
fn heroes_clock(
    header: &Header,
    [seconds, nanoseconds]: [&str; 2],
    most_s: i64,
) -> Result<Option<(i64, i32)>, Problem> {
    if header.get(seconds).is_none() {
        return Ok(None);
    }
    let whole = header.size(seconds, 0..=most_s)?;
    let rest = match header.get(nanoseconds) {
        Some(_) => header.size(nanoseconds, 0..=999_999_999)?,
        None => 0,
    };
    Ok(Some((whole as i64, rest as i32)))
}

fn time(header: &Header, keyword: &str) -> Result<Option<Timestamp>, Problem> {
    let Some(text) = header.text(keyword)? else {
        return Ok(None);
    };
    if let Some(scale) = header.text("TIMESYS")?
        && scale != "UTC"
    {
        return Err(Problem::field("TIMESYS", "'UTC'", format!("'{scale}'")));
    }
    match parse_time(&text).or_else(|| parse_asctime(&text)) {
        Some(time) => Ok(Some(time)),
        None => Err(Problem::field(
            keyword,
            "a UTC date and time YYYY-MM-DDThh:mm:ss[.s...]",
            format!("'{text}'"),
        )),
    }
}

/// An ISO 8601 UTC date with a time, with or without Z.
fn parse_time(text: &str) -> Option<Timestamp> {
    let civil = text.strip_suffix('Z').unwrap_or(text);
    let shape = civil.is_ascii() && civil.len() >= 19 && civil.as_bytes()[10] == b'T';
    let clock = || {
        civil[11..]
            .bytes()
            .all(|b| b.is_ascii_digit() || b":.".contains(&b))
    };
    if !(shape && clock()) {
        return None;
    }
    let civil: DateTime = civil.parse().ok()?;
    TimeZone::UTC.to_timestamp(civil).ok()
}

/// A UTC date as C's `asctime` writes it: "Sat Sep 21 18:00:00 2013", perhaps with its line end, which no header may hold.
fn parse_asctime(text: &str) -> Option<Timestamp> {
    let text = text.trim_end_matches('?').trim_end();
    let civil = DateTime::strptime("%a %b %e %H:%M:%S %Y", text).ok()?;
    TimeZone::UTC.to_timestamp(civil).ok()
}

/// The time as FITS writes it: no Z, microseconds, and nanoseconds where there are any.
pub fn format_time(time: Timestamp) -> String {
    let digits = if time.subsec_nanosecond() % 1000 == 0 {
        6
    } else {
        9
    };
    let text = format!("{time:.digits$}");
    text.trim_end_matches('Z').into()
}

/// The value at which pixels saturate. What 16-bit files hold is 0 to 4095 unless SATURATE or BITDEPTH says
/// otherwise, or a pixel beyond 4095 shows that it is not so.
pub(super) fn read_saturation(header: &Header, pixels: PixelSlice<'_>) -> Result<u16, Problem> {
    let full = if pixels.bits() == 8 { 255 } else { u16::MAX };
    if let Some(level) = header.number("SATURATE")? {
        if !(1.0..=65_535.0).contains(&level) {
            return Err(Problem::field(
                "SATURATE",
                "a level from 1 to 65535 DN",
                level,
            ));
        }
        return Ok((level as u16).min(full));
    }
    if header.get("BITDEPTH").is_some() {
        let depth = header.size("BITDEPTH", 1..=16)?;
        return Ok(((1u32 << depth) - 1).min(full.into()) as u16);
    }
    Ok(pixels.assumed_saturation_dn())
}

/// The keywords that say how a frame was taken.
pub(super) fn info_cards(frame: &Frame) -> Vec<Card> {
    let info = &frame.info;
    let mut cards = time_cards(info);
    let mut add =
        |keyword, value: Option<Value>| cards.extend(value.map(|v| Card::new(keyword, v)));
    add("FRAMENUM", info.number.map(|n| Value::Integer(n as i64)));
    add("MONOTIME", info.monotonic.map(|t| t.as_secs_f64().into()));
    add(
        "UTCSTEP",
        info.utc_step.map(|step| step.as_secs_f64().into()),
    );
    add(
        "CAMCLOCK",
        info.camera_clock
            .and_then(|t| i64::try_from(t.as_nanos()).ok())
            .map(Value::Integer),
    );
    let corner = |along: fn((usize, usize)) -> usize| {
        info.corner_px.map(|at| Value::Integer(along(at) as i64))
    };
    add("CORNER-X", corner(|(x, _)| x));
    add("CORNER-Y", corner(|(_, y)| y));
    add("CAMERA", info.camera.clone().map(Value::Text));
    add("GAIN", info.analogue_gain.map(Value::Float));
    add("PREAMP", info.preamp_gain.map(Value::Float));
    add("CAMTEMP", info.camera_temperature_c.map(Value::Float));
    let depth = u16::BITS - frame.saturation_dn().leading_zeros();
    add("BITDEPTH", Some(Value::Integer(depth.into())));
    add(
        "SATURATE",
        Some(Value::Integer(frame.saturation_dn().into())),
    );
    add("BTYPE", Some("Intensity".into()));
    add("BUNIT", Some("adu".into()));
    cards.extend(info.place.map(place_cards).unwrap_or_default());
    cards
}

/// Each time stands twice, as a date and as a Modified Julian Date: what is missing readers of world coordinates add
/// themselves, and say so.
fn time_cards(info: &FrameInfo) -> Vec<Card> {
    let (start, end) = (info.exposure_start(), info.exposure_end());
    let mut cards = vec![Card::new("TIMESYS", "UTC")];
    for (keyword, julian, time) in [
        ("DATEREF", "MJDREF", start.or(info.mid_exposure)),
        ("DATE-OBS", "MJD-OBS", start),
        ("DATE-BEG", "MJD-BEG", start),
        ("DATE-AVG", "MJD-AVG", info.mid_exposure),
        ("DATE-END", "MJD-END", end),
    ] {
        if let Some(time) = time {
            cards.push(Card::new(keyword, format_time(time)));
            cards.push(Card::new(julian, modified_julian_date(time)));
        }
    }
    if let Some(exposure) = info.exposure {
        cards.push(Card::new("EXPTIME", exposure.as_secs_f64()));
        cards.push(Card::new("XPOSURE", exposure.as_secs_f64()));
    }
    cards
}

/// The keywords that say how well the computer's clock was held, from which the frame's times come.
pub fn clock_cards(clock: &ClockStatus) -> Vec<Card> {
    let mut cards = vec![
        Card::new("CLKSYNC", clock.synchronised),
        Card::new("CLKOFF", clock.offset_us * 1e-6),
        Card::new("CLKERR", clock.max_error_us * 1e-6),
    ];
    cards.extend(clock.source.map(|source| Card::new("CLKSRC", source)));
    cards
}

/// Days since 1858-11-17, to the microsecond.
fn modified_julian_date(time: Timestamp) -> f64 {
    const OF_UNIX_EPOCH: f64 = 40_587.0;
    OF_UNIX_EPOCH + time.as_microsecond() as f64 / 86_400e6
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn times_are_read_with_and_without_z_and_nothing_else_is() {
        let expected: Timestamp = "2013-09-21T18:00:00.0075Z".parse().unwrap();
        for text in ["2013-09-21T18:00:00.0075", "2013-09-21T18:00:00.007500Z"] {
            assert_eq!(parse_time(text), Some(expected), "{text}");
        }
        for text in [
            "2013-09-21",
            "2013-13-21T18:00:00",
            "21/09/13",
            "2013-09-21T25:00:00",
            "2013-09-21T18:00:00+02:00",
            "2013-09-21 18:00:00",
            "",
        ] {
            assert_eq!(parse_time(text), None, "{text}");
        }
    }

    #[test]
    fn the_clocks_keywords_are_in_seconds_and_tell_of_a_time_service_only_where_there_is_one() {
        let mut clock = ClockStatus {
            synchronised: true,
            offset_us: -250.0,
            max_error_us: 1500.0,
            source: Some("chrony"),
        };
        let card = |keyword, value: Value| Card::new(keyword, value);
        let held = [
            card("CLKSYNC", true.into()),
            card("CLKOFF", (-250e-6).into()),
            card("CLKERR", 1500e-6.into()),
            card("CLKSRC", "chrony".into()),
        ];
        assert_eq!(clock_cards(&clock), held);
        clock.source = None;
        assert_eq!(clock_cards(&clock), held[..3]);
    }

    #[test]
    fn times_of_c_are_read_with_and_without_their_line_end() {
        let expected: Timestamp = "2013-09-01T08:05:09Z".parse().unwrap();
        for text in ["Sun Sep  1 08:05:09 2013", "Sun Sep  1 08:05:09 2013?"] {
            assert_eq!(parse_asctime(text), Some(expected), "{text}");
        }
        for text in ["Mon Sep  1 08:05:09 2013", "Sep 1 2013", ""] {
            assert_eq!(parse_asctime(text), None, "{text}");
        }
    }

    #[test]
    fn a_modified_julian_date_is_that_of_the_almanac() {
        // 2000-01-01 12:00 is JD 2451545.0, and MJD = JD - 2400000.5.
        let noon: Timestamp = "2000-01-01T12:00:00Z".parse().unwrap();
        assert_eq!(modified_julian_date(noon), 51_544.5);
    }

    #[test]
    fn a_time_is_written_without_z_to_the_microsecond_or_better() {
        let time = |text: &str| format_time(text.parse().unwrap());
        assert_eq!(time("2013-09-21T18:00:00Z"), "2013-09-21T18:00:00.000000");
        assert_eq!(
            time("2013-09-21T18:00:00.000000001Z"),
            "2013-09-21T18:00:00.000000001"
        );
    }
}
