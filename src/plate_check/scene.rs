//! Detections of a plate with the Sun at a given position, without a frame.

use super::Rotations;
use crate::aspect::{Expected, MARK_MARGIN_PX, Pipeline, SolverSettings};
use crate::fiducial::{self, Detection, Detections, Identified, Lighting, MarkImage, Unread};
use crate::frame::Region;
use crate::geometry::{Circle, Ellipse, Mapping, unit};
use crate::instrument::{Instrument, SMALLEST_SUN_ARCSEC};
use crate::plate::MarkId;
use crate::units::{Measured, PlateMil, SensorPx};
use nalgebra::Matrix2;
use rand::{Rng, RngExt};
use rand_distr::StandardNormal;
use std::f64::consts::TAU;

/// Contrast of a typical print.
pub(super) const CONTRAST: f64 = 0.8;
/// Uncertainty of the camera's rotation from the arms, 1 sigma.
const ARMS_SIGMA_DEG: f64 = 0.6;

/// A plate in front of a camera: the common input for all positions of the Sun. The Sun has its smallest size, which lights
/// the fewest marks.
pub(super) struct PlateView<'a> {
    pub instrument: &'a Instrument,
    solver: &'a SolverSettings,
    pipeline: Pipeline<'a>,
    /// Mapping of the camera with the stated mounting.
    pub stated: Mapping,
    pub image: MarkImage,
    /// Uncertainty of a mark's detection, 1 sigma per axis.
    pub sigma_px: f64,
}

impl<'a> PlateView<'a> {
    /// `None` if the stated mounting gives no mapping.
    pub fn new(
        instrument: &'a Instrument,
        solver: &'a SolverSettings,
        noise_share: f64,
    ) -> Option<Self> {
        let expected = Expected {
            radius_arcsec: SMALLEST_SUN_ARCSEC,
        };
        let scale = instrument.mounting.scale_mil_per_px.value;
        let image = MarkImage::new(
            &instrument.plate.shape,
            scale,
            instrument.optics.blur_px.value,
        );
        Some(Self {
            instrument,
            solver,
            pipeline: Pipeline::new(solver, instrument, Some(expected)),
            stated: instrument.nominal_mapping()?,
            sigma_px: image.place_sigma_px(noise_share / CONTRAST),
            image,
        })
    }

    /// A camera whose mounting is drawn from the stated one and its sigmas, or has any rotation.
    pub fn drawn(&self, rotations: Rotations, rng: &mut impl Rng) -> Mapping {
        let mut mounting = (self.instrument.mounting).drawn(|| rng.sample(StandardNormal));
        if rotations == Rotations::Any {
            mounting.rotation_deg = rng.random_range(0.0..360.0);
        }
        let drawn = Mapping::similarity(mounting, self.instrument.camera.distortion);
        drawn.unwrap_or(self.stated)
    }

    /// Radius of the Sun on the plate.
    pub fn radius_mil(&self) -> f64 {
        self.instrument.optics.radius_mil(SMALLEST_SUN_ARCSEC)
    }
}

/// A mark that the Sun lights, wholly or in part.
#[derive(Debug, Clone, Copy)]
pub(super) struct LitMark {
    pub id: MarkId,
    pub at: SensorPx,
    pub lighting: Lighting,
    /// Whether it is found at any contrast.
    pub is_sure: bool,
    /// Uncertainty of its printed position, 1 sigma per axis.
    pub print_mil: f64,
}

/// The Sun at a position of the plate in front of a camera with some mounting.
pub(super) struct CheckScene<'a> {
    pub view: &'a PlateView<'a>,
    pub outline: Ellipse,
    pub marks: Vec<LitMark>,
    /// A mark's arms, or two radii of a dot, as offsets on the sensor, px.
    pub arms: Matrix2<f64>,
}

impl<'a> CheckScene<'a> {
    pub fn new(view: &'a PlateView, sun: PlateMil, mapping: &Mapping) -> Self {
        let (plate, radius_mil) = (&view.instrument.plate, view.radius_mil());
        let centre = mapping.to_sensor(sun);
        let radius_px = radius_mil / mapping.scale_mil_per_px(centre);
        let outline = Ellipse::from(Circle {
            centre: centre.vector(),
            radius: radius_px,
        });
        let region = view.sensor();
        let half_mil = plate.shape.size_mil() / 2.0;
        let arms = mapping.sensor_jacobian(sun) * plate.shape.arms() * half_mil;
        let mut marks = Vec::new();
        for (id, printed) in plate.marks() {
            if printed.distance(sun) > radius_mil {
                continue;
            }
            let at = mapping.to_sensor(printed);
            if !region.holds(at, view.image.reach_px()) {
                continue;
            }
            let depth_px = radius_px - at.distance(centre);
            marks.push(LitMark {
                id,
                at,
                lighting: Lighting::of(at, view.image.tips(&arms), &outline, &region),
                is_sure: depth_px > view.image.sure_depth_px(),
                print_mil: plate
                    .place(id)
                    .map_or(0.0, |place| place.variance_mil2().sqrt()),
            });
        }
        Self {
            view,
            outline,
            marks,
            arms,
        }
    }

    pub fn radius_px(&self) -> f64 {
        self.outline.mean_radius()
    }

    /// Number of fully lit marks.
    pub fn lit(&self) -> usize {
        self.full().count()
    }

    /// The fully lit marks.
    pub fn full(&self) -> impl Iterator<Item = &LitMark> {
        self.marks.iter().filter(|m| m.lighting == Lighting::Full)
    }

