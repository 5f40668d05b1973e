//! A scene, its frame, and the truth about it.

use super::{Cover, Purpose, generator};
use crate::frame::{Frame, FrameError, FrameInfo};
use crate::geometry::{Distortion, Mapping, MappingKind, SimilarityParameters, unit};
use crate::instrument::Instrument;
use crate::plate::{MarkId, Plate};
use crate::units::{PlateMil, SensorPx};
use nalgebra::{Matrix3, Vector2};
use rand::RngExt;
use rand_distr::StandardNormal;

/// Reason why a scene cannot be made.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum SceneError {
    #[error("expected a mapping that can be inverted; check scale, rotation and keystone")]
    Mapping,
    #[error(
        "expected a sensor large enough for the Sun, found {width_px} x {height_px} px and a radius of {radius_px:.1} px"
    )]
    TooSmall {
        width_px: usize,
        height_px: usize,
        radius_px: f64,
    },
    #[error(transparent)]
    Frame(#[from] FrameError),
}

/// Everything that defines a picture. DN are those of an 8-bit camera, whatever the depth.
#[derive(Debug, Clone, PartialEq)]
pub struct Scene {
    pub width_px: usize,
    pub height_px: usize,
    pub mapping: Mapping,
    pub plate: Plate,
    /// `None` for a picture without Sun.
    pub sun: Option<Sun>,
    /// Fraction of the light that a mark absorbs, 0 to 1.
    pub mark_contrast: f64,
    /// Level of every pixel without light, DN.
    pub background_dn: f64,
    /// Gaussian blur of the picture, 1 sigma, before the pixel integrates.
    pub blur_px: f64,
    pub blemishes: Blemishes,
    pub stray: StrayLight,
    pub readout: Readout,
    pub noise: Noise,
    pub depth: Depth,
    /// Seed of the noise.
    pub seed: u64,
    /// Data that the frame will state.
    pub info: FrameInfo,
}

/// Linear limb darkening of the Sun as observed by HEROES at 630 nm in 2013: the light is proportional to 1 - u (1 - cos theta).
pub const LIMB_DARKENING: f64 = 0.56;

/// The Sun's image on the plate.
#[derive(Debug, Clone, PartialEq)]
pub struct Sun {
    /// Its centre at mid-exposure.
    pub centre: PlateMil,
    pub radius_mil: f64,
    /// Light at the disc's centre, above the background.
    pub peak_dn: f64,
    /// Linear limb darkening u: the light is proportional to 1 - u (1 - cos theta).
    pub limb_darkening: f64,
    pub surface: Surface,
    pub spots: Vec<Sunspot>,
    pub covers: Vec<Cover>,
    /// Motion of the image during the exposure.
    pub smear_mil: Vector2<f64>,
}

/// Structure of the disc besides its linear limb darkening.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub enum Surface {
    /// No structure.
    #[default]
    Plain,
    /// Spots, granulation and the limb darkening of the continuum picture that SDO/HMI took on 2023-01-31, relative to a linear
    /// limb darkening of 0.56.
    Hmi {
        /// Rotation of the picture, rad.
        turn_rad: f64,
        mirrored: bool,
    },
}

/// A dark disc on the Sun.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sunspot {
    /// Offset from the Sun's centre.
    pub offset_mil: Vector2<f64>,
    pub radius_mil: f64,
    /// Fraction of the light that it absorbs, 0 to 1.
    pub contrast: f64,
}

impl Sun {
    /// A Sun at rest, without spots, with the brightness and limb darkening observed by HEROES at 630 nm in 2013.
    pub fn new(centre: PlateMil, radius_mil: f64) -> Self {
        Self {
            centre,
            radius_mil,
            peak_dn: 205.0,
            limb_darkening: LIMB_DARKENING,
            surface: Surface::Plain,
            spots: Vec::new(),
            covers: Vec::new(),
            smear_mil: Vector2::zeros(),
        }
    }

    /// Fraction of the light that passes the covers of the Sun at a place, 0 to 1.
    pub fn left_by_covers(&self, at: PlateMil) -> f64 {
        let offset_mil = at.vector() - self.centre.vector();
        self.covers.iter().map(|c| c.left(offset_mil)).product()
    }

    /// Points around the limb, on the sensor.
    pub(super) fn limb_px(&self, mapping: &Mapping) -> impl Iterator<Item = SensorPx> {
        const POINTS: u32 = 64;
        (0..POINTS).map(move |k| {
            let angle = f64::from(k) / f64::from(POINTS) * std::f64::consts::TAU;
            let edge = unit(angle) * self.radius_mil;
            mapping.to_sensor((self.centre.vector() + edge).into())
        })
    }
}

