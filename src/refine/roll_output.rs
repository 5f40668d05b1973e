//! Files of the roll camera's refinement: `roll.fits`, `roll.csv`, `roll.json`.

use super::output::{Counts, OutputError, write_json, write_table};
use super::roll::{ROLL, ROLL_COLUMNS, RollHistory, RollRecipe, RollRow, kind};
use crate::archive::{CONFIGURATION, INSTRUMENT};
use crate::columns;
use crate::estimation::median;
use crate::fits::zero_cards;
use crate::observe::InputSummary;
use crate::provenance::{COMMIT, PROGRAM};
use jiff::Timestamp;
use serde::Serialize;
use std::collections::BTreeMap;
use std::path::Path;

/// The summary: counts, and the inputs that the numbers depend on.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RollSummary {
    pub program: &'static str,
    /// Commit that the program was built from, where it is known.
    pub commit: Option<&'static str>,
    pub times: &'static str,
    /// SHA-256 of the effective configuration and of the camera's file.
    pub configuration_sha256: Option<String>,
    pub camera_sha256: Option<String>,
    /// SHA-256 of `roll.fits`.
    pub table_sha256: String,
    #[serde(flatten)]
    pub counts: Counts,
    #[serde(flatten)]
    pub inputs: InputSummary,
    /// Number of frames by the reason why they are not fine.
    pub remarks: BTreeMap<String, usize>,
    /// Median 1 sigma of the roll: of single frames, and smoothed.
    pub frame_sigma_deg: Option<f64>,
    pub smoothed_sigma_deg: Option<f64>,
    /// Part of the frames' sigmas that changes between frames, of roll and pitch.
    pub changing_part: [f64; 2],
}

/// Writes table, CSV and summary to a folder; `each` sees every row.
///
/// # Errors
/// If a file cannot be written or a journal cannot be read.
pub fn write_roll(
    folder: &Path,
    history: &RollHistory,
    recipe: &RollRecipe,
    mut each: impl FnMut(&RollRow),
) -> Result<RollSummary, OutputError> {
    let rows = || history.rows().map(|row| row.map_err(OutputError::from));
    let path = folder.join("roll");
    let (mut counts, mut remarks) = (Counts::default(), BTreeMap::new());
    let (mut sigmas, mut smoothed) = (Vec::new(), Vec::new());
    let table = (ROLL, ROLL_COLUMNS);
    // Zero of UNIX_S.
    let mut cards = zero_cards(Timestamp::UNIX_EPOCH);
    cards.extend(recipe.flown.cards());
    write_table(&path, &cards, table, rows, |row| {
        let flag = row.timing.flag.map(|flag| flag.to_string());
        counts.add(row.quality, row.utc(), flag.into_iter());
        let remark = row.remark();
        if !remark.is_empty() && row.copy_of.is_none() {
            *remarks.entry(kind(&remark)).or_default() += 1;
        }
        sigmas.extend(row.angles_deg().map(|[roll, _]| roll.sigma));
        smoothed.extend(row.smoothed.map(|smoothed| smoothed.roll_deg.sigma));
        each(row);
    })?;
    let summary = RollSummary {
        program: PROGRAM,
        commit: COMMIT,
        times: "UTC at mid-exposure",
        configuration_sha256: recipe.flown.sha256(CONFIGURATION),
        camera_sha256: recipe.flown.sha256(INSTRUMENT),
        table_sha256: columns::sha256(&path.with_extension("fits"))?,
        counts,
        inputs: history.inputs().clone(),
        remarks,
        frame_sigma_deg: median(&sigmas),
        smoothed_sigma_deg: median(&smoothed),
        changing_part: history.changing,
    };
    write_json(&folder.join("roll.json"), &summary)?;
    Ok(summary)
}
