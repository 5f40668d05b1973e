//! A solved frame as a sentence of NMEA 0183:
//!
//! `$PSASP,hhmmss.ss,quality,azimuth,elevation,sigma,roll,roll sigma,camera*hh`
//!
//! Unknown values, and values that do not fit, are empty fields.

use super::Report;
use crate::clock::utc_text;
use crate::navigation::nmea::summed;
use crate::record::Record;

/// Most characters of a number: "-180.000000", "0.000024", "-180.0000", "0.0123". With the other fields these make 77 of the 82 that a sentence may
/// have.
const ANGLE: usize = 11;
const SIGMA: usize = 9;
const ROLL: usize = 9;
const ROLL_SIGMA: usize = 6;

/// The sentence, with `\r\n`.
pub(super) fn sentence(report: &Report) -> String {
    let record = &report.row.record;
    let offset = record.offset_deg.as_ref();
    let roll = record.roll_deg.as_ref();
    let number = |value: Option<f64>, decimals, width| {
        value.map_or(String::new(), |value| fitted(value, decimals, width))
    };
    let fields = [
        time_of_day(record),
        report.row.quality_code().to_string(),
        number(offset.map(|offset| offset.azimuth), 6, ANGLE),
        number(offset.map(|offset| offset.elevation), 6, ANGLE),
        number(offset.map(|offset| offset.sigma), 6, SIGMA),
        number(roll.map(|roll| roll.value), 4, ROLL),
        number(roll.map(|roll| roll.sigma), 4, ROLL_SIGMA),
        report.number.to_string(),
    ];
    summed(&format!("PSASP,{}", fields.join(",")))
}

/// Mid-exposure, UTC, hhmmss.ss; empty if the frame has no time.
fn time_of_day(record: &Record) -> String {
    let text = record.utc.map(|utc| utc_text(utc, 2));
    let time = text.as_deref().and_then(|text| text.split_once('T'));
    time.map_or(String::new(), |(_, time)| {
        time.trim_end_matches('Z').replace(':', "")
    })
}

/// A number with at most `decimals` decimals, reduced to fit the width; empty if none fits, or the number is not finite.
fn fitted(value: f64, decimals: usize, width: usize) -> String {
    if !value.is_finite() {
        return String::new();
    }
    let texts = (0..=decimals).rev().map(|n| format!("{value:.n$}"));
    let text = { texts }.find(|text| text.len() <= width);
    let text = text.unwrap_or_default();
    // No "-0.000000".
    match text.strip_prefix('-') {
        Some(rest) if rest.bytes().all(|byte| matches!(byte, b'0' | b'.')) => rest.into(),
        _ => text,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::aspect::Quality;
    use crate::clock::Utc;
    use crate::record::{LoggedRow, OffsetRecord, RollRecord};
    use jiff::Timestamp;
    use proptest::prelude::*;
    use std::time::Duration;

    fn report(utc: Option<Utc>, offset: Option<[f64; 3]>, roll: Option<[f64; 2]>) -> Report {
        let record = Record {
            utc,
            offset_deg: offset.map(|[azimuth, elevation, sigma]| OffsetRecord {
                azimuth,
                elevation,
                cross_elevation: 0.0,
                sigma,
                calibration_sigma: 0.0,
            }),
            roll_deg: roll.map(|[value, sigma]| RollRecord { value, sigma }),
            ..Record::unsolved(None, None, Duration::ZERO)
        };
        Report {
            camera: "camera".into(),
            number: 1,
            row: LoggedRow {
                quality: Quality::Fine,
                ..LoggedRow::bare(Some(7), record)
            },
        }
    }

    /// The fields of a sentence whose form is right.
    fn fields(sentence: &str) -> Vec<&str> {
        assert!(sentence.is_ascii() && sentence.len() <= 82, "{sentence:?}");
        let text = sentence.strip_prefix('$').unwrap();
        let text = text.strip_suffix("\r\n").unwrap();
        let (text, sum) = text.split_once('*').unwrap();
        let expected = text.bytes().fold(0, |sum, byte| sum ^ byte);
        assert_eq!(sum, format!("{expected:02X}"), "{sentence:?}");
        assert!(text.bytes().all(|byte| (b' '..=b'~').contains(&byte)));
        let fields: Vec<&str> = text.split(',').collect();
        assert_eq!((fields[0], fields.len()), ("PSASP", 9), "{sentence:?}");
        fields
    }

    #[test]
    fn a_sentence_has_the_numbers_of_its_frame() {
        let utc: Timestamp = "2013-09-21T18:00:07.126Z".parse().unwrap();
        let text = report(
            Some(utc.into()),
            Some([0.500_812_34, -12.25, 2.44e-5]),
            Some([-0.75, 0.0123]),
        );
        // The checksum was computed by another program: `pynmea2.NMEASentence.checksum`.
        assert_eq!(
            sentence(&text),
            "$PSASP,180007.12,2,0.500812,-12.250000,0.000024,-0.7500,0.0123,1*41\r\n"
        );
    }

    #[test]
    fn what_is_not_known_is_empty() {
        let text = sentence(&report(None, None, None));
        assert_eq!(fields(&text)[1..], ["", "2", "", "", "", "", "", "1"]);
    }

    #[test]
    fn what_does_not_fit_a_field_loses_decimals_and_at_last_is_empty() {
        assert_eq!(fitted(-179.123_456_7, 6, 11), "-179.123457");
        assert_eq!(fitted(-1_179.123_456_7, 6, 11), "-1179.12346");
        assert_eq!(fitted(12_345_678_901.2, 6, 11), "12345678901");
        assert_eq!(fitted(123_456_789_012.0, 6, 11), "");
        assert_eq!(fitted(f64::INFINITY, 6, 11), "");
        assert_eq!(fitted(-1e-9, 6, 11), "0.000000");
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(15_000))]
        #[test]
        fn any_solution_gives_a_sentence_of_82_characters_at_most_with_its_checksum(
            ms in proptest::option::of(0_i64..4_102_444_800_000),
            in_leap_second: bool,
            offset in proptest::option::of([-1e9..1e9, -1e9..1e9, 0.0..1e9]),
            roll in proptest::option::of([-1e6..1e6, 0.0..1e6]),
            small in 0_i32..12,
            number: u8,
        ) {
            let utc = ms.map(|ms| Utc {
                time: Timestamp::from_millisecond(ms).unwrap(),
                in_leap_second,
            });
            let scale = 10.0_f64.powi(-small);
            let offset = offset.map(|offset| offset.map(|value: f64| value * scale));
            let roll = roll.map(|roll| roll.map(|value: f64| value * scale));
            let text = Report { number, ..report(utc, offset, roll) };
            let sentence = sentence(&text);
            let fields = fields(&sentence);
            prop_assert_eq!(fields[1].len(), if utc.is_some() { 9 } else { 0 });
            for (text, value) in [
                (fields[3], offset.map(|offset| offset[0])),
                (fields[4], offset.map(|offset| offset[1])),
                (fields[6], roll.map(|roll| roll[0])),
            ] {
                match value {
                    // Half of the last decimal that fits a field of this width.
                    Some(value) if value.abs() < 180.0 => {
                        let read: f64 = text.parse().unwrap();
                        prop_assert!((read - value).abs() < 0.51e-4, "{text} of {value}");
                    }
                    Some(_) => {}
                    None => prop_assert_eq!(text, ""),
                }
            }
        }
    }
}
