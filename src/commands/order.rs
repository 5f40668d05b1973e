//! A command by its name, with values as text.

use super::table::{COMMANDS, CommandRow, row_named, row_of};
use super::variable::Variable;
use crate::link::control::result;
use crate::link::ground::Answered;
use crate::link::message::{MESSAGES, MessageRow, key};
use crate::link::{AspectCommand, Computer, Direction, Message, MessageError};

/// Reason why an order is invalid.
#[derive(Debug, thiserror::Error)]
pub enum OrderError {
    #[error(
        "command: expected a name or key of the command table, or one of {}; found \"{found}\"{nearest}",
        message_names()
    )]
    Unknown { found: String, nearest: String },
    #[error("{name}: expected {expected} ({}), found {found} values", .variables.join(", "))]
    Count {
        name: String,
        expected: usize,
        variables: Vec<String>,
        found: usize,
    },
    #[error("{name}, {variable}: expected {expected}, found \"{found}\"")]
    Value {
        name: String,
        variable: &'static str,
        expected: String,
        found: String,
    },
    #[error(transparent)]
    Message(#[from] MessageError),
}

/// The message of an order. Commands of the table are named by name or by key (`0x0412`), with their values in natural units; messages to the
/// aspect system are named by name.
pub fn order(name: &str, values: &[String], computer: Computer) -> Result<Message, OrderError> {
    match orderable().find(|row| row.name == name) {
        Some(message) => of_message(message, values),
        None => Ok(Message::Aspect(command(row(name)?, values, computer)?)),
    }
}

/// The messages to the aspect system; the aspect command has commands of its own.
pub fn orderable() -> impl Iterator<Item = &'static MessageRow> {
    let to_aspect = |row: &&MessageRow| row.direction == Direction::ToAspect;
    let messages = MESSAGES.iter().filter(to_aspect);
    messages.filter(|row| row.key != key::ASPECT_COMMAND)
}

fn message_names() -> String {
    let names: Vec<&str> = orderable().map(|row| row.name).collect();
    names.join(", ")
}

/// The row with this name or key.
pub fn row(name: &str) -> Result<&'static CommandRow, OrderError> {
    let by_key = || {
        let key = u16::from_str_radix(name.strip_prefix("0x")?, 16).ok()?;
        COMMANDS.iter().find(|row| row.key == key)
    };
    row_named(name).or_else(by_key).ok_or_else(|| {
        let likeness = |row: &&CommandRow| (1e3 * strsim::jaro_winkler(name, row.name)) as u32;
        let nearest = COMMANDS.iter().max_by_key(likeness);
        OrderError::Unknown {
            found: name.into(),
            nearest: nearest.map_or(String::new(), |row| {
                format!("; nearest is \"{}\"", row.name)
            }),
        }
    })
}

fn command(
    row: &CommandRow,
    values: &[String],
    computer: Computer,
) -> Result<AspectCommand, OrderError> {
    let names = row.variables.iter().map(ToString::to_string);
    count(row.name, &names.collect::<Vec<_>>(), values)?;
    let code = |(variable, text): (&Variable, &String)| {
        let value: Option<f64> = text.parse().ok();
        let code = value.and_then(|value| variable.kind.code(value));
        code.ok_or_else(|| OrderError::Value {
            name: row.name.into(),
            variable: variable.name,
            expected: variable.kind.range().into(),
            found: text.clone(),
        })
    };
    let codes: Result<Vec<u16>, _> = row.variables.iter().zip(values).map(code).collect();
    Ok(row.command(computer, &codes?)?)
}

/// A message whose numbers are each given as text.
fn of_message(row: &MessageRow, values: &[String]) -> Result<Message, OrderError> {
    let fields = row.fields();
    let names: Vec<String> = fields.iter().map(|field| field.name.into()).collect();
    count(row.name, &names, values)?;
    let mut payload = row.key.to_le_bytes().to_vec();
    for (field, text) in fields.iter().zip(values) {
        let in_range = |value: f64| {
            let range = field.range;
            range.is_none_or(|(low, high)| (low..=high).contains(&value))
        };
        let is_allowed = text.parse().is_ok_and(in_range);
        let bytes = field.number.bytes_of(text).filter(|_| is_allowed);
        payload.extend(bytes.ok_or_else(|| OrderError::Value {
            name: row.name.into(),
            variable: field.name,
            expected: field.range.map_or("a number".into(), |(low, high)| {
                format!("a number from {low} to {high}")
            }),
            found: text.clone(),
        })?);
    }
    Ok(Message::decode(&payload)?)
}

fn count(name: &str, variables: &[String], values: &[String]) -> Result<(), OrderError> {
    if variables.len() == values.len() {
        return Ok(());
    }
    Err(OrderError::Count {
        name: name.into(),
        expected: variables.len(),
        variables: variables.to_vec(),
        found: values.len(),
    })
}

impl Answered {
    /// Whether a command was executed: done, or read.
    pub fn is_done(self) -> bool {
        let reads = row_of(self.key).is_some_and(|row| row.reads.is_some());
        match reads {
            true => self.value != result::UNKNOWN,
            false => self.value == result::DONE,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::link::GpsFix;

    fn say(name: &str, values: &[&str]) -> Result<Message, String> {
        let values: Vec<String> = values.iter().map(|v| (*v).into()).collect();
        order(name, &values, Computer::One).map_err(|error| error.to_string())
    }

    fn aspect(key: u16, variables: &[u16]) -> Result<Message, String> {
        let command = AspectCommand::new(key, variables.to_vec()).unwrap();
        Ok(Message::Aspect(command))
    }

    #[test]
    fn orders_go_by_name_or_key_with_values_as_people_write_them() {
        let target = aspect(0x1412, &[(-300_i16).cast_unsigned(), 450]);
        assert_eq!(say("set_target", &["-300", "450"]), target);
        assert_eq!(say("0x0412", &["-300", "450"]), target);
        assert_eq!(say("set_clocking", &["-32.375"]), aspect(0x1621, &[0x1EFD]));
        assert_eq!(say("start_tracking", &[]), Ok(Message::StartTracking));
        let fix = GpsFix {
            latitude_deg: 34.49,
            longitude_deg: -104.25,
        };
        assert_eq!(say("gps", &["34.49", "-104.25"]), Ok(Message::Gps(fix)));
    }

    #[test]
    fn a_wrong_order_is_refused_on_one_line_that_says_what_was_expected() {
        for (name, values, words) in [
            (
                "set_targets",
                &[][..],
                &["set_targets", "\"set_target\""][..],
            ),
            (
                "set_target",
                &["1"],
                &["set_target", "expected 2", "x (i16, arcsec)"],
            ),
            (
                "set_target",
                &["1", "40000"],
                &["y", "-32768 to 32767", "40000"],
            ),
            ("store_frames", &["2"], &["1 (on) or 0 (off)", "2"]),
            ("set_twist", &["north"], &["angle", "north"]),
            ("gps", &["1", "x"], &["longitude", "x"]),
            ("gps", &["91", "0"], &["latitude", "-90 to 90", "91"]),
            (
                "moon",
                &["1", "2", "inf"],
                &["height_m", "-1000 to 2000000", "inf"],
            ),
            ("moon", &["1", "2"], &["expected 3", "height_m"]),
            ("stop_tracking", &["1"], &["expected 0"]),
        ] {
            let message = say(name, values).unwrap_err();
            for word in words {
                assert!(message.contains(word), "{message} lacks {word}");
            }
            assert!(!message.contains('\n'));
        }
    }
}
