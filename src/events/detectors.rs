//! DET.toml: the columns with a photon's time and position, and the mounting of each detector.

use super::good_times::Good;
use crate::fits::Problem;
use crate::instrument::TomlError;
use crate::instrument::toml_file::{parse_strict, read_text};
use crate::units::ARCSEC_PER_RAD;
use nalgebra::{Rotation2, Vector2};
use serde::Deserialize;
use std::collections::BTreeSet;
use std::path::Path;

/// Contents of DET.toml.
#[derive(Debug, Clone, PartialEq)]
pub struct Detectors {
    pub columns: PhotonColumns,
    detectors: Vec<Detector>,
}

/// Names of the columns that are read.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct PhotonColumns {
    pub time: String,
    pub x: String,
    pub y: String,
    /// `None` if a single detector without id has all photons.
    pub id: Option<String>,
}

/// Mounting of a detector, with 1 sigma of each value, per axis if it has two.
#[derive(Debug, Clone, PartialEq)]
pub struct Detector {
    id: Option<i64>,
    /// Ranges of the measured x and y, if stated.
    pub field: Option<[[f64; 2]; 2]>,
    /// The extension with its good time intervals, if stated.
    good_times: Option<String>,
    scale_arcsec: f64,
    scale_sigma_arcsec: f64,
    centre: Vector2<f64>,
    centre_sigma: f64,
    rotation: Rotation2<f64>,
    rotation_sigma_rad: f64,
    mirrored: bool,
    offset_arcsec: Vector2<f64>,
    offset_sigma_arcsec: f64,
}

/// Direction of a photon in the telescope's axes.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct FromBoresight {
    /// Position in the tangent plane of the sky at the boresight, to the right and up.
    pub right_rad: f64,
    pub up_rad: f64,
    /// Variance from the stated mounting of the detector, mean of the two axes.
    pub variance_arcsec2: f64,
}

#[derive(Deserialize)]
struct RawFile {
    #[serde(default = "time_column")]
    time_column: String,
    #[serde(default = "x_column")]
    x_column: String,
    #[serde(default = "y_column")]
    y_column: String,
    #[serde(default = "id_column")]
    id_column: String,
    #[serde(default, rename = "detector")]
    detectors: Vec<RawDetector>,
}

fn time_column() -> String {
    "TIME".into()
}

fn x_column() -> String {
    "X".into()
}

fn y_column() -> String {
    "Y".into()
}

fn id_column() -> String {
    "DET_ID".into()
}

#[derive(Deserialize)]
struct RawDetector {
    id: Option<i64>,
    field: Option<[[f64; 2]; 2]>,
    good_times: Option<String>,
    scale_arcsec: f64,
    #[serde(default)]
    scale_sigma_arcsec: f64,
    centre: [f64; 2],
    #[serde(default)]
    centre_sigma: f64,
    rotation_deg: f64,
    #[serde(default)]
    rotation_sigma_deg: f64,
    #[serde(default)]
    mirrored: bool,
    #[serde(default)]
    offset_arcsec: [f64; 2],
    #[serde(default)]
    offset_sigma_arcsec: f64,
}

const KEYS: &[&str] = &[
    "time_column",
    "x_column",
    "y_column",
    "id_column",
    "detector.id",
    "detector.field",
    "detector.good_times",
    "detector.scale_arcsec",
    "detector.scale_sigma_arcsec",
    "detector.centre",
    "detector.centre_sigma",
    "detector.rotation_deg",
    "detector.rotation_sigma_deg",
    "detector.mirrored",
    "detector.offset_arcsec",
    "detector.offset_sigma_arcsec",
];

impl Detectors {
    /// # Errors
    /// The error names the file, the field, and what was expected there.
    pub fn read(path: &Path) -> Result<Self, TomlError> {
        Self::parse(path, &read_text(path)?)
    }

    /// Parses the text of such a file; errors name `path`.
    ///
    /// # Errors
    /// Those of [`read`](Self::read).
    pub fn parse(path: &Path, text: &str) -> Result<Self, TomlError> {
        let known: Vec<String> = KEYS.iter().map(|key| (*key).into()).collect();
        let raw: RawFile = parse_strict(path, text, &known)?;
        check_ids(path, &raw.detectors)?;
        let detectors = raw.detectors.iter().enumerate();
        let detectors = detectors.map(|(n, raw)| raw.checked(path, n));
        let detectors: Vec<Detector> = detectors.collect::<Result<_, _>>()?;
        let has_ids = detectors.iter().any(|detector| detector.id.is_some());
        Ok(Self {
            columns: PhotonColumns {
                time: raw.time_column,
                x: raw.x_column,
                y: raw.y_column,
                id: has_ids.then_some(raw.id_column),
            },
            detectors,
        })
    }

    /// The detector with this id, and its index in the file; `None` if there is none.
    pub fn of_id(&self, id: Option<f64>) -> Option<(usize, &Detector)> {
        let is_it = |(_, detector): &(usize, &Detector)| detector.id.map(|id| id as f64) == id;
        self.detectors.iter().enumerate().find(is_it)
    }

