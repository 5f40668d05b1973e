//! Commands to the flight: composed from the command table, armed, sent once, and tracked until they are answered.

use crate::commands::OrderError;
use crate::commands::order::{self, order};
use crate::commands::words::{describe, result_in_words};
use crate::commands::{COMMANDS, CommandRow, row_of, setting};
use crate::link::control::result;
use crate::link::ground::Answered;
use crate::link::hex::hex;
use crate::link::housekeeping::FIELDS;
use crate::link::{Computer, Packet, Telemetry, id};
use jiff::{SignedDuration, Timestamp};
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, VecDeque};
use std::fs::{File, OpenOptions};
use std::io::{self, Write};
use std::path::{Path, PathBuf};

/// Time within which an armed command may be sent.
pub const ARMED: SignedDuration = SignedDuration::from_secs(30);
/// Time after which a command counts as unanswered.
const TIMEOUT: SignedDuration = SignedDuration::from_secs(5);
/// Number of rows of the log on the page.
const MOST_ROWS: usize = 1000;

/// A command as composed by a user.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Request {
    pub name: String,
    #[serde(default)]
    pub values: Vec<String>,
    #[serde(default = "first_computer")]
    pub computer: u32,
}

fn first_computer() -> u32 {
    Computer::One.number().into()
}

/// Why a command is not sent.
#[derive(Debug, thiserror::Error)]
pub enum Refusal {
    #[error(transparent)]
    Order(#[from] OrderError),
    #[error("computer: expected 1 or 2, found {0}")]
    Computer(u32),
    #[error(
        "expected a command that is armed, found none: it was sent, is older than 30 s, or another one was armed"
    )]
    NotArmed,
    #[error("{0} changes the flight: expected a second confirmation")]
    NotConfirmed(String),
    #[error("the log of commands, {}: {cause}", .path.display())]
    Log { path: PathBuf, cause: io::Error },
}

/// A command in the form that is sent.
#[derive(Debug, Clone, Serialize)]
pub struct Composed {
    #[serde(serialize_with = "as_hex")]
    pub bytes: Vec<u8>,
    pub words: String,
    pub changes_flight: bool,
    #[serde(skip)]
    sequence: u16,
    #[serde(skip)]
    text: String,
    #[serde(skip)]
    computer: Computer,
}

fn as_hex<S: serde::Serializer>(bytes: &[u8], out: S) -> Result<S::Ok, S::Error> {
    out.serialize_str(&hex(bytes))
}

fn as_number<S: serde::Serializer>(computer: &Computer, out: S) -> Result<S::Ok, S::Error> {
    out.serialize_u8(computer.number())
}

impl Request {
    /// The packet of the command, with a number from the time, like those of `solaspect link send`.
    ///
    /// # Errors
    /// If there is no such command, or if it does not accept the values.
    pub fn compose(&self, now: Timestamp) -> Result<Composed, Refusal> {
        let refused = Refusal::Computer(self.computer);
        let computer = Computer::numbered(self.computer).ok_or(refused)?;
        let message = order(&self.name, &self.values, computer)?;
        let sequence = now.as_millisecond() as u16;
        let packet = message
            .packet(id::ASPECT, sequence)
            .map_err(OrderError::from)?;
        let text = [std::slice::from_ref(&self.name), &self.values]
            .concat()
            .join(" ");
        Ok(Composed {
            bytes: packet.encode(),
            words: describe(&Packet::Command(packet)),
            changes_flight: changes_flight(&self.name),
            sequence,
            text,
            computer,
        })
    }
}

/// A row of the log: a command and its result.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct OrderRow {
    pub number: u64,
    pub utc: Timestamp,
    pub command: String,
    #[serde(serialize_with = "as_number")]
    pub computer: Computer,
    pub bytes: String,
    pub received: Option<Timestamp>,
    pub answered: Option<Timestamp>,
    pub result: Option<String>,
    pub good: Option<bool>,
    /// Further remarks.
    pub words: Option<String>,
    #[serde(skip)]
    sequence: u16,
}

impl OrderRow {
    fn is_open(&self) -> bool {
        self.good.is_none()
    }
}

