//! Pixels without light: dark level, read noise, and hot pixels.

use super::shots::{Shot, Shots};
use crate::calibrate::quantity::CalibratedQuantity;
use crate::frame::Frame;
use crate::units::Measured;
use crate::with_view;

/// Fewest frames for which a pixel's median separates a hot pixel from noise.
const LEAST_FRAMES: usize = 3;
/// A hot pixel exceeds the level by more than this many sigmas of the noise of one frame.
const HOT_SIGMAS: f64 = 5.0;
/// With more bright neighbours than this a pixel is illuminated, not hot.
const MOST_NEIGHBOURS: usize = 2;
/// If more than this part of the values is zero, the noise is clipped there.
const CUT_OFF: f64 = 0.003;
/// Every n-th pixel is used for level and noise.
const STRIDE: usize = 3;
/// The part of a normal distribution below one sigma.
const ONE_SIGMA: f64 = 0.841_345;
/// Systematic error of level and noise from rounding and sampling, DN.
const FLOOR_DN: f64 = 0.01;
/// The same for noise estimated from integer values in the upper half of a distribution.
const COARSE_DN: f64 = 0.05;

/// Levels of the unilluminated pixels.
#[derive(Debug, Clone)]
pub(super) struct Dark {
    pub level: Result<Measured, String>,
    pub noise: Result<Measured, String>,
    noise_remark: &'static str,
    pub hot: Option<Vec<(usize, usize)>>,
}

/// Level, noise and hot pixels of the unilluminated parts of frames.
pub(super) fn measure(shots: &Shots) -> Dark {
    let values: Vec<f64> = shots.frames.iter().flat_map(unlit).collect();
    if values.len() < 1000 {
        let why = "not determined: no unlit pixels; take frames with the lens covered (--dark)";
        return Dark {
            level: Err(why.into()),
            noise: Err(why.into()),
            noise_remark: "",
            hot: None,
        };
    }
    let histogram = Histogram::of(&values);
    let level = histogram.value_above(0.5);
    let (noise, noise_remark) = noise(shots, &histogram, level);
    let sigma = (noise.value / (values.len() as f64).sqrt()).hypot(FLOOR_DN);
    Dark {
        level: Ok(Measured::new(level, sigma)),
        noise: Ok(noise),
        noise_remark,
        hot: hot_pixels(shots, level, noise.value),
    }
}

impl Dark {
    pub fn level_dn(&self) -> f64 {
        self.level.as_ref().map_or(0.0, |level| level.value)
    }

    pub fn noise_dn(&self) -> f64 {
        self.noise.as_ref().map_or(1.0, |noise| noise.value)
    }

    pub fn level_quantity(&self) -> CalibratedQuantity {
        let name = ("dark level", "camera.noise.dark_dn", "DN");
        CalibratedQuantity::measured(name, self.level.clone(), "median of the unlit pixels")
    }

    pub fn noise_quantity(&self) -> CalibratedQuantity {
        let name = ("read noise", "camera.noise.read_noise_dn", "DN");
        CalibratedQuantity::measured(name, self.noise.clone(), self.noise_remark)
    }
}

/// A sample of a frame's pixels: columns and rows.
fn sample(frame: &Frame) -> impl Iterator<Item = (usize, usize)> + use<> {
    let width = frame.width();
    let every = (0..width * frame.height()).step_by(STRIDE);
    every.map(move |n| (n % width, n / width))
}

/// A sample of a frame's unilluminated pixels.
fn unlit(shot: &Shot) -> Vec<f64> {
    let unlit = sample(&shot.frame).filter(|(x, y)| shot.is_unlit(*x, *y));
    with_view!(&shot.frame, view => unlit.map(|(x, y)| f64::from(view.dn(x, y))).collect())
}

/// Noise from differences of successive frames, which cancel fixed patterns; if it is clipped at zero, from the upper half of the values.
fn noise(shots: &Shots, histogram: &Histogram, level: f64) -> (Measured, &'static str) {
    let cut_off = histogram.part_of(0) > CUT_OFF;
    let differences: Vec<f64> = shots
        .pairs()
        .into_iter()
        .flat_map(|(a, b)| difference(a, b))
        .collect();
    if cut_off || differences.len() < 1000 {
        let value = histogram.value_above(ONE_SIGMA) - level;
        let remark = match cut_off {
            true => {
                "from the upper half of the values, fixed pattern included: the lower half is cut off at zero; raise the camera's offset to measure it from pairs"
            }
            false => {
                "from the upper half of the values, fixed pattern included: no two frames at equal exposure"
            }
        };
        let sigma = (2.0 * value / histogram.total.sqrt()).hypot(COARSE_DN);
        return (Measured::new(value, sigma), remark);
    }
    let variance = clipped_variance(&differences);
    let value = (variance / 2.0).sqrt();
    let sigma = (value / (2.0 * differences.len() as f64).sqrt()).hypot(FLOOR_DN);
    (
        Measured::new(value, sigma),
        "from differences of frames that follow each other",
    )
}

