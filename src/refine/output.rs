//! What a refinement leaves: `aspect.fits`, `aspect.csv`, `summary.json`. The same archive, instrument and settings give the
//! same bytes: nothing in them tells when they were made.

use super::clock_facts::ClockFacts;
use super::columns::{self, ASPECT, ASPECT_COLUMNS, ColumnRow, SMOOTHED, SMOOTHED_COLUMNS};
use super::first_pass::{FirstPass, Recipe, hash_of};
use super::flight::Flight;
use super::inputs::InputSummary;
use super::mapping::{Jump, MappingFacts, TemperatureDependence};
use crate::smoothing::FoundSwing;
use super::oddity::Oddity;
use super::radius::RadiusDependence;
use super::record::Grade;
use super::row::Row;
use crate::archive::{CONFIGURATION, Flown, INSTRUMENT};
use crate::estimation::median;
use crate::fits::{self, Card, Table};
use crate::provenance::{COMMIT, PROGRAM};
use crate::units::Measured;
use serde::Serialize;
use std::collections::BTreeMap;
use std::f64::consts::SQRT_2;
use std::fs::{self, File};
use std::io::{self, BufWriter, Write};
use std::iter;
use std::path::{Path, PathBuf};

/// A file that could not be written.
#[derive(Debug, thiserror::Error)]
#[error("{}: expected to write, found \"{cause}\"", .path.display())]
pub struct OutputError {
    path: PathBuf,
    cause: io::Error,
}

impl OutputError {
    pub(super) fn of(path: &Path, problem: &impl ToString) -> Self {
        Self {
            path: path.into(),
            cause: io::Error::other(problem.to_string()),
        }
    }
}

/// The summary: counts, and what the numbers rest on.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Summary {
    pub program: &'static str,
    /// That the program was built from, where it is known.
    pub commit: Option<&'static str>,
    pub times: &'static str,
    pub instrument: String,
    /// Of version, instrument and settings, hexadecimal.
    pub recipe_hash: String,
    pub instrument_hash: String,
    pub settings_hash: String,
    /// SHA-256 of the effective configuration and of the instrument's file.
    pub configuration_sha256: Option<String>,
    pub instrument_sha256: Option<String>,
    /// Of `aspect.fits`.
    pub table_hash: String,
    pub files: usize,
    #[serde(flatten)]
    pub inputs: InputSummary,
    pub fine: usize,
    pub coarse: usize,
    pub none: usize,
    /// Frames by themselves.
    pub own_fine: usize,
    /// Frames that showed their disc on a second look only.
    pub second_look: usize,
    pub odd: BTreeMap<String, usize>,
    pub first_utc: Option<String>,
    pub last_utc: Option<String>,
    /// Of the fine frames, per axis.
    pub median_sigma_mil: Option<f64>,
    pub median_sigma_arcsec: Option<f64>,
    pub radius_over_expected: Option<f64>,
    pub radius_by_temperature: RadiusSummary,
    pub mapping: Option<MappingSummary>,
    pub clock: ClockFacts,
    /// Random walk of the gondola's acceleration, mil/s^2 after a second.
    pub restless_mil_per_s2: Option<f64>,
    /// Swings of the gondola along the plate's x and y.
    pub swings: [Vec<SwingSummary>; 2],
}

/// A swing of the gondola.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct SwingSummary {
    pub period_s: f64,
    /// In which its amplitude falls to 1/e where nothing drives it.
    pub damping_s: f64,
    pub rms_mil: f64,
}

impl SwingSummary {
    fn of(swing: &FoundSwing) -> Self {
        Self {
            period_s: swing.period_s,
            damping_s: swing.damping_s,
            rms_mil: swing.rms,
        }
    }

    /// For people; "none found" where there is none.
    pub fn text(swings: &[Self]) -> String {
        let text = |swing: &Self| {
            let Self {
                period_s,
                damping_s,
                rms_mil,
            } = swing;
            let amplitude_mil = rms_mil * SQRT_2;
            format!(
                "{period_s:.2} s, amplitude {amplitude_mil:.2} mil, damping time {damping_s:.0} s"
            )
        };
        let all: Vec<String> = swings.iter().map(text).collect();
        match all.is_empty() {
            true => "none found".into(),
            false => all.join("; "),
        }
    }
}

/// What a degree of the camera's temperature does to the disc's radius on the plate.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct RadiusSummary {
    /// As a part of the radius: value and 1 sigma. None where there is nothing to tell it by.
    pub per_degc: Option<[f64; 2]>,
    pub determined: bool,
    /// For people: the slope, or "not determined" and why.
    pub text: String,
}

