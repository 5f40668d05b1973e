//! Files of a refinement: `aspect.fits`, `aspect.csv`, `summary.json`. The same archive, instrument and settings give the
//! same bytes: the files hold no creation time.

use super::clock_facts::ClockFacts;
use super::columns::{
    ASPECT, ASPECT_COLUMNS, SMOOTHED, STABILISATION, STABILISATION_COLUMNS, smoothed_columns,
};
use super::comparison::Compared;
use super::flags::FrameFlag;
use super::history::History;
use super::mapping::{Jump, MappingFacts};
use super::radius::RadiusDependence;
use super::record::Grade;
use super::row::RefinedRow;
use super::solar_path::OnTarget;
use super::stabilisation::StabilisationRow;
use crate::archive::{CONFIGURATION, INSTRUMENT, instrument_cards, target_cards};
use crate::clock::utc_microseconds;
use crate::columns::{self, Column, Widths, whole};
use crate::estimation::median;
use crate::fits::{Card, FileError};
use crate::observe::{InputSummary, JournalError, Observer};
use crate::pointing::Roll;
use crate::pointing_history::{
    LONGEST_WORD, POINTING, POINTING_COLUMNS, PointingHistory, pointing_cards,
};
use crate::provenance::{COMMIT, PROGRAM};
use crate::smoothing::FoundSwing;
use jiff::Timestamp;
use serde::Serialize;
use std::borrow::Borrow;
use std::collections::BTreeMap;
use std::f64::consts::SQRT_2;
use std::io::Write;
use std::path::Path;

/// Why the results could not be written.
#[derive(Debug, thiserror::Error)]
pub enum OutputError {
    #[error(transparent)]
    File(#[from] FileError),
    #[error(transparent)]
    Journal(#[from] JournalError),
}

/// The summary: counts, and the inputs that the numbers depend on.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Summary {
    pub program: &'static str,
    /// Commit that the program was built from, where it is known.
    pub commit: Option<&'static str>,
    pub times: &'static str,
    pub instrument: String,
    /// Hash of version, instrument and settings, hexadecimal.
    pub recipe_hash: String,
    pub instrument_hash: String,
    pub settings_hash: String,
    /// SHA-256 of the effective configuration and of the instrument's file.
    pub configuration_sha256: Option<String>,
    pub instrument_sha256: Option<String>,
    /// SHA-256 of `aspect.fits`.
    pub table_sha256: String,
    #[serde(flatten)]
    pub counts: Counts,
    /// Frames that are fine when solved alone.
    pub own_fine: usize,
    /// Frames whose disc was found in the second pass only.
    pub second_pass: usize,
    #[serde(flatten)]
    pub inputs: InputSummary,
    /// Median 1 sigma of the fine frames, per axis.
    pub median_sigma_mil: Option<f64>,
    pub median_sigma_arcsec: Option<f64>,
    pub radius_over_expected: Option<f64>,
    pub radius_by_temperature: RadiusDependence,
    pub mapping: Option<MappingSummary>,
    pub clock: ClockFacts,
    /// Process noise of the acceleration: the square root of its spectral density.
    pub path_process_noise_mil_per_s2_5: Option<f64>,
    #[serde(flatten)]
    pub pointing: PointingFacts,
    /// Swings of the gondola along the plate's x and y.
    pub swings_mil: [Vec<FoundSwing>; 2],
}

/// Pointing facts of a flight.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct PointingFacts {
    /// Cameras compared with the attitude by gyros; none without an IMU.
    pub cameras_against_gyros: Option<Compared>,
    /// Time that the telescope was near its target; none where that is not known.
    pub on_target: Option<OnTarget>,
}

/// Frames by quality, flagged frames by reason, and their first and last time.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Counts {
    pub files: usize,
    pub fine: usize,
    pub coarse: usize,
    pub none: usize,
    pub flagged: BTreeMap<String, usize>,
    pub first_utc: Option<String>,
    pub last_utc: Option<String>,
}

impl Counts {
    /// Counts a file, in the order of time.
    pub(super) fn add(
        &mut self,
        quality: Grade,
        utc: Option<Timestamp>,
        flags: impl Iterator<Item = String>,
    ) {
        self.files += 1;
        match quality {
            Grade::Fine => self.fine += 1,
            Grade::Coarse => self.coarse += 1,
            Grade::None => self.none += 1,
        }
        for flag in flags {
            *self.flagged.entry(flag).or_default() += 1;
        }
        if let Some(utc) = utc {
            let utc = utc_microseconds(utc);
            self.first_utc.get_or_insert_with(|| utc.clone());
            self.last_utc = Some(utc);
        }
    }
}

