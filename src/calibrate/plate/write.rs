//! The calibrated instrument as TOML: the start's text with what was measured put in its place.

use super::Calibration;
use super::fit::PoseFit;
use crate::geometry::Distortion;
use crate::instrument::{Instrument, TomlError};
use jiff::Timestamp;
use std::fmt::Display;
use std::path::Path;
use toml_edit::{Array, ArrayOfTables, DocumentMut, Item, Table, Value, value};

/// The text of the start instrument with the calibration's marks, lens and mounting, and where they come from.
///
/// All else of the start stays as it is, comments too. `start_path` names the start in errors.
pub fn instrument_text(
    start_path: &Path,
    start_text: &str,
    start: &Instrument,
    calibration: &Calibration,
) -> Result<String, TomlError> {
    let mut document: DocumentMut = start_text.parse().map_err(|error: toml_edit::TomlError| {
        TomlError::new(start_path, "", "valid TOML", error.message())
    })?;
    let source = Source::of(calibration);
    let fit = &calibration.fit;
    if fit.distortion != Distortion::NONE || start.camera.distortion != Distortion::NONE {
        document["camera"]["distortion"] = Item::Table(distortion(calibration, &source));
    }
    let pose = &fit.poses[calibration.mounted_pose];
    mounting(&mut document["mounting"], pose, start, calibration, &source);
    document["plate"]["mark"] = Item::ArrayOfTables(marks(calibration));
    let calibrations = document.entry("calibration").or_insert_with(|| {
        let mut table = Table::new();
        table.set_implicit(true);
        Item::Table(table)
    });
    calibrations["plate"] = Item::Table(provenance(calibration, &source));
    Ok(document.to_string())
}

/// What stands beside every value; how many frames it rests on is said once, in `[calibration.plate]`.
const SOURCE: &str = "solaspect calibrate plate";

/// Of which day the values are.
struct Source {
    date: String,
}

impl Source {
    fn of(calibration: &Calibration) -> Self {
        // The day of the frames, so that the same frames give the same file; of frames without time, today.
        let day = calibration.last.unwrap_or_else(Timestamp::now);
        Self {
            date: day.to_string().chars().take(10).collect(),
        }
    }

    /// A value with its sigma, if it has one.
    fn entry(&self, value: impl Display, sigma: Option<String>, remark: &str) -> Item {
        let sigma = sigma.map_or(String::new(), |sigma| format!(", sigma = {sigma}"));
        let text = format!(
            "{{ value = {value}{sigma}, source = \"{SOURCE}{remark}\", date = {} }}",
            self.date
        );
        // What is not TOML here would be a number that is not finite; the reader refuses its text.
        let parsed = text.parse::<Value>();
        value_or_text(parsed, text)
    }
}

fn value_or_text(parsed: Result<Value, toml_edit::TomlError>, text: String) -> Item {
    match parsed {
        Ok(parsed) => Item::Value(parsed),
        Err(_) => value(text),
    }
}

/// Decimals that show two digits of a sigma.
fn decimals(sigma: f64) -> usize {
    match sigma > 0.0 && sigma.is_finite() {
        true => (1.0 - sigma.log10().floor()).clamp(1.0, 9.0) as usize,
        false => 6,
    }
}

fn distortion(calibration: &Calibration, source: &Source) -> Table {
    let fit = &calibration.fit;
    let ([k1, k2], [p1, p2]) = (fit.distortion.radial, fit.distortion.decentring);
    let sigma = fit.distortion_sigma;
    let centre = fit.distortion.centre;
    let term = |value: f64, sigma: f64| match sigma > 0.0 {
        true => source.entry(format!("{value:.5e}"), Some(format!("{sigma:.1e}")), ""),
        false => source.entry(0, None, "; not called for by the data"),
    };
    let mut table = Table::new();
    table["centre_px"] = source.entry(
        format!("[{}, {}]", centre.x, centre.y),
        None,
        "; held, the decentring terms move it",
    );
    table["radial_per_px2"] = term(k1, sigma[0]);
    table["radial_per_px4"] = term(k2, sigma[1]);
    table["decentring_per_px"] = match sigma[2] > 0.0 {
        true => source.entry(
            format!("[{p1:.5e}, {p2:.5e}]"),
            Some(format!("{:.1e}", sigma[2].max(sigma[3]))),
            "",
        ),
        false => source.entry("[0, 0]", None, "; not called for by the data"),
    };
    table
}