/// Defects of plate, baffles and camera.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Blemishes {
    pub hot_pixels: Vec<HotPixel>,
    pub scratches: Vec<Scratch>,
    pub leaks: Vec<Leak>,
    pub dust: Vec<Dust>,
    /// Fraction of the light that is lost in the corners of the sensor; the loss grows with the square of the distance from
    /// the middle.
    pub vignetting: f64,
}

/// A pixel that is always saturated.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct HotPixel {
    pub x: usize,
    pub y: usize,
}

/// A straight scratch on the plate. It is visible only where the Sun lights it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Scratch {
    pub start: PlateMil,
    pub end: PlateMil,
    pub width_mil: f64,
    /// Its light relative to that of the surrounding plate.
    pub brightness: f64,
}

/// Light that passes the baffles: a soft spot near the plate's edge.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Leak {
    pub centre: PlateMil,
    /// Gaussian, 1 sigma.
    pub sigma_px: f64,
    /// Light at its middle.
    pub peak_dn: f64,
}

/// A speck of dust in front of the sensor: a soft shadow.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Dust {
    pub centre: SensorPx,
    /// Gaussian, 1 sigma.
    pub sigma_px: f64,
    /// Fraction of the light that it absorbs at its middle, 0 to 1.
    pub depth: f64,
}

/// Stray light of the optics. It does not change the truth.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct StrayLight {
    pub gradients: Vec<Gradient>,
    pub ghost: Option<Ghost>,
    pub coma: Option<Coma>,
}

/// Additive light that rises linearly in one direction.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gradient {
    pub rise_dn: f64,
    /// Direction of the rise, from +x towards +y, rad.
    pub direction_rad: f64,
    pub across: Extent,
}

/// The span of a gradient.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Extent {
    /// The sensor, from zero in its darkest corner.
    Sensor,
    /// The Sun's disc, from half the rise at its darkest limb; zero without a Sun, and never negative.
    Disc,
}

/// A second image of Sun and marks, shifted and out of focus.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ghost {
    /// Its light relative to that of the image.
    pub share: f64,
    pub offset_px: Vector2<f64>,
    /// Gaussian, 1 sigma, beyond the blur of the image.
    pub blur_px: f64,
}

/// Displacement of a fraction of the light to one side. The rest is shifted the other way so that the centroid is conserved: the
/// centre of the image stays at its true place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Coma {
    pub share: f64,
    /// Displacement relative to the rest.
    pub offset_px: Vector2<f64>,
    /// Gaussian, 1 sigma, beyond the blur of the image.
    pub blur_px: f64,
}

/// Levels that the readout of the sensor adds.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct Readout {
    /// Frame transfer: every pixel additionally receives this fraction of all the light in its column.
    pub column_smear: f64,
    /// Level of the right half of the sensor, with an amplifier of its own, above the left.
    pub tap_step_dn: f64,
}

/// Noise of a pixel.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Noise {
    /// Additive Gaussian noise, 1 sigma.
    pub read_dn: f64,
    /// Photo-electrons per DN; if set, photons add noise of variance signal / gain, drawn from a Gaussian.
    pub electrons_per_dn: Option<f64>,
}

impl Noise {
    pub const NONE: Self = Self::read(0.0);

    /// Only additive noise.
    pub const fn read(read_dn: f64) -> Self {
        Self {
            read_dn,
            electrons_per_dn: None,
        }
    }
}

/// Bit depth of the camera.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Depth {
    /// 8 bits, saturating at 255.
    Eight,
    /// 10 bits in 16, saturating at 1023; 4 of its steps make one of the 8-bit camera's.
    Ten,
    /// 12 bits in 16, saturating at 4095; 16 of its steps make one of the 8-bit camera's.
    Twelve,
    /// 16 bits, saturating at 65535; 256 of its steps make one of the 8-bit camera's.
    Sixteen,
}

impl Depth {
    /// Saturation of a pixel, in the camera's own DN.
    pub fn saturation_dn(self) -> u16 {
        match self {
            Self::Eight => 255,
            Self::Ten => 1023,
            Self::Twelve => 4095,
            Self::Sixteen => 65_535,
        }
    }

    /// The camera's own DN per 8-bit DN.
    pub fn steps_per_dn(self) -> f32 {
        match self {
            Self::Eight => 1.0,
            Self::Ten => 4.0,
            Self::Twelve => 16.0,
            Self::Sixteen => 256.0,
        }
    }
}

/// A rendered scene and the truth about it.
#[derive(Debug, Clone, PartialEq)]
pub struct Picture {
    pub frame: Frame,
    pub truth: Truth,
}

/// Truth of a picture, at mid-exposure.
#[derive(Debug, Clone, PartialEq)]
pub struct Truth {
    pub sun: Option<TruthOfSun>,
    pub mapping: Mapping,
    /// Every mark on the sensor that the Sun lights, completely or in part.
    pub marks: Vec<LitMark>,
}

