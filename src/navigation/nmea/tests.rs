//! Handmade receivers' sentences; the two sentences of gpsd's documentation have its checksums.

use super::*;

/// Sentences from gpsd's documentation of NMEA, with checksums according to the standard.
const GGA: &str = "$GPGGA,123519.50,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,*71\r\n";
const RMC: &str = "$GPRMC,123519.50,A,4807.038,N,01131.000,E,022.4,084.4,230324,003.1,W*79\r\n";
const CLOCK: &str = "2024-03-23T12:35:19Z";

fn summed(body: &str) -> String {
    let sum = body.bytes().fold(0, |sum, byte| sum ^ byte);
    format!("${body}*{sum:02X}\r\n")
}

fn gga(time: &str, quality: &str) -> String {
    summed(&format!(
        "GNGGA,{time},4807.038,N,01131.000,E,{quality},08,0.9,545.4,M,46.9,M,,"
    ))
}

fn rmc(time: &str, velocity: &str, date: &str, modes: &str) -> String {
    summed(&format!(
        "GNRMC,{time},A,4807.038,N,01131.000,E,{velocity},{date},,,{modes}"
    ))
}

fn hear_at(bytes: &[u8], clock: &str) -> (Vec<Received>, GpsCounts) {
    let mut receiver = Nmea::default();
    let heard = receiver.feed(bytes, clock.parse().unwrap());
    let mut counts = GpsCounts::default();
    heard.iter().for_each(|one| _ = counts.note(one));
    counts.noise_bytes = receiver.noise_bytes();
    (heard, counts)
}

fn hear(text: &str) -> (Vec<Received>, GpsCounts) {
    hear_at(text.as_bytes(), CLOCK)
}

fn fixes(text: &str) -> Vec<TimedFix> {
    let fix = |heard| match heard {
        Received::Fix(fix) => Some(fix),
        _ => None,
    };
    hear(text).0.into_iter().filter_map(fix).collect()
}

/// The only rejected fix of a text.
fn refusal_at(text: &str, clock: &str) -> (Refusal, String) {
    match hear_at(text.as_bytes(), clock).0.as_slice() {
        [Received::Refused(refused)] => (refused.refusal, refused.to_string()),
        other => panic!("{text}: {other:?}"),
    }
}

fn refusal(text: &str) -> Refusal {
    refusal_at(text, CLOCK).0
}

#[test]
fn two_sentences_of_a_second_make_a_fix_in_whatever_pieces_and_order_they_come() {
    // The times differ from gpsd's sentences, so the checksums must be recomputed.
    let [gga, rmc] = [GGA, RMC].map(|text| summed(&text[1..text.find('*').unwrap()]));
    for text in [gga.clone() + &rmc, rmc + &gga] {
        for pieces in [1, 7, 500] {
            let mut receiver = Nmea::default();
            let now = CLOCK.parse().unwrap();
            let pieces = text.as_bytes().chunks(pieces);
            let heard: Vec<_> = pieces.flat_map(|piece| receiver.feed(piece, now)).collect();
            let [Received::Fix(fix)] = heard.as_slice() else {
                panic!("{heard:?}");
            };
            assert_eq!(fix.utc.to_string(), "2024-03-23T12:35:19.5Z");
            assert!((fix.place.latitude_deg - 48.1173).abs() < 1e-9);
            assert!((fix.place.longitude_deg - 11.516_666_667).abs() < 1e-9);
            assert!((fix.place.height_m - 592.3).abs() < 1e-9);
            // 22.4 knots, 84.4 deg from north towards east.
            let [north_m_s, east_m_s] = fix.level_m_s.unwrap();
            assert!((east_m_s - 11.4686).abs() < 1e-3, "{east_m_s}");
            assert!((north_m_s - 1.1245).abs() < 1e-3, "{north_m_s}");
        }
    }
}