/// A value that was read by a command.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Read {
    pub value: f64,
    pub time: Timestamp,
}

/// The commands of this console.
#[derive(Debug, Default)]
pub struct Orders {
    /// The armed command, with an unguessable name and the time at which it was armed.
    armed: Option<(String, Timestamp, Composed)>,
    /// The rows of the log, the latest first.
    rows: VecDeque<OrderRow>,
    number: u64,
    /// Values of reading commands, by name.
    pub read: BTreeMap<&'static str, Read>,
    log: Option<Log>,
}

/// The file with the log.
#[derive(Debug)]
struct Log {
    path: PathBuf,
    file: File,
}

/// Columns of the file: one row per event of a command.
const COLUMNS: [&str; 7] = [
    "utc", "number", "event", "computer", "command", "bytes", "words",
];

impl Orders {
    /// With a file to which the log is appended.
    ///
    /// # Errors
    /// If it cannot be opened or written.
    pub fn logged(path: &Path) -> Result<Self, Refusal> {
        let failed = |cause| Refusal::Log {
            path: path.into(),
            cause,
        };
        let mut file = OpenOptions::new()
            .create(true)
            .append(true)
            .open(path)
            .map_err(failed)?;
        if file.metadata().map_err(failed)?.len() == 0 {
            writeln!(file, "{}", COLUMNS.join(",")).map_err(failed)?;
        }
        let path = path.into();
        Ok(Self {
            log: Some(Log { path, file }),
            ..Self::default()
        })
    }

    /// Arms a command under a name, replacing any armed command.
    pub fn arm(&mut self, name: String, composed: Composed, now: Timestamp) {
        self.armed = Some((name, now, composed));
    }

    /// Takes the armed command for sending and writes it to the log first: a command that cannot be logged is not sent.
    ///
    /// # Errors
    /// If none is armed under this name, if it was not confirmed, or if the log cannot be written.
    pub fn release(
        &mut self,
        name: &str,
        confirmed: bool,
        now: Timestamp,
    ) -> Result<(OrderRow, Vec<u8>), Refusal> {
        let is_it = |(armed, since, _): &mut (String, Timestamp, Composed)| {
            armed == name && now.duration_since(*since) <= ARMED
        };
        let (id, since, composed) = self.armed.take_if(is_it).ok_or(Refusal::NotArmed)?;
        if composed.changes_flight && !confirmed {
            let refusal = Refusal::NotConfirmed(composed.text.clone());
            self.armed = Some((id, since, composed));
            return Err(refusal);
        }
        self.number += 1;
        let row = OrderRow {
            number: self.number,
            utc: now,
            command: composed.text,
            computer: composed.computer,
            bytes: hex(&composed.bytes),
            received: None,
            answered: None,
            result: None,
            good: None,
            words: None,
            sequence: composed.sequence,
        };
        self.note(&row, "sent", &composed.words, now)?;
        self.rows.push_front(row.clone());
        self.rows.truncate(MOST_ROWS);
        Ok((row, composed.bytes))
    }

    /// The rows of the log, the latest first.
    pub fn rows(&self) -> impl Iterator<Item = &OrderRow> {
        self.rows.iter()
    }

    /// Processes a packet from the line; whether a row has changed.
    pub fn hear(&mut self, packet: &Packet, now: Timestamp) -> bool {
        let Packet::Telemetry(packet) = packet else {
            return false;
        };
        let (sequence, answer) = match Telemetry::decode(packet) {
            Ok(Telemetry::Receipt(receipt)) => (receipt.sequence, None),
            Ok(Telemetry::Result(result)) => (result.sequence, Some(Answered::from(result))),
            Err(_) => return false,
        };
        let recent = |row: &&mut OrderRow| row.sequence == sequence && row.is_open();
        let Some(row) = self.rows.iter_mut().find(recent) else {
            return false;
        };
        let Some(answer) = answer else {
            row.received.get_or_insert(now);
            return true;
        };
        let words = result_in_words(answer.key, answer.value);
        row.answered = Some(now);
        row.good = Some(answer.is_done());
        row.result = Some(words.clone());
        let row = row.clone();
        self.remember(answer, now);
        self.note_or_warn(&row, "answered", &words, now);
        true
    }