/// A sample of the differences of two frames, where both are unilluminated.
fn difference(a: &Shot, b: &Shot) -> Vec<f64> {
    let unlit = sample(&a.frame).filter(|(x, y)| a.is_unlit(*x, *y) && b.is_unlit(*x, *y));
    unlit.map(|(x, y)| dn(a, x, y) - dn(b, x, y)).collect()
}

/// A pixel's value.
pub(super) fn dn(shot: &Shot, x: usize, y: usize) -> f64 {
    with_view!(&shot.frame, view => f64::from(view.dn(x, y)))
}

/// The variance of values without the few beyond five sigmas: hot pixels flicker.
pub(super) fn clipped_variance(values: &[f64]) -> f64 {
    let mut limit = f64::INFINITY;
    let mut variance = 0.0;
    for _ in 0..4 {
        let (mut count, mut sum, mut squares) = (0.0, 0.0, 0.0);
        for v in values.iter().filter(|v| v.abs() <= limit) {
            count += 1.0;
            sum += v;
            squares += v * v;
        }
        let mean: f64 = sum / f64::max(count, 1.0);
        variance = (squares - count * mean * mean) / f64::max(count - 1.0, 1.0);
        limit = mean.abs() + 5.0 * variance.max(0.0).sqrt();
    }
    variance
}

/// The pixels whose median over the frames in which they are unilluminated is well above the level, unlike that of their neighbours.
fn hot_pixels(shots: &Shots, level: f64, noise: f64) -> Option<Vec<(usize, usize)>> {
    let first = &shots.frames.first()?.frame;
    if shots.frames.len() < LEAST_FRAMES {
        return None;
    }
    let (width, height) = (first.width(), first.height());
    let limit = level + HOT_SIGMAS * noise.max(1.0);
    let mut values = Vec::with_capacity(shots.frames.len());
    let mut bright = vec![false; width * height];
    for (n, bright) in bright.iter_mut().enumerate() {
        let (x, y) = (n % width, n / width);
        values.clear();
        let unlit = shots.frames.iter().filter(|shot| shot.is_unlit(x, y));
        values.extend(unlit.map(|shot| dn(shot, x, y)));
        let above = values.iter().filter(|v| **v > limit).count();
        *bright = values.len() >= LEAST_FRAMES && 2 * above > values.len();
    }
    let alone = |n: &usize| {
        let (x, y) = (n % width, n / width);
        let rows = y.saturating_sub(1)..(y + 2).min(height);
        let columns = x.saturating_sub(1)..(x + 2).min(width);
        let around = rows.flat_map(|y| columns.clone().map(move |x| y * width + x));
        around.filter(|m| bright[*m]).count() <= 1 + MOST_NEIGHBOURS
    };
    let hot = (0..bright.len()).filter(|n| bright[*n]).filter(alone);
    Some(hot.map(|n| (n % width, n / width)).collect())
}

/// Histogram of integer values.
struct Histogram {
    counts: Vec<u64>,
    total: f64,
}

impl Histogram {
    fn of(values: &[f64]) -> Self {
        let mut counts = vec![0_u64; 1 << 16];
        for value in values {
            counts[*value as usize] += 1;
        }
        Self {
            counts,
            total: values.len() as f64,
        }
    }

    fn part_of(&self, value: usize) -> f64 {
        self.counts[value] as f64 / self.total
    }

    /// The value below which a part of the counts lies, interpolated within an integer.
    fn value_above(&self, part: f64) -> f64 {
        let wanted = part * self.total;
        let mut below = 0.0;
        for (dn, count) in self.counts.iter().enumerate().filter(|(_, n)| **n > 0) {
            let count = *count as f64;
            if below + count >= wanted {
                return dn as f64 - 0.5 + (wanted - below) / count;
            }
            below += count;
        }
        self.counts.len() as f64
    }
}
