//! Training on the demo: its faults, each with what it does, what the console shows of it, and what to do. One table, from which the
//! page's panel and the section "Training" of `docs/console.md` are made.

use super::commands::check_sender;
use super::request::{Answer, Body, Console, Failure};
use crate::demo::{Fault, Faults};
use axum::Json;
use axum::extract::State;
use axum::http::HeaderMap;
use serde::Deserialize;
use serde_json::{Value, json};

/// A fault from the operator's view.
pub struct Exercise {
    pub fault: Fault,
    pub title: &'static str,
    pub happens: &'static str,
    pub shows: &'static str,
    pub remedy: &'static str,
    /// The rules by which the console detects it.
    pub rules: &'static [&'static str],
}

pub const EXERCISES: &[Exercise] = &[
    Exercise {
        fault: Fault::CameraDead,
        title: "Camera dead",
        happens: "The pitch-yaw camera delivers no frames and reports no error. The roll camera continues.",
        shows: "Within 3 s the alarm \"no frames from a camera\": `silent_s` grows by 1 each second, `fine` does not grow, no solutions of the Sun come. After 10 s \"the \
                inertial filter coasts\": offsets by the gyros go on, with a sigma that grows. The alarm ends a minute after frames come again.",
        remedy: "Point by the gyros while their sigma allows it. Nothing is to be sent: the program searches for the camera, and sets it again when it is back. If it stays silent, have \
                 its power switched off and on.",
        rules: &["silent_s"],
    },
    Exercise {
        fault: Fault::DiskFull,
        title: "Disk full",
        happens: "Every write to the archive's disk fails, and the disk reports no free space.",
        shows: "Within 3 s the alarms \"a disk of the archive is 100 % full\" and \"refusals by a disk\", then \"frames stored on no disk\": `unstored` grows with each frame, `stored` does \
                not. Solutions go on. The first alarm ends with the fault, the others a minute later.",
        remedy: "Leave the pointing alone: nothing of it depends on the disk. Note the time: the pictures from then on are lost; the rows of the logs wait, and are written when there is \
                 space. Have files deleted, or another disk mounted.",
        rules: &["disks_full", "unstored"],
    },
    Exercise {
        fault: Fault::LineCut,
        title: "Line cut",
        happens: "Nothing passes the line between the aspect system and the controller, either way: no solutions, no housekeeping, no commands, no samples of the IMU.",
        shows: "After 5 s the alarm \"no housekeeping\", and all ages grow; a command gets no receipt. When the line is back the alarm ends, \"missing\" counts the packets that were lost, \
                and the inertial filter, which had no samples, waits for its attitude.",
        remedy: "Check the ground's own side first. Send nothing that changes the flight: without a receipt it is not known whether it was carried out. When the line is back, read what may have \
                 changed, then command again.",
        rules: &["silence"],
    },
];

/// Contents of the page's panel.
pub fn panel(faults: &Faults) -> Value {
    let exercise = |one: &Exercise| {
        json!({
            "fault": one.fault.name(),
            "title": one.title,
            "happens": one.happens,
            "shows": one.shows,
            "remedy": one.remedy,
            "rules": one.rules,
            "on": faults.is_on(one.fault),
        })
    };
    EXERCISES.iter().map(exercise).collect()
}

/// A button press.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Press {
    fault: String,
    on: bool,
}

/// Switches a fault on or off: a command like any other, but to the simulator. It is recorded in the program's log.
pub async fn switch(
    State(console): State<Console>,
    headers: HeaderMap,
    press: Body<Press>,
) -> Answer<Json<Value>> {
    check_sender(&console, &headers)?;
    let Some(faults) = &console.parts().training else {
        return Err(Failure::missing("only the demo has faults to train on"));
    };
    let Press { fault: name, on } = press.0;
    let known = Fault::ALL.into_iter().find(|fault| fault.name() == name);
    let Some(fault) = known else {
        let names = Fault::ALL.map(Fault::name).join(", ");
        return Err(Failure::bad(format!(
            "fault: expected one of {names}; found \"{name}\""
        )));
    };
    match on {
        true => faults.begin(fault),
        false => faults.end(fault),
    }
    tracing::warn!(fault = name, on, "training: a fault was switched");
    console
        .shared()
        .change(|history| history.news.training += 1);
    Ok(Json(panel(faults)))
}

/// The table of `docs/console.md`.
pub fn documentation() -> String {
    let row = |one: &Exercise| {
        let (title, happens, shows, remedy) = (one.title, one.happens, one.shows, one.remedy);
        format!("| **{title}** | {happens} | {shows} | {remedy} |\n")
    };
    let rows: String = EXERCISES.iter().map(row).collect();
    format!(
        "| fault | what happens | what the console shows | what to do |\n|---|---|---|---|\n{rows}"
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::console::rules::rules;

    #[test]
    fn the_page_for_operators_has_the_table_of_the_faults() {
        let page = include_str!("../../docs/console.md");
        assert!(page.contains(&documentation()), "{}", documentation());
    }

    #[test]
    fn every_fault_is_an_exercise_and_is_noticed_by_rules_that_there_are() {
        let faults: Vec<Fault> = EXERCISES.iter().map(|one| one.fault).collect();
        assert_eq!(faults, Fault::ALL);
        let known = |name: &&str| *name == "silence" || rules().any(|rule| rule.name == *name);
        assert!(EXERCISES.iter().flat_map(|one| one.rules).all(known));
    }
}