#[test]
fn any_talker_any_end_of_line_and_small_digits_of_a_checksum_will_do() {
    let both = gga("123519.50", "1") + &rmc("123519.50", "22.4,84.4", "230324", "A");
    for talker in ["GP", "GL", "GA", "GB", "BD", "GQ"] {
        let lines = both.lines();
        let other =
            lines.map(|line| summed(&format!("{talker}{}", &line[3..line.find('*').unwrap()])));
        assert_eq!(fixes(&other.collect::<String>()).len(), 1, "{talker}");
    }
    for end in ["\r", "\n", "", " \r\n", "\r\r\n\n"] {
        assert_eq!(fixes(&both.replace("\r\n", end)).len(), 1, "{end:?}");
    }
    let small = both.to_ascii_lowercase();
    let sums: String = both
        .lines()
        .zip(small.lines())
        .map(|(line, small)| {
            let star = line.find('*').unwrap();
            format!("{}{}\r\n", &line[..star], &small[star..])
        })
        .collect();
    assert_eq!(fixes(&sums).len(), 1, "{sums}");
}

#[test]
fn what_is_not_measured_is_no_fix_whichever_sentence_says_so() {
    use Refusal::{Estimated, Manual, NoFix, Simulated};
    for (quality, modes, wanted) in [
        ("0", "N", NoFix),
        ("0", "A", NoFix),
        ("", "A", NoFix),
        ("6", "E,V", Estimated),
        ("6", "A", Estimated),
        ("1", "E", Estimated),
        ("7", "M", Manual),
        ("1", "M", Manual),
        ("8", "S,V", Simulated),
        ("1", "S", Simulated),
        ("1", "N", NoFix),
        ("1", "?", NoFix),
    ] {
        let text = gga("123519.50", quality) + &rmc("123519.50", "22.4,84.4", "230324", modes);
        assert_eq!(refusal(&text), wanted, "quality {quality}, modes {modes}");
    }
    // The navigational status is V if the receiver does not provide it.
    for (quality, modes) in [
        ("1", "A,V"),
        ("2", "D,V"),
        ("4", "R"),
        ("5", "F"),
        ("3", "P"),
    ] {
        let text = gga("123519.50", quality) + &rmc("123519.50", "22.4,84.4", "230324", modes);
        assert_eq!(fixes(&text).len(), 1, "quality {quality}, modes {modes}");
    }
    let warned = rmc("123519.50", "22.4,84.4", "230324", "A");
    let warned = summed(&warned[1..warned.find('*').unwrap()].replace(",A,4807", ",V,4807"));
    assert_eq!(refusal(&(gga("123519.50", "1") + &warned)), NoFix);
}

#[test]
fn a_date_of_another_day_is_refused_and_a_rollover_is_called_so() {
    let of = |date: &str| gga("123519.50", "1") + &rmc("123519.50", "22.4,84.4", date, "A");
    // 1024 weeks are 7168 days: 2024-03-23 minus 7168 days is 2004-08-07; plus 7168 days, 2043-11-07.
    for (date, weeks) in [("070804", "-1024"), ("071143", "+1024")] {
        let (refusal, why) = refusal_at(&of(date), CLOCK);
        assert_eq!(refusal, Refusal::WeekRollover, "{why}");
        assert!(why.contains(weeks), "{why}");
    }
    for date in ["220324", "010180", "060804"] {
        assert_eq!(refusal(&of(date)), Refusal::AnotherDay, "{date}");
    }
    // A clock that is off by hours is no reason to lose the position.
    for clock in ["2024-03-23T00:40:00Z", "2024-03-24T00:30:00Z"] {
        let (heard, _) = hear_at(of("230324").as_bytes(), clock);
        assert!(
            matches!(heard[..], [Received::Fix(_)]),
            "{clock}: {heard:?}"
        );
    }
}

#[test]
fn binary_messages_between_sentences_cost_none_of_them() {
    let both = gga("123519.50", "1") + &rmc("123519.50", "22.4,84.4", "230324", "A");
    // As sent by u-blox receivers, with all byte values, including `$` and line ends.
    let mut binary = b"\xb5\x62\x01\x07".to_vec();
    binary.extend((0..=255).rev());
    let mut bytes = binary.clone();
    for line in both.lines() {
        bytes.extend(line.as_bytes());
        bytes.extend(&binary);
    }
    let (heard, counts) = hear_at(&bytes, CLOCK);
    assert!(matches!(heard[..], [Received::Fix(_)]), "{heard:?}");
    assert_eq!((counts.fixes, counts.unreadable), (1, 0));
    // All except blanks and line ends, six of 256.
    assert!(
        (3 * 250..3 * 260).contains(&(counts.noise_bytes as usize)),
        "{counts:?}"
    );
}

