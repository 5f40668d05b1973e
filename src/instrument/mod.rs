//! The instrument: camera, plate, optics and mounting, read from a TOML file, checked, and immutable afterwards.
//!
//! A file states each number's unit in its key and its 1-sigma, source and date beside it: `scale_mil_per_px = { value =
//! 5.75, sigma = 0.0115, source = "...", date = 2013-09-21 }`. Reading has two steps: `raw` holds the contents of the file,
//! [`Instrument`] the checked values.

mod builtin;
mod dates;
mod direction_camera;
mod directions;
mod lens_fit;
mod raw;
pub mod role;
mod sees;
mod sensor;
pub mod toml_file;

pub use builtin::{
    DEMO_HORIZON, DEMO_NAVIGATION, builtin, builtin_names, builtin_text, text_of, text_or_demo,
};
pub use dates::Dated;
pub(crate) use direction_camera::rotation_of_rows;
pub use direction_camera::{DirectionCamera, MountedCamera, WrongFrameSize};
pub use directions::Directions;
pub use lens_fit::{LensMisfit, MEAN_SUN_ARCSEC, SMALLEST_SUN_ARCSEC};
pub use role::Role;
pub use sees::{Sees, Stated};
pub use sensor::{Noise, Sensor, Thermal, Vignetting};
pub use toml_file::TomlError;

use crate::frame::{Frame, TakenBy};
use crate::geometry::{Distortion, Handedness, Mapping, SimilarityParameters};
use crate::plate::Plate;
use crate::units::{ARCSEC_PER_RAD, MIL_MM, Measured, PlateMil, SensorPx};
use nalgebra::{Matrix2, Vector2};
use std::borrow::Cow;
use std::path::Path;

/// All properties of the hardware that the solver and the pointing need.
#[derive(Debug, Clone, PartialEq)]
pub struct Instrument {
    pub name: String,
    /// Name of its camera in frames (`CAMERA`); none if the file states none.
    pub camera_name: Option<String>,
    pub camera: PlateCamera,
    /// Response of the camera's pixels to light.
    pub sensor: Sensor,
    pub plate: Plate,
    pub optics: Optics,
    pub mounting: Mounting,
}

/// The camera that observes the plate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PlateCamera {
    pub width_px: usize,
    pub height_px: usize,
    /// Bits per pixel as digitised by the camera.
    pub bits: u32,
    pub distortion: Distortion,
}

impl PlateCamera {
    /// Width and height of the sensor, px.
    pub fn size_px(&self) -> [usize; 2] {
        [self.width_px, self.height_px]
    }

    /// The centre of the sensor.
    pub fn middle_px(&self) -> SensorPx {
        let middle = |pixels: usize| (pixels as f64 - 1.0) / 2.0;
        SensorPx::new(middle(self.width_px), middle(self.height_px))
    }
}

/// The telescope that projects the Sun's image onto the plate.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Optics {
    pub focal_length_mm: Measured,
    /// Distance from the lens to the plate.
    pub plate_distance_mm: Measured,
    /// Gaussian blur of the picture on the sensor, 1 sigma.
    pub blur_px: Measured,
    /// Wavelength of the band-pass filter.
    pub wavelength_nm: f64,
    /// Change of blur and scale with temperature; the solver does not use it, since it measures both in each frame.
    pub thermal: Option<Thermal>,
}

impl Optics {
    /// Radius on the plate of a disc of the given angular radius, mil.
    pub fn radius_mil(&self, angular_radius_arcsec: f64) -> f64 {
        self.plate_distance_mm.value * (angular_radius_arcsec / ARCSEC_PER_RAD).tan() / MIL_MM
    }

    /// Plate scale at the optical axis, arcsec per mil.
    pub fn arcsec_per_mil(&self) -> f64 {
        MIL_MM / self.plate_distance_mm.value * ARCSEC_PER_RAD
    }
}

/// Allowed range of an angle of the mounting.
pub const TURN_DEG: std::ops::RangeInclusive<f64> = -360.0..=360.0;

