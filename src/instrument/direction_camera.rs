//! A camera that measures directions, as described in its file: it is used to find horizon and Moon.
//!
//! ```toml
//! [camera]
//! width_px = 1920
//! height_px = 1080
//! centre_px = [962.7, 537.4]       # principal point; (0, 0) is the centre of the first pixel
//! focal_px = [888.97, 888.97]      # fx, fy
//! kannala_brandt = [1.0, -0.05, 0.01, 0.0, 0.0]   # k1 to k5; unset, the lens makes no distortion
//! body_from_camera = [[0, 0, 1], [1, 0, 0], [0, 1, 0]]   # three rows
//! mask_px = [[0, 900, 300, 1080]]  # x0, y0, x1, y1 of the vehicle's own parts; x1 and y1 are excluded
//! ```
//!
//! A number may have its 1-sigma, source and date beside it, as in an instrument's file: `{ value = 1920, source = "...", date = 2026-11-22 }`.

use super::builtin::text_of;
use super::toml_file::{TomlError, Utc, parse_strict};
use crate::frame::{Frame, Region};
use crate::geometry::camera::{CameraModel, Lens};
use crate::units::SensorPx;
use nalgebra::{Matrix3, Rotation3};
use serde::Deserialize;
use std::path::Path;

/// A camera that measures directions.
#[derive(Debug, Clone, PartialEq)]
pub struct DirectionCamera {
    pub width_px: usize,
    pub height_px: usize,
    pub lens: CameraModel,
    /// Rotates directions from the camera frame to the body's axes.
    pub body_from_camera: Option<Rotation3<f64>>,
    /// Regions of the picture that show the vehicle itself.
    pub mask: Vec<Region>,
}

/// A camera whose directions are known in the axes of the body that carries it.
#[derive(Debug, Clone, PartialEq)]
pub struct MountedCamera {
    pub optics: DirectionCamera,
    pub body_from_camera: Rotation3<f64>,
}

impl MountedCamera {
    /// Reads a camera's file that states the camera's mounting.
    ///
    /// # Errors
    /// As [`DirectionCamera::read`], and if the file does not state the mounting.
    pub fn read(path: &Path) -> Result<Self, TomlError> {
        Self::parse(path, &text_of(path)?)
    }

    /// Reads the text of such a file; `path` is used in error messages.
    ///
    /// # Errors
    /// As [`read`](Self::read).
    pub fn parse(path: &Path, text: &str) -> Result<Self, TomlError> {
        let optics = DirectionCamera::parse(path, text)?;
        let missing = || {
            let expected = "three rows of a rotation matrix";
            TomlError::new(path, "camera.body_from_camera", expected, "none")
        };
        Ok(Self {
            body_from_camera: optics.body_from_camera.ok_or_else(missing)?,
            optics,
        })
    }
}

/// A frame that is not from this camera.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error(
    "size: expected {expected_width} x {expected_height} px as of the camera, found {width} x {height}"
)]
pub struct WrongFrameSize {
    pub expected_width: usize,
    pub expected_height: usize,
    pub width: usize,
    pub height: usize,
}

#[derive(Deserialize)]
#[serde(
    untagged,
    expecting = "a number or a list of numbers, or a table with value, sigma, source and date"
)]
enum Entry<T> {
    Bare(T),
    Stated(Stated<T>),
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Stated<T> {
    value: T,
    #[serde(default, rename = "sigma")]
    _sigma: Option<toml::Value>,
    #[serde(default, rename = "source")]
    _source: Option<String>,
    #[serde(default, rename = "date")]
    _date: Option<Utc>,
}

impl<T> Entry<T> {
    fn value(self) -> T {
        match self {
            Self::Bare(value) => value,
            Self::Stated(stated) => stated.value,
        }
    }
}

#[derive(Deserialize)]
struct RawFile {
    #[serde(default, rename = "name")]
    _name: Option<String>,
    #[serde(default, rename = "description")]
    _description: Option<String>,
    /// Basis of a calibration; informative only.
    #[serde(default, rename = "calibration")]
    _calibrations: Option<toml::Table>,
    camera: RawCamera,
}

#[derive(Deserialize)]
struct RawCamera {
    width_px: Entry<usize>,
    height_px: Entry<usize>,
    centre_px: Entry<[f64; 2]>,
    focal_px: Entry<[f64; 2]>,
    kannala_brandt: Option<Entry<[f64; 5]>>,
    body_from_camera: Option<Entry<[[f64; 3]; 3]>>,
    mask_px: Option<Entry<Vec<[usize; 4]>>>,
}

const KEYS: [&str; 8] = [
    "camera",
    "camera.width_px",
    "camera.height_px",
    "camera.centre_px",
    "camera.focal_px",
    "camera.kannala_brandt",
    "camera.body_from_camera",
    "camera.mask_px",
];

impl DirectionCamera {
    /// Reads a camera's file.
    ///
    /// # Errors
    /// The file, the field, and what was expected there.
    pub fn read(path: &Path) -> Result<Self, TomlError> {
        Self::parse(path, &text_of(path)?)
    }

