//! Finding marks on the flattened disc, at any rotation of the camera.

use super::kernel::Tap;
use super::{CrossShape, FlatDisc, Kernel, Settings};
use crate::units::SensorPx;
use nalgebra::{Complex, Matrix6, Vector6};

/// Whether the whole mark is lit.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Lighting {
    /// The whole cross lies on the disc.
    Full,
    /// The limb cuts the cross: its position is pulled, and it must not decide a mapping.
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
    /// Rotation of the arms from the sensor's axes, modulo a quarter turn, 0 to 90 deg.
    pub quarter_rotation_deg: f64,
}

/// Systematic error of a paraboloid's peak over the sub-pixel phases, px; added to every mark's sigma.
const PARABOLOID_SIGMA_PX: f64 = 0.01;
/// Haze and saturation widen the disc by up to this.
const LIMB_UNCERTAINTY_PX: f64 = 1.0;
/// A spot seen through the round kernel is this much weaker than a cross through its own.
const ROUND_SHARE: f64 = 0.6;

/// Finds the marks on a flattened disc.
pub fn detect(flat: &FlatDisc, shape: &CrossShape, settings: &Settings) -> Detections {
    let spots = find_spots(flat, &Kernel::round(shape), shape, settings);
    let Some(quarter_rotation_deg) = arm_rotation_deg(flat, &spots, shape) else {
        return Detections::default();
    };
    let kernel = Kernel::oriented(shape, quarter_rotation_deg);
    let filter = Filter::new(flat, &kernel);
    let slope_energy = shape.slope_energy();
    let mut marks: Vec<Detection> = spots
        .iter()
        .filter_map(|spot| measure(&filter, shape, slope_energy, *spot, settings))
        .collect();
    marks.sort_by(|a, b| b.contrast.total_cmp(&a.contrast));
    let mut kept: Vec<Detection> = Vec::new();
    for mark in marks {
        let apart = 2.0 * shape.half_length_px;
        if kept.iter().all(|other| other.at.distance(mark.at) > apart) {
            kept.push(mark);
        }
    }
    Detections {
        marks: kept,
        quarter_rotation_deg,
    }
}

/// A kernel laid over a flattened disc: its taps as distances along the values.
struct Filter<'a> {
    flat: &'a FlatDisc,
    kernel: &'a Kernel,
    taps: Vec<(isize, f32)>,
}

impl<'a> Filter<'a> {
    fn new(flat: &'a FlatDisc, kernel: &'a Kernel) -> Self {
        let side = flat.side() as isize;
        let along = |tap: &Tap| (tap.dy * side + tap.dx, tap.weight / kernel.energy as f32);
        Self {
            flat,
            kernel,
            taps: kernel.taps.iter().map(along).collect(),
        }
    }

    /// Rows or columns from which on the kernel stays within the values.
    fn inner(&self) -> std::ops::Range<usize> {
        let reach = self.kernel.reach() + 1;
        reach..self.flat.side().saturating_sub(reach).max(reach)
    }

    fn contains(&self, index: usize) -> bool {
        let (row, column) = (index / self.flat.side(), index % self.flat.side());
        self.inner().contains(&row) && self.inner().contains(&column)
    }

    /// Contrast of the cross as the kernel sees it, centred on an inner value.
    fn response(&self, index: usize) -> f32 {
        let values = self.flat.values();
        let sum = |sum: f32, (along, weight): &(isize, f32)| {
            sum + weight * values[index.wrapping_add_signed(*along)]
        };
        self.taps.iter().fold(0.0, sum)
    }

    /// The responses of all inner values; 0 elsewhere. Tap by tap along whole rows, which the compiler turns into
    /// vector instructions.
    fn responses(&self) -> Vec<f32> {
        let values = self.flat.values();
        let side = self.flat.side();
        let inner = self.inner();
        let mut responses = vec![0.0_f32; values.len()];
        for row in inner.clone() {
            let first = row * side + inner.start;
            let sums = &mut responses[first..first + inner.len()];
            for (along, weight) in &self.taps {
                let from = first.wrapping_add_signed(*along);
                for (sum, value) in sums.iter_mut().zip(&values[from..from + inner.len()]) {
                    *sum += weight * value;
                }
            }
        }
        responses
    }

    /// 1 sigma of a response at a position.
    fn noise(&self, at: SensorPx) -> f64 {
        self.flat.noise(at) / self.kernel.energy.sqrt()
    }
}

/// Indices of the local maxima of the round kernel's response, strongest first, one for each mark length.
fn find_spots(
    flat: &FlatDisc,
    kernel: &Kernel,
    shape: &CrossShape,
    settings: &Settings,
) -> Vec<usize> {
    let filter = Filter::new(flat, kernel);
    let responses = filter.responses();
    let least = (settings.min_contrast * ROUND_SHARE) as f32;
    let mut spots: Vec<usize> = Vec::new();
    for (index, &here) in responses.iter().enumerate() {
        if here > least && filter.contains(index) {
            let at = flat.position(index);
            let significant = f64::from(here) > settings.detection_sigma * filter.noise(at);
            let is_peak = || neighbours(index, flat.side()).all(|n| responses[n] <= here);
            if significant && flat.depth_px(at) > 0.0 && is_peak() {
                spots.push(index);
            }
        }
    }
    spots.sort_by(|a, b| responses[*b].total_cmp(&responses[*a]));
    let mut kept: Vec<usize> = Vec::new();
    for spot in spots {
        let here = flat.position(spot);
        let far = |other: &usize| flat.position(*other).distance(here) > 2.0 * shape.half_length_px;
        if kept.len() < settings.max_detections && kept.iter().all(far) {
            kept.push(spot);
        }
    }
    kept
}

