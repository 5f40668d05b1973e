//! NAV.toml with the estimates of a flight: biases of the IMU and misalignments of the cameras.

use super::revision::{Revision, number};
use crate::instrument::TomlError;
use crate::navigation::{Constant, ConstantErrors, NavigationSettings};
use crate::provenance::{COMMIT, PROGRAM};
use jiff::civil::Date;
use nalgebra::{DMatrix, Matrix3, Rotation3, Vector3};
use std::path::Path;
use toml_edit::{Array, Item, Table, Value, value};

/// Provenance of the new values.
#[derive(Debug, Clone, PartialEq)]
pub struct Source {
    /// Date of the flight, UTC; none if not known.
    pub date: Option<Date>,
    /// Description of the method, for people.
    pub text: String,
    /// Files from which the flight was read.
    pub files: Vec<String>,
}

/// The text of a NAV.toml with the filter's final biases and misalignments. Every other line stays unchanged.
///
/// # Errors
/// If the cameras of the text are no tables `[[camera]]`, or the result cannot be parsed; errors name `path`.
pub fn calibrated(
    path: &Path,
    text: &str,
    settings: &NavigationSettings,
    found: &ConstantErrors,
    source: &Source,
) -> Result<String, TomlError> {
    let mut revision = Revision::of(path, text)?;
    for (n, (constant, errors)) in found.values.iter().enumerate() {
        let sigma = found.sigma(n);
        match constant {
            Constant::AccelerometerBias => {
                revision.renew("imu", "accelerometer_bias", triad(errors, sigma));
                let sigma = number(sigma, sigma);
                revision.renew("imu", "accelerometer_bias_sigma", sigma);
            }
            Constant::GyroBias => {
                revision.renew("imu", "gyro_bias", triad(errors, sigma));
                revision.renew("imu", "gyro_bias_sigma", number(sigma, sigma));
            }
            Constant::Misalignment(camera) => {
                let camera = &settings.cameras[*camera];
                // The true direction is that of the camera's file, rotated further by the misalignment.
                let turned = Rotation3::new(*errors) * camera.body_from_camera;
                let sigma_deg = sigma.to_degrees();
                for (key, value) in [
                    ("body_from_camera", rows(turned.matrix())),
                    ("misalignment_sigma_deg", number(sigma_deg, sigma_deg)),
                ] {
                    revision.renew_named("camera", &camera.name, key, value)?;
                }
            }
        }
    }
    let signed = signature(settings, found, source, revision.sha256());
    revision.put("calibration", Item::Table(signed));
    let text = revision.text();
    NavigationSettings::parse(path, &text)?;
    Ok(text)
}

/// The table `[calibration]`.
fn signature(
    settings: &NavigationSettings,
    found: &ConstantErrors,
    source: &Source,
    sha256: &str,
) -> Table {
    let mut table = Table::new();
    let date = source.date.map(|date| date.to_string().parse::<Value>());
    if let Some(Ok(date)) = date {
        table["date"] = value(date);
    }
    table["source"] = value(&source.text);
    table["files"] = value(source.files.iter().collect::<Array>());
    table["program"] = value(PROGRAM);
    if let Some(commit) = COMMIT {
        table["commit"] = value(commit);
    }
    table["navigation_sha256"] = value(sha256);
    let constants = found.values.iter();
    let names = constants.flat_map(|(constant, _)| names(*constant, settings));
    table["states"] = value(names.collect::<Array>());
    table["covariance"] = value(lines(&found.covariance));
    table
}

/// Names of the states of an error: quantity, axis, unit.
fn names(constant: Constant, settings: &NavigationSettings) -> [String; 3] {
    let (name, unit) = match constant {
        Constant::AccelerometerBias => ("accelerometer_bias".into(), "m_s2"),
        Constant::GyroBias => ("gyro_bias".into(), "rad_s"),
        Constant::Misalignment(camera) => {
            let camera = &settings.cameras[camera].name;
            (format!("misalignment_{camera}"), "rad")
        }
    };
    ["x", "y", "z"].map(|axis| format!("{name}_{axis}_{unit}"))
}

fn triad(errors: &Vector3<f64>, sigma: f64) -> Value {
    let numbers = errors.iter().map(|error| number(*error, sigma));
    Value::Array(numbers.collect())
}

fn rows(matrix: &Matrix3<f64>) -> Value {
    let row = |n: usize| Value::Array(matrix.row(n).iter().copied().collect());
    Value::Array((0..3).map(row).collect())
}

/// A matrix, one line per row.
fn lines(matrix: &DMatrix<f64>) -> Array {
    let exact = |x: &f64| format!("{x:e}").parse().unwrap_or(Value::from(*x));
    let row = |n: usize| {
        let row: Array = matrix.row(n).iter().map(exact).collect();
        Value::Array(row).decorated("\n    ", "")
    };
    let mut lines = Array::new();
    (0..matrix.nrows()).for_each(|n| lines.push_formatted(row(n)));
    lines.set_trailing_comma(true);
    lines.set_trailing("\n");
    lines
}
