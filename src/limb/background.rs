//! The background under and around the disc.
//!
//! Stray light varies slowly over the frame. The halves of a sensor that are read through two amplifiers differ by a step.
//! In a frame-transfer CCD every pixel of a column receives the same small fraction of the column's light while the charge
//! is shifted (Powell, Chmielewski and others call it smear). The model is therefore a plane, a step at the middle column
//! and at the middle row, and a multiple of each column's sum. All terms are fitted to the pixels around the disc, which
//! determine them far better than the few pixels of a sector of the limb.

use crate::estimation::{Fitted, LeastSquares, Linearised, Loss, Prior, Scale, TUKEY_SIGMAS};
use crate::frame::{Background, Frame, Levels, Region, Sample, View};
use crate::geometry::Circle;
use crate::kernels::sum_within;
use crate::with_view;
use nalgebra::{SVector, Vector1};

/// The background is fitted to pixels at these distances from the disc's centre, in radii: beyond the blur and the halo.
const ABOUT: [f64; 2] = [1.15, 2.2];
/// Pixels are averaged over squares of this side, reading every `STRIDE_PX`-th row.
const CELL_PX: usize = 48;
const STRIDE_PX: usize = 4;
/// Pixels that deviate more than this from the frame's background are rejected: light leaks, hot pixels. In sigma.
const SAME_SIGMAS: f64 = 5.0;
/// A term smaller than this many sigma is dropped.
const SIGNIFICANT_SIGMAS: f64 = 4.0;

/// Constant, slopes along x and y, steps at the middle column and row, column smear.
const TERMS: usize = 6;
const PLANE: usize = 3;

/// The background of a region around a disc. If too few dark pixels surround it, the background level of the frame.
pub fn background(frame: &Frame, region: Region, disc: &Circle, levels: &Levels) -> Background {
    let even = Background::even(region, levels.background_dn);
    let about = Region::around(
        disc.centre.into(),
        ABOUT[1] * disc.radius,
        frame.width(),
        frame.height(),
    );
    let Some(about) = about else {
        return even;
    };
    let scene = with_view!(frame, view => Scene::of(&view, about, disc, levels));
    match scene.fit() {
        Some(coefficients) => scene.background(region, &coefficients, levels.background_dn),
        None => even,
    }
}

/// A square of dark pixels: its terms, its mean above the frame's background level (DN) and its number of pixels.
struct Cell {
    terms: SVector<f64, TERMS>,
    mean_dn: f64,
    pixels: f64,
}

/// The dark pixels around a disc, and the column sums.
struct Scene {
    about: Region,
    middle: [f64; 2],
    cells: Vec<Cell>,
    /// Light of each column of `about`, relative to the largest.
    column_sums: Vec<f64>,
}

impl Scene {
    fn of<T: Sample>(view: &View<'_, T>, about: Region, disc: &Circle, levels: &Levels) -> Self {
        let cells = about.width().div_ceil(CELL_PX) * about.height().div_ceil(CELL_PX);
        let mut scene = Self {
            about,
            middle: [
                view.width as f64 / 2.0 - 0.5,
                view.height as f64 / 2.0 - 0.5,
            ],
            cells: Vec::with_capacity(cells),
            column_sums: column_sums(view, about, disc, levels.background_dn),
        };
        for y in (about.y0..about.y1).step_by(CELL_PX) {
            for x in (about.x0..about.x1).step_by(CELL_PX) {
                let cell = Region {
                    x0: x,
                    y0: y,
                    x1: (x + CELL_PX).min(about.x1),
                    y1: (y + CELL_PX).min(about.y1),
                };
                scene.cells.extend(scene.cell(view, cell, disc, levels));
            }
        }
        scene
    }

    /// `None` if the disc or its halo is near.
    fn cell<T: Sample>(
        &self,
        view: &View<'_, T>,
        cell: Region,
        disc: &Circle,
        levels: &Levels,
    ) -> Option<Cell> {
        let x = (cell.x0 + cell.x1 - 1) as f64 / 2.0;
        let y = (cell.y0 + cell.y1 - 1) as f64 / 2.0;
        let half_diagonal = CELL_PX as f64 * std::f64::consts::FRAC_1_SQRT_2;
        let distance = (x - disc.centre.x).hypot(y - disc.centre.y);
        if distance - half_diagonal < ABOUT[0] * disc.radius {
            return None;
        }
        let limit = (SAME_SIGMAS * levels.noise_dn).max(1.0);
        let same = [-limit, limit].map(|by| (levels.background_dn + by).max(0.0) as i32);
        let (mut sum, mut pixels) = (0, 0);
        for row in (cell.y0..cell.y1).step_by(STRIDE_PX) {
            let [dn, count] = sum_within(&view.row(row)[cell.x0..cell.x1], same);
            (sum, pixels) = (sum + dn, pixels + count);
        }
        let columns = &self.column_sums[cell.x0 - self.about.x0..cell.x1 - self.about.x0];
        let column_sum = columns.iter().sum::<f64>() / columns.len() as f64;
        (pixels > 0).then(|| Cell {
            terms: self.terms(x, y, column_sum),
            mean_dn: f64::from(sum) / f64::from(pixels) - levels.background_dn,
            pixels: f64::from(pixels),
        })
    }

