//! The last steps of the pipeline: from a mapping and the limb to the Sun's centre, its uncertainty and the quality.

use super::stages::{Pipeline, at};
use super::{AdoptedMapping, Aspect, Origin, Quality, Solution, Stage, Stopped, Track};
use crate::geometry::{Circle, LocalSimilarity, Mapping};
use crate::limb::{self, Limb};
use crate::registration::Registration;
use crate::units::{Estimate, Measured, PlateMil, Rejected, SensorPx};
use nalgebra::{Matrix2, Vector2};

/// How far a mapping may have moved since the frame that gave it.
const PRIOR_DRIFT_PX: f64 = 0.5;
/// Largest scatter of the limb about its outline: the Sun's is a tenth of it, a square's ten times as large.
const MAX_SCATTER_PX: f64 = 1.0;
/// Least part of the limb's points that must lie on its outline: marks and scratches hide a tenth of them.
const LEAST_ON_OUTLINE: f64 = 0.6;
/// The limb's fit holds for an image that moves by so many px during the exposure, four times what the fastest slew does
/// (0.25 deg/s for 15 ms); one that moves farther is no picture of a circle any more.
const MOST_MOTION_PX: f64 = 5.0;
/// The limb's part that makes a fine solution.
const LEAST_FINE_LIMB: f64 = 0.4;

impl<'a> Pipeline<'a> {
    /// This frame's mapping, else the prior's, else the calibration's.
    pub(super) fn adopt(&self, own: Option<&Registration>) -> Result<AdoptedMapping, Stopped> {
        if let Some(own) = own {
            return Ok(AdoptedMapping {
                mapping: own.mapping,
                origin: Origin::Frame,
                residual_px: Some(own.residual_px),
            });
        }
        let borrowed = |mapping: Mapping, origin| AdoptedMapping {
            mapping,
            origin,
            residual_px: None,
        };
        if let Some(prior) = self.prior_registration() {
            return Ok(borrowed(prior.mapping, Origin::Prior));
        }
        match self.instrument.nominal_mapping() {
            Some(nominal) => Ok(borrowed(nominal, Origin::Calibration)),
            None => Err(at(Stage::Registration)(Rejected {
                reason: "the calibration's mapping cannot be inverted",
                measured: 0.0,
                limit: 0.0,
            })),
        }
    }

