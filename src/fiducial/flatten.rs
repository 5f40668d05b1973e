//! The disc without its own brightness: a mark becomes a dark cross on even ground, and the limb leaves no edge.

use super::{CrossShape, Illumination};
use crate::estimation::{SIGMA_PER_MEDIAN, median};
use crate::frame::{Cutout, PixelNoise, Region};
use crate::geometry::Ellipse;
use crate::units::SensorPx;
use nalgebra::{Matrix4, Vector4};

/// The square reaches over the disc by this part of its radius: the outline is not final yet.
const DISC_MARGIN: f64 = 0.02;
/// Where less than this part of the brightest light falls, nothing is judged: from a pixel inside the limb outwards an error
/// of the outline by 0.1 px shows as 5 % of the light and more.
const LEAST_LIGHT: f32 = 0.4;
/// Pixels brighter than this many sigma are taken for that bright: scratches and hot pixels.
const BRIGHTEST_SIGMA: f64 = 3.0;

/// The darkness of every pixel about the disc: 0 on the clean disc and outside it, 1 where no light is left.
#[derive(Debug, Clone, PartialEq)]
pub struct FlatDisc {
    pub outline: Ellipse,
    /// The part of the sensor that is known.
    known: Region,
    /// The sensor's pixel that the first value belongs to; the square about the disc may reach over the sensor.
    left: isize,
    top: isize,
    side: usize,
    darkness: Vec<f32>,
    /// Light of the clean disc, DN; 0 where nothing is judged.
    light: Vec<f32>,
    noise: PixelNoise,
    /// The scatter of the clean disc's pixels over their stated noise, at least 1.
    inflation: f64,
}

impl FlatDisc {
    /// Divides a disc by its light, with ground of darkness 0 about it, so wide that a cross at the limb fits in.
    ///
    /// The light is the expected one times a smooth factor that the disc's own pixels determine. Masked pixels have
    /// darkness 0. `None` when the disc is not in the cutout.
    pub fn new(
        cutout: &Cutout,
        outline: Ellipse,
        illumination: &impl Illumination,
        shape: &CrossShape,
    ) -> Option<Self> {
        let disc_px = outline.mean_radius() * (1.0 + DISC_MARGIN);
        let known = cutout.region();
        let about = Region::around(outline.centre.into(), disc_px, known.x1, known.y1)?;
        let about = about.intersection(&known)?;
        let reach = disc_px + 2.0 * shape.reach_px();
        let side = 2 * reach.ceil() as usize + 2;
        let mut flat = Self {
            outline,
            known,
            left: (outline.centre.x - reach).floor() as isize,
            top: (outline.centre.y - reach).floor() as isize,
            side,
            darkness: vec![0.0; side * side],
            light: vec![0.0; side * side],
            noise: cutout.noise,
            inflation: 1.0,
        };
        flat.expect_light(about, illumination);
        let ground = Ground::sample(&flat, cutout, about)?;
        let factor = ground.factor();
        flat.inflation = ground.scatter(&factor, &flat.noise).max(1.0);
        flat.divide(cutout, about, &factor);
        Some(flat)
    }

    /// Fills in the expected light.
    fn expect_light(&mut self, about: Region, illumination: &impl Illumination) {
        for y in about.y0..about.y1 {
            let first = self.offset(about.x0, y);
            let row = &mut self.light[first..first + about.width()];
            illumination.fill(about.x0 as f64, y as f64, row);
        }
        let brightest = self.light.iter().copied().fold(0.0, f32::max);
        for light in &mut self.light {
            *light = if *light < LEAST_LIGHT * brightest {
                0.0
            } else {
                *light
            };
        }
    }

    /// Fills in the darkness; the expected light becomes the disc's own.
    fn divide(&mut self, cutout: &Cutout, about: Region, factor: &LightFactor) {
        let brightest = self.light.iter().copied().fold(0.0, f32::max);
        let most_excess_dn =
            self.noise.sigma_dn(brightest.into()) * BRIGHTEST_SIGMA * self.inflation;
        let most_excess_dn = most_excess_dn as f32;
        for y in about.y0..about.y1 {
            let first = self.offset(about.x0, y);
            let pixels = first..first + about.width();
            let seen = &cutout.row(y)[about.x0 - self.known.x0..];
            let masked = &cutout.mask.row(y)[about.x0 - self.known.x0..];
            let (darkness, light) = (&mut self.darkness[pixels.clone()], &mut self.light[pixels]);
            factor.scale_row(about.x0, y, light);
            for (((darkness, light), seen), masked) in
                darkness.iter_mut().zip(light).zip(seen).zip(masked)
            {
                let left = seen.min(*light + most_excess_dn) / light.max(f32::MIN_POSITIVE);
                *darkness = if *masked | (*light <= 0.0) {
                    0.0
                } else {
                    1.0 - left
                };
            }
        }
    }

    /// The index of a pixel of the sensor that lies in the square.
    fn offset(&self, x: usize, y: usize) -> usize {
        let (column, row) = (x as isize - self.left, y as isize - self.top);
        row as usize * self.side + column as usize
    }

    /// Pixels in a row, and rows.
    pub fn side(&self) -> usize {
        self.side
    }

    /// The darkness, row by row.
    pub(super) fn values(&self) -> &[f32] {
        &self.darkness
    }

    /// The sensor position of a value's index.
    pub(super) fn position(&self, index: usize) -> SensorPx {
        let (row, column) = (index / self.side, index % self.side);
        SensorPx::new(
            (self.left + column as isize) as f64,
            (self.top + row as isize) as f64,
        )
    }

