//! Finding marks on the flattened disc, at any rotation of the camera.

use super::candidates::candidates;
use super::mark_image::turned;
use super::template::{Template, Window};
use super::{FiducialSettings, FlatDisc, Lighting, MarkImage};
use crate::geometry::Handedness;
use crate::plate::MarkShape;
use crate::units::{Measured, SensorPx};
use nalgebra::{Complex, Matrix2, Vector2};
use serde::{Deserialize, Serialize};

/// A mark that was found, without an id yet.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct Detection {
    pub at: SensorPx,
    /// 1 sigma per axis.
    pub sigma_px: f64,
    /// Darkness of the mark as a fraction of the light around it.
    pub contrast: f64,
    /// Part of the structure about the position that the mark explains, 0 to 1.
    pub likeness: f64,
    pub lighting: Lighting,
}

/// The marks that were found, and the rotation their arms show.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Detections {
    pub marks: Vec<Detection>,
    /// Rotation of the arms from the axes of the disc's own coordinates ([`Ellipse::to_disc`](crate::geometry::Ellipse::to_disc); of a
    /// round disc: from the sensor's axes), modulo a quarter turn, 0 to 90 deg. `None` of marks without arms, and where none was found.
    pub arms_deg: Option<Measured>,
}

impl Detections {
    /// Rotation of the plate's axes modulo a quarter turn, by the arms of its crosses; `None` where there are none.
    pub fn quarter_rotation_deg(
        &self,
        shape: &MarkShape,
        handedness: Handedness,
    ) -> Option<Measured> {
        let MarkShape::Cross(cross) = shape else {
            return None;
        };
        // A mirror turns the other way round.
        let from_axes_deg = match handedness {
            Handedness::Mirrored => -cross.arm_angle_deg,
            Handedness::Direct => cross.arm_angle_deg,
        };
        let arms = self.arms_deg?;
        Some(Measured::new(arms.value - from_axes_deg, arms.sigma))
    }
}

/// Systematic error of a parabola's top over the sub-pixel phases, px; added to every mark's sigma.
const PARABOLA_SIGMA_PX: f64 = 0.01;
/// Structure that the cross does not explain counts as noise that is correlated over this many pixels: the size of a sunspot.
const DISTURBANCE_PX2: f64 = 6.0;
/// The structure of a clean cross, between pixels and blurred as it may be, over what the filter explains of it.
const CLEAN_SHARE: f64 = 1.4;
/// The same of a dot.
const CLEAN_SHARE_OF_DOT: f64 = 1.1;
/// Only its size and its even darkness distinguish a dot from a sunspot: it must explain this part of the structure.
const LEAST_LIKENESS_OF_DOT: f64 = 0.5;
/// The contrast that the fourfold part of a cross shows, over that of the whole: 1 for a cross in focus, 0.3 in haze that
/// the filter does not know of, and 0, except for noise, of a round spot.
const FOURFOLD_SHARE: std::ops::Range<f64> = 0.2..2.0;
/// That part must be significant by itself, by less than the whole.
const FOURFOLD_SIGMA: f64 = 4.0;
/// Error of the arms' rotation by pixels and neighbours beside the noise, 1 sigma, deg.
const ARMS_SIGMA_DEG: f64 = 0.6;
/// All marks of a plate have the same contrast; saturation, the limb and blemishes change it by less than this.
const COMMON_CONTRAST: std::ops::Range<f64> = 0.45..2.2;

/// Finds the marks on a flattened disc. `shape` is the mark at the frame's own blur.
///
/// # Algorithm
/// 1. Candidates: places that are dark over about the size of a mark.
/// 2. Each is centred by a filter of the mark's round part, which answers at any rotation.
/// 3. The rotation that the arms there have in common; dots have none.
/// 4. At each candidate, the peak of the response to the blurred mark at that rotation. It must be significant, like a
///    mark, and of a cross as fourfold as one: sunspots and dust are round.
/// 5. Of those too near to each other the likest; of all, those of the contrast that the frame's marks have in common.
/// 6. The rotation again, from the marks' own places.
pub fn detect(flat: &FlatDisc, shape: &MarkImage, settings: &FiducialSettings) -> Detections {
    let window = Window::within(shape.reach_px());
    let candidates = candidates(flat, shape, settings); // 1
    let centred = centred(flat, shape, &window, &candidates); // 2
    let arms = shape
        .shows_arms()
        .then(|| ArmRotation::new(flat, shape, &window));
    let common_deg = |places: &[usize]| arms.as_ref()?.common_deg(flat, places.iter().copied());
    let rough_deg = common_deg(&centred); // 3
    if centred.is_empty() || arms.is_some() && rough_deg.is_none() {
        return Detections::default();
    }
    let rotation_deg = rough_deg.map_or(0.0, |arms| arms.value);
    let search = MarkSearch::new(flat, shape, settings, &window, rotation_deg);
    let found = centred.iter().filter_map(|index| search.measure(*index)); // 4
    let marks = with_common_contrast(likest(found.collect(), shape)); // 5
    let full = marks.iter().filter(|m| m.lighting == Lighting::Full);
    let places: Vec<usize> = full.filter_map(|mark| flat.index(mark.at)).collect();
    let arms_deg = common_deg(&places).or(rough_deg); // 6
    Detections { marks, arms_deg }
}

