//! Random scenes by condition: the same instrument throughout, with the Sun at another place in every frame.

use super::blemish::Counts;
use super::optics::Strengths;
use super::scene::{
    Blemishes, Depth, Noise, Readout, Scene, SceneError, StrayLight, Sun, Sunspot, Surface,
    keystoned, scattered,
};
use super::{Covers, EXPOSURE, Purpose, SUN_RADIUS_ARCSEC, derived_seed, frame_info, generator};
use crate::geometry::{Mapping, SimilarityParameters, unit};
use crate::instrument::Instrument;
use crate::units::{PlateMil, SensorPx};
use nalgebra::Vector2;
use rand::RngExt;
use std::f64::consts::TAU;

/// Position of the Sun in random scenes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum SunInView {
    /// Anywhere with the whole disc on the sensor.
    Whole,
    /// Cut by the sensor's edge, with at least half its radius still on the sensor.
    Partial,
    /// Not in the picture.
    Absent,
}

/// Shared settings of random scenes.
#[derive(Debug, Clone, PartialEq)]
pub struct Conditions {
    pub sun: SunInView,
    pub sun_radius_arcsec: f64,
    /// Scale, rotation and plate centre of the picture.
    pub similarity: SimilarityParameters,
    /// See [`keystoned`].
    pub keystone_deg: f64,
    pub peak_dn: f64,
    pub background_dn: f64,
    /// Fraction of the light that a mark absorbs, 0 to 1.
    pub mark_contrast: f64,
    /// Displacement of the marks from the instrument's plate, rms in each axis.
    pub mark_scatter_mil: f64,
    /// Gaussian, 1 sigma.
    pub blur_px: f64,
    /// Motion of the Sun during the exposure, in a direction drawn for every frame.
    pub smear_px: f64,
    pub sunspots: usize,
    /// Whether the Sun has the surface of HMI's picture, turned and mirrored at random; see [`Surface::Hmi`].
    pub hmi: bool,
    pub covers: Covers,
    pub blemishes: Counts,
    pub stray: Strengths,
    pub readout: Readout,
    pub noise: Noise,
    pub depth: Depth,
}

impl Conditions {
    /// The instrument as stated, the whole Sun in view, 5 DN of noise, no blemishes.
    pub fn of(instrument: &Instrument) -> Self {
        Self {
            sun: SunInView::Whole,
            sun_radius_arcsec: SUN_RADIUS_ARCSEC,
            similarity: instrument.mounting.similarity(),
            keystone_deg: 0.0,
            peak_dn: 205.0,
            background_dn: 4.0,
            mark_contrast: 0.8,
            mark_scatter_mil: 0.0,
            blur_px: instrument.optics.blur_px.value,
            smear_px: 0.0,
            sunspots: 0,
            hmi: false,
            covers: Covers::default(),
            blemishes: Counts::default(),
            stray: Strengths::default(),
            readout: Readout::default(),
            noise: Noise::read(5.0),
            depth: Depth::Eight,
        }
    }
}

/// Random scenes: plate, mapping, blemishes, stray light and the Sun's surface depend on the seed; place, smear and noise on
/// the frame.
#[derive(Debug, Clone)]
pub struct RandomScenes {
    template: Scene,
    sun: Sun,
    in_view: SunInView,
    smear_px: f64,
    seed: u64,
}

impl RandomScenes {
    pub fn new(
        instrument: &Instrument,
        conditions: &Conditions,
        seed: u64,
    ) -> Result<Self, SceneError> {
        let camera = &instrument.camera;
        let mapping = keystoned(
            conditions.similarity,
            conditions.keystone_deg,
            camera.width_px,
            camera.distortion,
        )
        .ok_or(SceneError::Mapping)?;
        let radius_mil = instrument.optics.radius_mil(conditions.sun_radius_arcsec);
        let mut template = Scene {
            plate: scattered(&instrument.plate, conditions.mark_scatter_mil, seed),
            mark_contrast: conditions.mark_contrast,
            background_dn: conditions.background_dn,
            blur_px: conditions.blur_px,
            readout: conditions.readout,
            noise: conditions.noise,
            depth: conditions.depth,
            ..Scene::new(instrument, mapping)
        };
        template.blemishes = Blemishes::random(&conditions.blemishes, &template, radius_mil, seed);
        let radius_px = radius_mil / mapping.scale_mil_per_px(middle(&template));
        template.stray = StrayLight::random(&conditions.stray, radius_px, seed);
        let sun = Sun {
            peak_dn: conditions.peak_dn,
            surface: surface(conditions.hmi, seed),
            spots: sunspots(conditions.sunspots, radius_mil, seed),
            covers: conditions.covers.random(radius_mil, seed),
            ..Sun::new(mapping.to_plate(middle(&template)), radius_mil)
        };
        Ok(Self {
            template,
            sun,
            in_view: conditions.sun,
            smear_px: conditions.smear_px,
            seed,
        })
    }

    /// The scene of a frame. The same seed and number always give the same scene.
    pub fn scene(&self, number: u64) -> Result<Scene, SceneError> {
        Ok(Scene {
            sun: self.sun(number)?,
            seed: derived_seed(self.seed, Purpose::Noise, number),
            info: frame_info(number),
            ..self.template.clone()
        })
    }

