//! Acquisition: a first mapping from the marks of a frame without prior information.

use super::stages::{DiscImage, MARK_MARGIN_PX, Pipeline, at};
use super::{Measured, Solution, Stage, Stopped};
use crate::estimation::median;
use crate::fiducial::{
    self, Detection, Detections, FlatDisc, IdentificationPrior, Illumination, Lighting, Unread,
};
use crate::frame::{Frame, Mask};
use crate::geometry::{Ellipse, Mapping, MappingKind};
use crate::instrument::Mounting;
use crate::kernels::limb::Lit;
use crate::limb::DiscLight;
use crate::plate::MarkId;
use crate::reasons::sun;
use crate::registration::{self, Pair};
use crate::units::{self, Rejected, SensorPx};
use nalgebra::Matrix2;
use std::f64::consts::PI;

/// Relative error of a scale derived from the disc's radius: the Sun's edge of the ephemeris and the edge seen on the limb
/// may differ by half a pixel.
const DISC_SCALE_SIGMA: f64 = 0.006;
/// Haze may widen the disc by up to this.
const HAZE_PX: f64 = 1.0;

/// Largest distance of the plate's centre from the stated position when marks that cannot be identified there are searched
/// anywhere, px.
const ANYWHERE_PX: f64 = 2000.0;

