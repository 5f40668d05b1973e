//! `solaspect config`: the configuration's documents, made from the parameter table, and the check of a configuration.

use crate::config::{example, parameters_page};
use crate::preflight::{self, Options, Plan, Remark, Remarks};
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
        Action::Example => print!("{}", example()),
        Action::Parameters => print!("{}", parameters_page()),
        Action::Check { file, json } => return Ok(check(file.as_deref(), *json)),
    }
    Ok(ExitCode::SUCCESS)
}

fn check(file: Option<&Path>, as_json: bool) -> ExitCode {
    let (plan, remarks) = preflight::survey(file, &Options::default());
    match as_json {
        true => println!("{}", json(plan.as_ref(), &remarks)),
        false => print_lines(plan.as_ref(), &remarks),
    }
    match plan {
        Some(_) => ExitCode::SUCCESS,
        None => ExitCode::FAILURE,
    }
}

fn print_lines(plan: Option<&Plan>, remarks: &Remarks) {
    for remark in &remarks.list {
        println!("{remark}");
    }
    if let Some(plan) = plan {
        println!("ok: this would fly");
        for line in plan.to_string().lines() {
            println!("  {line}");
        }
    }
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
