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
    /// Fraction of the structure around the position that the mark explains, 0 to 1.
    pub likeness: f64,
    pub lighting: Lighting,
}

/// The detected marks, and the rotation of their arms.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct Detections {
    pub marks: Vec<Detection>,
    /// Rotation of the arms from the axes of the disc's own coordinates
    /// ([`Ellipse::to_disc`](crate::geometry::Ellipse::to_disc); of a round disc: from the sensor's axes), modulo a quarter
    /// turn, 0 to 90 deg. `None` for marks without arms, or if none was found.
    pub arms_deg: Option<Measured>,
}

impl Detections {
    /// Rotation of the plate's axes modulo a quarter turn, from the arms of its crosses; `None` if there are none.
    pub fn quarter_rotation_deg(
        &self,
        shape: &MarkShape,
        handedness: Handedness,
    ) -> Option<Measured> {
        let MarkShape::Cross(cross) = shape else {
            return None;
        };
        // A mirror reverses the sense of rotation.
        let from_axes_deg = match handedness {
            Handedness::Mirrored => -cross.arm_angle_deg,
            Handedness::Direct => cross.arm_angle_deg,
        };
        let arms = self.arms_deg?;
        Some(Measured::new(arms.value - from_axes_deg, arms.sigma))
    }
}

/// Systematic error of a parabola's vertex over the sub-pixel phases, px; added to every mark's sigma.
const PARABOLA_SIGMA_PX: f64 = 0.01;
/// Unexplained structure counts as noise that is correlated over this many pixels: the size of a sunspot.
const DISTURBANCE_PX2: f64 = 6.0;
/// Structure of a clean cross, at any sub-pixel phase and blur, relative to the part that the filter explains.
const CLEAN_SHARE: f64 = 1.4;
/// The same for a dot.
const CLEAN_SHARE_OF_DOT: f64 = 1.1;
/// Only its size and uniform darkness distinguish a dot from a sunspot: it must explain this fraction of the structure.
const LEAST_LIKENESS_OF_DOT: f64 = 0.5;
/// Contrast of a cross's fourfold part relative to that of the whole: 1 for a cross in focus, 0.3 in haze that the filter
/// does not model, and 0, apart from noise, for a round spot.
const FOURFOLD_SHARE: std::ops::Range<f64> = 0.2..2.0;
/// The fourfold part must be significant by itself, by this many sigma, less than the whole.
const FOURFOLD_SIGMA: f64 = 4.0;
/// Error of the arms' rotation from sampling and neighbours, beside the noise, 1 sigma, deg.
const ARMS_SIGMA_DEG: f64 = 0.6;
/// All marks of a plate have the same contrast; saturation, the limb and blemishes change it by less than this.
const COMMON_CONTRAST: std::ops::Range<f64> = 0.45..2.2;

/// Finds the marks on a flattened disc. `shape` is the mark at the frame's own blur.
///
/// # Algorithm
/// 1. Candidates: positions that are dark over about the size of a mark.
/// 2. Each is centred by a filter of the mark's round part, which responds at any rotation.
/// 3. The rotation common to the arms at the candidates; dots have none.
/// 4. At each candidate, the peak of the response to the blurred mark at that rotation. It must be significant, explain
///    most of the structure, and for a cross have a fourfold part: sunspots and dust are round.
/// 5. Of detections too near to each other, the one most like a mark; of all, those with the contrast common to the frame's
///    marks.
/// 6. The rotation again, from the marks' own positions.
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

/// A filter for the round part of a mark: its share minus the rest.
fn round_template(window: &Window, share: &[f32], rest: &[f32]) -> Template {
    let round = share.iter().zip(rest).map(|(share, rest)| share - rest);
    Template::new(window, &round.collect::<Vec<f32>>())
}

/// Candidates moved to the centre of the dark spot, each position once; those that move by more than half a mark are
/// dropped.
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

/// Filters for the arms' rotation: the fourth harmonic of the darkness around a position.
struct ArmRotation<'a> {
    window: &'a Window,
    real: Vec<f32>,
    imaginary: Vec<f32>,
    /// Sum of the squares of either part.
    energy: f64,
}

impl<'a> ArmRotation<'a> {
    fn new(flat: &FlatDisc, shape: &MarkImage, window: &'a Window) -> Self {
        let to_disc = flat.outline.inverse().cast::<f32>();
        let reach2 = shape.reach_px().powi(2) as f32;
        let harmonic = |(x, y): (&f32, &f32)| {
            // Weight the radii where the arms are separate, smoothly, so that the square pixel grid has no effect.
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

    /// The common rotation of the arms at some positions, in the disc's coordinates. Positions to the nearest pixel
    /// suffice: an offset rotates opposite arms in opposite directions. `None` without positions.
    fn common_deg(&self, flat: &FlatDisc, places: impl Iterator<Item = usize>) -> Option<Measured> {
        let (mut common, mut variance) = (Complex::new(0.0_f32, 0.0), 0.0);
        for place in places.filter(|place| self.window.fits(flat, *place)) {
            let [re, im] = [&self.real, &self.imaginary]
                .map(|weights| self.window.correlate(weights, flat, place));
            let harmonic = Complex::new(re, im);
            let squares = self.window.squares(flat, place);
            // A position is weighted by its fourfold part, so that the many false candidates hardly count.
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
    /// The cross without its round part; `None` for a mark without arms.
    fourfold: Option<Template>,
    /// Sum of the squared slopes of the mark along one axis, 1/px^2.
    slope_energy: f64,
    /// Offsets of two neighbouring tips from the middle, px, as columns.
    arms: Matrix2<f64>,
}

/// Largest distance of a mark from its candidate, in pixels.
const MOST_STEPS: usize = 6;

/// The fraction of the structure around a position that a mark explains.
struct Explained {
    /// Sum of the squared darkness that the mark explains, and of all the darkness minus the noise.
    explained: f64,
    structure: f64,
    /// Structure of a clean mark relative to the explained part.
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
            // Unresolved arms may have any rotation.
            false => (round_template(window, &coverage.share, &rest), None),
        };
        Self {
            flat,
            shape,
            settings,
            window,
            mark,
            fourfold,
            // The mark is invariant under a quarter turn, so its slope is the same along every axis.
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
        // The local noise may exceed its expected share; the structure is at least the explained part.
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

    /// Compares the fourfold part, which nothing round has. `None` if it is not a cross.
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

    /// Compares all structure except the mean.
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

    /// Expected sum of squares around a position from noise alone.
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

/// The detections whose contrast agrees with the median of the fully lit ones (of all, if none is fully lit), strongest
/// first.
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
