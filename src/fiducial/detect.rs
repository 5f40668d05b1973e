//! Finding marks on the flattened disc, at any rotation of the camera.

use super::coverage::BlurredCross;
use super::kernel::Kernel;
use super::spots::{find_spots, neighbours};
use super::{CrossShape, FlatDisc, Settings};
use crate::units::SensorPx;
use nalgebra::{Complex, Matrix6, Vector2, Vector6};

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
    let spots = find_spots(flat, shape, settings); // 1
    let places = spots
        .iter()
        .map(|spot| middle_of_darkness(flat, flat.position(*spot), shape));
    let arms = Arms::new(flat, shape);
    let Some(rough_deg) = arms.rotation_deg(flat, places) else {
        return Detections::default(); // 2
    };
    let search = Search::new(flat, shape, settings, rough_deg);
    let found = spots
        .iter()
        .filter_map(|spot| search.measure(*spot))
        .collect(); // 3
    let marks = with_common_contrast(likest(found, shape)); // 4
    let full = || marks.iter().filter(|m| m.lighting == Lighting::Full);
    let places = full().map(|mark| mark.at);
    let quarter_rotation_deg = arms.rotation_deg(flat, places).unwrap_or(rough_deg); // 5
    Detections {
        marks,
        quarter_rotation_deg,
    }
}

/// The centroid of the darkness about a place that is within a few pixels of it.
fn middle_of_darkness(flat: &FlatDisc, place: SensorPx, shape: &CrossShape) -> SensorPx {
    const ROUNDS: usize = 2;
    let mut middle = place.vector();
    for _ in 0..ROUNDS {
        let (mut sum, mut moment) = (0.0, Vector2::zeros());
        for (first, values) in flat.around(middle.into(), 0.75 * shape.half_length_px) {
            let (mut row, mut along) = (0.0_f32, 0.0_f32);
            for (n, darkness) in values.iter().enumerate() {
                row += darkness;
                along += darkness * n as f32;
            }
            sum += f64::from(row);
            moment += (first - middle) * f64::from(row) + Vector2::x() * f64::from(along);
        }
        if sum > 0.0 {
            middle += moment / sum;
        }
    }
    // What leads far away is no middle.
    if SensorPx::from(middle).distance(place) < shape.half_length_px {
        middle.into()
    } else {
        place
    }
}

/// What tells the arms' rotation: the fourfold part of the darkness about a place.
struct Arms {
    reach: usize,
    side: usize,
    /// By pixel, row by row: real and imaginary part of what its darkness adds; nothing outside the cross's circle.
    fourfold: Vec<[f32; 2]>,
    inside: Vec<f32>,
}

impl Arms {
    fn new(flat: &FlatDisc, shape: &CrossShape) -> Self {
        let radius = shape.reach_px();
        let reach = radius.floor() as usize;
        let side = 2 * reach + 1;
        let to_disc = flat.outline.inverse().cast::<f32>();
        let offset = |n: usize| {
            let from_middle = |v: usize| v as f32 - reach as f32;
            Vector2::new(from_middle(n % side), from_middle(n / side))
        };
        let part2 = |n: usize| offset(n).norm_squared() / (radius * radius) as f32;
        let fourfold = |n: usize| {
            // Where arms are apart from each other, and smooth, lest the pixels' own square shows.
            let weight = (part2(n) * (1.0 - part2(n))).max(0.0);
            let w = to_disc * offset(n);
            let square = Complex::new(w.x * w.x - w.y * w.y, 2.0 * w.x * w.y);
            let turned = square * square;
            let unit = turned * (weight / (w.norm_squared().powi(2) + f32::MIN_POSITIVE));
            [unit.re, unit.im]
        };
        let inside = |n: usize| if part2(n) <= 1.0 { 1.0 } else { 0.0 };
        Self {
            reach,
            side,
            fourfold: (0..side * side).map(fourfold).collect(),
            inside: (0..side * side).map(inside).collect(),
        }
    }

    /// The rotation of the arms in the disc's coordinates that some places have in common, each to the nearest pixel: what
    /// that is off turns opposite arms in opposite ways. `None` without places.
    fn rotation_deg(&self, flat: &FlatDisc, places: impl Iterator<Item = SensorPx>) -> Option<f64> {
        let mut common = Complex::new(0.0_f32, 0.0);
        for place in places {
            let (fourfold, squares) = self.about(flat, place);
            // A place counts by how fourfold it is, so that the many that are no marks hardly do.
            if squares > 0.0 {
                common += fourfold * (fourfold.norm_sqr() / squares);
            }
        }
        let angle = f64::from(common.arg()) / 4.0;
        (common.norm() > 0.0).then(|| angle.to_degrees().rem_euclid(90.0))
    }

