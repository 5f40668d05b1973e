//! The raw contents of an instrument's file, and the checks that turn them into an [`Instrument`].

use super::toml_file::{TomlError, Utc, keys_of, parse_strict};
use super::{Directions, Instrument, Mounting, Optics, PlateCamera, TURN_DEG};
use crate::geometry::{Distortion, Handedness};
use crate::units::{Measured, PlateMil, SensorPx};
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::Path;

mod plate;
mod sensor;

use plate::RawPlate;
pub(super) use plate::with_table;
use sensor::{RawNoise, RawThermal, RawVignetting};

/// A number with its metadata. Source and date are informative; the program uses value and sigma. A calibration from frames
/// without times has no date.
#[derive(Deserialize)]
struct Entry<T> {
    value: T,
    #[serde(default)]
    sigma: f64,
    source: String,
    #[serde(default, rename = "date")]
    _date: Option<Utc>,
}

#[derive(Deserialize)]
#[serde(rename_all = "kebab-case")]
enum RawHandedness {
    Mirrored,
    Direct,
}

#[derive(Deserialize)]
struct RawInstrument {
    name: String,
    #[serde(rename = "description")]
    _description: String,
    camera: RawCamera,
    plate: RawPlate,
    optics: RawOptics,
    mounting: RawMounting,
    #[serde(default, rename = "calibration")]
    _calibrations: BTreeMap<String, RawCalibration>,
}

/// Basis of a calibration; informative, like source and date.
#[derive(Deserialize)]
struct RawCalibration {
    #[serde(rename = "frames")]
    _frames: usize,
    #[serde(default, rename = "poses")]
    _poses: Option<usize>,
    /// Ids of marks that were lit but never identified.
    #[serde(default, rename = "suspect_marks")]
    _suspect_marks: Vec<[i32; 2]>,
    /// SHA-256 over the sorted SHA-256 of the files.
    #[serde(rename = "frames_sha256")]
    _frames_sha256: String,
    /// The first digits of each file's SHA-256.
    #[serde(default, rename = "frame_hashes")]
    _frame_hashes: Option<String>,
    /// Date of the last frame.
    #[serde(default, rename = "date")]
    _date: Option<Utc>,
    #[serde(rename = "program")]
    _program: String,
    #[serde(default, rename = "commit")]
    _commit: Option<String>,
    /// SHA-256 of the file that the calibration started from.
    #[serde(default, rename = "instrument_sha256")]
    _instrument_sha256: Option<String>,
    #[serde(default, rename = "note")]
    _note: Option<String>,
}

#[derive(Deserialize)]
struct RawCamera {
    name: Option<Entry<String>>,
    width_px: Entry<usize>,
    height_px: Entry<usize>,
    bits: Entry<u32>,
    distortion: Option<RawDistortion>,
    noise: Option<RawNoise>,
    vignetting: Option<RawVignetting>,
    hot_pixels_px: Option<Entry<Vec<[usize; 2]>>>,
}

#[derive(Deserialize)]
struct RawDistortion {
    centre_px: Entry<[f64; 2]>,
    radial_per_px2: Entry<f64>,
    radial_per_px4: Entry<f64>,
    decentring_per_px: Entry<[f64; 2]>,
}

#[derive(Deserialize)]
struct RawOptics {
    focal_length_mm: Entry<f64>,
    plate_distance_mm: Entry<f64>,
    blur_px: Entry<f64>,
    wavelength_nm: Entry<f64>,
    temperature: Option<RawThermal>,
}

#[derive(Deserialize)]
struct RawMounting {
    handedness: Entry<RawHandedness>,
    scale_mil_per_px: Entry<f64>,
    rotation_deg: Entry<f64>,
    twist_deg: Entry<f64>,
    plate_centre_px: Entry<[f64; 2]>,
    boresight_mil: Entry<[f64; 2]>,
    clocking_deg: Entry<f64>,
    directions: Option<Entry<Directions>>,
    roll_deg: Option<Entry<f64>>,
}

pub(super) fn parse(path: &Path, text: &str) -> Result<Instrument, TomlError> {
    let mut known = keys_of(include_str!("../../calibration/demo.toml"));
    known.extend(OPTIONAL_KEYS.map(str::to_owned));
    let raw: RawInstrument = parse_strict(path, text, &known)?;
    Checker { path }.instrument(raw)
}

/// Keys that the demo does not use, as suggestions for an unknown key.
const OPTIONAL_KEYS: [&str; 18] = [
    "camera.hot_pixels_px",
    "camera.name",
    "camera.noise.dark_dn",
    "camera.noise.gain_dn_per_electron",
    "camera.noise.read_noise_dn",
    "camera.noise.saturation_dn",
    "camera.vignetting.centre_px",
    "camera.vignetting.radial_per_px2",
    "optics.temperature.blur_px_per_c",
    "optics.temperature.reference_c",
    "optics.temperature.scale_per_c",
    "plate.arm_angle_deg",
    "plate.dot_diameter_mil",
    "plate.drawing.csv",
    "plate.field_radius_mil",
    "plate.marks",
    "plate.pattern",
    "plate.shape",
];

