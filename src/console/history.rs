//! All data of a flight on the ground: received packets and logs, ordered by the flight's own time.

use super::housekeeping::HousekeepingRows;
use super::pictures::Partial;
use super::rules::{self, Minute, Rule, Severity};
use super::table::{Column, Nanoseconds, Steady, Table, nanoseconds, place, row_at};
use crate::link::housekeeping::ids_in_words;
use crate::link::picture::{Section, Tag};
use crate::link::{
    CommandPacket, FrameMarks, Housekeeping, Message, Messages, NoSolution, Packet, Solution,
    TelemetryPacket,
};
use jiff::Timestamp;
use std::collections::BTreeMap;

const SECOND_NS: i64 = 1_000_000_000;
/// Period over which the growth of counters is reported.
const MINUTE_NS: i64 = 60 * SECOND_NS;
/// Time without housekeeping, which is sent each second, after which it counts as missing.
pub const SILENCE_S: i64 = 5;
/// Maximum number of stored alarms.
const MOST_ALARMS: usize = 1000;
/// Maximum number of different reasons.
const MOST_REASONS: usize = 500;
const OTHER_REASONS: &str = "other reasons";
/// Maximum number of tables: a few for each camera.
pub const MOST_TABLES: usize = 64;
/// Maximum number of stored pictures, of 2.5 MB each.
const MOST_PICTURES: usize = 12;
/// Maximum number of stored packets of marks: three days of one camera.
const MOST_MARKS: usize = 1 << 18;
/// Old rows are dropped in blocks of an hour.
const PIECE_NS: i64 = 3600 * SECOND_NS;

/// Names of the tables.
pub const HOUSEKEEPING: &str = "housekeeping";
pub const RECEIVED: &str = "received";
pub const GYROS: &str = "gyros";

/// An alarm with its period.
#[derive(Debug, Clone, PartialEq)]
pub struct Alarm {
    /// The rule's name.
    pub rule: &'static str,
    pub severity: Severity,
    pub words: String,
    pub since: Nanoseconds,
    /// `None` while the condition lasts.
    pub until: Option<Nanoseconds>,
}

/// Counts of the line.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct LineCounts {
    pub packets: u64,
    pub rejected: u64,
    /// Seconds without housekeeping between seconds with it.
    pub missing: u64,
    pub doubled: u64,
    pub late: u64,
    /// Rows whose time disagrees with that of their neighbours: see [`Steady`].
    pub doubtful: u64,
    /// Total number of bytes.
    pub bytes: u64,
}

/// Counters of news by kind, which increase with every change.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct News {
    pub housekeeping: u64,
    pub solution: u64,
    pub gyros: u64,
    pub pictures: u64,
    pub frames: u64,
    pub marks: u64,
    pub orders: u64,
    pub training: u64,
}

impl News {
    /// Total number of packets.
    pub fn total(&self) -> u64 {
        let packets = self.housekeeping + self.solution + self.gyros + self.pictures + self.marks;
        packets + self.frames + self.orders + self.training
    }
}

/// A frame named in a solution log.
#[derive(Debug, Clone)]
pub struct FrameRow {
    pub time: Nanoseconds,
    /// Path under the archive's folder; empty if the picture was not stored.
    pub file: Box<str>,
    /// The folder of its camera under the archive's; empty for the first camera.
    pub camera: Box<str>,
    /// Quality in the log: fine, coarse or none.
    pub quality: &'static str,
    /// Index into [`History::reasons`].
    pub reason: Option<u16>,
}