/// A filter of what is round of a mark: its share less the rest.
fn round_template(window: &Window, share: &[f32], rest: &[f32]) -> Template {
    let round = share.iter().zip(rest).map(|(share, rest)| share - rest);
    Template::new(window, &round.collect::<Vec<f32>>())
}

/// Candidates moved to the middle of what is dark there, each place once; those that move by more than half a mark are none.
fn centred(
    flat: &FlatDisc,
    shape: &MarkImage,
    window: &Window,
    candidates: &[usize],
) -> Vec<usize> {
    let share = shape.coverage(&window.x, &window.y, &turned(0.0)).share;
    let round = round_template(window, &share, &window.without_round_part(&share));
    let most_steps = shape.half_length_px as usize;
    let peak = |start: &usize| round.climb(window, flat, *start, most_steps);
    let mut places: Vec<usize> = candidates
        .iter()
        .filter_map(peak)
        .map(|peak| peak.index)
        .collect();
    places.sort_unstable();
    places.dedup();
    places
}

/// Filters for the arms' rotation: the fourth harmonic of the darkness about a place.
struct ArmRotation<'a> {
    window: &'a Window,
    real: Vec<f32>,
    imaginary: Vec<f32>,
    /// Sum of the squares of either.
    energy: f64,
}

impl<'a> ArmRotation<'a> {
    fn new(flat: &FlatDisc, shape: &MarkImage, window: &'a Window) -> Self {
        let to_disc = flat.outline.inverse().cast::<f32>();
        let reach2 = shape.reach_px().powi(2) as f32;
        let harmonic = |(x, y): (&f32, &f32)| {
            // Where arms are apart from each other, and smooth, lest the pixels' own square shows.
            let part2 = (x * x + y * y) / reach2;
            let weight = (part2 * (1.0 - part2)).max(0.0);
            let w = to_disc * Vector2::new(*x, *y);
            let direction2 = Complex::new(w.x, w.y).powu(2);
            let fourth =
                direction2.powu(2) * (weight / (direction2.norm_sqr() + f32::MIN_POSITIVE));
            (fourth.re, fourth.im)
        };
        let (real, imaginary): (Vec<f32>, Vec<f32>) =
            window.x.iter().zip(&window.y).map(harmonic).unzip();
        Self {
            window,
            energy: imaginary.iter().map(|v| f64::from(v * v)).sum(),
            real,
            imaginary,
        }
    }

    /// The rotation of the arms in the disc's coordinates that some places have in common, each to the nearest pixel: an
    /// offset turns opposite arms in opposite ways. `None` without places.
    fn common_deg(&self, flat: &FlatDisc, places: impl Iterator<Item = usize>) -> Option<Measured> {
        let (mut common, mut variance) = (Complex::new(0.0_f32, 0.0), 0.0);
        for place in places.filter(|place| self.window.fits(flat, *place)) {
            let [re, im] = [&self.real, &self.imaginary]
                .map(|weights| self.window.correlate(weights, flat, place));
            let harmonic = Complex::new(re, im);
            let squares = self.window.squares(flat, place);
            // A place counts by how fourfold it is, so that the many that are no marks hardly do.
            if squares > 0.0 {
                let counts = harmonic.norm_sqr() / squares;
                common += harmonic * counts;
                variance += (f64::from(counts) * flat.noise(place)).powi(2) * self.energy;
            }
        }
        let angle_deg = f64::from(common.arg()).to_degrees() / 4.0;
        let noise_deg = (variance.sqrt() / f64::from(common.norm())).to_degrees() / 4.0;
        (common.norm() > 0.0).then(|| {
            let sigma_deg = noise_deg.hypot(ARMS_SIGMA_DEG);
            Measured::new(angle_deg.rem_euclid(90.0), sigma_deg)
        })
    }
}

/// Matched filters for marks of one rotation.
struct MarkSearch<'a> {
    flat: &'a FlatDisc,
    shape: &'a MarkImage,
    settings: &'a FiducialSettings,
    window: &'a Window,
    mark: Template,
    /// Of a cross without its round part.
    fourfold: Option<Template>,
    /// Sum of the squared slopes of the mark along one axis, 1/px^2.
    slope_energy: f64,
    /// Offsets of two neighbouring tips from the middle, px, as columns.
    arms: Matrix2<f64>,
}

/// Steps of a pixel by which a mark may be from the middle of the darkness.
const MOST_STEPS: usize = 6;

/// How a mark explains what is about its place.
struct Explained {
    /// Sum of the squared darkness that it explains, and of all but the noise's own share.
    explained: f64,
    structure: f64,
    /// The structure of a clean mark over what is explained of it.
    clean_share: f64,
    least_likeness: f64,
}

