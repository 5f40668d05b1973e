//! The steps of the pipeline up to the marks' mapping: each takes the products of earlier stages and calls the room that
//! knows how.

use super::{Expected, Mark, Settings, Stage, Stopped, Track};
use crate::fiducial::{self, CrossShape, Detections, FlatDisc, Lighting, Sight};
use crate::frame::{Frame, Levels, Region};
use crate::geometry::{Circle, Ellipse};
use crate::instrument::Instrument;
use crate::limb::{self, CoarseDisc, Crossing};
use crate::registration::{self, Pair, Registration};
use crate::units::{Measured, Rejected, SensorPx};
use nalgebra::Vector2;

/// The Sun's mean angular radius, and how far it strays from it in a year: what is expected of a frame without time.
const MEAN_RADIUS_ARCSEC: Measured = Measured::new(959.63, 11.0);
/// A point of the limb is never better than this.
pub(super) const LEAST_SCATTER_PX: f64 = 0.01;
/// Relative error of a scale taken from the disc's radius: haze and saturation move the threshold by up to a pixel,
/// a tilted camera makes the scale differ between axes.
const DISC_SCALE_SIGMA: f64 = 0.007;
/// Depth inside the limb from which a mark must have been found, in half lengths from tip to tip, beside a pixel by
/// which haze may widen the disc. In simulated frames all are found from 0.5 on.
const SURE_DEPTH: f64 = 0.75;
/// Largest residual of the marks about their mapping.
const MAX_RESIDUAL_PX: f64 = 0.6;
/// The Sun may have moved this far since the prior: 0.25 deg/s at 4 frames/s, twice over.
const PRIOR_REACH_PX: f64 = 45.0;

/// A frame on its way, with all that is known beforehand.
pub(super) struct Work<'a> {
    pub(super) settings: &'a Settings,
    pub(super) frame: &'a Frame,
    pub(super) instrument: &'a Instrument,
    pub(super) prior: Option<&'a Track>,
    /// The Sun's expected radius on the plate.
    pub(super) radius_mil: Measured,
    /// The same on the sensor, at the nominal scale.
    pub(super) radius_px: f64,
    pub(super) shape: CrossShape,
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
        let crossings =
            limb::fine_chords(self.frame, levels, coarse, self.mark_length_px(), settings);
        if crossings.len() < settings.min_crossings {
            return Err(at(Stage::Limb)(Rejected {
                reason: "too few chords cross the limb squarely",
                measured: crossings.len() as f64,
                limit: settings.min_crossings as f64,
            }));
        }
        Ok(crossings)
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
        let radius = self.radius_mil.value;
        let relative = (self.radius_mil.sigma / radius).hypot(DISC_SCALE_SIGMA);
        let sight = Sight {
            outline: Ellipse::from(*disc),
            radius_mil: Measured::new(radius, radius * relative),
            quarter_rotation_deg: detections.quarter_rotation_deg,
            handedness: mounting.handedness,
            plate_centre: mounting.plate_centre_px,
            sure_depth_px: SURE_DEPTH * self.shape.half_length_px + 1.0,
            sure_margin_px: self.shape.half_length_px + 4.0,
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
}

pub(super) fn at(stage: Stage) -> impl Fn(Rejected) -> Stopped {
    move |rejected| Stopped { stage, rejected }
}

pub(super) fn no_circle(points: usize) -> Stopped {
    at(Stage::Limb)(Rejected {
        reason: "the crossings determine no circle",
        measured: points as f64,
        limit: 3.0,
    })
}