    /// The scene of a frame with the Sun at a place on the plate, moving with a velocity in mil/s.
    pub(super) fn scene_at(&self, number: u64, centre: PlateMil, per_s: Vector2<f64>) -> Scene {
        Scene {
            sun: Some(Sun {
                centre,
                smear_mil: per_s * EXPOSURE.as_secs_f64(),
                ..self.sun.clone()
            }),
            seed: derived_seed(self.seed, Purpose::Noise, number),
            info: frame_info(number),
            ..self.template.clone()
        }
    }

    /// The scene of a frame that only the camera makes: no Sun, no plate, no stray light; the noise has the seed of a purpose.
    pub(super) fn without_sun(&self, purpose: Purpose, number: u64) -> Scene {
        let mut scene = Scene {
            stray: StrayLight::default(),
            seed: derived_seed(self.seed, purpose, number),
            info: frame_info(number),
            ..self.template.clone()
        };
        scene.blemishes.leaks.clear();
        scene.blemishes.scratches.clear();
        scene
    }

    /// Light at the disc's centre, 8-bit DN.
    pub(super) fn peak_dn(&self) -> f64 {
        self.sun.peak_dn
    }

    /// The mapping of all scenes.
    pub(super) fn mapping(&self) -> &Mapping {
        &self.template.mapping
    }

    fn sun(&self, number: u64) -> Result<Option<Sun>, SceneError> {
        if self.in_view == SunInView::Absent {
            return Ok(None);
        }
        let mapping = &self.template.mapping;
        let mut rng = generator(self.seed, Purpose::Sun, number);
        let reach = self.radius_px();
        let (width, height) = (
            self.template.width_px as f64,
            self.template.height_px as f64,
        );
        // Enough for a sensor on which only one place in a thousand is suitable.
        for _ in 0..20_000 {
            let seen = SensorPx::new(
                rng.random_range(-reach..width + reach),
                rng.random_range(-reach..height + reach),
            );
            let direction = rng.random_range(0.0..TAU);
            let smear_px = unit(direction) * self.smear_px;
            let sun = Sun {
                centre: mapping.to_plate(seen),
                smear_mil: mapping.plate_jacobian(seen) * smear_px,
                ..self.sun.clone()
            };
            if self.suits(&sun, seen) {
                return Ok(Some(sun));
            }
        }
        Err(SceneError::TooSmall {
            width_px: self.template.width_px,
            height_px: self.template.height_px,
            radius_px: reach,
        })
    }

    fn radius_px(&self) -> f64 {
        let scale = self
            .template
            .mapping
            .scale_mil_per_px(middle(&self.template));
        self.sun.radius_mil / scale
    }

    /// Whether the position of the Sun fulfils the conditions.
    fn suits(&self, sun: &Sun, seen: SensorPx) -> bool {
        // A margin for the blur and the smear at the edge.
        let spare = 2.0 + 2.0 * self.template.blur_px + self.smear_px / 2.0;
        let depth = |p: SensorPx| depth_in(&self.template, p);
        let limb = || sun.limb_px(&self.template.mapping).map(depth);
        match self.in_view {
            SunInView::Whole => limb().all(|inside| inside > spare),
            SunInView::Partial => {
                let deepest = limb().fold(f64::NEG_INFINITY, f64::max);
                let outermost = limb().fold(f64::INFINITY, f64::min);
                outermost < -spare && deepest.max(depth(seen)) > 0.5 * self.radius_px()
            }
            SunInView::Absent => false,
        }
    }
}

/// Distance of a position inside the sensor's nearest edge, px; negative outside.
fn depth_in(scene: &Scene, at: SensorPx) -> f64 {
    let (width, height) = (scene.width_px as f64, scene.height_px as f64);
    let x = (at.x + 0.5).min(width - 0.5 - at.x);
    let y = (at.y + 0.5).min(height - 0.5 - at.y);
    x.min(y)
}

fn middle(scene: &Scene) -> SensorPx {
    SensorPx::new(
        (scene.width_px as f64 - 1.0) / 2.0,
        (scene.height_px as f64 - 1.0) / 2.0,
    )
}

/// HMI's picture, turned and mirrored by the seed, or none.
fn surface(hmi: bool, seed: u64) -> Surface {
    let mut rng = generator(seed, Purpose::Optics, 1);
    let turned = Surface::Hmi {
        turn_rad: rng.random_range(0.0..TAU),
        mirrored: rng.random_bool(0.5),
    };
    if hmi { turned } else { Surface::Plain }
}

/// Random spots; they are nearer the disc's centre than its limb, which represents the activity belts.
fn sunspots(count: usize, radius_mil: f64, seed: u64) -> Vec<Sunspot> {
    let mut rng = generator(seed, Purpose::Sun, u64::MAX);
    let spot = |_| {
        let angle = rng.random_range(0.0..TAU);
        let distance = radius_mil * rng.random_range(0.0_f64..0.7).sqrt();
        Sunspot {
            offset_mil: unit(angle) * distance,
            radius_mil: radius_mil * rng.random_range(0.01..0.03),
            contrast: rng.random_range(0.2..0.6),
        }
    };
    (0..count).map(spot).collect()
}
