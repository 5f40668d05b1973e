//! Alarms by the housekeeping, in words: one table, from which the console's state line and the table of
//! `docs/flight.md`, "What the ground sees", are made.

use crate::link::Housekeeping;
use crate::units::counted;

/// Severity of a finding.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Severity {
    Good,
    Attention,
    Alarm,
}

impl Severity {
    pub fn name(self) -> &'static str {
        match self {
            Self::Good => "good",
            Self::Attention => "attention",
            Self::Alarm => "alarm",
        }
    }
}

/// The latest housekeeping, and that from a minute before or from the flight's start.
pub struct Minute<'a> {
    pub now: &'a Housekeeping,
    pub before: &'a Housekeeping,
}

/// A rule that detects one fault.
pub struct Rule {
    pub name: &'static str,
    pub severity: Severity,
    /// Description of the fault, for a sentence; `None` if there is none.
    pub found: fn(&Minute) -> Option<String>,
}

/// Fields that are monitored together: a row of the page's table, with the rules that judge them. Some fields have no rule.
pub struct Watch {
    pub fields: &'static [&'static str],
    pub good: &'static str,
    pub otherwise: &'static str,
    pub rules: &'static [Rule],
}

/// Above these levels a disk causes a warning, and then is thinned (`archive.warn_free_percent`,
/// `archive.thin_free_percent`).
const DISK_WARNING_PERCENT: u8 = 90;
const DISK_ALARM_PERCENT: u8 = 97;
const RESIDUAL_PX: f32 = 0.3;
const LATENCY_MS: f32 = 10.0;
/// Limit of the clock's error, in which the Sun moves by 0.15 arcsec.
const CLOCK_US: f32 = 10_000.0;

/// Value of `gyro_agreement` for a contradiction.
const CONTRADICTED: u8 = 3;

macro_rules! counter {
    ($field:ident, $severity:ident, $what:literal) => {
        Rule {
            name: stringify!($field),
            severity: Severity::$severity,
            found: |minute| {
                let of = |housekeeping: &Housekeeping| u64::from(housekeeping.$field);
                growth($what, of(minute.before), of(minute.now))
            },
        }
    };
}

macro_rules! switch {
    ($field:ident, $severity:ident, $wrong:literal, $words:literal) => {
        Rule {
            name: stringify!($field),
            severity: Severity::$severity,
            found: |minute| (minute.now.$field == $wrong).then(|| $words.into()),
        }
    };
}