    /// The fourfold part of the darkness about a place, and the sum of its squares; nothing where the flattened disc ends.
    fn about(&self, flat: &FlatDisc, place: SensorPx) -> (Complex<f32>, f32) {
        let (mut fourfold, mut squares) = (Complex::new(0.0, 0.0), 0.0);
        for row in 0..self.side {
            let Some(values) = flat.row_from(place, self.reach, row, self.side) else {
                return (Complex::new(0.0, 0.0), 0.0);
            };
            let weights = &self.fourfold[row * self.side..][..self.side];
            let inside = &self.inside[row * self.side..][..self.side];
            for ((value, weight), inside) in values.iter().zip(weights).zip(inside) {
                fourfold.re += value * weight[0];
                fourfold.im += value * weight[1];
                squares += value * value * inside;
            }
        }
        (fourfold, squares)
    }
}

/// What looks for crosses of one rotation.
struct Search<'a> {
    flat: &'a FlatDisc,
    shape: &'a CrossShape,
    settings: &'a Settings,
    cross: Kernel,
    fourfold: Kernel,
    slope_energy: f64,
    /// Offsets of two neighbouring tips from the middle, px.
    tips: [Vector2<f64>; 2],
}

impl<'a> Search<'a> {
    fn new(
        flat: &'a FlatDisc,
        shape: &'a CrossShape,
        settings: &'a Settings,
        rotation_deg: f64,
    ) -> Self {
        let blurred = BlurredCross::new(shape);
        let (sin, cos) = rotation_deg.to_radians().sin_cos();
        let tip = |x, y| Vector2::new(x, y) * shape.half_length_px;
        Self {
            flat,
            shape,
            settings,
            cross: Kernel::oriented(shape, &blurred, rotation_deg),
            fourfold: Kernel::fourfold(shape, &blurred, rotation_deg),
            slope_energy: blurred.slope_energy(shape.reach_px()),
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
        let fourfold = self.fourfold.response(flat, index);
        let significant = fourfold > FOURFOLD_SIGMA * self.fourfold.noise(noise);
        let structure = self.structure(at, noise);
        let explained = fourfold * fourfold * self.fourfold.energy;
        // The noise of this very patch may exceed its mean share; structure is never less than what is explained.
        let likeness = explained / structure.max(explained);
        if !significant
            || !FOURFOLD_SHARE.contains(&(fourfold / contrast))
            || likeness < settings.min_likeness
        {
            return None;
        }
        let disturbed =
            DISTURBANCE_PX2 * (structure - CLEAN_SHARE * explained).max(0.0) / self.area_px2();
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
            if !self.cross.fits(self.flat, index) {
                return None;
            }
            let mut around = [0.0; 9];
            let mut best = (index, f64::NEG_INFINITY);
            for (response, n) in around.iter_mut().zip(neighbours(index, self.flat.side())) {
                *response = self.cross.response(self.flat, n);
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

    /// Sum of the squared darkness about a position, the noise's own share and all that is round about the position taken
    /// off.
    fn structure(&self, at: SensorPx, noise: f64) -> f64 {
        let mut rings = vec![Ring::default(); self.cross.reach + 1];
        for (first, values) in self.flat.around(at, self.shape.reach_px()) {
            let from: Vector2<f32> = (first - at.vector()).cast();
            for (n, darkness) in values.iter().enumerate() {
                let dx = from.x + n as f32;
                let ring = (dx * dx + from.y * from.y).sqrt() as usize;
                rings[ring.min(self.cross.reach)].add(*darkness);
            }
        }
        rings.iter().map(|ring| ring.structure(noise)).sum()
    }

    /// Of the patch that is judged about a position.
    fn area_px2(&self) -> f64 {
        std::f64::consts::PI * self.shape.reach_px().powi(2)
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

/// The darkness on a ring about a position.
#[derive(Debug, Clone, Copy, Default)]
struct Ring {
    pixels: f32,
    sum: f32,
    squares: f32,
}

impl Ring {
    fn add(&mut self, darkness: f32) {
        self.pixels += 1.0;
        self.sum += darkness;
        self.squares += darkness * darkness;
    }

    /// Sum of the squares about the ring's mean beyond what noise of this sigma makes.
    fn structure(&self, noise: f64) -> f64 {
        let freedoms = (self.pixels - 1.0).max(0.0);
        let about_mean = self.squares - self.sum * self.sum / self.pixels.max(1.0);
        f64::from(about_mean) - f64::from(freedoms) * noise * noise
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
    let mut normal = Matrix6::zeros();
    let mut right = Vector6::zeros();
    for (n, value) in around.iter().enumerate() {
        let (x, y) = (n as f64 % 3.0 - 1.0, (n / 3) as f64 - 1.0);
        let row = Vector6::new(1.0, x, y, x * x, x * y, y * y);
        normal += row * row.transpose();
        right += row * *value;
    }
    let p = normal.cholesky()?.solve(&right);
    let (a, b, c) = (2.0 * p[3], p[4], 2.0 * p[5]);
    let determinant = a * c - b * b;
    if a >= 0.0 || c >= 0.0 || determinant <= 0.0 {
        return None;
    }
    let x = -(c * p[1] - b * p[2]) / determinant;
    let y = -(a * p[2] - b * p[1]) / determinant;
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