    /// Reads the text of a camera's file; `path` is used in error messages.
    ///
    /// # Errors
    /// As [`read`](Self::read).
    pub fn parse(path: &Path, text: &str) -> Result<Self, TomlError> {
        let known = KEYS.map(str::to_owned);
        let RawFile { camera: raw, .. } = parse_strict(path, text, &known)?;
        let error = |field: &str, expected: &str, found: String| {
            TomlError::new(path, format!("camera.{field}"), expected, found)
        };
        let (width_px, height_px) = (raw.width_px.value(), raw.height_px.value());
        for (field, size) in [("width_px", width_px), ("height_px", height_px)] {
            if !(16..=65_536).contains(&size) {
                return Err(error(field, "a number from 16 to 65536", size.to_string()));
            }
        }
        let (centre, focal) = (raw.centre_px.value(), raw.focal_px.value());
        if !focal.iter().all(|f| (1.0..=1e7).contains(f)) {
            return Err(error(
                "focal_px",
                "two numbers from 1 to 1e7",
                format!("{focal:?}"),
            ));
        }
        if !centre.iter().all(|c| c.abs() <= 1e6) {
            return Err(error(
                "centre_px",
                "two numbers from -1e6 to 1e6",
                format!("{centre:?}"),
            ));
        }
        let k = raw.kannala_brandt.map(Entry::value);
        let lens = k.map_or(Lens::Rectilinear, Lens::KannalaBrandt);
        let lens = CameraModel::new(lens, focal, SensorPx::new(centre[0], centre[1])).ok_or_else(
            || {
                let expected = "k1 to k5 of a radius that grows from the axis";
                error(
                    "kannala_brandt",
                    expected,
                    format!("{:?}", k.unwrap_or_default()),
                )
            },
        )?;
        let body_from_camera = match raw.body_from_camera.map(Entry::value) {
            Some(rows) => Some(rotation_of_rows(&rows).ok_or_else(|| {
                let expected =
                    "three rows of a rotation matrix (orthonormal to 1e-4, right-handed)";
                error("body_from_camera", expected, format!("{rows:?}"))
            })?),
            None => None,
        };
        let masks = raw.mask_px.map(Entry::value).unwrap_or_default();
        let mask = masks
            .iter()
            .map(|&[x0, y0, x1, y1]| {
                let fits = x0 < x1 && y0 < y1 && x1 <= width_px && y1 <= height_px;
                fits.then_some(Region { x0, y0, x1, y1 }).ok_or_else(|| {
                    let expected = format!(
                        "[x0, y0, x1, y1] with x0 < x1 <= {width_px} and y0 < y1 <= {height_px}"
                    );
                    error("mask_px", &expected, format!("{:?}", [x0, y0, x1, y1]))
                })
            })
            .collect::<Result<_, _>>()?;
        Ok(Self {
            width_px,
            height_px,
            lens,
            body_from_camera,
            mask,
        })
    }

    /// Width and height of its frames, px.
    pub fn size_px(&self) -> [usize; 2] {
        [self.width_px, self.height_px]
    }