#[rustfmt::skip] // One rule, one line where it is short.
pub const WATCHES: &[Watch] = &[
    Watch {
        fields: &["fine"],
        good: "grows with the frames of the first pitch-yaw camera",
        otherwise: "`coarse`: part of the disc, or too few marks; `none`: no Sun; `stopped_limb` and its like say at which stage",
        rules: &[Rule {
            name: "fine",
            severity: Severity::Attention,
            found: without_fine,
        }],
    },
    Watch {
        fields: &["values_set"],
        good: "0, or as many as commands have set",
        otherwise: "number of values set by command that differ from the configuration: `preflight` lists them, and `reset_values` returns to it",
        rules: &[Rule {
            name: "values_set",
            severity: Severity::Attention,
            found: |minute| {
                let set = minute.now.values_set;
                let blind = without_fine(minute).is_some();
                (set > 0 && blind).then(|| {
                    let values = counted(set.into(), "value");
                    format!("no fine frame, with {values} set by command: reset_values returns to the configuration")
                })
            },
        }],
    },
    Watch {
        fields: &["silent_s"],
        good: "constant",
        otherwise: "time without frames from a camera: see above",
        rules: &[Rule {
            name: "silent_s",
            severity: Severity::Alarm,
            found: |minute| {
                let silent_s = minute.now.silent_s.saturating_sub(minute.before.silent_s);
                (silent_s > 0)
                    .then(|| format!("no frames from a camera for {silent_s} s of the last minute"))
            },
        }],
    },
    Watch {
        fields: &["lost", "unstored", "outdated", "unsent", "rejected", "datagrams_refused", "restarts"],
        good: "constant",
        otherwise: "see above",
        rules: &[
            counter!(lost, Alarm, "frame lost by camera or solver|frames lost by camera or solver"),
            counter!(unstored, Alarm, "frame stored on no disk|frames stored on no disk"),
            counter!(outdated, Attention, "solution too old to be sent|solutions too old to be sent"),
            counter!(unsent, Attention, "packet that could not be sent|packets that could not be sent"),
            counter!(rejected, Attention, "corrupt packet received|corrupt packets received"),
            counter!(datagrams_refused, Attention, "datagram refused|datagrams refused"),
            counter!(restarts, Alarm, "thread restarted|threads restarted"),
        ],
    },
    Watch {
        fields: &["tracking", "sending", "storing"],
        good: "1",
        otherwise: "the controller has not asked for solutions; this computer sends none; frames are not stored",
        rules: &[
            switch!(tracking, Attention, false, "tracking is off: the controller has not asked for solutions"),
            switch!(sending, Attention, false, "sending is off: this computer sends no solutions"),
            switch!(storing, Attention, false, "frames of the pitch-yaw camera are not stored"),
        ],
    },
    Watch {
        fields: &["disc_dn"],
        good: "50 to 95 % of full scale",
        otherwise: "set the exposure (0x0451), or `camera.auto_exposure`",
        rules: &[],
    },
    Watch {
        fields: &["residual_px"],
        good: "below 0.3",
        otherwise: "the camera has moved or is out of focus",
        rules: &[Rule {
            name: "residual_px",
            severity: Severity::Attention,
            found: |minute| {
                let residual = minute.now.residual_px.filter(|px| *px >= RESIDUAL_PX)?;
                Some(format!(
                    "marks are {residual:.2} px rms from the mapping: the camera has moved or is out of focus"
                ))
            },
        }],
    },
    Watch {
        fields: &["plate_sigma_mil", "offset_sigma_deg"],
        good: "as in the lab",
        otherwise: "noise, blur, few limb points",
        rules: &[],
    },
    Watch {
        fields: &["rotation_deg", "scale_mil_per_px"],
        good: "as calibrated",
        otherwise: "the camera has turned or moved",
        rules: &[],
    },
    Watch {
        fields: &["calibration_contradicted"],
        good: "0",
        otherwise: "three fine frames in a row agree that rotation, scale or plate centre are more than 5 sigma from the instrument's file: the wrong file, or the camera was moved. The log and the flight's summary name key, stated and measured value. Frames without marks borrow what was measured",
        rules: &[switch!(calibration_contradicted, Alarm, true, "fine frames contradict the instrument's file: the wrong file, or the camera was moved")],
    },
    Watch {
        fields: &["navigation"],
        good: "2 (aligned) if the inertial filter is enabled",
        otherwise: "1: it waits for samples, a fix and the Sun; 3: no frame for 10 s; 4: it has restarted; 5: frames contradict the gyros, for seconds: the filter follows them; 6: the IMU's values freeze, saturate or jump",
        rules: &[Rule {
            name: "navigation",
            severity: Severity::Attention,
            found: |minute| match minute.now.navigation {
                1 => Some("the inertial filter waits for samples, a fix and the Sun".into()),
                3 => Some("the inertial filter coasts: no frame for 10 s".into()),
                4 => Some("the inertial filter has restarted".into()),
                // The alarm below reports it.
                5 if minute.now.gyro_agreement == CONTRADICTED => None,
                5 => Some("frames contradict the gyros: inertial offsets are uncertain".into()),
                6 => Some(
                    "the IMU's values freeze, saturate or jump: inertial offsets are uncertain"
                        .into(),
                ),
                _ => None,
            },
        }],
    },
    Watch {
        fields: &["gyro_agreement", "gyro_right_sigmas", "gyro_up_sigmas", "gyro_roll_sigmas"],
        good: "1; within 5 sigma",
        otherwise: "2: a direction is more than 5 sigma from the gyros' prediction; 3: for 10 s. One of the two is wrong: the filter follows the camera, which may have moved. The log names camera and axis",
        rules: &[Rule {
            name: "gyro_agreement",
            severity: Severity::Alarm,
            found: |minute| {
                let words = gyros_against_sun(minute.now)
                    .filter(|_| minute.now.gyro_agreement == CONTRADICTED)?;
                Some(format!(
                    "{words}: they contradict each other for 10 s, one of them is wrong"
                ))
            },
        }],
    },
    Watch {
        fields: &["simulated"],
        good: "0",
        otherwise: "frames and offsets are simulated",
        rules: &[switch!(simulated, Attention, true, "frames and offsets are simulated")],
    },
    Watch {
        fields: &["takeovers", "log_lines_lost", "gps_refused"],
        good: "constant",
        otherwise: "see above",
        rules: &[
            counter!(takeovers, Alarm, "thread hung and was replaced|threads hung and were replaced"),
            counter!(log_lines_lost, Attention, "log line lost|log lines lost"),
            counter!(gps_refused, Attention, "GPS fix refused|GPS fixes refused"),
        ],
    },
    Watch {
        fields: &["disk_1_refusals", "disk_2_refusals", "rows_refused"],
        good: "constant",
        otherwise: "a disk fails, or was absent",
        rules: &[
            Rule {
                name: "disk_refusals",
                severity: Severity::Alarm,
                found: |minute| {
                    let of = |housekeeping: &Housekeeping| {
                        u64::from(housekeeping.disk_1_refusals) + u64::from(housekeeping.disk_2_refusals)
                    };
                    growth(
                        "refusal by a disk|refusals by a disk",
                        of(minute.before),
                        of(minute.now),
                    )
                },
            },
            counter!(rows_refused, Attention, "row not written to a log|rows not written to a log"),
        ],
    },
    Watch {
        fields: &["queued_frames", "queued_events"],
        good: "0 or 1",
        otherwise: "the solver, or the line, is too slow",
        rules: &[
            Rule {
                name: "queued_frames",
                severity: Severity::Attention,
                found: |minute| queue(minute.now.queued_frames, "frames wait for the solver"),
            },
            Rule {
                name: "queued_events",
                severity: Severity::Attention,
                found: |minute| queue(minute.now.queued_events, "events wait for the line"),
            },
        ],
    },
    Watch {
        fields: &["queued_pictures", "queued_rows"],
        good: "some",
        otherwise: "a disk is too slow",
        rules: &[],
    },
    Watch {
        fields: &["camera_c", "computer_c"],
        good: "within their specification",
        otherwise: "",
        rules: &[],
    },
    Watch {
        fields: &["disk_1", "disk_2"],
        good: "grow slowly",
        otherwise: "from 90 % on frames may soon be thinned, from 97 % on they are (`archive.thin_free_percent`)",
        rules: &[
            Rule {
                name: "disks_filling",
                severity: Severity::Attention,
                found: |minute| fullest(minute.now, DISK_WARNING_PERCENT..DISK_ALARM_PERCENT),
            },
            Rule {
                name: "disks_full",
                severity: Severity::Alarm,
                found: |minute| fullest(minute.now, DISK_ALARM_PERCENT..101),
            },
        ],
    },
    Watch {
        fields: &["commit", "modified", "configuration"],
        good: "as installed; 0; the first digits of `sha256sum` of `configuration_<start>.toml`",
        otherwise: "another program, configuration or instrument than intended",
        rules: &[switch!(modified, Attention, true, "the program was built from modified sources")],
    },
    Watch {
        fields: &["latency_99_ms"],
        good: "below 10",
        otherwise: "the computer is busy, or too hot",
        rules: &[Rule {
            name: "latency_99_ms",
            severity: Severity::Attention,
            found: |minute| {
                let latency = minute.now.latency_99_ms.filter(|ms| *ms > LATENCY_MS)?;
                Some(format!(
                    "from frame to packet {latency:.0} ms (99 %): the computer is busy, or too hot"
                ))
            },
        }],
    },
    Watch {
        fields: &["clock_offset_us", "clock_stepped"],
        good: "small; false",
        otherwise: "the time service",
        rules: &[
            Rule {
                name: "clock_offset_us",
                severity: Severity::Attention,
                found: |minute| {
                    let offset = minute
                        .now
                        .clock_offset_us
                        .filter(|us| us.abs() > CLOCK_US)?;
                    Some(format!("the clock is {:.0} ms off", offset / 1e3))
                },
            },
            switch!(clock_stepped, Alarm, true, "the clock has stepped"),
        ],
    },
];