    fn terms(&self, x: f64, y: f64, column_sum: f64) -> SVector<f64, TERMS> {
        let half = |at: f64, middle: f64| if at > middle { 0.5 } else { -0.5 };
        let [u, v] = self.relative_place(x, y);
        SVector::from([
            1.0,
            u,
            v,
            half(x, self.middle[0]),
            half(y, self.middle[1]),
            column_sum,
        ])
    }

    /// Relative position, -1 to 1 across the region of the pixels that are used.
    fn relative_place(&self, x: f64, y: f64) -> [f64; 2] {
        let along =
            |at: f64, from: usize, to: usize| 2.0 * (at - from as f64) / (to - from) as f64 - 1.0;
        [
            along(x, self.about.x0, self.about.x1),
            along(y, self.about.y0, self.about.y1),
        ]
    }

    /// The coefficients of the terms: the plane always, the other terms only if they are significant.
    fn fit(&self) -> Option<SVector<f64, TERMS>> {
        let all = self.regression(&[true; TERMS], SVector::zeros())?;
        let significant = |n: usize| {
            let term = all.measured(n);
            term.value.abs() > SIGNIFICANT_SIGMAS * term.sigma
        };
        let used = std::array::from_fn(|n| n < PLANE || significant(n));
        let fit = match used == [true; TERMS] {
            true => all,
            false => self.regression(&used, all.parameters)?,
        };
        Some(fit.parameters)
    }

    /// Fits the terms that are used and holds the others at 0. A term that is the same in all cells is held as well.
    fn regression(
        &self,
        used: &[bool; TERMS],
        start: SVector<f64, TERMS>,
    ) -> Option<Fitted<TERMS>> {
        let held = |n: usize| !used[n] || (n >= PLANE && !self.varies(n));
        let fit = LeastSquares {
            start: SVector::from_fn(|n, _| if held(n) { 0.0 } else { start[n] }),
            prior: Prior {
                mean: SVector::zeros(),
                information: SVector::from_fn(|n, _| if held(n) { f64::INFINITY } else { 0.0 }),
            },
            loss: Loss::Tukey(TUKEY_SIGMAS),
            scale: Scale::Median,
            tolerance_sigmas: 0.2,
        };
        let rows = |coefficients: &SVector<f64, TERMS>| {
            let coefficients = *coefficients;
            Some(self.cells.iter().map(move |cell| {
                let weight = cell.pixels.sqrt();
                let left_dn = cell.mean_dn - cell.terms.dot(&coefficients);
                Linearised {
                    residual: Vector1::new(left_dn * weight),
                    jacobian: cell.terms.transpose() * weight,
                }
            }))
        };
        (self.cells.len() > 2 * TERMS).then(|| fit.fit_each(rows).ok())?
    }

    /// Whether enough cells differ from the first one in term `n`.
    fn varies(&self, n: usize) -> bool {
        const DIFFERENT: f64 = 0.2;
        let first = self.cells.first().map_or(0.0, |cell| cell.terms[n]);
        let differs = |cell: &&Cell| (cell.terms[n] - first).abs() > DIFFERENT;
        self.cells.iter().filter(differs).count() > PLANE
    }

    fn background(
        &self,
        region: Region,
        coefficients: &SVector<f64, TERMS>,
        level_dn: f64,
    ) -> Background {
        let [constant, along_x, along_y, step_x, step_y, smear]: [f64; TERMS] =
            (*coefficients).into();
        let centre = [
            (self.about.x0 + self.about.x1) as f64 / 2.0,
            (self.about.y0 + self.about.y1) as f64 / 2.0,
        ];
        let column = |x: usize| {
            let sum = x
                .checked_sub(self.about.x0)
                .and_then(|n| self.column_sums.get(n))
                .copied()
                .unwrap_or(0.0);
            let terms = self.terms(x as f64, centre[1], sum);
            (level_dn + constant + along_x * terms[1] + step_x * terms[3] + smear * sum) as f32
        };
        let row = |y: usize| {
            let terms = self.terms(centre[0], y as f64, 0.0);
            (along_y * terms[2] + step_y * terms[4]) as f32
        };
        Background {
            columns_dn: (region.x0..region.x1).map(column).collect(),
            rows_dn: (region.y0..region.y1).map(row).collect(),
        }
    }
}

