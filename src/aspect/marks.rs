//! The steps of the pipeline from the marks on the flattened disc to their mapping.

use super::contradiction::check_stated;
use super::stages::{LIMB_DEFINITION_SIGMA_PX, Pipeline, at};
use super::{Mark, Stage, Stopped};
use crate::estimation::median;
use crate::fiducial::{
    self, CrossShape, Detections, FlatDisc, IdentificationPrior, Illumination, Lighting,
    RefinedMark, Refiner,
};
use crate::frame::Cutout;
use crate::geometry::{Ellipse, Mapping};
use crate::limb::{COMA_BLURS, DiscLight, Limb};
use crate::plate::MarkId;
use crate::registration::{self, Outline, Pair, Registration};
use crate::units::{Estimate, Measured, Rejected, SensorPx};
use nalgebra::{Matrix2, Vector2};

/// Relative error of a scale taken from the disc's radius: what the ephemeris calls the Sun's edge and what the limb shows
/// may differ by half a pixel.
const DISC_SCALE_SIGMA: f64 = 0.006;
/// A lens so many times softer than it is stated is out of focus, or behind haze.
const SOFT: f64 = 1.3;
/// 1 sigma of a mark whose pixels do not agree with a cross.
const UNREFINED_SIGMA_PX: f64 = 0.2;
/// Depth inside the limb from which a mark must have been found, in half lengths from tip to tip, beside a pixel by
/// which haze may widen the disc. In simulated frames all are found from 0.5 on.
const SURE_DEPTH: f64 = 0.75;
/// Part of a shift by coma that is uncertain: the displaced light's own blur.
const COMA_OPEN: f64 = 0.2;
/// Largest residual of the marks about their mapping.
const MAX_RESIDUAL_PX: f64 = 0.6;

/// What the marks' fits start from.
pub struct MarkScene<'a> {
    pub cutout: &'a Cutout,
    pub limb: &'a Limb,
    pub mapping: &'a Mapping,
}

/// How far coma shifts the marks against the limb.
struct ComaShift {
    shift_px: Vector2<f64>,
    /// What it adds to the covariance of each mark.
    covariance_px2: Matrix2<f64>,
}

impl ComaShift {
    fn removed_from(&self, found: RefinedMark) -> RefinedMark {
        let place = Estimate {
            position: (found.place.position.vector() - self.shift_px).into(),
            covariance: found.place.covariance + self.covariance_px2,
        };
        RefinedMark { place, ..found }
    }
}

