//! Finding marks on the flattened disc, at any rotation of the camera.

use super::coverage::{BlurredCross, Pose};
use super::kernel::{Kernel, Support};
use super::spots::{find_spots, neighbours};
use super::{CrossShape, FlatDisc, Settings};
use crate::units::SensorPx;
use nalgebra::{Complex, Vector2};

/// Whether the whole mark is lit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Lighting {
    /// All four tips of the cross lie inside the limb and on the sensor.
    Full,
    /// The limb or the sensor's edge cuts the cross: its position is pulled, and it must not decide a mapping.
    Cut,
}

/// A mark that was found, not yet named.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Detection {
    pub at: SensorPx,
    /// 1 sigma per axis.
    pub sigma_px: f64,
    /// Darkness of the cross as a fraction of the light around it.
    pub contrast: f64,
    /// Part of the structure about the position that the cross explains, 0 to 1.
    pub likeness: f64,
    pub lighting: Lighting,
}

/// The marks that were found, and the rotation their arms show.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Detections {
    pub marks: Vec<Detection>,
    /// Rotation of the arms from the axes of the disc's own coordinates ([`Ellipse::to_disc`](crate::geometry::Ellipse::to_disc); of a
    /// round disc: from the sensor's axes), modulo a quarter turn, 0 to 90 deg.
    pub quarter_rotation_deg: f64,
}

/// Systematic error of a paraboloid's peak over the sub-pixel phases, px; added to every mark's sigma.
const PARABOLOID_SIGMA_PX: f64 = 0.01;
/// Structure that the cross does not explain counts as noise that is alike over so many pixels: the size of a sunspot.
const DISTURBANCE_PX2: f64 = 6.0;
/// The structure of a clean cross, between pixels and blurred as it may be, over what the kernel explains of it.
const CLEAN_SHARE: f64 = 1.4;
/// How far inside the limb a tip must be to count as lit: the outline's own uncertainty.
const TIP_MARGIN_PX: f64 = 0.25;
/// The contrast that the fourfold part of a cross shows, over that of the whole: 1 for a cross in focus, 0.3 in haze, and
/// 0 but for noise of what is round.
const FOURFOLD_SHARE: std::ops::Range<f64> = 0.2..2.0;
/// That part must be significant by itself, by less than the whole.
const FOURFOLD_SIGMA: f64 = 4.0;
/// All marks of a plate have the same contrast; saturation, the limb and blemishes change it by less than this.
const COMMON_CONTRAST: std::ops::Range<f64> = 0.45..2.2;

/// Finds the marks on a flattened disc.
///
/// # Algorithm
/// 1. Places that are dark over about the size of a mark, whatever its rotation.
/// 2. The rotation that the arms there have in common.
/// 3. At each place, the peak of the response to the blurred cross at that rotation, refined by a paraboloid. It must be
///    significant, like a cross, and as fourfold as one: sunspots and dust are round.
/// 4. Of those too near to each other the likest; of all, those of the contrast that the frame's marks have in common.
/// 5. The rotation again, from the marks' own places.
pub fn detect(flat: &FlatDisc, shape: &CrossShape, settings: &Settings) -> Detections {
    let middle = Middle::new(shape);
    let spots = find_spots(flat, shape, settings); // 1
    let spots: Vec<usize> = spots.iter().map(|spot| middle.near(flat, *spot)).collect();
    let support = Support::within(shape.reach_px());
    let arms = Arms::new(flat, shape, &support);
    let Some(rough_deg) = arms.rotation_deg(flat, spots.iter().copied()) else {
        return Detections::default(); // 2
    };
    let search = Search::new(flat, shape, settings, &support, rough_deg);
    let found = spots
        .iter()
        .filter_map(|spot| search.measure(*spot))
        .collect(); // 3
    let marks = with_common_contrast(likest(found, shape)); // 4
    let full = || marks.iter().filter(|m| m.lighting == Lighting::Full);
    let places = full().filter_map(|mark| flat.index(mark.at));
    let quarter_rotation_deg = arms.rotation_deg(flat, places).unwrap_or(rough_deg); // 5
    Detections {
        marks,
        quarter_rotation_deg,
    }
}

