//! How a frame was taken, from keywords and to keywords.
//!
//! Times are UTC. The middle of the exposure is DATE-AVG; where that is missing, DATE-OBS (or DATE-BEG) plus half
//! the exposure. A file that gives a start and no exposure is taken as a very short one. The place is OBSGEO-B,
//! -L and -H where all three stand, since they are what a [`Place`] holds, else OBSGEO-X, -Y and -Z; both are on
//! WGS 84 (FITS 4.0, section 8.4.1).

use super::header::{Header, Value};
use super::{Card, Problem};
use crate::frame::{Frame, FrameInfo};
use crate::units::Place;
use jiff::civil::DateTime;
use jiff::tz::TimeZone;
use jiff::{SignedDuration, Timestamp};
use sofars::consts::WGS84;
use std::time::Duration;

/// The longest exposure or monotonic time that is believed, s: thirty years.
const LONGEST_S: f64 = 1e9;

/// Reads how a frame was taken.
pub(super) fn read_info(header: &Header) -> Result<FrameInfo, Problem> {
    let exposure = match seconds(header, "EXPTIME")? {
        Some(exposure) => Some(exposure),
        None => seconds(header, "XPOSURE")?,
    };
    let number = match header.get("FRAMENUM") {
        Some(_) => Some(header.size("FRAMENUM", 0..=i64::MAX)?),
        None => None,
    };
    let camera = match header.text("CAMERA")? {
        Some(camera) => Some(camera),
        None => header.text("INSTRUME")?,
    };
    Ok(FrameInfo {
        number,
        mid_exposure: mid_exposure(header, exposure)?,
        monotonic: seconds(header, "MONOTIME")?,
        exposure,
        analogue_gain: header.number("GAIN")?,
        preamp_gain: header.number("PREAMP")?,
        camera_temperature_c: header.number("CAMTEMP")?,
        place: place(header)?,
        camera,
    })
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

fn mid_exposure(header: &Header, exposure: Option<Duration>) -> Result<Option<Timestamp>, Problem> {
    if let Some(middle) = time(header, "DATE-AVG")? {
        return Ok(Some(middle));
    }
    for keyword in ["DATE-OBS", "DATE-BEG"] {
        if let Some(start) = time(header, keyword)? {
            let half = SignedDuration::try_from(exposure.unwrap_or_default() / 2);
            let middle = half.ok().and_then(|half| start.checked_add(half).ok());
            return middle
                .map(Some)
                .ok_or_else(|| Problem::field(keyword, "a time before the year 9999", start));
        }
    }
    Ok(None)
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
    match parse_time(&text) {
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

/// The time as FITS writes it: no Z, microseconds, and nanoseconds where there are any.
pub(super) fn format_time(time: Timestamp) -> String {
    let digits = if time.subsec_nanosecond() % 1000 == 0 {
        6
    } else {
        9
    };
    let text = format!("{time:.digits$}");
    text.trim_end_matches('Z').into()
}

fn place(header: &Header) -> Result<Option<Place>, Problem> {
    if let Some([latitude, longitude, height]) =
        triple(header, ["OBSGEO-B", "OBSGEO-L", "OBSGEO-H"])?
    {
        return checked_place("OBSGEO-B/L/H", latitude, longitude, height).map(Some);
    }
    let Some(xyz) = triple(header, ["OBSGEO-X", "OBSGEO-Y", "OBSGEO-Z"])? else {
        return Ok(None);
    };
    let field = "OBSGEO-X/Y/Z";
    let (longitude, latitude, height) = sofars::coords::gc2gd(WGS84, xyz)
        .map_err(|_| Problem::field(field, "a geocentric position in m", format!("{xyz:?}")))?;
    checked_place(field, latitude.to_degrees(), longitude.to_degrees(), height).map(Some)
}

fn checked_place(
    field: &str,
    latitude: f64,
    longitude: f64,
    height: f64,
) -> Result<Place, Problem> {
    Place::new(latitude, longitude, height).map_err(|error| {
        let found = format!(
            "latitude {latitude:.4} deg, longitude {longitude:.4} deg, height {height:.0} m"
        );
        Problem::field(
            field,
            format!("a place near the Earth's surface ({error})"),
            found,
        )
    })
}

/// Three numbers that only make sense together.
fn triple(header: &Header, keywords: [&str; 3]) -> Result<Option<[f64; 3]>, Problem> {
    let [a, b, c] = keywords;
    match (header.number(a)?, header.number(b)?, header.number(c)?) {
        (Some(x), Some(y), Some(z)) => Ok(Some([x, y, z])),
        (None, None, None) => Ok(None),
        _ => Err(Problem::field(
            keywords.join(", "),
            "all three or none",
            "some of them",
        )),
    }
}

/// The value at which pixels saturate. What 16-bit files hold is 0 to 4095 unless SATURATE or BITDEPTH says
/// otherwise, or a pixel beyond 4095 shows that it is not so.
pub(super) fn read_saturation(
    header: &Header,
    bits: u32,
    brightest_dn: u16,
) -> Result<u16, Problem> {
    let full = if bits == 8 { 255 } else { u16::MAX };
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
    Ok(assumed_saturation(bits, brightest_dn))
}

/// The saturation of pixels that come without a word about it.
pub(super) fn assumed_saturation(bits: u32, brightest_dn: u16) -> u16 {
    match (bits, brightest_dn) {
        (8, _) => 255,
        (_, ..=4095) => 4095,
        _ => u16::MAX,
    }
}

/// The keywords that say how a frame was taken.
pub(super) fn info_cards(frame: &Frame) -> Vec<Card> {
    let info = &frame.info;
    let mut cards = time_cards(info);
    let mut add =
        |keyword, value: Option<Value>| cards.extend(value.map(|v| Card::new(keyword, v)));
    add("FRAMENUM", info.number.map(|n| Value::Integer(n as i64)));
    add("MONOTIME", info.monotonic.map(|t| t.as_secs_f64().into()));
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
    add("BUNIT", Some("DN".into()));
    cards.extend(info.place.map(place_cards).unwrap_or_default());
    cards
}

fn time_cards(info: &FrameInfo) -> Vec<Card> {
    let mut cards = vec![Card::new("TIMESYS", "UTC")];
    let mut add = |keyword, time: Option<Timestamp>| {
        cards.extend(time.map(|time| Card::new(keyword, format_time(time))));
    };
    add("DATEREF", info.exposure_start().or(info.mid_exposure));
    add("DATE-OBS", info.exposure_start());
    add("DATE-BEG", info.exposure_start());
    add("DATE-AVG", info.mid_exposure);
    add("DATE-END", info.exposure_end());
    if let Some(exposure) = info.exposure {
        cards.push(Card::new("EXPTIME", exposure.as_secs_f64()));
        cards.push(Card::new("XPOSURE", exposure.as_secs_f64()));
    }
    cards
}

fn place_cards(place: Place) -> Vec<Card> {
    let geodetic = [place.latitude_deg, place.longitude_deg, place.height_m];
    let mut cards: Vec<Card> = ["OBSGEO-B", "OBSGEO-L", "OBSGEO-H"]
        .into_iter()
        .zip(geodetic)
        .map(|(keyword, value)| Card::new(keyword, value))
        .collect();
    let [latitude, longitude] = [place.latitude_deg, place.longitude_deg].map(f64::to_radians);
    if let Ok(xyz) = sofars::coords::gd2gc(WGS84, longitude, latitude, place.height_m) {
        for (keyword, value) in ["OBSGEO-X", "OBSGEO-Y", "OBSGEO-Z"].into_iter().zip(xyz) {
            // To a tenth of a millimetre: more would be noise of the conversion.
            cards.push(Card::new(keyword, (value * 1e4).round() / 1e4));
        }
    }
    cards
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
    fn a_time_is_written_without_z_to_the_microsecond_or_better() {
        let time = |text: &str| format_time(text.parse().unwrap());
        assert_eq!(time("2013-09-21T18:00:00Z"), "2013-09-21T18:00:00.000000");
        assert_eq!(
            time("2013-09-21T18:00:00.000000001Z"),
            "2013-09-21T18:00:00.000000001"
        );
    }
}
