//! The steps of the pipeline: each takes the products of earlier stages and calls the room that knows how.

use super::{
    AdoptedMapping, Aspect, Expected, Mark, Origin, Quality, Settings, Solution, Stage, Stopped,
    Track,
};
use crate::fiducial::{self, CrossShape, Detections, FlatDisc, Lighting, Sight};
use crate::frame::{Frame, Region};
use crate::geometry::Mapping;
use crate::instrument::Instrument;
use crate::limb::{self, Circle, CoarseDisc, Crossing, DiscFit, Levels};
use crate::registration::{self, Pair, Registration};
use crate::units::{Estimate, Measured, PlateMil, Rejected, SensorPx};
use nalgebra::{Matrix2, Vector2};

/// The Sun's mean angular radius, and how far it strays from it in a year: what is expected of a frame without time.
const MEAN_RADIUS_ARCSEC: Measured = Measured::new(959.63, 11.0);
/// A chord crosses the threshold, not the disc's edge; the two differ by less than this.
const LIMB_DEFINITION_SIGMA_PX: f64 = 0.3;
/// A point of the limb is never better than this.
const LEAST_SCATTER_PX: f64 = 0.01;
/// Relative error of a scale taken from the disc's radius: haze and saturation move the threshold by up to a pixel,
/// a tilted camera makes the scale differ between axes.
const DISC_SCALE_SIGMA: f64 = 0.007;
/// How far a mapping may have moved since the frame that gave it.
const PRIOR_DRIFT_PX: f64 = 0.5;
/// Distance from a mark's arm within which the limb is not trusted, px.
const MARK_MARGIN_PX: f64 = 3.5;
/// Largest scatter of the limb about its circle: the Sun's is a tenth of it, a square's ten times as large.
const MAX_SCATTER_PX: f64 = 1.0;
/// Largest residual of the marks about their mapping.
const MAX_RESIDUAL_PX: f64 = 0.6;
/// The limb's part that makes a fine solution.
const LEAST_FINE_LIMB: f64 = 0.4;
/// The Sun may have moved this far since the prior: 0.25 deg/s at 4 frames/s, twice over.
const PRIOR_REACH_PX: f64 = 45.0;

/// A frame on its way, with all that is known beforehand.
pub(super) struct Work<'a> {
    settings: &'a Settings,
    frame: &'a Frame,
    instrument: &'a Instrument,
    prior: Option<&'a Track>,
    /// The Sun's expected radius on the plate.
    radius_mil: Measured,
    /// The same on the sensor, at the nominal scale.
    radius_px: f64,
    shape: CrossShape,
}

impl<'a> Work<'a> {
    pub(super) fn new(
        settings: &'a Settings,
        frame: &'a Frame,
        instrument: &'a Instrument,
        expected: Option<Expected>,
        prior: Option<&'a Track>,
    ) -> Self {
        let angular = expected.map_or(MEAN_RADIUS_ARCSEC, |e| Measured::new(e.radius_arcsec, 0.0));
        let optics = &instrument.optics;
        let scale = instrument.mounting.scale_mil_per_px.value;
        let value = optics.radius_mil(angular.value);
        let focus = optics.plate_distance_mm;
        let relative = (angular.sigma / angular.value).hypot(focus.sigma / focus.value);
        Self {
            settings,
            frame,
            instrument,
            prior,
            radius_mil: Measured::new(value, value * relative),
            radius_px: value / scale,
            shape: CrossShape::new(&instrument.plate.cross, scale, optics.blur_px.value),
        }
    }

    fn mark_length_px(&self) -> f64 {
        2.0 * self.shape.half_length_px
    }

    pub(super) fn levels(&self) -> Result<Levels, Stopped> {
        limb::levels(self.frame, &self.settings.limb).map_err(at(Stage::Levels))
    }