/// All rules, in the order of the table: a rule's index is its bit in the flags of a packet.
pub fn rules() -> impl Iterator<Item = &'static Rule> {
    WATCHES.iter().flat_map(|watch| watch.rules)
}

/// The growth of a counter within the minute; `what` is for one and for several.
fn growth(what: &str, before: u64, now: u64) -> Option<String> {
    let grown = now.checked_sub(before).filter(|grown| *grown > 0)?;
    let (one, several) = what.split_once('|').unwrap_or((what, what));
    let what = if grown == 1 { one } else { several };
    Some(format!(
        "{grown} {what} in the last minute, {now} since the start"
    ))
}

/// Difference between cameras and gyros; `None` if nothing is compared.
pub fn gyros_against_sun(housekeeping: &Housekeeping) -> Option<String> {
    let sigmas =
        |value: Option<f32>| value.map_or("\u{2013}".into(), |value| format!("{value:.1}"));
    let [right, up, roll] = [
        housekeeping.gyro_right_sigmas,
        housekeeping.gyro_up_sigmas,
        housekeeping.gyro_roll_sigmas,
    ]
    .map(sigmas);
    (housekeeping.gyro_agreement > 0)
        .then(|| format!("Gyros against Sun: {right}, {up} sigma; roll {roll}"))
}

