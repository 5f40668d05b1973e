//! Check before the flight: of the configuration, and of all devices that it names.
//!
//! ```text
//! configuration -> Plan and Remarks -> run -> Findings: clock, sky, disks, link, cameras, polarity
//! ```
//!
//! The [plan](crate::plan) is the flight's, and so are the solvers that test a frame of each camera. Each check has a time limit, and runs on a
//! thread of its own that is abandoned if it does not return: a dead network disk or a camera that hangs is a finding, and so is a check that panics.

mod bounded;
mod calibration;
mod camera;
mod clock;
mod disks;
mod finding;
mod gps;
mod link;
mod navigation;
mod polarity;
mod sky;

pub use clock::judge as judge_clock;
pub use disks::{Demand, check_folder};
pub use finding::{Finding, Verdict};
pub use polarity::{Axis, Motion, Operator, Trend};

use crate::plan::{Options, Plan, Remark, Severity};
use std::path::Path;
use std::time::Duration;

/// Keys that the checks before a flight report in more detail.
const CHECKED_LATER: [&str; 4] = [
    "archive.directory",
    "archive.second_directory",
    "link.port",
    "site",
];

/// Whether another line of the page will report the same.
fn is_checked_later(remark: &Remark) -> bool {
    let key = remark.what.field.as_str();
    remark.severity == Severity::Warning && CHECKED_LATER.contains(&key)
}

impl From<&Remark> for Finding {
    fn from(remark: &Remark) -> Self {
        let what = remark.what.to_string();
        match remark.severity {
            Severity::Error => Self::fail("configuration", what, remark.remedy),
            Severity::Warning => Self::warn("configuration", what, remark.remedy),
        }
    }
}

/// Extent of the check.
#[derive(Default)]
pub struct Extent<'a> {
    /// How long the controller is waited for; `None` if only the port is opened.
    pub wait_for_controller: Option<Duration>,
    /// Operator who slews the telescope for the polarity test; `None` if it is not made.
    pub operator: Option<&'a mut dyn Operator>,
}

/// Makes every check of a configuration (the defaults without a file), in order. `report` gets each finding as it is
/// made. If the configuration has errors, clock, disks and line are checked as far as it names them.
pub fn run(
    file: Option<&Path>,
    options: &Options,
    extent: Extent,
    report: &mut dyn FnMut(Finding),
) {
    let (plan, mut remarks) = Plan::survey(file, options);
    plan.check(&mut remarks);
    let news = remarks.list.iter().filter(|one| !is_checked_later(one));
    news.map(Finding::from).for_each(&mut *report);
    if remarks.has_errors() {
        check_in_part(&plan, extent.wait_for_controller, report);
    } else {
        check(&plan, extent, report);
    }
}

/// Checks that are possible with errors in the configuration: its other parts may be wrong.
fn check_in_part(plan: &Plan, wait: Option<Duration>, report: &mut dyn FnMut(Finding)) {
    clock::check(plan).into_iter().for_each(&mut *report);
    if !plan.folders().is_empty() {
        disks::check(plan).into_iter().for_each(&mut *report);
    }
    if plan.line.is_some() {
        report(link::check(plan, wait));
    }
}

fn check(plan: &Plan, extent: Extent, report: &mut dyn FnMut(Finding)) {
    clock::check(plan).into_iter().for_each(&mut *report);
    sky::check(plan).into_iter().for_each(&mut *report);
    disks::check(plan).into_iter().for_each(&mut *report);
    report(link::check(plan, extent.wait_for_controller));
    for camera in &plan.cameras {
        calibration::check(plan, camera)
            .into_iter()
            .for_each(&mut *report);
        camera::check(plan, camera)
            .into_iter()
            .for_each(&mut *report);
    }
    navigation::check(plan).into_iter().for_each(&mut *report);
    if let Some(operator) = extent.operator {
        polarity::check(plan, operator)
            .into_iter()
            .for_each(&mut *report);
        navigation::check_axes(plan, operator)
            .into_iter()
            .for_each(&mut *report);
    }
}
