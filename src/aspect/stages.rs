//! The steps of the pipeline up to the marks' mapping: each takes the products of earlier stages and calls the room that
//! knows how.

use super::{Expected, Mark, Settings, Stage, Stopped, Track};
use crate::fiducial::{self, CrossShape, Detections, FlatDisc, Lighting, Refiner, Sight};
use crate::frame::{Frame, Levels, Region};
use crate::geometry::{Ellipse, Mapping};
use crate::instrument::Instrument;
use crate::limb::{self, CoarseDisc, Hidden, Limb, OutlinePrior};
use crate::registration::{self, Outline, Pair, Registration};
use crate::units::{Measured, Rejected, SensorPx};
use nalgebra::Matrix2;

/// The Sun's mean angular radius, and how far it strays from it in a year: what is expected of a frame without time.
const MEAN_RADIUS_ARCSEC: Measured = Measured::new(959.63, 11.0);
/// How far the limb that the profile's fit finds may be from the edge that the ephemeris means.
pub(super) const LIMB_DEFINITION_SIGMA_PX: f64 = 0.1;
/// A camera tilted by 3 deg makes the half axes differ by this part from their mean, 1 sigma.
const TILTED_FLATNESS: f64 = 0.002;
/// A camera that looks as straight as the instrument states.
const STATED_FLATNESS: f64 = 0.0003;
/// Distance from a mark's arm within which the limb is not trusted, px.
const MARK_MARGIN_PX: f64 = 3.0;
/// The limb's fit looks at pixels so far from the limb.
const HIDING_DEPTH_PX: f64 = 12.0;
/// Relative error of a scale taken from the disc's radius: haze and saturation move the threshold by up to a pixel,
/// a tilted camera makes the scale differ between axes.
const DISC_SCALE_SIGMA: f64 = 0.007;
/// A limb so many times softer than the instrument's blur is hazy or smeared.
const SOFT: f64 = 1.3;
/// 1 sigma of a mark whose pixels do not agree with a cross.
const UNREFINED_SIGMA_PX: f64 = 0.2;
/// What such a mark counts for when two blurs are compared.
const UNREFINED_CHI2: f64 = 10.0;
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

