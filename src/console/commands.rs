//! Requests concerning commands.

use super::access::{Refused, unguessable};
use super::history::History;
use super::orders::{ARMED, Orders, Request, changes_flight, field_of, reading};
use super::receive::Outgoing;
use super::request::{Answer, Body, Console, Failure};
use super::view::utc;
use crate::commands::order::orderable;
use crate::commands::{COMMANDS, CommandRow, Variable};
use crate::config::{Allowed, Parameter, parameters};
use crate::link::housekeeping::FIELDS;
use crate::link::message::MessageRow;
use crate::link::number::Field;
use axum::Json;
use axum::extract::State;
use axum::http::{HeaderMap, StatusCode};
use jiff::Timestamp;
use serde::Deserialize;
use serde_json::{Value, json};

/// The command table with the present values.
pub async fn table(State(console): State<Console>) -> Json<Value> {
    let history = console.shared().history();
    let orders = console.shared().orders();
    let rows = COMMANDS.iter().map(|row| command(row, &history, &orders));
    let rows = rows.chain(orderable().map(message));
    Json(json!({
        "computers": [1, 2],
        "commands": rows.collect::<Vec<_>>(),
        "parameters": parameters().iter().filter_map(parameter).collect::<Vec<_>>(),
    }))
}

fn command(row: &'static CommandRow, history: &History, orders: &Orders) -> Value {
    let variable = |(n, variable): (usize, &Variable)| {
        let (low, high, step) = variable.kind.limits();
        json!({
            "name": variable.name,
            "unit": variable.unit,
            "kind": variable.to_string(),
            "range": variable.kind.range(),
            "low": low,
            "high": high,
            "step": step,
            "present": present(row, n, history, orders),
            "read_by": reading(row, n).map(|row| row.name),
        })
    };
    json!({
        "name": row.name,
        "key": format!("{:#06x}", row.key),
        "documentation": row.documentation,
        "changes_flight": row.action.changes_flight(),
        "variables": row.variables.iter().enumerate().map(variable).collect::<Vec<_>>(),
        "reads": row.reads.map(|reads| json!({"name": reads.name, "unit": reads.unit})),
    })
}

/// Present value: from the housekeeping, or the value read last.
fn present(row: &CommandRow, variable: usize, history: &History, orders: &Orders) -> Option<Value> {
    let set = field_of(row, variable).and_then(|name| {
        let newest = history.row(None)?;
        let field = FIELDS.iter().find(|field| field.name == name)?;
        let value = history.housekeeping.numbers(newest..newest + 1, field.name);
        let value = value.first().filter(|value| value.is_finite())?;
        let time = utc(history.housekeeping.times[newest]);
        Some(json!({"value": value, "from": "housekeeping", "time": time}))
    });
    set.or_else(|| {
        let name = reading(row, variable)?.name;
        let read = orders.read.get(name)?;
        Some(json!({"value": read.value, "from": name, "time": format!("{:.3}", read.time)}))
    })
}

/// A command that is a message of its own.
fn message(row: &MessageRow) -> Value {
    let variable = |field: Field| {
        let range = field.range;
        // The unit is shown beside it.
        let name = field.name.strip_suffix(&format!("_{}", field.unit));
        json!({
            "name": name.unwrap_or(field.name),
            "unit": field.unit,
            "kind": "number",
            "range": range.map(|(low, high)| format!("a number from {low} to {high}")),
            "low": range.map(|(low, _)| low),
            "high": range.map(|(_, high)| high),
            "step": null,
            "present": null,
            "read_by": null,
        })
    };
    json!({
        "name": row.name,
        "key": null,
        "documentation": row.documentation,
        "changes_flight": changes_flight(row.name),
        "variables": row.fields().into_iter().map(variable).collect::<Vec<_>>(),
        "reads": null,
    })
}

/// A parameter that is set by a numbered command.
fn parameter(parameter: &Parameter) -> Option<Value> {
    let number = parameter.command?;
    let (command, low, high) = match parameter.allowed {
        Allowed::Number(low, high) => ("float", json!(low), json!(high)),
        Allowed::Whole(low, high) => ("integer", json!(low), json!(high)),
        _ => return None,
    };
    Some(json!({
        "number": number,
        "command": command,
        "key": parameter.key,
        "unit": parameter.unit,
        "low": low,
        "high": high,
        "default": parameter.default().map(|value| value.to_string()),
        "documentation": parameter.documentation,
    }))
}

pub async fn compose(request: Body<Request>) -> Answer<Json<Value>> {
    let composed = request.0.compose(Timestamp::now())?;
    Ok(Json(json!(composed)))
}

/// Checks that the sender has logged in, and that the console was started for sending.
pub fn check_sender(console: &Console, headers: &HeaderMap) -> Answer<()> {
    if !console.takes_commands() {
        let words = "this console only shows: commands need --token-file, and a line to the gondola (--gondola over UDP)";
        return Err(Failure(StatusCode::FORBIDDEN, words.into()));
    }
    match console.parts().access.is_logged_in(headers) {
        true => Ok(()),
        false => Err(Refused::Login.into()),
    }
}

pub async fn arm(
    State(console): State<Console>,
    headers: HeaderMap,
    request: Body<Request>,
) -> Answer<Json<Value>> {
    check_sender(&console, &headers)?;
    let now = Timestamp::now();
    let composed = request.0.compose(now)?;
    let name = unguessable();
    let mut answer = json!(composed);
    answer["armed"] = json!(name);
    answer["expires_s"] = json!(ARMED.as_secs());
    console.shared().orders().arm(name, composed, now);
    Ok(Json(answer))
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Release {
    armed: String,
    #[serde(default)]
    confirmed: bool,
}

pub async fn send(
    State(console): State<Console>,
    headers: HeaderMap,
    release: Body<Release>,
) -> Answer<Json<Value>> {
    check_sender(&console, &headers)?;
    let shared = console.shared();
    let Release { armed, confirmed } = release.0;
    let (row, bytes) = shared
        .orders()
        .release(&armed, confirmed, Timestamp::now())?;
    tracing::info!(
        command = row.command,
        number = row.number,
        "a command is sent"
    );
    let number = row.number;
    let to = row.computer;
    let sent = console
        .parts()
        .outbox
        .as_ref()
        .map(|outbox| outbox.try_send(Outgoing { number, to, bytes }));
    if !matches!(sent, Some(Ok(()))) {
        shared.fail_order(number, "not sent: the line takes no more");
    }
    shared.notify_of_orders(true);
    Ok(Json(json!(row)))
}

pub async fn log(State(console): State<Console>) -> Json<Value> {
    let orders = console.shared().orders();
    Json(json!({"rows": orders.rows().collect::<Vec<_>>()}))
}