/// The flight so far.
pub struct History {
    pub housekeeping: HousekeepingRows,
    /// Row that arrived last and was not late.
    newest: Option<usize>,
    /// Tables by name.
    pub tables: BTreeMap<String, Table>,
    pub frames: Vec<FrameRow>,
    pub reasons: Vec<String>,
    /// Pictures by the camera's number and the time of the frame.
    pub pictures: BTreeMap<(u8, Nanoseconds), Partial>,
    /// Marks with ids that do not fit into the housekeeping, by its time and the camera's number, with their time of
    /// arrival.
    marks: BTreeMap<(Nanoseconds, u16), (Nanoseconds, FrameMarks)>,
    pub alarms: Vec<Alarm>,
    pub line: LineCounts,
    pub news: News,
    /// Time of arrival of the last solution and the last offset by gyros, by the ground's clock.
    pub solution_arrived: Option<Nanoseconds>,
    pub gyros_arrived: Option<Nanoseconds>,
    /// Time at which the last frame was read from a log.
    pub frame_read: Option<Nanoseconds>,
    stated_times: Steady,
    solution_times: Steady,
    gyro_times: Steady,
    /// The last announced exposure, to which an error refers.
    announced: Option<Nanoseconds>,
    /// How long rows are kept after their arrival.
    keep: Nanoseconds,
    /// Time at which old rows were last dropped.
    forgot: Option<Nanoseconds>,
}

/// The columns of a received solution.
const SOLUTION_COLUMNS: [(&str, &str, &str); 5] = [
    ("azimuth_deg", "deg", "offset in azimuth"),
    ("elevation_deg", "deg", "offset in elevation"),
    (
        "roll_deg",
        "deg",
        "roll by the horizon, right side low positive",
    ),
    (
        "sigma_deg",
        "deg",
        "the offset's 1 sigma per axis of true angle",
    ),
    ("error_code", "", "why there is no solution, by its number"),
];
const GYRO_COLUMNS: [(&str, &str, &str); 5] = [
    ("azimuth_deg", "deg", "offset in azimuth"),
    ("elevation_deg", "deg", "offset in elevation"),
    (
        "roll_deg",
        "deg",
        "roll about the boresight, right side low positive",
    ),
    (
        "sigma_deg",
        "deg",
        "the offset's 1 sigma per axis of true angle",
    ),
    ("age_ms", "ms", "age of the last frame that it rests on"),
];

fn columns(rows: &[(&str, &str, &str)]) -> Vec<Column> {
    let column =
        |(name, unit, documentation): &(&str, &str, &str)| Column::new(name, unit, documentation);
    rows.iter().map(column).collect()
}

impl History {
    /// Rows older than `keep` are dropped.
    pub fn new(keep: std::time::Duration) -> Self {
        let tables = [
            Table::new(RECEIVED, columns(&SOLUTION_COLUMNS)),
            Table::new(GYROS, columns(&GYRO_COLUMNS)),
        ];
        Self {
            housekeeping: HousekeepingRows::default(),
            newest: None,
            tables: tables.map(|table| (table.name.clone(), table)).into(),
            frames: Vec::new(),
            reasons: Vec::new(),
            pictures: BTreeMap::new(),
            marks: BTreeMap::new(),
            alarms: Vec::new(),
            line: LineCounts::default(),
            news: News::default(),
            solution_arrived: None,
            gyros_arrived: None,
            frame_read: None,
            stated_times: Steady::default(),
            solution_times: Steady::default(),
            gyro_times: Steady::default(),
            announced: None,
            keep: i64::try_from(keep.as_nanos()).unwrap_or(i64::MAX),
            forgot: None,
        }
    }

    /// Takes in a packet that arrived at a time of the ground's clock.
    pub fn take(&mut self, packet: &Packet, arrived: Timestamp) {
        self.line.packets += 1;
        match packet {
            Packet::Command(packet) => self.take_messages(packet, nanoseconds(arrived)),
            Packet::Telemetry(packet) => self.take_telemetry(packet, nanoseconds(arrived)),
        }
    }

    fn take_messages(&mut self, packet: &CommandPacket, arrived: Nanoseconds) {
        for message in Messages::of(packet.payload()).filter_map(|(_, message)| message.ok()) {
            match message {
                Message::ExposureStart(exposure) => {
                    self.announced = Some(nanoseconds(exposure.time))
                }
                Message::Solution(solution) => {
                    let row = numbers(&solution, None);
                    self.take_solution(nanoseconds(solution.time), arrived, &row);
                }
                Message::Error(NoSolution { code }) => {
                    let row = [None, None, None, None, Some(code.into())];
                    self.take_solution(self.announced.unwrap_or(arrived), arrived, &row);
                }
                Message::Propagated(by_gyros) => {
                    let (solution, age_ms) = (by_gyros.solution, by_gyros.age_ms);
                    let row = numbers(&solution, Some(age_ms.into()));
                    self.take_gyros(nanoseconds(solution.time), arrived, &row);
                }
                _ => {}
            }
        }
    }