/// Orientation and position of plate and camera in the gondola.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mounting {
    /// Plate length per pixel.
    pub scale_mil_per_px: Measured,
    /// Rotation of the picture, including the camera's twist (0 or 180 deg); positive from +x towards +y.
    pub rotation_deg: Measured,
    /// The part of the rotation that is the camera's twist.
    pub twist_deg: f64,
    pub handedness: Handedness,
    /// Position of the plate's centre on the sensor; 1 sigma per axis.
    pub plate_centre_px: SensorPx,
    pub plate_centre_sigma_px: f64,
    /// The boresight: position of the Sun on the plate when the telescope points at it.
    pub boresight_mil: PlateMil,
    pub boresight_sigma_mil: f64,
    /// Angle of the plate's +Y from the direction to the zenith.
    pub clocking_deg: Measured,
    /// Reference point of directions on the plate relative to the zenith.
    pub directions: Directions,
    /// The telescope's roll if no sensor measures it: its rotation about the boresight, positive with the right side low.
    /// Without effect if directions refer to the zenith at the Sun.
    pub roll_deg: Measured,
}

impl Mounting {
    /// The same mounting with the camera at another twist.
    pub fn twisted_to(mut self, twist_deg: f64) -> Self {
        self.rotation_deg.value += twist_deg - self.twist_deg;
        self.twist_deg = twist_deg;
        self
    }

    /// The stated similarity from plate to sensor.
    pub fn similarity(&self) -> SimilarityParameters {
        SimilarityParameters {
            plate_centre: self.plate_centre_px,
            scale_mil_per_px: self.scale_mil_per_px.value,
            rotation_deg: self.rotation_deg.value,
            handedness: self.handedness,
        }
    }

    /// A similarity drawn at random from the stated values and sigmas; `normal` returns a standard normal number.
    pub fn drawn(&self, mut normal: impl FnMut() -> f64) -> SimilarityParameters {
        let mut drawn = self.similarity();
        drawn.plate_centre.x += self.plate_centre_sigma_px * normal();
        drawn.plate_centre.y += self.plate_centre_sigma_px * normal();
        drawn.rotation_deg += self.rotation_deg.sigma * normal();
        drawn.scale_mil_per_px += self.scale_mil_per_px.sigma * normal();
        drawn
    }
}

/// A frame with another size than this instrument's.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[error(
    "size: expected {expected_width} x {expected_height} px as of instrument \"{instrument}\", found {width} x {height}; a part of the sensor \
     is placed by CORNER-X and CORNER-Y (or XORGSUBF and YORGSUBF, DETSEC, CCDSEC)"
)]
pub struct WrongSize {
    pub instrument: String,
    pub expected_width: usize,
    pub expected_height: usize,
    pub width: usize,
    pub height: usize,
}

/// A frame taken by another instrument or another camera.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("{keyword}: expected \"{expected}\" as of instrument \"{instrument}\", found \"{found}\"")]
pub struct WrongCamera {
    pub keyword: &'static str,
    pub instrument: String,
    pub expected: String,
    pub found: String,
}

impl Instrument {
    /// Checks that a frame is from this instrument, by instrument and camera in its header.
    ///
    /// # Errors
    /// The keyword that names another one.
    pub fn check_taken_by(&self, by: &TakenBy) -> Result<(), WrongCamera> {
        let wrong = |keyword, expected: &str, found: &str| WrongCamera {
            keyword,
            instrument: self.name.clone(),
            expected: expected.into(),
            found: found.into(),
        };
        if let Some(named) = &by.instrument
            && role::one_of_several(named).0 != self.name
            && *named != self.name
        {
            return Err(wrong("OBSRVTRY", &self.name, named));
        }
        match (&self.camera_name, &by.camera) {
            (Some(own), Some(camera)) if own != camera => Err(wrong("CAMERA", own, camera)),
            _ => Ok(()),
        }
    }

