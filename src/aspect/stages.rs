//! The steps of the pipeline up to the disc's light: each takes the products of earlier stages and calls the module that
//! computes it.

use super::{Expected, SolverSettings, Stage, Stopped};
use crate::fiducial::MarkImage;
use crate::frame::{Cutout, Frame, Levels, Mask, PixelNoise, Region};
use crate::geometry::{Circle, Ellipse, Mapping};
use crate::instrument::{Instrument, MEAN_SUN_ARCSEC};
use crate::limb::{self, DiscLight, DiscSearch, KnownOutline, Limb, LimbFit, OutlinePrior};
pub(super) use crate::reasons::at;
use crate::units::{Measured, Rejected};

/// Variation of the Sun's angular radius about its mean in a year.
const YEARLY_ARCSEC: f64 = 11.0;
/// Difference between the limb by the profile's fit and the edge of the ephemeris, 1 sigma.
pub(super) const LIMB_DEFINITION_SIGMA_PX: f64 = 0.1;
/// Relative difference of the half axes from their mean for a camera tilted by 3 deg, 1 sigma.
const TILTED_FLATNESS: f64 = 0.002;
/// The same for a camera without tilt, as the instrument states.
const STATED_FLATNESS: f64 = 0.0003;
/// Distance from a mark's arm within which the limb is masked, px.
pub(crate) const MARK_MARGIN_PX: f64 = 3.0;
/// The limb fit reads pixels down to this depth inside the limb; outside the limb marks absorb no light.
const MASKED_DEPTH_PX: f64 = 14.0;
/// Half width of the cutout, in radii from the disc's centre: the limb's band and the marks' patches lie within.
const CUTOUT_RADII: f64 = 1.3;
/// The marks near a disc lie within this many radii: a tilted camera flattens its image.
pub(super) const DISC_REACH: f64 = 1.2;
/// Largest motion of the Sun since the prior: 0.25 deg/s at 4 frames/s, doubled.
const PRIOR_REACH_PX: f64 = 45.0;
/// A lens softer than stated by this factor is out of focus, or behind haze.
const SOFT: f64 = 1.3;

/// The image of a disc, as used to measure limb and marks.
pub struct DiscImage {
    /// Brightness of the disc's bright part, DN.
    disc_dn: f64,
    /// The pixels around it: background subtracted, hot pixels masked.
    pub cutout: Cutout,
    /// A rough model of the disc's light.
    pub light: DiscLight,
}

/// Inputs of every stage, independent of the frame.
#[derive(Clone)]
pub struct Pipeline<'a> {
    pub(super) settings: &'a SolverSettings,
    pub(super) instrument: &'a Instrument,
    /// The Sun's expected radius on the plate.
    pub(super) radius_mil: Measured,
    /// The same on the sensor, at the nominal scale.
    pub(super) radius_px: f64,
    /// A mark at the nominal scale and the stated blur of the lens.
    pub(super) shape: MarkImage,
}

impl<'a> Pipeline<'a> {
    pub fn new(
        settings: &'a SolverSettings,
        instrument: &'a Instrument,
        expected: Option<Expected>,
    ) -> Self {
        let angular = match expected {
            Some(expected) => Measured::new(expected.radius_arcsec, 0.0),
            None => Measured::new(MEAN_SUN_ARCSEC, YEARLY_ARCSEC),
        };
        let optics = &instrument.optics;
        let scale = instrument.mounting.scale_mil_per_px.value;
        let value = optics.radius_mil(angular.value);
        let focus = optics.plate_distance_mm;
        let relative = (angular.sigma / angular.value).hypot(focus.sigma / focus.value);
        Self {
            settings,
            instrument,
            radius_mil: Measured::new(value, value * relative),
            radius_px: value / scale,
            shape: MarkImage::new(&instrument.plate.shape, scale, optics.blur_px.value),
        }
    }

    /// The levels. A background cut off at zero shows too little noise, so the stated noise is the minimum.
    pub fn levels(&self, frame: &Frame) -> Result<Levels, Stopped> {
        let seen = limb::levels(frame, &self.settings.limb).map_err(at(Stage::Levels))?;
        let stated = self
            .instrument
            .sensor
            .noise
            .filter(|noise| noise.is_of(frame));
        Ok(match stated {
            Some(noise) => Levels {
                noise_dn: seen.noise_dn.max(noise.read_noise_dn.value),
                ..seen
            },
            None => seen,
        })
    }