    /// The index of the value nearest to a position; `None` beyond the square.
    pub(super) fn index(&self, at: SensorPx) -> Option<usize> {
        let column = at.x.round() - self.left as f64;
        let row = at.y.round() - self.top as f64;
        let within = |v: f64| (0.0..self.side as f64).contains(&v);
        (within(column) && within(row)).then(|| row as usize * self.side + column as usize)
    }

    /// 1 sigma of the darkness at a value's index; infinite where nothing is judged.
    pub fn noise(&self, index: usize) -> f64 {
        let light = f64::from(self.light[index]);
        self.inflation * self.noise.sigma_dn(light) / light
    }

    /// Whether a position is lit: inside the limb and on the sensor, by a margin.
    pub fn is_lit(&self, at: SensorPx, margin_px: f64) -> bool {
        let within = |v: f64, from: usize, to: usize| {
            v >= from as f64 + margin_px && v <= to as f64 - 1.0 - margin_px
        };
        self.outline.excess(at.vector()) < -margin_px
            && within(at.x, self.known.x0, self.known.x1)
            && within(at.y, self.known.y0, self.known.y1)
    }
}

/// The clean disc's light over the expected one: a constant, a tilt (vignetting, the lamp), and a part that grows with the square of
/// the distance from the disc's middle (another limb darkening). Coefficients of 1, u, v and u^2 + v^2, in radii from the
/// middle.
struct LightFactor {
    outline: Ellipse,
    coefficients: Vector4<f64>,
}

impl LightFactor {
    /// Offset of a pixel from the disc's middle, radii.
    fn offset(outline: &Ellipse, x: usize, y: usize) -> [f64; 2] {
        let radius = outline.mean_radius();
        [
            (x as f64 - outline.centre.x) / radius,
            (y as f64 - outline.centre.y) / radius,
        ]
    }

    /// Multiplies the light on a row's pixels from column `x` on.
    fn scale_row(&self, x: usize, y: usize, light: &mut [f32]) {
        let [u, v] = Self::offset(&self.outline, x, y);
        let [even, along_u, along_v, square] = self.coefficients.into();
        let of_row = (even + along_v * v + square * v * v) as f32;
        let (u, step) = (u as f32, 1.0 / self.outline.mean_radius() as f32);
        let (along_u, square) = (along_u as f32, square as f32);
        for (n, light) in light.iter_mut().enumerate() {
            let u = u + n as i32 as f32 * step;
            *light *= of_row + u * (along_u + u * square);
        }
    }
}

/// A sparse sample of the disc's pixels.
struct Ground {
    outline: Ellipse,
    pixels: Vec<GroundPixel>,
}

struct GroundPixel {
    basis: Vector4<f64>,
    /// Expected light, DN.
    light: f64,
    /// Seen over expected light.
    ratio: f64,
}

impl Ground {
    /// Columns and rows from one pixel of the sample to the next: some 600 pixels of the Sun's disc.
    const STRIDE_PX: usize = 7;
    /// Fewest pixels that determine the factor.
    const MIN_PIXELS: usize = 40;
    /// Farther than this from the factor is a mark or a blemish: the limit of each pass.
    const LIMITS: [f64; 3] = [0.3, 0.15, 0.15];

    /// `None` of too few pixels.
    fn sample(flat: &FlatDisc, cutout: &Cutout, about: Region) -> Option<Self> {
        let mut pixels = Vec::new();
        for y in (about.y0..about.y1).step_by(Self::STRIDE_PX) {
            let (seen, masked) = (cutout.row(y), cutout.mask.row(y));
            // Each row starts elsewhere, so that no column of blemishes counts more than its share.
            let first = about.x0 + 3 * y % Self::STRIDE_PX;
            for x in (first..about.x1).step_by(Self::STRIDE_PX) {
                let light = f64::from(flat.light[flat.offset(x, y)]);
                let column = x - cutout.region().x0;
                if light > 0.0 && !masked[column] {
                    let [u, v] = LightFactor::offset(&flat.outline, x, y);
                    pixels.push(GroundPixel {
                        basis: Vector4::new(1.0, u, v, u * u + v * v),
                        light,
                        ratio: f64::from(seen[column]) / light,
                    });
                }
            }
        }
        (pixels.len() >= Self::MIN_PIXELS).then_some(Self {
            outline: flat.outline,
            pixels,
        })
    }

    /// By least squares on the light, without what is far from the pass before; the first starts from the median.
    fn factor(&self) -> LightFactor {
        let middle = median(self.pixels.iter().map(|pixel| pixel.ratio)).unwrap_or(1.0);
        let start = Vector4::new(middle, 0.0, 0.0, 0.0);
        let mut coefficients = start;
        for limit in Self::LIMITS {
            let mut matrix = Matrix4::zeros();
            let mut right = Vector4::zeros();
            for GroundPixel {
                basis,
                light,
                ratio,
            } in &self.pixels
            {
                if (ratio - basis.dot(&coefficients)).abs() < limit * middle {
                    let weighted = basis * (light * light);
                    matrix.ger(1.0, &weighted, basis, 1.0);
                    right += weighted * *ratio;
                }
            }
            match matrix.cholesky() {
                Some(factor) => coefficients = factor.solve(&right),
                None => break,
            }
        }
        LightFactor {
            outline: self.outline,
            coefficients,
        }
    }

    /// Scatter of the pixels over their stated noise, by the median.
    fn scatter(&self, factor: &LightFactor, noise: &PixelNoise) -> f64 {
        let normalised = self.pixels.iter().map(|pixel| {
            let light = pixel.light * pixel.basis.dot(&factor.coefficients);
            (pixel.ratio * pixel.light - light).abs() / noise.sigma_dn(light)
        });
        SIGMA_PER_MEDIAN * median(normalised).unwrap_or(0.0)
    }
}