/// The 3 x 3 neighbourhood of an index, by rows.
fn neighbours(index: usize, side: usize) -> impl Iterator<Item = usize> {
    (0..9).map(move |n| index + (n / 3) * side + n % 3 - side - 1)
}

/// The rotation of the arms from the fourfold part of the darkness on rings about the spots. `None` without spots.
fn arm_rotation_deg(flat: &FlatDisc, spots: &[usize], shape: &CrossShape) -> Option<f64> {
    let reach = shape.half_length_px.ceil() as isize;
    let (values, side) = (flat.values(), flat.side() as isize);
    let mut fourfold = Complex::new(0.0, 0.0);
    for spot in spots {
        for dy in -reach..=reach {
            for dx in -reach..=reach {
                let (fx, fy) = (dx as f64, dy as f64);
                let distance = fx.hypot(fy);
                if distance > 2.5 && distance < shape.half_length_px {
                    let darkness = values[spot.wrapping_add_signed(dy * side + dx)];
                    fourfold += Complex::from_polar(f64::from(darkness), 4.0 * fy.atan2(fx));
                }
            }
        }
    }
    (fourfold.norm() > 0.0).then(|| (fourfold.arg() / 4.0).to_degrees().rem_euclid(90.0))
}

/// Climbs to the peak of the cross's response near a spot, refines it by a paraboloid and judges it.
fn measure(
    filter: &Filter<'_>,
    shape: &CrossShape,
    slope_energy: f64,
    spot: usize,
    settings: &Settings,
) -> Option<Detection> {
    let flat = filter.flat;
    let (index, around) = climb(filter, spot)?;
    let (dx, dy) = paraboloid_peak(&around)?;
    let pixel = flat.position(index);
    let at = SensorPx::new(pixel.x + dx, pixel.y + dy);
    let contrast = f64::from(around[4]);
    let enough = (settings.detection_sigma * filter.noise(at)).max(settings.min_contrast);
    let likeness = likeness(filter, index, contrast, flat.noise(at));
    if contrast < enough || likeness < settings.min_likeness {
        return None;
    }
    let random = flat.noise(at) / (contrast * slope_energy.sqrt());
    let lighting = if flat.depth_px(at) >= shape.half_length_px + LIMB_UNCERTAINTY_PX {
        Lighting::Full
    } else {
        Lighting::Cut
    };
    Some(Detection {
        at,
        sigma_px: random.hypot(PARABOLOID_SIGMA_PX),
        contrast,
        likeness,
        lighting,
    })
}

/// The index of the highest response near a spot, with the responses of its 3 x 3 neighbourhood by rows. `None` when
/// the climb leads away.
fn climb(filter: &Filter<'_>, spot: usize) -> Option<(usize, [f32; 9])> {
    const FARTHEST: usize = 5;
    let mut index = spot;
    for _ in 0..=FARTHEST {
        if !neighbours(index, filter.flat.side()).all(|n| filter.contains(n)) {
            return None;
        }
        let mut around = [0.0_f32; 9];
        let mut best = (index, f32::NEG_INFINITY);
        for (response, n) in around.iter_mut().zip(neighbours(index, filter.flat.side())) {
            *response = filter.response(n);
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

/// The top of the least-squares paraboloid through a 3 x 3 neighbourhood, from its middle. `None` when it has no top
/// within a pixel.
fn paraboloid_peak(around: &[f32; 9]) -> Option<(f64, f64)> {
    let mut normal = Matrix6::zeros();
    let mut right = Vector6::zeros();
    for (n, value) in around.iter().enumerate() {
        let (x, y) = (n as f64 % 3.0 - 1.0, (n / 3) as f64 - 1.0);
        let row = Vector6::new(1.0, x, y, x * x, x * y, y * y);
        normal += row * row.transpose();
        right += row * f64::from(*value);
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

/// The part of the structure about a position that the cross explains, the noise's own share taken off.
fn likeness(filter: &Filter<'_>, index: usize, contrast: f64, noise: f64) -> f64 {
    let values = filter.flat.values();
    let count = filter.taps.len() as f64;
    let (mut sum, mut squares) = (0.0_f64, 0.0_f64);
    for (along, _) in &filter.taps {
        let darkness = f64::from(values[index.wrapping_add_signed(*along)]);
        sum += darkness;
        squares += darkness * darkness;
    }
    let structure = squares - sum * sum / count;
    let explained = contrast * contrast * filter.kernel.energy;
    // The noise of this very patch may exceed its mean share; structure is never less than what is explained.
    explained / (structure - count * noise * noise).max(explained)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_top_of_a_paraboloid_is_found_where_it_is() {
        let (px, py) = (0.3, -0.2);
        let around: [f32; 9] = std::array::from_fn(|n| {
            let (x, y) = (n as f64 % 3.0 - 1.0 - px, (n / 3) as f64 - 1.0 - py);
            (1.0 - 0.1 * x * x - 0.2 * y * y + 0.05 * x * y) as f32
        });
        let (x, y) = paraboloid_peak(&around).unwrap();
        assert!((x - px).abs() < 1e-5 && (y - py).abs() < 1e-5);
    }

    #[test]
    fn even_ground_and_saddles_have_no_top() {
        assert_eq!(paraboloid_peak(&[1.0; 9]), None);
        let saddle = [0.0, -1.0, 0.0, 1.0, 0.0, 1.0, 0.0, -1.0, 0.0];
        assert_eq!(paraboloid_peak(&saddle), None);
    }
}
