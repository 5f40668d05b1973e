//! Header values of other programs: each is either used, or reported in a warning.

use super::*;
use jiff::Timestamp;
use rand::seq::IndexedRandom;
use rand::{RngExt, SeedableRng};
use rand_xoshiro::Xoshiro256PlusPlus;
use rayon::prelude::*;
use std::process::Command;

/// Keywords and values of a valid header.
const GOOD: [(&str, &str); 12] = [
    ("DATE-OBS", "'2013-09-21T18:00:00.250'"),
    ("EXPTIME", "0.015"),
    ("CAMERA", "'PYAS'"),
    ("FRAMENUM", "17"),
    ("GAIN", "1.5"),
    ("CAMTEMP", "-10.5"),
    ("BITDEPTH", "8"),
    ("SATURATE", "255"),
    ("OBSGEO-X", "-1300690.005"),
    ("OBSGEO-Y", "-5132065.136"),
    ("OBSGEO-Z", "3613124.979"),
    ("TIMESYS", "'UTC'"),
];
/// Mid-exposure time of the valid header.
const MIDDLE: &str = "2013-09-21T18:00:00.2575Z";

/// Expected time of a foreign header.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Time {
    /// The time of the valid header, within this many seconds.
    Within(f64),
    /// No time, with a reason.
    None,
}
use Time::Within;

/// One or several related values in foreign notation.
#[derive(Debug, Clone, Copy)]
struct Foreign {
    /// Cards that replace valid ones or are added; an empty value removes the keyword.
    cards: &'static [(&'static str, &'static str)],
    /// Keyword named in the warning; `None` if the meaning is clear.
    warns: Option<&'static str>,
    /// `None` if the value does not affect the time.
    time: Option<Time>,
}

const fn value(keyword: &'static str, cards: &'static [(&'static str, &'static str)]) -> Foreign {
    Foreign {
        cards,
        warns: Some(keyword),
        time: None,
    }
}

const fn clear(cards: &'static [(&'static str, &'static str)], within_s: f64) -> Foreign {
    Foreign {
        cards,
        warns: None,
        time: Some(Within(within_s)),
    }
}

const fn timed(
    keyword: &'static str,
    cards: &'static [(&'static str, &'static str)],
    time: Time,
) -> Foreign {
    Foreign {
        cards,
        warns: Some(keyword),
        time: Some(time),
    }
}

/// Values that do not affect the Sun's position.
const VALUES: &[Foreign] = &[
    value("CAMERA", &[("CAMERA", "1")]),
    value("INSTRUME", &[("CAMERA", ""), ("INSTRUME", "12")]),
    value("GAIN", &[("GAIN", "'High'")]),
    value("GAIN", &[("GAIN", "'50 %'")]),
    value("GAIN", &[("GAIN", "T")]),
    value("CAMTEMP", &[("CAMTEMP", "nan")]),
    value("CAMTEMP", &[("CAMTEMP", "-inf")]),
    value("CAMTEMP", &[("CAMTEMP", "'-10 C'")]),
    value("FRAMENUM", &[("FRAMENUM", "'0001'")]),
    value("FRAMENUM", &[("FRAMENUM", "-1")]),
    value("FRAMENUM", &[("FRAMENUM", "1.5")]),
    value("FRAMENUM", &[("FRAMENUM", "1E300")]),
    value(
        "LATITUDE, LONGITUD, HEIGHT",
        &[("WIDTH", "1296"), ("HEIGHT", "966")],
    ),
    value(
        "LATITUDE",
        &[
            ("LATITUDE", "'34 29 24'"),
            ("LONGITUD", "'-104 13 18'"),
            ("HEIGHT", "38405.0"),
        ],
    ),
    value(
        "LATITUDE/LONGITUD/HEIGHT",
        &[
            ("LATITUDE", "134.49"),
            ("LONGITUD", "-104.2"),
            ("HEIGHT", "38405.0"),
        ],
    ),
    value("OBSGEO-X, OBSGEO-Y, OBSGEO-Z", &[("OBSGEO-Z", "")]),
    value(
        "OBSGEO-X/Y/Z",
        &[("OBSGEO-X", "0."), ("OBSGEO-Y", "0."), ("OBSGEO-Z", "0.")],
    ),
    value("OBSGEO-Y", &[("OBSGEO-Y", "'unknown'")]),
    value("SATURATE", &[("SATURATE", "0")]),
    value("SATURATE", &[("SATURATE", "-1.0")]),
    value("SATURATE", &[("SATURATE", "'full'")]),
    value("BITDEPTH", &[("BITDEPTH", "'12 bit'"), ("SATURATE", "")]),
    value("BITDEPTH", &[("BITDEPTH", "99"), ("SATURATE", "")]),
    value("MONOTIME", &[("MONOTIME", "-5.0")]),
    value("CAMCLOCK", &[("CAMCLOCK", "'now'")]),
    value("UTCSTEP", &[("UTCSTEP", "'none'")]),
    value("PREAMP", &[("PREAMP", "'off'")]),
    value("OBSRVTRY", &[("OBSRVTRY", "7")]),
    value("CORNER-X", &[("CORNER-X", "'left'")]),
    value("ROWORDER", &[("ROWORDER", "'sideways'")]),
    value("DETSEC", &[("DETSEC", "'[1:99,1:99]'")]),
];