    /// The instrument for a given frame: if the frame states that it is a part of the sensor, positions refer to the part's
    /// corner.
    ///
    /// # Errors
    /// If the frame is neither the whole sensor nor a part of it.
    pub fn seen_by(&self, frame: &Frame) -> Result<Cow<'_, Self>, WrongSize> {
        let wrong = match self.check_size(frame) {
            Ok(()) => return Ok(Cow::Borrowed(self)),
            Err(wrong) => wrong,
        };
        match frame.info.corner_px {
            Some((x, y))
                if x.saturating_add(wrong.width) <= wrong.expected_width
                    && y.saturating_add(wrong.height) <= wrong.expected_height =>
            {
                let size = (wrong.width, wrong.height);
                Ok(Cow::Owned(self.windowed((x, y), size)))
            }
            _ => Err(wrong),
        }
    }

    /// Checks that a frame has the size of the whole sensor.
    ///
    /// # Errors
    /// If the frame has another size.
    pub fn check_size(&self, frame: &Frame) -> Result<(), WrongSize> {
        let (expected_width, expected_height) = (self.camera.width_px, self.camera.height_px);
        let (width, height) = (frame.width(), frame.height());
        if (width, height) == (expected_width, expected_height) {
            return Ok(());
        }
        Err(WrongSize {
            instrument: self.name.clone(),
            expected_width,
            expected_height,
            width,
            height,
        })
    }

    fn windowed(&self, corner_px: (usize, usize), size_px: (usize, usize)) -> Self {
        let from_corner = |at: SensorPx| SensorPx {
            x: at.x - corner_px.0 as f64,
            y: at.y - corner_px.1 as f64,
        };
        let mut window = self.clone();
        (window.camera.width_px, window.camera.height_px) = size_px;
        window.camera.distortion.centre = from_corner(self.camera.distortion.centre);
        window.mounting.plate_centre_px = from_corner(self.mounting.plate_centre_px);
        window.sensor = self.sensor.windowed(corner_px, size_px);
        window
    }

    /// Reads and checks an instrument's TOML file, or a built-in instrument by name.
    pub fn read(path: &Path) -> Result<Self, TomlError> {
        raw::parse(path, &text_of(path)?)
    }

    /// Checks an instrument's TOML text; `path` is used in error messages.
    pub fn parse(path: &Path, text: &str) -> Result<Self, TomlError> {
        raw::parse(path, text)
    }

    /// The mapping stated by the calibration; for its covariance at the Sun's position see
    /// [`nominal_covariance_mil2`](Self::nominal_covariance_mil2).
    pub fn nominal_mapping(&self) -> Option<Mapping> {
        Mapping::similarity(self.mounting.similarity(), self.camera.distortion)
    }

    /// Covariance of a plate position obtained by the nominal mapping, from the stated sigmas of the plate's centre, the
    /// rotation and the scale; mil^2.
    pub fn nominal_covariance_mil2(&self, at: PlateMil) -> Matrix2<f64> {
        let m = &self.mounting;
        let shift = m.plate_centre_sigma_px * m.scale_mil_per_px.value;
        let along = at.vector();
        let across = Vector2::new(-along.y, along.x);
        let scale = m.scale_mil_per_px.sigma / m.scale_mil_per_px.value;
        let rotation = m.rotation_deg.sigma.to_radians();
        Matrix2::identity() * shift.powi(2)
            + along * along.transpose() * scale.powi(2)
            + across * across.transpose() * rotation.powi(2)
    }

    /// Radius of the Sun on the sensor for an angular radius, px, at the nominal scale.
    pub fn radius_px(&self, angular_radius_arcsec: f64) -> f64 {
        self.optics.radius_mil(angular_radius_arcsec) / self.mounting.scale_mil_per_px.value
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sun_of_september_2013_is_as_large_on_the_sensor_as_the_ephemeris_says() {
        let demo = builtin("demo").unwrap();
        assert!((demo.radius_px(955.59) - 95.163).abs() < 0.001);
        assert!((demo.optics.arcsec_per_mil() - 1.746).abs() < 0.001);
    }

    #[test]
    fn a_frame_that_names_another_instrument_or_camera_is_refused() {
        let mut demo = builtin("demo").unwrap();
        let by = |instrument: Option<&str>, camera: Option<&str>| TakenBy {
            instrument: instrument.map(str::to_owned),
            camera: camera.map(str::to_owned),
        };
        let keyword = |demo: &Instrument, by: &TakenBy| {
            demo.check_taken_by(by).err().map(|wrong| wrong.keyword)
        };
        for named in [None, Some("demo"), Some("demo-2")] {
            assert_eq!(keyword(&demo, &by(named, Some("any"))), None);
        }
        let other = by(Some("heroes-pyas-f"), None);
        assert_eq!(keyword(&demo, &other), Some("OBSRVTRY"));
        demo.camera_name = Some("IGV-B1310 42".into());
        assert_eq!(
            keyword(&demo, &by(None, Some("IGV-B1310 43"))),
            Some("CAMERA")
        );
        assert_eq!(keyword(&demo, &by(None, Some("IGV-B1310 42"))), None);
        assert_eq!(keyword(&demo, &by(None, None)), None);
    }
}
