//! The steps of the pipeline up to the disc's outline: each takes the products of earlier stages and calls the module that
//! does it.

use super::{Expected, Settings, Stage, Stopped, Track};
use crate::fiducial::{CrossShape, Detections};
use crate::frame::{Cutout, Frame, Levels, Mask, PixelNoise, Region};
use crate::geometry::{Circle, Ellipse, Mapping};
use crate::instrument::Instrument;
use crate::limb::{self, DiscSearch, KnownOutline, LimbFit, OutlinePrior};
use crate::units::{Measured, Rejected, SensorPx};

/// The Sun's mean angular radius, and how far it strays from it in a year: what is expected of a frame without time.
const MEAN_RADIUS_ARCSEC: Measured = Measured::new(959.63, 11.0);
/// How far the limb that the profile's fit finds may be from the edge that the ephemeris means.
pub(super) const LIMB_DEFINITION_SIGMA_PX: f64 = 0.1;
/// A camera tilted by 3 deg makes the half axes differ by this part from their mean, 1 sigma.
const TILTED_FLATNESS: f64 = 0.002;
/// A camera without tilt, as the instrument states.
const STATED_FLATNESS: f64 = 0.0003;
/// Distance from a mark's arm within which the limb is not trusted, px.
const MARK_MARGIN_PX: f64 = 3.0;
/// The limb's fit reads pixels so far inside the limb; outside it marks take no light.
const MASKED_DEPTH_PX: f64 = 14.0;
/// The cutout reaches so many radii from the disc's centre: the limb's band and the marks' patches lie within.
const CUTOUT_RADII: f64 = 1.3;
/// The marks near a disc lie within so many times its radius: a tilted camera flattens its image.
pub(super) const DISC_ROOM: f64 = 1.2;
/// The Sun may have moved this far since the prior: 0.25 deg/s at 4 frames/s, twice over.
const PRIOR_REACH_PX: f64 = 45.0;

/// A frame on its way, with all that is known beforehand.
pub struct Pipeline<'a> {
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

