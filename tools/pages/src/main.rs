//! Writes the man pages of solaspect and its completions for bash, zsh and fish, from the command table.

use anyhow::Context;
use clap::Parser;
use clap_complete::Shell;
use solaspect::cli;
use std::fs::create_dir_all;
use std::path::{Path, PathBuf};

/// Write the man pages of solaspect and its completions for bash, zsh and fish, from the command table
#[derive(Parser)]
struct Args {
    /// The folder in which man/ and completions/ are made
    out: PathBuf,
}

fn main() -> anyhow::Result<()> {
    let out = Args::parse().out;
    write(&out).with_context(|| format!("cannot write to {}", out.display()))
}

/// Writes a page for each command to `man`, and a file for each shell to `completions`.
fn write(out: &Path) -> anyhow::Result<()> {
    let [man, completions] = ["man", "completions"].map(|name| out.join(name));
    create_dir_all(&man)?;
    create_dir_all(&completions)?;
    clap_mangen::generate_to(cli::command(), &man)?;
    for shell in [Shell::Bash, Shell::Zsh, Shell::Fish] {
        clap_complete::generate_to(shell, &mut cli::command(), "solaspect", &completions)?;
    }
    Ok(())
}
