//! Check of the controller's line: whether it can be opened, and whether packets arrive on it.

use super::Finding;
use super::bounded::within;
use crate::link::{BytePort, Direction, Parser, PortError};
use crate::plan::Plan;
use std::time::{Duration, Instant};

const CHECK: &str = "link";
/// Time limit for opening a port.
const TIMEOUT: Duration = Duration::from_secs(10);
const PLUG: &str = "plug it in, and name it in link.port as it stands in /dev/serial/by-id; the service's user must be in the group \
                    that owns it (dialout)";
const LISTEN: &str =
    "is the controller on, are receive and transmit crossed, is link.baud its speed?";

/// Counts during the listening time.
#[derive(Debug, Default, PartialEq)]
struct Received {
    packets: usize,
    refused_bytes: u64,
}

pub(super) fn check(plan: &Plan, wait: Option<Duration>) -> Finding {
    let Some((address, local)) = plan.line.clone() else {
        let found = "no port: nothing would be sent";
        return Finding::warn(CHECK, found, "set link.port");
    };
    let link = &plan.config.link;
    let (baud, port) = (link.baud, link.port.clone().unwrap_or_default());
    if let Err(refused) = link.guard() {
        let advice = format!("set {}", refused.key);
        return Finding::fail(CHECK, refused.to_string(), &advice);
    }
    let limit = TIMEOUT + wait.unwrap_or_default();
    let tried = within(limit, move || -> Result<Option<Received>, PortError> {
        let mut open = address.open(baud, local)?;
        wait.map(|wait| listen(open.as_mut(), wait)).transpose()
    });
    match (tried, wait) {
        (Err(no_answer), _) => Finding::fail(CHECK, format!("{port}: {no_answer}"), PLUG),
        (Ok(Err(error)), _) => Finding::fail(CHECK, error.to_string(), PLUG),
        (Ok(Ok(None)), _) => Finding::pass(CHECK, format!("{port} opens; it was not read")),
        (Ok(Ok(Some(received))), wait) => judge(&port, &received, wait.unwrap_or_default()),
    }
}

/// Listens until the first good packet, or for `wait`.
fn listen(port: &mut dyn BytePort, wait: Duration) -> Result<Received, PortError> {
    let mut parser = Parser::new(Direction::ToAspect);
    let mut received = Received::default();
    let mut buffer = [0; 512];
    let start = Instant::now();
    while received.packets == 0 && start.elapsed() < wait {
        let count = port.read(&mut buffer, Duration::from_millis(100))?;
        received.packets += parser.feed(&buffer[..count], start.elapsed()).len();
    }
    received.refused_bytes = parser.rejected().bytes;
    Ok(received)
}

fn judge(port: &str, received: &Received, wait: Duration) -> Finding {
    let seconds = wait.as_secs_f64();
    match received {
        Received {
            packets: 0,
            refused_bytes: 0,
        } => Finding::warn(
            CHECK,
            format!("{port} opens; nothing heard in {seconds:.0} s"),
            LISTEN,
        ),
        Received {
            packets: 0,
            refused_bytes,
        } => {
            let found = format!(
                "{port} opens; {refused_bytes} bytes in {seconds:.0} s, and no packet in them"
            );
            Finding::warn(CHECK, found, LISTEN)
        }
        _ => Finding::pass(CHECK, format!("{port} opens, and the controller speaks")),
    }
}
