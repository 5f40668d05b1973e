//! `solaspect preflight`: one page of findings, ready to fly or not.

use super::options::{self, ConfigurationArgs};
use super::output::say;
use crate::log;
use crate::preflight::{self, Extent, Finding, Operator, Verdict};
use crate::units::counted;
use clap::Args;
use crossbeam_channel::{Receiver, bounded};
use serde_json::json;
use std::io::{BufRead, IsTerminal};
use std::process::ExitCode;
use std::time::Duration;

/// Longest wait for an answer of the operator.
const OPERATOR: Duration = Duration::from_secs(600);

/// Check before a flight that clock, disks, line and cameras work as configured
#[derive(Debug, Args)]
pub struct PreflightArgs {
    #[command(flatten)]
    over: ConfigurationArgs,
    /// Wait for a packet from the controller, up to this time
    #[arg(
        long,
        value_name = "TIME",
        num_args = 0..=1,
        default_missing_value = "5s",
        value_parser = options::duration
    )]
    wait_controller: Option<Duration>,
    /// Ask for slews of the telescope and watch that the offsets follow
    #[arg(long)]
    polarity: bool,
    /// Take the answers to the polarity test from standard input though it is no terminal: an empty line for a slew that begins,
    /// "skip" for none
    #[arg(long, requires = "polarity")]
    answers: bool,
    /// One JSON object instead of the page
    #[arg(long)]
    json: bool,
}

pub fn run(args: PreflightArgs) -> anyhow::Result<ExitCode> {
    if args.polarity && !args.answers && !std::io::stdin().is_terminal() {
        anyhow::bail!("--polarity: expected a terminal to ask at, or --answers, found neither");
    }
    let options = args.over.options();
    let mut findings = Vec::new();
    let mut report = |finding: Finding| {
        if !args.json {
            // The checks continue without a reader, and the exit code gives the result.
            let _ = say(&finding);
        }
        findings.push(finding);
    };
    let mut console = args.polarity.then(Console::new);
    let extent = Extent {
        wait_for_controller: args.wait_controller,
        operator: console.as_mut().map(|console| console as &mut dyn Operator),
    };
    preflight::run(args.over.config.as_deref(), &options, extent, &mut report);
    conclude(&findings, args.json)
}

fn conclude(findings: &[Finding], as_json: bool) -> anyhow::Result<ExitCode> {
    let count = |verdict| findings.iter().filter(|f| f.verdict == verdict).count();
    let [passed, warned, failed] = [Verdict::Pass, Verdict::Warn, Verdict::Fail].map(count);
    let worst = findings.iter().map(|finding| finding.verdict).max();
    let verdict = worst.unwrap_or(Verdict::Pass);
    if as_json {
        say(json!({ "verdict": verdict, "checks": findings }))?;
    } else {
        let verdict = verdict.name();
        say(format_args!(
            "{verdict}: {passed} passed, {}, {failed} failed",
            counted(warned as u64, "warning")
        ))?;
    }
    Ok(match verdict {
        Verdict::Fail => ExitCode::FAILURE,
        Verdict::Warn | Verdict::Pass => ExitCode::SUCCESS,
    })
}

/// Asks at the terminal. Answers are read on a thread of their own, so that an absent operator does not block the rest.
struct Console {
    answers: Receiver<String>,
}

impl Console {
    fn new() -> Self {
        let (give, answers) = bounded(0);
        std::thread::spawn(move || {
            let lines = std::io::stdin().lock().lines();
            for line in lines.map_while(Result::ok) {
                if give.send(line).is_err() {
                    break;
                }
            }
        });
        Self { answers }
    }
}

impl Operator for Console {
    fn is_ready(&mut self, request: &str) -> bool {
        log::say(&format!("Press Enter (or type skip), then {request}."));
        match self.answers.recv_timeout(OPERATOR) {
            Ok(answer) => !answer.trim().eq_ignore_ascii_case("skip"),
            Err(_) => false,
        }
    }
}
