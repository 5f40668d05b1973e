//! The last steps of the pipeline: from a mapping and the limb to the Sun's centre, its uncertainty and the quality.

use super::stages::{LIMB_DEFINITION_SIGMA_PX, Pipeline, at};
use super::{Adopted, Aspect, Mark, Quality, Stage, Stopped, Track};
use crate::estimation::CONTRADICTION_SIGMAS;
use crate::geometry::{Mapping, TILT_PER_PX};
use crate::limb::{self, Limb};
use crate::plate::{MarkId, MarkPlace, Plate};
use crate::reasons::sun;
use crate::registration::{self, Outline, Pair, Registration};
use crate::units::{Estimate, Measured, Rejected, SensorPx};
use nalgebra::{Matrix2, Vector2};

/// Largest residual of the marks about their mapping.
const MAX_RESIDUAL_PX: f64 = 0.6;
/// Largest scatter of the limb about its outline: the Sun's is a tenth of this, that of a square ten times as large.
const MAX_SCATTER_PX: f64 = 1.0;
/// Minimum fraction of the limb's points on its outline: marks and scratches mask a tenth of them.
const LEAST_ON_OUTLINE: f64 = 0.6;
/// The limb fit is valid for an image that moves by so many px during the exposure, four times the motion by the fastest
/// slew (0.25 deg/s for 15 ms); if it moves farther, its outline is no longer a circle.
const MOST_MOTION_PX: f64 = 5.0;
/// Minimum fraction of the limb for a fine solution.
const LEAST_FINE_LIMB: f64 = 0.4;

