//! `solaspect config`: the configuration's documents, made from the parameter table, and the check of a configuration.

use super::output::say;
use crate::config::{example, parameters_page};
use crate::plan::{Options, Plan, Remark, Remarks};
use clap::{Args, Subcommand};
use serde_json::json;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

/// Check a configuration, print a commented example of one, or the page of all parameters
#[derive(Debug, Args)]
pub struct ConfigArgs {
    #[command(subcommand)]
    action: Action,
}

#[derive(Debug, Subcommand)]
enum Action {
    /// A configuration file with every parameter at its default
    Example,
    /// The page of parameters, in Markdown
    Parameters,
    /// Every error of a configuration and of the files that it names, and what would fly
    Check {
        /// The configuration's TOML file [default: no file, the defaults]
        file: Option<PathBuf>,
        /// One JSON object instead of lines
        #[arg(long)]
        json: bool,
    },
}

pub fn run(args: &ConfigArgs) -> anyhow::Result<ExitCode> {
    match &args.action {
        Action::Example => say(example().trim_end())?,
        Action::Parameters => say(parameters_page().trim_end())?,
        Action::Check { file, json } => return check(file.as_deref(), *json),
    }
    Ok(ExitCode::SUCCESS)
}

fn check(file: Option<&Path>, as_json: bool) -> anyhow::Result<ExitCode> {
    let (plan, mut remarks) = Plan::survey(file, &Options::default());
    plan.check(&mut remarks);
    let plan = Some(plan).filter(|_| !remarks.has_errors());
    match as_json {
        true => say(json(plan.as_ref(), &remarks))?,
        false => print_lines(plan.as_ref(), &remarks)?,
    }
    Ok(match plan {
        Some(_) => ExitCode::SUCCESS,
        None => ExitCode::FAILURE,
    })
}

fn print_lines(plan: Option<&Plan>, remarks: &Remarks) -> anyhow::Result<()> {
    for remark in &remarks.list {
        say(remark)?;
    }
    if let Some(plan) = plan {
        say("ok: this would fly")?;
        for line in plan.to_string().lines() {
            say(format_args!("  {line}"))?;
        }
    }
    Ok(())
}

fn json(plan: Option<&Plan>, remarks: &Remarks) -> serde_json::Value {
    let remark = |remark: &Remark| {
        json!({
            "severity": remark.severity,
            "file": remark.what.path.display().to_string(),
            "key": remark.what.field,
            "expected": remark.what.expected,
            "found": remark.what.found,
        })
    };
    let lines =
        |plan: &Plan| -> Vec<String> { plan.to_string().lines().map(str::to_owned).collect() };
    json!({
        "ok": plan.is_some(),
        "remarks": remarks.list.iter().map(remark).collect::<Vec<_>>(),
        "would_fly": plan.map(lines),
    })
}
