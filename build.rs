//! Gives the program, for `src/provenance.rs`, its version and the commit that it is built from, where that is known.

use std::path::Path;
use std::process::Command;

/// What goes into the program. A change there is a change of the program.
const SOURCES: [&str; 5] = ["build.rs", "Cargo.toml", "Cargo.lock", "calibration", "src"];

fn main() {
    for source in SOURCES {
        println!("cargo:rerun-if-changed={source}");
    }
    let version = env!("CARGO_PKG_VERSION");
    match commit() {
        Some(commit) => {
            println!("cargo:rustc-env=SOLASPECT_COMMIT={commit}");
            println!("cargo:rustc-env=SOLASPECT_VERSION={version} ({commit})");
        }
        None => println!("cargo:rustc-env=SOLASPECT_VERSION={version}"),
    }
}

/// The commit, with "-dirty" where sources differ from it; none outside a checkout.
fn commit() -> Option<String> {
    // Sources in a folder of another repository are not described by its commits.
    if !git(&["rev-parse", "--show-prefix"])?.is_empty() {
        return None;
    }
    // The log of HEAD grows with every commit and checkout, in a worktree, too. Cargo takes a path that is not there as
    // changed each time, and not every repository has the log.
    for name in ["logs/HEAD", "HEAD"] {
        let path = git(&["rev-parse", "--git-path", name])?;
        if Path::new(&path).exists() {
            println!("cargo:rerun-if-changed={path}");
        }
    }
    let commit = git(&["rev-parse", "--short=12", "HEAD"])?;
    let modified = git(&[&["diff", "--name-only", "HEAD", "--"], &SOURCES[..]].concat())?;
    Some(match modified.is_empty() {
        true => commit,
        false => commit + "-dirty",
    })
}

/// What git says, without the end of the line; `None` where there is no git, or no repository.
fn git(arguments: &[&str]) -> Option<String> {
    let said = Command::new("git").args(arguments).output().ok()?;
    let text = String::from_utf8(said.stdout).ok()?;
    said.status.success().then(|| text.trim_end().to_owned())
}