    /// Fraction of the limb not masked by marks of the plate, 0 to 1.
    pub fn limb_free(&self, sun: PlateMil) -> f64 {
        const POINTS: usize = 360;
        let (plate, radius_mil) = (&self.view.instrument.plate, self.view.radius_mil());
        let margin_mil = MARK_MARGIN_PX * radius_mil / self.radius_px();
        let reach_mil = plate.shape.size_mil() / 2.0 + margin_mil;
        let beside = |at: &PlateMil| (at.distance(sun) - radius_mil).abs() < reach_mil;
        let marks = plate.marks().map(|(_, at)| at);
        let near: Vec<PlateMil> = marks.filter(beside).collect();
        let covers = plate.shape.covers(margin_mil, &Matrix2::identity());
        let free = |n: &usize| {
            let angle = TAU * *n as f64 / POINTS as f64;
            let limb = sun.vector() + unit(angle) * radius_mil;
            !near.iter().any(|at| covers(limb - at.vector()))
        };
        (0..POINTS).filter(free).count() as f64 / POINTS as f64
    }

    /// Detections if only the marks that must be found are found.
    pub fn all_found(&self, rng: &mut impl Rng) -> Seen {
        let mut seen = Seen::new(self);
        for mark in self.marks.iter().filter(|mark| mark.is_sure) {
            seen.push(Some(mark.id), self.detection(mark, rng));
        }
        seen
    }

    /// A detection of a mark, displaced by its own sigma and by the print's.
    pub fn detection(&self, mark: &LitMark, rng: &mut impl Rng) -> Detection {
        let print_px = mark.print_mil * self.radius_px() / self.view.radius_mil();
        let sigma_px = self.view.sigma_px.hypot(print_px);
        let mut off = || sigma_px * rng.sample::<f64, _>(StandardNormal);
        Detection {
            at: SensorPx::new(mark.at.x + off(), mark.at.y + off()),
            sigma_px: self.view.sigma_px,
            contrast: CONTRAST,
            likeness: 1.0,
            lighting: mark.lighting,
        }
    }

    /// The flight's identification of detections.
    pub fn identify(&self, detections: &Detections) -> Result<Identified, Unread> {
        let PlateView {
            instrument, solver, ..
        } = self.view;
        let sensor_px = instrument.camera.size_px().map(|side| side as f64);
        let mounting = &instrument.mounting;
        let pipeline = &self.view.pipeline;
        let prior = pipeline.identification_prior(sensor_px, self.outline, detections, mounting);
        fiducial::identify_with_margin(
            &detections.marks,
            &prior,
            &instrument.plate,
            &solver.fiducial,
        )
    }

    /// The lighting of an object of a mark's size.
    pub fn lighting(&self, at: SensorPx) -> Lighting {
        let view = self.view;
        Lighting::of(
            at,
            view.image.tips(&self.arms),
            &self.outline,
            &view.sensor(),
        )
    }
}

impl PlateView<'_> {
    fn sensor(&self) -> Region {
        let [x1, y1] = self.instrument.camera.size_px();
        Region {
            x0: 0,
            y0: 0,
            x1,
            y1,
        }
    }
}

/// Detections, and the marks that they truly are.
pub(super) struct Seen {
    pub detections: Detections,
    /// One for each detection; `None` for a false one.
    pub ids: Vec<Option<MarkId>>,
}

impl Seen {
    /// Only the direction of the arms, if the camera resolves them.
    pub fn new(scene: &CheckScene) -> Self {
        let arm = scene.arms;
        let arms_deg = arm.m21.atan2(arm.m11).to_degrees().rem_euclid(90.0);
        let shows_arms = scene.view.image.shows_arms();
        Self {
            detections: Detections {
                marks: Vec::new(),
                arms_deg: shows_arms.then_some(Measured::new(arms_deg, ARMS_SIGMA_DEG)),
            },
            ids: Vec::new(),
        }
    }

    pub fn push(&mut self, id: Option<MarkId>, detection: Detection) {
        self.ids.push(id);
        self.detections.marks.push(detection);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::instrument::builtin;
    use crate::plate::{MarkPlace, MarkShape, Pattern, Plate};

    #[test]
    fn a_dot_on_the_limb_hides_as_much_of_it_as_it_is_wide() {
        let (solver, sun) = (SolverSettings::default(), PlateMil::new(100.0, -50.0));
        let mut demo = builtin("demo").unwrap();
        let radius_mil = demo.optics.radius_mil(SMALLEST_SUN_ARCSEC);
        let mark = |(i, at): (i32, [f64; 2])| {
            let at = PlateMil::from(sun.vector() + nalgebra::Vector2::from(at));
            (MarkId { i, j: 0 }, MarkPlace::new(at, 1.0))
        };
        // One on the limb, one inside, one outside.
        let marks = [[radius_mil, 0.0], [0.0, 200.0], [-900.0, 0.0]];
        let shape = MarkShape::Dot { diameter_mil: 60.0 };
        demo.plate = Plate::new(Pattern::Listed, shape, 1.0, (1..).zip(marks).map(mark));
        let view = PlateView::new(&demo, &solver, 0.02).unwrap();
        let scene = CheckScene::new(&view, sun, &view.stated);
        let reach_mil = 30.0 + MARK_MARGIN_PX * demo.mounting.scale_mil_per_px.value;
        let hidden = 4.0 * (reach_mil / radius_mil / 2.0).asin() / TAU;
        let free = scene.limb_free(sun);
        assert!((free - (1.0 - hidden)).abs() < 2.0 / 360.0, "{free}");
    }
}