impl Pipeline<'_> {
    /// Limb and marks of a single frame: by the mapping that its marks give, or the limb alone.
    ///
    /// # Errors
    /// If there is no limb, or if the marks contradict every mapping that could be borrowed.
    pub(super) fn alone(
        &self,
        frame: &Frame,
        image: &DiscImage,
        solution: &mut Solution,
    ) -> Result<Measured, Stopped> {
        solution.detections = self.detect(image);
        match self.acquire(frame, image, &solution.detections) {
            Ok(mapping) => self.measure(image, &mapping),
            Err(Unread::Contradicting(rejected)) => Err(at(Stage::Identification)(rejected)),
            Err(Unread::Undecided(rejected)) => {
                let mask = self.detections_mask(image, &solution.detections);
                Ok(Measured {
                    limb: self.limb_beside(image, &mask)?,
                    marks: Err(at(Stage::Identification)(rejected)),
                    missing: 0,
                })
            }
        }
    }

    /// The marks on the flattened disc.
    pub fn detect(&self, image: &DiscImage) -> Detections {
        let DiscImage { cutout, light, .. } = image;
        let shape = self.disc_shape(light);
        match FlatDisc::new(cutout, light.outline, light, &shape) {
            Some(flat) => fiducial::detect(&flat, &shape, &self.detection_settings()),
            None => Detections::default(),
        }
    }

    /// On a plate with many marks, allows as many detections as the disc has marks.
    fn detection_settings(&self) -> fiducial::FiducialSettings {
        /// Largest local density of the plate's marks relative to the mean.
        const DENSEST: f64 = 1.5;
        let settings = self.settings.fiducial;
        let disc_mil2 = PI * self.radius_mil.value.powi(2);
        let marks = DENSEST * self.instrument.plate.density_per_mil2() * disc_mil2;
        let usual = fiducial::FiducialSettings::default().max_detections;
        let max_detections = match marks as usize {
            many if many > usual => settings.max_detections.max(many),
            _ => settings.max_detections,
        };
        fiducial::FiducialSettings {
            max_detections,
            ..settings
        }
    }

    /// The cutout's mask, and all detections on the disc: no mapping predicts which marks lie near the limb.
    fn detections_mask(&self, image: &DiscImage, detections: &Detections) -> Mask {
        let mut mask = image.cutout.mask.clone();
        let reach_px = self.shape.half_length_px + MARK_MARGIN_PX;
        for Detection { at, .. } in &detections.marks {
            mask.hide_where(*at, reach_px, |pixel| pixel.distance(*at) < reach_px);
        }
        mask
    }

    /// A similarity from the marks that were detected and can be identified.
    fn acquire(
        &self,
        frame: &Frame,
        image: &DiscImage,
        detections: &Detections,
    ) -> Result<Mapping, Unread> {
        let sensor_px = [frame.width() as f64, frame.height() as f64];
        let ids = self.identify(sensor_px, image.light.outline, detections)?;
        let pair = |(n, id): &(usize, _)| {
            Some(Pair {
                observed: detections.marks[*n].at,
                printed: self.instrument.plate.position(*id)?,
                covariance_px2: Matrix2::identity() * detections.marks[*n].sigma_px.powi(2),
            })
        };
        let full = ids.iter().filter(|(n, _)| is_full(&detections.marks[*n]));
        let pairs: Vec<Pair> = full.filter_map(pair).collect();
        registration::fit(
            &pairs,
            MappingKind::Similarity,
            self.instrument.mounting.handedness,
            self.instrument.camera.distortion,
            &self.settings.registration,
        )
        .map(|fit| fit.mapping)
        .ok_or(Unread::Undecided(Rejected {
            reason: sun::NO_MAPPING,
            measured: pairs.len() as f64,
            limit: self.settings.fiducial.min_marks as f64,
        }))
    }

    /// The ids of the detections around a disc's outline on a sensor of some width and height, with the plate at its stated
    /// position; rejected if the detections show that the plate is somewhere else or mirrored.
    ///
    /// # Errors
    /// As [`fiducial::identify`].
    fn identify(
        &self,
        sensor_px: [f64; 2],
        outline: Ellipse,
        detections: &Detections,
    ) -> Result<Vec<(usize, MarkId)>, Unread> {
        let read = |mounting: &Mounting, settings: &fiducial::FiducialSettings| {
            self.identify_mounted(sensor_px, outline, detections, mounting, settings)
        };
        let (mounting, settings) = (&self.instrument.mounting, &self.settings.fiducial);
        let mirrored = || {
            let mut images = mirror_images(mounting, sensor_px).into_iter();
            images.any(|image| read(&image, settings).is_ok())
        };
        let elsewhere = || {
            let anywhere = Mounting {
                plate_centre_sigma_px: ANYWHERE_PX,
                ..*mounting
            };
            let settings = fiducial::FiducialSettings {
                max_centre_shift_px: ANYWHERE_PX,
                ..*settings
            };
            read(&anywhere, &settings)
        };
        let here = read(mounting, settings).map_err(|unread| {
            let rejected = unread.rejected();
            let because = |reason| Unread::Contradicting(Rejected { reason, ..rejected });
            match unread {
                Unread::Undecided(_) if mirrored() => because(sun::MIRROR_IMAGE),
                Unread::Undecided(_) if elsewhere().is_ok() => because(sun::CENTRE_ELSEWHERE),
                unread => unread,
            }
        })?;
        let count_full = |ids: &[(usize, _)]| {
            let full = ids.iter().filter(|(n, _)| is_full(&detections.marks[*n]));
            full.count()
        };
        // Marks that are not identified at the stated position may show that the plate is somewhere else.
        let read_here = count_full(&here);
        if read_here < detections.marks.iter().filter(|mark| is_full(mark)).count() {
            let read_there = elsewhere().map_or(0, |there| count_full(&there));
            let reason = sun::CENTRE_ELSEWHERE;
            Rejected::at_most(read_here as f64, read_there as f64, reason)
                .map_err(Unread::Contradicting)?;
        }
        Ok(here)
    }

    /// The ids for a camera mounted nearly like this.
    ///
    /// # Errors
    /// As [`fiducial::identify`].
    fn identify_mounted(
        &self,
        sensor_px: [f64; 2],
        outline: Ellipse,
        detections: &Detections,
        mounting: &Mounting,
        settings: &fiducial::FiducialSettings,
    ) -> Result<Vec<(usize, MarkId)>, Unread> {
        let prior = self.identification_prior(sensor_px, outline, detections, mounting);
        fiducial::identify(&detections.marks, &prior, &self.instrument.plate, settings)
    }

    /// The most likely ids, decisive or not.
    pub(crate) fn likeliest_ids(
        &self,
        sensor_px: [f64; 2],
        outline: Ellipse,
        detections: &Detections,
    ) -> Option<Vec<(usize, MarkId)>> {
        let instrument = self.instrument;
        let prior = self.identification_prior(sensor_px, outline, detections, &instrument.mounting);
        let settings = &self.settings.fiducial;
        fiducial::likeliest(&detections.marks, &prior, &instrument.plate, settings)
    }

    /// Prior before marks are identified, for a disc's outline on a sensor of some width and height.
    pub(crate) fn identification_prior(
        &self,
        sensor_px: [f64; 2],
        outline: Ellipse,
        detections: &Detections,
        mounting: &Mounting,
    ) -> IdentificationPrior {
        let radius = self.radius_mil.value;
        let relative = (self.radius_mil.sigma / radius).hypot(DISC_SCALE_SIGMA);
        IdentificationPrior {
            outline,
            radius_mil: units::Measured::new(radius, radius * relative),
            quarter_rotation_deg: detections
                .quarter_rotation_deg(&self.instrument.plate.shape, mounting.handedness),
            handedness: mounting.handedness,
            plate_centre: mounting.plate_centre_px,
            plate_centre_sigma_px: mounting.plate_centre_sigma_px,
            rotation_deg: mounting.rotation_deg,
            scale_mil_per_px: mounting.scale_mil_per_px,
            missed_share: missed_share(detections),
            sure_depth_px: self.shape.sure_depth_px() + HAZE_PX,
            sure_margin_px: self.shape.half_length_px + 4.0,
            sensor_px,
        }
    }
}