/// The roll of a gondola without a measurement: balancing levels it to about a degree.
const UNMEASURED_ROLL_DEG: Measured = Measured::new(0.0, 1.0);

/// Turns raw values into checked ones; contains the path for its errors.
struct Checker<'a> {
    path: &'a Path,
}

impl Checker<'_> {
    fn instrument(&self, raw: RawInstrument) -> Result<Instrument, TomlError> {
        self.name(&raw.name)?;
        let mounting = self.mounting(raw.mounting)?;
        Ok(Instrument {
            camera_name: raw.camera.name.as_ref().map(|name| name.value.clone()),
            sensor: self.sensor(&raw.camera)?,
            camera: self.camera(raw.camera)?,
            plate: self.plate(raw.plate, mounting.scale_mil_per_px.value)?,
            optics: self.optics(raw.optics)?,
            mounting,
            name: raw.name,
        })
    }

    /// The name is used for files and folders.
    fn name(&self, name: &str) -> Result<(), TomlError> {
        let leads_elsewhere = |c: char| matches!(c, '/' | '\\') || c.is_control();
        if !name.trim().is_empty() && !name.contains("..") && !name.contains(leads_elsewhere) {
            return Ok(());
        }
        let expected = "a name that is not empty, without '/', '\\', '..' and control characters";
        Err(TomlError::new(
            self.path,
            "name",
            expected,
            format!("{name:?}"),
        ))
    }

    fn camera(&self, raw: RawCamera) -> Result<PlateCamera, TomlError> {
        let side = 64.0..=65_536.0;
        self.within(
            "camera.width_px",
            raw.width_px.value as f64,
            side.clone(),
            "px",
        )?;
        self.within("camera.height_px", raw.height_px.value as f64, side, "px")?;
        self.within("camera.bits", f64::from(raw.bits.value), 8.0..=16.0, "bits")?;
        Ok(PlateCamera {
            width_px: raw.width_px.value,
            height_px: raw.height_px.value,
            bits: raw.bits.value,
            distortion: match raw.distortion {
                Some(distortion) => self.distortion(distortion)?,
                None => Distortion::NONE,
            },
        })
    }

    fn distortion(&self, raw: RawDistortion) -> Result<Distortion, TomlError> {
        let table = "camera.distortion";
        let [k1, k2] = [
            self.measured(
                &format!("{table}.radial_per_px2"),
                raw.radial_per_px2,
                -1e-6..=1e-6,
            )?,
            self.measured(
                &format!("{table}.radial_per_px4"),
                raw.radial_per_px4,
                -1e-12..=1e-12,
            )?,
        ];
        let [x, y] = self.pair(&format!("{table}.centre_px"), &raw.centre_px, 65_536.0)?;
        Ok(Distortion {
            centre: SensorPx::new(x, y),
            radial: [k1.value, k2.value],
            decentring: self.pair(
                &format!("{table}.decentring_per_px"),
                &raw.decentring_per_px,
                1e-3,
            )?,
        })
    }

    fn optics(&self, raw: RawOptics) -> Result<Optics, TomlError> {
        let lengths = 10.0..=100_000.0;
        Ok(Optics {
            focal_length_mm: self.measured(
                "optics.focal_length_mm",
                raw.focal_length_mm,
                lengths.clone(),
            )?,
            plate_distance_mm: self.measured(
                "optics.plate_distance_mm",
                raw.plate_distance_mm,
                lengths,
            )?,
            blur_px: self.measured("optics.blur_px", raw.blur_px, 0.0..=10.0)?,
            wavelength_nm: self
                .measured("optics.wavelength_nm", raw.wavelength_nm, 100.0..=2000.0)?
                .value,
            thermal: raw
                .temperature
                .as_ref()
                .map(|t| self.thermal(t))
                .transpose()?,
        })
    }

    fn mounting(&self, raw: RawMounting) -> Result<Mounting, TomlError> {
        let turn = TURN_DEG;
        let scale = self.measured(
            "mounting.scale_mil_per_px",
            raw.scale_mil_per_px,
            0.1..=100.0,
        )?;
        let rotation = self.measured("mounting.rotation_deg", raw.rotation_deg, turn.clone())?;
        let twist = self.measured("mounting.twist_deg", raw.twist_deg, turn.clone())?;
        let clocking = self.measured("mounting.clocking_deg", raw.clocking_deg, turn.clone())?;
        let centre = self.pair("mounting.plate_centre_px", &raw.plate_centre_px, 65_536.0)?;
        let boresight = self.pair(
            "mounting.boresight_mil",
            &raw.boresight_mil,
            plate::MOST_PLACE_MIL,
        )?;
        Ok(Mounting {
            scale_mil_per_px: scale,
            rotation_deg: Measured::new(rotation.value + twist.value, rotation.sigma),
            twist_deg: twist.value,
            handedness: match raw.handedness.value {
                RawHandedness::Mirrored => Handedness::Mirrored,
                RawHandedness::Direct => Handedness::Direct,
            },
            plate_centre_px: SensorPx::new(centre[0], centre[1]),
            plate_centre_sigma_px: raw.plate_centre_px.sigma,
            boresight_mil: boresight.into_position(),
            boresight_sigma_mil: raw.boresight_mil.sigma,
            clocking_deg: clocking,
            directions: self.directions(raw.directions)?,
            roll_deg: match raw.roll_deg {
                Some(roll) => self.measured("mounting.roll_deg", roll, turn)?,
                None => UNMEASURED_ROLL_DEG,
            },
        })
    }

    /// Directions refer to the zenith at the telescope, in which the plate is fixed, unless the file states the other rule.
    fn directions(&self, entry: Option<Entry<Directions>>) -> Result<Directions, TomlError> {
        let Some(entry) = entry else {
            return Ok(Directions::Telescope);
        };
        self.provenance("mounting.directions", &entry)?;
        Ok(entry.value)
    }

    fn measured(
        &self,
        field: &str,
        entry: Entry<f64>,
        range: std::ops::RangeInclusive<f64>,
    ) -> Result<Measured, TomlError> {
        self.number(field, &entry, range)
    }

    fn number(
        &self,
        field: &str,
        entry: &Entry<f64>,
        range: std::ops::RangeInclusive<f64>,
    ) -> Result<Measured, TomlError> {
        self.within(field, entry.value, range, unit_of(field))?;
        self.provenance(field, entry)?;
        Ok(Measured::new(entry.value, entry.sigma))
    }

    fn pair(
        &self,
        field: &str,
        entry: &Entry<[f64; 2]>,
        limit: f64,
    ) -> Result<[f64; 2], TomlError> {
        for value in entry.value {
            self.within(field, value, -limit..=limit, unit_of(field))?;
        }
        self.provenance(field, entry)?;
        Ok(entry.value)
    }

    fn provenance<T>(&self, field: &str, entry: &Entry<T>) -> Result<(), TomlError> {
        self.within(
            &format!("{field}.sigma"),
            entry.sigma,
            0.0..=1e6,
            unit_of(field),
        )?;
        if entry.source.trim().is_empty() {
            return Err(self.error(
                &format!("{field}.source"),
                "where the value comes from",
                "nothing",
            ));
        }
        Ok(())
    }

    fn within(
        &self,
        field: &str,
        value: f64,
        range: std::ops::RangeInclusive<f64>,
        unit: &str,
    ) -> Result<(), TomlError> {
        if range.contains(&value) {
            return Ok(());
        }
        let expected = format!("a number from {} to {} {unit}", range.start(), range.end());
        Err(self.error(field, expected.trim_end(), value.to_string()))
    }

    fn error(&self, field: &str, expected: &str, found: impl Into<String>) -> TomlError {
        TomlError::new(self.path, field, expected, found)
    }
}

