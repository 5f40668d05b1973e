//! The disc divided by its own brightness: a mark becomes a dark cross on a uniform background, and the limb leaves no
//! edge.

use super::{Illumination, Lighting, MarkImage};
use crate::estimation::{Normal, Prior, SIGMA_PER_MEDIAN, median};
use crate::frame::{Cutout, PixelNoise, Region};
use crate::geometry::Ellipse;
use crate::kernels::{SeenRow, divide_row, larger, zeros};
use crate::units::SensorPx;
use nalgebra::{Vector2, Vector4};
use std::ops::Range;

/// Margin of the square around the disc relative to its radius: the outline is not final yet.
const DISC_MARGIN: f64 = 0.02;
/// Pixels with less than this fraction of the brightest light are not used: from a pixel inside the limb outwards an error
/// of the outline by 0.1 px changes the brightness by 5 % and more.
const LEAST_LIGHT: f32 = 0.4;
/// Pixels brighter than this many sigma are clipped: scratches and hot pixels.
const BRIGHTEST_SIGMA: f64 = 3.0;

/// The darkness of every pixel around the disc: 0 on the clean disc and outside it, 1 where no light is left.
#[derive(Debug, Clone, PartialEq)]
pub struct FlatDisc {
    pub outline: Ellipse,
    /// The region of the sensor with pixel values.
    known: Region,
    /// The sensor pixel of the first value; the square around the disc may extend beyond the sensor.
    left: isize,
    top: isize,
    side: usize,
    darkness: Vec<f32>,
    /// Brightness of the clean disc, DN.
    light: Vec<f32>,
    /// Pixels with less expected light are not used, and their light is set to 0; DN.
    least_light: f32,
    noise: PixelNoise,
    /// The scatter of the clean disc's pixels over their stated noise, at least 1.
    inflation: f64,
}

impl FlatDisc {
    /// Divides a disc by its light. The margin of darkness 0 around it is wide enough for a cross at the limb.
    ///
    /// The light is the expected one times a smooth factor that the disc's own pixels determine. Masked pixels have
    /// darkness 0. `None` when the disc is not in the cutout.
    pub fn new(
        cutout: &Cutout,
        outline: Ellipse,
        illumination: &impl Illumination,
        shape: &MarkImage,
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
            darkness: zeros(side * side),
            light: zeros(side * side),
            least_light: 0.0,
            noise: cutout.noise,
            inflation: 1.0,
        };
        flat.expect_light(&about, illumination);
        let ground = Ground::sample(&flat, cutout, about)?;
        let factor = ground.factor();
        flat.inflation = ground.scatter(&factor, &flat.noise).max(1.0);
        flat.divide(cutout, &about, &factor);
        Some(flat)
    }

    /// The columns of a row of the sensor within the disc, clipped to a region.
    fn chord(&self, y: usize, about: &Region) -> Range<usize> {
        let reach = self.outline.mean_radius() * (1.0 + DISC_MARGIN);
        let dy = y as f64 - self.outline.centre.y;
        let half = (reach * reach - dy * dy).max(0.0).sqrt();
        let [from, to] = [-half, half].map(|side| (self.outline.centre.x + side).max(0.0) as usize);
        from.clamp(about.x0, about.x1)..to.clamp(about.x0, about.x1)
    }

    /// Fills in the expected brightness.
    fn expect_light(&mut self, about: &Region, illumination: &impl Illumination) {
        let stride = Ground::stride_px(&self.outline);
        let mut brightest = 0.0;
        for y in about.y0..about.y1 {
            let chord = self.chord(y, about);
            let first = self.offset(chord.start, y);
            let row = &mut self.light[first..first + chord.len()];
            illumination.fill(chord.start as f64, y as f64, row);
            brightest = row.iter().step_by(stride).copied().fold(brightest, larger);
        }
        self.least_light = LEAST_LIGHT * brightest;
    }

    /// Fills in the darkness; the expected brightness is replaced by the disc's own.
    fn divide(&mut self, cutout: &Cutout, about: &Region, factor: &LightFactor) {
        let brightest = f64::from(self.least_light / LEAST_LIGHT);
        let most_excess_dn = BRIGHTEST_SIGMA * self.inflation * self.noise.sigma_dn(brightest);
        let (most_excess_dn, least_light) = (most_excess_dn as f32, self.least_light);
        for y in about.y0..about.y1 {
            let chord = self.chord(y, about);
            let first = self.offset(chord.start, y);
            let pixels = first..first + chord.len();
            let columns = chord.start - self.known.x0..chord.end - self.known.x0;
            let (darkness, light) = (&mut self.darkness[pixels.clone()], &mut self.light[pixels]);
            let row = SeenRow {
                seen: &cutout.row(y)[columns.clone()],
                masked: &cutout.mask.row(y)[columns],
                factor: factor.along_row(chord.start, y),
            };
            divide_row(&row, least_light, most_excess_dn, light, darkness);
        }
    }

    /// The index of a sensor pixel in the square.
    fn offset(&self, x: usize, y: usize) -> usize {
        let (column, row) = (x as isize - self.left, y as isize - self.top);
        row as usize * self.side + column as usize
    }

    /// Number of pixels in a row, and of rows.
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

    /// The index of the value nearest to a position; `None` outside the square.
    pub(super) fn index(&self, at: SensorPx) -> Option<usize> {
        let column = at.x.round() - self.left as f64;
        let row = at.y.round() - self.top as f64;
        let within = |v: f64| (0.0..self.side as f64).contains(&v);
        (within(column) && within(row)).then(|| row as usize * self.side + column as usize)
    }

    /// 1 sigma of the darkness at a value's index; infinite where pixels are not used.
    pub fn noise(&self, index: usize) -> f64 {
        let light = f64::from(self.light[index]);
        self.inflation * self.noise.sigma_dn(light) / light
    }

    /// Lighting of a mark at a position, by the offsets of its tips.
    pub fn lighting(&self, at: SensorPx, tips: impl Iterator<Item = Vector2<f64>>) -> Lighting {
        Lighting::of(at, tips, &self.outline, &self.known)
    }
}