fn queue(waiting: u16, words: &str) -> Option<String> {
    (waiting > 1).then(|| format!("{waiting} {words}"))
}

fn fullest(housekeeping: &Housekeeping, range: std::ops::Range<u8>) -> Option<String> {
    let full = [housekeeping.disk_1, housekeeping.disk_2]
        .into_iter()
        .flatten()
        .max()?;
    range
        .contains(&full)
        .then(|| format!("a disk of the archive is {full} % full"))
}

fn without_fine(minute: &Minute) -> Option<String> {
    let (now, before) = (minute.now, minute.before);
    let taken = now.taken.checked_sub(before.taken)?;
    let [fine, coarse] = [
        now.fine.wrapping_sub(before.fine),
        now.coarse.wrapping_sub(before.coarse),
    ];
    if taken == 0 || fine > 0 {
        return None;
    }
    let of_stages = stopped(now).into_iter().zip(stopped(before));
    let most = of_stages
        .map(|((stage, now), (_, before))| (now.wrapping_sub(before), stage))
        .max_by_key(|(grown, _)| *grown)
        .filter(|(grown, _)| *grown > 0);
    let stage = most.map_or(String::new(), |(_, stage)| {
        format!("; most stopped at {stage}")
    });
    let frames = counted(taken.into(), "frame");
    Some(match coarse {
        0 => format!("no Sun in {frames} of the last minute{stage}"),
        coarse => format!("{coarse} of {frames} of the last minute coarse, none fine{stage}"),
    })
}