fn is_full(mark: &Detection) -> bool {
    mark.lighting == Lighting::Full
}

/// Mounting of the camera if its pictures were mirrored: its rows or columns read in the opposite order, or an error in its
/// file.
fn mirror_images(mounting: &Mounting, [width_px, height_px]: [f64; 2]) -> [Mounting; 3] {
    let SensorPx { x, y } = mounting.plate_centre_px;
    let (last_x, last_y) = (width_px - 1.0, height_px - 1.0);
    let rotation = mounting.rotation_deg;
    [
        (SensorPx::new(x, last_y - y), 180.0 - rotation.value),
        (SensorPx::new(last_x - x, y), -rotation.value),
        (SensorPx::new(x, y), rotation.value),
    ]
    .map(|(plate_centre_px, rotation_deg)| Mounting {
        plate_centre_px,
        rotation_deg: units::Measured::new(rotation_deg, rotation.sigma),
        handedness: mounting.handedness.other(),
        ..*mounting
    })
}

/// The disc's light illuminates the marks.
impl Illumination for DiscLight {
    fn fill(&self, x: f64, y: f64, light: &mut [f32]) {
        self.fill(x, y, light);
    }

    fn about(&self, position: SensorPx, x: &[f32], y: &[f32], lit: &mut Lit) {
        self.about(position.vector(), x, y, lit);
    }
}

/// Share of the marks that are missed, estimated from the sigmas of the detected ones. Above the share in simulated frames:
/// none of some 1,500 where marks have high contrast, 0.3 % in haze, 1.4 % of faint ones among blemishes.
pub(crate) fn missed_share(detections: &Detections) -> f64 {
    const MOST: f64 = 0.1;
    const LEAST: f64 = 0.003;
    const SIGMA_OF_MOST_PX: f64 = 0.08;
    match median(detections.marks.iter().map(|d| d.sigma_px)) {
        Some(median) => (MOST * (median / SIGMA_OF_MOST_PX).powi(2)).clamp(LEAST, MOST),
        None => MOST,
    }
}
