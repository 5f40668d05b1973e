//! Calibration frames with the whole plate evenly illuminated, without Sun.
//!
//! Such a frame is divided into round windows of the Sun's size, all over the sensor. In each the marks are detected and
//! identified as if illuminated by the Sun; the windows that agree give all marks.

use super::observation::{FrameObservation, MarkObservation, consensus};
use crate::aspect;
use crate::calibrate::numbers::median;
use crate::estimation::QUARTILE_SIGMAS;
use crate::fiducial::{
    self, Detections, FlatDisc, IdentificationPrior, Lighting, MarkImage, Refiner,
};
use crate::frame::{
    Background, Cutout, Frame, Levels, PixelNoise, ROUNDING_NOISE_DN, Sample, View,
};
use crate::geometry::{Circle, Ellipse};
use crate::instrument::Instrument;
use crate::registration::{self, Pair};
use crate::units::Measured;
use crate::with_view;
use nalgebra::Vector2;
use std::collections::BTreeMap;
use std::path::Path;

/// Angular radius of the windows: the Sun's.
const WINDOW_ARCSEC: f64 = 960.0;
/// Least illuminated fraction of the sensor: the Sun illuminates 2 %, a lamp far more than this.
const LEAST_LIT: f64 = 0.25;
/// Least brightness of the illuminated plate above the background, in sigmas of the noise.
const LEAST_LIGHT_SIGMA: f64 = 20.0;
/// Fewest marks in such a frame.
const LEAST_MARKS: usize = 12;
/// Greatest distance of a mark's positions in two windows of a frame.
const SAME_PLACE_PX: f64 = 0.5;

/// Levels of a frame of the illuminated plate; `None` if the frame is none.
pub(super) fn lit_levels(frame: &Frame) -> Option<Levels> {
    let (mut values, noise_dn) = with_view!(frame, view => (sample(&view), noise(&view)));
    values.sort_by(f32::total_cmp);
    let at = |share: f64| values.get((share * (values.len() as f64 - 1.0)) as usize);
    let (middle, bright) = (f64::from(*at(0.5)?), f64::from(*at(0.99)?));
    let lit = values.iter().filter(|v| f64::from(**v) > bright / 2.0);
    let share = lit.count() as f64 / values.len() as f64;
    let is_lit = share > LEAST_LIT && middle > LEAST_LIGHT_SIGMA * noise_dn;
    is_lit.then_some(Levels {
        background_dn: 0.0,
        noise_dn,
        disc_dn: middle,
    })
}

fn sample<T: Sample>(view: &View<'_, T>) -> Vec<f32> {
    const EVERY: usize = 37;
    view.pixels().step_by(EVERY).map(|v| v.dn()).collect()
}

/// 1 sigma of a pixel's noise, from differences of neighbours.
fn noise<T: Sample>(view: &View<'_, T>) -> f64 {
    const EVERY: usize = 37;
    let pairs = view.pixels().zip(view.pixels().skip(1)).step_by(EVERY);
    let differences = pairs.map(|(pixel, next)| f64::from((next.dn() - pixel.dn()).abs()));
    // Median of the absolute difference of two normal values.
    let sigma = median(differences) / (QUARTILE_SIGMAS * 2.0_f64.sqrt());
    sigma.max(ROUNDING_NOISE_DN)
}