/// Scale, rotation and centre of the pose nearest to the stated one. A camera that was moved may be moved again, so that
/// after several poses the start's sigmas stand beside the fit's.
fn mounting(
    table: &mut Item,
    pose: &PoseFit,
    start: &Instrument,
    calibration: &Calibration,
    source: &Source,
) {
    let stated = &start.mounting;
    let moved = calibration.poses.len() > 1;
    let sigma = |fit: f64, stated: f64| if moved { fit.hypot(stated) } else { fit };
    let remark = if moved {
        ", the pose nearest to the stated one"
    } else {
        ""
    };
    let mut put = |key: &str, value: String, sigma: f64| {
        let digits = decimals(sigma);
        table[key] = source.entry(value, Some(format!("{sigma:.digits$}")), remark);
    };
    let scale = pose.scale_mil_per_px;
    let digits = decimals(scale.sigma);
    put(
        "scale_mil_per_px",
        format!("{:.digits$}", scale.value),
        sigma(scale.sigma, stated.scale_mil_per_px.sigma),
    );
    let rotation = pose.rotation_deg;
    let digits = decimals(rotation.sigma);
    let turns = ((stated.rotation_deg.value - rotation.value) / 360.0).round();
    put(
        "rotation_deg",
        format!("{:.digits$}", rotation.value + 360.0 * turns),
        sigma(rotation.sigma, stated.rotation_deg.sigma),
    );
    let (centre, centre_sigma) = (pose.plate_centre_px, pose.plate_centre_sigma_px);
    let digits = decimals(centre_sigma);
    put(
        "plate_centre_px",
        format!("[{:.digits$}, {:.digits$}]", centre.x, centre.y),
        sigma(centre_sigma, stated.plate_centre_sigma_px),
    );
}

fn marks(calibration: &Calibration) -> ArrayOfTables {
    const LEAST_SIGMA_MIL: f64 = 0.0001;
    // The long list stands at the file's end.
    const AFTER_ALL_ELSE: isize = 1_000_000;
    let fixed = |v: f64| format!("{v:.4}");
    let pair = |[x, y]: [f64; 2]| {
        let text = format!("[{}, {}]", fixed(x), fixed(y));
        value_or_text(text.parse::<Value>(), text)
    };
    let mut marks = ArrayOfTables::new();
    for mark in &calibration.fit.marks {
        let mut table = Table::new();
        table.set_position(Some(AFTER_ALL_ELSE));
        let id = [i64::from(mark.id.i), i64::from(mark.id.j)];
        table["id"] = value(Array::from_iter(id));
        table["position_mil"] = pair([mark.position.x, mark.position.y]);
        table["sigma_mil"] = pair(mark.sigma_mil.map(|sigma| sigma.max(LEAST_SIGMA_MIL)));
        marks.push(table);
    }
    marks
}

fn provenance(calibration: &Calibration, source: &Source) -> Table {
    let fit = &calibration.fit;
    let mut table = Table::new();
    let frames: usize = fit.poses.iter().map(|pose| pose.frames).sum();
    let whole = |n: usize| value(i64::try_from(n).unwrap_or(i64::MAX));
    table["frames"] = whole(frames);
    table["poses"] = whole(calibration.poses.len());
    table["frames_sha256"] = value(calibration.frames_sha256.as_str());
    let date = source.date.clone();
    table["date"] = value_or_text(date.parse::<Value>(), date);
    table["program"] = value(concat!("solaspect ", env!("CARGO_PKG_VERSION")));
    table["note"] = value(match fit.separation.by_data() {
        true => "the frames tell the plate's errors from the lens's distortion",
        false => {
            "the frames do not tell the plate's errors from the lens's distortion: the split rests on stated priors"
        }
    });
    table
}