/// Ratio of the clean disc's brightness to the expected one: a constant, a tilt (vignetting, the lamp), and a term in the
/// square of the distance from the disc's centre (a different limb darkening). Coefficients of 1, u, v and u^2 + v^2, in
/// radii from the centre.
struct LightFactor {
    outline: Ellipse,
    coefficients: Vector4<f64>,
}

impl LightFactor {
    /// Offset of a pixel from the disc's centre, radii.
    fn offset(outline: &Ellipse, x: usize, y: usize) -> [f64; 2] {
        let radius = outline.mean_radius();
        [
            (x as f64 - outline.centre.x) / radius,
            (y as f64 - outline.centre.y) / radius,
        ]
    }

    /// The factor on a row's pixels from column `x` on: a polynomial of second degree in the pixel's index, the constant
    /// first.
    fn along_row(&self, x: usize, y: usize) -> [f32; 3] {
        let [u, v] = Self::offset(&self.outline, x, y);
        let step = 1.0 / self.outline.mean_radius();
        let [even, along_u, along_v, square] = self.coefficients.into();
        let first = even + along_u * u + along_v * v + square * (u * u + v * v);
        let slope = (along_u + 2.0 * square * u) * step;
        [first, slope, square * step * step].map(|v| v as f32)
    }
}

/// A sparse sample of the disc's pixels.
struct Ground {
    outline: Ellipse,
    pixels: Vec<GroundPixel>,
}

struct GroundPixel {
    basis: Vector4<f64>,
    /// Expected brightness, DN.
    light: f64,
    /// Ratio of observed to expected brightness.
    ratio: f64,
}

impl Ground {
    /// Largest stride of the sample in columns and rows: some 600 pixels of the demo's disc, of which few remain if it is
    /// saturated. A smaller disc has a smaller stride.
    const MOST_STRIDE_PX: f64 = 7.0;
    const STRIDES_PER_RADIUS: f64 = 12.0;
    /// Fewest pixels that determine the factor.
    const MIN_PIXELS: usize = 40;
    /// Scatter of single pixels' ratios, and 1 sigma of tilt and curvature about zero.
    const RATIO_SIGMA: f64 = 0.05;
    const UNEVEN_SIGMA: f64 = 0.15;
    /// Pixels that differ from the factor by more than this are marks or blemishes: the limit of each pass.
    const LIMITS: [f64; 3] = [0.3, 0.15, 0.15];

    fn stride_px(outline: &Ellipse) -> usize {
        let stride_px = outline.mean_radius() / Self::STRIDES_PER_RADIUS;
        stride_px.clamp(1.0, Self::MOST_STRIDE_PX) as usize
    }

    /// `None` if there are too few pixels.
    fn sample(flat: &FlatDisc, cutout: &Cutout, about: Region) -> Option<Self> {
        let mut pixels = Vec::new();
        let stride_px = Self::stride_px(&flat.outline);
        for y in (about.y0..about.y1).step_by(stride_px) {
            let (seen, masked) = (cutout.row(y), cutout.mask.row(y));
            // The first column changes from row to row, so that a column of blemishes does not count too much.
            let first = about.x0 + 3 * y % stride_px;
            for x in (first..about.x1).step_by(stride_px) {
                let light = f64::from(flat.light[flat.offset(x, y)]);
                let column = x - cutout.region().x0;
                if light >= f64::from(flat.least_light) && !masked[column] {
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

    /// Least squares on the brightness, without outliers of the previous pass; the first pass starts from the median.
    fn factor(&self) -> LightFactor {
        let middle = median(self.pixels.iter().map(|pixel| pixel.ratio)).unwrap_or(1.0);
        let start = Vector4::new(middle, 0.0, 0.0, 0.0);
        let mut coefficients = start;
        let lights = self.pixels.iter().map(|pixel| pixel.light);
        let brightest = lights.fold(f64::MIN_POSITIVE, f64::max);
        // A saturated disc shows only a thin ring, which must not determine the curvature.
        let uneven = Self::UNEVEN_SIGMA.powi(-2);
        let even = Prior {
            mean: Vector4::zeros(),
            information: Vector4::new(0.0, uneven, uneven, uneven),
        };
        for limit in Self::LIMITS {
            let mut normal = Normal::zero();
            for GroundPixel {
                basis,
                light,
                ratio,
            } in &self.pixels
            {
                if (ratio - basis.dot(&coefficients)).abs() < limit * middle {
                    let weight = (light / brightest / Self::RATIO_SIGMA).powi(2);
                    normal.add(basis, *ratio, weight);
                }
            }
            match normal.solve(&even, &Vector4::zeros()) {
                Some(solved) => coefficients = solved.step,
                None => break,
            }
        }
        LightFactor {
            outline: self.outline,
            coefficients,
        }
    }

    /// Scatter of the pixels relative to their stated noise, by the median.
    fn scatter(&self, factor: &LightFactor, noise: &PixelNoise) -> f64 {
        let normalised = self.pixels.iter().map(|pixel| {
            let light = pixel.light * pixel.basis.dot(&factor.coefficients);
            (pixel.ratio * pixel.light - light).abs() / noise.sigma_dn(light)
        });
        SIGMA_PER_MEDIAN * median(normalised).unwrap_or(0.0)
    }
}