impl Pipeline<'_> {
    /// The mapping and the disc on the plate, fitted to marks and limb together.
    pub(super) fn register(&self, marks: &[Mark], limb: &Limb) -> Result<Registration, Rejected> {
        let pair = |mark: &Mark| {
            Some(Pair {
                observed: mark.at,
                printed: self.instrument.plate.position(mark.id)?,
                covariance_px2: mark.covariance_px2 + self.poorly_known_px2(mark.id),
            })
        };
        let pairs: Vec<Pair> = marks.iter().filter_map(pair).collect();
        let (count, least) = (pairs.len() as f64, self.settings.fiducial.min_marks as f64);
        Rejected::at_least(least, count, sun::FEW_MARKS)?;
        let outline = Outline {
            ellipse: limb.outline.ellipse,
            points: &limb.normal_points(),
            radius_mil: self.loose_radius_mil(),
        };
        let registration = registration::register(
            &pairs,
            Some(&outline),
            self.instrument.mounting.handedness,
            self.instrument.camera.distortion,
            &self.settings.registration,
        )
        .ok_or(Rejected {
            reason: sun::NO_MAPPING,
            measured: count,
            limit: least,
        })?;
        let reason = sun::MARKS_OFF_MAPPING;
        Rejected::at_most(MAX_RESIDUAL_PX, registration.residual_px, reason)?;
        Ok(registration)
    }

    /// Compares the scale and the disc's radius with those of instrument and ephemeris.
    ///
    /// # Errors
    /// If the scale at the Sun, in any direction, differs from the stated one by more than five sigma plus the allowance
    /// for a tilt, or if the radius on the plate differs from the expected one by more than five sigma. Both sigmas include
    /// those of the frame and of the print.
    pub(super) fn check_stated(&self, own: &Registration, marks: &[Mark]) -> Result<(), Rejected> {
        let Some(disc) = own.disc else {
            return Ok(());
        };
        let radius_mil = self.loose_radius_mil();
        let [.., x_px, y_px] = own.at_plate_centre();
        let sun = disc.on_sensor.position;
        let from_sun_px = (x_px.value - sun.x).hypot(y_px.value - sun.y);
        let printed = printed_mil(marks, &self.instrument.plate) / radius_mil.value;
        let stated = self.instrument.mounting.scale_mil_per_px;
        for scale in own.principal_scales(disc.on_plate.position) {
            let sigma = (stated.sigma.hypot(scale.sigma) / stated.value).hypot(printed);
            Rejected::at_most(
                // Along the tilt the scale changes twice as much as across it.
                CONTRADICTION_SIGMAS * sigma + 2.0 * TILT_PER_PX * from_sun_px,
                (scale.value / stated.value - 1.0).abs(),
                sun::SCALE,
            )?;
        }
        let sigma_mil = radius_mil.sigma.hypot(disc.radius_mil.sigma);
        Rejected::at_most(
            CONTRADICTION_SIGMAS * (sigma_mil / radius_mil.value).hypot(printed),
            (disc.radius_mil.value / radius_mil.value - 1.0).abs(),
            sun::RADIUS_OF_DISC,
        )
    }

    /// A mark known less well than the plate's best one has a lower weight: on a measured plate, the few unmeasured marks
    /// keep their drawn positions.
    fn poorly_known_px2(&self, id: MarkId) -> Matrix2<f64> {
        let scale = self.instrument.mounting.scale_mil_per_px.value;
        Matrix2::identity() * (self.instrument.plate.excess_variance_mil2(id) / scale.powi(2))
    }

    /// Prior of the disc's radius on the plate, so loose that a whole limb determines it; on a short limb the prior
    /// dominates.
    fn loose_radius_mil(&self) -> Measured {
        let definition = LIMB_DEFINITION_SIGMA_PX * self.instrument.mounting.scale_mil_per_px.value;
        Measured::new(
            self.radius_mil.value,
            self.radius_mil.sigma.hypot(definition),
        )
    }

    /// This frame's mapping, else the prior's, else the calibration's.
    pub(super) fn adopt(
        &self,
        own: Option<Registration>,
        prior: Option<&Track>,
    ) -> Result<Adopted, Stopped> {
        let earlier = || prior?.registration.clone().map(Adopted::Prior);
        let calibrated = || self.instrument.nominal_mapping().map(Adopted::Calibration);
        let adopted = own.map(Adopted::Own).or_else(earlier);
        adopted.or_else(calibrated).ok_or(Stopped {
            stage: Stage::Registration,
            rejected: Rejected {
                reason: sun::CALIBRATION_SINGULAR,
                measured: 0.0,
                limit: 0.0,
            },
        })
    }

    /// The Sun's position on sensor and plate.
    pub(super) fn aspect(&self, limb: &Limb, adopted: &Adopted) -> Result<Aspect, Stopped> {
        check_round(limb).map_err(at(Stage::Limb))?;
        let aspect = match adopted.own().and_then(|own| own.disc) {
            Some(disc) => Aspect {
                sun_px: disc.on_sensor,
                sun_radius_px: self.with_sigma_of_profile(disc.radius_px, limb),
                mapping: adopted.local_similarity(disc.on_sensor.position, self.instrument),
                sun_plate: disc.on_plate,
                limb_fraction: limb_fraction(limb),
            },
            None => self.borrowed_aspect(limb, adopted),
        };
        let radius_mil = aspect.sun_radius_px.value * aspect.mapping.scale_mil_per_px.value;
        let deviation = (radius_mil / self.radius_mil.value - 1.0).abs();
        let limit = self.settings.limb.max_radius_deviation;
        let reason = sun::SIZE;
        Rejected::at_most(limit, deviation, reason).map_err(at(Stage::Aspect))?;
        Ok(aspect)
    }

    /// Rejects the marks if the image moved so far that the fitted size and light of the Sun would bias them.
    pub(super) fn check_motion(&self, limb: &Limb) -> Result<(), Stopped> {
        let reason = sun::MOVED;
        Rejected::at_most(MOST_MOTION_PX, self.motion_px(limb), reason).map_err(at(Stage::Limb))
    }

    fn motion_px(&self, limb: &Limb) -> f64 {
        limb.light
            .most_motion_px(self.instrument.optics.blur_px.value, limb_fraction(limb))
    }

    /// The outline's centre through a borrowed mapping.
    fn borrowed_aspect(&self, limb: &Limb, adopted: &Adopted) -> Aspect {
        let mapping = adopted.mapping();
        let outline = &limb.outline;
        let on_sensor = disc_centre(
            mapping,
            outline.ellipse.centre.into(),
            self.radius_mil.value,
        );
        let on_plate = mapping.to_plate(on_sensor);
        let to_plate = mapping.plate_jacobian(on_sensor);
        // A moving image adds its motion to the uncertainty.
        let moved = match self.check_motion(limb) {
            Ok(()) => 0.0,
            Err(_) => limb::motion_variance_px2(self.motion_px(limb)),
        };
        let centre = outline.centre_covariance() + Matrix2::identity() * moved;
        let radius_sigma_px = outline.radius_sigma_px().hypot(moved.sqrt());
        let radius_px = Measured::new(outline.ellipse.mean_radius(), radius_sigma_px);
        Aspect {
            sun_px: Estimate {
                position: on_sensor,
                covariance: centre,
            },
            sun_radius_px: self.with_sigma_of_profile(radius_px, limb),
            mapping: adopted.local_similarity(on_sensor, self.instrument),
            sun_plate: Estimate {
                position: on_plate,
                covariance: to_plate * centre * to_plate.transpose()
                    + adopted.covariance_mil2(on_plate, self.instrument),
            },
            limb_fraction: limb_fraction(limb),
        }
    }

    /// Adds the uncertainty of the limb's profile, which moves all points together, to a radius, in proportion to the
    /// weight of the points against the prior.
    fn with_sigma_of_profile(&self, radius_px: Measured, limb: &Limb) -> Measured {
        let stated = limb.outline.radius_sigma_px() / self.stated_radius_px().sigma;
        let by_points = (1.0 - stated.powi(2)).max(0.0);
        Measured {
            sigma: radius_px
                .sigma
                .hypot(by_points * limb.light.place_sigma_px()),
            ..radius_px
        }
    }
}