/// The light that each column of a region receives from the disc, relative to the largest.
fn column_sums<T: Sample>(
    view: &View<'_, T>,
    about: Region,
    disc: &Circle,
    background_dn: f64,
) -> Vec<f64> {
    let mut sums = vec![0_u32; about.width()];
    let reach = ABOUT[0] * disc.radius;
    let square = Region::around(disc.centre.into(), reach, view.width, view.height);
    let square = square.unwrap_or(about);
    let rows = (square.y0..square.y1).step_by(STRIDE_PX);
    let dark = background_dn * rows.len() as f64;
    for y in rows {
        let row = &view.row(y)[square.x0..square.x1];
        let sums = &mut sums[square.x0.saturating_sub(about.x0)..];
        for (sum, pixel) in sums.iter_mut().zip(row) {
            *sum += (*pixel).into();
        }
    }
    let light: Vec<f64> = sums
        .iter()
        .map(|sum| (f64::from(*sum) - dark).max(0.0))
        .collect();
    let most = light.iter().copied().fold(1.0, f64::max);
    light.iter().map(|light| light / most).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::{FrameInfo, Pixels};
    use nalgebra::Vector2;

    const SIZE: [usize; 2] = [640, 480];
    const DISC: Circle = Circle {
        centre: Vector2::new(330.0, 250.0),
        radius: 80.0,
    };

    /// A disc of 200 DN over a background, with uniform noise of 3 DN rms; 12 bits, so that rounding is negligible.
    fn frame(background: impl Fn(f64, f64) -> f64, column_smear: f64) -> Frame {
        let light = |x: f64, y: f64| match DISC.excess(Vector2::new(x, y)) < 0.0 {
            true => 200.0,
            false => 0.0,
        };
        let columns: Vec<f64> = (0..SIZE[0])
            .map(|x| (0..SIZE[1]).map(|y| light(x as f64, y as f64)).sum::<f64>())
            .collect();
        let pixel = |n: usize| {
            let (column, row) = (n % SIZE[0], n / SIZE[0]);
            let (x, y) = (column as f64, row as f64);
            let noise = f64::from((n * 7919 % 101) as u32 as i32 - 50) / 9.7;
            let smear = column_smear * columns[column];
            (20.0 + light(x, y) + background(x, y) + smear + noise).round() as u16
        };
        let pixels = Pixels::U16((0..SIZE[0] * SIZE[1]).map(pixel).collect());
        Frame::new(SIZE[0], SIZE[1], pixels, 4095, FrameInfo::default()).unwrap()
    }

    /// Largest error of the fitted background over all pixels around the disc, DN.
    fn worst_dn(background: impl Fn(f64, f64) -> f64, column_smear: f64) -> f64 {
        let frame = frame(&background, column_smear);
        let region = Region::sized(230, 150, 200, 200);
        let levels = Levels {
            background_dn: 20.0,
            noise_dn: 3.0,
            disc_dn: 220.0,
        };
        let found = super::background(&frame, region, &DISC, &levels);
        let mut worst = 0.0_f64;
        for (n, column_dn) in found.columns_dn.iter().enumerate() {
            let x = (region.x0 + n) as f64;
            let half2 = DISC.radius.powi(2) - (x - DISC.centre.x).powi(2);
            let smear = column_smear * 200.0 * 2.0 * half2.max(0.0).sqrt();
            for (m, row_dn) in found.rows_dn.iter().enumerate() {
                let expected = 20.0 + background(x, (region.y0 + m) as f64) + smear;
                worst = worst.max((f64::from(column_dn + row_dn) - expected).abs());
            }
        }
        worst
    }

    #[test]
    fn an_even_background_stays_even() {
        assert!(worst_dn(|_, _| 0.0, 0.0) < 0.3);
    }

    #[test]
    fn a_plane_of_stray_light_is_found() {
        assert!(worst_dn(|x, y| 0.02 * x - 0.01 * y, 0.0) < 0.3);
    }

    #[test]
    fn a_step_between_the_halves_of_the_sensor_is_found() {
        assert!(worst_dn(|x, _| if x > 319.5 { 2.0 } else { 0.0 }, 0.0) < 0.4);
        assert!(worst_dn(|_, y| if y > 239.5 { 2.0 } else { 0.0 }, 0.0) < 0.4);
    }

    #[test]
    fn smear_along_the_columns_is_found() {
        let worst = worst_dn(|_, _| 0.0, 2e-4);
        assert!(worst < 0.6, "{worst}");
    }

    #[test]
    fn a_window_that_shows_little_beside_the_disc_has_the_frames_level() {
        let frame = frame(|_, _| 0.0, 0.0);
        let window = frame.cropped(Region::sized(235, 155, 190, 190)).unwrap();
        let disc = Circle {
            centre: DISC.centre - Vector2::new(235.0, 155.0),
            ..DISC
        };
        let levels = Levels {
            background_dn: 21.0,
            noise_dn: 3.0,
            disc_dn: 220.0,
        };
        let found = super::background(&window, window.region(), &disc, &levels);
        assert_eq!(found, Background::even(window.region(), 21.0));
    }
}
