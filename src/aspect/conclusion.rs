//! The last steps of the pipeline: from a mapping and the limb to the Sun's centre, its uncertainty and the quality.

use super::stages::{LEAST_SCATTER_PX, Work, at, no_circle};
use super::{AdoptedMapping, Aspect, Origin, Quality, Solution, Stage, Stopped, Track};
use crate::geometry::{Circle, Mapping};
use crate::limb::{self, Crossing, DiscFit};
use crate::registration::Registration;
use crate::units::{Estimate, Measured, PlateMil, Rejected, SensorPx};
use nalgebra::{Matrix2, Vector2};

/// A chord crosses the threshold, not the disc's edge; the two differ by less than this.
const LIMB_DEFINITION_SIGMA_PX: f64 = 0.3;
/// How far a mapping may have moved since the frame that gave it.
const PRIOR_DRIFT_PX: f64 = 0.5;
/// Distance from a mark's arm within which the limb is not trusted, px.
const MARK_MARGIN_PX: f64 = 3.5;
/// Largest scatter of the limb about its circle: the Sun's is a tenth of it, a square's ten times as large.
const MAX_SCATTER_PX: f64 = 1.0;
/// The limb's part that makes a fine solution.
const LEAST_FINE_LIMB: f64 = 0.4;

impl<'a> Work<'a> {
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

    /// The crossings that no mark of the plate, seen or not, can have pulled.
    pub(super) fn clear_of_marks(
        &self,
        mut crossings: Vec<Crossing>,
        adopted: &AdoptedMapping,
    ) -> Vec<Crossing> {
        if adopted.origin == Origin::Calibration {
            return crossings;
        }
        let plate = &self.instrument.plate;
        crossings.retain(|crossing| {
            let here = adopted.mapping.to_plate(crossing.at);
            let margin = MARK_MARGIN_PX * adopted.mapping.scale_mil_per_px(crossing.at);
            plate.nearest(here).is_none_or(|(id, _)| {
                let offset = here.vector() - plate.position(id).vector();
                !plate.cross.covers(offset, margin)
            })
        });
        crossings
    }

    /// The disc's circle on the plate, mil.
    pub(super) fn plate_disc(
        &self,
        crossings: &[Crossing],
        disc: &Circle,
        adopted: &AdoptedMapping,
    ) -> Result<DiscFit, Stopped> {
        let mapping = &adopted.mapping;
        let centre = SensorPx::from(disc.centre);
        let scale = mapping.scale_mil_per_px(centre);
        let points: Vec<Vector2<f64>> = crossings
            .iter()
            .map(|crossing| mapping.to_plate(crossing.at).vector())
            .collect();
        let start = Circle {
            centre: mapping.to_plate(centre).vector(),
            radius: disc.radius * scale,
        };
        let relative = match adopted.origin {
            Origin::Calibration => {
                let stated = self.instrument.mounting.scale_mil_per_px;
                stated.sigma / stated.value
            }
            Origin::Frame | Origin::Prior => 0.0,
        };
        let sigma = self
            .radius_mil
            .sigma
            .hypot(LIMB_DEFINITION_SIGMA_PX * scale)
            .hypot(relative * self.radius_mil.value);
        let prior = Measured::new(self.radius_mil.value, sigma);
        let fit = limb::fit_disc(&points, start, prior, LEAST_SCATTER_PX * scale)
            .ok_or_else(|| no_circle(points.len()))?;
        let scatter_px = fit.scatter / scale;
        if scatter_px > MAX_SCATTER_PX {
            return Err(at(Stage::Limb)(Rejected {
                reason: "what is bright is not round",
                measured: scatter_px,
                limit: MAX_SCATTER_PX,
            }));
        }
        Ok(fit)
    }

    pub(super) fn aspect(
        &self,
        limb: &DiscFit,
        crossings: &[Crossing],
        adopted: &AdoptedMapping,
        own: Option<&Registration>,
    ) -> Result<Aspect, Stopped> {
        let mapping = &adopted.mapping;
        let on_plate = PlateMil::from(limb.circle.centre);
        let on_sensor = mapping.to_sensor(on_plate);
        let to_sensor = mapping.sensor_jacobian(on_plate);
        let centre = limb.centre_covariance();
        let limb_points = crossings
            .iter()
            .zip(&limb.accepted)
            .filter(|(_, accepted)| **accepted)
            .map(|(crossing, _)| mapping.to_plate(crossing.at).vector());
        let aspect = Aspect {
            sun_px: Estimate {
                position: on_sensor,
                covariance: to_sensor * centre * to_sensor.transpose(),
            },
            sun_radius_px: limb.circle.radius / mapping.scale_mil_per_px(on_sensor),
            sun_plate: Estimate {
                position: on_plate,
                covariance: centre + self.mapping_covariance(on_plate, adopted, own),
            },
            limb_fraction: limb::arc_fraction(limb_points, limb.circle.centre),
        };
        let deviation = (limb.circle.radius / self.radius_mil.value - 1.0).abs();
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

    fn mapping_covariance(
        &self,
        at: PlateMil,
        adopted: &AdoptedMapping,
        own: Option<&Registration>,
    ) -> Matrix2<f64> {
        match (adopted.origin, own.or(self.prior_registration())) {
            (Origin::Frame, Some(own)) => own.covariance_mil2(at),
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
    pub(super) fn track(&self, aspect: &Aspect, own: Option<Registration>) -> Track {
        Track {
            disc: Circle {
                centre: aspect.sun_px.position.vector(),
                radius: aspect.sun_radius_px,
            },
            registration: own.or_else(|| self.prior_registration().cloned()),
        }
    }
}