/// The mapping of the flight, and its jumps with their frames.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MappingSummary {
    #[serde(flatten)]
    pub facts: MappingFacts,
    pub jumps: Vec<NamedJump>,
}

/// A jump of the mapping.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct NamedJump {
    /// The first frame after the jump.
    pub file: String,
    pub utc: Option<String>,
    #[serde(flatten)]
    pub jump: Jump,
}

impl NamedJump {
    /// Size, place and time of the jump, for people.
    pub fn text(&self) -> String {
        let Jump {
            shift_px: [x, y],
            turn_deg,
            ..
        } = self.jump;
        format!(
            "{x:.2}, {y:.2} px and {turn_deg:.3} deg before {}",
            self.file
        )
    }
}

/// Swings of the gondola, for people; "none found" if there are none.
pub(super) fn swings_text(swings: &[FoundSwing]) -> String {
    let text = |swing: &FoundSwing| {
        let (period_s, least_s) = (swing.period_s, swing.damping_least_s);
        let amplitude_mil = swing.rms * SQRT_2;
        let damping = match swing.damping_s {
            Some(damping_s) => {
                format!("damping time {damping_s:.0} s (longer than {least_s:.0} s)")
            }
            None => format!("damping not determined: longer than {least_s:.0} s"),
        };
        format!("{period_s:.2} s, amplitude {amplitude_mil:.2} mil, {damping}")
    };
    let all: Vec<String> = swings.iter().map(text).collect();
    match all.is_empty() {
        true => "none found".into(),
        false => all.join("; "),
    }
}

/// Counts of the rows for the summary.
#[derive(Default)]
struct Tally {
    counts: Counts,
    own_fine: usize,
    second_pass: usize,
    /// 1 sigma of the fine frames, per axis.
    sigmas_mil: Vec<[f64; 2]>,
}

impl Tally {
    fn add(&mut self, row: &RefinedRow) {
        self.counts.add(row.quality, row.utc(), row.flags());
        self.own_fine += usize::from(row.own_quality() == Grade::Fine);
        self.second_pass += usize::from(row.flags.contains(FrameFlag::SecondPass));
        let fine = row.sun.filter(|_| row.is_fine());
        self.sigmas_mil.extend(fine.map(|sun| sun.sigma()));
    }
}

/// Facts of the rows once `aspect.csv` is written.
pub struct Written {
    tally: Tally,
    widths: Widths,
}

/// Writes `aspect.csv` to a folder; `each` sees every row.
///
/// # Errors
/// If a file cannot be written or a journal cannot be read.
pub fn write_rows(
    folder: &Path,
    history: &History,
    mut each: impl FnMut(&RefinedRow),
) -> Result<Written, OutputError> {
    let mut tally = Tally::default();
    let seen = history.rows().map(|row| {
        let row = row?;
        tally.add(&row);
        each(&row);
        Ok::<_, OutputError>(row)
    });
    let widths = columns::write_csv(&folder.join("aspect.csv"), ASPECT_COLUMNS, seen)?;
    Ok(Written { tally, widths })
}

/// Writes `aspect.fits`, with the pointing table at `rate_hz`, `pointing.fits` and the summary to the same folder.
///
/// # Errors
/// As [`write_rows`].
pub fn write(
    folder: &Path,
    history: &History,
    written: Written,
    facts: PointingFacts,
    pointing: &PointingHistory,
    rate_hz: f64,
) -> Result<Summary, OutputError> {
    let fits = folder.join("aspect.fits");
    let cards = cards(history, pointing);
    columns::write_tables(&fits, &cards, |file| {
        let rows = history.rows().map(|row| row.map_err(OutputError::from));
        columns::write_fits(file, ASPECT, ASPECT_COLUMNS, &written.widths, rows)?;
        let smoothed = smoothed_columns();
        let path = history.smoothed().map(Ok::<_, OutputError>);
        columns::write_fits(file, SMOOTHED, &smoothed, &Widths::new(&smoothed), path)?;
        let rows = pointing.rows(rate_hz).map(Ok::<_, OutputError>);
        let widths = Widths::of(POINTING_COLUMNS, LONGEST_WORD);
        columns::write_fits(file, POINTING, POINTING_COLUMNS, &widths, rows)
    })?;
    pointing.write(folder, &cards)?;
    let summary = Summary {
        pointing: facts,
        ..summary(history, written.tally, columns::sha256(&fits)?)?
    };
    write_json(&folder.join("summary.json"), &summary)?;
    Ok(summary)
}

