//! `solaspect config`: prints the configuration's documents, made from the parameter table.

use crate::config::{example, parameters_page};
use clap::{Args, ValueEnum};

/// Print a commented example configuration, or the page of all parameters.
#[derive(Debug, Args)]
pub struct ConfigArgs {
    /// What to print.
    document: Document,
}

#[derive(Debug, Clone, Copy, ValueEnum)]
enum Document {
    /// A configuration file with every parameter at its default.
    Example,
    /// The page of parameters, in Markdown.
    Parameters,
}

pub fn run(args: ConfigArgs) -> anyhow::Result<()> {
    match args.document {
        Document::Example => print!("{}", example()),
        Document::Parameters => print!("{}", parameters_page()),
    }
    Ok(())
}
