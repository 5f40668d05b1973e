//! The ground's side of the line: it sends a message and waits for the answer.

use super::control::result;
use super::message::{Message, MessageError, Messages, MoonRequest};
use super::moon::MoonAnswer;
use super::packet::{Direction, Packet, id};
use super::parser::Parser;
use super::port::{BytePort, PortError};
use super::telemetry::{CommandOutcome, Telemetry};
use std::time::{Duration, Instant};

const WRITE_TIMEOUT: Duration = Duration::from_secs(1);

/// Reason why a message was not answered.
#[derive(Debug, thiserror::Error)]
pub enum AskError {
    #[error("no {what} within {timeout:?}")]
    NoAnswer {
        what: &'static str,
        timeout: Duration,
    },
    #[error(transparent)]
    Message(#[from] MessageError),
    #[error(transparent)]
    Port(#[from] PortError),
}

/// The key and value of a result.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Answered {
    pub key: u16,
    pub value: u16,
}

impl From<CommandOutcome> for Answered {
    fn from(CommandOutcome { key, value, .. }: CommandOutcome) -> Self {
        Self { key, value }
    }
}

/// Sends an order and waits for receipt and result.
///
/// # Errors
/// [`AskError::NoAnswer`] names the missing one of the two; other errors are the port's own.
pub fn ask(
    port: &mut dyn BytePort,
    message: &Message,
    sequence: u16,
    timeout: Duration,
) -> Result<Answered, AskError> {
    let mut received = false;
    let answered = converse(port, message, sequence, timeout, |packet| {
        let Packet::Telemetry(packet) = packet else {
            return None;
        };
        match Telemetry::decode(packet) {
            Ok(Telemetry::Receipt(receipt)) if receipt.sequence == sequence => received = true,
            Ok(Telemetry::Result(result)) if result.sequence == sequence && received => {
                return Some(Answered::from(result));
            }
            _ => {}
        }
        None
    })?;
    let what = if received { "result" } else { "receipt" };
    answered.ok_or(AskError::NoAnswer { what, timeout })
}

/// Sends a request for the Moon and waits for the Moon's place, or for the result if the request is refused.
///
/// # Errors
/// As [`ask`].
pub fn ask_for_moon(
    port: &mut dyn BytePort,
    request: MoonRequest,
    sequence: u16,
    timeout: Duration,
) -> Result<Result<MoonAnswer, Answered>, AskError> {
    let message = Message::MoonRequest(request);
    let answered = converse(port, &message, sequence, timeout, |packet| match packet {
        Packet::Telemetry(packet) => match Telemetry::decode(packet) {
            Ok(Telemetry::Result(result))
                if result.sequence == sequence && result.value != result::DONE =>
            {
                Some(Err(Answered::from(result)))
            }
            _ => None,
        },
        Packet::Command(packet) => Messages::of(packet.payload())
            .filter_map(|(_, message)| message.ok()?.moon_answer())
            .find(|answer| answer.request == sequence)
            .map(Ok),
    })?;
    let what = "answer to the request for the Moon";
    answered.ok_or(AskError::NoAnswer { what, timeout })
}

/// Sends a message and listens until the expected packet comes; `None` if none comes in time.
fn converse<T>(
    port: &mut dyn BytePort,
    message: &Message,
    sequence: u16,
    timeout: Duration,
    mut is_awaited: impl FnMut(&Packet) -> Option<T>,
) -> Result<Option<T>, AskError> {
    let packet = message.packet(id::ASPECT, sequence)?;
    port.write(&packet.encode(), WRITE_TIMEOUT)?;
    let start = Instant::now();
    let mut parser = Parser::new(Direction::ToController);
    let mut buffer = [0; 2048];
    while start.elapsed() < timeout {
        let left = timeout.saturating_sub(start.elapsed());
        let count = port.read(&mut buffer, left.min(Duration::from_millis(50)))?;
        let packets = parser.feed(&buffer[..count], start.elapsed());
        if let Some(awaited) = packets.iter().find_map(&mut is_awaited) {
            return Ok(Some(awaited));
        }
    }
    Ok(None)
}