    /// The disc to about a pixel: near its previous position, then anywhere.
    pub fn find_disc(
        &self,
        frame: &Frame,
        levels: &Levels,
        before: Option<&Circle>,
    ) -> Result<Circle, Stopped> {
        let search = DiscSearch {
            frame,
            levels,
            radius_px: self.radius_px,
            mark_length_px: 2.0 * self.shape.half_length_px,
            settings: &self.settings.limb,
        };
        let near = before.and_then(|disc| {
            let reach = disc.radius + PRIOR_REACH_PX;
            search.near(frame.around(disc.centre.into(), reach)?).ok()
        });
        let anywhere = || search.anywhere(frame.region());
        near.map_or_else(anywhere, Ok).map_err(at(Stage::Limb))
    }

    /// The image of a disc that was found to about a pixel.
    pub fn image(
        &self,
        frame: &Frame,
        levels: &Levels,
        disc: &Circle,
    ) -> Result<DiscImage, Stopped> {
        let cutout = cutout(frame, self.instrument, levels, disc);
        let disc_dn = levels.disc_dn - levels.background_dn;
        let light = self.limb_fit(disc_dn, &cutout).rough(&Ellipse::from(*disc));
        let light = light.map_err(at(Stage::Limb))?;
        Ok(DiscImage {
            disc_dn,
            cutout,
            light,
        })
    }

    /// Fit of the outline of the disc.
    fn limb_fit<'b>(&'b self, disc_dn: f64, cutout: &'b Cutout) -> LimbFit<'b> {
        let settings = &self.settings.limb;
        let spread = settings.max_radius_deviation / 4.0;
        LimbFit {
            cutout,
            disc_dn,
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

    /// The limb of a disc without masked pixels.
    pub fn limb(&self, image: &DiscImage, mask: &Mask) -> Result<Limb, Rejected> {
        self.limb_fit(image.disc_dn, &image.cutout)
            .near(&image.light, mask)
    }

    /// The disc's radius on the sensor from ephemeris and stated scale.
    pub(super) fn stated_radius_px(&self) -> Measured {
        let scale = self.instrument.mounting.scale_mil_per_px;
        let relative =
            (scale.sigma / scale.value).hypot(self.radius_mil.sigma / self.radius_mil.value);
        let sigma = (relative * self.radius_px).hypot(LIMB_DEFINITION_SIGMA_PX);
        Measured::new(self.radius_px, sigma)
    }

    /// Scale at the disc, from its radius.
    pub(super) fn disc_scale(&self, disc: &DiscLight) -> f64 {
        self.radius_mil.value / disc.outline.mean_radius()
    }

    /// Blur of the marks, 1 sigma, without the pixel response.
    pub(super) fn mark_blur_px(&self, disc: &DiscLight) -> f64 {
        let stated_px = self.instrument.optics.blur_px.value;
        let limb_px = disc.lens_blur_px();
        if limb_px > SOFT * stated_px {
            limb_px
        } else {
            stated_px
        }
    }

    /// A mark at the scale of the disc and the blur of the frame.
    pub(super) fn disc_shape(&self, disc: &DiscLight) -> MarkImage {
        let shape = &self.instrument.plate.shape;
        MarkImage::new(shape, self.disc_scale(disc), self.mark_blur_px(disc))
    }
}

/// The disc's surroundings for measuring limb and marks: background subtracted, the instrument's hot pixels masked.
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

/// The cutout's mask, plus every mark of the plate that a mapping puts near the limb, detected or not.
pub(crate) fn marks_mask(
    cutout: &Cutout,
    instrument: &Instrument,
    disc: &Ellipse,
    mapping: &Mapping,
) -> Mask {
    let mut mask = cutout.mask.clone();
    let shape = &instrument.plate.shape;
    let scale = mapping.scale_mil_per_px(disc.centre.into());
    let reach_px = 1.1 * shape.size_mil() / 2.0 / scale + MARK_MARGIN_PX;
    let near = -MASKED_DEPTH_PX - reach_px..reach_px;
    let centre = mapping.to_plate(disc.centre.into());
    let about_mil = DISC_REACH * (disc.mean_radius() + reach_px) * scale;
    for (_, printed) in instrument.plate.marks_about(centre, about_mil) {
        let seen = mapping.to_sensor(printed);
        if !near.contains(&disc.excess(seen.vector())) {
            continue;
        }
        let Some(to_plate) = mapping.sensor_jacobian(printed).try_inverse() else {
            continue;
        };
        let margin_mil = MARK_MARGIN_PX * mapping.scale_mil_per_px(seen);
        let covers = shape.covers(margin_mil, &to_plate);
        mask.hide_where(seen, reach_px, |at| covers(at.vector() - seen.vector()));
    }
    mask
}