/// Times. Unambiguous ones are read without a warning.
const TIMES: &[Foreign] = &[
    clear(&[("DATE-OBS", "'2013-09-21 18:00:00.250'")], 1e-6),
    clear(&[("DATE-OBS", "'2013-09-21t18:00:00.250'")], 1e-6),
    clear(&[("DATE-OBS", "'2013-09-21T18:00:00.250 (UTC)'")], 1e-6),
    clear(&[("DATE-OBS", "'2013-09-21T18:00:00,250'")], 1e-6),
    clear(&[("DATE-OBS", "'2013-09-21T18:00'")], 0.25),
    clear(&[("DATE-OBS", "'2013-09-21T12:00:00.250-06:00'")], 1e-6),
    clear(
        &[("DATE-OBS", "'2013-09-21'"), ("TIME-OBS", "'18:00:00.250'")],
        1e-6,
    ),
    clear(&[("TIMESYS", "'UT'")], 1e-6),
    clear(&[("TIMESYS", "'utc'")], 1e-6),
    clear(&[("TIMESYS", "'UTC(NTP)'")], 1e-6),
    clear(
        &[
            ("TIMESYS", "'TAI'"),
            ("DATE-OBS", "'2013-09-21T18:00:35.250'"),
        ],
        1e-6,
    ),
    clear(
        &[
            ("TIMESYS", "'GPS'"),
            ("DATE-OBS", "'2013-09-21T18:00:16.250'"),
        ],
        1e-6,
    ),
    clear(
        &[
            ("TIMESYS", "'TT'"),
            ("DATE-OBS", "'2013-09-21T18:01:07.434'"),
        ],
        1e-6,
    ),
    // 18:00:00.2575 is 0.75000298 of a day.
    clear(&[("DATE-OBS", ""), ("MJD-AVG", "56556.750002980324")], 2e-6),
    clear(&[("DATE-OBS", ""), ("MJD-OBS", "56556.750002893519")], 2e-6),
    clear(&[("DATE-OBS", ""), ("JD", "2456557.2500028935")], 1e-4),
    clear(
        &[("EXPTIME", ""), ("DATE-END", "'2013-09-21T18:00:00.265'")],
        1e-6,
    ),
    timed("DATE-AVG", &[("DATE-AVG", "'soon'")], Within(1e-6)),
    timed(
        "DATE-OBS",
        &[("DATE-OBS", "2013-09-21T18:00:00.250")],
        Within(1e-6),
    ),
    timed(
        "DATE-OBS",
        &[("DATE-OBS", "'UNKNOWN'"), ("MJD-OBS", "56556.750002893519")],
        Within(2e-6),
    ),
    timed("EXPTIME", &[("EXPTIME", "'0.015'")], Within(1e-6)),
    timed("EXPTIME", &[("EXPTIME", "-1.0")], Within(0.0076)),
    timed("EXPTIME", &[("EXPTIME", "'short'")], Within(0.0076)),
    timed(
        "DATE-OBS",
        &[("DATE-OBS", "'21/09/13'"), ("TIME-OBS", "'18:00:00.250'")],
        Time::None,
    ),
    timed(
        "DATE-OBS",
        &[("DATE-OBS", "'21/09/2013 18:00:00.250'")],
        Time::None,
    ),
    timed("DATE-OBS", &[("DATE-OBS", "''")], Time::None),
    timed("DATE-OBS", &[("DATE-OBS", "'UNKNOWN'")], Time::None),
    timed("DATE-OBS", &[("DATE-OBS", "'2013-09-21'")], Time::None),
    timed(
        "DATE-OBS",
        &[("DATE-OBS", "'2013-09-21T23:59:60.250'")],
        Time::None,
    ),
    timed("DATE-OBS", &[("DATE-OBS", "20130921")], Time::None),
    timed(
        "DATE-OBS",
        &[("DATE-OBS", "'2013-09-31T18:00:00'")],
        Time::None,
    ),
    timed("TIMESYS", &[("TIMESYS", "'LOCAL'")], Time::None),
    timed(
        "DATE-OBS",
        &[
            ("TIMESYS", "'TAI'"),
            ("DATE-OBS", "'2013-09-21T18:00:35.250Z'"),
        ],
        Time::None,
    ),
    timed(
        "MJD-OBS",
        &[("DATE-OBS", ""), ("MJD-OBS", "-1.0")],
        Time::None,
    ),
];