/// The numbers of frames that stopped at each stage.
fn stopped(housekeeping: &Housekeeping) -> [(&'static str, u16); 7] {
    [
        ("levels", housekeeping.stopped_levels),
        ("limb", housekeeping.stopped_limb),
        ("marks", housekeeping.stopped_marks),
        ("identification", housekeeping.stopped_identification),
        ("registration", housekeeping.stopped_registration),
        ("aspect", housekeeping.stopped_aspect),
        ("pointing", housekeeping.stopped_pointing),
    ]
}

/// The table of `docs/flight.md`.
pub fn documentation() -> String {
    let row = |watch: &Watch| {
        let fields: Vec<String> = watch
            .fields
            .iter()
            .map(|name| format!("`{name}`"))
            .collect();
        format!(
            "| {} | {} | {} |\n",
            fields.join(", "),
            watch.good,
            watch.otherwise
        )
        .replace("|  |", "| |")
    };
    let rows: String = WATCHES.iter().map(row).collect();
    format!("| field | good | otherwise |\n|---|---|---|\n{rows}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::link::housekeeping::FIELDS;

    #[test]
    fn the_page_for_operators_has_the_table_of_the_rules() {
        let page = include_str!("../../docs/flight.md");
        assert!(page.contains(&documentation()), "{}", documentation());
    }

    #[test]
    fn every_watched_field_is_one_and_every_rule_has_a_bit_and_a_name_of_its_own() {
        let known = |name: &&str| FIELDS.iter().any(|field| field.name == *name);
        assert!(WATCHES.iter().flat_map(|watch| watch.fields).all(known));
        let names: std::collections::BTreeSet<_> = rules().map(|rule| rule.name).collect();
        assert_eq!(names.len(), rules().count());
        assert!(names.len() <= 64);
    }

    #[test]
    fn a_flight_without_faults_is_judged_good_and_each_fault_by_its_rule() {
        let good = Housekeeping {
            tracking: true,
            sending: true,
            storing: true,
            taken: 240,
            fine: 240,
            ..Housekeeping::default()
        };
        let before = Housekeeping {
            taken: 4,
            fine: 4,
            ..good.clone()
        };
        let found = |now: Housekeeping| -> Vec<String> {
            let minute = Minute {
                now: &now,
                before: &before,
            };
            rules().filter_map(|rule| (rule.found)(&minute)).collect()
        };
        assert!(found(good.clone()).is_empty());
        let lost = Housekeeping {
            lost: 3,
            ..good.clone()
        };
        let words = "3 frames lost by camera or solver in the last minute, 3 since the start";
        assert_eq!(found(lost), [words]);
        let sunless = Housekeeping {
            fine: 4,
            none: 236,
            stopped_limb: 236,
            ..good.clone()
        };
        let words = "no Sun in 236 frames of the last minute; most stopped at limb";
        assert_eq!(found(sunless), [words]);
        // The filter's doubt and a lasting contradiction are reported once.
        let contradicted = Housekeeping {
            navigation: 5,
            gyro_agreement: 3,
            gyro_right_sigmas: Some(-231.04),
            gyro_up_sigmas: Some(0.4),
            ..good.clone()
        };
        let state = "Gyros against Sun: -231.0, 0.4 sigma; roll \u{2013}";
        assert_eq!(gyros_against_sun(&contradicted).as_deref(), Some(state));
        let words = format!("{state}: they contradict each other for 10 s, one of them is wrong");
        assert_eq!(found(contradicted.clone()), [words]);
        let doubted = Housekeeping {
            gyro_agreement: 2,
            ..contradicted
        };
        let words = "frames contradict the gyros: inertial offsets are uncertain";
        assert_eq!(found(doubted), [words]);
        assert_eq!(gyros_against_sun(&good), None);
        let full = Housekeeping {
            disk_1: Some(12),
            disk_2: Some(98),
            ..good
        };
        assert_eq!(found(full), ["a disk of the archive is 98 % full"]);
    }
}