/// The unit at the end of a key.
fn unit_of(field: &str) -> &'static str {
    let key = field.trim_end_matches(".sigma");
    const UNITS: [(&str, &str); 10] = [
        ("_dn", "DN"),
        ("_dn_per_electron", "DN"),
        ("_mil_per_px", "mil/px"),
        ("_per_px2", "px^-2"),
        ("_per_px4", "px^-4"),
        ("_per_px", "px^-1"),
        ("_mil", "mil"),
        ("_mm", "mm"),
        ("_px", "px"),
        ("_deg", "deg"),
    ];
    UNITS
        .iter()
        .find(|(ending, _)| key.ends_with(ending))
        .map_or("", |(_, unit)| unit)
}

trait IntoPosition {
    fn into_position(self) -> PlateMil;
}

impl IntoPosition for [f64; 2] {
    fn into_position(self) -> PlateMil {
        PlateMil::new(self[0], self[1])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plate::{MarkId, MarkPlace, Pattern};

    const DEMO: &str = include_str!("../../calibration/demo.toml");

    fn message(text: &str) -> String {
        parse(Path::new("a.toml"), text).unwrap_err().to_string()
    }

    #[test]
    fn an_unknown_key_names_the_nearest_known_one() {
        let text = DEMO.replace("clocking_deg", "cloking_deg");
        let message = message(&text);
        assert!(message.contains("a.toml"), "{message}");
        assert!(message.contains("mounting.cloking_deg"), "{message}");
        assert!(message.contains("\"mounting.clocking_deg\""), "{message}");
        assert!(!message.contains('\n'), "{message}");
    }

    #[test]
    fn a_name_that_would_lead_out_of_a_folder_or_is_empty_is_refused() {
        let demo = include_str!("../../calibration/demo.toml");
        for name in ["../escaped", "a/b", "..", "", " ", "a\\\\b"] {
            let text = demo.replacen("name = \"demo\"", &format!("name = \"{name}\""), 1);
            assert_ne!(text, demo);
            let error = parse(Path::new("i.toml"), &text).unwrap_err().to_string();
            assert!(
                error.starts_with("i.toml: name: expected a name"),
                "{error}"
            );
        }
    }

    #[test]
    fn a_negative_length_names_field_and_range() {
        let text = DEMO.replace(
            "focal_length_mm = { value = 3000",
            "focal_length_mm = { value = -3000",
        );
        let message = message(&text);
        assert!(message.contains("optics.focal_length_mm"), "{message}");
        assert!(
            message.contains("from 10 to 100000 mm, found -3000"),
            "{message}"
        );
    }

    #[test]
    fn a_wrong_type_names_the_field_on_one_line() {
        let text = DEMO.replace("width_px = { value = 1296", "width_px = { value = \"wide\"");
        let message = message(&text);
        assert!(message.contains("camera.width_px.value"), "{message}");
        assert!(!message.contains('\n'), "{message}");
    }

    #[test]
    fn a_date_may_be_in_quotes_and_must_be_one() {
        let dated = |date: &str| DEMO.replacen("date = 2013-09-21", &format!("date = {date}"), 1);
        let path = Path::new("a.toml");
        for date in ["\"2013-09-21\"", "2013-09-21T20:00:00-06:00", "2013-09-21"] {
            assert!(parse(path, &dated(date)).is_ok(), "{date}");
        }
        for date in ["\"yesterday\"", "18:00:00", "2013"] {
            let message = message(&dated(date));
            assert!(
                message.contains(".date: expected a date or a time such as"),
                "{message}"
            );
            assert!(
                message.contains(&format!("found {date} on line")),
                "{message}"
            );
        }
    }

    /// The demo without the lines that begin with a key.
    fn demo_without(key: &str) -> String {
        let lines = DEMO.lines().filter(|line| !line.starts_with(key));
        lines.map(|line| format!("{line}\n")).collect()
    }

    #[test]
    fn directions_are_the_telescopes_unless_the_file_says_otherwise() {
        let path = Path::new("a.toml");
        let unstated = demo_without("directions");
        assert_ne!(unstated, DEMO);
        let mounting = parse(path, &unstated).unwrap().mounting;
        assert_eq!(mounting.directions, Directions::Telescope);
        for directions in Directions::ALL {
            let text = DEMO.replace("\"telescope\"", &format!("{:?}", directions.name()));
            let mounting = parse(path, &text).unwrap().mounting;
            assert_eq!(mounting.directions, directions);
        }
        let message = message(&DEMO.replace("\"telescope\"", "\"sun\""));
        assert!(message.contains("mounting.directions"), "{message}");
        assert!(message.contains("\"sun-2013\""), "{message}");
    }

    #[test]
    fn a_roll_that_was_not_measured_is_zero_to_a_degree() {
        let path = Path::new("a.toml");
        let unstated = demo_without("roll_deg");
        assert_ne!(unstated, DEMO);
        let mounting = parse(path, &unstated).unwrap().mounting;
        assert_eq!(mounting.roll_deg, UNMEASURED_ROLL_DEG);
        let stated = DEMO.replace(
            "roll_deg = { value = 0, sigma = 1",
            "roll_deg = { value = -0.5, sigma = 0.2",
        );
        let mounting = parse(path, &stated).unwrap().mounting;
        assert_eq!(mounting.roll_deg, Measured::new(-0.5, 0.2));
    }

    #[test]
    fn measured_marks_replace_drawn_ones() {
        let text = format!(
            "{DEMO}\n[[plate.mark]]\nid = [1, 0]\nposition_mil = [270.4, 89.9]\nsigma_mil = [0.05, 0.06]\n"
        );
        let plate = parse(Path::new("a.toml"), &text).unwrap().plate;
        let id = MarkId::new(1, 0).unwrap();
        let expected = MarkPlace {
            at: PlateMil::new(270.4, 89.9),
            sigma_mil: [0.05, 0.06],
        };
        assert_eq!(plate.measured(id), Some(expected));
        assert_eq!(plate.pattern(), Pattern::Heroes);
    }
}