    fn take_solution(&mut self, time: Nanoseconds, arrived: Nanoseconds, row: &[Option<f64>]) {
        if !self.solution_times.take(time, arrived) {
            self.line.doubtful += 1;
            return;
        }
        self.push(RECEIVED, (time, arrived), row);
        self.solution_arrived = Some(arrived);
        self.news.solution += 1;
    }

    fn take_gyros(&mut self, time: Nanoseconds, arrived: Nanoseconds, row: &[Option<f64>]) {
        if !self.gyro_times.take(time, arrived) {
            self.line.doubtful += 1;
            return;
        }
        self.push(GYROS, (time, arrived), row);
        self.gyros_arrived = Some(arrived);
        self.news.gyros += 1;
    }

    fn push(
        &mut self,
        table: &str,
        (time, arrived): (Nanoseconds, Nanoseconds),
        row: &[Option<f64>],
    ) {
        if let Some(table) = self.tables.get_mut(table) {
            table.push(time, arrived, row);
        }
    }

    fn take_telemetry(&mut self, packet: &TelemetryPacket, arrived: Nanoseconds) {
        let (seconds, nanoseconds) = packet.time();
        let time = i64::from(seconds) * SECOND_NS + i64::from(nanoseconds);
        if let Some(housekeeping) = Housekeeping::decode(packet) {
            self.take_housekeeping(&housekeeping, time, arrived);
        } else if let Some(section) = Section::decode(packet) {
            self.change_picture(section.camera, (time, arrived), |picture| {
                picture.take_section(&section);
            });
        } else if let Some((camera, tag)) = Tag::decode(packet) {
            self.change_picture(camera, (time, arrived), |picture| picture.take_tag(tag));
        } else if let Ok(marks) = FrameMarks::decode(packet) {
            self.take_marks(marks, time, arrived);
        }
    }

    /// The marks belong to the housekeeping of their time, and may arrive before or after it.
    fn take_marks(&mut self, marks: FrameMarks, time: Nanoseconds, arrived: Nanoseconds) {
        self.marks.insert((time, marks.camera), (arrived, marks));
        if self.marks.len() > MOST_MARKS {
            self.marks.pop_first();
        }
        self.news.marks += 1;
    }

    /// The ids of marks that were reported in addition to the housekeeping of a time, camera by camera.
    pub fn ids_beside(&self, time: Nanoseconds) -> Option<String> {
        let beside = self.marks.range((time, 0)..=(time, u16::MAX));
        let ids = beside.map(|((_, camera), (_, marks))| {
            let ids = ids_in_words(marks.ids());
            format!("camera {camera}: {ids}").trim_end().to_owned()
        });
        let ids: Vec<String> = ids.collect();
        (!ids.is_empty()).then(|| ids.join("; "))
    }

    /// Changes the picture of a camera's frame at a time.
    fn change_picture(
        &mut self,
        camera: u8,
        (time, arrived): (Nanoseconds, Nanoseconds),
        change: impl FnOnce(&mut Partial),
    ) {
        if self.pictures.len() >= MOST_PICTURES && !self.pictures.contains_key(&(camera, time)) {
            // By arrival: a picture may state any time.
            let oldest = self.pictures.iter().min_by_key(|(_, known)| known.arrived);
            let oldest = oldest.map(|(picture, _)| *picture);
            oldest.and_then(|oldest| self.pictures.remove(&oldest));
        }
        let begun = || Partial::begun(time, arrived);
        let picture = self.pictures.entry((camera, time)).or_insert_with(begun);
        change(picture);
        picture.arrived = arrived;
        picture.version += 1;
        self.news.pictures += 1;
    }