impl RadiusSummary {
    fn of(found: &RadiusDependence) -> Self {
        Self {
            per_degc: found.per_degc().map(|slope| [slope.value, slope.sigma]),
            determined: matches!(found, RadiusDependence::Linear { .. }),
            text: found.text(),
        }
    }
}

/// What is known of the flight's mapping.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct MappingSummary {
    pub wander_shift_px: f64,
    pub wander_turn_px: f64,
    /// By how much the marks' sigmas were inflated.
    pub sigmas_raised: f64,
    /// How much more likely the camera's temperature makes the marks, natural logarithm; none where no temperature is told.
    pub temperature_gain: Option<f64>,
    /// What a degree does, where the mapping follows the temperature.
    pub by_temperature: Option<ThermalSummary>,
    pub jumps: Vec<JumpSummary>,
}

/// What a degree of the camera's temperature does: value and 1 sigma.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct ThermalSummary {
    pub shift_x_px_per_degc: [f64; 2],
    pub shift_y_px_per_degc: [f64; 2],
    /// At 1000 mil from the plate's centre.
    pub stretch_px_per_degc: [f64; 2],
    pub turn_px_per_degc: [f64; 2],
}

/// A jump of the mapping.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct JumpSummary {
    /// The first frame after it.
    pub file: String,
    pub utc: Option<String>,
    pub shift_px: [f64; 2],
    pub turn_deg: f64,
}

impl JumpSummary {
    /// How far, and where, for people.
    pub fn text(&self) -> String {
        let ([x, y], turn) = (self.shift_px, self.turn_deg);
        format!("{x:.2}, {y:.2} px and {turn:.3} deg before {}", self.file)
    }
}

/// Hardly a row, or a moment of the path, takes more bytes in the tables.
const ROW_BYTES: usize = 1024;
const MOMENT_BYTES: usize = 64;

/// Writes table, CSV and summary to a folder.
///
/// # Errors
/// A file that cannot be written.
pub fn write(folder: &Path, flight: &Flight, recipe: &Recipe) -> Result<Summary, OutputError> {
    let aspect = iter::once_with(|| columns::table(ASPECT, ASPECT_COLUMNS, &flight.rows));
    let path_table =
        iter::once_with(|| columns::table(SMOOTHED, SMOOTHED_COLUMNS, &flight.smoothed_rows()));
    let expected_bytes = flight.rows.len() * ROW_BYTES + flight.path_times_s.len() * MOMENT_BYTES;
    let tables = aspect.chain(path_table);
    let path = folder.join("aspect.fits");
    let table_hash = write_tables(&path, &recipe.flown, expected_bytes, tables)?;
    whole(&folder.join("aspect.csv"), |file| {
        csv(file, ASPECT_COLUMNS, &flight.rows)
    })?;
    let summary = summary(flight, recipe, table_hash);
    whole(&folder.join("summary.json"), |file| {
        serde_json::to_writer_pretty(&mut *file, &summary)?;
        file.write_all(b"\n")
    })?;
    Ok(summary)
}

/// Writes tables as FITS, with the hashes of what was flown, and gives their own hash, hexadecimal.
pub(super) fn write_tables(
    path: &Path,
    flown: &Flown,
    expected_bytes: usize,
    tables: impl IntoIterator<Item = Table>,
) -> Result<String, OutputError> {
    let cards: Vec<Card> = flown.cards().collect();
    let bytes = fits::encode_tables(expected_bytes, &cards, tables);
    let bytes = bytes.map_err(|problem| OutputError::of(path, &problem))?;
    whole(path, |file| file.write_all(&bytes))?;
    Ok(hex(hash_of(&bytes)))
}

/// Writes a file that is whole or absent.
pub(super) fn whole(
    path: &Path,
    write: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
) -> Result<(), OutputError> {
    let unfinished = path.with_extension("part");
    let make = || {
        let mut file = BufWriter::new(File::create(&unfinished)?);
        write(&mut file)?;
        file.into_inner()?.sync_all()?;
        fs::rename(&unfinished, path)
    };
    make().map_err(|cause| OutputError {
        path: path.into(),
        cause,
    })
}