/// What is known about the marks before their pixels are looked at.
pub(super) struct MarkSight<'a> {
    pub(super) levels: &'a Levels,
    pub(super) limb: &'a Limb,
    pub(super) mapping: &'a Mapping,
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

    /// The outline of the disc, without the hidden pixels.
    ///
    /// The round outline of the stated radius steadies the fit to a disc of which little is seen. A limb that
    /// contradicts it is believed instead.
    pub(super) fn limb(
        &self,
        levels: &Levels,
        start: &Ellipse,
        hidden: &Hidden,
    ) -> Result<Limb, Stopped> {
        let fit = |prior: OutlinePrior| {
            let (blur_px, settings) = (self.shape.blur_px, &self.settings.limb);
            limb::fit_limb(self.frame, start, levels, blur_px, &prior, hidden, settings)
                .map_err(at(Stage::Limb))
        };
        let free = fit(OutlinePrior {
            radius_px: Measured::new(
                self.radius_px,
                self.settings.limb.max_radius_deviation / 4.0 * self.radius_px,
            ),
            flatness: TILTED_FLATNESS,
        })?;
        let stated = OutlinePrior {
            radius_px: self.stated_radius_px(),
            flatness: STATED_FLATNESS,
        };
        if free.outline.contradicts(&stated) {
            return Ok(free);
        }
        fit(stated)
    }

    /// The disc's radius on the sensor by ephemeris and stated scale.
    fn stated_radius_px(&self) -> Measured {
        let scale = self.instrument.mounting.scale_mil_per_px;
        let relative =
            (scale.sigma / scale.value).hypot(self.radius_mil.sigma / self.radius_mil.value);
        let sigma = (relative * self.radius_px).hypot(LIMB_DEFINITION_SIGMA_PX);
        Measured::new(self.radius_px, sigma)
    }

    /// The square about the disc that the limb's fit looks at.
    fn about(&self, disc: &Ellipse) -> Region {
        let reach = 1.3 * disc.mean_radius();
        Region::around(
            disc.centre.into(),
            reach,
            self.frame.width(),
            self.frame.height(),
        )
        .unwrap_or(self.frame.region())
    }

    /// Before the marks are known nothing is hidden.
    pub(super) fn nothing_hidden(&self, disc: &Ellipse) -> Hidden {
        Hidden::nothing(self.about(disc))
    }

    /// Hides every mark of the plate that a mapping puts near the limb, seen or not.
    pub(super) fn marks_hidden(&self, disc: &Ellipse, mapping: &Mapping) -> Hidden {
        let mut hidden = self.nothing_hidden(disc);
        let plate = &self.instrument.plate;
        let reach_px = self.shape.half_length_px * 1.5 + MARK_MARGIN_PX;
        for (_, printed) in plate.marks() {
            let seen = mapping.to_sensor(printed);
            if disc.excess(seen.vector()).abs() > HIDING_DEPTH_PX + reach_px {
                continue;
            }
            let Some(back) = mapping.sensor_jacobian(printed).try_inverse() else {
                continue;
            };
            let margin_mil = MARK_MARGIN_PX * mapping.scale_mil_per_px(seen);
            hidden.hide(seen, reach_px, |at| {
                let offset = back * (at.vector() - seen.vector());
                plate.cross.covers(offset, margin_mil)
            });
        }
        hidden
    }

    /// Hides what was found near the limb, where no mapping tells which marks lie there.
    pub(super) fn detections_hidden(&self, disc: &Ellipse, detections: &Detections) -> Hidden {
        let mut hidden = self.nothing_hidden(disc);
        let reach_px = self.shape.half_length_px + MARK_MARGIN_PX;
        for detection in &detections.marks {
            hidden.hide(detection.at, reach_px, |at| {
                at.distance(detection.at) < reach_px
            });
        }
        hidden
    }

    /// Scale at the disc, from its radius.
    fn disc_scale(&self, disc: &Ellipse) -> f64 {
        self.radius_mil.value / disc.mean_radius()
    }

    pub(super) fn detect(&self, levels: &Levels, limb: &Limb) -> Detections {
        let disc = limb.outline.ellipse;
        let (plate, optics) = (&self.instrument.plate, &self.instrument.optics);
        let shape = CrossShape::new(&plate.cross, self.disc_scale(&disc), optics.blur_px.value);
        let margin = 2.0 * shape.half_length_px;
        match FlatDisc::new(self.frame, disc, levels, margin) {
            Some(flat) => fiducial::detect(&flat, &shape, &self.settings.fiducial),
            None => Detections::default(),
        }
    }

    /// Marks that were read, each placed by its own pixels. One whose pixels do not agree keeps its first place, and a
    /// sigma that gives it little weight.
    ///
    /// A limb softer than the instrument's blur may come of haze, which softens the marks too, or of the Sun's motion,
    /// which does not: the marks' own pixels decide.
    pub(super) fn refine(&self, sight: &MarkSight<'_>, marks: &[Mark]) -> Vec<Mark> {
        let stated_px = self.instrument.optics.blur_px.value;
        let (sharp, sharp_chi2) = self.refine_at(stated_px, sight, marks);
        let limb_px = sight.limb.lens_blur_px();
        if limb_px < SOFT * stated_px {
            return sharp;
        }
        let (soft, soft_chi2) = self.refine_at(limb_px, sight, marks);
        if soft_chi2 < sharp_chi2 { soft } else { sharp }
    }

    /// Marks refined at a lens's blur, and what they leave unexplained on average.
    fn refine_at(&self, blur_px: f64, sight: &MarkSight<'_>, marks: &[Mark]) -> (Vec<Mark>, f64) {
        let limb = sight.limb;
        let scale = self.disc_scale(&limb.outline.ellipse);
        let plate = &self.instrument.plate;
        let refiner = Refiner::new(&plate.cross, scale, blur_px);
        let mut chi2 = 0.0;
        let mut refined = |mark: &Mark| {
            let jacobian = sight.mapping.sensor_jacobian(plate.position(mark.id));
            let light = |x, y| limb.light_dn(x, y);
            let found = refiner.refine(self.frame, sight.levels, light, &jacobian, mark.at);
            let Some(found) = found else {
                chi2 += UNREFINED_CHI2;
                return Mark {
                    covariance_px2: Matrix2::identity() * UNREFINED_SIGMA_PX.powi(2),
                    ..*mark
                };
            };
            chi2 += found.reduced_chi2;
            Mark {
                at: found.place.position,
                covariance_px2: found.place.covariance,
                ..*mark
            }
        };
        (marks.iter().map(&mut refined).collect(), chi2)
    }

    pub(super) fn identify(
        &self,
        detections: &Detections,
        limb: &Limb,
    ) -> Result<Vec<Mark>, Stopped> {
        let mounting = &self.instrument.mounting;
        let radius = self.radius_mil.value;
        let relative = (self.radius_mil.sigma / radius).hypot(DISC_SCALE_SIGMA);
        let sight = Sight {
            outline: limb.outline.ellipse,
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
        let pairs: Vec<Pair> = marks
            .iter()
            .filter(|mark| mark.lighting == Lighting::Full)
            .map(|mark| Pair {
                seen: mark.at,
                printed: self.instrument.plate.position(mark.id),
                covariance_px2: mark.covariance_px2,
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
        let points: Vec<(SensorPx, f64)> = limb
            .iter()
            .flat_map(|limb| limb.points.iter().map(|point| (point.at, point.sigma_px)))
            .collect();
        let outline = limb.map(|limb| Outline {
            centre: limb.outline.ellipse.centre.into(),
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
        Ok(registration)
    }

    /// The disc's radius on the plate, so loosely that a whole limb decides it and a short one leans on it.
    fn loose_radius_mil(&self) -> Measured {
        let definition = LIMB_DEFINITION_SIGMA_PX * self.instrument.mounting.scale_mil_per_px.value;
        Measured::new(
            self.radius_mil.value,
            self.radius_mil.sigma.hypot(definition),
        )
    }
}

pub(super) fn at(stage: Stage) -> impl Fn(Rejected) -> Stopped {
    move |rejected| Stopped { stage, rejected }
}