    /// Inserts housekeeping by its time: packets may be late, or arrive twice.
    pub fn take_housekeeping(
        &mut self,
        housekeeping: &Housekeeping,
        time: Nanoseconds,
        arrived: Nanoseconds,
    ) {
        if !self.stated_times.take(time, arrived) {
            self.line.doubtful += 1;
            return;
        }
        let payload = housekeeping.payload();
        let at = place(&self.housekeeping.times, time);
        if self.housekeeping.has(at, time, &payload) {
            self.line.doubled += 1;
            return;
        }
        // After a clock was set back, rows are newer by the time since the start, but not by their own time.
        let newest = self.newest.and_then(|row| self.housekeeping.at_row(row));
        let is_late = at < self.housekeeping.times.len()
            && newest.is_some_and(|newest| housekeeping.uptime_s < newest.uptime_s);
        self.count_missing(is_late, time, arrived);
        self.housekeeping.insert(at, time, arrived, payload);
        match is_late {
            true => self.newest = self.newest.map(|row| row + usize::from(row >= at)),
            false => self.newest = Some(at),
        }
        self.judge(at, is_late);
        self.news.housekeeping += 1;
        self.drop_old(arrived);
    }

    /// Counts the seconds without housekeeping before a time; a late packet was counted before and is subtracted. A step of
    /// the clock adds none.
    fn count_missing(&mut self, is_late: bool, time: Nanoseconds, arrived: Nanoseconds) {
        if is_late {
            self.line.late += 1;
            self.line.missing = self.line.missing.saturating_sub(1);
            return;
        }
        let rows = &self.housekeeping;
        let before = |times: &[Nanoseconds], now| self.newest.map_or(now, |row| times[row]);
        let theirs = time.saturating_sub(before(&rows.times, time));
        let ours = arrived.saturating_sub(before(&rows.arrived, arrived));
        let seconds = (theirs.min(ours.saturating_add(MINUTE_NS)) + SECOND_NS / 2) / SECOND_NS;
        self.line.missing += u64::try_from(seconds - 1).unwrap_or(0);
    }

    fn judge(&mut self, row: usize, is_late: bool) {
        let (Some(now), Some(before)) = (self.housekeeping.at_row(row), self.before(row)) else {
            return;
        };
        let minute = Minute {
            now: &now,
            before: &before,
        };
        let time = self.housekeeping.times[row];
        for (bit, rule) in rules::rules().enumerate() {
            let found = (rule.found)(&minute);
            self.housekeeping.flags[row] |= u64::from(found.is_some()) << bit;
            // The findings of a late row are out of date.
            if !is_late {
                self.note_alarm(rule, found, time);
            }
        }
    }

    /// Begins, continues or ends the alarm of a rule.
    fn note_alarm(&mut self, rule: &'static Rule, found: Option<String>, time: Nanoseconds) {
        let lasts = |alarm: &&mut Alarm| alarm.rule == rule.name && alarm.until.is_none();
        match (self.alarms.iter_mut().rev().find(lasts), found) {
            (Some(alarm), Some(words)) => alarm.words = words,
            (Some(alarm), None) => alarm.until = Some(time),
            (None, Some(words)) => self.alarms.push(Alarm {
                rule: rule.name,
                severity: rule.severity,
                words,
                since: time,
                until: None,
            }),
            (None, None) => {}
        }
        if self.alarms.len() > MOST_ALARMS {
            self.alarms.remove(0);
        }
    }

    /// The housekeeping from a minute before a row, or from the start of its flight.
    fn before(&self, row: usize) -> Option<Housekeeping> {
        let times = &self.housekeeping.times;
        let mut first = row_at(times, times.get(row)? - MINUTE_NS).unwrap_or(0);
        let now = self.housekeeping.at_row(row)?;
        loop {
            let before = self.housekeeping.at_row(first)?;
            if first >= row || before.uptime_s <= now.uptime_s {
                return Some(before);
            }
            first += 1;
        }
    }