/// What tells the centroid of the darkness about a place that is within a few pixels of it.
struct Middle {
    support: Support,
    /// Offsets within the support's radius, px.
    x: Vec<f32>,
    y: Vec<f32>,
    farthest_px: f64,
}

impl Middle {
    fn new(shape: &CrossShape) -> Self {
        let support = Support::within(0.75 * shape.half_length_px);
        Self {
            x: support.weights(&support.x),
            y: support.weights(&support.y),
            support,
            farthest_px: shape.half_length_px,
        }
    }

    /// The index nearest to the centroid; what leads far away is no middle.
    fn near(&self, flat: &FlatDisc, spot: usize) -> usize {
        const ROUNDS: usize = 2;
        // Arms that reach beyond hold a cross's centroid back by half of the way.
        const STEP: f64 = 1.5;
        let place = flat.position(spot);
        let mut middle = spot;
        for _ in 0..ROUNDS {
            if !self.support.fits(flat, middle) {
                return spot;
            }
            let weights = [&self.support.inside[..], &self.x, &self.y];
            let sum = |weights| f64::from(self.support.sum(weights, flat, middle));
            let [sum, x, y] = weights.map(sum);
            let from = flat.position(middle);
            let near = SensorPx::new(from.x + STEP * x / sum, from.y + STEP * y / sum);
            if sum <= 0.0 || near.distance(place) > self.farthest_px {
                return spot;
            }
            middle = flat.index(near).unwrap_or(spot);
        }
        middle
    }
}

/// What tells the arms' rotation: the fourfold part of the darkness about a place.
struct Arms<'a> {
    support: &'a Support,
    /// By pixel: real and imaginary part of what its darkness adds.
    real: Vec<f32>,
    imaginary: Vec<f32>,
}

impl<'a> Arms<'a> {
    fn new(flat: &FlatDisc, shape: &CrossShape, support: &'a Support) -> Self {
        let to_disc = flat.outline.inverse().cast::<f32>();
        let per_radius2 = shape.reach_px().powi(-2) as f32;
        let fourfold = |(x, y): (&f32, &f32)| {
            // Where arms are apart from each other, and smooth, lest the pixels' own square shows.
            let part2 = (x * x + y * y) * per_radius2;
            let weight = (part2 * (1.0 - part2)).max(0.0);
            let w = to_disc * Vector2::new(*x, *y);
            let (re, im) = (w.x * w.x - w.y * w.y, 2.0 * w.x * w.y);
            let unit = weight / (re * re + im * im + f32::MIN_POSITIVE);
            ((re * re - im * im) * unit, 2.0 * re * im * unit)
        };
        let (real, imaginary) = support.x.iter().zip(&support.y).map(fourfold).unzip();
        Self {
            support,
            real,
            imaginary,
        }
    }

    /// The rotation of the arms in the disc's coordinates that some places have in common, each to the nearest pixel: what
    /// that is off turns opposite arms in opposite ways. `None` without places.
    fn rotation_deg(&self, flat: &FlatDisc, places: impl Iterator<Item = usize>) -> Option<f64> {
        let mut common = Complex::new(0.0_f32, 0.0);
        for place in places.filter(|place| self.support.fits(flat, *place)) {
            let weights = [&self.real, &self.imaginary];
            let [re, im] = weights.map(|weights| self.support.sum(weights, flat, place));
            let squares = self.support.squares(flat, place);
            // A place counts by how fourfold it is, so that the many that are no marks hardly do.
            if squares > 0.0 {
                common += Complex::new(re, im) * ((re * re + im * im) / squares);
            }
        }
        let angle = f64::from(common.arg()) / 4.0;
        (common.norm() > 0.0).then(|| angle.to_degrees().rem_euclid(90.0))
    }
}

/// What looks for crosses of one rotation.
struct Search<'a> {
    flat: &'a FlatDisc,
    settings: &'a Settings,
    support: &'a Support,
    cross: Kernel,
    fourfold: Kernel,
    rings: Rings,
    slope_energy: f64,
    /// Offsets of two neighbouring tips from the middle, px.
    tips: [Vector2<f64>; 2],
}