impl Pipeline<'_> {
    /// Scale at the disc, from its radius.
    fn disc_scale(&self, disc: &Ellipse) -> f64 {
        self.radius_mil.value / disc.mean_radius()
    }

    /// Blur of the marks, 1 sigma, without the pixel's own size.
    fn mark_blur_px(&self, limb: &Limb) -> f64 {
        let stated_px = self.instrument.optics.blur_px.value;
        let limb_px = limb.lens_blur_px();
        if limb_px > SOFT * stated_px {
            limb_px
        } else {
            stated_px
        }
    }

    /// The cross at the scale of the disc and the blur of the frame.
    fn disc_shape(&self, limb: &Limb) -> CrossShape {
        let scale = self.disc_scale(&limb.outline.ellipse);
        CrossShape::new(&self.instrument.plate.cross, scale, self.mark_blur_px(limb))
    }

    pub fn detect(&self, cutout: &Cutout, limb: &Limb) -> Detections {
        let shape = self.disc_shape(limb);
        match FlatDisc::new(cutout, limb.outline.ellipse, &limb.light(), &shape) {
            Some(flat) => fiducial::detect(&flat, &shape, &self.settings.fiducial),
            None => Detections::default(),
        }
    }

    /// Marks by their own pixels, without the shift that coma gives them against the limb; none where the pixels do not
    /// agree with a cross.
    pub(super) fn refine(&self, scene: &MarkScene<'_>, marks: &[Mark]) -> Vec<Option<RefinedMark>> {
        let limb = scene.limb;
        let scale = self.disc_scale(&limb.outline.ellipse);
        let plate = &self.instrument.plate;
        let refiner = Refiner::new(&plate.cross, scale, self.mark_blur_px(limb));
        let light = limb.light();
        let coma = self.coma_shift(limb, marks.len());
        let refined = |mark: &Mark| {
            let jacobian = scene.mapping.sensor_jacobian(plate.position(mark.id));
            let found = refiner.refine(scene.cutout, &light, &jacobian, mark.at)?;
            Some(coma.removed_from(found))
        };
        marks.iter().map(refined).collect()
    }

    /// Marks that were read, each placed by its own pixels. One whose pixels do not agree keeps its first place, and a
    /// sigma that gives it little weight.
    pub fn place(&self, scene: &MarkScene<'_>, marks: &[Mark]) -> Vec<Mark> {
        let refined = self.refine(scene, marks);
        let placed = marks.iter().zip(&refined).map(|(mark, found)| match found {
            Some(found) => mark.placed(found),
            None => Mark {
                covariance_px2: Matrix2::identity() * UNREFINED_SIGMA_PX.powi(2),
                ..*mark
            },
        });
        placed.collect()
    }

    /// By how much coma shifts marks against the limb. Its uncertainty moves all marks alike: so many must not average it
    /// away.
    fn coma_shift(&self, limb: &Limb, marks: usize) -> ComaShift {
        let (coma, covariance) = limb.coma();
        let response = self.disc_shape(limb).coma_shift(COMA_BLURS);
        let open = covariance + Matrix2::identity() * (COMA_OPEN * coma.norm()).powi(2);
        ComaShift {
            shift_px: response * coma,
            covariance_px2: marks as f64 * response.powi(2) * open,
        }
    }

    pub(super) fn identify(
        &self,
        detections: &Detections,
        limb: &Limb,
    ) -> Result<Vec<Mark>, Stopped> {
        let mounting = &self.instrument.mounting;
        let radius = self.radius_mil.value;
        let relative = (self.radius_mil.sigma / radius).hypot(DISC_SCALE_SIGMA);
        let prior = IdentificationPrior {
            outline: limb.outline.ellipse,
            radius_mil: Measured::new(radius, radius * relative),
            quarter_rotation_deg: detections.quarter_rotation_deg,
            handedness: mounting.handedness,
            plate_centre: mounting.plate_centre_px,
            plate_centre_sigma_px: mounting.plate_centre_sigma_px,
            rotation_deg: mounting.rotation_deg,
            scale_mil_per_px: mounting.scale_mil_per_px,
            missed_share: missed_share(detections),
            sure_depth_px: SURE_DEPTH * self.shape.half_length_px + 1.0,
            sure_margin_px: self.shape.half_length_px + 4.0,
            sensor_px: [self.frame.width() as f64, self.frame.height() as f64],
        };
        let settings = &self.settings.fiducial;
        let found = &detections.marks;
        let identification = fiducial::identify(found, &prior, &self.instrument.plate, settings)
            .map_err(at(Stage::Identification))?;
        let named = identification.ids.into_iter().map(|(n, id)| Mark {
            id,
            at: found[n].at,
            covariance_px2: Matrix2::identity() * found[n].sigma_px.powi(2),
            lighting: found[n].lighting,
        });
        Ok(named.collect())
    }

    /// The mapping from the fully lit marks, and the disc on the plate where its limb is given.
    pub(super) fn register(
        &self,
        marks: &[Mark],
        limb: Option<&Limb>,
    ) -> Result<Registration, Stopped> {
        let mut pairs = Vec::with_capacity(marks.len());
        let used = marks
            .iter()
            .filter(|mark| limb.is_some() || mark.lighting == Lighting::Full);
        pairs.extend(used.map(|mark| Pair {
            observed: mark.at,
            printed: self.instrument.plate.position(mark.id),
            covariance_px2: mark.covariance_px2 + self.poorly_known_px2(mark.id),
        }));
        let reject = |reason, measured, limit| {
            at(Stage::Registration)(Rejected {
                reason,
                measured,
                limit,
            })
        };
        let least = self.settings.fiducial.min_marks;
        if pairs.len() < least {
            let reason = "too few fully lit marks have an id";
            return Err(reject(reason, pairs.len() as f64, least as f64));
        }
        let points = limb.map_or(&[][..], |limb| &limb.points);
        let points: Vec<(SensorPx, f64)> = points.iter().map(|p| (p.at, p.sigma_px)).collect();
        let outline = limb.map(|limb| Outline {
            ellipse: limb.outline.ellipse,
            points: &points,
            radius_mil: self.loose_radius_mil(),
        });
        let registration = registration::register(
            &pairs,
            outline.as_ref(),
            self.instrument.mounting.handedness,
            self.instrument.camera.distortion,
            &self.settings.registration,
        )
        .ok_or_else(|| {
            reject(
                "the marks determine no mapping",
                pairs.len() as f64,
                least as f64,
            )
        })?;
        if registration.residual_px > MAX_RESIDUAL_PX {
            let reason = "the marks do not fit a mapping";
            return Err(reject(reason, registration.residual_px, MAX_RESIDUAL_PX));
        }
        check_stated(
            &registration,
            marks,
            self.instrument,
            self.loose_radius_mil(),
        )
        .map_err(at(Stage::Registration))?;
        Ok(registration)
    }

    /// A mark that is known less well than the plate's best weighs less: on a plate that was measured, the few marks that
    /// nobody saw are still where the drawing puts them.
    fn poorly_known_px2(&self, id: MarkId) -> Matrix2<f64> {
        let scale = self.instrument.mounting.scale_mil_per_px.value;
        Matrix2::identity() * (self.instrument.plate.excess_variance_mil2(id) / scale.powi(2))
    }

    /// The disc's radius on the plate, so loosely that a whole limb determines it; a short one depends on it.
    fn loose_radius_mil(&self) -> Measured {
        let definition = LIMB_DEFINITION_SIGMA_PX * self.instrument.mounting.scale_mil_per_px.value;
        Measured::new(
            self.radius_mil.value,
            self.radius_mil.sigma.hypot(definition),
        )
    }
}

/// The disc's light illuminates the marks.
impl Illumination for DiscLight {
    fn fill(&self, x: f64, y: f64, light: &mut [f32]) {
        self.fill(x, y, light);
    }
}

impl Mark {
    /// The mark where its pixels show it.
    pub fn placed(&self, found: &RefinedMark) -> Self {
        Self {
            at: found.place.position,
            covariance_px2: found.place.covariance,
            ..*self
        }
    }
}

/// Share of the marks that go unseen, by how well the others are seen. Held above what simulated frames show: none of some
/// 1,500 where marks are plain, 0.3 % in haze, 1.4 % of faint ones among blemishes.
fn missed_share(detections: &Detections) -> f64 {
    const MOST: f64 = 0.1;
    const LEAST: f64 = 0.003;
    const SIGMA_OF_MOST_PX: f64 = 0.08;
    match median(detections.marks.iter().map(|d| d.sigma_px)) {
        Some(median) => (MOST * (median / SIGMA_OF_MOST_PX).powi(2)).clamp(LEAST, MOST),
        None => MOST,
    }
}