    pub(super) fn find_disc(&self, levels: &Levels) -> Result<CoarseDisc, Stopped> {
        let find = |region| {
            limb::find_disc(
                self.frame,
                region,
                levels,
                self.radius_px,
                self.mark_length_px(),
                &self.settings.limb,
            )
        };
        let near = self.prior.and_then(|prior| {
            let reach = prior.disc.radius + PRIOR_REACH_PX;
            let centre = SensorPx::from(prior.disc.centre);
            Region::around(centre, reach, self.frame.width(), self.frame.height())
        });
        match near.map(find) {
            Some(Ok(disc)) => Ok(disc),
            _ => find(self.frame.region()).map_err(at(Stage::Limb)),
        }
    }

    pub(super) fn limb(
        &self,
        levels: &Levels,
        coarse: &CoarseDisc,
    ) -> Result<Vec<Crossing>, Stopped> {
        let settings = &self.settings.limb;
        let chords = limb::fine_chords(self.frame, levels, coarse, self.mark_length_px(), settings);
        if chords.crossings.len() < settings.min_crossings {
            return Err(at(Stage::Limb)(Rejected {
                reason: "too few chords cross the limb squarely",
                measured: chords.crossings.len() as f64,
                limit: settings.min_crossings as f64,
            }));
        }
        Ok(chords.crossings)
    }

    /// The circle on the sensor: a first one, for the marks.
    pub(super) fn sensor_disc(
        &self,
        crossings: &[Crossing],
        coarse: &CoarseDisc,
    ) -> Result<Circle, Stopped> {
        let points: Vec<Vector2<f64>> = crossings.iter().map(|c| c.at.vector()).collect();
        let sigma = self.settings.limb.max_radius_deviation / 4.0 * self.radius_px;
        let prior = Measured::new(self.radius_px, sigma);
        limb::fit_disc(&points, coarse.circle(), prior, LEAST_SCATTER_PX)
            .map(|fit| fit.circle)
            .ok_or_else(|| no_circle(points.len()))
    }

    pub(super) fn detect(&self, levels: &Levels, disc: &Circle) -> Detections {
        let margin = self.mark_length_px();
        match FlatDisc::new(self.frame, *disc, levels, margin) {
            Some(flat) => fiducial::detect(&flat, &self.shape, &self.settings.fiducial),
            None => Detections::default(),
        }
    }

    pub(super) fn identify(
        &self,
        detections: &Detections,
        disc: &Circle,
    ) -> Result<Vec<Mark>, Stopped> {
        let mounting = &self.instrument.mounting;
        let scale = self.radius_mil.value / disc.radius;
        let relative = (self.radius_mil.sigma / self.radius_mil.value).hypot(DISC_SCALE_SIGMA);
        let sight = Sight {
            scale_mil_per_px: Measured::new(scale, scale * relative),
            quarter_rotation_deg: detections.quarter_rotation_deg,
            handedness: mounting.handedness,
            plate_centre: mounting.plate_centre_px,
            disc: *disc,
            sure_depth_px: self.shape.half_length_px + 4.0,
            sensor_px: [self.frame.width() as f64, self.frame.height() as f64],
        };
        let settings = &self.settings.fiducial;
        let found = &detections.marks;
        let identification = fiducial::identify(found, &sight, &self.instrument.plate, settings)
            .map_err(at(Stage::Identification))?;
        let named = identification.ids.into_iter().map(|(n, id)| Mark {
            id,
            at: found[n].at,
            sigma_px: found[n].sigma_px,
            lighting: found[n].lighting,
        });
        Ok(named.collect())
    }

    /// The mapping from the fully lit marks.
    pub(super) fn register(&self, marks: &[Mark]) -> Result<Registration, Stopped> {
        let pairs: Vec<Pair> = marks
            .iter()
            .filter(|mark| mark.lighting == Lighting::Full)
            .map(|mark| Pair {
                seen: mark.at,
                printed: self.instrument.plate.position(mark.id),
                sigma_px: mark.sigma_px,
            })
            .collect();
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
        let registration = registration::register(
            &pairs,
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
        Ok(registration)
    }

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

fn at(stage: Stage) -> impl Fn(Rejected) -> Stopped {
    move |rejected| Stopped { stage, rejected }
}

fn no_circle(points: usize) -> Stopped {
    at(Stage::Limb)(Rejected {
        reason: "the crossings determine no circle",
        measured: points as f64,
        limit: 3.0,
    })
}
