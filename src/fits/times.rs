//! Mid-exposure in UTC, from the keywords that programs use for their times.
//!
//! DATE-AVG is mid-exposure; if there is none that can be used, half the exposure is added to its start: DATE-OBS, with TIME-OBS if it
//! has no time of day, or DATE-BEG. A start without an exposure is treated as that of a very short one. Files of the HEROES flight of
//! 2013 give the start as RT_SEC and RT_NSEC (s and ns since 1970), or in the form of C's `asctime`. Modified Julian
//! Dates and Julian Dates come last. TIMESYS names the scale of all of them except RT_SEC (FITS 4.0, section 9.2).

use super::values::Values;
use crate::clock::{Scale, Utc, read_utc, utc_of_mjd};
use crate::frame::Warning;
use jiff::{SignedDuration, Timestamp};
use std::time::Duration;

/// The longest plausible exposure or monotonic time, s: thirty years.
pub(super) const LONGEST_S: f64 = 1e9;

/// The latest plausible RT_SEC, s: the year 9999.
const LONGEST_CLOCK_S: f64 = 253_370_764_800.0;

/// Julian Date minus Modified Julian Date.
const JULIAN_OF_MODIFIED: f64 = 2_400_000.5;

/// The part of the exposure whose time a keyword gives.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Part {
    Start,
    Middle,
}

/// Mid-exposure; if the header states a time that cannot be used, the reason why there is none.
pub(super) fn mid_exposure(
    values: &mut Values,
    exposure: Option<Duration>,
) -> (Option<Utc>, Option<Warning>) {
    values.reading(|values| {
        READERS.into_iter().find_map(|(part, read)| {
            let utc = read(values)?;
            match part {
                Part::Middle => Some(utc),
                Part::Start => middle(values, utc, exposure),
            }
        })
    })
}

type Reader = fn(&mut Values) -> Option<Utc>;

/// In order of precedence.
const READERS: [(Part, Reader); 9] = [
    (Part::Middle, |values| text(values, "DATE-AVG")),
    (Part::Start, heroes_clock_time),
    (Part::Start, |values| text(values, "DATE-OBS")),
    (Part::Start, |values| text(values, "DATE-BEG")),
    (Part::Start, |values| text(values, "DATE_OBS")),
    (Part::Middle, |values| julian(values, "MJD-AVG", 0.0)),
    (Part::Start, |values| julian(values, "MJD-OBS", 0.0)),
    (Part::Start, |values| julian(values, "MJD-BEG", 0.0)),
    (Part::Start, |values| {
        julian(values, "JD", JULIAN_OF_MODIFIED)
    }),
];

fn middle(values: &mut Values, start: Utc, exposure: Option<Duration>) -> Option<Utc> {
    let exposure = match exposure {
        Some(exposure) => SignedDuration::try_from(exposure).ok()?,
        None => until_end(values, start.time).unwrap_or_default(),
    };
    let half = exposure / 2;
    let time = start.time.checked_add(half);
    let time = time.inspect_err(|_| {
        values.warn(Warning::new(
            "EXPTIME",
            "an exposure that ends before the year 9999",
            half,
        ));
    });
    Some(Utc {
        time: time.ok()?,
        ..start
    })
}

/// Duration from the start to DATE-END, if that is later.
fn until_end(values: &mut Values, start: Timestamp) -> Option<SignedDuration> {
    let end = text(values, "DATE-END")?;
    let exposure = end.time.duration_since(start);
    exposure.is_positive().then_some(exposure)
}

/// The scale of the header's times, UTC if it names none; `None`, with a warning, if it names an unknown one.
fn scale(values: &mut Values) -> Option<Option<Scale>> {
    let Some(name) = values.text("TIMESYS") else {
        return Some(None);
    };
    let scale = Scale::named(&name);
    if scale.is_none() {
        let warning = Warning::new(
            "TIMESYS",
            "'UTC', 'TAI', 'TT' or 'GPS'",
            format!("'{name}'"),
        );
        if !values.warnings.contains(&warning) {
            values.warn(warning);
        }
    }
    scale.map(Some)
}

/// The time of a keyword with a date.
fn text(values: &mut Values, keyword: &'static str) -> Option<Utc> {
    let date = values.date(keyword)?;
    let scale = scale(values)?;
    read_utc(&date, scale)
        .or_else(|expected| match keyword {
            "DATE-OBS" => with_time_of_day(values, &date, scale).unwrap_or(Err(expected)),
            _ => Err(expected),
        })
        .map_err(|expected| values.warn(Warning::new(keyword, expected, format!("'{date}'"))))
        .ok()
}

/// A date whose time of day is in a keyword of its own, as before 1998.
fn with_time_of_day(
    values: &Values,
    date: &str,
    scale: Option<Scale>,
) -> Option<Result<Utc, &'static str>> {
    let mut clock = ["TIME-OBS", "UTC-OBS", "UT"].into_iter();
    let clock = clock.find_map(|keyword| values.header.text(keyword).ok()?)?;
    Some(read_utc(&format!("{date}T{clock}"), scale))
}

/// A date counted in days.
fn julian(values: &mut Values, keyword: &'static str, zero: f64) -> Option<Utc> {
    let days = values.number(keyword)?;
    let scale = scale(values)?.unwrap_or(Scale::Utc);
    utc_of_mjd(days - zero, scale)
        .map_err(|expected| values.warn(Warning::new(keyword, expected, days)))
        .ok()
}

/// The computer's clock as written by HEROES, if no standard keyword gives the time.
fn heroes_clock_time(values: &mut Values) -> Option<Utc> {
    let today = ["DATE-OBS", "DATE-BEG"].iter().any(|keyword| {
        let text = values.header.text(keyword).ok().flatten();
        text.is_some_and(|text| text.contains('T') && read_utc(&text, None).is_ok())
    });
    if today {
        return None;
    }
    let (seconds, nanoseconds) = heroes_clock(values, ["RT_SEC", "RT_NSEC"], LONGEST_CLOCK_S)?;
    let time = Timestamp::new(seconds as i64, nanoseconds as i32).ok()?;
    Some(Utc {
        time,
        in_leap_second: false,
    })
}

/// Mid-exposure on the monotonic clock, from its start as written by HEROES.
pub(super) fn heroes_monotonic(
    values: &mut Values,
    exposure: Option<Duration>,
) -> Option<Duration> {
    let (seconds, nanoseconds) = heroes_clock(values, ["MON_SEC", "MON_NSEC"], LONGEST_S)?;
    let start = Duration::new(seconds, nanoseconds);
    Some(start + exposure.unwrap_or_default() / 2)
}

/// A clock in two keywords, seconds up to `most_s` and nanoseconds.
fn heroes_clock(
    values: &mut Values,
    [seconds, nanoseconds]: [&str; 2],
    most_s: f64,
) -> Option<(u64, u32)> {
    let whole = values.within(seconds, 0.0..=most_s, "whole seconds before the year 9999")?;
    let expected = "a number from 0 to 999999999";
    let rest = values.within(nanoseconds, 0.0..=999_999_999.0, expected);
    Some((whole as u64, rest.unwrap_or_default() as u32))
}