/// True position of the Sun.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TruthOfSun {
    pub plate: PlateMil,
    /// The image of the disc's centre; under keystone this is not the centre of the ellipse.
    pub px: SensorPx,
    /// Radius at the mapping's scale at the centre.
    pub radius_px: f64,
}

/// A mark that the Sun lights.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LitMark {
    pub id: MarkId,
    /// Its printed position, including scatter.
    pub plate: PlateMil,
    pub px: SensorPx,
    /// Distance of its centre inside the limb; negative if only an arm is lit.
    pub depth_mil: f64,
}

impl Scene {
    /// A picture without Sun, blemishes or noise, of an instrument with this mapping.
    pub fn new(instrument: &Instrument, mapping: Mapping) -> Self {
        Self {
            width_px: instrument.camera.width_px,
            height_px: instrument.camera.height_px,
            mapping,
            plate: instrument.plate.clone(),
            sun: None,
            mark_contrast: 0.8,
            background_dn: 4.0,
            blur_px: instrument.optics.blur_px.value,
            blemishes: Blemishes::default(),
            stray: StrayLight::default(),
            readout: Readout::default(),
            noise: Noise::NONE,
            depth: Depth::Eight,
            seed: 0,
            info: FrameInfo::default(),
        }
    }

    /// The truth about the picture.
    pub fn truth(&self) -> Truth {
        Truth {
            sun: self.sun.as_ref().map(|sun| self.truth_of(sun)),
            mapping: self.mapping,
            marks: self
                .sun
                .as_ref()
                .map(|sun| self.lit_marks(sun))
                .unwrap_or_default(),
        }
    }

    pub(super) fn truth_of(&self, sun: &Sun) -> TruthOfSun {
        let px = self.mapping.to_sensor(sun.centre);
        TruthOfSun {
            plate: sun.centre,
            px,
            radius_px: sun.radius_mil / self.mapping.scale_mil_per_px(px),
        }
    }

    fn lit_marks(&self, sun: &Sun) -> Vec<LitMark> {
        let reach = self.plate.shape.size_mil() / 2.0;
        self.plate
            .marks()
            .map(|(id, plate)| LitMark {
                id,
                plate,
                px: self.mapping.to_sensor(plate),
                depth_mil: sun.radius_mil - plate.distance(sun.centre),
            })
            .filter(|mark| mark.depth_mil > -reach && self.on_sensor(mark.px))
            .filter(|mark| sun.left_by_covers(mark.plate) > 0.0)
            .collect()
    }

    /// Whether a position lies within the pixels.
    pub(super) fn on_sensor(&self, at: SensorPx) -> bool {
        let within = |v: f64, pixels: usize| (-0.5..pixels as f64 - 0.5).contains(&v);
        within(at.x, self.width_px) && within(at.y, self.height_px)
    }
}

/// The mapping of a camera that is tilted relative to the plate by `keystone_deg`.
///
/// With c the plate's centre on the sensor and q the position from it after rotation, px, a plate position is imaged
/// at c + q / (1 + k q.x), k = tan(keystone) / (4 x sensor width): parallel lines along x converge. `None` if
/// the parameters give no mapping.
pub fn keystoned(
    parameters: SimilarityParameters,
    keystone_deg: f64,
    width_px: usize,
    distortion: Distortion,
) -> Option<Mapping> {
    if keystone_deg == 0.0 {
        return Mapping::similarity(parameters, distortion);
    }
    let square = Mapping::similarity(parameters, Distortion::NONE)?;
    let c = parameters.plate_centre;
    let k = keystone_deg.to_radians().tan() / (4.0 * width_px as f64);
    let to_centre = Matrix3::new(1.0, 0.0, -c.x, 0.0, 1.0, -c.y, 0.0, 0.0, 1.0);
    let back = Matrix3::new(1.0, 0.0, c.x, 0.0, 1.0, c.y, 0.0, 0.0, 1.0);
    let tilt = Matrix3::new(1.0, 0.0, 0.0, 0.0, 1.0, 0.0, k, 0.0, 1.0);
    let seen = back * tilt * to_centre;
    Mapping::new(
        MappingKind::Keystone,
        square.matrix() * seen.try_inverse()?,
        distortion,
    )
}

/// The plate with every mark displaced at random, `rms_mil` in each axis, to simulate errors of printing.
pub fn scattered(plate: &Plate, rms_mil: f64, seed: u64) -> Plate {
    let mut rng = generator(seed, Purpose::Plate, 0);
    let mut printed = plate.clone();
    for (id, drawn) in plate.marks() {
        let [dx, dy]: [f64; 2] = std::array::from_fn(|_| rng.sample(StandardNormal));
        let at = PlateMil::new(drawn.x + rms_mil * dx, drawn.y + rms_mil * dy);
        if let Some(place) = plate.place(id) {
            printed.set(id, at, place.sigma_mil);
        }
    }
    printed
}