/// The valid header with foreign values in place of its own.
fn cards(foreign: &[Foreign]) -> Vec<String> {
    let mut values: Vec<(&str, &str)> = GOOD.to_vec();
    for (keyword, value) in foreign.iter().flat_map(|foreign| foreign.cards) {
        values.retain(|(name, _)| name != keyword);
        if !value.is_empty() {
            values.push((keyword, value));
        }
    }
    values
        .iter()
        .map(|(keyword, value)| format!("{keyword:<8}= {value}"))
        .collect()
}

fn file(foreign: &[Foreign]) -> Vec<u8> {
    let cards = cards(foreign);
    let cards: Vec<&str> = cards.iter().map(String::as_str).collect();
    sample(8, &cards, |_, dn| [dn])
}

/// Checks a frame's Sun, warnings and time against its foreign values.
fn check(foreign: &[Foreign]) {
    let frame = read(&file(foreign), "frame.fits");
    let what = format!("{foreign:?}\n{:?}", frame.info);
    assert_solved(&frame, &what);
    let warned = fields(&frame.info.warnings);
    for keyword in foreign.iter().filter_map(|foreign| foreign.warns) {
        assert!(warned.contains(&keyword), "no word of {keyword}: {what}");
    }
    if foreign.iter().all(|foreign| foreign.warns.is_none()) {
        assert_eq!(frame.info.warnings, [], "{what}");
    }
    let expected = foreign.iter().find_map(|foreign| foreign.time);
    match expected.unwrap_or(Within(1e-6)) {
        Within(limit_s) => {
            let good: Timestamp = MIDDLE.parse().unwrap();
            let error = frame.info.mid_exposure.unwrap().duration_since(good);
            assert!(error.as_secs_f64().abs() <= limit_s, "{error:?}: {what}");
            assert_eq!(frame.info.untimed, None, "{what}");
        }
        Time::None => {
            assert_eq!(frame.info.mid_exposure, None, "{what}");
            assert!(frame.info.untimed.is_some(), "{what}");
        }
    }
}

#[test]
fn each_foreign_value_costs_no_frame_and_is_named() {
    let all: Vec<Foreign> = VALUES.iter().chain(TIMES).copied().collect();
    all.par_iter().for_each(|foreign| check(&[*foreign]));
}