impl<'a> MarkSearch<'a> {
    fn new(
        flat: &'a FlatDisc,
        shape: &'a MarkImage,
        settings: &'a FiducialSettings,
        window: &'a Window,
        rotation_deg: f64,
    ) -> Self {
        let to_arms = turned(rotation_deg);
        let coverage = shape.coverage(&window.x, &window.y, &to_arms);
        let rest = window.without_round_part(&coverage.share);
        let (mark, fourfold) = match shape.shows_arms() {
            true => {
                let mark = Template::new(window, &coverage.share);
                (mark, Some(Template::new(window, &rest)))
            }
            // Arms that do not show may point anywhere.
            false => (round_template(window, &coverage.share, &rest), None),
        };
        Self {
            flat,
            shape,
            settings,
            window,
            mark,
            fourfold,
            // A quarter turn leaves the mark as it is, so its slope is the same along every axis.
            slope_energy: coverage.slope_energy(),
            arms: to_arms.transpose() * shape.half_length_px,
        }
    }

    /// The mark near a candidate; `None` where there is no mark.
    fn measure(&self, candidate: usize) -> Option<Detection> {
        let (flat, window) = (self.flat, self.window);
        let peak = self.mark.climb(window, flat, candidate, MOST_STEPS)?;
        let [dx, dy] = peak.top()?;
        let pixel = flat.position(peak.index);
        let at = SensorPx::new(pixel.x + dx, pixel.y + dy);
        let noise = flat.noise(peak.index);
        let contrast = peak.response;
        let enough = self.settings.detection_sigma * self.mark.noise(noise);
        if contrast < enough.max(self.settings.min_contrast) {
            return None;
        }
        let Explained {
            explained,
            structure,
            clean_share,
            least_likeness,
        } = match &self.fourfold {
            Some(fourfold) => self.as_cross(fourfold, peak.index, contrast, noise)?,
            None => self.as_dot(peak.index, contrast, noise),
        };
        // The noise of this very place may exceed its mean share; structure is never less than what is explained.
        let likeness = explained / structure.max(explained);
        if likeness < least_likeness {
            return None;
        }
        let unexplained = (structure - clean_share * explained).max(0.0);
        let disturbance = DISTURBANCE_PX2 * unexplained / window.pixels() as f64;
        let random = noise.hypot(disturbance.sqrt()) / (contrast * self.slope_energy.sqrt());
        Some(Detection {
            at,
            sigma_px: random.hypot(PARABOLA_SIGMA_PX),
            contrast,
            likeness,
            lighting: flat.lighting(at, self.shape.tips(&self.arms)),
        })
    }

    /// By its fourfold part: nothing round has one. `None` of what is no cross.
    fn as_cross(
        &self,
        template: &Template,
        index: usize,
        contrast: f64,
        noise: f64,
    ) -> Option<Explained> {
        let fourfold = template.response(self.window, self.flat, index);
        let significant = fourfold > FOURFOLD_SIGMA * template.noise(noise);
        let is_cross = significant && FOURFOLD_SHARE.contains(&(fourfold / contrast));
        is_cross.then(|| {
            let (window, flat) = (self.window, self.flat);
            let all = window.squares(flat, index) - window.round_squares(flat, index);
            Explained {
                explained: fourfold * fourfold * template.energy,
                structure: f64::from(all) - self.noise_squares(noise),
                clean_share: CLEAN_SHARE,
                least_likeness: self.settings.min_likeness,
            }
        })
    }

    /// By all that is not even.
    fn as_dot(&self, index: usize, contrast: f64, noise: f64) -> Explained {
        let all = f64::from(self.window.squares(self.flat, index));
        let even = f64::from(self.window.sum(self.flat, index)).powi(2);
        Explained {
            explained: contrast * contrast * self.mark.energy,
            structure: all - even / self.window.pixels() as f64 - self.noise_squares(noise),
            clean_share: CLEAN_SHARE_OF_DOT,
            least_likeness: self.settings.min_likeness.max(LEAST_LIKENESS_OF_DOT),
        }
    }

    /// Sum of squares about a place by noise alone.
    fn noise_squares(&self, noise: f64) -> f64 {
        self.window.pixels() as f64 * noise * noise
    }
}

/// Of detections less than a mark's size apart, the one most like a mark.
fn likest(mut found: Vec<Detection>, shape: &MarkImage) -> Vec<Detection> {
    found.sort_by(|a, b| b.likeness.total_cmp(&a.likeness));
    let mut kept: Vec<Detection> = Vec::new();
    for mark in found {
        let apart = 2.0 * shape.half_length_px;
        if kept.iter().all(|other| other.at.distance(mark.at) > apart) {
            kept.push(mark);
        }
    }
    kept
}

/// The detections whose contrast is that of most fully lit ones (of all, where none is), strongest first.
fn with_common_contrast(mut marks: Vec<Detection>) -> Vec<Detection> {
    marks.sort_by(|a, b| b.contrast.total_cmp(&a.contrast));
    let full = || marks.iter().filter(|mark| mark.lighting == Lighting::Full);
    let middle = full().count() / 2;
    let Some(common) = full().nth(middle).or(marks.first()).map(|m| m.contrast) else {
        return marks;
    };
    marks.retain(|mark| COMMON_CONTRAST.contains(&(mark.contrast / common)));
    marks
}