    fn remember(&mut self, answer: Answered, now: Timestamp) {
        let Some((row, reads)) = row_of(answer.key).and_then(|row| Some((row, row.reads?))) else {
            return;
        };
        if answer.value != result::UNKNOWN {
            let value = reads.kind.value(answer.value);
            self.read.insert(row.name, Read { value, time: now });
        }
    }

    /// Closes the unanswered rows; whether a row has changed.
    pub fn give_up(&mut self, now: Timestamp) -> bool {
        let is_due = |row: &&mut OrderRow| row.is_open() && now.duration_since(row.utc) > TIMEOUT;
        let mut due = Vec::new();
        for row in self.rows.iter_mut().filter(is_due) {
            let what = if row.received.is_some() {
                "result"
            } else {
                "receipt"
            };
            row.good = Some(false);
            row.words = Some(format!("no {what} within {} s", TIMEOUT.as_secs()));
            due.push(row.clone());
        }
        for row in &due {
            self.note_or_warn(
                row,
                "not answered",
                row.words.as_deref().unwrap_or_default(),
                now,
            );
        }
        !due.is_empty()
    }

    /// Records a command that could not be sent.
    pub fn fail(&mut self, number: u64, why: &str, now: Timestamp) {
        let Some(row) = self.rows.iter_mut().find(|row| row.number == number) else {
            return;
        };
        row.good = Some(false);
        row.words = Some(why.into());
        let row = row.clone();
        self.note_or_warn(&row, "not sent", why, now);
    }

    fn note_or_warn(&mut self, row: &OrderRow, event: &str, words: &str, now: Timestamp) {
        if let Err(error) = self.note(row, event, words, now) {
            tracing::error!(%error, "a row is missing in the log of commands");
        }
    }

    fn note(
        &mut self,
        row: &OrderRow,
        event: &str,
        words: &str,
        now: Timestamp,
    ) -> Result<(), Refusal> {
        let Some(Log { path, file }) = &mut self.log else {
            return Ok(());
        };
        let fields = [
            &format!("{now:.3}"),
            &row.number.to_string(),
            event,
            &row.computer.number().to_string(),
            &row.command,
            &row.bytes,
            words,
        ];
        let line = || -> io::Result<Vec<u8>> {
            let mut line = csv::Writer::from_writer(Vec::new());
            line.write_record(fields)?;
            line.into_inner().map_err(|error| error.into_error())
        };
        let written = line().and_then(|line| {
            file.write_all(&line)?;
            file.sync_data()
        });
        written.map_err(|cause| Refusal::Log {
            path: path.clone(),
            cause,
        })
    }
}

/// The command that reads the value set by a variable of another command.
pub fn reading(row: &CommandRow, variable: usize) -> Option<&'static CommandRow> {
    let set = row.variables.get(variable)?.settings;
    let reads = |row: &&CommandRow| row.reads.is_some_and(|reads| reads.settings == set);
    COMMANDS.iter().filter(|_| !set.is_empty()).find(reads)
}

/// The housekeeping field that shows the last value set by a variable of a command.
pub fn field_of(row: &CommandRow, variable: usize) -> Option<&'static str> {
    match row.variables.get(variable)?.settings {
        [setting::STORE_PITCH_YAW] => Some("storing"),
        [setting] => {
            // The frame's fields have the names of the first camera's parameters.
            let name = setting.key().strip_prefix("camera.")?;
            FIELDS
                .iter()
                .map(|field| field.name)
                .find(|field| *field == name)
        }
        _ => None,
    }
}

