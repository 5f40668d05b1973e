//! What a refinement leaves of the roll camera: `roll.fits`, `roll.csv`, `roll.json`.

use super::super::columns::{self, ROLL, ROLL_COLUMNS};
use super::super::inputs::InputSummary;
use super::super::output::{OutputError, csv, whole, write_tables};
use super::super::record::Grade;
use super::{RollHistory, RollRecipe, RollRow};
use crate::archive::{CONFIGURATION, INSTRUMENT};
use crate::estimation::median;
use crate::provenance::{COMMIT, PROGRAM};
use serde::Serialize;
use std::collections::BTreeMap;
use std::io::Write;
use std::iter;
use std::path::Path;

/// Hardly a row takes more bytes in the table.
const ROW_BYTES: usize = 512;

/// The summary: counts, and what the numbers rest on.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RollSummary {
    pub program: &'static str,
    /// That the program was built from, where it is known.
    pub commit: Option<&'static str>,
    pub times: &'static str,
    /// SHA-256 of the effective configuration and of the camera's file.
    pub configuration_sha256: Option<String>,
    pub camera_sha256: Option<String>,
    /// Of `roll.fits`, hexadecimal.
    pub table_hash: String,
    pub files: usize,
    #[serde(flatten)]
    pub inputs: InputSummary,
    pub fine: usize,
    pub coarse: usize,
    pub none: usize,
    /// Frames by why they are not fine.
    pub remarks: BTreeMap<String, usize>,
    /// Frames by what is odd about their times.
    pub odd: BTreeMap<String, usize>,
    pub first_utc: Option<String>,
    pub last_utc: Option<String>,
    /// Median 1 sigma of the roll: of a frame by itself, and smoothed.
    pub frame_sigma_deg: Option<f64>,
    pub smoothed_sigma_deg: Option<f64>,
    /// Which part of the frames' sigmas changes from one to the next, of roll and pitch.
    pub changing_part: [f64; 2],
}

/// Writes table, CSV and summary to a folder.
///
/// # Errors
/// A file that cannot be written.
pub fn write_roll(
    folder: &Path,
    history: &RollHistory,
    recipe: &RollRecipe,
) -> Result<RollSummary, OutputError> {
    let table = iter::once_with(|| columns::table(ROLL, ROLL_COLUMNS, &history.rows));
    let expected_bytes = history.rows.len() * ROW_BYTES;
    let path = folder.join("roll.fits");
    let table_hash = write_tables(&path, &recipe.flown, expected_bytes, table)?;
    whole(&folder.join("roll.csv"), |file| {
        csv(file, ROLL_COLUMNS, &history.rows)
    })?;
    let summary = summary(history, recipe, table_hash);
    whole(&folder.join("roll.json"), |file| {
        serde_json::to_writer_pretty(&mut *file, &summary)?;
        file.write_all(b"\n")
    })?;
    Ok(summary)
}

fn summary(history: &RollHistory, recipe: &RollRecipe, table_hash: String) -> RollSummary {
    let rows = &history.rows;
    let count = |grade| rows.iter().filter(|row| row.quality == grade).count();
    let mut remarks = BTreeMap::new();
    let counted = rows.iter().filter(|row| row.copy_of.is_none());
    for remark in counted.map(RollRow::remark) {
        if !remark.is_empty() {
            *remarks.entry(kind(&remark)).or_default() += 1;
        }
    }
    let mut odd = BTreeMap::new();
    for oddity in rows.iter().filter_map(|row| row.odd_time) {
        *odd.entry(oddity.to_string()).or_default() += 1;
    }
    let dated = &rows[..history.dated];
    let time = |row: &RollRow| row.facts.utc().map(|utc| format!("{utc:.6}"));
    let own = |row: &RollRow| row.angles_deg().map(|[roll, _]| roll.sigma);
    let smoothed = |row: &RollRow| row.smoothed.map(|s| s.roll_deg.sigma);
    RollSummary {
        program: PROGRAM,
        commit: COMMIT,
        times: "UTC at mid-exposure",
        configuration_sha256: recipe.flown.sha256(CONFIGURATION),
        camera_sha256: recipe.flown.sha256(INSTRUMENT),
        table_hash,
        files: rows.len(),
        inputs: history.inputs.clone(),
        fine: count(Grade::Fine),
        coarse: count(Grade::Coarse),
        none: count(Grade::None),
        remarks,
        odd,
        first_utc: dated.first().and_then(time),
        last_utc: dated.last().and_then(time),
        frame_sigma_deg: median(rows.iter().filter_map(own)),
        smoothed_sigma_deg: median(rows.iter().filter_map(smoothed)),
        changing_part: history.changing,
    }
}

/// A remark without its numbers.
pub(super) fn kind(remark: &str) -> String {
    let kind = remark.split_once(" (measured");
    kind.map_or(remark, |(kind, _)| kind).into()
}