    /// Whether a frame has this camera's size.
    ///
    /// # Errors
    /// Both sizes.
    pub fn check(&self, frame: &Frame) -> Result<(), WrongFrameSize> {
        match (frame.width(), frame.height()) == (self.width_px, self.height_px) {
            true => Ok(()),
            false => Err(WrongFrameSize {
                expected_width: self.width_px,
                expected_height: self.height_px,
                width: frame.width(),
                height: frame.height(),
            }),
        }
    }
}

/// The rotation given by three rows, orthonormalised; `None` if it is not a rotation.
pub(crate) fn rotation_of_rows(rows: &[[f64; 3]; 3]) -> Option<Rotation3<f64>> {
    const TOLERANCE: f64 = 1e-4;
    let matrix = Matrix3::from_fn(|row, column| rows[row][column]);
    let off = (matrix * matrix.transpose() - Matrix3::identity()).amax();
    // With infinite elements the largest deviation is NaN, which a comparison may miss.
    let is_finite = matrix.iter().all(|number| number.is_finite());
    let is_rotation = is_finite && off < TOLERANCE && matrix.determinant() > 0.0;
    is_rotation.then(|| Rotation3::from_matrix(&matrix))
}

#[cfg(test)]
mod tests {
    use super::*;

    const PLAIN: &str = "[camera]\nwidth_px = 1920\nheight_px = 1080\ncentre_px = [962.7, 537.4]\nfocal_px = [888.97, 890]\n";

    fn parse(text: &str) -> Result<DirectionCamera, String> {
        DirectionCamera::parse(Path::new("cam.toml"), text).map_err(|error| error.to_string())
    }

    #[test]
    fn bare_and_stated_values_are_read() {
        let camera = parse(PLAIN).unwrap();
        assert_eq!((camera.width_px, camera.height_px), (1920, 1080));
        assert_eq!(camera.lens.mean_focal_px(), 889.485);
        let stated = PLAIN.replace(
            "= 1920",
            "= { value = 1920, source = \"data sheet\", date = 2026-11-22 }",
        );
        assert_eq!(parse(&stated).as_ref(), Ok(&camera));
        let quoted = stated.replace("2026-11-22", "\"2026-11-22\"");
        assert_eq!(parse(&quoted).as_ref(), Ok(&camera));
        assert!(parse(&stated.replace("2026-11-22", "\"yesterday\"")).is_err());
        let more = format!(
            "{PLAIN}mask_px = [[0, 900, 300, 1080]]\nbody_from_camera = [[0, 0, 1], [1, 0, 0], [0, 1, 0]]\n"
        );
        let camera = parse(&more).unwrap();
        assert!(camera.mask[0].contains(299, 900) && !camera.mask[0].contains(300, 900));
        let forward = camera.body_from_camera.unwrap() * nalgebra::Vector3::z();
        assert!((forward - nalgebra::Vector3::x()).norm() < 1e-12);
    }

    #[test]
    fn what_is_wrong_is_named_with_file_and_field() {
        for (text, wanted) in [
            (
                PLAIN.replace("focal_px", "focus_px"),
                "nearest is \"camera.focal_px\"",
            ),
            (
                PLAIN.replace("[888.97, 890]", "[888.97, -1]"),
                "camera.focal_px: expected two numbers from 1",
            ),
            (
                PLAIN.replace("= 1080", "= 0"),
                "camera.height_px: expected a number from 16",
            ),
            (
                PLAIN.replace("= 1080", "= \"tall\""),
                "camera.height_px: expected a number or a list of numbers, or a table with value, sigma, source and date, found \"tall\" on line",
            ),
            (
                format!("{PLAIN}kannala_brandt = [-1, 0, 0, 0, 0]\n"),
                "camera.kannala_brandt: expected k1 to k5",
            ),
            (
                format!("{PLAIN}mask_px = [[0, 0, 3000, 10]]\n"),
                "camera.mask_px: expected [x0, y0, x1, y1]",
            ),
            (
                format!("{PLAIN}body_from_camera = [[1, 0, 0], [0, 1, 0], [0, 0, -1]]\n"),
                "camera.body_from_camera: expected three rows",
            ),
        ] {
            let message = parse(&text).unwrap_err();
            assert!(
                message.starts_with("cam.toml: ") && message.contains(wanted),
                "{message}"
            );
        }
    }
}