    /// Alarms by a row's rules, with their start times, the worst first.
    pub fn findings(&self, row: usize) -> Vec<Alarm> {
        let (Some(now), Some(before)) = (self.housekeeping.at_row(row), self.before(row)) else {
            return Vec::new();
        };
        let minute = Minute {
            now: &now,
            before: &before,
        };
        let rows = &self.housekeeping;
        let finding = |(bit, rule): (usize, &'static rules::Rule)| {
            if rows.flags[row] >> bit & 1 == 0 {
                return None;
            }
            let is_clear = |earlier: &usize| rows.flags[*earlier] >> bit & 1 == 0;
            let clear = (0..row).rev().find(is_clear);
            Some(Alarm {
                rule: rule.name,
                severity: rule.severity,
                words: (rule.found)(&minute)?,
                since: rows.times[clear.map_or(0, |clear| clear + 1)],
                until: None,
            })
        };
        let mut found: Vec<Alarm> = rules::rules().enumerate().filter_map(finding).collect();
        found.sort_by_key(|alarm| std::cmp::Reverse(alarm.severity));
        found
    }

    /// The first camera's last stored frame, up to a time or up to now.
    pub fn stored_frame(&self, at: Option<Nanoseconds>) -> Option<&FrameRow> {
        let time = at.unwrap_or(Nanoseconds::MAX);
        let end = self.frames.partition_point(|frame| frame.time <= time);
        let is_stored = |frame: &&FrameRow| !frame.file.is_empty() && frame.camera.is_empty();
        self.frames[..end].iter().rev().find(is_stored)
    }

    /// The picture of a camera at a time, or its last one.
    pub fn picture(&self, camera: u8, at: Option<Nanoseconds>) -> Option<&Partial> {
        let range = (camera, Nanoseconds::MIN)..=(camera, at.unwrap_or(Nanoseconds::MAX));
        self.pictures
            .range(range)
            .next_back()
            .map(|(_, picture)| picture)
    }

    /// The cameras with pictures.
    pub fn cameras(&self) -> std::collections::BTreeSet<u8> {
        self.pictures.keys().map(|(camera, _)| *camera).collect()
    }

    /// The row of housekeeping at a time, or the newest.
    pub fn row(&self, at: Option<Nanoseconds>) -> Option<usize> {
        match at {
            Some(time) => row_at(&self.housekeeping.times, time),
            None => self.newest,
        }
    }

    /// The first and the last time of any data.
    pub fn span(&self) -> Option<(Nanoseconds, Nanoseconds)> {
        let tables = self.tables.values().map(Table::times);
        let all = tables.chain([self.housekeeping.times.as_slice()]);
        let ends = all.filter_map(|times| Some((*times.first()?, *times.last()?)));
        ends.reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))
    }

    /// The index of a reason, which is added if it is new.
    pub fn reason(&mut self, words: &str) -> Option<u16> {
        if words.is_empty() {
            return None;
        }
        let place_of = |words: &str| self.reasons.iter().position(|reason| reason == words);
        let known = place_of(words).or_else(|| {
            let is_full = self.reasons.len() >= MOST_REASONS;
            is_full.then(|| place_of(OTHER_REASONS)).flatten()
        });
        let place = known.unwrap_or_else(|| {
            let is_full = self.reasons.len() >= MOST_REASONS;
            let words = if is_full { OTHER_REASONS } else { words };
            self.reasons.push(words.into());
            self.reasons.len() - 1
        });
        u16::try_from(place).ok()
    }

    /// Drops data that arrived too long ago, in blocks of an hour.
    fn drop_old(&mut self, now: Nanoseconds) {
        let before = *self.forgot.get_or_insert(now);
        if now.saturating_sub(before) < PIECE_NS {
            return;
        }
        self.forgot = Some(now);
        let oldest = now.saturating_sub(self.keep);
        let kept = self.housekeeping.forget_before(oldest);
        let place = |row: usize| kept[..row].iter().filter(|kept| **kept).count();
        self.newest = self.newest.filter(|row| kept[*row]).map(place);
        for table in self.tables.values_mut() {
            table.forget_before(oldest);
        }
        self.marks.retain(|_, (arrived, _)| *arrived >= oldest);
    }
}

fn numbers(solution: &Solution, last: Option<f64>) -> [Option<f64>; 5] {
    [
        Some(solution.azimuth_deg),
        Some(solution.elevation_deg),
        Some(solution.roll_deg),
        Some(solution.error_deg),
        last,
    ]
}