#[test]
fn three_hundred_headers_with_up_to_five_foreign_values_give_sun_and_time() {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(46);
    let mut headers = Vec::new();
    while headers.len() < 300 {
        let count = random.random_range(1..=5);
        let mut header: Vec<Foreign> = Vec::new();
        if random.random_range(0..2) == 0 {
            header.extend(TIMES.choose(&mut random));
        }
        while header.len() < count {
            let Some(next) = VALUES.choose(&mut random) else {
                break;
            };
            // At most one value for each keyword.
            let stated = |cards: &[(&str, &str)]| {
                let mut used = header.iter().flat_map(|foreign| foreign.cards);
                used.any(|(keyword, _)| cards.iter().any(|(other, _)| other == keyword))
            };
            if !stated(next.cards) {
                header.push(*next);
            }
        }
        headers.push(header);
    }
    headers.par_iter().for_each(|header| check(header));
}

#[test]
fn a_leap_second_is_kept() {
    let leap = Foreign {
        cards: &[("DATE-OBS", "'2016-12-31T23:59:60.25'")],
        warns: None,
        time: None,
    };
    let frame = read(&file(&[leap]), "frame.fits");
    let text = solaspect::clock::utc_text(frame.info.utc().unwrap(), 4);
    assert_eq!(text, "2016-12-31T23:59:60.2575Z");
}

/// Standard output and standard error of `solve` for these files.
fn solve(files: &[(&str, Vec<u8>)]) -> (Vec<serde_json::Value>, String) {
    let folder = tempfile::tempdir().unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_solaspect"));
    command.args(["solve", "--format", "jsonl"]);
    for (name, bytes) in files {
        let path = folder.path().join(name);
        fs::write(&path, bytes).unwrap();
        command.arg(path);
    }
    let output = command.env_remove("RUST_LOG").output().unwrap();
    assert!(output.status.success(), "{output:?}");
    let lines = String::from_utf8(output.stdout).unwrap();
    let rows = lines
        .lines()
        .map(|line| serde_json::from_str(line).unwrap());
    (rows.collect(), String::from_utf8(output.stderr).unwrap())
}

#[test]
fn solve_says_why_a_frame_has_no_offset_and_warns_once_of_each_kind() {
    let gain = value("GAIN", &[("GAIN", "'High'")]);
    let unknown = timed("DATE-OBS", &[("DATE-OBS", "'UNKNOWN'")], Time::None);
    let nowhere = value(
        "OBSGEO-X/Y/Z",
        &[("OBSGEO-X", "0."), ("OBSGEO-Y", "0."), ("OBSGEO-Z", "0.")],
    );
    let leap = clear(&[("DATE-OBS", "'2016-12-31T23:59:60.25'")], 1e-6);
    let (rows, log) = solve(&[
        ("a.fits", file(&[gain])),
        ("b.fits", file(&[gain, unknown])),
        ("c.fits", file(&[nowhere])),
        ("d.fits", file(&[leap])),
    ]);
    let [good, untimed, unplaced, leap] = rows.as_slice() else {
        panic!("{rows:?}");
    };
    for row in [good, untimed, unplaced] {
        assert_eq!(row["quality"], "fine", "{row}");
    }
    assert!(
        good["reason"].is_null() && good["offset_deg"].is_object(),
        "{good}"
    );
    assert_eq!(untimed["utc"], serde_json::Value::Null);
    assert_eq!(untimed["reason"]["stage"], "time");
    let reason = untimed["reason"]["reason"].as_str().unwrap();
    assert!(
        reason.starts_with("DATE-OBS: expected a time such as"),
        "{reason}"
    );
    assert!(reason.ends_with("found 'UNKNOWN'"), "{reason}");
    assert!(untimed["offset_deg"].is_null());
    assert_eq!(unplaced["reason"]["stage"], "place");
    assert_eq!(leap["utc"], "2016-12-31T23:59:60.257Z");
    let named = log.lines().filter(|line| line.contains("'High'")).count();
    assert_eq!(named, 1, "{log}");
    assert!(
        log.contains("a.fits: GAIN: expected a finite number, found 'High'"),
        "{log}"
    );
    assert!(
        log.contains("in 2 frames: GAIN: expected a finite number"),
        "{log}"
    );
}
