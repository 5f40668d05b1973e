//! What would be detected of a plate with the Sun at some place, without a frame.

use super::{CheckSettings, Rotations};
use crate::aspect::{Expected, Pipeline, SolverSettings};
use crate::fiducial::{Detection, Detections, Identified, Lighting, MarkImage, Unread};
use crate::frame::Region;
use crate::geometry::{Circle, Ellipse, SimilarityParameters};
use crate::instrument::Instrument;
use crate::plate::MarkId;
use crate::units::{Measured, PlateMil, SensorPx};
use nalgebra::Vector2;
use rand::{Rng, RngExt};
use rand_distr::StandardNormal;

/// The Sun at 1 AU.
const RADIUS_ARCSEC: f64 = 959.23;
/// Contrast of a usual print.
const CONTRAST: f64 = 0.8;
/// How well the arms show the camera's rotation, 1 sigma.
const ARMS_SIGMA_DEG: f64 = 0.6;

/// A mark that would be detected.
#[derive(Debug, Clone, Copy)]
struct SeenMark {
    at: SensorPx,
    lighting: Lighting,
}

/// The Sun at a place of the plate before a camera that is mounted somehow.
pub(super) struct CheckScene<'a> {
    pub instrument: &'a Instrument,
    pipeline: Pipeline<'a>,
    sun: PlateMil,
    mounting: SimilarityParameters,
    marks: Vec<SeenMark>,
    /// Of the marks, in their order.
    pub ids: Vec<MarkId>,
    pub image: MarkImage,
    /// Of a mark's detection, 1 sigma per axis.
    pub sigma_px: f64,
    pub radius_px: f64,
}

impl<'a> CheckScene<'a> {
    /// Before the camera as it is stated.
    pub fn stated(
        instrument: &'a Instrument,
        solver: &'a SolverSettings,
        settings: &CheckSettings,
        sun: PlateMil,
    ) -> Self {
        let expected = Expected {
            radius_arcsec: RADIUS_ARCSEC,
        };
        let (scale, blur_px) = (
            instrument.mounting.scale_mil_per_px.value,
            instrument.optics.blur_px.value,
        );
        let image = MarkImage::new(&instrument.plate.shape, scale, blur_px);
        let mut scene = Self {
            instrument,
            pipeline: Pipeline::new(solver, instrument, Some(expected)),
            sun,
            mounting: instrument.mounting.similarity(),
            marks: Vec::new(),
            ids: Vec::new(),
            image,
            sigma_px: image.place_sigma_px(settings.noise_share / CONTRAST),
            radius_px: instrument.radius_px(RADIUS_ARCSEC),
        };
        scene.see();
        scene
    }

    /// Before a camera whose mounting is off the stated one as far as its sigmas say, or is turned anyhow.
    pub fn drawn(&self, rotations: Rotations, rng: &mut impl Rng) -> Self {
        let stated = &self.instrument.mounting;
        let mut off = |sigma: f64| sigma * rng.sample::<f64, _>(StandardNormal);
        let mut mounting = stated.similarity();
        mounting.plate_centre.x += off(stated.plate_centre_sigma_px);
        mounting.plate_centre.y += off(stated.plate_centre_sigma_px);
        mounting.scale_mil_per_px += off(stated.scale_mil_per_px.sigma);
        match rotations {
            Rotations::Stated => mounting.rotation_deg += off(stated.rotation_deg.sigma),
            Rotations::Any => mounting.rotation_deg = rng.random_range(0.0..360.0),
        }
        let mut scene = Self {
            pipeline: self.pipeline.clone(),
            mounting,
            marks: Vec::new(),
            ids: Vec::new(),
            ..*self
        };
        scene.see();
        for mark in &mut scene.marks {
            let mut off = || self.sigma_px * rng.sample::<f64, _>(StandardNormal);
            mark.at = SensorPx::new(mark.at.x + off(), mark.at.y + off());
        }
        scene
    }

    /// Fills in the marks that the Sun lights so far that they are detected.
    fn see(&mut self) {
        /// How far inside the limb a mark's middle must be, in half its size; see `SURE_DEPTH` of the solver.
        const DETECTED_DEPTH: f64 = 0.75;
        let plate = &self.instrument.plate;
        let half_mil = plate.shape.size_mil() / 2.0;
        let scale = self.mounting.scale_mil_per_px;
        let reach_mil = self.radius_px * scale - DETECTED_DEPTH * half_mil;
        let (outline, region) = (self.outline(), self.region());
        let arms = self.direction(plate.shape.arms() * (half_mil / scale));
        for (id, at) in plate.drawn_marks() {
            let seen = self.on_sensor(at);
            if at.distance(self.sun) > reach_mil || !region.holds(seen, self.image.reach_px()) {
                continue;
            }
            let lighting = Lighting::of(seen, self.image.tips(&arms), &outline, &region);
            self.marks.push(SeenMark { at: seen, lighting });
            self.ids.push(id);
        }
    }

    fn region(&self) -> Region {
        let [x1, y1] = self.instrument.camera.size_px();
        Region {
            x0: 0,
            y0: 0,
            x1,
            y1,
        }
    }

    /// Plate axes as they are seen, apart from scale.
    fn direction(&self, of: nalgebra::Matrix2<f64>) -> nalgebra::Matrix2<f64> {
        let rotation = nalgebra::Rotation2::new(self.mounting.rotation_deg.to_radians());
        rotation.matrix() * self.mounting.handedness.axes() * of
    }

    fn on_sensor(&self, at: PlateMil) -> SensorPx {
        let turned = self.direction(nalgebra::Matrix2::identity()) * at.vector();
        let from_centre: Vector2<f64> = turned / self.mounting.scale_mil_per_px;
        SensorPx::from(self.mounting.plate_centre.vector() + from_centre)
    }

    fn outline(&self) -> Ellipse {
        Ellipse::from(Circle {
            centre: self.on_sensor(self.sun).vector(),
            radius: self.radius_px,
        })
    }

    /// How many marks are fully lit.
    pub fn lit(&self) -> usize {
        self.full_px().count()
    }

    /// Where the fully lit marks are from the Sun's centre, px.
    pub fn full_px(&self) -> impl Iterator<Item = Vector2<f64>> + '_ {
        let centre = self.on_sensor(self.sun).vector();
        let full = self.marks.iter().filter(|m| m.lighting == Lighting::Full);
        full.map(move |mark| mark.at.vector() - centre)
    }

    /// What the flight's detection would give.
    pub fn detections(&self) -> Detections {
        let detection = |mark: &SeenMark| Detection {
            at: mark.at,
            sigma_px: self.sigma_px,
            contrast: CONTRAST,
            likeness: 1.0,
            lighting: mark.lighting,
        };
        let plate = &self.instrument.plate;
        let arm = self.direction(plate.shape.arms());
        let arms_deg = arm.m21.atan2(arm.m11).to_degrees().rem_euclid(90.0);
        Detections {
            marks: self.marks.iter().map(detection).collect(),
            arms_deg: self
                .image
                .shows_arms()
                .then_some(Measured::new(arms_deg, ARMS_SIGMA_DEG)),
        }
    }

    /// What the flight makes of them.
    pub fn identify(&self, detections: &Detections) -> Result<Identified, Unread> {
        let sensor_px = self.instrument.camera.size_px().map(|side| side as f64);
        self.pipeline
            .identify(sensor_px, self.outline(), detections)
    }
}