impl<'a> Search<'a> {
    fn new(
        flat: &'a FlatDisc,
        shape: &'a CrossShape,
        settings: &'a Settings,
        support: &'a Support,
        rotation_deg: f64,
    ) -> Self {
        let blurred = BlurredCross::new(shape);
        let coverage = blurred.at(&support.x, &support.y, &Pose::turned(rotation_deg));
        // A quarter turn leaves the cross as it is, so its slope is the same along every axis.
        let slopes = coverage.slope_u.iter().chain(coverage.slope_v.iter());
        let slope_energy = f64::from(slopes.map(|slope| slope * slope).sum::<f32>()) / 2.0;
        let (sin, cos) = rotation_deg.to_radians().sin_cos();
        let tip = |x, y| Vector2::new(x, y) * shape.half_length_px;
        Self {
            flat,
            settings,
            support,
            cross: Kernel::of(support, &coverage.share),
            fourfold: Kernel::fourfold(support, &coverage.share, &blurred),
            rings: Rings::of(support),
            slope_energy,
            tips: [tip(cos, sin), tip(-sin, cos)],
        }
    }

    /// Climbs to the peak of the cross's response near a spot, refines it by a paraboloid and judges it.
    fn measure(&self, spot: usize) -> Option<Detection> {
        let (flat, settings) = (self.flat, self.settings);
        let (index, around) = self.climb(spot)?;
        let (dx, dy) = paraboloid_peak(&around)?;
        let pixel = flat.position(index);
        let at = SensorPx::new(pixel.x + dx, pixel.y + dy);
        let noise = flat.noise(at);
        let contrast = around[4];
        let enough = settings.detection_sigma * self.cross.noise(noise);
        if contrast < enough.max(settings.min_contrast) {
            return None;
        }
        let fourfold = self.fourfold.response(self.support, flat, index);
        let significant = fourfold > FOURFOLD_SIGMA * self.fourfold.noise(noise);
        let structure = self.rings.structure(self.support, flat, index, noise);
        let explained = fourfold * fourfold * self.fourfold.energy;
        // The noise of this very patch may exceed its mean share; structure is never less than what is explained.
        let likeness = explained / structure.max(explained);
        if !significant
            || !FOURFOLD_SHARE.contains(&(fourfold / contrast))
            || likeness < settings.min_likeness
        {
            return None;
        }
        let disturbed = DISTURBANCE_PX2 * (structure - CLEAN_SHARE * explained).max(0.0)
            / self.rings.area_px2();
        let random = noise.hypot(disturbed.sqrt()) / (contrast * self.slope_energy.sqrt());
        Some(Detection {
            at,
            sigma_px: random.hypot(PARABOLOID_SIGMA_PX),
            contrast,
            likeness,
            lighting: self.lighting(at),
        })
    }

    /// The index of the highest response near a spot, with the responses of its 3 x 3 neighbourhood by rows. `None` when
    /// the climb leads away.
    fn climb(&self, spot: usize) -> Option<(usize, [f64; 9])> {
        const FARTHEST: usize = 6;
        let mut index = spot;
        for _ in 0..=FARTHEST {
            if !self.support.fits(self.flat, index) {
                return None;
            }
            let side = self.flat.side();
            let mut around = [0.0; 9];
            for (row, middle) in
                around
                    .as_chunks_mut()
                    .0
                    .iter_mut()
                    .zip([index - side, index, index + side])
            {
                *row = self.cross.responses_beside(self.support, self.flat, middle);
            }
            let mut best = (index, f64::NEG_INFINITY);
            for (response, n) in around.iter().zip(neighbours(index, side)) {
                if *response > best.1 {
                    best = (n, *response);
                }
            }
            if best.0 == index {
                return Some((index, around));
            }
            index = best.0;
        }
        None
    }

    fn lighting(&self, at: SensorPx) -> Lighting {
        let mut tips = self
            .tips
            .iter()
            .flat_map(|tip| [at.vector() + tip, at.vector() - tip]);
        if tips.all(|tip| self.flat.is_lit(tip.into(), TIP_MARGIN_PX)) {
            Lighting::Full
        } else {
            Lighting::Cut
        }
    }
}

/// The rings, a pixel wide, about the middle of a support.
struct Rings {
    /// By pixel, row by row; one more for what is outside the radius.
    ring: Vec<u16>,
    /// Pixels of each within the radius.
    pixels: Vec<f32>,
}