impl<'a> Pipeline<'a> {
    pub fn new(
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

    /// The levels. A background cut off at zero shows less noise than there is: the stated noise is the least.
    pub fn levels(&self) -> Result<Levels, Stopped> {
        let seen = limb::levels(self.frame, &self.settings.limb).map_err(at(Stage::Levels))?;
        let stated = self
            .instrument
            .sensor
            .noise
            .filter(|noise| noise.is_of(self.frame));
        Ok(match stated {
            Some(noise) => Levels {
                noise_dn: seen.noise_dn.max(noise.read_noise_dn.value),
                ..seen
            },
            None => seen,
        })
    }

    pub fn find_disc(&self, levels: &Levels) -> Result<Circle, Stopped> {
        let search = DiscSearch {
            frame: self.frame,
            levels,
            radius_px: self.radius_px,
            mark_length_px: self.mark_length_px(),
            settings: &self.settings.limb,
        };
        let near = self.prior.and_then(|prior| {
            let reach = prior.disc.radius + PRIOR_REACH_PX;
            let centre = SensorPx::from(prior.disc.centre);
            let region = Region::around(centre, reach, self.frame.width(), self.frame.height())?;
            search.near(region).ok()
        });
        let anywhere = || search.anywhere(self.frame.region());
        near.map_or_else(anywhere, Ok).map_err(at(Stage::Limb))
    }

    /// What fits the outline of the disc.
    pub fn limb_fit<'b>(&'b self, levels: &Levels, cutout: &'b Cutout) -> LimbFit<'b> {
        let settings = &self.settings.limb;
        let spread = settings.max_radius_deviation / 4.0;
        LimbFit {
            cutout,
            disc_dn: levels.disc_dn - levels.background_dn,
            blur_px: self.shape.blur_px,
            known: KnownOutline {
                possible: OutlinePrior {
                    radius_px: Measured::new(self.radius_px, spread * self.radius_px),
                    flatness: TILTED_FLATNESS,
                },
                stated: OutlinePrior {
                    radius_px: self.stated_radius_px(),
                    flatness: STATED_FLATNESS,
                },
            },
            settings,
        }
    }

    /// The disc's radius on the sensor by ephemeris and stated scale.
    fn stated_radius_px(&self) -> Measured {
        let scale = self.instrument.mounting.scale_mil_per_px;
        let relative =
            (scale.sigma / scale.value).hypot(self.radius_mil.sigma / self.radius_mil.value);
        let sigma = (relative * self.radius_px).hypot(LIMB_DEFINITION_SIGMA_PX);
        Measured::new(self.radius_px, sigma)
    }

    /// The disc's surroundings as all further stages read them: the background taken off, hot pixels masked.
    pub fn cutout(&self, levels: &Levels, disc: &Circle) -> Cutout {
        cutout(self.frame, self.instrument, levels, disc)
    }

    /// Every mark of the plate that a mapping puts near the limb, seen or not.
    pub(super) fn marks_mask(&self, region: Region, disc: &Ellipse, mapping: &Mapping) -> Mask {
        marks_mask(region, self.instrument, disc, mapping)
    }

    /// What was found near the limb, where no mapping predicts which marks lie there.
    pub(super) fn detections_mask(&self, region: Region, detections: &Detections) -> Mask {
        let mut mask = Mask::none(region);
        let reach_px = self.shape.half_length_px + MARK_MARGIN_PX;
        for detection in &detections.marks {
            mask.hide_where(detection.at, reach_px, |at| {
                at.distance(detection.at) < reach_px
            });
        }
        mask
    }
}

/// The disc's surroundings as limb and marks are read from them: the background taken off, the instrument's hot pixels masked.
pub(crate) fn cutout(
    frame: &Frame,
    instrument: &Instrument,
    levels: &Levels,
    disc: &Circle,
) -> Cutout {
    let reach = CUTOUT_RADII * disc.radius;
    let about = Region::around(disc.centre.into(), reach, frame.width(), frame.height());
    let region = about.unwrap_or(frame.region());
    let background = limb::background(frame, region, disc, levels);
    let noise = PixelNoise::even(levels.noise_dn);
    let mut cutout = Cutout::new(frame, region, &background, noise);
    for (x, y) in &instrument.sensor.hot_pixels {
        cutout.mask.hide(*x, *y);
    }
    cutout
}

/// Masks every mark of the plate that a mapping puts near the limb, seen or not.
pub(crate) fn marks_mask(
    region: Region,
    instrument: &Instrument,
    disc: &Ellipse,
    mapping: &Mapping,
) -> Mask {
    let mut mask = Mask::none(region);
    let cross = &instrument.plate.cross;
    let scale = mapping.scale_mil_per_px(disc.centre.into());
    let reach_px = 1.1 * cross.arm_length_mil / 2.0 / scale + MARK_MARGIN_PX;
    let near = -MASKED_DEPTH_PX - reach_px..reach_px;
    let centre = mapping.to_plate(disc.centre.into());
    let about_mil = DISC_ROOM * (disc.mean_radius() + reach_px) * scale;
    for (_, printed) in instrument.plate.marks_about(centre, about_mil) {
        let seen = mapping.to_sensor(printed);
        if !near.contains(&disc.excess(seen.vector())) {
            continue;
        }
        let Some(to_arms) = mapping.sensor_jacobian(printed).try_inverse() else {
            continue;
        };
        let margin_mil = MARK_MARGIN_PX * mapping.scale_mil_per_px(seen);
        let half_length = cross.arm_length_mil / 2.0 + margin_mil;
        let half_width = cross.arm_width_mil / 2.0 + margin_mil;
        mask.hide_where(seen, reach_px, |at| {
            let along = (to_arms * (at.vector() - seen.vector())).abs();
            along.max() < half_length && along.min() < half_width
        });
    }
    mask
}

pub(super) fn at(stage: Stage) -> impl Fn(Rejected) -> Stopped {
    move |rejected| Stopped { stage, rejected }
}