    /// Detectors in the order of the file.
    pub fn iter(&self) -> impl ExactSizeIterator<Item = &Detector> {
        self.detectors.iter()
    }

    /// The ids, for messages.
    pub fn ids(&self) -> String {
        let ids = self.detectors.iter().filter_map(|detector| detector.id);
        let ids: Vec<String> = ids.map(|id| id.to_string()).collect();
        ids.join(", ")
    }
}

/// Checks the ids that assign photons to detectors: each detector has its own, and only a single one needs none.
fn check_ids(path: &Path, detectors: &[RawDetector]) -> Result<(), TomlError> {
    if detectors.is_empty() {
        let expected = "one [[detector]] or more";
        return Err(TomlError::new(path, "detector", expected, "none"));
    }
    let mut ids = BTreeSet::new();
    for (n, detector) in detectors.iter().enumerate() {
        let field = format!("detector.{n}.id");
        let expected = "an id of its own for each detector";
        match detector.id {
            Some(id) if !ids.insert(id) => {
                return Err(TomlError::new(path, field, expected, format!("{id} again")));
            }
            None if detectors.len() > 1 => {
                return Err(TomlError::new(path, field, expected, "none"));
            }
            _ => {}
        }
    }
    Ok(())
}

impl Detector {
    /// Its good times from a list: the ones that it names, or the only ones. `None` if the list has none.
    ///
    /// # Errors
    /// If none of them has the name, or there are several and it names none.
    pub fn good_times<'a>(&self, all: &'a [Good]) -> Result<Option<&'a Good>, Problem> {
        let wrong = |found: &str| {
            let names: Vec<&str> = all.iter().map(|good| good.name.as_str()).collect();
            let expected = format!(
                "the detector's table of good time intervals ({})",
                names.join(", ")
            );
            Problem::field("detector.good_times", expected, found)
        };
        match (&self.good_times, all) {
            (Some(name), all) => {
                let named = all.iter().find(|good| good.name.eq_ignore_ascii_case(name));
                named.map(Some).ok_or_else(|| wrong(&format!("\"{name}\"")))
            }
            (None, []) => Ok(None),
            (None, [one]) => Ok(Some(one)),
            (None, _) => Err(wrong("none")),
        }
    }
}

impl RawDetector {
    fn checked(&self, path: &Path, n: usize) -> Result<Detector, TomlError> {
        let wrong = |key: &str, expected, found: f64| {
            let field = format!("detector.{n}.{key}");
            Err(TomlError::new(path, field, expected, found.to_string()))
        };
        if self.scale_arcsec <= 0.0 {
            return wrong("scale_arcsec", "a number above 0", self.scale_arcsec);
        }
        for (key, sigma) in [
            ("scale_sigma_arcsec", self.scale_sigma_arcsec),
            ("centre_sigma", self.centre_sigma),
            ("rotation_sigma_deg", self.rotation_sigma_deg),
            ("offset_sigma_arcsec", self.offset_sigma_arcsec),
        ] {
            if sigma < 0.0 {
                return wrong(key, "a number from 0 on", sigma);
            }
        }
        for [low, high] in self.field.into_iter().flatten() {
            if low >= high {
                return wrong(
                    "field",
                    "[low, high] of x and of y, each low below its high",
                    low,
                );
            }
        }
        Ok(Detector {
            id: self.id,
            field: self.field,
            good_times: self.good_times.clone(),
            scale_arcsec: self.scale_arcsec,
            scale_sigma_arcsec: self.scale_sigma_arcsec,
            centre: self.centre.into(),
            centre_sigma: self.centre_sigma,
            rotation: Rotation2::new(self.rotation_deg.to_radians()),
            rotation_sigma_rad: self.rotation_sigma_deg.to_radians(),
            mirrored: self.mirrored,
            offset_arcsec: self.offset_arcsec.into(),
            offset_sigma_arcsec: self.offset_sigma_arcsec,
        })
    }
}

impl Detector {
    /// The direction of a photon measured at a position.
    pub fn locate(&self, place: Vector2<f64>) -> FromBoresight {
        let mut from_axis = place - self.centre;
        if self.mirrored {
            from_axis.y = -from_axis.y;
        }
        let arcsec = self.rotation * from_axis * self.scale_arcsec + self.offset_arcsec;
        let [right_rad, up_rad] = [arcsec.x, arcsec.y].map(|arcsec| arcsec / ARCSEC_PER_RAD);
        // An error of the scale moves a photon along its distance from the module's axis, one of the rotation across it.
        let along = from_axis.norm() * self.scale_sigma_arcsec;
        let across = from_axis.norm() * self.scale_arcsec * self.rotation_sigma_rad;
        let centre = self.scale_arcsec * self.centre_sigma;
        FromBoresight {
            right_rad,
            up_rad,
            variance_arcsec2: self.offset_sigma_arcsec.powi(2)
                + centre.powi(2)
                + (along.powi(2) + across.powi(2)) / 2.0,
        }
    }
}
