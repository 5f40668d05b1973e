//! The committed counts, and their growth.

use crate::counts::{Instructions, WORKS};
use anyhow::{Context, bail};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Accepted growth of a count.
const MOST_GROWTH: f64 = 0.05;

/// One count: a row of the file.
#[derive(Serialize, Deserialize)]
struct Row {
    conditions: String,
    work: String,
    instructions: u64,
}

pub struct Baseline {
    path: PathBuf,
    rows: Vec<Row>,
}

impl Baseline {
    fn path() -> PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("benches/solve/baseline.csv")
    }

    pub fn empty() -> Self {
        Self {
            path: Self::path(),
            rows: Vec::new(),
        }
    }

    pub fn read() -> anyhow::Result<Self> {
        let path = Self::path();
        let rows: Result<_, csv::Error> =
            csv::Reader::from_path(&path).and_then(|mut reader| reader.deserialize().collect());
        let rows = rows.with_context(|| format!("{}", path.display()))?;
        Ok(Self { path, rows })
    }

    pub fn add(&mut self, conditions: &str, counted: &Instructions) {
        for (work, instructions) in WORKS.iter().zip(counted.0) {
            self.rows.push(Row {
                conditions: conditions.into(),
                work: work.name.into(),
                instructions,
            });
        }
    }

    pub fn write(&self) -> anyhow::Result<()> {
        let mut writer = csv::Writer::from_path(&self.path)?;
        self.rows.iter().try_for_each(|row| writer.serialize(row))?;
        writer.flush()?;
        Ok(())
    }

    /// Fails if a count has grown by more than accepted, or is not in the file.
    pub fn check(&self, conditions: &str, counted: &Instructions) -> anyhow::Result<()> {
        for (work, instructions) in WORKS.iter().zip(counted.0) {
            let known = |row: &&Row| row.conditions == conditions && row.work == work.name;
            let Some(row) = self.rows.iter().find(known) else {
                bail!(
                    "{}: no row for {conditions}, {}",
                    self.path.display(),
                    work.name
                );
            };
            let growth = instructions as f64 / row.instructions as f64 - 1.0;
            if growth > MOST_GROWTH {
                bail!(
                    "{conditions}, {}: {instructions} instructions are {:.1} % more than the {} of {}",
                    work.name,
                    1e2 * growth,
                    row.instructions,
                    self.path.display()
                );
            }
        }
        Ok(())
    }
}