#[test]
fn what_cannot_be_read_is_counted_and_says_why() {
    let good = rmc("123519.50", "22.4,84.4", "230324", "A");
    let cases = [
        (good.replace("22.4", "92.4"), "checksum"),
        (good.replace('*', ","), "checksum"),
        (good.replacen('*', "*zz", 1), "checksum"),
        (format!("{}{good}", &good[..30]), "checksum"),
        (
            good.replacen(",84", &format!(",{}", "8".repeat(200)), 1),
            "characters",
        ),
        (good.replacen(",84", ",\u{1}84", 1), "binary"),
        (gga("250000", "1"), "time"),
        (gga("1235", "1"), "time"),
        (rmc("123519", "fast,84.4", "230324", "A"), "speed"),
        (rmc("123519", "22.4,nan", "230324", "A"), "course"),
        (rmc("123519", "22.4,84.4", "310224", "A"), "date"),
        (
            summed("GPGGA,123519,4860.5,N,01131.0,E,1,08,0.9,545.4,M,46.9,M,,"),
            "latitude",
        ),
        (
            summed("GPGGA,123519,4807.0,N,01131.0,X,1,08,0.9,545.4,M,46.9,M,,"),
            "longitude",
        ),
        (
            summed("GPGGA,123519,4807.0,N,01131.0,E,1,08,0.9,high,M,46.9,M,,"),
            "altitude",
        ),
    ];
    for (text, wanted) in cases {
        let (heard, counts) = hear(&text);
        assert_eq!(counts.unreadable, 1, "{text}: {heard:?}");
        let why = heard.iter().find_map(|heard| match heard {
            Received::Unreadable(why) => Some(why.to_string()),
            _ => None,
        });
        assert!(
            why.as_ref().unwrap().contains(wanted),
            "{why:?} lacks {wanted}"
        );
    }
    // Sentences of other kinds are ignored.
    for text in [
        "GPVTG,084.4,T,087.5,M,022.4,N,041.5,K",
        "PUBX,00,1",
        "GPGSV,1,1,00",
    ] {
        let (heard, counts) = hear(&summed(text));
        assert!(
            heard.is_empty() && counts == GpsCounts::default(),
            "{counts:?}"
        );
    }
    // Noise without line ends is not stored.
    let (_, counts) = hear_at(&[0xFF; 100_000], CLOCK);
    assert_eq!(counts.noise_bytes, 100_000);
}

#[test]
fn a_speed_without_a_course_leaves_the_position() {
    let of = |velocity: &str| {
        let text = gga("123519.50", "1") + &rmc("123519.50", velocity, "230324", "A");
        fixes(&text)[0].level_m_s
    };
    // A speed of 0.1 m/s counts as rest.
    assert_eq!(of("0.2,"), Some([0.0, 0.0]));
    assert_eq!(of("0.793,"), None);
    assert_eq!(of(",84.4"), None);
    assert_eq!(of(","), None);
}

#[test]
fn places_that_receivers_invent_are_refused() {
    let at = |place: &str, height: &str| {
        let both = gga("123519.50", "1") + &rmc("123519.50", "22.4,84.4", "230324", "A");
        let both = both
            .replace("4807.038,N,01131.000,E", place)
            .replace("545.4", height);
        let body = |line: &str| summed(&line[1..line.find('*').unwrap()]);
        refusal(&both.lines().map(body).collect::<String>())
    };
    for nowhere in ["0000.0,N,00000.0,E", "0000.001,S,00000.002,W"] {
        assert_eq!(at(nowhere, "38405.0"), Refusal::Nowhere);
    }
    for (place, height) in [
        ("9100.0,N,01131.0,E", "545.4"),
        ("4807.0,N,18001.0,E", "545.4"),
        ("4807.0,N,01131.0,E", "-9000"),
        ("4807.0,N,01131.0,E", "99999999"),
    ] {
        assert_eq!(at(place, height), Refusal::Impossible, "{place} {height}");
    }
    assert_eq!(at(",,,", "545.4"), Refusal::Incomplete);
    assert_eq!(at("4807.0,N,01131.0,E", ""), Refusal::Incomplete);
    let fast = gga("123519.50", "1") + &rmc("123519.50", "99999,84.4", "230324", "A");
    assert_eq!(refusal(&fast), Refusal::Impossible);
}

