//! Check of the clock.

use super::bounded::within;
use super::{Finding, Verdict};
use crate::clock::ClockStatus;
use crate::plan::Plan;
use jiff::{Timestamp, tz::Offset};
use std::process::{Command, Stdio};
use std::time::Duration;

/// Plausible years: a clock that was never set starts in 1970 or 2000.
const YEARS: std::ops::RangeInclusive<i16> = 2025..=2099;
const TIMEOUT: Duration = Duration::from_secs(2);
const HOLD_IT: &str = "start a time service (chrony with the gondola's GPS or NTP server) and wait until it holds the clock; \
                       each second that the clock is off moves the Sun by 15 arcsec";

pub(super) fn check(plan: &Plan) -> Vec<Finding> {
    let times_frames = plan.cameras.iter().any(|camera| camera.source.is_real());
    let status = ClockStatus::read().map_err(|error| error.to_string());
    let source = status.as_ref().ok().and_then(|status| status.source);
    let limit_ms = plan.config.preflight.max_clock_error_ms;
    let mut findings = judge(status, Timestamp::now(), limit_ms, times_frames);
    if source == Some("chrony") {
        findings.extend(tracking());
    }
    findings
}

/// Checks the clock: `times_frames` if this clock times the frames; then an error is more
/// than a warning. `Err` is the reason why the kernel did not answer.
pub fn judge(
    status: Result<ClockStatus, String>,
    now: Timestamp,
    limit_ms: f64,
    times_frames: bool,
) -> Vec<Finding> {
    let verdict = match times_frames {
        true => Verdict::Fail,
        false => Verdict::Warn,
    };
    let held = match status {
        Err(reason) => Finding::warn(
            "clock",
            format!("the kernel does not say how the clock is held: {reason}"),
            "make sure by other means that a time service holds it",
        ),
        Ok(status) if !status.synchronised => {
            let found = format!("free-running: {}", described(&status));
            Finding::new("clock", verdict, found, HOLD_IT)
        }
        Ok(status) if status.max_error_us > limit_ms * 1e3 => {
            let found = format!(
                "held badly: {}, the limit is {limit_ms} ms",
                described(&status)
            );
            Finding::new("clock", verdict, found, HOLD_IT)
        }
        Ok(status) => Finding::pass("clock", format!("held: {}", described(&status))),
    };
    let year = Offset::UTC.to_datetime(now).year();
    let date = match YEARS.contains(&year) {
        true => Finding::pass("date", format!("{now:.3}")),
        false => Finding::fail("date", format!("{now:.3}, which cannot be"), HOLD_IT),
    };
    vec![held, date]
}

fn described(status: &ClockStatus) -> String {
    format!(
        "off by {:.3} ms as the kernel knows, at most by {:.1} ms; {}",
        status.offset_us.abs() / 1e3,
        status.max_error_us / 1e3,
        match status.source {
            Some(source) => format!("{source} runs"),
            None => "no time service is known to run".into(),
        }
    )
}

/// Finding on chrony's source. It runs chrony's own program; without that there is no finding.
fn tracking() -> Option<Finding> {
    let ask = || {
        Command::new("chronyc")
            .args(["-c", "-n", "tracking"])
            .stdin(Stdio::null())
            .stderr(Stdio::null())
            .output()
    };
    let output = within(TIMEOUT, ask).ok()?.ok()?;
    follows(&String::from_utf8_lossy(&output.stdout))
}

/// Reads chrony's report: the id and the name or address of its source, its stratum, the time of the last measurement, the
/// remaining offset (s), ...
fn follows(report: &str) -> Option<Finding> {
    let fields: Vec<&str> = report.trim().split(',').collect();
    let [_, name, stratum, _, offset_s, ..] = fields[..] else {
        return None;
    };
    let offset_s: f64 = offset_s.parse().ok()?;
    let followed = match name {
        "" => "no source",
        name => name,
    };
    let found = format!(
        "chrony follows {followed}, stratum {stratum}, off by {:.3} ms",
        offset_s.abs() * 1e3
    );
    Some(match stratum {
        "0" => Finding::warn("time source", found, HOLD_IT),
        _ => Finding::pass("time source", found),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_chrony_follows_is_read_from_its_report() {
        let report = "47505300,GPS,1,1758477600.000000000,-0.000001234,0.000000512,0.000002000,-12.345,0.001,0.02,0.000001,0.00001,16.0,Normal\n";
        let finding = follows(report).unwrap();
        assert_eq!(finding.verdict, Verdict::Pass);
        assert_eq!(
            finding.found,
            "chrony follows GPS, stratum 1, off by 0.001 ms"
        );
        let alone = "7F7F0101,,0,0.000000000,0.000000000,0.0,0.0,0.0,0.0,0.0,1.0,1.0,0.0,Not synchronised\n";
        assert_eq!(follows(alone).unwrap().verdict, Verdict::Warn);
        assert_eq!(follows("506 Cannot talk to daemon\n"), None);
    }
}