/// The marks of an illuminated plate.
pub(super) fn by_lamp(
    file: &Path,
    frame: &Frame,
    levels: &Levels,
    instrument: &Instrument,
) -> Result<FrameObservation, String> {
    let region = frame.region();
    let background = Background::even(region, levels.background_dn);
    let noise = PixelNoise::even(levels.noise_dn);
    let lit = LitPlate {
        frame,
        cutout: Cutout::new(frame, region, &background, noise),
        light_dn: levels.disc_dn - levels.background_dn,
        instrument,
        settings: aspect::SolverSettings::default(),
    };
    let windows: Vec<FrameObservation> = lit
        .windows()
        .filter_map(|outline| lit.identify(outline, file))
        .collect();
    let windows: Vec<&FrameObservation> = windows.iter().collect();
    let all: Vec<usize> = (0..windows.len()).collect();
    let agreed =
        consensus(&windows, &all, &instrument.plate).ok_or("no marks could be identified")?;
    let mut marks: BTreeMap<_, MarkObservation> = BTreeMap::new();
    for window in agreed.frames.iter().map(|n| windows[*n]) {
        for mark in &window.marks {
            let known = marks.entry(mark.id).or_insert(*mark);
            if known.at.distance(mark.at) > SAME_PLACE_PX {
                return Err(format!("mark {} is seen in two places", mark.id));
            }
        }
    }
    if marks.len() < LEAST_MARKS {
        let count = marks.len();
        return Err(format!(
            "{count} marks on the lit plate, expected {LEAST_MARKS}"
        ));
    }
    Ok(FrameObservation {
        file: file.into(),
        utc: frame.info.mid_exposure,
        mapping: agreed.mapping,
        sun: None,
        marks: marks.into_values().collect(),
    })
}

struct LitPlate<'a> {
    frame: &'a Frame,
    /// The whole frame.
    cutout: Cutout,
    /// Level of the lamp above the background.
    light_dn: f64,
    instrument: &'a Instrument,
    settings: aspect::SolverSettings,
}