pub(super) fn csv<T>(
    file: &mut BufWriter<File>,
    columns: &[ColumnRow<T>],
    rows: &[T],
) -> io::Result<()> {
    let mut csv = csv::Writer::from_writer(file);
    csv.write_record(columns.iter().map(|column| column.name))?;
    for row in rows {
        let cells = columns.iter().map(|column| (column.value)(row));
        csv.write_record(cells.map(|cell| columns::text(&cell)))?;
    }
    csv.flush()
}

fn hex(hash: u64) -> String {
    format!("{hash:016x}")
}

fn summary(flight: &Flight, recipe: &Recipe, table_hash: String) -> Summary {
    let rows = &flight.rows;
    let count = |grade| rows.iter().filter(|row| row.quality == grade).count();
    let mut odd = BTreeMap::new();
    for oddity in rows.iter().flat_map(|row| &row.oddities) {
        *odd.entry(oddity.to_string()).or_default() += 1;
    }
    let dated = &rows[..flight.dated];
    let fine = rows.iter().filter(|row| row.is_fine());
    let sigmas = fine.filter_map(|row| Some(row.sun?.sigma()));
    let median_sigma_mil = median(sigmas.flatten());
    let arcsec_per_mil = recipe.instrument.optics.arcsec_per_mil();
    let hash = |text: String| hex(hash_of(text.as_bytes()));
    Summary {
        program: PROGRAM,
        commit: COMMIT,
        times: "UTC at mid-exposure",
        instrument: recipe.instrument.name.clone(),
        recipe_hash: hex(recipe.hash()),
        instrument_hash: hash(format!("{:?}", recipe.instrument)),
        settings_hash: hash(format!("{:?}", recipe.settings)),
        configuration_sha256: recipe.flown.sha256(CONFIGURATION),
        instrument_sha256: recipe.flown.sha256(INSTRUMENT),
        table_hash,
        files: rows.len(),
        inputs: flight.inputs.clone(),
        fine: count(Grade::Fine),
        coarse: count(Grade::Coarse),
        none: count(Grade::None),
        own_fine: rows
            .iter()
            .filter(|row| row.own.quality == Grade::Fine)
            .count(),
        second_look: rows
            .iter()
            .filter(|row| row.oddities.contains(&Oddity::SecondLook))
            .count(),
        odd,
        first_utc: dated.first().and_then(time),
        last_utc: dated.last().and_then(time),
        median_sigma_mil,
        median_sigma_arcsec: median_sigma_mil.map(|sigma| sigma * arcsec_per_mil),
        radius_over_expected: flight.radius_ratio.map(|ratio| ratio.value),
        radius_by_temperature: RadiusSummary::of(&flight.radius_by_temperature),
        mapping: flight.mapping.as_ref().map(|facts| mapping(facts, rows)),
        clock: flight.clock.clone(),
        restless_mil_per_s2: flight.path.as_ref().map(|path| path.process_noise),
        swings: flight.path.as_ref().map_or_else(Default::default, |path| {
            path.swings
                .each_ref()
                .map(|swings| swings.iter().map(SwingSummary::of).collect())
        }),
    }
}

fn mapping(facts: &MappingFacts, rows: &[Row]) -> MappingSummary {
    let jump = |jump: &Jump| JumpSummary {
        file: rows[jump.after].file.clone(),
        utc: time(&rows[jump.after]),
        shift_px: jump.shift_px.into(),
        turn_deg: jump.turn_deg,
    };
    let (temperature_gain, by_temperature) = match facts.temperature {
        TemperatureDependence::NotObservable => (None, None),
        TemperatureDependence::Insignificant { gain } => (Some(gain), None),
        TemperatureDependence::Linear { gain, px_per_degc } => {
            (Some(gain), Some(thermal(&px_per_degc)))
        }
    };
    MappingSummary {
        wander_shift_px: facts.process_noise_px[0],
        wander_turn_px: facts.process_noise_px[1],
        sigmas_raised: facts.inflation,
        temperature_gain,
        by_temperature,
        jumps: facts.jumps.iter().map(jump).collect(),
    }
}

fn thermal(px_per_degc: &[Measured; 4]) -> ThermalSummary {
    let [x, y, stretch, turn] = px_per_degc.map(|measured| [measured.value, measured.sigma]);
    ThermalSummary {
        shift_x_px_per_degc: x,
        shift_y_px_per_degc: y,
        stretch_px_per_degc: stretch,
        turn_px_per_degc: turn,
    }
}

fn time(row: &Row) -> Option<String> {
    row.utc().map(|utc| format!("{utc:.6}"))
}