/// Compares a borrowed position with the one from the frame's own marks, if their mapping is not adopted.
///
/// # Errors
/// If the two positions on the plate contradict each other.
pub(super) fn check_borrowed(borrowed: &Aspect, own: &Registration) -> Result<(), Rejected> {
    let Some(disc) = own.disc else {
        return Ok(());
    };
    let (there, here) = (&borrowed.sun_plate, &disc.on_plate);
    let apart = there.position.vector() - here.position.vector();
    let inverse = (there.covariance + here.covariance).try_inverse();
    let sigmas = inverse.map_or(0.0, |inverse| apart.dot(&(inverse * apart)).sqrt());
    let reason = sun::BORROWED_CONTRADICTED;
    Rejected::at_most(CONTRADICTION_SIGMAS, sigmas, reason)
}

/// The quality, and the reason for a coarse one if no earlier stage gave it.
pub(super) fn judge(aspect: &Aspect, adopted: &Adopted) -> (Quality, Option<Stopped>) {
    let reason = sun::PART_OF_LIMB;
    match Rejected::at_least(LEAST_FINE_LIMB, aspect.limb_fraction, reason) {
        Err(rejected) => (Quality::Coarse, Some(at(Stage::Aspect)(rejected))),
        Ok(()) if adopted.own().is_some() => (Quality::Fine, None),
        Ok(()) => (Quality::Coarse, None),
    }
}

/// Uncertainty of the printed positions of a frame's marks, 1 sigma per axis.
pub(crate) fn printed_mil(marks: &[Mark], plate: &Plate) -> f64 {
    let places = marks.iter().filter_map(|mark| plate.place(mark.id));
    let squares: f64 = places
        .map(
            |MarkPlace {
                 sigma_mil: [x, y], ..
             }| (x * x + y * y) / 2.0,
        )
        .sum();
    (squares / marks.len().max(1) as f64).sqrt()
}

/// Visible fraction of the limb, 0 to 1.
fn limb_fraction(limb: &Limb) -> f64 {
    let points = limb.points.iter().map(|point| point.at.vector());
    limb::arc_fraction(points, limb.outline.ellipse.centre)
}

fn check_round(limb: &Limb) -> Result<(), Rejected> {
    let outline = &limb.outline;
    let reason = sun::OFF_OUTLINE;
    Rejected::at_least(LEAST_ON_OUTLINE, outline.accepted_share(), reason)?;
    let reason = sun::NOT_ROUND;
    Rejected::at_most(MAX_SCATTER_PX, outline.scatter_px, reason)
}

/// The image of the centre of a disc on the plate whose outline is centred on `outline_centre`: with a tilt of 3 deg the
/// two are 0.1 px apart.
fn disc_centre(mapping: &Mapping, outline_centre: SensorPx, radius_mil: f64) -> SensorPx {
    let middle = mapping.to_plate(outline_centre).vector();
    let seen = |angle: f64| {
        let (sin, cos) = angle.sin_cos();
        let edge = middle + Vector2::new(cos, sin) * radius_mil;
        mapping.to_sensor(edge.into()).vector()
    };
    let quarter = std::f64::consts::FRAC_PI_2;
    let outline: Vector2<f64> = (0..4).map(|n| seen(f64::from(n) * quarter)).sum();
    let shift = outline / 4.0 - outline_centre.vector();
    (outline_centre.vector() - shift).into()
}