impl LitPlate<'_> {
    /// Windows that overlap so that each mark lies well inside one of them.
    fn windows(&self) -> impl Iterator<Item = Ellipse> {
        let radius = self.instrument.radius_px(WINDOW_ARCSEC);
        let steps = move |size: usize| {
            let count = (size as f64 / (0.8 * radius)).ceil().max(1.0);
            (0..=count as usize).map(move |n| n as f64 * size as f64 / count)
        };
        let (width, height) = (self.frame.width(), self.frame.height());
        steps(height).flat_map(move |y| {
            steps(width).map(move |x| {
                Ellipse::from(Circle {
                    centre: Vector2::new(x, y),
                    radius,
                })
            })
        })
    }

    /// The marks in a window, identified and fitted; `None` if they cannot be identified.
    fn identify(&self, outline: Ellipse, file: &Path) -> Option<FrameObservation> {
        let instrument = self.instrument;
        let (plate, mounting) = (&instrument.plate, &instrument.mounting);
        let (scale, blur_px) = (
            mounting.scale_mil_per_px.value,
            instrument.optics.blur_px.value,
        );
        let shape = MarkImage::new(&plate.shape, scale, blur_px);
        let window = |x: f64, y: f64| {
            let inside = outline.excess(Vector2::new(x, y)) < 0.0;
            if inside { self.light_dn } else { 0.0 }
        };
        let flat = FlatDisc::new(&self.cutout, outline, &window, &shape)?;
        let mut found = fiducial::detect(&flat, &shape, &self.settings.fiducial);
        // The window's edge is not an edge of the illumination.
        found.marks.retain(|mark| mark.lighting == Lighting::Full);
        let prior = self.prior(outline, &found, &shape);
        let fiducial = &self.settings.fiducial;
        let identified = fiducial::identify(&found.marks, &prior, plate, fiducial).ok()?;
        let pair = |(n, id): &(usize, _)| {
            Some(Pair {
                observed: found.marks[*n].at,
                printed: plate.position(*id)?,
                covariance_px2: nalgebra::Matrix2::identity() * found.marks[*n].sigma_px.powi(2),
            })
        };
        let pairs: Vec<Pair> = identified.iter().filter_map(pair).collect();
        let distortion = instrument.camera.distortion;
        let settings = &self.settings.registration;
        let fitted =
            registration::register(&pairs, None, mounting.handedness, distortion, settings)?;
        let mut refiner = Refiner::new(&plate.shape, scale, blur_px, self.cutout.noise);
        let lamp = |_: f64, _: f64| self.light_dn;
        let refined = |(n, id): &(usize, _)| {
            let jacobian = fitted.mapping.sensor_jacobian(plate.position(*id)?);
            let start = found.marks[*n].at;
            let mark = refiner.refine(&self.cutout, &lamp, &jacobian, start)?;
            Some(MarkObservation {
                id: *id,
                at: mark.place.position,
                covariance_px2: mark.place.covariance,
            })
        };
        Some(FrameObservation {
            file: file.into(),
            utc: self.frame.info.mid_exposure,
            mapping: fitted.mapping,
            sun: None,
            marks: identified.iter().filter_map(refined).collect(),
        })
    }

    fn prior(
        &self,
        outline: Ellipse,
        found: &Detections,
        shape: &MarkImage,
    ) -> IdentificationPrior {
        /// Relative sigma of a window's radius on the plate: from the scale and the lens's distortion.
        const SCALE_SIGMA: f64 = 0.006;
        /// Fraction of marks that are not detected on an evenly illuminated plate.
        const MISSED: f64 = 0.02;
        let mounting = &self.instrument.mounting;
        let radius = outline.mean_radius() * mounting.scale_mil_per_px.value;
        IdentificationPrior {
            outline,
            radius_mil: Measured::new(radius, SCALE_SIGMA * radius),
            quarter_rotation_deg: found
                .quarter_rotation_deg(&self.instrument.plate.shape, mounting.handedness),
            handedness: mounting.handedness,
            plate_centre: mounting.plate_centre_px,
            plate_centre_sigma_px: mounting.plate_centre_sigma_px,
            rotation_deg: mounting.rotation_deg,
            scale_mil_per_px: mounting.scale_mil_per_px,
            missed_share: MISSED,
            sure_depth_px: shape.half_length_px + 2.0,
            sure_margin_px: shape.half_length_px + 4.0,
            sensor_px: [self.frame.width() as f64, self.frame.height() as f64],
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::instrument::builtin;
    use crate::simulate::{Conditions, RandomScenes, Sun};
    use crate::units::{PlateMil, SensorPx};

    /// Simulates a lamp by a Sun as large as the plate, without limb darkening.
    fn lit_frame(instrument: &Instrument) -> crate::simulate::Scene {
        let scenes = RandomScenes::new(instrument, &Conditions::of(instrument), 3).unwrap();
        let mut scene = scenes.scene(0).unwrap();
        scene.sun = Some(Sun {
            limb_darkening: 0.0,
            peak_dn: 180.0,
            ..Sun::new(PlateMil::new(0.0, 0.0), 20_000.0)
        });
        scene
    }

    #[test]
    fn every_mark_of_a_lit_plate_is_named_and_placed() {
        let demo = builtin("demo").unwrap();
        let scene = lit_frame(&demo);
        let picture = scene.picture().unwrap();
        let levels = lit_levels(&picture.frame).unwrap();
        let seen = by_lamp(Path::new("lit"), &picture.frame, &levels, &demo).unwrap();
        let mut squares = 0.0;
        for mark in &seen.marks {
            let place = demo.plate.position(mark.id).unwrap();
            let error = picture.truth.mapping.to_sensor(place).distance(mark.at);
            assert!(error < 0.15, "{}", mark.id);
            squares += error.powi(2);
        }
        let whole = |at: &SensorPx| at.x > 12.0 && at.y > 12.0 && at.x < 1283.0 && at.y < 953.0;
        let on_sensor = demo.plate.marks().filter(|(_, at)| {
            let seen = picture.truth.mapping.to_sensor(*at);
            whole(&seen)
        });
        let (found, there) = (seen.marks.len(), on_sensor.count());
        assert!(found * 100 >= there * 98, "{found} of {there}");
        assert!((squares / found as f64).sqrt() < 0.04);
    }

    #[test]
    fn neither_the_sun_nor_darkness_is_a_lit_plate() {
        let demo = builtin("demo").unwrap();
        let mut scene = lit_frame(&demo);
        scene.sun = Some(Sun::new(PlateMil::new(0.0, 0.0), 546.0));
        assert_eq!(lit_levels(&scene.frame().unwrap()), None);
        scene.sun = None;
        assert_eq!(lit_levels(&scene.frame().unwrap()), None);
    }
}
