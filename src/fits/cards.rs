//! Keywords of a frame's exposure data.

use super::header::Value;
use super::place::place_cards;
use super::{Card, keyword};
use crate::clock::ClockStatus;
use crate::frame::{Frame, FrameInfo};
use jiff::Timestamp;

/// The time as FITS writes it: no Z, microseconds, and nanoseconds if there are any.
pub fn format_time(time: Timestamp) -> String {
    let digits = if time.subsec_nanosecond() % 1000 == 0 {
        6
    } else {
        9
    };
    let text = format!("{time:.digits$}");
    text.trim_end_matches('Z').into()
}

/// The keywords of the exposure data.
pub(super) fn info_cards(frame: &Frame) -> Vec<Card> {
    let info = &frame.info;
    let mut cards = time_cards(info);
    let mut add =
        |keyword, value: Option<Value>| cards.extend(value.map(|v| Card::new(keyword, v)));
    add(
        &keyword::FRAMENUM,
        info.number.map(|n| Value::Integer(n as i64)),
    );
    add(
        &keyword::MONOTIME,
        info.monotonic.map(|t| t.as_secs_f64().into()),
    );
    add(
        &keyword::UTCSTEP,
        info.utc_step.map(|step| step.as_secs_f64().into()),
    );
    add(
        &keyword::CAMCLOCK,
        info.camera_clock
            .and_then(|t| i64::try_from(t.as_nanos()).ok())
            .map(Value::Integer),
    );
    let corner = |along: fn((usize, usize)) -> usize| {
        info.corner_px.map(|at| Value::Integer(along(at) as i64))
    };
    add(&keyword::CORNER_X, corner(|(x, _)| x));
    add(&keyword::CORNER_Y, corner(|(_, y)| y));
    add(&keyword::CAMERA, info.camera.clone().map(Value::Text));
    add(&keyword::GAIN, info.analogue_gain.map(Value::Float));
    add(&keyword::PREAMP, info.preamp_gain.map(Value::Float));
    add(
        &keyword::CAMTEMP,
        info.camera_temperature_c.map(Value::Float),
    );
    let depth = u16::BITS - frame.saturation_dn().leading_zeros();
    add(&keyword::BITDEPTH, Some(Value::Integer(depth.into())));
    add(
        &keyword::SATURATE,
        Some(Value::Integer(frame.saturation_dn().into())),
    );
    add(&keyword::BTYPE, Some("Intensity".into()));
    add(&keyword::BUNIT, Some("adu".into()));
    cards.extend(info.place.map(place_cards).unwrap_or_default());
    cards
}

/// Each time is written twice, as a date and as a Modified Julian Date: readers of world coordinates add a missing one
/// themselves, with a warning.
fn time_cards(info: &FrameInfo) -> Vec<Card> {
    let (start, end) = (info.exposure_start(), info.exposure_end());
    let mut cards = vec![Card::new(&keyword::TIMESYS, "UTC")];
    for (keyword, julian, time) in [
        (
            &keyword::DATEREF,
            &keyword::MJDREF,
            start.or(info.mid_exposure),
        ),
        (&keyword::DATE_OBS, &keyword::MJD_OBS, start),
        (&keyword::DATE_BEG, &keyword::MJD_BEG, start),
        (&keyword::DATE_AVG, &keyword::MJD_AVG, info.mid_exposure),
        (&keyword::DATE_END, &keyword::MJD_END, end),
    ] {
        if let Some(time) = time {
            cards.push(Card::new(keyword, format_time(time)));
            cards.push(Card::new(julian, modified_julian_date(time)));
        }
    }
    if let Some(exposure) = info.exposure {
        cards.push(Card::new(&keyword::EXPTIME, exposure.as_secs_f64()));
        cards.push(Card::new(&keyword::XPOSURE, exposure.as_secs_f64()));
    }
    cards
}

/// The keywords of the synchronisation of the computer's clock, from which the frame's times come.
pub fn clock_cards(clock: &ClockStatus) -> Vec<Card> {
    let mut cards = vec![
        Card::new(&keyword::CLKSYNC, clock.synchronised),
        Card::new(&keyword::CLKOFF, clock.offset_us * 1e-6),
        Card::new(&keyword::CLKERR, clock.max_error_us * 1e-6),
    ];
    cards.extend(
        clock
            .source
            .map(|source| Card::new(&keyword::CLKSRC, source)),
    );
    cards
}

/// Cards of a time scale: seconds since a zero, UTC.
pub fn zero_cards(zero: Timestamp) -> Vec<Card> {
    vec![
        Card::new(&keyword::TIMESYS, "UTC"),
        Card::new(&keyword::TIMEUNIT, "s"),
        Card::new(&keyword::DATEREF, format_time(zero)),
        Card::new(&keyword::MJDREF, modified_julian_date(zero)),
    ]
}

/// Days since 1858-11-17, to the microsecond.
pub fn modified_julian_date(time: Timestamp) -> f64 {
    const OF_UNIX_EPOCH: f64 = 40_587.0;
    OF_UNIX_EPOCH + time.as_microsecond() as f64 / 86_400e6
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_clocks_keywords_are_in_seconds_and_name_a_time_service_only_where_there_is_one() {
        let mut clock = ClockStatus {
            synchronised: true,
            offset_us: -250.0,
            max_error_us: 1500.0,
            source: Some("chrony"),
        };
        let card = |keyword, value: Value| Card::new(keyword, value);
        let held = [
            card(&keyword::CLKSYNC, true.into()),
            card(&keyword::CLKOFF, (-250e-6).into()),
            card(&keyword::CLKERR, 1500e-6.into()),
            card(&keyword::CLKSRC, "chrony".into()),
        ];
        assert_eq!(clock_cards(&clock), held);
        clock.source = None;
        assert_eq!(clock_cards(&clock), held[..3]);
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