/// Whether a command changes the flight: all except reading, and requests for pictures or the Moon. An unknown one may
/// change it.
pub fn changes_flight(name: &str) -> bool {
    let of_command = |row: &CommandRow| row.action.changes_flight();
    order::row(name).map_or(name != "moon", of_command)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::link::{CommandOutcome, Receipt};

    fn request(name: &str, values: &[&str]) -> Request {
        Request {
            name: name.into(),
            values: values.iter().map(|value| (*value).into()).collect(),
            computer: 1,
        }
    }

    fn at(second: i64) -> Timestamp {
        Timestamp::from_second(1_379_786_400 + second).unwrap()
    }

    fn armed(orders: &mut Orders, name: &str, values: &[&str]) {
        let composed = request(name, values).compose(at(0)).unwrap();
        orders.arm("a".into(), composed, at(0));
    }

    fn answer(orders: &mut Orders, telemetry: Telemetry) -> bool {
        let packet = telemetry.packet(at(2)).unwrap();
        orders.hear(&Packet::Telemetry(packet), at(2))
    }

    #[test]
    fn a_command_is_sent_once_within_its_time_and_only_confirmed_where_it_changes_the_flight() {
        let mut orders = Orders::default();
        assert!(matches!(
            orders.release("a", true, at(0)),
            Err(Refusal::NotArmed)
        ));
        armed(&mut orders, "set_target", &["0", "100"]);
        assert!(matches!(
            orders.release("b", true, at(1)),
            Err(Refusal::NotArmed)
        ));
        assert!(matches!(
            orders.release("a", false, at(1)),
            Err(Refusal::NotConfirmed(_))
        ));
        let (row, bytes) = orders.release("a", true, at(1)).unwrap();
        assert_eq!(
            (row.command.as_str(), bytes.len()),
            ("set_target 0 100", 16)
        );
        assert!(matches!(
            orders.release("a", true, at(1)),
            Err(Refusal::NotArmed)
        ));
        armed(&mut orders, "get_target_x", &[]);
        assert!(matches!(
            orders.release("a", true, at(31)),
            Err(Refusal::NotArmed)
        ));
        armed(&mut orders, "get_target_x", &[]);
        assert!(
            orders.release("a", false, at(1)).is_ok(),
            "reading changes nothing"
        );
    }

    #[test]
    fn a_command_is_followed_to_its_answer_and_what_it_reads_is_known() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("log.csv");
        let mut orders = Orders::logged(&path).unwrap();
        armed(&mut orders, "get_target_x", &[]);
        let (row, _) = orders.release("a", false, at(1)).unwrap();
        let sequence = row.sequence;
        let (key, value) = (0x1A10, (-30_i16).cast_unsigned());
        assert!(!answer(
            &mut orders,
            Telemetry::Receipt(Receipt {
                sequence: sequence + 1
            })
        ));
        assert!(answer(
            &mut orders,
            Telemetry::Receipt(Receipt { sequence })
        ));
        assert!(answer(
            &mut orders,
            Telemetry::Result(CommandOutcome {
                sequence,
                key,
                value
            })
        ));
        let row = orders.rows().next().unwrap();
        assert_eq!(
            (row.good, row.result.as_deref()),
            (Some(true), Some("x -30 arcsec"))
        );
        assert_eq!(orders.read["get_target_x"].value, -30.0);
        assert!(!orders.give_up(at(60)));
        armed(&mut orders, "no_op", &[]);
        orders.release("a", false, at(3)).unwrap();
        assert!(orders.give_up(at(9)));
        let row = orders.rows().next().unwrap();
        assert_eq!(
            (row.good, row.words.as_deref()),
            (Some(false), Some("no receipt within 5 s"))
        );
        let log = std::fs::read_to_string(path).unwrap();
        let events: Vec<&str> = log
            .lines()
            .map(|line| line.split(',').nth(2).unwrap())
            .collect();
        assert_eq!(
            events,
            ["event", "sent", "answered", "sent", "not answered"]
        );
    }

    #[test]
    fn what_is_set_is_read_by_a_command_where_there_is_one() {
        let read =
            |name: &str, variable| reading(order::row(name).ok()?, variable).map(|row| row.name);
        assert_eq!(read("set_target", 1), Some("get_target_y"));
        assert_eq!(
            read("set_pitch_yaw_exposure", 0),
            Some("get_pitch_yaw_exposure")
        );
        assert_eq!(read("set_clocking", 0), Some("get_clocking"));
        assert_eq!(read("no_op", 0), None);
        assert!(!changes_flight("send_roll_picture") && !changes_flight("moon"));
        assert!(changes_flight("quit") && changes_flight("start_tracking"));
    }
}