impl Rings {
    fn of(support: &Support) -> Self {
        let outside = support.reach as u16 + 1;
        let places = support.x.iter().zip(&support.y).zip(&support.inside);
        let ring = places.map(|((x, y), inside)| match *inside > 0.0 {
            true => (x * x + y * y).sqrt() as u16,
            false => outside,
        });
        let ring: Vec<u16> = ring.collect();
        let mut pixels = vec![0.0; usize::from(outside) + 1];
        ring.iter()
            .for_each(|ring| pixels[usize::from(*ring)] += 1.0);
        pixels.pop();
        Self { ring, pixels }
    }

    /// Sum of the squared darkness about a place, the noise's own share and all that is round about the place taken off.
    fn structure(&self, support: &Support, flat: &FlatDisc, index: usize, noise: f64) -> f64 {
        let mut sums = vec![0.0_f32; self.pixels.len() + 1];
        for (row, rings) in support.rows(flat, index).zip(support.rows_of(&self.ring)) {
            for (darkness, ring) in row.iter().zip(rings) {
                sums[usize::from(*ring)] += darkness;
            }
        }
        let rings = self.pixels.iter().zip(&sums);
        let round: f32 = rings.map(|(pixels, sum)| sum * sum / pixels).sum();
        let freedoms = self.pixels.iter().map(|pixels| pixels - 1.0).sum::<f32>();
        let about_means = support.squares(flat, index) - round;
        f64::from(about_means) - f64::from(freedoms) * noise * noise
    }

    fn area_px2(&self) -> f64 {
        f64::from(self.pixels.iter().sum::<f32>())
    }
}

/// Of detections less than a mark's length apart, the one most like a cross.
fn likest(mut found: Vec<Detection>, shape: &CrossShape) -> Vec<Detection> {
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

/// The top of the least-squares paraboloid through a 3 x 3 neighbourhood, from its middle. `None` when it has no top
/// within a pixel.
fn paraboloid_peak(around: &[f64; 9]) -> Option<(f64, f64)> {
    // On such a neighbourhood x, y, xy, and x^2 and y^2 less their means, are independent of each other.
    let sum = |weight: &dyn Fn(f64, f64) -> f64| -> f64 {
        let place = |n: usize| (n as f64 % 3.0 - 1.0, (n / 3) as f64 - 1.0);
        let weighted = |(n, value): (usize, &f64)| weight(place(n).0, place(n).1) * value;
        around.iter().enumerate().map(weighted).sum()
    };
    let (along_x, along_y) = (sum(&|x, _| x) / 6.0, sum(&|_, y| y) / 6.0);
    let (a, c) = (
        sum(&|x, _| x * x - 2.0 / 3.0),
        sum(&|_, y| y * y - 2.0 / 3.0),
    );
    let b = sum(&|x, y| x * y) / 4.0;
    let determinant = a * c - b * b;
    if a >= 0.0 || c >= 0.0 || determinant <= 0.0 {
        return None;
    }
    let x = -(c * along_x - b * along_y) / determinant;
    let y = -(a * along_y - b * along_x) / determinant;
    (x.abs() <= 1.0 && y.abs() <= 1.0).then_some((x, y))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_top_of_a_paraboloid_is_found_where_it_is() {
        let (px, py) = (0.3, -0.2);
        let around: [f64; 9] = std::array::from_fn(|n| {
            let (x, y) = (n as f64 % 3.0 - 1.0 - px, (n / 3) as f64 - 1.0 - py);
            1.0 - 0.1 * x * x - 0.2 * y * y + 0.05 * x * y
        });
        let (x, y) = paraboloid_peak(&around).unwrap();
        assert!((x - px).abs() < 1e-9 && (y - py).abs() < 1e-9);
    }

    #[test]
    fn even_ground_and_saddles_have_no_top() {
        assert_eq!(paraboloid_peak(&[1.0; 9]), None);
        let saddle = [0.0, -1.0, 0.0, 1.0, 0.0, 1.0, 0.0, -1.0, 0.0];
        assert_eq!(paraboloid_peak(&saddle), None);
    }
}