    fn prior_registration(&self) -> Option<&'a Registration> {
        self.prior.and_then(|prior| prior.registration.as_ref())
    }

    pub(super) fn aspect(
        &self,
        limb: &Limb,
        adopted: &AdoptedMapping,
        own: Option<&Registration>,
    ) -> Result<Aspect, Stopped> {
        check_round(limb)?;
        let limb_fraction = limb_fraction(limb);
        let aspect = match own.and_then(|own| own.disc) {
            Some(disc) => Aspect {
                sun_px: disc.on_sensor,
                sun_radius_px: with_sigma_of_profile(disc.radius_px, limb),
                mapping: self.local_similarity(disc.on_sensor.position, adopted, own),
                sun_plate: disc.on_plate,
                limb_fraction,
            },
            None => self.borrowed_aspect(limb, adopted, limb_fraction),
        };
        let radius_mil = aspect.sun_radius_px.value * aspect.mapping.scale_mil_per_px.value;
        let deviation = (radius_mil / self.radius_mil.value - 1.0).abs();
        let limit = self.settings.limb.max_radius_deviation;
        if deviation > limit {
            return Err(at(Stage::Aspect)(Rejected {
                reason: "the disc is not of the Sun's size",
                measured: deviation,
                limit,
            }));
        }
        Ok(aspect)
    }

    /// Scale and rotation of the adopted mapping at a place: this frame's, the prior's, or as the calibration states them.
    fn local_similarity(
        &self,
        at: SensorPx,
        adopted: &AdoptedMapping,
        own: Option<&Registration>,
    ) -> LocalSimilarity {
        if let Some(registration) = own.or_else(|| self.prior_registration()) {
            return registration.local_similarity(at);
        }
        let (mapping, mounting) = (&adopted.mapping, &self.instrument.mounting);
        let (scale, rotation) = (mounting.scale_mil_per_px, mounting.rotation_deg);
        LocalSimilarity {
            scale_mil_per_px: Measured::new(mapping.scale_mil_per_px(at), scale.sigma),
            rotation_deg: Measured::new(mapping.rotation_deg(at), rotation.sigma),
        }
    }

    /// Marks do not serve where the Sun moved so far that its size and light mislead who reads them.
    pub(super) fn check_motion(&self, limb: &Limb) -> Result<(), Stopped> {
        let motion_px = self.motion_px(limb);
        if motion_px < MOST_MOTION_PX {
            return Ok(());
        }
        Err(at(Stage::Limb)(Rejected {
            reason: "the Sun moved too far during the exposure",
            measured: motion_px,
            limit: MOST_MOTION_PX,
        }))
    }

    fn motion_px(&self, limb: &Limb) -> f64 {
        limb.most_motion_px(self.instrument.optics.blur_px.value, limb_fraction(limb))
    }

    /// The outline's centre through a mapping that is not this frame's.
    fn borrowed_aspect(&self, limb: &Limb, adopted: &AdoptedMapping, limb_fraction: f64) -> Aspect {
        let mapping = &adopted.mapping;
        let outline = &limb.outline;
        let on_sensor = disc_centre(
            mapping,
            outline.ellipse.centre.into(),
            self.radius_mil.value,
        );
        let on_plate = mapping.to_plate(on_sensor);
        let to_plate = mapping.plate_jacobian(on_sensor);
        // An outline that moved is uncertain by its motion.
        let moved = match self.check_motion(limb) {
            Ok(()) => 0.0,
            Err(_) => self.motion_px(limb).powi(2) / 12.0,
        };
        let centre = outline.centre_covariance() + Matrix2::identity() * moved;
        let radius_sigma_px = outline.radius_sigma_px().hypot(moved.sqrt());
        let radius_px = Measured::new(outline.ellipse.mean_radius(), radius_sigma_px);
        Aspect {
            sun_px: Estimate {
                position: on_sensor,
                covariance: centre,
            },
            sun_radius_px: with_sigma_of_profile(radius_px, limb),
            mapping: self.local_similarity(on_sensor, adopted, None),
            sun_plate: Estimate {
                position: on_plate,
                covariance: to_plate * centre * to_plate.transpose()
                    + self.borrowed_covariance(on_plate, adopted),
            },
            limb_fraction,
        }
    }

    fn borrowed_covariance(&self, at: PlateMil, adopted: &AdoptedMapping) -> Matrix2<f64> {
        match (adopted.origin, self.prior_registration()) {
            (Origin::Prior, Some(prior)) => {
                let scale = adopted
                    .mapping
                    .scale_mil_per_px(adopted.mapping.to_sensor(at));
                let drift = (PRIOR_DRIFT_PX * scale).powi(2);
                prior.covariance_mil2(at) + Matrix2::identity() * drift
            }
            _ => self.instrument.nominal_covariance_mil2(at),
        }
    }

    /// The quality; notes why a coarse solution is not fine.
    pub(super) fn judge(
        &self,
        aspect: &Aspect,
        adopted: &AdoptedMapping,
        solution: &mut Solution,
    ) -> Quality {
        if aspect.limb_fraction < LEAST_FINE_LIMB {
            solution.stop(
                Stage::Aspect,
                Rejected {
                    reason: "only part of the limb is seen",
                    measured: aspect.limb_fraction,
                    limit: LEAST_FINE_LIMB,
                },
            );
            return Quality::Coarse;
        }
        match adopted.origin {
            Origin::Frame => Quality::Fine,
            Origin::Prior | Origin::Calibration => Quality::Coarse,
        }
    }

    /// What this frame teaches: a frame without marks hands on the prior's registration.
    pub(super) fn track(
        &self,
        aspect: &Aspect,
        own: Option<Registration>,
        predicted: u32,
    ) -> Track {
        Track {
            disc: Circle {
                centre: aspect.sun_px.position.vector(),
                radius: aspect.sun_radius_px.value,
            },
            predicted,
            registration: own.or_else(|| self.prior_registration().cloned()),
        }
    }
}

/// A radius with the uncertainty of the limb's profile, which moves all points alike.
fn with_sigma_of_profile(radius_px: Measured, limb: &Limb) -> Measured {
    Measured {
        sigma: radius_px.sigma.hypot(limb.place_sigma_px()),
        ..radius_px
    }
}

/// Part of the limb that is seen, 0 to 1.
fn limb_fraction(limb: &Limb) -> f64 {
    let points = limb.points.iter().map(|point| point.at.vector());
    limb::arc_fraction(points, limb.outline.ellipse.centre)
}

fn check_round(limb: &Limb) -> Result<(), Stopped> {
    let on_it = limb.outline.accepted_share();
    if on_it < LEAST_ON_OUTLINE {
        return Err(at(Stage::Limb)(Rejected {
            reason: "too much of the limb is off its outline",
            measured: on_it,
            limit: LEAST_ON_OUTLINE,
        }));
    }
    let scatter_px = limb.outline.scatter_px;
    if scatter_px > MAX_SCATTER_PX {
        return Err(at(Stage::Limb)(Rejected {
            reason: "what is bright is not round",
            measured: scatter_px,
            limit: MAX_SCATTER_PX,
        }));
    }
    Ok(())
}

/// The image of the centre of a disc on the plate whose outline is centred on `outline_centre`: under a tilt of 3 deg the two are
/// a tenth of a pixel apart.
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