#[test]
fn second_60_is_the_next_minutes_first() {
    let leap = gga("235960.00", "1") + &rmc("235960.00", "22.4,84.4", "311216", "A");
    let (heard, _) = hear_at(leap.as_bytes(), "2017-01-01T00:00:00Z");
    let [Received::Fix(fix)] = heard.as_slice() else {
        panic!("{heard:?}");
    };
    // As in Unix time.
    assert_eq!(fix.utc.to_string(), "2017-01-01T00:00:00Z");
}

#[test]
fn a_receiver_without_rmc_gives_places_dated_by_zda_or_by_the_clock() {
    let times = ["123518.90", "123519.00", "123519.10"];
    let alone: String = times.iter().map(|time| gga(time, "1")).collect();
    let found = fixes(&alone);
    let seconds: Vec<_> = found.iter().map(|fix| fix.utc.to_string()).collect();
    assert_eq!(seconds, ["2024-03-23T12:35:18.9Z", "2024-03-23T12:35:19Z"]);
    assert!(found.iter().all(|fix| fix.level_m_s.is_none()));
    // Times on both sides of midnight.
    let around = gga("235959.50", "1") + &gga("000000.50", "1") + &gga("000001.50", "1");
    let (heard, _) = hear_at(around.as_bytes(), "2024-03-23T23:59:59.9Z");
    let utc = |heard: &Received| match heard {
        Received::Fix(fix) => fix.utc.to_string(),
        other => panic!("{other:?}"),
    };
    let found: Vec<_> = heard.iter().map(utc).collect();
    assert_eq!(found, ["2024-03-23T23:59:59.5Z", "2024-03-24T00:00:00.5Z"]);
    let with_zda = |date: &str| {
        let zda = summed(&format!("GPZDA,123519.00,{date},00,00"));
        gga("123519.00", "1") + &zda + &gga("123520.00", "1")
    };
    assert_eq!(fixes(&with_zda("23,03,2024")).len(), 1);
    assert_eq!(refusal(&with_zda("07,08,2004")), Refusal::WeekRollover);
    // ZDA alone gives no place, RMC alone no height.
    let (heard, _) = hear(&summed("GPZDA,123519.00,23,03,2024,00,00").repeat(3));
    assert!(heard.is_empty());
    let alone = rmc("123519.00", "1,2", "230324", "A") + &gga("123520.00", "1");
    assert_eq!(refusal(&alone), Refusal::Incomplete);
}

#[test]
fn ten_fixes_a_second_are_separated_and_one_that_is_said_again_is_reported_again() {
    let second = |n: usize| format!("123519.{n}0");
    let fast: String = (0..10)
        .map(|n| gga(&second(n), "1") + &rmc(&second(n), "22.4,84.4", "230324", "A"))
        .collect();
    assert_eq!(fixes(&fast).len(), 10);
    // GGA ten times a second and RMC once.
    let slow: String = (0..10)
        .map(|n| {
            let rmc = (n == 0).then(|| rmc(&second(n), "22.4,84.4", "230324", "A"));
            gga(&second(n), "1") + &rmc.unwrap_or_default()
        })
        .collect();
    let found = fixes(&slow);
    assert_eq!(found.len(), 9, "the last one waits");
    assert_eq!(
        found.iter().filter(|fix| fix.level_m_s.is_some()).count(),
        1
    );
    // A hanging receiver: the caller can detect it from the repeated times.
    let hangs = (gga("123519.00", "1") + &rmc("123519.00", "22.4,84.4", "230324", "A")).repeat(3);
    assert_eq!(fixes(&hangs).len(), 3);
    assert_eq!(fixes(&gga("123519.00", "1").repeat(3)).len(), 2);
}

#[test]
fn what_is_no_fix_is_counted_by_kind() {
    let lost =
        summed("GPGGA,123519.00,,,,,0,00,,,M,,M,,") + &summed("GPRMC,123519.00,V,,,,,,,230324,,,N");
    let typed = gga("123520.00", "7") + &rmc("123520.00", ",", "230324", "M");
    let (_, counts) = hear(&(lost.repeat(2) + &typed));
    assert_eq!((counts.fixes, counts.unreadable), (0, 0));
    assert_eq!(counts.to_string(), "refused: 2 no fix, 1 manual input");
}
