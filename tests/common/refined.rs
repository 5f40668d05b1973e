//! Refining an archive with the program, and reading the results.

use solaspect::fits::{self, Table, Values};
use std::fs;
use std::path::Path;
use std::process::{Command, Output};

pub fn command(archive: &Path, out: &Path, more: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_solaspect"));
    let command_ = command.env_remove("RUST_LOG").arg("refine").arg(archive);
    command_.arg("--out").arg(out).args(more);
    command
}

pub fn refine(archive: &Path, out: &Path, more: &[&str]) -> Output {
    let output = command(archive, out, more).output().unwrap();
    let printed = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{printed}");
    output
}

pub struct Columns(pub Table);

impl Columns {
    pub fn read(out: &Path, name: &str) -> Self {
        Self::of(&out.join("aspect.fits"), name)
    }

    pub fn of(file: &Path, name: &str) -> Self {
        Self(fits::read_table(file, name).unwrap().unwrap())
    }

    pub fn values(&self, name: &str) -> &Values {
        &self
            .0
            .columns
            .iter()
            .find(|c| c.name == name)
            .unwrap()
            .values
    }

    pub fn floats(&self, name: &str) -> &[f64] {
        match self.values(name) {
            Values::Float(values) => values,
            _ => panic!("{name}"),
        }
    }

    pub fn texts(&self, name: &str) -> &[String] {
        match self.values(name) {
            Values::Text(values) => values,
            _ => panic!("{name}"),
        }
    }
}

pub fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|v| v * v).sum::<f64>() / values.len() as f64).sqrt()
}

pub fn quantile(values: &[f64], part: f64) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted[((sorted.len() - 1) as f64 * part).round() as usize]
}

pub fn temporary() -> tempfile::TempDir {
    tempfile::tempdir_in(env!("CARGO_TARGET_TMPDIR")).unwrap()
}

pub fn summary(out: &Path) -> serde_json::Value {
    serde_json::from_slice(&fs::read(out.join("summary.json")).unwrap()).unwrap()
}