/// Header cards of a history's tables: times, instrument, target, and the observer's position.
fn cards(history: &History, pointing: &PointingHistory) -> Vec<Card> {
    let mut cards = pointing_cards(pointing);
    cards.extend(instrument_cards(history.instrument(), Roll::Stated));
    cards.extend(target_cards(&history.sky().target));
    cards.extend(history.recipe().flown.cards());
    cards
}

/// Writes a table as `name.fits` and `name.csv`; `each` sees every row.
///
/// # Errors
/// If a file cannot be written; any error that `rows` yields.
pub(super) fn write_table<T, R: Borrow<T>, I: Iterator<Item = Result<R, OutputError>>>(
    path: &Path,
    cards: &[Card],
    (name, columns): (&str, &[Column<T>]),
    rows: impl Fn() -> I,
    mut each: impl FnMut(&T),
) -> Result<(), OutputError> {
    let seen = rows().inspect(|row| {
        if let Ok(row) = row {
            each(row.borrow());
        }
    });
    let widths = columns::write_csv(&path.with_extension("csv"), columns, seen)?;
    columns::write_tables(&path.with_extension("fits"), cards, |file| {
        columns::write_fits(file, name, columns, &widths, rows())
    })
}

/// Writes `stabilisation.fits` and `stabilisation.csv` to a folder.
///
/// # Errors
/// If a file cannot be written.
pub fn write_stabilisation(
    folder: &Path,
    rows: &[StabilisationRow],
    history: &History,
    pointing: &PointingHistory,
) -> Result<(), OutputError> {
    let table = (STABILISATION, STABILISATION_COLUMNS);
    let path = folder.join("stabilisation");
    let cards = cards(history, pointing);
    write_table(&path, &cards, table, || rows.iter().map(Ok), |_| {})
}

pub(super) fn write_json(path: &Path, value: &impl Serialize) -> Result<(), FileError> {
    whole(path, |file| {
        serde_json::to_writer_pretty(&mut *file, value)?;
        file.write_all(b"\n")
    })
}

fn summary(history: &History, tally: Tally, table_sha256: String) -> Result<Summary, JournalError> {
    let median_sigma_mil = median(tally.sigmas_mil.iter().flatten());
    let recipe = history.recipe();
    let hex = |hash: u64| format!("{hash:016x}");
    let [instrument_hash, settings_hash] = recipe.stated_hashes().map(hex);
    let arcsec_per_mil = recipe.instrument.optics.arcsec_per_mil();
    let path = history.path();
    let mapping = history.mapping().map(|facts| {
        let jumps = facts.jumps.iter().map(|jump| named(history, jump));
        Ok::<_, JournalError>(MappingSummary {
            jumps: jumps.collect::<Result<_, _>>()?,
            facts: facts.clone(),
        })
    });
    Ok(Summary {
        program: PROGRAM,
        commit: COMMIT,
        times: "UTC at mid-exposure",
        instrument: recipe.instrument.name.clone(),
        recipe_hash: hex(recipe.hash()),
        instrument_hash,
        settings_hash,
        configuration_sha256: recipe.flown.sha256(CONFIGURATION),
        instrument_sha256: recipe.flown.sha256(INSTRUMENT),
        table_sha256,
        counts: tally.counts,
        own_fine: tally.own_fine,
        second_pass: tally.second_pass,
        inputs: history.inputs().clone(),
        median_sigma_mil,
        median_sigma_arcsec: median_sigma_mil.map(|sigma| sigma * arcsec_per_mil),
        radius_over_expected: history.radius_ratio().map(|ratio| ratio.value),
        radius_by_temperature: history.radius_by_temperature,
        mapping: mapping.transpose()?,
        clock: history.clock().clone(),
        path_process_noise_mil_per_s2_5: path.map(|path| path.process_noise),
        pointing: PointingFacts::default(),
        swings_mil: path.map_or_else(Default::default, |path| path.swings.clone()),
    })
}

fn named(history: &History, jump: &Jump) -> Result<NamedJump, JournalError> {
    Ok(NamedJump {
        file: history.file(jump.after)?,
        utc: history.utc(jump.after).map(utc_microseconds),
        jump: *jump,
    })
}

#[cfg(test)]
mod tests;
